"""The schema: migrations, roles, the state of a database, audits of its rows, and the Prefect server's own database."""

from __future__ import annotations

import hashlib
import logging
import re
import time
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from conetl.db import connection as db
from conetl.db.connection import Connection
from conetl.model.errors import DatabaseError

#: Key of the advisory lock that keeps two migrations apart.
MIGRATION_LOCK = 0x636F6E65
ROLES = ("conetl_reader", "conetl_writer")
PREFECT_DATABASE = "prefect"
#: First migration of the databases of conetl 0.1, which had no release.
_BEFORE_BASELINE = "0001_schema"
SHOWN_ROWS = 100
_log = logging.getLogger(__name__)


def migrate(conn: Connection, *, directory: Path | None = None) -> list[str]:
    """Bring the schema up to date, all or nothing. Returns the names of the migrations that were applied now.

    Views and functions (`sql/functions/`) are made again after new migrations, or if their files changed. Migrations only go
    forwards. Raises `DatabaseError` if an applied one was changed afterwards, the database is newer than this
    conetl or older than its baseline, PostGIS is missing or cannot be created. Two calls at once wait for each other; if nothing
    has to be done, nothing is locked or written, so users without rights on the schema may call it too.
    """
    wanted = _migration_files(directory or db.sql_directory() / "migrations")
    functions = "\n".join(
        path.read_text(encoding="utf-8") for path in sorted((db.sql_directory() / "functions").glob("*.sql"))
    )
    with db.transaction(conn, "The state of the database cannot be read"):
        if db.query(conn, "schema.status")[0]["has_schema"]:
            applied = _applied(conn)
            _check_history(applied, wanted)
            current = not wanted.keys() - applied.keys() and _functions_sha256(conn) == _sha256(functions)
            if current and (not _missing_roles(conn) or not _may_create_roles(conn)):
                return []
    done: list[str] = []
    with db.transaction(conn, "The database could not be migrated, and is unchanged"):
        db.execute(conn, "select pg_advisory_xact_lock(%(key)s)", {"key": MIGRATION_LOCK})
        db.query(conn, "schema.schema_migration")
        applied = _applied(conn)
        _check_history(applied, wanted)
        for name in [name for name in wanted if name not in applied]:
            _require_extensions(conn, name)
            db.execute(conn, wanted[name])
            db.query(conn, "schema.insert_migration", name=name, sha256=_sha256(wanted[name]))
            done.append(name)
        if done or _functions_sha256(conn) != _sha256(functions):
            db.execute(conn, functions)
            db.query(conn, "schema.record_functions", sha256=_sha256(functions))
        if _may_create_roles(conn):
            db.query(conn, "schema.roles")
    if applied and done:
        _log.warning("database migrated to %s: older versions of conetl refuse it from now on", done[-1])
    return done


def require_usable(conn: Connection) -> None:
    """Raise DatabaseError, with what to do, if `migrate` would refuse this database or lack an extension; changes nothing."""
    wanted = _migration_files(db.sql_directory() / "migrations")
    with db.transaction(conn, "The state of the database cannot be read"):
        applied = _applied(conn) if db.query(conn, "schema.status")[0]["has_schema"] else {}
        _check_history(applied, wanted)
        for name in [name for name in wanted if name not in applied][:1]:
            _require_extensions(conn, name)


def applied_migrations(conn: Connection) -> list[str]:
    """Names of the migrations of this database, oldest first."""
    return sorted(_applied(conn))


def database_status(conn: Connection) -> dict[str, Any]:
    """What the database holds and whether this conetl can work with it; changes nothing.

    missing_roles: of conetl_reader and conetl_writer those that do not exist or have no rights here. `migrate` makes them where
    may_create_roles; otherwise a superuser has to run it once. maps: (name, SRID) of each.
    """
    with db.transaction(conn, "The state of the database cannot be read"):
        facts = db.query(conn, "schema.status")[0]
        applied = _applied(conn) if facts["has_schema"] else {}
        maps = db.query(conn, "map.maps") if facts["has_map"] else []
        wanted = _migration_files(db.sql_directory() / "migrations")
        return {
            "database": facts["database"],
            "user": facts["username"],
            "postgres_version": facts["postgres_version"],
            "postgis_version": facts["postgis_version"],
            "applied_migrations": tuple(sorted(applied)),
            "pending_migrations": tuple(name for name in wanted if name not in applied),
            "missing_roles": _missing_roles(conn) if facts["has_map"] else ROLES,
            "may_create_roles": _may_create_roles(conn),
            "size_bytes": facts["size_bytes"],
            "maps": tuple((row["map_name"], row["srid"]) for row in maps),
        }


