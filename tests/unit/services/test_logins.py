"""Logins: of the Prefect server, checked before it is used, and the files of secrets in the home folder."""

from __future__ import annotations

import base64
import errno
import grp
import os
import stat
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import httpx
import pytest
from pydantic import SecretStr

from conetl.files import home as homes
from conetl.files.storage import as_path
from conetl.model.errors import DatabaseError, InputError, ServiceError
from conetl.pipeline.settings import Settings, prefect_login
from conetl.services.processes import require_access, unavailable
from flows.backfill import backfill
from flows.ingest_drive import ingest_drive

SECRET = "desk:wide-open"
VARIABLE = "PREFECT_SERVER_API_AUTH_STRING"


class _Protected(BaseHTTPRequestHandler):
    """Like Prefect's server with PREFECT_SERVER_API_AUTH_STRING: all but /health requires the password."""

    def do_GET(self) -> None:
        wanted = f"Basic {base64.b64encode(SECRET.encode()).decode()}"
        self.send_response(200 if self.path == "/api/health" or self.headers["Authorization"] == wanted else 401)
        self.end_headers()

    def log_message(self, *_: object) -> None: ...


@pytest.fixture
def api() -> Iterator[str]:
    with HTTPServer(("127.0.0.1", 0), _Protected) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}/api"
        server.shutdown()
        thread.join()


@pytest.mark.parametrize("auth", [None, "desk:guessed"])
def test_without_the_password_the_error_names_the_variable(api: str, auth: str | None) -> None:
    require_access(api, SECRET, VARIABLE)
    with pytest.raises(ServiceError, match=f"set {VARIABLE}") as refusal:
        require_access(api, auth, VARIABLE)
    assert api in str(refusal.value)
    assert "guessed" not in str(refusal.value)


def test_a_server_that_died_is_no_internal_error() -> None:
    request = httpx.Request("POST", "http://127.0.0.1:4200/api/flow_runs")
    for status, is_service in ((503, True), (500, True), (409, False)):
        answer = httpx.Response(status, request=request)
        try:
            try:
                answer.raise_for_status()
            except httpx.HTTPStatusError as error:
                raise RuntimeError("the run could not be created") from error
        except RuntimeError as error:
            found = unavailable(error)
            assert (found is not None) == is_service
            assert found is None or found.exit_code == 3
    assert unavailable(httpx.ConnectError("refused")) is not None
    assert unavailable(KeyError("x")) is None
    assert "disk" in str(unavailable(OSError(errno.ENOSPC, "No space left on device")))


def test_what_conetl_noticed_first_is_the_error() -> None:
    """Prefect keeps its runs in PostgreSQL, and cannot store that this one failed."""
    try:
        try:
            raise DatabaseError("PostgreSQL is gone")
        except DatabaseError:
            raise httpx.ConnectError("refused")  # noqa: B904 -- as in Prefect
    except httpx.ConnectError as error:
        assert str(unavailable(error)) == "PostgreSQL is gone"


