"""The model of a log's errors, which the adjustment of the poses and all checks of them share, and its estimate from one drive.

The error of each coordinate and angle is the sum of a smooth part (Matern process of order 5/2: a drift, in the limit a constant;
of positions only), a slow one (first-order Gauss-Markov, as of receivers), a fast one (lasting up to seconds: corrections once a
second, interpolation, vibration) and white noise; the stamps of the records jitter. The adjustment follows the smooth part as a
process of order 3/2 of the same rate: here it would take a wave of which the drive shows a part for a slower one.
A log states the variance of the sum. How it is shared differs from receiver to receiver, and images show it: visual odometry is
accurate to millimetres from frame to frame. So the shares are estimated for each drive by restricted maximum likelihood
(variance components, e.g. Koch 1999, ch. 3.6) with priors, from the difference between the logged and the measured path. If they
exceed the stated variance significantly, the variance grows until it fits (`ErrorShares.factor`). A fixed white share of 10 %
held 392 of 920 simulated honest drives; estimating the shares inside the adjustment would repeat it some ten times.

What all records have in common cannot be seen in one drive. It is what the other parts leave of the stated variance. Nor do
images show most drifts: a scale or a turn within the calibration's errors makes the same path. Then the priors decide.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotri
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
#: Prior sigmas of the logarithms of white, fast and slow over smooth share, of the times of the fast, the slow and the smooth
#: part, of the jitter of the stamps, and of the factor on the stated variance.
_PRIOR_SIGMA = np.array([8.0, 8.0, 8.0, 0.7, 2.0, 1.5, 1.0, 0.7])
_FAST_SHARE, _SLOW_SHARE, _FAST_S = 0.01, 1.0, 0.7
#: Of the times, s.
_RANGES_S = (0.15, 3.0), (5.0, 600.0), (1.0, 6000.0)
#: Logarithms of white, fast and slow over smooth share where the search begins, of positions and of attitudes: the likelihood has
#: one maximum for white and one for fast errors.
_STARTS, _ATTITUDE_STARTS = ((2.0, -4.6, -4.0), (-4.6, 2.0, -4.0)), ((-4.6, -4.6, 4.0),)
_LEAST_JITTER_S = 1e-6
#: Chi-square of one degree of freedom at 0.05 above which the variance grows.
_SIGNIFICANT = 3.84
#: Unknowns that are fitted to the same records.
_FITTED = 5
#: Share of its sampling error that a share of nearly 1 leaves to the slow part.
_LEFT = 0.1
#: Variance of the mean of a fast error relative to that of its changes.
_FAST_MEAN = 1.0
#: Of normal errors, from the median of their absolute values; what the white part leaves at least.
SIGMA_OF_MEDIAN, _LEAST_SLOW = 1.4826, 1e-3
#: Stated sigmas that differ by less than this factor have the same cause.
_SAME_SIGMA = 1.1
_LEAST_VAR = 1e-6
#: What an error has in common with the one before a step is its exponential.
STEP_CHANGE = 0.7
#: Sigma of the alignment of cameras and body in addition to the stated attitudes, which is checked separately.
_ALIGNMENT_RAD = 0.004


class ErrorShares(NamedTuple):
    """Shares of the variance of one group of axes.

    They add up to 1, or to more: a fast error has a mean, too, which images do not show.
    """

    white: float
    fast: float
    slow: float
    smooth: float
    fast_s: float
    """Correlation time of the fast part."""
    slow_s: float
    """Correlation time of the slow part."""
    smooth_s: float
    """Of the smooth part: the root of 3 over the rate of a sine wave that has the same curvature."""
    jitter_s: float = 0.0
    """Sigma of the time stamps' jitter, in addition to the stated variance."""
    factor: float = 1.0
    """By which the stated variance is too small."""


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
    renewed: Floats
    """(K,): how often the errors have changed by a step since the first record."""

    @property
    def least(self) -> Floats:
        """(6,): sigma of a smooth error, which positions have: at most the smallest stated one is common to all records."""
        return np.append(self.stated[:, :3].min(axis=0), np.zeros(3))


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
    white, lasts_s = params.gnss_white_share**2, params.gnss_correlation_s
    position = ErrorShares(white, 0.0, 1.0 - white, 0.0, _FAST_S, lasts_s, lasts_s)
    white, lasts_s = params.attitude_white_share**2, params.attitude_correlation_s
    attitude = ErrorShares(white, 0.0, 1.0 - white, 0.0, _FAST_S, lasts_s, lasts_s)
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
    scatter = SIGMA_OF_MEDIAN * np.median(np.abs(bends), axis=0) / 6**0.5
    total = np.median(np.hypot(log.own, log.drift), axis=0)
    shares = np.minimum((scatter / total) ** 2, 1.0 - _LEAST_SLOW)
    rough = [float(shares[list(axes)].max()) for axes in GROUPS]
    rough = [max(one.white, share) for one, share in zip(assumed, rough, strict=True)]
    found = [one._replace(white=share, slow=1.0 - share) for one, share in zip(assumed, rough, strict=True)]
    return LogErrors(found[0]._replace(jitter_s=params.clock_sigma_s), *found[1:])


