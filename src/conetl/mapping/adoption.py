"""What an imported map states against the map -> deltas. It adds, confirms, moves and changes heights; what it leaves out, it
says nothing about.

Statement and feature are the same cone where the id is the same, else where a track of a drive would be taken for it
(`map_association.py`); one-to-one. Unlike a drive, an imported map has no common offset that could be told from its own errors:
its sigmas must hold as they are. What it says of a cone's existence adds up with what drives saw and missed (`belief.py`).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from uuid import UUID, uuid5

import numpy as np

from conetl.mapping.association import pair
from conetl.mapping.changes import height_differs
from conetl.mapping.existence_update import stated
from conetl.mapping.feature_states import changed, confirmations
from conetl.model.map_records import Delta, DeltaKind, Doubt, MapFeature, Statement
from conetl.model.params import ReconcileParams
from conetl.model.records import Track

_NAMESPACE = UUID("c2a5b3a1-6c2f-4f1e-9a53-7c1d2b6f0d44")
_NO_OFFSET_M = np.zeros(3)


def adopt(
    statements: Sequence[Statement],
    features: Sequence[MapFeature],
    params: ReconcileParams,
    *,
    at_ns: int,
    founding_key: str,
    known: Collection[UUID] = (),
    pinned: Collection[UUID] = (),
    doubts: Mapping[UUID, Doubt] | None = None,
) -> list[Delta]:
    """Deltas of an imported map that speaks for the instant `at_ns`; the order of statements and features does not matter.

    features: those that stand around. A new feature keeps the id of its statement, unless that is `known` already (it stood there
    and is gone, or stands elsewhere): then its id follows from `founding_key` and that id. pinned: features that a person
    holds in place; they may be confirmed. doubts: of features that drives missed since their version.
    """
    doubts = doubts or {}
    statements = sorted(statements, key=lambda statement: statement.feature.feature_id)
    features = sorted(features, key=lambda feature: feature.feature_id)
    tracks = [_as_track(statement, at_ns) for statement in statements]
    placed = np.array([track.xyz_m for track in tracks]).reshape(-1, 3)
    pairs = _pair(tracks, statements, features, params)
    evidence = {
        j: stated(features[j], doubts.get(features[j].feature_id), statements[i]) for j, i in sorted(pairs.items())
    }
    kinds: dict[int, DeltaKind | None] = {}
    for j, i in sorted(pairs.items()):
        held, near = features[j].feature_id in pinned, _is_near(statements[i].feature, features[j], params)
        if not near:
            kinds[j] = None if held else DeltaKind.MOVED
        else:
            other = not held and height_differs(features[j], tracks[i], params)
            kinds[j] = DeltaKind.HEIGHT_CHANGED if other else DeltaKind.CONFIRMED
    confirmed = {j: pairs[j] for j, kind in kinds.items() if kind is DeltaKind.CONFIRMED}
    deltas = confirmations(confirmed, features, tracks, evidence)
    for j, kind in kinds.items():
        if kind is not None and kind is not DeltaKind.CONFIRMED:
            i = pairs[j]
            deltas.append(changed(kind, features[j], tracks[i], placed[i], _NO_OFFSET_M, evidence[j]))
    deltas = [delta.model_copy(update={"track_index": None}) for delta in deltas]
    paired = set(pairs.values())
    deltas += [_added(s, founding_key, known) for i, s in enumerate(statements) if i not in paired]
    return sorted(deltas, key=lambda delta: (delta.changed_at_ns, str(delta.feature_id)))


def _pair(
    tracks: Sequence[Track], statements: Sequence[Statement], features: Sequence[MapFeature], params: ReconcileParams
) -> dict[int, int]:
    """Feature index -> statement index of those that are the same cone."""
    index_of = {feature.feature_id: j for j, feature in enumerate(features)}
    pairs = {
        index_of[statement.feature.feature_id]: i
        for i, statement in enumerate(statements)
        if statement.feature.feature_id in index_of
    }
    taken = set(pairs.values())
    free = [i for i in range(len(statements)) if i not in taken]
    others = [j for j in range(len(features)) if j not in pairs]
    own = [tracks[i] for i in free]
    placed = np.array([track.xyz_m for track in own]).reshape(-1, 3)
    near = pair(placed, own, [features[j] for j in others], _NO_OFFSET_M, 0.0, params)
    return pairs | {others[column]: free[row] for column, row in near.items()}


def _is_near(stated_feature: MapFeature, feature: MapFeature, params: ReconcileParams) -> bool:
    """Whether the two places may be one, as for tracks of a drive without a known offset (`map_association.pair`)."""
    shift = np.subtract(stated_feature.xyz_m[:2], feature.xyz_m[:2])
    distance_m = float(np.hypot(*shift))
    if distance_m <= params.min_gate_m:
        return True
    cov = np.array(stated_feature.cov_m2) + np.array(feature.cov_m2)
    horizontal = np.array([[cov[0], cov[1]], [cov[1], cov[3]]])
    chi2 = float(shift @ np.linalg.solve(horizontal, shift))
    return chi2 <= params.gate_chi2 and distance_m <= params.max_offset_m


def _added(statement: Statement, founding_key: str, known: Collection[UUID]) -> Delta:
    feature = statement.feature
    feature_id = feature.feature_id
    if feature_id in known:
        feature_id = uuid5(_NAMESPACE, f"{founding_key}/{feature_id}")
    evidence = stated(None, None, statement)
    return Delta(
        kind=DeltaKind.ADDED,
        feature_id=feature_id,
        old=None,
        new=feature.model_copy(
            update={"feature_id": feature_id, "version": 1, "existence_probability": evidence.existence_probability}
        ),
        track_index=None,
        changed_at_ns=statement.valid_from_ns,
        shift_m=None,
        evidence=evidence,
    )


def _as_track(statement: Statement, at_ns: int) -> Track:
    """What `confirmations`, `changed` and `pair` need to know of a sighting; a statement has no positions."""
    feature = statement.feature
    return Track.model_construct(
        track_index=0,
        category=feature.category,
        xyz_m=feature.xyz_m,
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
        shared_jacobian=None,
    )
