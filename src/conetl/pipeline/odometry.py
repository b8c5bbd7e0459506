"""Steps that refine poses and calibration: visual odometry, self-calibration, and one adjustment of the whole trajectory."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from conetl.files.parquet_store import has_result, load_result, load_results, result_key, result_path, save_result
from conetl.geometry.motion.stereo_motion import RelativeMotion
from conetl.geometry.motion.stereo_tracks import StereoTracks, motions_of
from conetl.model.health import HealthCheck
from conetl.model.params import IngestParams, TrajectoryParams, params_sha256
from conetl.model.records import Drive, FramePair, Rig, Side, StereoMatch
from conetl.perception.rectified_image import fetch_pairs, read_pair_image
from conetl.perception.visual_odometry import follow_drive, follow_spans
from conetl.perception.worker_setup import set_up_worker
from conetl.perception.working_size import ImageReader
from conetl.pipeline.chunks import RESULTS_VERSION, Chunk, geometry_key
from conetl.pipeline.executor import Tick, ignore
from conetl.tracking.control_points import refine_with_control
from conetl.tracking.health import check_trajectory
from conetl.tracking.self_calibration import SelfCalibration, choose_spans, span_params, spread_spans
from conetl.tracking.self_calibration import self_calibrate as estimate_calibration
from conetl.tracking.trajectory import RefinedTrajectory

_log = logging.getLogger(__name__)
_PAIRS_AT_ONCE = 8


def odometry_chunks(chunks: Sequence[Chunk]) -> Iterator[Chunk]:
    """The chunks of a drive, each with the first frame pair of the next, so that no interval between two is lost."""
    for k, chunk in enumerate(chunks):
        following = chunks[k + 1].frame_pairs[:1] if k + 1 < len(chunks) else ()
        if len(chunk.frame_pairs) + len(following) > 1:
            yield chunk.model_copy(update={"frame_pairs": (*chunk.frame_pairs, *following)})


def moved(chunks: Sequence[Chunk], trajectory: RefinedTrajectory) -> list[Chunk]:
    """The chunks of a drive with the poses of the refined trajectory."""
    pairs = {pair.frame_index: pair for pair in trajectory.frame_pairs}
    return [
        chunk.model_copy(update={"frame_pairs": tuple(pairs[pair.frame_index] for pair in chunk.frame_pairs)})
        for chunk in chunks
    ]


def with_rig(chunks: Sequence[Chunk], rig: Rig) -> list[Chunk]:
    """The chunks of a drive with another rig."""
    return [chunk.model_copy(update={"rig": rig}) for chunk in chunks]


class Odometry(NamedTuple):
    """Parquet files of one chunk."""

    tracks: Path
    """Points followed between its frame pairs ..."""
    motions: Path
    """... and the motions that they tell."""


def odometry(chunk: Chunk, tick: Tick | None = None) -> Odometry:
    """Points followed between the frame pairs of a chunk, and its motions by the rig as it is. tick: called for every motion."""
    key = result_key(RESULTS_VERSION, "tracks", params_sha256(chunk.params.trajectory), geometry_key(chunk))
    tick = tick or ignore
    path, intervals = result_path(chunk.results_folder, key), len(chunk.frame_pairs) - 1
    if has_result(chunk.results_folder, key):
        tick(intervals)
        return Odometry(path, _motions(chunk, path))
    set_up_worker()
    tracks: list[StereoTracks] = []
    for found in follow_drive(
        chunk.frame_pairs, chunk.rig, grey_reader(chunk.rig, chunk.frame_pairs), chunk.params.trajectory
    ):
        tracks.append(found)
        tick(1)
    save_result(chunk.results_folder, key, tracks, [])
    return Odometry(path, _motions(chunk, path, tracks))


def motions(chunks: Sequence[Chunk], odometry: Sequence[Odometry]) -> list[Path]:
    """Motions between a drive's frame pairs by its rig after self-calibration; returns the Parquet files, chunk by chunk.

    chunks: `odometry_chunks` with that rig. odometry: points followed, and motions by the rig as it was, a start that spares the
    search. One step for all chunks: 3 ms per frame pair, and a task costs Prefect 40.
    """
    return [_motions(chunk, found.tracks, earlier=found.motions) for chunk, found in zip(chunks, odometry, strict=True)]


def _motions(
    chunk: Chunk, tracks: Path, known: Sequence[StereoTracks] | None = None, *, earlier: Path | None = None
) -> Path:
    """known: what `tracks` holds, where that is in memory."""
    params, pairs = chunk.params.trajectory, chunk.frame_pairs
    start = earlier.stem if earlier else "none"
    key = result_key(RESULTS_VERSION, "motions", tracks.stem, params_sha256(params), geometry_key(chunk), start)
    if not has_result(chunk.results_folder, key):
        followed = load_result(tracks, StereoTracks)[0] if known is None else known
        starts = load_result(earlier, RelativeMotion)[0] if earlier else None
        save_result(chunk.results_folder, key, list(motions_of(followed, pairs, chunk.rig, params, starts)), [])
    return result_path(chunk.results_folder, key)


def self_calibrate(drive: Drive, tracks: list[Path], motions: list[Path], chunk: Chunk) -> SelfCalibration:
    """What the whole drive says about its rig's calibration; chunk: any of the drive's, for parameters and results folder."""
    key = result_key(RESULTS_VERSION, "self-calibrate-bend", *(path.stem for path in (*tracks, *motions)))
    if has_result(chunk.results_folder, key):
        return load_result(result_path(chunk.results_folder, key), SelfCalibration)[0][0]
    found = _calibration(drive, load_results(motions, RelativeMotion)[0], chunk.params.trajectory)
    save_result(chunk.results_folder, key, [found], [])
    _log.info("Self-calibration: %s", found.detail)
    return found


def calibrate_drive(
    drive: Drive, params: TrajectoryParams, tracks: list[StereoTracks] | None = None
) -> SelfCalibration:
    """Self-calibration of a drive in one thread; tracks: of its intervals, where they are known already."""
    if tracks is None:
        tracks = list(follow_drive(drive.frame_pairs, drive.rig, grey_reader(drive.rig, drive.frame_pairs), params))
    return _calibration(drive, list(motions_of(tracks, drive.frame_pairs, drive.rig, params)), params)


def _calibration(drive: Drive, measured: Sequence[RelativeMotion], params: TrajectoryParams) -> SelfCalibration:
    pairs, read, wide = drive.frame_pairs, grey_reader(drive.rig), span_params(params)
    spans = spread_spans(choose_spans(measured, params.self_calibration_span_m), params.self_calibration_max_spans)
    if len(spans) < params.self_calibration_min_spans:
        spans = []  # no image needs to be decoded again
    followed = list(follow_spans(spans, pairs, drive.rig, read, wide))
    return estimate_calibration(drive.rig, spans, followed, params)


def refine(drive: Drive, motions: list[Path], matches: list[Path], params: IngestParams) -> RefinedTrajectory:
    """Refined poses of the whole drive; the logged ones, with the reason, where images or parameters do not allow it."""
    measured, _ = load_results(motions, RelativeMotion)
    found, _ = load_results(matches, StereoMatch)
    params = params.model_copy(update={"trajectory": _by_its_clock(drive, params.trajectory)})
    result = refine_with_control(drive.frame_pairs, drive.rig, measured, found, params, drive.control_points)
    _log.info("Trajectory %s: %s", result.outcome.replace("_", " "), result.detail)
    return result


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
    return checks if trajectory.control is None else [*checks, trajectory.control]


def _by_its_clock(drive: Drive, params: TrajectoryParams) -> TrajectoryParams:
    """The parameters with the sigma of the drive's own clocks, where it is known."""
    return params if drive.clock_sigma_s is None else params.model_copy(update={"clock_sigma_s": drive.clock_sigma_s})


def grey_reader(rig: Rig, in_order: Sequence[FramePair] = ()) -> ImageReader:
    """Reads the grey images of a drive's frame pairs; those that are read in order are asked for some pairs ahead."""
    batches = {
        in_order[k].frame_index: in_order[k : k + _PAIRS_AT_ONCE] for k in range(0, len(in_order), _PAIRS_AT_ONCE)
    }

    def read(pair: FramePair, side: Side) -> NDArray[np.uint8]:
        if side == "left":
            fetch_pairs(batches.get(pair.frame_index, ()))
        return read_pair_image(pair, side, rig, grey=True)

    return read
