"""Records as columns of the database's tables (see sql/migrations), ready for COPY."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from operator import attrgetter
from typing import Any
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
from conetl.db.map.rows import jacobian_columns
from conetl.model.map_records import Delta, FeatureVersion, MapFeature
from conetl.model.records import Detection, FramePair, Position, StereoMatch, Track
from conetl.model.rejections import Rejection

Columns = dict[str, Column]
_COV_NAMES = ("xx", "xy", "xz", "yy", "yz", "zz")


def frame_pair_columns(drive_uuid: UUID, srid: int, pairs: Sequence[FramePair]) -> Columns:
    """Table frame_pair."""
    poses = [pair.pose for pair in pairs]
    return {
        "drive_uuid": constant_uuid(drive_uuid, len(pairs)),
        **_attributes(pairs, integers, "frame_index"),
        **_attributes(pairs, texts, "left_path", "right_path"),
        **_attributes(pairs, bigints, "captured_at_ns"),
        "geom": points([p.map_t_body_m for p in poses], srid),
        "map_r_body": double_arrays(np.reshape([p.map_R_body for p in poses], (-1, 9))),
        "sigma_enu_m": double_arrays(np.reshape([p.sigma_enu_m for p in poses], (-1, 3))),
        "sigma_rpy_rad": double_arrays(np.reshape([p.sigma_rpy_rad for p in poses], (-1, 3))),
    }


def detection_columns(drive_uuid: UUID, detections: Sequence[Detection]) -> Columns:
    """Table detection."""
    return {
        "drive_uuid": constant_uuid(drive_uuid, len(detections)),
        **_attributes(detections, integers, "frame_index", "detection_index"),
        **_attributes(detections, texts, "side", "category"),
        **_attributes(detections, doubles, "x_px", "y_px", "w_px", "h_px", "score"),
    }


def match_columns(drive_uuid: UUID, matches: Sequence[StereoMatch]) -> Columns:
    """Table stereo_match."""
    columns = {
        "drive_uuid": constant_uuid(drive_uuid, len(matches)),
        **_attributes(matches, integers, "frame_index", "match_index"),
        "left_detection_index": integers([m.left.detection_index for m in matches]),
        "right_detection_index": integers([m.right.detection_index for m in matches]),
        **_attributes(matches, doubles, "sigma_u_px", "sigma_v_px", "sigma_pointing_px", "cost"),
        **_attributes(matches, booleans, "refined"),
    }
    for point in ("foot", "centre", "tip"):
        for side in ("left", "right"):
            uv_px = np.reshape([getattr(m, f"{point}_{side}_uv_px") for m in matches], (-1, 2))
            columns[f"{point}_{side}_u_px"] = doubles(uv_px[:, 0])
            columns[f"{point}_{side}_v_px"] = doubles(uv_px[:, 1])
    return columns


def position_columns(drive_uuid: UUID, srid: int, positions: Sequence[Position]) -> Columns:
    """Table position."""
    camera = np.reshape([p.camera_xyz_m for p in positions], (-1, 3))
    return {
        "drive_uuid": constant_uuid(drive_uuid, len(positions)),
        **_attributes(positions, integers, "frame_index", "match_index", "iterations"),
        "geom": points([p.xyz_m for p in positions], srid),
        **_covariance("cov", [p.cov_m2 for p in positions]),
        "centre_geom": points([p.centre_xyz_m for p in positions], srid),
        **{f"camera_{axis}_m": doubles(camera[:, i]) for i, axis in enumerate("xyz")},
        **_covariance("camera_cov", [p.camera_cov_m2 for p in positions]),
        **_attributes(positions, doubles, "cone_height_m", "range_m", "ray_angle_rad", "residual_rms_px", "score"),
    }


def track_columns(drive_uuid: UUID, srid: int, tracks: Sequence[Track]) -> Columns:
    """Table track."""
    return {
        "drive_uuid": constant_uuid(drive_uuid, len(tracks)),
        **_attributes(tracks, integers, "track_index"),
        **cone_columns(srid, tracks),
        **_covariance("relative_cov", [t.relative_cov_m2 for t in tracks]),
        **_attributes(tracks, doubles, "residual_rms_px", "nearest_range_m"),
    }


def track_member_columns(drive_uuid: UUID, tracks: Sequence[Track]) -> Columns:
    """Table track_member: the positions of each track."""
    members = np.reshape([(t.track_index, *member) for t in tracks for member in t.members], (-1, 3))
    return {
        "drive_uuid": constant_uuid(drive_uuid, len(members)),
        "track_index": integers(members[:, 0]),
        "frame_index": integers(members[:, 1]),
        "match_index": integers(members[:, 2]),
    }


def delta_columns(srid: int, deltas: Sequence[Delta], suppressed: Collection[UUID] = ()) -> Columns:
    """Temporary table delta_stage: one row per delta, with the resulting state of the feature.

    A removed feature keeps its last state, marked as not present. suppressed: features that end where a person decided that
    nothing stands.
    """
    return {
        **_change_columns(deltas),
        **_attributes(deltas, booleans, "is_change"),
        "present": booleans([d.new is not None and d.feature_id not in suppressed for d in deltas]),
        "suppressed": booleans([d.new is not None and d.feature_id in suppressed for d in deltas]),
        **cone_columns(srid, [delta.state_after for delta in deltas]),
    }


def replayed_delta_columns(changes: Sequence[tuple[UUID, Delta]]) -> Columns:
    """Temporary table replayed_delta_stage: (changeset, delta) as they hold from now on."""
    deltas = [delta for _, delta in changes]
    return {
        "changeset_id": uuids([changeset_id for changeset_id, _ in changes]),
        "new_version": integers([version_after(d) for d in deltas]),
        **_change_columns(deltas),
    }


def version_columns(srid: int, versions: Sequence[FeatureVersion]) -> Columns:
    """Temporary table version_stage: whole versions, as they hold from now on."""
    return {
        **cone_columns(srid, [v.feature for v in versions]),
        "feature_id": uuids([v.feature.feature_id for v in versions]),
        "version": integers([v.feature.version for v in versions]),
        **_attributes(versions, uuids, "changeset_id"),
        "present": booleans([v.present and not v.suppressed for v in versions]),
        **_attributes(versions, booleans, "suppressed"),
        **_attributes(versions, bigints, "valid_from_ns"),
        "valid_from": timestamps_from_ns([v.valid_from_ns for v in versions]),
        "valid_to": timestamps_from_ns([0 if v.valid_to_ns is None else v.valid_to_ns for v in versions]),
        "is_open": booleans([v.valid_to_ns is None for v in versions]),
    }


def evidence_values(delta: Delta) -> tuple[float | None, float | None, int | None, int | None]:
    """log_likelihood_ratio, existence_after, frames_seen, frames_empty of a delta's row."""
    e = delta.evidence
    if e is None:
        return None, None, None, None
    return e.log_likelihood_ratio, e.existence_probability, e.frames_seen, e.frames_empty


