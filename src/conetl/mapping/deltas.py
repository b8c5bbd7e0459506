"""Deltas of single features, and the state of the features after them."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple
from uuid import UUID, uuid5

import numpy as np

from conetl.geometry.packing import cov3, stack_rows, vec3
from conetl.mapping.contradiction import Contradiction
from conetl.mapping.existence_update import missed, observed, sighting_evidence
from conetl.mapping.fusion import birge_ratios, excess_of, fuse, larger_excess, with_excess
from conetl.model.arrays import Floats
from conetl.model.base import Cov3, SharedErrorJacobian
from conetl.model.drive import Track
from conetl.model.feature_classes import FEATURE_CLASSES
from conetl.model.map_records import Delta, DeltaKind, ExistenceEvidence, MapFeature
from conetl.model.params import ReconcileParams

_NAMESPACE = UUID("6a3f2f0e-5a0f-4b55-8f0f-3d6a3f0c7e11")


class ReconcileContext(NamedTuple):
    """What the comparison of a drive, or of an imported map, with the map needs besides these two."""

    params: ReconcileParams
    founding_key: str
    """Map name and content of the drive or import, from which the ids of new features follow."""
    pinned: Collection[UUID] = ()
    """Features that are neither moved nor removed nor given another height."""
    contradiction: Contradiction | None = None
    """Displacement of the drive beyond its stated sigmas."""


def new_feature(track: Track, map_xyz_m: Floats, shift: Floats, founding_key: str, half_of: UUID | None) -> Delta:
    """A new feature; half_of: the feature that turned out to be two cones. Other arguments as for `feature_from_track`.

    Its id is derived from the track's first position, which is in no other track and does not depend on the order of tracks.
    """
    frame, match = track.members[0]
    feature_id = uuid5(_NAMESPACE, f"{founding_key}/{frame}/{match}")
    evidence = sighting_evidence(None, track)
    return Delta(
        kind=DeltaKind.ADDED if half_of is None else DeltaKind.SPLIT,
        feature_id=feature_id,
        new=feature_from_track(track, map_xyz_m, shift, feature_id, 1, evidence),
        track_index=track.track_index,
        changed_at_ns=track.first_seen_ns,
        other_feature_id=half_of,
        evidence=evidence,
    )


def end_feature(
    kind: DeltaKind,
    feature: MapFeature,
    from_ns: int,
    *,
    merged_into: UUID | None = None,
    evidence: ExistenceEvidence | None = None,
) -> Delta:
    """Remove a feature, or merge it into another one, from an instant after its last observation."""
    return Delta(
        kind=kind,
        feature_id=feature.feature_id,
        old=feature,
        changed_at_ns=max(from_ns, feature.last_seen_ns + 1),
        other_feature_id=merged_into,
        evidence=evidence,
    )


def miss_or_remove(feature: MapFeature, missed_ns: int, evidence: ExistenceEvidence, *, gone: bool) -> Delta:
    """Miss a feature, or remove it if it is `gone`. missed_ns: when this drive first missed it."""
    new = missed(feature, evidence.existence_probability, missed_ns)
    if gone:
        assert new.first_missed_ns is not None
        # From the first miss on, perhaps by an earlier drive whose evidence was not enough.
        return end_feature(DeltaKind.REMOVED, feature, new.first_missed_ns, evidence=evidence)
    return Delta(
        kind=DeltaKind.MISSED,
        feature_id=feature.feature_id,
        old=feature,
        new=new,
        changed_at_ns=missed_ns,
        evidence=evidence,
    )


def move_and_merge(old: MapFeature, confirmation: Delta) -> list[Delta]:
    """Move `old` to the position of the confirmed feature, and merge that one into it.

    The confirmed feature was added by an earlier drive to which only the new position was visible.
    """
    merged, state = confirmation.old, confirmation.new
    assert merged is not None and state is not None  # as of every confirmation
    own = {"feature_id": old.feature_id, "version": old.version + 1, "seen_count": old.seen_count + 1}
    new = add_counts(old, state).model_copy(update=own)
    shift_m = float(np.hypot(*(np.array(new.xyz_m) - np.array(old.xyz_m))[:2]))
    moved = {"kind": DeltaKind.MOVED, "feature_id": old.feature_id, "old": old, "new": new, "shift_m": shift_m}
    return [
        confirmation.model_copy(update=moved),
        end_feature(DeltaKind.MERGED, merged, confirmation.changed_at_ns, merged_into=old.feature_id),
    ]


def update_feature(
    kind: DeltaKind, feature: MapFeature, track: Track, map_xyz_m: Floats, shift: Floats, evidence: ExistenceEvidence
) -> Delta:
    """Replace the state of a feature by what this drive alone observed; map_xyz_m, shift: as for `feature_from_track`."""
    new = feature_from_track(track, map_xyz_m, shift, feature.feature_id, feature.version + 1, evidence)
    return Delta(
        kind=kind,
        feature_id=feature.feature_id,
        old=feature,
        new=add_counts(feature, new),
        track_index=track.track_index,
        changed_at_ns=track.first_seen_ns,
        shift_m=float(np.linalg.norm((map_xyz_m - np.array(feature.xyz_m))[:2])),
        evidence=evidence,
    )


def add_counts(old: MapFeature, new: MapFeature) -> MapFeature:
    """The new state with the time span and the numbers of all observations and drives, old and new."""
    return new.model_copy(
        update={
            "first_seen_ns": old.first_seen_ns,
            "last_seen_ns": max(old.last_seen_ns, new.last_seen_ns),
            "observation_count": old.observation_count + new.observation_count,
            "seen_count": old.seen_count + new.seen_count,
            "missed_count": old.missed_count,
        }
    )


def confirm_features(
    pairs: Mapping[int, int],
    features: Sequence[MapFeature],
    tracks: Sequence[Track],
    evidence: Mapping[int, ExistenceEvidence],
    excess_m2: Floats | None = None,
) -> list[Delta]:
    """Confirm features at the same position: both estimates are fused by their covariances, all pairs (feature -> track) at once.

    evidence: by feature. excess_m2 (3, 3): by which the drive contradicts the map. Tracks enter in the drive's own frame, where
    their covariances hold: corrected by the drive's offset they would contain the map's errors, and one difference would be
    shared out twice.
    """
    if not pairs:
        return []
    old, new = [features[j] for j in pairs], [tracks[i] for i in pairs.values()]
    excess = [larger_excess(excess_of(f.shared_jacobian), excess_m2) for f in old]
    gain, cov, jacobians, difference_m2 = fuse(*_with_excess(old, excess), *_with_excess(new, excess))
    old_xyz, new_xyz = (stack_rows([one.xyz_m for one in side], 3) for side in (old, new))
    apart = new_xyz - old_xyz
    fused = old_xyz + _matvec(gain, apart)
    in_excess = np.array([np.zeros((3, 3)) if one is None else one for one in excess])
    of_excess = np.diagonal(in_excess, axis1=1, axis2=2)  # it covers both already
    ratios = birge_ratios(apart, difference_m2 + in_excess)
    cov[:, range(3), range(3)] = of_excess + ratios * (cov[:, range(3), range(3)] - of_excess)
    centres, new_centres = (stack_rows([one.centre_xyz_m for one in side], 3) for side in (old, new))
    centres = centres + _matvec(gain, new_centres - centres)
    shifts_m = np.linalg.norm((fused - old_xyz)[:, :2], axis=1).tolist()
    heights, height_sigmas = _fused_heights(old, new)
    unsound = ~(np.diagonal(cov, axis1=1, axis2=2) > 0).all(axis=1)
    if unsound.any():
        first = old[int(np.flatnonzero(unsound)[0])]
        raise ValueError(f"feature {first.feature_id} and its track have covariances that cannot be fused")
    deltas = []
    for k, (j, feature, track) in enumerate(zip(pairs, old, new, strict=True)):
        after = {
            "version": feature.version + 1,
            "xyz_m": vec3(fused[k]),
            "cov_m2": cov3(cov[k]),
            "centre_xyz_m": vec3(centres[k]),
            "object_height_m": float(heights[k]),
            "object_height_sigma_m": float(height_sigmas[k]),
            "shared_jacobian": jacobians[k],
            **observed(feature, evidence[j]),
            "observation_count": feature.observation_count + track.observation_count,
            "last_seen_ns": max(feature.last_seen_ns, track.last_seen_ns),
        }
        deltas.append(
            Delta(
                kind=DeltaKind.CONFIRMED,
                feature_id=feature.feature_id,
                old=feature,
                new=MapFeature(**vars(feature) | after),
                track_index=track.track_index,
                changed_at_ns=track.first_seen_ns,
                shift_m=shifts_m[k],
                evidence=evidence[j],
            )
        )
    return deltas


def exceeding(track: Track, excess_m2: Floats | None) -> Track:
    """The track with sigmas enlarged by the excess (3, 3) of its drive, if it has one."""
    if excess_m2 is None:
        return track
    cov_m2, shared_jacobian = with_excess(track.cov_m2, track.shared_jacobian, excess_m2)
    return track.model_copy(update={"cov_m2": cov_m2, "shared_jacobian": shared_jacobian})


def _with_excess(
    estimates: Sequence[MapFeature | Track], excess: Sequence[Floats | None]
) -> tuple[list[Cov3], list[SharedErrorJacobian | None]]:
    """Covariances and Jacobians of estimates whose sigmas are too small by an excess (3, 3), where there is one."""
    covs = [one.cov_m2 for one in estimates]
    jacobians = [one.shared_jacobian for one in estimates]
    for k, excess_m2 in enumerate(excess):
        if excess_m2 is not None:
            covs[k], jacobians[k] = with_excess(covs[k], jacobians[k], excess_m2)
    return covs, jacobians


def _fused_heights(old: Sequence[MapFeature], new: Sequence[Track]) -> tuple[Floats, Floats]:
    """Weighted means of two heights each, and their sigmas (N,) m.

    What heights of a class have in common stays in the sigma; heights stated with a smaller one, such as surveyed ones, lack it.
    """
    heights = np.array([[one.object_height_m for one in side] for side in (old, new)])
    variances = np.array([[one.object_height_sigma_m for one in side] for side in (old, new)]) ** 2
    shares = np.array([FEATURE_CLASSES[one.category].height_common for one in old])
    both = (variances > (shares * heights) ** 2).all(axis=0)
    weights = 1 / (variances - both * (shares * heights) ** 2)
    fused = (heights * weights).sum(axis=0) / weights.sum(axis=0)
    return fused, np.sqrt(1 / weights.sum(axis=0) + both * (shares * fused) ** 2)


def _matvec(matrices: Floats, vectors: Floats) -> Floats:
    """(N, 3, 3) times (N, 3)."""
    return (matrices @ vectors[:, :, None])[:, :, 0]


def feature_from_track(
    track: Track, map_xyz_m: Floats, shift: Floats, feature_id: UUID, version: int, evidence: ExistenceEvidence
) -> MapFeature:
    """A track as a feature; map_xyz_m (3,): its position on the map, shift (3,): what was subtracted from the track, metres."""
    own = {
        "feature_id": feature_id,
        "version": version,
        "xyz_m": vec3(map_xyz_m),
        "centre_xyz_m": vec3(np.array(track.centre_xyz_m) - shift),
        **observed(None, evidence),
        "marking": None,
    }
    return MapFeature(**{name: vars(track)[name] for name in MapFeature.model_fields.keys() - own} | own)
