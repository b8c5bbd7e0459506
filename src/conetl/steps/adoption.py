"""What an imported map states against the map -> deltas. It adds, confirms and moves; what it leaves out, it says nothing about.

Statement and feature are the same cone where the id is the same, else where a track of a drive would be taken for it
(`changes.py`);
one-to-one. Unlike a drive, an imported map has no common offset that could be told from its own errors: its sigmas must
hold as they are.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from uuid import UUID, uuid5

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from conetl.geometry.packing import vec3
from conetl.params import ReconcileParams
from conetl.records import Delta, DeltaKind, MapFeature, Statement, Track
from conetl.steps.changes import MAX_LOGIT, Floats, confirmed, moved

_NAMESPACE = UUID("c2a5b3a1-6c2f-4f1e-9a53-7c1d2b6f0d44")
_MAX_BELIEF = float(1 / (1 + np.exp(-MAX_LOGIT)))


def adopt(
    statements: Sequence[Statement],
    features: Sequence[MapFeature],
    params: ReconcileParams,
    *,
    at_ns: int,
    founding_key: str,
    known: Collection[UUID] = (),
    pinned: Collection[UUID] = (),
) -> list[Delta]:
    """Deltas of an imported map that speaks for the instant `at_ns`; the order of statements and features does not matter.

    features: those that stand around. A new feature keeps the id of its statement, unless that is `known` already (it stood there
    and is gone, or stands elsewhere): then its id follows from `founding_key` and that id. pinned: features that a person
    holds in place; they may be confirmed.
    """
    statements = sorted(statements, key=lambda statement: statement.feature.feature_id)
    features = sorted(features, key=lambda feature: feature.feature_id)
    pairs = _pair(statements, features, params)
    deltas = []
    for i, statement in enumerate(statements):
        if i not in pairs:
            deltas.append(_added(statement, founding_key, known))
            continue
        feature = features[pairs[i]]
        place = np.array(statement.feature.xyz_m)
        if _is_near(statement.feature, feature, params):
            deltas.append(confirmed(feature, _as_track(statement, at_ns), place, np.zeros(3)))
        elif feature.feature_id not in pinned:
            deltas.append(moved(feature, _as_track(statement, at_ns), place, np.zeros(3)))
    deltas = [delta.model_copy(update={"track_index": None}) for delta in deltas]
    return sorted(deltas, key=lambda delta: (delta.changed_at_ns, str(delta.feature_id)))


def _pair(statements: Sequence[Statement], features: Sequence[MapFeature], params: ReconcileParams) -> dict[int, int]:
    """Statement index -> feature index of those that are the same cone."""
    index_of = {feature.feature_id: j for j, feature in enumerate(features)}
    pairs = {
        i: index_of[statement.feature.feature_id]
        for i, statement in enumerate(statements)
        if statement.feature.feature_id in index_of
    }
    taken = set(pairs.values())
    free = [i for i in range(len(statements)) if i not in pairs]
    others = [j for j in range(len(features)) if j not in taken]
    if not free or not others:
        return pairs
    reach_m = max(params.max_offset_m, params.min_gate_m)
    stated = cKDTree(_places([statements[i].feature for i in free]))
    near = stated.query_ball_tree(cKDTree(_places([features[j] for j in others])), reach_m)
    edges = [
        (row, column)
        for row, columns in enumerate(near)
        for column in sorted(columns)
        if _is_near(statements[free[row]].feature, features[others[column]], params)
    ]
    return pairs | {free[row]: others[column] for row, column in _assign(edges, statements, features, free, others)}


def _assign(
    edges: Sequence[tuple[int, int]],
    statements: Sequence[Statement],
    features: Sequence[MapFeature],
    free: Sequence[int],
    others: Sequence[int],
) -> list[tuple[int, int]]:
    """The edges of least total distance, each end used once; group by group, because a whole map has no small cost matrix."""
    if not edges:
        return []
    rows, columns = np.array(edges).T
    size = len(free) + len(others)
    _, group = connected_components(coo_array((np.ones(len(rows)), (rows, len(free) + columns)), shape=(size, size)))
    by_group: dict[int, list[tuple[int, int]]] = {}
    for edge in edges:
        by_group.setdefault(int(group[edge[0]]), []).append(edge)
    chosen = []
    for members in by_group.values():
        left = sorted({row for row, _ in members})
        right = sorted({column for _, column in members})
        costs = np.full((len(left), len(right)), 1e6)
        for row, column in members:
            shift = _shift_m(statements[free[row]].feature, features[others[column]])
            costs[left.index(row), right.index(column)] = shift
        for a, b in zip(*linear_sum_assignment(costs), strict=True):
            if costs[a, b] < 1e6:
                chosen.append((left[int(a)], right[int(b)]))
    return chosen


def _is_near(stated: MapFeature, feature: MapFeature, params: ReconcileParams) -> bool:
    """Whether the two places may be one, as for tracks of a drive without a known offset (`changes.py`)."""
    distance_m = _shift_m(stated, feature)
    if distance_m <= params.min_gate_m:
        return True
    cov = np.array(stated.cov_m2) + np.array(feature.cov_m2)
    horizontal = np.array([[cov[0], cov[1]], [cov[1], cov[3]]])
    shift = np.subtract(stated.xyz_m[:2], feature.xyz_m[:2])
    chi2 = float(shift @ np.linalg.solve(horizontal, shift))
    return chi2 <= params.gate_chi2 and distance_m <= params.max_offset_m


def _shift_m(stated: MapFeature, feature: MapFeature) -> float:
    return float(np.hypot(stated.xyz_m[0] - feature.xyz_m[0], stated.xyz_m[1] - feature.xyz_m[1]))


def _places(features: Sequence[MapFeature]) -> Floats:
    return np.array([feature.xyz_m[:2] for feature in features])


def _added(statement: Statement, founding_key: str, known: Collection[UUID]) -> Delta:
    feature = statement.feature
    feature_id = feature.feature_id
    if feature_id in known:
        feature_id = uuid5(_NAMESPACE, f"{founding_key}/{feature_id}")
    belief = min(feature.existence_probability, _MAX_BELIEF)
    return Delta(
        kind=DeltaKind.ADDED,
        feature_id=feature_id,
        old=None,
        new=feature.model_copy(update={"feature_id": feature_id, "version": 1, "existence_probability": belief}),
        track_index=None,
        changed_at_ns=statement.valid_from_ns,
        shift_m=None,
    )


def _as_track(statement: Statement, at_ns: int) -> Track:
    """What `confirmed` and `moved` need to know of a sighting; a statement has no positions."""
    feature = statement.feature
    return Track.model_construct(
        track_index=0,
        category=feature.category,
        xyz_m=vec3(np.array(feature.xyz_m)),
        cov_m2=feature.cov_m2,
        relative_cov_m2=feature.cov_m2,
        centre_xyz_m=feature.centre_xyz_m,
        cone_height_m=feature.cone_height_m,
        cone_height_sigma_m=feature.cone_height_sigma_m,
        existence_probability=feature.existence_probability,
        observation_count=feature.observation_count,
        first_seen_ns=at_ns,
        last_seen_ns=feature.last_seen_ns,
        residual_rms_px=0.0,
        nearest_range_m=1.0,
        members=((0, 0),),
    )
