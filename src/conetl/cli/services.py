"""`conetl up`, `down` and `status`: all services on one machine."""

from __future__ import annotations

import logging
import os
import socket
import sys
from collections.abc import Callable
from contextlib import closing, suppress
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from conetl.cli.console import (
    Columns,
    DecisionsOption,
    JsonOption,
    MapOption,
    answer,
    counted,
    print_json,
    print_records,
    say,
    spinner,
)
from conetl.db.cluster.cluster import cluster_down, cluster_status
from conetl.db.connection import connect, sqlalchemy_url
from conetl.db.map.notice_store import undelivered
from conetl.db.schema import prefect_database
from conetl.files.home import PREFECT_LOGIN, home_access, login_address, share_home, view_token
from conetl.model.errors import EXIT_SERVICE_MISSING, DatabaseError, ServiceError
from conetl.pipeline.database import MapDatabase, running_url
from conetl.pipeline.settings import (
    SERVER_AUTH,
    Settings,
    prefect_environment,
    prefect_login,
    prefect_server_environment,
    read_settings,
)
from conetl.services import processes

PREFECT_PORT, VIEW_PORT = 4200, 8791
_TIMEOUT_S = 180
_log = logging.getLogger(__name__)


def up(
    workers: Annotated[
        int, typer.Option(min=1, max=64, help="Number of workers; each ingests one drive at a time.")
    ] = 1,
    host: Annotated[
        str,
        typer.Option(help="Address that Prefect listens on. To open it to other machines, put a TLS proxy in front."),
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=1, max=65535, help="Port of Prefect.")] = PREFECT_PORT,
    view_port: Annotated[int, typer.Option(min=1, max=65535, help="Port of the map viewer, on 127.0.0.1.")] = VIEW_PORT,
    decisions: DecisionsOption = False,
    group: Annotated[
        str | None,
        typer.Option(help="Operating system group that may read results, reports and exports, nothing else."),
    ] = None,
    map_name: MapOption = None,
    as_json: JsonOption = False,
) -> None:
    """Start all services: PostGIS, Prefect, workers, scheduled deployments and the map viewer.

    Leaves running services as they are, starts missing ones and resumes crashed runs. `conetl down` stops them and keeps maps,
    schedules and the history of runs.
    """
    settings = read_settings(map_name)
    home = settings.home.resolve()
    if group:
        share_home(home, group)
    with processes.services_lock(home), spinner("Starting") as show:
        services = {name: s for name, s in processes.read_services(home).items() if processes.is_running(s)}
        if "prefect" not in services:
            processes.free_port(host, port, "Prefect", "--port").close()
        if "view" not in services:
            processes.free_port("127.0.0.1", view_port, "the map viewer", "--view-port").close()
        show("Starting PostGIS")
        with MapDatabase(settings) as database:
            url = database.url
        settings.inbox.mkdir(parents=True, exist_ok=True)
        done = _start_services(
            settings, services, url, show, host=host, port=port, view_port=view_port, workers=workers, decisions=decisions,
        )  # fmt: skip
    if as_json:
        print_json({**_status(settings), **done})
        return
    say(f"Prefect:     {services['prefect'].address}  (schedules, runs, forms to start runs)")
    say(f"             log in with {login_source(home)}")
    say(f"Map:         {login_address(str(services['view'].address), view_token(home))}")
    say(f"Drop folder: {settings.inbox.resolve()}  (complete drives are ingested every 5 minutes)")
    say(f"PostGIS:     {'CONETL_DATABASE_URL' if settings.database_url else url}")
    say(f"Workers:     1 for plans and exports, {workers} for drives; logs in {home / 'logs'}")
    if done["runs_recovered"]:
        say(f"{counted(len(done['runs_recovered']), 'crashed run')} marked as crashed or resumed.")
    say("`conetl status` shows the state of the services, `conetl down` stops them.")


