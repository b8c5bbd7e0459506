"""Plans of work zones: imported into the database, and compared with the zones of a map."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, NamedTuple
from uuid import UUID

import numpy as np
from shapely import MultiPoint

from conetl.db.connection import Connection
from conetl.db.map import plan_store as store
from conetl.db.map.map_store import map_transaction, require_map
from conetl.db.map.results import MapInfo
from conetl.db.serve_store import read_origin
from conetl.geometry.geodesy import to_geodetic, to_map
from conetl.geometry.packing import horizontal_sigma_m
from conetl.model.base import Record, ns_from_utc
from conetl.model.errors import InputError
from conetl.model.planned_zones import DIFFERENCE_COLUMNS, VERDICTS, WORST_FIRST, Difference, PlanFile, UnusedRecord
from conetl.model.work_zone_params import PlanParams, WorkZoneParams
from conetl.model.work_zone_records import WorkZone
from conetl.pipeline.maps.work_zones import read_zones
from conetl.workzones.looks import FoundZone, ZonePhase
from conetl.workzones.plan_comparison import PlacedPlan, compare, shape_of

#: Differences that drives looked at so long before the last of them are older than last night.
_NIGHT = timedelta(hours=24)


class PlanRow(Record):
    """A difference with what a person needs to judge it."""

    difference: Difference
    lon_deg: float
    lat_deg: float
    images: tuple[str, ...] = ()
    """Left images of the passes `first` and `last`."""
    link: str
    """Of the map viewer, from its address on."""
    verdict: str = "open"
    note: str = ""
    decided_by: str | None = None
    rank: int | None = None
    """1: to be looked at first. Those that are open come before judged ones, then those of last night, then the worst kinds, the
    most certain and the largest. None: no difference."""
    last_night: bool = False
    """A drive looked at it in the last 24 hours of drives."""

    def flat(self) -> dict[str, Any]:
        """All values of a row of a table as JSON values, by the names of `DIFFERENCE_COLUMNS`; passes as time and drive."""
        values = self.model_dump(mode="json")
        values |= values.pop("difference")
        for name in ("absent", "first", "last", "gone"):
            sight = values.pop(name) or {}
            values |= {f"{name}_at": sight.get("at"), f"{name}_drive": sight.get("drive_id")}
        return {column.name: values[column.name] for column in DIFFERENCE_COLUMNS}


class PlanComparison(NamedTuple):
    """All rows at an instant."""

    at: datetime
    rows: list[PlanRow]
    plans: Sequence[PlacedPlan] = ()
    """Those that were compared, and the zones."""
    zones: Sequence[WorkZone] = ()

    @property
    def counts(self) -> Counter[str]:
        return Counter(str(row.difference.kind) for row in self.rows)

    @property
    def worst_first(self) -> list[PlanRow]:
        """The differences by their rank."""
        return sorted((row for row in self.rows if row.rank is not None), key=lambda row: row.rank or 0)


def import_plans(
    conn: Connection, path: Path, file: PlanFile, *, map_name: str, list_name: str
) -> tuple[store.StoredPlans, list[UnusedRecord]]:
    """Store the plans of a file in a list of the map, and why other records are not. Raises InputError if none can be used."""
    info = require_map(conn, map_name)
    unused, placed = list(file.unused), []
    for zone in file.zones:
        try:
            placed.append((zone, shape_of([_to_map(info.srid, part) for part in zone.parts])))
        except ValueError as error:
            unused.append(UnusedRecord(f"plan {zone.plan_id}", f"it is outside of the area of the map: {error}"))
    if not placed:
        reasons = "".join(f"; {one.record}: {one.reason}" for one in unused[:1])
        raise InputError(f"{path}: none of its {len(unused)} records is a plan that can be used{reasons}")
    with map_transaction(conn, map_name):
        stored = store.write_plans(conn, require_map(conn, map_name), list_name, path.name, placed)
    return stored, unused


def _to_map(srid: int, part: Sequence[tuple[float, float]]) -> Any:
    lon, lat = np.array(part).T
    return to_map(srid, lat, lon, np.zeros(len(lon)))[:, :2]


def compare_with_plans(
    conn: Connection, *, map_name: str, as_of: datetime | None = None, known_at: datetime | None = None,
    lanes: Path | None = None, params: PlanParams | None = None,
) -> PlanComparison:  # fmt: skip
    """Plans against zones at as_of (None: now), with plans and verdicts as they were known at known_at (None: now); read-only."""
    params, zone_params, at = params or PlanParams(), WorkZoneParams(), as_of or datetime.now(UTC)
    info = require_map(conn, map_name)
    plans = store.read_plans(conn, map_name=map_name, known_at=known_at)
    found = read_zones(conn, map_name=map_name, as_of=as_of, lanes=lanes, params=zone_params)
    on_map = [found_zone(zone, zone_params) for zone in found.zones]
    places = [one.shape for one in plans] + [MultiPoint(phase.xy_m) for zone in on_map for phase in zone.phases]
    boxes = [one.envelope.buffer(params.look_aside_m, join_style="mitre") for one in places]
    drives = store.read_frames_near(conn, boxes, map_name=map_name, until=at)
    rows = compare(plans, on_map, drives, params, at_ns=ns_from_utc(at))
    first = {zone.history.zone_id: zone.first.feature_id for zone in found.zones}
    return PlanComparison(at, _ranked(_with_evidence(conn, rows, first, info, known_at)), plans, found.zones)


def _ranked(rows: Sequence[PlanRow]) -> list[PlanRow]:
    """In the same order, with their ranks."""
    looked_at = [row.difference.looked_at for row in rows]
    newest = max((at for at in looked_at if at is not None), default=None)
    made = [
        row.model_copy(update={"last_night": at is not None and newest is not None and at > newest - _NIGHT})
        for row, at in zip(rows, looked_at, strict=True)
    ]

    def urgency(row: PlanRow) -> tuple[Any, ...]:
        one = row.difference
        return (row.verdict != "open", not row.last_night, WORST_FIRST.index(one.kind), -one.confidence, -(one.amount or 0.0),
            str(one.difference_id))  # fmt: skip

    ordered = sorted((row for row in made if row.difference.kind in WORST_FIRST), key=urgency)
    ranks = {row.difference.difference_id: rank for rank, row in enumerate(ordered, 1)}
    return [row.model_copy(update={"rank": ranks.get(row.difference.difference_id)}) for row in made]


def read_difference_table(
    conn: Connection, *, map_name: str, as_of: datetime | None, view: str
) -> list[dict[str, Any]] | None:
    """The differences as rows of a table for people, the worst first; None: there are no plans. view: of the map viewer."""
    if not store.read_plans(conn, map_name=map_name):
        return None
    found = compare_with_plans(conn, map_name=map_name, as_of=as_of)
    shown = ("rank", "kind", "plan_id", "text", "first_at", "last_at", "confidence", "verdict", "last_night")
    flat = [row.flat() for row in found.worst_first]
    return [
        {name: row[name] for name in shown} | {"map": f"{view}/{row['link']}" if view else row["link"]} for row in flat
    ]


def found_zone(zone: WorkZone, params: WorkZoneParams) -> FoundZone:
    """A zone of the map as the comparison takes it. While fewer devices are left than make a zone, it is gone."""
    history = zone.history
    every = history.phases or ((history.start_ns, history.cones),)
    phases = [phase for phase in every if len(phase[1]) >= params.min_cones] or [every[0]]
    gone_ns = history.end_ns if history.merged_into is None else None
    gone_ns = next((at_ns for at_ns, _ in every if at_ns > phases[-1][0]), gone_ns)
    cones = [cone for _, some in phases for cone in some]
    counts = np.ones(1)  # probabilities of so many devices
    for cone in phases[-1][1]:
        counts = np.convolve(counts, [1 - cone.existence_probability, cone.existence_probability])
    return FoundZone(
        zone_id=history.zone_id,
        phases=tuple(
            ZonePhase(at_ns, max(cone.last_seen_ns for cone in some), np.array([cone.xyz_m[:2] for cone in some]))
            for at_ns, some in phases
        ),
        first_seen_ns=history.start_ns,
        last_seen_ns=max(cone.last_seen_ns for cone in cones),
        gone_ns=gone_ns,
        merged_into=history.merged_into,
        sigma_m=max(horizontal_sigma_m(cone.cov_m2) for cone in cones),
        existence=float(min(counts[params.min_cones :].sum(), 1.0)),
        closed_side=zone.closed_side,
        closed_lane_count=zone.closed_lane_count,
    )


def _with_evidence(
    conn: Connection, rows: Sequence[Difference], first: Mapping[UUID, UUID], info: MapInfo, known_at: datetime | None
) -> list[PlanRow]:
    """Rows with images, links, and verdicts. first: device of each zone."""
    map_name = info.map_name
    shown = {row.difference_id: [one for one in (row.first, row.last) if one is not None] for row in rows}
    images = store.read_images(conn, [one for some in shown.values() for one in some], map_name=map_name)
    verdicts = store.read_verdicts(conn, map_name=map_name, known_at=known_at)
    judged = [(Difference.model_validate(one["difference"]), one) for one in verdicts]
    east, north, _ = read_origin(conn, map_name) or (0.0, 0.0, 0.0)
    made = []
    for row in rows:
        lat, lon, _ = to_geodetic(info.srid, (*row.xy_m, 0.0)).tolist()
        said = next((one for known, one in judged if known.is_same(row)), {})
        passes = shown[row.difference_id]
        link = f"#map={map_name}" + "".join(f"&valid={one.at:%Y-%m-%dT%H:%M:%S.%fZ}" for one in passes[-1:])
        mark = f"&mark={row.xy_m[0] - east:.2f},{row.xy_m[1] - north:.2f}"
        link += mark if row.zone_id is None else f"&feature={first[row.zone_id]}"
        paths = dict.fromkeys(images[one] for one in passes if one in images)
        verdict = {name: said[name] for name in ("verdict", "note", "decided_by") if name in said}
        made.append(PlanRow(difference=row, lon_deg=lon, lat_deg=lat, images=tuple(paths), link=link, **verdict))
    return made


def judge(
    conn: Connection,
    beginning: str,
    verdict: str,
    *,
    map_name: str,
    note: str,
    decided_by: str | None,
    as_of: datetime | None,
) -> Difference:
    """Write what a person says about the difference whose id begins so; `open` takes it back. Raises InputError."""
    if verdict not in VERDICTS:
        raise InputError(f"verdict {verdict}: expected one of {', '.join(VERDICTS)}")
    rows = [row.difference for row in compare_with_plans(conn, map_name=map_name, as_of=as_of).rows]
    named = [one for one in rows if len(beginning) >= 4 and str(one.difference_id).startswith(beginning.lower())]
    if len(named) != 1:
        problem = "several differences have" if named else "no difference has"
        raise InputError(
            f"{beginning}: {problem} an id that begins so (at least 4 characters): see `conetl zones compare`"
        )
    with map_transaction(conn, map_name):
        store.write_verdict(conn, require_map(conn, map_name), named[0], verdict, note=note, decided_by=decided_by)
    return named[0]
