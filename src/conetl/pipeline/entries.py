"""What is below a drop folder or the folder of a backfill: drives, what `conetl init` makes drives of, and everything else.

Nothing is left out: each entry has the reason why it is no drive, and the command that helps. No image is opened. Files of a
drive are not entries, nor is the calibration beside drives, which belongs to them.
"""

from __future__ import annotations

import hashlib
import os
import stat
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from shlex import quote
from typing import Literal

from conetl.files.documents import input_errors
from conetl.files.names import printable, require_utf8
from conetl.files.storage import is_remote
from conetl.model.errors import InputError
from conetl.perception.images import IMAGE_SUFFIXES
from conetl.perception.video import VIDEO_SUFFIXES
from conetl.pipeline.settings import Settings
from conetl.readers.drives import find_format, plain, video, zed_recording
from conetl.readers.drives.drive_yaml import DRIVE_YAML, is_bare_bag
from conetl.readers.drives.formats import DriveFormat
from conetl.readers.drives.header import DriveHeader, read_header
from conetl.readers.rigs import CAM_TO_CAM, IMU_TO_VELO, RIG_YAML, VELO_TO_CAM

#: Drives may be sorted into folders by month, day, vehicle; deeper folders are named, not searched.
MAX_DEPTH = 6
MARKER = "COMPLETE"
#: Folders of a drive, in which no others are searched.
_PARTS = frozenset({*(f"image_0{n}" for n in range(10)), "oxts", "velodyne_points", "left", "right", "mav0"})
_BESIDE_DRIVES = frozenset({CAM_TO_CAM, VELO_TO_CAM, IMU_TO_VELO, MARKER})
#: Ends of the names of files that have to be unpacked -> the command that does; the first that fits counts.
_PACKED = {
    **dict.fromkeys((".tar", ".tgz", ".tar.gz", ".tar.bz2", ".tar.xz", ".tar.zst"), "tar -xf {path} -C {folder}"),
    ".zip": "unzip {path} -d {folder}", ".7z": "7z x {path} -o{folder}", ".rar": "unrar x {path} {folder}/",
    ".gz": "gunzip {path}", ".bz2": "bunzip2 {path}", ".xz": "unxz {path}", ".lz4": "unlz4 {path}", ".zst": "unzstd {path}",
}  # fmt: skip
#: More files of one kind in a folder are one entry.
_MANY = 20
Kind = Literal["drive", "needs init", "not recognised", "arriving", "hidden", "images"]
"""images: a folder of images; what it belongs to is decided by its parent."""


@dataclass(frozen=True)
class Entry:
    """One drive, or what is none."""

    path: Path
    kind: Kind = "drive"
    why: str = ""
    command: str = ""
    """What a person can do about it, as a line for a shell."""
    name: str = ""
    """Default: that of the path."""

    def header(self) -> DriveHeader:
        """The header of the drive; of what is none one that changes with the entry itself."""
        if self.kind == "drive":
            return read_header(self.path)
        try:
            facts = self.path.lstat()
            version = () if self.kind == "arriving" else (facts.st_size, facts.st_mtime_ns)
        except OSError:
            version = ()
        shown, name = printable(self.path), printable(self.name or self.path.name)[:200]
        identity = "\0".join(map(str, (shown, name, *version)))
        sha256 = hashlib.sha256(identity.encode()).hexdigest()
        return DriveHeader(self.path, name or "/", sha256, 0, None, None, printable(self.why))


