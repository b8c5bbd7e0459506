"""All commands: their names, their functions, and the order in which `conetl --help` lists them.

A module is imported when its command runs. Help pages and shell completion read its docstrings from the source file.
"""

from __future__ import annotations

import ast
import inspect
import os
from collections.abc import Mapping
from importlib import import_module
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from conetl.cli.console import note, say, start_logging

#: Heading of the first help page -> name of a command -> its module below `conetl.cli` and function.
_COMMANDS = {
    "Drives": {
        "ingest": "ingest:ingest",
        "backfill": "backfill:backfill",
        "watch": "watch:watch",
        "init": "init:init",
        "inspect": "inspect_drive:inspect",
        "drive": "",
    },
    "Map": {"map": "", "view": "view:view", "report": "", "base": ""},
    "Services": {"up": "services:up", "down": "services:down", "status": "services:status", "db": ""},
    "Tools": {
        "demo": "demo:demo",
        "detect": "tools.detect:detect",
        "locate": "tools.detect:locate",
        "calibrate": "tools.calibrate:calibrate",
        "rig": "",
        "evaluate": "tools.evaluate:evaluate",
        "lidar-check": "tools.evaluate:lidar_check",
        "simulate": "tools.simulate:simulate",
    },
}
#: Group of commands -> its help, and its commands likewise.
_GROUPS = {
    "drive": (
        "Drives on hold: recordings that contradict themselves.",
        {"held": "map.decisions:held", "accept": "map.decisions:accept"},
    ),
    "map": (
        "Show, compare, export, import, correct and manage maps.",
        {
            "show": "map.show:show",
            "log": "map.show:log",
            "diff": "map.compare:diff",
            "picture": "map.compare:picture",
            "export": "map.exchange:export",
            "import": "map.exchange:import_",
            "list": "map.manage:list_",
            "create": "map.manage:create",
            "rename": "map.manage:rename",
            "delete": "map.manage:delete",
            "restore": "map.manage:restore",
            "licence": "map.exchange:licence",
            "qgis": "map.exchange:qgis",
            "check-layout": "map.work_zones:check_layout_command",
            "check-points": "map.compare:check_points",
            "suppress": "map.decisions:suppress",
            "pin": "map.decisions:pin",
            "classify": "map.decisions:classify",
            "revert": "map.decisions:revert",
            "decisions": "map.decisions:decisions",
        },
    ),
    "report": (
        "Quality reports as HTML: of a drive, or of a night.",
        {"drive": "report:drive", "night": "report:night"},
    ),
    "base": (
        "Base layers of the map: LiDAR points and lane boundaries.",
        {
            "import": "map.base_layers:import_files",
            "list": "map.base_layers:list_layers",
            "drop": "map.base_layers:drop",
        },
    ),
    "db": (
        "The PostGIS database: CONETL_DATABASE_URL, or a private cluster.",
        {name: f"database:{name}" for name in ("up", "down", "status", "migrate", "audit", "archive", "prune")},
    ),
    "rig": (
        "Show the calibration of a rig, or convert it to the format of another tool.",
        {"show": "tools.rig:show", "convert": "tools.rig:convert"},
    ),
}
EXAMPLES = {
    "ingest": ("ingest drives/2026-03-02", "ingest --map night_survey drives/*", "ingest drives/a --no-refine --json"),
    "backfill": ("backfill /srv/drives --since 2026-01-01 --dry-run", "backfill /srv/drives --max-parallel 4"),
    "watch": ("watch drives/today", "watch /mnt/nfs/today --poll --idle-seconds 60"),
    "init": (
        "init recording",
        "init recording --left l.mp4 --right r.mp4 --trajectory log.nmea --date 2026-03-02 --yes",
        "init recording --every 2 --from 10 --to 70",
    ),
    "inspect": ("inspect drives/2026-03-02", "inspect drives/2026-03-02 --page inspection.html"),
    "drive held": ("drive held", "drive held --map night_survey --json"),
    "drive accept": ('drive accept 12 --note "checked with the crew" --by Ann',),
    "map show": ("map show", "map show --as-of 2026-03-02 --map night_survey"),
    "map log": ("map log", "map log 1c223030"),
    "map diff": ("map diff 1 2", "map diff 2026-03-01 2026-03-08 --out week.geojson --image week.png"),
    "map picture": ('map picture map.png --at 2026-03-02 --title "L 605"', "map picture changes.pdf --changes 1 2"),
    "map export": (
        "map export --out cones.gpkg",
        "map export --out cones.parquet --as-of 2026-03-03",
        "map export --out changes.csv --what changes --from 2026-03-01 --to 2026-03-07",
        'map export --out feed.geojson --format wzdx --publisher "Road office" --road-name "L 605"',
    ),
    "map import": (
        "map import cones.gpkg",
        "map import cones.csv --crs EPSG:25832 --surveyed-at 2026-02-27 --sigma-m 0.3",
    ),
    "map list": ("map list",),
    "map create": ("map create night_survey --crs EPSG:25832", "map create city --crs EPSG:25832+7837"),
    "map rename": ("map rename default city_centre",),
    "map delete": ("map delete night_survey", "map delete night_survey --yes --dump night.zip"),
    "map restore": ("map restore night.zip", "map restore night.zip --map night_again"),
    "map licence": ("map licence", "map licence CC-BY-4.0"),
    "map qgis": ("map qgis --out cones.qgz", "map qgis --out cones.qgz --user anna"),
    "map check-layout": ("map check-layout --speed-kmh 50", "map check-layout --speed-kmh 80 --image layout.png"),
    "map check-points": ("map check-points survey.csv --crs EPSG:25832 --sigma-m 0.01",),
    "map suppress": ('map suppress 1c223030 --note "a bollard"', "map suppress 1c223030 --radius 2"),
    "map pin": ('map pin 1c223030 --note "surveyed by hand"',),
    "map classify": ('map classify 1c223030 drum --note "seen on site"',),
    "map revert": ("map revert 2", 'map revert 2 --note "wrong calibration" --by Ann'),
    "map decisions": ("map decisions",),
    "view": ("view", "view --map night_survey --port 8800", "view --decisions"),
    "report drive": ("report drive 2026-03-02_taper", "report drive 3 --out third.html"),
    "report night": ("report night", "report night 2026-03-03"),
    "base import": ("base import survey.laz lanes.osm", "base import lanes.geojson --layer lanes --crs 25832"),
    "base list": ("base list",),
    "base drop": ("base drop survey",),
    "up": ("up", "up --workers 4 --map night_survey"),
    "down": ("down",),
    "status": ("status", "status --json"),
    "db up": ("db up",),
    "db down": ("db down",),
    "db status": ("db status", "db status --json"),
    "db migrate": ("db migrate",),
    "db audit": ("db audit",),
    "db archive": (
        "db archive --keep-positions 90d",
        "db archive --keep-positions 90d --yes",
        "db archive --restore 2026-03-02_taper_pass1",
    ),
    "db prune": ("db prune --keep-positions 90d --keep-results 30d", "db prune --keep-results 30d --yes"),
    "demo": ("demo", "demo data/drives"),
    "detect": ("detect images --out detections.json --draw annotated",),
    "locate": ("locate left.png right.png --calibration rig.yaml",),
    "calibrate": (
        "calibrate boards --board chessboard:9x6:37.8mm --out rig.yaml --report report",
        "calibrate left.mp4 right.mp4 --board charuco:8x6:40mm:30mm --out rig.yaml",
    ),
    "rig show": ("rig show rig.yaml",),
    "rig convert": ("rig convert camchain.yaml rig.yaml --to rig",),
    "evaluate": ("evaluate drives/2026-03-02 --truth surveyed.csv --out accuracy",),
    "lidar-check": ("lidar-check drives/2026-03-02",),
    "simulate": ("simulate simulated --pass 1", "simulate mixed --world mixed --seed 3"),
}


