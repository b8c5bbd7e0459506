"""Checks of a drive's positions against the whole map and its other drives, once, when the drive is committed.

A replay, which repeats its checks, compares only what a drive may have in view.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from conetl.db.connection import Connection
from conetl.db.map.commit import path_wkt
from conetl.db.map.drive_store import same_rig_elsewhere
from conetl.db.map.import_store import far_from_all
from conetl.db.map.map_store import find_map, read_features_as_of
from conetl.geometry.geodesy import to_geodetic, to_map
from conetl.geometry.linear_reference import evenly_spaced
from conetl.mapping.displacement import FARTHEST_M, check_far_positions
from conetl.model.drive import Drive, DriveRecords
from conetl.model.health import HealthCheck, Verdict, hold
from conetl.model.params import ReconcileParams
from conetl.readers.base_layers.georeferencing import FAR_M

#: Tracks that are compared with what stands farther away, and how many times in a drive.
_TOGETHER, _MOST_PARTS = 40, 5
#: Width of a UTM zone. A drive in a wrong zone is on roads of the map (to 10 m beside what a drive there has in view) with this
#: share of its path. Of random roads 0.02 % are, 0.3 % in towns in which every second road is on the map.
_ZONE_DEG, _ON_ROADS_M, _LEAST_ON_ROADS = 6.0, 10.0, 0.9
#: A drive farther than this from everything on the map is unusual; frame pairs that are compared.
_UNUSUAL_M, _COMPARED = 50_000.0, 200
#: A vehicle is not faster (250 km/h), nor in two places farther apart than this at once (areas of drives are 50 m wide).
_MOST_M_S, _APART_M = 70.0, 100.0


def check_positions_on_map(
    conn: Connection, records: DriveRecords, params: ReconcileParams, map_name: str
) -> Iterator[HealthCheck]:
    """The checks that did not pass. Raises DatabaseError from the surrounding transaction."""
    drive, info = records.drive, find_map(conn, map_name)
    if info is None or info.srid != drive.map_srid:
        return
    yield from _cones_elsewhere(conn, records, params, map_name)
    yield from _one_rig_in_two_places(conn, drive, map_name)
    path_m = np.array([pair.pose.map_t_body_m for pair in evenly_spaced(drive.frame_pairs, _COMPARED)])
    if not far_from_all(conn, info, path_m, FAR_M).all():
        return
    lat_deg, lon_deg, height_m = to_geodetic(info.srid, path_m).T
    for east_deg in (-_ZONE_DEG, _ZONE_DEG):
        try:
            there_m = to_map(info.srid, lat_deg, lon_deg + east_deg, height_m)
        except ValueError:  # the map's CRS does not extend that far
            continue
        if far_from_all(conn, info, there_m, _ON_ROADS_M).mean() <= 1.0 - _LEAST_ON_ROADS:
            yield _wrong_zone(east_deg)
            return
    if far_from_all(conn, info, path_m, _UNUSUAL_M).all():
        yield _far_away()


def _cones_elsewhere(
    conn: Connection, records: DriveRecords, params: ReconcileParams, map_name: str
) -> Iterator[HealthCheck]:
    """A hold if a drive may be some 100 m from where the map has its cones. For a long drive, some parts are checked."""
    parts = [records.tracks[k : k + _TOGETHER] for k in range(0, len(records.tracks), _TOGETHER)]
    for part in evenly_spaced(parts, _MOST_PARTS):
        east_m, north_m = np.array([track.xyz_m[:2] for track in part]).T
        low, high = ((float(side(east_m)), float(side(north_m))) for side in (np.min, np.max))
        box = (low[0] - FARTHEST_M, low[1] - FARTHEST_M, high[0] + FARTHEST_M, high[1] + FARTHEST_M)
        around = read_features_as_of(conn, map_name=map_name, within=box)
        found = check_far_positions(part, [one.feature for one in around], params)
        if found is not None:
            yield found
            return


def _wrong_zone(east_deg: float) -> HealthCheck:
    detail = (
        f"The drive is more than {FAR_M / 1000:g} km from everything on the map, but would be on roads of the map if it were "
        f"{_ZONE_DEG:g} degrees farther {'east' if east_deg > 0 else 'west'}, one UTM zone: correct the zone of its coordinates "
        "(trajectory.crs in drive.yaml)."
    )
    return hold("UTM zone", detail, value=-east_deg, unit="degrees")


def _far_away() -> HealthCheck:
    detail = (
        f"Nothing else on the map is within {_UNUSUAL_M / 1000:g} km of this drive: if this is not a new region, revert it and "
        "check the CRS, zone and signs of its coordinates."
    )
    return HealthCheck(name="distance from the rest of the map", verdict=Verdict.WARN, value=None, detail=detail)


def _one_rig_in_two_places(conn: Connection, drive: Drive, map_name: str) -> Iterator[HealthCheck]:
    """A warning if a drive of the same rig was too far away at that time: the times or positions of one of them are wrong."""
    found = same_rig_elsewhere(conn, drive, path_wkt(drive), map_name=map_name, most_m_s=_MOST_M_S, apart_m=_APART_M)
    if found is not None:
        when = f"{found.apart_s:.0f} s before or after it" if found.apart_s else "at the same time"
        detail = (
            f"Drive {found.drive_id} has the same rig (rig_id {drive.rig.rig_id}) and was {found.apart_m / 1000:.1f} km away "
            f"{when}: the times (time zone, date) or positions of one of them are wrong. If they were recorded by two "
            "vehicles, give the rig of one a separate rig_id in its drive.yaml."
        )
        yield HealthCheck(
            name="one rig in two places", verdict=Verdict.WARN, value=found.apart_m / 1000, unit="km", detail=detail
        )
