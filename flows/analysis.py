"""From a drive that was read to its tracks: the order of the steps, for the flow and for commands that need no server."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from prefect import Task
from prefect.utilities.annotations import opaque

from conetl.files.parquet_store import load_results
from conetl.model.detector_evidence import DetectorEvidence
from conetl.model.params import IngestParams
from conetl.model.records import Detection, Drive, DriveRecords, Position, Rig, StereoMatch, Track
from conetl.model.rejections import Rejection
from conetl.perception.unreadable import without_unread
from conetl.pipeline.chunks import Chunk, parts_of
from conetl.pipeline.progress import expect
from conetl.tracking.self_calibration import SWITCHED_OFF, SelfCalibration, self_calibrated_rig
from conetl.tracking.trajectory import RefinedTrajectory
from flows.detection import detect_task, match_task
from flows.refinement import (
    Odometry,
    motions_task,
    moved,
    odometry_chunks,
    odometry_task,
    refine_task,
    self_calibrate_task,
    with_rig,
)
from flows.retries import whole
from flows.runners import count_when_done
from flows.tasks import fuse_task, locate_task, weigh_task

#: While the calibration is worked out, detections of so many parts of chunks more keep the cores busy.
_PARTS_MEANWHILE = 2


class Runs(Protocol):
    """How tasks are run."""

    def now(self, task: Task[..., Any], *arguments: Any) -> Any:
        """In the caller's thread; its result. Arguments may be futures."""

    def soon(self, task: Task[..., Any], *arguments: Any) -> Any:
        """Beside the caller, a future with `result()`. Arguments may be futures."""


class PrefectRuns:
    """As task runs of the flow run that calls."""

    def now(self, task: Task[..., Any], *arguments: Any) -> Any:
        return task(*arguments)

    def soon(self, task: Task[..., Any], *arguments: Any) -> Any:
        return task.submit(*arguments)


class PlainRuns:
    """As plain functions, on a pool of threads: no server, no run."""

    def __init__(self, pool: ThreadPoolExecutor) -> None:
        self._pool = pool

    def now(self, task: Task[..., Any], *arguments: Any) -> Any:
        return task.fn(*(_value(argument) for argument in arguments))

    def soon(self, task: Task[..., Any], *arguments: Any) -> Future[Any]:
        # What it waits for was submitted before it, so a pool of any size gets on.
        return self._pool.submit(self.now, task, *arguments)


def _value(argument: Any) -> Any:
    if isinstance(argument, Future):
        return argument.result()
    return argument.unwrap() if isinstance(argument, opaque) else argument


class Analysed(NamedTuple):
    """What a drive gave, and how its poses and its calibration were refined."""

    records: DriveRecords
    trajectory: RefinedTrajectory
    calibration: SelfCalibration


def analyse(
    drive: Drive,
    rejections: Sequence[Rejection],
    chunks: Sequence[Chunk],
    params: IngestParams,
    evidence: DetectorEvidence | None,
    runs: Runs,
) -> Analysed:
    """Detect and odometry -> self-calibrate -> match -> refine -> locate -> fuse.

    Where the trajectory was refined, once more locate and fuse with sigmas as the tracks show them.
    rejections: of reading the drive. chunks: `chunks_of` the drive. evidence: what is measured of the detector (None: nothing).
    How far it is, `conetl.pipeline.progress` tells. Raises ConetlError.
    """
    detection_paths, match_paths, motion_paths, calibration, rig = _run_chunks(drive, chunks, runs)
    chunks = with_rig(chunks, rig)
    drive = drive.model_copy(update={"rig": rig})
    trajectory: RefinedTrajectory = runs.now(refine_task, whole(drive), motion_paths, match_paths, params)
    drive = drive.model_copy(update={"frame_pairs": trajectory.frame_pairs})
    position_paths = runs.now(locate_task, whole(moved(chunks, trajectory)), match_paths)
    detections, refused_detections = load_results(detection_paths, Detection)
    drive, detections = without_unread(drive, detections, refused_detections)
    matches, refused_matches = load_results(match_paths, StereoMatch)
    positions, refused_positions = load_results(position_paths, Position)

    def fused(matches: list[StereoMatch], positions: list[Position]) -> tuple[list[Track], list[Rejection]]:
        seen = whole(detections), whole(matches), whole(positions)
        made: tuple[list[Track], list[Rejection]] = runs.now(
            fuse_task, whole(drive), *seen, params, evidence, whole(trajectory)
        )
        return made

    tracks, refused_tracks = fused(matches, positions)
    if trajectory.covariance is not None:
        # What sightings state by themselves made these tracks; what the tracks say of that makes the last ones.
        matches, positions, refused_positions = runs.now(
            weigh_task, whole(drive), whole(matches), whole(tracks), params, whole(trajectory)
        )
        tracks, refused_tracks = fused(matches, positions)
    refused = [*rejections, *refused_detections, *refused_matches, *refused_positions, *refused_tracks]
    return Analysed(DriveRecords(drive, detections, matches, positions, tracks, refused), trajectory, calibration)


