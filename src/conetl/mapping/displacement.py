"""Checks whether the objects of a drive, of a part of it or of an imported map are displaced against those of the map, in plan or
height, or are of other classes.

Objects are compared at their positions, and by their arrangement, which can match elsewhere if all positions are wrong.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from math import hypot
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from conetl.geometry.packing import cov_matrices
from conetl.mapping.association import assign, classes_of, common_offset, near_pairs, xyz_of
from conetl.mapping.fusion import difference_cov
from conetl.model.arrays import Floats, Ints
from conetl.model.drive import Track
from conetl.model.health import AGREEMENT, Finding
from conetl.model.map_records import Delta, DeltaKind, MapFeature
from conetl.model.params import AgreementParams, ReconcileParams

#: Positions (N, 3) and classes (N,) of tracks or features.
_Located = tuple[Floats, NDArray[np.str_]]
POSITION, HEIGHTS = f"{AGREEMENT}: position", f"{AGREEMENT}: heights"
#: Two tracks that are tried are at most this far from each other.
_LONGEST_BASE_M = 60.0
#: A merge compares everything on the map within this distance.
_NEAR_M = 50.0
#: A fit is distinct if no other one, this many gates apart, fits this share as many; else some of the map's cones must be absent.
_APART_GATES, _RIVAL_SHARE, _LEAST_ABSENT_SHARE = 2.0, 0.8, 0.25
#: Limits of that search: tracks that it uses, tracks from which it starts, and how far two lengths may differ.
_MAX_TRACKS, _STARTS, _LENGTH_TOLERANCE_M = 200, 10, 0.3
_MAX_NEAR, _MAX_TRIED = 150, 300


def check_positions(
    tracks: Sequence[Track], features: Sequence[MapFeature], kinds: Counter[DeltaKind], params: ReconcileParams
) -> Finding | None:
    """Whether the drive's cones have a common displacement against the map's that exceeds the stated sigmas."""
    limits, on_drive, on_map = params.agreement, _located(tracks), _located(features)
    t, f = on_drive[0], on_map[0]
    covs = cov_matrices([track.cov_m2 for track in tracks]), cov_matrices([feature.cov_m2 for feature in features])
    near = np.flatnonzero(cKDTree(f[:, :2]).query(t[:, :2])[0] <= limits.max_displacement_m)
    # GNSS without a fix is metres off, as its sigmas state: only the heights are compared after its offset is taken out.
    offset_m = np.array([*common_offset(tracks, features, params)[0][:2], 0.0])
    for shift_m, compared in ((np.zeros(3), (1.0, 1.0, 1.0)), (offset_m, (0.0, 0.0, 1.0))):
        pairs = _same_positions(on_drive, on_map, shift_m, params)
        if pairs and 2 * len(pairs) >= len(near):
            i, j = list(pairs), list(pairs.values())
            common = _common_displacement((t[i] - f[j]) * compared, _mean_cov(tracks, features, pairs), limits)
            if common is not None:
                return common
    some = near[:: 1 + len(near) // _MAX_TRACKS]
    share = len(some) / max(len(near), 1)
    found = share * (kinds[DeltaKind.CONFIRMED] + kinds[DeltaKind.HEIGHT_CHANGED])
    least = max(limits.least_agreeing, limits.least_share * len(some), 2 * found + 1)
    fit = None
    if least <= len(some):
        fit = _best_fit(
            t[some, :2], f[:, :2], params.min_gate_m, limits.max_displacement_m, np.radians(limits.max_turn_deg)
        )
    if fit is None or fit.agreeing < least:
        return None
    absent = share * (kinds[DeltaKind.REMOVED] + kinds[DeltaKind.MISSED] + kinds[DeltaKind.MOVED])
    same_zone = fit.distinct and (fit.beside or fit.residual_m <= limits.same_zone_m)
    if not same_zone and absent < _LEAST_ABSENT_SHARE * fit.agreeing:
        return None  # the drive may see a continuation of the map's row, or a second row beside it
    sigma_m = _mean_sigma_m(covs[0].mean(axis=0) + covs[1].mean(axis=0))
    allowed_m = limits.sigmas * sigma_m
    if fit.largest_m <= min(params.max_offset_m, allowed_m):
        return None
    if fit.largest_m <= allowed_m:
        return _finding(POSITION, fit.middle_m, sigma_m, params.max_offset_m, "too far")
    return _position(fit, sigma_m, min(params.max_offset_m, allowed_m), 0.1)


def check_same_cones(
    stated: Sequence[Track | MapFeature],
    features: Sequence[Track | MapFeature],
    params: ReconcileParams,
    within_m: float | None = None,
) -> Finding | None:
    """Whether cones that are stated again, by an imported map or a second pass, have a common displacement beyond their sigmas.

    Cones at equal distances also fit a row farther along, or the same plan elsewhere: only an irregular arrangement that fits
    once, to within the difference of two surveys of the same cones, counts as the same cones. within_m: how far away they may
    be; default: `elsewhere_m`.
    """
    if not stated or not features:
        return None
    t, f = xyz_of(stated), xyz_of(features)
    pairs = _same_positions(_located(stated), _located(features), np.zeros(3), params)
    within_m = within_m or params.agreement.elsewhere_m
    if pairs:
        i, j = list(pairs), list(pairs.values())
        # If most have no cone near them, the rest match neighbours by chance: only heights are compared.
        compared = (1.0, 1.0, 1.0) if 2 * len(pairs) >= len(_near(t, f, params)) else (0.0, 0.0, 1.0)
        common = _common_displacement((t[i] - f[j]) * compared, _mean_cov(stated, features, pairs), params.agreement)
        if common is not None:
            return common
    return _match_arrangement(stated, features, len(pairs), params, params.agreement.least_same, within_m)


def check_far_positions(
    tracks: Sequence[Track], features: Sequence[MapFeature], params: ReconcileParams
) -> Finding | None:
    """Whether a drive's cones have a common displacement that is too large for `check_agreement`.

    features: the map's point objects within `elsewhere_m` of the tracks. A merge compares only what a drive may have in view, so
    this is checked once, when the drive is ingested.
    """
    sure = [track for track in tracks if track.existence_probability >= params.founding_existence_probability]
    if (check := _check_other_section(sure, features, params)) is not None:
        return check.model_copy(update={"check": "heights of another section"})
    check = check_arrangement(sure, features, params)
    if check is None or check.value is None or check.value <= _NEAR_M:
        return None
    return check.model_copy(update={"check": "the same cones elsewhere"})


def _check_other_section(
    tracks: Sequence[Track], features: Sequence[MapFeature], params: ReconcileParams
) -> Finding | None:
    """The height difference of a drive's cones against the map's nearest ones, if it proves another section of the road."""
    if not tracks or not features:
        return None
    t, f = xyz_of(tracks), xyz_of(features)
    apart_m, nearest = cKDTree(f[:, :2]).query(t[:, :2])
    near = apart_m <= params.agreement.beside_m
    up_m = (t[:, 2] - f[nearest, 2])[near]
    if not up_m.size or np.abs(up_m).min() < params.agreement.cliff_m:
        return None
    covs = cov_matrices([track.cov_m2 for track in tracks]), cov_matrices([feature.cov_m2 for feature in features])
    sigma_m = float(np.sqrt((covs[0] + covs[1][nearest])[near, 2, 2].max()))
    return check_heights(float(np.median(up_m)), sigma_m, len(up_m), params.agreement, those="the nearest ones")


def check_arrangement(
    tracks: Sequence[Track], features: Sequence[MapFeature], params: ReconcileParams
) -> Finding | None:
    """Whether the arrangement of enough cones matches the map elsewhere, even along a row from which no cone is missing."""
    if len(tracks) < params.agreement.least_same_of_drive or not features:
        return None
    found = len(_same_positions(_located(tracks), _located(features), np.zeros(3), params))
    match = partial(_match_arrangement, tracks, features, found, params, params.agreement.least_same_of_drive)
    within_m = params.agreement.elsewhere_m
    return match(within_m) or match(within_m, max_turn_deg=180.0)  # the direction of a local frame is typed by people


def check_parts(tracks: Sequence[Track], features: Sequence[MapFeature], params: ReconcileParams) -> Finding | None:
    """Whether the arrangement of a part of the drive matches the map elsewhere. No cone was observed both before and in it.

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
    within_m = params.agreement.max_displacement_m if len(parts) > 1 else params.agreement.lever_m
    for part in parts if features else ():
        found = len(_same_positions(_located(part), _located(features), np.zeros(3), params))
        check = _match_arrangement(
            part, features, found, params, params.agreement.least_pairs, within_m, params.agreement.part_turn_deg
        )
        if check is not None:
            return _of_part(check, len(part)) if len(parts) > 1 else check
    return None