def find_entries(
    root: Path,
    *,
    may_be_drive: bool = True,
    quiet_s: float | None = None,
    settings: Settings | None = None,
) -> list[Entry]:
    """Everything below `root`, by path; `root` itself where may_be_drive.

    quiet_s: what changed within these seconds, and has no file COMPLETE, is arriving. Links are followed, where the settings
    (None: everywhere) allow to read what they lead to, and stay in the paths: the calibration may be beside the link. Raises
    InputError.
    """
    with input_errors(root):
        exists = root.is_dir()
    if not exists:
        raise InputError(f"{printable(root)}: there is no such folder; give a folder that holds drives")
    if is_remote(root):
        return [Entry(path) for path in _objects(root, MAX_DEPTH)]
    require_utf8(root)
    root = root.absolute()
    search = _Search(settings)
    found = search.folder(root, MAX_DEPTH, ()) if may_be_drive else search.drop_folder(root)
    found = [entry for entry in found if entry.path != root or any(root.iterdir())]  # nothing is below an empty folder
    return found if quiet_s is None else [_with_arrival(entry, quiet_s) for entry in found]


def _objects(folder: Path, depth: int) -> Iterator[Path]:
    """Drives in object storage."""
    if find_format(folder) is not None:
        yield folder
    elif depth:
        for child in sorted(path for path in folder.iterdir() if path.is_dir() and not path.name.startswith(".")):
            yield from _objects(child, depth - 1)


@dataclass(frozen=True)
class _Search:
    """Of folders on this machine."""

    settings: Settings | None

    def require_readable(self, path: Path, *, links: bool = False) -> None:
        if self.settings is not None:
            self.settings.require_readable(path, links=links)

    def is_usable(self, drive: Path) -> bool:
        """Whether a drive has no known problem. What links outside is not opened."""
        try:
            self.require_readable(drive, links=True)
        except InputError:
            return False
        return read_header(drive).problem is None

    def drop_folder(self, root: Path) -> list[Entry]:
        """The entries of a folder that is no drive, whatever is in it."""
        return self._apart(root, MAX_DEPTH, (root.resolve(),))

    def folder(self, folder: Path, depth: int, above: Sequence[Path]) -> list[Entry]:
        """The entries of a folder: itself, or what is in it."""
        above = (*above, folder.resolve())
        try:
            for name in (DRIVE_YAML, *_PARTS):  # before they are opened to find the format
                if (folder / name).is_symlink():
                    self.require_readable(folder / name)
            found = find_format(folder)
            if depth == 0:
                return [_of_format(folder, found) if found else self._deepest(folder)]
            below, files = self._inside(folder, depth, above, _PARTS if found else frozenset())
            if found is None:
                return _contents(folder, below, files)
            drives = [entry for entry in below if entry.kind == "drive" and self.is_usable(entry.path)]
            if drives and (found.UNPACKS or not self.is_usable(folder)):  # a loose file or folder beside drives
                return self._apart(folder, depth, above)
        except (
            OSError,
            InputError,
        ):  # unreadable, or removed meanwhile: it may hold a drive, so its header states the problem
            return [Entry(folder)]
        return [_of_format(folder, found), *(_nested(entry, folder) for entry in drives)]

    def _apart(self, folder: Path, depth: int, above: Sequence[Path]) -> list[Entry]:
        """The entries of a folder that is no drive, each for itself."""
        below, files = self._inside(folder, depth, above)
        return [*(_alone(entry) for entry in below), *_stray_files(files)]

    def _inside(
        self, folder: Path, depth: int, above: Sequence[Path], parts: frozenset[str] = frozenset()
    ) -> tuple[list[Entry], list[Path]]:
        """The entries of all but files in a folder, and its files. parts: names that are not searched. Raises OSError."""
        with os.scandir(folder) as listed:
            names = sorted(entry.name for entry in listed)
        below: list[Entry] = []
        files: list[Path] = []
        for path in (folder / name for name in names if name not in parts):
            found = self._path(path, depth, above)
            below += found or ()
            if found is None:
                files.append(path)
        return below, files

    def _path(self, path: Path, depth: int, above: Sequence[Path]) -> list[Entry] | None:
        """The entries of a path; None for a file."""
        if path.name.startswith("."):
            return [Entry(path, "hidden", "hidden: names that begin with a dot are not searched")]
        is_link = path.is_symlink()
        try:
            mode = path.stat().st_mode
            if is_link:
                self.require_readable(path)
        except InputError as error:
            return [_unknown(path, str(error), f"rm {quoted(path)}")]
        except OSError as error:
            what = "a broken link" if is_link else "this cannot be read"
            return [_unknown(path, f"{what}: {error.strerror}", f"{'rm' if is_link else 'ls -ld'} {quoted(path)}")]
        if stat.S_ISREG(mode):
            return None
        if not stat.S_ISDIR(mode):
            return [_unknown(path, "a pipe, a socket or a device, not a recording", f"rm {quoted(path)}")]
        if is_link and path.resolve() in above:
            return [_unknown(path, "a link to a folder that it is in", f"rm {quoted(path)}")]
        return self.folder(path, depth - 1, above)

    def _deepest(self, folder: Path) -> Entry:
        with os.scandir(folder) as listed:
            if not any(entry.is_dir() for entry in listed):
                return _contents(folder, [], [path for path in folder.iterdir() if path.is_file()])[0]
        why = f"deeper than {MAX_DEPTH} levels, where nothing is searched"
        return _unknown(folder, why, f"conetl backfill {quoted(folder)}")


