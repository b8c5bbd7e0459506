"""Route of the search: cones, drives, days, coordinates and places in one answer."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Annotated

import numpy as np
from fastapi import APIRouter, HTTPException, Query, Request

from conetl.db.map.map_store import find_features, find_map, list_changesets
from conetl.geometry.geodesy import to_geodetic, to_map
from conetl.model.records import Vec3, utc_from_ns
from conetl.web import models as m
from conetl.web import rows as to
from conetl.web.parameters import MapName, Reader, cut, origin_of

if TYPE_CHECKING:  # GDAL takes seconds to load
    from conetl.readers.maps.gazetteer import Gazetteer

router = APIRouter(tags=["search"])
_MAX_FOUND = 20
_NUMBER = r"[-+]?\d{1,9}(?:\.\d*)?"
#: "458006.5 5428010", "49.005, 8.43", with units or letters of the axes that people copy along.
_PAIR = re.compile(rf"\s*({_NUMBER})\s*(?:°|m|E|N)?\s*[\s,;]\s*({_NUMBER})\s*(?:°|m|E|N)?\s*", re.IGNORECASE)
#: Of two ways to read a pair, the one whose point is nearer to the map is meant, if the other one is farther than this.
_FAR_M = 100_000.0


@router.get("/maps/{map_name}/search")
def search(
    map_name: MapName, conn: Reader, request: Request, text: Annotated[str, Query(min_length=1, max_length=100)]
) -> m.Found:
    """What a text may mean: an id's beginning, a part of a drive's id, a day (2026-03-02), a coordinate pair, a place."""
    origin = origin_of(conn, map_name)
    info = find_map(conn, map_name)
    if info is None:
        raise HTTPException(404, f"There is no map {map_name}.")
    wanted = text.strip()
    ids = []
    if re.fullmatch(r"[0-9a-fA-F-]{1,36}", wanted):
        ids = find_features(conn, wanted, map_name=map_name, max_rows=_MAX_FOUND + 1)
    drives = [
        m.FoundDrive(changeset_no=c.changeset_no, drive_id=c.drive_id, captured_from=utc_from_ns(c.captured_from_ns))
        for c in list_changesets(conn, map_name=map_name)
        if wanted and wanted.casefold() in f"{c.drive_id}\n{utc_from_ns(c.captured_from_ns):%Y-%m-%d}".casefold()
    ]
    feature_ids, more_ids = cut(ids, _MAX_FOUND)
    found_drives, more_drives = cut(drives, _MAX_FOUND)
    return m.Found(
        feature_ids=feature_ids, drives=found_drives, positions=_positions(wanted, info.srid, origin),
        places=_places(wanted, info.srid, origin, request.app.state.gazetteer), truncated=more_ids or more_drives,
    )  # fmt: skip


def _positions(text: str, srid: int, origin: Vec3) -> list[m.FoundPosition]:
    """The point of a coordinate pair: lat, lon where both are small enough, else E N of the map's CRS; swapped if nearer."""
    pair = _PAIR.fullmatch(text)
    if pair is None:
        return []
    a, b = float(pair[1]), float(pair[2])
    readings = []
    for first, second, order in ((a, b, ""), (b, a, "swapped")):
        if abs(a) <= 180 and abs(b) <= 180:
            found = _at(srid, first, second, origin)
            label = "longitude, latitude" if order else "latitude, longitude"
        else:
            found = to.offset((first, second, origin[2]), origin)[:2]
            label = f"EPSG:{srid}, {'north, east' if order else 'east, north'}"
        if found is not None:
            readings.append(m.FoundPosition(label=label, xy_m=found, lat_lon_deg=_lat_lon(srid, found, origin)))
    near = [reading for reading in readings if np.hypot(*reading.xy_m) <= _FAR_M]
    return (near or readings)[:1]


def _places(text: str, srid: int, origin: Vec3, gazetteer: Gazetteer | None) -> list[m.FoundPosition]:
    if gazetteer is None or not text:
        return []
    found = []
    for i in gazetteer.find(text, _MAX_FOUND):
        lon, lat = gazetteer.lon_lat_deg[i].tolist()
        xy_m = _at(srid, lat, lon, origin)
        if xy_m is not None:
            found.append(m.FoundPosition(label=gazetteer.names[i], xy_m=xy_m, lat_lon_deg=(lat, lon)))
    return found


def _at(srid: int, lat_deg: float, lon_deg: float, origin: Vec3) -> tuple[float, float] | None:
    """Metres from the origin; None for a position that the map's CRS cannot express."""
    if abs(lat_deg) > 90 or abs(lon_deg) > 180:
        return None
    try:
        return to.offset(to_map(srid, lat_deg, lon_deg, 0.0).tolist(), origin)[:2]
    except ValueError:
        return None


def _lat_lon(srid: int, xy_m: tuple[float, float], origin: Vec3) -> tuple[float, float] | None:
    lat, lon = to_geodetic(srid, (xy_m[0] + origin[0], xy_m[1] + origin[1], 0.0))[:2].tolist()
    return (lat, lon) if np.isfinite([lat, lon]).all() else None
