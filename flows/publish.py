"""After the commit: the map as files, and what the drive changed as artifacts in Prefect."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Any

import numpy as np
from prefect import task
from prefect.artifacts import create_image_artifact, create_link_artifact, create_table_artifact
from prefect.runtime import flow_run

from conetl.db.connection import Connection
from conetl.db.map.map_store import find_changeset
from conetl.db.run_store import write_run_steps
from conetl.exports.geojson import export_geojson
from conetl.geometry.rig import map_SE3_left
from conetl.model.errors import MapMismatchError
from conetl.model.ingest_report import ChangeLine, IngestReport
from conetl.model.map_records import Changeset, MapFeature
from conetl.model.records import Drive
from conetl.pipeline.settings import Settings
from conetl.reports.drive_page import write_drive_page
from conetl.reports.plan_view import draw_plan_view
from flows.changeset_events import tell_changes
from flows.drive_artifacts import show_around
from flows.merge import open_map
from flows.retries import RETRY
from flows.timing import times_of


@task(name="publish", **RETRY)
def publish_task(
    drive: Drive, changeset: Changeset, untouched: list[MapFeature], report: IngestReport, settings: Settings
) -> list[Path]:
    """Write the map as GeoJSON, the plan view as a PNG and the QA report; show view, summary, changes and report as artifacts."""
    exports = settings.exports_folder
    exports.mkdir(parents=True, exist_ok=True)
    geojson = exports / f"{settings.map_name}.geojson"
    with open_map(settings) as conn:
        export_geojson(conn, geojson, map_name=settings.map_name)
        write_run_steps(conn, changeset.changeset_id, times_of(flow_run.get_id()))
        page = _write_report(conn, changeset, settings)
    image = settings.drive_image_path(drive.drive_id)
    path = np.array([map_SE3_left(pair.pose, drive.rig)[:2, 3] for pair in drive.frame_pairs])
    draw_plan_view(
        image,
        title=f"Drive {drive.drive_id}, {drive.captured_from:%Y-%m-%d %H:%M} UTC\n"
        f"map {settings.map_name}, EPSG:{drive.map_srid}",
        trajectory_m=path,
        deltas=changeset.deltas,
        untouched=untouched,
    )
    encoded = base64.b64encode(image.read_bytes()).decode()
    create_image_artifact(
        f"data:image/png;base64,{encoded}", key="plan-view", description=f"Plan view of drive {drive.drive_id}"
    )
    create_table_artifact(summary_rows(report), key="summary", description=f"Drive {drive.drive_id}: {report.status}")
    if report.changes:
        create_table_artifact(
            [_change_row(line) for line in report.changes],
            key="changes",
            description=f"Changes by drive {drive.drive_id}",
        )
    show_around(report, settings)
    tell_changes(report, settings)
    return [geojson, image, page]


def _write_report(conn: Connection, changeset: Changeset, settings: Settings) -> Path:
    """The QA report as a file, and a link to it: to the web view where there is one, since browsers open no file from a page."""
    committed = find_changeset(conn, changeset.idempotency_key, map_name=settings.map_name)
    if committed is None:
        raise MapMismatchError(f"changeset {changeset.changeset_id} was committed but cannot be found again")
    path = settings.drive_report_path(committed.drive_id, committed.changeset_no).resolve()
    write_drive_page(conn, committed, path, map_name=settings.map_name)
    served = f"/api/maps/{settings.map_name}/changesets/{committed.changeset_no}/report"
    create_link_artifact(
        settings.view_url.rstrip("/") + served if settings.view_url else path.as_uri(),
        link_text=f"QA report of drive {changeset.drive_id}", key="qa-report", description=f"The file: {path}",
    )  # fmt: skip
    return path


def _change_row(line: ChangeLine) -> dict[str, Any]:
    """One change, rounded to what is meant."""
    east_m, north_m, height_m = line.xyz_m
    return {
        "change": str(line.kind),
        "feature": str(line.feature_id),
        "easting_m": round(east_m, 3),
        "northing_m": round(north_m, 3),
        "height_m": round(height_m, 3),
        "cone_height_m": round(line.cone_height_m, 2),
        "sigma_m": round(line.sigma_horizontal_m, 3),
        "existence_probability": round(line.existence_probability, 3),
        "observations": line.observation_count,
        "shift_m": None if line.shift_m is None else round(line.shift_m, 3),
    }


def summary_rows(report: IngestReport) -> list[dict[str, Any]]:
    """The figures of one ingest, a row each."""
    rows: list[dict[str, Any]] = [
        {"what": name.replace("_", " "), "count": getattr(report, name)}
        for name in ("frame_pairs", "frame_pairs_rejected", "detections", "matches", "positions", "tracks")
    ]
    rows += [{"what": f"rejected: {reason}", "count": count} for reason, count in report.rejections.items()]
    return rows