def _contents(folder: Path, below: Sequence[Entry], files: Sequence[Path]) -> list[Entry]:
    """The entries of a folder that is no drive: one for the folder where nothing in it can be one alone."""
    hidden = [entry for entry in below if entry.kind == "hidden"]
    seen = [entry for entry in below if entry.kind != "hidden"]
    strays = _stray_files(files)
    if folder.name in _PARTS:
        why = f"a part of a drive ({folder.name}) without the rest; all parts belong in one folder"
        return [*hidden, _unknown(folder, why, f"mv {quoted(folder)} DRIVE/")]
    if len(seen) > 1 and all(entry.kind == "images" for entry in seen):
        return [*hidden, _initial(folder, f"{len(seen)} folders of images without a drive.yaml")]
    if seen or any(entry.kind == "drive" for entry in strays):
        return [*(_alone(entry) for entry in below), *strays]
    if any(path.suffix.lower() in IMAGE_SUFFIXES for path in files):
        return [*hidden, _initial(folder, "images of one folder without a drive.yaml", kind="images")]
    if len(strays) == 1:
        return [*hidden, *strays]
    if not files:
        return [*hidden, _unknown(folder, "the folder is empty", f"rmdir {quoted(folder)}")]
    listed = ", ".join(printable(path.name) for path in files[:3]) + (", ..." if files[3:] else "")
    return [*hidden, _unknown(folder, f"neither images nor videos nor a bag; found {listed}", _away(folder))]


def _of_format(folder: Path, found: DriveFormat) -> Entry:
    """A folder with a drive's files."""
    stated = (folder / DRIVE_YAML).is_file()
    if found is video and not stated:
        return _initial(folder, "videos without a drive.yaml")
    if found is plain and not stated and not (folder / plain.TRAJECTORY).is_file():
        return _initial(folder, f"images without {plain.TRAJECTORY} or a drive.yaml")
    return Entry(folder)


def _stray_files(files: Sequence[Path]) -> list[Entry]:
    """The entries of files that are not in a drive's folder: bags are drives, many of one kind are one entry."""
    bags = [path for path in files if is_bare_bag(path)]
    own = _BESIDE_DRIVES | {f"{bag.stem}.{name}" for bag in bags for name in (DRIVE_YAML, RIG_YAML)}
    kinds: dict[str, list[Path]] = defaultdict(list)
    for path in files:
        if path not in bags and path.name not in own:
            kinds[path.suffix.lower()].append(path)
    entries = [Entry(bag) for bag in bags]
    for suffix, some in kinds.items():
        if len(some) > _MANY:
            first, name = _stray_file(some[0]), f"{len(some):,} files *{suffix}"
            entries.append(replace(first, name=name, command=f"mv {quoted(first.path.parent)}/*{suffix} ELSEWHERE"))
        else:
            entries += map(_stray_file, some)
    return entries


