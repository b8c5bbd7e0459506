"""Routes of images: drives past a feature, frame pairs with boxes and cameras, images and crops; the QA report of a drive."""

from __future__ import annotations

from typing import Annotated, Any, Literal
from uuid import UUID

from fastapi import APIRouter, HTTPException, Query, Request, Response
from fastapi.responses import HTMLResponse

from conetl.db import serve_store as store
from conetl.db.connection import Connection
from conetl.db.map.map_store import list_changesets
from conetl.db.reader_pool import ReaderPool
from conetl.files.people import log_whole_image
from conetl.model.base import utc_from_ns
from conetl.model.errors import ConetlError
from conetl.model.rig import Rig
from conetl.reports.camera_images import Box, crop_jpeg, frame_jpeg, image_file
from conetl.reports.drive_passes import expected_box, passes_of, pose_of
from conetl.web import rows as to
from conetl.web.judging_models import Frame, Passes
from conetl.web.parameters import ChangesetNo, Index, MapName, Origin, Reader, cut
from conetl.web.security import person_of

router = APIRouter(prefix="/maps/{map_name}")
_MAX_PASSES = 30
_IMAGE: dict[str, Any] = {"response_class": Response, "responses": {200: {"content": {"image/jpeg": {}}}}}
Version = Annotated[int | None, Query(ge=1, le=2**31 - 1, description="Version of the feature; default: the latest.")]
#: The report is one file that contains its styles and images, and runs nothing.
_REPORT_POLICY = (
    "default-src 'none'; img-src data:; style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'"
)
Context = Annotated[
    float,
    Query(
        ge=1.0, le=100.0, allow_inf_nan=False, description="Width and height of the crop in units of the box; 100 shows all."
    ),
]  # fmt: skip


@router.get("/features/{feature_id}/passes", tags=["frames"])
def passes(map_name: MapName, feature_id: UUID, conn: Reader, origin: Origin, version: Version = None) -> Passes:
    """The drives that have the position of a feature in view, with the frame pairs that show it, observed or empty."""
    history = store.read_feature_history(conn, map_name, feature_id)
    states = [row for row in history if version in (None, row["version"])]
    if not states:
        raise HTTPException(404, f"The map {map_name} has no feature {feature_id} of this version.")
    found = passes_of(conn, map_name, feature_id, states[-1], max_drives=_MAX_PASSES + 1)
    shown, truncated = cut(found, _MAX_PASSES)
    return Passes(
        feature_id=feature_id,
        version=states[-1]["version"],
        origin_m=origin,
        passes=[to.drive_pass(one, origin) for one in shown],
        truncated=truncated,
    )


@router.get("/drives/{drive_uuid}/frames/{frame_index}", tags=["frames"])
def frame(
    map_name: MapName, drive_uuid: UUID, frame_index: Index, conn: Reader, origin: Origin, request: Request
) -> Frame:
    """The cameras and detections of one frame pair, and whether its images are still there."""
    row = _frame(conn, map_name, drive_uuid, frame_index)
    boxes = store.read_frame_boxes(conn, drive_uuid, frame_index)
    left, right = (to.frame_view(row, side, boxes[side], _problem(row, side), origin) for side in ("left", "right"))
    return Frame(
        drive_id=row["drive_id"],
        drive_uuid=drive_uuid,
        frame_index=frame_index,
        captured_at=utc_from_ns(row["captured_at_ns"]),
        origin_m=origin,
        pixelated=not _sees_whole(request),
        left=left,
        right=right,
    )


