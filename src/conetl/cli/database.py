"""`conetl db`: the database that holds the map."""

from __future__ import annotations

from contextlib import closing
from dataclasses import asdict

import typer

from conetl.cli.console import JsonOption, out, print_json, print_table
from conetl.cli.prune import prune
from conetl.db.audits import run_audits
from conetl.db.cluster.cluster import cluster_down, cluster_status, cluster_up
from conetl.db.connection import Connection, connect
from conetl.db.schema import database_status
from conetl.db.schema import migrate as apply_migrations
from conetl.model.errors import ConetlError, DatabaseError
from conetl.pipeline.settings import Settings, read_settings

app = typer.Typer(
    help="The database that holds the map: CONETL_DATABASE_URL, or a private cluster.", no_args_is_help=True
)
app.command()(prune)


class AuditFailedError(ConetlError):
    """An audit found rows that must not be."""

    exit_code = 1


def open_database(settings: Settings, *, start: bool = True) -> Connection:
    """A connection to the configured database, or to the private cluster (started if `start`). Raises DatabaseError."""
    if settings.database_url:
        return connect(settings.database_url.get_secret_value())
    if not start and (cluster := cluster_status(settings.home)).state != "running":
        raise DatabaseError(
            "the private database cluster is not running: start it with `conetl db up`"
            if cluster.host is None
            else f"the private database cluster runs on another machine or container (host {cluster.host}): ask it there"
        )
    return connect(cluster_up(settings.home))


def open_map(settings: Settings) -> Connection:
    """Connection with the schema up to date."""
    conn = open_database(settings)
    apply_migrations(conn)
    return conn


@app.command()
def up(as_json: JsonOption = False) -> None:
    """Start the private PostGIS cluster, make it first where there is none, and bring its schema up to date."""
    settings = read_settings()
    if settings.database_url:
        out.print("CONETL_DATABASE_URL is set: conetl uses that database and runs none of its own.")
        raise typer.Exit(0)
    url = cluster_up(settings.home)
    with closing(connect(url)) as conn:
        applied = apply_migrations(conn)
    if as_json:
        print_json({"url": url, "migrations_applied": list(applied)})
    else:
        out.print(f"PostGIS is up: psql '{url}'", markup=False)


@app.command()
def down(as_json: JsonOption = False) -> None:
    """Stop the private cluster; the data stay."""
    stopped = cluster_down(read_settings().home)
    if as_json:
        print_json({"stopped": stopped})
    else:
        out.print("PostGIS is stopped." if stopped else "PostGIS was not running.")


@app.command()
def status(as_json: JsonOption = False) -> None:
    """What there is: cluster, schema, roles, maps."""
    settings = read_settings()
    cluster = None if settings.database_url else cluster_status(settings.home)
    database = None
    if cluster is None or cluster.state == "running":
        with closing(open_database(settings, start=False)) as conn:
            database = database_status(conn)
    if as_json:
        print_json({"cluster": cluster and asdict(cluster), "database": database and asdict(database)})
        return
    rows = [(f"cluster {name}", value) for name, value in asdict(cluster).items()] if cluster else []
    rows += [(name, value) for name, value in asdict(database).items()] if database else []
    print_table(
        "", ("what", "value"), [(name.replace("_", " "), _words(value)) for name, value in rows], numbers_from=9
    )


def _words(value: object) -> str:
    """A value as a person writes it."""
    if isinstance(value, tuple):
        return ", ".join(" EPSG:".join(map(str, v)) if isinstance(v, tuple) else str(v) for v in value) or "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return "none" if value is None else str(value)


@app.command()
def migrate(as_json: JsonOption = False) -> None:
    """Bring the schema up to date (forwards only)."""
    with closing(open_database(read_settings())) as conn:
        applied = apply_migrations(conn)
    if as_json:
        print_json({"migrations_applied": list(applied)})
    else:
        out.print(f"applied: {', '.join(applied)}" if applied else "the schema is up to date", markup=False)


@app.command()
def audit(as_json: JsonOption = False) -> None:
    """Check the map against its own rules; every query must find nothing. Exit code 1 where one finds something."""
    with closing(open_database(read_settings())) as conn:
        results = run_audits(conn)
    if as_json:
        print_json([asdict(result) for result in results])
    else:
        rows = [
            (result.name, "passed" if not result.rows else f"{result.row_count} rows", f"{result.seconds:.1f}")
            for result in results
        ]
        print_table("", ("audit", "result", "s"), rows, numbers_from=2)
        for result in results:
            for row in result.rows[:10]:
                out.print(f"{result.name}: {row}", markup=False)
    if any(result.rows for result in results):
        raise AuditFailedError("the audit found rows that must not be, see above")
