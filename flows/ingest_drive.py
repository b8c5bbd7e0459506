"""The main flow: one drive folder becomes one changeset of the map. One line per arrow."""

from __future__ import annotations

import time
from pathlib import Path
from uuid import UUID

from prefect import flow, get_run_logger
from prefect.artifacts import create_progress_artifact, update_progress_artifact
from prefect.futures import PrefectFuture

from conetl.io.model_card import NOT_MEASURED
from conetl.io.parquet_store import load_results
from conetl.params import IngestParams
from conetl.records import Detection, Drive, Position, StereoMatch
from conetl.rejections import INPUT_REASONS
from conetl.reports import IngestReport, TooManyRejectionsError
from conetl.settings import Settings
from conetl.steps.self_calibration import SWITCHED_OFF, SelfCalibration, self_calibrated_rig
from flows.changeset_events import catch_up_task
from flows.control_room import name_of_run, worst_frames_task
from flows.merge import already_committed, identify, merge_task
from flows.merge import map_srid as srid_of_map
from flows.progress import expect, ignore, listen
from flows.publish import publish_task
from flows.refinement import (
    motions_task,
    moved,
    odometry_chunks,
    odometry_task,
    refine_task,
    self_calibrate_task,
    with_rig,
)
from flows.retries import lost_frame_pairs, whole
from flows.runners import count_when_done
from flows.tasks import (
    Chunk,
    chunks_of,
    detect_task,
    fuse_task,
    locate_task,
    match_task,
    read_drive_task,
)


@flow(name="ingest-drive", flow_run_name=name_of_run, validate_parameters=False)
def ingest_drive(
    folder: Path, settings: Settings, params: IngestParams, *, map_srid: int | None = None
) -> IngestReport:
    """Read -> detect and odometry -> self-calibrate -> match -> refine -> locate -> fuse -> merge -> publish.

    folder: a drive folder. map_srid: CRS of the map where it is not the UTM zone of the drive. Raises ConetlError (bad input,
    service missing: nothing was written) and TooManyRejectionsError (written, but look at the rejections).
    """
    started = time.monotonic()
    drive, rejections = read_drive_task(folder, map_srid or srid_of_map(settings), settings.pictures_folder.resolve())
    identity = identify(drive, params, settings)
    if identity.evidence is None:
        get_run_logger().warning(NOT_MEASURED)
    if (known := already_committed(drive, identity, settings)) is not None:
        catch_up_task(known, settings)
        return known
    chunks = chunks_of(drive, settings, identity.model_sha256, params)
    detection_paths, match_paths, motion_paths, calibration = _run_chunks(drive, chunks)
    drive = drive.model_copy(update={"rig": self_calibrated_rig(drive.rig, calibration, params.trajectory)})
    chunks = with_rig(chunks, drive.rig)
    trajectory = refine_task(whole(drive), motion_paths, match_paths, params)
    drive = drive.model_copy(update={"frame_pairs": trajectory.frame_pairs})
    position_paths = locate_task(whole(moved(chunks, trajectory)), match_paths)
    detections, refused_detections = load_results(detection_paths, Detection)
    matches, refused_matches = load_results(match_paths, StereoMatch)
    positions, refused_positions = load_results(position_paths, Position)
    seen = whole(detections), whole(matches), whole(positions)
    tracks, refused_tracks = fuse_task(whole(drive), *seen, params, identity.evidence, whole(trajectory))
    rejections = [*rejections, *refused_detections, *refused_matches, *refused_positions, *refused_tracks]
    told = {"trajectory": trajectory.detail, "calibration": calibration.detail}
    outcomes = {"trajectory_outcome": trajectory.outcome.value, "calibration_outcome": calibration.outcome.value}
    merged = merge_task(
        whole(drive), identity, *seen, whole(tracks), whole(rejections), settings, params, told | outcomes
    )
    report = merged.report.model_copy(update={"seconds": time.monotonic() - started, **told})
    if report.status == "committed":
        publish_task(whole(drive), whole(merged.changeset), whole(list(merged.untouched)), whole(report), settings)
        worst_frames_task(whole(drive), whole(detections), whole(positions), whole(matches))
    lost = len(lost_frame_pairs(rejections, INPUT_REASONS))
    if lost > params.max_rejected_fraction * drive.expected_frame_count:
        raise TooManyRejectionsError(report, params.max_rejected_fraction)
    return report


def _run_chunks(drive: Drive, chunks: list[Chunk]) -> tuple[list[Path], list[Path], list[Path], SelfCalibration]:
    """Detections, matches and motions of all chunks, and what the drive says of its calibration, which matching waits for.

    Visual odometry runs beside the detection; motions and self-calibration run in the flow's own thread, also beside it.
    """
    drive_id, params = drive.drive_id, chunks[0].params.trajectory
    overlapping = list(odometry_chunks(chunks)) if params.refine else []
    steps = 2 * sum(len(chunk.frame_pairs) for chunk in chunks) + sum(len(o.frame_pairs) - 1 for o in overlapping)
    progress = create_progress_artifact(0.0, key="progress", description=f"Images and motions of drive {drive_id}")
    assert isinstance(progress, UUID)  # a coroutine only where an event loop runs
    shown = 0

    def show(listened_drive_id: str, done: int, total: int) -> None:
        nonlocal shown
        if listened_drive_id == drive_id and done * 10 // total > shown:  # a request to the server every tenth
            shown = done * 10 // total
            update_progress_artifact(progress, 100.0 * done / total)

    expect(drive_id, steps)
    listen(show)
    try:
        detected: list[tuple[PrefectFuture[Path], PrefectFuture[Path]]] = []
        followed: list[PrefectFuture[Path]] = []
        for k, chunk in enumerate(chunks):
            detected.append((detect_task.submit(whole(chunk), "left"), detect_task.submit(whole(chunk), "right")))
            for future in detected[-1]:
                count_when_done(future, drive_id, len(chunk.frame_pairs))
            if k < len(overlapping):
                followed.append(odometry_task.submit(whole(overlapping[k])))
                count_when_done(followed[-1], drive_id, len(overlapping[k].frame_pairs) - 1)
        tracks = [f.result() for f in followed]
        motions = motions_task(whole(overlapping), tracks)
        calibration = (
            self_calibrate_task(whole(drive), tracks, motions, whole(chunks[0]))
            if params.self_calibrate
            else SWITCHED_OFF
        )
        rig = self_calibrated_rig(drive.rig, calibration, params)
        if rig != drive.rig:
            motions = motions_task(whole(with_rig(overlapping, rig)), tracks, motions)
        turned = with_rig(chunks, rig)
        matched = [match_task.submit(whole(c), left, right) for c, (left, right) in zip(turned, detected, strict=True)]
        return [f.result() for sides in detected for f in sides], [f.result() for f in matched], motions, calibration
    finally:
        ignore(show)
