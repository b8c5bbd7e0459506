"""The model of a log's errors, which the adjustment of the poses and all checks of them share, and its estimate from one drive.

The error of each coordinate and angle is the sum of a slow part (first-order Gauss-Markov, in the limit a constant), a fast one
(lasting up to seconds: corrections once a second, interpolation, vibration) and white noise; the stamps of the records jitter.
A log states the variance of the sum. How it is shared differs from receiver to receiver, and images show it: visual odometry is
accurate to millimetres from frame to frame. So the shares are estimated for each drive by restricted maximum likelihood
(variance components, e.g. Koch 1999, ch. 3.6) with priors, from the difference between the logged and the measured path. If they
exceed the stated variance significantly, the variance grows until it fits (`ErrorShares.factor`).

What all records have in common cannot be seen in one drive. It is what the other parts leave of the stated variance.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

from conetl.geometry.linear_reference import evenly_spaced
from conetl.geometry.motion.pose_graph import LoggedPoses, MeasuredMotions, motion_residuals
from conetl.model.arrays import Floats, Ints
from conetl.model.params import TrajectoryParams
from conetl.tracking.log.path_difference import (
    LEAST_APART_S,
    UNKNOWN,
    PathDifference,
    measured_cov,
    path_changes,
    path_difference,
)

#: Axes whose errors have the same shares: easting and northing, height, roll and pitch, heading.
GROUPS = ((0, 1), (2,), (3, 4), (5,))
#: Frames that are compared: so many evenly spaced ones, and runs of successive ones.
_SPACED, _RUNS, _RUN = 48, 3, 24
#: Prior sigmas of the logarithms of white and fast over slow share, of the times of the fast and the slow part, of the jitter of
#: the stamps, and of the factor on the stated variance.
_PRIOR_SIGMA = np.array([8.0, 8.0, 0.7, 2.0, 1.0, 0.7])
_FAST_SHARE, _FAST_S, _FAST_RANGE_S, _SLOW_RANGE_S = 0.01, 0.7, (0.15, 3.0), (5.0, 600.0)
_LEAST_JITTER_S, _MOST_FACTOR = 1e-6, 20.0
#: Chi-square of one degree of freedom at 0.05 above which the variance grows.
_SIGNIFICANT = 3.84
#: Unknowns that are fitted to the same records.
_FITTED = 4
#: Share of its sampling error that a share of nearly 1 leaves to the slow part.
_LEFT = 0.1
#: Of normal errors, from the median of their absolute values; what the white part leaves at least.
_SIGMA_OF_MEDIAN, _LEAST_SLOW = 1.4826, 1e-3
#: Stated sigmas that differ by less than this factor have the same cause.
_SAME_SIGMA = 1.1
_LEAST_VAR = 1e-6
#: Sigma of the alignment of cameras and body in addition to the stated attitudes, which is checked separately.
_ALIGNMENT_RAD = 0.004


class ErrorShares(NamedTuple):
    """Shares of the variance of one group of axes; they add up to 1."""

    white: float
    fast: float
    fast_s: float
    """Correlation time of the fast part."""
    slow_s: float
    """Correlation time of the rest."""
    jitter_s: float = 0.0
    """Sigma of the time stamps' jitter, in addition to the stated variance."""
    factor: float = 1.0
    """By which the stated variance is too small."""
    constant: float = 1.0
    """Likelihood, relative to the best, that the rest does not change within the drive at all."""

    @property
    def slow(self) -> float:
        return 1.0 - self.white - self.fast


class StatedErrors(NamedTuple):
    """What a log states of K records; position (m) before attitude (rad)."""

    times_s: Floats
    """(K,) since the first."""
    stated: Floats
    """(K, 6): sigmas, without what interpolation adds."""
    between: Floats
    """(K, 6): sigmas that interpolation between records adds."""
    apart_s: Floats
    """(K,): time between the records that are interpolated, else 0."""


