"""`conetl detect`, `evaluate` and `calibrate`: tools without database and server, on real images."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest
import typer
from typer.testing import CliRunner, Result

from conetl.cli.app import app
from conetl.cli.tools.calibrate import calibrate
from conetl.evaluation.markings import TRUTH_FILE
from conetl.model.errors import InputError
from conetl.readers.rigs import read_rig
from tests.integration.conftest import command_line
from tests.integration.small_drives import SAMPLES, cut_drive


@pytest.fixture
def detect(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., str]:
    """`conetl detect --json` in a folder of the test's own."""
    monkeypatch.chdir(tmp_path)
    return partial(command_line(tmp_path / "home", ""), "detect", "--json")


@pytest.fixture
def small_image(tmp_path: Path) -> Path:
    path = tmp_path / "in" / "small.png"
    path.parent.mkdir()
    cv2.imwrite(str(path), np.full((64, 96, 3), 120, np.uint8))
    return path


def test_boxes_and_annotated_copies_are_written_into_new_folders(detect: Callable[..., str], tmp_path: Path) -> None:
    pair = [SAMPLE / side / "data" / "0000000010.jpg" for side in ("image_02", "image_03")]
    detect(*pair, "--out", tmp_path / "new" / "found.json", "--draw", tmp_path / "drawn" / "deep")
    found = json.loads((tmp_path / "new" / "found.json").read_text())
    assert set(found[0]) == {"file_name", "category", "bbox", "score", "probability", "foot", "tip"}
    drawn = list((tmp_path / "drawn" / "deep").glob("*.jpg"))
    assert len(drawn) == 2, "of equal name, from two folders"
    assert [cv2.imread(str(path)).shape for path in drawn] == [cv2.imread(str(path)).shape for path in pair]
    detect(tmp_path / "nothing", code=2)


@pytest.mark.parametrize("option", ["--out", "--draw"])
def test_a_path_that_cannot_be_written_is_bad_input(
    detect: Callable[..., str], tmp_path: Path, small_image: Path, option: str
) -> None:
    (tmp_path / "file").write_text("taken")
    assert "cannot be written" in detect(small_image, option, tmp_path / "file" / "below", code=2)
    assert not (tmp_path / "detections.json").exists()


def test_one_unreadable_image_costs_only_itself(small_image: Path, tmp_path: Path) -> None:
    (small_image.parent / "broken.jpg").write_bytes(b"\xff\xd8\xff\xe0 no image")
    arguments = ["detect", str(small_image.parent), "--out", str(tmp_path / "found.json"), "--json"]
    done = CliRunner().invoke(app, arguments, env={"CONETL_HOME": str(tmp_path / "home")})
    assert done.exit_code == 1 and "broken.jpg" in done.stderr
    result = json.loads(done.stdout)
    assert result["images"] == 2
    assert [Path(name).name for name in result["refused"]] == ["broken.jpg"]


def test_nothing_is_written_where_no_image_can_be_read(detect: Callable[..., str], tmp_path: Path) -> None:
    (tmp_path / "broken.png").write_bytes(b"\x89PNG no image")
    detect(tmp_path / "broken.png", "--out", tmp_path / "found.json", code=2)
    assert not (tmp_path / "found.json").exists()


SAMPLE = SAMPLES[0]
FRAMES = range(8, 22)


def piece(folder: Path, frames: range) -> Path:
    """Some frame pairs of the sample drive, and its truth."""
    shutil.copy(SAMPLE / "truth.csv", cut_drive(SAMPLE, folder, frames=frames))
    return folder


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """14 frame pairs past the first cones."""
    return piece(tmp_path_factory.mktemp("drives") / "piece", FRAMES)


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("home")


def evaluate(drive: Path, truth: Path, home: Path, *options: str) -> Result:
    return evaluate_all([drive], home, "--truth", str(truth), *options)


def evaluate_all(drives: list[Path], home: Path, *options: str) -> Result:
    return CliRunner().invoke(app, ["evaluate", *map(str, drives), *options], env={"CONETL_HOME": str(home)})


