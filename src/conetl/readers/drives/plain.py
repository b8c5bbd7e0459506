"""Plain drive folders: the least that a two-camera rig with a trajectory can deliver.

    drive/left/*.{jpg,png}, drive/right/*.{jpg,png}   images as rig.yaml describes them, the same stem for both of a pair
    drive/trajectory.csv                              one row a pair, the pose of the body at the exposure, see `Row`
    drive/rig.yaml                                    the rig, with body_SE3_left, see calibration_files/rig_yaml.py
    drive/drive.yaml                                  optional, see drive_yaml.py (cameras and calibration do not apply)

The row number in trajectory.csv, from 0, is the pair's frame_index. Angles are those of OXTS: body x forward, y left, z up, yaw
counted from true east counter-clockwise, pitch positive with the front down, roll positive with the left side up.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from conetl.geometry import geodesy
from conetl.geometry import pose as se3
from conetl.geometry import rig as rigs
from conetl.model.errors import CalibrationError, DriveFolderError
from conetl.model.records import Drive, FramePair, Pose, Rig
from conetl.model.rejections import Rejection, RejectionReason
from conetl.readers.drives import oxts
from conetl.readers.drives.content import ContentHash
from conetl.readers.drives.drive_yaml import DRIVE_YAML, DriveYaml, read_drive_yaml
from conetl.readers.drives.pairs import IMAGE_SUFFIXES, PairError, check_images, images_ahead, require_pairs
from conetl.readers.drives.timestamps import misplaced, parse_timestamp
from conetl.readers.rigs import RIG_YAML, read_rig_yaml
from conetl.readers.rigs.common import rectified_rig

TRAJECTORY = "trajectory.csv"
Sigma = Annotated[float, Field(gt=0, le=1000)]


class Row(BaseModel):
    """One row of trajectory.csv; the columns may stand in any order."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    stem: str = Field(min_length=1)
    captured_at: str
    """Like 2026-03-01 12:00:00.123456789, UTC or the time zone of drive.yaml, or with its own offset (Z, +01:00)."""
    lon_deg: float = Field(ge=-180, le=180)
    lat_deg: float = Field(ge=-90, le=90)
    height_m: float = Field(ge=-20_000, le=20_000)
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


def is_plain_folder(folder: Path) -> bool:
    """True where a folder looks like a plain drive, whole or not."""
    return (folder / TRAJECTORY).is_file() or ((folder / "left").is_dir() and (folder / "right").is_dir())


def read_plain_drive(
    folder: Path, *, map_srid: int | None = None, headers_only: bool = False
) -> tuple[Drive, list[Rejection]]:
    """A plain drive and its rejections; see `kitti.read_kitti_drive` for the rules that both share."""
    root = folder.resolve()
    content = ContentHash(headers_only=headers_only)
    settings = read_drive_yaml(root)
    rig = read_plain_rig(root, settings, content)
    left, right = _images(root / "left", folder), _images(root / "right", folder)
    stems = sorted(left.keys() | right.keys())
    if not stems:
        raise DriveFolderError(f"{folder}: there are no images (*.jpg, *.png) in left and right")
    rows, numbers = _read_rows(root, folder, content)
    good = [row for row in rows.values() if isinstance(row, Row)]
    if not good:
        first = next((str(row) for row in rows.values()), "the file has no rows")
        raise DriveFolderError(f"{folder / TRAJECTORY}: not one usable pose: {first}")
    srid, poses = _poses(good, map_srid or settings.map_srid, folder)
    times = {row.stem: time_of_row(row, settings.timestamps_timezone) for row in good}
    for stem, text in _jumps(poses, times).items():
        rows[stem] = f"{TRAJECTORY}, stem '{stem}': {text}"
    # Pairs are ordered by row; a stem that has none comes last and only serves to name the rejection.
    order = {stem: numbers.get(stem, len(rows) + i) for i, stem in enumerate(stems)}
    wrong_times = misplaced({order[stem]: t for stem in stems if isinstance(t := times.get(stem), int)})

    pairs: list[FramePair] = []
    rejections: list[Rejection] = []
    for stem in images_ahead(sorted(stems, key=lambda stem: order[stem]), left, right, content):
        try:
            images = check_images(left.get(stem, []), right.get(stem, []), rig, content, root)
            if stem not in rows:
                raise PairError(RejectionReason.POSE_MISSING, f"{TRAJECTORY} has no row with the stem '{stem}'")
            if not isinstance(rows[stem], Row):
                raise PairError(RejectionReason.POSE_INVALID, str(rows[stem]))
            captured = times[stem]
            if isinstance(captured, str):
                raise PairError(RejectionReason.TIMESTAMP_INVALID, captured)
            if order[stem] in wrong_times:
                raise PairError(
                    RejectionReason.TIMESTAMP_INVALID,
                    f"{TRAJECTORY}: captured_at of '{stem}' {wrong_times[order[stem]]}",
                )
        except PairError as error:
            rejections.append(error.rejection(f"frame pair '{stem}'", order[stem]))
        else:
            pairs.append(
                FramePair(
                    frame_index=order[stem], left_path=str(images[0].path), right_path=str(images[1].path),
                    captured_at_ns=captured, pose=poses[stem],
                    left_sha256=images[0].sha256, right_sha256=images[1].sha256,
                )
            )  # fmt: skip
    require_pairs(pairs, rejections, len(stems), folder)
    drive = Drive(
        drive_id=settings.id_of(root), source_path=str(root), rig=rig, map_srid=srid,
        content_sha256=content.hexdigest(), frame_pairs=tuple(pairs), expected_frame_count=len(stems),
    )  # fmt: skip
    return drive, rejections


