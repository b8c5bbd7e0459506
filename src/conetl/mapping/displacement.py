"""Whether the objects of a drive, of a part of it, of a second pass or of an imported map are displaced against those of the map.

One estimator tries transforms: none, the common offset of the drive, and of those that put two cones onto two of the map the one
after which most fit (`searches`). Cones at equal distances also fit a row farther along, and the same plan elsewhere: where a
transform is searched far away, only an irregular arrangement that fits once, to within the difference of two surveys of the same
cones, counts as the same cones.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from math import hypot
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from conetl.geometry.packing import cov_matrices
from conetl.mapping.arrangement import ArrangementFit, best_fit
from conetl.mapping.association import assign, classes_of, common_offset, near_pairs, xyz_of
from conetl.mapping.fusion import difference_cov
from conetl.model.arrays import Floats, Ints
from conetl.model.drive import Track
from conetl.model.health import AGREEMENT, Finding
from conetl.model.map_records import Delta, DeltaKind, MapFeature
from conetl.model.params import AgreementParams, ReconcileParams

POSITION, HEIGHTS = f"{AGREEMENT}: position", f"{AGREEMENT}: heights"
#: A merge compares everything on the map within this distance.
_NEAR_M = 50.0
#: Unless a fit proves the same zone, this share of the map's cones must be absent: the drive may see another row beside it.
_LEAST_ABSENT_SHARE = 0.25
#: At most about this many tracks are compared by their arrangement; smaller rotations are not named.
_MAX_TRACKS, _LEAST_TURN_DEG = 200, 1.0
_NOT_MOVED, _ALL_AXES, _HEIGHT = np.zeros(3), np.ones(3), np.array([0.0, 0.0, 1.0])


class Search(NamedTuple):
    """Transforms of one kind, and what proves one of them."""

    within_m: float
    """Largest displacement ..."""
    turn_deg: float
    """... and rotation."""
    least: int
    """Cones that must fit."""
    near_m: float
    """Cones count if one of the map is within this distance."""
    is_exact: bool = True
    """Whether only the same cones count: to `same_zone_m`, at unequal distances, at no other place; else to `min_gate_m`."""


def searches(params: ReconcileParams) -> dict[str, Search]:
    """The transforms that are tried for a whole drive, a part of it, and cones that are stated again."""
    own, far_m = params.agreement, params.agreement.elsewhere_m
    return {
        "drive": Search(own.max_displacement_m, own.max_turn_deg, own.least_agreeing, own.max_displacement_m, False),
        "elsewhere": Search(far_m, own.max_turn_deg, own.least_same_of_drive, far_m),
        "any turn": Search(far_m, 180.0, own.least_same_of_drive, far_m),  # people type the direction of local frames
        "part": Search(own.max_displacement_m, own.part_turn_deg, own.least_pairs, far_m),
        "few cones": Search(own.lever_m, own.part_turn_deg, own.least_pairs, far_m),  # lever arm of another vehicle
        "moved": Search(far_m, own.max_turn_deg, own.least_agreeing, far_m),
        "stated again": Search(far_m, own.max_turn_deg, own.least_same, far_m),
        "passed again": Search(own.again_m, own.max_turn_deg, own.least_same, far_m),
    }


class _Objects(NamedTuple):
    """N tracks or features."""

    xyz_m: Floats
    classes: NDArray[np.str_]
    cov_m2: Floats
    """(N, 3, 3)"""
    some: Sequence[Track | MapFeature]


def _objects(some: Sequence[Track | MapFeature]) -> _Objects:
    return _Objects(xyz_of(some), classes_of(some), cov_matrices([one.cov_m2 for one in some]), some)


def check_displacement(
    tracks: Sequence[Track], features: Sequence[MapFeature], deltas: Sequence[Delta], params: ReconcileParams
) -> Finding | None:
    """Whether a drive, or a part of it, is displaced against the map beyond the stated sigmas.

    tracks: in an order of their positions; features: of the map around the drive; deltas: by `reconcile`.
    """
    if not tracks or not features:
        return _of_deltas(deltas, params)
    kinds = Counter(delta.kind for delta in deltas)
    stay = kinds[DeltaKind.CONFIRMED] + kinds[DeltaKind.HEIGHT_CHANGED]
    absent = kinds[DeltaKind.REMOVED] + kinds[DeltaKind.MISSED] + kinds[DeltaKind.MOVED]
    drive, on_map, tried = _objects(tracks), _objects(features), searches(params)
    # GNSS without a fix is metres off, as its sigmas state: only the heights are compared after its offset is taken out.
    offset_m = np.array([*common_offset(tracks, features, params)[0][:2], 0.0])
    return (
        _at_same_positions(drive, on_map, params, tried["drive"].near_m)
        or _at_same_positions(drive, on_map, params, tried["drive"].near_m, offset_m, _HEIGHT)
        or _displaced(drive, on_map, tried["drive"], params, stay, absent)
        or _elsewhere(drive, on_map, params)
        or _of_parts(tracks, on_map, params)
        or _of_deltas(deltas, params)
    )


def check_same_cones(
    stated: Sequence[Track | MapFeature],
    features: Sequence[Track | MapFeature],
    params: ReconcileParams,
    tried: Literal["stated again", "passed again"] = "stated again",
) -> Finding | None:
    """Whether cones that are stated again, by an imported map or a second pass, have a common displacement beyond their sigmas.

    tried: which of the `searches`.
    """
    if not stated or not features:
        return None
    cones, on_map, search = _objects(stated), _objects(features), searches(params)[tried]
    # If most have no cone near them, the rest match neighbours by chance: only heights are compared.
    return (
        _at_same_positions(cones, on_map, params, search.near_m)
        or _at_same_positions(cones, on_map, params, 0.0, _NOT_MOVED, _HEIGHT)
        or _displaced(cones, on_map, search, params, _count_same(cones, on_map, params))
    )


def check_far_positions(
    tracks: Sequence[Track], features: Sequence[MapFeature], params: ReconcileParams
) -> Finding | None:
    """Whether a drive's cones have a common displacement that is too large for `check_displacement`.

    features: the map's point objects within `elsewhere_m` of the tracks. A merge compares only what a drive may have in view, so
    this is checked once, when the drive is ingested.
    """
    sure = [track for track in tracks if track.existence_probability >= params.founding_existence_probability]
    if not sure or not features:
        return None
    drive, on_map = _objects(sure), _objects(features)
    if (found := _other_section(drive, on_map, params.agreement)) is not None:
        return found.model_copy(update={"check": "heights of another section"})
    found = _elsewhere(drive, on_map, params)
    if found is None or found.value is None or found.value <= _NEAR_M:
        return None
    return found.model_copy(update={"check": "the same cones elsewhere"})


def check_classes(tracks: Sequence[Track], features: Sequence[MapFeature], params: ReconcileParams) -> Finding | None:
    """Whether most of the objects at positions of map objects are of another class."""
    if not tracks or not features:
        return None
    drive, on_map = _objects(tracks), _objects(features)
    same = _same_positions(drive, on_map, _NOT_MOVED, params)
    i = np.setdiff1d(np.arange(len(drive.xyz_m)), list(same))
    j = np.setdiff1d(np.arange(len(on_map.xyz_m)), list(same.values()))
    rows, columns = near_pairs(drive.xyz_m[i, :2], on_map.xyz_m[j, :2], params.min_gate_m)
    pairs = assign(rows, columns, np.hypot(*(drive.xyz_m[i[rows]] - on_map.xyz_m[j[columns]])[:, :2].T))
    least = params.agreement.least_pairs
    if len(pairs) < least or len(pairs) <= len(same):
        return None
    changes = Counter((on_map.classes[j[b]], drive.classes[i[a]]) for a, b in pairs.items())
    (was, now), _ = max(changes.items(), key=lambda item: (item[1], item[0]))
    facts = {"objects": len(pairs) + len(same), "others": len(pairs), "now": str(now), "was": str(was)}
    limit = max(len(same), least - 1)
    return Finding(check=f"{AGREEMENT}: classes", value=len(pairs), limit=limit, found=True, facts=facts)


def check_heights(
    up_m: float,
    sigma_m: float,
    count: int,
    limits: AgreementParams,
    *,
    what: str = "cones",
    those: str = "the same cones",
) -> Finding | None:
    """A common height difference `up_m`, if it is significant. count: pairs that agree on it."""
    least_m = limits.least_offset_m if count >= limits.least_pairs else limits.gross_rise_m
    limit_m = max(least_m, limits.sigmas * sigma_m)
    if abs(up_m) <= limit_m:
        return None
    apart = f"{abs(up_m):.{1 if abs(up_m) >= 1 else 2}f} m {'higher' if up_m > 0 else 'lower'}"
    return _finding(HEIGHTS, up_m, sigma_m, limit_m).saying("", apart=apart, what=what, those=those)


def _at_same_positions(
    cones: _Objects,
    on_map: _Objects,
    params: ReconcileParams,
    near_m: float,
    shift_m: Floats = _NOT_MOVED,
    axes: Floats = _ALL_AXES,
) -> Finding | None:
    """The common displacement of the cones at positions of the map's, at least half of those that have one within `near_m`.

    shift_m (3,): by which the cones are moved back first; axes (3,): 1 of coordinates that are compared, 0 of others.
    """
    pairs = _same_positions(cones, on_map, shift_m, params)
    if not pairs or 2 * len(pairs) < len(_near(cones, on_map, near_m)):
        return None
    i, j = list(pairs), list(pairs.values())
    few = slice(None, None, 1 + len(pairs) // _MAX_TRACKS)  # covariances of all would take long, and differ little
    ours, theirs = [cones.some[k] for k in i[few]], [on_map.some[k] for k in j[few]]
    cov_m2 = difference_cov(
        [one.cov_m2 for one in ours], [one.shared_jacobian for one in ours],
        [one.cov_m2 for one in theirs], [one.shared_jacobian for one in theirs],
    )  # fmt: skip
    apart_m = cones.xyz_m[i] - on_map.xyz_m[j]
    return _common_displacement(apart_m * axes, cov_m2.mean(axis=0), params.agreement)


def _displaced(
    cones: _Objects, on_map: _Objects, search: Search, params: ReconcileParams, stay: int, absent: int = 0
) -> Finding | None:
    """Whether the arrangement of the cones fits the map's after a transform, by more than the sigmas allow.

    stay: how many stand at a cone of the map; twice as many must fit elsewhere. absent: cones of the map that the drive misses.
    """
    limits, near = params.agreement, _near(cones, on_map, search.near_m)
    some = near[:: 1 + len(near) // _MAX_TRACKS]
    share = len(some) / max(len(near), 1)
    least = max(search.least, limits.least_share * len(some), 2 * stay * share + 1)
    t, f = cones.xyz_m[:, :2], on_map.xyz_m[:, :2]
    if least > len(some) or (search.is_exact and _is_even(t[near], t[some], limits)):
        return None
    gate_m = 2 * limits.same_zone_m if search.is_exact else params.min_gate_m
    fit = best_fit(t[some], f, gate_m, search.within_m, np.radians(search.turn_deg))
    if fit is None or fit.agreeing < least:
        return None
    is_same = fit.distinct and fit.residual_m <= limits.same_zone_m
    if not search.is_exact:
        is_same |= (fit.distinct and fit.beside) or absent * share >= _LEAST_ABSENT_SHARE * fit.agreeing
    return _position(fit, cones, on_map, search, params) if is_same else None


def _is_even(near: Floats, some: Floats, limits: AgreementParams) -> bool:
    """Whether some (N, 2) of the cones near (M, 2) the map's have the same distance from their neighbours."""
    return bool(np.asarray(cKDTree(near).query(some, 2)[0])[:, 1].std() < 2 * limits.same_zone_m)


