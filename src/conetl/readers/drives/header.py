"""What a drive folder says of itself at a glance: when, how many images, which. No image is opened.

For plans over many drives. What is found here is enough to know a drive again, not to trust it: the exact content is compared
when the drive is ingested.
"""

from __future__ import annotations

import csv
import os
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from conetl.files.names import printable, require_utf8
from conetl.files.storage import is_remote
from conetl.model.errors import CalibrationError, ConetlError, DriveFolderError, ServiceError, is_of_storage
from conetl.model.records import utc_from_ns
from conetl.readers.drives import DriveFormat, drive_format
from conetl.readers.drives.bag_messages import METADATA, bag_files, open_bag
from conetl.readers.drives.bag_rig import choose_topics
from conetl.readers.drives.body import add_settings
from conetl.readers.drives.content import ContentHash
from conetl.readers.drives.drive_yaml import DRIVE_YAML, DriveYaml, read_drive_yaml
from conetl.readers.drives.euroc import (
    SENSOR_YAML,
    camera_names,
    read_euroc_rig,
    stream_folder,
    trajectory_names,
    trajectory_path,
)
from conetl.readers.drives.kitti import calibration_path, camera_folder, is_number, no_poses, read_rig_for
from conetl.readers.drives.pairs import IMAGE_SUFFIXES
from conetl.readers.drives.plain import TRAJECTORY, read_plain_rig
from conetl.readers.drives.timestamps import EARLIEST_NS, misplaced, parse_timestamp, parse_timestamps
from conetl.readers.rigs import IMU_TO_VELO, RIG_YAML, VELO_TO_CAM

#: A drive may lie in folders by month, day, vehicle; deeper ones are not looked for.
MAX_DEPTH = 6
#: Images a side whose size takes part in the header: a drive delivered again with other images is another one.
SAMPLED_IMAGES = 16
#: Pose files whose content takes part: corrected poses are as many, and often of as many digits.
SAMPLED_POSES = 16
#: Bytes of a long trajectory that are looked at in one place, at its beginning, its end and between.
_SAMPLED_BYTES = 4096
MARKER = "COMPLETE"
_Times = Callable[[ContentHash, Path, DriveYaml], tuple[int, int]]


@dataclass(frozen=True)
class DriveHeader:
    """A drive folder at a glance."""

    path: Path
    drive_id: str
    header_sha256: str
    frame_pairs: int
    captured_from_ns: int | None
    captured_to_ns: int | None
    """UTC; None where the folder does not tell: then `problem` says why, or the clock of a bag's recorder was not set."""
    problem: str | None
    problem_may_pass: bool = False
    """The storage failed: it is no property of the drive."""

    @property
    def shown_path(self) -> str:
        """The path as text that can be printed and stored, whatever bytes it is made of."""
        return printable(self.path)

    @property
    def captured_from(self) -> datetime | None:
        return None if self.captured_from_ns is None else utc_from_ns(self.captured_from_ns)


def find_drives(root: Path) -> Iterator[Path]:
    """Drive folders in `root` and the folders below it, `root` itself included, by path; hidden folders are left out.

    Links are followed and stay in the paths: a calibration may lie beside the link.
    """
    try:
        there = root.is_dir()
    except OSError as error:
        raise DriveFolderError(f"{root}: this cannot be looked at: {error.strerror}") from error
    if not there:
        raise DriveFolderError(f"{printable(root)}: there is no such folder; give a folder that holds drives")
    require_utf8(root)
    yield from _find(root.absolute(), MAX_DEPTH)


def _find(folder: Path, depth: int) -> Iterator[Path]:
    try:
        found = drive_format(folder) is not None
        names = [] if found or depth == 0 else _folders_in(folder)
    except OSError:  # not to be read, or gone by now: it may hold a drive, so its outline says what is wrong
        found, names = True, []
    if found:
        yield folder
    for name in names:
        yield from _find(folder / name, depth - 1)


def _folders_in(folder: Path) -> list[str]:
    """Names of folders that are not hidden, sorted; of links whatever they lead to where that cannot be seen."""
    with os.scandir(folder) as entries:
        return sorted(entry.name for entry in entries if not entry.name.startswith(".") and _may_be_folder(entry))


def _may_be_folder(entry: os.DirEntry[str]) -> bool:
    try:
        return entry.is_dir()
    except OSError:
        return True


