"""Interior and relative orientation of a calibrated rig with their sigmas, as in Tables 1 and 2 of Lagahit & Tseng.

Focal lengths and principal point in millimetres on the sensor, omega, phi, kappa and base components. The principal point counts
from the sensor's centre, x0 to the right and y0 upwards.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from conetl.geometry import rig as rigs
from conetl.geometry.calibration.stereo_bundle import BoardView, Bundle, residuals_px
from conetl.geometry.rectification import rectified_from_raw, rectify
from conetl.model.arrays import Floats
from conetl.model.rig import INTERIOR, RELATIVE, CalibrationCovariance, Rig, Side

_STEP_RAD = 1e-6
COVERAGE_CELLS = 8


class Value(NamedTuple):
    """One number of a table with its standard deviation, both in `unit`."""

    name: str
    value: float
    sigma: float
    unit: str


def interior_in_pixels(rig: Rig, side: Side) -> list[Value]:
    """fx, fy, cx, cy and the lens's coefficients of one camera. The rig must have a covariance."""
    camera, sigmas = rigs.camera_of(rig, side), _covariance(rig).sigmas
    rows = [Value(name.removesuffix("_px"), getattr(camera, name), sigmas[f"{side}.{name}"], "px") for name in INTERIOR]
    names = {"fisheye": ("k1", "k2", "k3", "k4")}.get(
        camera.lens.model, ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
    )
    rows += [
        Value(name, value, sigmas[f"{side}.lens.{i}"], "")
        for i, (name, value) in enumerate(zip(names, camera.lens.coefficients, strict=False))
    ]
    return rows


def interior_in_millimetres(rig: Rig, side: Side, sensor_mm: tuple[float, float]) -> list[Value]:
    """fx, fy, x0, y0 of one camera on a sensor of width, height in mm (the paper's Table 1)."""
    camera, sigmas = rigs.camera_of(rig, side), _covariance(rig).sigmas
    across, down = sensor_mm[0] / camera.width_px, sensor_mm[1] / camera.height_px
    return [
        Value("fx", camera.fx_px * across, sigmas[f"{side}.fx_px"] * across, "mm"),
        Value("fy", camera.fy_px * down, sigmas[f"{side}.fy_px"] * down, "mm"),
        Value("x0", (camera.cx_px - (camera.width_px - 1) / 2) * across, sigmas[f"{side}.cx_px"] * across, "mm"),
        Value("y0", -(camera.cy_px - (camera.height_px - 1) / 2) * down, sigmas[f"{side}.cy_px"] * down, "mm"),
    ]


def relative_orientation(rig: Rig) -> list[Value]:
    """omega, phi, kappa, bx, by, bz of the right camera in the left one and the length of the base (the paper's Table 2).

    left_R_right = Rx(omega) Ry(phi) Rz(kappa), axes of the left camera (x right, y down, z forward).
    """
    left_SE3_right, known = rigs.left_SE3_right(rig), _covariance(rig)
    index = [known.names.index(f"relative.{name}") for name in RELATIVE]
    covariance = np.array(known.matrix)[np.ix_(index, index)]
    rotation, base = Rotation.from_matrix(left_SE3_right[:3, :3]), left_SE3_right[:3, 3]
    angles = rotation.as_euler("XYZ")
    by_r = np.empty((3, 3))
    for axis in range(3):
        small = Rotation.from_rotvec(_STEP_RAD * np.eye(3)[axis])
        ahead, behind = (rotation * small).as_euler("XYZ"), (rotation * small.inv()).as_euler("XYZ")
        by_r[:, axis] = (ahead - behind) / (2 * _STEP_RAD)
    angle_sigmas = np.sqrt(np.diag(by_r @ covariance[:3, :3] @ by_r.T))
    along = base / np.linalg.norm(base)
    shifts = covariance[3:, 3:]
    rows = [
        Value(name, float(np.degrees(a)), float(np.degrees(s)), "deg")
        for name, a, s in zip(("omega", "phi", "kappa"), angles, angle_sigmas, strict=True)
    ]
    rows += [
        Value(name, float(1e3 * b), float(1e3 * s), "mm")
        for name, b, s in zip(("bx", "by", "bz"), base, np.sqrt(np.diag(shifts)), strict=True)
    ]
    sigma = float(np.sqrt(along @ shifts @ along))
    return [*rows, Value("base", float(1e3 * np.linalg.norm(base)), 1e3 * sigma, "mm")]


def rms_px(bundle: Bundle, views: Sequence[BoardView]) -> float:
    """Root mean square length of the residuals of some views (as OpenCV counts)."""
    return float(np.sqrt(np.concatenate([(residuals_px(bundle, v) ** 2).sum(axis=1) for v in views]).mean()))


def epipolar_errors_px(rig: Rig, views: Sequence[BoardView]) -> Floats:
    """(n,) row of the left minus row of the right image after rectification, of all corners that both show."""
    rectified = rectify(rig)
    by_pair: dict[int, dict[Side, BoardView]] = defaultdict(dict)
    for view in views:
        by_pair[view.pair_index][view.side] = view
    errors = []
    for sides in by_pair.values():
        if len(sides) < 2:
            continue
        left, right = sides["left"], sides["right"]
        _, in_left, in_right = np.intersect1d(left.point_ids, right.point_ids, return_indices=True)
        rows = [
            rectified_from_raw(rectified, v.side, v.uv_px[i])[:, 1] for v, i in ((left, in_left), (right, in_right))
        ]
        errors.append(rows[0] - rows[1])
    together = np.concatenate(errors)
    return np.asarray(together[np.isfinite(together)])


def coverage(rig: Rig, views: Sequence[BoardView], side: Side) -> float:
    """Share of the cells of an 8 x 8 grid over the image that hold a corner."""
    camera = rigs.camera_of(rig, side)
    uv = np.concatenate([v.uv_px for v in views if v.side == side]) + 0.5
    cells = np.floor(uv / (camera.width_px, camera.height_px) * COVERAGE_CELLS).astype(int).clip(0, COVERAGE_CELLS - 1)
    return len(np.unique(cells, axis=0)) / COVERAGE_CELLS**2


def _covariance(rig: Rig) -> CalibrationCovariance:
    if rig.calibration_covariance is None:
        raise ValueError(f"rig {rig.rig_id} has no covariance of its calibration")
    return rig.calibration_covariance