def _position(
    fit: ArrangementFit, cones: _Objects, on_map: _Objects, search: Search, params: ReconcileParams
) -> Finding | None:
    """The finding of a transform that is beyond the stated sigmas, or too far to tell which cone is which."""
    sigma_m = _mean_sigma_m(cones.cov_m2.mean(axis=0) + on_map.cov_m2.mean(axis=0))
    allowed_m, turn_deg = params.agreement.sigmas * sigma_m, float(np.degrees(fit.turn))
    limit_m = min(params.max_offset_m, allowed_m)
    if fit.largest_m <= limit_m:
        return None
    says = "turned" if abs(turn_deg) >= _LEAST_TURN_DEG else ""
    if fit.largest_m <= allowed_m and not search.is_exact:
        says = "too far"
    return _finding(POSITION, fit.middle_m, sigma_m, limit_m, says).saying(says, turn_deg=turn_deg)


def _elsewhere(drive: _Objects, on_map: _Objects, params: ReconcileParams) -> Finding | None:
    """Whether the arrangement of enough cones matches the map elsewhere, even along a row from which no cone is missing."""
    tried, same = searches(params), _count_same(drive, on_map, params)
    found = (_displaced(drive, on_map, tried[name], params, same) for name in ("elsewhere", "any turn"))
    return next(filter(None, found), None)