def read_header(folder: Path) -> DriveHeader:
    """The outline of a drive folder or a bare bag; what is wrong with it stands in `problem`, nothing is raised for it."""
    content = ContentHash()
    drive_id, pairs = printable(folder.name)[:200] or "drive", 0
    first_ns = last_ns = problem = found = None
    readable, passes = True, False
    try:
        drive_id = DriveYaml().id_of(folder)
        content.add("drive_id", drive_id.encode())
        add_settings(content, folder, (DRIVE_YAML,))
        settings = read_drive_yaml(folder)
        drive_id = settings.id_of(folder)
        content.add("drive_id", drive_id.encode())
        if not is_remote(folder):
            require_utf8(folder)
        found = drive_format(folder)
        if found is None and not is_remote(folder) and not folder.is_file():
            _require_readable(folder)
        if found == "bag":
            pairs, first_ns, last_ns = _bag(content, folder, settings)
            streams = ["the left", "the right camera's topic"]
        else:
            sides, times = _folder_format(found, folder, settings)
            streams = [*sides]
            pairs = len(set.union(*(_add_images(content, folder, *side) for side in sides.items())))
            first_ns, last_ns = times(content, folder, settings)
            _read_rig(found, folder, settings)
            _require_poses(found, folder, settings)
        if not pairs:
            problem = f"there are no images in {' and '.join(streams)}"
    except OSError as error:
        problem = f"this cannot be read: {error.strerror or error}: {error.filename or folder}"
        readable = False
        passes = is_of_storage(error)
    except (ConetlError, ValueError) as error:
        problem = f"{error}"
        passes = is_of_storage(error.__cause__) or isinstance(error, ServiceError)
    except Exception as error:  # others wrote these files, and one drive must not stop a year of them
        problem = f"this cannot be looked at: {type(error).__name__}: {error}"
        readable = False
    if found is None or not readable:
        content.add("path", printable(folder).encode())  # nothing else may tell it from another one
    problem = None if problem is None else printable(problem)
    return DriveHeader(folder, drive_id, content.hexdigest(), pairs, first_ns, last_ns, problem, passes)


def _require_readable(folder: Path) -> None:
    """Raise OSError where a folder cannot be listed: what looks like no drive may be one then."""
    with os.scandir(folder):
        pass


def quiet_since(folder: Path) -> float | None:
    """When anything in a drive folder changed last (seconds since 1970), None where the marker file says that it is complete.

    The time is that of the inode (ctime): copying tools set modification times back to those of the source, this one they cannot.
    """
    try:
        if (folder / MARKER).exists():
            return None
    except PermissionError:
        pass  # goes on by its own time: it is taken when it has been so for a while, and refused with the reason
    latest = _changed_at(folder, follow_links=True)
    for parent, folders, files in os.walk(folder):
        for name in (*folders, *files):
            latest = max(latest, _changed_at(Path(parent) / name))
    return latest


def _changed_at(path: Path, *, follow_links: bool = False) -> float:
    """Time of the inode's change (seconds since 1970); now for one that is renamed this very moment, 0 where nobody may know."""
    try:
        return path.stat(follow_symlinks=follow_links).st_ctime
    except FileNotFoundError:
        return datetime.now(UTC).timestamp()
    except OSError:
        return 0.0


def _add_file(content: ContentHash, folder: Path, name: str) -> None:
    path = folder / name
    if path.is_file():
        content.add(name, path.read_bytes())


