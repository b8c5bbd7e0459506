"""What a user gets wrong, on the command line and in files: exit code, at most three lines, no traceback, and what helps.

All messages stand in `wrong_invocations.txt`, to be read aloud; renew it with CONETL_RENEW_MESSAGES=1.
"""

from __future__ import annotations

import os
import re
import shutil
import sys
from contextlib import closing
from pathlib import Path

import pytest

from conetl.cli import main
from conetl.db.connection import connect
from conetl.readers.drives import read_drive
from tests.integration.drives_of_days import merge, survey
from tests.unit.readers.drive_formats import SAMPLE, sample_frames, write_plain

LIST = Path(__file__).with_name("wrong_invocations.txt")
HEADER = "feature_id,lon,lat,ellipsoidal_height_m,last_seen_at"
GOOD = "1c223030-5d0f-4a7e-9a0d-0e4cf2a1b2c3,8.4302,49.0021,115.5,2026-03-01T10:00:00Z"
#: Name -> text of the files that the invocations name.
FILES = {
    "notes.txt": "Cones were seen on the L 605.\n",
    "clip.mp4": "not a video",
    "bad_row.csv": f"{HEADER}\n{GOOD}\n{GOOD.replace('1c22', '2c22').replace('49.0021', 'north')}\n",
    "bad_time.csv": f"{HEADER}\n{GOOD.replace('2026-03-01T10:00:00Z', 'last week')}\n",
    "swapped.csv": f"{HEADER}\n{GOOD.replace('8.4302,49.0021', '49.0021,8.4302')}\n",
    "probability.csv": f"{HEADER},existence_probability\n{GOOD},1.2\n",
    "no_crs.csv": "easting,northing,ellipsoidal_height_m,last_seen_at\n458000,5428000,115,2026-03-01\n",
    "good.csv": f"{HEADER}\n{GOOD}\n",
    "points.csv": "name\nP1\n",
    "lines.geojson": '{"type": "FeatureCollection", "features": [{"type": "Feature", "properties": {}, "geometry": '
    '{"type": "LineString", "coordinates": [[8.43, 49.0], [8.44, 49.0]]}}]}',
    "rules.yaml": "layout: {spacing: 10}\n",
    "rules_text.yaml": "as usual\n",
    "params.yaml": "reconcile: {min_gate: 0.5}\n",
    "params_far.yaml": "reconcile: {min_gate_m: far}\n",
    "params_class.yaml": "detection: {categories: [bollard]}\n",
    "params_negative.yaml": "reconcile: {min_gate_m: -1}\n",
    "nested.yaml": "[" * 3000,
    "feed.yaml": "publisher: Road office\ncolour: red\n",
    "rig_half.yaml": "rig_id: mine\nleft: {width_px: 960, height_px: 320, fx_px: 700, fy_px: 700, cx_px: 480, cy_px: 160}\n",
    "rig_text.yaml": "rig_id: mine\nleft: {width_px: wide}\n",
}  # fmt: skip
#: Command line, exit code, and words that the message must have. SURVEY stands for a feature of the map `survey`.
WRONG: list[tuple[str, int, str]] = [
    ("map dif 1 2", 2, "did you mean diff"),
    ("ingst drive", 2, "did you mean ingest"),
    ("export --format gpkg", 2, "did you mean map export"),
    ("map diff 1", 2, "after"),
    ("map diff --outt x 1 2", 2, "--outt"),
    ("ingest --map-srid UTM plain", 2, "--map-srid.*'UTM'.*whole number"),
    ("view --port 99999999", 2, "--port.*99999999.*65535"),
    ("map export --what nothing --out x.csv", 2, "--what.*features.*history"),
    ("base import --kind circles good.csv", 2, "--kind.*points.*lines"),
    ("map export --out", 2, "--out"),
    ("view survey", 2, "survey; did you mean --map survey"),
    ("map diff 1 2 --map survey --out x.png", 2, "x.png.*GeoJSON.*--image"),
    ("map picture x.png --changes 1", 2, "--changes"),
    ("ingest", 2, "drives"),
    ("map create west", 2, "--crs"),
    ("map show --as-of yesterday", 2, "'yesterday'.*2026-03-02"),
    ("map show --as-of 02.03.2026", 2, "02.03.2026"),
    ("map export --out x.csv --as-of 2026-13-01", 2, "2026-13-01"),
    ("map picture x.png --at 2026-03-02T25:00", 2, "2026-03-02T25:00"),
    ("report night 2026-02-30", 2, "2026-02-30"),
    ("report night 2026-03-01 --since 2026-03-01", 2, "--since"),
    ("map show --map servey", 2, "servey.*did you mean survey"),
    ("map show --map x", 2, "it has survey"),
    ("map show --map My_Map", 2, "'My_Map'.*a-z"),
    ("map create survey --crs EPSG:25832", 2, "already exists"),
    ("map create west --crs WGS84", 2, "'WGS84'.*EPSG:25832"),
    ("map create west --crs EPSG:4326", 2, "4326.*projected"),
    ("map create west --crs EPSG:25832+25833", 2, "25833.*not a height system"),
    ("map create west --crs EPSG:25832+7837", 2, "grid de_bkg_gcg2016.tif"),
    ("map create west --crs EPSG:999999", 2, "EPSG:999999"),
    ("map rename survey Survey!", 2, "'Survey!'"),
    ("map delete survey", 2, "--yes"),
    ("map restore missing.zip", 2, "missing.zip"),
    ("map restore notes.txt", 2, "notes.txt.*map delete"),
    ("map diff 1 9", 2, "changeset 9.*map log"),
    ("map diff 1 tomorrow", 2, "'tomorrow'"),
    ("map diff 2026-03-03 2026-03-02", 2, "2026-03-02 is before.*2026-03-03: exchange them"),
    ("map diff 1 2026-03-01", 2, "changeset 1 is later than 2026-03-01: exchange them"),
    ("map diff 1 1 --known-at soon", 2, "'soon'.*2026-03-02"),
    ("map picture x.png --known-at then", 2, "--known-at then.*--as-of"),
    ("map picture x.png --changes 2026-03-03 2026-03-02", 2, "exchange them"),
    ("map export --out x.csv --what changes --from 2026-03-03 --to 2026-03-02", 2, "--to 2026-03-02 is before --from"),
    ("report night --since 2026-03-03 --until 2026-03-02", 2, "--until 2026-03-02 is before --since 2026-03-03"),
    ("backfill plain --since 2026-03-03 --until 2026-03-02", 2, "--until 2026-03-02 is before --since 2026-03-03"),
    ("map log ffffffff", 2, "ffffffff.*map show"),
    ("map suppress zz", 2, "zz"),
    ("map suppress FEATURE --radius 50", 2, "50 m: expected.*20"),
    ("map pin ffffffff", 2, "ffffffff"),
    ("map revert 9", 2, "9.*map log"),
    ("map revert qqqq", 2, "qqqq"),
    ("report drive nosuch", 2, "nosuch"),
    ("report quality --checkpoints missing.csv", 2, "missing.csv"),
    ("drive accept nosuch", 2, "nosuch"),
    ("base drop roads", 2, "roads.*base list"),
    ("map export --out x.shp", 2, "x.shp.*--format"),
    ("map export --out x --format shape", 2, "shape.*geojson"),
    ("map export --out x.csv --format wzdx --what history", 2, "--what.*wzdx"),
    ("map export --out x.csv --publisher A", 2, "--publisher.*wzdx"),
    ("map export --out /proc/x.csv", 2, "/proc/x.csv"),
    ("map export --out feed.json --format wzdx", 2, "publisher"),
    ("map export --out feed.json --format wzdx --road-name A --feed feed.yaml", 2, "feed.yaml: colour.*known"),
    ("map export --out feed.json --format wzdx --feed feed.yaml", 2, "feed.yaml.*road_names"),
    ("map export --out feed.xml --format datex2 --publisher A --road-name B", 2, "country.*--country"),
    ("map picture x.gif", 2, "x.gif.*png"),
    ("map picture x.png --size big", 2, "big.*240x160"),
    ("map picture x.png --bbox 1,2,3", 2, "1,2,3.*west,south,east,north"),
    ("map picture x.png --bbox 8,49,7,50", 2, "west"),
    ("map import missing.csv", 2, "missing.csv"),
    ("map import notes.txt", 2, "notes.txt"),
    ("map import lines.geojson", 2, "lines.geojson.*point"),
    ("map import no_crs.csv", 2, "no_crs.csv.*--crs"),
    ("map import bad_row.csv", 2, "bad_row.csv, row 2.*north"),
    ("map import bad_time.csv", 2, "bad_time.csv, row 1.*last_seen_at.*last week"),
    ("map import swapped.csv", 2, "swapped.csv, row 1.*swapped"),
    ("map import probability.csv", 2, "row 1: existence_probability is .?1.2.?, expected at most 1"),
    ("map import good.csv --sigma-m -1", 2, "--sigma-m.*more than 0"),
    ("map import good.csv --crs UTM", 2, "--crs.*'UTM'"),
    ("map check-points points.csv", 2, "points.csv"),
    ("map check-points missing.csv", 2, "missing.csv"),
    ("map check-layout --rules rules.yaml", 2, "rules.yaml: layout.spacing"),
    ("map check-layout --rules rules_text.yaml", 2, "rules_text.yaml.*keys and values"),
    ("map check-layout --rules nested.yaml", 2, "nested.yaml"),
    ("map check-layout --speed-kmh 500", 2, "--speed-kmh.*200"),
    ("zones plan import missing.gpkg", 2, "missing.gpkg"),
    ("zones plan import notes.txt", 2, "notes.txt.*.gpkg"),
    ("zones plan import points.csv", 2, "points.csv.*wkt.*lon"),
    ("zones plan import good.csv", 2, "good.csv.*row 1.*plan_id.*--column"),
    ("zones plan import good.csv --time-zone Mars", 2, "Mars.*Europe/Berlin"),
    ("zones plan import good.csv --column Nr", 2, "--column.*plan_id=Nr"),
    ("zones compare --out x.pdf", 2, "x.pdf.*.html"),
    ("zones compare --rules rules.yaml", 2, "rules.yaml: layout"),
    ("zones judge zz accepted", 2, "zz.*zones compare"),
    ("zones judge ffffffff fine", 2, "fine.*confirmed"),
    ("base import missing.laz", 2, "missing.laz"),
    ("base import notes.txt", 2, "notes.txt"),
    ("ingest nowhere", 2, "nowhere"),
    ("ingest clip.mp4", 2, "clip.mp4.*conetl init"),
    ("ingest empty", 2, "empty"),
    ("ingest columns", 2, "trajectory.csv.*heading"),
    ("ingest half_rig", 2, "rig.yaml.*right.*missing"),
    ("ingest keys", 2, "drive.yaml.*speed"),
    ("ingest plain --params params.yaml", 2, "params.yaml: reconcile.min_gate.*did you mean min_gate_m"),
    ("ingest plain --params params_far.yaml", 2, "min_gate_m: expected a number, found 'far'"),
    ("ingest plain --params params_negative.yaml", 2, "min_gate_m: expected .*found -1"),
    ("ingest plain --params missing.yaml", 2, "missing.yaml"),
    ("inspect nowhere", 2, "nowhere"),
    ("inspect empty", 2, "empty"),
    ("init nowhere", 2, "nowhere"),
    ("init empty", 2, "empty"),
    ("backfill nowhere", 2, "nowhere"),
    ("ingest --category cone plain", 2, "cone: .*traffic_cone.*lane_marking, all"),
    ("ingest --category all --category cone plain", 2, "cone: .*traffic_cone"),
    ("ingest --params params_class.yaml plain", 2, "bollard: expected some of traffic_cone, tubular_marker"),
    ("detect nowhere.png --out x.json", 2, "nowhere.png"),
    ("locate a.png b.png --calibration rig_half.yaml", 2, "a.png|rig_half.yaml"),
    ("init empty --set start=noon", 2, "did you mean images.start"),
    ("init empty --set images.every=0", 2, "images.every: expected at least 1, found 0"),
    ("init empty --right-offset 0", 2, "did you mean --set images.right_offset_s="),
    ("rig show notes.txt", 2, "notes.txt"),
    ("rig show rig_half.yaml", 2, "rig_half.yaml: right: is missing"),
    ("rig show rig_text.yaml", 2, "rig_text.yaml: left.width_px: expected a whole number"),
    ("rig convert notes.txt out.yaml", 2, "out.yaml.*--to"),
    ("calibrate empty --board chess --out rig.yaml", 2, "chess"),
    ("calibrate empty --board chessboard:9x6:37.8mm --out rig.yaml", 2, "empty"),
    ("evaluate empty --out accuracy", 2, "empty"),
    ("watch nowhere --idle-seconds 0.1", 2, "nowhere"),
    ("db prune", 2, "--keep-positions"),
    ("db prune --keep-results soon", 2, "soon.*90d"),
    ("CONETL_MAP_NAME=My_Map map show", 2, "CONETL_MAP_NAME.*My_Map"),
    ("CONETL_WORKERS=0 map show", 2, "CONETL_WORKERS.*at least 1"),
    ("CONETL_TASK_RUNNER=cloud map show", 2, "CONETL_TASK_RUNNER.*threads"),
    ("CONETL_DATABASE_URL=nonsense map show", 3, "nonsense"),
    ("CONETL_DATABASE_URL=postgresql://127.0.0.1:9/x map show", 3, "127.0.0.1:9.*cannot be reached"),
]  # fmt: skip
_said: dict[str, str] = {}


