"""Headers of drives: what is known without opening images."""

from __future__ import annotations

import errno
import os
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from conetl.model.errors import InputError
from conetl.readers.drives import read_drive
from conetl.readers.drives.header import find_drives, quiet_since, read_header
from tests.folders import SAMPLE


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    return Path(shutil.copytree(SAMPLE, tmp_path / "archive" / "drive"))


def test_a_storage_error_is_not_a_property_of_the_drive(drive: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    good = read_header(drive)
    read = Path.open

    def stale(path: Path, *arguments: Any, **options: Any) -> Any:
        if path.name.startswith("calib"):
            raise OSError(errno.ESTALE, "Stale file handle", str(path))
        return read(path, *arguments, **options)

    with monkeypatch.context() as failing:
        failing.setattr(Path, "open", stale)
        bad = read_header(drive)
    assert bad.problem is not None
    assert "Stale file handle" in bad.problem
    assert bad.problem_may_pass
    assert not good.problem_may_pass
    (drive / "calib_cam_to_cam.txt").write_text("")
    assert not read_header(drive).problem_may_pass


def test_the_header_does_not_depend_on_the_path(drive: Path, tmp_path: Path) -> None:
    moved = Path(shutil.copytree(drive, tmp_path / "elsewhere" / "drive"))
    assert read_header(moved).header_sha256 == read_header(drive).header_sha256


@pytest.mark.parametrize(
    "change", ["another image", "another size", "another time", "another calibration", "another pose"]
)
def test_another_delivery_is_another_drive(drive: Path, change: str) -> None:
    before = read_header(drive).header_sha256
    image = drive / "image_02" / "data" / "0000000000.jpg"
    if change == "another image":
        shutil.copy(image, image.with_name("0000009999.jpg"))
    elif change == "another pose":
        path = drive / "oxts" / "data" / "0000000000.txt"
        shutil.copy(path, path.with_name("0000009999.txt"))
    elif change == "another size":
        image.write_bytes(image.read_bytes() + b"\0")
    else:
        name = "image_02/timestamps.txt" if change == "another time" else "calib_cam_to_cam.txt"
        (drive / name).write_text((drive / name).read_text().replace("9", "8"))
    assert read_header(drive).header_sha256 != before


def test_an_unusable_calibration_is_the_problem(drive: Path) -> None:
    calibration = drive / "calib_cam_to_cam.txt"
    whole = calibration.read_text()
    calibration.write_text("\n".join(line for line in whole.splitlines() if not line.startswith("P_rect_03")))
    spoilt = read_header(drive)
    assert spoilt.problem is not None
    assert "P_rect_03" in spoilt.problem
    assert spoilt.captured_from is not None
    calibration.unlink()
    missing = read_header(drive)
    assert "calib_cam_to_cam.txt" in (missing.problem or "")
    (drive / "drive.yaml").write_text("calibration: named/calib_cam_to_cam.txt\n")
    (drive / "named").mkdir()
    for name in ("calib_velo_to_cam.txt", "calib_imu_to_velo.txt"):
        (drive / name).rename(drive / "named" / name)
    before = read_header(drive)
    (drive / "named" / "calib_cam_to_cam.txt").write_text(whole)
    delivered = read_header(drive)
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
    with pytest.raises(InputError, match="no such folder"):
        list(find_drives(tmp_path / "nowhere"))


def test_a_relative_path_is_the_drive_itself(drive: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Plan, job and reader must identify the same drive, or it is ingested again and again. Links: `test_drive_formats.py`."""
    direct = read_header(drive)
    monkeypatch.chdir(drive)
    for path in (Path(), Path("../drive")):
        header = read_header(path)
        assert (header.drive_id, header.header_sha256) == (direct.drive_id, direct.header_sha256)
        assert read_drive(path, headers_only=True)[0].drive_id == direct.drive_id


def test_a_calibration_beside_the_link_is_found_by_plan_and_reader(drive: Path, tmp_path: Path) -> None:
    day = tmp_path / "day"
    day.mkdir()
    for path in drive.glob("calib*.txt"):
        path.rename(day / path.name)
    (day / "linked").symlink_to(drive)
    assert read_header(drive).problem is not None
    for [found] in (find_drives(day), find_drives(day / "linked")):
        assert read_header(found).problem is None
        assert read_drive(found, headers_only=True)[0].drive_id == "drive"


def test_a_drive_is_quiet_since_its_last_change(drive: Path) -> None:
    """Copying tools set times back; the inode's own time stays that of the arrival."""
    for path in (*drive.rglob("*"), drive):
        os.utime(path, (0, 0))
    changed_at = quiet_since(drive)
    assert changed_at is not None
    assert abs(time.time() - changed_at) < 3600
    (drive / "COMPLETE").touch()
    assert quiet_since(drive) is None


def failing(monkeypatch: pytest.MonkeyPatch, owner: Any, name: str, inside: Path, error: OSError) -> None:
    """Let a function that takes a path first fail for `inside` and all below it, as for a user without rights (root has them)."""
    true: Callable[..., Any] = getattr(owner, name)

    def fail(path: Any, *args: Any, **kwargs: Any) -> Any:
        if Path(path) == inside or inside in Path(path).parents:
            raise error
        return true(path, *args, **kwargs)

    monkeypatch.setattr(owner, name, fail)


@pytest.mark.parametrize("code", [errno.EACCES, errno.ENOENT])
@pytest.mark.parametrize("what", ["listing", "everything in it"])
def test_an_unreadable_folder_is_reported_and_stops_no_other(
    drive: Path, code: int, what: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """lost+found of root, or a folder that was renamed since its parent was listed."""
    closed = drive.parent / "lost+found"
    closed.mkdir()
    error = OSError(code, os.strerror(code), str(closed))
    failing(monkeypatch, os, "scandir", closed, error)
    if what != "listing" and code == errno.EACCES:
        failing(monkeypatch, Path, "stat", closed / "anything", error)
        monkeypatch.setattr(Path, "is_file", lambda path: Path.exists(path) and not Path.is_dir(path))
    found = list(find_drives(drive.parent))
    assert found == [drive, closed]
    header = read_header(closed)
    assert os.strerror(code) in (header.problem or "")
    assert header.drive_id == "lost+found"
    assert read_header(drive).problem is None
    other = drive.parent / "other" / "lost+found"
    other.mkdir(parents=True)
    failing(monkeypatch, os, "scandir", other, error)
    assert read_header(other).header_sha256 != header.header_sha256


def test_an_unreadable_file_is_the_problem(drive: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    error = PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(drive / "image_03" / "data"))
    failing(monkeypatch, Path, "iterdir", drive / "image_03" / "data", error)
    assert "Permission denied" in (read_header(drive).problem or "")


def test_a_circular_link_stops_nothing(drive: Path) -> None:
    (drive.parent / "round").symlink_to("round")
    round_, found = sorted(find_drives(drive.parent), reverse=True)
    assert found == drive
    assert read_header(round_).problem is not None


def test_a_folder_that_is_gone_or_closed_is_not_quiet_for_an_error(
    drive: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gone = quiet_since(drive.parent / "gone")
    assert gone is not None
    assert abs(time.time() - gone) < 60, "still arriving, under another name"
    failing(monkeypatch, Path, "exists", drive / "COMPLETE", PermissionError(errno.EACCES, os.strerror(errno.EACCES)))
    assert quiet_since(drive) is not None


def test_a_name_that_is_not_utf8_is_rejected_with_a_printable_message(drive: Path) -> None:
    odd = drive.rename(drive.parent / os.fsdecode(b"M\xfcnchen"))
    assert list(find_drives(drive.parent)) == [odd]
    header = read_header(odd)
    assert header.drive_id == "M\\xfcnchen"
    assert header.shown_path == f"{drive.parent}/M\\xfcnchen"
    assert "not UTF-8" in (header.problem or "")
    (header.drive_id + header.shown_path + (header.problem or "")).encode()
    with pytest.raises(InputError, match="rename the folder"):
        read_drive(odd)
    again = Path(shutil.copytree(odd, drive.parent / "other day" / odd.name))
    assert read_header(again).header_sha256 != header.header_sha256, "each is reported"
    link = drive.parent / "linked"
    link.symlink_to(odd)
    assert "not UTF-8" in (read_header(link).problem or "")
    with pytest.raises(InputError, match="not UTF-8"):
        list(find_drives(odd))


def test_an_id_is_escaped_for_the_database(drive: Path) -> None:
    (drive / "drive.yaml").write_text('drive_id: "a\\0b"\n')
    assert read_header(drive).drive_id == "a\\x00b"
    assert read_drive(drive, headers_only=True)[0].drive_id == read_header(drive).drive_id


@pytest.mark.parametrize("day", ["0001-01-01", "5026-03-02"])
def test_a_time_that_nanoseconds_cannot_hold_is_an_unreadable_stamp(drive: Path, day: str) -> None:
    (drive / "drive.yaml").write_text("timestamps_timezone: Europe/Berlin\n")
    whole = read_header(drive)
    stamps = drive / "image_02" / "timestamps.txt"
    lines = stamps.read_text().splitlines()
    stamps.write_text("\n".join([f"{day} 00:00:00", *lines[1:]]) + "\n")
    header = read_header(drive)
    assert header.problem is None
    assert header.captured_to_ns == whole.captured_to_ns
    _, rejections = read_drive(drive, headers_only=True)
    assert day in rejections[0].detail


def test_an_unexpected_error_stops_nothing(drive: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(_: Path) -> None:
        raise RecursionError("too deep")

    monkeypatch.setattr("conetl.readers.drives.header.read_drive_yaml", broken)
    assert "RecursionError: too deep" in (read_header(drive).problem or "")
