"""Cones of a map or a drive against surveyed truth: the paper's Table 3."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from conetl.model.map_records import MapFeature
from conetl.model.records import Positive, Record, Track, Vec3

Floats = NDArray[np.float64]
#: What is compared with the truth: features of the map, or tracks of one drive.
Found = TypeVar("Found", bound=MapFeature | Track)
_FORBIDDEN = 1e6


class TruthCone(Record):
    """One surveyed cone: foot centre on the ground, in the map's CRS with ellipsoidal height."""

    cone_id: str
    xyz_m: Vec3
    cone_height_m: Positive


@dataclass(frozen=True)
class TruthLine(Generic[Found]):
    """One line of the table: a cone of the truth and what was found for it, None where it was missed."""

    truth: TruthCone
    feature: Found | None
    truth_range_m: float
    """Ground distance from the nearest point of the path."""
    range_m: float | None

    @property
    def difference_m(self) -> Vec3 | None:
        if self.feature is None:
            return None
        dx, dy, dz = (float(a - b) for a, b in zip(self.feature.xyz_m, self.truth.xyz_m, strict=True))
        return dx, dy, dz

    @property
    def error_3d_m(self) -> float | None:
        return None if self.difference_m is None else float(np.linalg.norm(self.difference_m))


def compare_with_truth(
    truth: Sequence[TruthCone],
    features: Sequence[Found],
    path_m: Floats,
    *,
    gate_m: float = 0.75,
    within_m: float = 20.0,
) -> tuple[list[TruthLine[Found]], list[Found]]:
    """The table, by cone id, and what stands for no cone (false ones).

    path_m: (F, 2 or 3) path of the left camera. A feature or track stands for a cone when the two are paired one-to-one at the
    least total distance and lie within gate_m. Cones farther than within_m from the path are not asked for.
    """
    asked = [cone for cone in truth if _range(cone.xyz_m, path_m) <= within_m]
    everything = list(truth)
    costs = np.full((len(everything), len(features)), _FORBIDDEN)
    for i, cone in enumerate(everything):
        for j, candidate in enumerate(features):
            distance = float(np.linalg.norm(np.subtract(candidate.xyz_m, cone.xyz_m)))
            if distance <= gate_m:
                costs[i, j] = distance
    rows, columns = linear_sum_assignment(costs)
    pairs = {i: j for i, j in zip(rows.tolist(), columns.tolist(), strict=True) if costs[i, j] < _FORBIDDEN}
    lines = []
    for i, cone in enumerate(everything):
        if cone not in asked:
            continue
        feature = features[pairs[i]] if i in pairs else None
        lines.append(
            TruthLine(
                cone, feature, _range(cone.xyz_m, path_m), None if feature is None else _range(feature.xyz_m, path_m)
            )
        )
    false = [features[j] for j in range(len(features)) if j not in pairs.values()]
    return sorted(lines, key=lambda line: line.truth.cone_id), false


def _range(xyz_m: Vec3, path_m: Floats) -> float:
    return float(np.linalg.norm(path_m[:, :2] - np.array(xyz_m[:2]), axis=1).min())
