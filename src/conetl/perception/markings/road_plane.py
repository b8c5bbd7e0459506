"""The road in front of a stereo rig as a plane, from dense disparities of one frame pair.

A plane of the left camera's frame is a plane of (u, v, disparity) too: f B / Z is linear in u and v. Only its height below the
camera is searched for: its normal is about that of the level body, and most of what lies low and near is road ("v-disparity",
Labayrade, Aubert & Tarel 2002).
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from cv2.typing import MatLike
from numpy.typing import NDArray

from conetl.geometry.camera import first_road_row, rays
from conetl.geometry.rig import infinity_homography, up_in_left_camera
from conetl.model.arrays import Floats
from conetl.model.rig import Rig

#: Wider images are reduced for the dense disparities.
_MAX_WIDTH_PX = 800
_BLOCK_PX = 11
#: Depths between which the road is searched, and half the width of the strip ahead (m).
_NEAREST_M, _FARTHEST_M, _ASIDE_M = 4.0, 15.0, 3.0
#: Least usual height of a camera, and how far the road is needed.
_USUAL_HEIGHT_M, _SEARCHED_M = 0.9, 18.0
#: Heights of a camera above the road (m), and the resolution at which the first guess is made.
_HEIGHTS_M, _HEIGHT_STEP_M = (0.3, 4.0), 0.05
#: Shares of the disparity, one after the other, within which a point counts as road.
_TOLERANCES = (0.1, 0.05, 0.03, 0.03)
#: Largest slope of the road against the body: brakes and ramps.
_MAX_TILT_RAD = 0.12
_MIN_POINTS = 80
#: One of this many rows and columns of the disparities is used.
_EVERY = 4


class RoadPlane(NamedTuple):
    """Road and measured disparities of one frame pair. Disparities are those of a right camera turned like the left one."""

    plane: Floats
    """(3,): the road's disparity at (u, v) is plane @ (u, v, 1)."""
    camera_height_m: float
    """Of the left camera above the plane."""
    measured_px: NDArray[np.float32]
    """(h, w) disparities in pixels of the full image, NaN where unknown; every `step_px`-th pixel of the left image ..."""
    step_px: float
    first_row_px: int
    """... from this row of the full image on."""

    def height_m(self, uv_px: Floats, disparity_px: Floats) -> Floats:
        """(...) heights above the plane of points of the left image (..., 2) with disparities (...)."""
        expected = uv_px @ self.plane[:2] + self.plane[2]
        return np.asarray(self.camera_height_m * (1 - expected / disparity_px))

    def measured_at(self, uv_px: Floats) -> Floats:
        """(...) measured disparities at points (..., 2) of the left image; NaN where unknown and outside."""
        rows, columns = self.measured_px.shape
        u = np.rint((uv_px[..., 0] + 0.5) / self.step_px - 0.5).astype(np.intp)
        v = np.rint((uv_px[..., 1] - self.first_row_px + 0.5) / self.step_px - 0.5).astype(np.intp)
        inside = (u >= 0) & (u < columns) & (v >= 0) & (v < rows)
        return np.where(inside, self.measured_px[np.clip(v, 0, rows - 1), np.clip(u, 0, columns - 1)], np.nan)


def find_road(left: MatLike, right: MatLike, rig: Rig) -> RoadPlane | None:
    """The road plane of one frame pair of grey images (H, W); None where too little of it is seen."""
    camera = rig.left
    focal_base = camera.fx_px * rig.baseline_m
    down = -up_in_left_camera(rig)
    # From the horizon down, without the rows in which cameras at usual heights see the road far away.
    far_px = _USUAL_HEIGHT_M / _SEARCHED_M * camera.fy_px
    first_row = first_road_row(camera, [np.outer([0.0, 0.0, 1.0], -down)], margin_rad=0.0) + int(far_px)
    scale = min(1.0, _MAX_WIDTH_PX / camera.width_px)
    shift = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, first_row], [0.0, 0.0, 1.0]])
    size = camera.width_px, camera.height_px - first_row
    images = [
        left[first_row:],
        cv2.warpPerspective(
            right, infinity_homography(rig) @ shift, size, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        ),
    ]
    if scale < 1:
        images = [cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA) for image in images]
    lower, parallel = map(np.ascontiguousarray, images)
    step = size[0] / lower.shape[1]
    most = int(np.ceil(focal_base / step / (0.8 * _NEAREST_M) / 16)) * 16
    if lower.shape[0] < 2 * _BLOCK_PX or lower.shape[1] < most + 2 * _BLOCK_PX:
        return None
    matcher = cv2.StereoBM.create(numDisparities=most, blockSize=_BLOCK_PX)
    matcher.setTextureThreshold(5)
    matcher.setUniquenessRatio(5)
    # Block matching leaves out as many columns on the left as there are disparities, whether their partners are seen or not.
    padded = [cv2.copyMakeBorder(image, 0, 0, most, 0, cv2.BORDER_CONSTANT) for image in (lower, parallel)]
    raw = matcher.compute(*padded)[:, most:]
    measured = np.where(raw > 0, raw.astype(np.float32) / 16 * np.float32(step), np.float32(np.nan))
    road = _plane(measured, step, first_row, rig, down)
    if road is None:
        return None
    normal = np.array([
        road[0] * camera.fx_px, road[1] * camera.fy_px, road @ (camera.cx_px, camera.cy_px, 1.0)
    ])  # fmt: skip
    length = float(np.linalg.norm(normal))
    if normal @ down < length * np.cos(_MAX_TILT_RAD):
        return None
    return RoadPlane(road, focal_base / length, measured, step, first_row)


def _plane(measured: NDArray[np.float32], step: float, first_row: int, rig: Rig, down: Floats) -> Floats | None:
    """(3,) of `RoadPlane.plane`, by a vote about the height, then least squares with shrinking tolerances."""
    focal_base = rig.left.fx_px * rig.baseline_m
    some = measured[::_EVERY, ::_EVERY].astype(np.float64)
    v, u = np.indices(some.shape) * float(_EVERY)
    u, v = (u + 0.5) * step - 0.5, (v + 0.5) * step - 0.5 + first_row
    ray = rays(rig.left, np.stack([u, v], axis=-1))
    with np.errstate(invalid="ignore", divide="ignore"):
        depth = focal_base / some
        near = (depth > _NEAREST_M) & (depth < _FARTHEST_M) & (np.abs(ray[..., 0] * depth) < _ASIDE_M)
    if near.sum() < _MIN_POINTS:
        return None
    u, v, disparity, reach = u[near], v[near], some[near], ray[near] @ down
    heights = reach * focal_base / disparity
    bins = np.arange(*_HEIGHTS_M, _HEIGHT_STEP_M)
    votes = np.convolve(np.histogram(heights, bins)[0], np.ones(3), "same")
    height = bins[int(votes.argmax())] + _HEIGHT_STEP_M / 2
    predicted = reach * focal_base / height
    design = np.stack([u, v, np.ones_like(u)], axis=1)
    plane = np.zeros(3)
    for tolerance in _TOLERANCES:
        close = np.abs(disparity - predicted) < np.maximum(tolerance * predicted, 0.5)
        if close.sum() < _MIN_POINTS:
            return None
        normal = design[close].T @ design[close]
        plane = np.linalg.solve(normal, design[close].T @ disparity[close])
        predicted = design @ plane
    return np.asarray(plane)
