"""Routes of the image viewer: the drives past a feature, one frame pair with boxes and cameras, its whole images."""

from __future__ import annotations

from typing import Annotated, Any, Literal
from uuid import UUID

from fastapi import APIRouter, HTTPException, Query, Request, Response

from conetl.db import judging_store as store
from conetl.db.connection import Connection
from conetl.db.reader_pool import ReaderPool
from conetl.db.serve_store import read_feature_history
from conetl.model.errors import ConetlError
from conetl.model.records import Rig, utc_from_ns
from conetl.reports.camera_images import Box, frame_jpeg, image_file
from conetl.reports.drive_passes import expected_box, passes_of
from conetl.web import judging_models as m
from conetl.web import rows as to
from conetl.web.parameters import Index, MapName, Reader, cut, origin_of

router = APIRouter(tags=["frames"], prefix="/maps/{map_name}")
_MAX_PASSES = 30
Version = Annotated[int | None, Query(ge=1, le=2**31 - 1, description="Of the feature; by default its newest one.")]


@router.get("/features/{feature_id}/passes")
def passes(map_name: MapName, feature_id: UUID, conn: Reader, version: Version = None) -> m.Passes:
    """The drives that have the position of a feature in view, with the frame pairs that show it, observed or empty."""
    origin = origin_of(conn, map_name)
    history = read_feature_history(conn, map_name, feature_id)
    states = [row for row in history if version in (None, row["version"])]
    if not states:
        raise HTTPException(404, f"The map {map_name} has no feature {feature_id} of this version.")
    xyz_m = _position(states[-1])
    height_m, category = states[-1]["cone_height_m"], states[-1]["category"]
    found, truncated = cut(
        passes_of(conn, map_name, feature_id, xyz_m, height_m, category=category, max_drives=_MAX_PASSES + 1),
        _MAX_PASSES,
    )
    return m.Passes(
        feature_id=feature_id,
        version=states[-1]["version"],
        origin_m=origin,
        passes=[to.drive_pass(one, origin) for one in found],
        truncated=truncated,
    )


@router.get("/drives/{drive_uuid}/frames/{frame_index}")
def frame(map_name: MapName, drive_uuid: UUID, frame_index: Index, conn: Reader, request: Request) -> m.Frame:
    """The cameras and detections of one frame pair, and whether its images are still there."""
    origin = origin_of(conn, map_name)
    row = _frame(conn, map_name, drive_uuid, frame_index)
    boxes = store.read_frame_boxes(conn, drive_uuid, frame_index)
    left, right = (to.frame_view(row, side, boxes[side], _problem(row, side), origin) for side in ("left", "right"))
    return m.Frame(
        drive_id=row["drive_id"],
        drive_uuid=drive_uuid,
        frame_index=frame_index,
        captured_at=utc_from_ns(row["captured_at_ns"]),
        origin_m=origin,
        pixelated=not request.app.state.whole_images,
        left=left,
        right=right,
    )


@router.get(
    "/drives/{drive_uuid}/frames/{frame_index}/{side}.jpg",
    response_class=Response,
    responses={200: {"content": {"image/jpeg": {}}}},
)
def frame_image(
    map_name: MapName,
    drive_uuid: UUID,
    frame_index: Index,
    side: Literal["left", "right"],
    request: Request,
    feature_id: Annotated[UUID | None, Query(description="Show the positions of this feature sharp as well.")] = None,
) -> Response:
    """JPEG of a whole rectified image; pixelated except around detections and the feature, unless the server shows all."""
    pool: ReaderPool = request.app.state.pool
    with pool.reading() as conn:  # released before the image is decoded
        row = _frame(conn, map_name, drive_uuid, frame_index)
        boxes = store.read_frame_boxes(conn, drive_uuid, frame_index)[side]
        history = [] if feature_id is None else read_feature_history(conn, map_name, feature_id)
    rig, pose = Rig.model_validate(row["rig"]), to.pose_of(row)
    expected = {
        expected_box(_position(state), state["cone_height_m"], pose, rig, side, state["category"]) for state in history
    }
    sharp = [(box["x_px"], box["y_px"], box["w_px"], box["h_px"]) for box in boxes]
    sharp += [box for box in expected if box is not None and _is_near(box, rig)]
    path = image_file(row["source_path"], row[f"{side}_path"])
    data = frame_jpeg(path, rig, side, sharp, whole=request.app.state.whole_images)
    return Response(data, media_type="image/jpeg", headers={"Cache-Control": "private, max-age=3600"})


def _frame(conn: Connection, map_name: str, drive_uuid: UUID, frame_index: int) -> dict[str, Any]:
    row = store.read_frame(conn, map_name, drive_uuid, frame_index)
    if row is None:
        raise HTTPException(404, f"The map {map_name} has no frame pair {frame_index} of drive {drive_uuid}.")
    return row


def _position(row: dict[str, Any]) -> tuple[float, float, float]:
    return row["easting_m"], row["northing_m"], row["height_m"]


def _problem(row: dict[str, Any], side: str) -> str | None:
    """Why an image cannot be shown; None where its file is there."""
    try:
        image_file(row["source_path"], row[f"{side}_path"])
    except ConetlError as error:
        return str(error)
    return None


def _is_near(box: Box, rig: Rig) -> bool:
    """Whether a box is in the image and no larger: a cone beside the camera would show everything."""
    x, y, w, h = box
    inside = -w < x < rig.left.width_px and -h < y < rig.left.height_px
    return inside and 3 * max(w, h) < rig.left.width_px
