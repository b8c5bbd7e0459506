"""Motion of a stereo rig from image points whose truth is known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from conetl.geometry import pose as se3
from conetl.geometry.motion import stereo_motion
from conetl.geometry.motion.stereo_motion import (
    MotionStatus,
    RelativeMotion,
    StereoCameras,
    estimate_motion,
    project,
    triangulate,
)
from conetl.model.params import TrajectoryParams

LENS = np.array([720.0, 715.0, 610.0, 173.0])
RIGHT_SE3_LEFT = se3.se3(Rotation.from_rotvec([0.002, -0.003, 0.001]).as_matrix(), [-0.53, 0.004, -0.003])
CAMERAS = StereoCameras(LENS, LENS + np.array([1.0, 2.0, 4.0, 0.0]), RIGHT_SE3_LEFT)
LIMITS = TrajectoryParams(min_points=25, gate_m=0.6, gate_rad=0.03)
WIDE = LIMITS.model_copy(update={"gate_m": 2.0})
TRUTH = se3.se3(Rotation.from_rotvec([0.001, 0.012, -0.002]).as_matrix(), [0.03, -0.01, -0.9])


def scene(rng: np.random.Generator, count: int = 250) -> np.ndarray:
    depth = rng.uniform(5, 45, count)
    uv = np.column_stack([rng.uniform(20, 1220, count), rng.uniform(60, 360, count)])
    return np.column_stack([(uv - LENS[2:]) / LENS[:2] * depth[:, None], depth])


def seen(points: np.ndarray, rng: np.random.Generator, sigma_px: float = 0.3) -> np.ndarray:
    return project(CAMERAS, points)[0] + rng.normal(0, sigma_px, (len(points), 3))


def observe(rng: np.random.Generator, count: int = 250) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    points = scene(rng, count)
    return seen(points, rng), seen(se3.apply(TRUTH, points), rng), np.full(count, 0.3)


def test_triangulation_inverts_projection_and_its_derivatives_are_right() -> None:
    points = scene(np.random.default_rng(0), 20)
    image, by_point, valid = project(CAMERAS, points)
    back, by_image, usable = triangulate(CAMERAS, image)
    assert valid.all() and usable.all()
    assert np.allclose(back, points, atol=1e-9)
    assert np.allclose(by_image @ by_point, np.eye(3), atol=1e-7)
    step = 1e-5
    for axis in range(3):
        moved = project(CAMERAS, points + step * np.eye(3)[axis])[0]
        assert np.allclose((moved - image) / step, by_point[:, :, axis], rtol=1e-3, atol=1e-2)


def error_of(found: np.ndarray) -> np.ndarray:
    turn = Rotation.from_matrix(found[:3, :3] @ TRUTH[:3, :3].T).as_rotvec()
    return np.concatenate([turn, found[:3, 3] - TRUTH[:3, 3]])


def test_covariance_is_honest() -> None:
    nees = []
    for seed in range(40):
        first, second, sigma = observe(np.random.default_rng(seed))
        found = estimate_motion(CAMERAS, first, second, sigma, np.eye(4), WIDE, seed)
        assert found.status is MotionStatus.OK
        error = error_of(found.next_SE3_first)
        nees.append(error @ np.linalg.solve(found.cov, error))
    low, high = chi2.ppf([0.001, 0.999], 6 * len(nees)) / len(nees)
    assert low < np.mean(nees) < 1.15 * high  # the sandwich estimate itself is a little short on 250 points


def test_weights_help_where_errors_have_heavy_tails(monkeypatch: pytest.MonkeyPatch) -> None:
    """As those of real images: few points are far off, many a little."""
    rms = []
    for sigmas in (stereo_motion._CAUCHY_SIGMAS, 1e6):
        monkeypatch.setattr(stereo_motion, "_CAUCHY_SIGMAS", sigmas)
        errors = []
        for seed in range(20):
            rng = np.random.default_rng(seed)
            points = scene(rng)
            first = project(CAMERAS, points)[0] + 0.05 * rng.standard_t(1.2, (250, 3))
            second = project(CAMERAS, se3.apply(TRUTH, points))[0] + 0.05 * rng.standard_t(1.2, (250, 3))
            found = estimate_motion(CAMERAS, first, second, np.full(250, 0.3), np.eye(4), WIDE, seed)
            errors.append(error_of(found.next_SE3_first)[3:])
        rms.append(float(np.sqrt(np.mean(np.square(errors)))))
    assert rms[0] < 0.8 * rms[1]


def behind_a_lorry() -> tuple[np.ndarray, np.ndarray]:
    """Two looks at 300 points, of which the first 180 drive along at the car's own speed."""
    rng = np.random.default_rng(1)
    points = scene(rng, 300)
    first = seen(points, rng)
    second = seen(se3.apply(TRUTH, points), rng)
    second[:180] = first[:180] + rng.normal(0, 0.3, (180, 3))
    return first, second


