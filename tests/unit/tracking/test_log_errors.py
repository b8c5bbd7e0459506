"""The shares of a log's errors are found whatever their spectrum, and a variance that is too small is found out."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from conetl.geometry.motion.pose_graph import LoggedPoses, MeasuredMotions
from conetl.model.params import TrajectoryParams
from conetl.tracking.log.log_errors import ErrorShares, LogErrors, StatedErrors, estimate_log_errors, sigma_levels
from conetl.tracking.log.path_fit import PathFit, fit_path
from tests.cases import cases

Floats = NDArray[np.float64]
PARAMS = TrajectoryParams()
FRAMES, STEP_S, SPEED_M_S, VO_M = 150, 0.1, 12.0, 0.004
Errors = Callable[[np.random.Generator, Floats], Floats]


def walk(rng: np.random.Generator, times_s: Floats, lasts_s: float) -> Floats:
    """(K, 3) Gauss-Markov process of unit variance."""
    keep = np.exp(-STEP_S / lasts_s)
    found = rng.normal(0, 1, (len(times_s), 3))
    for k in range(1, len(times_s)):
        found[k] = keep * found[k - 1] + np.sqrt(1 - keep**2) * found[k]
    return found


def constant(rng: np.random.Generator, times_s: Floats) -> Floats:
    return np.tile(rng.normal(0, 1, 3), (len(times_s), 1))


def white(rng: np.random.Generator, times_s: Floats) -> Floats:
    return rng.normal(0, 1, (len(times_s), 3))


def saw_tooth(rng: np.random.Generator, times_s: Floats) -> Floats:
    return (np.mod(times_s + rng.uniform(), 1.0)[:, None] - 0.5) * 12**0.5 * rng.choice([-1, 1], 3)


def made(
    seed: int, errors: Errors, sigma_m: float, *, factor: float = 1.0, stated_m: Floats | None = None
) -> tuple[LoggedPoses, MeasuredMotions, StatedErrors]:
    """A drive on a bend whose log errs by `factor` times what it states; attitudes are exact, and stated to 0.05 degrees."""
    rng, times_s = np.random.default_rng(seed), np.arange(FRAMES) * STEP_S
    yaw = 0.3 + 0.15 * np.sin(0.3 * times_s)
    ahead = np.stack([np.cos(yaw), np.sin(yaw), np.zeros(FRAMES)], axis=1)
    path = np.cumsum(ahead, axis=0) * SPEED_M_S * STEP_S
    # The body looks along its x axis, the camera along its z axis.
    rotations = np.stack(
        [ahead, np.stack([-ahead[:, 1], ahead[:, 0], 0 * yaw], axis=1), np.tile([0, 0, 1.0], (FRAMES, 1))], axis=2
    )
    body_SE3_left = np.eye(4)
    body_SE3_left[:3, :3] = np.array([[0, 0, 1.0], [-1, 0, 0], [0, -1, 0]])
    left = rotations @ body_SE3_left[:3, :3]
    steps = np.diff(path, axis=0) + rng.normal(0, VO_M, (FRAMES - 1, 3))
    motions = np.tile(np.eye(4), (FRAMES - 1, 1, 1))
    motions[:, :3, :3] = np.swapaxes(left[1:], 1, 2) @ left[:-1]
    motions[:, :3, 3] = -np.einsum("mji,mj->mi", left[1:], steps)
    cov = np.tile(np.diag([1e-8] * 3 + [VO_M**2] * 3), (FRAMES - 1, 1, 1))
    sigma = np.full((FRAMES, 3), sigma_m) if stated_m is None else stated_m
    logged = path + factor * sigma * errors(rng, times_s)
    stated = np.hstack([sigma, np.full((FRAMES, 3), 0.0009)])
    unused = np.ones((FRAMES, 6))
    log = LoggedPoses(
        rotations,
        logged,
        sigma,
        unused,
        unused,
        unused[1:],
        body_SE3_left,
        unused,
        unused,
        unused[0, :3],
        unused[1:, :3],
        np.zeros(FRAMES),
    )
    records = StatedErrors(times_s, stated, np.zeros((FRAMES, 6)), np.zeros(FRAMES), np.zeros(FRAMES))
    return log, MeasuredMotions(np.arange(FRAMES - 1), motions, cov), records


def found(*args: object, **options: object) -> LogErrors:
    log, motions, records = made(*args, **options)  # type: ignore[arg-type]
    return estimate_log_errors(log, log.rotations, log.positions, motions, records, PARAMS)


@pytest.mark.parametrize("sigma_m", cases(0.3, release=[0.05]))
@pytest.mark.parametrize(
    ("errors", "expected"),
    [
        (constant, {"smooth": (0.9, 1.0)}),
        (lambda rng, t: walk(rng, t, 20.0), {"white": (0.0, 0.01), "fast": (0.0, 0.1)}),
        (white, {"white": (0.8, 1.0)}),
        (saw_tooth, {"fast": (0.8, 1.0)}),
        (lambda rng, t: 0.5**0.5 * (white(rng, t) + constant(rng, t)), {"white": (0.3, 0.7)}),
    ],
)
def test_shares_are_found_whatever_the_spectrum(
    errors: Errors, expected: dict[str, tuple[float, float]], sigma_m: float
) -> None:
    each = [found(seed, errors, sigma_m).horizontal for seed in range(3)]
    for name, (low, high) in expected.items():
        assert low < np.median([getattr(one, name) for one in each]) <= high, each
    assert [one.factor for one in each] == [1.0] * 3


def test_a_constant_error_is_told_from_one_that_changes() -> None:
    """By what an error is expected to have in common with that of 30 s later."""

    def common(shares: ErrorShares) -> float:
        apart = 3**0.5 * 30 / shares.smooth_s
        return shares.slow * np.exp(-30 / shares.slow_s) + shares.smooth * (1 + apart) * np.exp(-apart)

    changes, lasts = (found(1, errors, 0.3).horizontal for errors in (lambda rng, t: walk(rng, t, 20.0), constant))
    assert changes.white + changes.fast < 0.1 and common(changes) < 0.4
    assert common(lasts) > 0.6


@pytest.mark.parametrize("part", cases(0.25, release=[0.5]))
def test_the_rate_of_a_wave_is_found_of_which_a_drive_shows_a_part(part: float) -> None:
    """A Matern process of order 3/2 takes it for a slower one: a wave is smoother."""

    def wave(rng: np.random.Generator, t: Floats) -> Floats:
        angle = 2 * np.pi * part * t[:, None] / t[-1]
        return np.asarray(np.cos(angle) * rng.normal(0, 1, 3) + np.sin(angle) * rng.normal(0, 1, 3))

    rates = [(3 * one.smooth) ** 0.5 / one.smooth_s for one in (found(k, wave, 0.3).horizontal for k in range(5))]
    assert 0.6 < np.median(rates) / (2 * np.pi * part / ((FRAMES - 1) * STEP_S)) < 1.7, rates


@pytest.mark.parametrize("errors", [white, lambda rng, t: walk(rng, t, 1.0)])
def test_sigmas_that_are_too_small_grow_until_they_fit(errors: Errors) -> None:
    factors = [found(seed, errors, 0.05, factor=3.0).horizontal.factor ** 0.5 for seed in range(4)]
    assert 2.2 < np.median(factors) < 4.0


def test_levels_follow_solutions_not_noise() -> None:
    """Of a fix and a float solution only the smaller part is common; sigmas that vary by a few per cent are one level."""
    noisy = 0.02 * (1 + 0.03 * np.random.default_rng(0).uniform(-1, 1, 50))
    levels, changes = sigma_levels(noisy[:, None], np.zeros(50))
    assert (levels == levels[0]).all() and not changes.any()
    _, changes = sigma_levels(np.array([0.02, 0.02, 0.5, 0.5, 0.02])[:, None], np.zeros(5))
    assert np.exp(-changes[:, 0]) == pytest.approx([1, 1, 0.04, 0.04, 0.0016])
    grows = np.geomspace(0.02, 1.0, 50)  # without GNSS
    levels, _ = sigma_levels(grows[:, None], np.zeros(50))
    assert levels[:, 0] == pytest.approx(grows, rel=0.1) and (np.diff(levels[:-2, 0]) > 0).all()


def test_what_a_log_cannot_explain_is_estimated_and_its_sigma_holds() -> None:
    squares = np.zeros(7)
    for seed in range(20):
        log, motions, records = made(seed, lambda rng, t: walk(rng, t, 20.0), 0.02)
        errors = LogErrors(*[ErrorShares(0.01, 0.0, 0.99, 0.0, 0.7, 20.0, 20.0)] * 4)
        fit = fit_path(log, log.rotations, None, motions, records, errors, PARAMS)
        squares += (fit.found / fit.sigma) ** 2
        assert not fit.doubtful.any()
    assert (squares / 20 < 2.0).all()


def test_noise_of_the_images_of_a_standing_vehicle_is_no_scale() -> None:
    """It is in the measured path and in what differs from it: by that path, the scale was 1."""
    off = []
    for seed in range(20):
        log, motions, records = made(seed, constant, 0.02)
        log.positions[:] = log.positions[0]
        shifts_m = np.random.default_rng(seed).normal(0, VO_M, (FRAMES - 1, 3))
        motions.next_SE3_first[:, :3, 3] = shifts_m
        errors = LogErrors(*[ErrorShares(0.01, 0.0, 0.99, 0.0, 0.7, 20.0, 20.0)] * 4)
        scale, sigma = fit_path(log, log.rotations, log.positions, motions, records, errors, PARAMS).scale
        off.append(scale / sigma)
    assert abs(np.mean(off)) < 0.5 and np.sqrt(np.mean(np.square(off))) < 1.3


@pytest.mark.parametrize(("scale", "aside_rad"), [(0.02, 0.0), (0.0, 0.01), (-0.01, -0.005)])
def test_a_wrong_scale_and_direction_are_found_and_may_be_a_drift(scale: float, aside_rad: float) -> None:
    fit = with_wrong_motions(scale, aside_rad)
    assert fit.found[:2] == pytest.approx([scale, aside_rad], abs=0.0015)
    assert fit.doubtful.tolist() == [abs(scale) > 0.006, abs(aside_rad) > 0.004, False]
    drifts = fit.drifts()
    assert drifts.shape == (FRAMES, 3, 2 * int(fit.doubtful.sum()))
    half_m = np.abs(drifts).max(axis=(0, 1)) / (FRAMES * STEP_S * SPEED_M_S / 2)
    assert half_m.max() == pytest.approx(max(abs(scale), abs(aside_rad)), rel=0.15)


def with_wrong_motions(scale: float, aside_rad: float) -> PathFit:
    """Images that show longer distances, by cameras that look to the left."""
    log, motions, records = made(3, constant, 0.02)
    turn = np.eye(4)
    turn[0, 0] = turn[2, 2] = np.cos(aside_rad)
    turn[0, 2], turn[2, 0] = np.sin(aside_rad), -np.sin(aside_rad)
    wrong = motions.next_SE3_first.copy()
    wrong[:, :3, 3] = (1 + scale) * wrong[:, :3, 3] @ turn[:3, :3].T
    errors = LogErrors(*[ErrorShares(0.01, 0.0, 0.99, 0.0, 0.7, 20.0, 20.0)] * 4)
    return fit_path(log, log.rotations, None, motions._replace(next_SE3_first=wrong), records, errors, PARAMS)
