"""`conetl doctor`: whether this machine has what conetl requires, and how to get what is missing."""

from __future__ import annotations

import inspect
import os
import platform
import shutil
import sys
from collections.abc import Callable
from contextlib import closing, suppress
from dataclasses import dataclass
from importlib import metadata

import typer
from packaging.requirements import Requirement

from conetl.cli import console as ui
from conetl.cli.services import PREFECT_PORT, VIEW_PORT
from conetl.db.cluster.cluster import cluster_status
from conetl.db.cluster.location import find_location, server_user
from conetl.db.cluster.owner import require_no_server_elsewhere
from conetl.db.cluster.postgres_install import choose_install, find_installs
from conetl.db.connection import connect
from conetl.db.map.archive import list_maps
from conetl.db.schema import database_status, require_usable
from conetl.files.home import PREFECT_LOGIN, VIEW_TOKEN, WRITER_TOKEN, home_access, read_secret
from conetl.geometry.geodesy import map_crs
from conetl.model.errors import EXIT_NEEDS_ATTENTION, ConetlError, DatabaseError, InputError
from conetl.pipeline.database import running_url
from conetl.pipeline.settings import Settings, read_settings
from conetl.services import processes

#: A new cluster with its log, results and reports of some drives.
MIN_FREE_BYTES = 2_000_000_000
_OTHER_HOME = "choose another folder, `export CONETL_HOME=/path/to/folder`"


@dataclass(frozen=True)
class Diagnosis:
    """The answer of one check."""

    check: str
    tests: str
    passed: bool
    found: str
    """What there is; where it did not pass the problem, with its remedy."""


def doctor(as_json: ui.JsonOption = False) -> None:
    """Check whether this machine has what conetl requires, and say how to get what is missing.

    Changes nothing. Exit code 1: something is missing.
    """
    settings = read_settings()
    findings = [_finding(look, settings) for look in CHECKS]
    if as_json:
        ui.print_json(findings)
    else:
        columns: ui.Columns = {
            "check": "check",
            "result": lambda one: "passed" if one.passed else "failed",
            "found": lambda one: one.found if one.passed else f"see below; tested: {one.tests}",
        }
        ui.print_records("", columns, findings, numbers_from=len(columns))
        for one in findings:
            if not one.passed:
                ui.say(f": {one.found}", bold=one.check)
    if not all(one.passed for one in findings):
        raise typer.Exit(EXIT_NEEDS_ATTENTION)


def _finding(look: Callable[[Settings], str], settings: Settings) -> Diagnosis:
    tests = (inspect.getdoc(look) or "").partition(".")[0]
    try:
        return Diagnosis(look.__name__, tests, True, look(settings))
    except (ConetlError, OSError) as error:
        return Diagnosis(look.__name__, tests, False, str(error))


def packages(_: Settings) -> str:
    """All required packages, and those that they require, are installed in versions that fit. Raises InputError."""
    waiting, wrong = [Requirement("conetl")], {}
    seen: set[str] = set()
    while waiting:
        one = waiting.pop()
        if str(one) in seen or not (one.marker is None or one.marker.evaluate({"extra": ""})):
            continue
        seen.add(str(one))
        found = next(iter(metadata.distributions(name=one.name)), None)
        wanted = f"{one.name}{one.specifier}"
        if found is None or not one.specifier.contains(found.version, prereleases=True):
            wrong[wanted] = "missing" if found is None else f"{found.version} is installed"
        else:
            waiting += map(Requirement, found.requires or ())
    if wrong:
        command = " ".join([sys.executable, "-m pip install", *(f'"{wanted}"' for wanted in wrong)])
        listed = ", ".join(f"{wanted} ({why})" for wanted, why in wrong.items())
        raise InputError(f"conetl requires {listed}: run `{command}`")
    return f"conetl {metadata.version('conetl')}, Python {platform.python_version()}, all packages"


