"""Drives read back from the database: everything needed to compare one with the map again, except its images.

Numbers come back to the last bit, so the result of another comparison is that of the first one.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from functools import lru_cache, partial
from typing import NamedTuple
from uuid import UUID

import numpy as np

from conetl.checks.verdict import judge
from conetl.db.connection import Connection, read, stream, stream_values
from conetl.db.copy_rows import json_text
from conetl.db.map.import_store import read_statements
from conetl.db.map.results import DriveRef
from conetl.db.map.rows import Row, covariances, marking_of, read_jacobian, record_of
from conetl.mapping.history import DriveEvidence, founding_key
from conetl.mapping.visibility import DriveObservations, observations_of_drive, visibility_checks
from conetl.model.detector_evidence import UNMEASURED_ABSENCE, AbsenceFigures
from conetl.model.drive import Detection, Drive, FramePair, Pose, Track
from conetl.model.health import ADJOINING
from conetl.model.markings import MarkingTrack
from conetl.model.params import ReconcileParams
from conetl.model.rig import Rig

_UNREAD = "The drives of the map cannot be read"
#: Eastings and northings of places, and half the side of the square around each, in metres of the map's CRS.
Squares = tuple[Sequence[float], Sequence[float], float]


#: Views of drives are large; a merge needs them one after the other.
_VIEWS_IN_MEMORY = 2


def read_evidence(conn: Connection, drives: Sequence[DriveRef]) -> list[DriveEvidence]:
    """The evidence of ingested drives, and of imported maps, which had nothing in view. Views are read on demand."""
    headers: dict[UUID, Row] = {}

    @lru_cache(maxsize=_VIEWS_IN_MEMORY)
    def view_of(drive_uuid: UUID) -> DriveObservations:
        return read_view(conn, headers[drive_uuid])

    evidence = []
    for ref in drives:
        what, drive_uuid = f"Drive {ref.drive_uuid} cannot be read", ref.drive_uuid
        [header] = read(conn, what, "drives.header", drive_uuid=drive_uuid)
        headers[drive_uuid] = header
        statements = read_statements(conn, drive_uuid) if header["rig"] is None else []
        path: Iterable[tuple[float, ...]] = (s.feature.xyz_m[:2] for s in statements)
        if header["rig"] is not None:
            path = stream_values(conn, what, "drives.path", drive_uuid=drive_uuid)
        params = ReconcileParams.model_validate(header["reconcile"])
        markings = [_marking_track(row) for row in stream(conn, what, "drives.marking_tracks", drive_uuid=drive_uuid)]
        visible, in_view = visibility_checks(partial(view_of, drive_uuid), markings, params)
        evidence.append(
            DriveEvidence(
                key=(header["captured_from_ns"], header["content_sha256"], ref.idempotency_key),
                changeset_id=ref.changeset_id,
                founding_key=founding_key(header["id_name"], header["content_sha256"]),
                tracks=read_tracks(conn, drive_uuid),
                path_m=np.array(list(path)).reshape(-1, 2),
                influence_m=header["influence_m"],
                check_visibility=visible,
                markings=markings,
                check_view=in_view,
                params=params,
                judge=judge,
                imported=statements,
            )
        )
    return evidence


def read_tracks(conn: Connection, drive_uuid: UUID) -> list[Track]:
    """The tracks of an ingested drive, in order; [] of an imported map."""
    rows = stream(conn, f"Drive {drive_uuid} cannot be read", "drives.tracks", drive_uuid=drive_uuid)
    return [
        record_of(Track, row, members=tuple(map(tuple, row["members"])), shared_jacobian=read_jacobian(row))
        for row in rows
    ]


class ConcurrentDrive(NamedTuple):
    """A stored drive that may be another delivery of a recording."""

    drive_uuid: UUID
    drive_id: str
    changeset_no: int
    rig: Rig
    is_alike: bool
    """Whether it has the id and the length of the recording."""


def drives_at_the_same_time(
    conn: Connection, drive: Drive, path_wkt: str, same_ns: int, *, map_name: str
) -> list[ConcurrentDrive]:
    """Active drives with other content that may be another delivery of a drive which is not stored yet.

    They were near its path at the same time; or have its id and length, or passed the same positions at the same intervals, at
    any time. path_wkt: its path (line, map CRS); same_ns: tolerance of the intervals.
    """
    captured_from_ns, captured_to_ns = drive.captured_ns
    eastings_m, northings_m, _ = zip(*(pair.pose.map_t_body_m for pair in drive.frame_pairs), strict=True)
    rows = read(
        conn, _UNREAD, "drives.drives_at_the_same_time", map_name=map_name, drive_id=drive.drive_id,
        at_ns=[pair.captured_at_ns for pair in drive.frame_pairs], eastings_m=list(eastings_m),
        northings_m=list(northings_m), same_ns=same_ns,
        content_sha256=drive.content_sha256, captured_from_ns=captured_from_ns, captured_to_ns=captured_to_ns,
        frame_count=drive.expected_frame_count, path_wkt=path_wkt, srid=drive.map_srid,
    )  # fmt: skip
    return [ConcurrentDrive(**row | {"rig": Rig.model_validate(row["rig"])}) for row in rows]


def drives_with_boxes(
    conn: Connection, drive: Drive, boxes: Sequence[tuple[float, ...]], *, map_name: str, **limits: float
) -> list[ConcurrentDrive]:
    """Active drives with other content whose left images have the boxes of a drive, at the same positions and intervals.

    boxes: time stamp (ns), easting, northing (m) of the image, left, top, width, height (px), at least one; limits: of the query.
    """
    names = ("at_ns", "eastings_m", "northings_m", "x_px", "y_px", "w_px", "h_px")
    columns = dict(zip(names, map(list, zip(*boxes, strict=True)), strict=True))
    size = {"width_px": drive.rig.left.width_px, "height_px": drive.rig.left.height_px}
    own = {"map_name": map_name, "content_sha256": drive.content_sha256, "srid": drive.map_srid}
    rows = read(conn, _UNREAD, "drives.drives_with_boxes", **own, **size, **columns, **limits)
    return [ConcurrentDrive(**row | {"rig": Rig.model_validate(row["rig"])}) for row in rows]


class DriveElsewhere(NamedTuple):
    """Another drive of the same rig."""

    drive_id: str
    apart_m: float
    """Distance of its area from the path of the drive."""
    apart_s: float
    """Time between them; 0 where they overlap."""


def same_rig_elsewhere(
    conn: Connection, drive: Drive, path_wkt: str, *, map_name: str, most_m_s: float, apart_m: float
) -> DriveElsewhere | None:
    """The nearest active drive in time, of the same `rig_id`, that is farther away than `apart_m` and the speed `most_m_s` allow.

    path_wkt: path of the drive (line, map CRS), which is not stored yet.
    """
    captured_from_ns, captured_to_ns = drive.captured_ns
    rows = read(
        conn, _UNREAD, "drives.same_rig_elsewhere", map_name=map_name, rig_id=drive.rig.rig_id, drive_id=drive.drive_id,
        captured_from_ns=captured_from_ns, captured_to_ns=captured_to_ns, path_wkt=path_wkt, srid=drive.map_srid,
        most_m_s=most_m_s, apart_m=apart_m,
    )  # fmt: skip
    return DriveElsewhere(**rows[0]) if rows else None


class AdjoiningDrive(NamedTuple):
    """A drive that counts, or that the map holds, recorded immediately before or after another one."""

    drive_uuid: UUID
    drive_id: str
    rig: Rig
    captured_from_ns: int
    on_hold: bool
    """For the check of adjoining drives."""
    accepted: bool
    """By a person."""


def adjoining_drives(
    conn: Connection, drive_uuids: Collection[UUID], within_ns: int
) -> list[tuple[UUID, AdjoiningDrive]]:
    """Drives that ended at most within_ns before, or began at most within_ns after, one of drive_uuids; and these themselves if
    active.

    Each comes with the one of drive_uuids that it adjoins; in the order of recording.
    """
    of = {"drive_uuids": list(drive_uuids), "within_ns": within_ns, "check": json_text([{"name": ADJOINING}])}
    rows = read(conn, _UNREAD, "drives.adjoining_drives", **of)
    return [(row.pop("of_uuid"), AdjoiningDrive(**row | {"rig": Rig.model_validate(row["rig"])})) for row in rows]


def read_ends(conn: Connection, drive_uuids: Collection[UUID], count: int) -> dict[UUID, list[FramePair]]:
    """The first and the last `count` frame pairs of some drives, by time."""
    found: dict[UUID, list[FramePair]] = {}
    for row in stream(conn, _UNREAD, "drives.frame_pairs_at_ends", drive_uuids=list(drive_uuids), count=count):
        found.setdefault(row["drive_uuid"], []).append(_frame_pair(row))
    return found


def read_view(conn: Connection, drive: Row, near: Squares | None = None) -> DriveObservations:
    """What a drive had in view, and what was detected and located there.

    drive: its drive_uuid, rig and absence_figures, as stored. near: only frame pairs recorded there.
    """
    drive_uuid, figures = drive["drive_uuid"], drive["absence_figures"]
    frame_pairs = read_frame_pairs(conn, drive_uuid, near)
    frames = None if near is None else [pair.frame_index for pair in frame_pairs]
    what, wanted = f"Drive {drive_uuid} cannot be read", {"drive_uuid": drive_uuid, "frames": frames}
    positions = stream_values(conn, what, "drives.positions", **wanted)
    spots = [(frame_index, category, (x, y, z)) for frame_index, category, x, y, z in positions]
    detections = [Detection.model_construct(**row) for row in stream(conn, what, "drives.detections", **wanted)]
    known = AbsenceFigures.model_validate(figures) if figures else UNMEASURED_ABSENCE
    return observations_of_drive(Rig.model_validate(drive["rig"]), frame_pairs, detections, spots, known)


def read_frame_pairs(conn: Connection, drive_uuid: UUID, near: Squares | None = None) -> list[FramePair]:
    """Frame pairs with their poses, in order. near: only those recorded there."""
    squares = dict(zip(("eastings_m", "northings_m", "within_m"), near or (None, None, None), strict=True))
    what = f"Drive {drive_uuid} cannot be read"
    return [_frame_pair(row) for row in stream(conn, what, "drives.frame_pairs", drive_uuid=drive_uuid, **squares)]


def _frame_pair(row: Row) -> FramePair:
    r = row["map_r_body"]
    rotation = (tuple(r[:3]), tuple(r[3:6]), tuple(r[6:]))
    pose = record_of(Pose, row, map_R_body=rotation, interpolated=None)
    return record_of(FramePair, row, pose=pose, left_sha256="", right_sha256="")


def _marking_track(row: Row) -> MarkingTrack:
    return record_of(
        MarkingTrack, row, marking=marking_of(row), relative_cov_m2=covariances(row["relative_cov"]), image_cov_m2=(),
        shared_jacobian=read_jacobian(row),
    )  # fmt: skip
