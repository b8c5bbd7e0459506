"""`conetl report quality`: every figure computed again from the rows of the tables, in plain Python, to the last digit."""

from __future__ import annotations

import csv
import json
import math
import os
import random
from datetime import UTC, datetime, timedelta
from fractions import Fraction
from pathlib import Path

import pytest
from lxml import etree

from conetl.db.connection import execute
from conetl.db.schema import run_audits
from conetl.readers.surveyed_points import read_surveyed_points
from tests.command import ROOT
from tests.integration.drives_of_days import merge, survey

AT = datetime(2026, 3, 10, tzinfo=UTC)
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
COLUMNS = ("name", "easting", "northing", "height_m", "sigma_e_m", "sigma_n_m", "sigma_u_m")


def mean(values):
    """Of the exact sum."""
    return float(sum(map(Fraction, values))) / len(values)


def rms(values):
    return math.sqrt(mean([value * value for value in values]))


def instant(nanoseconds):
    return EPOCH + timedelta(microseconds=nanoseconds // 1000)


def days(moment):
    return ((AT - moment) // timedelta(microseconds=1)) * 1000 / 1e9 / 86400.0


def rank(values, percent):
    """The smallest value that at least so many percent of the values do not exceed."""
    return next(v for v in sorted(values) if 100 * sum(other <= v for other in values) >= percent * len(values))


def age_class(age):
    return min((limit for limit in (1, 7, 30) if age <= limit), default=None)


@pytest.fixture(scope="module")
def filled(another_database, samples):
    """Two surveys of one road, and 40 cones elsewhere."""
    with another_database() as conn:
        for day in (0, 1):
            merge(conn, survey(day))
        shift = random.Random(1)
        made = [
            samples.feature(
                f"far {k}",
                existence_probability=shift.uniform(0.9, 1.0),
                **samples.standing_at((458_900.0 + 10 * k, 5_428_500.0, 115.0), cov_m2=samples.cov_of(0.03)),
            )
            for k in range(40)
        ]
        samples.commit(conn, *[samples.added(one) for one in made], key="fa")
        conn.commit()
        yield conn


def write_points(path, count):
    """Check points with known errors; the last one has no cone."""
    draw = random.Random(count)
    xyz = [(458_900.0 + 10 * k, 5_428_500.0, 115.0) for k in range(count)]
    rows = [
        (f"P{k}", *(round(value + draw.gauss(0, 0.03), 4) for value in place), 0.01, 0.012, 0.02)
        for k, place in enumerate(xyz)
    ]
    rows.append(("nothing", 458_000.0, 5_428_500.0, 115.0, 0.01, 0.012, 0.02))
    with path.open("w", newline="") as file:
        csv.writer(file).writerows([COLUMNS, *rows])
    return path, rows


def standing(conn):
    rows = execute(
        conn,
        "select v.*, ST_X(geom) as x, ST_Y(geom) as y, ST_Z(geom) as z from conetl.feature_version v where present and line is "
        "null and valid_period @> %(at)s and upper_inf(system_period) order by feature_id",
        {"at": AT},
    )
    conn.rollback()
    return rows


def asked(conn, conetl_at, points):
    return json.loads(conetl_at(conn, "report", "quality", "--checkpoints", points, "--crs", "EPSG:32632", "--as-of",
        AT.isoformat(), "--output", points.parent, "--json"))  # fmt: skip


@pytest.fixture
def conetl_at(monkeypatch, tmp_path):
    """The command line in this process; exit code 1: the made cones have no tracks, which audits find."""
    from typer.testing import CliRunner

    from conetl.cli.app import app

    def run(conn, *arguments):
        for name, value in (("DATABASE_URL", conn.dsn), ("HOME", str(tmp_path)), ("MAP_NAME", "default")):
            monkeypatch.setenv(f"CONETL_{name}", value)
        result = CliRunner().invoke(app, [*map(str, arguments)])
        assert result.exit_code == bool(any(one.row_count for one in run_audits(conn))), result.output
        conn.rollback()
        return result.stdout

    return run


def test_positional_accuracy_and_measures(filled, conetl_at, tmp_path):
    path, rows = write_points(tmp_path / "points.csv", 40)
    found = asked(filled, conetl_at, path)
    features = standing(filled)
    assert found["features"] == len(features)
    # Reading converts by way of WGS 84, which costs less than a nanometre.
    read = [(p.name, *p.xyz_m, *p.sigma_m) for p in read_surveyed_points(path, 32632, crs="EPSG:32632")]
    assert all(math.dist(a[1:], b[1:]) < 1e-9 for a, b in zip(rows, read, strict=True))
    rows = read
    pairs = [
        (row, near)
        for row in rows
        for near in features
        if math.dist(row[1:4], (near["x"], near["y"], near["z"])) <= 0.75
    ]
    assert len(pairs) == 40
    e, n, u = ([near[axis] - row[k] for row, near in pairs] for k, axis in ((1, "x"), (2, "y"), (3, "z")))
    se, sn, su = (rms([row[k] for row, _ in pairs]) for k in (4, 5, 6))
    horizontal = math.sqrt(rms(e) * rms(e) + rms(n) * rms(n) + se * se + sn * sn)
    vertical = math.sqrt(rms(u) * rms(u) + su * su)
    position = found["positional"]
    assert (position["check_points"], position["tested"]) == (41, 40)
    assert position["mean_enu_m"] == [mean(e), mean(n), mean(u)]
    assert position["rmse_differences_enu_m"] == [rms(e), rms(n), rms(u)]
    assert position["rmse_points_enu_m"] == [se, sn, su] != [0, 0, 0]
    assert (position["rmse_h_m"], position["rmse_v_m"]) == (horizontal, vertical)
    assert position["rmse_3d_m"] == math.sqrt(horizontal * horizontal + vertical * vertical)
    assert position["nssda_horizontal_m"] == 1.7308 * math.sqrt(rms(e) * rms(e) + rms(n) * rms(n))
    assert position["nssda_vertical_m"] == 1.96 * rms(u)
    classes = [math.ceil(100 * rmse) for rmse in (horizontal, vertical)]
    assert position["verdict"] == "horizontal class {} cm, vertical class {} cm".format(*classes)
    audits = {one.name: one.row_count for one in run_audits(filled)}
    filled.rollback()
    periods = sum(count for name, count in audits.items() if "periods" in name)
    assert found["audits"] == audits
    assert [measure["value"] for measure in found["measures"]] == [
        1.0,
        1 / 41,
        mean([1.0 - one["existence_probability"] for one in features]),
        horizontal,
        vertical,
        mean([math.sqrt(one["cov_xx"] + one["cov_yy"]) for one in features]),
        mean([math.sqrt(one["cov_zz"]) for one in features]),
        0.0,
        sum(days(instant(one["last_seen_ns"])) > 7 for one in features) / len(features),
        periods,
        sum(audits.values()) - periods,
    ]


def test_ten_points_give_no_verdict(filled, conetl_at, tmp_path):
    path, _ = write_points(tmp_path / "points.csv", 10)
    position = asked(filled, conetl_at, path)["positional"]
    assert position["tested"] == 10 and position["verdict"] is None and position["rmse_h_m"] > 0
    page = (tmp_path / "quality.html").read_text()
    assert "No verdict: an object of the map stands on 10 check points, and ASPRS 2023 requires at least 30" in page
    assert "class" not in position["statement"]
    nowhere = tmp_path / "nowhere.csv"
    nowhere.write_text(",".join(COLUMNS) + "\nA,0,5000000,0,1,1,1\n")
    position = asked(filled, conetl_at, nowhere)["positional"]
    assert (position["tested"], position["rmse_h_m"], position["verdict"]) == (0, None, None)


def test_coverage_ages_and_latency(filled, conetl_at, tmp_path):
    path, _ = write_points(tmp_path / "points.csv", 1)
    found = asked(filled, conetl_at, path)
    frames = execute(
        filled, "select drive_uuid, captured_at_ns, ST_X(geom) as x, ST_Y(geom) as y from conetl.frame_pair"
    )
    drives = execute(
        filled, "select captured_to_ns, committed_at from conetl.drive join conetl.changeset using (drive_uuid)"
    )
    squares = {}
    for one in frames:
        squares.setdefault((256.0 * (one["x"] // 256), 256.0 * (one["y"] // 256)), []).append(one)
    assert len(squares) >= 1
    for square in found["squares"]:
        here = squares.pop((square["west_m"], square["south_m"]))
        last = instant(max(one["captured_at_ns"] for one in here))
        assert square["drives"] == len({one["drive_uuid"] for one in here}) and square["frame_pairs"] == len(here)
        assert datetime.fromisoformat(square["last_at"]) == last and square["age_days"] == days(last)
    assert not squares
    features = [age_class(days(instant(one["last_seen_ns"]))) for one in standing(filled)]
    passed = [age_class(square["age_days"]) for square in found["squares"]]
    assert found["ages"] == [
        {"up_to_days": limit, "squares": passed.count(limit), "features": features.count(limit)}
        for limit in (1, 7, 30, None)
    ]
    delays = [(one["committed_at"] - instant(one["captured_to_ns"])).total_seconds() for one in drives]
    assert found["latency"] == {"drives": 3, "p50_s": rank(delays, 50), "p95_s": rank(delays, 95)}


def test_a_state_before_the_drives_has_none_of_their_figures(filled, conetl_at, tmp_path):
    found = json.loads(
        conetl_at(filled, "report", "quality", "--as-of", "2026-02-01", "--output", tmp_path / "a.html", "--json")
    )
    assert (found["features"], found["squares"], found["positional"]) == (0, [], None)
    assert found["latency"] == {"drives": 0, "p50_s": None, "p95_s": None}
    assert {one["value"] for one in found["measures"]} <= {None, 0.0} | set(found["audits"].values()) | {
        float(sum(found["audits"].values()))
    }
    assert "positional accuracy was not tested" in (tmp_path / "a.html").read_text()


#: Folder with the schemas of ISO as HOST/PATH, as their imports name them: standards.iso.org/iso/19157/-2/mdq/1.0/mdq.xsd ...
ISO_XSD = Path(os.environ.get("ISO_XSD_FOLDER") or ROOT.parent / "shared" / "data" / "iso_xsd")
MDQ = "http://standards.iso.org/iso/19157/-2/mdq/1.0"
GML = "http://www.opengis.net/gml/3.2"


def iso_schema():
    """GML is imported first: libxml2 reads one document of a namespace, and others of the schemas import parts of it."""

    class Local(etree.Resolver):
        def resolve(self, url, _, context):
            return (
                self.resolve_filename(str(ISO_XSD / url.partition("://")[2]), context)
                if url.startswith("http")
                else None
            )

    parser = etree.XMLParser(no_network=True)
    parser.resolvers.add(Local())
    places = {GML: "http://schemas.opengis.net/gml/3.2.1/gml.xsd", MDQ: f"{MDQ}/mdq.xsd"}
    imports = "".join(f'<import namespace="{name}" schemaLocation="{place}"/>' for name, place in places.items())
    return etree.XMLSchema(
        etree.fromstring(f'<schema xmlns="http://www.w3.org/2001/XMLSchema">{imports}</schema>', parser)
    )


def xml_report(conn, conetl_at, folder, *more):
    path = folder / "report.xml"
    given = ("report", "quality", "--as-of", AT.isoformat(), "--out", path, "--json", *more)
    found = json.loads(conetl_at(conn, *given))
    return etree.parse(path), found


@pytest.mark.parametrize("count", [None, 10, 40])
def test_the_report_as_iso_xml_has_the_values_of_the_json(filled, conetl_at, tmp_path, count):
    points = (
        ()
        if count is None
        else ("--checkpoints", write_points(tmp_path / "points.csv", count)[0], "--crs", "EPSG:32632")
    )
    tree, found = xml_report(filled, conetl_at, tmp_path, *points)
    names = {"mdq": MDQ, "gco": "http://standards.iso.org/iso/19115/-3/gco/1.0"}
    reports = tree.getroot().findall("mdq:report/*", names)
    assert tree.getroot().tag == f"{{{MDQ}}}DQ_DataQuality" and len(reports) == len(found["measures"]) > 8
    for report, measure in zip(reports, found["measures"], strict=True):
        text = [one.text for one in report.iterfind(".//gco:CharacterString", names)]
        assert text[:3] == [measure["name"], measure["element"], measure["basis"]]
        values = [float(one.text) for one in report.iterfind(".//gco:Real", names)]
        assert values == ([] if measure["value"] is None else [measure["value"]])
        assert (len(report.findall(".//mdq:DQ_DescriptiveResult", names)) > 0) == (
            measure["value"] is None or ("check points" in measure["basis"] and measure["unit"] == "m"))  # fmt: skip
        assert all(one.text == AT.isoformat() for one in report.iterfind(".//gco:DateTime", names))
    kinds = [etree.QName(report).localname for report in reports]
    assert {"DQ_CompletenessOmission", "DQ_CompletenessCommission", "DQ_AbsoluteExternalPositionalAccuracy",
            "DQ_ThematicClassificationCorrectness", "DQ_TemporalValidity", "DQ_TemporalConsistency",
            "DQ_ConceptualConsistency"} == set(kinds)  # fmt: skip
    statements = [
        one.text for one in tree.iterfind(".//mdq:DQ_DescriptiveResult/mdq:statement/gco:CharacterString", names)
    ]
    if count is not None:
        assert statements.count(found["positional"]["statement"]) == 2
        assert ("No verdict" in found["positional"]["statement"]) == (count < 30)


def test_the_xml_is_valid_by_the_schemas_of_iso(filled, conetl_at, tmp_path):
    if not ISO_XSD.is_dir():
        pytest.skip(f"no schemas of ISO: neither ISO_XSD_FOLDER nor {ISO_XSD} names a folder of them")
    schema = iso_schema()
    for points in ((), ("--checkpoints", write_points(tmp_path / "points.csv", 40)[0], "--crs", "EPSG:32632")):
        tree, _ = xml_report(filled, conetl_at, tmp_path, *points)
        assert schema.validate(tree), schema.error_log
    tree.getroot().remove(tree.getroot()[0])
    assert not schema.validate(tree), "without a scope"
