"""What the desk sees of one drive in Prefect: a name with drive and date, rejections, worst images, the map, events."""

import base64
from collections import defaultdict
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from prefect import task
from prefect.artifacts import create_image_artifact, create_link_artifact, create_table_artifact
from prefect.runtime import flow_run

from conetl.db.map.map_store import list_changesets
from conetl.files.storage import as_path
from conetl.model.errors import StorageError
from conetl.model.ingest_report import IngestReport
from conetl.model.records import Detection, Drive, Position, Side, StereoMatch
from conetl.perception.images import ImageFileError
from conetl.perception.rectified_image import read_rig_image
from conetl.pipeline.settings import Settings
from conetl.readers.drives.header import DriveHeader, read_header
from conetl.reports.annotated_image import draw_boxes, pairs_jpeg
from flows.merge import open_map
from flows.retries import RETRY

SHOWN_FRAMES = 3


def drive_run_name(outline: DriveHeader) -> str:
    """Drive and date, as Prefect's lists show them."""
    at = outline.captured_from
    return f"{outline.drive_id} ({at:%Y-%m-%d %H:%M})" if at else outline.drive_id


def name_of_run() -> str:
    """Name of the present run of `ingest-drive`, whatever its parameter is called."""
    parameters = flow_run.parameters
    return drive_run_name(read_header(as_path(str(parameters.get("drive") or parameters["folder"]))))


def show_around(report: IngestReport, settings: Settings) -> None:
    """Rejections by reason, and a link to the changeset in the web view."""
    if report.rejections:
        total = sum(report.rejections.values())
        rows = [
            {"reason": str(reason).replace("_", " "), "records": count} for reason, count in report.rejections.items()
        ]
        create_table_artifact(
            rows, key="rejections", description=f"{total} records of drive {report.drive_id} are in quarantine"
        )
    if settings.view_url:
        with open_map(settings) as conn:
            found = [
                c for c in list_changesets(conn, map_name=settings.map_name) if c.changeset_id == report.changeset_id
            ]
        link = (
            f"{settings.view_url.rstrip('/')}/#map={settings.map_name}&changeset={found[0].changeset_no}"
            if found
            else ""
        )
        if link:
            create_link_artifact(
                link, link_text=f"Drive {report.drive_id} on the map", key="map", description="The web view"
            )


@task(name="worst frames", **RETRY)
def worst_frames_task(
    drive: Drive, detections: Sequence[Detection], positions: Sequence[Position], matches: Sequence[StereoMatch]
) -> None:
    """Show the pairs whose rays fit worst, with the boxes that were found; nothing where no cone was measured."""
    worst: dict[int, float] = defaultdict(float)
    for position in positions:
        worst[position.frame_index] = max(worst[position.frame_index], position.residual_rms_px)
    chosen = sorted(worst, key=lambda index: -worst[index])[:SHOWN_FRAMES]
    pairs = {pair.frame_index: pair for pair in drive.frame_pairs}
    rows: list[tuple[NDArray[np.uint8], NDArray[np.uint8], str]] = []
    for index in chosen:
        pair = pairs[index]
        drawn: list[NDArray[np.uint8]] = []
        sides: tuple[tuple[Side, str], ...] = (("left", pair.left_path), ("right", pair.right_path))
        try:
            for side, path in sides:
                boxes = [
                    (d.x_px, d.y_px, d.w_px, d.h_px, d.score, *(np.nan,) * 4)
                    for d in detections
                    if d.frame_index == index and d.side == side
                ]
                drawn.append(draw_boxes(read_rig_image(as_path(path), drive.rig, side), np.array(boxes).reshape(-1, 9)))
        except (ImageFileError, StorageError):  # vanished since it was read; the drive is on the map already
            continue
        count = sum(match.frame_index == index for match in matches)
        rows.append((drawn[0], drawn[1], f"frame pair {index}: {worst[index]:.2f} px residual, {count} cones matched"))
    if rows:
        encoded = base64.b64encode(pairs_jpeg(rows)).decode()
        create_image_artifact(
            f"data:image/jpeg;base64,{encoded}", key="worst-frames",
            description=f"Drive {drive.drive_id}: the pairs whose rays fit worst, left and right",
        )  # fmt: skip
