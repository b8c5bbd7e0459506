"""Drives read back from the database: everything needed to compare one with the map again, except its images.

Numbers come back to the last bit, so the result of another comparison is that of the first one.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any, NamedTuple
from uuid import UUID

import numpy as np
from numpy.typing import NDArray

from conetl.db.connection import Connection, database_errors, execute, load_sql, stream
from conetl.db.copy_binary import json_text
from conetl.db.map.import_store import read_statements
from conetl.db.map.marking_rows import covariances, marking_of
from conetl.db.map.rows import jacobian_from_wire
from conetl.model.detector_evidence import UNMEASURED_ABSENCE, AbsenceFigures
from conetl.model.errors import MapMismatchError
from conetl.model.health import ADJOINING
from conetl.model.map_records import DriveOrder, ImportedFeature
from conetl.model.markings import MarkingTrack
from conetl.model.params import ReconcileParams
from conetl.model.records import Detection, Drive, FramePair, Pose, Rig, Track, Vec3, sound

_DETECTION = ("frame_index", "side", "detection_index", "category", "x_px", "y_px", "w_px", "h_px", "score")


#: Easting, northing and half the side of a square, in metres of the map's CRS.
Square = tuple[float, float, float]


@dataclass(frozen=True)
class StoredDrive:
    """The small part of a drive: its header, its path, its tracks and lane markings."""

    id_name: str
    content_sha256: str
    captured_from_ns: int
    rig: Rig | None
    """None of an imported map."""
    reconcile: ReconcileParams
    influence_m: float
    figures: AbsenceFigures
    """Of the drive's detector."""
    path_m: NDArray[np.float64]
    """(N, 2), a row per frame pair; of an imported map, its stated positions."""
    tracks: list[Track]
    markings: list[MarkingTrack]
    statements: list[ImportedFeature]
    """Of an imported map, instead of tracks."""

    def key(self, idempotency_key: str) -> DriveOrder:
        return self.captured_from_ns, self.content_sha256, idempotency_key


@dataclass(frozen=True)
class StoredView:
    """The large part of a drive: what was visible, and what was seen."""

    frame_pairs: list[FramePair]
    detections: list[Detection]
    spots: list[tuple[int, str, Vec3]]
    """Frame index, class and xyz of every position."""


def load_stored_drive(conn: Connection, drive_uuid: UUID) -> StoredDrive:
    """Header, path, tracks and lane markings of an ingested drive. Raises MapMismatchError if it does not exist."""
    parameters = {"drive_uuid": drive_uuid}
    with database_errors(f"Drive {drive_uuid} cannot be read"):
        headers = execute(conn, load_sql("drives.header"), parameters)
        if not headers:
            raise MapMismatchError(f"there is no drive {drive_uuid} in this database")
        header = headers[0]
        rig = None if header["rig"] is None else Rig.model_validate(header["rig"])
        statements = read_statements(conn, drive_uuid) if rig is None else []
        path = stream(conn, load_sql("drives.path"), parameters) if rig else (s.feature.xyz_m[:2] for s in statements)
        figures = header["absence_figures"]
        return StoredDrive(
            id_name=header["id_name"],
            content_sha256=header["content_sha256"],
            captured_from_ns=header["captured_from_ns"],
            rig=rig,
            reconcile=ReconcileParams.model_validate(header["reconcile"]),
            influence_m=header["influence_m"],
            figures=AbsenceFigures.model_validate(figures) if figures else UNMEASURED_ABSENCE,
            path_m=np.array(list(path)).reshape(-1, 2),
            tracks=[_track(row) for row in stream(conn, load_sql("drives.tracks"), parameters)],
            markings=[_marking_track(row) for row in stream(conn, load_sql("drives.marking_tracks"), parameters)],
            statements=statements,
        )


class DriveThen(NamedTuple):
    """A drive of another recording that was around at the same time."""

    drive_uuid: UUID
    drive_id: str
    changeset_no: int
    rig: Rig


def drives_at_the_same_time(
    conn: Connection, drive: Drive, captured_ns: tuple[int, int], path_wkt: str, *, map_name: str
) -> list[DriveThen]:
    """The drives that count, of other ids and content, whose areas and times meet those of a drive that is not stored yet.

    captured_ns: instants of its first and last frame pair; path_wkt: its path (line, map CRS).
    """
    parameters = {
        "map_name": map_name,
        "drive_id": drive.drive_id,
        "content_sha256": drive.content_sha256,
        "captured_from_ns": captured_ns[0],
        "captured_to_ns": captured_ns[1],
        "path_wkt": path_wkt,
        "srid": drive.map_srid,
    }
    with database_errors("The drives of the map cannot be read"):
        rows = execute(conn, load_sql("drives.drives_at_the_same_time"), parameters)
    return [DriveThen(**row | {"rig": Rig.model_validate(row["rig"])}) for row in rows]


class AdjoiningDrive(NamedTuple):
    """A drive that counts, or that the map holds, recorded right before or after another one."""

    drive_uuid: UUID
    drive_id: str
    rig: Rig
    captured_from_ns: int
    on_hold: bool
    """For the check of adjoining drives."""


