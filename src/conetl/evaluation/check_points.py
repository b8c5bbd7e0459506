"""Surveyed check points against the cones of a map: residuals and RMSE of each axis (ASPRS Positional Accuracy Standards, 2023).

Check points take part in nothing: they only judge the map.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from conetl.evaluation.truth import paired
from conetl.geometry.packing import cov_matrix
from conetl.model.map_records import MapFeature
from conetl.model.records import SurveyedPoint

Floats = NDArray[np.float64]
#: Probability below which residuals contradict the stated sigmas.
_CONTRADICTS = 1e-3


class PointResidual(NamedTuple):
    """A check point and the cone that stands on it, None where the map has none."""

    point: SurveyedPoint
    feature: MapFeature | None
    difference_m: Floats | None
    """(3,) map minus point: east, north, up."""


class CheckedMap(NamedTuple):
    """The residuals of all points, and what they say together."""

    residuals: list[PointResidual]
    rmse_m: Floats | None
    """(5,) of east, north, up, horizontal, 3D; None without a point on a cone."""
    mean_m: Floats | None
    """(3,) of east, north, up: a systematic part, such as that of another datum."""
    nees: float | None
    """Mean squared residual in stated sigmas of map and point, per axis: 1 where they are true."""
    contradicts: bool
    """Whether that is improbable (below 0.1 %) with the stated sigmas. Residuals of one drive are correlated: no proof."""


def check_map(points: Sequence[SurveyedPoint], features: Sequence[MapFeature], *, within_m: float = 0.75) -> CheckedMap:
    """Residuals of a map at check points. A cone stands on a point if it is nearest to it, and at most within_m away in 3D."""
    truth = np.array([point.xyz_m for point in points]).reshape(-1, 3)
    found = np.array([feature.xyz_m for feature in features]).reshape(-1, 3)
    pairs = paired(truth, found, within_m)
    residuals = [
        PointResidual(point, features[pairs[i]], found[pairs[i]] - truth[i])
        if i in pairs
        else PointResidual(point, None, None)
        for i, point in enumerate(points)
    ]
    if not pairs:
        return CheckedMap(residuals, None, None, None, contradicts=False)
    d = np.array([r.difference_m for r in residuals if r.difference_m is not None])
    squares = (d**2).mean(axis=0)
    rmse = np.sqrt([*squares, squares[0] + squares[1], squares.sum()])
    total = sum(
        float(
            r.difference_m
            @ np.linalg.solve(cov_matrix(r.feature.cov_m2) + np.diag(np.square(r.point.sigma_m)), r.difference_m)
        )
        for r in residuals
        if r.feature is not None and r.difference_m is not None
    )
    contradicts = bool(chi2.sf(total, 3 * len(d)) < _CONTRADICTS)
    return CheckedMap(residuals, rmse, d.mean(axis=0), total / (3 * len(d)), contradicts=contradicts)