@router.get("/drives/{drive_uuid}/frames/{frame_index}/{side}.jpg", tags=["frames"], **_IMAGE)
def frame_image(
    map_name: MapName,
    drive_uuid: UUID,
    frame_index: Index,
    side: Literal["left", "right"],
    request: Request,
    feature_id: Annotated[UUID | None, Query(description="Also show the positions of this feature sharp.")] = None,
) -> Response:
    """JPEG of a whole rectified image; pixelated except around detections and the feature, for those who may
    not see it whole."""
    pool: ReaderPool = request.app.state.pool
    with pool.reading() as conn:  # released before the image is decoded
        row = _frame(conn, map_name, drive_uuid, frame_index)
        boxes = store.read_frame_boxes(conn, drive_uuid, frame_index)[side]
        history = [] if feature_id is None else store.read_feature_history(conn, map_name, feature_id)
    rig, pose = Rig.model_validate(row["rig"]), pose_of(row)
    expected = {
        expected_box(to.position(state), state["object_height_m"], pose, rig, side, state["category"])
        for state in history
    }
    sharp = [_xywh(box) for box in boxes]
    sharp += [box for box in expected if box is not None and _is_near(box, rig)]
    path = image_file(row["source_path"], row[f"{side}_path"])
    whole = _show_whole(request, map_name, row, frame_index, side)
    return _image(frame_jpeg(path, rig, side, sharp, whole=whole), whole)


def _sees_whole(request: Request) -> bool:
    person = person_of(request)
    return request.app.state.whole_images or (person is not None and person.sees_whole_images)


def _show_whole(request: Request, map_name: str, row: dict[str, Any], frame_index: int, side: str) -> bool:
    """Whether this request gets the whole image, which is logged before."""
    if not _sees_whole(request):
        return False
    person = person_of(request)
    if request.app.state.image_log is not None:
        what = {"map": map_name, "drive": row["drive_id"], "frame_index": frame_index, "side": side}
        log_whole_image(request.app.state.image_log, person.name if person else None, **what)
    return True


def _image(jpeg: bytes, whole: bool) -> Response:
    """Browsers keep no whole image, so each view of one is logged."""
    headers = {"Cache-Control": "no-store" if whole else "private, max-age=3600", "Vary": "Cookie, Authorization"}
    return Response(jpeg, media_type="image/jpeg", headers=headers)


def _frame(conn: Connection, map_name: str, drive_uuid: UUID, frame_index: int) -> dict[str, Any]:
    rows = store.read_rows(conn, "judging.frame", map_name=map_name, drive_uuid=drive_uuid, frame_index=frame_index)
    if not rows:
        raise HTTPException(404, f"The map {map_name} has no frame pair {frame_index} of drive {drive_uuid}.")
    return rows[0]


def _xywh(box: store.Row) -> Box:
    return box["x_px"], box["y_px"], box["w_px"], box["h_px"]


def _problem(row: dict[str, Any], side: str) -> str | None:
    """Why an image cannot be shown; None if its file exists."""
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


@router.get("/drives/{drive_uuid}/pictures/{frame_index}/{match_index}/{side}.jpg", tags=["images"], **_IMAGE)
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
        row = _frame(conn, map_name, drive_uuid, frame_index)
        boxes = store.read_frame_boxes(conn, drive_uuid, frame_index)[side]
    found = [box for box in boxes if box["match_index"] == match_index]
    if not found:
        raise HTTPException(
            404, f"The map {map_name} has no match {match_index} in frame pair {frame_index} of this drive."
        )
    path, box = image_file(row["source_path"], row[f"{side}_path"]), _xywh(found[0])
    whole = _show_whole(request, map_name, row, frame_index, side)
    return _image(crop_jpeg(path, Rig.model_validate(row["rig"]), side, box, context=context, whole=whole), whole)


@router.get("/changesets/{changeset_no}/report", tags=["images"], response_class=HTMLResponse)
def drive_report(map_name: MapName, changeset_no: ChangesetNo, conn: Reader, _: Origin) -> Response:
    """Counts, changes with images, residuals, rejections, run times and hashes of one drive, made on request."""
    from conetl.reports.drive_page import drive_page  # here: matplotlib takes half a second to load

    found = [c for c in list_changesets(conn, map_name=map_name) if c.changeset_no == changeset_no]
    if not found:
        raise HTTPException(404, f"The map {map_name} has no changeset {changeset_no}.")
    page = drive_page(conn, found[0], map_name=map_name)[0]
    return HTMLResponse(page, headers={"Content-Security-Policy": _REPORT_POLICY})
