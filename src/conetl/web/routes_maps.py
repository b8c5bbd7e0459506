"""Maps, their changesets, and the ways of their drives."""

from __future__ import annotations

from uuid import UUID

from fastapi import APIRouter, HTTPException, Request

from conetl.db.map.map_store import find_map, list_changesets
from conetl.db.serve_store import read_maps, read_trajectory
from conetl.model.records import Rig, Vec3, utc_from_ns
from conetl.web.models import MapItem, Maps, Timeline, Trajectory
from conetl.web.parameters import MAX_TRAJECTORY, MapName, Reader, origin_of
from conetl.web.rows import camera_place, timeline_item

router = APIRouter(tags=["maps"])


@router.get("/maps")
def maps(request: Request, conn: Reader) -> Maps:
    """All maps of the database."""
    return Maps(maps=[MapItem(**row) for row in read_maps(conn)], chosen=request.app.state.map_name)


@router.get("/maps/{map_name}/timeline")
def timeline(map_name: MapName, conn: Reader) -> Timeline:
    """All changesets of a map, oldest first."""
    origin = origin_of(conn, map_name)
    info = find_map(conn, map_name)
    if info is None:
        raise HTTPException(404, f"There is no map {map_name}.")
    items = [timeline_item(c) for c in reversed(list_changesets(conn, map_name=map_name))]
    return Timeline(map_name=map_name, srid=info.srid, origin_m=origin, changesets=items)


@router.get("/maps/{map_name}/drives/{drive_uuid}/trajectory")
def trajectory(map_name: MapName, drive_uuid: UUID, conn: Reader) -> Trajectory:
    """The way of the left camera of one drive."""
    origin = origin_of(conn, map_name)
    rows = read_trajectory(conn, map_name, drive_uuid, MAX_TRAJECTORY + 1)
    if not rows:
        known = [c.drive_id for c in list_changesets(conn, map_name=map_name) if c.drive_uuid == drive_uuid]
        if not known:
            raise HTTPException(404, f"The map {map_name} knows no drive {drive_uuid}.")
        return _no_way(known[0], drive_uuid, origin)  # an imported map went nowhere
    rig = Rig.model_validate(rows[0]["rig"])
    shown = rows[:MAX_TRAJECTORY]
    return Trajectory(
        drive_id=rows[0]["drive_id"],
        drive_uuid=drive_uuid,
        origin_m=origin,
        frame_index=[row["frame_index"] for row in shown],
        captured_at=[utc_from_ns(row["captured_at_ns"]) for row in shown],
        xyz_m=[camera_place(row, rig, origin) for row in shown],
        truncated=len(rows) > MAX_TRAJECTORY,
    )


def _no_way(drive_id: str, drive_uuid: UUID, origin: Vec3) -> Trajectory:
    return Trajectory(
        drive_id=drive_id,
        drive_uuid=drive_uuid,
        origin_m=origin,
        frame_index=[],
        captured_at=[],
        xyz_m=[],
        truncated=False,
    )