def _stray_file(path: Path) -> Entry:
    name, suffix = path.name.lower(), path.suffix.lower()
    if (unpack := next((command for end, command in _PACKED.items() if name.endswith(end)), None)) is not None:
        command = unpack.format(path=quoted(path), folder=quoted(path.parent))
        return _unknown(path, "an archive, which is not unpacked", command)
    if name.endswith(".bag.active"):
        why = "a ROS 1 bag whose recording did not end"
        return _unknown(path, why, f"rosbag reindex {quoted(path)} && mv {quoted(path)} {quoted(path.with_suffix(''))}")
    if (error := zed_recording(path)) is not None:
        return _unknown(path, str(error), "svo_export.py --mode 0")
    if name.removesuffix(".zstd").endswith(".db3"):
        return _unknown(path, "a part of a bag without its metadata.yaml", f"ros2 bag reindex {quoted(path.parent)}")
    if suffix in VIDEO_SUFFIXES | IMAGE_SUFFIXES:
        why = "a video or an image alone; those of both cameras, the log and the calibration belong in one folder"
        return _unknown(path, why, f"mv {quoted(path)} DRIVE/ && conetl init DRIVE")
    if name in (DRIVE_YAML, RIG_YAML, plain.TRAJECTORY):
        return _unknown(path, "a part of a drive outside of a drive's folder", f"mv {quoted(path)} DRIVE/")
    return _unknown(path, "a file that is no recording; a drive is a folder or a bag", _away(path))


def _nested(entry: Entry, folder: Path) -> Entry:
    why = f"a drive inside the drive {printable(folder)}, which is one recording"
    return _unknown(entry.path, why, f"conetl ingest {quoted(entry.path)}")


def _alone(entry: Entry) -> Entry:
    return replace(entry, kind="needs init") if entry.kind == "images" else entry


def _initial(path: Path, why: str, *, kind: Kind = "needs init") -> Entry:
    return Entry(path, kind, why, f"conetl init {quoted(path)}")


def _unknown(path: Path, why: str, command: str) -> Entry:
    return Entry(path, "not recognised", why, command)


def _away(path: Path) -> str:
    return f"mv {quoted(path)} ELSEWHERE"


def quoted(path: Path) -> str:
    """A path as an argument of a command that can be printed."""
    return quote(printable(path))


def _with_arrival(entry: Entry, quiet_s: float) -> Entry:
    """The entry, or that it may still be arriving."""
    if entry.kind == "hidden" or (changed_at := quiet_since(entry.path)) is None:
        return entry
    quiet = time.time() - changed_at
    if quiet >= quiet_s:
        return entry
    why = f"still arriving: changed {max(quiet, 0):.0f} s ago; complete after {quiet_s:.0f} s, or with a file {MARKER} in it"
    return Entry(entry.path, "arriving", why, "", entry.name)


def quiet_since(folder: Path) -> float | None:
    """When anything in a folder changed last (seconds since 1970); None where the marker file says it is complete.

    The time is that of the inode (ctime): copying tools set modification times back to those of the source, but not this one.
    """
    try:
        if (folder / MARKER).exists():
            return None
    except OSError:
        pass  # the drive is taken after its quiet time, and refused with the reason
    latest = _changed_at(folder, follow_links=True)
    for parent, folders, files in os.walk(folder):
        for name in (*folders, *files):
            latest = max(latest, _changed_at(Path(parent) / name))
    return latest


def _changed_at(path: Path, *, follow_links: bool = False) -> float:
    """Time of the inode's change (seconds since 1970); now for one that was just renamed, 0 where it cannot be read."""
    try:
        return path.stat(follow_symlinks=follow_links).st_ctime
    except FileNotFoundError:
        return path.lstat().st_ctime if path.is_symlink() else datetime.now(UTC).timestamp()
    except OSError:
        return 0.0