class LazyGroup(TyperGroup):
    """A group of commands whose modules are imported when they run."""

    targets: Mapping[str, str] = {name: target for panel in _COMMANDS.values() for name, target in panel.items()}
    prefix = ""
    """Before the names of its commands in `EXAMPLES`."""
    listing = False

    def list_commands(self, ctx: Any) -> list[str]:
        return [*self.targets, *super().list_commands(ctx)]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        target = self.targets.get(cmd_name)
        if target is None:
            return super().get_command(ctx, cmd_name)
        if self.listing:
            text = _summary(target) if target else _GROUPS[cmd_name][0]
            panel = next((panel for panel, names in _COMMANDS.items() if cmd_name in names), None)
            return TyperCommand(
                cmd_name, help=text, rich_help_panel=panel if self.targets is LazyGroup.targets else None
            )
        if target:
            return _load(cmd_name, target, self.prefix)
        group = LazyGroup(name=cmd_name, help=_GROUPS[cmd_name][0], no_args_is_help=True)
        group.targets, group.prefix = _GROUPS[cmd_name][1], f"{cmd_name} "
        return group

    def format_help(self, ctx: Any, formatter: Any) -> None:
        self.listing = True
        super().format_help(ctx, formatter)

    def shell_complete(self, ctx: Any, incomplete: str) -> Any:
        self.listing = True
        return super().shell_complete(ctx, incomplete)


