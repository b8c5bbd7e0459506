"""The wheel holds everything that runs: flows, SQL and the model, away from the clone."""

from __future__ import annotations

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the content of the wheel, as `pip install` puts it there; dependencies are those of this environment."""
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(folder), str(ROOT)]
    subprocess.run(build, check=True, capture_output=True, text=True)
    (wheel,) = folder.glob("*.whl")
    target = folder / "site"
    zipfile.ZipFile(wheel).extractall(target)
    return target


def run(installed: Path, code: str, cwd: Path, **environment: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": str(installed), "CONETL_HOME": str(cwd / "home"), **environment},
        cwd=cwd,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_code_model_flows_front_end_and_sql_come_from_the_wheel(
    installed: Path, tmp_path: Path, database_url: str
) -> None:
    code = (
        "import conetl, flows, sys\nfrom conetl.perception import detector\nfrom conetl.web.app import STATIC\n"
        "from flows.ingest_drive import ingest_drive\nfrom flows.register import deployments_file\n"
        "detector.load_detector()\nassert ingest_drive.name == 'ingest-drive'\n"
        "paths = [conetl.__file__, flows.__file__, detector.shipped_model_path(), deployments_file(), STATIC / 'index.html']\n"
        "print(*paths, next(STATIC.rglob('*.js')), sep='\\n')\n"
        "sys.argv = ['conetl', 'db', 'audit']; from conetl.cli import main; main()"
    )
    files, audits = (
        (said := run(installed, code, tmp_path, CONETL_DATABASE_URL=database_url).splitlines())[:6],
        said[6:],
    )
    for file in files:
        assert Path(file).is_relative_to(installed) and Path(file).is_file()
    assert "passed" in "\n".join(audits)


def test_every_tracked_file_of_the_packages_is_in_the_wheel(installed: Path) -> None:
    places = {
        "src/": "",
        "sql/": "conetl/sql/",
        "data/models/": "conetl/data/models/",
        "prefect.yaml": "flows/prefect.yaml",
    }
    command = ["git", "ls-files", "flows", *places]
    tracked = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout.splitlines()
    assert len(tracked) > 400
    wanted = [
        next((to + name.removeprefix(of) for of, to in places.items() if name.startswith(of)), name) for name in tracked
    ]
    assert [name for name in wanted if not (installed / name).is_file()] == []
