"""Checks of a whole drive against the map: its cones are all lower, shifted or turned, or too many of the map's cones are gone;
or the same of its lane markings, the only thing to compare in a drive without cones.

A failed check is one finding for a person, not nine moved cones. The checks are part of the merge, so they are repeated when an
earlier drive arrives.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import islice
from math import exp, log, sqrt

import numpy as np
from scipy.special import betaln

from conetl.mapping.displacement import POSITION, check_classes, check_displacement, check_heights
from conetl.mapping.marking_deltas import line_drive, lines_on_map
from conetl.mapping.marking_lines import feet
from conetl.model.drive import Track
from conetl.model.health import AGREEMENT, Finding
from conetl.model.map_records import Delta, DeltaKind, MapFeature
from conetl.model.markings import MarkingTrack
from conetl.model.params import ReconcileParams

#: A drive that confirms this many objects that were on the map an hour before is correctly positioned.
LEAST_CONFIRMED, BEFORE_NS = 3, 3_600_000_000_000


def is_confirmed(deltas: Sequence[Delta], captured_from_ns: int) -> bool:
    """Whether a drive confirms point objects that were on the map an hour before it began."""
    kinds, before_ns = (DeltaKind.CONFIRMED, DeltaKind.HEIGHT_CHANGED), captured_from_ns - BEFORE_NS
    known = (d for d in deltas if d.kind in kinds and not d.is_line and d.old and d.old.first_seen_ns < before_ns)
    return len(list(islice(known, LEAST_CONFIRMED))) == LEAST_CONFIRMED


def check_agreement(
    tracks: Sequence[Track], features: Sequence[MapFeature], deltas: Sequence[Delta], params: ReconcileParams
) -> Finding | None:
    """What of the map contradicts a drive; None if nothing does.

    features: the map's point objects around the drive; deltas: by `reconcile`. The result does not depend on their order.
    """
    kinds = Counter(delta.kind for delta in deltas)
    sure = sorted(
        (track for track in tracks if track.existence_probability >= params.founding_existence_probability),
        key=lambda track: track.xyz_m,
    )
    return (
        check_displacement(sure, features, deltas, params)
        or check_classes(sure, features, params)
        or _check_moves(kinds, params)
        or _check_removals(kinds, params)
    )


def check_marking_agreement(
    markings: Sequence[MarkingTrack], stretches: Sequence[MapFeature], deltas: Sequence[Delta], params: ReconcileParams
) -> Finding | None:
    """What of the map contradicts a drive; None if nothing does. The result does not depend on any order.

    stretches: those of the map around the drive; deltas: by `reconcile_markings`.
    """
    kinds = Counter(delta.kind for delta in deltas)
    moved = _check_moves(kinds, params, "stretches of lane markings")
    return moved or _check_marking_positions(markings, stretches, params) or _check_replaced(kinds, params)


def _check_moves(kinds: Counter[DeltaKind], params: ReconcileParams, what: str = "cones") -> Finding | None:
    """Whether most of the objects that a drive shows are at other positions than on the map."""
    least, moved = params.agreement.least_pairs, kinds[DeltaKind.MOVED]
    stayed = kinds[DeltaKind.CONFIRMED] + kinds[DeltaKind.HEIGHT_CHANGED]
    if moved < least or moved <= stayed:
        return None
    facts: dict[str, int | str] = {"moved": moved, "shown": moved + stayed, "what": what}
    return _contradiction("moves", moved, max(stayed, least - 1), facts)


def _contradiction(
    comparison: str, value: float, limit: float, facts: Mapping[str, int | str], says: str = ""
) -> Finding:
    return Finding(check=f"{AGREEMENT}: {comparison}", value=value, limit=limit, found=True, says=(says,), facts=facts)


def _check_removals(kinds: Counter[DeltaKind], params: ReconcileParams) -> Finding | None:
    """Whether a drive that finds many cones gone was probably blind.

    Beta-binomial: either the drive detects all that the model card promises, and the cones of a road vanish together (share of
    mean `vanished_probability`, beta-distributed with concentration 1); or it detects an unknown share of them. Cones that it
    found, including new ones, are evidence against the latter.
    """
    removed, stayed = kinds[DeltaKind.REMOVED], kinds[DeltaKind.CONFIRMED] + kinds[DeltaKind.HEIGHT_CHANGED]
    seen = stayed + kinds[DeltaKind.ADDED] + kinds[DeltaKind.MOVED] + kinds[DeltaKind.SPLIT]
    limits = params.agreement
    if removed < limits.least_pairs:
        return None
    v = params.vanished_probability
    gone = log(1 - limits.blind_probability) + betaln(v + removed, 1 - v + stayed) - betaln(v, 1 - v)
    blind = log(limits.blind_probability) + betaln(1 + removed, 1 + seen)
    if blind - gone <= log(limits.max_blind / (1 - limits.max_blind)):
        return None
    facts = {"removed": removed, "in_view": removed + stayed, "seen": seen}
    return _contradiction("removals", 100 / (1.0 + exp(gone - blind)), 100 * limits.max_blind, facts)


def _check_marking_positions(
    markings: Sequence[MarkingTrack], stretches: Sequence[MapFeature], params: ReconcileParams
) -> Finding | None:
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
    check = check_heights(up, sqrt(cov[:, 2, 2].mean()), count, params.agreement, what="lane markings", those="those")
    if check is not None:
        return check
    aside_m = float(np.hypot(*np.median(found.lateral_m[:, None] * on_map.normals[found.point], axis=0)))
    sigma_m = sqrt(float(cov[:, 0, 0].mean() + cov[:, 1, 1].mean()) / 2)
    limit_m = max(params.agreement.least_offset_m, params.agreement.sigmas * sigma_m)
    if count < params.agreement.least_pairs or aside_m <= limit_m:
        return None
    return Finding(check=POSITION, value=aside_m, sigma=sigma_m, limit=limit_m, found=True, says=("markings",))


def _check_replaced(kinds: Counter[DeltaKind], params: ReconcileParams) -> Finding | None:
    """Whether most stretches in view are gone: the drive is displaced and adds as many others, or it cannot see them."""
    stayed, moved = kinds[DeltaKind.CONFIRMED], kinds[DeltaKind.MOVED]
    added, removed, least = kinds[DeltaKind.ADDED], kinds[DeltaKind.REMOVED], params.agreement.least_pairs
    is_displaced = min(removed, added) >= least and min(removed, added) + moved > stayed
    if not is_displaced and (removed < least or removed <= stayed + moved + added):
        return None
    facts = {"removed": removed, "added": added, "stayed": stayed}
    return _contradiction("replaced", removed, max(stayed, least - 1), facts, "" if is_displaced else "not seen")
