"""Records as columns for COPY, and exact records from rows (unchecked)."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping, Sequence
from operator import attrgetter
from typing import Any, TypeVar
from uuid import UUID

import numpy as np
import shapely

from conetl.db import copy_rows as copy
from conetl.db.copy_rows import Columns
from conetl.geometry.packing import stack_rows
from conetl.model.base import Cov3, Record, SharedErrorJacobian
from conetl.model.columns import stored_names
from conetl.model.drive import Detection, FramePair, Position, StereoMatch, Track
from conetl.model.map_records import Delta, FeatureVersion, MapFeature
from conetl.model.markings import Marking, MarkingTrack
from conetl.model.rejections import Rejection

R = TypeVar("R", bound=Record)
Row = Mapping[str, Any]
_COV_NAMES = ("xx", "xy", "xz", "yy", "yz", "zz")
#: Bytes before the items of an array of one dimension and of three, and the offset of the former's length.
_HEAD_OF_ONE, _HEAD_OF_THREE, _LENGTH_AT = 20, 36, 12
_REALS = np.dtype([("length", ">i4"), ("value", ">f4")])
#: Bytes before the vertices in `ST_AsBinary`.
_WKB_HEAD = 9
#: Columns of lane markings alone.
_PAINT = stored_names("lines")
#: Columns of a delta's row in the order of `replay.current_deltas`. new_version: the old one if a confirmation changed nothing.
_CHANGE = (
    "feature_id", "kind", "old_version", "new_version", "track_index", "changed_at_ns", "shift_m", "other_feature_id",
    "log_likelihood_ratio", "existence_after", "frames_seen", "frames_empty",
)  # fmt: skip


def record_of(record_type: type[R], row: Row, **computed: Any) -> R:
    """A record from the columns named like its fields, and from `computed` values."""
    return record_type(**{name: computed[name] if name in computed else row[name] for name in record_type.model_fields})


def feature_of(row: Row) -> MapFeature:
    """Columns as in `map.features_as_of`."""
    return record_of(MapFeature, row, shared_jacobian=read_jacobian(row), marking=marking_of(row))


def version_of(row: Row) -> FeatureVersion:
    """Columns as in `map.current_versions`."""
    return record_of(FeatureVersion, row, feature=feature_of(row))


def frame_pair_columns(drive_uuid: UUID, srid: int, pairs: Sequence[FramePair]) -> Columns:
    """Table frame_pair."""
    poses = [pair.pose for pair in pairs]
    return {
        "drive_uuid": [drive_uuid] * len(pairs),
        **_attributes(pairs, "frame_index left_path right_path captured_at_ns detail"),
        "geom": copy.points([p.map_t_body_m for p in poses], srid),
        "map_r_body": copy.arrays(sum(p.map_R_body, ()) for p in poses),
        "sigma_enu_m": copy.arrays([p.sigma_enu_m for p in poses]),
        "sigma_rpy_rad": copy.arrays([p.sigma_rpy_rad for p in poses]),
    }


def detection_columns(drive_uuid: UUID, detections: Sequence[Detection]) -> Columns:
    """Table detection."""
    names = "frame_index detection_index side category x_px y_px w_px h_px score"
    return {"drive_uuid": [drive_uuid] * len(detections), **_attributes(detections, names)}


def match_columns(drive_uuid: UUID, matches: Sequence[StereoMatch]) -> Columns:
    """Table stereo_match."""
    columns: dict[str, Any] = {
        "drive_uuid": [drive_uuid] * len(matches),
        **_attributes(matches, "frame_index match_index refined sigma_u_px sigma_v_px sigma_pointing_px cost"),
        "left_detection_index": [m.left and m.left.detection_index for m in matches],
        "right_detection_index": [m.right and m.right.detection_index for m in matches],
    }
    for point in ("foot", "centre", "tip"):
        for side in ("left", "right"):
            uv_px = stack_rows([getattr(m, f"{point}_{side}_uv_px") for m in matches], 2)
            columns[f"{point}_{side}_u_px"] = uv_px[:, 0]
            columns[f"{point}_{side}_v_px"] = uv_px[:, 1]
    return columns


def position_columns(drive_uuid: UUID, srid: int, positions: Sequence[Position]) -> Columns:
    """Table position."""
    camera = stack_rows([p.camera_xyz_m for p in positions], 3)
    names = "frame_index match_index iterations range_m ray_angle_rad residual_rms_px score"
    return {
        "drive_uuid": [drive_uuid] * len(positions),
        **_location_columns(srid, positions),
        **{f"camera_{axis}_m": camera[:, i] for i, axis in enumerate("xyz")},
        **_covariance("camera_cov", [p.camera_cov_m2 for p in positions]),
        **_attributes(positions, names),
    }


def track_columns(drive_uuid: UUID, srid: int, tracks: Sequence[Track]) -> Columns:
    """Table track."""
    return {
        "drive_uuid": [drive_uuid] * len(tracks),
        **cone_columns(srid, tracks),
        **_covariance("relative_cov", [t.relative_cov_m2 for t in tracks]),
        **_attributes(tracks, "track_index residual_rms_px nearest_range_m"),
        "members": copy.arrays([sorted(track.members) for track in tracks]),
    }


def marking_track_columns(drive_uuid: UUID, srid: int, tracks: Sequence[MarkingTrack]) -> Columns:
    """Table marking_track."""
    seen = "observation_count existence_probability first_seen_ns last_seen_ns"
    return {
        "drive_uuid": [drive_uuid] * len(tracks),
        **_attributes(tracks, f"marking_index category contrast blur_px {seen}"),
        **marking_columns(srid, [track.marking for track in tracks]),
        "relative_cov": copy.arrays([track.relative_cov_m2 for track in tracks]),
        **jacobian_columns([track.shared_jacobian for track in tracks]),
    }


def replayed_delta_columns(changes: Sequence[tuple[UUID, Delta]]) -> Columns:
    """Temporary table replayed_delta_stage: the new (changeset, delta) pairs."""
    deltas = [delta for _, delta in changes]
    return {
        "changeset_id": [changeset_id for changeset_id, _ in changes],
        "of_line": [d.is_line for d in deltas],
        "changed_at": copy.timestamps_from_ns([d.changed_at_ns for d in deltas]),
        **_to_columns(_CHANGE, map(change_values, deltas)),
    }


def version_columns(srid: int, versions: Sequence[FeatureVersion]) -> Columns:
    """Temporary table version_stage: the new versions."""
    return {
        **cone_columns(srid, [v.feature for v in versions]),
        **marking_columns(srid, [v.feature.marking for v in versions]),
        **_attributes([v.feature for v in versions], "feature_id version seen_count missed_count first_missed_ns"),
        "present": [v.present and not v.suppressed for v in versions],
        **_attributes(versions, "changeset_id suppressed valid_from_ns"),
        "valid_from": copy.timestamps_from_ns([v.valid_from_ns for v in versions]),
        "valid_to": copy.timestamps_from_ns([0 if v.valid_to_ns is None else v.valid_to_ns for v in versions]),
        "is_open": [v.valid_to_ns is None for v in versions],
    }


def change_values(delta: Delta) -> tuple[Any, ...]:
    """Values of a delta for the columns `_CHANGE`."""
    e, old = delta.evidence, None if delta.old is None else delta.old.version
    new = delta.state_after.version if old is None else old + 1 if delta.is_change else old
    evidence: tuple[float | None, ...] = (None,) * 4
    if e is not None:
        evidence = e.log_likelihood_ratio, e.existence_probability, e.frames_seen, e.frames_empty
    return (
        delta.feature_id,
        delta.kind,
        old,
        new,
        delta.track_index,
        delta.changed_at_ns,
        delta.shift_m,
        delta.other_feature_id,
        *evidence,
    )


def rejection_columns(changeset_id: UUID, rejections: Sequence[Rejection]) -> Columns:
    """Table quarantine."""
    return {
        "changeset_id": [changeset_id] * len(rejections),
        **_attributes(rejections, "step reason record detail payload"),
    }


def cone_columns(srid: int, cones: Sequence[Track] | Sequence[MapFeature]) -> Columns:
    """Columns that tracks, feature versions and statements of imported maps share."""
    names = "object_height_sigma_m existence_probability observation_count first_seen_ns last_seen_ns"
    return {
        **_location_columns(srid, cones),
        **_attributes(cones, names),
        **jacobian_columns([c.shared_jacobian for c in cones]),
    }


def _attributes(records: Sequence[Any], names: str) -> Columns:
    """Columns named like attributes, at least two. Each record is read once: half the time."""
    return _to_columns(names.split(), map(attrgetter(*names.split()), records))


def _to_columns(names: Sequence[str], rows: Iterable[Sequence[Any]]) -> Columns:
    """Columns by name from rows that have a value for each."""
    return dict(zip(names, list(zip(*rows, strict=True)) or [()] * len(names), strict=True))


def _location_columns(srid: int, records: Sequence[Position] | Sequence[Track] | Sequence[MapFeature]) -> Columns:
    """Columns of class, foot, centre and height."""
    return {
        **_attributes(records, "category object_height_m"),
        "geom": copy.points([one.xyz_m for one in records], srid),
        **_covariance("cov", [one.cov_m2 for one in records]),
        "centre_geom": copy.points([one.centre_xyz_m for one in records], srid),
    }


def _covariance(prefix: str, covariances: Sequence[tuple[float, ...]]) -> Columns:
    values = stack_rows(covariances, 6)
    return {f"{prefix}_{name}": values[:, i] for i, name in enumerate(_COV_NAMES)}


def jacobian_columns(jacobians: Sequence[SharedErrorJacobian | None]) -> Columns:
    """The columns calibrations (uuid[]) and shared_jacobian_m (real[][][]) of some rows."""
    ids = [one and [str(key) for key in one.calibrations] for one in jacobians]
    moved_m = [
        one and np.frombuffer(one.moved_m, ">f4").reshape(len(one.calibrations), 3, -1).tolist() for one in jacobians
    ]
    return {"calibrations": copy.arrays(ids), "shared_jacobian_m": copy.arrays(moved_m)}


def read_jacobian(row: Row) -> SharedErrorJacobian | None:
    """The column shared_jacobian: both arrays as `array_send` makes them, concatenated."""
    if (wire := row["shared_jacobian"]) is None:
        return None
    both, (count,) = bytes(wire), struct.unpack_from(">i", wire, _LENGTH_AT)
    step = 4 + 16
    starts = range(_HEAD_OF_ONE, _HEAD_OF_ONE + count * step, step)
    ids = tuple(UUID(bytes=both[at + 4 : at + step]) for at in starts)
    items = np.frombuffer(both, _REALS, offset=_HEAD_OF_ONE + count * step + _HEAD_OF_THREE)
    return SharedErrorJacobian(ids, items["value"].tobytes())


def marking_columns(srid: int, markings: Sequence[Marking | None]) -> Columns:
    """Columns of the shape of lines; NULL for point objects."""
    if not any(markings):  # avoids a second pass over millions of versions that are not lines
        return dict.fromkeys(("line", "line_cov", *_PAINT), [None] * len(markings))
    lines = [None if m is None else shapely.set_srid(shapely.LineString(m.vertices_m), srid) for m in markings]
    return {
        "line": list(shapely.to_wkb(lines, hex=True, include_srid=True)),
        "line_cov": copy.arrays([None if m is None else m.cov_m2 for m in markings]),
        **{name: [getattr(m, name, None) for m in markings] for name in _PAINT},
    }


def marking_of(row: Row) -> Marking | None:
    """Shape of a line from the columns of `map.features_as_of`, from the line to gap_m; None for point objects."""
    if row["line"] is None:
        return None
    vertices_m = np.frombuffer(row["line"], "<f8", offset=_WKB_HEAD).reshape(-1, 3).tolist()
    cov_m2 = covariances(row["line_cov"])
    return record_of(Marking, row, vertices_m=tuple(map(tuple, vertices_m)), cov_m2=cov_m2)


def covariances(rows: list[list[float]]) -> tuple[Cov3, ...]:
    """Covariances of the vertices of a line, from float8[][6]."""
    return tuple((xx, xy, xz, yy, yz, zz) for xx, xy, xz, yy, yz, zz in rows)