def check_part(deltas: Sequence[Delta], params: ReconcileParams) -> Finding | None:
    """Whether the cones that a drive moves, or misses and adds elsewhere, have one common displacement.

    GNSS may get another fix while the vehicle waits, and no images show the jump. People do not move cones by equal distances.
    """
    check, count = _equal_moves(deltas, params.agreement)
    if check is None:
        came = _by_position(d.new for d in deltas if d.kind in (DeltaKind.ADDED, DeltaKind.MOVED))
        gone = _by_position(d.old for d in deltas if d.kind in (DeltaKind.MOVED, DeltaKind.REMOVED, DeltaKind.MISSED))
        count = len(came)
        within_m, least = params.agreement.elsewhere_m, params.agreement.least_agreeing
        check = _match_arrangement(came, gone, 0, params, least, within_m) if came and gone else None
    if check is None:
        return None
    return _of_part(check, count)


def _of_part(check: Finding, count: int) -> Finding:
    return check.saying(*check.says, "part", count=count)


def _equal_moves(deltas: Sequence[Delta], limits: AgreementParams) -> tuple[Finding | None, int]:
    """The displacement that most of the moved cones have in common, and how many have it."""
    moved = [(d.old, d.new) for d in deltas if d.kind is DeltaKind.MOVED and d.old and d.new]
    if len(moved) < limits.least_pairs:
        return None, 0
    old, new = zip(*sorted(moved, key=lambda pair: (pair[0].xyz_m, pair[1].xyz_m)), strict=True)
    apart_m = (xyz_of(new) - xyz_of(old)) * (1.0, 1.0, 0.0)
    near = np.linalg.norm(apart_m[:, None] - apart_m, axis=2) <= 2 * limits.same_zone_m
    alike = near[near.sum(axis=1).argmax()]
    if np.hypot(*apart_m[alike, :2].std(axis=0)) > limits.same_zone_m:
        return None, 0
    cov_m2 = 2 * cov_matrices([one.cov_m2 for one in (*old, *new)]).mean(axis=0)
    return _common_displacement(apart_m[alike], cov_m2, limits), int(alike.sum())


