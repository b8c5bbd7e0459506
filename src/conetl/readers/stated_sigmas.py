"""Whether a file's positions can be as accurate as its sigmas state: maps, surveyed points and drives."""

from __future__ import annotations

import math

import numpy as np
from pyproj import CRS

from conetl.model.arrays import Floats
from conetl.model.errors import InputError
from conetl.readers.maps.tables import MapTable

#: No position on a road is known better than this; 0.02 m, squared, is less.
_LEAST_SIGMA_M, _EARTH_RADIUS_M = 1e-3, 6_371_000.0
#: Steps of decimals, and of numbers of single precision. An axis with fewer different values may be on a coarse one by chance.
_STEPS = sorted([10.0**-k for k in range(7)] + [2.0**-k for k in range(1, 20)], reverse=True)
_LEAST_ROUNDED = 4


def implausible_sigma(sigmas_m: Floats) -> str | None:
    """What is wrong with sigmas of horizontal positions (N, 2) that no survey reaches."""
    stated_m = float(np.median(sigmas_m.max(axis=1)))
    if stated_m >= _LEAST_SIGMA_M:
        return None
    return (
        f"the sigma of the positions is {stated_m:.2g} m (median), but no survey of a road is accurate to {_LEAST_SIGMA_M:g} m: "
        "is it a variance (m²), or in another unit?"
    )


def require_exact(table: MapTable, crs: CRS, sigmas_m: Floats) -> None:
    """Raise InputError where a file's positions in `crs` are known less well than its sigmas east, north, up (N, 3) state."""
    if problem := implausible_sigma(sigmas_m[:, :2]):
        raise InputError(f"{table.path}: {problem}; nothing was written")
    unit_m = crs.axis_info[0].unit_conversion_factor * (_EARTH_RADIUS_M if crs.is_geographic else 1.0)
    for values, unit, sigma_m in zip(table.xyz.T, (unit_m, unit_m, 1.0), sigmas_m.max(axis=0), strict=True):
        step_m = unit * _step(values[np.isfinite(values)])
        if step_m / math.sqrt(12) > sigma_m:
            raise InputError(
                f"{table.path}: its positions are rounded to {step_m:.2g} m, but the stated sigmas are {sigma_m:.2g} m: write "
                "them with more decimals and in double precision, or state sigmas that cover the rounding "
                f"({math.ceil(30 * step_m) / 100:g} m); nothing was written"
            )


def _step(values: Floats) -> float:
    """The coarsest step of which all coordinates of an axis (N,) are multiples; 0 where none is known, or they are as planned."""
    different = np.unique(values)
    gaps = np.diff(different)
    if len(different) < _LEAST_ROUNDED or np.ptp(gaps) < gaps.max() * 1e-6:
        return 0.0
    within = 1e-11 + 1e-15 * np.abs(values).max()
    return next((step for step in _STEPS if np.abs(values - (values / step).round() * step).max() < within), 0.0)
