"""The command line as a whole: help without imports, version, log, completion, unusable home folders."""

from __future__ import annotations

import logging
import re
import shlex
import subprocess
import sys
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from typer.main import get_command
from typer.testing import CliRunner

from conetl.cli.app import _COMMANDS, _GROUPS, app
from conetl.cli.ingest import ingest_drives
from conetl.cli.map.exchange import _format_by_name
from conetl.cli.services import _environment
from conetl.model.errors import InputError
from conetl.model.ingest_report import NeedsAttentionError
from conetl.model.params import IngestParams
from conetl.pipeline.settings import Settings
from tests.integration.small_drives import SAMPLES

COMMANDS = {(name,): found for panel in _COMMANDS.values() for name, found in panel.items()}
COMMANDS |= {(*group.split(), name): found for group, (_, some) in _GROUPS.items() for name, found in some.items()}


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_every_command_has_help_and_is_listed_with_its_first_paragraph(words: tuple[str, ...]) -> None:
    group = get_command(app)
    for word in words[:-1]:
        group = group.get_command(None, word)  # type: ignore[attr-defined, assignment]
    loaded = group.get_command(None, words[-1])  # type: ignore[attr-defined]
    group.listing = True  # type: ignore[attr-defined]
    listed = group.get_command(None, words[-1])  # type: ignore[attr-defined]
    assert loaded.name == listed.name == words[-1]
    assert listed.help and loaded.help.startswith(" ".join(listed.help.split()))
    assert not re.search(r"\[[a-z]", loaded.help), "Rich takes [words] for its markup"


@pytest.mark.parametrize("words", [words for words, found in COMMANDS.items() if found], ids=" ".join)
def test_every_command_has_examples_that_are_valid(words: tuple[str, ...]) -> None:
    group = get_command(app)
    for word in words[:-1]:
        group = group.get_command(None, word)  # type: ignore[attr-defined, assignment]
    command = group.get_command(None, words[-1])  # type: ignore[attr-defined]
    for example in COMMANDS[words][1:]:
        assert f"conetl {' '.join(words)} {example}".strip() in command.epilog
        assert command.make_context(words[-1], shlex.split(example))


def test_reading_a_map_in_a_folder_without_one_makes_no_database(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("CONETL_HOME", "CONETL_DATABASE_URL"):
        monkeypatch.delenv(name, raising=False)
    for command in (
        "map show", "map show --provisional", "map list", "map export --out cones.gpkg", "report night", "report quality",
        "view", "db audit",
        "db prune --keep-positions 90d", "db archive --keep-positions 90d",
    ):  # fmt: skip
        done = CliRunner().invoke(app, command.split())
        assert isinstance(done.exception, InputError), (command, done)
        assert f"{tmp_path / '.conetl'}: contains no maps" in str(done.exception)
        assert "a new map begins with `conetl ingest DRIVE`" in str(done.exception)
    assert not list(tmp_path.iterdir())


def test_help_and_completion_import_no_command() -> None:
    code = (
        "import sys\nfrom conetl.cli.app import app\nfrom typer.testing import CliRunner\n"
        "done = CliRunner().invoke(app, ['-h'])\nassert 'ingest' in done.output and not done.exit_code, done.output\n"
        "words = {'_CONETL_COMPLETE': 'complete_bash', 'COMP_WORDS': 'conetl b', 'COMP_CWORD': '1'}\n"
        "done = CliRunner().invoke(app, [], env=words, prog_name='conetl')\n"
        "assert done.output.split() == ['backfill', 'base'], done.output\n"
        "assert not {'numpy', 'psycopg2', 'conetl.cli.ingest'} & set(sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_version() -> None:
    assert CliRunner().invoke(app, ["--version"]).output.startswith("conetl 0.")


def test_the_log_is_silent_unless_verbose(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CONETL_HOME", str(tmp_path))
    for option, level in ((["-vv"], logging.DEBUG), (["-v"], logging.INFO), ([], logging.WARNING)):
        CliRunner().invoke(app, [*option, "down"])
        assert logging.getLogger("conetl").getEffectiveLevel() == level


def test_status_of_an_empty_home_says_what_to_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CONETL_HOME", str(tmp_path))
    monkeypatch.delenv("CONETL_DATABASE_URL", raising=False)
    done = CliRunner().invoke(app, ["status"])
    assert done.exit_code == 3
    assert "No services are running" in done.output
    assert str(tmp_path) in done.output.replace("\n", "")


@pytest.mark.parametrize("command", ["status", "up"])
def test_a_home_that_is_a_file_is_reported(command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    home = tmp_path / "file"
    home.touch()
    monkeypatch.setenv("CONETL_HOME", str(home))
    monkeypatch.delenv("CONETL_DATABASE_URL", raising=False)
    done = CliRunner().invoke(app, [command])
    assert isinstance(done.exception, InputError)
    assert str(home) in str(done.exception) and "CONETL_HOME" in str(done.exception)


def test_the_suffix_selects_the_format_of_an_export() -> None:
    formats = {
        "cones.geojson": "geojson", "cones.json": "geojson", "cones": "geojson", "cones.csv": "csv", "cones.GPKG": "gpkg",
        "cones.parquet": "geoparquet", "cones.fgb": "flatgeobuf", "cones.mcap": "mcap", "cones.osm": "lanelet2",
    }  # fmt: skip
    assert {name: _format_by_name(Path(name)) for name in formats} == formats
    with pytest.raises(InputError, match=r"cones\.shp: .*--format \(geojson, csv"):
        _format_by_name(Path("cones.shp"))


@pytest.mark.parametrize(("cores", "workers", "each"), [(8, 3, "2"), (2, 4, "1")])
def test_workers_share_the_cores(
    cores: int, workers: int, each: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("CONETL_WORKERS", raising=False)
    found = _environment(Settings(workers=cores), tmp_path, "http://host/api", "login", "http://view", workers)
    assert found["CONETL_WORKERS"] == each


REPORT: Any = SimpleNamespace(remarks=[])
OUTCOMES = {"fine": None, "held": NeedsAttentionError(REPORT, "on hold"), "bad": InputError("bad")}


@pytest.mark.parametrize(
    ("outcomes", "code"), [("fine", 0), ("held fine", 1), ("bad fine", 2), ("held bad", 2), ("bad held", 2)]
)
def test_the_exit_code_of_several_drives_is_the_worst_in_any_order(
    outcomes: str, code: int, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Of drives whose ingest is made up."""
    ends = iter(outcomes.split())

    def ingested(*_: object, **__: object) -> Any:
        if error := OUTCOMES[next(ends)]:
            raise error
        return REPORT

    monkeypatch.setattr("flows.ingest_drive.ingest_here", ingested)
    monkeypatch.setattr("flows.server.prefect_server", nullcontext)
    monkeypatch.setattr("conetl.cli.ingest.prefect_environment", lambda _: {})
    drives = SAMPLES[: len(outcomes.split())]
    found = ingest_drives(drives, Settings(home=tmp_path), IngestParams(), map_srid=None, show=lambda _: None)
    assert (len(found[0]), found[1]) == (len(drives) - outcomes.count("bad"), code)
