"""Servers that others run: settings that would change numbers, and poolers that break locks of sessions."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import psycopg2
import pytest

from conetl.db import connection as db
from conetl.db.connection import address_parts, connect, execute
from conetl.model.errors import DatabaseError
from tests.command import free_port, until

#: As an administrator may set them for a database or a user.
FOREIGN = {
    "extra_float_digits": "-15", "datestyle": "German", "intervalstyle": "sql_standard", "bytea_output": "escape",
    "timezone": "Asia/Kathmandu", "search_path": "pg_catalog", "standard_conforming_strings": "off",
    "transform_null_equals": "on", "array_nulls": "off", "default_transaction_isolation": "serializable",
    "client_encoding": "LATIN1",
}  # fmt: skip
POOLER = shutil.which("pgbouncer") or "/usr/sbin/pgbouncer"


def test_settings_of_a_server_change_no_number(conn: Any, database_url: str) -> None:
    name = address_parts(database_url)["dbname"]
    plain = execute(conn, "select name, setting from pg_settings where name = any(%(names)s)", {"names": [*FOREIGN]})
    conn.rollback()
    for setting, value in FOREIGN.items():
        execute(conn, f"alter database {name} set {setting} to '{value}'")
    conn.commit()
    with closing(psycopg2.connect(database_url)) as raw, raw.cursor() as cursor:
        cursor.execute("select 0.1::float8 + 0.2")
        assert cursor.fetchone() == (0.3,), "the settings have an effect"
    with closing(connect(database_url)) as own:
        found = execute(own, "select name, setting from pg_settings where name = any(%(names)s)", {"names": [*FOREIGN]})
        assert found == plain
        [row] = execute(
            own,
            "select 0.1::float8 + 0.2 as number, '\\x00ff'::bytea as bytes, timestamptz '2026-03-02 10:00Z' as at, "
            "interval '1 day -1 hour' as span, 'ü\\\\' as text, array[null] as nothing",
        )
        assert row["number"] == 0.1 + 0.2
        assert bytes(row["bytes"]) == b"\0\xff"
        assert row["at"].isoformat() == "2026-03-02T10:00:00+00:00"
        assert row["span"].total_seconds() == 23 * 3600
        assert (row["text"], row["nothing"]) == ("ü\\\\", [None])


@contextmanager
def pooler(database_url: str, mode: str) -> Iterator[str]:
    """pgbouncer in front of the database; its address."""
    parts, port = address_parts(database_url), free_port()
    folder = Path(mkdtemp(dir="/tmp"))  # that of pytest is closed to the server's user
    folder.chmod(0o755)
    settings = folder / "pgbouncer.ini"
    server = f"host={parts['host']} port={parts['port']} user={parts['user']} dbname={parts['dbname']}"
    settings.write_text(
        f"[databases]\npooled = {server}\n[pgbouncer]\nlisten_addr = 127.0.0.1\nlisten_port = {port}\nauth_type = any\n"
        f"unix_socket_dir =\npool_mode = {mode}\nignore_startup_parameters = options\n"
    )
    owner = Path(parts["host"]).owner()  # the server knows its users by their processes
    settings.chmod(0o644)
    command = [POOLER, str(settings)]
    if os.geteuid() == 0:
        command = ["runuser", "-u", owner, "--", *command]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as process:
        try:
            yield f"postgresql://x@127.0.0.1:{port}/pooled"
        finally:
            process.terminate()
            shutil.rmtree(folder)


@pytest.mark.skipif(not Path(POOLER).exists(), reason="pgbouncer is not installed")
@pytest.mark.parametrize("mode", ["session", "transaction"])
def test_pgbouncer_is_accepted_in_session_mode_only(mode: str, database_url: str) -> None:
    with pooler(database_url, mode) as url:

        def attempt() -> str | None:
            try:
                connect(url).close()
            except DatabaseError as error:
                return None if "Connection refused" in str(error) else str(error)
            return "accepted"

        said = until(attempt, "an answer of pgbouncer")
    assert ("pool_mode = session" in said, said == "accepted") == (mode != "session", mode == "session")


class Pooled:
    """A connection through a pooler: its process id at the server."""

    def __init__(self, server_pid: int) -> None:
        self.server_pid = server_pid

    def close(self) -> None:
        """As of psycopg2."""


@pytest.mark.parametrize(("pids", "shared"), [([7], True), ([8, 7], True), ([8, 9, 10], False)])
def test_a_session_that_others_get_meanwhile_is_refused(
    pids: list[int], shared: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    waiting = iter(map(Pooled, pids))
    monkeypatch.setattr(db.psycopg2, "connect", lambda *_, **__: next(waiting))
    monkeypatch.setattr(db, "execute", lambda conn, _: [{"pid": conn.server_pid}])
    if shared:
        with pytest.raises(DatabaseError, match="pooler in transaction mode") as refused:
            db._require_own_session("postgresql://a:secret@pooled/x", 7)
        assert "secret" not in str(refused.value)
    else:
        db._require_own_session("postgresql://a:secret@pooled/x", 7)
