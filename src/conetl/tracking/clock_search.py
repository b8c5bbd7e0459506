"""Offset between the clocks of cameras and trajectory that may be tens of seconds apart, from turns and changes of speed.

Visual odometry without any pose gives speed and turn rate of the vehicle at the stamps of the images, the trajectory gives them
at its own. All offsets within the search are tried (cross-correlation with robust residuals), the best one must fit significantly
better than any other, and is then refined by least squares as in `clock.py`, which finds the remainder.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from conetl.geometry.motion.position_spline import position_spline, states_at, turn_rate
from conetl.geometry.motion.stereo_motion import RelativeMotion
from conetl.geometry.small_arrays import nearest_index
from conetl.model.arrays import Bools, Floats
from conetl.model.params import TrajectoryParams
from conetl.model.rig import Rig
from conetl.tracking.clock import robust_fit, smoothed

#: Step of both signals and of the offsets that are tried (s).
_STEP_S = 0.1
#: Both signals are smoothed by this many steps: turns of a vehicle last longer, noise does not.
_SMOOTHED = 4.0
#: Offsets are tried under which the trajectory covers this share of the images, and this many seconds of them.
_OVERLAP_SHARE, _OVERLAP_S = 0.6, 5.0
#: Residuals beyond this many sigmas count as this many: a passing lorry, a lost fix.
_CUT = 3.0
#: Least sigmas of the two columns: of the turn (rad/s, or m/s^2 across where the trajectory has no attitude), of the speed (m/s).
_LEAST_SIGMA = {True: np.array([0.002, 0.03]), False: np.array([0.02, 0.03])}
#: An offset that differs by this much must fit worse by this much (chi-square of one degree of freedom at 5 sigma).
_APART_S, _LEAST_GAIN = 0.5, 25.0
#: Of the variance of one of the signals the best offset explains at least this share.
_LEAST_EXPLAINED = 0.5
#: The trajectory is not interpolated over longer gaps (s; in median distances of its records).
_GAP_S, _GAP_FACTOR = 0.5, 2.5
#: Residuals of sparse records are correlated over this many of their distances.
_ALIKE = 2.5
#: Sigma of the scale of the speeds, and the least and largest one of a result (s): `clock.py` finds what is left within 0.4 s.
_SCALE, LEAST_SIGMA_S, _MAX_SIGMA_S = 0.02, 0.002, 0.15
#: Errors of positions change as slowly as the vehicle moves: on simulated drives residuals show a sigma too small by this.
_DOUBT = 1.5
_ITERATIONS, _MOST_PIECES = 12, 2_000_000


class VehicleRates(NamedTuple):
    """Turn rate and speed at N instants, by the clock of the images."""

    times_s: Floats
    """(N,) rising, in the middle of each interval; seconds since the first image."""
    turn_rad_s: Floats
    """(N,) about the vertical, counter-clockwise."""
    speed_m_s: Floats
    """(N,)"""


class ImageClock(NamedTuple):
    """What to add to the times of images to have those of the trajectory's clock (s), with its sigma."""

    offset_s: float
    sigma_s: float


def rates_of(motions: Sequence[RelativeMotion], times_ns: Mapping[int, int], rig: Rig) -> VehicleRates:
    """Turn rates and speeds of measured motions of the left camera. times_ns: of the images, by frame index (ns)."""
    known = [m for m in motions if m.second_SE3_first is not None]
    start_ns = min(times_ns.values(), default=0)
    begin, end = (
        np.array([times_ns[index] - start_ns for index in indices]) * 1e-9
        for indices in ([m.first_frame_index for m in known], [m.second_frame_index for m in known])
    )
    poses = np.array([m.second_SE3_first for m in known]).reshape(-1, 4, 4)
    step_s = np.maximum(end - begin, 1e-3)
    body_R_left = np.array(rig.body_SE3_left)[:3, :3]
    # A point moves against the camera.
    turned = -Rotation.from_matrix(poses[:, :3, :3]).as_rotvec() @ body_R_left.T if known else np.zeros((0, 3))
    # The camera moves with the rig's lever, the speed of the body is what both have.
    lever = np.array(rig.body_SE3_left)[:3, 3]
    moved = -np.einsum("nji,nj->ni", poses[:, :3, :3], poses[:, :3, 3]) @ body_R_left.T
    speed = np.linalg.norm(moved - np.cross(turned, lever), axis=1) / step_s
    return VehicleRates((begin + end) / 2, turned[:, 2] / step_s, speed)


