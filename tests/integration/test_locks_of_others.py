"""A session of somebody else holds a table: reported with who it is, and given up after a limit."""

from __future__ import annotations

import logging
import time
from contextlib import closing

import psycopg2
import pytest

from conetl.db import connection
from conetl.db.connection import connect, database_errors, execute
from conetl.db.map.map_store import find_map
from conetl.model.errors import DatabaseError


def test_a_foreign_lock_is_named_and_waited_for_within_limits(
    database_url: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(connection, "REPORT_AFTER_S", 0.5)
    options = connection.SESSION_OPTIONS.replace("lock_timeout=600000", "lock_timeout=4000")
    assert options != connection.SESSION_OPTIONS
    monkeypatch.setattr(connection, "SESSION_OPTIONS", options)
    with (
        closing(psycopg2.connect(database_url, application_name="somebody")) as foreign,
        closing(connect(database_url)) as conn,
    ):
        execute(foreign, "lock table conetl.map in access exclusive mode")
        time.sleep(1.5)  # the thread of an earlier test looks once a second
        with caplog.at_level(logging.WARNING, "conetl.db"), pytest.raises(DatabaseError, match="somebody") as refused:
            find_map(conn)
        assert refused.value.exit_code == 3
        assert "held by process" in caplog.text and "program somebody" in caplog.text
        foreign.rollback()
        conn.rollback()
        with database_errors("reading"):
            assert execute(conn, "select 1 as n") == [{"n": 1}]
