"""Makers of small valid records, as most tests need them, and of changesets of a map that is not that of a drive."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from typing import Any
from uuid import UUID, uuid5

from conetl.db.map.commit import add_drive, commit_changeset
from conetl.db.map.map_store import map_transaction
from conetl.db.map.replay_store import read_versions
from conetl.evaluation.truth import TruthCone
from conetl.mapping.existence_update import missed
from conetl.mapping.history import MapUpdate, next_rows
from conetl.model.base import Cov3
from conetl.model.drive import Detection, Drive, DriveRecords, FramePair, Pose, Position, StereoMatch, Track
from conetl.model.feature_classes import CONE, LANE_MARKING
from conetl.model.map_records import (
    Changeset,
    Decisions,
    Delta,
    DeltaKind,
    ExistenceEvidence,
    FeatureVersion,
    MapFeature,
)
from conetl.model.markings import Marking, MarkingTrack
from conetl.model.rig import SIDES, Camera, Rig, Side
from conetl.pipeline.replay import replay_of_newest

SRID = 32632
DAY_NS = 86_400_000_000_000
#: 2026-03-01 08:00:00 UTC
START_NS = 1_772_352_000_000_000_000
_IDENTITY4 = ((1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0))
COV_M2 = (0.01, 0.001, 0.0, 0.02, 0.0, 0.04)
#: Of a drive after which a feature is gone.
ABSENT = ExistenceEvidence(log_likelihood_ratio=-6.0, existence_probability=0.05, frames_seen=0, frames_empty=9)
_NAMESPACE = UUID("00000000-0000-4000-8000-000000000000")


def drive(
    drive_id: str = "drive_a",
    *,
    start_ns: int = START_NS,
    frames: int = 3,
    srid: int = SRID,
    content_sha256: str | None = None,
) -> Drive:
    camera = Camera(width_px=1242, height_px=375, fx_px=721.5, fy_px=721.5, cx_px=609.6, cy_px=172.9)
    right = ((1.0, 0.0, 0.0, 0.532), *_IDENTITY4[1:])
    pose = Pose(
        map_R_body=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
        map_t_body_m=(458_000.5, 5_428_000.25, 115.125),
        sigma_enu_m=(0.3, 0.3, 0.5),
        sigma_rpy_rad=(0.001, 0.001, 0.002),
    )
    return Drive(
        drive_id=drive_id,
        source_path=f"drives/{drive_id}",
        rig=Rig(rig_id="rig", left=camera, right=camera, body_SE3_left=_IDENTITY4, body_SE3_right=right),
        map_srid=srid,
        content_sha256=content_sha256 or hashlib.sha256(drive_id.encode()).hexdigest(),
        frame_pairs=tuple(
            FramePair(
                frame_index=i,
                left_path=f"image_02/data/{i:010d}.png",
                right_path=f"image_03/data/{i:010d}.png",
                captured_at_ns=start_ns + i * 100_000_000 + 7,
                pose=pose,
            )
            for i in range(frames)
        ),
        expected_frame_count=frames,
    )


def box(
    x_px: float,
    y_px: float,
    w_px: float,
    h_px: float,
    *,
    frame: int = 0,
    side: Side = "left",
    index: int = 0,
    **more: Any,
) -> Detection:
    values: dict[str, Any] = {"frame_index": frame, "side": side, "detection_index": index, "score": 0.9}
    return Detection(x_px=x_px, y_px=y_px, w_px=w_px, h_px=h_px, **values | more)


def detections(frames: int = 3) -> list[Detection]:
    return [box(600.5, 180, 20, 30, frame=i, side=side) for i in range(frames) for side in SIDES[: 1 + (i != 1)]]


def matches(frames: int = 3) -> list[StereoMatch]:
    """In frame pair 1 the network found the object in the left image only (`detections`)."""
    boxes = {(box.frame_index, box.side): box for box in detections(frames)}
    return [
        StereoMatch(
            frame_index=i,
            match_index=0,
            left=boxes.get((i, "left")),
            right=boxes.get((i, "right")),
            foot_left_uv_px=(610.0, 210.0),
            foot_right_uv_px=(580.0, 210.0),
            centre_left_uv_px=(610.0, 195.0),
            centre_right_uv_px=(580.0, 195.0),
            tip_left_uv_px=(610.0, 180.0),
            tip_right_uv_px=(580.0, 180.0),
            sigma_u_px=0.2,
            sigma_v_px=0.5,
            sigma_pointing_px=0.4,
            refined=True,
            cost=0.1,
        )
        for i in range(frames)
    ]


def position(frame_index: int = 0, match_index: int = 0, **changes: Any) -> Position:
    values: dict[str, Any] = {
        "frame_index": frame_index,
        "match_index": match_index,
        "cov_m2": COV_M2,
        "object_height_m": 0.7,
        "xyz_m": (458_001.0, 5_428_010.0, 114.5),
        "centre_xyz_m": (458_001.0, 5_428_010.0, 114.85),
        "camera_xyz_m": (0.5, 1.6, 12.0),
        "camera_cov_m2": COV_M2,
        "range_m": 12.0,
        "ray_angle_rad": 0.04,
        "residual_rms_px": 0.3,
        "iterations": 3,
        "score": 0.9,
    }
    return Position(**values | changes)


def positions(frames: int = 3) -> list[Position]:
    return [position(i) for i in range(frames)]


def track(track_index: int = 0, frames: int = 3, *, seen_ns: int = START_NS + 7, **changes: Any) -> Track:
    values: dict[str, Any] = {
        "track_index": track_index,
        "relative_cov_m2": COV_M2,
        "existence_probability": 0.97,
        "object_height_sigma_m": 0.02,
        "observation_count": frames,
        "first_seen_ns": seen_ns,
        "last_seen_ns": seen_ns + (frames - 1) * 100_000_000,
        "residual_rms_px": 0.3,
        "nearest_range_m": 9.0,
        "members": tuple((i, 0) for i in range(frames)),
    }
    return Track(**values | standing_at((458_001.0, 5_428_010.0, 114.5)) | changes)


def truth_cone(name: str, xyz_m: Sequence[float], height_m: float = 0.7, category: str = CONE) -> TruthCone:
    """A surveyed cone, UTM 32."""
    x, y, z = map(float, xyz_m)
    return TruthCone(
        cone_id=name, category=category, easting_m=x, northing_m=y, height_ellipsoidal_m=z, cone_height_m=height_m, map_srid=32632
    )  # fmt: skip


def feature(name: str | int = "cone", *, seen_ns: int = START_NS, **changes: Any) -> MapFeature:
    """By a name or by the number that is its id."""
    values: dict[str, Any] = {
        "feature_id": UUID(int=name) if isinstance(name, int) else uuid5(_NAMESPACE, name),
        "version": 1,
        "category": "traffic_cone",
        "object_height_sigma_m": 0.02,
        "existence_probability": 0.97,
        "observation_count": 3,
        "seen_count": 1,
        "first_seen_ns": seen_ns,
        "last_seen_ns": seen_ns + 200_000_000,
    }
    return MapFeature(**values | standing_at((458_001.0, 5_428_010.0, 114.5)) | changes)


def marking(vertices_m: Sequence[Sequence[float]], *, cov_m2: Cov3 = COV_M2, **changes: Any) -> Marking:
    """A solid white line, or what the changes say."""
    values: dict[str, Any] = {
        "vertices_m": tuple(tuple(map(float, xyz_m)) for xyz_m in vertices_m),
        "cov_m2": (cov_m2,) * len(vertices_m),
        "width_m": 0.12,
        "width_sigma_m": 0.01,
        "colour": "white",
        "pattern": "solid",
    }
    return Marking(**values | changes)


def marking_track(shape: Marking, marking_index: int = 0, *, seen_ns: int = START_NS, **changes: Any) -> MarkingTrack:
    values: dict[str, Any] = {
        "marking_index": marking_index,
        "category": LANE_MARKING,
        "marking": shape,
        "relative_cov_m2": shape.cov_m2,
        "existence_probability": 0.97,
        "observation_count": 12,
        "first_seen_ns": seen_ns,
        "last_seen_ns": seen_ns + 200_000_000,
        "contrast": 60.0,
        "blur_px": 0.9,
    }
    return MarkingTrack(**values | changes)


def line_feature(shape: Marking, name: str | int = "line", **changes: Any) -> MapFeature:
    """A stretch of a lane marking on the map."""
    middle_m = shape.vertices_m[len(shape.vertices_m) // 2]
    at = {"xyz_m": middle_m, "centre_xyz_m": middle_m, "cov_m2": shape.cov_m2[len(shape.cov_m2) // 2]}
    paint = {"category": LANE_MARKING, "marking": shape, "object_height_m": 0.003, "object_height_sigma_m": 0.002}
    return feature(name, **at | paint | changes)


def standing_at(xyz_m: Sequence[float], height_m: float = 0.7, cov_m2: Cov3 = COV_M2) -> dict[str, Any]:
    """What a cone's foot and height say of a feature or a track."""
    x, y, z = map(float, xyz_m)
    centre_xyz_m = (x, y, z + height_m / 2)
    return {"xyz_m": (x, y, z), "cov_m2": cov_m2, "centre_xyz_m": centre_xyz_m, "object_height_m": height_m}