def find_clock_offset(
    rates: VehicleRates,
    first_image_ns: int,
    times_ns: Sequence[int],
    positions_m: Floats,
    rotations: Floats | None,
    sigma_m: Floats,
    search_s: float = 30.0,
) -> ImageClock | None:
    """The offset under which images and trajectory show the same turns and speeds; None where they do not show one.

    rates: of the images (`rates_of`), whose first is of `first_image_ns`. times_ns (K,), rising: of the records, with positions
    (K, 3) in a level frame in metres, their sigmas (K, 3), and rotations (K, 3, 3) from the body to that frame, None where the
    trajectory has no attitude of its own. search_s: the offset is between minus and plus this. The sigma is one of the
    estimate, `LEAST_SIGMA_S` at least. None, too, where other offsets fit nearly as well, as on a straight drive at constant
    speed, and where images and trajectory have too little in common.
    """
    times_s = (np.array(times_ns, dtype=np.int64) - first_image_ns) * 1e-9
    target, at_s = _on_grid(rates, attitude=rotations is not None)
    if target is None:
        return None
    near = (times_s >= at_s[0] - search_s - 5) & (times_s <= at_s[-1] + search_s + 5)
    if near.sum() < 4 or np.ptp(times_s[near]) < _OVERLAP_S:
        return None
    first = round((max(times_s[near][0], at_s[0] - search_s) - at_s[0]) / _STEP_S)
    last = round((min(times_s[near][-1], at_s[-1] + search_s) - at_s[0]) / _STEP_S)
    grid_s = at_s[0] + _STEP_S * np.arange(first, last + 1)
    turned = None if rotations is None else rotations[near]
    signal = _trajectory_signal(times_s[near], positions_m[near], turned, sigma_m[near], grid_s)
    reach = round(search_s / _STEP_S)
    padded = np.full((len(target) + 2 * reach, 2), np.nan)
    index = np.arange(first, last + 1) + reach
    inside = (index >= 0) & (index < len(padded))
    padded[index[inside]] = signal[inside]
    searched = _searched(target, padded, _LEAST_SIGMA[rotations is not None])
    if searched is None:
        return None
    best, worse, common = searched
    coarse_s = (best - reach) * _STEP_S
    alike = round(max(_ALIKE * float(np.median(np.diff(times_s[near]))) / _STEP_S, 10 * _SMOOTHED))
    found = _refined(target, at_s, signal, grid_s, coarse_s, alike)
    if found is None or not len(worse):
        return None
    offset_s, sigma_s, counted = found
    gain = float((worse * common / counted).sum(axis=1).min())
    if gain < _LEAST_GAIN or abs(offset_s - coarse_s) > _APART_S or sigma_s > _MAX_SIGMA_S:
        return None
    return ImageClock(float(offset_s), max(sigma_s, LEAST_SIGMA_S))


def _searched(target: Floats, padded: Floats, least: Floats) -> tuple[int, Floats, int] | None:
    """The lag under which two signals (N, 2) and (N + L - 1, 2) fit best; by how much others far from it fit worse, (M, 2) mean
    squared residuals; how many values they have in common. None where none fits, or the last one tried does best."""
    overlap, typical = _by_lag(target, padded, None)
    enough = overlap >= max(_OVERLAP_SHARE * np.isfinite(target[:, 1]).sum(), _OVERLAP_S / _STEP_S)
    if not enough.any():
        return None
    sigma = np.maximum(np.min(typical[enough], axis=0), least)
    for _ in range(2):
        misfit = np.where(enough[:, None], _by_lag(target, padded, sigma)[1], np.inf)
        best = int(np.argmin(misfit.sum(axis=1)))
        rest = target - padded[best : best + len(target)]
        sigma = np.maximum(sigma, np.sqrt(np.nanmean(np.minimum(rest**2, (_CUT * sigma) ** 2), axis=0)))
    valid = np.isfinite(rest).all(axis=1)
    spread = np.minimum((rest[valid] / sigma) ** 2, _CUT**2).mean(axis=0)
    whole = (target[valid] - np.median(target[valid], axis=0)) / sigma
    explained = 1 - spread / np.maximum((whole**2).mean(axis=0), 1e-9)
    if explained.max() < _LEAST_EXPLAINED or best in (0, len(misfit) - 1):
        return None
    apart = enough & (np.abs(np.arange(len(misfit)) - best) * _STEP_S >= _APART_S)
    return best, misfit[apart] - misfit[best], int(valid.sum())


def _on_grid(rates: VehicleRates, *, attitude: bool) -> tuple[Floats | None, Floats]:
    """(N, 2) turn and speed at even steps, NaN where no image shows them, and their times (N,) s; None if too few."""
    times = rates.times_s
    if len(times) < 2 or times[-1] - times[0] < _OVERLAP_S:
        return None, times
    at_s = np.arange(times[0], times[-1] + 1e-9, _STEP_S)
    turn = rates.turn_rad_s if attitude else rates.turn_rad_s * rates.speed_m_s
    values = np.stack([np.interp(at_s, times, column) for column in (turn, rates.speed_m_s)], axis=1)
    reach_s = min(max(1.5 * _STEP_S, 0.75 * float(np.median(np.diff(times)))), _GAP_S)
    known = np.abs(times[nearest_index(times, at_s)] - at_s) <= reach_s
    return np.where(known[:, None], smoothed(values, known.astype(np.float64), _SMOOTHED), np.nan), at_s


