"""One drive through the steps of the flow without Prefect's server and without the map."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from conetl.cli.console import note_unmeasured, progress_bar
from conetl.model.errors import InputError
from conetl.model.params import IngestParams
from conetl.model.records import (
    Detection,
    Drive,
    Position,
    StereoMatch,
    Track,
)
from conetl.model.rejections import Rejection
from conetl.perception.model_card import read_model_card
from conetl.pipeline.settings import Settings, prefect_environment
from conetl.tracking.association import MotionError
from conetl.tracking.error_propagation import PoseCov, pose_cov
from conetl.tracking.trajectory import motion_error


@dataclass(frozen=True)
class DriveResults:
    """What the steps made of one drive."""

    drive: Drive
    """With the refined poses and the turned right camera, where trajectory and calibration were refined."""
    motion: MotionError | None
    """Error of the motion between frames; None where the trajectory was not refined."""
    poses: PoseCov
    """How the errors of the drive's poses hang together."""
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

    from conetl.pipeline import progress
    from conetl.pipeline.chunks import chunks_of
    from flows.analysis import PlainRuns, analyse
    from flows.tasks import read_drive_task

    drive, rejections = read_drive_task.fn(folder, map_srid, settings.images_folder.resolve())
    card = read_model_card(settings.model_path)
    note_unmeasured(card)
    chunks = chunks_of(drive, settings, params)
    # Outside a run Prefect has no logger to give.
    with progress_bar() as bars, ThreadPoolExecutor(settings.workers) as pool, disable_run_logger():
        bar = bars.add_task(drive.drive_id, total=None)
        listener = lambda _, done, total: bars.update(bar, completed=done, total=total)  # noqa: E731
        progress.listen(listener)
        try:
            records, trajectory, calibration = analyse(
                drive, rejections, chunks, params, card.evidence, PlainRuns(pool)
            )
        finally:
            progress.ignore(listener)
    return DriveResults(
        records.drive,
        motion_error(trajectory),
        pose_cov(trajectory, params.trajectory),
        trajectory.detail,
        calibration.detail,
        list(records.detections),
        list(records.matches),
        list(records.positions),
        list(records.tracks),
        list(records.rejections),
    )
