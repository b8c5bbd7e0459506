"""Position, velocity and course of a vehicle at any instant from positions alone, recorded 0.5 to 20 times per second.

Along each axis the acceleration is a first-order Gauss-Markov process (Singer 1970), and so is the error of a recorded position,
with a white share that the records show (mean of its posterior). The estimate is the smoother of that model (Rauch, Tung &
Striebel 1965): a smoothing spline whose covariance grows between the records by what a vehicle may do in the meantime. Between
two records it is the Gauss-Markov bridge of the smoothed states.

All positions and velocities are along east, north and up of a map or of a level frame; yaw counts from east, counter-clockwise.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from conetl.geometry import pose as se3
from conetl.geometry.linear_reference import spaced
from conetl.model.arrays import Bools, Floats, Ints

#: Accelerations of a vehicle on a road (m/s^2, one sigma; east, north, up) and how long one lasts (s).
_ACCELERATION_M_S2, _LASTS_S = np.array([1.8, 1.8, 0.3]), 1.5
#: Before the first record speed is unknown (m/s, one sigma), and positions differ by as much as this (m).
_ANY_SPEED_M_S, _ANYWHERE_M = 40.0, 1e4
#: Over a longer gap (s) nothing is known: the estimate starts over after it.
LONGEST_GAP_S = 60.0
#: Records nearer in time than this to one that is used are left out (s): the slow error hardly changes between them.
_LEAST_STEP_S = 0.19
#: A vehicle moves from this speed on, and from this many of its sigmas on: else its course does not determine its heading.
_MOVING_M_S, _MOVING_SIGMAS = 0.5, 4.0
#: The antenna is this far from the rear axle, along the vehicle (m, one sigma): in a bend its course is not the heading.
_AHEAD_OF_AXLE_M = 1.5
#: No vehicle turns more tightly than with this radius (m).
_LEAST_RADIUS_M = 5.0
#: Roll, pitch and yaw beyond course and grade (rad, one sigma): crossfall, springs, axes of the rig and the vehicle.
_UNSEEN_RAD = np.radians([2.5, 1.5, 1.5])
#: Pitch of a vehicle that stands on a slope, and of an angle about which nothing is known (rad, one sigma).
_SLOPE_RAD, _UNKNOWN_RAD = np.radians(3.0), np.pi / 3**0.5
_NODES, _NODE_WEIGHTS = np.polynomial.legendre.leggauss(16)
#: Median of chi-square of one degree of freedom.
_MEDIAN_CHI2 = 0.4549
#: Shares of white errors that are tried, on so many records.
_WHITE_SHARES, _MOST_SHOWN = (0.2, 0.4, 0.7, 0.95), 1000


class PositionSpline(NamedTuple):
    """Smoothed states at the K records that are used."""

    origin_m: Floats
    """(3,) subtracted from all positions."""
    times_s: Floats
    """(K,) rising."""
    state: Floats
    """(K, 3, 4): of each axis position (m), velocity (m/s), acceleration (m/s^2), slow error in its sigmas."""
    cov: Floats
    """(K, 3, 4, 4)"""
    gain: Floats
    """(K - 1, 3, 4, 4): regression of a state on the next one."""
    slow_m: Floats
    """(K, 3): sigma of the slow error of the recorded position."""
    lasts_s: float
    """Correlation time of the slow error."""


class VehicleStates(NamedTuple):
    """Position and motion of the vehicle at M instants."""

    positions_m: Floats
    """(M, 3) as a record of that instant would have it, with the slow error of the records around."""
    sigma_m: Floats
    """(M, 3) of its interpolation, beside that slow error."""
    slow_m: Floats
    """(M, 3): sigma of the slow error."""
    velocity_m_s: Floats
    """(M, 3)"""
    velocity_sigma_m_s: Floats
    """(M, 3)"""
    acceleration_m_s2: Floats
    """(M, 3)"""
    mean_velocity_m_s: Floats
    """(M, 3) between the records around the instant."""


def position_spline(
    times_s: ArrayLike, positions_m: ArrayLike, sigma_m: ArrayLike, *, white_share: float, correlation_s: float
) -> PositionSpline:
    """Smoothed states of positions (N, 3) with sigmas (N, 3), recorded at rising times (N,).

    white_share, correlation_s: of the errors of the records, as `gnss_white_share` (at least) and `gnss_correlation_s` of
    `TrajectoryParams`. A vehicle that moves more abruptly than is usual widens the covariances. Raises ValueError for fewer than
    three records at least 0.19 s apart, times that do not rise, and values that are not finite.
    """
    times, positions, sigma = (np.asarray(a, dtype=np.float64) for a in (times_s, positions_m, sigma_m))
    if not all(np.isfinite(a).all() for a in (times, positions, sigma)) or (np.diff(times) <= 0).any():
        raise ValueError("expected finite positions and sigmas at rising times")
    used = spaced(times[:, None], _LEAST_STEP_S)
    if used and used[-1] != len(times) - 1:  # the last one in place of the one before
        used = [*(used[:-1] or used), len(times) - 1]
    if len(used) < 3:
        raise ValueError(f"expected at least three positions {_LEAST_STEP_S:g} s apart, found {len(times)}")
    times, sigma = times[used], np.maximum(sigma[used], 1e-4)
    origin = positions[0].copy()
    observed = positions[used] - origin
    shown = slice(0, _MOST_SHOWN)
    shares = np.array([white_share, *(share for share in _WHITE_SHARES if share > white_share)])
    unlikely = _filtered(times[shown], observed[shown], sigma[shown], shares, correlation_s).unlikely
    share = float(np.sqrt(np.average(shares**2, weights=np.exp(unlikely.min() - unlikely))))
    found = _filtered(times, observed, sigma, np.array([share]), correlation_s)
    means, covs, ahead, ahead_cov = (part[:, 0] for part in (found.means, found.covs, found.ahead, found.ahead_cov))
    gain = np.swapaxes(np.linalg.solve(ahead_cov[1:], found.carry[:, None] @ covs[:-1]), -1, -2)
    for k in range(len(times) - 2, -1, -1):
        means[k] += (gain[k] @ (means[k + 1] - ahead[k + 1])[..., None])[..., 0]
        covs[k] += gain[k] @ (covs[k + 1] - ahead_cov[k + 1]) @ np.swapaxes(gain[k], -1, -2)
    misses = found.misses[found.shown, 0]
    factor = np.maximum(np.median(misses, axis=0) / _MEDIAN_CHI2, 1.0) if len(misses) else np.ones(3)
    factor[:2] = factor[:2].max()
    slow = np.sqrt(1 - share**2) * sigma
    return PositionSpline(origin, times, means, covs * factor[:, None, None], gain, slow, correlation_s)


class _Filtered(NamedTuple):
    """Estimates at K records with each of G shares of white errors, by the records up to each."""

    means: Floats
    """(K, G, 3, 4)"""
    covs: Floats
    """(K, G, 3, 4, 4)"""
    ahead: Floats
    """(K, G, 3, 4): the mean without the record itself."""
    ahead_cov: Floats
    carry: Floats
    """(K - 1, 4, 4): transition to the next record."""
    misses: Floats
    """(K, G, 3): squared differences of the records from what was expected, over their variances."""
    unlikely: Floats
    """(G,): minus the logarithm of the likelihood."""
    shown: Bools
    """(K,): whether a record was expected: the first ones of a part only initialise the estimate."""


def _filtered(times: Floats, observed: Floats, sigma: Floats, shares: Floats, correlation_s: float) -> _Filtered:
    """times (K,), observed (K, 3) and sigma (K, 3) of the records; shares: (G,)"""
    count, size = len(times), len(shares)
    slow, white = np.sqrt(1 - shares[:, None] ** 2) * sigma[:, None], (shares[:, None] * sigma[:, None]) ** 2
    carry, noise = _transition(np.diff(times), correlation_s)
    begins = np.r_[True, np.diff(times) > LONGEST_GAP_S]
    carry[begins[1:]] = 0.0
    reach = np.zeros((count, size, 3, 4))
    reach[..., 0], reach[..., 3] = 1.0, slow
    unknown = np.zeros((size, 3, 4, 4))
    unknown[:] = np.diag([_ANYWHERE_M**2, _ANY_SPEED_M_S**2, 0.0, 1.0])
    unknown[:, :, 2, 2] = _ACCELERATION_M_S2**2
    mean, cov = np.zeros((size, 3, 4)), unknown
    means, covs = np.empty((count, size, 3, 4)), np.empty((count, size, 3, 4, 4))
    ahead, ahead_cov = np.empty_like(means), np.empty_like(covs)
    misses, variances = np.zeros((count, size, 3)), np.ones((count, size, 3))
    for k in range(count):
        if begins[k]:
            mean, cov = np.zeros((size, 3, 4)), unknown
            mean[..., 0] = observed[k]
        else:
            mean, cov = (carry[k - 1] @ mean[..., None])[..., 0], carry[k - 1] @ cov @ carry[k - 1].T + noise[k - 1]
        ahead[k], ahead_cov[k] = mean, cov
        column = (cov @ reach[k][..., None])[..., 0]
        variances[k] = (reach[k] * column).sum(axis=-1) + white[k]
        miss = observed[k] - (reach[k] * mean).sum(axis=-1)
        misses[k] = miss**2 / variances[k]
        mean = mean + column * (miss / variances[k])[..., None]
        cov = cov - column[..., :, None] * column[..., None, :] / variances[k][..., None, None]
        means[k], covs[k] = mean, cov
    shown = ~(begins | np.r_[True, begins[:-1]])
    unlikely = (misses[shown] + np.log(variances[shown])).sum(axis=(0, 2)) / 2
    return _Filtered(means, covs, ahead, ahead_cov, carry, misses, unlikely, shown)


def states_at(spline: PositionSpline, times_s: ArrayLike) -> VehicleStates:
    """Interpolate the spline at instants (M,) between its first and last record; meaningless in gaps of more than
    `LONGEST_GAP_S`.

    Raises ValueError beyond the records.
    """
    times = np.asarray(times_s, dtype=np.float64).reshape(-1)
    if len(times) and not (spline.times_s[0] <= times.min() and times.max() <= spline.times_s[-1]):
        raise ValueError("expected instants between the first and the last record")
    k = np.clip(np.searchsorted(spline.times_s, times, side="right") - 1, 0, len(spline.times_s) - 2)
    before, q_before = _transition(times - spline.times_s[k], spline.lasts_s)
    after, q_after = _transition(spline.times_s[k + 1] - times, spline.lasts_s)
    before, after = before[:, None], after[:, None]
    whole = after @ q_before @ np.swapaxes(after, -1, -2) + q_after
    by_next = np.swapaxes(np.linalg.solve(whole, after @ q_before), -1, -2)
    by_first = before - by_next @ after @ before
    state = (by_first @ spline.state[k][..., None] + by_next @ spline.state[k + 1][..., None])[..., 0]
    mixed = by_first @ spline.gain[k] @ spline.cov[k + 1] @ np.swapaxes(by_next, -1, -2)
    cov = by_first @ spline.cov[k] @ np.swapaxes(by_first, -1, -2) + mixed + np.swapaxes(mixed, -1, -2)
    cov += by_next @ spline.cov[k + 1] @ np.swapaxes(by_next, -1, -2) + q_before - by_next @ after @ q_before
    share = ((times - spline.times_s[k]) / (spline.times_s[k + 1] - spline.times_s[k]))[:, None]
    slow = (1 - share) * spline.slow_m[k] + share * spline.slow_m[k + 1]
    apart_s = (spline.times_s[k + 1] - spline.times_s[k])[:, None]
    recorded = cov[..., 0, 0] + slow**2 * cov[..., 3, 3] + 2 * slow * cov[..., 0, 3]
    return VehicleStates(
        spline.origin_m + state[..., 0] + slow * state[..., 3], np.sqrt(np.maximum(recorded, 1e-8)), slow, state[..., 1],
        np.sqrt(np.maximum(cov[..., 1, 1], 1e-8)), state[..., 2],
        (spline.state[k + 1, :, 0] - spline.state[k, :, 0]) / apart_s,
    )  # fmt: skip


def turn_rate(moved: VehicleStates) -> Floats:
    """(M,) rad/s of the course, counter-clockwise; limited to what a vehicle can do at its speed."""
    east, north = moved.velocity_m_s[:, 0], moved.velocity_m_s[:, 1]
    speed = np.maximum(np.hypot(east, north), 1e-3)
    turned = (east * moved.acceleration_m_s2[:, 1] - north * moved.acceleration_m_s2[:, 0]) / speed**2
    return np.asarray(np.clip(turned, -speed / _LEAST_RADIUS_M, speed / _LEAST_RADIUS_M))


def course_attitude(spline: PositionSpline, times_s: ArrayLike) -> tuple[Floats, Floats, Floats]:
    """Rotations (M, 3, 3) from body (forward, left, up) to the frame of the positions, and two sets of sigmas (M, 3) of roll,
    pitch and yaw (rad): of all errors, and of those that last no longer than the time between two records.

    Yaw is the course, pitch the grade, roll zero. A standing or slow vehicle has the heading between those before and after,
    with a sigma that grows with the distance that it may have rolled. A vehicle that reverses is taken for one that drives
    forward: positions do not show the difference. Raises ValueError where it never moves: its heading is unknown then.
    """
    times = np.asarray(times_s, dtype=np.float64).reshape(-1)
    middle = ((spline.times_s[1:] + spline.times_s[:-1]) / 2)[np.diff(spline.times_s) <= LONGEST_GAP_S]
    steady = np.sort(np.concatenate([spline.times_s, middle]))
    around, moved = states_at(spline, steady), states_at(spline, times)
    moving = np.flatnonzero(_is_moving(around))
    if not len(moving):
        raise ValueError("the positions never show the vehicle moving, so that its heading is unknown")
    yaw, own = _course(moved)
    shown = _best_headings(states_at(spline, steady[moving]), around.positions_m[moving])
    at = np.searchsorted(steady[moving], times)
    candidates = []
    for (edge_yaw, edge_sigma), side in zip(
        shown, (np.maximum(at - 1, 0), np.minimum(at, len(moving) - 1)), strict=True
    ):
        rolled_m = np.linalg.norm((moved.positions_m - around.positions_m[moving[side]])[:, :2], axis=1)
        rolled_m += moved.sigma_m[:, :2].max(axis=1)
        candidates.append((edge_yaw[side], edge_sigma[side] + rolled_m / _LEAST_RADIUS_M))
    (first, first_sigma), (second, second_sigma) = candidates
    apart = np.angle(np.exp(1j * (second - first)))
    weight = first_sigma**2 / (first_sigma**2 + second_sigma**2)
    held_sigma = np.hypot(np.minimum(first_sigma, second_sigma), np.abs(apart) / 2)
    still = ~_is_moving(moved)
    held = still | (held_sigma < own)
    yaw = np.where(held, first + weight * apart, yaw)
    own = np.where(held, np.minimum(held_sigma, _UNKNOWN_RAD), own)
    speed = np.maximum(np.hypot(moved.velocity_m_s[:, 0], moved.velocity_m_s[:, 1]), 1e-3)
    pitch = np.where(still, 0.0, -np.arctan2(moved.velocity_m_s[:, 2], speed))
    pitch_sigma = np.where(still, _SLOPE_RAD, np.minimum(moved.velocity_sigma_m_s[:, 2] / speed, _SLOPE_RAD))
    short = np.stack([np.zeros(len(times)), pitch_sigma, own], axis=1)
    return se3.rotation_from_rpy(np.zeros(len(times)), pitch, yaw), np.hypot(short, _UNSEEN_RAD), short


def _best_headings(moving: VehicleStates, positions_m: Floats) -> tuple[tuple[Floats, Floats], tuple[Floats, Floats]]:
    """Yaw (M,) and its sigma (M,) at each of M instants, by the courses up to it and by those from it on.

    A course shows little where the vehicle is slow. The one of a faster instant may be better, although the vehicle may have
    turned since, by what it has driven over its least radius.
    """
    yaw, sigma = _course(moving)
    turned = np.cumsum(np.linalg.norm(np.diff(positions_m[:, :2], axis=0, prepend=positions_m[:1, :2]), axis=1))
    turned /= _LEAST_RADIUS_M

    def best(least: Floats) -> Ints:
        """(M,): number of the least value up to each."""
        return np.maximum.accumulate(np.where(least <= np.minimum.accumulate(least), np.arange(len(least)), 0))

    before, after = best(sigma - turned), len(sigma) - 1 - best((sigma + turned)[::-1])[::-1]
    return (
        (yaw[before], sigma[before] + turned - turned[before]), (yaw[after], sigma[after] + turned[after] - turned),
    )  # fmt: skip


def _course(moved: VehicleStates) -> tuple[Floats, Floats]:
    """Yaw (M,) of the course and its sigma (M,), rad."""
    east, north = moved.velocity_m_s[:, 0], moved.velocity_m_s[:, 1]
    speed = np.maximum(np.hypot(east, north), 1e-3)
    across = np.hypot(north * moved.velocity_sigma_m_s[:, 0], east * moved.velocity_sigma_m_s[:, 1]) / speed
    slip = np.abs(turn_rate(moved)) * _AHEAD_OF_AXLE_M / speed
    return np.arctan2(north, east), np.minimum(np.hypot(across / speed, slip), _UNKNOWN_RAD)


def _is_moving(moved: VehicleStates) -> Bools:
    """(M,) whether the course is a heading. After a sudden stop the spline swings back although the records do not."""
    least = np.maximum(_MOVING_M_S, _MOVING_SIGMAS * moved.velocity_sigma_m_s[:, :2].max(axis=1))
    here, mean = moved.velocity_m_s[:, :2], moved.mean_velocity_m_s[:, :2]
    fast = np.minimum(np.linalg.norm(here, axis=1), np.linalg.norm(mean, axis=1)) > least
    return np.asarray(fast & ((here * mean).sum(axis=1) > 0))


def _transition(step_s: Floats, correlation_s: float) -> tuple[Floats, Floats]:
    """Transition (M, 4, 4) of the state of an axis over times (M,), and the noise (M, 3, 4, 4) that it adds on each axis."""
    step = np.minimum(step_s, LONGEST_GAP_S)

    def answer(t_s: Floats) -> Floats:
        """(..., 3) position, velocity and acceleration after an acceleration of one, t later."""
        x = t_s / _LASTS_S
        return np.stack([(x + np.expm1(-x)) * _LASTS_S**2, -np.expm1(-x) * _LASTS_S, np.exp(-x)], axis=-1)

    carry = np.zeros((len(step), 4, 4))
    carry[:, 0, 0] = carry[:, 1, 1] = 1.0
    carry[:, 0, 1], carry[:, 3, 3] = step, np.exp(-step / correlation_s)
    carry[:, :3, 2] = answer(step)
    nodes = answer(step[:, None] * (_NODES + 1) / 2)
    # Pushes that keep the variance of the acceleration at one.
    added = np.einsum("mni,mnj,n->mij", nodes, nodes, _NODE_WEIGHTS) * step[:, None, None] / _LASTS_S
    noise = np.zeros((len(step), 3, 4, 4))
    noise[:, :, :3, :3] = added[:, None] * (_ACCELERATION_M_S2**2)[:, None, None]
    noise[:, :, 3, 3] = -np.expm1(-2 * step / correlation_s)[:, None]
    return carry, noise
