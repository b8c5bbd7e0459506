"""A drive folder while it is being recorded: the frame pairs so far, and their poses. KITTI raw and plain folders.

Nothing here waits. What does not exist yet is None, what is wrong raises PairError. A recorder may write files in any order and
in pieces: a line counts once it ends with a newline, an OXTS record once it has all its numbers; whether an image is complete is
checked when it is read. What has arrived is kept, and files are read on from there: reading the folder again for every pair, as
`read_drive` does, would take longer the longer the drive is. How a line, a record or a row is understood is in the readers of
whole drives (`readers/drives`).
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from conetl.files.documents import MAX_TABLE_BYTES, table_lines
from conetl.files.storage import is_present
from conetl.model.drive import FramePair, Pose
from conetl.model.errors import InputError
from conetl.model.rejections import RejectionReason
from conetl.model.rig import Rig
from conetl.perception.images import IMAGE_SUFFIXES
from conetl.readers.drives import find_format, kitti, plain
from conetl.readers.drives.drive_yaml import read_drive_yaml
from conetl.readers.drives.pairs import ContentHash, PairError, Source, first_size
from conetl.readers.drives.plain import TRAJECTORY, Row, Rows, pose_of_row, read_plain_rig, time_of_row
from conetl.readers.drives.poses import checked_srid
from conetl.readers.rigs import RIG_YAML
from conetl.readers.trajectories.oxts import FIELD_COUNT, MAX_RECORD_BYTES, OxtsRecord, parse_oxts
from conetl.readers.trajectories.times import clock_problem, parse_timestamp

#: Number of a pair without a row so far: it comes last.
BEHIND = 2**62


class ArrivingPair(NamedTuple):
    """A frame pair of which both image files have appeared."""

    key: str
    """Stem of the images."""
    left_path: Path
    right_path: Path


def open_arriving(folder: Path) -> ArrivingDrive | None:
    """The drive that arrives in a folder; None until its format is known. Raises InputError."""
    root = folder.resolve()
    found = find_format(root)
    if found is not None and found not in (kitti, plain):
        raise InputError(
            f"{folder}: a drive of the format '{found.NAME}' cannot be watched, only KITTI raw and plain folders: "
            "ingest it when it is complete"
        )
    settings = read_drive_yaml(root)
    source = Source(folder, root, settings, ContentHash())
    if found is plain:
        path = root / TRAJECTORY
        return ArrivingPlain(source, _Couples(root / "left", root / "right"), Rows(path), GrowingFile(path))
    if not (root / settings.cameras.left).is_dir():
        return None
    left, right = (
        kitti.camera_folder(root, name, settings) for name in (settings.cameras.left, settings.cameras.right)
    )
    return ArrivingKitti(source, _Couples(left, right))


@dataclass
class _Couples:
    """Images of two folders by stem. By names, each handled once: an hour's drive has 72,000."""

    left: Path
    right: Path
    images: dict[Path, dict[str, str]] = field(default_factory=dict)
    """Names of images by folder and stem."""

    def new(self, changed: Iterable[Path] | None) -> list[ArrivingPair]:
        """Couples of which an image is new. changed: as in `_Arriving`."""
        paths = None if changed is None else list(changed)
        fresh: set[str] = set()
        for folder in (self.left, self.right):
            names = _names(folder) if paths is None else {path.name for path in paths if path.parent == folder}
            fresh |= self._add(folder, names)
        left, right = self.images[self.left], self.images[self.right]
        whole = sorted(fresh & left.keys() & right.keys())
        return [ArrivingPair(stem, self.left / left[stem], self.right / right[stem]) for stem in whole]

    def left_paths(self) -> Iterator[Path]:
        """Left images so far, by stem."""
        return (self.left / name for _, name in sorted(self.images.get(self.left, {}).items()))

    def _add(self, folder: Path, names: set[str]) -> set[str]:
        """Add names of a folder; the stems of new images."""
        known = self.images.setdefault(folder, {})
        new = set()
        for name in sorted(name for name in names.difference(known.values()) if not name.startswith(".")):
            stem, suffix = os.path.splitext(name)  # noqa: PTH122 -- a path of every name is slow
            if suffix.lower() in IMAGE_SUFFIXES and stem not in known:
                known[stem] = name
                new.add(stem)
        return new