def _start_services(
    settings: Settings, services: dict[str, processes.Service], url: str, show: Callable[[str], object], *,
    host: str, port: int, view_port: int, workers: int, decisions: bool,
) -> dict[str, Any]:  # fmt: skip
    """Add the missing ones to `services`, each as soon as those it requires are ready; all are ready at the end."""
    home = settings.home.resolve()
    login = prefect_login(home)
    address = str(services["prefect"].address) if "prefect" in services else _address(host, port)
    view = str(services["view"].address) if "view" in services else f"http://127.0.0.1:{view_port}"
    processes.require_access(f"{address}/api", login, SERVER_AUTH)
    environment = {**os.environ, **_environment(settings, home, f"{address}/api", login, view, workers)}

    def ensure(name: str, command: list[str], where: str | None, **more: str) -> None:
        if name not in services:
            show(f"Starting {name}")
            services[name] = processes.start_service(
                name, command, home=home, environment={**environment, **more}, address=where
            )
            _log.info("started %s, process %s", name, services[name].pid)
            processes.write_services(home, services)

    # Starting is mostly importing on one core: independent services start at the same time.
    ensure(
        "prefect",
        processes.server_command(host, port),
        address,
        PREFECT_SERVER_DATABASE_CONNECTION_URL=_prefect_url(settings, url),
        **prefect_server_environment(home, address),
        # Errors of its own services appear only in its log.
        PREFECT_LOGGING_HANDLERS_CONSOLE_LEVEL="ERROR",
    )
    conetl = [sys.executable, "-m", "conetl"]
    writing = ["--decisions"] if decisions else []
    ensure("view", [*conetl, "view", "--port", str(view_port), *writing], view)
    os.environ.update(environment)  # Prefect reads its environment when it is imported, below
    from flows import register
    from flows.runs import recover_runs

    processes.wait_healthy(services["prefect"], lambda: processes.is_healthy(f"{address}/api"), _TIMEOUT_S)
    processes.require_access(f"{address}/api", login, SERVER_AUTH)
    register.ensure_pool()
    names = {name: f"{name} {socket.gethostname()}" for name in ("desk", *(f"drives-{n + 1}" for n in range(workers)))}
    for name, worker in names.items():
        # Prefect shows a queue that nobody polls as not ready, and makes `default` with the pool.
        queues, limit = (["desk", "default"], "8") if name == "desk" else (["drives", "backfill"], "1")
        command = [sys.executable, "-m", "prefect", "worker", "start", "--pool", "conetl", "--type", "process"]
        command += [part for queue in queues for part in ("--work-queue", queue)]
        command += ["--limit", limit, "--name", worker, "--install-policy", "never"]
        ensure(name, command, None)
    show("Registering deployments")
    registered = register.ensure_deployments()
    with MapDatabase(settings) as database:
        recovered = [str(run.id) for run in recover_runs(database)]
    show("Waiting for all services")
    processes.wait_healthy(services["view"], lambda: processes.answers(view), _TIMEOUT_S)
    for name, worker in names.items():
        since = datetime.fromisoformat(services[name].started_at)
        processes.wait_healthy(services[name], partial(register.worker_is_online, worker, since), _TIMEOUT_S)
    return {"deployments_registered": registered, "runs_recovered": recovered}


def login_source(home: Path) -> str:
    """Where a person finds user and password of Prefect's pages."""
    return SERVER_AUTH if os.environ.get(SERVER_AUTH) else f"the line in {home / PREFECT_LOGIN}"


def down(as_json: JsonOption = False) -> None:
    """Stop all services that `conetl up` started. Maps, schedules and the history of runs are kept."""
    settings = read_settings()
    home = settings.home.resolve()
    stopped: list[str] = []
    if home.is_dir():
        with processes.services_lock(home), spinner("Stopping"):
            services = processes.read_services(home)
            if not settings.database_url and (cluster := cluster_status(home)).host is not None:
                # Their processes are not visible here; forgetting them would leave them running for ever.
                raise ServiceError(
                    f"the services of {home} run on another machine or container (host {cluster.host}): stop them there. Nothing "
                    f"was stopped. If that machine no longer runs, remove {cluster.directory}/data/postmaster.pid."
                )
            # Workers first: they report their end to Prefect.
            order = sorted(services, key=lambda name: {"prefect": 2, "view": 1}.get(name, 0))
            stopped = [name for name in order if processes.stop_service(services[name])]
            processes.write_services(home, {})
            if not settings.database_url and cluster_down(home):
                stopped.append("postgis")
    text = f"Stopped: {', '.join(stopped)}." if stopped else "No services were running."
    answer(as_json, {"stopped": stopped}, text)


def status(as_json: JsonOption = False) -> None:
    """Show the status of the services of `conetl up`. Exit code 3: at least one is not running."""
    settings = read_settings()
    found = _status(settings)
    if as_json:
        print_json(found)
    else:
        columns: Columns = {
            "service": "name", "state": "state", "address": "address", "process": "pid",
            "since (UTC)": lambda row: row["since"] and datetime.fromisoformat(row["since"]),
        }  # fmt: skip
        print_records("", columns, found["services"], numbers_from=9)
        for service in found["services"]:
            if service["log_tail"]:
                say(f"\n{service['name']}: the end of {service['log']}:\n{service['log_tail']}")
        say(f"Home:    {settings.home.resolve()}, readable by {found['home_readable_by']}")
        if view := next((service["address"] for service in found["services"] if service["name"] == "view"), None):
            say(f"Prefect: log in with {login_source(settings.home.resolve())}")
            say(f"Map:     {login_address(view, view_token(settings.home))}")
        if found["notices"]:
            given_up = sum(row["given_up_at"] is not None for row in found["notices"])
            failed = counted(len(found["notices"]), "undelivered notice")
            say(f"Notices: {failed}, {given_up} given up: see `conetl zones undelivered`")
        if all(service["since"] is None for service in found["services"]):
            say("No services are running: start them with `conetl up`, or set CONETL_HOME to another home folder.")
    if not found["up"]:
        raise typer.Exit(EXIT_SERVICE_MISSING)