def prefect_database(url: str) -> str:
    """Create the Prefect server's database on the server of `url` if it is missing. Returns its address in SQLAlchemy's form."""
    with (
        closing(db.connect(url)) as conn,
        db.database_errors(
            f"The database {PREFECT_DATABASE} for the Prefect server cannot be created: create it manually, or name one in "
            "CONETL_PREFECT_DATABASE_URL"
        ),
    ):
        conn.autocommit = True
        if not db.query(conn, "schema.database_exists", name=PREFECT_DATABASE)[0]["found"]:
            db.query(conn, "schema.create_prefect_database")
    return db.sqlalchemy_url(url, PREFECT_DATABASE)


def _migration_files(directory: Path) -> dict[str, str]:
    files = {path.stem: path.read_text(encoding="utf-8") for path in sorted(directory.glob("*.sql"))}
    for number, name in enumerate(files, start=1):
        if not re.fullmatch(rf"{number:04d}_[a-z0-9_]+", name):
            raise DatabaseError(f"migration {name}.sql in {directory} should be named {number:04d}_<what it does>.sql")
    return files


def _functions_sha256(conn: Connection) -> str | None:
    """Hash of the files from which the views and functions of this database were made; None: of none."""
    return next((row["sha256"] for row in db.query(conn, "schema.functions_sha256")), None)


def _applied(conn: Connection) -> dict[str, str]:
    return {row["name"]: row["sha256"] for row in db.query(conn, "schema.applied_migrations")}


def _check_history(applied: Mapping[str, str], wanted: Mapping[str, str]) -> None:
    unknown = [name for name in applied if name not in wanted]
    if _BEFORE_BASELINE in unknown:
        raise DatabaseError(
            "This database was made by a conetl from before the schema's baseline and cannot be migrated: export its maps with "
            "that version and import them into a new database (`conetl map export`, `conetl map import`), or ingest the "
            "drives again. Nothing was changed."
        )
    if unknown:
        raise DatabaseError(f"The database was migrated by a newer conetl ({', '.join(unknown)}): install that one.")
    for name, sha256 in applied.items():
        if _sha256(wanted[name]) != sha256:
            raise DatabaseError(
                f"sql/migrations/{name}.sql was changed after it was applied to this database: restore the file and put the "
                "change into a new migration."
            )


def _require_extensions(conn: Connection, migration: str) -> None:
    """Name the missing extension, where PostgreSQL would only name a control file."""
    missing = [row["name"] for row in db.query(conn, "schema.missing_extensions")]
    if missing:
        raise DatabaseError(
            f"migration {migration} requires the extension(s) {', '.join(missing)}, which this server does not offer: install "
            "PostGIS on the server (Debian: postgresql-<version>-postgis-3) or set CONETL_DATABASE_URL to another one."
        )


def _missing_roles(conn: Connection) -> tuple[str, ...]:
    ready = {row["rolname"] for row in db.query(conn, "schema.ready_roles", names=list(ROLES))}
    return tuple(name for name in ROLES if name not in ready)


def _may_create_roles(conn: Connection) -> bool:
    return bool(db.query(conn, "schema.may_create_roles")[0]["may_create_roles"])


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


@dataclass(frozen=True)
class AuditResult:
    """What one audit found."""

    name: str
    purpose: str
    """The comment of its statement."""
    row_count: int
    rows: tuple[dict[str, Any], ...]
    """The first 100 offending rows; every one has a column `problem`."""
    seconds: float = 0.0
    """Duration."""

    @property
    def passed(self) -> bool:
        return self.row_count == 0


def run_audits(conn: Connection) -> list[AuditResult]:
    """Run all audits over all maps of the database, on one snapshot; changes nothing."""
    with db.transaction(conn, "The audits could not be run"):
        db.query(conn, "exports.snapshot")
        return [_run(conn, name, text) for name, text in db.statements("audits").items()]


def _run(conn: Connection, name: str, text: str) -> AuditResult:
    purpose = text.partition("\n-- Columns:")[0].removeprefix("-- ").replace("\n-- ", " ")
    start = time.monotonic()
    rows = db.execute(conn, text)
    seconds = time.monotonic() - start
    return AuditResult(name, purpose, len(rows), tuple(rows[:SHOWN_ROWS]), seconds)
