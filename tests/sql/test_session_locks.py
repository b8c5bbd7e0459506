"""Locks that say who lives: a session that is lost on the way costs nobody's work, and is taken up again."""

from __future__ import annotations

import os
import socket
import threading
from collections.abc import Iterator
from contextlib import closing
from typing import Any

import psycopg2
import pytest

from conetl.db import receipt_store
from conetl.db.connection import CLIENT_KEEPALIVES, Connection, connect, execute, load_sql, read
from conetl.db.receipt_store import held_locks, holding, try_lock
from conetl.model.errors import DatabaseError
from tests.command import until

NAMES = ("conetl.drive/a", "conetl.flow_run/b")


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(receipt_store, "CHECK_EVERY_S", 0.05)


@pytest.fixture
def asking(database_url: str) -> Iterator[Connection]:
    """A session that asks about the others."""
    with closing(connect(database_url)) as conn:
        conn.autocommit = True
        yield conn


def owners(asking: Connection) -> set[int]:
    """Server processes that hold advisory locks in this database."""
    sql = (
        "select pid from pg_locks where locktype = 'advisory' and granted "
        "and database = (select oid from pg_database where datname = current_database())"
    )
    return {row["pid"] for row in execute(asking, sql)}


def end_sessions(asking: Connection, pids: set[int]) -> None:
    for pid in pids:
        execute(asking, "select pg_terminate_backend(%(pid)s, 10000)", {"pid": pid})


def test_a_lost_session_is_replaced_and_ends_nothing(database_url: str, asking: Connection) -> None:
    with holding(database_url, *NAMES):
        before = owners(asking)
        end_sessions(asking, before)
        until(lambda: held_locks(asking, NAMES) == set(NAMES), "the lock")
        assert not owners(asking) & before
    assert held_locks(asking, NAMES) == set()


def test_a_session_that_is_lost_at_the_very_end_is_no_error(database_url: str, asking: Connection) -> None:
    with holding(database_url, *NAMES):
        end_sessions(asking, owners(asking))


@pytest.mark.parametrize("freed_first", [True, False])
def test_who_took_a_lost_lock_keeps_it(database_url: str, asking: Connection, freed_first: bool) -> None:
    """Both go on; the lock says of one of them that it lives, and of the other as soon as it is free."""
    with closing(connect(database_url)) as other:
        other.autocommit = True
        waits = threading.Thread(target=execute, args=(other, load_sql("locks.take_lock"), {"name": NAMES[0]}))
        with holding(database_url, *NAMES):
            mine = owners(asking)
            waits.start()
            until(
                lambda: execute(asking, "select pid from pg_locks where locktype = 'advisory' and not granted"),
                "who waits",
            )
            end_sessions(asking, mine)
            waits.join()
            until(lambda: held_locks(asking, NAMES) == set(NAMES), "the lock")
            assert other.info.backend_pid in owners(asking)
            if freed_first:
                execute(other, load_sql("locks.free_lock"), {"name": NAMES[0]})
                until(lambda: held_locks(asking, NAMES) == set(NAMES), "the lock")
                assert other.info.backend_pid not in owners(asking)
        assert held_locks(asking, NAMES) == (set() if freed_first else {NAMES[0]}), "nobody frees another's lock"


def test_the_error_of_the_work_is_its_own(database_url: str, asking: Connection) -> None:
    with pytest.raises(psycopg2.DataError), holding(database_url, *NAMES):
        raise psycopg2.DataError("of the work")
    with pytest.raises(psycopg2.DataError), try_lock(asking, NAMES[0]):
        raise psycopg2.DataError("of the work")
    assert held_locks(asking, NAMES) == set()


def test_a_watch_that_lost_its_session_frees_without_an_error(database_url: str, asking: Connection) -> None:
    with closing(connect(database_url)) as conn, try_lock(conn, NAMES[0]) as free:
        assert free
        end_sessions(asking, owners(asking))


def test_a_server_that_is_not_there_is_told_at_first() -> None:
    with pytest.raises(DatabaseError, match="cannot be reached"), holding("postgresql://nobody@127.0.0.1:1/none", "a"):
        raise AssertionError("it must not begin")


def test_a_lost_connection_names_postgresql_and_what_to_do(database_url: str) -> None:
    with closing(connect(database_url)) as conn:
        with socket.socket(fileno=os.dup(conn.fileno())) as its:
            its.shutdown(socket.SHUT_RDWR)
        with pytest.raises(
            DatabaseError, match=r"^Maps cannot be read: .*\. PostgreSQL was stopped .*: start it and run"
        ):
            read(conn, "Maps cannot be read", "schema.session")


def test_idle_connections_are_kept_alive(database_url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Both ends ask after each other; what the address says itself counts."""
    asked: list[dict[str, Any]] = []

    def spy(url: str, **named: Any) -> Connection:
        asked.append(named)
        return real(url, **named)

    real = psycopg2.connect
    monkeypatch.setattr(psycopg2, "connect", spy)
    connect(database_url).close()
    connect(f"{database_url}&keepalives_idle=7").close()
    assert CLIENT_KEEPALIVES.items() <= asked[0].items()
    assert all(f"-c tcp_{name}=" in asked[0]["options"] for name in ("keepalives_idle", "user_timeout"))
    assert "keepalives_idle" not in asked[1] and asked[1]["keepalives_count"] == 3