def test_figures_plots_and_page(drive: Path, home: Path, tmp_path: Path) -> None:
    done = evaluate(drive, SAMPLE / "truth.csv", home, "--out", str(tmp_path / "out"), "--within-m", "8", "--json")
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    rows = [line.split(",") for line in (SAMPLE / "truth.csv").read_text().splitlines()[1:]]
    truth = {row[0]: [float(value) for value in row[1:4]] for row in rows}
    seen = [cone for cone in found["cones"] if cone["xyz_m"] is not None]
    assert len(seen) >= 3
    for cone in seen:
        error_m = np.linalg.norm(np.subtract(cone["xyz_m"], truth[cone["cone_id"]]))
        assert error_m == pytest.approx(cone["error_3d_m"], abs=1e-9) and error_m < 0.15
    assert sorted(found["missed"]) == sorted(c["cone_id"] for c in found["cones"] if c["xyz_m"] is None)
    assert found["errors"]["single positions"]["count"] >= 3 * len(seen)
    assert sum(band["errors"]["count"] for band in found["by_range"]) == found["errors"]["single positions"]["count"]
    assert sum(found["nees"]["tracks"][part]["dof"] for part in ("relative", "common")) == 3 * len(seen)
    for name in ("errors_over_range.png", "plan.png", "nees.png"):
        data = (tmp_path / "out" / name).read_bytes()
        assert data.startswith(b"\x89PNG") and len(data) > 10_000
    page = (tmp_path / "out" / "index.html").read_text()
    assert page.count('src="data:image/png;base64,') == 3 and "://" not in page
    assert not (home / "postgres").exists()


@pytest.mark.release
def test_cones_outside_of_a_partial_survey_are_not_false(drive: Path, home: Path, tmp_path: Path) -> None:
    surveyed = tmp_path / "truth.csv"
    surveyed.write_text("\n".join((SAMPLE / "truth.csv").read_text().splitlines()[:3]) + "\n")
    whole = json.loads(evaluate(drive, SAMPLE / "truth.csv", home, "--out", str(tmp_path / "out"), "--json").stdout)
    found = json.loads(evaluate(drive, surveyed, home, "--out", str(tmp_path / "out"), "--json").stdout)
    near = [one["xyz_m"] for one in whole["cones"] if one["xyz_m"]]
    assert whole["not_judged_tracks"] == [] and found["false_tracks"] == []
    assert len(found["not_judged_tracks"]) >= 2 and all(one["xyz_m"] in near for one in found["not_judged_tracks"])
    said = f"0 false ones, {len(found['not_judged_tracks'])} outside of the surveyed area and not judged"
    assert said in (tmp_path / "out" / "index.html").read_text()


@pytest.mark.release
def test_two_drives_are_judged_together(drive: Path, home: Path, tmp_path: Path) -> None:
    """Each by its own truth.csv; the second are six frame pairs of the same road."""
    second = piece(tmp_path / "second", range(22, 28))
    done = evaluate_all([drive, second], home, "--out", str(tmp_path / "out"), "--within-m", "8", "--json")
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    assert [one["drive_id"] for one in found["drives"]] == ["piece", "second"]
    for kind in ("tracks", "single positions"):
        assert found["pooled"]["errors"][kind]["count"] == sum(d["errors"][kind]["count"] for d in found["drives"])
        for part in ("relative", "common", "absolute"):
            single = [d["nees"][kind][part] for d in found["drives"]]
            together = found["pooled"]["nees"][kind][part]
            assert together["dof"] == sum(one["dof"] for one in single if one)
            assert together["value"] == pytest.approx(sum(one["value"] for one in single if one))
    for file in ("piece/index.html", "second/plan.png"):
        assert (tmp_path / "out" / file).is_file()
    assert "2 drives compared with ground truth" in (tmp_path / "out" / "index.html").read_text()


def test_lane_markings_are_evaluated_alone(drive: Path, home: Path, tmp_path: Path) -> None:
    """Without surveyed objects, by one drive and by two; the figures are those of the tables."""
    first, second = (shutil.copytree(drive, tmp_path / name) for name in ("first", "second"))
    for folder in (first, second):
        shutil.copy(SAMPLE / TRUTH_FILE, folder)
    only = ("--category", "lane_marking")
    refused = evaluate_all([drive], home, *only).exception
    assert isinstance(refused, InputError) and f"contains no {TRUTH_FILE}" in str(refused)
    assert "omit it" in str(evaluate(drive, SAMPLE / "truth.csv", home, *only).exception)
    done = evaluate_all([first], home, *only, "--out", str(tmp_path / "one"), "--json")
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    assert found["cones"] == [] and found["files"] == [str(tmp_path / "one" / "index.html")]
    assert found["lane_markings"]["completeness"] > 0.5 and found["lane_markings"]["lateral_median_m"] < 0.05
    done = evaluate_all([first, second], home, *only, "--out", str(tmp_path / "two"))
    assert done.exit_code == 0, done.output
    assert "Lane markings, drive by drive" in done.output and "cones" not in done.output
    page = (tmp_path / "two" / "index.html").read_text()
    assert "Lane markings, drive by drive" in page and "cones found" not in page


def test_a_drive_without_truth_or_given_twice_is_refused(drive: Path, home: Path, tmp_path: Path) -> None:
    """Before anything is computed, also of the drives that are fine."""
    (tmp_path / "bare").mkdir()
    for drives, words in (([drive, tmp_path / "bare"], "contains no truth.csv"), ([drive, drive], "given twice")):
        refused = evaluate_all(drives, home).exception
        assert isinstance(refused, InputError) and words in str(refused)


