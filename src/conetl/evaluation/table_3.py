"""Cones of a map or drive beside the surveyed ones: the paper's Table 3."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from conetl.evaluation.truth import Found, TruthCone, TruthLine, read_truth
from conetl.model.errors import InputError

TABLE_3_COLUMNS = ("cone", "", "easting", "northing", "height", "range", "cone height", "3D error")


def read_truth_cones(path: Path) -> tuple[list[TruthCone], int]:
    """The cones present according to a truth.csv, and the EPSG code of their coordinates.

    Raises InputError if the file cannot be used, has no cones, or mixes coordinate systems.
    """
    rows = [row for row in read_truth(path) if row.present]
    srids = sorted({row.map_srid for row in rows})
    if not rows:
        raise InputError(f"truth {path}: no cone is present (present = 1); nothing to compare with")
    if len(srids) > 1:
        raise InputError(f"truth {path}: map_srid must be the same for all cones, found {', '.join(map(str, srids))}")
    cones = [
        TruthCone(
            cone_id=row.cone_id,
            xyz_m=(row.easting_m, row.northing_m, row.height_ellipsoidal_m),
            cone_height_m=row.cone_height_m,
        )
        for row in rows
    ]
    return cones, srids[0]


def table_3_rows(lines: Sequence[TruthLine[Found]], *, missing: str) -> list[tuple[object, ...]]:
    """Truth, computed and difference of each cone; `missing` in the second row if it was not found."""
    rows: list[tuple[object, ...]] = []
    for line in lines:
        truth, feature = line.truth, line.feature
        known = (*truth.xyz_m, line.truth_range_m, truth.cone_height_m)
        rows.append((truth.cone_id, "truth", *(f"{value:.3f}" for value in known), ""))
        if feature is None or line.range_m is None:
            rows.append(("", missing, *[""] * 6))
            continue
        computed = (*feature.xyz_m, line.range_m, feature.cone_height_m)
        differences = [b - a for a, b in zip(known, computed, strict=True)]
        rows.append(("", "computed", *(f"{value:.3f}" for value in computed), ""))
        rows.append(("", "difference", *(f"{value:+.3f}" for value in differences), f"{line.error_3d_m:.3f}"))
    return rows


def median_error(lines: Sequence[TruthLine[Found]]) -> float | None:
    """Median 3D error of the cones that were found, None if none was."""
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
        "cone_height_m": line.feature.cone_height_m if line.feature else None,
    }
