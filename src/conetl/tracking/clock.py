"""Offset between the clock of the cameras and that of GNSS/INS, from visual odometry against the logged poses.

Turns and changes of speed that the images show earlier or later than the log give the offset (the idea of Rehder, Siegwart &
Furgale 2016, with motions in place of feature tracks). A boresight error and an error of scale, which act on the same motions,
are estimated along with it, and changes of the relative error of visual odometry within the drive. On a straight drive at
constant speed the offset cannot be observed, and its sigma says so.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d, median_filter
from scipy.spatial.transform import Rotation

from conetl.geometry import pose as se3
from conetl.geometry.motion.pose_graph import LoggedPoses, MeasuredMotions
from conetl.geometry.packing import vec3
from conetl.geometry.small_arrays import cross_matrix
from conetl.model.arrays import Floats
from conetl.model.drive import FramePair

#: Offsets that are tried, s.
_TRIED_S = np.arange(-0.4, 0.41, 0.04)
#: Both signals are smoothed by this many intervals, so that interpolation smooths the noise of the log no further: it would draw
#: the offset towards the middle between two records.
_SMOOTHED, _MOST_CORRELATED = 1.5, 10.0
#: ... which leaves this share of the sigma of independent values.
_NOISE_SHARE = (4 * np.pi * _SMOOTHED**2) ** -0.25
#: Sigmas of a boresight error (rad) and of the scale beside the offset, and of the changes of the scale within the drive, half a
#: wave and a whole one.
_BORESIGHT_RAD, _SCALE, _SCALE_CHANGES = 0.03, 0.02, (0.003, 0.003)
_UNKNOWNS = 5 + len(_SCALE_CHANGES)
#: An offset is corrected from this many seconds, and this many of its sigmas, on, if it is known this well.
LEAST_S, _SIGNIFICANT, MAX_SIGMA_S = 0.005, 4.0, 0.01
#: ... and from this many of its sigmas on it widens those of the positions.
_DOUBTFUL = 2.0
_ITERATIONS, _HUBER, _LEAST_INTERVALS = 12, 2.0, 20
#: Between sparse records poses have errors for seconds: fewer of them may agree with another offset by chance.
_LEAST_RECORDS = 10
_CUT, _LAGS = 3.0, 6
#: What a vehicle may gain or lose in speed, m/s^2, how many intervals around one show what is usual, and what is beyond noise.
_ACCELERATION, _AROUND, _NOISE = 8.0, 4, 8.0
#: A sigma from a median has this share of the degrees of freedom of its values; few make errors Student's, not normal.
_MEDIAN_SHARE, _LEAST_FREEDOM = 0.37, 4.0
#: An offset that differs by this much must fit worse by this much (chi-square of one degree of freedom at 5 sigma).
_APART_S, _LEAST_GAIN = 0.1, 25.0
#: Errors of 1,150 offsets on simulated drives (`make bench-health`) in sigmas of the adjustment, root mean square.
_UNDERSTATED = 1.04


class ClockOffset(NamedTuple):
    """By how much the stamps of the poses lag behind those of the images (s), with its sigma."""

    offset_s: float
    sigma_s: float

    def is_applied(self, assumed_s: float) -> bool:
        """Whether the poses must be corrected by it: where it is significant, or much better known than the sigma of the clocks
        without it, which is large where they were not synchronised."""
        significant = abs(self.offset_s) > max(LEAST_S, _SIGNIFICANT * self.sigma_s)
        better = assumed_s > LEAST_S and 2 * self.sigma_s <= assumed_s
        shown = self.sigma_s <= MAX_SIGMA_S and abs(self.offset_s) < _TRIED_S[-1] - 0.02
        return shown and (significant or better)

    def remaining_s(self, assumed_s: float) -> float:
        """Sigma of the remaining offset: of the correction, else as assumed, and wider if the drive contradicts that."""
        if self.is_applied(assumed_s):
            return self.sigma_s
        doubtful = self.sigma_s <= MAX_SIGMA_S and abs(self.offset_s) > _DOUBTFUL * self.sigma_s
        return max(assumed_s, abs(self.offset_s) if doubtful else 0.0)


def estimate_clock(
    frame_pairs: Sequence[FramePair], log: LoggedPoses, motions: MeasuredMotions, *, by_speeds: bool = False
) -> ClockOffset | None:
    """The offset under which logged and measured motions agree best; None where the drive does not show it.

    by_speeds: the attitudes of the log are those of visual odometry, so that only velocities in the map's frame show it.
    """
    if len(motions.start) < _LEAST_INTERVALS:
        return None
    times_s = _times_s(frame_pairs)
    gaps_s = [pair.pose.interpolated.apart_s for pair in frame_pairs if pair.pose.interpolated is not None]
    if gaps_s and times_s[-1] < _LEAST_RECORDS * np.median(gaps_s):
        return None
    steps_s, middle_s = np.diff(times_s), (times_s[1:] + times_s[:-1]) / 2
    left = se3.compose(se3.se3(log.rotations, log.positions), log.body_SE3_left)
    rates = _rates(se3.compose(se3.invert(left[1:]), left[:-1]), steps_s)
    axes = left[1:, :3, :3] if by_speeds else np.eye(3)
    rates[:, 3:] = (axes @ rates[:, 3:, None])[..., 0]
    logged = smoothed(rates, _without_jumps(rates, steps_s))
    known = np.zeros(len(steps_s))
    known[motions.start] = 1.0
    raw = np.zeros((len(steps_s), 6))
    raw[motions.start] = _rates(motions.next_SE3_first, steps_s[motions.start])
    raw[:, 3:] = (axes @ raw[:, 3:, None])[..., 0]
    measured = smoothed(raw, known)
    used = (known > 0) & (middle_s - _TRIED_S.max() >= middle_s[0]) & (middle_s - _TRIED_S.min() <= middle_s[-1])
    if used.sum() < _LEAST_INTERVALS:
        return None
    # A smoothed value beside a gap is that of another instant, away from the gap. The slopes are those of the images: those of
    # the log have more noise, and would make the sigma of the offset too small.
    centre_s = smoothed(middle_s[:, None], known)[:, 0]
    there = known > 0
    shown = slice(3 if by_speeds else 0, 6)
    signal, at_s, target = CubicSpline(middle_s, logged), centre_s[used], measured[used]
    by = _derivatives(target, CubicSpline(centre_s[there], measured[there])(at_s, 1))[:, shown]
    # Of few intervals, the residuals of one column may all be small by chance: it would outweigh the others.
    stated = np.sqrt(np.median(np.diagonal(motions.cov, axis1=1, axis2=2), axis=0)) / np.median(steps_s)
    least = (_NOISE_SHARE * stated)[shown]
    prior = np.diag([0.0, *[_BORESIGHT_RAD**-2] * 3, *(sigma**-2 for sigma in (_SCALE, *_SCALE_CHANGES))])

    def misfit(offset_s: float) -> Floats:
        return np.asarray((target - signal(at_s - offset_s))[:, shown])

    fits = {float(tried): robust_fit(misfit(tried), by, prior, 3, held=True, least_sigma=least) for tried in _TRIED_S}
    offset_s = min(fits, key=lambda tried: float(np.log(fits[tried].sigma).sum()))
    for _ in range(_ITERATIONS):
        fit = robust_fit(misfit(offset_s), by, prior, 5, least_sigma=least)
        offset_s = float(np.clip(offset_s + fit.solution[0], _TRIED_S[0], _TRIED_S[-1]))
        if abs(fit.solution[0]) < 1e-5:
            break
    # Where the drive does not show the offset, others fit nearly as well.
    best = _misfit2(fit.left_over, fit)
    others = [_misfit2(other.left_over, fit) for tried, other in fits.items() if abs(tried - offset_s) >= _APART_S]
    if min(others) - best < _LEAST_GAIN:
        return None
    by_log = _derivatives(signal(at_s - offset_s), signal(at_s - offset_s, 1))[:, shown]
    weighted = (by * fit.weight[..., None]).reshape(-1, _UNKNOWNS)
    back = np.linalg.inv(weighted.T @ by_log.reshape(-1, _UNKNOWNS) + prior)
    return ClockOffset(offset_s, _UNDERSTATED * float((back @ fit.normal @ back.T)[0, 0] ** 0.5))


def _derivatives(rates: Floats, slope: Floats) -> Floats:
    """(N, 6, 7): derivatives of rates (N, 6) whose change with time is `slope` by offset, boresight, scale and its changes."""
    by = np.zeros((*rates.shape, _UNKNOWNS))
    by[..., 0] = -slope
    by[:, :3, 1:4], by[:, 3:, 1:4] = -cross_matrix(rates[:, :3]), -cross_matrix(rates[:, 3:])
    waves = np.cos(np.pi * np.linspace(0, 1, len(rates))[:, None] * np.arange(_UNKNOWNS - 4))
    by[:, 3:, 4:] = rates[:, 3:, None] * waves[:, None]
    return by


class Fit(NamedTuple):
    """Result of `robust_fit` of C columns by P unknowns."""

    solution: Floats
    """(P,): the change of the offset is the first."""
    normal: Floats
    """(P, P)"""
    sigma: Floats
    """(C,) of what remains, by column."""
    counted: Floats
    """(C,): so many successive values count as one."""
    left_over: Floats
    """(N, C)"""
    weight: Floats
    """(N, C)"""


def robust_fit(
    misfit: Floats,
    by: Floats,
    prior: Floats,
    rounds: int,
    *,
    held: bool = False,
    lags: int = _LAGS,
    least_sigma: float | Floats = 1e-9,
) -> Fit:
    """Robust least squares of misfits (N, C) with the derivatives by (N, C, P); prior (P, P): information on the unknowns.

    held: without a change of the first unknown, the offset. lags: so many successive values may be correlated. least_sigma: (C,)
    of what remains, whatever the residuals.
    """
    unknowns = len(prior)
    free = slice(1 if held else 0, unknowns)
    solution, normal, left_over = np.zeros(unknowns), prior, misfit
    # Oscillating turns suffer from noise of the same frequency.
    alike = _autocorrelations(by[..., 0], lags)
    for _ in range(rounds):
        sigma = np.maximum(1.4826 * np.median(np.abs(left_over), axis=0), least_sigma)  # robust, around zero
        repeats = _autocorrelations(np.clip(left_over / sigma, -_CUT, _CUT), lags)
        freedom = np.maximum(_MEDIAN_SHARE * len(misfit) / (1 + 2 * (repeats**2).sum(axis=0)), _LEAST_FREEDOM)
        sigma *= np.sqrt(freedom / (freedom - 2))
        counted = np.clip(1 + 2 * (repeats * alike).sum(axis=0), 1.0, max(_MOST_CORRELATED, lags))
        weight = np.minimum(1.0, _HUBER / np.maximum(np.abs(left_over / sigma), 1e-9)) / sigma**2 / counted
        weighted = (by * weight[..., None]).reshape(-1, unknowns).T
        normal, right = weighted @ by.reshape(-1, unknowns) + prior, weighted @ misfit.ravel()
        solution = np.zeros(unknowns)
        solution[free] = np.linalg.solve(normal[free, free], right[free])
        left_over = misfit - by @ solution
    return Fit(solution, normal, sigma, counted, left_over, weight)


def _misfit2(left_over: Floats, fit: Fit) -> float:
    """Squared residuals by the sigmas of a fit, outliers cut."""
    return float((np.minimum((left_over / fit.sigma) ** 2, _CUT**2) / fit.counted).sum())


def _autocorrelations(values: Floats, most: int) -> Floats:
    """(L, C) of each column (N, C), around zero, for lags of 1 to L, at most `most`."""
    energy = np.maximum((values**2).mean(axis=0), 1e-12)
    lags = range(1, min(most, len(values) - 1) + 1)
    return np.array([(values[lag:] * values[:-lag]).mean(axis=0) / energy for lag in lags])


def _rates(next_SE3_first: Floats, steps_s: Floats) -> Floats:
    """(N, 6): turn rate (rad/s) and speed (m/s) of motions (N, 4, 4)."""
    turn = Rotation.from_matrix(next_SE3_first[:, :3, :3]).as_rotvec()
    return np.hstack([turn, next_SE3_first[:, :3, 3]]) / steps_s[:, None]


def _without_jumps(rates: Floats, steps_s: Floats) -> Floats:
    """(N,) 0 where the log changes its speed faster than a vehicle can, else 1: a jump would bias the offset."""
    usual = median_filter(rates[:, 3:], size=(2 * _AROUND + 1, 1), mode="nearest")
    apart = np.linalg.norm(rates[:, 3:] - usual, axis=1)
    most = max(_ACCELERATION * _AROUND * float(np.median(steps_s)), _NOISE * float(np.median(apart)))
    return np.where(apart <= most, 1.0, 0.0)


def smoothed(signal: Floats, known: Floats, intervals: float = _SMOOTHED) -> Floats:
    """(N, C) a signal with gaps, smoothed by this many intervals; known (N,): 1 where it has a value, else 0."""
    weight = gaussian_filter1d(known, intervals, mode="nearest")
    total = gaussian_filter1d(signal * known[:, None], intervals, axis=0, mode="nearest")
    return np.asarray(total / np.maximum(weight, 1e-6)[:, None])


def at_images(frame_pairs: Sequence[FramePair], log: LoggedPoses, offset_s: float) -> tuple[FramePair, ...]:
    """The frame pairs with the poses of their own instants, where the stamps of the log lag by `offset_s`."""
    times_s = _times_s(frame_pairs)
    wanted_s = times_s - offset_s
    k = np.clip(np.searchsorted(times_s, wanted_s, side="right") - 1, 0, len(times_s) - 2)
    share = (wanted_s - times_s[k]) / (times_s[k + 1] - times_s[k])
    turn = Rotation.from_matrix(np.swapaxes(log.rotations[k], 1, 2) @ log.rotations[k + 1]).as_rotvec()
    rotations = log.rotations[k] @ Rotation.from_rotvec(share[:, None] * turn).as_matrix()
    places = log.positions[k] + share[:, None] * (log.positions[k + 1] - log.positions[k])
    return tuple(
        pair.with_pose(map_R_body=se3.to_matrix3(rotation), map_t_body_m=vec3(place))
        for pair, rotation, place in zip(frame_pairs, rotations, places, strict=True)
    )


def _times_s(frame_pairs: Sequence[FramePair]) -> Floats:
    return np.array([pair.captured_at_ns - frame_pairs[0].captured_at_ns for pair in frame_pairs]) * 1e-9
