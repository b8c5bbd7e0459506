"""Plans of work zones with their history, people's verdicts on differences, and where drives looked, in PostGIS."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np
import shapely

from conetl.db.connection import Connection, copy_columns, or_infinity, query, read, stream_values
from conetl.db.copy_rows import clean_text
from conetl.db.map.map_store import system_time
from conetl.db.map.results import MapInfo
from conetl.db.map.rows import Row
from conetl.model.base import ns_from_utc
from conetl.model.drive import MIN_DETAIL
from conetl.model.planned_zones import Difference, PlannedZone
from conetl.workzones.looks import DriveFrames
from conetl.workzones.plan_comparison import PlacedPlan

#: West, south, east, north in metres of the map's CRS.
Box = tuple[float, float, float, float]


class StoredPlans(NamedTuple):
    """What an import did, by plan id."""

    added: tuple[str, ...]
    changed: tuple[str, ...]
    older: tuple[str, ...]
    """Not stored: the database has a newer version."""
    unchanged: int


def read_plans(
    conn: Connection, *, map_name: str, list_name: str | None = None, known_at: datetime | None = None
) -> list[PlacedPlan]:
    """The plans of a map, of one list or all, as the database knew them (None: now)."""
    what, known = f"The plans of map {map_name} cannot be read", or_infinity(known_at)
    rows = read(conn, what, "plans.plans", map_name=map_name, list_name=list_name, known_at=known)
    shapes = shapely.from_wkb([bytes(row["geom"]) for row in rows])
    return [
        PlacedPlan(row["list_name"], PlannedZone.model_validate(row["record"]), shape)
        for row, shape in zip(rows, shapes, strict=True)
    ]


def write_plans(
    conn: Connection, info: MapInfo, list_name: str, file_name: str, plans: Sequence[tuple[PlannedZone, Any]]
) -> StoredPlans:
    """Store plans with their shapes (map CRS) in the caller's `map_transaction`; what is stored already changes nothing."""
    known = {one.plan.plan_id: one.plan for one in read_plans(conn, map_name=info.map_name, list_name=list_name)}
    older = [plan.plan_id for plan, _ in plans if plan.plan_id in known and plan.order < known[plan.plan_id].order]
    new = [one for one in plans if one[0] != known.get(one[0].plan_id) and one[0].plan_id not in older]
    changed = [plan.plan_id for plan, _ in new if plan.plan_id in known]
    if new:
        at = system_time(conn, info)
        key = {"map_id": info.map_id, "list_name": list_name}
        query(conn, "plans.end_plans", **key, plan_ids=changed, at=at)
        shapes = shapely.set_srid([shape for _, shape in new], info.srid)
        shared = {"srid": info.srid, "file_name": clean_text(file_name), "system_period": f"[{at.isoformat()},)"} | key
        columns = {name: [value] * len(new) for name, value in shared.items()}
        copy_columns(conn, "conetl.plan", columns | {
            "plan_id": [plan.plan_id for plan, _ in new],
            "record": [plan.model_dump(mode="json") for plan, _ in new],
            "geom": list(shapely.to_wkb(shapes, hex=True, include_srid=True)),
        })  # fmt: skip
    added = [plan.plan_id for plan, _ in new if plan.plan_id not in known]
    return StoredPlans(tuple(added), tuple(changed), tuple(older), len(plans) - len(new) - len(older))


def read_frames_near(conn: Connection, boxes: Iterable[Box], *, map_name: str, until: datetime) -> list[DriveFrames]:
    """The frame pairs of the active drives in boxes that show absence, by drive."""
    edges = np.array(list(boxes), np.float64).reshape(-1, 4).T.tolist()
    sides = dict(zip(("west_m", "south_m", "east_m", "north_m"), edges, strict=True))
    rows = stream_values(
        conn, f"The drives of map {map_name} cannot be read", "plans.frames_near", map_name=map_name,
        until_ns=ns_from_utc(until), least_detail=MIN_DETAIL, **sides,
    )  # fmt: skip
    found = []
    for drive_id, some in groupby(rows, key=lambda row: row[0]):
        _, frames, at_ns, east, north = zip(*some, strict=True)
        found.append(DriveFrames(drive_id, np.array(frames), np.array(at_ns, np.int64), np.column_stack([east, north])))
    return found


def read_images(conn: Connection, sights: Sequence[tuple[str, int]], *, map_name: str) -> dict[tuple[str, int], str]:
    """The left images of frame pairs (drive id, index): path of the drive, and of the image in it."""
    drive_ids, frames = ([one[k] for one in sights] for k in range(2))
    what = f"The drives of map {map_name} cannot be read"
    rows = read(conn, what, "plans.images", map_name=map_name, drive_ids=drive_ids, frames=frames)
    return {(row["drive_id"], row["frame_index"]): f"{row['source_path']}/{row['left_path']}" for row in rows}


def read_verdicts(conn: Connection, *, map_name: str, known_at: datetime | None = None) -> Sequence[Row]:
    """Columns of `plans.verdicts`, in the order in which they were given."""
    what = f"The verdicts on differences of map {map_name} cannot be read"
    return read(conn, what, "plans.verdicts", map_name=map_name, known_at=or_infinity(known_at))


def write_verdict(
    conn: Connection, info: MapInfo, one: Difference, verdict: str, *, note: str, decided_by: str | None
) -> None:
    """Write what a person says about a difference in the caller's `map_transaction`."""
    seen_from, seen_until = span_of(one)
    query(
        conn, "plans.insert_verdict", map_id=info.map_id, srid=info.srid, kind=one.kind.value, list_name=one.list_name,
        plan_id=one.plan_id, easting_m=one.xy_m[0], northing_m=one.xy_m[1], radius_m=one.radius_m, seen_from=seen_from,
        seen_until=seen_until, verdict=verdict, note=clean_text(note), decided_by=decided_by and clean_text(decided_by),
        decided_at=system_time(conn, info),
    )  # fmt: skip


def span_of(one: Difference) -> tuple[datetime | None, datetime | None]:
    """When the zone of a difference stood, as far as drives know, else when it was planned; None: open."""
    if one.zone_id is None or one.first is None:
        return one.planned_from, one.planned_until
    return one.first.at, None if one.gone is None else one.gone.at


def is_about(verdict: Mapping[str, Any], one: Difference) -> bool:
    """Whether a row of `read_verdicts` is about a difference: of its kind and plan, at its place and time."""
    begin, end = span_of(one)
    east, north = one.xy_m[0] - verdict["easting_m"], one.xy_m[1] - verdict["northing_m"]
    return (
        (verdict["kind"], verdict["list_name"], verdict["plan_id"]) == (one.kind, one.list_name, one.plan_id)
        and (east * east + north * north) ** 0.5 <= max(verdict["radius_m"], one.radius_m)
        and (verdict["seen_until"] is None or begin is None or begin <= verdict["seen_until"])
        and (end is None or verdict["seen_from"] is None or verdict["seen_from"] <= end)
    )
