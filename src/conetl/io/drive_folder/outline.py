"""What a drive folder says of itself at a glance: when, how many pictures, which. No picture is opened.

For plans over many drives. What is found here is enough to know a drive again, not to trust it: the exact content is compared
when the drive is ingested.
"""

from __future__ import annotations

import csv
import os
from collections.abc import Callable, Iterator
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from conetl.errors import CalibrationError, ConetlError, DriveFolderError, ServiceError, is_of_storage
from conetl.io.calibration.files import IMU_TO_VELO, RIG_YAML, VELO_TO_CAM
from conetl.io.drive_folder import DriveFormat, drive_format
from conetl.io.drive_folder.bag_messages import METADATA, bag_files, open_bag
from conetl.io.drive_folder.bag_rig import choose_topics
from conetl.io.drive_folder.body import add_settings
from conetl.io.drive_folder.content import ContentHash
from conetl.io.drive_folder.drive_yaml import DRIVE_YAML, DriveYaml, read_drive_yaml
from conetl.io.drive_folder.euroc import camera_names, read_euroc_rig, stream_folder
from conetl.io.drive_folder.kitti import calibration_path, camera_folder, read_rig_for
from conetl.io.drive_folder.pairs import IMAGE_SUFFIXES
from conetl.io.drive_folder.plain import TRAJECTORY, read_plain_rig
from conetl.io.drive_folder.timestamps import parse_timestamp
from conetl.io.places import is_remote
from conetl.records import utc_from_ns

#: A drive may lie in folders by month, day, vehicle; deeper ones are not looked for.
MAX_DEPTH = 6
#: Pictures a side whose size takes part in the header: a drive delivered again with other pictures is another one.
SAMPLED_PICTURES = 16
MARKER = "COMPLETE"
_Times = Callable[[ContentHash, Path, DriveYaml], tuple[int, int]]


@dataclass(frozen=True)
class DriveOutline:
    """A drive folder at a glance."""

    path: Path
    drive_id: str
    header_sha256: str
    frame_pairs: int
    captured_from_ns: int | None
    captured_to_ns: int | None
    """UTC; None where the folder does not tell, then `problem` says why."""
    problem: str | None
    problem_may_pass: bool = False
    """The storage failed: it is no property of the drive."""

    @property
    def captured_from(self) -> datetime | None:
        return None if self.captured_from_ns is None else utc_from_ns(self.captured_from_ns)


def find_drives(root: Path) -> Iterator[Path]:
    """Drive folders in `root` and the folders below it, `root` itself included, by path; hidden folders are left out.

    Links are followed and stay in the paths: a calibration may lie beside the link.
    """
    if not root.is_dir():
        raise DriveFolderError(f"{root}: there is no such folder; give a folder that holds drives")
    yield from _find(root.absolute(), MAX_DEPTH)


def _find(folder: Path, depth: int) -> Iterator[Path]:
    if drive_format(folder) is not None:
        yield folder
        return
    if depth == 0:
        return
    with os.scandir(folder) as entries:
        names = sorted(entry.name for entry in entries if entry.is_dir() and not entry.name.startswith("."))
    for name in names:
        yield from _find(folder / name, depth - 1)


def outline_drive(folder: Path) -> DriveOutline:
    """The outline of a drive folder or a bare bag; what is wrong with it stands in `problem`, nothing is raised for it."""
    content = ContentHash()
    drive_id, pairs = DriveYaml().id_of(folder), 0
    first_ns = last_ns = problem = None
    passes = False
    try:
        settings = read_drive_yaml(folder)
        drive_id = settings.id_of(folder)
        content.add("drive_id", drive_id.encode())
        add_settings(content, folder, (DRIVE_YAML,))
        found = drive_format(folder)
        if found == "bag":
            pairs, first_ns, last_ns = _bag(content, folder, settings)
            streams = ["the left", "the right camera's topic"]
        else:
            sides, times = _folder_format(found, folder, settings)
            streams = [*sides]
            pairs = len(set.union(*(_add_pictures(content, folder, *side) for side in sides.items())))
            first_ns, last_ns = times(content, folder, settings)
            _read_rig(found, folder, settings)
        if not pairs:
            problem = f"there are no pictures in {' and '.join(streams)}"
    except (ConetlError, OSError, ValueError) as error:
        problem = f"{error}"
        passes = is_of_storage(error) or is_of_storage(error.__cause__) or isinstance(error, ServiceError)
    return DriveOutline(folder, drive_id, content.hexdigest(), pairs, first_ns, last_ns, problem, passes)


def quiet_since(folder: Path) -> float | None:
    """When anything in a drive folder changed last (seconds since 1970), None where the marker file says that it is complete.

    The time is that of the inode (ctime): copying tools set modification times back to those of the source, this one they cannot.
    """
    if (folder / MARKER).exists():
        return None
    latest = folder.stat().st_ctime
    for parent, folders, files in os.walk(folder):
        for name in (*folders, *files):
            try:
                latest = max(latest, (Path(parent) / name).lstat().st_ctime)
            except FileNotFoundError:  # renamed this very moment
                latest = max(latest, datetime.now(UTC).timestamp())
    return latest


def _add_file(content: ContentHash, folder: Path, name: str) -> None:
    path = folder / name
    if path.is_file():
        content.add(name, path.read_bytes())


