"""`export_map` writes a map as a file of any format, completely or not at all, with a manifest beside it."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from conetl.db.connection import Connection, query, transaction
from conetl.exports import FORMATS, Format, writer_of
from conetl.exports.source import ExportContent, ExportRequest, ExportSource, open_source
from conetl.exports.text_files import iso_utc
from conetl.files.atomic import atomic_files
from conetl.files.parquet_store import file_sha256
from conetl.geometry.geodesy import height_system_name
from conetl.model.errors import InputError

MANIFEST_VERSION = 1
_WGS84 = "OGC:CRS84"
#: Memory of the database per sort or join. Enough for a million features; a history has more joins and any length.
_WORK_MEM = {ExportContent.FEATURES: "128MB", ExportContent.CHANGES: "64MB", ExportContent.HISTORY: "64MB"}


def export_map(conn: Connection, path: Path, file_format: str, request: ExportRequest) -> dict[str, Any]:
    """Write the rows of `request` to `path` and a manifest to `path` + '.manifest.json'. Returns the manifest.

    All rows come from one snapshot of the database, in batches. All files appear at the end, or none. If the map has lane
    markings and a file of the format holds one type of geometry only, they are in a second file (`cones_lane_markings.csv`)
    with a manifest of its own; `lane_markings` of the manifest says in which file they are, and how many. Raises InputError for
    an unknown format or map, and if the files cannot be written.
    """
    if file_format not in FORMATS:
        raise InputError(f"unknown format {file_format}: choose one of {', '.join(FORMATS)}")
    chosen = FORMATS[file_format]
    with transaction(conn, f"The map {request.map_name} cannot be read"):
        query(conn, "exports.snapshot")
        query(conn, "exports.memory", work_mem=_WORK_MEM[request.what])
        with open_source(conn, request, chosen.order) as sources:
            groups = [[source] for source in sources] if chosen.one_geometry else [sources]
            paths = [path, path.with_name(f"{path.stem}_lane_markings{path.suffix}")][: len(groups)]
            beside = [one.with_name(one.name + ".manifest.json") for one in paths]
            with atomic_files(*paths, *beside) as written:
                files, manifest_files = written[: len(paths)], written[len(paths) :]
                for group, file in zip(groups, files, strict=True):
                    writer_of(file_format)(group, file)
                manifests = [
                    _manifest(group, file_format, chosen, file) for group, file in zip(groups, files, strict=True)
                ]
                if len(sources) > 1:
                    lines = {
                        "file": files[-1].name,
                        "rows": sources[-1].counts.total(),
                        "columns": sources[-1].property_names,
                    }
                    manifests[0]["lane_markings"] = lines
                for manifest, file in zip(manifests, manifest_files, strict=True):
                    file.write_text(json.dumps(manifest, indent=2) + "\n", encoding="utf-8")
    return manifests[0]


def _manifest(sources: Sequence[ExportSource], file_format: str, chosen: Format, file: Path) -> dict[str, Any]:
    """Of a file that holds all rows of the sources."""
    source, counts = sources[0], sum((one.counts for one in sources), Counter[str]())
    request = source.request
    facts = query(source.conn, "exports.facts", map_name=request.map_name)[0]
    return {
        "manifest_version": MANIFEST_VERSION,
        "file": file.name,
        "format": file_format,
        "sha256": file_sha256(file),
        "bytes": file.stat().st_size,
        "rows": counts.total(),
        "rows_by_class": dict(sorted(counts.items())),
        "what": str(request.what),
        "map": request.map_name,
        "as_of": _text(request.as_of),
        "known_at": _text(request.known_at),
        "from": _text(request.since),
        "to": _text(request.until),
        "box_m": request.box_m,
        "category": request.category,
        "last_committed_at": _text(source.info.last_committed_at),
        "changesets": facts["changeset_count"],
        "exported_at": iso_utc(datetime.now(UTC)),
        "crs": _WGS84 if chosen.geographic else source.crs_text,
        "map_crs": f"EPSG:{source.info.srid}",
        "heights": "ellipsoidal, metres" if source.epsg[1] is None else f"{height_system_name(source.epsg[1])}, metres",
        "height_system": height_system_name(source.epsg[1]),
        "columns": source.property_names,
        "code_version": version("conetl"),
        "schema_version": facts["schema_version"],
        "licence": facts["licence"],
    }


def _text(instant: datetime | None) -> str | None:
    return None if instant is None else iso_utc(instant)
