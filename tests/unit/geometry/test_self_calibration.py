"""The turn of the right camera from simulated points of a drive: found within what is stated, and not where nothing tells."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from conetl.geometry.self_calibration import estimate_turn
from conetl.geometry.stereo_motion import MotionLimits, StereoCameras
from tests.synthetic.spans import BASELINE_M, CX_PX, CY_PX, FOCAL_PX, make_span, see

INTRINSICS = np.array([FOCAL_PX, FOCAL_PX, CX_PX, CY_PX])
BESIDE = np.eye(4)
BESIDE[0, 3] = -BASELINE_M
CAMERAS = StereoCameras(INTRINSICS, INTRINSICS, BESIDE)
LIMITS = MotionLimits(min_inliers=30, gate_m=0.5, gate_rad=0.02)
#: 0.6 px of disparity, 0.3 px of row, 0.2 px of row at the side.
TURN = np.array([0.3, -0.6, 0.3]) / FOCAL_PX


def found_from(seed: int, turn: np.ndarray = TURN, spans: int = 18, **street: float) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    found = estimate_turn(CAMERAS, [make_span(rng, turn, **street) for _ in range(spans)], LIMITS, 8)  # type: ignore[arg-type]
    assert found is not None
    return found.rotation_rad, found.cov


def test_a_turn_is_found_within_its_stated_sigma() -> None:
    """Over ten drives the squared errors have the size that the covariances state, neither more nor less."""
    nees = []
    for seed in range(10):
        turn, cov = found_from(seed)
        assert np.abs(turn - TURN).max() * FOCAL_PX < 0.25
        nees.append((turn - TURN) @ np.linalg.solve(cov, turn - TURN))
    # Covariances from the scatter of 18 spans are uncertain themselves; the larger of two estimates is taken.
    low, high = chi2.ppf([0.001, 0.999], 3 * len(nees)) / len(nees)
    assert 0.8 * low < np.mean(nees) < 1.1 * high


def test_without_a_turn_none_is_found() -> None:
    turn, cov = found_from(100, np.zeros(3))
    assert turn @ np.linalg.solve(cov, turn) < chi2.ppf(0.999, 3) * 1.3
    assert np.abs(turn).max() * FOCAL_PX < 0.2


def test_a_lorry_that_keeps_ahead_is_outvoted() -> None:
    turn, cov = found_from(200, points=120, lorry=40)
    assert np.all(np.abs(turn - TURN) < 4 * np.sqrt(np.diag(cov)))
    assert np.sqrt(cov[1, 1]) * FOCAL_PX < 0.15


def test_wrong_points_do_not_move_the_result() -> None:
    rng = np.random.default_rng(300)
    spans = [make_span(rng, TURN) for _ in range(24)]
    for span in spans:
        span.last_px[::9] += rng.uniform(-20, 20, span.last_px[::9].shape)
        span.first_px[1::9, 3] += 2.0  # a wrong row alone is seen by no motion
    found = estimate_turn(CAMERAS, spans, LIMITS, 8)
    assert found is not None
    assert np.abs(found.rotation_rad - TURN).max() * FOCAL_PX < 0.06  # a ninth of the rows is wrong by 2 px to one side


def test_a_longer_way_tells_more() -> None:
    short, long = (found_from(400, way_m=way)[1] for way in (0.3, 2.0))
    assert long[1, 1] < 0.5 * short[1, 1]


def test_disparities_bent_by_something_else_show_as_a_gap_of_the_model() -> None:
    rng = np.random.default_rng(500)
    bent, straight = ([make_span(rng, np.zeros(3)) for _ in range(16)] for _ in range(2))
    for span in bent:
        for seen in (span.first_px, span.last_px):
            seen[:, 2] += 1.5 * ((seen[:, 2] - CX_PX) / FOCAL_PX) ** 2
    gaps = [estimate_turn(CAMERAS, spans, LIMITS, 8) for spans in (bent, straight)]
    assert gaps[0] is not None and gaps[1] is not None
    # Nothing is turned: the turn that was found instead and its gap are of opposite sign and equal size.
    gap_px = float(gaps[0].model_gap_rad[1]) * FOCAL_PX
    assert gap_px > 0.15
    assert gap_px == pytest.approx(-float(gaps[0].rotation_rad[1]) * FOCAL_PX, abs=0.05)
    assert abs(float(gaps[1].model_gap_rad[1])) * FOCAL_PX < 0.03


@pytest.mark.parametrize("spans", [0, 7])
def test_too_few_spans_say_nothing(spans: int) -> None:
    rng = np.random.default_rng(600)
    assert estimate_turn(CAMERAS, [make_span(rng, TURN) for _ in range(spans)], LIMITS, 8) is None


def test_spans_of_noise_say_nothing() -> None:
    rng = np.random.default_rng(700)
    spans = [make_span(rng, TURN) for _ in range(10)]
    for span in spans:
        span.last_px[:] = see(np.array([[0.0, 0.0, 9.0]]), np.zeros(3)) + rng.uniform(-60, 60, span.last_px.shape)
    assert estimate_turn(CAMERAS, spans, LIMITS, 8) is None


def test_a_turn_of_the_rig_as_delivered_is_what_is_left() -> None:
    """A right camera that stands askew by calibration is no error of it."""
    rng = np.random.default_rng(800)
    askew = np.eye(4)
    askew[:3, :3] = Rotation.from_rotvec(-TURN).as_matrix()
    cameras = StereoCameras(INTRINSICS, INTRINSICS, askew @ BESIDE)
    found = estimate_turn(cameras, [make_span(rng, TURN) for _ in range(16)], LIMITS, 8)
    assert found is not None
    assert np.all(np.abs(found.rotation_rad) < 4 * np.sqrt(np.diag(found.cov)))
