"""The QGIS project, opened and drawn by a real QGIS."""

from __future__ import annotations

import json
import os
import subprocess
import zipfile
from html import unescape
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from conetl.db.connection import address, execute
from conetl.exports.qgis_project import _iso, write_qgis_project
from conetl.model.errors import InputError
from tests.integration.drives_of_days import merge, survey

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
def surveyed(conn):
    for day in range(2):
        merge(conn, survey(day))
    return conn


def test_no_secret_and_nothing_half_written(surveyed, tmp_path):
    path = tmp_path / "cones.qgz"
    write_qgis_project(surveyed, path, map_name="default", user="anna")
    text = unescape(zipfile.ZipFile(path).read("cones.qgs").decode())
    assert "password" not in text
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
        "from conetl.feature_version where upper_inf(system_period)",
    )
    layers = found["layers"]
    assert all(layer["valid"] for layer in layers.values())
    assert layers["cones_standing_now"]["features"] == counts["now"] > 4
    assert layers["cones_over_time"]["features"] == counts["over_time"] > counts["now"]
    assert layers["cones_over_time"]["temporal"] and layers["cones_over_time"]["fields"] == ["valid_from", "valid_to"]
    assert layers["cones_standing_now"]["renderer"] == "categorizedSymbol"
    pixels = np.asarray(Image.open(image).convert("RGB")).reshape(-1, 3).astype(int)
    for kind, colour in {"confirmed": (127, 151, 178), "moved": (168, 50, 127), "removed": (31, 41, 51)}.items():
        near = (np.abs(pixels - colour).max(axis=1) < 24).sum()
        assert near > 20, f"{kind} is not to be seen"
