"""The paper's rig with a calibration drawn from its sigmas: do the stated intervals cover the truth as often as they say?

2,000 rigs as they may truly be take the image, the intersection believes the calibration. Intervals are stated at each
estimate, as the pipeline would: it does not know the truth.
"""

from __future__ import annotations

import numpy as np
import pytest

from conetl.geometry.calibration.covariance import calibration_cov, calibration_jacobian
from docs.figures import accuracy_cases as cases
from docs.figures.paper_rig import SIGMAS, changed_views, drawn_views, paper_rig, render_pair

DRAWS = 2000


def rng() -> np.random.Generator:
    return np.random.default_rng(7)


@pytest.mark.parametrize("noise_px", [0.1, 0.3, 1.0])
def test_the_95_percent_interval_holds_93_to_97_percent(noise_px: float) -> None:
    spread = cases.calibration_and_noise(paper_rig(), cases.paper_point(), noise_px, rng(), draws=DRAWS)
    assert np.all((spread.inside_95 > 0.93) & (spread.inside_95 < 0.97)), spread.inside_95
    np.testing.assert_allclose(spread.monte_carlo_m, spread.analytic_m, rtol=0.08)


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_sigmas_half_or_double_as_large_are_noticed(factor: float) -> None:
    """The rigs are drawn from other sigmas than the calibration states."""
    truly = paper_rig(sigmas={name: sigma / factor for name, sigma in SIGMAS.items()})
    stated = paper_rig()
    point = cases.paper_point()
    uv = cases.project(drawn_views(truly, rng(), DRAWS), point)
    result = cases.solve(uv, cases.views_of(stated), 0.3)
    common = calibration_cov(result.xyz_m, stated)
    spread = cases.spread(result.xyz_m - point, result.cov_m2 + common, point, np.eye(3))
    assert not 0.93 < spread.inside_95[0] < 0.97


def test_without_the_calibrations_share_the_intervals_are_a_delusion() -> None:
    uv = cases.project(drawn_views(paper_rig(), rng(), DRAWS), cases.paper_point())
    result = cases.solve(uv, cases.views_of(paper_rig()), 0.3)
    spread = cases.spread(result.xyz_m - cases.paper_point(), result.cov_m2, cases.paper_point(), np.eye(3))
    assert spread.inside_95[0] < 0.2


def test_phi_alone_costs_what_the_formula_says() -> None:
    """sigma_Z = Z^2 / (f b) * f sigma_phi * (1 + (x/z)^2): a turn of the right camera shifts its columns."""
    rig = paper_rig(sigmas={"relative.ry_rad": SIGMAS["relative.ry_rad"]})
    jacobian = calibration_jacobian(cases.paper_point()[None], rig)[0]
    z, base = cases.paper_point()[2], 0.2745
    assert abs(jacobian[2, 0]) == pytest.approx(z * z / base * (1 + (base / z) ** 2), rel=1e-3)


def test_the_pipelines_derivatives_are_those_of_the_intersection() -> None:
    """The implicit-function formula against differences of the intersection itself, over range and bearing."""
    rig = paper_rig()
    points = np.stack([cases.foot_at(r, b) for r in (3.0, 8.53, 30.0) for b in (-0.4, 0.0, 0.3)])
    by_differences = cases.jacobian_by_differences(rig, points)
    scaled = np.abs(by_differences) * list(SIGMAS.values())
    error = np.abs(calibration_jacobian(points, rig) - by_differences) * list(SIGMAS.values())
    assert np.all(error < 1e-2 * scaled.max(axis=(1, 2), keepdims=True))
    assert np.median(error) < 1e-4 * np.median(scaled.max(axis=(1, 2)))


def test_views_drawn_have_the_covariance_of_the_calibration() -> None:
    rig = paper_rig()
    k, rotation, centre = drawn_views(rig, rng(), 20_000)
    assert np.std(k[:, 0, 0]) == pytest.approx(SIGMAS["left.fx_px"], rel=0.03)
    assert np.std(centre[:, 1, 0]) == pytest.approx(SIGMAS["relative.tx_m"], rel=0.03)
    assert np.std(np.arcsin(rotation[:, 1, 0, 2])) == pytest.approx(SIGMAS["relative.ry_rad"], rel=0.03)
    with pytest.raises(ValueError, match=r"left\.k1"):
        changed_views(rig, ["left.k1"], np.zeros((1, 1)))
    with pytest.raises(ValueError, match="no calibration covariance"):
        drawn_views(rig.model_copy(update={"calibration_covariance": None}), rng(), 1)


def test_the_rendered_cone_stands_where_it_is_said_to_stand() -> None:
    """Outline of the lit left cheek in both images: its disparity is the axis's, to a fifth of a pixel, at every height."""
    pytest.importorskip("mitsuba", reason="Mitsuba is not installed: pip install 'conetl[simulate]'")
    pair = render_pair(samples_per_pixel=2)
    truth = cases.project(cases.views_of(pair.rig), pair.foot_m)
    orange = [(image[..., 0] - image[..., 2]).astype(float) for image in (pair.left, pair.right)]
    edges = []
    for row in range(90, 180, 6):
        crossings = []
        for channel in orange:
            line = channel[row - 3 : row + 4].mean(axis=0)
            level = (np.quantile(line, 0.1) + np.quantile(line, 0.98)) / 2
            first = int(np.argmax(line > level))
            crossings.append(first - (line[first] - level) / (line[first] - line[first - 1]))
        edges.append(crossings[0] - crossings[1])
    # The outline lies a little nearer than the axis: radius^2 / distance, under half a millimetre.
    assert np.median(edges) == pytest.approx(truth[0, 0] - truth[1, 0], abs=0.25)
    rows = np.flatnonzero(orange[0].max(axis=1) > 0.3 * orange[0].max())
    tip_row = cases.project(cases.views_of(pair.rig), pair.foot_m - [0.0, pair.cone_height_m, 0.0])[0, 1]
    assert rows[0] == pytest.approx(tip_row, abs=2.0)
    lit = np.flatnonzero(orange[0][rows[0] + 8] > 0.1 * orange[0].max())
    radius_px = pair.rig.left.fx_px * 0.0376 / pair.foot_m[2]  # of the body, 8 rows below its top
    assert lit[0] == pytest.approx(truth[0, 0] - radius_px, abs=2.5)
