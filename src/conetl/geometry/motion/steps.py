"""Steps of a trajectory that the speeds before and after them do not explain."""

from __future__ import annotations

import numpy as np

from conetl.model.arrays import Floats

#: This many steps before and after one give the vehicle's speed.
_NEIGHBOURS = 4
#: m/s^2: what a vehicle may gain or lose in speed at once, by how much its horizontal acceleration departs from an even one
#: within a few seconds of driving, and by how much its vertical one does on a road.
_ACCELERATION, _UNEVEN, _UNEVEN_UP = 8.0, 3.5, 1.0
#: The same where it may brake, wait and pull away, m/s^2: horizontal and vertical.
_STOP_AND_GO = np.array([4.0, 1.0])


def max_deviation_m(apart_s: float) -> Floats:
    """(2,) m, horizontal and vertical: largest deviation of a vehicle from the path that the mean of two velocities predicts
    between them.

    If its acceleration stays within a of a constant one, the deviation is at most a t^2 / 4.
    """
    return _STOP_AND_GO * apart_s**2 / 4


def unexplained_step_m(steps_m: Floats, speeds: Floats, times_s: Floats, k: int, errors_m: Floats) -> float:
    """Length of the difference between step k and what the speeds of its neighbours predict, m; 0 where a vehicle can drive so,
    and where fewer than two speeds are known.

    steps_m (N - 1, 3): from each of N positions to the next, east, north, up, m. speeds (N - 1, 3): m/s in the same frame, NaN
    where they are not known, as of step k itself. times_s (N,): of the positions, rising. errors_m (2,): largest errors of the
    positions, horizontal and vertical.
    """
    middle_s, step_s = (times_s[1:] + times_s[:-1]) / 2, float(times_s[k + 1] - times_s[k])
    first, last = max(k - _NEIGHBOURS, 0), min(k + _NEIGHBOURS + 1, len(middle_s))
    near = first + np.flatnonzero(~np.isnan(speeds[first:last, 0]))
    near = near[near != k]
    if len(near) < 2:
        return 0.0
    # Between neighbours on both sides acceleration is constant apart from a jerk; beyond them speed may change at once.
    reach_s = float(times_s[last] - times_s[first])
    if min((near < k).sum(), (near > k).sum()) >= 2:
        speed = np.polynomial.polynomial.polyfit(middle_s[near] - middle_s[k], speeds[near], 1)[0]
        within_reach_m = np.array([_UNEVEN, _UNEVEN_UP]) * step_s * reach_s / 8
        driven_m = np.maximum(within_reach_m, max_deviation_m(step_s))
    else:
        speed = np.median(speeds[near], axis=0)
        driven_m = np.array([_ACCELERATION, _UNEVEN_UP]) * step_s * reach_s / 2
    off = steps_m[k] - speed * step_s
    off_m = np.array([np.hypot(off[0], off[1]), abs(off[2])])
    return float(np.hypot(*off_m)) if (off_m > driven_m + errors_m).any() else 0.0
