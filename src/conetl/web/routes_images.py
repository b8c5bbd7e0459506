"""Crops of the drives' pictures. A request names a stereo match; which file that is, only the database says."""

from __future__ import annotations

from typing import Literal
from uuid import UUID

from fastapi import APIRouter, HTTPException, Request, Response

from conetl.db.reader_pool import ReaderPool
from conetl.db.serve_store import read_sighting_picture
from conetl.model.records import Rig
from conetl.reports.crops import crop_jpeg, picture_file
from conetl.web.parameters import Context, FrameIndex, MapName, MatchIndex

router = APIRouter(tags=["pictures"])


@router.get(
    "/maps/{map_name}/drives/{drive_uuid}/pictures/{frame_index}/{match_index}/{side}.jpg",
    response_class=Response,
    responses={200: {"content": {"image/jpeg": {}}}},
)
def picture(
    map_name: MapName,
    drive_uuid: UUID,
    frame_index: FrameIndex,
    match_index: MatchIndex,
    side: Literal["left", "right"],
    request: Request,
    context: Context = 3.0,
) -> Response:
    """JPEG of what surrounds one detection, with its box."""
    pool: ReaderPool = request.app.state.pool
    with pool.reading() as conn:  # given back before the picture is decoded
        row = read_sighting_picture(conn, map_name, drive_uuid, frame_index, match_index, side)
    if row is None:
        raise HTTPException(
            404, f"The map {map_name} knows no match {match_index} in frame pair {frame_index} of this drive."
        )
    path = picture_file(row["source_path"], row["picture_path"])
    box = (row["x_px"], row["y_px"], row["w_px"], row["h_px"])
    data = crop_jpeg(path, Rig.model_validate(row["rig"]), side, box, context=context)
    return Response(data, media_type="image/jpeg", headers={"Cache-Control": "private, max-age=3600"})
