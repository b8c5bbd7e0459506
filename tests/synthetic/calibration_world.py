"""Simulated board views of a known rig."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from conetl.geometry import pose as se3
from conetl.geometry.calibration.stereo_bundle import BoardView, Bundle, BundleError, residuals_px
from conetl.geometry.calibration.stereo_calibration import Start
from conetl.model.rig import Camera, Lens

Array = NDArray[np.float64]
SIDES = ("left", "right")


def board_points(cols: int = 7, rows: int = 5, square_m: float = 0.05) -> Array:
    """(n, 3) corners of a flat board, row by row."""
    x, y = np.meshgrid(np.arange(cols), np.arange(rows))
    return np.column_stack([x.ravel() * square_m, y.ravel() * square_m, np.zeros(cols * rows)])


def true_bundle(
    pairs: int, rng: np.random.Generator, lens: Lens | None = None, points_m: Array | None = None
) -> Bundle:
    """A rig of 0.3 m base and boards all over its field, 0.8 to 2 m away, tilted and turned."""
    points = board_points() if points_m is None else points_m
    lens = Lens(model="radial", coefficients=(-0.12, 0.05)) if lens is None else lens
    left = Camera(width_px=800, height_px=600, fx_px=620.0, fy_px=622.0, cx_px=405.0, cy_px=297.0, lens=lens)
    right = Camera(width_px=800, height_px=600, fx_px=615.0, fy_px=617.0, cx_px=396.0, cy_px=303.0, lens=lens)
    relative = se3.se3(Rotation.from_rotvec([0.01, -0.03, 0.005]).as_matrix(), np.array([0.3, 0.004, -0.006]))
    bundle = Bundle(left, right, relative, {}, points, np.zeros((points.size, 0)), np.zeros(0))
    poses: dict[int, Array] = {}
    while len(poses) < pairs:
        distance = rng.uniform(0.8, 2.0)
        turn = Rotation.from_euler("zxy", [rng.uniform(-0.6, 0.6), rng.uniform(-0.6, 0.6), rng.uniform(-0.6, 0.6)])
        middle = np.array([rng.uniform(-0.45, 0.6) * distance, rng.uniform(-0.4, 0.4) * distance, distance])
        pose = se3.se3(turn.as_matrix(), middle - turn.apply(points.mean(axis=0)))
        trial = replace(bundle, board_SE3={0: pose})
        if all(_inside(trial, side) for side in SIDES):
            poses[len(poses)] = pose
    return replace(bundle, board_SE3=poses)


def observe(bundle: Bundle, sigma_px: float, rng: np.random.Generator, common_px: float = 0.0) -> list[BoardView]:
    """Views with independent noise of every corner, and an affine error that all corners of a view have in common."""
    ids = np.arange(len(bundle.points_m))
    centred = (bundle.points_m[:, :2] - bundle.points_m[:, :2].mean(axis=0)) / np.ptp(bundle.points_m[:, :2])
    views = []
    for pair in bundle.board_SE3:
        for side in SIDES:
            uv = exact(bundle, pair, side)
            field = np.column_stack([np.ones(len(ids)), 2 * centred]) @ rng.normal(0, 1, (3, 2)) * common_px
            views.append(BoardView(pair, side, ids, uv + field + rng.normal(0, sigma_px, uv.shape)))
    return views


def exact(bundle: Bundle, pair: int, side: str) -> Array:
    """(n, 2) image points without errors."""
    zero = BoardView(pair, side, np.arange(len(bundle.points_m)), np.zeros((len(bundle.points_m), 2)))
    return -residuals_px(bundle, zero)


def start_near(bundle: Bundle, rng: np.random.Generator) -> Start:
    """Start values a few pixels and centimetres off, with a radial lens."""

    def shaken(pose: Array) -> Array:
        return se3.se3(pose[:3, :3] @ Rotation.from_rotvec(rng.normal(0, 0.005, 3)).as_matrix(), pose[:3, 3] * 1.01)

    blank = Lens(model="radial", coefficients=(0.0, 0.0))
    left, right = (
        c.model_copy(update={"fx_px": c.fx_px * 1.01, "fy_px": c.fy_px * 1.01, "lens": blank})
        for c in (bundle.left, bundle.right)
    )
    poses = bundle.board_SE3
    to_right = se3.invert(bundle.left_SE3_right)
    return Start(
        left, right, {p: shaken(t) for p, t in poses.items()}, {p: shaken(to_right @ t) for p, t in poses.items()}
    )


def _inside(bundle: Bundle, side: str) -> bool:
    camera = bundle.left if side == "left" else bundle.right
    try:
        uv = exact(bundle, 0, side)
    except BundleError:
        return False
    return bool(((uv >= 5) & (uv <= (camera.width_px - 6, camera.height_px - 6))).all())
