"""The drives that passed a feature, and what their frame pairs show at its position; and the sentence for each of its changes."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from datetime import datetime
from typing import Any, Literal, NamedTuple
from uuid import UUID

import numpy as np

from conetl.db import serve_store as store
from conetl.db.connection import Connection, stream_values
from conetl.db.map.drive_store import read_view
from conetl.geometry import pose as se3
from conetl.geometry.rig import camera_of, map_SE3_camera
from conetl.mapping.reasons import ChangeFacts, explain_change
from conetl.mapping.visibility import DriveObservations, pairs_in_view, visible_pairs
from conetl.model.arrays import Floats
from conetl.model.base import Record, Vec3, utc_from_ns
from conetl.model.drive import Pose
from conetl.model.feature_classes import CONE, LINE_CLASSES, noun_of
from conetl.model.map_records import DeltaKind
from conetl.model.params import ReconcileParams
from conetl.model.rig import Rig, Side
from conetl.reports.camera_images import Box
from conetl.tracking.matching.apparent_boxes import apparent_boxes

#: Farther from a cone no detector sees it.
_WITHIN_M = 60.0
_NEIGHBOUR_M = 6.0
#: Sentences that say from which distance the position was visible: of removals, then of the latest misses.
_MAX_ABSENCES = 40
#: Facts of a change that are columns of the same name.
_OF_ROW = (
    "drive_id",
    "existence_probability",
    "frames_empty",
    "shift_m",
    "sigma_m",
    "object_height_m",
    "other_feature_id",
)
Row = Mapping[str, Any]
FrameState = Literal["observed", "empty", "occupied", "hidden"]


class PassFrame(Record):
    """A frame pair of a drive that contains the position of a feature, or an observation of it."""

    frame_index: int
    captured_at: datetime
    range_m: float
    """From the left camera to the foot."""
    state: FrameState
    """observed: the drive's observation of the feature; empty: the position was visible, and no cone was observed; occupied: a
    detection that is not part of the feature; hidden: by a nearer detection, or the image shows too little."""
    camera_xyz_m: Vec3
    """Left camera; in the map's CRS, in answers of the server from the map's origin."""


class DrivePass(Record):
    """One drive past a feature."""

    changeset_no: int
    drive_id: str
    drive_uuid: UUID
    captured_from: datetime
    counts: bool
    kind: DeltaKind | None
    """What the drive did to the feature; null where it judged nothing."""
    frames: tuple[PassFrame, ...]
    """In the order of the recording."""


def passes_of(
    conn: Connection,
    map_name: str,
    feature_id: UUID,
    state: Row,
    *,
    max_drives: int,
    only: Sequence[UUID] | None = None,
) -> list[DrivePass]:
    """The drives that have a feature in view, the latest first. state: a row of serving.feature_history; only: drive_uuids.

    As `check_visibility` decided, but for the drive's common offset, which is not stored: a count may differ by a frame pair.
    """
    observed = store.observed_frames(conn, map_name, feature_id)
    past = {"easting_m": state["easting_m"], "northing_m": state["northing_m"], "drive_uuids": only}
    found = []
    for row in store.read_rows(conn, "judging.drives_past", map_name=map_name, max_rows=max_drives, **past):
        kind, frames = observed.get(row["drive_uuid"]) or (None, dict[int, int]())
        in_view = _frames_in_view(_read_near(conn, row, [state], feature_id), state, frames)
        if in_view:
            known = {name: row[name] for name in ("changeset_no", "drive_id", "drive_uuid", "counts")}
            at = utc_from_ns(row["captured_from_ns"])
            found.append(DrivePass(**known, captured_from=at, kind=DeltaKind(kind) if kind else None, frames=in_view))
    return found


class _Near(NamedTuple):
    """What a drive had in view near some places."""

    drive: DriveObservations
    tracks_m: Floats
    """(M, 3) others than that of the feature."""
    params: ReconcileParams


def _read_near(conn: Connection, header: Row, states: Sequence[Row], feature_id: UUID | None = None) -> _Near:
    """At once for all places. header: of drives.header; feature_id: whose track is left out."""
    drive_uuid = header["drive_uuid"]
    eastings_m, northings_m = ([state[name] for state in states] for name in ("easting_m", "northing_m"))
    drive = read_view(conn, header, (eastings_m, northings_m, _WITHIN_M))
    tracks = stream_values(
        conn, "The tracks of a drive cannot be read", "judging.tracks_near", drive_uuid=drive_uuid, feature_id=feature_id,
        eastings_m=eastings_m, northings_m=northings_m, within_m=_NEIGHBOUR_M,
    )  # fmt: skip
    tracks_m = np.array(list(tracks), np.float64).reshape(-1, 3)
    return _Near(drive, tracks_m, ReconcileParams.model_validate(header["reconcile"]))


def _frames_in_view(near: _Near, state: Row, observed: Collection[int]) -> tuple[PassFrame, ...]:
    drive, others_m, params = near
    if not drive.frames:
        return ()
    foot_m = np.array([state["easting_m"], state["northing_m"], state["ellipsoidal_height_m"]])
    height_m, category = state["object_height_m"], state["category"]
    visible = {pair.row: pair.occupied for pair in visible_pairs(foot_m, height_m, others_m, drive, params, category)}
    states: dict[int, FrameState] = {}
    for row in pairs_in_view(foot_m, height_m, drive, params, category)[0].tolist():
        states[row] = "hidden" if row not in visible else "occupied" if visible[row] else "empty"
    states |= {row: "observed" for row, frame in enumerate(drive.frames) if frame in observed}
    cameras_m = drive.map_SE3_left[:, :3, 3]
    within = np.abs(cameras_m - foot_m)[:, :2].max(axis=1) <= _WITHIN_M  # other frame pairs are near other places
    return tuple(
        PassFrame(
            frame_index=drive.frames[row],
            captured_at=utc_from_ns(int(drive.captured_at_ns[row])),
            range_m=float(np.linalg.norm(cameras_m[row] - foot_m)),
            state=states[row],
            camera_xyz_m=tuple(cameras_m[row].tolist()),
        )
        for row in sorted(states)
        if within[row]
    )


def pose_of(row: Row, prefix: str = "") -> Pose:
    """The pose of a frame pair of `judging.frame`, without its sigmas."""
    rotation = np.reshape(row["map_r_body"], (3, 3)).tolist()
    position_m = tuple(row[f"{prefix}{name}"] for name in ("easting_m", "northing_m", "ellipsoidal_height_m"))
    zeros = (0.0, 0.0, 0.0)
    return Pose(map_R_body=rotation, map_t_body_m=position_m, sigma_enu_m=zeros, sigma_rpy_rad=zeros)


def expected_box(
    xyz_m: Vec3, object_height_m: float, pose: Pose, rig: Rig, side: Side, category: str = CONE
) -> Box | None:
    """x, y, width, height (px, from the image's edge) of an object at a position; None behind the camera."""
    camera_SE3_map = se3.invert(map_SE3_camera(pose, rig, side))
    ends = np.array([xyz_m, (*xyz_m[:2], xyz_m[2] + object_height_m)])
    foot, tip = ends @ camera_SE3_map[:3, :3].T + camera_SE3_map[:3, 3]
    x0, y0, x1, y1 = apparent_boxes(foot[None], tip[None], camera_of(rig, side), category)[0].tolist()
    return None if np.isnan(x0) else (x0 + 0.5, y0 + 0.5, x1 - x0, y1 - y0)


def reasons_of(conn: Connection, rows: Sequence[Row]) -> list[str]:
    """The sentence of `mapping.reasons` for each change. rows: with the columns of serving.feature_history that it needs."""
    points = [row for row in rows if row["category"] not in LINE_CLASSES]  # tracks of lines are numbered by themselves
    tracks = [(row["drive_uuid"], row["track_index"]) for row in points if row["track_index"] is not None]
    ranges = store.track_ranges(conn, list(dict.fromkeys(tracks)))
    absences = [row for row in reversed(points) if row["kind"] in (DeltaKind.REMOVED, DeltaKind.MISSED)]
    absences = sorted(absences, key=lambda row: row["kind"] == DeltaKind.MISSED)[:_MAX_ABSENCES]
    absent_ranges = _ranges_of_absences(conn, absences)
    sentences = []
    for row in rows:
        is_line = row["category"] in LINE_CLASSES
        found = None if is_line else ranges.get((row["drive_uuid"], row["track_index"]))
        near_m, far_m, frames = found or (None, None, None)
        range_m = (near_m, far_m) if near_m is not None and far_m is not None else None
        range_m = absent_ranges.get(id(row), range_m)
        facts = ChangeFacts(
            **{name: row[name] for name in _OF_ROW}, kind=DeltaKind(row["kind"]), is_import=row["drive_kind"] == "import",
            frames_seen=frames or row["frames_seen"], range_m=range_m, noun=noun_of(row["category"]),
        )  # fmt: skip
        sentences.append(explain_change(facts))
    return sentences


def _ranges_of_absences(conn: Connection, rows: Sequence[Row]) -> dict[int, tuple[float, float] | None]:
    """Nearest and farthest distance from which its drive had the position of each row in view, by id(row); None where the records
    of the drive were pruned. Each drive is read once."""
    by_drive: dict[UUID, list[Row]] = defaultdict(list)
    for row in rows:
        by_drive[row["drive_uuid"]].append(row)
    found: dict[int, tuple[float, float] | None] = {}
    for drive_uuid, some in by_drive.items():
        [header] = store.read_rows(conn, "drives.header", drive_uuid=drive_uuid)
        near = None if header["rig"] is None else _read_near(conn, header, some)
        found |= {id(row): None if near is None else _range_of(near, row) for row in some}
    return found


def _range_of(near: _Near, row: Row) -> tuple[float, float] | None:
    frames = _frames_in_view(near, row, ())
    shown = [frame.range_m for frame in frames if frame.state in ("empty", "occupied")] or [f.range_m for f in frames]
    return (min(shown), max(shown)) if shown else None
