"""Connections to PostGIS: named statements, errors, transactions, COPY, locks. The only module that imports psycopg2."""

from __future__ import annotations

import logging
import math
import os
import re
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from datetime import datetime
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, TypeAlias
from urllib.parse import quote, urlencode
from weakref import WeakKeyDictionary

import psycopg2
import psycopg2.errors
import psycopg2.extensions
import psycopg2.extras

from conetl.model.columns import GROUPS, select_list
from conetl.model.errors import DatabaseError, InputError

if TYPE_CHECKING:
    from conetl.db.copy_rows import Columns

Connection: TypeAlias = psycopg2.extensions.connection

CONNECT_TIMEOUT_S = 10
#: Many sessions are idle while a drive is computed. Over TCP, both ends probe the other one after `_IDLE_S` and know within a
#: minute that it is gone; firewalls see traffic. Without effect on unix sockets; settings in the address take precedence.
_IDLE_S, _INTERVAL_S, _COUNT = 30, 10, 3
_GONE_MS = 1000 * (_IDLE_S + _COUNT * _INTERVAL_S)
CLIENT_KEEPALIVES = {
    "keepalives": 1,
    "keepalives_idle": _IDLE_S,
    "keepalives_interval": _INTERVAL_S,
    "keepalives_count": _COUNT,
    "tcp_user_timeout": _GONE_MS,
}
#: How long a statement waits for a lock of another session.
LOCK_TIMEOUT_S = 600.0
#: Of the start of a session; others are set by schema.session. The server's side of the keepalives, by which it frees the locks
#: of a machine that is gone.
SESSION_OPTIONS = (
    f"-c lock_timeout={LOCK_TIMEOUT_S * 1000:.0f} -c tcp_keepalives_idle={_IDLE_S} "
    f"-c tcp_keepalives_interval={_INTERVAL_S} -c tcp_keepalives_count={_COUNT} -c tcp_user_timeout={_GONE_MS}"
)
#: Sent at once; psycopg2's own 8 kB cost a Python call for every few rows.
COPY_CHUNK_BYTES = 1 << 20
CopyBlock: TypeAlias = tuple[str, BytesIO]
"""A COPY statement and the rows that are ready to be sent."""
_NAME = re.compile(r"^-- name: (\w+)\n", re.MULTILINE)
#: A list of columns of `model/columns.py` or `sql/columns.sql`, and the alias of the table that has them.
_COLUMNS = re.compile(r"\{\{(\w+) columns(?: of (\w+))?\}\}")
#: So many connections take the sessions that a pooler in transaction mode has at hand.
_POOLED_SESSIONS = 3
REPORT_AFTER_S = 5.0
REPORT_EVERY_S = 60.0
_OTHER_USER = (
    "Use another database user: one with the role conetl_writer may change maps, the owner of the tables may also migrate, "
    "prune, archive and delete."
)
_log = logging.getLogger(__name__)


def sqlalchemy_url(url: str, database: str | None = None) -> str:
    """A libpq address, of either form, for SQLAlchemy's asyncpg dialect; database: another one on the same server."""
    parts = address_parts(url)
    login = ":".join(quote(parts[name], safe="") for name in ("user", "password") if name in parts)
    query: dict[str, str] = {name: parts[name] for name in ("host", "port") if name in parts}
    if "sslmode" in parts:
        query["ssl"] = parts["sslmode"]
    name = quote(database or parts.get("dbname", ""), safe="")
    return f"postgresql+asyncpg://{login + '@' if login else ''}/{name}?{urlencode(query)}"


def address_parts(url: str) -> dict[str, str]:
    """Keywords of a libpq address of either form (host, port, dbname, user, ...). Raises `DatabaseError` if it is invalid."""
    try:
        return dict(psycopg2.extensions.parse_dsn(url))
    except psycopg2.Error as error:
        raise DatabaseError(
            f"The address {_without_password(url)} is not a libpq address: {_first_line(error)}"
        ) from error


