"""Start values of a calibration, by OpenCV: each camera by itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from conetl.geometry import pose as se3
from conetl.geometry.calibration.board_views import BoardView
from conetl.geometry.calibration.stereo_calibration import MIN_PAIRS, Start
from conetl.model.errors import CalibrationError
from conetl.model.records import Camera, Lens, Side

Array = NDArray[np.float64]
_FLAGS = cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K3
#: OpenCV's time grows fast with the number of images; a start needs no more than this.
_MAX_VIEWS = 40
#: Views with this many times the median RMS are left out of the start; the adjustment judges them later.
_OUTLIER = 5.0


def start_values(points_m: Array, views: Sequence[BoardView], sizes: Mapping[Side, tuple[int, int]]) -> Start:
    """Cameras with radial distortion and the board's pose in each view. points_m: (n, 3) board; sizes: width, height by side.

    Raises CalibrationError where a camera has too few views or OpenCV finds no solution.
    """
    cameras: dict[Side, Camera] = {}
    poses: dict[Side, dict[int, Array]] = {}
    for side in ("left", "right"):
        own = [view for view in views if view.side == side]
        if len(own) < MIN_PAIRS:
            raise CalibrationError(
                f"the board was found in {len(own)} {side} images, at least {MIN_PAIRS} are needed (20 to 40 are good)"
            )
        cameras[side], poses[side] = _one_camera(points_m, own, sizes[side], side)
    return Start(cameras["left"], cameras["right"], poses["left"], poses["right"])


def _one_camera(
    points_m: Array, views: Sequence[BoardView], size: tuple[int, int], side: Side
) -> tuple[Camera, dict[int, Array]]:
    chosen = [views[i] for i in np.unique(np.linspace(0, len(views) - 1, _MAX_VIEWS).round().astype(int))]
    try:
        for _ in range(3):
            objects = [points_m[v.point_ids].astype(np.float32) for v in chosen]
            images = [v.uv_px.astype(np.float32) for v in chosen]
            _, k, lens, _, _, _, _, rms = cv2.calibrateCameraExtended(
                objects, images, size, np.eye(3), np.zeros(5), flags=_FLAGS
            )
            good = rms.ravel() <= _OUTLIER * np.median(rms)
            if good.all():
                break
            chosen = [v for v, g in zip(chosen, good, strict=True) if g]
        matrix, coefficients = (np.asarray(a, dtype=np.float64) for a in (k, lens))
        poses = {v.pair_index: _pose(points_m, v, matrix, coefficients) for v in views}
    except cv2.error as error:
        raise CalibrationError(
            f"OpenCV finds no calibration of the {side} camera: {str(error).strip()}. Are the images all alike? Tilt the "
            "board, and bring it near and far"
        ) from error
    k1, k2 = (float(c) for c in coefficients.ravel()[:2])
    camera = Camera(
        width_px=size[0], height_px=size[1], fx_px=float(matrix[0, 0]), fy_px=float(matrix[1, 1]), cx_px=float(matrix[0, 2]),
        cy_px=float(matrix[1, 2]), lens=Lens(model="radial", coefficients=(k1, k2)),
    )  # fmt: skip
    return camera, poses


def _pose(points_m: Array, view: BoardView, k: Array, lens: Array) -> Array:
    """(4, 4) camera_SE3_board; of the two that a plane allows the one of the smaller residuals."""
    _, turns, shifts, _ = cv2.solvePnPGeneric(
        points_m[view.point_ids], view.uv_px[:, None], k, lens, flags=cv2.SOLVEPNP_IPPE
    )
    turn, shift = cv2.solvePnPRefineLM(points_m[view.point_ids], view.uv_px[:, None], k, lens, turns[0], shifts[0])
    return se3.se3(Rotation.from_rotvec(turn.ravel()).as_matrix(), shift.ravel())
