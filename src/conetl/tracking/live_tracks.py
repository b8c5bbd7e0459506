"""Tracks of a drive that goes on: one frame pair at a time, in bounded memory, by the functions for tracks of whole drives.

What differs from `fuse_tracks`: poses are the logged ones; a group of positions that ended is joined only by one that begins (two
long fragments of one cone stay two); of a group its nearest positions take part, and of the images the last ones and its own;
whether it stands on the road like the others is not asked. The ingest of the whole drive replaces all of it.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from conetl.geometry.packing import cov_matrix
from conetl.geometry.rig import map_SE3_left, map_SE3_right
from conetl.model.detector_evidence import DetectorEvidence
from conetl.model.params import IngestParams
from conetl.model.records import Detection, FramePair, Position, Rig, StereoMatch, Track
from conetl.model.rejections import Rejection
from conetl.tracking.association import Chain, extend_chains, misfit_of
from conetl.tracking.tracks import BoxKey, boxes_in_use, fuse_group

Floats = NDArray[np.float64]
#: What is older takes part in nothing any more.
KEPT_FRAMES = 400
#: Of a group, the nearest positions that are adjusted together; of the drive, the last frame pairs that say whether it exists.
_MOST_MEMBERS, _LOOKED_FRAMES = 8, 8


@dataclass(frozen=True)
class Frame:
    """One frame pair and what was found in it."""

    pair: FramePair
    detections: tuple[Detection, ...]
    matches: tuple[StereoMatch, ...]
    positions: tuple[Position, ...]


@dataclass(frozen=True)
class LiveTracks:
    """What is known of a drive so far. Frames are those kept, by frame index."""

    frames: Mapping[int, Frame] = field(default_factory=dict)
    poses: Mapping[int, Floats] = field(default_factory=dict)
    """(4, 4) left camera -> map of these frames."""
    open_chains: tuple[Chain, ...] = ()
    ended: tuple[tuple[Position, ...], ...] = ()
    numbers: Mapping[tuple[int, int], int] = field(default_factory=dict)
    """Number of a track by the (frame, match) of its first position; it stays the same for the whole drive."""


def add_frame(
    tracks: LiveTracks, frame: Frame, rig: Rig, params: IngestParams, evidence: DetectorEvidence
) -> tuple[LiveTracks, dict[int, Track | Rejection]]:
    """The tracks after one more frame pair, and those that it changed, by number: as they are now, or why they are none (yet).

    Frame pairs must come by rising frame index.
    """
    now = frame.pair.frame_index
    if tracks.frames and now <= max(tracks.frames):
        raise ValueError(f"frame pair {now} comes after {max(tracks.frames)}: expected rising numbers")
    gap = params.track.max_gap_frames
    oldest = now - max(KEPT_FRAMES, gap + 1)
    frames = {n: f for n, f in tracks.frames.items() if n > oldest} | {now: frame}
    poses = {n: tracks.poses[n] for n in frames if n != now} | {now: map_SE3_left(frame.pair.pose, rig)}
    living = [c for c in tracks.open_chains if now - c.members[-1].frame_index <= gap]
    ended = [c.members for c in tracks.open_chains if now - c.members[-1].frame_index > gap]
    ended = [g for g in (*tracks.ended, *ended) if g[-1].frame_index in poses]
    chains = extend_chains(living, frame.positions, now, poses, params.track, None)
    chains = [_revived(chain, ended, poses, params) if len(chain.members) == 1 else chain for chain in chains]
    chains = [_recent(chain, poses) for chain in chains]
    numbers = dict(tracks.numbers)
    matches = _by_number(frames.values())

    def boxes_of(*groups: Sequence[Position]) -> set[BoxKey]:
        kept = ([p for p in group if p.frame_index in frames] for group in groups)
        return boxes_in_use(kept, matches, params.track)

    in_use = boxes_of(*(chain.members for chain in chains), *ended)
    changed: dict[int, Track | Rejection] = {}
    for chain in chains:
        if chain.members[-1].frame_index != now:
            continue
        number = numbers.setdefault(_name(chain), len(numbers))
        if len(chain.members) >= params.track.min_observations:
            # Only its nearest positions are adjusted, but all of its boxes are its own.
            others = in_use - boxes_of(chain.members)
            changed[number] = _fused(number, chain, frames, rig, params, evidence, others)
    return LiveTracks(frames, poses, tuple(chains), tuple(ended), numbers), changed


def _name(chain: Chain) -> tuple[int, int]:
    return chain.members[0].frame_index, chain.members[0].match_index


def _recent(chain: Chain, poses: Mapping[int, Floats]) -> Chain:
    """The chain without positions of frames that are forgotten, but for its first one, which is its name."""
    first, *others = chain.members
    kept = (first, *(p for p in others if p.frame_index in poses))
    return chain if len(kept) == len(chain.members) else Chain(kept, chain.mean, chain.cov)


def _revived(
    chain: Chain, ended: list[tuple[Position, ...]], poses: Mapping[int, Floats], params: IngestParams
) -> Chain:
    """A chain that has just begun, put behind the ended group that it fits best, if any; that one leaves `ended`."""
    found = [
        (misfit, i)
        for i, group in enumerate(ended)
        if (
            misfit := misfit_of(
                tuple(p for p in group if p.frame_index in poses), chain.members, poses, params.track, None
            )
        )
        is not None
    ]
    if not found:
        return chain
    group = ended.pop(min(found)[1])
    (position,) = chain.members
    return Chain((*group, position), np.array(position.camera_xyz_m), cov_matrix(position.camera_cov_m2))


def _by_number(frames: Iterable[Frame]) -> dict[tuple[int, int], StereoMatch]:
    return {(match.frame_index, match.match_index): match for frame in frames for match in frame.matches}


def _fused(
    number: int,
    chain: Chain,
    frames: Mapping[int, Frame],
    rig: Rig,
    params: IngestParams,
    evidence: DetectorEvidence,
    others: Collection[BoxKey],
) -> Track | Rejection:
    members = [p for p in chain.members if p.frame_index in frames]
    nearest = sorted(members, key=lambda p: p.range_m)[:_MOST_MEMBERS]
    group: Sequence[Position] = sorted(nearest, key=lambda p: p.frame_index)
    used = {p.frame_index for p in group} | set(sorted(frames)[-_LOOKED_FRAMES:])
    shown = {n: frames[n] for n in sorted(used)}
    track = fuse_group(
        number,
        tuple(group),
        _by_number(shown.values()),
        {n: f.detections for n, f in shown.items()},
        {n: f.pair for n, f in shown.items()},
        rig,
        {n: map_SE3_left(f.pair.pose, rig) for n, f in shown.items()},
        {n: map_SE3_right(f.pair.pose, rig) for n, f in shown.items()},
        params,
        evidence,
        None,
        others,
    )
    if isinstance(track, Rejection):
        return track
    first, last = (frames[p.frame_index].pair.captured_at_ns for p in (members[0], members[-1]))
    seen = {"observation_count": len(members), "first_seen_ns": first, "last_seen_ns": last}
    return track.model_copy(update=seen)
