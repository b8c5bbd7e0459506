"""Every command of README and of the pages for users is a valid command line, and runs unless another test runs it at length."""

from __future__ import annotations

import csv
import json
import os
import re
import shlex
import shutil
import sys
from contextlib import closing

import cv2
import geopandas
import pytest
import yaml
from pyproj import Transformer
from shapely import Point
from typer.main import get_command

from conetl.cli import main
from conetl.cli.app import app
from conetl.db.connection import connect
from conetl.db.map.map_store import read_current_features
from conetl.files.documents import read_yaml_mapping
from conetl.model.columns import BY_NAME, TABLES
from conetl.readers.drives import read_drive
from conetl.readers.rigs import write_rig_yaml
from tests.command import ROOT
from tests.integration.drives_of_days import merge, survey
from tests.integration.small_drives import SAMPLES, cut_drive
from tests.synthetic.world import ORIGIN_M
from tests.unit.readers.test_rig_formats import kalibr_of

FOLDERS = ("start", "tutorial", "record", "map", "operate", "help", "reference", "explanation")
PAGES = (
    "README.md",
    *(str(page.relative_to(ROOT)) for folder in FOLDERS for page in sorted((ROOT / "docs" / folder).glob("*.md"))),
)
#: Commands that take minutes, servers, or recordings of their own -> the test that runs them, and its words for it. LiDAR,
#: renderer and training are tested as functions, not as commands: there is no small LiDAR drive, and the others are extras.
ELSEWHERE = {
    "ingest": ("integration/test_ingest.py", '"ingest"'),
    "backfill": ("integration/test_operations.py", '"backfill"'),
    "watch": ("integration/test_watch.py", '"watch"'),
    "init": ("unit/readers/test_video_drives.py", '"init"'),
    "view": ("browser/test_view.py", '"view"'),
    "up": ("integration/test_operations.py", '"up"'),
    "down": ("integration/test_operations.py", '"down"'),
    "status": ("integration/test_operations.py", '"status"'),
    "doctor": ("integration/test_doctor.py", '"doctor"'),
    "drive": ("integration/test_reports.py", '"drive", "accept"'),
    "zones notify": ("integration/test_notices.py", '"zones", "notify"'),
    "calibrate": ("integration/test_tools.py", "calibrate("),
    "evaluate": ("integration/test_tools.py", '"evaluate"'),
    "demo": ("integration/test_ingest.py", '"demo"'),
    "lidar-check": ("unit/evaluation/test_lidar_check.py", "conetl.evaluation.lidar"),
    "simulate": ("unit/simulation/test_render.py", "conetl.simulation"),
    "labels": ("integration/test_labels.py", '"labels", "import"'),
    "train": ("unit/learning/test_fine_tuning.py", "train_model("),
}
#: What a reader puts in the place of the text -> what stands in the folder of this test.
PLACES = {
    "path/to/drive": "drive",
    "path/to/folder": "drive",
    "IMAGES": "images",
    "lanes.osm": "data/base/lane_boundaries.geojson",
    "survey.laz": "street.laz",
}


def commands_of(page: str) -> list[str]:
    """Command lines of the shell blocks of a page, without comments and without what is optional."""
    found = []
    for language, body in re.findall(r"^```(\w*)\n(.*?)^```$", (ROOT / page).read_text(), re.DOTALL | re.MULTILINE):
        if language in ("", "bash", "sh"):
            lines = [re.sub(r"\s+#.*| \[[^\]]*\]", "", line).strip() for line in body.replace("\\\n", " ").splitlines()]
            found += [line for line in lines if re.match(r"(\w+=\S+ )*(conetl|make) ", line + " ")]
    return found


COMMANDS = [(page, line) for page in PAGES for line in commands_of(page)]


@pytest.mark.parametrize(("page", "line"), COMMANDS, ids=[line for _, line in COMMANDS])
def test_every_command_is_valid(page, line):
    words = [word for word in shlex.split(line) if not re.match(r"[A-Z_]+=", word)]
    if words[0] == "make":
        targets = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
        assert set(words[1:]) <= set(targets)
        return
    command, words = get_command(app), words[1:]
    while hasattr(command, "get_command"):
        name = words.pop(0)
        command = command.get_command(None, name)
        assert command is not None, f"{page}: {line}"
    assert command.make_context(name, words)


def test_what_runs_elsewhere_does():
    for command, (path, words) in ELSEWHERE.items():
        assert words in (ROOT / "tests" / path).read_text(), f"{path} does not run {command}"


