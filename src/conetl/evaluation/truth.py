"""Surveyed cones (truth.csv) against cones of a map or a drive: the paper's Table 3. Surveyed check points against the cones of a
map: residuals and RMSE of each axis (ASPRS Positional Accuracy Standards, 2023). Check points are used for nothing else."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from io import StringIO
from itertools import compress
from pathlib import Path
from typing import Generic, Literal, NamedTuple, TypeVar

import numpy as np
import shapely
from pydantic import Field
from scipy.special import chdtrc

from conetl.files.documents import input_errors, library_errors, read_limited
from conetl.geometry.consistency import point_nees
from conetl.geometry.packing import cov_matrices
from conetl.mapping.association import assign, near_pairs
from conetl.model.arrays import Floats
from conetl.model.base import Record, Vec3
from conetl.model.drive import SurveyedPoint, Track
from conetl.model.errors import InputError
from conetl.model.feature_classes import CONE, FEATURE_CLASSES
from conetl.model.map_records import MapFeature

#: Features of the map, or tracks of one drive.
Found = TypeVar("Found", bound=MapFeature | Track)
_GATE_M = 0.75
#: Around the surveyed area: less than the distance to the next cone of a row.
_AROUND_M = 2.0
TABLE_3_COLUMNS = ("cone", "", "easting", "northing", "height", "range", "cone height", "3D error")
#: Probability below which residuals contradict the stated sigmas.
_CONTRADICTS = 1e-3


class TruthCone(Record):
    """One line of truth.csv: a surveyed cone, with the centre of the foot on the ground."""

    cone_id: str = Field(min_length=1)
    category: Literal[tuple(FEATURE_CLASSES)] = CONE  # type: ignore[valid-type]
    easting_m: float
    northing_m: float
    height_ellipsoidal_m: float
    cone_height_m: float = Field(gt=0)
    map_srid: int
    present: bool = True
    """False where the cone was taken away since the previous pass."""
    change: str = ""
    """added, confirmed, moved or removed since the previous pass."""

    @property
    def xyz_m(self) -> Vec3:
        """In the map's CRS."""
        return self.easting_m, self.northing_m, self.height_ellipsoidal_m


def read_truth(path: Path) -> list[TruthCone]:
    """All lines of a truth.csv. Raises InputError with file, line and field."""
    with library_errors(f"truth {path}: cannot be read", csv.Error):
        reader = csv.DictReader(StringIO(read_limited(path), newline=""))
        columns, rows = list(reader.fieldnames or ()), list(reader)
    required = [name for name, field in TruthCone.model_fields.items() if field.is_required()]
    if not set(required) <= set(columns):
        raise InputError(
            f"truth {path}: expected the columns {', '.join(required)}, separated by commas; found {', '.join(columns)[:200]}"
        )
    truth = []
    for number, row in enumerate(rows, 2):
        with input_errors(f"truth {path}, line {number}"):
            truth.append(TruthCone.model_validate(row))
    return truth


def read_truth_cones(path: Path) -> tuple[list[TruthCone], int]:
    """The cones present according to a truth.csv, and the EPSG code of their coordinates.

    Raises InputError if the file cannot be used, has no cones, or mixes coordinate systems.
    """
    cones = [cone for cone in read_truth(path) if cone.present]
    srids = sorted({cone.map_srid for cone in cones})
    if not cones:
        raise InputError(f"truth {path}: no cone is present (present = 1); nothing to compare with")
    if len(srids) > 1:
        raise InputError(f"truth {path}: map_srid must be the same for all cones, found {', '.join(map(str, srids))}")
    return cones, srids[0]


@dataclass(frozen=True)
class TruthLine(Generic[Found]):
    """A cone of the truth and the feature or track paired with it, None where it was missed."""

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


def pair_positions(truth_m: Floats, found_m: Floats, gate_m: float) -> dict[int, int]:
    """One-to-one pairs (by index) of positions (M, 3) and others (N, 3) at the least total distance, at most gate_m apart."""
    rows, columns = near_pairs(truth_m, found_m, gate_m)
    return dict(sorted(assign(rows, columns, np.linalg.norm(truth_m[rows] - found_m[columns], axis=1)).items()))