def _status(settings: Settings) -> dict[str, Any]:
    """All services with their states: running, not answering, ended, or not visible because they run on another machine."""
    home = settings.home.resolve()
    rows: list[dict[str, Any]] = []
    elsewhere = False
    if not settings.database_url:
        cluster = cluster_status(home)
        elsewhere = cluster.host is not None
        address = f"host {cluster.host}" if elsewhere else cluster.url
        pid = cluster.pid if cluster.state == "running" else None
        facts: dict[str, Any] = {"pid": pid, "since": None, "log": None, "log_tail": None}
        rows.append({"name": "postgis", "state": cluster.state, "address": address, **facts})
    services = processes.read_services(home)
    for service in services.values():
        state = "running" if processes.is_running(service) else "not seen from here" if elsewhere else "ended"
        health = f"{service.address}/api/health" if service.name == "prefect" else str(service.address)
        if state == "running" and service.address and not processes.answers(health):
            state = "not answering"
        facts = {"pid": service.pid if state in ("running", "not answering") else None, "since": service.started_at}
        tail = processes.log_tail(service) if state in ("ended", "not answering") else None
        facts |= {"log": service.log, "log_tail": tail}
        rows.append({"name": service.name, "state": state, "address": service.address, **facts})
    running = bool(services) and all(row["state"] == "running" for row in rows)
    return {"up": running, "services": rows, "home_readable_by": home_access(home), "notices": _undelivered(settings)}


def _undelivered(settings: Settings) -> list[dict[str, Any]]:
    """Notices that could not be delivered, of all maps; none where no database is running or ready."""
    with suppress(ServiceError, DatabaseError):
        if url := running_url(settings):
            with closing(connect(url)) as conn:
                return [dict(row) for row in undelivered(conn)]
    return []


def _address(host: str, port: int) -> str:
    """Address at which this machine and, unless it is loopback, others reach the server."""
    name = socket.getfqdn() if host in {"0.0.0.0", "::"} else f"[{host}]" if ":" in host else host
    return f"http://{name}:{port}"


def _prefect_url(settings: Settings, url: str) -> str:
    if settings.prefect_database_url:
        return sqlalchemy_url(settings.prefect_database_url.get_secret_value())
    try:
        return prefect_database(url)
    except ServiceError:
        if settings.database_url is None:
            raise
        raise ServiceError(
            "the database `prefect` cannot be created beside the one of the map: create it yourself (create database prefect), "
            "or set CONETL_PREFECT_DATABASE_URL"
        ) from None


def _environment(settings: Settings, home: Path, api: str, login: str, view: str, workers: int) -> dict[str, str]:
    """Environment variables of all services."""
    values = {
        **prefect_environment(home),
        "PREFECT_API_URL": api,
        "PREFECT_API_AUTH_STRING": login,
        "CONETL_HOME": str(home),
        "CONETL_MAP_NAME": settings.map_name,
        "CONETL_VIEW_URL": settings.view_url or view,
        "CONETL_DROP_FOLDER": str(settings.inbox.resolve()),
        "CONETL_WORKERS": os.environ.get("CONETL_WORKERS", str(max(1, settings.workers // workers))),
        # A run waits 8 minutes for a server that is being restarted, not the usual one.
        "PREFECT_CLIENT_MAX_RETRIES": os.environ.get("PREFECT_CLIENT_MAX_RETRIES", "8"),
        "PREFECT_WORKER_QUERY_SECONDS": os.environ.get("PREFECT_WORKER_QUERY_SECONDS", "3"),
    }
    # Runs have their own working folders, so relative paths would not work.
    if settings.model_path:
        values["CONETL_MODEL_PATH"] = str(settings.model_path.resolve())
    if "PYTHONPATH" in os.environ:
        paths = os.environ["PYTHONPATH"].split(os.pathsep)
        values["PYTHONPATH"] = os.pathsep.join(str(Path(path).resolve()) for path in paths)
    return values
