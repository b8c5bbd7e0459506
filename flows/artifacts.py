"""What Prefect's UI shows of one drive: progress, plan view, changes, rejections, worst images, links; and its events."""

from __future__ import annotations

import base64
import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from typing import Any, cast
from uuid import UUID, uuid5

import numpy as np
from prefect import artifacts
from prefect.events import emit_event
from prefect.events.worker import EventsWorker

from conetl.db.receipt_store import Receipt, StepTime
from conetl.exports.kind_marks import kind_label
from conetl.files.names import as_markdown
from conetl.model.arrays import Image
from conetl.model.drive import DriveRecords
from conetl.model.errors import StorageError
from conetl.model.ingest_report import ChangeLine, CommitReport
from conetl.model.rig import SIDES
from conetl.perception.images import ImageFileError
from conetl.perception.rectified_image import read_pair_image
from conetl.pipeline.backfill_plan import Plan
from conetl.pipeline.commit import CommittedDrive
from conetl.pipeline.database import MapDatabase
from conetl.pipeline.executor import Progress, step
from conetl.pipeline.publish import PublishedFiles, catch_up, notify, publish
from conetl.pipeline.settings import Settings
from conetl.reports.camera_images import draw_boxes, pairs_jpeg, pixelated

#: A request to the server costs about 30 ms of processor time.
_SHOWN_EVERY_S = 10.0
_SHOWN_FRAMES = 3
_NAMESPACE = UUID("7d0b6f2e-54c3-4f0d-9a53-0d2f7c1be9aa")
_PATIENCE_S = 60.0


def progress_artifact(drive_id: str, progress: Progress | None = None) -> Progress:
    """A callback that shows in Prefect how many of the drive's images and motions are done, and calls `progress` too."""
    shown: UUID | None = None
    shown_at = 0.0

    def show(done: int, total: int) -> None:
        nonlocal shown, shown_at
        if progress is not None:
            progress(done, total)
        now = time.monotonic()
        if shown is None:
            what = f"Images and motions of drive {as_markdown(drive_id)}"
            shown = cast(UUID, artifacts.create_progress_artifact(0.0, key="progress", description=what))
            shown_at = now
        elif now - shown_at >= _SHOWN_EVERY_S or done == total:
            artifacts.update_progress_artifact(shown, 100.0 * done / total)
            shown_at = now

    return show


def batch_progress(sentence: str) -> Callable[[float, str], None]:
    """The progress bar of a batch that begins, in Prefect's UI: a callback that moves it to a percentage, with a sentence."""
    bar = cast(UUID, artifacts.create_progress_artifact(0.0, key="batch-progress", description=sentence))

    def show(percent: float, sentence: str) -> None:
        artifacts.update_progress_artifact(bar, percent, description=sentence)

    return show


@step("publish", "publish {committed.changeset.drive_id}")
def publish_drive(committed: CommittedDrive, settings: Settings, database: MapDatabase, times: list[StepTime]) -> None:
    """Write the files of a drive that was committed now, show them as artifacts, and send its events."""
    files, report = publish(committed, settings, database, times), committed.report
    drive = as_markdown(report.drive_id)
    _show_files(committed, files, settings)
    total = sum(report.rejections.values())
    reasons = [{"reason": reason.replace("_", " "), "records": count} for reason, count in report.rejections.items()]
    tables = {
        "summary": (_summary_rows(report), f"Drive {drive}: {report.status}"),
        "changes": ([_change_row(line) for line in report.changes], f"Changes by drive {drive}"),
        "health": ([check.model_dump(mode="json") for check in report.health], f"Health checks of drive {drive}"),
        "rejections": (reasons, f"{total} records of drive {drive} were rejected"),
    }
    for key, (rows, description) in tables.items():
        if rows:
            artifacts.create_table_artifact(rows, key=key, description=description)
    _show_worst_frames(committed.analysed.records, whole=settings.images == "full")
    notify(report, database, send_events)


@step("publish what is pending", "publish {report.drive_id}")
def publish_pending(report: CommitReport, settings: Settings, database: MapDatabase) -> None:
    """Publish what an earlier run left pending of a drive that is on the map."""
    catch_up(report, settings, database, send_events)


def send_events(report: CommitReport, vanished: Sequence[dict[str, Any]]) -> None:
    """One event for the changeset, another one where the drive is on hold; and one for each cone that vanished, to count them.

    The ids of the events follow from the changeset: one that is sent twice is stored once.
    """
    map_resource = f"conetl.map.{report.map_name}"
    changeset_resource = f"{map_resource}.changeset.{report.changeset_id}"
    related = [{"prefect.resource.id": map_resource, "prefect.resource.role": "map"}]
    emit_event(
        "conetl.changeset.committed" if report.on_hold is None else "conetl.drive.held",
        resource={
            "prefect.resource.id": changeset_resource,
            "prefect.resource.name": report.drive_id,
            "conetl.map": report.map_name,
            **{f"conetl.{kind}": str(count) for kind, count in report.counts.items()},
        },
        related=related,
        payload=report.model_dump(mode="json", exclude={"changes"}),
        id=uuid5(_NAMESPACE, changeset_resource),
    )
    for cone in vanished:
        emit_event(
            "conetl.cone.vanished",
            resource={
                "prefect.resource.id": f"{map_resource}.feature.{cone['feature_id']}",
                "conetl.map": report.map_name,
                "conetl.changeset": str(report.changeset_id),
                "conetl.drive": report.drive_id,
            },
            related=related,
            payload={"xyz_m": cone["xyz_m"], "srid": report.map_srid, "object_height_m": cone["object_height_m"]},
            id=uuid5(_NAMESPACE, f"{changeset_resource}/{cone['feature_id']}"),
        )
    EventsWorker.drain_all(timeout=_PATIENCE_S, at_exit=False)  # a thread sends them