def read_plain_rig(root: Path, settings: DriveYaml, content: ContentHash) -> Rig:
    """The rectified rig, which must tell how the left camera sits on the body; its file goes into the content hash.

    A rig.yaml with lenses or turned cameras describes raw images: they are resampled when they are read.
    """
    path = root / RIG_YAML
    if not path.is_file():
        raise CalibrationError(
            f"{root}: {RIG_YAML} is missing; it describes the two cameras and how they sit on the body"
        )
    rig = read_rig_yaml(path)
    if rigs.body_is_left_camera(rig):
        raise CalibrationError(
            f"{path}: 'body_SE3_left' is missing; the poses of {TRAJECTORY} are those of the body, so it must be told how the "
            "left camera sits on it (R and t_m, from camera points to body points)"
        )
    for name in (RIG_YAML, DRIVE_YAML):
        if (root / name).is_file():
            content.add(name, (root / name).read_bytes())
    changes = {"sigma_px": settings.sigmas.image_px} if "image_px" in settings.sigmas.model_fields_set else {}
    rig = rig.model_copy(update=changes | ({"rig_id": settings.rig_id} if settings.rig_id else {}))
    return rectified_rig(rig, path)


def _poses(rows: Sequence[Row], srid: int | None, folder: Path) -> tuple[int, dict[str, Pose]]:
    """EPSG code of the map and the poses in it by stem. Raises DriveFolderError."""
    first = rows[0]
    try:
        srid = srid or geodesy.utm_srid(first.lat_deg, first.lon_deg)
        geodesy.check_map_srid(srid)
        geodesy.check_scale(srid, first.lat_deg, first.lon_deg)
        return srid, {row.stem: pose_of_row(row, srid) for row in rows}
    except ValueError as error:
        raise DriveFolderError(f"{folder}: {error}") from error


def _jumps(poses: Mapping[str, Pose], times: Mapping[str, int | str]) -> dict[str, str]:
    """Stems whose place cannot be true, as in `oxts.jumps`."""
    timed = sorted((time, stem) for stem, time in times.items() if isinstance(time, int))
    places = np.array([se3.map_SE3_body(poses[stem]) for _, stem in timed]).reshape(-1, 4, 4)
    numbers = list(range(len(timed)))
    track = oxts.Trajectory(numbers, places, np.zeros((len(timed), 3)), {n: timed[n][0] for n in numbers})
    return {timed[number][1]: text for number, text in oxts.jumps(track).items()}


def _images(data: Path, folder: Path) -> dict[str, list[Path]]:
    """Images by stem."""
    if not data.is_dir():
        raise DriveFolderError(
            f"{folder}: the folder {data.name} is missing; expected left/ and right/ with the same stems"
        )
    found: dict[str, list[Path]] = {}
    for path in sorted(data.iterdir()):
        if path.suffix.lower() in IMAGE_SUFFIXES and not path.name.startswith("."):
            found.setdefault(path.stem, []).append(path)
    return found


def _read_rows(root: Path, folder: Path, content: ContentHash) -> tuple[dict[str, Row | str], dict[str, int]]:
    """Rows, or what is wrong with them, and row numbers, both by stem."""
    path = root / TRAJECTORY
    if not path.is_file():
        raise DriveFolderError(f"{folder}: {TRAJECTORY} is missing; it holds one row with the pose of each pair")
    data = path.read_bytes()
    content.add(TRAJECTORY, data)
    reader = csv.DictReader(io.StringIO(data.decode("utf-8-sig", errors="replace"), newline=""))
    wanted, header = set(Row.model_fields), set(reader.fieldnames or ())
    if wanted != header:
        wrong = [f"missing {', '.join(sorted(wanted - header))}"] if wanted - header else []
        wrong += [f"not known {', '.join(sorted(str(name) for name in header - wanted))}"] if header - wanted else []
        raise DriveFolderError(f"{folder / TRAJECTORY}: the columns do not fit: {'; '.join(wrong)}")
    rows: dict[str, Row | str] = {}
    numbers: dict[str, int] = {}
    for number, values in enumerate(reader):
        stem = str(values.get("stem") or f"row {number}")
        place = f"{TRAJECTORY}, row {number}"
        try:
            row: Row | str = Row.model_validate({str(key): value for key, value in values.items()})
        except ValidationError as error:
            first = error.errors()[0]
            row = f"{place}: {'.'.join(str(part) for part in first['loc'])}: {first['msg']}, found {first['input']!r}"
        if stem in rows:
            row = f"{place}: the stem '{stem}' stands in two rows; keep one"
        numbers.setdefault(stem, number)
        rows[stem] = row
    return rows, numbers


def pose_of_row(row: Row, srid: int) -> Pose:
    """Pose of the body in the map frame; yaw is turned from true to grid east."""
    x, y, z = (float(c) for c in geodesy.to_map(srid, row.lat_deg, row.lon_deg, row.height_m))
    convergence = float(geodesy.grid_convergence_rad(srid, row.lat_deg, row.lon_deg))
    roll, pitch, yaw = np.radians([row.roll_deg, row.pitch_deg, row.yaw_deg])
    sigmas = (math.radians(row.sigma_roll_deg), math.radians(row.sigma_pitch_deg), math.radians(row.sigma_yaw_deg))
    return Pose(
        map_R_body=se3.to_matrix3(se3.rotation_from_rpy(roll, pitch, yaw + convergence)), map_t_body_m=(x, y, z),
        sigma_enu_m=(row.sigma_e_m, row.sigma_n_m, row.sigma_u_m), sigma_rpy_rad=sigmas,
    )  # fmt: skip


def time_of_row(row: Row, zone: str) -> int | str:
    """UTC nanoseconds, or what is wrong."""
    try:
        return parse_timestamp(row.captured_at, zone)
    except ValueError as error:
        return f"{TRAJECTORY}: captured_at of '{row.stem}': {error}"
