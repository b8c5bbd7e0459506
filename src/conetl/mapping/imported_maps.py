"""Features of an imported map against the map -> deltas: added, confirmed, moved, height changed. Features that it lacks stay
unchanged.

Two features are the same cone if their ids are equal, else if a track at that position would be paired with the feature
(`association.py`). Unlike a drive, an imported map has no common offset that could be separated from its own errors: its sigmas
count as stated.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from uuid import UUID, uuid5

import numpy as np

from conetl.mapping.association import Comparison, match_unmoved
from conetl.mapping.changes import height_differs
from conetl.mapping.deltas import ReconcileContext, confirm_features, update_feature
from conetl.mapping.existence_update import confirmation_evidence, observed
from conetl.model.drive import Track
from conetl.model.map_records import Delta, DeltaKind, ImportedFeature, MapFeature
from conetl.model.params import ReconcileParams

_NAMESPACE = UUID("c2a5b3a1-6c2f-4f1e-9a53-7c1d2b6f0d44")
_NO_OFFSET_M = np.zeros(3)


def reconcile_imported(
    statements: Sequence[ImportedFeature],
    features: Sequence[MapFeature],
    context: ReconcileContext,
    *,
    at_ns: int,
    known: Collection[UUID] = (),
) -> list[Delta]:
    """Deltas of an imported map that is valid at the instant `at_ns`; the order of statements and features does not matter.

    features: the present ones nearby. A new feature keeps its id unless that is `known` already (of a feature that is gone, or
    elsewhere): then the id follows from `founding_key` and the imported id.
    """
    params, founding_key, pinned, _ = context
    statements = sorted(statements, key=lambda statement: statement.feature.feature_id)
    features = sorted(features, key=lambda feature: feature.feature_id)
    tracks = [_as_track(statement.feature, at_ns) for statement in statements]
    pairs = _match(tracks, statements, features, params)
    evidence = {
        j: confirmation_evidence(features[j], statements[i].feature.existence_probability, 0)
        for j, i in sorted(pairs.items())
    }
    kinds: dict[int, DeltaKind] = {}
    for j, i in sorted(pairs.items()):
        held, near = features[j].feature_id in pinned, _is_near(tracks[i], features[j], params)
        if near:
            other = not held and height_differs(features[j], tracks[i], params)
            kinds[j] = DeltaKind.HEIGHT_CHANGED if other else DeltaKind.CONFIRMED
        elif not held:
            kinds[j] = DeltaKind.MOVED
    same = {j: pairs[j] for j, kind in kinds.items() if kind is DeltaKind.CONFIRMED}
    deltas = confirm_features(same, features, tracks, evidence)
    for j, kind in kinds.items():
        if kind is not DeltaKind.CONFIRMED:
            track = tracks[pairs[j]]
            deltas.append(update_feature(kind, features[j], track, np.array(track.xyz_m), _NO_OFFSET_M, evidence[j]))
    deltas = [delta.model_copy(update={"track_index": None}) for delta in deltas]
    paired = set(pairs.values())
    deltas += [_added(s, founding_key, known) for i, s in enumerate(statements) if i not in paired]
    return sorted(deltas, key=lambda delta: (delta.changed_at_ns, str(delta.feature_id)))


def _match(
    tracks: Sequence[Track],
    statements: Sequence[ImportedFeature],
    features: Sequence[MapFeature],
    params: ReconcileParams,
) -> dict[int, int]:
    """Feature index -> statement index of those that are the same cone."""
    index_of = {feature.feature_id: j for j, feature in enumerate(features)}
    pairs = {
        index_of[statement.feature.feature_id]: i
        for i, statement in enumerate(statements)
        if statement.feature.feature_id in index_of
    }
    paired = set(pairs.values())
    free = [i for i in range(len(statements)) if i not in paired]
    others = [j for j in range(len(features)) if j not in pairs]
    own = [tracks[i] for i in free]
    xyz_m = np.array([track.xyz_m for track in own]).reshape(-1, 3)
    near = match_unmoved(Comparison(own, [features[j] for j in others], xyz_m, params), _NO_OFFSET_M, 0.0)
    return pairs | {others[column]: free[row] for column, row in near.items()}


def _is_near(track: Track, feature: MapFeature, params: ReconcileParams) -> bool:
    """Whether the positions may be the same, by the gate of `association.match_unmoved` without a known offset."""
    shift = np.subtract(track.xyz_m[:2], feature.xyz_m[:2])
    distance_m = float(np.hypot(*shift))
    if distance_m <= params.min_gate_m:
        return True
    cov = np.array(track.cov_m2) + np.array(feature.cov_m2)
    horizontal = np.array([[cov[0], cov[1]], [cov[1], cov[3]]])
    chi2 = float(shift @ np.linalg.solve(horizontal, shift))
    return chi2 <= params.gate_chi2 and distance_m <= params.max_offset_m


def _added(statement: ImportedFeature, founding_key: str, known: Collection[UUID]) -> Delta:
    feature_id = statement.feature.feature_id
    if feature_id in known:
        feature_id = uuid5(_NAMESPACE, f"{founding_key}/{feature_id}")
    evidence = confirmation_evidence(None, statement.feature.existence_probability, 0)
    own = {"feature_id": feature_id, "version": 1, **observed(None, evidence)}
    return Delta(
        kind=DeltaKind.ADDED,
        feature_id=feature_id,
        new=statement.feature.model_copy(update=own),
        changed_at_ns=statement.valid_from_ns,
        evidence=evidence,
    )


def _as_track(feature: MapFeature, at_ns: int) -> Track:
    """An imported feature as a track of a drive, without positions."""
    shared = feature.model_dump(include=Track.model_fields.keys() & MapFeature.model_fields.keys())
    return Track.model_construct(
        **shared | {"first_seen_ns": at_ns, "shared_jacobian": None},
        track_index=0,
        relative_cov_m2=feature.cov_m2,
        residual_rms_px=0.0,
        nearest_range_m=1.0,
        members=((0, 0),),
    )
