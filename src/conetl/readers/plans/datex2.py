"""Planned road works of DATEX II publications of situations, versions 2 and 3 (CEN/TS 16157-3, and -2 for locations).

Elements are found by their local names, which both versions share. A record is one `situationRecord`; it is used if it is road
works, or manages lanes because of road works.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

from lxml import etree
from pyproj import Transformer
from pyproj.exceptions import ProjError

from conetl.files.documents import shown
from conetl.files.names import printable
from conetl.model.errors import InputError
from conetl.model.planned_zones import NotAPlanError, PlanFile, PlannedZone
from conetl.readers.plans.national_highways import Element, elements_of
from conetl.readers.plans.wzdx import used_and_unused

_WORKS = frozenset({"MaintenanceWorks", "ConstructionWorks"})
_LANES = "RoadOrCarriagewayOrLaneManagement"
_CAUSES = frozenset({"roadMaintenance", "constructionWork", "roadworks"})
_XSI_TYPE = "{http://www.w3.org/2001/XMLSchema-instance}type"
#: Where coordinates of a point stand in a location, the most exact first; True: the road between or around them is not known.
_POINTS = (
    ("firstDirection", True),
    ("tpegLinearLocation", True),
    ("pointByCoordinates", False),
    ("tpegPointLocation", False),
    ("coordinatesForDisplay", True),
)
_WITHOUT_COORDINATES = frozenset(
    {
        "alertCPoint", "alertCLinear", "alertCArea", "pointAlongLinearElement", "linearWithinLinearElement", "namedArea",
        "predefinedLocationReference", "externalReferencing",
    }
)  # fmt: skip
Positions = tuple[tuple[float, float], ...]


def read_datex2(path: Path) -> PlanFile:
    """Planned zones of a file, in its order, and why each other record is not used.

    Of several versions of a record the last one is used. Raises InputError for a file that is not XML or holds no situations.
    """
    records = (
        (situation, record, any(_kind(one) in _WORKS for one in situation.findall("{*}situationRecord")))
        for situation in _situations(path)
        for record in situation.findall("{*}situationRecord")
    )
    return used_and_unused(records, lambda one: _zone(*one), name_of=_name)


def _name(one: tuple[Element, Element, bool]) -> str:
    return printable(f"situation {one[0].get('id', '')}, record {one[1].get('id', '')}")


def _situations(path: Path) -> Iterator[Element]:
    root = yield from elements_of(path, "{*}situation", "DATEX II")
    if "datex2.eu" not in (etree.QName(root).namespace or ""):
        raise InputError(f"{path}: its root is {shown(root.tag)}, expected DATEX II")
    kinds = [_kind(one) for one in root.iter("{*}payload", "{*}payloadPublication")]
    if root.find(".//{*}situation") is None and "SituationPublication" not in kinds:
        raise InputError(f"{path}: holds {', '.join(kinds) or 'no publication'}, expected a SituationPublication")


def _kind(element: Element) -> str:
    return str(element.get(_XSI_TYPE, "no type")).rpartition(":")[2]


def _zone(situation: Element, record: Element, has_works: bool) -> PlannedZone:
    """Raises ValueError for a record that is not used."""
    _require_works(situation, record, has_works)
    location = next(iter(record.findall("{*}locationReference") + record.findall("{*}groupOfLocations")), None)
    if location is None:
        raise ValueError("it has no location")
    parts, approximate = _parts(location)
    status = _one(record, "operatorActionStatus") or _one(record, "validity/validityStatus")
    sources = ("source/sourceName/values/value", "source/sourceIdentification")
    values: dict[str, Any] = {
        "plan_id": record.get("id") or "",
        "version": record.get("version"),
        "group_id": situation.get("id"),
        "kind": _kind(record),
        "starts_at": _one(record, "validity/validityTimeSpecification/overallStartTime"),
        "ends_at": _one(record, "validity/validityTimeSpecification/overallEndTime"),
        "periods": [
            {"starts_at": _one(one, "startOfPeriod"), "ends_at": _one(one, "endOfPeriod")}
            for one in record.iterfind("{*}validity/{*}validityTimeSpecification/{*}validPeriod")
        ],
        "status": status,
        "parts": parts,
        "approximate": approximate,
        "carriageways": _leaves(location, "carriageway"),
        "lanes": _leaves(location, "lane", "laneUsage", "laneNumber"),
        "closed_lane_count": _one(record, "impact/numberOfLanesRestricted"),
        "road_names": _leaves(location, "roadName", "roadNumber"),
        "description": " ".join(_texts(record.iterfind("{*}generalPublicComment/{*}comment//{*}value"))),
        "source": next((found for path in sources if (found := _one(record, path))), ""),
    }
    return PlannedZone.model_validate(values)


def _require_works(situation: Element, record: Element, has_works: bool) -> None:
    kind, cause = _kind(record), _one(record, "cause/causeType")
    if kind not in _WORKS | {_LANES}:
        raise NotAPlanError(f"{kind} is neither road works nor a closure of lanes")
    if kind == _LANES and cause not in _CAUSES and not (cause is None and has_works):
        raise NotAPlanError(f"its cause is {cause or 'not stated'}, not road works")
    use = _one(situation, "headerInformation/informationStatus")
    if use not in (None, "real"):
        raise NotAPlanError(f"its status is {use}, not real")
    if _one(record, "operatorActionStatus") == "rejected":
        raise NotAPlanError("the plan was rejected")


def _parts(reference: Element) -> tuple[list[Positions], bool]:
    """Lines or points of a location, and whether they are approximate. Raises ValueError where it has no coordinates."""
    places = list(reference.iter("{*}location", "{*}locationContainedInGroup")) or [reference]
    found = [_parts_of(place) for place in places]
    parts = [part for some, _ in found for part in some]
    if parts:
        return parts, any(approximate or not some for some, approximate in found)
    kinds = {etree.QName(one).localname for one in reference.iter(etree.Element)} & _WITHOUT_COORDINATES
    raise ValueError(f"its location has no coordinates, only {', '.join(sorted(kinds)) or 'a description'}")


def _parts_of(place: Element) -> tuple[list[Positions], bool]:
    lists = [one for one in place.iter("{*}posList") if not any(one.iterancestors("{*}interior"))]
    if lists:
        return [_line(one) for one in lists], False
    for name, approximate in _POINTS:
        parts = [_points(one) for one in place.iter(f"{{*}}{name}")]
        if any(parts):
            return [part for part in parts if part], approximate
    return [], False


def _line(positions: Element) -> Positions:
    """Longitude and latitude of a posList, whose numbers stand in the order of its CRS. Raises ValueError."""
    line = positions.getparent()
    dimension = int(line.get("srsDimension") or positions.get("srsDimension") or 2)
    numbers = [float(word) for word in (positions.text or "").split()]
    if dimension not in (2, 3) or not numbers or len(numbers) % dimension:
        raise ValueError(f"posList: {len(numbers)} numbers are no positions of {dimension}")
    pairs = list(zip(numbers[::dimension], numbers[1::dimension], strict=True))
    srs = line.get("srsName") or positions.get("srsName")
    if srs is not None:
        move = _to_wgs84(srs)
        pairs = [move.transform(*pair) for pair in pairs]
    return tuple((lon, lat) for lat, lon in pairs)


@lru_cache
def _to_wgs84(srs: str) -> Transformer:
    """From the axes of a CRS as its authority orders them. Raises ValueError."""
    try:
        return Transformer.from_crs(srs, 4326)
    except ProjError as error:
        raise ValueError(f"srsName {shown(srs)} is not a known CRS") from error


def _points(place: Element) -> Positions:
    """Positions below an element, `from` before `to`, which the schema orders the other way."""
    ends = [end for name in ("from", "to") for end in place.findall(f"{{*}}{name}")] or [place]
    found = [(_one(one, "longitude"), _one(one, "latitude")) for end in ends for one in end.iter(etree.Element)]
    return tuple((float(lon), float(lat)) for lon, lat in found if lon and lat)


def _one(element: Element, path: str) -> str | None:
    """Text of the first element at a path of local names."""
    found = element.findtext("/".join(f"{{*}}{name}" for name in path.split("/")))
    return (found or "").strip() or None


def _leaves(location: Element, *names: str) -> tuple[str, ...]:
    """Different texts of elements of these names that contain no others."""
    return tuple(
        dict.fromkeys(_texts(one for one in location.iter(*(f"{{*}}{name}" for name in names)) if not len(one)))
    )


def _texts(elements: Iterable[Element]) -> list[str]:
    return [" ".join(printable(one.text, lines=True).split()) for one in elements if (one.text or "").strip()]