def compare_with_truth(
    truth: Sequence[TruthCone], features: Sequence[Found], path_m: Floats, *, within_m: float = 20.0
) -> tuple[list[TruthLine[Found]], list[Found]]:
    """One line per cone of the truth, by cone id, and the features without one.

    path_m: (F, 2 or 3) path of the left camera. Features or tracks are paired with cones of their class one-to-one at the least
    total distance, at most 0.75 m each. Cones farther than within_m from the path are left out, and features of classes of which
    the truth has none.
    """
    pairs: dict[int, int] = {}
    classes = {cone.category for cone in truth}
    features = [feature for feature in features if feature.category in classes]
    for category in classes:
        rows = [i for i, cone in enumerate(truth) if cone.category == category]
        columns = [j for j, feature in enumerate(features) if feature.category == category]
        truth_m = np.array([truth[i].xyz_m for i in rows]).reshape(-1, 3)
        found_m = np.array([features[j].xyz_m for j in columns]).reshape(-1, 3)
        pairs |= {rows[i]: columns[j] for i, j in pair_positions(truth_m, found_m, _GATE_M).items()}
    lines = []
    for i, cone in enumerate(truth):
        truth_range_m = _range(cone.xyz_m, path_m)
        if truth_range_m <= within_m:
            feature = features[pairs[i]] if i in pairs else None
            range_m = None if feature is None else _range(feature.xyz_m, path_m)
            lines.append(TruthLine(cone, feature, truth_range_m, range_m))
    others = [feature for j, feature in enumerate(features) if j not in pairs.values()]
    return sorted(lines, key=lambda line: line.truth.cone_id), others


def split_by_extent(truth: Sequence[TruthCone], found: Sequence[Found]) -> tuple[list[Found], list[Found]]:
    """Features without a cone of the truth: false ones inside the surveyed area, and those outside, which are not counted.

    The area is the convex hull of the truth, widened by 2 m.
    """
    area = shapely.MultiPoint([cone.xyz_m[:2] for cone in truth]).convex_hull
    far = [bool(area.distance(shapely.Point(one.xyz_m[:2])) > _AROUND_M) for one in found]
    return [*compress(found, (not is_far for is_far in far))], [*compress(found, far)]


def table_3_rows(lines: Sequence[TruthLine[Found]], *, missing: str) -> list[tuple[object, ...]]:
    """Truth, computed position and difference of each cone; `missing` in the second row of one that was not found."""
    rows: list[tuple[object, ...]] = []
    for line in lines:
        truth, feature = line.truth, line.feature
        known = (*truth.xyz_m, line.truth_range_m, truth.cone_height_m)
        rows.append((truth.cone_id, "truth", *(f"{value:.3f}" for value in known), ""))
        if feature is None or line.range_m is None:
            rows.append(("", missing, *[""] * 6))
            continue
        computed = (*feature.xyz_m, line.range_m, feature.object_height_m)
        differences = [b - a for a, b in zip(known, computed, strict=True)]
        rows.append(("", "computed", *(f"{value:.3f}" for value in computed), ""))
        rows.append(("", "difference", *(f"{value:+.3f}" for value in differences), f"{line.error_3d_m:.3f}"))
    return rows


def median_error(lines: Sequence[TruthLine[Found]]) -> float | None:
    """Median 3D error of the cones that were found, None without any."""
    errors = [line.error_3d_m for line in lines if line.error_3d_m is not None]
    return float(np.median(errors)) if errors else None


def line_as_dict(line: TruthLine[Found]) -> dict[str, object]:
    """One cone as JSON values."""
    return {
        "cone_id": line.truth.cone_id,
        "truth_xyz_m": line.truth.xyz_m,
        "xyz_m": line.feature.xyz_m if line.feature else None,
        "difference_m": line.difference_m,
        "error_3d_m": line.error_3d_m,
        "truth_range_m": line.truth_range_m,
        "range_m": line.range_m,
        "truth_cone_height_m": line.truth.cone_height_m,
        "object_height_m": line.feature.object_height_m if line.feature else None,
    }


def _range(xyz_m: Vec3, path_m: Floats) -> float:
    return float(np.linalg.norm(path_m[:, :2] - np.array(xyz_m[:2]), axis=1).min())


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
    pairs = pair_positions(truth, found, within_m)
    residuals = [
        PointResidual(point, features[pairs[i]], found[pairs[i]] - truth[i])
        if i in pairs
        else PointResidual(point, None, None)
        for i, point in enumerate(points)
    ]
    if not pairs:
        return CheckedMap(residuals, None, None, None, contradicts=False)
    d = np.array([found[j] - truth[i] for i, j in pairs.items()])
    squares = (d**2).mean(axis=0)
    rmse = np.sqrt([*squares, squares[0] + squares[1], squares.sum()])
    of_points = np.array([np.diag(np.square(points[i].sigma_m)) for i in pairs])
    total = float(point_nees(d, cov_matrices([features[j].cov_m2 for j in pairs.values()]) + of_points).sum())
    contradicts = bool(chdtrc(3 * len(d), total) < _CONTRADICTS)
    return CheckedMap(residuals, rmse, d.mean(axis=0), total / (3 * len(d)), contradicts=contradicts)