def _of_parts(tracks: Sequence[Track], on_map: _Objects, params: ReconcileParams) -> Finding | None:
    """Whether a part of the drive is displaced. No cone was observed both before and in it.

    GNSS may get another fix while the vehicle waits or drives on without recording; it does not turn the positions. A drive with
    one part, which may show few cones, is compared with cones that a wrong lever arm can reach.
    """
    parts: list[list[Track]] = []
    end_ns = 0
    for track in sorted(tracks, key=lambda track: (track.first_seen_ns, track.xyz_m)):
        if track.first_seen_ns > end_ns:
            parts.append([])
        parts[-1].append(track)
        end_ns = max(end_ns, track.last_seen_ns)
    search = searches(params)["part" if len(parts) > 1 else "few cones"]
    for part in (_objects(one) for one in parts if len(one) >= search.least):  # fewer can prove nothing
        found = _displaced(part, on_map, search, params, _count_same(part, on_map, params))
        if found is not None:
            return _only(found, len(part.xyz_m)) if len(parts) > 1 else found
    return None


def _of_deltas(deltas: Sequence[Delta], params: ReconcileParams) -> Finding | None:
    """Whether the cones that a drive moves, or misses and adds elsewhere, have one common displacement.

    GNSS may get another fix while the vehicle waits, and no images show the jump. People do not move cones by equal distances.
    """
    found = _equal_moves(deltas, params.agreement)
    if found is not None:
        return found
    came = _by_position(d.new for d in deltas if d.kind in (DeltaKind.ADDED, DeltaKind.MOVED))
    gone = _by_position(d.old for d in deltas if d.kind in (DeltaKind.MOVED, DeltaKind.REMOVED, DeltaKind.MISSED))
    if not came or not gone:
        return None
    found = _displaced(_objects(came), _objects(gone), searches(params)["moved"], params, 0)
    return None if found is None else _only(found, len(came))


