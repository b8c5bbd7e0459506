"""Calibration errors in positions: the Jacobian against real intersections with a wrong rig, and the laws of what is shared."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from conetl.geometry import camera as cam
from conetl.geometry import pose as se3
from conetl.geometry import rig as rigs
from conetl.geometry.calibration.covariance import calibration_cov, calibration_jacobian
from conetl.geometry.intersection import intersect
from conetl.geometry.rectification import rectify
from conetl.model.rig import CalibrationCovariance, Camera, Lens, Rig

Array = NDArray[np.float64]

RELATIVE = tuple(f"relative.{n}" for n in ("rx_rad", "ry_rad", "rz_rad", "tx_m", "ty_m", "tz_m"))
POINTS = np.array([[0.4, 1.2, 4.0], [-3.0, 1.4, 9.0], [5.0, 1.6, 20.0]])


def camera(fx_px: float, lens: Lens | None = None) -> Camera:
    return Camera(
        width_px=1242, height_px=375, fx_px=fx_px, fy_px=fx_px * 1.01, cx_px=609.0, cy_px=172.0, lens=lens or Lens()
    )


def a_rig(lens: Lens | None = None, turn_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Rig:
    names = [f"{side}.{n}" for side in ("left", "right") for n in ("fx_px", "fy_px", "cx_px", "cy_px")]
    if lens is not None:
        names += [f"{side}.lens.{i}" for side in ("left", "right") for i in range(len(lens.coefficients))]
    names += RELATIVE
    sigmas = [
        1e-3 if ".lens." in n else 1e-4 if n.endswith("rad") else 3e-4 if n.endswith("_m") else 0.5 for n in names
    ]
    rng = np.random.default_rng(4)
    mixed = np.diag(sigmas) @ np.linalg.qr(rng.normal(size=(len(names), len(names))))[0]
    matrix = mixed @ np.diag(rng.uniform(0.1, 1.0, len(names))) @ mixed.T
    right = se3.se3(Rotation.from_rotvec(turn_rad).as_matrix(), np.array([0.53, 0.004, -0.006]))
    body = se3.se3(Rotation.from_euler("xyz", (-1.6, 0.02, -1.5)).as_matrix(), np.array([1.6, 0.2, 0.9]))
    rows = tuple(tuple(row) for row in ((matrix + matrix.T) / 2).tolist())
    return Rig(
        rig_id="r", left=camera(721.0, lens), right=camera(718.0, lens), body_SE3_left=se3.to_matrix4(body),
        body_SE3_right=se3.to_matrix4(se3.compose(body, right)),
        calibration_covariance=CalibrationCovariance(names=tuple(names), matrix=rows),
    )  # fmt: skip


def changed(rig: Rig, name: str, step: float) -> Rig:
    part, _, field = name.partition(".")
    if part == "relative":
        relative, axis = rigs.left_SE3_right(rig), "xyz".index(field[1])
        small = np.eye(3)[axis] * step
        if field.endswith("_rad"):
            relative[:3, :3] = relative[:3, :3] @ Rotation.from_rotvec(small).as_matrix()
        else:
            relative[:3, 3] += small
        return rig.model_copy(
            update={"body_SE3_right": se3.to_matrix4(se3.compose(rigs.body_SE3_camera(rig, "left"), relative))}
        )
    old = getattr(rig, part)
    if field.startswith("lens."):
        coefficients = list(old.lens.coefficients)
        coefficients[int(field[5:])] += step
        new = old.model_copy(update={"lens": Lens(model=old.lens.model, coefficients=tuple(coefficients))})
    else:
        new = old.model_copy(update={field: getattr(old, field) + step})
    return rig.model_copy(update={part: new})


def solve(rig: Rig, uv: Array) -> Array:
    """Points (P, 3) in the left camera frame of image points (P, 2, 2): by `intersect`, with a lens by scipy in its pixels."""
    relative = rigs.left_SE3_right(rig)
    if rig.left.lens.model != "none":

        def misfit(point: Array, observed: Array) -> Array:
            return (image_points(rig, point[None])[0] - observed).ravel()

        exact = {"xtol": 1e-15, "ftol": 1e-15, "gtol": 1e-15}
        return np.array([least_squares(misfit, p, args=(o,), **exact).x for p, o in zip(POINTS, uv, strict=True)])
    result = intersect(
        uv, np.stack([cam.intrinsics(rig.left), cam.intrinsics(rig.right)]),
        np.stack([np.eye(3), relative[:3, :3]]), np.stack([np.zeros(3), relative[:3, 3]]), 1.0, convergence_m2=1e-24,
    )  # fmt: skip
    assert result.ok.all()
    return result.xyz_m


def image_points(rig: Rig, points: Array) -> Array:
    right = se3.apply(se3.invert(rigs.left_SE3_right(rig)), points)
    return np.stack([cam.project(rig.left, points), cam.project(rig.right, right)], axis=1)


@pytest.mark.parametrize("lens", [None, Lens(model="brown", coefficients=(-0.05, 0.01, 1e-4, -2e-4, 0.0))])
def test_the_jacobian_is_what_wrong_calibrations_do(lens: Lens | None) -> None:
    rig = a_rig(lens, (0.004, -0.02, 0.003))
    assert rig.calibration_covariance is not None
    uv = image_points(rig, POINTS)
    jacobian = calibration_jacobian(POINTS, rig)
    for k, name in enumerate(rig.calibration_covariance.names):
        step = 1e-2 if name.endswith("_px") else 1e-5
        moved = (solve(changed(rig, name, step), uv) - solve(changed(rig, name, -step), uv)) / (2 * step)
        np.testing.assert_allclose(jacobian[:, :, k], moved, atol=1e-4 * np.abs(moved).max() + 1e-9, err_msg=name)


def test_a_rectified_rig_inherits_the_errors_of_the_rig_that_took_the_images() -> None:
    raw = a_rig(Lens(model="radial", coefficients=(-0.05, 0.01)), (0.004, -0.02, 0.003))
    rectified = rectify(raw)
    assert rectified.rectified_from is raw
    raw_R_rect = rigs.body_SE3_camera(raw, "left")[:3, :3].T @ rigs.body_SE3_camera(rectified, "left")[:3, :3]
    own = calibration_cov(POINTS, rectified)
    expected = raw_R_rect.T @ calibration_cov(POINTS @ raw_R_rect.T, raw) @ raw_R_rect
    np.testing.assert_allclose(own, expected, rtol=1e-9, atol=1e-15)
    assert (np.linalg.eigvalsh(own) > 0).all()


def test_without_a_covariance_there_is_none_to_add() -> None:
    rig = a_rig().model_copy(update={"calibration_covariance": None})
    assert calibration_jacobian(POINTS, rig).shape == (3, 3, 0)
    np.testing.assert_array_equal(calibration_cov(POINTS, rig), np.zeros((3, 3, 3)))


@pytest.mark.parametrize("name", ["left.lens.0", "middle.fx_px", "relative.fx_px", "left.lens.x", "left"])
def test_names_that_are_no_parameter_are_refused(name: str) -> None:
    rig = a_rig().model_copy(update={"calibration_covariance": CalibrationCovariance(names=(name,), matrix=((1.0,),))})
    with pytest.raises(ValueError, match="not a parameter"):
        calibration_jacobian(POINTS, rig)
