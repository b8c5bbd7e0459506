"""`conetl inspect`: damaged drives and exit codes."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from conetl.cli import main
from conetl.cli.inspect_drive import CPU_S_PER_MEGAPIXEL, START_CPU_S
from conetl.model.rig import Rig
from conetl.pipeline.settings import read_settings
from conetl.readers.drives import read_drive
from tests.mutants.images import changed as images_changed
from tests.mutants.images import copy_drive, only_right, shifted, smeared
from tests.unit.readers.drive_formats import SAMPLE, WRITERS, Frame, changed, sample_frames, write_euroc, write_kitti


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    return sample_frames()


@pytest.fixture(scope="module")
def rig() -> Rig:
    return read_drive(SAMPLE)[0].rig


def run(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> tuple[int, str, str]:
    with pytest.MonkeyPatch.context() as patch, pytest.raises(SystemExit) as stopped:
        patch.setattr(sys, "argv", ["conetl", *arguments])
        main()
    text = capsys.readouterr()
    return int(stopped.value.code or 0), text.out, text.err


def test_inspect_shows_what_is_lost(
    tmp_path: Path, frames: list[Frame], rig: Rig, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CONETL_HOME", str(tmp_path / "home"))
    damaged = changed(frames, 4, left=(frames[4].left or b"")[:-500])
    path = WRITERS["mcap file"](tmp_path / "run", damaged, rig)
    page = tmp_path / "shown" / "drive.html"
    code, text, _ = run(["inspect", str(path), "--json", "--page", str(page)], capsys)
    found = json.loads(text)
    assert code == 0
    assert (found["format"], found["usable_pairs"], found["expected_pairs"]) == ("bag", 9, 10)
    assert found["lost_by_reason"] == {"image_truncated": 1}
    megapixels = 9 * 2 * rig.left.width_px * rig.left.height_px / 1e6  # of both images
    seconds = START_CPU_S + CPU_S_PER_MEGAPIXEL * megapixels / read_settings().workers
    assert found["estimated_seconds"] == pytest.approx(seconds, abs=0.1)
    assert found["page"] == str(page) and "data:image/png" in page.read_text()
    code, _, said = run(["inspect", str(path), "--image", str(tmp_path / "drive.png")], capsys)
    assert code == 2 and "--page" in said
    damaged = changed(changed(damaged, 2, right=None), 3, right=None)
    page = tmp_path / "page.html"
    code, text, _ = run(["inspect", str(write_kitti(tmp_path / "kitti", damaged, rig)), "--page", str(page)], capsys)
    shown = page.read_text()
    assert "3 of 10 frame pairs cannot be used" in shown and "there is no right image" in shown
    assert "rows of the right images" in shown and "data:image/png" in shown
    assert code == 1  # 3 of 10 are more than a tenth
    assert "KITTI raw layout" in text
    assert "7 of 10 usable, 3 lost" in text
    assert "there is no right image" in text
    code, text, _ = run(["inspect", str(SAMPLE)], capsys)
    assert code == 0
    checks = [line.split("  ") for line in text.splitlines() if line.rstrip().endswith(" pass")]
    assert [line[0] for line in checks] == [
        "covered parts of the lenses", "blurred parts of the lenses", "trigger of both cameras", "seams in the images",
        "columns of the right images", "distortion of the lenses", "rows of the right images",
    ]  # fmt: skip
    assert "+- 0.30 px (limit 4)" in text


def test_inspect_exits_with_2_for_what_cannot_be_ingested(
    tmp_path: Path, frames: list[Frame], rig: Rig, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CONETL_HOME", str(tmp_path / "home"))
    path = write_euroc(tmp_path / "run", frames, rig)
    (path / "drive.yaml").unlink()
    code, text, complaint = run(["inspect", str(path)], capsys)
    assert (code, text) == (2, "")
    assert "georeference" in complaint
    assert run(["inspect", str(tmp_path / "nothing")], capsys)[0] == 2


def test_inspect_compares_the_images_of_each_pair(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    drive = copy_drive(SAMPLE, tmp_path / "rows")
    images_changed(only_right(shifted(3, 0)))(drive)
    code, text, _ = run(["inspect", str(drive), "--json"], capsys)
    rows = {check["name"]: check for check in json.loads(text)["health"]}["rows of the right images"]
    assert (code, rows["verdict"]) == (0, "corrected")
    assert rows["value"] == pytest.approx(3.0, abs=0.5)


def test_inspect_exits_with_1_for_a_smeared_lens(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    drive = copy_drive(SAMPLE, tmp_path / "smeared")
    images_changed(only_right(smeared(7.0)))(drive)
    code, text, _ = run(["inspect", str(drive)], capsys)
    assert code == 1
    assert "Note, blurred parts of the lenses: " in text and "Clean the lens." in text
