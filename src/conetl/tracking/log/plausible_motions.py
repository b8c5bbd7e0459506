"""Which measured motions are plausible beside a log, and where the log steps."""

from __future__ import annotations

import numpy as np

from conetl.geometry import pose as se3
from conetl.geometry.motion.pose_graph import LoggedPoses, MeasuredMotions, motion_residuals
from conetl.model.arrays import Bools, Floats, Ints
from conetl.tracking.log.log_errors import SIGMA_OF_MEDIAN

#: Chi-square of 6 degrees of freedom at 1e-6, beyond which an interval contradicts GNSS/INS.
_GATE_CHI2 = 38.3
_NEIGHBOURS = 4
_LONE_SIGMAS = 4.5
#: A step of the log is so many times as rough as the images there, beyond so many sigmas of most differences, and rare.
_STEPS_BY, _STEP_SIGMAS, _MOST_STEPS = 2.0, 8.0, 0.05


def log_steps(log: LoggedPoses, motions: MeasuredMotions) -> Bools:
    """(K - 1,): in which intervals GNSS/INS steps, as where a receiver finds other satellites.

    There it is rougher than elsewhere, by far, and than the images, if they could be compared. If that is so in many intervals,
    it is noise.
    """
    left = se3.compose(se3.se3(log.rotations, log.positions), log.body_SE3_left)
    by_log = se3.compose(se3.invert(left[1:]), left[:-1])[:, :3, 3]
    every, seen = np.arange(len(by_log)), motions.start
    residual, _, _ = motion_residuals(log, log.rotations, log.positions, motions, 0.0)

    def roughness(rows: Ints, moved: Floats) -> Floats:
        medians, counts = _medians_beside(rows, moved, rows)
        found = np.zeros(len(every))
        found[rows] = np.where(counts >= _NEIGHBOURS, np.abs(moved - medians).max(axis=1, initial=0.0), 0.0)
        return found

    of_log, of_images = roughness(every, by_log), roughness(seen, motions.next_SE3_first[:, :3, 3])
    differs, sigma = of_log.copy(), np.zeros(len(every))
    differs[seen] = roughness(seen, residual[:, 3:])[seen]
    sigma[seen] = np.sqrt(np.diagonal(motions.cov[:, 3:, 3:], axis1=1, axis2=2).max(axis=1))
    usual = np.full(len(every), np.median(of_log))
    if len(seen):
        usual[seen] = np.median(differs[seen])
    steps = differs > _STEP_SIGMAS * np.hypot(sigma, SIGMA_OF_MEDIAN * usual)
    steps &= of_log > _STEPS_BY * of_images
    return steps if steps.mean() <= _MOST_STEPS else np.zeros(len(every), dtype=bool)


def plausible_motions(
    log: LoggedPoses, motions: MeasuredMotions, scale_sigma: float, rough: LoggedPoses | None = None
) -> Bools:
    """(M,): which measured intervals are plausible.

    One is rejected if it contradicts GNSS/INS beyond its errors, or differs from its neighbours beyond them, unless GNSS/INS
    differs from these neighbours by more: then GNSS/INS steps, as where a receiver finds other satellites. rough: the log with
    errors as assumed beforehand (`rough_errors`); a motion that these explain contradicts nothing.
    """
    k, parts = motions.start, motion_residuals(log, log.rotations, log.positions, motions, 0.0)
    residual, from_first, _ = parts
    inside = _within_errors(log, motions, parts, scale_sigma)
    if rough is not None and not inside.all():
        inside |= _within_errors(rough, motions, parts, scale_sigma)
    change = (
        log.drift[k] ** 2 * 2 * (1 - log.correlation[k]) + log.noise[k] ** 2 + log.noise[k + 1] ** 2 + log.change[k]
    )
    sigma = np.sqrt(np.diagonal(motions.cov + _moved(from_first, change), axis1=1, axis2=2))
    observed = motions.next_SE3_first[:, :3, 3]
    by_log = observed - residual[:, 3:]
    each = np.hstack([residual, observed, by_log])
    medians, counts = _medians_beside(k[inside], each[inside], k)
    off, known = np.abs(each - medians), counts >= _NEIGHBOURS
    by_images = off[:, 6:9] > off[:, 9:]  # rougher by the images than by GNSS/INS
    lone = off[:, :6] > _LONE_SIGMAS * sigma
    lone[:, 3:] &= by_images
    steps = known & (off[:, 9:].max(axis=1) > _STEPS_BY * off[:, 6:9].max(axis=1))
    return np.asarray((inside | steps) & ~(known & lone.any(axis=1)))


def _within_errors(
    log: LoggedPoses, motions: MeasuredMotions, parts: tuple[Floats, Floats, Floats], scale_sigma: float
) -> Bools:
    """(M,): whether the errors of both explain how they differ. parts: of `motion_residuals`."""
    k, (residual, from_first, from_second) = motions.start, parts
    # What both poses have in common counts too: an attitude error turns the distance between them to the side.
    kept = log.correlation[k] * log.drift[k + 1] / log.drift[k]
    fresh = log.drift[k + 1] ** 2 * (1 - log.correlation[k] ** 2) + log.noise[k + 1] ** 2 + log.change[k]
    scaled = motions.next_SE3_first[:, :3, 3] * scale_sigma
    spread = motions.cov + _moved(from_first, log.noise[k] ** 2) + _moved(from_second, fresh)
    spread += _moved(from_first + from_second * kept[:, None, :], log.drift[k] ** 2)
    spread[:, 3:, 3:] += scaled[:, :, None] * scaled[:, None, :]
    chi2 = np.einsum("mi,mi->m", residual, np.linalg.solve(spread, residual[:, :, None])[:, :, 0])
    return np.asarray(chi2 <= _GATE_CHI2)


def _moved(jacobian: Floats, variance: Floats) -> Floats:
    """(M, 6, 6) covariances of what errors of variance (M, 6) move by the derivatives (M, 6, 6)."""
    return np.asarray(jacobian * variance[:, None, :] @ np.swapaxes(jacobian, 1, 2))


def _medians_beside(rows: Ints, values: Floats, asked: Ints) -> tuple[Floats, Ints]:
    """(A, V) medians of those of N values (N, V) that lie at most `_NEIGHBOURS` rows (N,) beside each row that is asked (A,), and
    how many do. A row's own value does not count."""
    table = np.full((int(asked.max(initial=0)) + 2 * _NEIGHBOURS + 1, values.shape[1]), np.nan)
    table[rows + _NEIGHBOURS] = values
    windows = np.lib.stride_tricks.sliding_window_view(table, 2 * _NEIGHBOURS + 1, axis=0)[asked]
    beside = np.ma.masked_invalid(np.delete(windows, _NEIGHBOURS, axis=2))
    medians = np.ma.median(beside, axis=2)  # type: ignore[no-untyped-call]
    return medians.filled(np.nan), beside[:, 0].count(axis=1)