def test_clients_use_the_password_of_the_own_server(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("PREFECT_API_AUTH_STRING", raising=False)
    monkeypatch.delenv("PREFECT_SERVER_API_AUTH_STRING", raising=False)
    own = prefect_login(tmp_path / "home")
    assert own.startswith("conetl:") and len(own) > 40
    assert own == prefect_login(tmp_path / "home") != prefect_login(tmp_path / "other")
    monkeypatch.setenv("PREFECT_API_AUTH_STRING", "desk:of-a-client")
    assert prefect_login(tmp_path / "home") == "desk:of-a-client"
    monkeypatch.setenv("PREFECT_SERVER_API_AUTH_STRING", SECRET)
    assert prefect_login(tmp_path / "none") == SECRET
    assert not (tmp_path / "none").exists()


def test_only_its_owner_reads_a_secret(tmp_path: Path) -> None:
    path = homes.make_secret(tmp_path / "home" / "writer_token")
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    token = homes.read_secret(path)
    assert len(token.get_secret_value()) >= 40 and token.get_secret_value() not in repr(token)
    assert homes.read_secret(homes.make_secret(path)) == token
    path.chmod(0o640)
    with pytest.raises(InputError, match="chmod 600") as refused:
        homes.read_secret(path)
    assert token.get_secret_value() not in str(refused.value)
    with pytest.raises(InputError, match="cannot be read"):
        homes.read_secret(tmp_path / "none")
    for short in ("short", "with a space in it all", "ümlaut-ümlaut-ümlaut", ""):
        with pytest.raises(InputError, match="at least 16") as refused:
            homes.validated_secret(SecretStr(short), "CONETL_WRITER_TOKEN")
        assert not short or short not in str(refused.value)


def test_a_home_folder_is_closed_and_shared_only_on_purpose(tmp_path: Path) -> None:
    home = tmp_path / "home"
    (home / "exports").mkdir(parents=True)
    (home / "exports" / "report.html").write_text("street")
    (home / "exports").chmod(0o755)
    assert homes.home_access(home) == "everybody (exports)"
    homes.make_home(home)
    assert homes.home_access(home) == "owner only"
    (home / "postgres").mkdir(mode=0o755)
    assert homes.home_access(home) == "everybody (postgres)", "every folder is looked at"
    (home / "postgres").chmod(0o700)
    assert {stat.S_IMODE((home / name).stat().st_mode) for name in homes.FOLDERS} == {0o700}
    homes.make_secret(home / homes.VIEW_TOKEN)
    group = grp.getgrgid(os.getegid()).gr_name
    (home / "logs").chmod(0o2750)  # both shared by an earlier version
    home.chmod(0o2750)
    (home / "logs" / "view.log").write_text("http://127.0.0.1:8791/?token=secret")
    homes.share_home(home, group)
    homes.make_home(home)  # as every later command does
    assert homes.home_access(home) == f"owner and group {group} (exports, results)"
    modes = {path.name: stat.S_IMODE(path.stat().st_mode) for path in home.iterdir()}
    shared = {name for name, mode in modes.items() if mode & 0o070}
    assert shared == {"exports", "results"} == set(homes.SHARED)
    assert modes["exports"] == 0o2750 and modes[homes.VIEW_TOKEN] == 0o600
    assert stat.S_IMODE((home / "exports" / "report.html").stat().st_mode) & 0o070 == 0o040
    assert stat.S_IMODE(home.stat().st_mode) & 0o070 == 0o010, "names of other files are not listed"
    with pytest.raises(InputError, match="no group"):
        homes.share_home(home, "no-such-group")


def test_workers_read_drives_below_the_configured_folders_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    inside, outside = tmp_path / "drives" / "a", tmp_path / "drives2"
    inside.mkdir(parents=True)
    outside.mkdir()
    (tmp_path / "drives" / "link").symlink_to(outside)
    settings = Settings(drive_roots=f"{tmp_path / 'drives'}, s3://bucket/drives")
    settings.require_readable(inside)
    settings.require_readable(as_path("s3://bucket/drives/a"))
    Settings(drive_roots="/drives, s3://bucket/").require_readable(as_path("s3://bucket/a"))
    Settings().require_readable(outside)
    objects = map(as_path, ("s3://bucket/drives2/a", "s3://bucket/drives/../a", "s3://bucket2/drives/a"))
    for path in (outside, tmp_path / "drives" / "link", tmp_path / "drives" / ".." / "drives2", Path("/"), *objects):
        with pytest.raises(InputError, match="CONETL_DRIVE_ROOTS"):
            settings.require_readable(path)
    monkeypatch.setenv("CONETL_DRIVE_ROOTS", str(inside))
    for flow in (ingest_drive, backfill):
        with pytest.raises(InputError, match="CONETL_DRIVE_ROOTS"):
            flow.fn(outside)
    (inside / "timestamps.txt").symlink_to(outside / "timestamps.txt")
    with pytest.raises(InputError, match=r"timestamps\.txt lies outside .* CONETL_DRIVE_ROOTS"):
        ingest_drive.fn(inside)
