"""Tracks of one drive against the map -> deltas; docs/explanation/changes.md has the rules of each kind.

The drive's common offset is estimated from all shared cones and subtracted, then tracks and features are paired one-to-one
(`association.py`). A feature without a track whose location was visible is missed, and removed if its existence probability
becomes low enough (`existence_update.py`). A vanished feature and a new track of similar height nearby are one moved cone.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from math import hypot, sqrt
from operator import attrgetter
from uuid import UUID

import numpy as np

from conetl.mapping.association import (
    Comparison,
    common_offset,
    match_moved,
    match_moved_earlier,
    match_unmoved,
    near_pairs,
    xyz_of,
)
from conetl.mapping.deltas import (
    ReconcileContext,
    confirm_features,
    end_feature,
    exceeding,
    miss_or_remove,
    move_and_merge,
    new_feature,
    update_feature,
)
from conetl.mapping.existence_update import is_gone, miss_evidence, sighting_evidence
from conetl.mapping.fusion import tracks_in_map_frame
from conetl.mapping.visibility import NotObserved, VisibilityCheck
from conetl.model.drive import Track
from conetl.model.feature_classes import mutually_exclusive, width_over_height
from conetl.model.map_records import Delta, DeltaKind, ExistenceEvidence, MapFeature
from conetl.model.params import ReconcileParams

#: A feature this near to the midpoint of two tracks (as a share of their distance) was a mixture of both.
_MIDDLE_SHARE = 0.25
#: Wider than the base plate of any cone.
_WIDEST_BASE_M = 1.0


def reconcile(
    tracks: Sequence[Track],
    features: Sequence[MapFeature],
    check_visibility: VisibilityCheck,
    context: ReconcileContext,
) -> list[Delta]:
    """Deltas from the map before the drive to the map after it; the order of tracks and features does not matter.

    features: the map after all drives that were recorded before this one.
    """
    params, founding_key, pinned, contradiction = context
    tracks = _drop_duplicates(sorted(tracks, key=lambda track: track.members[0]))
    features = sorted(features, key=attrgetter("feature_id.int"))
    apart_m, excess_m2 = np.zeros(3), None
    if contradiction is None:
        offset_m, weight = common_offset(tracks, features, params)
    else:  # the drive is compared where the map has its cones, but not moved there
        offset_m, weight, apart_m, excess_m2 = np.zeros(3), 0.0, contradiction.offset_m, contradiction.excess_m2
    shift_m = weight * offset_m
    map_xyz_m = xyz_of(tracks) - shift_m
    comparison = Comparison(tracks, features, map_xyz_m - apart_m, params)
    pairs = match_unmoved(comparison, offset_m, weight)
    merged = _find_mergers(comparison, pairs, pinned)
    deltas = [
        end_feature(
            DeltaKind.MERGED,
            features[j],
            tracks[pairs[kept]].first_seen_ns,
            merged_into=features[kept].feature_id,
        )
        for j, kept in merged.items()
    ]

    paired = set(pairs.values())
    free = _new_features(tracks, paired, params)
    others_m = xyz_of([tracks[i] for i in sorted(paired.union(free))])
    unobserved: dict[int, tuple[NotObserved, ExistenceEvidence]] = {}
    for j, feature in enumerate(features):
        absence = None if j in pairs or j in merged else check_visibility(feature, shift_m + apart_m, others_m)
        if absence is not None:
            unobserved[j] = absence, miss_evidence(feature, absence, params)
    loose = {j: evidence for j, (_, evidence) in unobserved.items() if features[j].feature_id not in pinned}
    vanished = [j for j, evidence in loose.items() if is_gone(evidence, params, moved=True)]

    moved = match_moved(comparison, free, vanished)
    free = sorted(set(free).difference(moved.values()))
    halves = _find_splits(comparison, free, pairs)
    evidence_for = {j: sighting_evidence(features[j], tracks[i]) for j, i in {**pairs, **moved}.items()}
    renewed = dict.fromkeys(moved, DeltaKind.MOVED)
    renewed |= dict.fromkeys(halves.values(), DeltaKind.CONFIRMED)  # its position was the mean of both cones
    for j, i in pairs.items():
        if features[j].feature_id not in pinned and height_differs(features[j], tracks[i], params):
            renewed[j] = DeltaKind.HEIGHT_CHANGED
    as_before = {j: i for j, i in pairs.items() if j not in renewed}
    track_of = pairs | moved
    own = tracks_in_map_frame([*free, *(track_of[j] for j in renewed)], tracks, features, pairs, weight)
    own = {i: exceeding(track, excess_m2) for i, track in own.items()}
    loose_pairs = {j: i for j, i in as_before.items() if features[j].feature_id not in pinned}
    left = [j for j in vanished if j not in moved]
    moved_to = match_moved_earlier(comparison, loose_pairs, left)
    feature_by_id = {features[k].feature_id: features[j] for j, k in moved_to.items()}
    for delta in confirm_features(as_before, features, tracks, evidence_for, excess_m2):
        old = feature_by_id.get(delta.feature_id)
        deltas += [delta] if old is None else move_and_merge(old, delta)
    for j, kind in renewed.items():
        i = track_of[j]
        deltas.append(update_feature(kind, features[j], own[i], map_xyz_m[i], shift_m, evidence_for[j]))
    for j, (absence, evidence) in unobserved.items():
        if j in moved or j in moved_to:
            continue
        gone = j in loose and is_gone(evidence, params)
        deltas.append(miss_or_remove(features[j], absence.first_ns, evidence, gone=gone))
    for i in free:
        half_of = features[halves[i]].feature_id if i in halves else None
        deltas.append(new_feature(own[i], map_xyz_m[i], shift_m, founding_key, half_of))
    return sorted(deltas, key=attrgetter("changed_at_ns", "feature_id.int"))


def height_differs(feature: MapFeature, track: Track, params: ReconcileParams) -> bool:
    """Whether the track shows another cone at the feature's position."""
    sigma_m = hypot(feature.object_height_sigma_m, track.object_height_sigma_m)
    difference_m = abs(track.object_height_m - feature.object_height_m)
    return difference_m > max(params.moved_height_tolerance_m, 3 * sigma_m)


