"""The main flow: one drive folder becomes one changeset of the map. One line per arrow."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from uuid import UUID

from prefect import flow, get_run_logger
from prefect.artifacts import create_progress_artifact, update_progress_artifact

from conetl.model.errors import ConetlError
from conetl.model.ingest_report import IngestReport, TooManyRejectionsError
from conetl.model.params import IngestParams
from conetl.model.rejections import INPUT_REASONS
from conetl.perception.model_card import NOT_MEASURED
from conetl.pipeline.chunks import chunks_of
from conetl.pipeline.progress import ignore, listen
from conetl.pipeline.settings import Settings
from flows.analysis import PrefectRuns, analyse
from flows.changeset_events import catch_up_task
from flows.drive_artifacts import name_of_run, worst_frames_task
from flows.merge import already_committed, identify, merge_task, refuse_other_delivery
from flows.merge import map_srid as srid_of_map
from flows.publish import publish_task
from flows.retries import as_known, lost_frame_pairs, whole
from flows.tasks import read_drive_task

#: A request to the server costs some 30 ms of processor time.
_SHOWN_EVERY_S = 10.0


@flow(name="ingest-drive", flow_run_name=name_of_run, validate_parameters=False)
def ingest_drive(
    folder: Path, settings: Settings, params: IngestParams, *, map_srid: int | None = None
) -> IngestReport:
    """Read -> detect and odometry -> self-calibrate -> match -> refine -> locate -> fuse -> merge -> publish.

    folder: a drive folder. map_srid: CRS of the map where it is not the UTM zone of the drive. Raises ConetlError (bad input,
    service missing: nothing was written) and TooManyRejectionsError (written, but look at the rejections). What fails after the
    commit stands in the report (`unpublished`).
    """
    started = time.monotonic()
    drive, rejections = read_drive_task(folder, map_srid or srid_of_map(settings), settings.images_folder.resolve())
    identity = identify(drive, params, settings)
    if identity.evidence is None:
        get_run_logger().warning(NOT_MEASURED)
    if (known := already_committed(drive, identity, settings)) is not None:
        return _after_commit(known, partial(catch_up_task, known, settings))
    refuse_other_delivery(drive, settings)
    chunks = chunks_of(drive, settings, params)
    with _shown(drive.drive_id):
        records, trajectory, calibration = analyse(drive, rejections, chunks, params, identity.evidence, PrefectRuns())
    told = {"trajectory": trajectory.detail, "calibration": calibration.detail}
    outcomes = {"trajectory_outcome": trajectory.outcome.value, "calibration_outcome": calibration.outcome.value}
    try:
        merged = merge_task(whole(records), identity, settings, params, told | outcomes)
    except Exception:  # the commit may have gone through, and the database's or Prefect's answer to it been lost
        if (known := already_committed(drive, identity, settings)) is None:
            raise
        return _after_commit(known, partial(catch_up_task, known, settings))
    report = merged.report.model_copy(update={"seconds": time.monotonic() - started, **told})
    drive = records.drive

    def publish() -> None:
        publish_task(whole(drive), whole(merged.changeset), whole(list(merged.untouched)), whole(report), settings)
        worst_frames_task(whole(drive), whole(records.detections), whole(records.positions), whole(records.matches))

    report = _after_commit(
        report, publish if report.status == "committed" else partial(catch_up_task, report, settings)
    )
    lost = len(lost_frame_pairs(records.rejections, INPUT_REASONS))
    if lost > params.max_rejected_fraction * drive.expected_frame_count:
        raise TooManyRejectionsError(report, params.max_rejected_fraction)
    return report


def _after_commit(report: IngestReport, publish: Callable[[], None]) -> IngestReport:
    """Tell what is on the map; the report, with a note where that did not work. What is committed stays so, whatever fails here.

    The changeset stays untold then, and whoever comes next makes up for it (`flows/changeset_events.py`).
    """
    try:
        publish()
    except Exception as error:
        known = as_known(error)
        why = str(known) if isinstance(known, ConetlError) else f"{type(error).__name__}: {error}"
        get_run_logger().exception("Drive %s is on the map, but not all of it was published", report.drive_id)
        note = (
            f"Drive {report.drive_id} is on the map, but its files, report and events could not all be made: {why.rstrip('.')}. "
            "Mend that, and run the same command again: it makes up for them and changes nothing on the map."
        )
        return report.model_copy(update={"unpublished": note})
    return report


@contextmanager
def _shown(drive_id: str) -> Iterator[None]:
    """An artifact in Prefect that tells how far the drive's images and motions are."""
    progress = create_progress_artifact(0.0, key="progress", description=f"Images and motions of drive {drive_id}")
    assert isinstance(progress, UUID)  # a coroutine only where an event loop runs
    shown_at = time.monotonic()

    def show(listened_drive_id: str, done: int, total: int) -> None:
        nonlocal shown_at
        now = time.monotonic()
        if listened_drive_id == drive_id and (now - shown_at >= _SHOWN_EVERY_S or done == total):
            shown_at = now
            update_progress_artifact(progress, 100.0 * done / total)

    listen(show)
    try:
        yield
    finally:
        ignore(show)