def home(settings: Settings) -> str:
    """CONETL_HOME can be written, has free space, and keeps its secrets. Raises InputError."""
    path = settings.home.absolute()
    folder = next(one for one in (path, *path.parents) if os.access(one, os.F_OK))
    if not (folder.is_dir() and os.access(folder, os.W_OK | os.X_OK)):
        raise InputError(f"{folder} is no folder that this user may write to: {_OTHER_HOME}")
    free_bytes = shutil.disk_usage(folder).free
    if free_bytes < MIN_FREE_BYTES:
        raise InputError(
            f"{folder} has {free_bytes / 1e9:.1f} GB of free space, {MIN_FREE_BYTES / 1e9:.0f} GB are required: free space, or "
            f"{_OTHER_HOME}"
        )
    for name in (PREFECT_LOGIN, VIEW_TOKEN, WRITER_TOKEN):
        if os.access(path / name, os.F_OK):
            read_secret(path / name)
    access = f"readable by {home_access(path)}" if path.is_dir() else "not created yet"
    return f"{path}, {free_bytes / 1e9:.0f} GB free, {access}"


def database(settings: Settings) -> str:
    """The database of CONETL_DATABASE_URL answers, or PostgreSQL with PostGIS is installed. Raises DatabaseError."""
    url = running_url(settings)
    if url is None:
        cluster, location = cluster_status(settings.home), find_location(settings.home)
        if location is not None:
            require_no_server_elsewhere(location)
        user = (location.user if location else server_user()).pw_name
        install = choose_install(find_installs(), data_major=cluster.postgres_major)
        version = ".".join(map(str, install.version))
        return f"PostgreSQL {version} with PostGIS, private cluster {cluster.state}, runs as user {user}"
    with closing(connect(url)) as conn:
        require_usable(conn)
        facts = database_status(conn)
    pending = ui.counted(len(facts["pending_migrations"]), "migration")
    advice = f"; {pending} to apply: back up, then `conetl db migrate`" if facts["pending_migrations"] else ""
    return f"PostgreSQL {facts['postgres_version']}, PostGIS {facts['postgis_version'] or 'available'}{advice}"


def model(settings: Settings) -> str:
    """The detector's files are complete and can be loaded. Raises ModelFileError or InputError."""
    from conetl.perception.detector import load_detector  # onnxruntime takes time to load

    card = load_detector(settings.model_path, providers=settings.onnx_providers).card
    return f"{card.name}, SHA-256 {card.sha256[:12]}, runs on {settings.onnx_providers}"


def projections(settings: Settings) -> str:
    """PROJ knows EPSG codes and has the grids of the maps' heights. Raises InputError."""
    map_crs("EPSG:25832")
    maps = []
    with suppress(DatabaseError):  # reported by its own check
        if url := running_url(settings):
            with closing(connect(url)) as conn:
                maps = list_maps(conn)
    for one in maps:
        map_crs(f"EPSG:{one['srid']}" + (f"+{one['vertical_srid']}" if one["vertical_srid"] else ""))
    return f"grids of {ui.counted(len(maps), 'map')}" if maps else "EPSG codes; no map was read that names grids"


def prefect(settings: Settings) -> str:
    """The Prefect server of PREFECT_API_URL answers and accepts the login. Raises ServiceError."""
    if api := os.environ.get("PREFECT_API_URL"):
        processes.require_configured(api, os.environ.get("PREFECT_API_AUTH_STRING"))
        return f"{api} answers"
    return "server of `conetl up`" if _services(settings) else "none is running: each command starts its own"


def ports(settings: Settings) -> str:
    """The ports of `conetl up` are free. Raises InputError."""
    running = _services(settings)
    if "prefect" not in running:
        processes.free_port("127.0.0.1", PREFECT_PORT, "Prefect", "conetl up --port").close()
    if "view" not in running:
        processes.free_port("127.0.0.1", VIEW_PORT, "the map viewer", "conetl up --view-port").close()
    return f"{PREFECT_PORT} and {VIEW_PORT} are {'used by `conetl up`' if running else 'free'}"


def _services(settings: Settings) -> set[str]:
    """Names of the services of `conetl up` that run here."""
    return {name for name, one in processes.read_services(settings.home).items() if processes.is_running(one)}


#: Each says what there is, or raises an error that says what to do; the first sentence of its docstring is what it tests.
CHECKS: tuple[Callable[[Settings], str], ...] = (packages, home, database, model, projections, prefect, ports)