def test_a_lorry_on_most_of_the_image_is_outvoted_by_what_may_be_true() -> None:
    """60 % of the points drive along at the car's own speed: their motion lies outside the gate around INS."""
    first, second = behind_a_lorry()
    expected = TRUTH.copy()
    expected[2, 3] += 0.1
    found = estimate_motion(CAMERAS, first, second, np.full(300, 0.3), expected, LIMITS)
    assert found.status is MotionStatus.OK
    assert np.linalg.norm(error_of(found.next_SE3_first)[3:]) < 0.02
    assert found.inliers[:180].mean() < 0.2
    assert found.inliers[180:].mean() > 0.9


def test_a_guess_that_most_points_follow_spares_the_search(monkeypatch: pytest.MonkeyPatch) -> None:
    first, second, sigma = observe(np.random.default_rng(3))
    searched = estimate_motion(CAMERAS, first, second, sigma, np.eye(4), WIDE)
    near = TRUTH @ se3.se3(Rotation.from_rotvec([0.0, 0.0003, 0.0]).as_matrix(), [0.0, 0.0, 0.01])

    def no_search(*_: object) -> None:
        raise AssertionError("searched among hypotheses")

    monkeypatch.setattr(stereo_motion, "_hypotheses", no_search)
    guessed = estimate_motion(CAMERAS, first, second, sigma, np.eye(4), WIDE, guess=near)
    # One point at the bound more or less.
    assert (guessed.inliers != searched.inliers).mean() < 0.02
    apart = error_of(guessed.next_SE3_first) - error_of(searched.next_SE3_first)
    assert (np.abs(apart) < 0.25 * np.sqrt(np.diag(searched.cov))).all()


def test_a_guess_outside_of_the_gate_is_not_believed_however_many_follow_it() -> None:
    """Most points are a lorry's, whose motion was the guess: what may be true is searched for."""
    first, second = behind_a_lorry()
    found = estimate_motion(CAMERAS, first, second, np.full(300, 0.3), TRUTH, LIMITS, guess=np.eye(4))
    assert found.status is MotionStatus.OK
    assert found.inliers[:180].mean() < 0.2


def test_a_lorry_on_all_of_the_image_gives_no_motion() -> None:
    rng = np.random.default_rng(2)
    first = seen(scene(rng, 200), rng)
    second = first + rng.normal(0, 0.3, first.shape)
    found = estimate_motion(CAMERAS, first, second, np.full(200, 0.3), TRUTH, LIMITS)
    assert found.status is MotionStatus.NO_CONSENSUS


@pytest.mark.parametrize("count", [0, 2, 24])
def test_too_few_points(count: int) -> None:
    first, second, sigma = observe(np.random.default_rng(5), count)
    assert estimate_motion(CAMERAS, first, second, sigma, TRUTH, LIMITS).status is MotionStatus.TOO_FEW_POINTS


def test_points_that_are_no_numbers_are_left_out() -> None:
    first, second, sigma = observe(np.random.default_rng(6))
    first[::10], second[5::10] = np.nan, np.inf
    found = estimate_motion(CAMERAS, first, second, sigma, TRUTH, LIMITS)
    assert found.status is MotionStatus.OK
    assert not found.inliers[::10].any() and not found.inliers[5::10].any()


def test_far_points_alone_do_not_tell_how_far_the_car_drove() -> None:
    rng = np.random.default_rng(7)
    points = scene(rng) * 60
    found = estimate_motion(
        CAMERAS, seen(points, rng), seen(se3.apply(TRUTH, points), rng), np.full(len(points), 0.3), TRUTH, LIMITS
    )
    assert found.status is MotionStatus.TOO_FEW_POINTS


def test_a_motion_without_covariance_is_refused() -> None:
    with pytest.raises(ValueError, match="21 numbers"):
        RelativeMotion(
            first_frame_index=0, second_frame_index=1, second_SE3_first=se3.to_matrix4(TRUTH), cov=(), inlier_count=1,
            point_count=1, reason="ok",
        )  # fmt: skip