def _add_images(content: ContentHash, folder: Path, side: str, data: Path) -> set[str]:
    """Names of all images of one side, which lie in `data`, and sizes of a few, into the header; the stems."""
    if not data.is_dir():
        raise DriveFolderError(f"{folder}: the folder {side} is missing")
    names = _names_in(data, IMAGE_SUFFIXES)
    sample = names[:: max(1, len(names) // SAMPLED_IMAGES)]
    sizes = [f"{name} {(data / name).stat().st_size}" for name in sample]
    content.add(side, "\n".join([*names, *sizes]).encode(errors="surrogateescape"))
    return {name.rsplit(".", 1)[0] for name in names}


def _names_in(data: Path, suffixes: Collection[str]) -> list[str]:
    """Names of files with one of these suffixes that are not hidden, sorted."""
    with nullcontext(data.iterdir()) if is_remote(data) else os.scandir(data) as entries:
        found = (entry.name for entry in entries if not entry.name.startswith("."))
        return sorted(name for name in found if os.path.splitext(name)[1].lower() in suffixes)  # noqa: PTH122 -- many


def _add_poses(content: ContentHash, folder: Path) -> None:
    """Names of all OXTS files and what stands in a few of them, into the header."""
    data = folder / "oxts" / "data"
    if not data.is_dir():
        return  # said by `_require_poses`; the times are told all the same
    names = _names_in(data, (".txt",))
    content.add("oxts/data", "\n".join(names).encode(errors="surrogateescape"))
    for name in names[:: max(1, len(names) // SAMPLED_POSES)]:
        content.add(f"oxts/data/{name}", (data / name).read_bytes())


def _add_trajectory(content: ContentHash, folder: Path, name: str) -> None:
    """Size and some places of a trajectory, which may be too long to be read for a plan, into the header."""
    path = folder / name
    if not path.is_file():
        return
    size = path.stat().st_size
    step = max(_SAMPLED_BYTES, (size - _SAMPLED_BYTES) // (SAMPLED_POSES - 1))
    pieces = [f"{size}\n".encode()]
    with path.open("rb") as file:
        for start in range(0, size, step):
            file.seek(start)
            pieces.append(file.read(_SAMPLED_BYTES))
    content.add(name, b"".join(pieces))


def _folder_format(found: DriveFormat | None, folder: Path, settings: DriveYaml) -> tuple[dict[str, Path], _Times]:
    """Folders of both sides' images by their names, and what reads the times, of a drive that is a folder of images.

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


def _require_poses(found: DriveFormat | None, folder: Path, settings: DriveYaml) -> None:
    """Raises DriveFolderError where a drive has no trajectory yet: others compute it and send it later.

    A plain folder's times stand in it, so its absence was told before; the trajectory of a bag is one of its topics.
    """
    if found == "euroc":
        trajectory_path(folder.resolve(), settings)
    elif found != "plain":
        data = folder / "oxts" / "data"
        if not data.is_dir() or not any(path.suffix == ".txt" and is_number(path.stem) for path in data.iterdir()):
            raise no_poses(folder)


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
    for wanted in trajectory_names(settings):
        name = stream_folder(folder.resolve(), wanted).relative_to(folder.resolve()).as_posix()
        _add_trajectory(content, folder, f"{name}/data.csv")
        _add_file(content, folder, f"{name}/{SENSOR_YAML}")
    for camera in cameras:
        if not (folder / camera / "data.csv").is_file():
            raise DriveFolderError(f"{folder}: {camera}/data.csv is missing")
    path = folder / cameras[0] / "data.csv"
    words = (line.split(",")[0].strip() for line in path.read_text(encoding="utf-8", errors="replace").splitlines())
    stamps = [int(word) for word in words if word.isascii() and word.isdigit() and 0 < int(word) < 2**63]
    return _ends(stamps, path)


def _bag(content: ContentHash, folder: Path, settings: DriveYaml) -> tuple[int, int | None, int | None]:
    """Left images, first and last message by the recorder's clock (None: not set); the bag's index goes into the header."""
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
        set_ns = [time_ns for time_ns in bag.recorded_ns if time_ns >= EARLIEST_NS]
        # A recorder whose clock was set on the way knows the end; the images have stamps of their own.
        return bag.counts[topics.left], *((set_ns[0], set_ns[-1]) if set_ns else (None, None))


def _kitti_times(content: ContentHash, folder: Path, settings: DriveYaml) -> tuple[int, int]:
    with suppress(CalibrationError):  # said by `_read_rig`; without it the header is another one than with it
        calibration = calibration_path(folder, settings)
        for name in (calibration.name, VELO_TO_CAM, IMU_TO_VELO):
            _add_file(content, calibration.parent, name)
    _add_file(content, folder, "oxts/timestamps.txt")
    _add_poses(content, folder)
    name = f"{settings.cameras.left}/timestamps.txt"
    path = folder / name
    if not path.is_file():
        raise DriveFolderError(f"{folder}: {name} is missing")
    data = path.read_bytes()
    content.add(name, data)
    stamps = parse_timestamps(data.decode("utf-8", errors="replace"), settings.timestamps_timezone)
    return _ends([stamp for stamp in stamps.values() if isinstance(stamp, int)], path)


def _plain_times(content: ContentHash, folder: Path, settings: DriveYaml) -> tuple[int, int]:
    _add_file(content, folder, RIG_YAML)
    path = folder / TRAJECTORY
    if not path.is_file():
        raise DriveFolderError(f"{folder}: {TRAJECTORY} is missing")
    data = path.read_bytes()
    content.add(TRAJECTORY, data)
    rows = csv.DictReader(data.decode("utf-8", errors="replace").splitlines())
    stamps: list[int] = []
    for row in rows:
        with suppress(ValueError):
            stamps.append(parse_timestamp(row.get("captured_at") or "", settings.timestamps_timezone))
    return _ends(stamps, path)


def _ends(stamps: Sequence[int], path: Path) -> tuple[int, int]:
    """First and last time that the reader will take. Raises DriveFolderError."""
    wrong = misplaced(dict(enumerate(stamps)))
    found = [stamp for number, stamp in enumerate(stamps) if number not in wrong]
    if not found:
        raise DriveFolderError(f"{path}: there is no time stamp from 2000 on that can be read")
    return found[0], found[-1]
