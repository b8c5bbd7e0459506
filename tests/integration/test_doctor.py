"""`conetl doctor` on machines that lack something: it names what is missing and the command that gets it, and changes nothing."""

from __future__ import annotations

import json
import os
import shutil
import socket
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from tempfile import mkdtemp

import pytest

from conetl.cli.doctor import CHECKS
from conetl.cli.services import VIEW_PORT
from conetl.db.connection import connect, execute
from conetl.db.map.map_store import insert_map
from conetl.perception.model_card import shipped_model_path
from tests.command import conetl

NOBODY = 65534


def failures(home: Path, **options: object) -> dict[str, str]:
    """Check -> problem; ports are left out, because others may use them."""
    done = conetl("doctor", "--json", **{"CONETL_HOME": home, "cwd": home.parent, **options})  # type: ignore[arg-type]
    findings = json.loads(done.stdout)
    assert [one["check"] for one in findings] == [look.__name__ for look in CHECKS] and done.returncode in (0, 1), (
        done.stderr
    )
    assert done.returncode == any(not one["passed"] for one in findings)
    assert all(one["found"] and one["tests"] for one in findings)
    return {one["check"]: one["found"] for one in findings if not one["passed"] and one["check"] != "ports"}


@pytest.fixture
def home(tmp_path: Path) -> Path:
    return tmp_path / "home"


def test_nothing_is_missing_and_nothing_is_changed(home: Path, database_url: str) -> None:
    assert failures(home) == {} == failures(home, CONETL_DATABASE_URL=database_url)
    assert not home.exists()


def test_a_machine_without_postgresql(home: Path) -> None:
    before = "import conetl.db.cluster.postgres_install as found; found.BIN_DIRECTORY_GLOBS = ()"
    found = failures(home, before=before, PATH="/nonexistent")
    assert found.keys() == {"database"}
    assert "sudo apt-get install postgresql-postgis" in found["database"]
    assert "CONETL_DATABASE_URL" in found["database"]


def test_a_database_that_cannot_be_used(home: Path, database_url: str) -> None:
    found = failures(home, CONETL_DATABASE_URL="postgresql://me:hidden@127.0.0.1:1/none")
    assert found.keys() == {"database"} and "127.0.0.1" in found["database"] and "hidden" not in found["database"]
    with closing(connect(database_url)) as conn:
        insert_map(conn, "heights", 25832, vertical_srid=7837)
        execute(conn, "insert into conetl.schema_migration (name, sha256) values ('9999_later', 'x')")
        conn.commit()
    found = failures(home, CONETL_DATABASE_URL=database_url)
    assert found.keys() == {"database", "projections"}
    assert "newer conetl (9999_later)" in found["database"]
    assert "de_bkg_gcg2016.tif" in found["projections"]


@contextmanager
def folder_of_others(mode: int) -> Iterator[Path]:
    """Of pytest's own folders other users see nothing."""
    folder = Path(mkdtemp(prefix="conetl-test-doctor-", dir="/tmp"))
    try:
        folder.chmod(mode)
        yield folder
    finally:
        folder.chmod(0o700)
        shutil.rmtree(folder)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may become another user")
@pytest.mark.parametrize("mode", [0o555, 0o700])
def test_a_home_that_cannot_be_written(mode: int) -> None:
    before = (  # what other users cannot import here
        "import os, platform, importlib.metadata\nfrom conetl.cli import doctor\n"
        "doctor.CHECKS = (doctor.home, doctor.database)\n"
        f"os.chdir('/'); os.setuid({NOBODY})"
    )
    with folder_of_others(mode) as folder:
        done = conetl("doctor", before=before, CONETL_HOME=folder / "new" / "home")
    assert done.returncode == 1, done.stderr
    assert (
        f"home: {folder} is no folder that this user may write to" in done.stdout
        and "export CONETL_HOME=" in done.stdout
    )


def test_files_that_are_damaged_or_open_to_others(home: Path) -> None:
    model = home.parent / "model.onnx"
    for source, copy in ((shipped_model_path(), model), (Path(f"{shipped_model_path()}.json"), Path(f"{model}.json"))):
        shutil.copy(source, copy)
    content = bytearray(model.read_bytes())
    content[len(content) // 2] ^= 1
    model.write_bytes(content)
    home.mkdir(mode=0o700)
    (home / "view_token").write_text("0123456789abcdef")
    (home / "view_token").chmod(0o644)
    found = failures(home, CONETL_MODEL_PATH=model)
    assert found.keys() == {"model", "home"}
    assert f"{model}: SHA-256" in found["model"] and f"chmod 600 {home / 'view_token'}" in found["home"]


def test_packages_and_servers_of_others(home: Path) -> None:
    other = home.parent / "fastapi-0.200.dist-info"
    other.mkdir()
    (other / "METADATA").write_text("Metadata-Version: 2.1\nName: fastapi\nVersion: 0.200\n")
    before = f"import sys; sys.path.insert(0, {str(home.parent)!r})"
    found = failures(home, before=before, PREFECT_API_URL="http://127.0.0.1:1/api")
    assert found.keys() == {"packages", "prefect"}
    assert "(0.200 is installed)" in found["packages"] and '-m pip install "fastapi<0.151,>=' in found["packages"]
    assert "PREFECT_API_URL" in found["prefect"]


def test_a_port_in_use_and_the_answer_for_people(home: Path) -> None:
    with socket.socket() as other:
        other.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        with suppress(OSError):  # already in use: as good
            other.bind(("127.0.0.1", VIEW_PORT))
            other.listen()
        done = conetl("doctor", CONETL_HOME=home)
    assert done.returncode == 1
    assert f"ports: port {VIEW_PORT}" in done.stdout and "--view-port" in done.stdout
    assert "database" in done.stdout.splitlines()[3]
