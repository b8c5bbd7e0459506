"""The map as files for others, every night: a folder a publication, and a pointer to the last one.

    folder/
      2026-03-04T020000.000000Z/    one publication: files, each with its manifest, report.html and publication.json
      latest -> 2026-03-04T020000.000000Z

A publication appears whole or not at all: it is written beside the others under a hidden name, and `latest` changes
at the end, in one step.
"""

import json
import shutil
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Annotated, Any

from prefect import State, flow
from prefect.artifacts import create_link_artifact, create_table_artifact
from prefect.states import Completed
from pydantic import Field

from conetl.db.map.map_store import find_map
from conetl.exports import FORMATS
from conetl.exports.export import export_map
from conetl.exports.source import ExportRequest
from conetl.files.expiry import LATEST
from conetl.files.partial_files import aside, sweep
from conetl.model.errors import InputError
from conetl.pipeline.settings import Settings
from conetl.reports.night_page import write_night_page
from flows.drive_job import MapName, alive, settings_for
from flows.merge import open_map

REPORT = "report.html"
REPORTED = timedelta(days=1)


@flow(name="publish-map", flow_run_name="publish map")
def publish_map(
    map_name: MapName = None,
    formats: Annotated[
        list[str] | None, Field(description=f"Some of {', '.join(FORMATS)}; all of them unless given.")
    ] = None,
    folder: Annotated[
        Path | None, Field(description="Where publications go; `exports` of CONETL_HOME unless given.")
    ] = None,
    as_of: Annotated[datetime | None, Field(description="Instant on the road; as the map stands unless given.")] = None,
) -> State[Any]:
    """Write the map in several formats to a new folder, and point `latest` at it.

    All files tell the map as it was believed at one instant; `report.html` tells of the last 24 hours. Fails for an unknown
    format or a folder that cannot be written; the last publication stays then.
    """
    settings = settings_for(map_name)
    with alive(settings):
        with open_map(settings) as conn:
            if find_map(conn, settings.map_name) is None:
                return Completed(name="NothingToPublish", message=f"the map {settings.map_name} is empty")
        published, manifests = write_publication(
            settings, list(FORMATS) if formats is None else formats, folder or settings.exports_folder, as_of
        )
    create_table_artifact(
        [{name: manifest[name] for name in ("file", "rows", "bytes", "sha256")} for manifest in manifests],
        key="publication",
        description=f"Map {settings.map_name} -> {published}",
    )
    page = published / REPORT
    create_link_artifact(
        page.resolve().as_uri(),
        key="qa-report-night",
        link_text="QA report of the last 24 hours",
        description=f"The file: {page}",
    )
    return Completed(message=f"{len(manifests)} files in {published}")


def write_publication(
    settings: Settings, formats: list[str], folder: Path, as_of: datetime | None = None
) -> tuple[Path, list[dict[str, Any]]]:
    """Write the map of `as_of` (None: latest) in `formats` to a new folder in `folder`; that folder, and its files' manifests.

    Raises InputError for an unknown format, a map that is not there, or a folder that cannot be written.
    """
    unknown = [name for name in formats if name not in FORMATS]
    if unknown or not formats:
        raise InputError(f"formats to publish: {', '.join(unknown) or 'none'}; choose from {', '.join(FORMATS)}")
    name = datetime.now(UTC).strftime("%Y-%m-%dT%H%M%S.%fZ")
    unfinished = aside(folder / name)
    try:
        unfinished.mkdir(parents=True)
    except OSError as error:
        raise InputError(f"{folder} cannot be written ({error.strerror}): choose another folder") from error
    sweep([folder])
    try:
        with open_map(settings) as conn:
            info = find_map(conn, settings.map_name)
            conn.rollback()
            # The belief of the last changeset: what is committed from now on is left out of every file alike.
            believed_at = info.last_committed_at if info else None
            request = ExportRequest(settings.map_name, as_of=as_of, believed_at=believed_at)
            manifests = [
                export_map(conn, unfinished / f"{settings.map_name}{FORMATS[wanted].suffix}", wanted, request)
                for wanted in dict.fromkeys(formats)
            ]
            now = datetime.now(UTC)
            if info is not None:
                write_night_page(conn, unfinished / REPORT, map_name=settings.map_name, since=now - REPORTED, until=now)
        content = {"map": settings.map_name, "report": REPORT if info else None, "files": manifests}
        (unfinished / "publication.json").write_text(json.dumps(content, indent=2) + "\n")
        unfinished.replace(folder / name)
    except BaseException:
        shutil.rmtree(unfinished, ignore_errors=True)
        raise
    _point_at(folder / LATEST, name)
    return folder / name, manifests


def _point_at(link: Path, target: str) -> None:
    """A symbolic link that replaces the old one in one step."""
    fresh = aside(link)
    fresh.symlink_to(target)
    fresh.replace(link)