def cov_of(sigma_m: float) -> Cov3:
    """Equal and independent along the axes."""
    return (sigma_m**2, 0.0, 0.0, sigma_m**2, 0.0, sigma_m**2)


def added(feature: MapFeature, **changes: Any) -> Delta:
    values = {"changed_at_ns": feature.first_seen_ns, "track_index": 0, "shift_m": None} | changes
    return Delta(kind=DeltaKind.ADDED, feature_id=feature.feature_id, old=None, new=feature, **values)


def removed(feature: MapFeature, at_ns: int) -> Delta:
    return Delta(
        kind=DeltaKind.REMOVED,
        feature_id=feature.feature_id,
        old=feature,
        new=None,
        track_index=None,
        changed_at_ns=at_ns,
        shift_m=None,
        evidence=ABSENT,
    )


def not_seen(old: MapFeature, at_ns: int, existence_probability: float = 0.6) -> Delta:
    """A miss."""
    evidence = ABSENT.model_copy(update={"existence_probability": existence_probability})
    new = missed(old, existence_probability, at_ns)
    return Delta(
        kind=DeltaKind.MISSED, feature_id=old.feature_id, old=old, new=new, changed_at_ns=at_ns, evidence=evidence
    )


def changed(kind: str, old: MapFeature, at_ns: int, **changes: Any) -> Delta:
    own = {"version": old.version + 1, "seen_count": old.seen_count + 1, "first_missed_ns": None}
    new = old.model_copy(update=own | changes)
    shift_m = ((new.xyz_m[0] - old.xyz_m[0]) ** 2 + (new.xyz_m[1] - old.xyz_m[1]) ** 2) ** 0.5
    return Delta(
        kind=DeltaKind(kind),
        feature_id=old.feature_id,
        old=old,
        new=new,
        track_index=0,
        changed_at_ns=at_ns,
        shift_m=shift_m,
    )


