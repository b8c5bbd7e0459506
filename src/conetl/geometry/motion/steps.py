"""Steps of a trajectory that the speeds before and after them do not explain."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from conetl.model.arrays import Floats

#: This many steps before and after one give the vehicle's speed.
_NEIGHBOURS = 4
#: m/s^2: what a vehicle may gain or lose in speed at once, by how much its horizontal acceleration departs from an even one
#: within a few seconds of driving, and by how much its vertical one does on a road.
_ACCELERATION, _UNEVEN, _UNEVEN_UP = 8.0, 3.5, 1.0
#: The same where it may brake, wait and pull away, m/s^2: horizontal and vertical.
_STOP_AND_GO = np.array([4.0, 1.0])


class StepMisfit(NamedTuple):
    """Difference between a step of a trajectory and what the speeds around it predict."""

    off_m: tuple[float, float]
    """Horizontal distance and height difference, m."""
    driven_m: tuple[float, float]
    """What of each a vehicle may drive beside an even change of its speed, m."""

    def unexplained_m(self, errors_m: tuple[float, float]) -> float:
        """Length of the step's misfit if one of its components exceeds what a vehicle can do and the position errors; else 0.

        errors_m: largest errors of the positions, horizontal and vertical."""
        beyond = any(off > own + error for off, own, error in zip(self.off_m, self.driven_m, errors_m, strict=True))
        return float(np.hypot(*self.off_m)) if beyond else 0.0


def max_deviation_m(apart_s: float) -> Floats:
    """(2,) m, horizontal and vertical: largest deviation of a vehicle from the path that the mean of two velocities predicts
    between them.

    If its acceleration stays within a of a constant one, the deviation is at most a t^2 / 4.
    """
    return _STOP_AND_GO * apart_s**2 / 4


def step_misfit(steps_m: Floats, speeds: Floats, times_s: Floats, k: int) -> StepMisfit | None:
    """Compare a step with the speeds of its neighbours; None where fewer than two of them are known.

    steps_m (N - 1, 3): from each of N positions to the next, east, north, up, m. speeds (N - 1, 3): m/s in the same frame, NaN
    where they are not known, as of step k itself. times_s (N,): of the positions, rising.
    """
    middle_s, step_s = (times_s[1:] + times_s[:-1]) / 2, float(times_s[k + 1] - times_s[k])
    first, last = max(k - _NEIGHBOURS, 0), min(k + _NEIGHBOURS + 1, len(middle_s))
    near = first + np.flatnonzero(~np.isnan(speeds[first:last, 0]))
    near = near[near != k]
    if len(near) < 2:
        return None
    # Between neighbours on both sides acceleration is constant apart from a jerk; beyond them speed may change at once.
    reach_s = float(times_s[last] - times_s[first])
    if min((near < k).sum(), (near > k).sum()) >= 2:
        speed = np.polynomial.polynomial.polyfit(middle_s[near] - middle_s[k], speeds[near], 1)[0]
        within_reach_m = np.array([_UNEVEN, _UNEVEN_UP]) * step_s * reach_s / 8
        horizontal_m, vertical_m = np.maximum(within_reach_m, max_deviation_m(step_s)).tolist()
        driven_m = horizontal_m, vertical_m
    else:
        speed = np.median(speeds[near], axis=0)
        driven_m = _ACCELERATION * step_s * reach_s / 2, _UNEVEN_UP * step_s * reach_s / 2
    off = steps_m[k] - speed * step_s
    return StepMisfit((float(np.hypot(off[0], off[1])), abs(float(off[2]))), driven_m)
