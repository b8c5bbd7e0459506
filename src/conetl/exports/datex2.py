"""Work zones as DATEX II 3.7: a SituationPublication with one situation of road works per zone.

docs/reference/wzdx.md describes the source of every field. Elements stand in the order of the schema, which the programme does
not allow to ship: the tests validate what is written.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from uuid import UUID

from lxml import etree
from lxml.builder import ElementMaker

from conetl.exports.text_files import LON_LAT_DECIMALS, coordinates
from conetl.exports.zone_feed import FeedContext, ZoneState, description_of, iso_seconds, state_of, zones_to_publish
from conetl.files.atomic import atomic_files
from conetl.files.names import printable
from conetl.geometry.packing import horizontal_sigma_m
from conetl.model.map_records import MapFeature
from conetl.model.work_zone_records import VehicleImpact, WorkZone

_NAMESPACES = {
    "d2": "http://datex2.eu/schema/3/d2Payload",
    "com": "http://datex2.eu/schema/3/common",
    "loc": "http://datex2.eu/schema/3/locationReferencing",
    "sit": "http://datex2.eu/schema/3/situation",
    "xsi": "http://www.w3.org/2001/XMLSchema-instance",
}
_TYPE = f"{{{_NAMESPACES['xsi']}}}type"
_D2, _COM, _LOC, _SIT = (ElementMaker(namespace=_NAMESPACES[name], nsmap=_NAMESPACES) for name in list(_NAMESPACES)[:4])
#: Characters of a text in the schema.
_MAX_TEXT = 1024
#: Sigmas that hold 95 % of a circular normal distribution in the plane, sqrt(-2 ln 0.05), and of one on a line.
_PLANE_95, _LINE_95 = math.sqrt(-2.0 * math.log(0.05)), 1.959964
_ACTIVE = "implemented"
#: An element of lxml, which has no types.
Element = Any


def export_situations(
    zones: Sequence[WorkZone], standing: Sequence[MapFeature], path: Path, context: FeedContext
) -> int:
    """Write a situation per zone that exists or ended recently. Returns their number."""
    shown, ids = zones_to_publish(zones, context)
    root = _D2.payload(
        _COM.publicationTime(iso_seconds(context.made_at)),
        _COM.publicationCreator(
            _COM.country(context.info.country), _COM.nationalIdentifier(_text(context.info.publisher))
        ),
        *(_situation(zone, context, ids) for zone in shown),
        {_TYPE: "sit:SituationPublication", "lang": "en", "modelBaseVersion": "3"},
    )
    with atomic_files(path) as (file,):
        etree.ElementTree(root).write(file, encoding="UTF-8", xml_declaration=True, pretty_print=True)
    return len(shown)


def _situation(zone: WorkZone, context: FeedContext, ids: set[UUID]) -> Element:
    merged_into = zone.history.merged_into
    older = {"id": str(merged_into), "targetClass": "sit:Situation"}
    related = [_SIT.relatedSituation(_SIT.objectReference(**older))] if merged_into in ids else []
    return _SIT.situation(
        _SIT.situationVersionTime(iso_seconds(context.at)),
        _SIT.headerInformation(_COM.confidentiality("noRestriction"), _COM.informationStatus("real")),
        _record(zone, state_of(zone, context), context),
        *related,
        id=str(zone.history.zone_id),
    )


def _record(zone: WorkZone, state: ZoneState, context: FeedContext) -> Element:
    """The road works."""
    organization = context.info.organization_name or context.info.publisher
    period = _COM.validityTimeSpecification(
        _COM.overallStartTime(iso_seconds(state.start)), _COM.overallEndTime(iso_seconds(state.ended or state.expires))
    )
    stands = state.ended is None and not state.stale
    return _SIT.situationRecord(
        _SIT.situationRecordCreationTime(iso_seconds(state.start)),
        _SIT.situationRecordObservationTime(iso_seconds(state.surveyed)),
        _SIT.situationRecordVersionTime(iso_seconds(context.at)),
        _SIT.probabilityOfOccurrence("probable" if state.stale else "certain"),
        _SIT.source(
            _COM.sourceIdentification(_text(context.data_source_id)),
            _COM.sourceName(_words(organization)),
            _COM.sourceType("vehicleProbeMeasurement"),
        ),
        # No status says that it is unknown whether the works go on: what the last survey is evidence for has an end.
        _SIT.validity(_COM.validityStatus("definedByValidityTimeSpec"), period),
        *(_impact(zone) if stands else ()),
        _SIT.generalPublicComment(
            _SIT.comment(_words(description_of(zone, state, context.params))), _SIT.commentType("description")
        ),
        _location(zone, context, stands),
        *([_SIT.operatorActionStatus(_ACTIVE)] if stands else ()),
        _SIT.mobility(_SIT.mobilityType("stationary")),
        _SIT.roadMaintenanceType("roadworks"),
        {
            _TYPE: "sit:MaintenanceWorks",
            "id": f"{zone.history.zone_id}-works",
            "version": _version(context),
        },
    )


def _version(context: FeedContext) -> str:
    """As in WZDx, each publication is a new version: it may find that a survey is too old."""
    return str(int(context.at.timestamp()))


def _impact(zone: WorkZone) -> list[Element]:
    closed = 0 if zone.impact is VehicleImpact.ALL_LANES_OPEN else zone.closed_lane_count
    return [] if closed is None else [_SIT.impact(_SIT.numberOfLanesRestricted(str(closed)))]


def _location(zone: WorkZone, context: FeedContext, stands: bool) -> Element:
    """The line of the zone; its first device with height and accuracy; side, closed lane and road."""
    side = zone.closed_side if stands else None
    lane = [_LOC.lane(_LOC.laneUsage(f"{side}Lane"))] if side and zone.closed_lane_count else []
    precision_m = _PLANE_95 * max(horizontal_sigma_m(end.cov_m2) for end in (zone.first, zone.last))
    described = _LOC.supplementaryPositionalDescription(
        *([_LOC.positionOnCarriageway(f"onThe{side.capitalize()}")] if side else ()),
        _LOC.carriageway(_LOC.carriageway("unspecifiedCarriageway"), *lane),
        *(_LOC.roadInformation(_LOC.roadName(_text(name))) for name in context.info.road_names),
        locationPrecision=str(math.ceil(precision_m)),
    )
    places = " ".join(f"{_degrees(lat)} {_degrees(lon)}" for lon, lat, *_ in coordinates(zone.line_m, context.srid))
    return _SIT.locationReference(
        _LOC.coordinatesForDisplay(*_position(zone.first, context.srid)),
        described,
        _LOC.gmlLineString(_LOC.posList(places), srsName="urn:ogc:def:crs:EPSG::4326", srsDimension="2"),
        {_TYPE: "loc:LinearLocation"},
    )


def _position(device: MapFeature, srid: int) -> list[Element]:
    [[lon, lat, height]] = coordinates([device.xyz_m], srid)
    horizontal, vertical = _PLANE_95 * horizontal_sigma_m(device.cov_m2), _LINE_95 * math.sqrt(device.cov_m2[5])
    return [
        _LOC.latitude(_degrees(lat)),
        _LOC.longitude(_degrees(lon)),
        _LOC.heightCoordinate(
            _LOC.heightValue(f"{height:.4f}"),
            _LOC.heightType("ellipsoidalHeight"),
            _LOC.verticalPositionAccuracy(_LOC.accuracyPercentile95(f"{vertical:.3f}")),
        ),
        _LOC.horizontalPositionAccuracy(_LOC.accuracyPercentile95(f"{horizontal:.3f}")),
    ]


def _degrees(value: float) -> str:
    """Without an exponent, which the schema does not allow."""
    return f"{value:.{LON_LAT_DECIMALS}f}"


def _words(text: str) -> Element:
    return _COM.values(_COM.value(_text(text), lang="en"))


def _text(value: str) -> str:
    return printable(value)[:_MAX_TEXT]
