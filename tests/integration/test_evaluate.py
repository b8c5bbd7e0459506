"""`conetl evaluate` on a part of a sample drive, without database and server."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from conetl.cli.app import app
from conetl.model.errors import InputError

SAMPLE = Path(__file__).resolve().parents[2] / "data" / "drives" / "2026-03-02_taper_pass1"
FRAMES = range(8, 22)


def piece(folder: Path, frames: range) -> Path:
    """Some frame pairs of the sample drive, and its truth."""
    folder.mkdir()
    for file in (*SAMPLE.glob("*.txt"), SAMPLE / "truth.csv"):
        shutil.copy(file, folder)
    for part, suffix in (("image_02", "jpg"), ("image_03", "jpg"), ("oxts", "txt")):
        (folder / part / "data").mkdir(parents=True)
        stamps = (SAMPLE / part / "timestamps.txt").read_text().splitlines()
        (folder / part / "timestamps.txt").write_text("".join(f"{stamps[k]}\n" for k in frames))
        for new, old in enumerate(frames):
            shutil.copy(
                SAMPLE / part / "data" / f"{old:010d}.{suffix}", folder / part / "data" / f"{new:010d}.{suffix}"
            )
    return folder


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """14 frame pairs past the first cones."""
    return piece(tmp_path_factory.mktemp("drives") / "piece", FRAMES)


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("home")


def run(drive: Path, truth: Path, home: Path, *options: str) -> Result:
    return run_all([drive], home, "--truth", str(truth), *options)


def run_all(drives: list[Path], home: Path, *options: str) -> Result:
    return CliRunner().invoke(app, ["evaluate", *map(str, drives), *options], env={"CONETL_HOME": str(home)})


def test_figures_plots_and_page(drive: Path, home: Path, tmp_path: Path) -> None:
    done = run(drive, SAMPLE / "truth.csv", home, "--out", str(tmp_path / "out"), "--within-m", "8", "--json")
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
    assert found["nees"]["tracks"]["relative"]["dof"] == 3 * len(seen) - 6
    for name in ("errors_over_range.png", "plan.png", "nees.png"):
        data = (tmp_path / "out" / name).read_bytes()
        assert data.startswith(b"\x89PNG") and len(data) > 10_000
    page = (tmp_path / "out" / "index.html").read_text()
    assert page.count('src="data:image/png;base64,') == 3 and "://" not in page
    assert not (home / "postgres").exists()


def test_two_drives_are_judged_together(drive: Path, home: Path, tmp_path: Path) -> None:
    """Each by its own truth.csv; the second are six frame pairs of the same road."""
    second = piece(tmp_path / "second", range(22, 28))
    done = run_all([drive, second], home, "--out", str(tmp_path / "out"), "--within-m", "8", "--json")
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
    assert "2 drives against truth" in (tmp_path / "out" / "index.html").read_text()


def test_a_drive_without_truth_or_given_twice_is_refused(drive: Path, home: Path, tmp_path: Path) -> None:
    """Before anything is computed, also of the drives that are fine."""
    (tmp_path / "bare").mkdir()
    for drives, words in (([drive, tmp_path / "bare"], "has no truth.csv"), ([drive, drive], "given twice")):
        refused = run_all(drives, home).exception
        assert isinstance(refused, InputError) and words in str(refused)


def test_the_table_for_a_person(drive: Path, home: Path, tmp_path: Path) -> None:
    """The second run uses cached results."""
    done = run(drive, SAMPLE / "truth.csv", home, "--out", str(tmp_path), "--within-m", "8")
    assert done.exit_code == 0, done.output
    for words in ("difference", "single positions, relative", "CE90", "index.html"):
        assert words in done.output


def test_truth_of_another_drive_without_cones_or_with_two_systems_is_refused(
    drive: Path, home: Path, tmp_path: Path
) -> None:
    rows = (SAMPLE / "truth.csv").read_text().replace(",4583", ",4683")
    (tmp_path / "truth.csv").write_text(rows)
    assert "another drive" in str(run(drive, tmp_path / "truth.csv", home).exception)
    rows = (SAMPLE / "truth.csv").read_text().splitlines()
    (tmp_path / "truth.csv").write_text(rows[0] + "\n")
    assert "no cone is present" in str(run(drive, tmp_path / "truth.csv", home).exception)
    (tmp_path / "truth.csv").write_text("\n".join([*rows[:2], rows[2].replace("32632", "32633")]) + "\n")
    assert "32632, 32633" in str(run(drive, tmp_path / "truth.csv", home).exception)
    assert "no such drive folder" in str(run(tmp_path / "none", SAMPLE / "truth.csv", home).exception)