def version_after(delta: Delta) -> int:
    """Number of the version after a delta: the old one's if a confirmation changed nothing."""
    if delta.old is None:
        return delta.state_after.version
    return delta.old.version + 1 if delta.is_change else delta.old.version


def rejection_columns(changeset_id: UUID, rejections: Sequence[Rejection]) -> Columns:
    """Table quarantine; the order of the columns determines that of the rows, see `copy_binary.encode`."""
    return {
        "changeset_id": constant_uuid(changeset_id, len(rejections)),
        **_attributes(rejections, texts, "step"),
        "reason": texts([r.reason.value for r in rejections]),
        **_attributes(rejections, texts, "record", "detail"),
        **_attributes(rejections, jsons, "payload"),
    }


def cone_columns(srid: int, cones: Sequence[Track] | Sequence[MapFeature]) -> Columns:
    """What tracks, feature versions and statements of imported maps have in common."""
    return {
        **_attributes(cones, texts, "category"),
        "geom": points([c.xyz_m for c in cones], srid),
        **_covariance("cov", [c.cov_m2 for c in cones]),
        "centre_geom": points([c.centre_xyz_m for c in cones], srid),
        **_attributes(cones, doubles, "cone_height_m", "cone_height_sigma_m", "existence_probability"),
        **_attributes(cones, integers, "observation_count"),
        **_attributes(cones, bigints, "first_seen_ns", "last_seen_ns"),
        **jacobian_columns([c.shared_jacobian for c in cones]),
    }


def _change_columns(deltas: Sequence[Delta]) -> Columns:
    evidence = [evidence_values(delta) for delta in deltas]
    ratios, existence, seen, empty = zip(*evidence, strict=True) if evidence else ((), (), (), ())
    return {
        **_attributes(deltas, uuids, "feature_id", "other_feature_id"),
        "kind": texts([d.kind.value for d in deltas]),
        "old_version": integers([d.old.version if d.old else None for d in deltas]),
        **_attributes(deltas, integers, "track_index"),
        **_attributes(deltas, bigints, "changed_at_ns"),
        "changed_at": timestamps_from_ns([d.changed_at_ns for d in deltas]),
        **_attributes(deltas, doubles, "shift_m"),
        "log_likelihood_ratio": doubles(ratios),
        "existence_after": doubles(existence),
        "frames_seen": integers(seen),
        "frames_empty": integers(empty),
    }


def _attributes(records: Sequence[Any], encode: Callable[[list[Any]], Column], *names: str) -> Columns:
    """Columns that are named as the attributes."""
    return {name: encode(list(map(attrgetter(name), records))) for name in names}


def _covariance(prefix: str, covariances: Sequence[tuple[float, ...]]) -> Columns:
    values = np.reshape(covariances, (-1, 6))
    return {f"{prefix}_{name}": doubles(values[:, i]) for i, name in enumerate(_COV_NAMES)}
