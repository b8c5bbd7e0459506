"""Routes of maps: changesets, one feature's history and sightings, camera paths."""

from __future__ import annotations

from uuid import UUID

from fastapi import APIRouter, HTTPException, Request

from conetl.db import serve_store as store
from conetl.db.map.archive import list_maps
from conetl.db.map.map_store import list_changesets, require_map
from conetl.geometry.rig import map_SE3_left
from conetl.model.base import utc_from_ns
from conetl.model.rig import Rig
from conetl.reports.drive_passes import pose_of, reasons_of
from conetl.web import models as m
from conetl.web import rows as to
from conetl.web.parameters import Instant, MapName, Origin, Reader

router = APIRouter(tags=["maps"])
_MAP = "/maps/{map_name}"
_MAX_SIGHTINGS = 2_000
_MAX_TRAJECTORY = 50_000


@router.get("/maps")
def maps(request: Request, conn: Reader) -> m.Maps:
    """All maps of the database."""
    state = request.app.state
    return m.Maps(
        maps=[m.MapItem(**{name: row[name] for name in m.MapItem.model_fields}) for row in list_maps(conn)],
        chosen=state.map_name,
        basemap=state.basemap.item if state.basemap else None,
        embeddable=state.embed_host is not None,
    )


@router.get(f"{_MAP}/timeline")
def timeline(map_name: MapName, conn: Reader, origin: Origin) -> m.Timeline:
    """All changesets of a map, oldest first."""
    srid = require_map(conn, map_name).srid
    items = [to.timeline_item(c) for c in reversed(list_changesets(conn, map_name=map_name))]
    return m.Timeline(map_name=map_name, srid=srid, origin_m=origin, changesets=items)


@router.get(f"{_MAP}/features/{{feature_id}}")
def feature_history(
    map_name: MapName, feature_id: UUID, conn: Reader, origin: Origin, known_at: Instant = None
) -> m.FeatureHistory:
    """The history of one feature, in the state of the database at `known_at`."""
    rows = store.read_feature_history(conn, map_name, feature_id, known_at, origin)
    history = to.history(rows, reasons_of(conn, rows))
    if not history:
        raise HTTPException(
            404,
            f"The map {map_name} has no feature {feature_id}. Perhaps the drive that added it was reverted.",
        )
    return m.FeatureHistory(feature_id=feature_id, origin_m=origin, history=history)


@router.get(f"{_MAP}/features/{{feature_id}}/sightings")
def sightings(map_name: MapName, feature_id: UUID, conn: Reader, origin: Origin) -> m.Sightings:
    """The frame pairs in which one feature was observed, with boxes and camera."""
    feature = {"map_name": map_name, "feature_id": feature_id}
    found, truncated = store.read_some(conn, "serving.sightings", _MAX_SIGHTINGS, **feature)
    drives = list({row["drive_uuid"] for row in found})
    rigs = store.read_rows(conn, "serving.rigs", map_name=map_name, drive_uuids=drives)
    cameras = {row["drive_uuid"]: Rig.model_validate(row["rig"]) for row in rigs}
    return m.Sightings(
        feature_id=feature_id,
        origin_m=origin,
        sightings=[to.sighting(row, cameras[row["drive_uuid"]], origin) for row in found],
        truncated=truncated,
    )


@router.get(f"{_MAP}/drives/{{drive_uuid}}/trajectory")
def trajectory(map_name: MapName, drive_uuid: UUID, conn: Reader, origin: Origin) -> m.Trajectory:
    """The path of the left camera of one drive; empty for an imported map."""
    drive = {"map_name": map_name, "drive_uuid": drive_uuid}
    rows, truncated = store.read_some(conn, "serving.trajectory", _MAX_TRAJECTORY, **drive)
    drive_ids = [row["drive_id"] for row in rows[:1]] or [
        c.drive_id for c in list_changesets(conn, map_name=map_name) if c.drive_uuid == drive_uuid
    ]
    if not drive_ids:
        raise HTTPException(404, f"The map {map_name} has no drive {drive_uuid}.")
    rig = Rig.model_validate(rows[0]["rig"]) if rows else None
    return m.Trajectory(
        drive_id=drive_ids[0],
        drive_uuid=drive_uuid,
        origin_m=origin,
        frame_index=[row["frame_index"] for row in rows],
        captured_at=[utc_from_ns(row["captured_at_ns"]) for row in rows],
        xyz_m=[to.offset(map_SE3_left(pose_of(row), rig)[:3, 3].tolist(), origin) for row in rows] if rig else [],
        truncated=truncated,
    )