@pytest.fixture(scope="module")
def folder(tmp_path_factory, module_database_url, prefect_here):
    """The files, some drives, and a map of one drive with the name `survey`; a Prefect server runs."""
    root = tmp_path_factory.mktemp("wrong")
    for name, text in FILES.items():
        (root / name).write_text(text)
    (root / "empty").mkdir()
    plain = write_plain(root / "plain", sample_frames()[:3], read_drive(SAMPLE)[0].rig)
    for name in ("columns", "half_rig", "keys"):
        shutil.copytree(plain, root / name)
    log = root / "columns" / "trajectory.csv"
    log.write_text(log.read_text().replace("yaw_deg", "heading", 1))
    (root / "half_rig" / "rig.yaml").write_text(FILES["rig_half.yaml"])
    (root / "keys" / "drive.yaml").write_text("speed: 50\n")
    with closing(connect(module_database_url)) as conn:
        merge(conn, survey(0), map_name="survey")
        conn.commit()
        with conn.cursor() as cursor:
            cursor.execute("select feature_id::text from conetl.current_feature order by 1 limit 1")
            [feature] = cursor.fetchone()
    return root, module_database_url, feature


@pytest.mark.parametrize(("line", "code", "words"), WRONG, ids=[line for line, _, _ in WRONG])
def test_what_is_wrong_is_said(folder, monkeypatch, capsys, line, code, words):
    root, url, feature = folder
    monkeypatch.chdir(root)
    monkeypatch.setenv("COLUMNS", "200")
    for name in [name for name in os.environ if name.startswith("CONETL_")]:
        monkeypatch.delenv(name)
    values = {"CONETL_HOME": str(root / "home"), "CONETL_DATABASE_URL": url, "CONETL_MAP_NAME": "survey"}
    words_of = line.split()
    while "=" in words_of[0] and words_of[0].startswith("CONETL_"):
        name, value = words_of.pop(0).split("=", 1)
        values[name] = value
    for name, value in values.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(sys, "argv", ["conetl", *(feature if word == "FEATURE" else word for word in words_of)])
    monkeypatch.setattr(sys.modules["__main__"], "__package__", None)  # else usage says `python -m pytest`
    with pytest.raises(SystemExit) as ended:
        main()
    said = capsys.readouterr()
    text = (said.err + said.out).strip().replace(str(root), "FOLDER").replace(feature, "FEATURE")
    text = re.sub(r"/\S*/proj\b", "PROJ", re.sub(r"/tmp/conetl-test\S*", "DATABASE", text))
    _said[line] = text
    assert (ended.value.code, "Traceback" in text) == (code, False), text
    assert len(text.splitlines()) <= 3, text
    assert re.search(words, text.replace("\n", " ")), text


def test_all_messages_stand_in_one_list():
    """Run after the others; only where all of them ran."""
    if len(_said) < len(WRONG):
        pytest.skip("only some invocations were run")
    text = "".join(f"$ conetl {line}\n{_said[line]}\n\n" for line, _, _ in WRONG)
    if os.environ.get("CONETL_RENEW_MESSAGES"):
        LIST.write_text(text)
    assert LIST.read_text() == text
