"""Ctrl-C and folders that cannot be written to, through the command line."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.folders import ROOT


def environment(home):
    paths = os.pathsep.join([str(ROOT / "src"), str(ROOT)])
    return {**os.environ, "PYTHONPATH": paths, "CONETL_HOME": str(home)}


def test_ctrl_c_at_a_question_ends_at_once(tmp_path):
    code = (
        "import sys, typer\nfrom conetl.cli import app, main\nfrom conetl.cli.console import at_a_question\n@app.command()\n"
        "def wait():\n    with at_a_question(): typer.prompt('Which one')\nsys.argv = ['conetl', 'wait']; main()"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code], env=environment(tmp_path), cwd=ROOT,
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert process.stdout.read(9) == "Which one"
    time.sleep(0.5)
    process.send_signal(signal.SIGINT)
    _, complaint = process.communicate(timeout=60)
    assert process.returncode == 130
    assert complaint.strip() == "conetl: interrupted"


@pytest.mark.parametrize("presses", [1, 2])
def test_ctrl_c_is_one_sentence_and_an_exit_code_of_its_own(tmp_path, presses):
    """A second Ctrl-C ends what does not listen to the first."""
    # Ready is what is inside of `try` already: a Ctrl-C just before it would end the first wait and find no second one.
    body = "print('ready', flush=True); time.sleep(60)"
    body = body if presses == 1 else f"try: {body}\n    finally: time.sleep(60)"
    wait = f"import time\nfrom conetl.cli import app, main\n@app.command()\ndef wait():\n    {body}"
    code = f"{wait}\nimport sys; sys.argv = ['conetl', 'wait']; main()"
    process = subprocess.Popen(
        [sys.executable, "-c", code],
        env=environment(tmp_path),
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout.readline() == "ready\n"
    for _ in range(presses):
        process.send_signal(signal.SIGINT)
        time.sleep(0.5)
    _, complaint = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "Ctrl-C again to stop immediately" in complaint
    assert ("is partly on the map" in complaint) == (presses == 1)
    assert "Traceback" not in complaint


def test_names_that_a_terminal_cannot_show_are_escaped(tmp_path):
    show = (
        "from conetl.cli import app, main\nfrom conetl.cli.console import print_table\n"
        "@app.command()\ndef show():\n    print_table('', ['drive'], [['Stra\\u00dfe']])"
    )
    done = subprocess.run(
        [sys.executable, "-c", f"{show}\nimport sys; sys.argv = ['conetl', 'show']; main()"],
        env={**environment(tmp_path), "PYTHONIOENCODING": "ascii"}, cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert r"Stra\xdfe" in done.stdout


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no full device")
def test_a_full_disk_below_standard_output_is_named(tmp_path):
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-c", "from conetl.cli import main; main()", "map", "export", "--help"],
            env=environment(tmp_path), cwd=ROOT, stdout=full, stderr=subprocess.PIPE, text=True, check=False,
        )  # fmt: skip
    assert done.returncode == 3, done.stderr
    assert "standard output" in done.stderr and "No space left" in done.stderr