def _by_position(features: Iterable[MapFeature | None]) -> list[MapFeature]:
    return sorted((feature for feature in features if feature), key=lambda feature: feature.xyz_m)


def check_classes(tracks: Sequence[Track], features: Sequence[MapFeature], params: ReconcileParams) -> Finding | None:
    """Whether most of the objects at positions of map objects are of another class."""
    t, f = _located(tracks), _located(features)
    same = _same_positions(t, f, np.zeros(3), params)
    others = np.setdiff1d(np.arange(len(t[0])), list(same)), np.setdiff1d(np.arange(len(f[0])), list(same.values()))
    rows, columns = near_pairs(t[0][others[0], :2], f[0][others[1], :2], params.min_gate_m)
    pairs = assign(rows, columns, np.hypot(*(t[0][others[0][rows]] - f[0][others[1][columns]])[:, :2].T))
    if len(pairs) < params.agreement.least_pairs or len(pairs) <= len(same):
        return None
    changes = Counter((f[1][others[1][j]], t[1][others[0][i]]) for i, j in pairs.items())
    (was, now), _ = max(changes.items(), key=lambda item: (item[1], item[0]))
    facts = {"objects": len(pairs) + len(same), "others": len(pairs), "now": str(now), "was": str(was)}
    limit = max(len(same), params.agreement.least_pairs - 1)
    return Finding(check=f"{AGREEMENT}: classes", value=len(pairs), limit=limit, found=True, facts=facts)


