"""Receipts of drives that are worked on: when work begins, and what became of it."""

from __future__ import annotations

import socket
from dataclasses import replace
from uuid import UUID

from conetl.db.receipt_store import Receipt, write_receipt
from conetl.model.errors import may_pass
from conetl.model.ingest_report import IngestReport
from conetl.pipeline.database import MapDatabase
from conetl.pipeline.ingest import reason_of
from conetl.pipeline.settings import Settings
from conetl.readers.drives.header import DriveHeader


def new_receipt(
    header: DriveHeader, settings: Settings, analysis_sha256: str, attempt_id: UUID, flow_run_id: str | None
) -> Receipt:
    """The receipt of work that begins now."""
    return Receipt(
        attempt_id=attempt_id,
        map_name=settings.map_name,
        drive_path=header.shown_path,
        drive_id=header.drive_id,
        header_sha256=header.header_sha256,
        analysis_sha256=analysis_sha256,
        content_sha256=None,
        state="started",
        reason="",
        may_pass=True,
        changeset_id=None,
        frame_pairs=header.frame_pairs,
        seconds=None,
        flow_run_id=flow_run_id,
        host=socket.gethostname(),
    )


def keep(receipt: Receipt, settings: Settings, database: MapDatabase) -> None:
    """Write a receipt."""
    with database.connection() as conn:
        write_receipt(conn, receipt, settings.receipts_folder)


def failed(begun: Receipt, error: Exception) -> Receipt:
    """The receipt of work that ended before the commit; whether it is tried again depends on the error."""
    reason = reason_of(error)[:2000] or "no reason given"
    return replace(begun, state="failed", reason=reason, may_pass=may_pass(error))


def ended(begun: Receipt, report: IngestReport, seconds: float, reason: str) -> Receipt:
    """The receipt of a drive that is on the map. reason: what a person has to look at."""
    return replace(
        begun,
        state="committed" if report.status == "committed" else "known",
        reason=reason[:2000],
        may_pass=False,
        changeset_id=report.changeset_id,
        content_sha256=report.content_sha256,
        frame_pairs=report.frame_pairs,
        seconds=seconds,
    )
