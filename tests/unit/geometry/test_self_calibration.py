"""Turn and bend of the right camera from simulated points of a drive: found within what is stated, not where nothing tells."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from conetl.geometry.calibration.self_calibration import SpanPoints, corrected, estimate_right_camera
from conetl.geometry.motion.stereo_motion import StereoCameras, project
from conetl.model.params import TrajectoryParams
from tests.synthetic.spans import BASELINE_M, CX_PX, CY_PX, FOCAL_PX, make_span, see

INTRINSICS = np.array([FOCAL_PX, FOCAL_PX, CX_PX, CY_PX])
BESIDE = np.eye(4)
BESIDE[0, 3] = -BASELINE_M
CAMERAS = StereoCameras(INTRINSICS, INTRINSICS, BESIDE)
PARAMS = TrajectoryParams(min_points=30, gate_m=0.5, gate_rad=0.02, self_calibration_min_spans=8)
#: 0.6 px of disparity, 0.3 px of row, 0.2 px of row at the side.
TURN = np.array([0.3, -0.6, 0.3]) / FOCAL_PX
#: 1.1 px of disparity at the sides of the image.
BEND = 1.5 / FOCAL_PX


def found_from(seed: int, turn: np.ndarray = TURN, spans: int = 18, **street: float) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    found = estimate_right_camera(CAMERAS, [make_span(rng, turn, **street) for _ in range(spans)], PARAMS)  # type: ignore[arg-type]
    assert found is not None
    return found.turn_and_bend[:3], found.cov[:3, :3]


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
    found = estimate_right_camera(CAMERAS, spans, PARAMS)
    assert found is not None
    assert (
        np.abs(found.turn_and_bend[:3] - TURN).max() * FOCAL_PX < 0.06
    )  # a ninth of the rows is wrong by 2 px to one side


def test_a_longer_way_tells_more() -> None:
    short, long = (found_from(400, way_m=way)[1] for way in (0.3, 2.0))
    assert long[1, 1] < 0.5 * short[1, 1]


def bent(
    rng: np.random.Generator, turn: np.ndarray, field: Callable[[np.ndarray], np.ndarray], spans: int
) -> list[SpanPoints]:
    """Spans whose right columns are shifted, in px, by a field of x, the column in focal lengths from the middle."""
    made = [make_span(rng, turn) for _ in range(spans)]
    for span in made:
        for seen in (span.first_px, span.last_px):
            seen[:, 2] += field((seen[:, 2] - CX_PX) / FOCAL_PX)
    return made


def test_a_bend_of_the_columns_is_found_beside_the_turn_and_within_its_stated_sigma() -> None:
    nees = []
    for seed in range(500, 505):
        spans = bent(np.random.default_rng(seed), TURN, lambda x: BEND * FOCAL_PX * x**2, 16)
        found = estimate_right_camera(CAMERAS, spans, PARAMS)
        assert found is not None
        off = found.turn_and_bend - [*TURN, BEND]
        assert np.abs(off).max() * FOCAL_PX < 0.4
        nees.append(off @ np.linalg.solve(found.cov, off))
    low, high = chi2.ppf([0.001, 0.999], 4 * len(nees)) / len(nees)
    assert 0.8 * low < np.mean(nees) < 1.2 * high


def test_a_corrected_camera_sees_what_turn_and_bend_say() -> None:
    """A turn moves columns by -ry (1 + x^2), the bend by b x^2: to first order, in focal lengths."""
    far = np.array([[x, 0.0, 1.0] for x in (-0.8, -0.4, 0.0, 0.5, 0.8)]) * 1e6
    moved = project(corrected(CAMERAS, np.array([0, TURN[1], 0, BEND])), far)[0] - project(CAMERAS, far)[0]
    x2 = (far[:, 0] / far[:, 2]) ** 2
    assert moved[:, 2] / FOCAL_PX == pytest.approx(-TURN[1] * (1 + x2) + BEND * x2, abs=2e-5)
    assert moved[:, :2] == pytest.approx(0.0)


def test_disparities_off_by_yet_another_field_show_as_a_gap_of_the_model() -> None:
    side = CX_PX / FOCAL_PX

    def fourth(x: np.ndarray) -> np.ndarray:
        return np.asarray(1.5 * (35 * (x / side) ** 4 - 30 * (x / side) ** 2 + 3) / 8)

    gaps = []
    for field in (fourth, np.zeros_like):
        found = estimate_right_camera(CAMERAS, bent(np.random.default_rng(510), np.zeros(3), field, 16), PARAMS)
        assert found is not None
        gaps.append((found.turn_and_bend, found.model_gap))
    # Nothing is turned: what was found instead and its gap are of opposite sign and equal size.
    assert abs(gaps[0][1][3]) * FOCAL_PX > 0.15
    assert gaps[0][1] * FOCAL_PX == pytest.approx(-gaps[0][0] * FOCAL_PX, abs=0.12)
    assert np.abs(gaps[1][1]).max() * FOCAL_PX < 0.1


@pytest.mark.parametrize("spans", [0, 7])
def test_too_few_spans_say_nothing(spans: int) -> None:
    rng = np.random.default_rng(600)
    assert estimate_right_camera(CAMERAS, [make_span(rng, TURN) for _ in range(spans)], PARAMS) is None


def test_spans_of_noise_say_nothing() -> None:
    rng = np.random.default_rng(700)
    spans = [make_span(rng, TURN) for _ in range(10)]
    for span in spans:
        span.last_px[:] = see(np.array([[0.0, 0.0, 9.0]]), np.zeros(3)) + rng.uniform(-60, 60, span.last_px.shape)
    assert estimate_right_camera(CAMERAS, spans, PARAMS) is None


def test_a_turn_of_the_rig_as_delivered_is_what_is_left() -> None:
    """A right camera that stands askew by calibration is no error of it."""
    rng = np.random.default_rng(800)
    askew = np.eye(4)
    askew[:3, :3] = Rotation.from_rotvec(-TURN).as_matrix()
    cameras = StereoCameras(INTRINSICS, INTRINSICS, askew @ BESIDE)
    found = estimate_right_camera(cameras, [make_span(rng, TURN) for _ in range(16)], PARAMS)
    assert found is not None
    assert np.all(np.abs(found.turn_and_bend[:3]) < 4 * np.sqrt(np.diag(found.cov)[:3]))