class LogErrors(NamedTuple):
    """Shares for each of the `GROUPS`."""

    horizontal: ErrorShares
    up: ErrorShares
    tilt: ErrorShares
    heading: ErrorShares

    def by_axis(self, field: str) -> Floats:
        """(6,): a field for position before attitude."""
        return np.array([getattr(self[group], field) for group, axes in enumerate(GROUPS) for _ in axes])


def assumed_errors(params: TrajectoryParams) -> LogErrors:
    """The shares of a log that cannot be compared with images."""
    position = ErrorShares(params.gnss_white_share**2, 0.0, _FAST_S, params.gnss_correlation_s)
    attitude = ErrorShares(params.attitude_white_share**2, 0.0, _FAST_S, params.attitude_correlation_s)
    return LogErrors(position, position, attitude, attitude)


def rough_errors(log: LoggedPoses, motions: MeasuredMotions, params: TrajectoryParams) -> LogErrors:
    """The assumed shares, with a white share by how much the log scatters against the motions, in the median.

    Of white errors the second differences have six times the variance; a lorry that fills the images for seconds changes two.
    """
    assumed = assumed_errors(params)
    residual, _, _ = motion_residuals(log, log.rotations, log.positions, motions, 0.0)
    map_R_left = log.rotations[motions.start + 1] @ log.body_SE3_left[:3, :3]
    shifts = np.einsum("mij,mj->mi", map_R_left, residual[:, 3:])
    each = np.hstack([shifts, residual[:, :3] @ log.body_SE3_left[:3, :3].T])
    bends = np.diff(each, axis=0)[np.diff(motions.start) == 1]
    if not len(bends):
        return assumed
    scatter = _SIGMA_OF_MEDIAN * np.median(np.abs(bends), axis=0) / 6**0.5
    total = np.median(np.hypot(log.own, log.drift), axis=0)
    shares = np.minimum((scatter / total) ** 2, 1.0 - _LEAST_SLOW)
    rough = [float(shares[list(axes)].max()) for axes in GROUPS]
    found = [one._replace(white=max(one.white, share)) for one, share in zip(assumed, rough, strict=True)]
    return LogErrors(found[0]._replace(jitter_s=params.clock_sigma_s), *found[1:])


def sigma_levels(stated: Floats) -> tuple[Floats, Floats]:
    """(K, n) levels of stated sigmas (K, n), and the sums of the changes of their logarithms from the first record on.

    A receiver that finds another solution, or an INS without one, has other errors: of two sigmas at most the smaller one is
    common to both. Changes by less than a tenth are noise of the sigmas.
    """
    levels = stated.copy()
    for k in range(1, len(levels)):
        same = np.abs(np.log(stated[k] / levels[k - 1])) < np.log(_SAME_SIGMA)
        levels[k, same] = levels[k - 1, same]
    return levels, np.cumsum(np.abs(np.diff(np.log(levels), axis=0, prepend=np.log(levels[:1]))), axis=0)


def estimate_log_errors(
    log: LoggedPoses, rotations: Floats, motions: MeasuredMotions, records: StatedErrors, params: TrajectoryParams
) -> LogErrors:
    """The shares of a log that is compared with the motions that images show; arguments as for `path_difference`."""
    assumed = assumed_errors(params)
    difference = path_difference(log, rotations, motions, records.times_s, params)
    tilt, heading = (
        np.hypot(np.median(records.stated[:, axes].max(axis=1)), _ALIGNMENT_RAD) for axes in ((3, 4), (5,))
    )
    sigmas = np.array([params.scale_sigma, heading, tilt, *[params.lever_arm_sigma_m] * 3, params.clock_sigma_s])
    columns = path_changes(difference) * sigmas
    frames = compared_frames(records)
    shares = []
    for group, axes in enumerate(GROUPS):
        parts = [
            difference_terms(difference, records, frames, axis, columns if axis < 3 else None, group == 0)
            for axis in axes
        ]
        shares.append(_estimated(parts, assumed[group], 0.0 if group else params.clock_sigma_s))
    return LogErrors(*shares)


