"""Exports of the map: contract, times, atomic files; and the QGIS project, opened and drawn by a real QGIS."""

from __future__ import annotations

import csv
import json
import os
import re
import subprocess
import zipfile
from datetime import datetime
from html import unescape
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.stats import chi2

from conetl.db.connection import address, execute
from conetl.db.map.map_store import read_current_features
from conetl.exports import FORMATS
from conetl.exports.export import export_map
from conetl.exports.kind_marks import KIND_MARKS, PAINT
from conetl.exports.qgis_project import _iso, write_qgis_project
from conetl.exports.source import ExportContent, ExportRequest
from conetl.exports.text_files import iso_utc
from conetl.model.base import utc_from_ns
from conetl.model.errors import InputError
from conetl.model.map_records import DeltaKind
from conetl.pipeline.maps.decisions import SUPPRESS, decide_location
from tests.integration.drives_of_days import merge, survey


def test_the_same_map_gives_the_same_bytes(conn, samples, tmp_path):
    """In every format, so that a changed hash in the manifest means a changed map."""
    samples.commit(conn, *[samples.added(samples.feature(str(i), xyz_m=(i, i, 0.0))) for i in range(50)], key="1")
    for file_format, form in FORMATS.items():
        paths = [tmp_path / f"{name}{form.suffix}" for name in ("once", "again")]
        once, again = (export_map(conn, path, file_format, ExportRequest()) for path in paths)
        assert once["sha256"] == again["sha256"], file_format
    known_at = ExportRequest(known_at=datetime.fromisoformat(once["last_committed_at"]))
    before = export_map(conn, tmp_path / "before.gpkg", "gpkg", known_at)
    samples.commit(conn, samples.added(samples.feature("later")), key="2")
    assert export_map(conn, tmp_path / "after.gpkg", "gpkg", known_at)["sha256"] == before["sha256"]


def test_the_manifest_tells_of_decisions_too(conn, tmp_path):
    """Two exports that differ do not name the same state of the map."""
    merge(conn, survey(0))
    feature = read_current_features(conn)[0]
    conn.rollback()
    before = export_map(conn, tmp_path / "before.csv", "csv", ExportRequest())
    decided = decide_location(conn, SUPPRESS, str(feature.feature_id), map_name="default")
    after = export_map(conn, tmp_path / "after.csv", "csv", ExportRequest())
    assert (before["rows"] - after["rows"], before["changesets"]) == (1, after["changesets"])
    assert before["last_committed_at"] < after["last_committed_at"] == iso_utc(decided.decided_at)


def test_a_removed_cone_was_there_until_it_was_gone(conn, samples, tmp_path):
    """Also where it was confirmed after the first of the two instants, which made another version of it."""
    feature, day_ns = samples.feature(), samples.DAY_NS
    samples.commit(conn, samples.added(feature), key="1")
    seen = samples.changed("confirmed", feature, samples.START_NS + 4 * day_ns, observation_count=9)
    samples.commit(conn, seen, key="2")
    gone_ns = samples.START_NS + 9 * day_ns
    samples.commit(conn, samples.removed(seen.new, gone_ns), key="3")
    since, until = (utc_from_ns(samples.START_NS + days * day_ns) for days in (1, 19))
    export_map(conn, tmp_path / "c.csv", "csv", ExportRequest(what=ExportContent.CHANGES, since=since, until=until))
    with (tmp_path / "c.csv").open(newline="") as file:
        [row] = csv.DictReader(file)
    gone_at = iso_utc(utc_from_ns(gone_ns))
    assert (row["change"], row["version"], row["old_version"]) == ("removed", "3", "1")
    assert (row["valid_from"], row["changed_at"], row["valid_to"]) == (gone_at, gone_at, "")
    assert float(row["existence_probability"]) == samples.ABSENT.existence_probability


#: QGIS comes for the system's Python only.
PYTHON = Path("/usr/bin/python3")
RENDER = Path(__file__).with_name("qgis_render.py")
OFFSCREEN = {"PATH": os.environ["PATH"], "HOME": "/tmp", "QT_QPA_PLATFORM": "offscreen"}


