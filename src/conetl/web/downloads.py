"""Route of downloads: the state of the map that the page shows, as a file of `conetl.exports`."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path as FilePath
from tempfile import TemporaryDirectory
from typing import Annotated, Literal

from fastapi import APIRouter, HTTPException, Query, Request
from fastapi.responses import FileResponse
from pydantic import AfterValidator
from starlette.background import BackgroundTask

from conetl.db.map.map_store import find_map
from conetl.db.reader_pool import ReaderPool
from conetl.exports import FORMATS, ZONE_FORMATS
from conetl.model.errors import InputError
from conetl.web.models import Problem
from conetl.web.parameters import Instant, MapName

router = APIRouter(tags=["downloads"])
_MEDIA_TYPES = {
    "geojson": "application/geo+json", "csv": "text/csv", "gpkg": "application/geopackage+sqlite3",
    **{name: form.media_type for name, form in ZONE_FORMATS.items()},
}  # fmt: skip
_NUMBERS = ",".join([r"-?\d{1,9}(?:\.\d{1,6})?"] * 4)


def _corners(box: str) -> tuple[float, float, float, float]:
    west, south, east, north = map(float, box.split(","))
    return west, south, east, north


def _ordered(box: str | None) -> str | None:
    if box is not None:
        west, south, east, north = _corners(box)
        if west > east or south > north:
            raise ValueError("expected west, south, east, north, each in the map's CRS")
    return box


def _in_a_file(instant: datetime | None) -> datetime | None:
    if instant is not None and not 1 < instant.year < 9999:
        raise ValueError("expected a time between the years 2 and 9998")
    return instant


Box = Annotated[
    str | None, AfterValidator(_ordered),
    Query(pattern=f"^{_NUMBERS}$", description="West, south, east, north in the map's CRS; default: the whole map."),
]  # fmt: skip
Time = Annotated[Instant, AfterValidator(_in_a_file)]
Text = Annotated[str | None, Query(max_length=200)]


@router.get(
    "/maps/{map_name}/downloads/{file_format}",
    response_class=FileResponse,
    responses={200: {"content": {kind: {} for kind in _MEDIA_TYPES.values()}}, 400: {"model": Problem}},
)
def download(
    map_name: MapName,
    file_format: Literal["geojson", "csv", "gpkg", "wzdx"],
    request: Request,
    valid_at: Time = None,
    known_at: Time = None,
    from_valid_at: Time = None,
    box: Box = None,
    publisher: Text = None,
    road_name: Text = None,
) -> FileResponse:
    """The map at an instant as a file; with `from_valid_at`, the changes since then; `wzdx`: its work zones.

    WZDx requires the publisher and the name of the road, and describes the whole map as the database knows it now.
    """
    from conetl.exports.export import export_map  # here: Arrow takes a second to load
    from conetl.exports.source import ExportContent, ExportRequest
    from conetl.pipeline.maps.work_zones import export_zones

    pool: ReaderPool = request.app.state.pool
    name = _file_name(map_name, file_format, valid_at, from_valid_at)
    try:
        with ExitStack() as kept, pool.exporting() as conn:
            path = FilePath(kept.enter_context(TemporaryDirectory(prefix="conetl-download-"))) / name
            if find_map(conn, map_name) is None:
                raise HTTPException(404, f"There is no map {map_name}.")
            if file_format in ZONE_FORMATS:
                publisher, road_name = (publisher or "").strip(), (road_name or "").strip()
                if not (publisher and road_name):
                    raise InputError("A WZDx feed requires the publisher and the name of the road.")
                export_zones(
                    conn, path, file_format, map_name=map_name, as_of=valid_at, feed=None, publisher=publisher,
                    road_names=[road_name], lanes=None,
                )  # fmt: skip
            else:
                asked = ExportRequest(
                    map_name, known_at=known_at, as_of=valid_at, box_m=None if box is None else _corners(box)
                )
                if from_valid_at is not None:
                    asked = replace(asked, what=ExportContent.CHANGES, as_of=None, since=from_valid_at, until=valid_at)
                export_map(conn, path, file_format, asked)
            sent = BackgroundTask(kept.pop_all().close)
    except InputError as error:
        raise HTTPException(400, str(error)) from error
    # Not compressed: the browser can show the progress of the download.
    headers = {"Content-Encoding": "identity", "Cache-Control": "no-store"}
    return FileResponse(path, filename=name, headers=headers, media_type=_MEDIA_TYPES[file_format], background=sent)


def _file_name(map_name: str, file_format: str, until: datetime | None, since: datetime | None) -> str:
    """Name with the map and the time: of the state, or of the download if the state has none."""
    suffix = (ZONE_FORMATS.get(file_format) or FORMATS[file_format]).suffix
    times = (since, until or datetime.now(UTC))
    parts = [f"{time.astimezone(UTC):%Y-%m-%dT%H-%M-%SZ}" for time in times if time]
    return f"{map_name}_{'changes_' if since else ''}{'_'.join(parts)}{suffix}"
