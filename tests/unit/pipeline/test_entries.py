"""Entries below a folder: what is a drive, what is none, and when it is complete. All kinds: `test_drop_folder.py`."""

from __future__ import annotations

import errno
import io
import os
import shutil
import time
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from conetl.model.errors import InputError
from conetl.pipeline.backfill_plan import _header, _is_within
from conetl.pipeline.entries import Entry, find_entries, quiet_since
from conetl.pipeline.settings import Settings
from conetl.readers.drives.header import DriveHeader, read_header
from tests.folders import SAMPLE
from tests.unit.readers.test_drive_header import drive, failing

__all__ = ["drive"]


def drives(root: Path) -> list[Path]:
    return [entry.path for entry in find_entries(root) if entry.kind == "drive"]


def test_drives_are_found_in_folders_by_day(drive: Path, tmp_path: Path) -> None:
    shutil.copytree(drive, tmp_path / "archive" / "2026" / "03" / "another")
    shutil.copytree(drive, tmp_path / "archive" / ".arriving" / "hidden")
    (tmp_path / "archive" / "notes").mkdir()
    found = {entry.path.name: entry.kind for entry in find_entries(tmp_path / "archive")}
    assert found == {"another": "drive", "drive": "drive", ".arriving": "hidden", "notes": "not recognised"}
    assert find_entries(drive) == [Entry(drive)]
    assert find_entries(tmp_path / "archive" / "notes") == [], "nothing is below it"
    with pytest.raises(InputError, match="no such folder"):
        find_entries(tmp_path / "nowhere")


def test_a_drop_folder_is_never_a_drive_and_a_stray_file_hides_nothing(drive: Path) -> None:
    for name in ("drive.yaml", "left.mp4", "run.mcap"):
        (drive.parent / name).write_text("")
    (drive.parent / "oxts").mkdir()
    for may_be_drive in (True, False):
        found = {e.path.name: e.kind for e in find_entries(drive.parent, may_be_drive=may_be_drive)}
        strays = dict.fromkeys(("drive.yaml", "left.mp4", "oxts"), "not recognised")
        assert found == {"drive": "drive", "run.mcap": "drive", **strays}
    inside = {e.path.name for e in find_entries(drive, may_be_drive=False)}
    assert {"image_02", "image_03", "oxts"} <= inside, "the files of a drive that was copied without its folder"


def test_an_entry_is_arriving_until_it_is_quiet_or_complete(drive: Path) -> None:
    (drive.parent / "drive.zip").touch()
    found = {e.path.name: e for e in find_entries(drive.parent, quiet_s=1000)}
    assert {e.kind for e in found.values()} == {"arriving"}
    assert found["drive.zip"].header().problem == found["drive.zip"].why
    (drive / "COMPLETE").touch()
    assert {e.path.name: e.kind for e in find_entries(drive.parent, quiet_s=1000)} == {
        "drive": "drive", "drive.zip": "arriving",
    }  # fmt: skip
    assert {e.kind for e in find_entries(drive.parent, quiet_s=0)} == {"drive", "not recognised"}