def changeset(*deltas: Delta, drive_id: str = "drive_a", key: str = "1") -> Changeset:
    return Changeset(
        changeset_id=uuid5(_NAMESPACE, f"changeset {key}"),
        drive_id=drive_id,
        idempotency_key=key * (64 // len(key)),
        params_sha256="cd" * 32,
        model_sha256="ef" * 32,
        code_version="0.1.0",
        deltas=tuple(deltas),
    )


def commit(
    conn: Any,
    *deltas: Delta,
    key: str,
    start_ns: int = START_NS,
    map_name: str = "default",
    srid: int = SRID,
    markings: Sequence[MarkingTrack] = (),
    **options: Any,
) -> Any:
    """Commit a small drive with these deltas; `key` is one or more hex digits, different for every drive."""
    # Recorded at the same instant; the content puts them into the order of their keys.
    made = drive(f"drive_{key}", start_ns=start_ns, srid=srid, content_sha256=f"{int(key, 16):064x}")
    records = DriveRecords(made, detections(), matches(), positions(), [track()], (), markings)
    with map_transaction(conn, map_name):
        return write(conn, records, changeset(*deltas, drive_id=made.drive_id, key=key), map_name=map_name, **options)


def write(conn: Any, records: DriveRecords, made: Changeset, *, map_name: str = "default", **options: Any) -> Any:
    """`commit_changeset` of made-up deltas, of a drive that is newer than all others around it."""
    placed = add_drive(conn, records.drive, made.idempotency_key, map_name=map_name)
    standing: dict[UUID, dict[FeatureVersion, int]] = {}
    for row, row_id in read_versions(conn, [placed])[0].items():
        standing.setdefault(row.feature_id, {})[row] = row_id
    replay = replay_of_newest(standing, update_of(made, standing), made.changeset_id)
    return commit_changeset(conn, records, made, map_name=map_name, replay=replay, drive_uuid=placed, **options)


def update_of(made: Changeset, standing: Mapping[UUID, Mapping[FeatureVersion, int]]) -> MapUpdate:
    """What made-up deltas change; standing: the rows of the features."""
    current = {feature_id: next(reversed(rows)) for feature_id, rows in standing.items()}
    return MapUpdate([*made.deltas], next_rows(made.deltas, current, made.changeset_id, Decisions()))
