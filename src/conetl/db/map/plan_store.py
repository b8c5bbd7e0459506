"""Plans of work zones with their history, people's verdicts on differences, and where drives looked, in PostGIS."""

from __future__ import annotations

import posixpath
from collections.abc import Sequence
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
from conetl.model.planned_zones import Difference, PlannedZone, Sight
from conetl.workzones.looks import DriveFrames
from conetl.workzones.plan_comparison import PlacedPlan


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


def read_frames_near(conn: Connection, boxes: Sequence[Any], *, map_name: str, until: datetime) -> list[DriveFrames]:
    """The frame pairs of the active drives in boxes (polygons, map CRS) that show absence, by drive."""
    rows = stream_values(
        conn, f"The drives of map {map_name} cannot be read", "plans.frames_near", map_name=map_name,
        area=shapely.to_wkb(shapely.union_all(boxes)), until_ns=ns_from_utc(until), least_detail=MIN_DETAIL,
    )  # fmt: skip
    found = []
    for (drive_uuid, drive_id), some in groupby(rows, key=lambda row: row[:2]):
        *_, frames, at_ns, east, north = zip(*some, strict=True)
        xy_m = np.column_stack([east, north])
        found.append(DriveFrames(drive_id, np.array(frames), np.array(at_ns, np.int64), xy_m, drive_uuid))
    return found


def read_images(conn: Connection, sights: Sequence[Sight], *, map_name: str) -> dict[Sight, str]:
    """The left images of passes, of those that have one."""
    known = {(one.drive_uuid, one.frame_index) for one in sights if one.drive_uuid is not None}
    drives, frames = [key[0] for key in known], [key[1] for key in known]
    what = f"The drives of map {map_name} cannot be read"
    rows = read(conn, what, "plans.images", drive_uuids=drives, frames=frames)
    paths = {(row["drive_uuid"], row["frame_index"]): image_path(row["source_path"], row["left_path"]) for row in rows}
    return {one: paths[key] for one in sights if (key := (one.drive_uuid, one.frame_index)) in paths}


def image_path(drive: str, image: str) -> str:
    """Path of an image, which a drive names by its own path in its folder, by the whole path, or by the address of an object."""
    return image if "://" in image else posixpath.join(drive, image)


def read_verdicts(conn: Connection, *, map_name: str, known_at: datetime | None = None) -> Sequence[Row]:
    """Columns of `plans.verdicts`, the last one first."""
    what = f"The verdicts on differences of map {map_name} cannot be read"
    return read(conn, what, "plans.verdicts", map_name=map_name, known_at=or_infinity(known_at))


def write_verdict(
    conn: Connection, info: MapInfo, one: Difference, verdict: str, *, note: str, decided_by: str | None
) -> None:
    """Write what a person says about a difference in the caller's `map_transaction`."""
    said = {"verdict": verdict, "note": clean_text(note), "decided_by": decided_by and clean_text(decided_by)}
    query(
        conn, "plans.insert_verdict", map_id=info.map_id, difference=one.model_dump_json(), decided_at=system_time(conn, info),
        **said,
    )  # fmt: skip
