"""Checks of a whole drive against the map: its cones are all lower, shifted or turned, or too many of the map's cones are gone;
or the same of its lane markings, the only thing to compare in a drive without cones.

A failed check is one finding for a person, not nine moved cones. The checks are part of the merge, so they are repeated when an
earlier drive arrives; docs/explanation/health.md has their limits.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import islice
from math import exp, log, sqrt

import numpy as np
from scipy.special import betaln

from conetl.mapping.association import MAX_SIGMAS
from conetl.mapping.displacement import (
    LEAST_OFFSET_M,
    LEAST_PAIRS,
    agreement_hold,
    check_arrangement,
    check_classes,
    check_heights,
    check_part,
    check_parts,
    check_positions,
)
from conetl.mapping.marking_deltas import line_drive, lines_on_map
from conetl.mapping.marking_lines import feet
from conetl.model.drive import Track
from conetl.model.health import HealthCheck
from conetl.model.map_records import Delta, DeltaKind, MapFeature
from conetl.model.markings import MarkingTrack
from conetl.model.params import ReconcileParams

#: Fewer removed or moved cones are not checked.
_LEAST_REMOVED, _LEAST_MOVED = 3, 3
#: A drive that confirms this many objects that were on the map an hour before is correctly positioned.
LEAST_CONFIRMED, BEFORE_NS = 3, 3_600_000_000_000
_STRETCHES = "stretches of lane markings"
#: Prior probability that a drive is blind to what its model card promises, and the posterior from which a person must decide.
_BLIND_PRIOR, _MAX_BLIND = 0.01, 0.05


def is_confirmed(deltas: Sequence[Delta], captured_from_ns: int) -> bool:
    """Whether a drive confirms point objects that were on the map an hour before it began."""
    kinds, before_ns = (DeltaKind.CONFIRMED, DeltaKind.HEIGHT_CHANGED), captured_from_ns - BEFORE_NS
    known = (d for d in deltas if d.kind in kinds and not d.is_line and d.old and d.old.first_seen_ns < before_ns)
    return len(list(islice(known, LEAST_CONFIRMED))) == LEAST_CONFIRMED


def check_agreement(
    tracks: Sequence[Track], features: Sequence[MapFeature], deltas: Sequence[Delta], params: ReconcileParams
) -> HealthCheck | None:
    """Why a drive must not change the map before a person has checked it; None if it may.

    features: the map's point objects around the drive; deltas: by `reconcile`. The result does not depend on their order.
    """
    kinds = Counter(delta.kind for delta in deltas)
    sure = sorted(
        (track for track in tracks if track.existence_probability >= params.founding_existence_probability),
        key=lambda track: track.xyz_m,
    )
    check = check_positions(sure, features, kinds, params) if sure and features else None
    check = check or check_arrangement(sure, features, params) or check_classes(sure, features, params)
    check = check or check_parts(sure, features, params) or check_part(deltas, params)
    return check or _check_moves(kinds, "cones", "the zone was set up again") or _check_removals(kinds, params)


def check_marking_agreement(
    markings: Sequence[MarkingTrack], stretches: Sequence[MapFeature], deltas: Sequence[Delta], params: ReconcileParams
) -> HealthCheck | None:
    """Why a drive must not change the map before a person has checked it; None if it may. The result does not depend on any
    order.

    stretches: those of the map around the drive; deltas: by `reconcile_markings`.
    """
    kinds = Counter(delta.kind for delta in deltas)
    moved = _check_moves(kinds, _STRETCHES, "the road was repainted")
    return moved or _check_marking_positions(markings, stretches, params) or _check_replaced(kinds)


def _check_moves(kinds: Counter[DeltaKind], what: str, otherwise: str) -> HealthCheck | None:
    """Whether most of the objects that a drive shows are at other positions than on the map.

    what: their name; otherwise: the explanation if the drive is right.
    """
    moved, stayed = kinds[DeltaKind.MOVED], kinds[DeltaKind.CONFIRMED] + kinds[DeltaKind.HEIGHT_CHANGED]
    if moved < _LEAST_MOVED or moved <= stayed:
        return None
    detail = (
        f"The drive would move {moved} of the {moved + stayed} {what} that it shows: its distances or poses are wrong "
        f"(baseline, alignment), or {otherwise}."
    )
    return agreement_hold("moves", moved, detail, limit=max(stayed, _LEAST_MOVED - 1), unit=what)


def _check_removals(kinds: Counter[DeltaKind], params: ReconcileParams) -> HealthCheck | None:
    """Whether a drive that finds many cones gone was probably blind.

    Beta-binomial: either the drive detects all that the model card promises, and the cones of a road vanish together (share of
    mean `vanished_probability`, beta-distributed with concentration 1); or it detects an unknown share of them. Cones that it
    found, including new ones, are evidence against the latter.
    """
    removed, stayed = kinds[DeltaKind.REMOVED], kinds[DeltaKind.CONFIRMED] + kinds[DeltaKind.HEIGHT_CHANGED]
    seen = stayed + kinds[DeltaKind.ADDED] + kinds[DeltaKind.MOVED] + kinds[DeltaKind.SPLIT]
    if removed < _LEAST_REMOVED:
        return None
    v = params.vanished_probability
    gone = log(1 - _BLIND_PRIOR) + betaln(v + removed, 1 - v + stayed) - betaln(v, 1 - v)
    blind = log(_BLIND_PRIOR) + betaln(1 + removed, 1 + seen)
    if blind - gone <= log(_MAX_BLIND / (1 - _MAX_BLIND)):
        return None
    detail = (
        f"The drive would remove {removed} of the {removed + stayed} cones in its view and shows {seen or 'no'} "
        f"{'cone' if seen == 1 else 'cones'}: were they cleared, or could the cameras not see them? Check the images."
    )
    probability = 1.0 / (1.0 + exp(gone - blind))
    return agreement_hold(
        "removals", 100 * probability, detail, limit=100 * _MAX_BLIND, unit="% that it could not see them"
    )


def _check_marking_positions(
    markings: Sequence[MarkingTrack], stretches: Sequence[MapFeature], params: ReconcileParams
) -> HealthCheck | None:
    drive = line_drive(markings)
    on_map, map_cov = lines_on_map(sorted(stretches, key=lambda feature: feature.feature_id))
    found = feet(on_map, drive.lines, params.marking_moved_max_m)
    if not len(found.point):
        return None
    order = np.lexsort((np.abs(found.lateral_m), found.point))  # of each vertex the nearest line
    found = found.only(order[np.concatenate([[True], np.diff(found.point[order]) != 0])])
    cov = map_cov[found.point] + found.at(drive.cov_m2)
    count = len(np.unique(on_map.line[found.point]))
    up = float(np.median((found.at(drive.lines.vertices_m) - on_map.vertices_m[found.point])[:, 2]))
    check = check_heights(up, sqrt(cov[:, 2, 2].mean()), count, "lane markings", "those")
    if check is not None:
        return check
    aside_m = float(np.hypot(*np.median(found.lateral_m[:, None] * on_map.normals[found.point], axis=0)))
    sigma_m = sqrt(float(cov[:, 0, 0].mean() + cov[:, 1, 1].mean()) / 2)
    limit_m = max(LEAST_OFFSET_M, MAX_SIGMAS * sigma_m)
    if count < LEAST_PAIRS or aside_m <= limit_m:
        return None
    detail = (
        f"Its lane markings are {aside_m:.2f} m beside those of the map, with a stated sigma of {sigma_m:.2f} m: one of the two "
        "has a wrong position, or the road was repainted. Check base station, datum and antenna offset of the drive."
    )
    return agreement_hold("position", aside_m, detail, sigma=sigma_m, limit=limit_m, unit="m")


def _check_replaced(kinds: Counter[DeltaKind]) -> HealthCheck | None:
    """Whether most stretches in view are gone: the drive is displaced and adds as many others, or it cannot see them."""
    stayed, moved = kinds[DeltaKind.CONFIRMED], kinds[DeltaKind.MOVED]
    added, removed = kinds[DeltaKind.ADDED], kinds[DeltaKind.REMOVED]
    if min(removed, added) >= LEAST_PAIRS and min(removed, added) + moved > stayed:
        cause = "its position is wrong, or the road was repainted. Check base station, datum and antenna offset."
    elif removed >= LEAST_PAIRS and removed > stayed + moved + added:
        cause = "a lens was smeared or covered, or the paint is gone. Check the images."
    else:
        return None
    detail = f"The drive would remove {removed} {_STRETCHES}, add {added} others and confirm {stayed}: {cause}"
    limit = max(stayed, LEAST_PAIRS - 1)
    return agreement_hold("replaced", removed, detail, limit=limit, unit=_STRETCHES)