def adjoining_drives(
    conn: Connection, drive_uuids: Collection[UUID], within_ns: int
) -> list[tuple[UUID, AdjoiningDrive]]:
    """Drives that ended at most within_ns before, or began after, some drives; and these themselves, unless they are not active.

    Each comes with the one of drive_uuids that it adjoins; in the order of the fold.
    """
    parameters = {
        "drive_uuids": list(drive_uuids),
        "within_ns": within_ns,
        "check": json_text([{"name": ADJOINING}]),
    }
    with database_errors("The drives of the map cannot be read"):
        rows = execute(conn, load_sql("drives.adjoining_drives"), parameters)
    return [(row.pop("of_uuid"), AdjoiningDrive(**row | {"rig": Rig.model_validate(row["rig"])})) for row in rows]


def trusted_drives(
    conn: Connection, drive_uuids: Collection[UUID], least_confirmed: int, before_ns: int
) -> frozenset[UUID]:
    """Those of some drives that a person accepted, or that the map confirms (`mapping.agreement.is_confirmed`, as stored)."""
    parameters = {"drive_uuids": list(drive_uuids), "least_confirmed": least_confirmed, "before_ns": before_ns}
    with database_errors("The drives of the map cannot be read"):
        rows = execute(conn, load_sql("drives.trusted_drives"), parameters)
    return frozenset(row["drive_uuid"] for row in rows)


def read_ends(conn: Connection, drive_uuids: Collection[UUID], count: int) -> dict[UUID, list[FramePair]]:
    """The first and the last `count` frame pairs of some drives, in the order of their time."""
    parameters = {"drive_uuids": list(drive_uuids), "count": count}
    found: dict[UUID, list[FramePair]] = {}
    with database_errors("The drives of the map cannot be read"):
        for row in stream(conn, load_sql("drives.frame_pairs_at_ends"), parameters):
            found.setdefault(row[11], []).append(_frame_pair(row))
    return found


def read_view(conn: Connection, drive_uuid: UUID, near: Square | None = None) -> StoredView:
    """Frame pairs with their poses, detections and positions. near: only frame pairs recorded there."""
    frame_pairs = read_frame_pairs(conn, drive_uuid, near)
    frames = None if near is None else [pair.frame_index for pair in frame_pairs]
    parameters = {"drive_uuid": drive_uuid, "frames": frames}
    with database_errors(f"Drive {drive_uuid} cannot be read"):
        return StoredView(
            frame_pairs=frame_pairs,
            detections=[
                Detection.model_construct(**dict(zip(_DETECTION, row, strict=True)))
                for row in stream(conn, load_sql("drives.detections"), parameters)
            ],
            spots=[(row[0], row[1], row[2:]) for row in stream(conn, load_sql("drives.positions"), parameters)],
        )


def read_frame_pairs(conn: Connection, drive_uuid: UUID, near: Square | None = None) -> list[FramePair]:
    """Frame pairs with their poses, in order. near: only those recorded there."""
    square = dict(zip(("easting_m", "northing_m", "within_m"), near or (None, None, None), strict=True))
    with database_errors(f"Drive {drive_uuid} cannot be read"):
        rows = stream(conn, load_sql("drives.frame_pairs"), {"drive_uuid": drive_uuid} | square)
        return [_frame_pair(row) for row in rows]


def _frame_pair(row: tuple[Any, ...]) -> FramePair:
    return FramePair.model_construct(
        frame_index=row[0],
        left_path=row[1],
        right_path=row[2],
        captured_at_ns=row[3],
        pose=Pose.model_construct(
            map_R_body=(tuple(row[7][:3]), tuple(row[7][3:6]), tuple(row[7][6:])),
            map_t_body_m=row[4:7],
            sigma_enu_m=tuple(row[8]),
            sigma_rpy_rad=tuple(row[9]),
        ),
        left_sha256="",
        right_sha256="",
        detail=row[10],
    )


def _track(row: tuple[Any, ...]) -> Track:
    return Track.model_construct(
        track_index=row[0],
        category=row[1],
        xyz_m=row[2:5],
        cov_m2=row[5:11],
        relative_cov_m2=row[11:17],
        centre_xyz_m=row[17:20],
        cone_height_m=row[20],
        cone_height_sigma_m=row[21],
        existence_probability=row[22],
        observation_count=row[23],
        first_seen_ns=row[24],
        last_seen_ns=row[25],
        residual_rms_px=row[26],
        nearest_range_m=row[27],
        members=tuple((frame, match) for frame, match in row[28]),
        shared_jacobian=None if row[29] is None else jacobian_from_wire(row[29]),
    )


def _marking_track(row: tuple[Any, ...]) -> MarkingTrack:
    return sound(
        MarkingTrack,
        marking_index=row[0],
        category=row[1],
        marking=marking_of(row[10:]),
        relative_cov_m2=covariances(row[2]),
        existence_probability=row[3],
        observation_count=row[4],
        first_seen_ns=row[5],
        last_seen_ns=row[6],
        contrast=row[7],
        blur_px=row[8],
        shared_jacobian=None if row[9] is None else jacobian_from_wire(row[9]),
    )