def test_the_table_for_a_person(drive: Path, home: Path, tmp_path: Path) -> None:
    """The second run uses cached results."""
    done = evaluate(drive, SAMPLE / "truth.csv", home, "--out", str(tmp_path), "--within-m", "8")
    assert done.exit_code == 0, done.output
    for words in ("difference", "single positions, relative", "CE90", "index.html"):
        assert words in done.output


def test_truth_of_another_drive_without_cones_or_with_two_systems_is_refused(
    drive: Path, home: Path, tmp_path: Path
) -> None:
    rows = (SAMPLE / "truth.csv").read_text().replace(",4583", ",4683")
    (tmp_path / "truth.csv").write_text(rows)
    assert "another drive" in str(evaluate(drive, tmp_path / "truth.csv", home).exception)
    rows = (SAMPLE / "truth.csv").read_text().splitlines()
    (tmp_path / "truth.csv").write_text(rows[0] + "\n")
    assert "no cone is present" in str(evaluate(drive, tmp_path / "truth.csv", home).exception)
    (tmp_path / "truth.csv").write_text("\n".join([*rows[:2], rows[2].replace("32632", "32633")]) + "\n")
    assert "32632, 32633" in str(evaluate(drive, tmp_path / "truth.csv", home).exception)
    drums = str(evaluate(drive, SAMPLE / "truth.csv", home, "--category", "drum").exception)
    assert "contains no drum, only traffic_cone" in drums
    assert "no such drive folder" in str(evaluate(tmp_path / "none", SAMPLE / "truth.csv", home).exception)


SHARED = Path(os.environ.get("CONETL_SHARED_DATA", Path(__file__).parents[3] / "shared" / "data"))
IMAGES = SHARED / "feb_stereo_chessboard" / "pairs"
BOARD = "chessboard:9x6:37.8mm"
real = pytest.mark.skipif(not IMAGES.is_dir(), reason=f"no chessboard images at {IMAGES}")

calibrate_app = typer.Typer()
calibrate_app.command()(calibrate)


def _board_folder(path: Path, pairs: list[int], *, swapped: bool = False) -> Path:
    for place, pair in enumerate(pairs):
        for number, side in zip(
            (2 * pair, 2 * pair + 1), ("right", "left") if swapped else ("left", "right"), strict=True
        ):
            (path / side).mkdir(parents=True, exist_ok=True)
            (path / side / f"{place:02d}.jpg").symlink_to(IMAGES / f"pic{number:05d}.jpg")
    return path


def _calibrate(*words: object) -> str:
    result = CliRunner().invoke(calibrate_app, [str(word) for word in words], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.stdout


@real
def test_real_chessboards_give_a_rig_with_its_covariance(tmp_path: Path) -> None:
    folder = _board_folder(tmp_path / "images", list(range(4, 36, 3)))
    out, report = tmp_path / "rig.yaml", tmp_path / "report"
    words = ("--lens", "brown", "--sensor-mm", "23.5x15.6", "--out", out, "--report", report, "--json")
    content = json.loads(_calibrate(folder, "--board", BOARD, *words))
    assert content["pairs_used"] >= 10 and not content["constancy_checked"]
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
@pytest.mark.parametrize(
    ("pairs", "swapped", "board", "message"),
    [
        ([5, 10, 15, 20, 25], True, BOARD, "swapped"),
        ([5, 30], False, "chessboard:8x5:37.8mm", "9 x 6 inner corners instead of 8 x 5: check the size of the board"),
        ([30] * 6, False, BOARD, "too few or too similar positions"),
    ],
)
def test_images_that_cannot_calibrate_say_why(
    tmp_path: Path, pairs: list[int], swapped: bool, board: str, message: str
) -> None:
    folder = _board_folder(tmp_path, pairs, swapped=swapped)
    with pytest.raises(InputError, match=message):
        _calibrate(
            folder, "--board", board, "--lens", "radial", "--board-shape", "flat", "--out", tmp_path / "rig.yaml"
        )
    assert not (tmp_path / "rig.yaml").exists()


def test_what_cannot_be_meant_is_refused(tmp_path: Path) -> None:
    (tmp_path / "left").mkdir()
    for words, message in (
        ((tmp_path / "x",), "no such folder"),
        ((tmp_path,), "left/ and right/"),
        ((tmp_path, "--left-pattern", "l*.png"), "must be used together"),
        ((tmp_path, "--sensor-mm", "24"), "width x height"),
        ((tmp_path, "--pairing", "even-odd"), "no pair"),
    ):
        with pytest.raises(InputError, match=message):
            _calibrate(*words, "--board", BOARD)