def connect(url: str) -> Connection:
    """Open a connection (times in UTC, no autocommit). Raises `DatabaseError` with the reason and what to do."""
    try:
        named = psycopg2.extensions.parse_dsn(url)
        keepalives = {name: value for name, value in CLIENT_KEEPALIVES.items() if name not in named}
        conn = psycopg2.connect(
            url, connect_timeout=CONNECT_TIMEOUT_S, application_name="conetl", client_encoding="UTF8", options=SESSION_OPTIONS,
            **keepalives,
        )  # fmt: skip
    except (psycopg2.Error, UnicodeError) as error:
        remedy = "Start it (`conetl db up` for the private one) or correct CONETL_DATABASE_URL."
        if "FATAL: " in str(error):  # a server answered; psycopg2 has no error code of it
            remedy = "The server refuses the connection: correct the cause, or CONETL_DATABASE_URL."
        raise DatabaseError(
            f"The PostgreSQL database {_without_password(url)} cannot be reached: {_first_line(error)}. {remedy}"
        ) from error
    psycopg2.extras.register_uuid(conn_or_curs=conn)
    with database_errors("The connection could not be prepared"):
        conn.autocommit = True
        [session] = query(conn, "schema.session")
        if session["server_pid"] != conn.info.backend_pid:  # a pooler invents its own
            _require_own_session(url, session["server_pid"])
        conn.autocommit = False
    _sessions[conn] = _Session(url)
    _watch_of(os.getpid())
    return conn


def _require_own_session(url: str, server_pid: int) -> None:
    """Raise DatabaseError if a pooler lends a session of the server for a transaction only, so that others get it meanwhile.

    server_pid: of the server's process of an idle connection.
    """
    with ExitStack() as others:
        for _ in range(_POOLED_SESSIONS):
            other = others.enter_context(closing(psycopg2.connect(url, connect_timeout=CONNECT_TIMEOUT_S)))
            if execute(other, "select pg_backend_pid() as pid")[0]["pid"] == server_pid:  # its transaction stays open
                raise DatabaseError(
                    f"{_without_password(url)} leads through a connection pooler in transaction mode, which breaks the locks of "
                    "sessions: set pool_mode = session for this database (pgbouncer), or connect to the server itself."
                )


@dataclass
class _Session:
    """Bookkeeping for an open connection."""

    url: str
    """The connection itself knows its address without the password."""
    report_at: float = math.inf
    """When to query who blocks its statement, by the monotonic clock."""
    blockers: str = ""
    """Who was last seen to block it."""


_sessions: WeakKeyDictionary[Connection, _Session] = WeakKeyDictionary()


@cache
def _watch_of(process_id: int) -> threading.Thread:
    """The thread that watches the connections of this process; a forked one inherits none."""
    thread = threading.Thread(target=_watch, name="lock watch", daemon=True)
    thread.start()
    return thread


def _watch() -> None:
    """Report who holds the lock that a statement of this process waits for: after 5 s, then once a minute.

    PostgreSQL does not say so to a session that waits. Checking this process's connections costs the server nothing; only for one
    that has been busy for long it is queried, in a separate session.
    """
    while True:
        time.sleep(REPORT_AFTER_S / 5)
        for conn, session in list(_sessions.items()):
            now = time.monotonic()
            if conn.closed or conn.info.transaction_status != psycopg2.extensions.TRANSACTION_STATUS_ACTIVE:
                session.report_at = math.inf
            elif session.report_at == math.inf:
                session.report_at = now + REPORT_AFTER_S
            elif now >= session.report_at:
                blockers = _blockers(conn, session.url)
                session.report_at = now + (REPORT_EVERY_S if blockers else REPORT_AFTER_S)
                if blockers:
                    session.blockers = "; ".join(blockers)
                    _log.warning("waiting for a lock in the database that is held by %s", session.blockers)
        conn = None  # or it would stay open until the next check


def _blockers(conn: Connection, url: str) -> list[str]:
    """Who blocks a connection, queried in a separate session; [] if the server does not answer."""
    try:
        with closing(psycopg2.connect(url, connect_timeout=CONNECT_TIMEOUT_S)) as asking:
            rows = query(asking, "locks.blockers", pid=conn.info.backend_pid)
    except psycopg2.Error:
        return []
    return [
        f"process {row['pid']} (user {row['login']}, program {row['program'] or 'unknown'}, {row['address'] or 'this machine'}, "
        f"{row['state']} since {row['since']:%Y-%m-%d %H:%M:%S} UTC: {' '.join(row['statement'].split())[:80]})"
        for row in rows
    ]


