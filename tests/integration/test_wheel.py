"""The wheel holds everything that runs: flows, SQL and the model, away from the clone."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the installed wheel; its dependencies are those of this environment."""
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(folder), str(ROOT)]
    subprocess.run(build, check=True, capture_output=True, text=True)
    (wheel,) = folder.glob("*.whl")
    target = folder / "site"
    install = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--target", str(target), str(wheel)]
    subprocess.run(install, check=True, capture_output=True, text=True)
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


def test_the_code_comes_from_the_wheel(installed: Path, tmp_path: Path) -> None:
    files = run(installed, "import conetl, flows; print(conetl.__file__); print(flows.__file__)", tmp_path)
    assert all(Path(file).is_relative_to(installed) for file in files.splitlines())


def test_the_model_and_the_sql_come_from_the_wheel(installed: Path, tmp_path: Path, database_url: str) -> None:
    code = "from conetl.perception import detector as d\nd.load_detector(); print(d.shipped_model_path())"
    assert Path(run(installed, code, tmp_path)).is_relative_to(installed)
    command = "import sys; sys.argv = ['conetl', 'db', 'audit']; from conetl.cli import main; main()"
    assert "passed" in run(installed, command, tmp_path, CONETL_DATABASE_URL=database_url)


def test_the_flow_runs_from_the_wheel(installed: Path, tmp_path: Path) -> None:
    code = "from flows.ingest_drive import ingest_drive; print(ingest_drive.name)"
    assert run(installed, code, tmp_path) == "ingest-drive"


def test_the_deployments_come_from_the_wheel(installed: Path, tmp_path: Path) -> None:
    code = "from flows.register import deployments_file; print(deployments_file())"
    assert Path(run(installed, code, tmp_path)).is_relative_to(installed)


def test_the_front_end_comes_from_the_wheel(installed: Path, tmp_path: Path) -> None:
    code = "from conetl.web.app import STATIC; print(STATIC); print(len(list(STATIC.rglob('*.js'))))"
    folder, scripts = run(installed, code, tmp_path).splitlines()
    assert Path(folder).is_relative_to(installed)
    assert (Path(folder) / "index.html").is_file()
    assert int(scripts) >= 1
