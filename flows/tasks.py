"""Thin Prefect tasks: read, call a step, write. Chunks travel between tasks as paths of Parquet files."""

from __future__ import annotations

import socket
import threading
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

from prefect import task

from conetl.detector_evidence import UNMEASURED, DetectorEvidence
from conetl.errors import ModelFileError
from conetl.geometry.camera import first_road_row
from conetl.geometry.rig import map_SE3_left, map_SE3_right
from conetl.io import detector as detector_io
from conetl.io.drive_folder import read_drive
from conetl.io.parquet_store import (
    file_sha256,
    has_result,
    load_result,
    result_key,
    result_path,
    save_result,
)
from conetl.io.pictures.images import ImageFileError
from conetl.io.pictures.rectified_image import read_rig_image
from conetl.io.places import in_batches, place
from conetl.io.services.allocator import keep_freed_pictures
from conetl.params import IngestParams, params_sha256
from conetl.records import (
    Detection,
    Drive,
    FramePair,
    Position,
    Record,
    Rig,
    Side,
    StereoMatch,
    Track,
)
from conetl.rejections import Rejection
from conetl.settings import Settings
from conetl.steps.detections import check_boxes
from conetl.steps.matches import match_pair, with_measured_spread
from conetl.steps.pose_errors import pose_cov
from conetl.steps.positions import locate_positions
from conetl.steps.sighting_variances import sighting_variances, with_variances
from conetl.steps.tracks import fuse_tracks
from conetl.steps.trajectory import RefinedTrajectory, motion_error
from flows.progress import tell_progress
from flows.retries import RETRY

#: Part of every result key: raise it when a step computes something else from the same inputs.
RESULTS_VERSION = "8"
_per_thread = threading.local()


class Chunk(Record):
    """Some consecutive frame pairs of a drive, and where their results go."""

    drive_id: str
    rig: Rig
    frame_pairs: tuple[FramePair, ...]
    results_folder: Path
    model_path: Path | None
    model_sha256: str
    params: IngestParams


def chunks_of(drive: Drive, settings: Settings, model_sha256: str, params: IngestParams) -> list[Chunk]:
    """A drive cut into chunks of `params.chunk_pairs` frame pairs; the last may be shorter."""
    return [
        Chunk(
            drive_id=drive.drive_id,
            rig=drive.rig,
            frame_pairs=drive.frame_pairs[first : first + params.chunk_pairs],
            results_folder=settings.results_folder.resolve(),
            model_path=settings.model_path and settings.model_path.resolve(),
            model_sha256=model_sha256,
            params=params,
        )
        for first in range(0, len(drive.frame_pairs), params.chunk_pairs)
    ]


@task(name="read drive", task_run_name="read {folder}", **RETRY)
def read_drive_task(folder: Path, map_srid: int | None, pictures_folder: Path) -> tuple[Drive, list[Rejection]]:
    """Understand a drive folder; see `io/drive_folder`."""
    return read_drive(folder, map_srid=map_srid, pictures_folder=pictures_folder)


@task(name="detect", task_run_name="detect {side} {chunk.frame_pairs[0].frame_index}", tags=["detect"], **RETRY)
def detect_task(chunk: Chunk, side: Side) -> Path:
    """Detections of one side of a chunk; returns the Parquet file."""
    paths = [place(pair.left_path if side == "left" else pair.right_path) for pair in chunk.frame_pairs]
    hashes = [file_sha256(path) for path in in_batches(paths, fresh=True)]
    params = chunk.params.detection
    key = result_key(
        RESULTS_VERSION, "detect", side, chunk.model_sha256, params_sha256(params), _rig_and_poses(chunk), *hashes
    )
    if has_result(chunk.results_folder, key):
        tell_progress(chunk.drive_id, len(paths))
        return result_path(chunk.results_folder, key)
    keep_freed_pictures()
    camera = chunk.rig.left if side == "left" else chunk.rig.right
    pose_of = map_SE3_left if side == "left" else map_SE3_right
    rotations = [pose_of(pair.pose, chunk.rig)[:3, :3] for pair in chunk.frame_pairs]
    first_row = first_road_row(camera, rotations, params.horizon_margin_rad)
    detections: list[Detection] = []
    rejections: list[Rejection] = []
    for pair, path in zip(chunk.frame_pairs, in_batches(paths), strict=True):
        try:
            image = read_rig_image(path, chunk.rig, side)
        except ImageFileError as error:
            rejections.append(
                Rejection(
                    step="detections",
                    reason=error.reason,
                    record=f"frame pair {pair.frame_index}",
                    detail=str(error),
                    payload={"frame_index": pair.frame_index, "side": side, "path": str(path)},
                )
            )
        else:
            boxes = detector_io.detect_image(
                _detector(chunk), image,
                score_threshold=params.score_threshold, nms_iou=params.nms_iou, first_row=first_row,
            )  # fmt: skip
            found, refused = check_boxes(boxes, frame_index=pair.frame_index, side=side, params=params)
            detections += found
            rejections += refused
        tell_progress(chunk.drive_id, 1)
    return save_result(chunk.results_folder, key, detections, rejections)


