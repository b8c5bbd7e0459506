"""In which frame pairs of a drive a given cone should have been seen.

'We looked and it was not there' needs both halves: a spot counts as looked at only where a cone standing on it would be tall
enough, wholly inside both pictures and not hidden behind something nearer that was detected.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from conetl.params import ReconcileParams
from conetl.records import Camera, Detection, MapFeature, Position, Rig

Floats = NDArray[np.float64]
#: Width of a cone's base plate over its height; between the 0.5 and 0.6 of common road cones.
_WIDTH_OVER_HEIGHT = 0.55
#: A spot with more than this share of its box behind a nearer box counts as hidden.
_HIDDEN_SHARE = 0.25


@dataclass(frozen=True)
class Look:
    """What a drive saw of a feature's spot when it saw no cone there."""

    frames: int
    """Frame pairs in which the spot was in plain view and empty."""
    first_ns: int
    """Time of the first of them (UTC, ns since 1970)."""


def look_at_spot(
    feature: MapFeature,
    offset_m: Floats,
    rig: Rig,
    map_SE3_left: Mapping[int, Floats],
    map_SE3_right: Mapping[int, Floats],
    captured_at_ns: Mapping[int, int],
    detections: Mapping[int, Sequence[Detection]],
    positions: Sequence[Position],
    params: ReconcileParams,
) -> Look | None:
    """What the drive saw of a feature's spot, or None where it was never in plain view, or a cone was seen there as often as not.

    offset_m (3,): add it to map coordinates to get the drive's. Mappings are by frame index.
    """
    spot = np.array(feature.xyz_m) + offset_m
    visible = set(
        frames_in_plain_view(spot, feature.cone_height_m, rig, map_SE3_left, map_SE3_right, detections, params)
    )
    occupied = {
        p.frame_index for p in positions if float(np.linalg.norm((np.array(p.xyz_m) - spot)[:2])) <= params.min_gate_m
    }
    empty = visible - occupied
    if not empty or len(visible & occupied) >= len(empty):
        return None
    return Look(len(empty), min(captured_at_ns[frame] for frame in empty))


def frames_in_plain_view(
    foot_m: Floats,
    cone_height_m: float,
    rig: Rig,
    map_SE3_left: Mapping[int, Floats],
    map_SE3_right: Mapping[int, Floats],
    detections: Mapping[int, Sequence[Detection]],
    params: ReconcileParams,
) -> list[int]:
    """Frame indices in which a cone at `foot_m` (3,) in the map frame would be in plain view of both cameras.

    map_SE3_left, map_SE3_right: (4, 4) camera -> map by frame index; detections: those of both images by frame index.
    """
    tip_m = foot_m + np.array([0.0, 0.0, cone_height_m])
    seen = []
    for frame_index, left_pose in map_SE3_left.items():
        boxes = {
            "left": _apparent_box(foot_m, tip_m, left_pose, rig.left, params),
            "right": _apparent_box(foot_m, tip_m, map_SE3_right[frame_index], rig.right, params),
        }
        if any(box is None for box in boxes.values()):
            continue
        if not any(_is_hidden(boxes[d.side], d) for d in detections.get(frame_index, ())):
            seen.append(frame_index)
    return seen


def _apparent_box(
    foot_m: Floats, tip_m: Floats, map_SE3_camera: Floats, camera: Camera, params: ReconcileParams
) -> tuple[float, float, float, float] | None:
    """x0, y0, x1, y1 (px) that the cone would fill, None where it is too small, cut by the border or behind the camera."""
    rotation, centre = map_SE3_camera[:3, :3], map_SE3_camera[:3, 3]
    foot, tip = rotation.T @ (foot_m - centre), rotation.T @ (tip_m - centre)
    if min(foot[2], tip[2]) < 0.5:
        return None
    y1 = camera.cy_px + camera.fy_px * foot[1] / foot[2]
    y0 = camera.cy_px + camera.fy_px * tip[1] / tip[2]
    half = (y1 - y0) * _WIDTH_OVER_HEIGHT / 2
    u = camera.cx_px + camera.fx_px * foot[0] / foot[2]
    border = params.visible_border_px
    inside = (
        u - half >= border and y0 >= border and u + half <= camera.width_px - border and y1 <= camera.height_px - border
    )
    return (u - half, y0, u + half, y1) if inside and y1 - y0 >= params.visible_min_height_px else None


def _is_hidden(box: tuple[float, float, float, float] | None, detection: Detection) -> bool:
    """Whether a detected box that stands nearer (its foot is lower in the picture) covers a good part of `box`."""
    if box is None:
        return False
    x0, y0, x1, y1 = box
    if detection.y_px + detection.h_px <= y1 + 0.1 * (y1 - y0):
        return False
    width = min(x1, detection.x_px + detection.w_px) - max(x0, detection.x_px)
    height = min(y1, detection.y_px + detection.h_px) - max(y0, detection.y_px)
    return width > 0 and height > 0 and width * height > _HIDDEN_SHARE * (x1 - x0) * (y1 - y0)
