"""A drive folder while it is being recorded: which frame pairs are there by now, and their poses. KITTI raw and plain folders.

Nothing here waits or sleeps. What is not there yet is None, what is there and wrong raises PairError. A recorder may write any
file in any order and in pieces: a line counts once it ends with a newline, an OXTS record once it has all its numbers; whether a
image is whole is seen when it is read.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from conetl.geometry import geodesy
from conetl.geometry import pose as se3
from conetl.model.errors import DriveFolderError
from conetl.model.records import FramePair, Pose, Rig
from conetl.model.rejections import RejectionReason
from conetl.readers.drives import drive_format, oxts
from conetl.readers.drives.content import ContentHash
from conetl.readers.drives.drive_yaml import DriveYaml, read_drive_yaml
from conetl.readers.drives.kitti import (
    MAX_CLOCK_DIFFERENCE_NS,
    calibration_path,
    camera_folder,
    is_number,
    read_rig_for,
)
from conetl.readers.drives.pairs import IMAGE_SUFFIXES, PairError, first_size
from conetl.readers.drives.plain import TRAJECTORY, is_plain_folder, pose_of_row, read_plain_rig, time_of_row
from conetl.readers.drives.timestamps import EARLIEST_NS, parse_timestamp
from conetl.readers.recording.rows import ArrivingRows
from conetl.readers.recording.stamps import ArrivingStamps

Array = NDArray[np.float64]
#: Number of a pair whose row is not there yet: it comes last.
BEHIND = 2**62


class ArrivingPair(NamedTuple):
    """A frame pair of which both image files have appeared."""

    key: str
    """Stem of the images."""
    left_path: Path
    right_path: Path


class ArrivingDrive(Protocol):
    """One drive that is being recorded."""

    @property
    def drive_id(self) -> str: ...
    def look(self, changed: Iterable[Path] | None) -> list[ArrivingPair]:
        """Pairs that came since the last look. changed: files that did; None: read all folders, for what nobody told."""

    def order(self, pair: ArrivingPair) -> tuple[int, str]:
        """By this pairs are in the order of their recording; the number is BEHIND until it is known, and stays from then on."""

    def rig(self) -> Rig | None:
        """The rectified rig; None as long as its files are not there."""

    def frame_pair(self, pair: ArrivingPair, map_srid: int | None) -> tuple[FramePair, int] | None:
        """The pair with its pose, and the EPSG code of the map that it is in; None as long as its pose is not there.

        map_srid: of the map, where it exists. Raises PairError where pose or time are wrong.
        """


def open_arriving(folder: Path) -> ArrivingDrive | None:
    """The drive that begins to arrive in a folder; None as long as nothing tells what it is. Raises DriveFolderError."""
    root = folder.resolve()
    found = drive_format(root)
    if found in ("euroc", "bag"):
        raise DriveFolderError(
            f"{folder}: a drive of the format '{found}' cannot be watched, but KITTI raw and plain folders can: "
            "ingest it when it is complete"
        )
    if found == "plain" or is_plain_folder(root):
        return ArrivingPlain(
            root, read_drive_yaml(root), ArrivingRows(root / TRAJECTORY), _Couples(root / "left", root / "right")
        )
    settings = read_drive_yaml(root)
    if not (root / settings.cameras.left).is_dir():
        return None
    left, right = (camera_folder(root, name, settings) for name in (settings.cameras.left, settings.cameras.right))
    return ArrivingKitti(root, folder, settings, _Couples(left, right))


@dataclass
class _Couples:
    """Images of two folders by stem, and which couples were told already.

    Names only, and each is looked at once: an hour's drive has 72,000, and to make paths of them takes longer than a look may.
    """

    left: Path
    right: Path
    seen: dict[Path, set[str]] = field(default_factory=dict)
    """All names of a folder, images or not."""
    images: dict[Path, dict[str, str]] = field(default_factory=dict)
    """Names of a folder's images by stem."""
    told: set[str] = field(default_factory=set)

    def new(self, changed: Iterable[Path] | None) -> list[ArrivingPair]:
        """Couples that were not told yet. changed: as in `ArrivingDrive.look`."""
        paths = None if changed is None else list(changed)
        fresh: set[str] = set()
        for folder in (self.left, self.right):
            names = _names(folder) if paths is None else {path.name for path in paths if path.parent == folder}
            fresh |= self._take(folder, names)
        left, right = self.images[self.left], self.images[self.right]
        whole = sorted(stem for stem in fresh if stem in left and stem in right and stem not in self.told)
        self.told.update(whole)
        return [ArrivingPair(stem, self.left / left[stem], self.right / right[stem]) for stem in whole]

    def left_paths(self) -> Iterator[Path]:
        """Left images so far, by stem."""
        return (self.left / name for _, name in sorted(self.images.get(self.left, {}).items()))

    def _take(self, folder: Path, names: set[str]) -> set[str]:
        """Take in names of a folder; the stems of images that are new."""
        seen, known = self.seen.setdefault(folder, set()), self.images.setdefault(folder, {})
        unseen = names - seen
        seen |= unseen
        stems = {_parts(name)[0]: name for name in sorted(unseen, reverse=True) if _is_image(name)}
        new = stems.keys() - known.keys()
        known |= {stem: stems[stem] for stem in new}
        return new