def _base_width_m(a: Track | MapFeature, b: Track | MapFeature) -> float:
    """Width of the smaller of two objects."""
    return min(width_over_height(one.category) * one.object_height_m for one in (a, b))


def _drop_duplicates(tracks: Sequence[Track]) -> list[Track]:
    """The tracks without those whose base plates overlap that of a track with more observations.

    A duplicate is a second box of the detector or a fragment of the same chain.
    """
    xy_m = xyz_of(tracks)[:, :2]
    weight = [(track.observation_count, track.existence_probability, -i) for i, track in enumerate(tracks)]
    doubles = set()
    near = np.column_stack(near_pairs(xy_m, xy_m, _WIDEST_BASE_M))
    for a, b in near[near[:, 0] != near[:, 1]].tolist():
        overlap = float(np.hypot(*(xy_m[a] - xy_m[b]))) < _base_width_m(tracks[a], tracks[b])
        if overlap and weight[a] > weight[b] and mutually_exclusive(tracks[a].category, tracks[b].category):
            doubles.add(b)
    return [track for i, track in enumerate(tracks) if i not in doubles]


def _new_features(tracks: Sequence[Track], paired: Collection[int], params: ReconcileParams) -> list[int]:
    """The unpaired tracks that become new features: certain enough, and clearly separate from every track with more observations.

    Far cones are located poorly along the line of sight, so that a second box of one cone may give a track beside it. A track is
    left to later, nearer drives while its base plate, moved by one sigma, would overlap that of a track with more observations.
    """
    sure = params.founding_existence_probability
    free = [i for i, track in enumerate(tracks) if i not in paired and track.existence_probability >= sure]
    xy_m = xyz_of(tracks)[:, :2]
    doubtful = set()
    for a, k in zip(*near_pairs(xy_m[free], xy_m, 2 * _WIDEST_BASE_M), strict=True):
        i = free[a]
        one_kind = mutually_exclusive(tracks[k].category, tracks[i].category)
        if tracks[k].observation_count <= tracks[i].observation_count or not one_kind:
            continue
        apart = xy_m[i] - xy_m[k]
        apart_m = float(np.hypot(*apart))
        xx, xy, _, yy, *_ = np.add(tracks[i].relative_cov_m2, tracks[k].relative_cov_m2).tolist()
        x, y = (apart / max(apart_m, 1e-9)).tolist()
        sigma_m = sqrt(max(x * x * xx + 2 * x * y * xy + y * y * yy, 0.0))
        if apart_m - sigma_m < _base_width_m(tracks[i], tracks[k]):
            doubtful.add(i)
    return [i for i in free if i not in doubtful]


def _find_mergers(comparison: Comparison, pairs: Mapping[int, int], pinned: Collection[UUID]) -> dict[int, int]:
    """Unobserved feature -> the nearest observed one whose base plate overlaps its own: both are one cone."""
    features = comparison.features
    certain = [
        j
        for j in sorted(pairs)
        if comparison.tracks[pairs[j]].observation_count >= comparison.params.removal_min_frames
    ]
    unseen = [j for j, feature in enumerate(features) if j not in pairs and feature.feature_id not in pinned]
    xyz_m = xyz_of(features)
    found: dict[int, tuple[float, int]] = {}
    for a, b in zip(*near_pairs(xyz_m[certain, :2], xyz_m[unseen, :2], _WIDEST_BASE_M), strict=True):
        kept, other = certain[a], unseen[b]
        distance_m = float(np.hypot(*(xyz_m[kept] - xyz_m[other])[:2]))
        if features[kept].category == features[other].category and distance_m < _base_width_m(
            features[kept], features[other]
        ):
            found[other] = min(found.get(other, (distance_m, kept)), (distance_m, kept))
    return {other: kept for other, (_, kept) in found.items()}


def _find_splits(comparison: Comparison, free_tracks: Sequence[int], pairs: Mapping[int, int]) -> dict[int, int]:
    """Track index -> index of the feature that turns out to be two cones, one of them this track.

    The feature lies midway between this track and its own one, and one image shows both cones.
    """
    tracks, features, map_xyz_m, params = comparison
    paired_features = sorted(pairs)
    own_m = map_xyz_m[[pairs[j] for j in paired_features], :2]
    found: dict[int, int] = {}
    for b, a in zip(*near_pairs(map_xyz_m[list(free_tracks), :2], own_m, 2 * params.min_gate_m), strict=True):
        i, j = free_tracks[b], paired_features[a]
        own = tracks[pairs[j]]
        apart_m = float(np.hypot(*(map_xyz_m[i] - map_xyz_m[pairs[j]])[:2]))
        off_m = float(np.hypot(*((map_xyz_m[i] + map_xyz_m[pairs[j]]) / 2 - np.array(features[j].xyz_m))[:2]))
        together = not {frame for frame, _ in tracks[i].members}.isdisjoint(frame for frame, _ in own.members)
        beside = (
            tracks[i].category == own.category
            and apart_m >= _base_width_m(tracks[i], own)
            and off_m <= _MIDDLE_SHARE * apart_m
        )
        if beside and together and j not in found.values():
            found.setdefault(i, j)
    return found