class DifferenceTerms(NamedTuple):
    """The parts of the covariance (N, N) of one difference."""

    off: Floats
    base: Floats
    stated: Floats
    """(N, N) products of the stated sigmas."""
    apart_s: Floats
    """(N, N)"""
    changed: Floats
    """(N, N): share of the slow part that is common in spite of changes of the stated sigmas."""
    jitter: Floats
    """(N,) squared rates."""


def _estimated(parts: Sequence[DifferenceTerms], assumed: ErrorShares, jitter_s: float) -> ErrorShares:
    """The shares of one group of axes. assumed: without evidence; jitter_s: likewise, 0 where it is left to the white part."""
    middle = np.array([
        np.log(assumed.white / assumed.slow), np.log(_FAST_SHARE), np.log(_FAST_S), np.log(assumed.slow_s),
        np.log(max(jitter_s, _LEAST_JITTER_S)), 0.0,
    ])  # fmt: skip
    low, high = middle - 5 * _PRIOR_SIGMA, middle + 5 * _PRIOR_SIGMA
    low[2:4], high[2:4] = np.log([[_FAST_RANGE_S[0], _SLOW_RANGE_S[0]], [_FAST_RANGE_S[1], _SLOW_RANGE_S[1]]])

    def misfit(free: Floats, size: int) -> tuple[float, Floats]:
        given = np.concatenate([free, middle[size:]])
        off = (given - middle) / _PRIOR_SIGMA
        value, slope = float(off @ off) / 2, off / _PRIOR_SIGMA
        for part in parts:
            own, own_slope = _misfit(part, given)
            value, slope = value + own, slope + own_slope
        return value, slope[:size]

    def fitted(start: Floats) -> Floats:
        size = len(start)
        bounds = list(zip(low[:size], high[:size], strict=True))
        found = minimize(misfit, start, (size,), jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": 30})
        return np.asarray(found.x)

    def unlikely(given: Floats) -> float:
        return sum(_misfit(part, given)[0] for part in parts)

    values = fitted(middle[: 5 if jitter_s else 4])
    full = np.concatenate([values, middle[len(values) :]])
    still, least = full.copy(), unlikely(full)
    still[3] = high[3]
    constant = float(np.exp(min(least - unlikely(still), 0.0)))
    if sum(_misfit(part, full)[1][5] for part in parts) < 0:  # a larger variance fits better
        low[5], high[5] = 0.0, _MOST_FACTOR
        larger = fitted(full)
        if 2 * (least - unlikely(larger)) > _SIGNIFICANT:
            full = larger
    count = sum(len(part.off) for part in parts)
    white, fast, slow = _shares(full)
    # Heading, slope, scale and clock were fitted to the same records: Student's variance of what is left.
    freedom = max(count - _FITTED, 1)
    white, fast = (share * (freedom + 4) / freedom for share in (white, fast))
    # A share is known to its sampling error only.
    slow = max(1.0 - white - fast, _LEFT * (2 / count) ** 0.5 * max(white, fast))
    return ErrorShares(
        white / (white + fast + slow), fast / (white + fast + slow), float(np.exp(full[2])), float(np.exp(full[3])),
        float(np.exp(full[4])) if jitter_s else 0.0, float(np.exp(full[5])), constant,
    )  # fmt: skip


def _shares(values: Floats) -> Floats:
    """(3,): white, fast and slow share."""
    raw = np.array([np.exp(values[0]), np.exp(values[1]), 1.0])
    return np.asarray(raw / raw.sum())


def compared_frames(records: StatedErrors, most: int = _SPACED + _RUNS * _RUN) -> Ints:
    """The frames that are compared, about so many: their number squared is kept, to the third power it takes time.

    Between two records an interpolated path has no errors of its own: of these frames, those nearest to the records.
    """
    times_s, every = records.times_s, np.arange(len(records.times_s))
    if records.apart_s.any():
        record = np.round(times_s / max(float(np.median(records.apart_s)), LEAST_APART_S)).astype(int)
        order = np.lexsort((records.between[:, 0], record))
        every = np.sort(order[np.concatenate([[True], np.diff(record[order]) > 0])])
    count = len(every)
    if count <= most:
        return every
    starts = np.linspace(0, count - _RUN, _RUNS).round().astype(int)
    runs = (starts[:, None] + np.arange(_RUN)).ravel()
    return np.asarray(
        every[np.unique(np.concatenate([runs, np.array(evenly_spaced(range(count), most - _RUNS * _RUN))]))]
    )


def difference_terms(
    difference: PathDifference, records: StatedErrors, frames: Ints, axis: int, columns: Floats | None, jitters: bool
) -> DifferenceTerms:
    """columns (K, 3, C): changes by one sigma of errors that are not the log's."""
    times_s, sigma = records.times_s[frames], records.stated[frames, axis]
    apart_s, stated = np.abs(times_s[:, None] - times_s), np.outer(sigma, sigma)
    off = difference.off[frames, axis]
    base = measured_cov(difference, records.stated, frames, axis) + UNKNOWN * stated.max()
    if columns is not None:
        base += columns[frames, axis] @ columns[frames, axis].T
    base[np.diag_indices_from(base)] += records.between[frames, axis] ** 2 + _LEAST_VAR * stated.min()
    levels, changes = (part[frames, 0] for part in sigma_levels(records.stated[:, axis : axis + 1]))
    changed = np.outer(levels, levels) / stated * np.exp(-np.abs(changes[:, None] - changes))
    rate = difference.velocity[frames, axis] if jitters else np.zeros(len(frames))
    return DifferenceTerms(off - off.mean(), base, stated, apart_s, changed, rate**2)


def log_cov(part: DifferenceTerms, shares: ErrorShares) -> Floats:
    """(N, N)"""
    own = shares.fast * np.exp(-part.apart_s / shares.fast_s)
    own += shares.slow * part.changed * np.exp(-part.apart_s / shares.slow_s)
    own[np.diag_indices_from(own)] += shares.white
    cov = part.base + shares.factor * part.stated * own
    cov[np.diag_indices_from(cov)] += shares.jitter_s**2 * part.jitter
    return np.asarray(cov)


def _misfit(part: DifferenceTerms, values: Floats) -> tuple[float, Floats]:
    """Minus the logarithm of the likelihood, and its derivatives (6,).

    values: logarithms of white and fast over slow share, of the correlation times (s), of the jitter (s), of the factor.
    """
    white, fast, slow = _shares(values)
    fast_s, slow_s, factor = np.exp(values[[2, 3, 5]])
    jitter = np.exp(2 * values[4])
    of_white = np.diag(np.diagonal(part.stated))
    of_fast = part.stated * np.exp(-part.apart_s / fast_s)
    of_slow = part.stated * part.changed * np.exp(-part.apart_s / slow_s)
    own = factor * (white * of_white + fast * of_fast + slow * of_slow)
    cov = part.base + own
    cov[np.diag_indices_from(cov)] += jitter * part.jitter
    try:
        factored = cho_factor(cov, lower=True)
    except np.linalg.LinAlgError:
        return 1e12, np.zeros(len(values))
    solved = cho_solve(factored, part.off)
    inverse = cho_solve(factored, np.eye(len(cov)))
    by_cov = (inverse - np.outer(solved, solved)) / 2
    by_white, by_fast, by_slow = (factor * float((by_cov * of).sum()) for of in (of_white, of_fast, of_slow))
    mean = white * by_white + fast * by_fast + slow * by_slow
    slope = np.array([
        white * (by_white - mean), fast * (by_fast - mean),
        factor * fast * float((by_cov * of_fast * part.apart_s).sum()) / fast_s,
        factor * slow * float((by_cov * of_slow * part.apart_s).sum()) / slow_s,
        2 * jitter * float(np.diagonal(by_cov) @ part.jitter), mean,
    ])  # fmt: skip
    value = float(np.log(np.diagonal(factored[0])).sum()) + float(part.off @ solved) / 2
    return value, slope
