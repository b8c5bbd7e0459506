"""DATEX II: what is written is valid by the official schema, and read again; real publications are read record by record."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from functools import cache, partial
from uuid import UUID

import numpy as np
import pytest
from lxml import etree

from conetl.exports.datex2 import export_situations
from conetl.exports.text_files import coordinates
from conetl.exports.zone_feed import FeedContext, FeedInfo
from conetl.geometry.geodesy import to_map
from conetl.model.base import ns_from_utc
from conetl.model.errors import InputError
from conetl.model.work_zone_params import WorkZoneParams
from conetl.model.work_zone_records import VehicleImpact
from conetl.readers.plans.datex2 import read_datex2
from conetl.workzones.zone_layout import describe, layout_of
from tests.folders import SHARED
from tests.synthetic.tapers import closure

FOLDER = SHARED / "datex2_v3"
needs_schema = pytest.mark.skipif(not FOLDER.is_dir(), reason=f"no DATEX II schemas and samples in {FOLDER}")
PARAMS = WorkZoneParams()
INFO = FeedInfo(publisher="Road office <West>", road_names=("L 605", "B 10 & \x07"), country="de")
SEEN = datetime(1970, 1, 1, tzinfo=UTC)
SRID = 32632


@cache
def schema():
    return etree.XMLSchema(etree.parse(FOLDER / "xsd_v3.7" / "DATEXII_3_D2Payload.xsd"))


@cache
def zones():
    made = [closure(seed, "none", with_lanes=seed < 3) for seed in range(4)]
    named = [(replace(one.zone, zone_id=UUID(int=number)), one) for number, one in enumerate(made, 1)]
    return [describe(zone, layout_of(zone, one.paths, one.lanes, PARAMS), PARAMS) for zone, one in named]


def written(path, *, age=timedelta(days=1), change=lambda zone: zone):
    context = FeedContext(INFO, "default", SRID, at=SEEN + age, made_at=SEEN + age, params=PARAMS)
    made = [change(zone) for zone in zones()]
    assert export_situations(made, (), path, context) == len(made)
    return made, etree.parse(path)


def texts(document, name):
    return [one.text for one in document.iter(f"{{*}}{name}")]


def ended(zone):
    history = replace(zone.history, end_ns=ns_from_utc(SEEN + timedelta(hours=5)), merged_into=UUID(int=1))
    return replace(zone, history=history) if zone.history.zone_id.int > 1 else zone


@needs_schema
@pytest.mark.parametrize(
    ("age", "change"), [(timedelta(days=1), lambda z: z), (timedelta(days=30), lambda z: z), (timedelta(days=1), ended)]
)
def test_a_publication_is_valid_by_the_official_schema(tmp_path, age, change):
    _, document = written(tmp_path / "zones.xml", age=age, change=change)
    assert schema().validate(document), schema().error_log


def test_positions_return_within_a_centimetre_with_times_lanes_and_roads(tmp_path):
    made, document = written(tmp_path / "zones.xml")
    read = read_datex2(tmp_path / "zones.xml")
    assert not read.unused and len(read.zones) == len(made)
    for zone, plan in zip(made, read.zones, strict=True):
        lon, lat = np.array(plan.parts[0]).T
        xyz = to_map(SRID, lat, lon, np.zeros_like(lat))
        assert np.abs(xyz[:, :2] - zone.line_m[:, :2]).max() < 0.01
        assert (plan.group_id, plan.kind) == (str(zone.history.zone_id), "MaintenanceWorks")
        assert plan.starts_at == SEEN and plan.ends_at == SEEN + timedelta(days=7)
        assert plan.status == "implemented" and plan.source == INFO.publisher and "cones over" in plan.description
        assert plan.road_names == ("L 605", "B 10 & \\x07")
        assert plan.closed_lane_count == zone.closed_lane_count
        assert plan.lanes == ((f"{zone.closed_side}Lane",) if zone.closed_lane_count else ())
    assert {zone.closed_side for zone in made} == {"left", "right"} and None in {z.closed_lane_count for z in made}
    first = coordinates([made[0].first.xyz_m], SRID)[0]
    assert [float(texts(document, name)[0]) for name in ("longitude", "latitude", "heightValue")] == first
    # Sigma 0.1 m: a circle of 2.45, an interval of 1.96 sigmas hold 95 %.
    assert [float(value) for value in texts(document, "accuracyPercentile95")[:2]] == pytest.approx(
        [1.96 * made[0].first.cov_m2[5] ** 0.5, 0.245], abs=0.001
    )
    assert {one.get("locationPrecision") for one in document.iter("{*}supplementaryPositionalDescription")} == {"1"}


def test_a_zone_that_was_last_seen_long_ago_has_an_end_and_no_status(tmp_path):
    _, document = written(tmp_path / "old.xml", age=timedelta(days=30))
    assert set(texts(document, "overallEndTime")) == {"1970-01-08T00:00:00Z"}
    assert set(texts(document, "probabilityOfOccurrence")) == {"probable"}
    assert set(texts(document, "validityStatus")) == {"definedByValidityTimeSpec"}
    assert not texts(document, "operatorActionStatus") + texts(document, "laneUsage") + texts(document, "impact")
    assert all("not known" in text for text in texts(document, "value") if "cones" in text)


def test_no_lane_is_restricted_where_all_are_open(tmp_path):
    """Also where the row of cones would close one."""
    open_lanes = partial(replace, impact=VehicleImpact.ALL_LANES_OPEN, closed_lane_count=1)
    made, document = written(tmp_path / "open.xml", change=open_lanes)
    assert texts(document, "numberOfLanesRestricted") == ["0"] * len(made)


def test_an_ended_zone_names_the_one_that_it_became_part_of(tmp_path):
    _, document = written(tmp_path / "ended.xml", change=ended)
    assert texts(document, "overallEndTime") == ["1970-01-08T00:00:00Z", *["1970-01-01T05:00:00Z"] * 3]
    assert [one.get("id") for one in document.iter("{*}objectReference")] == [str(UUID(int=1))] * 3


@needs_schema
def test_every_record_of_real_publications_is_used_or_named():
    """Counted by an independent parser."""
    found = {}
    for path in sorted((FOLDER / "samples").glob("*.xml")):
        tags = (one.tag for _, one in etree.iterparse(str(path)) if isinstance(one.tag, str))
        records = Counter(etree.QName(tag).localname for tag in tags)["situationRecord"]
        if records:
            read = read_datex2(path)
            assert len(read.zones) + len(read.unused) == records
            found[path.stem] = read
        else:
            with pytest.raises(InputError, match="Publication, expected a SituationPublication"):
                read_datex2(path)
    assert {name: (len(read.zones), len(read.unused)) for name, read in found.items()} == {
        "finland__roadworks": (0, 3),
        "france__events": (0, 1),
        "netherlands__situations": (6, 5),
        "netherlands__srti": (0, 1),
    }
    closed = found["netherlands__situations"].zones[0]
    assert closed.parts[0][0] == (6.207613, 52.693642) and closed.closed_lane_count == 1
    assert closed.ends_at == datetime(2026, 12, 1, 11, tzinfo=UTC) and closed.carriageways == ("mainCarriageway",)
    reasons = [one.reason for read in found.values() for one in read.unused]
    assert sum("only alertC" in reason for reason in reasons) == 3


RECORD = """<situationRecord xsi:type="{kind}" id="{id}" version="{version}"><validity><validityTimeSpecification>
<overallStartTime>{start}</overallStartTime><overallEndTime>2026-03-02T10:00:00+01:00</overallEndTime>
</validityTimeSpecification></validity>{more}<locationReference>{place}</locationReference></situationRecord>"""
LINE = "<gmlLineString{}><posList>{}</posList></gmlLineString>"
POINT = "<latitude>49.0</latitude><longitude>8.4</longitude>"


def publication(path, *changes, information="real"):
    usual = {
        "kind": "ConstructionWorks",
        "version": "1",
        "start": "2026-03-01T10:00:00Z",
        "more": "",
        "place": LINE.format("", "49 8 50 9"),
    }
    records = "".join(RECORD.format(**usual | {"id": f"r{n}"} | change) for n, change in enumerate(changes))
    path.write_text(
        '<payload xmlns="http://datex2.eu/schema/3/d2Payload" xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance">'
        f'<situation id="s"><headerInformation><informationStatus>{information}</informationStatus></headerInformation>'
        f"{records}</situation></payload>"
    )
    return path


@pytest.mark.parametrize(
    ("place", "expected", "approximate"),
    [
        (LINE.format("", "49 8 50 9"), (((8.0, 49.0), (9.0, 50.0)),), False),
        (
            LINE.format(' srsDimension="3" srsName="EPSG:4979"', "49 8 115 50 9 116"),
            (((8.0, 49.0), (9.0, 50.0)),),
            False,
        ),
        (LINE.format(' srsName="EPSG:32632"', "500000 0 500000 10"), (((9.0, 0.0), (9.0, 0.00009)),), False),
        (
            f"<pointByCoordinates><pointCoordinates>{POINT}</pointCoordinates></pointByCoordinates>",
            (((8.4, 49.0),),),
            False,
        ),
        (
            f"<tpegLinearLocation><to>{POINT.replace('49.0', '50.0')}</to><from>{POINT}</from></tpegLinearLocation>",
            (((8.4, 49.0), (8.4, 50.0)),),
            True,
        ),
        (f"<coordinatesForDisplay>{POINT}</coordinatesForDisplay>", (((8.4, 49.0),),), True),
        (
            f"<locationContainedInItinerary><location>{LINE.format('', '1 2 3 4')}</location></locationContainedInItinerary>"
            "<locationContainedInItinerary><location><alertCLinear/></location></locationContainedInItinerary>",
            (((2.0, 1.0), (4.0, 3.0)),),
            True,
        ),
    ],
)
def test_locations_of_every_kind(tmp_path, place, expected, approximate):
    [zone] = read_datex2(publication(tmp_path / "a.xml", {"place": place})).zones
    assert np.allclose(zone.parts, expected, atol=1e-6) and zone.approximate is approximate


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"kind": "SpeedManagement"}, "neither road works"),
        (
            {"kind": "RoadOrCarriagewayOrLaneManagement", "more": "<cause><causeType>accident</causeType></cause>"},
            "its cause is accident",
        ),
        ({"start": "2026-03-05T10:00:00Z"}, "ends .* before it starts"),
        ({"start": "2026-03-01T10:00:00"}, "starts_at"),
        ({"start": ""}, "starts_at"),
        ({"place": LINE.format("", "149 8 50 9")}, "parts"),
        ({"place": LINE.format("", "49 8 50")}, "3 numbers"),
        ({"place": LINE.format("", "49 8 x 9")}, "could not convert"),
        ({"place": LINE.format("", "49 8 nan 9")}, "parts"),
        ({"place": LINE.format(' srsName="moon"', "49 8 50 9")}, "moon.*is not a known CRS"),
        ({"place": LINE.format(' srsDimension="two"', "49 8 50 9")}, "two"),
        ({"place": ""}, "no coordinates, only a description"),
        ({"more": "<operatorActionStatus>rejected</operatorActionStatus>"}, "was rejected"),
        ({"id": ""}, "plan_id"),
    ],
)
def test_a_broken_record_is_named_and_costs_only_itself(tmp_path, change, reason):
    read = read_datex2(publication(tmp_path / "a.xml", {}, change, {}))
    assert [zone.plan_id for zone in read.zones] == ["r0", "r2"]
    [unused] = read.unused
    assert unused.record.startswith("situation s, record ")
    with pytest.raises(ValueError, match=reason):
        raise ValueError(unused.reason)


def test_the_last_version_of_a_record_counts_in_any_order(tmp_path):
    versions = [{"id": "r", "version": version} for version in ("9", "10", "2")]
    read = read_datex2(publication(tmp_path / "a.xml", *versions))
    assert [zone.version for zone in read.zones] == ["10"]
    assert [one.reason for one in read.unused] == [f"version {n} is replaced by version 10" for n in (9, 2)]


def test_exercises_are_no_plans_and_other_files_are_refused(tmp_path):
    assert "is test, not real" in read_datex2(publication(tmp_path / "a.xml", {}, information="test")).unused[0].reason
    for text, words in [
        ("<a/>", "expected DATEX II"),
        ("{}", "is not XML"),
        ("<payload xmlns='http://datex2.eu/'", "is not XML"),
    ]:
        (tmp_path / "b.xml").write_text(text)
        with pytest.raises(InputError, match=words):
            read_datex2(tmp_path / "b.xml")
    with pytest.raises(InputError, match="cannot be read"):
        read_datex2(tmp_path / "none.xml")