@task(name="match", task_run_name="match {chunk.frame_pairs[0].frame_index}", **RETRY)
def match_task(chunk: Chunk, left: Path, right: Path) -> Path:
    """Stereo matches of a chunk from the detections of both sides; returns the Parquet file."""
    key = result_key(
        RESULTS_VERSION, "match", left.stem, right.stem, params_sha256(chunk.params.match), _rig_and_poses(chunk)
    )
    if has_result(chunk.results_folder, key):
        return result_path(chunk.results_folder, key)
    by_side = {"left": defaultdict[int, list[Detection]](list), "right": defaultdict[int, list[Detection]](list)}
    for path in (left, right):
        for detection in load_result(path, Detection)[0]:
            by_side[detection.side][detection.frame_index].append(detection)
    matches: list[StereoMatch] = []
    rejections: list[Rejection] = []
    for pair in chunk.frame_pairs:
        ours, theirs = by_side["left"][pair.frame_index], by_side["right"][pair.frame_index]
        # Up of the map, as the left camera sees it at this instant.
        up = map_SE3_left(pair.pose, chunk.rig)[2, :3]
        found, refused = match_pair(ours, theirs, chunk.rig, chunk.params.match, up_left=up)
        if found and chunk.params.match.refine:  # pictures are dear: only where boxes alone say that something matches
            images = (
                read_rig_image(place(pair.left_path), chunk.rig, "left"),
                read_rig_image(place(pair.right_path), chunk.rig, "right"),
            )
            found, refused = match_pair(ours, theirs, chunk.rig, chunk.params.match, up_left=up, images=images)
        matches += found
        rejections += refused
    return save_result(chunk.results_folder, key, with_measured_spread(matches), rejections)


@task(name="locate", **RETRY)
def locate_task(chunks: Sequence[Chunk], matches: Sequence[Path]) -> list[Path]:
    """Positions of a drive by forward intersection, chunk by chunk; returns the Parquet files."""
    return [_locate(chunk, path) for chunk, path in zip(chunks, matches, strict=True)]


def _locate(chunk: Chunk, matches: Path) -> Path:
    key = result_key(
        RESULTS_VERSION, "locate", matches.stem, params_sha256(chunk.params.position), _rig_and_poses(chunk)
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
    by_frame: dict[int, list[Detection]] = defaultdict(list)
    for detection in detections:
        by_frame[detection.frame_index].append(detection)
    return fuse_tracks(
        positions,
        {(m.frame_index, m.match_index): m for m in matches},
        by_frame,
        {pair.frame_index: pair for pair in drive.frame_pairs},
        drive.rig,
        {pair.frame_index: map_SE3_left(pair.pose, drive.rig) for pair in drive.frame_pairs},
        {pair.frame_index: map_SE3_right(pair.pose, drive.rig) for pair in drive.frame_pairs},
        params,
        evidence or UNMEASURED,
        None if trajectory is None else motion_error(trajectory),
    )


@task(name="weigh", **RETRY)
def weigh_task(
    drive: Drive, matches: list[StereoMatch], tracks: list[Track], params: IngestParams, trajectory: RefinedTrajectory
) -> tuple[list[StereoMatch], list[Position], list[Rejection]]:
    """Matches of the whole drive with sigmas as its tracks show them, and their positions; see `sighting_variances`."""
    pairs = {pair.frame_index: pair for pair in drive.frame_pairs}
    poses = {index: pair.pose for index, pair in pairs.items()}
    errors = pose_cov(trajectory, params.trajectory)
    weighed = with_variances(matches, sighting_variances(tracks, matches, drive.rig, poses, errors))
    return weighed, *locate_positions(weighed, pairs, drive.rig, params.position)


def _rig_and_poses(chunk: Chunk) -> str:
    """Hash of all geometry that a chunk's matches and positions depend on."""
    return result_key(chunk.rig.model_dump_json(), *(pair.model_dump_json() for pair in chunk.frame_pairs))


def _detector(chunk: Chunk) -> detector_io.Detector:
    """One single-threaded session per thread: two of them beat one session with two threads."""
    loaded: tuple[str, detector_io.Detector] | None = getattr(_per_thread, "detector", None)
    if loaded is None or loaded[0] != chunk.model_sha256:
        detector = detector_io.load_detector(chunk.model_path, threads=1)
        if detector.sha256 != chunk.model_sha256:  # on another machine, perhaps
            raise ModelFileError(
                f"{detector.path} on {socket.gethostname()} is another model (SHA-256 {detector.sha256}) than that of this run "
                f"({chunk.model_sha256}); all machines need the same version of conetl and the same CONETL_MODEL_PATH"
            )
        loaded = (chunk.model_sha256, detector)
        _per_thread.detector = loaded
    return loaded[1]
