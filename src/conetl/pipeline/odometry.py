"""Steps that refine poses and calibration: visual odometry, self-calibration, and one adjustment of the whole trajectory."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from functools import lru_cache
from itertools import tee
from math import ceil
from pathlib import Path
from typing import NamedTuple

import numpy as np

from conetl.files.parquet_store import has_result, load_result, load_results, result_key, result_path, save_result
from conetl.geometry.linear_reference import evenly_spread
from conetl.geometry.motion.stereo_motion import RelativeMotion
from conetl.geometry.motion.stereo_tracks import StereoTracks, cameras_of, motions_between, motions_of
from conetl.model.arrays import Image
from conetl.model.drive import Drive, FramePair
from conetl.model.health import HealthCheck
from conetl.model.params import IngestParams, TrajectoryParams, params_sha256
from conetl.model.rejections import Rejection
from conetl.model.rig import SIDES, Rig, Side
from conetl.perception.rectified_image import fetch_pairs, read_pair_image
from conetl.perception.stereo_check import check_lost_parts
from conetl.perception.torn_images import check_torn, find_torn
from conetl.perception.visual_odometry import follow_drive, follow_spans
from conetl.perception.worker_setup import set_up_worker
from conetl.perception.working_size import ImageReader
from conetl.pipeline.chunks import RESULTS_VERSION, Chunk, geometry_key, load_matches, parts_of
from conetl.pipeline.executor import Tick, ignore
from conetl.tracking.checks.exposures import check_lost_frames, right_camera_ahead
from conetl.tracking.checks.foreign_images import check_recording
from conetl.tracking.checks.poses import check_trajectory
from conetl.tracking.control_points import refine_with_control
from conetl.tracking.self_calibration import SelfCalibration, Span, choose_spans, span_params
from conetl.tracking.self_calibration import self_calibrate as estimate_calibration
from conetl.tracking.trajectory import RefinedTrajectory, is_by_course
from conetl.tracking.upright_edges import with_roll

_log = logging.getLogger(__name__)
_PAIRS_AT_ONCE = 8
#: Some spans cannot be followed, and parts end within one.
_SPARE = 1.25
#: Half of a shorter chunk may be shorter than a span: at 10 Hz and 2.5 m/s or less.
_SHORT_CHUNK_PAIRS = 16


def moved(chunks: Sequence[Chunk], drive: Drive) -> list[Chunk]:
    """The chunks of a drive with its rig, its frame pairs and their poses as refined."""
    pairs = {pair.frame_index: pair for pair in drive.frame_pairs}
    return [
        chunk.model_copy(
            update={
                "rig": drive.rig,
                "frame_pairs": tuple(pairs[p.frame_index] for p in chunk.frame_pairs if p.frame_index in pairs),
            }
        )
        for chunk in chunks
    ]


class Odometry(NamedTuple):
    """Parquet files of one part of a chunk."""

    tracks: Path
    """Points followed between its frame pairs, and to the first one after it ..."""
    motions: Path
    """... and the motions that they tell."""


def odometry(chunk: Chunk, part: int, tick: Tick | None = None) -> Odometry:
    """Points followed in one of the parts of a chunk, also over spans of self-calibration, and its motions by the chunk's rig.

    tick: called for every motion.
    """
    own, params, folder = _part(chunk, part), chunk.params.trajectory, chunk.results_folder
    pairs, rig = own.frame_pairs, chunk.rig
    key = _spans_key(_tracks_key(own))
    if has_result(folder, key):
        (tick or ignore)(len(pairs) - 1)
    else:
        set_up_worker()
        # One after the other: a span ends at the pair that was followed last, whose decoded images it gets.
        read = lru_cache(maxsize=len(SIDES))(grey_reader(rig, pairs))
        tracks, all_tracks = tee(_followed(own, read, tick))
        moves, all_moves = tee(motions_of(tracks, pairs, rig, params))
        spans = choose_spans(moves, params.self_calibration_span_m)
        found = list(follow_spans(spans, pairs, rig, read, span_params(params)))
        save_result(folder, _tracks_key(own), list(all_tracks), [])
        save_result(folder, _motions_key(own, rig), list(all_moves), [])
        save_result(folder, key, found, [])
    return motions(chunk, part, rig)


def follow(chunk: Chunk, part: int, tick: Tick | None = None) -> Iterator[None]:
    """Follow points in one of the parts of a chunk, from one frame pair to the next at each step; the end stores them."""
    own = _part(chunk, part)
    key = _tracks_key(own)
    if has_result(chunk.results_folder, key):
        (tick or ignore)(len(own.frame_pairs) - 1)
        return
    set_up_worker()
    found: list[StereoTracks] = []
    for tracks in _followed(own, grey_reader(own.rig, own.frame_pairs), tick):
        found.append(tracks)
        yield
    save_result(chunk.results_folder, key, found, [])


def motions(chunk: Chunk, part: int, rig: Rig, earlier: Odometry | None = None) -> Odometry:
    """Motions of one of the parts of a chunk from the points that were followed in it.

    chunk: with the rig by which points were followed; rig: the same after self-calibration. earlier: by the rig as it was, a
    start that spares the search.
    """
    own, folder = _part(chunk, part), chunk.results_folder
    tracks, key = _tracks_key(own), _motions_key(own, rig, earlier)
    if not has_result(folder, key):
        followed = load_result(result_path(folder, tracks), StereoTracks)[0]
        starts = load_result(earlier.motions, RelativeMotion)[0] if earlier else None
        found = motions_of(followed, own.frame_pairs, rig, chunk.params.trajectory, starts)
        save_result(folder, key, list(found), [])
    return Odometry(result_path(folder, tracks), result_path(folder, key))


def motions_again(parts: Sequence[tuple[Chunk, int]], rig: Rig, found: Sequence[Odometry]) -> list[Odometry]:
    """Motions by a drive's rig after self-calibration.

    One step for all parts: 3 ms per frame pair, and a task costs Prefect 40.
    """
    return [motions(chunk, part, rig, earlier) for (chunk, part), earlier in zip(parts, found, strict=True)]


def _part(chunk: Chunk, part: int) -> Chunk:
    """One of the parts of a chunk and the first frame pair after it, so that no interval between two is lost."""
    within = parts_of(chunk)[part]
    pairs = chunk.frame_pairs[within.start : within.stop + 1]
    if within.stop == len(chunk.frame_pairs) and chunk.next_pair is not None:
        pairs += (chunk.next_pair,)
    return chunk.model_copy(update={"frame_pairs": pairs})


def _followed(own: Chunk, read: ImageReader, tick: Tick | None) -> Iterator[StereoTracks]:
    """Points between the frame pairs of `_part`."""
    for tracks in follow_drive(own.frame_pairs, own.rig, read, own.params.trajectory):
        (tick or ignore)(1)
        yield tracks


def _tracks_key(own: Chunk) -> str:
    return result_key(RESULTS_VERSION, "tracks", params_sha256(own.params.trajectory), geometry_key(own))


def _spans_key(tracks_key: str) -> str:
    """Of points followed over spans of self-calibration."""
    return result_key("spans", tracks_key)


def _motions_key(own: Chunk, rig: Rig, earlier: Odometry | None = None) -> str:
    start = earlier.motions.stem if earlier else "none"
    params = params_sha256(own.params.trajectory)
    return result_key(RESULTS_VERSION, "motions", _tracks_key(own), params, geometry_key(own, rig), start)


def parts_to_follow(parts: Sequence[tuple[Chunk, int]], params: TrajectoryParams) -> list[int]:
    """Numbers of the parts of a drive that self-calibration needs: evenly spread, somewhat longer than all its spans.

    The length is that of the logged poses, so there may be fewer spans.
    """
    poses = [[pair.pose.map_t_body_m for pair in _part(*part).frame_pairs] for part in parts]
    length_m = sum(float(np.linalg.norm(np.diff(each, axis=0), axis=1).sum()) for each in poses if len(each) > 1)
    needed_m = _SPARE * params.self_calibration_span_m * params.self_calibration_max_spans
    count = ceil(len(parts) * min(needed_m / max(length_m, 1e-9), 1.0))
    return [round(k) for k in np.linspace(0, len(parts) - 1, count)]


def self_calibrate(chunk: Chunk, followed: Sequence[Odometry]) -> SelfCalibration:
    """What a drive says about its rig's calibration.

    chunk: any of the drive's, for rig, parameters and results folder. followed: `odometry` of parts of the drive, in its order.
    """
    params, folder = chunk.params.trajectory, chunk.results_folder
    key = result_key(RESULTS_VERSION, "self-calibrate", *(path.stem for each in followed for path in each))
    if has_result(folder, key):
        return load_result(result_path(folder, key), SelfCalibration)[0][0]
    spans: list[tuple[Span, StereoTracks]] = []
    for each in followed:
        chosen = choose_spans(load_result(each.motions, RelativeMotion)[0], params.self_calibration_span_m)
        points, _ = load_result(result_path(folder, _spans_key(each.tracks.stem)), StereoTracks)
        spans += zip(chosen, points, strict=True)
    found = _calibration(chunk.rig, evenly_spread(spans, params.self_calibration_max_spans), params)
    if len(spans) < params.self_calibration_min_spans and chunk.params.chunk_pairs < _SHORT_CHUNK_PAIRS:
        hint = f"a span lies within half a chunk, and chunk_pairs is {chunk.params.chunk_pairs} only"
        found = found.model_copy(update={"detail": f"{found.detail}; {hint}"})
    save_result(folder, key, [found], [])
    _log.info("Self-calibration: %s", found.detail)
    return found


def calibrate_drive(
    drive: Drive, params: TrajectoryParams, tracks: list[StereoTracks] | None = None
) -> SelfCalibration:
    """Self-calibration of a drive in one thread; tracks: of its intervals, where they are known already."""
    pairs, rig, read = drive.frame_pairs, drive.rig, grey_reader(drive.rig, drive.frame_pairs)
    followed = follow_drive(pairs, rig, read, params) if tracks is None else tracks
    chosen = list(choose_spans(motions_of(followed, pairs, rig, params), params.self_calibration_span_m))
    spans = evenly_spread(chosen, params.self_calibration_max_spans)
    wide = follow_spans(spans, pairs, rig, read, span_params(params))
    return _calibration(rig, list(zip(spans, wide, strict=True)), params)


def _calibration(rig: Rig, spans: Sequence[tuple[Span, StereoTracks]], params: TrajectoryParams) -> SelfCalibration:
    found = estimate_calibration(rig, [span for span, _ in spans], [tracks for _, tracks in spans], params)
    points = [tracks.points()[0] for _, tracks in spans if tracks.missing is None]
    return found.model_copy(update={"right_ahead": right_camera_ahead(cameras_of(rig), points)})


def refine(drive: Drive, motions: list[Path], matches: list[Path], params: IngestParams) -> RefinedTrajectory:
    """Refined poses of the whole drive; the logged ones, with the reason, where images or parameters do not allow it."""
    measured, _ = load_results(motions, RelativeMotion)
    pairs = drive.frame_pairs
    found, _ = load_matches(matches, pairs)
    params = params.model_copy(update={"trajectory": _by_its_clock(drive, params.trajectory)})
    if is_by_course(pairs):
        pairs = with_roll(pairs, drive.rig, measured, grey_reader(drive.rig), params.trajectory)
    result = refine_with_control(pairs, drive.rig, measured, found, params, drive.control_points)
    _log.info("Trajectory %s: %s", result.outcome.replace("_", " "), result.detail)
    return result


def without_torn(drive: Drive, motions: Sequence[Path]) -> tuple[Drive, HealthCheck, list[Rejection]]:
    """The drive without the frame pairs that have a torn image, whether there are too many, and their rejections."""
    torn = find_torn(
        drive, load_results(motions, RelativeMotion)[0], grey_reader(drive.rig.rectified_from or drive.rig)
    )
    check, rejections = check_torn(torn, drive)
    lost = {one.pair.frame_index for one in torn}
    kept = tuple(pair for pair in drive.frame_pairs if pair.frame_index not in lost)
    return drive.model_copy(update={"frame_pairs": kept}), check, rejections


def check_poses(
    drive: Drive,
    motions: Sequence[Path],
    trajectory: RefinedTrajectory,
    params: TrajectoryParams,
) -> list[HealthCheck]:
    """Checks of the poses as logged against the images. drive: with what its images show (`FramePair.detail`)."""
    details = {pair.frame_index: pair.detail for pair in drive.frame_pairs}
    pairs = [
        pair.model_copy(update={"detail": details[pair.frame_index]})
        for pair in trajectory.logged
        if pair.frame_index in details
    ]
    measured, _ = load_results(motions, RelativeMotion)
    checks = check_trajectory(pairs, drive.rig, measured, trajectory, _by_its_clock(drive, params))
    if measured and len(pairs) > 1:
        read = grey_reader(drive.rig)
        checks += [check(pairs, drive.rig, measured, read, params) for check in (check_lost_frames, check_recording)]
        lost = [motion is None or motion.second_SE3_first is None for motion in motions_between(pairs, measured)]
        checks += check_lost_parts(drive.model_copy(update={"frame_pairs": tuple(pairs)}), lost)
    return checks if trajectory.control is None else [*checks, trajectory.control]


def _by_its_clock(drive: Drive, params: TrajectoryParams) -> TrajectoryParams:
    """The parameters with the sigma of the drive's own clocks, where it is known."""
    return params if drive.clock_sigma_s is None else params.model_copy(update={"clock_sigma_s": drive.clock_sigma_s})


def grey_reader(rig: Rig, in_order: Sequence[FramePair] = ()) -> ImageReader:
    """Reads the grey images of a drive's frame pairs; those that are read in order are asked for some pairs ahead."""
    batches = {
        in_order[k].frame_index: in_order[k : k + _PAIRS_AT_ONCE] for k in range(0, len(in_order), _PAIRS_AT_ONCE)
    }

    def read(pair: FramePair, side: Side) -> Image:
        if side == "left":
            fetch_pairs(batches.get(pair.frame_index, ()))
        return read_pair_image(pair, side, rig, grey=True)

    return read