def _trajectory_signal(
    times_s: Floats, positions_m: Floats, rotations: Floats | None, sigma_m: Floats, grid_s: Floats
) -> Floats:
    """(J, 2) turn and speed of the trajectory at the grid's times, NaN where it has none."""
    signal = np.full((len(grid_s), 2), np.nan)
    gaps = np.diff(times_s)
    k = np.clip(np.searchsorted(times_s, grid_s, side="right") - 1, 0, len(gaps) - 1)
    there = (grid_s >= times_s[0]) & (grid_s <= times_s[-1])
    there &= gaps[k] <= max(_GAP_S, _GAP_FACTOR * float(np.median(gaps)))
    defaults = TrajectoryParams()
    spline = position_spline(
        times_s, positions_m, sigma_m, white_share=defaults.gnss_white_share, correlation_s=defaults.gnss_correlation_s
    )
    moved = states_at(spline, grid_s[there])
    speed = np.linalg.norm(moved.velocity_m_s, axis=1)
    if rotations is None:
        turn = turn_rate(moved) * speed
    else:
        yaw = np.unwrap(np.arctan2(rotations[:, 1, 0], rotations[:, 0, 0]))
        # Of more than ten records per second the mean of each step, since their differences are mostly noise.
        bins = np.unique((times_s / _STEP_S).astype(np.int64), return_inverse=True)[1]
        counts = np.bincount(bins)
        mean_s: Floats = np.asarray(np.bincount(bins, times_s) / counts, dtype=np.float64)
        mean_yaw: Floats = np.asarray(np.bincount(bins, yaw) / counts, dtype=np.float64)
        turn = CubicSpline(mean_s, mean_yaw)(grid_s[there], 1)
    signal[there] = np.stack([turn, speed], axis=1)
    known = there.astype(np.float64)
    return np.where(there[:, None], smoothed(np.nan_to_num(signal), known, _SMOOTHED), np.nan)


def _by_lag(target: Floats, padded: Floats, sigma: Floats | None) -> tuple[Floats, Floats]:
    """For every lag the number of values (L,) in common and, by column (L, 2), the robust spread of their differences, or with
    sigmas the mean of its squares, outliers cut."""
    windows = np.lib.stride_tricks.sliding_window_view(padded, len(target), axis=0)
    count, found = np.zeros(len(windows)), np.full((len(windows), 2), np.inf)
    at_once = max(_MOST_PIECES // (2 * len(target)), 1)
    for first in range(0, len(windows), at_once):
        rest = np.abs(windows[first : first + at_once] - target.T)
        common: Bools = np.isfinite(rest[:, 0]) & np.isfinite(rest[:, 1])
        count[first : first + at_once] = common.sum(axis=1)
        some = common.sum(axis=1) > 0
        rest = np.where(common[some][:, None], rest[some], np.nan)
        value = np.nanmedian(rest, axis=2) * 1.4826 if sigma is None else np.nanmean(
            np.minimum((rest / sigma[:, None]) ** 2, _CUT**2), axis=2
        )  # fmt: skip
        found[first : first + at_once][some] = value
    return count, found


def _refined(
    target: Floats, at_s: Floats, signal: Floats, grid_s: Floats, offset_s: float, alike: int
) -> tuple[float, float, Floats] | None:
    """The offset by least squares from a start, its sigma, and of each column (2,) how many successive values count as one; None
    where it does not converge."""
    there, known = np.isfinite(signal).all(axis=1), np.isfinite(target).all(axis=1)
    curve, own = CubicSpline(grid_s[there], signal[there]), CubicSpline(at_s[known], target[known])
    covered: Floats = np.asarray(there, dtype=np.float64)
    prior = np.diag([0.0, _SCALE**-2])
    start_s = offset_s
    for _ in range(_ITERATIONS):
        used = known & (at_s + offset_s >= grid_s[0]) & (at_s + offset_s <= grid_s[-1])
        used[used] &= np.interp(at_s[used] + offset_s, grid_s, covered) > 0.99
        if used.sum() * _STEP_S < _OVERLAP_S:
            return None
        by = np.zeros((int(used.sum()), 2, 2))
        by[..., 0], by[:, 1, 1] = own(at_s[used], 1), target[used, 1]
        fit = robust_fit(target[used] - curve(at_s[used] + offset_s), by, prior, 5, lags=alike)
        offset_s += float(fit.solution[0])
        if abs(offset_s - start_s) > 2 * _APART_S:
            return None
        if abs(fit.solution[0]) < 1e-5:
            break
    return offset_s, _DOUBT * float(np.linalg.inv(fit.normal)[0, 0] ** 0.5), fit.counted
