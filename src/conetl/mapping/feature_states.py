"""Features as they are after a drive saw them: the same place known better, or anew by this drive alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from uuid import UUID

import numpy as np
from numpy.typing import NDArray

from conetl.geometry.packing import vec3
from conetl.mapping.fusion import fuse
from conetl.model.map_records import Delta, DeltaKind, MapFeature, SightingEvidence
from conetl.model.records import Track, sound

Floats = NDArray[np.float64]


def changed(
    kind: DeltaKind, feature: MapFeature, track: Track, placed: Floats, shift: Floats, evidence: SightingEvidence
) -> Delta:
    """The feature as this drive alone saw it; placed, shift: as of `feature_from_track`."""
    new = feature_from_track(track, placed, shift, feature.feature_id, feature.version + 1, evidence).model_copy(
        update={
            "first_seen_ns": feature.first_seen_ns,
            "last_seen_ns": max(feature.last_seen_ns, track.last_seen_ns),
            "observation_count": feature.observation_count + track.observation_count,
        }
    )
    return Delta(
        kind=kind,
        feature_id=feature.feature_id,
        old=feature,
        new=new,
        track_index=track.track_index,
        changed_at_ns=track.first_seen_ns,
        shift_m=float(np.linalg.norm((placed - np.array(feature.xyz_m))[:2])),
        evidence=evidence,
    )


def confirmations(
    pairs: Mapping[int, int],
    features: Sequence[MapFeature],
    tracks: Sequence[Track],
    evidence: Mapping[int, SightingEvidence],
) -> list[Delta]:
    """The same places seen again: both statements weighted by their covariances, all pairs (feature -> track) at once.

    evidence: by feature. Tracks count where their drive has them: their covariances hold there. With the drive's offset taken out
    they would have the map's own errors in them, and one and the same difference would be shared out twice.
    """
    if not pairs:
        return []
    old, new = [features[j] for j in pairs], [tracks[i] for i in pairs.values()]
    gain, cov, shared_jacobian = fuse(
        [f.cov_m2 for f in old],
        [f.shared_jacobian for f in old],
        [t.cov_m2 for t in new],
        [t.shared_jacobian for t in new],
    )
    old_xyz = np.array([f.xyz_m for f in old])
    fused = old_xyz + _times(gain, np.array([t.xyz_m for t in new]) - old_xyz)
    centres = np.array([f.centre_xyz_m for f in old])
    fused_centres = centres + _times(gain, np.array([t.centre_xyz_m for t in new]) - centres)
    shifts_m = np.linalg.norm((fused - old_xyz)[:, :2], axis=1)
    heights = np.array([(f.cone_height_m, t.cone_height_m) for f, t in zip(old, new, strict=True)])
    weights = np.array([(f.cone_height_sigma_m, t.cone_height_sigma_m) for f, t in zip(old, new, strict=True)]) ** -2.0
    height = (heights * weights).sum(axis=1) / weights.sum(axis=1)
    # All at once what the records would check one by one.
    whole = np.column_stack([fused, cov.reshape(-1, 9), fused_centres, height])
    unsound = ~np.isfinite(whole).all(axis=1) | (np.diagonal(cov, axis1=1, axis2=2) <= 0).any(axis=1)
    if unsound.any():
        first = old[int(np.flatnonzero(unsound)[0])]
        raise ValueError(f"feature {first.feature_id} and its track have covariances that cannot be fused")
    columns = zip(
        old,
        new,
        fused.tolist(),
        cov.reshape(-1, 9)[:, [0, 1, 2, 4, 5, 8]].tolist(),
        fused_centres.tolist(),
        height.tolist(),
        (weights.sum(axis=1) ** -0.5).tolist(),
        [evidence[j] for j in pairs],
        shifts_m.tolist(),
        shared_jacobian,
        strict=True,
    )
    return [
        sound(
            Delta,
            kind=DeltaKind.CONFIRMED,
            feature_id=feature.feature_id,
            old=feature,
            new=sound(
                MapFeature,
                feature_id=feature.feature_id,
                version=feature.version + 1,
                category=feature.category,
                xyz_m=tuple(xyz_m),
                cov_m2=tuple(cov_m2),
                centre_xyz_m=tuple(centre_m),
                cone_height_m=height_m,
                cone_height_sigma_m=height_sigma_m,
                existence_probability=found.existence_probability,
                observation_count=feature.observation_count + track.observation_count,
                first_seen_ns=feature.first_seen_ns,
                last_seen_ns=max(feature.last_seen_ns, track.last_seen_ns),
                shared_jacobian=own_jacobian,
            ),
            track_index=track.track_index,
            changed_at_ns=track.first_seen_ns,
            shift_m=shift_m,
            other_feature_id=None,
            evidence=found,
        )
        for feature, track, xyz_m, cov_m2, centre_m, height_m, height_sigma_m, found, shift_m, own_jacobian in columns
    ]


def _times(matrices: Floats, vectors: Floats) -> Floats:
    """(N, 3, 3) times (N, 3)."""
    return (matrices @ vectors[:, :, None])[:, :, 0]


def feature_from_track(
    track: Track, placed: Floats, shift: Floats, feature_id: UUID, version: int, evidence: SightingEvidence
) -> MapFeature:
    """A track as a feature; placed (3,): in the map's coordinates, shift (3,): what was taken out of it, metres."""
    return sound(
        MapFeature,
        feature_id=feature_id,
        version=version,
        category=track.category,
        xyz_m=vec3(placed),
        cov_m2=track.cov_m2,
        centre_xyz_m=vec3(np.array(track.centre_xyz_m) - shift),
        cone_height_m=track.cone_height_m,
        cone_height_sigma_m=track.cone_height_sigma_m,
        existence_probability=evidence.existence_probability,
        observation_count=track.observation_count,
        first_seen_ns=track.first_seen_ns,
        last_seen_ns=track.last_seen_ns,
        shared_jacobian=track.shared_jacobian,
    )