def _names(folder: Path) -> set[str]:
    """None where there is no such folder yet."""
    try:
        return set(os.listdir(folder))  # noqa: PTH208 -- a path for every name is what takes the time
    except FileNotFoundError:
        return set()


def _is_image(name: str) -> bool:
    return not name.startswith(".") and _parts(name)[1].lower() in IMAGE_SUFFIXES


def _parts(name: str) -> tuple[str, str]:
    """Stem and suffix."""
    return os.path.splitext(name)  # noqa: PTH122 -- as above


@dataclass
class ArrivingPlain:
    """A plain folder; its pairs are ordered by the rows of trajectory.csv, those without a row come last."""

    root: Path
    settings: DriveYaml
    rows: ArrivingRows
    couples: _Couples
    _rig: Rig | None = None

    @property
    def drive_id(self) -> str:
        return self.settings.id_of(self.root)

    def look(self, changed: Iterable[Path] | None) -> list[ArrivingPair]:
        self.rows.read_on()
        return self.couples.new(changed)

    def order(self, pair: ArrivingPair) -> tuple[int, str]:
        return self.rows.numbers.get(pair.key, BEHIND), pair.key

    def rig(self) -> Rig | None:
        if self._rig is None and (self.root / "rig.yaml").is_file():
            self._rig = read_plain_rig(self.root, self.settings, ContentHash())
        return self._rig

    def frame_pair(self, pair: ArrivingPair, map_srid: int | None) -> tuple[FramePair, int] | None:
        row = self.rows.by_stem.get(pair.key)
        if row is None:
            return None
        if isinstance(row, str):
            raise PairError(RejectionReason.POSE_INVALID, row)
        captured = time_of_row(row, self.settings.timestamps_timezone)
        if isinstance(captured, str):
            raise PairError(RejectionReason.TIMESTAMP_INVALID, captured)
        _require_set_clock(captured)
        srid = _srid(map_srid or self.settings.map_srid, row.lat_deg, row.lon_deg, self.root)
        return _record(self.rows.numbers[pair.key], pair, captured, pose_of_row(row, srid)), srid


