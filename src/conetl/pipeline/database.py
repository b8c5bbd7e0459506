"""The database of the map, as one process of conetl uses it: one connection, checked for migrations once."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import closing, contextmanager

from conetl.db.cluster.cluster import cluster_up
from conetl.db.connection import Connection, connect
from conetl.db.receipt_store import is_alive
from conetl.db.schema import migrate
from conetl.pipeline.settings import Settings

_log = logging.getLogger(__name__)


def database_url(settings: Settings) -> str:
    """Address of the map's database; the private cluster is started where it does not run."""
    return settings.database_url.get_secret_value() if settings.database_url else cluster_up(settings.home)


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
    """One connection for all that a process asks and writes, opened when it is needed first, and again where it was lost.

    An ingest computes for minutes or hours between two statements, and idle connections are cut. For one thread at a time.
    """

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._conn: Connection | None = None
        self._url: str | None = None

    def __enter__(self) -> MapDatabase:
        return self

    def __exit__(self, *_: object) -> None:
        if self._conn is not None:
            self._conn.close()

    @property
    def url(self) -> str:
        """Its address; the schema is up to date."""
        if self._url is None:
            url = database_url(self._settings)
            self._conn = connect(url)
            migrate(self._conn)
            self._url = url
        return self._url

    @contextmanager
    def connection(self) -> Iterator[Connection]:
        """The connection, with no transaction open before and after. Raises DatabaseError."""
        url = self.url
        if self._conn is None or self._conn.closed or not is_alive(self._conn):
            if self._conn is not None:
                self._conn.close()
            self._conn = connect(url)
        conn = self._conn
        try:
            yield conn
        finally:
            if not conn.closed and is_alive(conn):
                conn.rollback()
