"""The QA report of a drive as a page, made when it is asked for."""

from __future__ import annotations

from fastapi import APIRouter, HTTPException, Response
from fastapi.responses import HTMLResponse

from conetl.db.map.map_store import list_changesets
from conetl.model.errors import InputError
from conetl.web.parameters import ChangesetNo, MapName, Reader, origin_of

router = APIRouter(tags=["reports"], prefix="/maps/{map_name}")
#: The page is one file: its styles and pictures are inside it, and it runs nothing.
_POLICY = (
    "default-src 'none'; img-src data:; style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'"
)


@router.get("/changesets/{changeset_no}/report", response_class=HTMLResponse)
def drive_report(map_name: MapName, changeset_no: ChangesetNo, conn: Reader) -> Response:
    """Counts, changes with pictures, residuals, refused records, times and hashes of one drive."""
    from conetl.reports.drive_page import drive_page  # here: matplotlib takes half a second to load

    origin_of(conn, map_name)
    found = [c for c in list_changesets(conn, map_name=map_name) if c.changeset_no == changeset_no]
    if not found:
        raise HTTPException(404, f"The map {map_name} knows no changeset {changeset_no}.")
    try:
        page = drive_page(conn, found[0], map_name=map_name)
    except InputError as error:
        raise HTTPException(404, str(error)) from error
    return HTMLResponse(page, headers={"Content-Security-Policy": _POLICY})
