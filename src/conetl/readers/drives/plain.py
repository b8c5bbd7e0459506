"""Plain drive folders: the minimum for a two-camera rig with a trajectory.

    drive/left/*.{jpg,png}, drive/right/*.{jpg,png}   images as rig.yaml describes them, the same stem for both of a pair
    drive/trajectory.csv                              one row per pair, the pose of the body at the exposure, see `Row`
    drive/rig.yaml                                    the rig, with body_SE3_left, see readers/rigs/rig_yaml.py
    drive/drive.yaml                                  optional, see drive_yaml.py (cameras and calibration do not apply)

The row number in trajectory.csv, from 0, is the pair's frame_index. Angles are those of OXTS: body x forward, y left, z up, yaw
counted from true east counter-clockwise, pitch positive with the front down, roll positive with the left side up.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field, ValidationError

from conetl.files.documents import MAX_SHOWN, first_message, input_errors, library_errors, shown
from conetl.geometry import geodesy
from conetl.geometry import pose as se3
from conetl.model.base import Height, Latitude, Longitude, Record
from conetl.model.drive import Drive, Pose
from conetl.model.errors import InputError
from conetl.model.rejections import Rejection, RejectionReason
from conetl.model.rig import SIDES, Rig
from conetl.readers.drives.camera_files import Files, folder_stream
from conetl.readers.drives.drive_yaml import DriveYaml, Sigmas, names_images
from conetl.readers.drives.formats import HeaderFacts, add_settings, no_rig, overrides, own_rig
from conetl.readers.drives.pairs import PairError, RecordedPair, Source, by_stem, drive_of_pairs
from conetl.readers.drives.poses import checked_srid, stated_sigmas, wild_fixes
from conetl.readers.rigs import RIG_YAML
from conetl.readers.rigs.common import rectified_rig
from conetl.readers.trajectories.times import misplaced, stamp_or_problem

NAME, TITLE = "plain", "plain folder"
READS_OBJECTS, UNPACKS = True, False
TRAJECTORY = "trajectory.csv"
Sigma = Annotated[float, Field(gt=0, le=1000)]


class Row(Record):
    """One row of trajectory.csv; the columns may be in any order."""

    stem: str = Field(min_length=1, max_length=255)
    captured_at: str
    """Like 2026-03-01 12:00:00.123456789, UTC or the time zone of drive.yaml, or with its own offset (Z, +01:00)."""
    lon_deg: Longitude
    lat_deg: Latitude
    height_m: Height
    """Above the WGS 84 ellipsoid."""
    roll_deg: float = Field(ge=-180, le=180)
    pitch_deg: float = Field(ge=-90, le=90)
    yaw_deg: float = Field(ge=-360, le=360)
    sigma_e_m: Sigma
    sigma_n_m: Sigma
    sigma_u_m: Sigma
    sigma_roll_deg: Sigma
    sigma_pitch_deg: Sigma
    sigma_yaw_deg: Sigma


@dataclass
class Rows:
    """Rows of trajectory.csv by stem, a message in place of a bad one, and their numbers from 0."""

    path: Path
    by_stem: dict[str, Row | str] = field(default_factory=dict)
    numbers: dict[str, int] = field(default_factory=dict)
    _columns: Sequence[str] | None = None
    _count: int = 0

    def add(self, lines: Iterable[str]) -> None:
        """Append lines of the file, the header first. Raises InputError where its columns are not those of `Row`."""
        reader = csv.DictReader(lines, fieldnames=self._columns)
        with library_errors(f"{self.path}: not a CSV file", csv.Error):
            if self._columns is None:
                self._columns = reader.fieldnames
                self._check_columns()
            for values in reader:
                self._add(values)

    def _add(self, values: Mapping[str, Any]) -> None:
        where = f"{TRAJECTORY}, row {self._count}"
        stem = str(values.get("stem") or f"row {self._count}")
        try:
            row: Row | str = Row.model_validate({str(key): value for key, value in values.items()})
        except ValidationError as error:
            row = f"{where}: {first_message(error)}"
        if stem in self.by_stem:
            row = f"{where}: the stem {shown(stem)} is in two rows; keep one"
        self.by_stem[stem] = row
        self.numbers.setdefault(stem, self._count)
        self._count += 1

    def _check_columns(self) -> None:
        wanted, found = set(Row.model_fields), set(self._columns or ())
        wrong = [f"missing {', '.join(sorted(wanted - found))}"] if wanted - found else []
        wrong += [f"unknown {', '.join(sorted(found - wanted))[:MAX_SHOWN]}"] if found - wanted else []
        if wrong:
            raise InputError(f"{self.path}: wrong columns: {'; '.join(wrong)}")


def matches(path: Path) -> bool:
    """True where a folder looks like a plain drive, complete or not; not where drive.yaml names its images (`video`)."""
    has_folders = (path / "left").is_dir() and (path / "right").is_dir()
    return ((path / TRAJECTORY).is_file() or has_folders) and not names_images(path)


def read(source: Source) -> tuple[Drive, list[Rejection]]:
    """The drive and its rejections."""
    path, settings = source.path, source.settings
    rig = read_plain_rig(source)
    left, right = (by_stem(stream.paths) for stream in source.files[:2])
    found = Rows(path / TRAJECTORY)
    found.add(_trajectory(source))
    good = [row for row in found.by_stem.values() if isinstance(row, Row)]
    if not good:
        first = next((str(row) for row in found.by_stem.values()), "the file has no rows")
        raise InputError(f"{path / TRAJECTORY}: no usable pose: {first}")
    srid = checked_srid(source.map_srid, good[0].lat_deg, good[0].lon_deg, path)
    times = {row.stem: time_of_row(row, settings.timestamps_timezone) for row in good}
    with input_errors(path):
        wild = _wild_rows([row for row in good if isinstance(times[row.stem], int)], times, srid)
    bad = {stem: row for stem, row in found.by_stem.items() if isinstance(row, str)} | wild
    # Pairs are ordered by row; a stem without one comes last and only serves to name the rejection.
    stems = sorted(left.keys() | right.keys() | found.by_stem.keys())
    order = {stem: found.numbers.get(stem, len(found.by_stem) + i) for i, stem in enumerate(stems)}
    misplaced_at = misplaced({order[stem]: t for stem in stems if isinstance(t := times.get(stem), int)})

    def frame(stem: str) -> RecordedPair:
        captured, number = times.get(stem), order[stem]
        reason, text = RejectionReason.TIMESTAMP_INVALID, captured if isinstance(captured, str) else None
        if stem not in found.by_stem:
            reason, text = RejectionReason.POSE_MISSING, f"{TRAJECTORY} has no row with the stem '{stem}'"
        elif stem in bad:
            reason, text = RejectionReason.POSE_INVALID, bad[stem]
        elif number in misplaced_at:
            text = f"{TRAJECTORY}: captured_at of '{stem}' {misplaced_at[number]}"
        time = captured if isinstance(captured, int) and text is None else PairError(reason, str(text))

        def pose_at(_: int) -> Pose:
            row = found.by_stem[stem]
            assert isinstance(row, Row)
            return pose_of_row(row, srid, settings.sigmas)

        return RecordedPair(number, f"'{stem}'", left.get(stem, []), right.get(stem, []), time, pose_at)

    return drive_of_pairs([*map(frame, sorted(stems, key=order.__getitem__))], source, rig, srid)


def scan(path: Path, settings: DriveYaml) -> Files:
    """Images, rig and trajectory."""
    del settings
    root = path.resolve()
    left, right = (
        folder_stream(root, root / side, side, "expected left/ and right/ with the same stems") for side in SIDES
    )
    return Files(left, right, {name: root / name for name in (RIG_YAML, TRAJECTORY)})


def read_header(source: Source, header: HeaderFacts) -> None:
    """The times of the rows; the rig must be there."""
    rows = csv.DictReader(_trajectory(source))
    zone = source.settings.timestamps_timezone
    header.set_times([stamp_or_problem(row.get("captured_at") or "", zone) for row in rows], source.path / TRAJECTORY)
    read_plain_rig(source)


def read_plain_rig(source: Source) -> Rig:
    """The rectified rig; its file is added to the content hash. Raises InputError.

    A rig.yaml with lenses or turned cameras describes raw images: they are rectified when they are read.
    """
    path = source.root / RIG_YAML
    found = own_rig(path, source.settings.pair)
    if found is None:
        raise no_rig(source.root)
    add_settings(source.content, source.root)
    return rectified_rig(found[0].model_copy(update=overrides(source.settings)), path)


def _wild_rows(rows: Sequence[Row], times: Mapping[str, Any], srid: int) -> dict[str, str]:
    """What is wrong with rows whose position cannot be true, by stem. Raises ValueError for one that the CRS cannot express."""
    rows = sorted(rows, key=lambda row: (times[row.stem], row.stem))
    lat_lon_height = np.array([(row.lat_deg, row.lon_deg, row.height_m) for row in rows]).reshape(-1, 3)
    wild = wild_fixes([times[row.stem] for row in rows], geodesy.to_map(srid, *lat_lon_height.T))
    return {rows[i].stem: f"{TRAJECTORY}, stem '{rows[i].stem}': {text}" for i, text in wild.items()}


def _trajectory(source: Source) -> Iterator[str]:
    remedy = f"for a log of another format run 'conetl init {source.path}'"
    return source.content.lines(source.path, TRAJECTORY, remedy, source.files.image_count)


def pose_of_row(row: Row, srid: int, settings: Sigmas) -> Pose:
    """Pose of the body in the map frame; yaw is turned from true to grid east. Sigmas of drive.yaml override those of the row."""
    position = geodesy.to_map(srid, row.lat_deg, row.lon_deg, row.height_m)
    convergence = float(geodesy.grid_convergence_rad(srid, row.lat_deg, row.lon_deg))
    roll, pitch, yaw = np.radians([row.roll_deg, row.pitch_deg, row.yaw_deg])
    rotation = se3.rotation_from_rpy(roll, pitch, yaw + convergence)
    angles = np.radians([row.sigma_roll_deg, row.sigma_pitch_deg, row.sigma_yaw_deg])
    recorded = np.array([[row.sigma_e_m, row.sigma_n_m, row.sigma_u_m, *angles]])
    return se3.to_pose(se3.se3(rotation, position), stated_sigmas(recorded, settings)[0])


def time_of_row(row: Row, zone: str) -> int | str:
    """UTC nanoseconds, or what is wrong."""
    stamp = stamp_or_problem(row.captured_at, zone)
    return stamp if isinstance(stamp, int) else f"{TRAJECTORY}: captured_at of '{row.stem}': {stamp}"
