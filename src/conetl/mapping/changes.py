"""Tracks of one drive against the map -> deltas.

The drive's common offset (GNSS without a fix puts the whole drive aside) is estimated from all shared cones first and taken
out; then tracks and features are paired one-to-one (`map_association.py`). A feature without a track whose spot was in view is
missed: evidence against it, and where the belief falls far enough (`belief.py`), it is gone. What is gone and a new track of like
height near it are one cone that was moved; what is left is removed, and added. Features out of view are left alone. The rules of
all kinds are written down in docs/explanation/changes.md.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from math import hypot, sqrt
from uuid import UUID, uuid5

import numpy as np
from numpy.typing import NDArray

from conetl.mapping.association import common_offset, moved_before, moves, pair
from conetl.mapping.existence_update import is_gone, missed, seen
from conetl.mapping.feature_states import changed, confirmations, feature_from_track
from conetl.mapping.gating import near_pairs
from conetl.mapping.map_frame import placed_tracks
from conetl.mapping.visibility import Look
from conetl.model.map_records import Delta, DeltaKind, Doubt, MapFeature, SightingEvidence
from conetl.model.params import ReconcileParams
from conetl.model.records import Track
from conetl.tracking.apparent_boxes import WIDTH_OVER_HEIGHT

Floats = NDArray[np.float64]
LookAt = Callable[[MapFeature, Floats, Floats], Look | None]
_NAMESPACE = UUID("6a3f2f0e-5a0f-4b55-8f0f-3d6a3f0c7e11")
#: A feature this near to the middle of two tracks, as a share of their distance, was both of them.
_MIDDLE_SHARE = 0.25
#: Wider than the base plate of any cone.
_WIDEST_BASE_M = 1.0


def reconcile(
    tracks: Sequence[Track],
    features: Sequence[MapFeature],
    look_at: LookAt,
    params: ReconcileParams,
    *,
    founding_key: str,
    pinned: Collection[UUID] = (),
    doubts: Mapping[UUID, Doubt] | None = None,
) -> list[Delta]:
    """Deltas that bring the map from before the drive to after it.

    look_at(feature, offset_m, others_m): what the drive saw of that feature's spot, None where that says nothing; offset_m (3,)
    is where the drive's map frame lies against the map's (add it to map coordinates to get the drive's), others_m (M, 3) the
    places, in the drive's frame, of cones that are not that feature (`visibility.look_at_spot`). founding_key (the map and the
    drive's content) founds the ids of new features. pinned: features that a person holds in place. doubts: of features that
    drives missed since their version. `features` is the map as the drives recorded before this one left it (`mapping/fold.py`);
    the order of both lists does not matter.
    """
    doubts = doubts or {}
    tracks = _without_doubles(sorted(tracks, key=lambda track: track.members[0]))
    features = sorted(features, key=lambda feature: feature.feature_id)
    offset_m, weight = common_offset(tracks, features, params)
    shift_m = weight * offset_m
    placed = np.array([t.xyz_m for t in tracks]).reshape(-1, 3) - shift_m
    pairs = pair(placed, tracks, features, offset_m, weight, params)
    merged = _mergers(features, pairs, tracks, pinned, params)
    deltas = [_merged(features[j], features[kept], tracks[pairs[kept]]) for j, kept in merged.items()]

    paired = set(pairs.values())
    free = _founding(tracks, paired, params)
    others_m = np.array([tracks[i].xyz_m for i in sorted(paired.union(free))]).reshape(-1, 3)
    unseen: dict[int, tuple[Look, SightingEvidence]] = {}
    for j, feature in enumerate(features):
        look = None if j in pairs or j in merged else look_at(feature, shift_m, others_m)
        if look is not None:
            unseen[j] = look, missed(feature, doubts.get(feature.feature_id), look, params)
    loose = {j: evidence for j, (_, evidence) in unseen.items() if features[j].feature_id not in pinned}
    vanished = [j for j, evidence in loose.items() if is_gone(evidence, params, moved=True)]

    moved = moves(placed, tracks, free, features, vanished, params)
    free = [i for i in free if i not in set(moved.values())]
    halves = _halves(placed, tracks, free, features, pairs, params)
    evidence_for = {
        j: seen(features[j], doubts.get(features[j].feature_id), tracks[i]) for j, i in {**pairs, **moved}.items()
    }
    anew = dict.fromkeys(moved, DeltaKind.MOVED)
    anew |= dict.fromkeys(halves.values(), DeltaKind.CONFIRMED)  # its place was that of neither half
    for j, i in pairs.items():
        if features[j].feature_id not in pinned and height_differs(features[j], tracks[i], params):
            anew[j] = DeltaKind.HEIGHT_CHANGED
    as_before = {j: i for j, i in pairs.items() if j not in anew}
    anew_from = [*free, *(pairs[j] if j in pairs else moved[j] for j in anew)]
    own = placed_tracks(anew_from, tracks, features, pairs, weight)
    loose_seen = {j: i for j, i in as_before.items() if features[j].feature_id not in pinned}
    left = [j for j in vanished if j not in moved]
    moved_to = moved_before(placed, tracks, loose_seen, features, left, params)
    feature_by_id = {features[k].feature_id: features[j] for j, k in moved_to.items()}
    for delta in confirmations(as_before, features, tracks, evidence_for):
        old = feature_by_id.get(delta.feature_id)
        deltas += [delta] if old is None else _moved_before(old, delta)
    for j, kind in anew.items():
        i = pairs[j] if j in pairs else moved[j]
        deltas.append(changed(kind, features[j], own[i], placed[i], shift_m, evidence_for[j]))
    for j, (look, evidence) in unseen.items():
        if j in moved or j in moved_to:
            continue
        if j in loose and is_gone(evidence, params):
            deltas.append(_removed(features[j], doubts.get(features[j].feature_id), look, evidence))
        else:
            deltas.append(_missed(features[j], look, evidence))
    for i in free:
        half_of = features[halves[i]].feature_id if i in halves else None
        deltas.append(_added(own[i], placed[i], shift_m, founding_key, half_of))
    return sorted(deltas, key=lambda d: (d.changed_at_ns, d.feature_id.int))


def _without_doubles(tracks: Sequence[Track]) -> list[Track]:
    """The tracks but for those that stand inside another one of the same drive: two base plates do not fit into one place. The
    one with more observations is the cone, the other a second box of the detector or a piece of the same chain."""
    if not tracks:
        return []
    places = np.array([track.xyz_m[:2] for track in tracks])
    weight = [(track.observation_count, track.existence_probability, -i) for i, track in enumerate(tracks)]
    doubles = set()
    for a, b in zip(*near_pairs(places, places, _WIDEST_BASE_M), strict=True):
        base_m = WIDTH_OVER_HEIGHT * min(tracks[a].cone_height_m, tracks[b].cone_height_m)
        if weight[a] > weight[b] and float(np.hypot(*(places[a] - places[b]))) < base_m:
            doubles.add(int(b))
    return [track for i, track in enumerate(tracks) if i not in doubles]


def _founding(tracks: Sequence[Track], paired: Collection[int], params: ReconcileParams) -> list[int]:
    """The tracks without a feature that are sure enough to be a cone of their own.

    A far cone is placed well across the line of sight and poorly along it, so the second box that a detector now and then gives
    to one cone may come to stand beside it. So a track founds nothing while its base plate, moved by one sigma, would stand on
    that of a track with more observations: a drive that passes nearer tells whether there are two.
    """
    sure = params.founding_existence_probability
    free = [i for i, track in enumerate(tracks) if i not in paired and track.existence_probability >= sure]
    if not free:
        return []
    places = np.array([track.xyz_m[:2] for track in tracks])
    doubtful = set()
    for a, k in zip(*near_pairs(places[free], places, 2 * _WIDEST_BASE_M), strict=True):
        i = free[a]
        if tracks[k].observation_count <= tracks[i].observation_count:
            continue
        apart = places[i] - places[k]
        apart_m = float(np.hypot(*apart))
        xx, xy, _, yy, *_ = np.add(tracks[i].relative_cov_m2, tracks[k].relative_cov_m2).tolist()
        x, y = (apart / max(apart_m, 1e-9)).tolist()
        sigma_m = sqrt(max(x * x * xx + 2 * x * y * xy + y * y * yy, 0.0))
        if apart_m - sigma_m < WIDTH_OVER_HEIGHT * min(tracks[i].cone_height_m, tracks[k].cone_height_m):
            doubtful.add(i)
    return [i for i in free if i not in doubtful]


def _mergers(
    features: Sequence[MapFeature],
    pairs: Mapping[int, int],
    tracks: Sequence[Track],
    pinned: Collection[UUID],
    params: ReconcileParams,
) -> dict[int, int]:
    """Unseen feature -> the seen one that it must be: two base plates do not fit into one place."""
    certain = [j for j in sorted(pairs) if tracks[pairs[j]].observation_count >= params.removal_min_frames]
    unseen = [j for j, feature in enumerate(features) if j not in pairs and feature.feature_id not in pinned]
    if not certain or not unseen:
        return {}
    places = np.array([feature.xyz_m for feature in features])
    found: dict[int, tuple[float, int]] = {}
    for a, b in zip(*near_pairs(places[certain, :2], places[unseen, :2], _WIDEST_BASE_M), strict=True):
        kept, other = certain[a], unseen[b]
        distance_m = float(np.hypot(*(places[kept] - places[other])[:2]))
        base_m = WIDTH_OVER_HEIGHT * min(features[kept].cone_height_m, features[other].cone_height_m)
        if distance_m < base_m:
            found[other] = min(found.get(other, (distance_m, kept)), (distance_m, kept))
    return {other: kept for other, (_, kept) in found.items()}


def _halves(
    placed: Floats,
    tracks: Sequence[Track],
    free_tracks: Sequence[int],
    features: Sequence[MapFeature],
    pairs: Mapping[int, int],
    params: ReconcileParams,
) -> dict[int, int]:
    """Track index -> feature index of cones that are half of a feature: it lies in the middle between this track and its own, and
    one image shows both."""
    if not free_tracks or not pairs:
        return {}
    seen_features = sorted(pairs)
    own_m = placed[[pairs[j] for j in seen_features], :2]
    found: dict[int, int] = {}
    for b, a in zip(*near_pairs(placed[list(free_tracks), :2], own_m, 2 * params.min_gate_m), strict=True):
        i, j = free_tracks[b], seen_features[a]
        own = tracks[pairs[j]]
        apart_m = float(np.hypot(*(placed[i] - placed[pairs[j]])[:2]))
        off_m = float(np.hypot(*((placed[i] + placed[pairs[j]]) / 2 - np.array(features[j].xyz_m))[:2]))
        base_m = WIDTH_OVER_HEIGHT * min(tracks[i].cone_height_m, own.cone_height_m)
        together = not {frame for frame, _ in tracks[i].members}.isdisjoint(frame for frame, _ in own.members)
        if apart_m >= base_m and off_m <= _MIDDLE_SHARE * apart_m and together and j not in found.values():
            found.setdefault(i, j)
    return found


def height_differs(feature: MapFeature, track: Track, params: ReconcileParams) -> bool:
    """Whether another cone stands there now."""
    sigma_m = hypot(feature.cone_height_sigma_m, track.cone_height_sigma_m)
    difference_m = abs(track.cone_height_m - feature.cone_height_m)
    return difference_m > max(params.moved_height_tolerance_m, 3 * sigma_m)


def _added(track: Track, placed: Floats, shift: Floats, founding_key: str, half_of: UUID | None) -> Delta:
    # The first sighting is in no other track of the drive, and does not depend on how tracks are numbered.
    frame, match = track.members[0]
    feature_id = uuid5(_NAMESPACE, f"{founding_key}/{frame}/{match}")
    evidence = seen(None, None, track)
    return Delta(
        kind=DeltaKind.ADDED if half_of is None else DeltaKind.SPLIT,
        feature_id=feature_id,
        old=None,
        new=feature_from_track(track, placed, shift, feature_id, 1, evidence),
        track_index=track.track_index,
        changed_at_ns=track.first_seen_ns,
        shift_m=None,
        other_feature_id=half_of,
        evidence=evidence,
    )


def _removed(feature: MapFeature, doubt: Doubt | None, look: Look, evidence: SightingEvidence) -> Delta:
    """Gone from the first of the looks that missed it on: of this drive, or of an earlier one that was not enough by itself."""
    first_ns = look.first_ns if doubt is None else min(doubt.first_missed_ns, look.first_ns)
    return Delta(
        kind=DeltaKind.REMOVED,
        feature_id=feature.feature_id,
        old=feature,
        new=None,
        track_index=None,
        changed_at_ns=max(first_ns, feature.last_seen_ns + 1),
        shift_m=None,
        evidence=evidence,
    )


def _missed(feature: MapFeature, look: Look, evidence: SightingEvidence) -> Delta:
    return Delta(
        kind=DeltaKind.MISSED,
        feature_id=feature.feature_id,
        old=feature,
        new=feature,
        track_index=None,
        changed_at_ns=look.first_ns,
        shift_m=None,
        evidence=evidence,
    )


def _merged(feature: MapFeature, kept: MapFeature, track: Track) -> Delta:
    return Delta(
        kind=DeltaKind.MERGED,
        feature_id=feature.feature_id,
        old=feature,
        new=None,
        track_index=None,
        changed_at_ns=max(track.first_seen_ns, feature.last_seen_ns + 1),
        shift_m=None,
        other_feature_id=kept.feature_id,
    )


def _moved_before(old: MapFeature, confirmed: Delta) -> list[Delta]:
    """A cone that an earlier drive took for a new one, having looked at its new place only: what it founded is given up again."""
    given_up, state = confirmed.old, confirmed.new
    if given_up is None or state is None:
        raise ValueError(f"the confirmation of feature {confirmed.feature_id} has an old and a new side")
    new = state.model_copy(
        update={
            "feature_id": old.feature_id,
            "version": old.version + 1,
            "first_seen_ns": old.first_seen_ns,
            "observation_count": old.observation_count + state.observation_count,
        }
    )
    shift_m = float(np.hypot(*(np.array(new.xyz_m) - np.array(old.xyz_m))[:2]))
    moved = {"kind": DeltaKind.MOVED, "feature_id": old.feature_id, "old": old, "new": new, "shift_m": shift_m}
    merged = Delta(
        kind=DeltaKind.MERGED,
        feature_id=given_up.feature_id,
        old=given_up,
        new=None,
        track_index=None,
        changed_at_ns=max(confirmed.changed_at_ns, given_up.last_seen_ns + 1),
        shift_m=None,
        other_feature_id=old.feature_id,
    )
    return [confirmed.model_copy(update=moved), merged]