@dataclass
class ArrivingKitti:
    """A folder in KITTI's layout."""

    root: Path
    folder: Path
    """As the user named it: the calibration may lie beside it."""
    settings: DriveYaml
    couples: _Couples
    _rig: Rig | None = None
    _stamps: dict[str, ArrivingStamps] = field(default_factory=dict)
    """By the file's name."""

    @property
    def drive_id(self) -> str:
        return self.settings.id_of(self.root)

    def look(self, changed: Iterable[Path] | None) -> list[ArrivingPair]:
        return [pair for pair in self.couples.new(changed) if is_number(pair.key)]

    def order(self, pair: ArrivingPair) -> tuple[int, str]:
        return int(pair.key), pair.key

    def rig(self) -> Rig | None:
        """Needs the size of a whole image: it says whether the images are rectified."""
        if self._rig is None:
            size = first_size(self.couples.left_paths())
            if size is not None:
                path = calibration_path(self.folder, self.settings)
                self._rig = read_rig_for(self.root, path, size, self.settings, ContentHash())
        return self._rig

    def frame_pair(self, pair: ArrivingPair, map_srid: int | None) -> tuple[FramePair, int] | None:
        number = int(pair.key)
        name = f"oxts/data/{pair.key}.txt"
        captured = self._time(f"{self.settings.cameras.left}/timestamps.txt", number)
        record = self._record_of(name)
        if captured is None or record is None:
            return None
        pose_at = self._time("oxts/timestamps.txt", number)
        if pose_at is None and (self.root / "oxts" / "timestamps.txt").is_file():
            return None
        _require_set_clock(captured)
        if pose_at is not None and abs(captured - pose_at) > MAX_CLOCK_DIFFERENCE_NS:
            raise PairError(
                RejectionReason.TIMESTAMP_INVALID, f"image and pose are {abs(captured - pose_at) * 1e-9:.3f} s apart"
            )
        srid = _srid(map_srid or self.settings.map_srid, record.lat_deg, record.lon_deg, self.root)
        return _record(number, pair, captured, self._pose(pair.key, record, pose_at, captured, srid)), srid

    def _pose(self, key: str, record: oxts.OxtsRecord, pose_at: int | None, captured: int, srid: int) -> Pose:
        """Pose at the exposure. The record after it may not be there yet, so the motion since the one before is carried on."""
        number = int(key)
        records, times = {number: record}, {} if pose_at is None else {number: pose_at}
        before_at = self._time("oxts/timestamps.txt", number - 1) if number else None
        before = self._record_of(f"oxts/data/{number - 1:0{len(key)}d}.txt") if before_at is not None else None
        if before is not None and before_at is not None and pose_at is not None:
            records[number - 1], times[number - 1] = before, before_at
        track = oxts.trajectory(records, times, srid, self.settings.sigmas)
        pose = track.map_SE3_body[-1]
        if len(track.numbers) == 2 and pose_at is not None and before_at is not None:
            step = pose_at - before_at
            if 0 < step <= oxts.MAX_GAP_NS:
                pose = se3.interpolate(track.map_SE3_body[0], pose, (captured - before_at) / step)
        return oxts.pose_record(pose, track.sigma_enu_m[-1], self.settings.sigmas)

    def _record_of(self, name: str) -> oxts.OxtsRecord | None:
        """An OXTS record; None where it is not there, or not all of it."""
        try:
            text = (self.root / name).read_text(encoding="utf-8", errors="replace")
        except FileNotFoundError:
            return None
        if len(text.split()) < oxts.FIELD_COUNT:
            return None
        try:
            return oxts.parse_oxts(text, accuracy_required=self.settings.sigmas.horizontal_m is None)
        except ValueError as error:
            raise PairError(RejectionReason.POSE_INVALID, f"{name}: {error}") from error

    def _time(self, name: str, number: int) -> int | None:
        """UTC nanoseconds of line `number`; None where it is not there, or not all of it."""
        line = self._stamps.setdefault(name, ArrivingStamps(self.root / name)).line(number)
        if line is None:
            return None
        try:
            return parse_timestamp(line, self.settings.timestamps_timezone)
        except ValueError as error:
            raise PairError(RejectionReason.TIMESTAMP_INVALID, f"{name}, line {number + 1}: {error}") from error


def _require_set_clock(captured: int) -> None:
    """Of all wrong clocks the one that shows without the rest of the drive."""
    if captured < EARLIEST_NS:
        raise PairError(
            RejectionReason.TIMESTAMP_INVALID, f"the time {captured} ns is before 2000: the clock was not set"
        )


def _srid(srid: int | None, lat_deg: float, lon_deg: float, root: Path) -> int:
    try:
        srid = srid or geodesy.utm_srid(lat_deg, lon_deg)
        geodesy.check_map_srid(srid)
        geodesy.check_scale(srid, lat_deg, lon_deg)
    except ValueError as error:
        raise DriveFolderError(f"{root}: {error}") from error
    return srid


def _record(number: int, pair: ArrivingPair, captured: int, pose: Pose) -> FramePair:
    return FramePair(
        frame_index=number,
        left_path=str(pair.left_path),
        right_path=str(pair.right_path),
        captured_at_ns=captured,
        pose=pose,
    )
