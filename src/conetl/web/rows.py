"""Rows of the database -> values of the answers: offsets from the origin that a float32 holds, camera poses, UTC times."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import timedelta
from typing import Any

import numpy as np

from conetl.db.map.results import CommittedChangeset
from conetl.geometry.rig import map_SE3_left
from conetl.model.records import Pose, Rig, Vec3, utc_from_ns
from conetl.web.models import Box, Change, Decision, Feature, HistoryItem, Sighting, TimelineItem

Row = Mapping[str, Any]
#: Offsets are sent to a tenth of a millimetre.
_DECIMALS = 4
#: PostgreSQL's timestamps count microseconds; periods are half-open.
_TICK = timedelta(microseconds=1)
_COV3 = ("xx", "xy", "xz", "yy", "yz", "zz")
_COV2 = ("xx", "xy", "yy")


def local(row: Row, origin_m: Vec3, prefix: str = "") -> Vec3:
    """Easting, northing, height of a row as metres from the origin."""
    names = (f"{prefix}easting_m", f"{prefix}northing_m", f"{prefix}height_m")
    x, y, z = (round(row[name] - start, _DECIMALS) for name, start in zip(names, origin_m, strict=True))
    return x, y, z


def timeline_item(c: CommittedChangeset) -> TimelineItem:
    """One changeset of the timeline."""
    return TimelineItem(
        **{name: getattr(c, name) for name in TimelineItem.model_fields if hasattr(c, name)},
        captured_from=utc_from_ns(c.captured_from_ns),
        captured_to=utc_from_ns(c.captured_to_ns),
        valid_at=utc_from_ns(c.captured_to_ns) + _TICK,
        known_before=c.committed_at - _TICK,
    )


def feature(row: Row, origin_m: Vec3) -> Feature:
    """One standing feature."""
    return Feature(
        **_same(row, Feature, skip={"xyz_m", "cov_m2", "first_seen_at", "last_seen_at"}),
        xyz_m=local(row, origin_m),
        cov_m2=tuple(row[f"cov_{name}"] for name in _COV3),
        first_seen_at=utc_from_ns(row["first_seen_ns"]),
        last_seen_at=utc_from_ns(row["last_seen_ns"]),
    )


def change(row: Row, origin_m: Vec3) -> Change:
    """One change."""
    return Change(
        **_same(row, Change, skip={"xyz_m", "old_xyz_m", "cov_m2"}),
        old_xyz_m=None if row["old_easting_m"] is None else local(row, origin_m, "old_"),
        xyz_m=local(row, origin_m),
        cov_m2=tuple(row[f"cov_{name}"] for name in _COV2),
    )


def history_item(row: Row, origin_m: Vec3) -> HistoryItem:
    """One line of a feature's history."""
    return HistoryItem(
        **_same(
            row, HistoryItem, skip={"captured_from", "xyz_m", "map_xyz_m", "cov_m2", "first_seen_at", "last_seen_at"}
        ),
        captured_from=utc_from_ns(row["captured_from_ns"]),
        xyz_m=local(row, origin_m),
        map_xyz_m=(row["easting_m"], row["northing_m"], row["height_m"]),
        cov_m2=tuple(row[f"cov_{name}"] for name in _COV3),
        first_seen_at=utc_from_ns(row["first_seen_ns"]),
        last_seen_at=utc_from_ns(row["last_seen_ns"]),
    )


def decision(row: Row, origin_m: Vec3) -> Decision:
    """One decision that holds."""
    is_place = row["easting_m"] is not None
    return Decision(
        **_same(row, Decision, skip={"xy_m", "reason"}),
        xy_m=tuple(round(row[n] - o, _DECIMALS) for n, o in zip(("easting_m", "northing_m"), origin_m, strict=False))
        if is_place
        else None,
        reason=row["note"],
    )


def sighting(row: Row, rig: Rig, origin_m: Vec3) -> Sighting:
    """One sighting with the left camera's pose."""
    camera = map_SE3_left(_pose(row, "body_"), rig)
    return Sighting(
        **_same(row, Sighting, skip={
            "captured_at", "xyz_m", "cov_m2", "camera_xyz_m", "map_R_camera", "corners", "left", "right"
        }),
        captured_at=utc_from_ns(row["captured_at_ns"]),
        xyz_m=local(row, origin_m),
        cov_m2=tuple(row[f"cov_{name}"] for name in _COV2),
        camera_xyz_m=_offset(camera, origin_m),
        map_R_camera=tuple(tuple(float(v) for v in line) for line in camera[:3, :3]),
        corners=_corners(rig),
        left=_box(row, "left"),
        right=_box(row, "right"),
    )  # fmt: skip


def camera_place(row: Row, rig: Rig, origin_m: Vec3) -> Vec3:
    """Projection centre of the left camera for a row of the trajectory."""
    return _offset(map_SE3_left(_pose(row, ""), rig), origin_m)


def _same(row: Row, model: type[Any], skip: set[str]) -> dict[str, Any]:
    """The fields that are called the same in row and answer."""
    return {name: row[name] for name in model.model_fields if name not in skip}


def _pose(row: Row, prefix: str) -> Pose:
    rotation = np.reshape(row["map_r_body"], (3, 3)).tolist()
    place = (row[f"{prefix}easting_m"], row[f"{prefix}northing_m"], row[f"{prefix}height_m"])
    zeros = (0.0, 0.0, 0.0)  # sigmas play no part in where the camera is
    return Pose(map_R_body=rotation, map_t_body_m=place, sigma_enu_m=zeros, sigma_rpy_rad=zeros)


def _offset(camera: Any, origin_m: Vec3) -> Vec3:
    x, y, z = (round(float(camera[i, 3]) - origin_m[i], _DECIMALS) for i in range(3))
    return x, y, z


def _corners(rig: Rig) -> tuple[Vec3, Vec3, Vec3, Vec3]:
    camera = rig.left
    left, right = ((edge - camera.cx_px) / camera.fx_px for edge in (-0.5, camera.width_px - 0.5))
    top, bottom = ((edge - camera.cy_px) / camera.fy_px for edge in (-0.5, camera.height_px - 0.5))
    return (left, top, 1.0), (right, top, 1.0), (right, bottom, 1.0), (left, bottom, 1.0)


def _box(row: Row, side: str) -> Box:
    return Box(**{name: row[f"{side}_{name}"] for name in Box.model_fields})
