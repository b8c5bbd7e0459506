"""Records as columns of the database's tables (see sql/migrations), ready for COPY."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from uuid import UUID

import numpy as np

from conetl.db.copy_binary import (
    Column,
    bigints,
    booleans,
    constant_uuid,
    double_arrays,
    doubles,
    integers,
    jsons,
    points,
    texts,
    timestamps_from_ns,
    uuids,
)
from conetl.db.map.jacobian_arrays import jacobian_columns
from conetl.model.map_records import Delta, FeatureVersion, MapFeature
from conetl.model.records import Detection, FramePair, Position, StereoMatch, Track
from conetl.model.rejections import Rejection

Columns = dict[str, Column]
_COV_NAMES = ("xx", "xy", "xz", "yy", "yz", "zz")


def frame_pair_columns(drive_uuid: UUID, srid: int, pairs: Sequence[FramePair]) -> Columns:
    """Table frame_pair."""
    return {
        "drive_uuid": constant_uuid(drive_uuid, len(pairs)),
        "frame_index": integers([p.frame_index for p in pairs]),
        "left_path": texts([p.left_path for p in pairs]),
        "right_path": texts([p.right_path for p in pairs]),
        "captured_at_ns": bigints([p.captured_at_ns for p in pairs]),
        "geom": points([p.pose.map_t_body_m for p in pairs], srid),
        "map_r_body": double_arrays(np.reshape([p.pose.map_R_body for p in pairs], (-1, 9))),
        "sigma_enu_m": double_arrays(np.reshape([p.pose.sigma_enu_m for p in pairs], (-1, 3))),
        "sigma_rpy_rad": double_arrays(np.reshape([p.pose.sigma_rpy_rad for p in pairs], (-1, 3))),
    }


def detection_columns(drive_uuid: UUID, detections: Sequence[Detection]) -> Columns:
    """Table detection."""
    return {
        "drive_uuid": constant_uuid(drive_uuid, len(detections)),
        "frame_index": integers([d.frame_index for d in detections]),
        "side": texts([d.side for d in detections]),
        "detection_index": integers([d.detection_index for d in detections]),
        "category": texts([d.category for d in detections]),
        "x_px": doubles([d.x_px for d in detections]),
        "y_px": doubles([d.y_px for d in detections]),
        "w_px": doubles([d.w_px for d in detections]),
        "h_px": doubles([d.h_px for d in detections]),
        "score": doubles([d.score for d in detections]),
    }


def match_columns(drive_uuid: UUID, matches: Sequence[StereoMatch]) -> Columns:
    """Table stereo_match."""
    columns = {
        "drive_uuid": constant_uuid(drive_uuid, len(matches)),
        "frame_index": integers([m.frame_index for m in matches]),
        "match_index": integers([m.match_index for m in matches]),
        "left_detection_index": integers([m.left.detection_index for m in matches]),
        "right_detection_index": integers([m.right.detection_index for m in matches]),
    }
    for point in ("foot", "centre", "tip"):
        for side in ("left", "right"):
            uv_px = np.reshape([getattr(m, f"{point}_{side}_uv_px") for m in matches], (-1, 2))
            columns[f"{point}_{side}_u_px"] = doubles(uv_px[:, 0])
            columns[f"{point}_{side}_v_px"] = doubles(uv_px[:, 1])
    return columns | {
        "sigma_u_px": doubles([m.sigma_u_px for m in matches]),
        "sigma_v_px": doubles([m.sigma_v_px for m in matches]),
        "sigma_pointing_px": doubles([m.sigma_pointing_px for m in matches]),
        "refined": booleans([m.refined for m in matches]),
        "cost": doubles([m.cost for m in matches]),
    }


def position_columns(drive_uuid: UUID, srid: int, positions: Sequence[Position]) -> Columns:
    """Table position."""
    camera = np.reshape([p.camera_xyz_m for p in positions], (-1, 3))
    return {
        "drive_uuid": constant_uuid(drive_uuid, len(positions)),
        "frame_index": integers([p.frame_index for p in positions]),
        "match_index": integers([p.match_index for p in positions]),
        "geom": points([p.xyz_m for p in positions], srid),
        **_covariance("cov", [p.cov_m2 for p in positions]),
        "centre_geom": points([p.centre_xyz_m for p in positions], srid),
        "cone_height_m": doubles([p.cone_height_m for p in positions]),
        "camera_x_m": doubles(camera[:, 0]),
        "camera_y_m": doubles(camera[:, 1]),
        "camera_z_m": doubles(camera[:, 2]),
        **_covariance("camera_cov", [p.camera_cov_m2 for p in positions]),
        "range_m": doubles([p.range_m for p in positions]),
        "ray_angle_rad": doubles([p.ray_angle_rad for p in positions]),
        "residual_rms_px": doubles([p.residual_rms_px for p in positions]),
        "iterations": integers([p.iterations for p in positions]),
        "score": doubles([p.score for p in positions]),
    }


def track_columns(drive_uuid: UUID, srid: int, tracks: Sequence[Track]) -> Columns:
    """Table track."""
    return {
        "drive_uuid": constant_uuid(drive_uuid, len(tracks)),
        "track_index": integers([t.track_index for t in tracks]),
        **cone_columns(srid, tracks),
        **_covariance("relative_cov", [t.relative_cov_m2 for t in tracks]),
        "residual_rms_px": doubles([t.residual_rms_px for t in tracks]),
        "nearest_range_m": doubles([t.nearest_range_m for t in tracks]),
    }


def track_member_columns(drive_uuid: UUID, tracks: Sequence[Track]) -> Columns:
    """Table track_member: which positions a track is made of."""
    members = np.reshape([(t.track_index, *member) for t in tracks for member in t.members], (-1, 3))
    return {
        "drive_uuid": constant_uuid(drive_uuid, len(members)),
        "track_index": integers(members[:, 0]),
        "frame_index": integers(members[:, 1]),
        "match_index": integers(members[:, 2]),
    }


def delta_columns(srid: int, deltas: Sequence[Delta], suppressed: Collection[UUID] = ()) -> Columns:
    """Temporary table delta_stage: one row per delta, with the state of the feature that follows from it.

    A removed feature keeps its last state, marked as not present. suppressed: features that end up where a person said that
    nothing stands.
    """
    states = [delta.state_after for delta in deltas]
    return {
        "feature_id": uuids([d.feature_id for d in deltas]),
        "kind": texts([d.kind.value for d in deltas]),
        "old_version": integers([d.old.version if d.old else None for d in deltas]),
        "is_change": booleans([d.is_change for d in deltas]),
        "track_index": integers([d.track_index for d in deltas]),
        "changed_at_ns": bigints([d.changed_at_ns for d in deltas]),
        "changed_at": timestamps_from_ns([d.changed_at_ns for d in deltas]),
        "shift_m": doubles([d.shift_m for d in deltas]),
        **_evidence_columns(deltas),
        "present": booleans([d.new is not None and d.feature_id not in suppressed for d in deltas]),
        "suppressed": booleans([d.new is not None and d.feature_id in suppressed for d in deltas]),
        **cone_columns(srid, states),
    }


def version_columns(srid: int, versions: Sequence[FeatureVersion]) -> Columns:
    """Temporary table version_stage: whole versions, as they are believed from now on."""
    return {
        "feature_id": uuids([v.feature.feature_id for v in versions]),
        "version": integers([v.feature.version for v in versions]),
        "changeset_id": uuids([v.changeset_id for v in versions]),
        "present": booleans([v.present and not v.suppressed for v in versions]),
        "suppressed": booleans([v.suppressed for v in versions]),
        **cone_columns(srid, [v.feature for v in versions]),
        "valid_from_ns": bigints([v.valid_from_ns for v in versions]),
        "valid_from": timestamps_from_ns([v.valid_from_ns for v in versions]),
        "valid_to": timestamps_from_ns([0 if v.valid_to_ns is None else v.valid_to_ns for v in versions]),
        "is_open": booleans([v.valid_to_ns is None for v in versions]),
    }


def replayed_delta_columns(changes: Sequence[tuple[UUID, Delta]]) -> Columns:
    """Temporary table replayed_delta_stage: (changeset, delta) as they are believed from now on."""
    deltas = [delta for _, delta in changes]
    return {
        "changeset_id": uuids([changeset_id for changeset_id, _ in changes]),
        "feature_id": uuids([d.feature_id for d in deltas]),
        "kind": texts([d.kind.value for d in deltas]),
        "old_version": integers([d.old.version if d.old else None for d in deltas]),
        "new_version": integers([version_after(d) for d in deltas]),
        "track_index": integers([d.track_index for d in deltas]),
        "changed_at_ns": bigints([d.changed_at_ns for d in deltas]),
        "changed_at": timestamps_from_ns([d.changed_at_ns for d in deltas]),
        "shift_m": doubles([d.shift_m for d in deltas]),
        **_evidence_columns(deltas),
    }


def _evidence_columns(deltas: Sequence[Delta]) -> Columns:
    values = [evidence_values(delta) for delta in deltas]
    ratios, existence, seen, empty = zip(*values, strict=True) if values else ((), (), (), ())
    return {
        "other_feature_id": uuids([d.other_feature_id for d in deltas]),
        "log_likelihood_ratio": doubles(ratios),
        "existence_after": doubles(existence),
        "frames_seen": integers(seen),
        "frames_empty": integers(empty),
    }


def evidence_values(delta: Delta) -> tuple[float | None, float | None, int | None, int | None]:
    """log_likelihood_ratio, existence_after, frames_seen, frames_empty of a delta's row."""
    e = delta.evidence
    return (
        (None, None, None, None)
        if e is None
        else (e.log_likelihood_ratio, e.existence_probability, e.frames_seen, e.frames_empty)
    )