def test_nothing_outside_of_the_roots_is_opened(drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Links of a drive, of folders in linked folders, of the calibration beside it, and of a drive.yaml that tells the format."""
    outside, opened = tmp_path / "outside", list[str]()
    shutil.copytree(SAMPLE, outside / "image_02")
    (outside / "secret").write_text("root:x:0:0\n")
    settings = Settings(drive_roots=str(tmp_path / "archive"))
    links = {
        "image_02": outside / "image_02" / "image_02", "image_02/timestamps.txt": outside / "secret",
        "drive.yaml": outside / "secret", "calib_cam_to_cam.txt": outside / "secret",
        "oxts/data/0000000000.txt": outside / "secret", "../calib_cam_to_cam.txt": outside / "secret",
        "image_03": tmp_path / "archive" / "elsewhere", "velodyne_points": outside / "image_02",
    }  # fmt: skip
    (tmp_path / "archive" / "elsewhere").mkdir()
    (tmp_path / "archive" / "elsewhere" / "data").symlink_to(outside / "image_02" / "image_03" / "data")

    def noting(module: Any, name: str, watched: pytest.MonkeyPatch) -> None:
        true = getattr(module, name)

        def note(path: Any, *arguments: Any, **options: Any) -> Any:
            opened.append(str(Path(path).resolve()))
            return true(path, *arguments, **options)

        watched.setattr(module, name, note)

    for number, (name, target) in enumerate(links.items()):
        attacked = Path(shutil.copytree(drive, tmp_path / "archive" / str(number) / "attacked"))
        link = attacked / name
        if link.is_dir():
            shutil.rmtree(link)
        link.unlink(missing_ok=True)
        link.symlink_to(target)
        with monkeypatch.context() as watched:
            noting(io, "open", watched)
            noting(os, "scandir", watched)
            [entry] = find_entries(attacked, settings=settings)
            header = _header(entry, settings)
        assert "outside of the folders" in (header.problem or ""), name
        assert "root:x" not in (header.problem or "")
        assert opened and [path for path in opened if path.startswith(str(outside))] == []
    (drive / "image_02").rename(tmp_path / "archive" / "disk")
    (drive / "image_02").symlink_to(tmp_path / "archive" / "disk")
    assert _header(Entry(drive), settings).problem is None, "a link below the roots"


def test_links_to_themselves_stop_no_plan(drive: Path, tmp_path: Path) -> None:
    for link in (drive / "oxts" / "data" / "loop", drive.parent / "loop"):
        link.symlink_to(link.name)
    (drive / "below").symlink_to(drive)
    settings = Settings(drive_roots=str(tmp_path))
    drives = [entry for entry in find_entries(drive.parent, quiet_s=0, settings=settings) if entry.kind == "drive"]
    assert [_header(entry, settings).problem for entry in drives] == [None]
    (drive / "drive.yaml").write_text("control_points: oxts/data/loop\n")
    assert "cannot be the name of a file" in (_header(Entry(drive), settings).problem or "")


def test_a_drive_is_quiet_since_its_last_change(drive: Path) -> None:
    """Copying tools set times back; the inode's own time stays that of the arrival."""
    for path in (*drive.rglob("*"), drive):
        os.utime(path, (0, 0))
    changed_at = quiet_since(drive)
    assert changed_at is not None
    assert abs(time.time() - changed_at) < 3600
    (drive / "COMPLETE").touch()
    assert quiet_since(drive) is None


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
    found = list(drives(drive.parent))
    assert found == [drive, closed]
    header = read_header(closed)
    assert os.strerror(code) in (header.problem or "")
    assert header.drive_id == "lost+found"
    assert read_header(drive).problem is None
    other = drive.parent / "other" / "lost+found"
    other.mkdir(parents=True)
    failing(monkeypatch, os, "scandir", other, error)
    assert read_header(other).header_sha256 != header.header_sha256


def test_a_folder_that_is_gone_or_closed_is_not_quiet_for_an_error(
    drive: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gone = quiet_since(drive.parent / "gone")
    assert gone is not None
    assert abs(time.time() - gone) < 60, "still arriving, under another name"
    failing(monkeypatch, Path, "exists", drive / "COMPLETE", PermissionError(errno.EACCES, os.strerror(errno.EACCES)))
    assert quiet_since(drive) is not None


def test_a_period_has_its_beginning_and_not_its_end() -> None:
    header = DriveHeader(Path("d"), "d", "0", 10, 10**18, 10**18 + 1, None)
    at, second = datetime.fromtimestamp(10**9, UTC), timedelta(seconds=1)
    for since, until, within in (
        (at, at + second, True), (at + second, None, False), (at - second, at, False), (None, at + second, True),
        (None, None, True),
    ):  # fmt: skip
        assert _is_within(header, since, until) == within
