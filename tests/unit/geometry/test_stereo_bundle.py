"""Derivatives of the bundle against differences, the freedom of a board's shape, and the tables."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from conetl.geometry.calibration import tables
from conetl.geometry.calibration.stereo_bundle import (
    apply_step,
    pair_system,
    parameter_names,
    residuals_px,
    shape_basis,
)
from conetl.geometry.calibration.stereo_calibration import calibrate_stereo, rig_of
from conetl.model.rig import LENS_COEFFICIENTS, Lens, LensModel
from tests.synthetic.calibration_world import board_points, observe, start_near, true_bundle

LENSES = [
    Lens(),
    Lens(model="radial", coefficients=(-0.1, 0.04)),
    Lens(model="brown", coefficients=(-0.1, 0.04, 0.002, -0.001, 0.01)),
    Lens(model="rational", coefficients=(0.3, 0.1, 0.002, -0.001, 0.01, 0.4, 0.1, 0.02)),
    Lens(model="fisheye", coefficients=(0.02, -0.01, 0.005, -0.002)),
]


@pytest.mark.parametrize(("lens", "free"), [(LENSES[0], False), *((lens, True) for lens in LENSES)])
def test_jacobians_agree_with_differences(lens: Lens, free: bool) -> None:
    rng = np.random.default_rng(0)
    bundle = true_bundle(1, rng, lens, board_points(4, 3))
    if free:
        basis = shape_basis(bundle.points_m)
        bundle = replace(bundle, basis=basis, shape=rng.normal(0, 1e-3, basis.shape[1]))
    views = observe(bundle, 0.3, rng)
    _, by_global, by_pose = pair_system(bundle, [(v, np.ones(len(v.point_ids))) for v in views])
    size = bundle.rig_parameters + len(bundle.shape)
    assert by_global.shape[1] == size

    def change(step: np.ndarray, pose: np.ndarray) -> np.ndarray:
        trial = apply_step(bundle, step, {0: pose})
        return np.concatenate([residuals_px(trial, v).ravel() for v in views])

    for n in range(size + 6):
        h = 1e-6 if n >= 4 else 1e-3
        step, pose = np.zeros(size), np.zeros(6)
        (step if n < size else pose)[n if n < size else n - size] = h
        difference = -(change(step, pose) - change(-step, -pose)) / (2 * h)
        analytic = by_global[:, n] if n < size else by_pose[:, n - size]
        np.testing.assert_allclose(analytic, difference, rtol=1e-5, atol=1e-4 * max(1.0, np.abs(difference).max()))


@pytest.mark.parametrize("model", LENS_COEFFICIENTS)
def test_names_count_the_unknowns(model: LensModel) -> None:
    lens = Lens(model=model, coefficients=(0.0,) * LENS_COEFFICIENTS[model])
    bundle = true_bundle(1, np.random.default_rng(0), lens)
    names = parameter_names(model)
    assert len(names) == len(set(names)) == bundle.rig_parameters
    assert names[-6:] == tuple(f"relative.{n}" for n in ("rx_rad", "ry_rad", "rz_rad", "tx_m", "ty_m", "tz_m"))


def test_a_boards_shape_has_no_motion_and_no_scale_in_it() -> None:
    points = board_points(4, 3)
    basis = shape_basis(points)
    assert basis.shape == (36, 29)
    np.testing.assert_allclose(basis.T @ basis, np.eye(29), atol=1e-12)
    deformations = basis.T.reshape(29, 12, 3)
    centred = points - points.mean(axis=0)
    np.testing.assert_allclose(deformations.sum(axis=1), 0.0, atol=1e-12)
    np.testing.assert_allclose(np.cross(centred, deformations).sum(axis=1), 0.0, atol=1e-12)
    np.testing.assert_allclose((centred * deformations).sum(axis=(1, 2)), 0.0, atol=1e-12)


def test_tables_are_those_of_the_rig() -> None:
    rng = np.random.default_rng(3)
    true = true_bundle(8, rng)
    views = observe(true, 0.05, rng)
    result = calibrate_stereo(true.points_m, views, start_near(true, rng), models=("radial",), board_shapes=("flat",))
    rig = rig_of(result, "simulated")
    relative = {v.name: v for v in tables.relative_orientation(rig)}
    for name, value in (("bx", 300.0), ("by", 4.0), ("bz", -6.0)):
        assert abs(relative[name].value - value) < 5 * relative[name].sigma < 5.0
    assert relative["omega"].value == pytest.approx(np.degrees(0.01), abs=5 * relative["omega"].sigma)
    pixels = {v.name: v for v in tables.interior_in_pixels(rig, "left")}
    millimetres = {v.name: v for v in tables.interior_in_millimetres(rig, "left", (8.0, 6.0))}
    assert millimetres["fx"].value == pytest.approx(pixels["fx"].value / 100)
    assert millimetres["fx"].sigma == pytest.approx(pixels["fx"].sigma / 100)
    assert millimetres["y0"].value == pytest.approx(-(pixels["cy"].value - 299.5) / 100)  # upwards
    rows = tables.epipolar_errors_px(rig, views)
    assert len(rows) == 8 * 35
    # two rows of independent noise of 0.05 px, at about the scale of the raw images
    assert 0.9 * 0.05 * 2**0.5 < np.sqrt((rows**2).mean()) < 1.15 * 0.05 * 2**0.5