def _names(folder: Path) -> set[str]:
    """Names in a folder, none until it exists."""
    try:
        return set(os.listdir(folder))  # noqa: PTH208 -- making a path of every name is slow
    except FileNotFoundError:
        return set()


@dataclass
class _Arriving:
    """One drive that is being recorded; `ArrivingPlain` and `ArrivingKitti` answer the same questions.

    new_pairs: pairs that have arrived since the last call; changed: changed files, None: list all folders. order: sort key in the
    order of recording, whose number is BEHIND until it is known, and then does not change. rig: the rectified one, None until its
    files exist. frame_pair: the pair with its pose, and the EPSG code of its map, None until its pose exists; map_srid: of the
    map, if it exists. Raises PairError where pose or time are wrong.
    """

    source: Source
    """Without what is read of it."""
    couples: _Couples
    _rig: Rig | None = field(default=None, init=False)

    @property
    def drive_id(self) -> str:
        return self.source.settings.id_of(self.source.root)

    def _checked_srid(self, map_srid: int | None, at: OxtsRecord | Row) -> int:
        return checked_srid(map_srid or self.source.settings.map_srid, at.lat_deg, at.lon_deg, self.source.root)


@dataclass
class ArrivingPlain(_Arriving):
    """A plain folder; its pairs are ordered by the rows of trajectory.csv, those without a row come last."""

    rows: Rows
    """Those that are complete so far."""
    file: GrowingFile
    """trajectory.csv"""
    _line_count: int = 0
    """Lines that are in `rows`."""

    def new_pairs(self, changed: Iterable[Path] | None) -> list[ArrivingPair]:
        """Raises InputError where trajectory.csv has wrong columns."""
        if lines := self.file.lines(self._line_count):
            self._line_count += len(lines)
            self.rows.add(table_lines(b"".join(line + b"\n" for line in lines)))
        return self.couples.new(changed)

    def order(self, pair: ArrivingPair) -> tuple[int, str]:
        return self.rows.numbers.get(pair.key, BEHIND), pair.key

    def rig(self) -> Rig | None:
        if self._rig is None and (self.source.root / RIG_YAML).is_file():
            self._rig = read_plain_rig(self.source)
        return self._rig

    def frame_pair(self, pair: ArrivingPair, map_srid: int | None) -> tuple[FramePair, int] | None:
        row = self.rows.by_stem.get(pair.key)
        if row is None:
            return None
        if isinstance(row, str):
            raise PairError(RejectionReason.POSE_INVALID, row)
        captured = time_of_row(row, self.source.settings.timestamps_timezone)
        if isinstance(captured, str):
            raise PairError(RejectionReason.TIMESTAMP_INVALID, captured)
        srid = self._checked_srid(map_srid, row)
        pose = pose_of_row(row, srid, self.source.settings.sigmas)
        return _record(self.rows.numbers[pair.key], pair, captured, pose), srid


@dataclass
class GrowingFile:
    """A text file that is being written: its lines so far (timestamps.txt of an hour has 36,000; a pair requires up to four)."""

    path: Path
    _lines: list[bytes] = field(default_factory=list)
    _offset: int = 0
    _inode: int = 0

    def line(self, number: int) -> str | None:
        """Line `number`, from 0; None where it is not complete yet. Only then the file is opened."""
        if number >= len(self._lines):
            self._read_on()
        return self._lines[number].decode("utf-8", errors="replace") if number < len(self._lines) else None

    def lines(self, first: int) -> list[bytes]:
        """The complete lines from line `first` on."""
        self._read_on()
        return self._lines[first:]

    def _read_on(self) -> None:
        """Read what was appended, or the whole file if it was replaced or truncated."""
        try:
            with self.path.open("rb") as file:
                found = os.fstat(file.fileno())
                if found.st_ino != self._inode or found.st_size < self._offset:
                    self._lines, self._offset, self._inode = [], 0, found.st_ino
                file.seek(self._offset)
                # What follows the last newline may be half a line.
                *whole, rest = file.read(MAX_TABLE_BYTES).split(b"\n")
                self._offset = file.tell() - len(rest)
        except FileNotFoundError:
            return
        self._lines += whole


