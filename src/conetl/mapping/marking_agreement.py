"""Whether the lane markings of a drive contradict those of the map as a whole: most moved, all higher or aside, or replaced.

The same for cones is in `agreement.py`. A drive that shows no cone has nothing else that its position can be compared with.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from math import sqrt

import numpy as np

from conetl.mapping.agreement import held, scattered
from conetl.mapping.marking_deltas import drive_of, lines_on_map
from conetl.mapping.marking_lines import feet
from conetl.model.health import HealthCheck
from conetl.model.map_records import Delta, DeltaKind, MapFeature
from conetl.model.markings import MarkingTrack
from conetl.model.params import ReconcileParams

#: Sigmas of a common offset that the stated ones do not explain; smaller offsets and height differences are left to the fusion.
_MAX_SIGMAS, _LEAST_OFFSET_M, _LEAST_RISE_M = 5.0, 0.1, 0.3
#: Stretches that must agree on that, or be replaced; on a height beyond any error of measurement one is enough.
_LEAST_STRETCHES, _GROSS_RISE_M = 3, 1.5
_STRETCHES = "stretches of lane markings"


def marking_contradiction(
    markings: Sequence[MarkingTrack], stretches: Sequence[MapFeature], deltas: Sequence[Delta], params: ReconcileParams
) -> HealthCheck | None:
    """Why a drive must not change the map before a person has looked; None if it may. The order of none of them matters.

    stretches: those of the map around the drive; deltas: what `reconcile_markings` made of both.
    """
    kinds = Counter(delta.kind for delta in deltas)
    moved = scattered(kinds, _STRETCHES, "the road was painted anew")
    return moved or _displaced(markings, stretches, params) or _replaced(kinds)


def _displaced(
    markings: Sequence[MarkingTrack], stretches: Sequence[MapFeature], params: ReconcileParams
) -> HealthCheck | None:
    drive = drive_of(markings)
    on_map, map_cov = lines_on_map(sorted(stretches, key=lambda feature: feature.feature_id))
    found = feet(on_map, drive.lines, params.marking_moved_max_m)
    if not len(found.point):
        return None
    order = np.lexsort((np.abs(found.lateral_m), found.point))  # of each vertex the nearest line
    found = found.only(order[np.concatenate([[True], np.diff(found.point[order]) != 0])])
    cov = map_cov[found.point] + found.at(drive.cov_m2)
    count = len(np.unique(on_map.line[found.point]))
    up = float(np.median((found.at(drive.lines.vertices_m) - on_map.vertices_m[found.point])[:, 2]))
    sigma_m = float(np.sqrt(cov[:, 2, 2].mean()))
    limit_m = max(_LEAST_RISE_M if count >= _LEAST_STRETCHES else _GROSS_RISE_M, _MAX_SIGMAS * sigma_m)
    if abs(up) > limit_m:
        detail = (
            f"Its lane markings lie {abs(up):.1f} m {'higher' if up > 0 else 'lower'} than those of the map, at a stated "
            f"{sigma_m:.2f} m: the heights refer to another datum (ellipsoid or geoid), or the height of the antenna is wrong."
        )
        return held("heights", up, detail, sigma=sigma_m, limit=limit_m, unit="m")
    aside_m = float(np.hypot(*np.median(found.lateral_m[:, None] * on_map.normals[found.point], axis=0)))
    sigma_m = sqrt(float(cov[:, 0, 0].mean() + cov[:, 1, 1].mean()) / 2)
    limit_m = max(_LEAST_OFFSET_M, _MAX_SIGMAS * sigma_m)
    if count < _LEAST_STRETCHES or aside_m <= limit_m:
        return None
    detail = (
        f"Its lane markings lie {aside_m:.2f} m beside those of the map, at a stated {sigma_m:.2f} m: one of the two has a wrong "
        "position, or the road was painted anew. Check base station, datum and antenna offset of the drive."
    )
    return held("position", aside_m, detail, sigma=sigma_m, limit=limit_m, unit="m")


def _replaced(kinds: Counter[DeltaKind]) -> HealthCheck | None:
    """Most stretches in view gone, and as many others where the map has none: a drive that lies farther aside."""
    stayed, replaced = kinds[DeltaKind.CONFIRMED], min(kinds[DeltaKind.REMOVED], kinds[DeltaKind.ADDED])
    if replaced < _LEAST_STRETCHES or replaced + kinds[DeltaKind.MOVED] <= stayed:
        return None
    detail = (
        f"It would remove {kinds[DeltaKind.REMOVED]} {_STRETCHES}, add {kinds[DeltaKind.ADDED]} others and confirm "
        f"{stayed}: its position is wrong, or the road was painted anew. Check base station, datum and antenna offset."
    )
    limit = max(stayed, _LEAST_STRETCHES - 1)
    return held("replaced", replaced, detail, limit=limit, unit=_STRETCHES)