def show_entries(plan: Plan) -> None:
    """A table of everything below the folder of a plan that is not simply done."""
    rows = [
        {"entry": as_markdown(line.header.path), "state": line.action, "why": as_markdown(line.reason)}
        for line in plan.lines
        if line.action != "skip" or line.needs_attention
    ]
    if rows:
        artifacts.create_table_artifact(rows, key="entries", description=f"Below {as_markdown(plan.root)}")


def show_differences(rows: Sequence[dict[str, Any]], map_name: str) -> None:
    """A table of how work zones differ from their plans."""
    shown = [row | {name: as_markdown(row[name]) for name in ("plan_id", "text") if row[name]} for row in rows]
    count = f"{len(rows)} differences" if len(rows) != 1 else "1 difference"
    artifacts.create_table_artifact(
        shown, key="plan-differences", description=f"{count} of map {map_name} from plans, the worst first"
    )


def send_not_recognised(receipts: Sequence[Receipt]) -> None:
    """An event for each file or folder that cannot be read as a drive."""
    for receipt in receipts:
        emit_event(
            "conetl.drive.not_recognised",
            resource={
                "prefect.resource.id": f"conetl.map.{receipt.map_name}.folder.{receipt.header_sha256}",
                "prefect.resource.name": receipt.drive_id,
                "conetl.map": receipt.map_name,
            },
            payload={"drive": receipt.drive_path, "reason": receipt.reason},
            id=uuid5(_NAMESPACE, str(receipt.attempt_id)),
        )
    if receipts:
        EventsWorker.drain_all(timeout=_PATIENCE_S, at_exit=False)


def _show_files(committed: CommittedDrive, files: PublishedFiles, settings: Settings) -> None:
    """The plan view; links to the QA report and the map, in the map viewer if there is one: browsers open no file from a page."""
    drive, changeset_no = as_markdown(committed.changeset.drive_id), committed.changeset.changeset_no
    encoded = base64.b64encode(files.plan_view.read_bytes()).decode()
    artifacts.create_image_artifact(
        f"data:image/png;base64,{encoded}", key="plan-view", description=f"Plan view of drive {drive}"
    )
    view = (settings.view_url or "").rstrip("/")
    served = f"{view}/api/maps/{settings.map_name}/changesets/{changeset_no}/report"
    artifacts.create_link_artifact(
        served if view else files.page.as_uri(),
        link_text=f"Report of drive {drive}", key="qa-report", description=f"File: {as_markdown(files.page)}",
    )  # fmt: skip
    if view:
        artifacts.create_link_artifact(
            f"{view}/#map={settings.map_name}&changeset={changeset_no}",
            link_text=f"Drive {drive} on the map", key="map", description="Map viewer",
        )  # fmt: skip


def _show_worst_frames(records: DriveRecords, *, whole: bool) -> None:
    """Show the pairs whose rays fit worst, with the boxes that were found; nothing where no cone was measured.

    whole: show images whole; else what is far from the boxes is pixelated.
    """
    worst: dict[int, float] = defaultdict(float)
    for position in records.positions:
        worst[position.frame_index] = max(worst[position.frame_index], position.residual_rms_px)
    chosen = sorted(worst, key=lambda index: -worst[index])[:_SHOWN_FRAMES]
    pairs = {pair.frame_index: pair for pair in records.drive.frame_pairs}
    rows: list[tuple[Image, Image, str]] = []
    for index in chosen:
        drawn: list[Image] = []
        try:
            for side in SIDES:
                boxes = [
                    (d.x_px, d.y_px, d.w_px, d.h_px, d.score, *(np.nan,) * 4, 0.0)
                    for d in records.detections
                    if d.frame_index == index and d.side == side
                ]
                image = read_pair_image(pairs[index], side, records.drive.rig)
                if not whole:
                    image = pixelated(image, [box[:4] for box in boxes])
                drawn.append(draw_boxes(image, np.array(boxes).reshape(-1, 10)))
        except (ImageFileError, StorageError):  # vanished since it was read; the drive is already on the map
            continue
        count = sum(match.frame_index == index for match in records.matches)
        rows.append((drawn[0], drawn[1], f"frame pair {index}: {worst[index]:.2f} px residual, {count} cones matched"))
    if rows:
        encoded = base64.b64encode(pairs_jpeg(rows)).decode()
        artifacts.create_image_artifact(
            f"data:image/jpeg;base64,{encoded}", key="worst-frames",
            description=f"Drive {as_markdown(records.drive.drive_id)}: frame pairs with the largest residuals, left and right",
        )  # fmt: skip


def _change_row(line: ChangeLine) -> dict[str, Any]:
    """One change, rounded to what is meant."""
    position = dict(zip(("easting_m", "northing_m", "ellipsoidal_height_m"), line.xyz_m, strict=True))
    row = {"change": kind_label(line.kind), **position, **line.model_dump(mode="json", exclude={"kind", "xyz_m"})}
    return {name: round(value, 3) if isinstance(value, float) else value for name, value in row.items()}


def _summary_rows(report: CommitReport) -> list[dict[str, Any]]:
    """The figures of one ingest, a row each."""
    names = ("frame_pairs", "frame_pairs_rejected", "detections", "matches", "positions", "tracks")
    counts = {name.replace("_", " "): getattr(report, name) for name in names}
    counts |= {f"lane markings: stretches {kind_label(kind)}": n for kind, n in report.line_counts.items()}
    return [{"what": what, "count": count} for what, count in counts.items()]
