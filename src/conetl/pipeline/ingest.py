"""Ingest one drive folder: one changeset of the map, and everything that shows it; receipts record the outcome."""

from __future__ import annotations

import logging
import socket
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from uuid import UUID

import httpx

from conetl.db.connection import require_writer
from conetl.db.map.map_store import find_map, map_gone
from conetl.db.receipt_store import Receipt, StepTime, write_receipt
from conetl.files.home import make_home
from conetl.files.storage import forget_all
from conetl.model.drive import Drive
from conetl.model.errors import ConetlError, ServiceError, is_retryable, is_storage_error, storage_error
from conetl.model.ingest_report import CommitReport, DriveOnHoldError, IngestReport, TooManyRejectionsError
from conetl.model.params import IngestParams
from conetl.model.rejections import DOUBTFUL_REASONS, Rejection
from conetl.perception.model_card import NOT_MEASURED, read_model_card
from conetl.pipeline.analysis import AnalysedDrive, analyse
from conetl.pipeline.commit import CommittedDrive, already_committed, changeset_of, commit, run_info
from conetl.pipeline.compared.same_recording import refuse_other_delivery, refuse_same_images
from conetl.pipeline.database import MapDatabase
from conetl.pipeline.executor import Executor, Progress, ThreadExecutor, step
from conetl.pipeline.publish import publish
from conetl.pipeline.settings import Settings, read_settings
from conetl.readers.drives import read_drive
from conetl.readers.drives.header import DriveHeader

_log = logging.getLogger(__name__)
#: Steps that publish a newly committed drive, and one that was already on the map.
PublishNew = Callable[[CommittedDrive, Settings, MapDatabase, list[StepTime]], object]
PublishKnown = Callable[[CommitReport, Settings, MapDatabase], object]


@step("read", "read {folder}")
def read(folder: Path | str, map_srid: int | None, images_folder: Path) -> tuple[Drive, list[Rejection]]:
    """Read a drive folder."""
    return read_drive(folder, map_srid=map_srid, images_folder=images_folder)


def ingest(
    folder: Path | str,
    params: IngestParams | None = None,
    settings: Settings | None = None,
    *,
    map_srid: int | None = None,
    map_exists: bool = False,
    database: MapDatabase | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
    publish_new: PublishNew = publish,
    publish_known: PublishKnown | None = None,
    flow_run_id: str | None = None,
) -> IngestReport:
    """Read -> analyse -> commit -> publish one drive.

    folder: a drive folder. map_srid: EPSG code of the map; default: the UTM zone of the drive. map_exists: the map was there when
    the batch began, or since its first drive: if it is gone now, it is not made anew. settings, executor, progress:
    as for `analyse`; database: as for `commit`. publish_new, publish_known: called for a newly committed drive, and for one that
    was already on the map. The images of the drive are read once if they fit into `files.storage.CACHE_BYTES`; those of a larger
    drive are read again.

    Raises ConetlError (bad input, service unavailable: nothing was written), DriveOnHoldError (stored, but the recording
    contradicts itself) and TooManyRejectionsError (committed, but too many frame pairs were rejected). A failure after the commit
    is stated in the report (`unpublished`).
    """
    params, settings, started = params or IngestParams(), settings or read_settings(), time.monotonic()
    make_home(settings.home)
    with ExitStack() as stack:
        stack.callback(forget_all)
        db = database or stack.enter_context(MapDatabase(settings))
        steps = executor or stack.enter_context(ThreadExecutor(settings.workers))
        with db.connection() as conn:
            info = find_map(conn, settings.map_name)
        if info is None and map_exists:
            raise map_gone(str(folder), settings.map_name)
        srid = map_srid or (info.srid if info and info.counts else None)  # later drives use the map's own CRS
        drive, rejections = steps.run(read, folder, srid, settings.images_folder.resolve())
        changeset = changeset_of(drive, params, settings)
        if read_model_card(settings.model_path).evidence is None:
            _log.warning(NOT_MEASURED)

        def finished(known: CommitReport) -> IngestReport:
            """The answer for a drive that is already on the map, once what was left pending is published."""
            publish = None if publish_known is None else lambda: steps.run(publish_known, known, settings, db)
            return _raise_if_held(_after_commit(known, started, publish))

        if (known := already_committed(drive, changeset, settings, db)) is not None:
            return finished(known)
        with db.connection() as conn:
            require_writer(conn)
        refuse_other_delivery(drive, settings, db)
        analysed = analyse(drive, params, rejections=rejections, settings=settings, executor=steps, progress=progress)
        refuse_same_images(analysed.records, settings, db)
        try:
            committed: CommittedDrive = steps.run(
                commit, analysed, settings, db, run_info(analysed, flow_run_id), info.map_id if info else None
            )
        except Exception:  # the commit may have succeeded although the answer of the database or Prefect was lost
            if (known := already_committed(drive, changeset, settings, db)) is None:
                raise
            return finished(known)
        if committed.report.is_known:  # another ingest of the same drive finished first
            return finished(committed.report)
        report = _after_commit(
            committed.report, started, lambda: steps.run(publish_new, committed, settings, db, steps.times())
        )
    return raise_if_doubtful(report, analysed)


