"""The map as files for others: a folder for each publication, and a pointer to the last one.

    folder/
      2026-03-04T020000.000000Z/    one publication: files, each with its manifest, report.html and publication.json
      latest -> 2026-03-04T020000.000000Z

A publication appears whole or not at all: it is written beside the others under a hidden name, and `latest` changes
at the end, in one step.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from conetl.db.connection import Connection
from conetl.db.map.results import MapInfo
from conetl.exports import FORMATS
from conetl.exports.export import export_map
from conetl.exports.source import ExportRequest
from conetl.files.atomic import LATEST, remove_leftovers, temporary_path
from conetl.model.errors import InputError
from conetl.reports.night_page import NightFacts, write_night_page

REPORT = "report.html"
REPORTED = timedelta(days=1)


def write_publication(
    conn: Connection,
    info: MapInfo,
    formats: list[str],
    folder: Path,
    as_of: datetime | None = None,
    drop_folder: Sequence[dict[str, Any]] = (),
) -> tuple[Path, list[dict[str, Any]], NightFacts]:
    """Write a map as of `as_of` (None: latest) in `formats` to a new folder in `folder`; that folder, the manifests of its files,
    and the facts of the report.

    info: the map as it is now: what is committed from now on is left out of every file alike. drop_folder: as for
    `reports.night_page.read_night`. Raises InputError for an unknown
    format, or a folder that cannot be written.
    """
    unknown = [name for name in formats if name not in FORMATS]
    if unknown or not formats:
        raise InputError(f"formats to publish: {', '.join(unknown) or 'none'}; choose from {', '.join(FORMATS)}")
    name = datetime.now(UTC).strftime("%Y-%m-%dT%H%M%S.%fZ")
    unfinished = temporary_path(folder / name)
    try:
        unfinished.mkdir(parents=True)
    except OSError as error:
        raise InputError(f"{folder} cannot be written ({error.strerror}): choose another folder") from error
    remove_leftovers([folder])
    try:
        request = ExportRequest(info.map_name, as_of=as_of, known_at=info.last_committed_at)
        manifests = [
            export_map(conn, unfinished / f"{info.map_name}{FORMATS[wanted].suffix}", wanted, request)
            for wanted in dict.fromkeys(formats)
        ]
        now = datetime.now(UTC)
        facts = write_night_page(
            conn, unfinished / REPORT, map_name=info.map_name, since=now - REPORTED, until=now, drop_folder=drop_folder
        )
        held = [drive.model_dump(mode="json") for drive in facts.held]
        content = {"map": info.map_name, "report": REPORT, "held": held, "files": manifests}
        (unfinished / "publication.json").write_text(json.dumps(content, indent=2) + "\n")
        unfinished.replace(folder / name)
    except BaseException:
        shutil.rmtree(unfinished, ignore_errors=True)
        raise
    fresh = temporary_path(folder / LATEST)
    fresh.symlink_to(name)
    fresh.replace(folder / LATEST)  # replaces the old link in one step
    return folder / name, manifests, facts
