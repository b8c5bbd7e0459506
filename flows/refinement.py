"""Tasks of trajectory refinement: visual odometry before the detection, one adjustment for the whole drive after it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from prefect import get_run_logger, task

from conetl.files.parquet_store import (
    has_result,
    load_result,
    load_results,
    result_key,
    result_path,
    save_result,
)
from conetl.files.storage import as_path
from conetl.geometry.motion.stereo_motion import RelativeMotion
from conetl.geometry.motion.stereo_tracks import StereoTracks, motions_of
from conetl.model.params import IngestParams, params_sha256
from conetl.model.records import Drive, FramePair, Rig, Side, StereoMatch
from conetl.perception.allocator import keep_freed_images
from conetl.perception.rectified_image import read_hashed_rig_image, read_rig_image_again
from conetl.perception.visual_odometry import follow_drive, follow_span
from conetl.perception.working_size import ImageReader
from conetl.pipeline.chunks import RESULTS_VERSION, Chunk, image_hashes, image_paths
from conetl.pipeline.progress import tell_progress
from conetl.tracking.landmarks import refine_with_cones
from conetl.tracking.self_calibration import SelfCalibration, choose_spans, self_calibrate, span_params, spread_spans
from conetl.tracking.trajectory import RefinedTrajectory
from flows.retries import RETRY


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


@task(name="odometry", task_run_name="odometry {chunk.frame_pairs[0].frame_index}", **RETRY)
def odometry_task(chunk: Chunk) -> Odometry:
    """Points followed between the frame pairs of a chunk, and its motions by the rig as it is."""
    hashes = image_hashes(image_paths(chunk.frame_pairs))
    key = _tracks_key(chunk, hashes.values())
    path, intervals = result_path(chunk.results_folder, key), len(chunk.frame_pairs) - 1
    if has_result(chunk.results_folder, key):
        tell_progress(chunk.drive_id, intervals)
        return Odometry(path, _motions(chunk, path))
    keep_freed_images()
    tracks: list[StereoTracks] = []
    for found in follow_drive(chunk.frame_pairs, chunk.rig, _reader(chunk.rig, hashes), chunk.params.trajectory):
        tracks.append(found)
        tell_progress(chunk.drive_id, 1)
    save_result(chunk.results_folder, key, tracks, [])
    return Odometry(path, _motions(chunk, path, tracks))


@task(name="motions", **RETRY)
def motions_task(chunks: Sequence[Chunk], odometry: Sequence[Odometry]) -> list[Path]:
    """Motions between a drive's frame pairs by its rig after self-calibration; returns the Parquet files, chunk by chunk.

    chunks: `odometry_chunks` with that rig. odometry: points followed, and motions by the rig as it was, a start that spares the
    search. One task for all: 3 ms a frame pair beside the detections, and a task's run costs Prefect 40.
    """
    return [_motions(chunk, found.tracks, earlier=found.motions) for chunk, found in zip(chunks, odometry, strict=True)]


def _motions(
    chunk: Chunk, tracks: Path, known: Sequence[StereoTracks] | None = None, *, earlier: Path | None = None
) -> Path:
    """known: what `tracks` holds, where that is in memory."""
    params, pairs = chunk.params.trajectory, chunk.frame_pairs
    geometry = result_key(chunk.rig.model_dump_json(), *(pair.model_dump_json() for pair in pairs))
    key = result_key(
        RESULTS_VERSION, "motions", tracks.stem, params_sha256(params), geometry, earlier.stem if earlier else "none"
    )
    if not has_result(chunk.results_folder, key):
        followed = load_result(tracks, StereoTracks)[0] if known is None else known
        starts = load_result(earlier, RelativeMotion)[0] if earlier else None
        save_result(chunk.results_folder, key, list(motions_of(followed, pairs, chunk.rig, params, starts)), [])
    return result_path(chunk.results_folder, key)


@task(name="self-calibrate", **RETRY)
def self_calibrate_task(drive: Drive, tracks: list[Path], motions: list[Path], chunk: Chunk) -> SelfCalibration:
    """What the whole drive says of its rig's calibration; chunk: any of the drive's, for parameters and results folder."""
    params = chunk.params.trajectory
    key = result_key(RESULTS_VERSION, "self-calibrate-bend", *(path.stem for path in (*tracks, *motions)))
    if has_result(chunk.results_folder, key):
        return load_result(result_path(chunk.results_folder, key), SelfCalibration)[0][0]
    measured, _ = load_results(motions, RelativeMotion)
    pairs, read = drive.frame_pairs, reader_again(drive.rig)
    wide = span_params(params)
    spans = choose_spans(measured, params.self_calibration_span_m)
    spans = spread_spans(spans, params.self_calibration_max_spans)
    if len(spans) < params.self_calibration_min_spans:
        spans = []  # no image needs to be read again
    followed = [follow_span(pairs[s.first], pairs[s.last], s.last_SE3_first, drive.rig, read, wide) for s in spans]
    found = self_calibrate(drive.rig, spans, followed, params)
    save_result(chunk.results_folder, key, [found], [])
    get_run_logger().info("Self-calibration: %s", found.detail)
    return found


@task(name="refine", **RETRY)
def refine_task(drive: Drive, motions: list[Path], matches: list[Path], params: IngestParams) -> RefinedTrajectory:
    """Refined poses of the whole drive; the logged ones, with the reason, where images or parameters do not allow it."""
    measured, _ = load_results(motions, RelativeMotion)
    found, _ = load_results(matches, StereoMatch)
    result = refine_with_cones(drive.frame_pairs, drive.rig, measured, found, params)
    get_run_logger().info("Trajectory %s: %s", result.outcome.replace("_", " "), result.detail)
    return result


def _tracks_key(chunk: Chunk, hashes: Iterable[str]) -> str:
    geometry = result_key(chunk.rig.model_dump_json(), *(pair.model_dump_json() for pair in chunk.frame_pairs))
    return result_key(RESULTS_VERSION, "tracks", params_sha256(chunk.params.trajectory), geometry, *hashes)


def _reader(rig: Rig, hashes: Mapping[Path, str]) -> ImageReader:
    """Reads images that were hashed for the key of a result."""

    def read(pair: FramePair, side: Side) -> NDArray[np.uint8]:
        path = _path(pair, side)
        return read_hashed_rig_image(path, hashes[path], rig, side, grey=True)

    return read


def reader_again(rig: Rig) -> ImageReader:
    """Reads images between which motions were measured: they were there."""
    return lambda pair, side: read_rig_image_again(_path(pair, side), rig, side, grey=True)


def _path(pair: FramePair, side: Side) -> Path:
    return as_path(pair.left_path if side == "left" else pair.right_path)