def _only(found: Finding, count: int) -> Finding:
    return found.saying(*found.says, "part", count=count)


def _equal_moves(deltas: Sequence[Delta], limits: AgreementParams) -> Finding | None:
    """The displacement that most of the moved cones have in common."""
    moved = [(d.old, d.new) for d in deltas if d.kind is DeltaKind.MOVED and d.old and d.new]
    if len(moved) < limits.least_pairs:
        return None
    old, new = zip(*sorted(moved, key=lambda pair: (pair[0].xyz_m, pair[1].xyz_m)), strict=True)
    apart_m = (xyz_of(new) - xyz_of(old)) * (1.0, 1.0, 0.0)
    near = np.linalg.norm(apart_m[:, None] - apart_m, axis=2) <= 2 * limits.same_zone_m
    alike = near[near.sum(axis=1).argmax()]
    if np.hypot(*apart_m[alike, :2].std(axis=0)) > limits.same_zone_m:
        return None
    cov_m2 = 2 * cov_matrices([one.cov_m2 for one in (*old, *new)]).mean(axis=0)
    found = _common_displacement(apart_m[alike], cov_m2, limits)
    return None if found is None else _only(found, int(alike.sum()))


def _by_position(features: Iterable[MapFeature | None]) -> list[MapFeature]:
    return sorted((feature for feature in features if feature), key=lambda feature: feature.xyz_m)