@pytest.fixture(scope="module")
def folder(tmp_path_factory, module_database_url):
    """What the pages assume: a drive, images, a rig, survey points, and the maps `default` and `demo`."""
    root = tmp_path_factory.mktemp("docs")
    (root / "data").symlink_to(ROOT / "data")
    cut_drive(SAMPLES[0], root / "drive", "2026-04-01")
    shutil.copy(ROOT / "data/base/street.laz", root / "street.laz")
    (root / "images").mkdir()
    for side, name in (("image_02", "left"), ("image_03", "right")):
        image = next((root / "drive" / side / "data").glob("*.jpg"))
        shutil.copy(image, root / "images" / f"{name}.jpg")
        cv2.imwrite(str(root / f"{name}.png"), cv2.imread(str(image)))
    rig = read_drive(SAMPLES[0])[0].rig
    write_rig_yaml(rig, root / "rig.yaml")
    (root / "camchain.yaml").write_text(yaml.safe_dump(kalibr_of(rig)))
    text = re.search(r"```yaml\n(publisher:.*?)```", (ROOT / "docs/map/work_zones.md").read_text(), re.DOTALL)
    assert text is not None
    (root / "feed.yaml").write_text(text[1])
    assert read_yaml_mapping(root / "feed.yaml", "feed")
    with closing(connect(module_database_url)) as conn:
        for name in ("default", "demo"):
            for day in (0, 1):
                merge(conn, survey(day), map_name=name)
            conn.commit()
        features = read_current_features(conn)
        conn.rollback()
    with (root / "survey.csv").open("w", newline="") as file:
        csv.writer(file).writerows(
            [("name", "easting_m", "northing_m", "height_m"), *((f"P{i}", *f.xyz_m) for i, f in enumerate(features))]
        )
    with (root / "cones.csv").open("w", newline="") as file:
        others = [(f.xyz_m[0] + 40 + 3 * i, f.xyz_m[1]) for i, f in enumerate(features)]  # arranged otherwise
        csv.writer(file).writerows([("easting_m", "northing_m"), *others])
    to_degrees = Transformer.from_crs(32632, 4326, always_xy=True)
    line = [to_degrees.transform(ORIGIN_M[0] + along_m, ORIGIN_M[1] + 2.0) for along_m in (-100.0, 200.0)]
    (root / "lanes.geojson").write_text(json.dumps({"type": "LineString", "coordinates": line}))
    (root / "permits.csv").write_text("Aktenzeichen,from,lon,lat\n7,2026-03-01,9.0,49.0\n")
    permits = geopandas.GeoDataFrame(
        {"id": ["8"], "from": ["2026-03-01T00:00Z"]}, geometry=[Point(9.0, 49.0)], crs=4326
    )
    permits.to_file(root / "permits.gpkg")
    return root, module_database_url, [str(f.feature_id) for f in features]


def test_the_commands_run_in_the_order_of_the_pages(folder, monkeypatch, capsys):
    root, url, features = folder
    monkeypatch.chdir(root)
    monkeypatch.setenv("CONETL_DATABASE_URL", url)
    assert said(monkeypatch, capsys, ["conetl", "map", "export", "--out", "cones.gpkg"])[0] == 0
    ran = 0
    for page in PAGES:
        for line in commands_of(page):
            words = shlex.split(line)
            for name in [name for name in os.environ if name.startswith(("CONETL_", "PREFECT_"))]:
                monkeypatch.delenv(name)
            monkeypatch.setenv("CONETL_HOME", str(root / ".conetl"))
            monkeypatch.setenv("CONETL_DATABASE_URL", url)
            while re.match(r"[A-Z_]+=", words[0]):
                monkeypatch.setenv(*words.pop(0).split("=", 1))
            if words[0] != "conetl" or {words[1], " ".join(words[1:3])} & ELSEWHERE.keys():
                continue
            words = [PLACES.get(word, word) for word in words]
            if words[1:] == ["base", "import", "drive"]:
                continue  # the sample drives have no LiDAR: test_base.py
            words = filled_in(words, root, features)
            code, text = said(monkeypatch, capsys, words)
            judges = (["map", "check-points"], ["report", "quality"])
            allowed = {0, 1} if words[1] in ("inspect", "locate") or words[1:3] in judges else {0}
            assert code in allowed, f"{page}: {line}: {text}"
            ran += 1
            if words[1:3] == ["map", "list"]:
                assert "default" in text and "demo" in text
    assert ran > 30
    assert json.loads((root / "changes.geojson").read_text())["features"]


def filled_in(words, root, features):
    """A command with what a reader puts in for its example names."""
    match words[1:]:
        case ["map", "pin" | "classify", "FEATURE", *_]:
            words[3] = features[0]
        case ["map", "suppress", "FEATURE", *_]:  # several pages: each another one
            words[3] = features.pop()
        case ["map", "delete", *_]:
            words.append("--yes")
        case ["map", "restore", _]:
            words[3] = str(next((root / ".conetl" / "dumps").glob("nights-*.zip")))
        case ["report", "drive", *_]:
            words[3] = "2"
        case ["map", "check-layout", "--lanes", *_]:  # those of the sample drives are elsewhere
            words[4] = str(root / "lanes.geojson")
        case ["zones", "judge", "DIFFERENCE", *_]:
            with (root / "differences.csv").open() as file:
                words[3] = next(row["difference_id"] for row in csv.DictReader(file) if row["kind"] == "not looked")
        case ["base", "drop", _]:
            words[3] = "street"
    return words


def said(monkeypatch, capsys, words):
    """Exit code and output of one command."""
    monkeypatch.setattr(sys, "argv", list(map(str, words)))
    with pytest.raises(SystemExit) as ended:
        main()
    done = capsys.readouterr()
    return ended.value.code, done.out + done.err


def test_the_table_of_the_tutorial_is_the_one_that_ingest_prints():
    text = (ROOT / "docs/tutorial/first_map.md").read_text()
    shown = re.search(r"^change +feature.*$", text, re.MULTILINE)
    assert shown is not None
    assert re.split(r"  +", shown[0]) == [
        BY_NAME[name].heading for name in TABLES["changes by a drive"] if name != "category"
    ]
