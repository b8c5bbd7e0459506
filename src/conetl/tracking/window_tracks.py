"""Tracks of a drive that is being recorded: `fuse_tracks` over its last frame pairs, with numbers that stay the same.

Objects that have left these frame pairs stand as they were last fused.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from itertools import chain
from math import dist
from typing import NamedTuple

from conetl.geometry.packing import horizontal_sigma_m
from conetl.model.detector_evidence import DetectorEvidence
from conetl.model.drive import Detection, FramePair, Position, StereoMatch, Track
from conetl.model.params import IngestParams
from conetl.model.rig import Rig
from conetl.tracking.tracks import drive_data, fuse_tracks

#: Number of frame pairs: as many as a track may be unobserved (`max_gap_frames`). Fusing costs its length.
WINDOW_PAIRS = 12


class ObservedPair(NamedTuple):
    """One frame pair with what was found in it."""

    pair: FramePair
    detections: Collection[Detection]
    matches: Collection[StereoMatch]
    positions: Collection[Position]


@dataclass(frozen=True)
class WindowTracks:
    """The last frame pairs of a drive, and all its tracks so far."""

    window: tuple[ObservedPair, ...] = ()
    number_of: Mapping[tuple[int, int], int] = field(default_factory=dict)
    """Number of the track of each (frame, match) in the window."""
    standing: Mapping[int, Track] = field(default_factory=dict)
    """Tracks by number, with all their members."""
    last_number: int = -1
    """Greatest number so far."""


def add_pair(
    tracks: WindowTracks, observed: ObservedPair, rig: Rig, params: IngestParams, evidence: DetectorEvidence
) -> tuple[WindowTracks, set[int]]:
    """The tracks after one more frame pair, and the numbers of those that it adds, changes or takes back.

    Only objects with a position in this pair are fused. A track is taken back when all its members were fused, so that none has
    left the window, but no track has its number.
    """
    window = (*tracks.window, observed)[-WINDOW_PAIRS:]
    if not observed.positions:
        return replace(tracks, window=window), set()
    pairs, detections, matches, positions = zip(*window, strict=True)
    boxes, points = chain.from_iterable(detections), chain.from_iterable(matches)
    data = drive_data(pairs, rig, boxes, points, params, evidence)
    now, first = observed.pair, pairs[0]
    found, rejected = fuse_tracks(list(chain.from_iterable(positions)), data, seen_in=now.frame_index)
    numbered: dict[int, Track] = {}
    for track in sorted(found, key=lambda track: -len(track.members)):
        number = _number_of(track, tracks, numbered, first, params.reconcile.min_gate_m)
        numbered[number] = _with_past(track, tracks.standing.get(number, track), first)
    fused = {member for track in found for member in track.members}
    fused |= {(frame, match) for one in rejected for frame, match in one.payload["members"]}
    earlier = tracks.standing.items()
    taken_back = {n for n, track in earlier if n not in numbered and fused.issuperset(track.members)}
    standing = {n: track for n, track in earlier if n not in taken_back} | numbered
    number_of = {member: n for member, n in tracks.number_of.items() if member[0] >= first.frame_index}
    number_of |= {member: n for n, track in numbered.items() for member in track.members}
    last_number = max([tracks.last_number, *numbered])
    return WindowTracks(window, number_of, standing, last_number), numbered.keys() | taken_back


def _number_of(track: Track, tracks: WindowTracks, taken: Collection[int], first: FramePair, gate_m: float) -> int:
    """Number of the earlier track that shares most members with this one; else, if the object was hidden for longer than the
    window, of the nearest one that has left it, within `gate_m` and three sigmas; else a new one. taken: numbers of others."""
    shared = Counter(tracks.number_of[member] for member in track.members if member in tracks.number_of)
    if own := [number for number, _ in shared.most_common() if number not in taken]:
        return own[0]
    beyond_m = {
        n: dist(t.xyz_m[:2], track.xyz_m[:2]) - gate_m - 3 * horizontal_sigma_m(t.relative_cov_m2)
        for n, t in tracks.standing.items() if n not in taken and t.last_seen_ns < first.captured_at_ns
    }  # fmt: skip
    nearest = min(beyond_m, key=beyond_m.__getitem__, default=-1)
    return nearest if beyond_m.get(nearest, 1.0) <= 0 else max([tracks.last_number, *taken]) + 1


def _with_past(track: Track, before: Track, first: FramePair) -> Track:
    """The track with its observations that have left the window."""
    past = tuple(member for member in before.members if member[0] < first.frame_index)
    if not past:
        return track
    members = past + track.members
    update = {"members": members, "observation_count": len(members), "first_seen_ns": before.first_seen_ns}
    return track.model_copy(update=update)