def _add_pictures(content: ContentHash, folder: Path, side: str, data: Path) -> set[str]:
    """Names of all pictures of one side, which lie in `data`, and sizes of a few, into the header; the stems."""
    if not data.is_dir():
        raise DriveFolderError(f"{folder}: the folder {side} is missing")
    with nullcontext(data.iterdir()) if is_remote(data) else os.scandir(data) as entries:
        found = (entry.name for entry in entries if not entry.name.startswith("."))
        names = sorted(name for name in found if os.path.splitext(name)[1].lower() in IMAGE_SUFFIXES)  # noqa: PTH122 -- many
    sample = names[:: max(1, len(names) // SAMPLED_PICTURES)]
    sizes = [f"{name} {(data / name).stat().st_size}" for name in sample]
    content.add(side, "\n".join([*names, *sizes]).encode(errors="surrogateescape"))
    return {name.rsplit(".", 1)[0] for name in names}


def _folder_format(found: DriveFormat | None, folder: Path, settings: DriveYaml) -> tuple[dict[str, Path], _Times]:
    """Folders of both sides' pictures by their names, and what reads the times, of a drive that is a folder of pictures.

    Raises DriveFolderError where drive.yaml names one outside of the drive folder.
    """
    root = folder.resolve()
    if found == "plain":
        return {side: root / side for side in ("left", "right")}, _plain_times
    if found == "euroc":
        if settings.streams.trajectory:
            stream_folder(root, settings.streams.trajectory)
        return {f"{name}/data": path / "data" for name, path in _euroc_cameras(root, settings).items()}, _euroc_times
    names = (settings.cameras.left, settings.cameras.right)
    return {f"{name}/data": camera_folder(root, name, settings) for name in names}, _kitti_times


def _read_rig(found: DriveFormat | None, folder: Path, settings: DriveYaml) -> None:
    """Raises CalibrationError where a drive's calibration is missing or is none; that of a bag is not looked at."""
    unused = ContentHash()
    if found == "plain":
        read_plain_rig(folder, settings, unused)
    elif found == "euroc":
        read_euroc_rig(folder, settings, unused)
    else:
        read_rig_for(folder, calibration_path(folder, settings), None, settings, unused)


def _euroc_cameras(root: Path, settings: DriveYaml) -> dict[str, Path]:
    """Folders of both cameras by their names in the drive folder `root`, links resolved."""
    paths = [stream_folder(root, name) for name in camera_names(settings).values()]
    return {path.relative_to(root).as_posix(): path for path in paths}


def _euroc_times(content: ContentHash, folder: Path, settings: DriveYaml) -> tuple[int, int]:
    cameras = [*_euroc_cameras(folder.resolve(), settings)]
    for camera in cameras:
        _add_file(content, folder, f"{camera}/data.csv")
        _add_file(content, folder, f"{camera}/sensor.yaml")
    _add_file(content, folder, RIG_YAML)
    path = folder / cameras[0] / "data.csv"
    if not path.is_file():
        raise DriveFolderError(f"{folder}: {cameras[0]}/data.csv is missing")
    words = (line.split(",")[0].strip() for line in path.read_text(encoding="utf-8", errors="replace").splitlines())
    stamps = [int(word) for word in words if word.isascii() and word.isdigit()]
    if not stamps:
        raise DriveFolderError(f"{path}: there is no time stamp that can be read")
    return stamps[0], stamps[-1]


def _bag(content: ContentHash, folder: Path, settings: DriveYaml) -> tuple[int, int, int]:
    """Left pictures, first and last message by the recorder's clock; the bag's index goes into the header."""
    path = bag_files(folder.resolve())  # a linked file by its own name, as the drive is called by it
    if path is None:
        raise DriveFolderError(f"{folder}: this is no bag")
    _add_file(content, folder, METADATA)
    add_settings(content, folder, (RIG_YAML,))
    for file in [path] if path.is_file() else sorted(folder.glob("*.mcap")) + sorted(folder.glob("*.db3")):
        content.add(file.name, str(file.stat().st_size).encode())
    with open_bag(path) as bag:
        topics = choose_topics(bag.types, settings.streams, folder)
        content.add("index", repr((sorted(bag.counts.items()), bag.recorded_ns)).encode())
        return bag.counts[topics.left], *bag.recorded_ns


def _kitti_times(content: ContentHash, folder: Path, settings: DriveYaml) -> tuple[int, int]:
    with suppress(CalibrationError):  # said by `_read_rig`; without it the header is another one than with it
        calibration = calibration_path(folder, settings)
        for name in (calibration.name, VELO_TO_CAM, IMU_TO_VELO):
            _add_file(content, calibration.parent, name)
    _add_file(content, folder, "oxts/timestamps.txt")
    name = f"{settings.cameras.left}/timestamps.txt"
    path = folder / name
    if not path.is_file():
        raise DriveFolderError(f"{folder}: {name} is missing")
    data = path.read_bytes()
    content.add(name, data)
    lines = data.decode("utf-8", errors="replace").splitlines()
    return _ends(lines, settings.timestamps_timezone, path)


def _plain_times(content: ContentHash, folder: Path, settings: DriveYaml) -> tuple[int, int]:
    _add_file(content, folder, RIG_YAML)
    path = folder / TRAJECTORY
    if not path.is_file():
        raise DriveFolderError(f"{folder}: {TRAJECTORY} is missing")
    data = path.read_bytes()
    content.add(TRAJECTORY, data)
    rows = csv.DictReader(data.decode("utf-8", errors="replace").splitlines())
    return _ends([row.get("captured_at") or "" for row in rows], settings.timestamps_timezone, path)


def _ends(stamps: list[str], zone: str, path: Path) -> tuple[int, int]:
    """First and last time that can be read. Raises DriveFolderError."""
    found: list[int] = []
    for lines in (iter(stamps), reversed(stamps)):
        for line in lines:
            try:
                found.append(parse_timestamp(line, zone))
            except ValueError:
                continue
            break
    if not found:
        raise DriveFolderError(f"{path}: there is no time stamp that can be read")
    return min(found), max(found)
