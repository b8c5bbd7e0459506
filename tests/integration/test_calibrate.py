"""`conetl calibrate` on real chessboard images, where they are at hand (`../shared/data`, or `$CONETL_SHARED_DATA`)."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from conetl.cli.tools.calibrate import calibrate
from conetl.model.errors import CalibrationError, InputError
from conetl.readers.rigs import read_rig

SHARED = Path(os.environ.get("CONETL_SHARED_DATA", Path(__file__).parents[3] / "shared" / "data"))
IMAGES = SHARED / "feb_stereo_chessboard" / "pairs"
BOARD = "chessboard:9x6:37.8mm"
real = pytest.mark.skipif(not IMAGES.is_dir(), reason=f"no chessboard images at {IMAGES}")

app = typer.Typer()
app.command()(calibrate)


def _folder(path: Path, pairs: list[int], *, swapped: bool = False) -> Path:
    for pair in pairs:
        for number, side in zip(
            (2 * pair, 2 * pair + 1), ("right", "left") if swapped else ("left", "right"), strict=True
        ):
            (path / side).mkdir(parents=True, exist_ok=True)
            (path / side / f"{pair:02d}.jpg").symlink_to(IMAGES / f"pic{number:05d}.jpg")
    return path


def _run(*words: object) -> str:
    result = CliRunner().invoke(app, [str(word) for word in words], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.stdout


@real
def test_real_chessboards_give_a_rig_with_its_covariance(tmp_path: Path) -> None:
    folder = _folder(tmp_path / "images", list(range(4, 36, 3)))
    out, report = tmp_path / "rig.yaml", tmp_path / "report"
    words = (
        "--board",
        BOARD,
        "--lens",
        "brown",
        "--sensor-mm",
        "23.5x15.6",
        "--out",
        out,
        "--report",
        report,
        "--json",
    )
    content = json.loads(_run(folder, *words))
    assert content["pairs_used"] >= 10
    assert content["board_shape"] == "free"  # the board in these images is bent by 2 mm
    assert content["rms_px"]["stereo"] < 0.12
    base = next(row for row in content["relative"] if row["name"] == "base")
    assert abs(base["value"] - 279.3) < 4 * base["sigma"] < 6.0
    assert json.loads((report / "report.json").read_text())["interior_mm"]["left"][0]["unit"] == "mm"
    assert (report / "coverage.png").read_bytes().startswith(b"\x89PNG")
    rig = read_rig(out)
    assert rig.left.lens.model == "brown"
    assert rig.calibration_covariance is not None and len(rig.calibration_covariance.names) == 24
    assert rig.baseline_m * 1000 == pytest.approx(base["value"])


@real
def test_swapped_cameras_are_told(tmp_path: Path) -> None:
    folder = _folder(tmp_path, [5, 10, 15, 20, 25], swapped=True)
    with pytest.raises(CalibrationError, match="swapped"):
        _run(folder, "--board", BOARD, "--lens", "radial", "--board-shape", "flat", "--out", tmp_path / "rig.yaml")
    assert not (tmp_path / "rig.yaml").exists()


@real
def test_a_board_of_another_size_is_told(tmp_path: Path) -> None:
    folder = _folder(tmp_path, [5])
    with pytest.raises(CalibrationError, match=r"none of the images.*9 x 6 inner corners instead of 8 x 6"):
        _run(folder, "--board", "chessboard:8x6:37.8mm", "--out", tmp_path / "rig.yaml")


@real
def test_two_pairs_are_too_few(tmp_path: Path) -> None:
    folder = _folder(tmp_path, [5, 20])
    with pytest.raises(CalibrationError, match="at least 3 are needed"):
        _run(folder, "--board", BOARD, "--out", tmp_path / "rig.yaml")


def test_what_cannot_be_meant_is_refused(tmp_path: Path) -> None:
    (tmp_path / "left").mkdir()
    for words, message in (
        ((tmp_path / "x",), "no such folder"),
        ((tmp_path,), "left/ and right/"),
        ((tmp_path, "--left-pattern", "l*.png"), "require each other"),
        ((tmp_path, "--sensor-mm", "24"), "width x height"),
        ((tmp_path, "--pairing", "even-odd"), "no pair"),
    ):
        with pytest.raises(InputError, match=message):
            _run(*words, "--board", BOARD)
