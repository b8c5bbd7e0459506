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
from conetl.mapping.displacement import check_far_positions
from conetl.model.check_params import RegionCheckParams
from conetl.model.drive import Drive, DriveRecords
from conetl.model.health import Finding
from conetl.model.params import IngestParams, ReconcileParams
from conetl.readers.base_layers.georeferencing import FAR_M

#: Tracks that are compared with what stands farther away, and how many times in a drive.
_TOGETHER, _MOST_PARTS = 40, 5
#: Width of a UTM zone. A drive in a wrong zone is on roads of the map: to 10 m beside what a drive there has in view.
_ZONE_DEG, _ON_ROADS_M = 6.0, 10.0
#: Frame pairs that are compared.
_COMPARED = 200


def check_positions_on_map(
    conn: Connection, records: DriveRecords, params: IngestParams, map_name: str
) -> Iterator[Finding]:
    """What contradicts the drive, or is unusual. Raises DatabaseError from the surrounding transaction."""
    drive, info, limits = records.drive, find_map(conn, map_name), params.check.region
    if info is None or info.srid != drive.map_srid:
        return
    yield from _cones_elsewhere(conn, records, params.reconcile, map_name)
    yield from _one_rig_in_two_places(conn, drive, map_name, limits)
    path_m = np.array([pair.pose.map_t_body_m for pair in evenly_spaced(drive.frame_pairs, _COMPARED)])
    if not far_from_all(conn, info, path_m, FAR_M).all():
        return
    lat_deg, lon_deg, height_m = to_geodetic(info.srid, path_m).T
    for east_deg in (-_ZONE_DEG, _ZONE_DEG):
        try:
            there_m = to_map(info.srid, lat_deg, lon_deg + east_deg, height_m)
        except ValueError:  # the map's CRS does not extend that far
            continue
        if far_from_all(conn, info, there_m, _ON_ROADS_M).mean() <= 1.0 - limits.least_on_roads:
            direction = "east" if east_deg > 0 else "west"
            yield Finding(
                check="UTM zone", value=-east_deg, found=True, facts={"direction": direction, "far_km": FAR_M / 1000}
            )
            return
    if far_from_all(conn, info, path_m, 1000 * limits.unusual_km).all():
        facts = {"km": limits.unusual_km}
        yield Finding(check="distance from the rest of the map", found=True, facts=facts)


def _cones_elsewhere(
    conn: Connection, records: DriveRecords, params: ReconcileParams, map_name: str
) -> Iterator[Finding]:
    """Whether a drive may be some 100 m from where the map has its cones. For a long drive, some parts are checked."""
    parts = [records.tracks[k : k + _TOGETHER] for k in range(0, len(records.tracks), _TOGETHER)]
    for part in evenly_spaced(parts, _MOST_PARTS):
        east_m, north_m = np.array([track.xyz_m[:2] for track in part]).T
        low, high = ((float(side(east_m)), float(side(north_m))) for side in (np.min, np.max))
        reach_m = params.agreement.elsewhere_m
        box = (low[0] - reach_m, low[1] - reach_m, high[0] + reach_m, high[1] + reach_m)
        around = read_features_as_of(conn, map_name=map_name, within=box)
        found = check_far_positions(part, [one.feature for one in around], params)
        if found is not None:
            yield found
            return


def _one_rig_in_two_places(
    conn: Connection, drive: Drive, map_name: str, limits: RegionCheckParams
) -> Iterator[Finding]:
    """Whether a drive of the same rig was too far away at that time: the times or positions of one of them are wrong."""
    found = same_rig_elsewhere(
        conn, drive, path_wkt(drive), map_name=map_name, most_m_s=limits.most_m_s, apart_m=limits.apart_m
    )
    if found is not None:
        when = f"{found.apart_s:.0f} s before or after it" if found.apart_s else "at the same time"
        facts = {"drive_id": found.drive_id, "rig_id": drive.rig.rig_id, "when": when}
        yield Finding(check="one rig in two places", value=found.apart_m / 1000, found=True, facts=facts)