def _summary(target: str) -> str:
    """First paragraph of a command's docstring, without importing its module."""
    module, function = target.split(":")
    spec = find_spec(f"conetl.cli.{module}")
    assert spec is not None and spec.origin is not None
    body = ast.parse(Path(spec.origin).read_text(encoding="utf-8")).body
    found = next(node for node in body if isinstance(node, ast.FunctionDef) and node.name == function)
    return inspect.cleandoc(ast.get_docstring(found) or "").partition("\n\n")[0]


def _load(name: str, target: str, prefix: str) -> Any:
    module, function = target.split(":")
    command = getattr(import_module(f"conetl.cli.{module}"), function)
    paragraphs = (inspect.getdoc(command) or "").split("\n\n")
    one = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    text = "\n\n".join(" ".join(paragraph.split()) for paragraph in paragraphs)
    one.command(name, help=text, epilog=epilog_of(f"{prefix}{name}"))(command)
    return typer.main.get_command(one)


app = typer.Typer(
    name="conetl",
    cls=LazyGroup,
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
    epilog="Exit codes: 0 done; 1 done, but something needs a person (too many records quarantined, a drive on hold, "
    "files or events not published); 2 bad usage or input, nothing written; 3 a service (database, Prefect, storage) is "
    "unavailable, nothing written; 70 internal error.",
)


def _print_version(wanted: bool) -> None:
    if wanted:
        say(f"conetl {version('conetl')}")
        raise typer.Exit


@app.callback()
def main(
    verbose: Annotated[
        int,
        typer.Option("--verbose", "-v", count=True, show_default=False, help="Log to standard error; -vv: in detail."),
    ] = 0,
    _version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Turn stereo survey drives into a versioned HD map of traffic cones."""
    start_logging(verbose)
    if any(name.startswith("CONETL_") for name in os.environ):
        from conetl.pipeline.settings import ignored_variables  # pydantic takes time to load

        if ignored := ignored_variables(os.environ):
            note(f"ignored environment variables, which are not settings: {', '.join(ignored)}")


def epilog_of(command: str) -> str | None:
    """The examples of a command in its help page."""
    lines = EXAMPLES.get(command)
    return None if lines is None else "\n\n".join(["Examples:", *(f"conetl {line}" for line in lines)])