def sigma_levels(stated: Floats, renewed: Floats) -> tuple[Floats, Floats]:
    """(K, n) levels of stated sigmas (K, n), and the sums of the changes of their logarithms from the first record on.

    renewed (K,): number of steps up to a record; each counts as `STEP_CHANGE`.

    A receiver that finds another solution, or an INS without one, has other errors: of two sigmas at most the smaller one is
    common to both. Changes by less than a tenth are noise of the sigmas, unless they add up: then a sigma grows, as without GNSS.
    """
    levels, single = stated.copy(), np.log(_SAME_SIGMA)
    for column in range(stated.shape[1]):
        sigma, start = stated[:, column], 0
        for k in range(1, len(sigma)):
            levels[k, column] = sigma[start]
            if abs(np.log(sigma[k] / sigma[start])) >= single:
                grows = abs(np.log(sigma[k] / sigma[k - 1])) < single
                levels[start : k + 1, column] = (
                    np.geomspace(sigma[start], sigma[k], k + 1 - start) if grows else sigma[start]
                )
                levels[k, column], start = sigma[k], k
    changes = np.cumsum(np.abs(np.diff(np.log(levels), axis=0, prepend=np.log(levels[:1]))), axis=0)
    return levels, changes + STEP_CHANGE * renewed[:, None]


def estimate_log_errors(
    log: LoggedPoses, rotations: Floats, positions: Floats, motions: MeasuredMotions, records: StatedErrors,
    params: TrajectoryParams,
) -> LogErrors:  # fmt: skip
    """The shares of a log that is compared with the motions that images show; arguments as for `path_difference`."""
    assumed = assumed_errors(params)
    difference = path_difference(log, rotations, positions, motions, records.times_s, params)
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
    """(N, N) products of the stated sigmas that are common in spite of their changes."""
    beyond: Floats
    """(N, N): what they exceed the variance by that all records have in common."""
    common: Floats
    """(N, N): that variance, less what steps between two frames change."""
    jitter: Floats
    """(N,) squared rates."""


def _estimated(parts: Sequence[DifferenceTerms], assumed: ErrorShares, jitter_s: float) -> ErrorShares:
    """The shares of one group of axes. assumed: without evidence; jitter_s: likewise, 0 where it is left to the white part."""
    middle = np.log([
        assumed.white / assumed.slow, _FAST_SHARE, _SLOW_SHARE, _FAST_S, assumed.slow_s, assumed.smooth_s,
        max(jitter_s, _LEAST_JITTER_S), 1.0,
    ])  # fmt: skip
    low, high = middle - 5 * _PRIOR_SIGMA, middle + 5 * _PRIOR_SIGMA
    low[3:6], high[3:6] = np.log(_RANGES_S).T

    def misfit(free: Floats, size: int) -> tuple[float, Floats]:
        given = np.concatenate([free, middle[size:]])
        off = (given - middle) / _PRIOR_SIGMA
        value, slope = float(off @ off) / 2, off / _PRIOR_SIGMA
        for part in parts:
            own, own_slope = _misfit(part, given)
            value, slope = value + own, slope + own_slope
        return value, slope[:size]

    def fitted(*starts: Floats) -> Floats:
        size = len(starts[0])
        bounds = list(zip(low[:size], high[:size], strict=True))
        found = [
            minimize(
                misfit,
                start,
                (size,),
                jac=True,
                method="L-BFGS-B",
                bounds=bounds,
                options={"maxiter": 30, "ftol": 1e-6},
            )
            for start in starts
        ]
        return np.asarray(min(found, key=lambda one: float(one.fun)).x)

    def unlikely(given: Floats) -> float:
        return sum(_misfit(part, given)[0] for part in parts)

    start = middle[: 7 if jitter_s else 6]
    starts = _STARTS if parts[0].common.any() else _ATTITUDE_STARTS
    values = fitted(*(np.concatenate([shares, start[3:]]) for shares in starts))
    full = np.concatenate([values, middle[len(values) :]])
    least = unlikely(full)
    if sum(_misfit(part, full)[1][-1] for part in parts) < 0:  # a larger variance fits better
        low[-1], high[-1] = 0.0, np.log(max(_largest_factor(parts, full), 1.0))
        larger = fitted(full)
        if 2 * (least - unlikely(larger)) > _SIGNIFICANT:
            full = larger
    count = sum(len(part.off) for part in parts)
    shares = _shares(full)
    # Heading, slope, scale and clock were fitted to the same records: Student's variance of what is left.
    freedom = max(count - _FITTED, 1)
    white, fast = shares[:2] * (freedom + 4) / freedom
    # A share is known to its sampling error only.
    lasting = max(1.0 - white - fast, _LEFT * (2 / count) ** 0.5 * max(white, fast))
    total = white + fast + lasting
    lasting = max(lasting, _FAST_MEAN * fast) / total
    slow = lasting * shares[2] / shares[2:].sum()
    fast_s, slow_s, smooth_s, own_jitter_s, factor = np.exp(full[3:]).tolist()
    return ErrorShares(
        white / total, fast / total, slow, lasting - slow, fast_s, slow_s, smooth_s, own_jitter_s if jitter_s else 0.0, factor,
    )  # fmt: skip


