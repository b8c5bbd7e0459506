"""Headers of drives: what is known without opening images."""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from conetl.model.errors import InputError
from conetl.readers.drives import read_drive
from conetl.readers.drives.header import read_header
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
    assert read_header(day / "linked").problem is None
    assert read_drive(day / "linked", headers_only=True)[0].drive_id == "drive"


def failing(monkeypatch: pytest.MonkeyPatch, owner: Any, name: str, inside: Path, error: OSError) -> None:
    """Let a function that takes a path first fail for `inside` and all below it, as for a user without rights (root has them)."""
    true: Callable[..., Any] = getattr(owner, name)

    def fail(path: Any, *args: Any, **kwargs: Any) -> Any:
        if Path(path) == inside or inside in Path(path).parents:
            raise error
        return true(path, *args, **kwargs)

    monkeypatch.setattr(owner, name, fail)


def test_an_unreadable_file_is_the_problem(drive: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    error = PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(drive / "image_03" / "data"))
    failing(monkeypatch, Path, "iterdir", drive / "image_03" / "data", error)
    assert "Permission denied" in (read_header(drive).problem or "")


def test_a_name_that_is_not_utf8_is_rejected_with_a_printable_message(drive: Path) -> None:
    odd = drive.rename(drive.parent / os.fsdecode(b"M\xfcnchen"))
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