def has_qgis() -> bool:
    if not PYTHON.exists():
        return False
    return (
        subprocess.run([PYTHON, "-c", "import qgis.core"], capture_output=True, env=OFFSCREEN, check=False).returncode
        == 0
    )


@pytest.fixture
def surveyed(conn, samples):
    for day in range(2):
        merge(conn, survey(day))
    [at] = execute(
        conn, "select avg(ST_X(geom)) as x, avg(ST_Y(geom)) as y, avg(ST_Z(geom)) as z from conetl.current_feature"
    )
    conn.rollback()
    vertices_m = np.add((at["x"], at["y"] + 3.0, at["z"]), np.linspace((-5, 0, 0), (5, 1, 0), 5))
    line = samples.line_feature(samples.marking(vertices_m, pattern="dashed", dash_m=1.0, gap_m=2.0, colour="yellow"))
    samples.commit(conn, samples.added(line), key="1", markings=[samples.marking_track(line.marking)])
    return conn


def test_no_secret_and_nothing_half_written(surveyed, tmp_path):
    path = tmp_path / "cones.qgz"
    write_qgis_project(surveyed, path, map_name="default", user="anna")
    text = unescape(zipfile.ZipFile(path).read("cones.qgs").decode())
    assert "password" not in text
    assert float(re.search(r'([\d.]+) \* "sigma_m"', text)[1]) == pytest.approx(
        2 * np.sqrt(chi2.ppf(0.95, 2)), abs=1e-3
    )
    [last] = execute(
        surveyed, "select max(last_seen_ns) as ns from conetl.feature_version where upper_inf(system_period)"
    )
    assert f"<end>{_iso(utc_from_ns(last['ns']))}</end>" in text
    assert "user='anna'" in text
    assert f"dbname='{address(surveyed)['dbname']}'" in text
    with pytest.raises(InputError, match=r"\.qgz or \.qgs"):
        write_qgis_project(surveyed, tmp_path / "cones.xml", map_name="default")
    with pytest.raises(InputError, match="no map named nowhere"):
        write_qgis_project(surveyed, tmp_path / "other.qgs", map_name="nowhere")
    assert [file.name for file in tmp_path.iterdir()] == ["cones.qgz"]


@pytest.mark.skipif(not has_qgis(), reason="python3-qgis is not installed for the system's Python")
def test_qgis_opens_and_draws_it(surveyed, tmp_path):
    project, image = tmp_path / "cones.qgz", tmp_path / "cones.png"
    write_qgis_project(surveyed, project, map_name="default")
    done = subprocess.run([PYTHON, RENDER, project, image], env=OFFSCREEN, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["read"] and found["errors"] == [] and found["crs"] == "EPSG:32632"
    [first] = execute(surveyed, "select min(lower(valid_period)) as at from conetl.feature_version")
    assert found["time"] == [_iso(first["at"]).rstrip("Z")]  # the first sighting, to the next second
    [counts] = execute(
        surveyed,
        "select count(*) as over_time, count(*) filter (where upper_inf(valid_period)) as now "
        "from conetl.feature_version where upper_inf(system_period) and line is null and present",
    )
    layers = found["layers"]
    assert all(layer["valid"] for layer in layers.values())
    assert layers["cones_standing_now"]["features"] == counts["now"] > 4
    assert layers["cones_over_time"]["features"] == counts["over_time"] > counts["now"]
    assert (layers["lane_markings_now"]["features"], layers["lane_markings_now"]["renderer"]) == (
        1,
        "categorizedSymbol",
    )
    assert layers["cones_over_time"]["temporal"] and layers["cones_over_time"]["fields"] == ["valid_from", "valid_to"]
    assert layers["cones_standing_now"]["renderer"] == "categorizedSymbol"
    pixels = np.asarray(Image.open(image).convert("RGB")).reshape(-1, 3).astype(int)
    shown = {
        "confirmed": KIND_MARKS[DeltaKind.CONFIRMED].colour,
        "moved": KIND_MARKS[DeltaKind.MOVED].colour,
        "paint": PAINT["yellow"],
    }
    for kind, colour in shown.items():
        near = (np.abs(pixels - list(bytes.fromhex(colour[1:]))).max(axis=1) < 24).sum()
        assert near > 20, f"{kind} is not to be seen"