@dataclass
class ArrivingKitti(_Arriving):
    """A folder in KITTI's layout."""

    _stamps: dict[str, GrowingFile] = field(default_factory=dict)
    """By the file's name."""

    def new_pairs(self, changed: Iterable[Path] | None) -> list[ArrivingPair]:
        return [pair for pair in self.couples.new(changed) if kitti.is_number(pair.key)]

    def order(self, pair: ArrivingPair) -> tuple[int, str]:
        return int(pair.key), pair.key

    def rig(self) -> Rig | None:
        """Requires the size of a complete image: it decides whether the images are rectified."""
        if self._rig is None and (size := first_size(self.couples.left_paths())) is not None:
            path = kitti.calibration_path(self.source.path, self.source.settings)
            self._rig = kitti.read_rig_for(self.source, path, size)
        return self._rig

    def frame_pair(self, pair: ArrivingPair, map_srid: int | None) -> tuple[FramePair, int] | None:
        number, settings = int(pair.key), self.source.settings
        captured, right_at = (
            self._time(f"{name}/timestamps.txt", number) for name in (settings.cameras.left, settings.cameras.right)
        )
        record = self._record_of(f"oxts/data/{pair.key}.txt")
        if captured is None or record is None:
            return None
        if (problem := kitti.trigger_problem(captured, right_at, settings)) is not None:
            raise PairError(RejectionReason.TIMESTAMP_INVALID, problem)
        pose_at = self._time(kitti.OXTS_STAMPS, number)
        if pose_at is None and (self.source.root / kitti.OXTS_STAMPS).is_file():
            return None
        kitti.require_same_time(captured, pose_at)
        srid = self._checked_srid(map_srid, record)
        return _record(number, pair, captured, self._pose(pair.key, record, pose_at, captured, srid)), srid

    def _pose(self, key: str, record: OxtsRecord, pose_at: int | None, captured: int, srid: int) -> Pose:
        """Pose at the exposure. The next record may not exist yet, so the motion since the one before is extrapolated."""
        number = int(key)
        records, times = {number: record}, {} if pose_at is None else {number: pose_at}
        before_at = self._time(kitti.OXTS_STAMPS, number - 1) if number else None
        before = self._record_of(f"oxts/data/{number - 1:0{len(key)}d}.txt") if before_at is not None else None
        if before is not None and before_at is not None and pose_at is not None:
            records[number - 1], times[number - 1] = before, before_at
        track = kitti.oxts_trajectory(records, times, srid, self.source.settings.sigmas)
        return kitti.oxts_pose(track, number, captured)

    def _record_of(self, name: str) -> OxtsRecord | None:
        """An OXTS record; None until it is complete."""
        path = self.source.root / name
        if not is_present(path):
            return None
        with path.open("rb") as file:
            text = file.read(MAX_RECORD_BYTES).decode(errors="replace")
        if len(text.split()) < FIELD_COUNT:
            return None
        try:
            return parse_oxts(text, accuracy_required=self.source.settings.sigmas.horizontal_m is None)
        except ValueError as error:
            raise PairError(RejectionReason.POSE_INVALID, f"{name}: {error}") from error

    def _time(self, name: str, number: int) -> int | None:
        """UTC nanoseconds of line `number`; None until it is complete."""
        line = self._stamps.setdefault(name, GrowingFile(self.source.root / name)).line(number)
        if line is None:
            return None
        try:
            return parse_timestamp(line, self.source.settings.timestamps_timezone)
        except ValueError as error:
            raise PairError(RejectionReason.TIMESTAMP_INVALID, f"{name}, line {number + 1}: {error}") from error


ArrivingDrive = ArrivingPlain | ArrivingKitti


def _record(number: int, pair: ArrivingPair, captured: int, pose: Pose) -> FramePair:
    """The pair; its clock is compared with nothing: the rest of the drive may not exist yet."""
    if (problem := clock_problem(captured)) is not None:
        raise PairError(RejectionReason.TIMESTAMP_INVALID, f"the time {captured} ns {problem}")
    left, right = str(pair.left_path), str(pair.right_path)
    return FramePair(frame_index=number, left_path=left, right_path=right, captured_at_ns=captured, pose=pose)