def version_after(delta: Delta) -> int:
    """Number of the version that follows from a delta: the old one's where a confirmation changed nothing."""
    if delta.old is None:
        return delta.state_after.version
    return delta.old.version + 1 if delta.is_change else delta.old.version


def rejection_columns(changeset_id: UUID, rejections: Sequence[Rejection]) -> Columns:
    """Table quarantine."""
    return {
        "changeset_id": constant_uuid(changeset_id, len(rejections)),
        "step": texts([r.step for r in rejections]),
        "reason": texts([r.reason.value for r in rejections]),
        "record": texts([r.record for r in rejections]),
        "detail": texts([r.detail for r in rejections]),
        "payload": jsons([r.payload for r in rejections]),
    }


def cone_columns(srid: int, cones: Sequence[Track] | Sequence[MapFeature]) -> Columns:
    """What tracks, feature versions and statements of imported maps have in common."""
    return {
        "category": texts([c.category for c in cones]),
        "geom": points([c.xyz_m for c in cones], srid),
        **_covariance("cov", [c.cov_m2 for c in cones]),
        "centre_geom": points([c.centre_xyz_m for c in cones], srid),
        "cone_height_m": doubles([c.cone_height_m for c in cones]),
        "cone_height_sigma_m": doubles([c.cone_height_sigma_m for c in cones]),
        "existence_probability": doubles([c.existence_probability for c in cones]),
        "observation_count": integers([c.observation_count for c in cones]),
        "first_seen_ns": bigints([c.first_seen_ns for c in cones]),
        "last_seen_ns": bigints([c.last_seen_ns for c in cones]),
        **jacobian_columns([c.shared_jacobian for c in cones]),
    }


def _covariance(prefix: str, covariances: Sequence[tuple[float, ...]]) -> Columns:
    values = np.reshape(covariances, (-1, 6))
    return {f"{prefix}_{name}": doubles(values[:, i]) for i, name in enumerate(_COV_NAMES)}
