"""The map as files for others, nightly: a folder a publication, and a pointer to the last one.

    folder/
      2026-03-04T020000.000000Z/    one publication: files, each with its manifest, and publication.json
      latest -> 2026-03-04T020000.000000Z

A publication appears whole or not at all: it is written beside the others under a hidden name, and `latest` changes
at the end, in one step.
"""

from __future__ import annotations

import json
import os
import shutil
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from uuid import uuid4

from prefect import flow
from prefect.artifacts import create_table_artifact

from conetl.errors import InputError
from conetl.io.exports import FORMATS
from conetl.io.exports.export import export_map
from conetl.io.exports.source import ExportRequest
from conetl.io.map_store import find_map
from conetl.settings import Settings
from flows.merge import open_map

LATEST = "latest"


@flow(name="publish-map")
def publish_map(settings: Settings, formats: list[str], folder: Path, as_of: datetime | None = None) -> Path:
    """Write the map (as of `as_of`; None: now) in `formats` to a new folder in `folder`, and point `latest` at it; the new
    folder.

    All files tell the map as it was believed at one instant. Raises InputError for an unknown format, a map that is not there, or
    a folder that cannot be written; the last publication stays then.
    """
    published, manifests = write_publication(settings, formats, folder, as_of)
    create_table_artifact(
        [{name: manifest[name] for name in ("file", "rows", "bytes", "sha256")} for manifest in manifests],
        key="publication",
        description=f"Map {settings.map_name} -> {published}",
    )
    return published


def write_publication(
    settings: Settings, formats: list[str], folder: Path, as_of: datetime | None = None
) -> tuple[Path, list[dict[str, Any]]]:
    """As `publish_map`, without Prefect; the new folder and the manifests of its files."""
    unknown = [name for name in formats if name not in FORMATS]
    if unknown or not formats:
        raise InputError(f"formats to publish: {', '.join(unknown) or 'none'}; choose from {', '.join(FORMATS)}")
    started_at = datetime.now(UTC)
    name = started_at.strftime("%Y-%m-%dT%H%M%S.%fZ")
    aside = folder / f".{name}.{uuid4().hex}.tmp"
    try:
        aside.mkdir(parents=True)
    except OSError as error:
        raise InputError(f"{folder} cannot be written ({error.strerror}): choose another folder") from error
    try:
        with open_map(settings) as conn:
            info = find_map(conn, settings.map_name)
            conn.rollback()
            # The belief of the last changeset: what is committed from now on is left out of every file alike.
            believed_at = info.last_committed_at if info else None
            request = ExportRequest(settings.map_name, as_of=as_of, believed_at=believed_at)
            manifests = [
                export_map(conn, aside / f"{settings.map_name}{FORMATS[wanted].suffix}", wanted, request)
                for wanted in dict.fromkeys(formats)
            ]
        (aside / "publication.json").write_text(
            json.dumps({"map": settings.map_name, "files": manifests}, indent=2) + "\n"
        )
        aside.replace(folder / name)
    except BaseException:
        shutil.rmtree(aside, ignore_errors=True)
        raise
    _point_at(folder / LATEST, name)
    return folder / name, manifests


def _point_at(link: Path, target: str) -> None:
    """A symbolic link that replaces the old one in one step."""
    fresh = link.with_name(f".{link.name}.{uuid4().hex}.tmp")
    fresh.symlink_to(target)
    os.replace(fresh, link)  # noqa: PTH105 -- atomic on every platform, unlike Path.rename
