"""`conetl up`, `down`, `status`: everything that a desk needs, on one machine."""

from __future__ import annotations

import os
import socket
import sys
from collections.abc import Callable
from contextlib import closing, nullcontext
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Annotated, Any, NamedTuple
from uuid import UUID

import httpx
import typer

from conetl.cli.console import JsonOption, err, out, print_json, print_table
from conetl.db.cluster.cluster import cluster_down, cluster_status, cluster_up
from conetl.db.connection import connect, migrate, prefect_database, sqlalchemy_url
from conetl.model.errors import EXIT_SERVICE_MISSING, InputError, ServiceError
from conetl.pipeline.database import MapDatabase
from conetl.pipeline.settings import SERVER_AUTH, Settings, prefect_auth_string, prefect_environment, read_settings
from conetl.services.prefect_api import is_healthy, require_access
from conetl.services.processes import (
    Service,
    is_running,
    log_tail,
    read_services,
    require_free_port,
    services_lock,
    start_service,
    stop_service,
    wait_healthy,
    write_services,
)

_LOOPBACK = {"127.0.0.1", "::1", "localhost"}
_TIMEOUT_S = 180


def up(
    workers: Annotated[
        int, typer.Option(min=1, max=64, help="Workers that ingest drives, one drive each at a time.")
    ] = 1,
    host: Annotated[
        str, typer.Option(help=f"Where Prefect listens. Another one than loopback needs {SERVER_AUTH} (user:password).")
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=1, max=65535, help="Port of Prefect.")] = 4200,
    view_port: Annotated[int, typer.Option(min=1, max=65535, help="Port of the web view (always 127.0.0.1).")] = 8791,
    decisions: Annotated[
        bool, typer.Option("--decisions", help="The web view takes decisions from holders of the writer token.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Start everything: PostGIS, Prefect on PostgreSQL, workers, deployments with their schedules, the web view.

    What runs already is left alone, what is missing is started, dead runs are taken up again. `conetl down` ends it;
    maps, schedules and the history of runs stay.
    """
    settings = read_settings()
    if host not in _LOOPBACK and not os.environ.get(SERVER_AUTH):
        raise InputError(
            f"--host {host} lets other machines start runs here: set {SERVER_AUTH} to user:password first (and put a proxy with "
            "TLS before it, see docs/how-to/operations.md). Nothing was started."
        )
    home = settings.home.resolve()
    with services_lock(home), err.status("Starting") if err.is_terminal else nullcontext() as spinner:
        say = spinner.update if spinner is not None else _say_nothing
        started = _start_all(settings, home, workers, host, port, view_port, decisions, say)
    if as_json:
        about = {
            "deployments_registered": started.registered,
            "runs_recovered": [str(run) for run in started.recovered],
        }
        print_json({**_status(settings), **about})
        return
    out.print(f"Prefect:     {started.prefect}  (schedules, runs, the form to start them)", markup=False)
    out.print(f"Map:         {started.view}", markup=False)
    out.print(f"Drop folder: {settings.inbox.resolve()}  (complete drives are picked up every 5 minutes)", markup=False)
    out.print(f"PostGIS:     {'CONETL_DATABASE_URL' if settings.database_url else started.database}", markup=False)
    out.print(f"Workers:     1 for plans and exports, {workers} for drives; logs in {home / 'logs'}", markup=False)
    if started.recovered:
        count = len(started.recovered)
        out.print(f"{count} runs whose process was gone are marked as crashed or taken up again.", markup=False)
    out.print("`conetl status` tells how they are, `conetl down` ends them.", markup=False)


class _Started(NamedTuple):
    """What `up` found and did."""

    prefect: str
    view: str
    database: str
    registered: bool
    recovered: list[UUID]


def _start_all(
    settings: Settings,
    home: Path,
    workers: int,
    host: str,
    port: int,
    view_port: int,
    decisions: bool,
    say: Callable[[str], object],
) -> _Started:
    """Start what is missing, each when that which it needs is healthy; all are at the end."""
    services = {name: s for name, s in read_services(home).items() if is_running(s)}
    _require_ports(services, host, port, view_port)
    if "prefect" in services:
        require_access(f"{services['prefect'].address}/api", prefect_auth_string(), SERVER_AUTH)
    say("Starting PostGIS")
    url = settings.database_url.get_secret_value() if settings.database_url else cluster_up(home)
    with closing(connect(url)) as conn:
        migrate(conn)
    settings.inbox.mkdir(parents=True, exist_ok=True)
    address = _reach(host, port) if "prefect" not in services else str(services["prefect"].address)
    view = f"http://127.0.0.1:{view_port}" if "view" not in services else str(services["view"].address)
    environment = {
        **os.environ,
        **_environment(settings, home, f"{address}/api", prefect_auth_string(), view, workers),
    }

    def ensure(name: str, command: list[str], where: str | None, **more: str) -> None:
        if name not in services:
            say(f"Starting {name}")
            everything = {**environment, **more}
            services[name] = start_service(name, command, home=home, environment=everything, address=where)
            write_services(home, services)

    # Starting is mostly importing, one core each: what needs nothing of another starts at the same time.
    server = [sys.executable, "-m", "uvicorn", "--factory", "prefect.server.api.server:create_app"]
    ensure(
        "prefect",
        [*server, "--host", host, "--port", str(port), "--log-level", "warning"],
        address,
        PREFECT_SERVER_DATABASE_CONNECTION_URL=_prefect_url(settings, url),
        PREFECT_SERVER_UI_API_URL=os.environ.get("PREFECT_SERVER_UI_API_URL", f"{address}/api"),
        # Its terminal is its log: what fails in its own services is told nowhere else.
        PREFECT_LOGGING_HANDLERS_CONSOLE_LEVEL="ERROR",
    )
    conetl = [sys.executable, "-c", "from conetl.cli import main; main()"]
    ensure("view", [*conetl, "view", "--port", str(view_port), *(["--decisions"] if decisions else [])], view)
    os.environ.update(environment)  # Prefect reads its environment when it is imported, below
    from flows import register
    from flows.runs import recover

    wait_healthy(services["prefect"], lambda: is_healthy(f"{address}/api"), _TIMEOUT_S)
    require_access(f"{address}/api", prefect_auth_string(), SERVER_AUTH)
    register.ensure_pool()
    names = ["desk", *(f"drives-{n + 1}" for n in range(workers))]
    for name in names:
        queue, limit = ("desk", "8") if name == "desk" else ("drives", "1")
        command = [sys.executable, "-m", "prefect", "worker", "start", "--pool", "conetl", "--type", "process"]
        command += ["--work-queue", queue, "--limit", limit, "--name", _worker_name(name), "--install-policy", "never"]
        ensure(name, command, None)
    say("Registering deployments")
    registered = register.ensure_deployments()
    with MapDatabase(settings) as database:
        recovered = [run.id for run in recover(database)]

    def is_online(name: str) -> bool:
        return register.worker_is_online(_worker_name(name), datetime.fromisoformat(services[name].started_at))

    say("Waiting until all answer")
    wait_healthy(services["view"], lambda: _answers(view), _TIMEOUT_S)
    for name in names:
        wait_healthy(services[name], partial(is_online, name), _TIMEOUT_S)
    return _Started(address, view, url, registered, recovered)


def _worker_name(service: str) -> str:
    return f"{service} {socket.gethostname()}"


def _say_nothing(_text: str) -> None:
    """Where nobody looks at a terminal."""


def down(as_json: JsonOption = False) -> None:
    """End everything that `conetl up` started; maps, schedules and the history of runs stay."""
    settings = read_settings()
    home = settings.home.resolve()
    stopped: list[str] = []
    if home.is_dir():
        with services_lock(home), err.status("Stopping") if err.is_terminal else nullcontext():
            services = read_services(home)
            if not settings.database_url and (cluster := cluster_status(home)).host is not None:
                # Their processes cannot be seen from here: whoever forgot them would leave them running for ever.
                raise ServiceError(
                    f"what `conetl up` started for {home} runs on another machine or container (host {cluster.host}): end it "
                    f"there. Nothing was ended. Where it is known to be dead, remove {cluster.directory}/data/postmaster.pid."
                )
            order = sorted(
                services, key=lambda name: {"prefect": 2, "view": 1}.get(name, 0)
            )  # workers report their end to Prefect
            stopped = [name for name in order if stop_service(services[name])]
            write_services(home, {})
            if not settings.database_url and cluster_down(home):
                stopped.append("postgis")
    if as_json:
        print_json({"stopped": stopped})
    else:
        out.print(f"Stopped: {', '.join(stopped)}." if stopped else "Nothing was running.")


def status(as_json: JsonOption = False) -> None:
    """What runs of that which `conetl up` started. Exit code 3 where something is missing."""
    found = _status(read_settings())
    if as_json:
        print_json(found)
    else:
        rows = [
            (s["name"], s["state"], s["address"] or "", s["pid"] or "", s["since"] or "") for s in found["services"]
        ]
        print_table("", ("service", "state", "address", "process", "since"), rows, numbers_from=9)
        for service in found["services"]:
            if service["log_tail"]:
                out.print(f"\n{service['name']}: the end of {service['log']}:\n{service['log_tail']}", markup=False)
        if all(service["since"] is None for service in found["services"]):
            home = read_settings().home.resolve()
            out.print(
                f"Nothing of `conetl up` runs for this home, {home}: start it, or name another by CONETL_HOME.",
                markup=False,
            )
    if not found["up"]:
        raise typer.Exit(EXIT_SERVICE_MISSING)


def _status(settings: Settings) -> dict[str, Any]:
    """Every service with its state: running, not answering, ended, or not seen from here where the cluster runs elsewhere."""
    home = settings.home.resolve()
    rows: list[dict[str, Any]] = []
    elsewhere = False
    if not settings.database_url:
        cluster = cluster_status(home)
        elsewhere = cluster.host is not None
        where = cluster.url if cluster.host is None else f"host {cluster.host}"
        rows.append(_row("postgis", cluster.state, where, cluster.pid))
    services = read_services(home)
    for service in services.values():
        state = "running" if is_running(service) else "not seen from here" if elsewhere else "ended"
        if state == "running" and service.address and not _answers(_health(service)):
            state = "not answering"
        rows.append(
            _row(service.name, state, service.address, service.pid, service, tail=state in ("ended", "not answering"))
        )
    return {"up": bool(services) and all(row["state"] == "running" for row in rows), "services": rows}


def _row(
    name: str, state: str, address: str | None, pid: int | None, service: Service | None = None, *, tail: bool = False
) -> dict[str, Any]:
    return {
        "name": name,
        "state": state,
        "address": address,
        "pid": pid if state in ("running", "not answering") else None,
        "since": service and service.started_at,
        "log": service and service.log,
        "log_tail": log_tail(service) if service and tail else None,
    }


def _require_ports(services: dict[str, Service], host: str, port: int, view_port: int) -> None:
    if "prefect" not in services:
        require_free_port(host, port, "Prefect", "--port")
    if "view" not in services:
        require_free_port("127.0.0.1", view_port, "the web view", "--view-port")


def _health(service: Service) -> str:
    return f"{service.address}/api/health" if service.name == "prefect" else str(service.address)


def _answers(url: str) -> bool:
    try:
        return httpx.get(url, timeout=5, trust_env=False).status_code == httpx.codes.OK
    except httpx.HTTPError:
        return False


def _reach(host: str, port: int) -> str:
    """Address at which this machine and, where it is not loopback, others reach the server."""
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
            "the database `prefect` cannot be made beside the map's: make it by hand (create database prefect), or set "
            "CONETL_PREFECT_DATABASE_URL"
        ) from None


def _environment(settings: Settings, home: Path, api: str, auth: str | None, view: str, workers: int) -> dict[str, str]:
    """What all services get to know. Secrets stay in the environment and are written nowhere."""
    values = {
        **prefect_environment(home),
        "PREFECT_API_URL": api,
        "CONETL_HOME": str(home),
        "CONETL_VIEW_URL": settings.view_url or view,
        "CONETL_DROP_FOLDER": str(settings.inbox.resolve()),
        "CONETL_WORKERS": os.environ.get("CONETL_WORKERS", str(max(1, settings.workers // workers))),
        "PREFECT_WORKER_QUERY_SECONDS": os.environ.get("PREFECT_WORKER_QUERY_SECONDS", "3"),
    }
    # Runs have working folders of their own: nothing that is relative to this one may reach them.
    if settings.model_path:
        values["CONETL_MODEL_PATH"] = str(settings.model_path.resolve())
    if "PYTHONPATH" in os.environ:
        values["PYTHONPATH"] = os.pathsep.join(
            str(Path(p).resolve()) for p in os.environ["PYTHONPATH"].split(os.pathsep)
        )
    if auth:
        values["PREFECT_API_AUTH_STRING"] = auth
    return values
