"""The list of planned works that National Highways (before: Highways England, Highways Agency) publishes every week as XML.

Until 2017 a record is `ha_planned_works` with an element for each field, since then `HE_PLANNED_WORKS` with attributes. Times are
those of London without an offset. The place is the middle of the works in the British National Grid: a rough place.
"""

from __future__ import annotations

import re
from collections.abc import Generator
from datetime import datetime
from functools import cache
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

from lxml import etree
from pyproj import Transformer
from pyproj.exceptions import ProjError

from conetl.files.documents import XmlFile, input_errors, library_errors, shown
from conetl.files.names import printable
from conetl.model.errors import InputError
from conetl.model.planned_zones import PlanFile, PlannedZone
from conetl.readers.plans.wzdx import used_and_unused

_ROOTS = ("ha_planned_roadworks", "Report")
_RECORDS = ("ha_planned_works", "{*}HE_PLANNED_WORKS")
#: Field -> its attribute since 2018.
_NAMES = {
    "reference_number": "NEW_EVENT_NUMBER", "start_date": "SDATE", "end_date": "EDATE", "description": "DESCRIPTION",
    "closure_type": "CLOSURE_TYPE", "status": "STATUS", "published_date": "PUBLISHED_DATE",
}  # fmt: skip
_LONDON = "Europe/London"
#: As `2016-03-21T20:00:00`, or `21-SEP-2026 21:00`, with the time or without it.
_TIMES = ("%Y-%m-%dT%H:%M:%S", "%Y-%m-%d", "%d-%b-%Y %H:%M:%S", "%d-%b-%Y %H:%M", "%d-%b-%Y")
#: An element of lxml, which has no types.
Element = Any


def is_planned_works(path: Path) -> bool:
    """Whether an XML file is such a list, by its first element; False for what is no XML."""
    try:
        with input_errors(path), XmlFile(path) as file:
            found = etree.iterparse(file, events=("start",), resolve_entities=False, no_network=True)
            return etree.QName(next(found)[1]).localname in _ROOTS
    except (etree.XMLSyntaxError, StopIteration):
        return False


def read_planned_works(path: Path) -> PlanFile:
    """Planned zones of a list, in its order, and why each other record is not used. Raises InputError if there is no record."""
    found = used_and_unused(elements_of(path, _RECORDS, "planned works"), _zone, "works")
    if not found.zones and not found.unused:
        raise InputError(f"{path}: holds no planned works, expected elements ha_planned_works or HE_PLANNED_WORKS")
    return found


def elements_of(path: Path, tag: str | tuple[str, ...], what: str) -> Generator[Element, None, Element]:
    """The elements of an XML file with this tag, one after another; only the last one, and the root that is returned, are in
    memory. Raises InputError."""
    not_xml = library_errors(f"{path}: is not XML", etree.XMLSyntaxError, hint=f"; expected {what}")
    with not_xml, input_errors(path), XmlFile(path) as file:
        found = etree.iterparse(file, tag=tag, resolve_entities=False, no_network=True)
        for _, record in found:
            yield record
            record.clear()
            while record.getprevious() is not None:
                del record.getparent()[0]
    return found.root


def _zone(record: Element) -> PlannedZone:
    """Raises ValueError for a record that cannot be used."""

    def text(name: str) -> str:
        attribute = record.get(_NAMES[name]) if name in _NAMES else None
        return printable(" ".join((attribute or record.findtext(name) or "").split()))

    roads = [one.get("ROAD_NUMBER") for one in record.iterfind(".//{*}ROAD")] or [text("road")]
    published = text("published_date")
    values = {
        "plan_id": text("reference_number"),
        "version": _instant("published_date", published).isoformat() if published else None,
        "kind": text("closure_type") or "planned works",
        "starts_at": _instant("start_date", text("start_date")),
        "ends_at": _instant("end_date", text("end_date")),
        "status": text("status") or None,
        "parts": [[_centre(record)]],
        "approximate": True,
        "road_names": list(dict.fromkeys(printable(road).strip() for road in roads if road)),
        "description": ". ".join(
            part.rstrip(".") for name in ("location", "traffic_management", "description") if (part := text(name))
        ),
        "source": "National Highways",
    }
    return PlannedZone.model_validate(values)


def _centre(record: Element) -> tuple[float, float]:
    """Longitude and latitude."""
    place = record.find(".//{*}EASTNORTH[@CENTRE_EASTING]")
    found = (
        [record.findtext(name) for name in ("centre_easting", "centre_northing")]
        if place is None
        else [place.get(name) for name in ("CENTRE_EASTING", "CENTRE_NORTHING")]
    )
    if not all(found):
        raise ValueError("it has no centre_easting and centre_northing")
    try:
        east, north = (float(number) for number in found)
        lon, lat = _to_degrees().transform(east, north, errcheck=True)
    except (ValueError, ProjError):
        raise ValueError(
            f"expected easting and northing in the British National Grid, found {', '.join(map(shown, found))}"
        ) from None
    return lon, lat


@cache
def _to_degrees() -> Transformer:
    return Transformer.from_crs(27700, "OGC:CRS84", always_xy=True)


def _instant(name: str, text: str) -> datetime:
    for form in _TIMES:
        try:
            return datetime.strptime(re.sub(r"\.\d+$", "", text.title() if "-" in text[:3] else text), form).replace(
                tzinfo=ZoneInfo(_LONDON)
            )
        except ValueError:
            continue
    raise ValueError(f"{name}: expected a time like 2016-03-21T20:00:00 or 21-SEP-2026 21:00, found {shown(text)}")
