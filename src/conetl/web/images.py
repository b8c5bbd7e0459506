"""Routes of images: crops around detections, and the QA report of a drive."""

from __future__ import annotations

from typing import Annotated, Literal
from uuid import UUID

from fastapi import APIRouter, HTTPException, Query, Request, Response
from fastapi.responses import HTMLResponse

from conetl.db.map.map_store import list_changesets
from conetl.db.reader_pool import ReaderPool
from conetl.db.serve_store import read_sighting_picture
from conetl.model.errors import InputError
from conetl.model.records import Rig
from conetl.reports.camera_images import crop_jpeg, image_file
from conetl.web.parameters import ChangesetNo, Index, MapName, Reader, origin_of

router = APIRouter(tags=["images"], prefix="/maps/{map_name}")
#: The report is one file that contains its styles and images, and runs nothing.
_REPORT_POLICY = (
    "default-src 'none'; img-src data:; style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'"
)
Context = Annotated[
    float,
    Query(
        ge=1.0, le=100.0, allow_inf_nan=False, description="Width and height of the crop in those of the box; 100 shows all."
    ),
]  # fmt: skip


@router.get(
    "/drives/{drive_uuid}/pictures/{frame_index}/{match_index}/{side}.jpg",
    response_class=Response,
    responses={200: {"content": {"image/jpeg": {}}}},
)
def sighting_image(
    map_name: MapName,
    drive_uuid: UUID,
    frame_index: Index,
    match_index: Index,
    side: Literal["left", "right"],
    request: Request,
    context: Context = 3.0,
) -> Response:
    """JPEG of the surroundings of one detection, with its box; the database alone decides which file is read."""
    pool: ReaderPool = request.app.state.pool
    with pool.reading() as conn:  # released before the image is decoded
        row = read_sighting_picture(conn, map_name, drive_uuid, frame_index, match_index, side)
    if row is None:
        raise HTTPException(
            404, f"The map {map_name} has no match {match_index} in frame pair {frame_index} of this drive."
        )
    path = image_file(row["source_path"], row["picture_path"])
    box = (row["x_px"], row["y_px"], row["w_px"], row["h_px"])
    data = crop_jpeg(
        path, Rig.model_validate(row["rig"]), side, box, context=context, whole=request.app.state.whole_images
    )
    return Response(data, media_type="image/jpeg", headers={"Cache-Control": "private, max-age=3600"})


@router.get("/changesets/{changeset_no}/report", response_class=HTMLResponse)
def drive_report(map_name: MapName, changeset_no: ChangesetNo, conn: Reader) -> Response:
    """Counts, changes with images, residuals, rejections, run times and hashes of one drive, made on request."""
    from conetl.reports.drive_page import drive_page  # here: matplotlib takes half a second to load

    origin_of(conn, map_name)
    found = [c for c in list_changesets(conn, map_name=map_name) if c.changeset_no == changeset_no]
    if not found:
        raise HTTPException(404, f"The map {map_name} has no changeset {changeset_no}.")
    try:
        page = drive_page(conn, found[0], map_name=map_name)
    except InputError as error:
        raise HTTPException(404, str(error)) from error
    return HTMLResponse(page, headers={"Content-Security-Policy": _REPORT_POLICY})