def _near(t: Floats, f: Floats, params: ReconcileParams) -> Ints:
    """Indices of the cones t (N, 3) that have one of f (M, 3) within `elsewhere_m`."""
    return np.flatnonzero(cKDTree(f[:, :2]).query(t[:, :2])[0] <= params.agreement.elsewhere_m)


def _match_arrangement(
    cones: Sequence[Track | MapFeature],
    features: Sequence[Track | MapFeature],
    found: int,
    params: ReconcileParams,
    least_same: int,
    within_m: float,
    max_turn_deg: float | None = None,
) -> Finding | None:
    """Whether the cones are displaced against cones of the map in the same arrangement.

    found: how many stand at a cone of the map; twice as many must fit elsewhere, and at least least_same. within_m, max_turn_deg:
    largest displacement and rotation; default: `AgreementParams.max_turn_deg`.
    """
    t, f = xyz_of(cones), xyz_of(features)
    near, limits = _near(t, f, params), params.agreement
    most_deg = limits.max_turn_deg if max_turn_deg is None else max_turn_deg
    some = near[:: 1 + len(near) // _MAX_TRACKS]
    found_of_some = found * len(some) / max(len(near), 1)
    least = max(least_same, limits.least_share * len(some), 2 * found_of_some + 1)
    if least > len(some):
        return None
    spacing_m = np.asarray(cKDTree(t[near, :2]).query(t[some, :2], 2)[0])[:, 1]
    if spacing_m.std() < 2 * limits.same_zone_m:
        return None
    fit = _best_fit(t[some, :2], f[:, :2], 2 * limits.same_zone_m, within_m, np.radians(most_deg))
    if fit is None or fit.agreeing < least or not fit.distinct or fit.residual_m > limits.same_zone_m:
        return None
    covs = cov_matrices([one.cov_m2 for one in cones]), cov_matrices([one.cov_m2 for one in features])
    sigma_m = _mean_sigma_m(covs[0].mean(axis=0) + covs[1].mean(axis=0))
    limit_m = min(params.max_offset_m, limits.sigmas * sigma_m)
    return _position(fit, sigma_m, limit_m, limits.max_turn_deg) if fit.largest_m > limit_m else None


def _located(objects: Sequence[Track | MapFeature]) -> _Located:
    return xyz_of(objects), classes_of(objects)


def _same_positions(tracks: _Located, features: _Located, shift_m: Floats, params: ReconcileParams) -> dict[int, int]:
    """Track -> feature of the same class at its position, after moving tracks back by `shift_m` (3,); heights are ignored."""
    (t, t_classes), (f, f_classes) = tracks, features
    rows, columns = near_pairs((t - shift_m)[:, :2], f[:, :2], params.min_gate_m)
    alike = t_classes[rows] == f_classes[columns]  # a sign may hang above a cone
    rows, columns = rows[alike], columns[alike]
    return assign(rows, columns, np.hypot(*(t[rows] - shift_m - f[columns])[:, :2].T))


def _finding(check: str, value: float, sigma: float, limit: float, says: str = "") -> Finding:
    return Finding(check=check, value=float(value), sigma=float(sigma), limit=float(limit), found=True, says=(says,))


def _mean_sigma_m(cov_m2: Floats) -> float:
    """Mean horizontal sigma of a (3, 3) covariance."""
    return float(np.sqrt(np.trace(cov_m2[:2, :2]) / 2))


def _mean_cov(t: Sequence[Track | MapFeature], f: Sequence[Track | MapFeature], pairs: Mapping[int, int]) -> Floats:
    """Mean covariance (3, 3) m^2 of the differences of pairs, t -> f, without the errors that both share; of some pairs."""
    chosen = sorted(pairs.items())[:: 1 + len(pairs) // _MAX_TRACKS]
    some, others = [t[i] for i, _ in chosen], [f[j] for _, j in chosen]
    covs = difference_cov(
        [one.cov_m2 for one in some], [one.shared_jacobian for one in some],
        [one.cov_m2 for one in others], [one.shared_jacobian for one in others],
    )  # fmt: skip
    return np.asarray(covs.mean(axis=0))


def _common_displacement(apart_m: Floats, cov_m2: Floats, limits: AgreementParams) -> Finding | None:
    """The median displacement, if it is significant. apart_m (K, 3): tracks minus their features; cov_m2 (3, 3): of one
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


def _position(fit: _Fit, sigma_m: float, limit_m: float, least_turn_deg: float) -> Finding:
    """A displacement of the whole arrangement; rotations from `least_turn_deg` on are named."""
    turn_deg = float(np.degrees(fit.turn))
    says = "turned" if abs(turn_deg) >= least_turn_deg else ""
    return _finding(POSITION, fit.middle_m, sigma_m, limit_m).saying(says, turn_deg=turn_deg)


class _Fit(NamedTuple):
    """A displacement of a whole drive after which its cones fit the map's."""

    agreeing: int
    residual_m: float
    """Root mean square distance of the tracks that fit to their features, after the displacement."""
    middle_m: float
    """Median and largest displacement of the tracks."""
    largest_m: float
    turn: float
    """Radians, counter-clockwise."""
    beside: bool
    """Whether the displaced row still lies along at least half of its length beside where it was."""
    distinct: bool
    """Whether no other displacement fits nearly as well, as along a row of equal distances."""


def _best_fit(t: Floats, f: Floats, gate_m: float, within_m: float, max_turn: float) -> _Fit | None:
    """The displacement with which most tracks fit, of all that put two tracks onto two features; of several the smallest.

    t (N, 2), f (M, 2): tracks and features; gate_m: of a fit; within_m, max_turn: largest displacement (m) and rotation (rad).
    Two tracks far from each other are tried with all features at their distance.
    """
    along = np.linalg.svd(t - t.mean(axis=0), full_matrices=False)[2][0]
    extent_m = float(np.ptp(t @ along))
    tree = cKDTree(f)
    tried: list[tuple[int, float, Floats, Floats, float]] = []
    for i in range(0, len(t), 1 + len(t) // _STARTS):
        lengths = np.hypot(*(t - t[i]).T)
        j = int(np.argmax(np.where(lengths <= _LONGEST_BASE_M, lengths, 0.0)))
        first, second = (np.array(tree.query_ball_point(t[k], within_m, return_sorted=True), np.intp) for k in (i, j))
        first, second = (near[:: 1 + len(near) // _MAX_NEAR] for near in (first, second))
        a, b = (grid.ravel() for grid in np.meshgrid(first, second))
        base, others = t[j] - t[i], f[b] - f[a]
        turns = np.arctan2(others[:, 1], others[:, 0]) - np.arctan2(base[1], base[0])
        turns = (turns + np.pi) % (2 * np.pi) - np.pi
        alike = np.abs(np.hypot(*others.T) - lengths[j]) <= _LENGTH_TOLERANCE_M
        candidates = np.flatnonzero(alike & (np.abs(turns) <= max_turn) & (lengths[j] > 0))
        for k in candidates[:: 1 + len(candidates) // _MAX_TRIED]:
            rotation = Rotation.from_rotvec((0, 0, turns[k])).as_matrix()[:2, :2]
            placed = (t - t[i]) @ rotation.T + f[a[k]]
            agreeing = int(np.count_nonzero(tree.query(placed)[0] <= gate_m))
            moved = placed - t
            tried.append((agreeing, -float(np.hypot(*moved.T).mean()), moved.mean(axis=0), moved, float(-turns[k])))
    if not tried:
        return None
    agreeing, _, mean, moved, turn = max(tried, key=lambda one: one[:2])
    moved_m = np.hypot(*moved.T)
    rivals = (other for other in tried if other[0] >= _RIVAL_SHARE * agreeing)
    distinct = not any(float(np.hypot(*(other[2] - mean))) > _APART_GATES * gate_m for other in rivals)
    beside = abs(float(np.median(moved @ along))) <= extent_m / 2
    left_m = np.asarray(tree.query(t + moved)[0])
    residual_m = float(np.sqrt(np.mean(left_m[left_m <= gate_m] ** 2)))
    return _Fit(agreeing, residual_m, float(np.median(moved_m)), float(moved_m.max()), turn, beside, distinct)
