"""The database of the map: one connection per process, checked for migrations once."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import closing, contextmanager
from functools import cached_property

from conetl.db.cluster.cluster import cluster_status, cluster_up
from conetl.db.connection import Connection, connect
from conetl.db.receipt_store import is_alive
from conetl.db.schema import migrate
from conetl.pipeline.settings import Settings

_log = logging.getLogger(__name__)


def database_url(settings: Settings) -> str:
    """Address of the map's database; starts the private cluster if it is not running."""
    return settings.database_url.get_secret_value() if settings.database_url else cluster_up(settings.home)


def running_url(settings: Settings) -> str | None:
    """Address of the map's database; None where the private cluster is not running."""
    given = settings.database_url
    return given.get_secret_value() if given else cluster_status(settings.home.resolve()).url


def open_database(settings: Settings) -> Connection:
    """A connection to the map's database. Raises DatabaseError."""
    conn = connect(database_url(settings))
    _log.info("database %s on %s, port %s", conn.info.dbname, conn.info.host, conn.info.port)
    return conn


@contextmanager
def open_maps(settings: Settings) -> Iterator[Connection]:
    """A connection to a database whose schema is up to date; the map of the settings may be missing."""
    with closing(open_database(settings)) as conn:
        migrate(conn)
        yield conn


class MapDatabase:
    """One connection for all queries of a process, opened on first use, and again after it was lost.

    An ingest computes for minutes or hours between two statements, and idle connections are cut. Use it from one thread at a
    time.
    """

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._conn: Connection | None = None

    def __enter__(self) -> MapDatabase:
        return self

    def __exit__(self, *_: object) -> None:
        if self._conn is not None:
            self._conn.close()

    @cached_property
    def url(self) -> str:
        """Its address; the schema is up to date."""
        url = database_url(self._settings)
        self._conn = connect(url)
        migrate(self._conn)
        return url

    @contextmanager
    def connection(self) -> Iterator[Connection]:
        """The connection, with no transaction open before and after. Raises DatabaseError."""
        url = self.url
        if self._conn is not None and not is_alive(self._conn):
            self._conn.close()
            self._conn = None
        conn = self._conn = self._conn or connect(url)
        try:
            yield conn
        finally:
            if is_alive(conn):
                conn.rollback()
