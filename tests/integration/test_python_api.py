"""The Python API: the example needs no Prefect and no database, and an ingest opens each image once."""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import conetl
from conetl.pipeline.settings import Settings
from tests.command import ROOT, environment_of
from tests.integration.small_drives import SAMPLES, cut_drive

_EXAMPLE = """
import json, runpy, sys
from pathlib import Path
main = runpy.run_path(sys.argv[1])["main"]
tracks = main(plot=Path(sys.argv[2]))
sigmas = [track.cov_m2[0] ** 0.5 for track in tracks]
print(json.dumps({"cones": [track.xyz_m for track in tracks], "sigmas": sigmas, "modules": sorted(sys.modules)}))
"""
_NO_DATABASE = "import psycopg2\ndef refuse(*_, **__): raise AssertionError('connected')\npsycopg2.connect = refuse\n"


def python(code: str, *arguments: object, home: Path, errors: bool = False, **environment: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments)], cwd=home, capture_output=True, text=True, timeout=600, check=False,
        env=environment_of(PYTHONPATH=f"{ROOT / 'src'}{os.pathsep}{ROOT}", **{"CONETL_HOME": home / "home", **environment}),
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stderr if errors else done.stdout


def test_the_example_finds_the_surveyed_cones_without_prefect_and_database(
    tmp_path: Path, sample_settings: Settings
) -> None:
    """It reads what other tests have found in the images of its drive."""
    example, plot, home = ROOT / "examples" / "first_map.py", tmp_path / "plot.png", str(sample_settings.home)
    said = python(_NO_DATABASE + _EXAMPLE, example, plot, home=tmp_path, CONETL_HOME=home)
    result = json.loads(said.splitlines()[-1])
    with (SAMPLES[0] / "truth.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["present"] == "1"]
    truth = np.array([[float(row["easting_m"]), float(row["northing_m"])] for row in rows])
    cones = np.array(result["cones"])[:, :2]
    assert len(cones) == len(truth) == 9
    apart = np.linalg.norm(truth[:, None] - cones[None], axis=2).min(axis=1)
    assert apart.max() < 0.1
    assert max(result["sigmas"]) < 0.1
    assert plot.read_bytes().startswith(b"\x89PNG")
    assert not any(name.split(".")[0] in {"prefect", "flows"} for name in result["modules"])


def test_all_names_of_the_package_exist() -> None:
    assert all(getattr(conetl, name).__name__ == name for name in conetl.__all__)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        conetl.nothing  # noqa: B018


def test_the_package_imports_none_of_its_names_before_they_are_used(tmp_path: Path) -> None:
    modules = python("import conetl, sys; print(*sys.modules)", home=tmp_path).split()
    assert not {"numpy", "conetl.pipeline", "conetl.model"} & set(modules)


_COUNT = """
import json, sys
images, connections, checks, publishing = [], [], [], []
def note(event, arguments):
    path = str(arguments[0]) if event == "open" else ""
    if ".geojson" in path:
        publishing.append(path)
    elif path.endswith(".jpg") and not publishing:  # the report shows crops
        images.append(path)
sys.addaudithook(note)
import psycopg2
connect = psycopg2.connect
psycopg2.connect = lambda *a, **k: connections.append(1) or connect(*a, **k)
from conetl.db import schema
migrate = schema.migrate
schema.migrate = lambda conn: checks.append(1) or migrate(conn)
from conetl.cli import main
try:
    main()
finally:
    print(json.dumps({"images": images, "connections": len(connections), "checks": len(checks)}), file=sys.stderr)
"""


@pytest.mark.release
def test_an_ingest_opens_each_image_once_and_few_connections(
    tmp_path: Path, conn: object, database_url: str, prefect: dict[str, str]
) -> None:
    drive = cut_drive(SAMPLES[0], tmp_path / "cut", "2026-05-01")
    code = _COUNT.replace("finally:", "except SystemExit as end:\n    assert not end.code\nfinally:")
    done = python(code, "ingest", drive, home=tmp_path, CONETL_DATABASE_URL=database_url, errors=True, **prefect)
    counted = json.loads(done.splitlines()[-1])
    every_image = sorted(map(str, drive.glob("image_0?/data/*.jpg")))
    assert sorted(counted["images"]) == every_image, "each once"
    assert counted["connections"] <= 2
    assert counted["checks"] == 1
