"""Tracks of a drive that is being recorded: one frame pair at a time, in bounded memory.

Differences from `fuse_tracks`: poses are the logged ones; an ended group is joined only by a group that begins (two long
fragments of one cone remain two); only the nearest positions of a group and the last images are used; the road surface is not
checked. The later ingest of the whole drive replaces all results.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from conetl.geometry.packing import cov_matrix
from conetl.geometry.rig import map_SE3_left
from conetl.model.arrays import Floats
from conetl.model.detector_evidence import DetectorEvidence
from conetl.model.drive import Detection, FramePair, Position, StereoMatch, Track
from conetl.model.params import IngestParams
from conetl.model.rejections import Rejection
from conetl.model.rig import Rig
from conetl.tracking.association import CameraMotion, Chain, extend_chains, misfit_of
from conetl.tracking.tracks import BoxKey, boxes_in_use, drive_data, fuse_group

#: Number of frames that are kept.
KEPT_FRAMES = 400
#: Nearest positions of a group that are adjusted together; last frame pairs of the drive that count for its existence.
_MOST_MEMBERS, _LAST_FRAMES = 8, 8


@dataclass(frozen=True)
class LiveFrame:
    """One frame pair with its detections, matches and positions."""

    pair: FramePair
    detections: tuple[Detection, ...]
    matches: tuple[StereoMatch, ...]
    positions: tuple[Position, ...]


@dataclass(frozen=True)
class LiveTracks:
    """State of a drive so far. Frames are those kept, by frame index."""

    frames: Mapping[int, LiveFrame] = field(default_factory=dict)
    poses: Mapping[int, Floats] = field(default_factory=dict)
    """(4, 4) left camera -> map of these frames."""
    open_chains: tuple[Chain, ...] = ()
    ended: tuple[tuple[Position, ...], ...] = ()
    numbers: Mapping[tuple[int, int], int] = field(default_factory=dict)
    """Number of a track by the (frame, match) of its first position; constant during the drive."""


def add_frame(
    tracks: LiveTracks, frame: LiveFrame, rig: Rig, params: IngestParams, evidence: DetectorEvidence
) -> tuple[LiveTracks, dict[int, Track | Rejection]]:
    """The state after one more frame pair, and the tracks that it changed, by number, or their rejections.

    Raises ValueError for a frame index that does not rise.
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
    camera = CameraMotion(poses, params.track)
    chains = extend_chains(living, frame.positions, now, camera)
    chains = [_joined(chain, ended, camera) if len(chain.members) == 1 else chain for chain in chains]
    chains = [_recent(chain, poses) for chain in chains]
    numbers = dict(tracks.numbers)
    matches = {(match.frame_index, match.match_index): match for f in frames.values() for match in f.matches}

    def boxes_of(*groups: Sequence[Position]) -> set[BoxKey]:
        kept = ([p for p in group if p.frame_index in frames] for group in groups)
        return boxes_in_use(kept, matches, params.track)

    in_use = boxes_of(*(chain.members for chain in chains), *ended)
    changed: dict[int, Track | Rejection] = {}
    for chain in chains:
        if chain.members[-1].frame_index != now:
            continue
        first = chain.members[0]
        number = numbers.setdefault((first.frame_index, first.match_index), len(numbers))
        if len(chain.members) >= params.track.min_observations:
            # Only its nearest positions are adjusted, but all of its boxes are its own.
            others = in_use - boxes_of(chain.members)
            changed[number] = _fused(number, chain, frames, rig, params, evidence, others)
    return LiveTracks(frames, poses, tuple(chains), tuple(ended), numbers), changed


def _recent(chain: Chain, poses: Mapping[int, Floats]) -> Chain:
    """The chain without positions of dropped frames, except its first one, which identifies it."""
    first, *others = chain.members
    kept = (first, *(p for p in others if p.frame_index in poses))
    return chain if len(kept) == len(chain.members) else Chain(kept, chain.mean, chain.cov)


def _joined(chain: Chain, ended: list[tuple[Position, ...]], camera: CameraMotion) -> Chain:
    """A new chain appended to the ended group that it fits best, if any; that group is removed from `ended`."""
    misfits = []
    for i, group in enumerate(ended):
        recent = tuple(p for p in group if p.frame_index in camera.map_SE3_left)
        if (misfit := misfit_of(recent, chain.members, camera)) is not None:
            misfits.append((misfit, i))
    if not misfits:
        return chain
    group = ended.pop(min(misfits)[1])
    (position,) = chain.members
    return Chain((*group, position), np.array(position.camera_xyz_m), cov_matrix(position.camera_cov_m2))


def _fused(
    number: int,
    chain: Chain,
    frames: Mapping[int, LiveFrame],
    rig: Rig,
    params: IngestParams,
    evidence: DetectorEvidence,
    others: Collection[BoxKey],
) -> Track | Rejection:
    members = [p for p in chain.members if p.frame_index in frames]
    nearest = sorted(members, key=lambda p: p.range_m)[:_MOST_MEMBERS]
    group = tuple(sorted(nearest, key=lambda p: p.frame_index))
    used = [frames[n] for n in sorted({p.frame_index for p in group} | set(sorted(frames)[-_LAST_FRAMES:]))]
    detections = [d for f in used for d in f.detections]
    matches = [m for f in used for m in f.matches]
    data = drive_data([f.pair for f in used], rig, detections, matches, params, evidence)
    track = fuse_group(number, group, data, others)
    if isinstance(track, Rejection):
        return track
    first, last = (frames[p.frame_index].pair.captured_at_ns for p in (members[0], members[-1]))
    return track.model_copy(update={"observation_count": len(members), "first_seen_ns": first, "last_seen_ns": last})