def _run_chunks(
    drive: Drive, chunks: Sequence[Chunk], runs: Runs
) -> tuple[list[Path], list[Path], list[Path], SelfCalibration, Rig]:
    """Detections, matches and motions of all chunks; what the drive says of its calibration, and its rig after that.

    Matching waits for the calibration, which needs the odometry of the whole drive. So the odometry comes first, and while Python
    itself works out the calibration in the caller's own thread, detections, which leave the interpreter to others, keep
    the cores busy. Once the rig is known, matches are computed along with the detections, from images that are in memory; only
    for those that were found meanwhile are images read again.
    """
    drive_id, params = drive.drive_id, chunks[0].params.trajectory
    overlapping = list(odometry_chunks(chunks)) if params.refine else []
    steps = 2 * sum(len(chunk.frame_pairs) for chunk in chunks) + sum(len(o.frame_pairs) - 1 for o in overlapping)
    expect(drive_id, steps)
    followed = [runs.soon(odometry_task, whole(chunk)) for chunk in overlapping]
    for chunk, future in zip(overlapping, followed, strict=True):
        count_when_done(future, drive_id, len(chunk.frame_pairs) - 1)
    parts = iter([(k, part) for k, chunk in enumerate(chunks) for part in range(len(parts_of(chunk)))])
    detected: list[list[Any]] = [[] for _ in chunks]

    def detect(count: int, rig: Rig | None) -> None:
        """Hand in the detections of so many parts more."""
        for k, part in islice(parts, count):
            detected[k].append(_detect(chunks[k], part, rig, runs))

    # Tasks begin in the order in which they are handed in: one part for every core, and matching as many parts later, which so
    # waits for nothing.
    ahead = os.cpu_count() or 1
    calibration: SelfCalibration = SWITCHED_OFF
    odometry: list[Odometry] = []
    detect(ahead, None if params.self_calibrate else drive.rig)
    if params.self_calibrate:
        detect(_PARTS_MEANWHILE, None)
        odometry = [future.result() for future in followed]
        tracks, motions = [found.tracks for found in odometry], [found.motions for found in odometry]
        calibration = runs.now(self_calibrate_task, whole(drive), tracks, motions, whole(chunks[0]))
    rig = self_calibrated_rig(drive.rig, calibration, params)
    moving: Any = None
    if rig != drive.rig:
        moving = runs.soon(motions_task, whole(with_rig(overlapping, rig)), whole(odometry))
    matched = []
    for k, chunk in enumerate(chunks):
        detect(len(parts_of(chunk)), rig)
        matched.append(runs.soon(match_task, whole(chunk), whole(rig), *detected[k]))
    paths = [future.result() for halves in detected for future in halves]
    motion_paths = [future.result().motions for future in followed] if moving is None else moving.result()
    return paths, [future.result() for future in matched], motion_paths, calibration, rig


def _detect(chunk: Chunk, part: int, rig: Rig | None, runs: Runs) -> Any:
    """Detections of a part of a chunk, a future."""
    future = runs.soon(detect_task, whole(chunk), part, whole(rig))
    count_when_done(future, chunk.drive_id, 2 * len(chunk.frame_pairs[parts_of(chunk)[part]]))
    return future
