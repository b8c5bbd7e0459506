"""Tasks of trajectory refinement: visual odometry beside the detection, one adjustment for the whole drive after it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from prefect import get_run_logger, task

from conetl.geometry.rig import map_SE3_left
from conetl.geometry.stereo_motion import RelativeMotion
from conetl.io.parquet_store import file_sha256, has_result, load_results, result_key, result_path, save_result
from conetl.io.rectified_image import read_rig_image
from conetl.io.visual_odometry import measure_motions
from conetl.params import IngestParams, params_sha256
from conetl.records import Drive, FramePair, Side, StereoMatch
from conetl.steps.association import chain_positions
from conetl.steps.positions import locate_positions
from conetl.steps.trajectory import RefinedTrajectory, RefinementOutcome, motion_error, refine_trajectory
from flows.progress import tell_progress
from flows.retries import RETRY
from flows.tasks import RESULTS_VERSION, Chunk


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


@task(name="odometry", task_run_name="odometry {chunk.frame_pairs[0].frame_index}", tags=["odometry"], **RETRY)
def odometry_task(chunk: Chunk) -> Path:
    """Motion between the frame pairs of a chunk, from the pictures; returns the Parquet file."""
    params, pairs = chunk.params.trajectory, chunk.frame_pairs
    hashes = [file_sha256(Path(path)) for pair in pairs for path in (pair.left_path, pair.right_path)]
    geometry = result_key(chunk.rig.model_dump_json(), *(pair.model_dump_json() for pair in pairs))
    key = result_key(RESULTS_VERSION, "odometry", params_sha256(params), geometry, *hashes)
    if has_result(chunk.results_folder, key):
        tell_progress(chunk.drive_id, len(pairs) - 1)
        return result_path(chunk.results_folder, key)

    def read(pair: FramePair, side: Side) -> NDArray[np.uint8]:
        return read_rig_image(Path(pair.left_path if side == "left" else pair.right_path), chunk.rig, side)

    motions: list[RelativeMotion] = []
    for motion in measure_motions(pairs, chunk.rig, read, params):
        motions.append(motion)
        tell_progress(chunk.drive_id, 1)
    return save_result(chunk.results_folder, key, motions, [])


@task(name="refine", **RETRY)
def refine_task(drive: Drive, motions: list[Path], matches: list[Path], params: IngestParams) -> RefinedTrajectory:
    """Refined poses of the whole drive; the logged ones, with the reason, where pictures or parameters do not allow it."""
    measured, _ = load_results(motions, RelativeMotion)
    result = refine_trajectory(drive.frame_pairs, drive.rig, measured, params.trajectory)
    if params.trajectory.cone_landmarks and result.outcome is RefinementOutcome.REFINED:
        found, _ = load_results(matches, StereoMatch)
        pairs = {pair.frame_index: pair for pair in result.frame_pairs}
        positions, _ = locate_positions(found, pairs, drive.rig, params.position)
        left = {index: map_SE3_left(pair.pose, drive.rig) for index, pair in pairs.items()}
        cones = chain_positions(positions, left, params.track, motion_error(result))
        seen_often = [cone for cone in cones if len(cone) >= params.track.min_observations]
        with_cones = refine_trajectory(drive.frame_pairs, drive.rig, measured, params.trajectory, seen_often)
        result = with_cones if with_cones.outcome is RefinementOutcome.REFINED else result
    get_run_logger().info("Trajectory %s: %s", result.outcome.replace("_", " "), result.detail)
    return result