def _largest_factor(parts: Sequence[DifferenceTerms], values: Floats) -> float:
    """How many times as large as expected the squared differences are, if all of them are errors of the log.

    The likelihood of waves, which are smoother than any error here, grows with the variance and the times together.
    """
    shares, times_s = _shares(values), np.exp(values[3:6])
    expected = 0.0
    for part in parts:
        own = np.tensordot(shares, _parts(part, *times_s), 1)
        expected += float(np.trace(own) - own.mean(axis=0).sum())
    return sum(float(part.off @ part.off) for part in parts) / expected


def _shares(values: Floats) -> Floats:
    """(4,): white, fast, slow and smooth share."""
    raw = np.array([*np.exp(values[:3]), 1.0])
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
    levels, changes = (part[frames, 0] for part in sigma_levels(records.stated[:, axis : axis + 1], records.renewed))
    changed = np.outer(levels, levels) * np.exp(-np.abs(changes[:, None] - changes))
    rate = difference.velocity[frames, axis] if jitters else np.zeros(len(frames))
    steps, least = np.abs(records.renewed[frames, None] - records.renewed[frames]), records.least[axis] ** 2
    beyond, common = np.maximum(changed - least, 0.0), least * np.exp(-STEP_CHANGE * steps)
    return DifferenceTerms(off - off.mean(), base, stated, apart_s, changed, beyond, common, rate**2)


def log_cov(part: DifferenceTerms, shares: ErrorShares) -> Floats:
    """(N, N)"""
    each = np.array([shares.white, shares.fast, shares.slow, shares.smooth])
    own = np.tensordot(each, _parts(part, shares.fast_s, shares.slow_s, shares.smooth_s), 1)
    cov = part.base + shares.factor * own
    cov[np.diag_indices_from(cov)] += shares.jitter_s**2 * part.jitter
    return np.asarray(cov)


def _parts(part: DifferenceTerms, fast_s: float, slow_s: float, smooth_s: float) -> Floats:
    """(4, N, N): covariances of a white, a fast, a slow and a smooth error of the stated sigmas.

    Where a stated sigma exceeds the smallest one, what exceeds it is not smooth, but slow.
    """
    slowly, apart = np.exp(-part.apart_s / slow_s), 3**0.5 / smooth_s * part.apart_s
    smooth = part.common * (1 + apart + apart**2 / 3) * np.exp(-apart) + part.beyond * slowly
    fast = part.stated * np.exp(-part.apart_s / fast_s)
    return np.stack([np.diag(np.diagonal(part.stated)), fast, part.changed * slowly, smooth])


def _misfit(part: DifferenceTerms, values: Floats) -> tuple[float, Floats]:
    """Minus the logarithm of the likelihood, and its derivatives (8,).

    values: logarithms of white, fast and slow over smooth share, of the three times (s), of the jitter (s), of the factor.
    """
    shares = _shares(values)
    fast_s, slow_s, smooth_s, _, factor = np.exp(values[3:])
    jitter = np.exp(2 * values[6])
    parts = _parts(part, fast_s, slow_s, smooth_s)
    cov = part.base + factor * np.tensordot(shares, parts, 1)
    cov[np.diag_indices_from(cov)] += jitter * part.jitter
    factor_of, failed = dpotrf(cov, lower=True)
    if failed:
        return 1e12, np.zeros(len(values))
    inverse = np.asarray(dpotri(factor_of, lower=True)[0])  # its lower triangle
    inverse += np.tril(inverse, -1).T
    solved = inverse @ part.off
    by_cov = (inverse - np.outer(solved, solved)) / 2
    by_parts = factor * np.tensordot(parts, by_cov, 2)
    mean = float(shares @ by_parts)
    apart = 3**0.5 / smooth_s * part.apart_s
    of_smooth = part.common * np.exp(-apart)
    beyond = parts[3] - of_smooth * (1 + apart + apart**2 / 3)
    later = by_cov * part.apart_s
    slope = np.array([
        *(shares * (by_parts - mean))[:3],
        factor * shares[1] * float((later * parts[1]).sum()) / fast_s,
        factor * float((later * (shares[2] * parts[2] + shares[3] * beyond)).sum()) / slow_s,
        factor * shares[3] * float((by_cov * of_smooth * (1 + apart) * apart**2).sum()) / 3,
        2 * jitter * float(np.diagonal(by_cov) @ part.jitter), mean,
    ])  # fmt: skip
    value = float(np.log(np.diagonal(factor_of)).sum()) + float(part.off @ solved) / 2
    return value, slope
