"""Association of the tracks of a drive with features of the map: common offset of the drive, one-to-one pairs, moved cones.

Neighbours are found by k-d trees and assignments are solved per connected group of near pairs, so that the time grows nearly
linearly with the number of cones.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from conetl.geometry.packing import cov_matrices, stack_rows
from conetl.mapping.fusion import difference_cov, expected_covs, mean_jacobians
from conetl.model.arrays import Floats, Ints
from conetl.model.drive import Track
from conetl.model.map_records import MapFeature
from conetl.model.params import ReconcileParams

#: Limits of the search for the common offset: candidate offsets, and tracks on which each is evaluated.
_MAX_CANDIDATES = 200
_MAX_TRACKS = 2000
#: Candidates nearer to each other than this are one.
_CANDIDATE_CELL_M = 0.1
#: Distance of two classes in the search for the common offset; above the size of any map.
_CLASSES_APART_M = 1e8
#: Least variance of a drive and of the map beside the errors that both share, (1 mm)^2: something always differs.
_LEAST_VARIANCE_M2 = 1e-6
#: Cost of a forbidden pair in the assignment; far above any distance.
_FORBIDDEN = 1e6
#: Cost of a pair at the edge of the gate, and of leaving a track and a feature unpaired: chi-square of 3 sigma.
_GATE_COST = 9.0


class Comparison(NamedTuple):
    """The tracks of a drive, or of an imported map, and the features of the map around it."""

    tracks: Sequence[Track]
    features: Sequence[MapFeature]
    map_xyz_m: Floats
    """(T, 3): the tracks in map coordinates."""
    params: ReconcileParams


def common_offset(
    tracks: Sequence[Track], features: Sequence[MapFeature], params: ReconcileParams
) -> tuple[Floats, float]:
    """Offset (3,) of the drive against the map in metres, and the share of it that the drive's own variance explains.

    It minimises the squared distances of all tracks to their nearest features of the same class, each capped at the gate, plus
    the squared offset over its stated variance. The cap limits the influence of new and moved cones; the ends of a row of equally
    spaced cones decide against a shift by one cone. With fewer than two agreeing pairs, or an offset beyond the stated sigmas,
    the result is zero: one moved cone must not shift the drive.
    """
    if len(tracks) < 2 or len(features) < 2:
        return np.zeros(3), 0.0
    drive_var, map_var = _own_variances(tracks, features)
    total_var = drive_var + map_var
    # A larger offset contradicts the stated sigmas: the drive is not corrected by it, but held (`displacement.py`).
    allowed_m = min(params.max_offset_m, params.agreement.sigmas * float(np.sqrt(total_var)))
    found = best_offset(tracks, features, params, allowed_m, total_var)
    return (np.zeros(3), 0.0) if found is None else (found.offset_m, drive_var / total_var)


class Offset(NamedTuple):
    """A common offset of a drive, and the pairs that agree on it."""

    offset_m: Floats
    """(3,) in metres: their median difference."""
    tracks: Ints
    """(K,) indices of those whose nearest feature of their class is within the gate after subtracting it."""
    features: Ints
    """(K,) indices of these features."""


def best_offset(
    tracks: Sequence[Track],
    features: Sequence[MapFeature],
    params: ReconcileParams,
    allowed_m: float,
    variance_m2: float,
) -> Offset | None:
    """The offset of at most `allowed_m` that `common_offset` describes; None with fewer than two agreeing pairs.

    variance_m2: expected, of one axis.
    """
    chosen = np.arange(0, len(tracks), 1 + len(tracks) // _MAX_TRACKS)
    some = [tracks[i] for i in chosen.tolist()]
    t, f = xyz_of(some), xyz_of(features)
    # A third coordinate keeps classes apart.
    apart_m = np.unique(classes_of([*some, *features]), return_inverse=True)[1] * _CLASSES_APART_M
    by_class = np.column_stack((t[:, :2], apart_m[: len(some)]))
    tree = cKDTree(np.column_stack((f[:, :2], apart_m[len(some) :])))
    scale_m = params.min_gate_m / 3

    def cost_of(offset: Floats) -> tuple[float, Ints, Ints]:
        """Cost, and the pairs within the gate."""
        misfits, nearest = (np.asarray(found) for found in tree.query(by_class - (*offset[:2], 0.0)))
        close = np.flatnonzero(misfits <= params.min_gate_m)
        costs = np.minimum((misfits / scale_m) ** 2, _GATE_COST)
        return float(costs.sum() + offset[:2] @ offset[:2] / variance_m2), close, nearest[close]

    best: tuple[float, Floats] | None = None
    for candidate in _candidates(t, f, allowed_m):
        cost, i, _ = cost_of(candidate)
        if len(i) >= 2 and (best is None or cost < best[0]):
            best = cost, candidate
    if best is None:
        return None
    offset_m, i, j = best[1], np.empty(0, np.int64), np.empty(0, np.int64)
    for _ in range(2):  # the median of the pairs; they may change with the offset
        _, i, j = cost_of(offset_m)
        if len(i) < 2:
            return None
        offset_m = np.median(t[i] - f[j], axis=0)
    return Offset(offset_m, chosen[i], j) if float(np.linalg.norm(offset_m[:2])) <= allowed_m else None


def _own_variances(tracks: Sequence[Track], features: Sequence[MapFeature]) -> tuple[float, float]:
    """Mean horizontal variances (m^2, one axis) of a drive and of the map, without what both share: it is in no difference."""
    covs = cov_matrices([track.cov_m2 for track in tracks]), expected_covs(features)
    own = [float(np.trace(cov[:, :2, :2], axis1=1, axis2=2).mean()) / 2 for cov in covs]
    drive, on_map = (mean_jacobians([one.shared_jacobian for one in side]) for side in (tracks, features))
    shared = 0.0
    for key in drive.keys() & on_map.keys():
        width = min(drive[key].shape[1], on_map[key].shape[1])
        shared += float((drive[key][:2, :width] * on_map[key][:2, :width]).sum()) / 2
    return max(own[0] - shared, _LEAST_VARIANCE_M2), max(own[1] - shared, _LEAST_VARIANCE_M2)


def match_unmoved(comparison: Comparison, offset_m: Floats, weight: float) -> dict[int, int]:
    """Feature index -> track index of cones that are still at the same position.

    The map coordinates are corrected by the drive's share `weight` of `offset_m`. Of all one-to-one assignments it is the one of
    least cost: squared distance over that of the gate, `_GATE_COST` for each unpaired track and feature. Leaving two unpaired may
    be cheaper than shifting a whole row by one.
    """
    tracks, features, map_xyz_m, params = comparison
    if not tracks or not features:
        return {}
    # With a known offset only the errors that the drive does not share count; otherwise all do.
    known = weight > 0
    feature_xyz_m = xyz_of(features)
    moved = map_xyz_m - (1 - weight) * offset_m
    j, i = near_pairs(feature_xyz_m[:, :2], moved[:, :2], max(params.min_gate_m, params.max_offset_m))
    if known:
        cov = cov_matrices([track.relative_cov_m2 for track in tracks])[i]
    else:
        cov = difference_cov(
            [tracks[k].cov_m2 for k in i.tolist()], [tracks[k].shared_jacobian for k in i.tolist()],
            [features[k].cov_m2 for k in j.tolist()], [features[k].shared_jacobian for k in j.tolist()],
        )  # fmt: skip
    x, y, z = (moved[i] - feature_xyz_m[j]).T
    xx, xy, yy = cov[:, 0, 0], cov[:, 0, 1], cov[:, 1, 1]
    distance2 = (yy * x * x - 2 * xy * x * y + xx * y * y) / (xx * yy - xy * xy)
    distance = np.hypot(x, y)
    share = np.minimum((distance / params.min_gate_m) ** 2, distance2 / params.gate_chi2)
    allowed = (distance <= params.min_gate_m) | ((distance2 <= params.gate_chi2) & (distance <= params.max_offset_m))
    var_z = np.array([track.cov_m2[5] for track in tracks])[i] + np.array([one.cov_m2[5] for one in features])[j]
    allowed &= classes_of(tracks)[i] == classes_of(features)[j]
    allowed &= np.abs(z) <= np.maximum(params.max_rise_m, np.sqrt(params.gate_chi2 * var_z))
    return assign(j[allowed], i[allowed], _GATE_COST * share[allowed], unpaired_cost=_GATE_COST)


def match_moved(comparison: Comparison, free_tracks: Sequence[int], vanished: Sequence[int]) -> dict[int, int]:
    """Feature index -> track index of moved cones: as many as possible, with the least total distance."""
    if not free_tracks or not vanished:
        return {}
    j, i, distance = _move_candidates(comparison, free_tracks, vanished)
    return assign(j, i, distance)


def match_moved_earlier(comparison: Comparison, observed: Mapping[int, int], vanished: Sequence[int]) -> dict[int, int]:
    """Feature index -> index of the feature that an earlier drive added at the cone's new position, because only that was visible
    to it.

    Like `match_moved`, among the `observed` features (feature -> track index) that were added after the vanished one was last
    observed; features observed at the same time are two cones.
    """
    features = comparison.features
    since_ns = min((features[j].last_seen_ns for j in vanished), default=0)
    feature_of = {i: k for k, i in observed.items() if features[k].first_seen_ns > since_ns}
    if not feature_of or not vanished:
        return {}
    j, i, distance = _move_candidates(comparison, sorted(feature_of), vanished)
    founded_ns = np.array([features[feature_of[track]].first_seen_ns for track in i.tolist()], np.int64)
    last_seen_ns = np.array([features[row].last_seen_ns for row in j.tolist()], np.int64)
    since = founded_ns > last_seen_ns
    return {row: feature_of[track] for row, track in assign(j[since], i[since], distance[since]).items()}


def _move_candidates(
    comparison: Comparison, of_tracks: Sequence[int], of_features: Sequence[int]
) -> tuple[Ints, Ints, Floats]:
    """Feature and track indices, and distances in metres, of all pairs that may be one moved cone."""
    tracks, features, map_xyz_m, params = comparison
    rows, columns = np.array(of_features), np.array(of_tracks)
    feature_xyz_m = np.array([features[j].xyz_m for j in of_features])
    j, i = near_pairs(feature_xyz_m[:, :2], map_xyz_m[columns, :2], params.moved_max_m)
    distance = np.hypot(*(map_xyz_m[columns[i], :2] - feature_xyz_m[j, :2]).T)
    heights = np.array([features[k].object_height_m for k in of_features])[j]
    alike = np.abs(np.array([tracks[k].object_height_m for k in of_tracks])[i] - heights)
    allowed = (alike <= params.moved_height_tolerance_m) & (distance <= params.moved_max_m)
    allowed &= classes_of([tracks[k] for k in of_tracks])[i] == classes_of([features[k] for k in of_features])[j]
    return rows[j[allowed]], columns[i[allowed]], distance[allowed]


def xyz_of(objects: Sequence[Track | MapFeature]) -> Floats:
    """(N, 3) positions in metres."""
    return stack_rows([one.xyz_m for one in objects], 3)


def classes_of(objects: Sequence[Track | MapFeature]) -> NDArray[np.str_]:
    """(N,) categories."""
    return np.array([one.category for one in objects])


def _candidates(t: Floats, f: Floats, allowed_m: float) -> Floats:
    """(P, 3) candidate offsets, one per cell: differences of a track and a feature, most frequent first, then shortest."""
    j, i = near_pairs(f[:, :2], t[:, :2], allowed_m)
    differences = t[i] - f[j]
    if len(differences) == 0:
        return differences
    cells = np.floor(differences[:, :2] / _CANDIDATE_CELL_M).astype(np.int64)
    _, inverse, counts = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    inverse = inverse.ravel()
    lengths = np.hypot(differences[:, 0], differences[:, 1])
    shortest_first = np.lexsort((lengths, inverse))
    first = shortest_first[np.searchsorted(inverse[shortest_first], np.arange(len(counts)))]
    order = np.lexsort((lengths[first], -counts))[:_MAX_CANDIDATES]
    return differences[first[order]]


def near_pairs(a_m: Floats, b_m: Floats, reach_m: float) -> tuple[Ints, Ints]:
    """Indices into a_m (N, D) and b_m (M, D), metres, of all pairs at most `reach_m` apart, ordered by index of `a`, then `b`."""
    if not len(a_m) or not len(b_m):
        return np.empty(0, np.int64), np.empty(0, np.int64)
    # Slightly farther, so that rounding in the tree loses no pair exactly at the reach: callers gate themselves.
    found = cKDTree(a_m).sparse_distance_matrix(cKDTree(b_m), reach_m * (1 + 1e-9), output_type="ndarray")
    order = np.lexsort((found["j"], found["i"]))
    return found["i"][order], found["j"][order]


def assign(rows: Ints, columns: Ints, costs: Floats, *, unpaired_cost: float | None = None) -> dict[int, int]:
    """Row -> column of the one-to-one assignment with most pairs and, among those, the least total cost.

    rows, columns, costs (K,): the allowed pairs, each once. unpaired_cost: cost of an unpaired row and column, above all costs;
    with it the total cost decides, not the number of pairs.
    """
    if not len(rows):
        return {}
    row_ids, r = np.unique(rows, return_inverse=True)
    column_ids, c = np.unique(columns, return_inverse=True)
    single = (np.bincount(r)[r] == 1) & (np.bincount(c)[c] == 1)
    pairs = dict(zip(rows[single].tolist(), columns[single].tolist(), strict=True))
    r, c, costs = r[~single], c[~single], costs[~single]
    size = len(row_ids) + len(column_ids)
    graph = coo_array((np.ones(len(r), bool), (r, len(row_ids) + c)), shape=(size, size))
    group = connected_components(graph, directed=False)[1][r]
    order = np.argsort(group, kind="stable")
    for members in np.split(order, np.flatnonzero(np.diff(group[order])) + 1) if len(order) else ():
        rr, i = np.unique(r[members], return_inverse=True)
        cc, j = np.unique(c[members], return_inverse=True)
        forbidden = _FORBIDDEN if unpaired_cost is None else unpaired_cost
        matrix = np.full((len(rr), len(cc)), forbidden)
        matrix[i, j] = np.minimum(costs[members], forbidden)
        for k, m in zip(*linear_sum_assignment(matrix), strict=True):
            if matrix[k, m] < forbidden:
                pairs[int(row_ids[rr[k]])] = int(column_ids[cc[m]])
    return pairs
