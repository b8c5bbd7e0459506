"""One drive through the steps of the flow without Prefect's server and without the map."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from conetl.cli.console import note_unmeasured, progress_bar
from conetl.errors import InputError
from conetl.io.detector import shipped_model_path
from conetl.io.model_card import read_model_card
from conetl.io.parquet_store import load_results
from conetl.params import IngestParams
from conetl.records import (
    Detection,
    Drive,
    Position,
    Side,
    StereoMatch,
    Track,
)
from conetl.rejections import Rejection
from conetl.settings import Settings, prefect_environment
from conetl.steps.association import MotionError
from conetl.steps.self_calibration import SWITCHED_OFF, self_calibrated_rig
from conetl.steps.trajectory import motion_error

_SIDES: tuple[Side, Side] = ("left", "right")


@dataclass(frozen=True)
class DriveResults:
    """What the steps made of one drive."""

    drive: Drive
    """With the refined poses and the turned right camera, where trajectory and calibration were refined."""
    motion: MotionError | None
    """Error of the motion between frames; None where the trajectory was not refined."""
    trajectory: str
    """What became of the trajectory, in one sentence."""
    calibration: str
    """What the drive itself says of the rig's calibration, in one sentence."""
    detections: list[Detection]
    matches: list[StereoMatch]
    positions: list[Position]
    tracks: list[Track]
    rejections: list[Rejection]


def run_steps(folder: Path, settings: Settings, params: IngestParams, *, map_srid: int | None) -> DriveResults:
    """Read, detect, match, locate and fuse one drive by the very functions of the flow, results cached as in an ingest.

    Prefect's tasks are called as the plain functions that they wrap: no server, no database, nothing is put on the map.
    Raises ConetlError where the drive cannot be used.
    """
    if not folder.is_dir():
        raise InputError(f"no such drive folder: {folder}")
    try:
        (settings.home / "prefect").mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"{settings.home}: cannot be written to ({error.strerror}); set CONETL_HOME to a folder of yours"
        ) from error
    os.environ.update(prefect_environment(settings.home))
    # Prefect reads its environment when it is imported, and takes two seconds for it: not at the top of the file.
    from prefect.logging import disable_run_logger

    from flows import progress
    from flows.refinement import (
        motions_task,
        moved,
        odometry_chunks,
        odometry_task,
        refine_task,
        self_calibrate_task,
        with_rig,
    )
    from flows.tasks import chunks_of, detect_task, fuse_task, locate_task, match_task, read_drive_task

    drive, rejections = read_drive_task.fn(folder, map_srid, settings.pictures_folder.resolve())
    card = read_model_card(settings.model_path or shipped_model_path())
    note_unmeasured(card)
    chunks = chunks_of(drive, settings, card.sha256, params)
    following = list(odometry_chunks(chunks)) if params.trajectory.refine else []
    steps = 2 * len(drive.frame_pairs) + sum(len(chunk.frame_pairs) - 1 for chunk in following)
    with progress_bar() as bars, ThreadPoolExecutor(settings.workers) as pool:
        bar = bars.add_task(drive.drive_id, total=None)
        listener = lambda _, done, total: bars.update(bar, completed=done, total=total)  # noqa: E731
        progress.listen(listener)
        try:
            progress.expect(drive.drive_id, steps)
            running = [[pool.submit(detect_task.fn, chunk, side) for side in _SIDES] for chunk in chunks]
            driven = [pool.submit(odometry_task.fn, chunk) for chunk in following]
            followed = [future.result() for future in driven]
            motions = motions_task.fn(following, followed)
            calibration = SWITCHED_OFF
            if params.trajectory.self_calibrate:
                with disable_run_logger():  # outside a run Prefect has no logger to give
                    calibration = self_calibrate_task.fn(drive, followed, motions, chunks[0])
            rig = self_calibrated_rig(drive.rig, calibration, params.trajectory)
            if rig != drive.rig:
                motions = motions_task.fn(with_rig(following, rig), followed, motions)
            detected = [[future.result() for future in sides] for sides in running]
        finally:
            progress.ignore(listener)
    drive, chunks = drive.model_copy(update={"rig": rig}), with_rig(chunks, rig)
    matched = [match_task.fn(chunk, left, right) for chunk, (left, right) in zip(chunks, detected, strict=True)]
    with disable_run_logger():
        trajectory = refine_task.fn(drive, motions, matched, params)
    drive = drive.model_copy(update={"frame_pairs": trajectory.frame_pairs})
    located = locate_task.fn(moved(chunks, trajectory), matched)
    detections, refused_detections = load_results([path for sides in detected for path in sides], Detection)
    matches, refused_matches = load_results(matched, StereoMatch)
    positions, refused_positions = load_results(located, Position)
    tracks, refused_tracks = fuse_task.fn(drive, detections, matches, positions, params, card.evidence, trajectory)
    refused = [*rejections, *refused_detections, *refused_matches, *refused_positions, *refused_tracks]
    return DriveResults(
        drive,
        motion_error(trajectory),
        trajectory.detail,
        calibration.detail,
        detections,
        matches,
        positions,
        tracks,
        refused,
    )