def raise_if_doubtful(report: IngestReport, analysed: AnalysedDrive) -> IngestReport:
    """The report of a newly committed drive. Raises DriveOnHoldError or TooManyRejectionsError if a person has to check it."""
    _raise_if_held(report)
    allowed = analysed.params.max_rejected_fraction
    # Each pair once, even if both images are bad.
    lost = len({one.record for one in analysed.records.rejections if one.reason in DOUBTFUL_REASONS})
    if lost > allowed * analysed.drive.expected_frame_count:
        raise TooManyRejectionsError(report, lost, allowed)
    return report


def _raise_if_held(report: IngestReport) -> IngestReport:
    if report.on_hold is not None:
        raise DriveOnHoldError(report)
    return report


def _after_commit(report: CommitReport, started: float, publish: Callable[[], object] | None) -> IngestReport:
    """Publish a committed drive; returns the answer, with a note if that failed. The commit stays. started: `time.monotonic`."""
    seconds, note = time.monotonic() - started, None
    try:
        if publish is not None:
            publish()
    except Exception as error:
        _log.exception("Drive %s is on the map, but not all of it was published", report.drive_id)
        note = (
            f"Drive {report.drive_id} is on the map, but not all of its files, report and events were published: "
            f"{error_text(error).rstrip('.')}. Correct this and run the same command again: it publishes the rest and does not "
            "change the map."
        )
    return IngestReport(**vars(report), seconds=seconds, unpublished=note)


def error_text(error: Exception) -> str:
    """The message of an error for users."""
    known = as_conetl_error(error)
    return str(known) if isinstance(known, ConetlError) else f"{type(error).__name__}: {error}"


def as_conetl_error(error: Exception) -> Exception:
    """An error of a library or the system as conetl's own, if a service or storage failed; other errors unchanged."""
    refused = isinstance(error, PermissionError) or (is_storage_error(error) and not isinstance(error, ConnectionError))
    if isinstance(error, OSError) and refused:
        return storage_error(error)
    if isinstance(error, httpx.HTTPError):
        return ServiceError(
            f"Prefect does not answer ({type(error).__name__}: {error}): check whether its server runs (`conetl status`, "
            "PREFECT_API_URL), and run the same command again."
        )
    return error


def new_receipt(
    header: DriveHeader, settings: Settings, analysis_sha256: str, attempt_id: UUID, flow_run_id: str | None
) -> Receipt:
    """The receipt at the beginning of the work."""
    return Receipt(
        attempt_id=attempt_id,
        map_name=settings.map_name,
        drive_path=header.shown_path,
        drive_id=header.drive_id,
        header_sha256=header.header_sha256,
        analysis_sha256=analysis_sha256,
        frame_pairs=header.frame_pairs,
        flow_run_id=flow_run_id,
        host=socket.gethostname(),
    )


def save_receipt(receipt: Receipt, settings: Settings, database: MapDatabase) -> None:
    """Write a receipt."""
    with database.connection() as conn:
        write_receipt(conn, receipt, settings.receipts_folder)


def failed_receipt(begun: Receipt, error: Exception) -> Receipt:
    """The receipt of work that ended before the commit; whether it is retried depends on the error."""
    reason = error_text(error)[:2000] or "no reason given"
    return replace(begun, state="failed", reason=reason, may_pass=is_retryable(error))


def final_receipt(begun: Receipt, report: IngestReport, seconds: float, reason: str) -> Receipt:
    """The receipt of a drive that is on the map. reason: what a person has to check."""
    return replace(
        begun,
        state="held" if report.on_hold else "known" if report.is_known else "committed",
        reason=reason[:2000],
        may_pass=False,
        changeset_id=report.changeset_id,
        content_sha256=report.content_sha256,
        frame_pairs=report.frame_pairs,
        seconds=seconds,
    )