def require_writer(conn: Connection) -> None:
    """Raise DatabaseError if the user may not commit to a map: before hours of work, not after them."""
    with transaction(conn, "The rights of the database user cannot be read"):
        if not query(conn, "schema.may_commit")[0]["may_commit"]:
            raise DatabaseError(f"This database user may only read the map. {_OTHER_USER}")


@contextmanager
def database_errors(what: str) -> Iterator[None]:
    """Turn psycopg2's errors into one `DatabaseError` that says `what` failed."""
    try:
        yield
    except (
        psycopg2.errors.UndefinedTable,
        psycopg2.errors.InvalidSchemaName,
        psycopg2.errors.UndefinedColumn,
        psycopg2.errors.UndefinedFunction,
    ) as error:
        raise DatabaseError(
            f"{what}: {_first_line(error)}. The database schema is not up to date: run `conetl db migrate`."
        ) from error
    except psycopg2.errors.InsufficientPrivilege as error:
        raise DatabaseError(f"{what}: {_first_line(error)}. {_OTHER_USER}") from error
    except psycopg2.errors.LockNotAvailable as error:
        holder = next((one.blockers for one in list(_sessions.values()) if one.blockers), "another session")
        raise DatabaseError(
            f"{what}: a lock was not free in time; it is held by {holder}. End that session, or try again later."
        ) from error
    except psycopg2.Error as error:
        lost = isinstance(error, psycopg2.OperationalError) and error.pgcode is None
        hint = ". PostgreSQL was stopped or cannot be reached: start it and run the same command again." if lost else ""
        raise DatabaseError(f"{what}: {_first_line(error)}{hint}") from error


@contextmanager
def transaction(conn: Connection, what: str) -> Iterator[None]:
    """All or nothing: commit at the end, roll back on any error. An open transaction of earlier reads is ended first."""
    with database_errors(what):
        conn.rollback()
        try:
            yield
            conn.commit()
        except BaseException:
            if not conn.closed:
                conn.rollback()
            raise


def execute(conn: Connection, sql: str, parameters: Mapping[str, Any] | None = None) -> list[dict[str, Any]]:
    """Run one statement. Returns its rows as dictionaries, [] if it returns none."""
    with conn.cursor() as cursor:
        cursor.execute(sql, parameters)
        if cursor.description is None:
            return []
        names = [column.name for column in cursor.description]
        return [dict(zip(names, row, strict=True)) for row in cursor.fetchall()]


def execute_count(conn: Connection, sql: str, parameters: Mapping[str, Any] | None = None) -> int:
    """Run one statement. Returns the number of rows it affected."""
    with conn.cursor() as cursor:
        cursor.execute(sql, parameters)
        return int(cursor.rowcount)


def query(conn: Connection, name: str, /, **parameters: Any) -> list[dict[str, Any]]:
    """Run a named statement of sql/, such as "map.find_map". Returns its rows as dictionaries, [] if it returns none."""
    return execute(conn, load_sql(name), parameters)


def read(conn: Connection, what: str, name: str, /, **parameters: Any) -> list[dict[str, Any]]:
    """As `query`; an error of the database becomes a `DatabaseError` that says `what` failed."""
    with database_errors(what):
        return query(conn, name, **parameters)


def stream(conn: Connection, what: str, name: str, /, **parameters: Any) -> Iterator[dict[str, Any]]:
    """As `read`, some rows at a time in memory (server-side cursor inside the open transaction)."""
    with _streaming(conn, what, name, parameters) as cursor:
        names: list[str] = []
        for row in cursor:
            names = names or [column.name for column in cursor.description or ()]  # known from the first row on
            yield dict(zip(names, row, strict=True))


def stream_values(conn: Connection, what: str, name: str, /, **parameters: Any) -> Iterator[tuple[Any, ...]]:
    """As `stream`, each row as the values of its columns."""
    with _streaming(conn, what, name, parameters) as cursor:
        yield from cursor


@contextmanager
def _streaming(conn: Connection, what: str, name: str, parameters: Mapping[str, Any]) -> Iterator[Any]:
    with database_errors(what), conn.cursor(name="conetl_stream") as cursor:
        cursor.itersize = 10_000
        cursor.execute(load_sql(name), parameters)
        yield cursor


def or_infinity(instant: datetime | None) -> str:
    """An instant as text for PostgreSQL; `infinity` for None."""
    return "infinity" if instant is None else instant.isoformat()


