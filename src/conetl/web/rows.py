"""Rows of the database -> answers: offsets from the origin that fit into a float32, camera poses, UTC times."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

import numpy as np
from pydantic import BaseModel

from conetl.db.map.results import CommittedChangeset
from conetl.geometry.rig import camera_of, map_SE3_camera, map_SE3_left
from conetl.model.base import TICK, Vec3, utc_from_ns
from conetl.model.rig import Rig, Side
from conetl.reports.drive_passes import DrivePass, pose_of
from conetl.web.judging_models import FrameBox, FrameView
from conetl.web.models import Box, Decision, HistoryItem, Sighting, TimelineItem

Row = Mapping[str, Any]
A = TypeVar("A", bound=BaseModel)
#: Decimals of offsets: a tenth of a millimetre.
_DECIMALS = 4


def offset(xyz_m: Sequence[float], origin_m: Vec3) -> Vec3:
    """A position of the map as metres from the origin."""
    x, y, z = np.round(np.subtract(xyz_m, origin_m), _DECIMALS).tolist()
    return x, y, z


def answer(model: type[A], row: Row, origin_m: Vec3 = (0.0, 0.0, 0.0), **computed: Any) -> A:
    """An answer whose fields are columns of the same name, or computed from others: offsets, covariances, times.

    origin_m: of rows that have no xyz_m yet.
    """

    def value(name: str) -> Any:
        if name in row:
            return row[name]
        if name == "xyz_m":
            return offset(position(row), origin_m)
        if name == "cov_m2":
            axes = ("xx", "xy", "xz", "yy", "yz", "zz") if "cov_xz" in row else ("xx", "xy", "yy")
            return tuple(row[f"cov_{axis}"] for axis in axes)
        return utc_from_ns(row[f"{name}_ns"])

    return model(**{name: value(name) for name in model.model_fields if name not in computed}, **computed)


def timeline_item(c: CommittedChangeset) -> TimelineItem:
    """One changeset of the timeline."""
    return answer(TimelineItem, vars(c), valid_at=c.valid_at, known_before=c.effective_at - TICK)


def history(rows: Sequence[Row], reasons: Sequence[str]) -> list[HistoryItem]:
    """A feature's history; rows: read with the origin of the answer; reasons: the sentence of each."""
    return [answer(HistoryItem, row, map_xyz_m=position(row), why=why) for row, why in zip(rows, reasons, strict=True)]


def decision(row: Row, origin_m: Vec3) -> Decision:
    """One decision in effect."""
    xy = None
    if row["easting_m"] is not None:
        xy = offset((row["easting_m"], row["northing_m"], origin_m[2]), origin_m)[:2]
    return answer(Decision, row, origin_m, xy_m=xy, reason=row["note"])


def sighting(row: Row, rig: Rig, origin_m: Vec3) -> Sighting:
    """One sighting with the left camera's pose."""
    camera = map_SE3_left(pose_of(row, "body_"), rig)
    return answer(
        Sighting,
        row,
        origin_m,
        camera_xyz_m=offset(camera[:3, 3].tolist(), origin_m),
        map_R_camera=camera[:3, :3].tolist(),
        corners=_corners(rig),
        left=_box(row, "left"),
        right=_box(row, "right"),
    )


def position(row: Row, prefix: str = "") -> Vec3:
    """Position in the map's CRS."""
    return row[f"{prefix}easting_m"], row[f"{prefix}northing_m"], row[f"{prefix}ellipsoidal_height_m"]


def frame_view(row: Row, side: Side, boxes: Sequence[Row], problem: str | None, origin_m: Vec3) -> FrameView:
    """One image of a frame pair of `judging.frame`, with its boxes; problem: why there is no image."""
    rig = Rig.model_validate(row["rig"])
    lens = camera_of(rig, side)
    camera = map_SE3_camera(pose_of(row), rig, side)
    sizes = ("width_px", "height_px", "fx_px", "fy_px", "cx_px", "cy_px")
    return FrameView(
        **{name: getattr(lens, name) for name in sizes},
        xyz_m=offset(camera[:3, 3].tolist(), origin_m),
        map_R_camera=camera[:3, :3].tolist(),
        boxes=[FrameBox(**box) for box in boxes],
        problem=problem,
    )


def drive_pass(found: DrivePass, origin_m: Vec3) -> DrivePass:
    """One drive past a feature, with offsets from the origin."""
    shown = tuple(
        frame.model_copy(
            update={"range_m": round(frame.range_m, 3), "camera_xyz_m": offset(frame.camera_xyz_m, origin_m)}
        )
        for frame in found.frames
    )
    return found.model_copy(update={"frames": shown})


def clusters(cells: Sequence[Row], by: str, origin_m: Vec3) -> list[tuple[Vec3, dict[str, int]]]:
    """The mean position in each cell, and its numbers by `by`; cells: x, y, feature_count, sum_cm."""
    found: dict[tuple[int, int], list[Row]] = {}
    for cell in cells:
        found.setdefault((cell["x"], cell["y"]), []).append(cell)
    answers = []
    for rows in found.values():
        counts: dict[str, int] = {}
        for row in rows:
            counts[row[by]] = counts.get(row[by], 0) + row["feature_count"]
        mean_m = [sum(row["sum_cm"][axis] for row in rows) / sum(counts.values()) / 100 for axis in range(3)]
        answers.append((offset(mean_m, origin_m), counts))
    return answers


def _corners(rig: Rig) -> tuple[Vec3, Vec3, Vec3, Vec3]:
    camera = rig.left
    left, right = ((edge - camera.cx_px) / camera.fx_px for edge in (-0.5, camera.width_px - 0.5))
    top, bottom = ((edge - camera.cy_px) / camera.fy_px for edge in (-0.5, camera.height_px - 0.5))
    return (left, top, 1.0), (right, top, 1.0), (right, bottom, 1.0), (left, bottom, 1.0)


def _box(row: Row, side: str) -> Box:
    return Box(**{name: row[f"{side}_{name}"] for name in Box.model_fields})
