"""Drive folders at a glance: what is known of them without opening a picture."""

from __future__ import annotations

import errno
import os
import shutil
import time
from pathlib import Path
from typing import Any

import pytest

from conetl.errors import DriveFolderError
from conetl.io.drive_folder import read_drive
from conetl.io.drive_folder.outline import find_drives, outline_drive, quiet_since

SAMPLES = Path(__file__).resolve().parents[3] / "data" / "drives"


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    return Path(shutil.copytree(next(SAMPLES.iterdir()), tmp_path / "archive" / "drive"))


def test_a_moment_of_bad_storage_is_no_property_of_the_drive(drive: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    good = outline_drive(drive)
    read = Path.read_text

    def stale(path: Path, *arguments: Any, **options: Any) -> str:
        if path.name.startswith("calib"):
            raise OSError(errno.ESTALE, "Stale file handle", str(path))
        return read(path, *arguments, **options)

    with monkeypatch.context() as failing:
        failing.setattr(Path, "read_text", stale)
        bad = outline_drive(drive)
    assert bad.problem is not None
    assert "Stale file handle" in bad.problem
    assert bad.problem_may_pass
    assert not good.problem_may_pass
    (drive / "calib_cam_to_cam.txt").write_text("")
    assert not outline_drive(drive).problem_may_pass


def test_an_outline_agrees_with_the_whole_reading(drive: Path) -> None:
    outline = outline_drive(drive)
    whole, _ = read_drive(drive)
    assert outline.problem is None
    assert outline.drive_id == whole.drive_id
    assert outline.frame_pairs == len(whole.frame_pairs)
    assert outline.captured_from == whole.captured_from
    assert outline.captured_to_ns == whole.frame_pairs[-1].captured_at_ns


def test_the_header_goes_with_the_drive_and_not_with_its_place(drive: Path, tmp_path: Path) -> None:
    moved = Path(shutil.copytree(drive, tmp_path / "elsewhere" / "drive"))
    assert outline_drive(moved).header_sha256 == outline_drive(drive).header_sha256


@pytest.mark.parametrize("change", ["a picture more", "another size", "another time", "another calibration"])
def test_another_delivery_is_another_drive(drive: Path, change: str) -> None:
    before = outline_drive(drive).header_sha256
    picture = drive / "image_02" / "data" / "0000000000.jpg"
    if change == "a picture more":
        shutil.copy(picture, picture.with_name("0000009999.jpg"))
    elif change == "another size":
        picture.write_bytes(picture.read_bytes() + b"\0")
    else:
        name = "image_02/timestamps.txt" if change == "another time" else "calib_cam_to_cam.txt"
        (drive / name).write_text((drive / name).read_text().replace("9", "8"))
    assert outline_drive(drive).header_sha256 != before


@pytest.mark.parametrize("missing", ["image_03", "image_02/timestamps.txt"])
def test_what_is_missing_is_said_and_nothing_raised(drive: Path, missing: str) -> None:
    path = drive / missing
    shutil.rmtree(path) if path.is_dir() else path.unlink()
    problem = outline_drive(drive).problem
    assert problem is not None
    assert missing in problem


def test_a_calibration_that_cannot_be_used_is_said_too(drive: Path) -> None:
    calibration = drive / "calib_cam_to_cam.txt"
    whole = calibration.read_text()
    calibration.write_text("\n".join(line for line in whole.splitlines() if not line.startswith("P_rect_03")))
    spoilt = outline_drive(drive)
    assert spoilt.problem is not None
    assert "P_rect_03" in spoilt.problem
    assert spoilt.captured_from is not None
    calibration.unlink()
    missing = outline_drive(drive)
    assert "calib_cam_to_cam.txt" in (missing.problem or "")
    (drive / "drive.yaml").write_text("calibration: named/calib_cam_to_cam.txt\n")
    (drive / "named").mkdir()
    for name in ("calib_velo_to_cam.txt", "calib_imu_to_velo.txt"):
        (drive / name).rename(drive / "named" / name)
    before = outline_drive(drive)
    (drive / "named" / "calib_cam_to_cam.txt").write_text(whole)
    delivered = outline_drive(drive)
    assert delivered.problem is None
    # What was refused under one header must not stay refused once the file is there.
    assert delivered.header_sha256 not in (before.header_sha256, missing.header_sha256)


def test_drives_are_found_in_folders_by_day(drive: Path, tmp_path: Path) -> None:
    shutil.copytree(drive, tmp_path / "archive" / "2026" / "03" / "another")
    shutil.copytree(drive, tmp_path / "archive" / ".arriving" / "hidden")
    (tmp_path / "archive" / "notes").mkdir()
    found = [path.name for path in find_drives(tmp_path / "archive")]
    assert sorted(found) == ["another", "drive"]
    assert list(find_drives(drive)) == [drive]
    with pytest.raises(DriveFolderError, match="no such folder"):
        list(find_drives(tmp_path / "nowhere"))


def test_a_linked_drive_is_the_drive_that_the_link_leads_to(
    drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whichever way leads to it: plan, job and reader must mean one drive, else it is ingested again and again."""
    direct = outline_drive(drive)
    (tmp_path / "links").mkdir()
    link = tmp_path / "links" / "another-name"
    link.symlink_to(drive)
    monkeypatch.chdir(drive)
    for way in (link, Path(), Path("../drive")):
        outline = outline_drive(way)
        assert (outline.drive_id, outline.header_sha256) == (direct.drive_id, direct.header_sha256)
        assert read_drive(way, headers_only=True)[0].drive_id == direct.drive_id


def test_a_calibration_beside_the_link_is_found_by_plan_and_reader(drive: Path, tmp_path: Path) -> None:
    day = tmp_path / "day"
    day.mkdir()
    for path in drive.glob("calib*.txt"):
        path.rename(day / path.name)
    (day / "linked").symlink_to(drive)
    assert outline_drive(drive).problem is not None
    for [found] in (find_drives(day), find_drives(day / "linked")):
        assert outline_drive(found).problem is None
        assert read_drive(found, headers_only=True)[0].drive_id == "drive"


def test_a_drive_is_quiet_since_its_last_change_whatever_its_times_say(drive: Path) -> None:
    """Copying tools set times back; the inode's own time stays that of the arrival."""
    for path in (*drive.rglob("*"), drive):
        os.utime(path, (0, 0))
    changed_at = quiet_since(drive)
    assert changed_at is not None
    assert abs(time.time() - changed_at) < 3600
    (drive / "COMPLETE").touch()
    assert quiet_since(drive) is None