def copy_out(conn: Connection, sql: str, parameters: Mapping[str, Any], sink: IO[bytes], options: str = "") -> int:
    """Write the rows of a query (without its final semicolon) in COPY's text format, or as `options` say. Returns the number."""
    with conn.cursor() as cursor:
        query = cursor.mogrify(sql, parameters).decode()
        cursor.copy_expert(f"copy ({query}) to stdout {options}", sink, COPY_CHUNK_BYTES)
        return int(cursor.rowcount)


def copy_in(conn: Connection, table_and_columns: str, source: IO[bytes], name: str, options: str = "") -> None:
    """Load rows in COPY's format, or as `options` say, inside the open transaction. Raises InputError with the name if they do
    not fit."""
    try:
        with conn.cursor() as cursor:
            cursor.copy_expert(f"copy {table_and_columns} from stdin {options}", source, COPY_CHUNK_BYTES)
    except (psycopg2.IntegrityError, psycopg2.DataError) as error:
        raise InputError(
            f"{name}: does not fit into this database ({_first_line(error)}); nothing was written"
        ) from error


def address(conn: Connection) -> dict[str, str]:
    """Address of a connection: host (a folder for a unix socket), port, dbname, user. Never a password."""
    known = conn.get_dsn_parameters()
    return {name: known[name] for name in ("host", "port", "dbname", "user") if known.get(name)}


def query_columns(conn: Connection, sql: str, parameters: Mapping[str, Any]) -> list[tuple[str, int]]:
    """Names and type OIDs of the columns of a query (without its final semicolon), without running it."""
    with conn.cursor() as cursor:
        cursor.execute(f"select * from ({sql}) q limit 0", parameters)
        return [(column.name, column.type_code) for column in cursor.description or ()]


def copy_columns(conn: Connection, table: str, columns: Columns) -> None:
    """Load columns into a table by COPY, inside the open transaction."""
    copy_block(conn, encoded_block(table, columns))


def encoded_block(table: str, columns: Columns) -> CopyBlock:
    """Rows of columns encoded for COPY; needs no connection."""
    from conetl.db.copy_rows import encode  # here: Arrow takes a while to load

    return f"copy {table} ({', '.join(columns)}) from stdin (format csv)", encode(columns)


def copy_block(conn: Connection, block: CopyBlock) -> None:
    """Send one block, inside the open transaction."""
    with conn.cursor() as cursor:
        cursor.copy_expert(*block, COPY_CHUNK_BYTES)


def _first_line(error: Exception) -> str:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[0][:400].rstrip(".") if lines else type(error).__name__  # may quote a whole row


def _without_password(url: str) -> str:
    return re.sub(r"(://[^:/@]*):[^@]*@", r"\1:***@", re.sub(r"password=('[^']*'|\S+)", "password=***", url))


@cache
def sql_directory() -> Path:
    """The folder of .sql files: `conetl/sql` in an installed wheel, `sql/` at the top of a clone."""
    package = Path(__file__).resolve().parents[1]
    for directory in (package / "sql", package.parents[1] / "sql"):
        if (directory / "migrations").is_dir():
            return directory
    raise DatabaseError(f"conetl's .sql files are missing beside {package}: install it again.")


@cache
def statements(topic: str) -> dict[str, str]:
    """All statements of a topic by name, in the order of the file, with the comments that follow their names; lists of shared
    columns are filled in."""
    path = sql_directory() / f"{topic}.sql"
    try:
        _, *parts = _NAME.split(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise DatabaseError(f"{path} cannot be read ({error.strerror}): install conetl again.") from error
    return {name: _COLUMNS.sub(_columns, text.strip()) for name, text in zip(parts[::2], parts[1::2], strict=True)}


def _columns(found: re.Match[str]) -> str:
    group = found[1]
    listed = select_list(group) if group in GROUPS else statements("columns")[group]
    return listed.replace("x.", f"{found[2]}." if found[2] else "")


def load_sql(name: str) -> str:
    """One statement by topic and name, for example load_sql("map.features_as_of")."""
    topic, _, statement = name.partition(".")
    try:
        return statements(topic)[statement]
    except KeyError:
        raise DatabaseError(
            f"{sql_directory() / topic}.sql has no statement {statement}: install conetl again."
        ) from None
