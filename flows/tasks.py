"""Thin Prefect tasks: read, call a step, write. Chunks travel between tasks as paths of Parquet files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from prefect import task

from conetl.files.parquet_store import (
    has_result,
    load_result,
    result_key,
    result_path,
    save_result,
)
from conetl.model.detector_evidence import UNMEASURED, DetectorEvidence
from conetl.model.params import IngestParams, params_sha256
from conetl.model.records import (
    Detection,
    Drive,
    Position,
    StereoMatch,
    Track,
)
from conetl.model.rejections import Rejection
from conetl.pipeline.chunks import RESULTS_VERSION, Chunk, rig_and_poses
from conetl.readers.drives import read_drive
from conetl.tracking.error_propagation import pose_cov
from conetl.tracking.positions import locate_positions
from conetl.tracking.tracks import fuse_tracks
from conetl.tracking.trajectory import RefinedTrajectory, motion_error
from conetl.tracking.variance_components import estimate_variance_factors, with_variance_factors
from flows.retries import RETRY


@task(name="read drive", task_run_name="read {folder}", **RETRY)
def read_drive_task(folder: Path, map_srid: int | None, images_folder: Path) -> tuple[Drive, list[Rejection]]:
    """Understand a drive folder; see `io/drive_folder`."""
    return read_drive(folder, map_srid=map_srid, images_folder=images_folder)


@task(name="locate", **RETRY)
def locate_task(chunks: Sequence[Chunk], matches: Sequence[Path]) -> list[Path]:
    """Positions of a drive by forward intersection, chunk by chunk; returns the Parquet files."""
    return [_locate(chunk, path) for chunk, path in zip(chunks, matches, strict=True)]


def _locate(chunk: Chunk, matches: Path) -> Path:
    key = result_key(
        RESULTS_VERSION, "locate", matches.stem, params_sha256(chunk.params.position), rig_and_poses(chunk)
    )
    if has_result(chunk.results_folder, key):
        return result_path(chunk.results_folder, key)
    pairs = {pair.frame_index: pair for pair in chunk.frame_pairs}
    positions, rejections = locate_positions(
        load_result(matches, StereoMatch)[0], pairs, chunk.rig, chunk.params.position
    )
    return save_result(chunk.results_folder, key, positions, rejections)


@task(name="fuse", **RETRY)
def fuse_task(
    drive: Drive,
    detections: list[Detection],
    matches: list[StereoMatch],
    positions: list[Position],
    params: IngestParams,
    evidence: DetectorEvidence | None,
    trajectory: RefinedTrajectory | None = None,
) -> tuple[list[Track], list[Rejection]]:
    """Tracks of the whole drive. evidence: what the model's sidecar says of its boxes; None where nothing was measured.

    trajectory: the refined one, whose poses `drive` has; without it relative motion errs by fixed shares of the way.
    """
    motion = None if trajectory is None else motion_error(trajectory)
    return fuse_tracks(
        positions, matches, detections, drive.frame_pairs, drive.rig, params, evidence or UNMEASURED, motion
    )


@task(name="weigh", **RETRY)
def weigh_task(
    drive: Drive, matches: list[StereoMatch], tracks: list[Track], params: IngestParams, trajectory: RefinedTrajectory
) -> tuple[list[StereoMatch], list[Position], list[Rejection]]:
    """Matches of the whole drive with sigmas as its tracks show them, and their positions; see `estimate_variance_factors`."""
    pairs = {pair.frame_index: pair for pair in drive.frame_pairs}
    poses = {index: pair.pose for index, pair in pairs.items()}
    errors = pose_cov(trajectory, params.trajectory)
    weighed = with_variance_factors(matches, estimate_variance_factors(tracks, matches, drive.rig, poses, errors))
    return weighed, *locate_positions(weighed, pairs, drive.rig, params.position)
