"""Tracks of one drive against the map -> deltas: added, confirmed, moved, removed.

The drive's common offset (GNSS without a fix puts the whole drive aside) is estimated from all shared cones first and taken
out; then tracks and features are paired one-to-one. What is left of both sides is a cone that was moved when the two are of
like height and near each other; otherwise a new cone, and, where the drive plainly looked at the spot and saw nothing, a
removed one. Features out of view are left alone.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from uuid import UUID, uuid5

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from conetl.geometry.packing import cov3, cov_matrix, vec3
from conetl.params import ReconcileParams
from conetl.records import Cov3, Delta, DeltaKind, MapFeature, Track
from conetl.steps.visibility import Look

Floats = NDArray[np.float64]
_NAMESPACE = UUID("6a3f2f0e-5a0f-4b55-8f0f-3d6a3f0c7e11")
_FORBIDDEN = 1e6
#: Offsets that are tried; every shared cone proposes nearly the same one, so a few hundred are plenty for any drive.
_MAX_PROPOSALS = 200
#: Belief in a feature never becomes certainty: the next drive must be able to change it.
MAX_LOGIT = 7.0


def reconcile(
    tracks: Sequence[Track],
    features: Sequence[MapFeature],
    look_at: Callable[[MapFeature, Floats], Look | None],
    params: ReconcileParams,
    *,
    founding_key: str,
    pinned: Collection[UUID] = (),
) -> list[Delta]:
    """Deltas that bring the map from before the drive to after it.

    look_at(feature, offset_m): what the drive saw of that feature's spot, None where it was never in plain view; offset_m (3,)
    is where the drive's map frame lies against the map's (add it to map coordinates to get the drive's). founding_key (the
    map and the drive's content) founds the ids of new features. pinned: features that a person holds in place. `features` is the
    map as the drives recorded before this one left it (`steps/fold.py`); the order of both lists does not matter.
    """
    tracks = sorted(tracks, key=lambda track: track.members[0])
    features = sorted(features, key=lambda feature: feature.feature_id)
    offset_m, weight = common_offset(tracks, features, params)
    placed = np.array([t.xyz_m for t in tracks]).reshape(-1, 3) - weight * offset_m
    pairs = _pair(placed, tracks, features, offset_m, weight, params)
    deltas: list[Delta] = []
    paired = set(pairs.values())
    free_tracks = [i for i in range(len(tracks)) if i not in paired]
    vanished: list[tuple[int, Look]] = []
    for j, feature in enumerate(features):
        if j in pairs or feature.feature_id in pinned:
            continue
        look = look_at(feature, weight * offset_m)
        if look is not None and look.frames >= params.removal_min_frames:
            vanished.append((j, look))
    for j, i in pairs.items():
        deltas.append(confirmed(features[j], tracks[i], placed[i], weight * offset_m))
    for j, i in _moves(placed, tracks, free_tracks, features, [j for j, _ in vanished], params).items():
        deltas.append(moved(features[j], tracks[i], placed[i], weight * offset_m))
        free_tracks.remove(i)
        vanished = [(k, look) for k, look in vanished if k != j]
    for j, look in vanished:
        feature = features[j]
        deltas.append(
            Delta(
                kind=DeltaKind.REMOVED,
                feature_id=feature.feature_id,
                old=feature,
                new=None,
                track_index=None,
                changed_at_ns=max(look.first_ns, feature.last_seen_ns + 1),
                shift_m=None,
            )
        )
    for i in free_tracks:
        deltas.append(_added(tracks[i], placed[i], weight * offset_m, founding_key))
    return sorted(deltas, key=lambda d: (d.changed_at_ns, str(d.feature_id)))


def common_offset(
    tracks: Sequence[Track], features: Sequence[MapFeature], params: ReconcileParams
) -> tuple[Floats, float]:
    """Offset (3,) of the drive against the map in metres, and the share of it that is the drive's fault.

    Every track-feature pair proposes an offset; the one that brings most tracks onto features wins, nearer proposals first,
    and is averaged over its pairs. Fewer than two agreeing pairs, or an offset beyond what the stated sigmas allow,
    give zero: one cone that was moved must not drag the drive along.
    """
    zero = np.zeros(3)
    if len(tracks) < 2 or len(features) < 2:
        return zero, 0.0
    t = np.array([track.xyz_m for track in tracks])
    f = np.array([feature.xyz_m for feature in features])
    differences = t[:, None, :] - f[None, :, :]
    drive_var = float(np.mean([track.cov_m2[0] + track.cov_m2[3] for track in tracks])) / 2
    map_var = float(np.mean([feature.cov_m2[0] + feature.cov_m2[3] for feature in features])) / 2
    allowed_m = min(params.max_offset_m, 4 * float(np.sqrt(drive_var + map_var)))
    proposals = differences.reshape(-1, 3)
    lengths = np.linalg.norm(proposals[:, :2], axis=1)
    best: tuple[int, float, Floats] = (1, 0.0, zero)
    for k in np.argsort(lengths, kind="stable")[:_MAX_PROPOSALS]:
        if lengths[k] > allowed_m:
            break
        misfits = np.linalg.norm((differences - proposals[k])[:, :, :2], axis=2)
        close = misfits <= params.min_gate_m
        inliers = differences[close & (misfits == misfits.min(axis=1, keepdims=True))]
        spread = float(np.linalg.norm(inliers - inliers.mean(axis=0), axis=1).mean()) if len(inliers) else np.inf
        if len(inliers) > best[0] or (len(inliers) == best[0] >= 2 and spread < 0.5 * best[1]):
            best = (len(inliers), spread, np.median(inliers, axis=0))
    count, _, offset_m = best
    if count < 2 or float(np.linalg.norm(offset_m[:2])) > allowed_m:
        return zero, 0.0
    return offset_m, drive_var / (drive_var + map_var)


def _pair(
    placed: Floats,
    tracks: Sequence[Track],
    features: Sequence[MapFeature],
    offset_m: Floats,
    weight: float,
    params: ReconcileParams,
) -> dict[int, int]:
    """Feature index -> track index of those that are the same cone in the same place."""
    if not tracks or not features:
        return {}
    # With the offset known only what is not common to the drive is uncertain; without it, everything is.
    known = weight > 0
    cov = _horizontal([track.relative_cov_m2 if known else track.cov_m2 for track in tracks])[None]
    if not known:
        cov = cov + _horizontal([feature.cov_m2 for feature in features])[:, None]
    places = np.array([feature.xyz_m for feature in features])
    x, y = np.moveaxis((placed - (1 - weight) * offset_m)[None, :, :2] - places[:, None, :2], 2, 0)
    xx, xy, yy = np.moveaxis(cov, 2, 0)
    distance2 = (yy * x * x - 2 * xy * x * y + xx * y * y) / (xx * yy - xy * xy)
    distance = np.hypot(x, y)
    near = (distance <= params.min_gate_m) | ((distance2 <= params.gate_chi2) & (distance <= params.max_offset_m))
    costs = np.where(near, distance, _FORBIDDEN)
    rows, columns = linear_sum_assignment(costs)
    return {int(j): int(i) for j, i in zip(rows, columns, strict=True) if costs[j, i] < _FORBIDDEN}


def _horizontal(covariances: Sequence[Cov3]) -> Floats:
    """(N, 3): xx, xy, yy of each covariance."""
    return np.array(covariances)[:, [0, 1, 3]]


def _moves(
    placed: Floats,
    tracks: Sequence[Track],
    free_tracks: Sequence[int],
    features: Sequence[MapFeature],
    vanished: Sequence[int],
    params: ReconcileParams,
) -> dict[int, int]:
    """Feature index -> track index of cones that were moved."""
    if not free_tracks or not vanished:
        return {}
    costs = np.full((len(vanished), len(free_tracks)), _FORBIDDEN)
    for row, j in enumerate(vanished):
        for column, i in enumerate(free_tracks):
            distance = float(np.linalg.norm((placed[i] - np.array(features[j].xyz_m))[:2]))
            height_difference = abs(tracks[i].cone_height_m - features[j].cone_height_m)
            if distance <= params.moved_max_m and height_difference <= params.moved_height_tolerance_m:
                costs[row, column] = distance
    rows, columns = linear_sum_assignment(costs)
    return {
        vanished[r]: free_tracks[c]
        for r, c in zip(rows.tolist(), columns.tolist(), strict=True)
        if costs[r, c] < _FORBIDDEN
    }


def _added(track: Track, placed: Floats, shift: Floats, founding_key: str) -> Delta:
    frame_index, match_index = track.members[0]
    feature_id = uuid5(_NAMESPACE, f"{founding_key}/{frame_index}/{match_index}")
    new = _feature_from_track(track, placed, shift, feature_id, 1)
    return Delta(
        kind=DeltaKind.ADDED,
        feature_id=feature_id,
        old=None,
        new=new,
        track_index=track.track_index,
        changed_at_ns=track.first_seen_ns,
        shift_m=None,
    )


def moved(feature: MapFeature, track: Track, placed: Floats, shift: Floats) -> Delta:
    """The same cone at another place; arguments as of `confirmed`."""
    new = _feature_from_track(track, placed, shift, feature.feature_id, feature.version + 1).model_copy(
        update={
            "first_seen_ns": feature.first_seen_ns,
            "observation_count": feature.observation_count + track.observation_count,
        }
    )
    return Delta(
        kind=DeltaKind.MOVED,
        feature_id=feature.feature_id,
        old=feature,
        new=new,
        track_index=track.track_index,
        changed_at_ns=track.first_seen_ns,
        shift_m=float(np.linalg.norm((placed - np.array(feature.xyz_m))[:2])),
    )


def confirmed(feature: MapFeature, track: Track, placed: Floats, shift: Floats) -> Delta:
    """The same place seen again: both statements weighted by their covariances. placed, shift: see `reconcile`'s offset,
    (3,) metres."""
    old_cov, new_cov = cov_matrix(feature.cov_m2), cov_matrix(track.cov_m2)
    old_xyz = np.array(feature.xyz_m)
    gain = old_cov @ np.linalg.inv(old_cov + new_cov)
    fused = old_xyz + gain @ (placed - old_xyz)
    cov = (np.eye(3) - gain) @ old_cov
    centre = np.array(feature.centre_xyz_m)
    fused_centre = centre + gain @ (np.array(track.centre_xyz_m) - shift - centre)
    old_weight, new_weight = feature.cone_height_sigma_m**-2, track.cone_height_sigma_m**-2
    height = (feature.cone_height_m * old_weight + track.cone_height_m * new_weight) / (old_weight + new_weight)
    logit = _logit(feature.existence_probability) + _logit(track.existence_probability)
    new = MapFeature(
        feature_id=feature.feature_id,
        version=feature.version + 1,
        category=feature.category,
        xyz_m=vec3(fused),
        cov_m2=cov3((cov + cov.T) / 2),
        centre_xyz_m=vec3(fused_centre),
        cone_height_m=height,
        cone_height_sigma_m=(old_weight + new_weight) ** -0.5,
        existence_probability=float(1 / (1 + np.exp(-min(logit, MAX_LOGIT)))),
        observation_count=feature.observation_count + track.observation_count,
        first_seen_ns=feature.first_seen_ns,
        last_seen_ns=max(feature.last_seen_ns, track.last_seen_ns),
    )
    return Delta(
        kind=DeltaKind.CONFIRMED,
        feature_id=feature.feature_id,
        old=feature,
        new=new,
        track_index=track.track_index,
        changed_at_ns=track.first_seen_ns,
        shift_m=float(np.linalg.norm((fused - old_xyz)[:2])),
    )


def _feature_from_track(track: Track, placed: Floats, shift: Floats, feature_id: UUID, version: int) -> MapFeature:
    return MapFeature(
        feature_id=feature_id,
        version=version,
        category=track.category,
        xyz_m=vec3(placed),
        cov_m2=track.cov_m2,
        centre_xyz_m=vec3(np.array(track.centre_xyz_m) - shift),
        cone_height_m=track.cone_height_m,
        cone_height_sigma_m=track.cone_height_sigma_m,
        existence_probability=min(track.existence_probability, float(1 / (1 + np.exp(-MAX_LOGIT)))),
        observation_count=track.observation_count,
        first_seen_ns=track.first_seen_ns,
        last_seen_ns=track.last_seen_ns,
    )


def _logit(probability: float) -> float:
    p = float(np.clip(probability, 1e-6, 1 - 1e-6))
    return float(np.log(p / (1 - p)))
