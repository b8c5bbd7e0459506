"""Check that the calibration includes the distortion of both lenses, by the rows of points in both images.

In a rectified pair a point is in the same row of both images. A radial distortion that the calibration of one lens lacks moves
rows by the third power of the distance from the centre, unlike a rotation of a camera or a focal length. Corners that were
matched in both images are followed to a tenth of a pixel (Lucas & Kanade 1981).
"""

from __future__ import annotations

from collections.abc import Iterable

import cv2
import numpy as np

from conetl.model.arrays import Floats, Image
from conetl.model.health import Finding
from conetl.model.rig import Rig

CHECK = "distortion of the lenses"
#: Largest row difference of points (px of the whole image), largest distance when found again, and least number of points.
_ROWS_PX, _FOUND_PX, _MIN_POINTS = 8.0, 4.0, 100
_WINDOW_PX, _ROUNDS, _HUBER_SIGMAS, _LEAST_PX = 15, 10, 1.5, 0.05


def check_distortion(pairs: Iterable[tuple[Image, Image, Floats, Floats]], rig: Rig, shrink: int) -> Finding:
    """pairs: grey images reduced by `shrink`, and matched points (N, 2) px of the whole images. rig: without lenses."""
    camera, at_infinity_px = rig.right, rig.left.cx_px - rig.right.cx_px
    points = np.concatenate([np.empty((0, 3)), *(_track_corners(*pair, at_infinity_px, shrink) for pair in pairs)])
    if len(points) < _MIN_POINTS:
        return Finding(check=CHECK)
    x, y = (points[:, 0] - camera.cx_px) / camera.fx_px, (points[:, 1] - camera.cy_px) / camera.fy_px
    rows = points[:, 2] / camera.fy_px
    # Offset, turns and focal lengths of the cameras, and the difference of their radial distortions.
    design = np.stack([np.ones_like(x), x, y, x * y, y * y, (x * x + y * y) * y], axis=1)
    weight, least = np.ones_like(rows), _LEAST_PX / camera.fy_px
    for _ in range(_ROUNDS):
        inverse = np.linalg.pinv(design.T @ (weight[:, None] * design))
        off = np.abs(rows - design @ (inverse @ design.T @ (weight * rows)))
        spread = max(1.48 * float(np.median(off)), least)
        weight = np.minimum(1.0, _HUBER_SIGMAS * spread / np.maximum(off, 1e-12)) * (off < 2 * _HUBER_SIGMAS * spread)
    k1 = float((inverse @ design.T @ (weight * rows))[-1])
    sigma = spread * float(inverse[-1, -1]) ** 0.5
    return Finding(check=CHECK, value=k1, sigma=sigma)


def _track_corners(
    left: Image, right: Image, ours: Floats, theirs: Floats, at_infinity_px: float, shrink: int
) -> Floats:
    """(M, 3) columns and rows in the right image, and rows right minus left, px of the whole image.

    at_infinity_px: columns left minus right of infinitely far points.
    """
    near = (np.abs(theirs[:, 1] - ours[:, 1]) < _ROWS_PX) & (ours[:, 0] - theirs[:, 0] - at_infinity_px > -shrink)
    if not near.any():
        return np.empty((0, 3))
    # Rectified images may differ in width, those of an optical flow may not.
    rows, columns = np.maximum(left.shape, right.shape)
    left, right = (
        np.pad(image, ((0, rows - image.shape[0]), (0, columns - image.shape[1])), "edge") for image in (left, right)
    )
    start, guess = ((part[near] / shrink)[:, None].astype(np.float32) for part in (ours, theirs))
    found, known, _ = cv2.calcOpticalFlowPyrLK(
        left,
        right,
        start,
        guess.copy(),
        winSize=(_WINDOW_PX, _WINDOW_PX),
        maxLevel=0,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    good = (known[:, 0] == 1) & (np.linalg.norm(found - guess, axis=2)[:, 0] < _FOUND_PX / shrink)
    there, here = found[good, 0].astype(np.float64), start[good, 0].astype(np.float64)
    return np.column_stack([shrink * there, shrink * (there[:, 1] - here[:, 1])])
