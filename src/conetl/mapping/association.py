"""Which track of a drive is which feature of the map: the drive's common offset, then one-to-one pairs, then cones that moved.

Everything works on neighbours found by a k-d tree, so that drives with thousands of cones take seconds, not hours.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from conetl.mapping.gating import Indices, assign, near_pairs
from conetl.model.map_records import MapFeature
from conetl.model.params import ReconcileParams
from conetl.model.records import Cov3, Track

Floats = NDArray[np.float64]
#: Offsets that are tried; cones that share one propose nearly the same.
_MAX_PROPOSALS = 200
#: Tracks that an offset is tried on: every so many of a longer drive's.
_MAX_TRACKS = 2000
#: Proposals nearer together than this are one.
_PROPOSAL_CELL_M = 0.1
#: Cost of a pair at the edge of the gate, and of leaving a track and a feature unpaired: a chi-square of 3 sigma.
_GATE_COST = 9.0


def common_offset(
    tracks: Sequence[Track], features: Sequence[MapFeature], params: ReconcileParams
) -> tuple[Floats, float]:
    """Offset (3,) of the drive against the map in metres, and the share of it that is the drive's fault.

    The most probable one: squared misfits of all tracks to their nearest features, each at most that of the gate's edge (a cone
    that is new or was moved counts no more), plus the squared offset over its stated variance. So a chain of equal distances,
    which fits onto itself when it is shifted by one, is shifted only where its ends say so. Fewer than two agreeing pairs, or an
    offset beyond what the stated sigmas allow, give zero: one cone that was moved must not drag the drive along.
    """
    zero = np.zeros(3)
    if len(tracks) < 2 or len(features) < 2:
        return zero, 0.0
    t = np.array([track.xyz_m for track in tracks[:: 1 + len(tracks) // _MAX_TRACKS]])
    f = np.array([feature.xyz_m for feature in features])
    drive_var = float(np.mean([track.cov_m2[0] + track.cov_m2[3] for track in tracks])) / 2
    map_var = float(np.mean([feature.cov_m2[0] + feature.cov_m2[3] for feature in features])) / 2
    total_var = drive_var + map_var
    allowed_m = min(params.max_offset_m, 4 * float(np.sqrt(total_var)))
    tree = cKDTree(f[:, :2])
    scale_m = params.min_gate_m / 3

    def cost_of(offset: Floats) -> tuple[float, Floats]:
        """Cost, and the differences (K, 3) of the pairs within the gate."""
        misfits, nearest = (np.asarray(found) for found in tree.query(t[:, :2] - offset[:2]))
        close = misfits <= params.min_gate_m
        costs = np.minimum((misfits / scale_m) ** 2, _GATE_COST)
        return float(costs.sum() + offset[:2] @ offset[:2] / total_var), t[close] - f[nearest[close]]

    best: tuple[float, Floats] | None = None
    for proposal in _proposals(t, f, allowed_m):
        cost, agreeing = cost_of(proposal)
        if len(agreeing) >= 2 and (best is None or cost < best[0]):
            best = cost, proposal
    if best is None:
        return zero, 0.0
    offset_m = best[1]
    for _ in range(2):  # onto the middle of its pairs, which may change the pairs
        _, agreeing = cost_of(offset_m)
        if len(agreeing) < 2:
            return zero, 0.0
        offset_m = np.median(agreeing, axis=0)
    if float(np.linalg.norm(offset_m[:2])) > allowed_m:
        return zero, 0.0
    return offset_m, drive_var / total_var


def pair(
    placed: Floats,
    tracks: Sequence[Track],
    features: Sequence[MapFeature],
    offset_m: Floats,
    weight: float,
    params: ReconcileParams,
) -> dict[int, int]:
    """Feature index -> track index of those that are the same cone in the same place.

    placed (T, 3): the tracks in map coordinates, the drive's share `weight` of `offset_m` taken out. Of all one-to-one
    assignments the one of least cost: squared distance over the gate's, `_GATE_COST` for a track and a feature that stay alone.
    Leaving two alone may thus be cheaper than moving a whole chain up by one.
    """
    if not tracks or not features:
        return {}
    # With the offset known only what is not common to the drive is uncertain; without it, everything is.
    known = weight > 0
    places = np.array([feature.xyz_m for feature in features])
    moved = placed - (1 - weight) * offset_m
    j, i = near_pairs(places[:, :2], moved[:, :2], max(params.min_gate_m, params.max_offset_m))
    cov = _horizontal([track.relative_cov_m2 if known else track.cov_m2 for track in tracks])[i]
    if not known:
        cov = cov + _horizontal([feature.cov_m2 for feature in features])[j]
    x, y = (moved[i, :2] - places[j, :2]).T
    xx, xy, yy = cov.T
    distance2 = (yy * x * x - 2 * xy * x * y + xx * y * y) / (xx * yy - xy * xy)
    distance = np.hypot(x, y)
    share = np.minimum((distance / params.min_gate_m) ** 2, distance2 / params.gate_chi2)
    allowed = (distance <= params.min_gate_m) | ((distance2 <= params.gate_chi2) & (distance <= params.max_offset_m))
    return assign(j[allowed], i[allowed], _GATE_COST * share[allowed], alone_cost=_GATE_COST)


def moves(
    placed: Floats,
    tracks: Sequence[Track],
    free_tracks: Sequence[int],
    features: Sequence[MapFeature],
    vanished: Sequence[int],
    params: ReconcileParams,
) -> dict[int, int]:
    """Feature index -> track index of cones that were moved: as many as can be, over the shortest ways."""
    if not free_tracks or not vanished:
        return {}
    j, i, distance = _alike_nearby(placed, tracks, free_tracks, features, vanished, params)
    return assign(j, i, distance)


def moved_before(
    placed: Floats,
    tracks: Sequence[Track],
    seen: Mapping[int, int],
    features: Sequence[MapFeature],
    vanished: Sequence[int],
    params: ReconcileParams,
) -> dict[int, int]:
    """Feature index -> index of the feature that it was moved to: an earlier drive had only the new place in view and founded it.

    As `moves`, among the features that are `seen` now (feature -> track index) and were founded after the vanished one was last
    seen: had both ever been seen to stand, they would be two cones.
    """
    since_ns = min((features[j].last_seen_ns for j in vanished), default=0)
    feature_of = {i: k for k, i in seen.items() if features[k].first_seen_ns > since_ns}
    if not feature_of or not vanished:
        return {}
    j, i, distance = _alike_nearby(placed, tracks, sorted(feature_of), features, vanished, params)
    founded_ns = np.array([features[feature_of[track]].first_seen_ns for track in i.tolist()], np.int64)
    last_seen_ns = np.array([features[row].last_seen_ns for row in j.tolist()], np.int64)
    since = founded_ns > last_seen_ns
    return {row: feature_of[track] for row, track in assign(j[since], i[since], distance[since]).items()}


def _alike_nearby(
    placed: Floats,
    tracks: Sequence[Track],
    of_tracks: Sequence[int],
    features: Sequence[MapFeature],
    of_features: Sequence[int],
    params: ReconcileParams,
) -> tuple[Indices, Indices, Floats]:
    """Feature and track indices, and distances in metres, of all pairs between which a cone may have been moved."""
    rows, columns = np.array(of_features), np.array(of_tracks)
    places = np.array([features[j].xyz_m for j in of_features])
    j, i = near_pairs(places[:, :2], placed[columns, :2], params.moved_max_m)
    distance = np.hypot(*(placed[columns[i], :2] - places[j, :2]).T)
    heights = np.array([features[k].cone_height_m for k in of_features])[j]
    alike = np.abs(np.array([tracks[k].cone_height_m for k in of_tracks])[i] - heights)
    allowed = (alike <= params.moved_height_tolerance_m) & (distance <= params.moved_max_m)
    return rows[j[allowed]], columns[i[allowed]], distance[allowed]


def _proposals(t: Floats, f: Floats, allowed_m: float) -> Floats:
    """(P, 3) offsets that some track and feature propose, one a cell, those of most pairs first, then the shortest."""
    j, i = near_pairs(f[:, :2], t[:, :2], allowed_m)
    differences = t[i] - f[j]
    if len(differences) == 0:
        return differences
    cells = np.floor(differences[:, :2] / _PROPOSAL_CELL_M).astype(np.int64)
    _, inverse, counts = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    inverse = inverse.ravel()
    lengths = np.hypot(differences[:, 0], differences[:, 1])
    shortest_first = np.lexsort((lengths, inverse))
    first = shortest_first[np.searchsorted(inverse[shortest_first], np.arange(len(counts)))]
    order = np.lexsort((lengths[first], -counts))[:_MAX_PROPOSALS]
    return differences[first[order]]


def _horizontal(covariances: Sequence[Cov3]) -> Floats:
    """(N, 3): xx, xy, yy of each covariance."""
    return np.array(covariances)[:, [0, 1, 3]]