def _other_section(drive: _Objects, on_map: _Objects, limits: AgreementParams) -> Finding | None:
    """The height difference of a drive's cones against the map's nearest ones, if it proves another section of the road."""
    apart_m, nearest = cKDTree(on_map.xyz_m[:, :2]).query(drive.xyz_m[:, :2])
    near = apart_m <= limits.beside_m
    up_m = (drive.xyz_m[:, 2] - on_map.xyz_m[nearest, 2])[near]
    if not up_m.size or np.abs(up_m).min() < limits.cliff_m:
        return None
    sigma_m = float(np.sqrt((drive.cov_m2 + on_map.cov_m2[nearest])[near, 2, 2].max()))
    return check_heights(float(np.median(up_m)), sigma_m, len(up_m), limits, those="the nearest ones")


def _near(cones: _Objects, on_map: _Objects, near_m: float) -> Ints:
    """Indices of the cones that have one of the map within this distance."""
    return np.flatnonzero(cKDTree(on_map.xyz_m[:, :2]).query(cones.xyz_m[:, :2])[0] <= near_m)


def _same_positions(cones: _Objects, on_map: _Objects, shift_m: Floats, params: ReconcileParams) -> dict[int, int]:
    """Cone -> feature of the same class at its position, after moving cones back by `shift_m` (3,); heights are ignored."""
    moved = (cones.xyz_m - shift_m)[:, :2]
    rows, columns = near_pairs(moved, on_map.xyz_m[:, :2], params.min_gate_m)
    alike = cones.classes[rows] == on_map.classes[columns]  # a sign may hang above a cone
    rows, columns = rows[alike], columns[alike]
    return assign(rows, columns, np.hypot(*(moved[rows] - on_map.xyz_m[columns, :2]).T))


def _count_same(cones: _Objects, on_map: _Objects, params: ReconcileParams) -> int:
    return len(_same_positions(cones, on_map, _NOT_MOVED, params))


def _finding(check: str, value: float, sigma: float, limit: float, says: str = "") -> Finding:
    return Finding(check=check, value=float(value), sigma=float(sigma), limit=float(limit), found=True, says=(says,))


def _mean_sigma_m(cov_m2: Floats) -> float:
    """Mean horizontal sigma of a (3, 3) covariance."""
    return float(np.sqrt(np.trace(cov_m2[:2, :2]) / 2))


def _common_displacement(apart_m: Floats, cov_m2: Floats, limits: AgreementParams) -> Finding | None:
    """The median displacement, if it is significant. apart_m (K, 3): cones minus their features; cov_m2 (3, 3): of one
    difference."""
    east, north, up = np.median(apart_m, axis=0).tolist()
    heights = check_heights(up, float(np.sqrt(cov_m2[2, 2])), len(apart_m), limits)
    if heights is not None:
        return heights
    offset = np.array([east, north])
    chi2 = float(offset @ np.linalg.solve(cov_m2[:2, :2], offset))
    significant = chi2 > limits.sigmas**2 and hypot(east, north) > limits.least_offset_m
    if len(apart_m) < limits.least_pairs or not significant:
        return None
    sigma_m = _mean_sigma_m(cov_m2)
    return _finding(POSITION, hypot(east, north), sigma_m, max(limits.least_offset_m, limits.sigmas * sigma_m))
