"""Planned work zones of WZDx 4 feeds (USDOT): road events of the type `work-zone`."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from operator import attrgetter
from pathlib import Path
from typing import Any

from conetl.files.documents import first_message, shown
from conetl.files.names import printable
from conetl.model.errors import InputError
from conetl.model.planned_zones import NotAPlanError, PlanFile, PlannedZone, UnusedRecord

#: Of a file, of which a feed of a state has some thousands; and of a record.
MOST_RECORDS, MOST_POSITIONS = 50_000, 10_000
#: Types of lanes on which vehicles drive.
_DRIVEN = frozenset({"general", "exit-lane", "exit-ramp", "entrance-lane", "entrance-ramp"})


def is_feed(document: Any) -> bool:
    return isinstance(document, dict) and isinstance(
        document.get("feed_info", document.get("road_event_feed_info")), dict
    )


def read_feed(path: Path, document: Any) -> PlanFile:
    """Planned zones of a feed, in its order, and why each other event is not used. Raises InputError without a list of events."""
    info = document.get("feed_info", document.get("road_event_feed_info"))
    sources = info.get("data_sources") if isinstance(info.get("data_sources"), list) else []
    names = {one.get("data_source_id"): one.get("organization_name") for one in sources if isinstance(one, dict)}
    publisher = str(info.get("publisher") or "")

    def zone(feature: dict[str, Any]) -> PlannedZone:
        properties = feature["properties"]
        core = properties["core_details"]
        if core.get("event_type") != "work-zone":
            raise NotAPlanError(f"its event_type is {shown(core.get('event_type'))}, not work-zone")
        lines = parts_of(feature["geometry"])
        points = feature["geometry"]["type"] == "MultiPoint"
        values = {
            "plan_id": feature.get("id"),
            "version": core.get("update_date"),
            "kind": core["event_type"],
            "starts_at": properties.get("start_date"),
            "ends_at": properties.get("end_date"),
            "status": properties.get("event_status"),
            "parts": [[point for part in lines for point in part]] if points else lines,
            "approximate": points,
            "road_names": core.get("road_names") or (),
            "description": printable(core.get("description") or ""),
            "source": names.get(core.get("data_source_id")) or publisher,
            **_lanes(properties),
        }
        return PlannedZone.model_validate(values)

    return used_and_unused(features_of(path, document), zone)


def features_of(path: Path, document: Any) -> list[Any]:
    """Features of a GeoJSON document. Raises InputError."""
    features = document.get("features") if isinstance(document, dict) else None
    if not isinstance(features, list):
        raise InputError(f"{path}: expected a GeoJSON FeatureCollection with features")
    return features


def used_and_unused(
    records: Iterable[Any],
    zone: Callable[[Any], PlannedZone],
    noun: str = "feature",
    name_of: Callable[[Any], str] | None = None,
) -> PlanFile:
    """Each record as a planned zone, or named with the reason; of several versions of a plan the newest is used.

    name_of: of a record, where it has more than a number. Raises ValueError for more than MOST_RECORDS.
    """
    zones: dict[str, PlannedZone] = {}
    unused = []
    for number, record in enumerate(records, 1):
        if number > MOST_RECORDS:
            raise ValueError(f"more than {MOST_RECORDS:,} {noun}s: import it in parts")
        name = f"{noun} {number}" if name_of is None else name_of(record)
        try:
            made = zone(record)
            if (positions := sum(map(len, made.parts))) > MOST_POSITIONS:
                raise ValueError(
                    f"its location has {positions:,} positions, expected at most {MOST_POSITIONS:,}: simplify it"
                )
        except (ValueError, LookupError, TypeError, AttributeError, OverflowError) as error:
            lacks = f"{error} is missing" if isinstance(error, KeyError) else "it has not the form of this format"
            reason = printable(first_message(error)) if isinstance(error, ValueError) else lacks
            unused.append(UnusedRecord(name, reason, not isinstance(error, NotAPlanError)))
            continue
        earlier = zones.pop(made.plan_id, None)
        if earlier is not None:
            older, made = sorted((earlier, made), key=attrgetter("order"))
            text = f"version {older.version} is replaced by version {made.version}"
            if name_of is None:
                name, text = f"{name} ({printable(made.plan_id)})", "the file has this plan twice"
            unused.append(UnusedRecord(name, text, False))
        zones[made.plan_id] = made
    return PlanFile(tuple(zones.values()), tuple(unused))


def parts_of(geometry: Any) -> list[list[tuple[float, float]]]:
    """Lines of longitude and latitude of a GeoJSON geometry, of areas their outlines. Raises ValueError, KeyError, TypeError."""
    kind, places = geometry["type"], geometry.get("coordinates")
    if kind == "GeometryCollection":
        return [part for one in geometry["geometries"] for part in parts_of(one)]
    lists: dict[str, Callable[[], Any]] = {
        "Point": lambda: [[places]], "LineString": lambda: [places], "MultiPoint": lambda: [[place] for place in places],
        "Polygon": lambda: places[:1], "MultiLineString": lambda: places, "MultiPolygon": lambda: [area[0] for area in places],
    }  # fmt: skip
    if kind not in lists:
        raise ValueError(f"its geometry is {shown(kind)}, expected points, lines or areas")
    return [[(float(place[0]), float(place[1])) for place in part] for part in lists[kind]()]


def _lanes(properties: dict[str, Any]) -> dict[str, Any]:
    """Closed lanes in words: order 1 is the leftmost one in the direction of travel."""
    if properties.get("vehicle_impact") == "all-lanes-closed":
        return {"lanes": ["all lanes"]}
    lanes = sorted(
        (one for one in properties.get("lanes") or () if one.get("type") in _DRIVEN), key=lambda one: int(one["order"])
    )
    closed = [number for number, one in enumerate(lanes) if one["status"] == "closed"]
    if not closed:
        return {"closed_lane_count": 0} if properties.get("vehicle_impact") == "all-lanes-open" else {}
    words = [{0: "left lane", len(lanes) - 1: "right lane"}.get(k, f"lane {k + 1} from the left") for k in closed]
    return {"lanes": ["all lanes"] if len(closed) == len(lanes) else words, "closed_lane_count": len(closed)}
