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
from conetl.model.errors import EXIT_CODES

#: Heading of the first help page -> name of a command -> its module below `conetl.cli` and function, and the arguments of its
#: examples; nothing of a group.
_COMMANDS: dict[str, dict[str, tuple[str, ...]]] = {
    "Drives": {
        "ingest": ("ingest:ingest", "drives/2026-03-02", "--map night_survey drives/*", "drives/a --no-refine --json"),
        "backfill": ("backfill:backfill", "/srv/drives --since 2026-01-01 --dry-run", "/srv/drives --max-parallel 4"),
        "watch": ("watch:watch", "drives/today", "/mnt/nfs/today --poll --idle-seconds 60"),
        "init": (
            "init:init",
            "recording",
            "recording --set images.left=l.mp4 --set trajectory.date=2026-03-02",
            "recording --rig calibration.yml",
        ),
        "inspect": ("inspect_drive:inspect", "drives/2026-03-02", "drives/2026-03-02 --page inspection.html"),
        "drive": (),
    },
    "Map": {
        "map": (),
        "zones": (),
        "view": ("view:view", "", "--map night_survey --port 8800", "--decisions"),
        "report": (),
        "base": (),
    },
    "Services": {
        "up": ("services:up", "", "--workers 4 --map night_survey"),
        "down": ("services:down", ""),
        "status": ("services:status", "", "--json"),
        "doctor": ("doctor:doctor", "", "--json"),
        "db": (),
        "user": (),
    },
    "Tools": {
        "demo": ("demo:demo", "", "data/drives"),
        "detect": ("tools.detect:detect", "images --out detections.json --draw annotated"),
        "locate": ("tools.detect:locate", "left.png right.png --calibration rig.yaml"),
        "calibrate": (
            "tools.calibrate:calibrate",
            "boards --board chessboard:9x6:37.8mm --out rig.yaml --report report",
            "left.mp4 right.mp4 --board charuco:8x6:40mm:30mm --out rig.yaml",
        ),
        "rig": (),
        "evaluate": ("tools.evaluate:evaluate", "drives/2026-03-02 --truth surveyed.csv --out accuracy"),
        "lidar-check": ("tools.evaluate:lidar_check", "drives/2026-03-02"),
        "simulate": ("tools.simulate:simulate", "simulated --pass 1", "mixed --world mixed --seed 3"),
        "labels": (),
        "train": ("tools.train:train", "labels --out streets.onnx", "labels --minutes 60 --model streets.onnx"),
    },
}
#: Group of commands, with the group that it is in -> its help, and its commands likewise.
_GROUPS: dict[str, tuple[str, dict[str, tuple[str, ...]]]] = {
    "drive": (
        "List and accept drives on hold (recordings with a failed health check).",
        {
            "held": ("map.decisions:held", "", "--map night_survey --json"),
            "accept": ("map.decisions:accept", '12 --note "checked with the crew" --by Ann'),
        },
    ),
    "map": (
        "Show, compare, export, import, correct and manage maps.",
        {
            "show": ("map.show:show", "", "--as-of 2026-03-02 --map night_survey"),
            "log": ("map.show:log", "", "1c223030"),
            "diff": ("map.compare:diff", "1 2", "2026-03-01 2026-03-08 --out week.geojson --image week.png"),
            "picture": ("map.compare:picture", "map.png --as-of 2026-03-02", "changes.pdf --changes 1 2"),
            "export": (
                "map.exchange:export",
                "--out cones.gpkg",
                "--out cones.parquet --as-of 2026-03-03",
                "--out changes.csv --what changes --from 2026-03-01 --to 2026-03-07",
                '--out feed.geojson --format wzdx --publisher "Road office" --road-name "L 605"',
            ),
            "import": (
                "map.exchange:import_",
                "cones.gpkg",
                "cones.csv --crs EPSG:25832 --surveyed-at 2026-02-27 --sigma-m 0.3",
            ),
            "list": ("map.manage:list_", ""),
            "create": ("map.manage:create", "night_survey --crs EPSG:25832", "city --crs EPSG:25832+7837"),
            "rename": ("map.manage:rename", "default city_centre"),
            "delete": ("map.manage:delete", "night_survey", "night_survey --yes --dump night.zip"),
            "restore": ("map.manage:restore", "night.zip", "night.zip --map night_again"),
            "licence": ("map.exchange:licence", "", "CC-BY-4.0"),
            "qgis": ("map.exchange:qgis", "--out cones.qgz", "--out cones.qgz --user anna"),
            "check-layout": (
                "map.work_zones:check_layout_command",
                "--speed-kmh 50",
                "--speed-kmh 80 --image layout.png",
            ),
            "check-points": ("map.compare:check_points", "survey.csv --crs EPSG:25832 --sigma-m 0.01"),
            "suppress": ("map.decisions:suppress", '1c223030 --note "a bollard"', "1c223030 --radius 2"),
            "pin": ("map.decisions:pin", '1c223030 --note "surveyed by hand"'),
            "classify": ("map.decisions:classify", '1c223030 drum --note "seen on site"'),
            "revert": ("map.decisions:revert", "2", '2 --note "wrong calibration" --by Ann'),
            "decisions": ("map.decisions:decisions", ""),
        },
    ),
    "zones": (
        "Compare work zones with plans (permits, feeds), and notify other systems of them.",
        {
            "plan": (),
            "compare": (
                "map.plans:compare",
                "",
                "--as-of 2026-03-03T06:00 --out differences.csv --out differences.html",
            ),
            "notify": ("map.notices:notify", "", "--again"),
            "undelivered": ("map.notices:undelivered", "", "--json"),
            "history": ("map.notices:history", "", "1c223030", "--known-at 2026-03-03T06:00"),
            "judge": ("map.plans:judge", '1c223030 accepted --note "emergency works" --by Ann'),
        },
    ),
    "zones plan": (
        "Import and list plans of work zones.",
        {
            "import": (
                "map.plans:import_",
                "permits.gpkg",
                "permits.csv --time-zone Europe/Berlin --column plan_id=Aktenzeichen",
                "feed.geojson --list state",
            ),
            "list": ("map.plans:list_", "", "--known-at 2026-03-01"),
        },
    ),
    "report": (
        "Write a quality report (HTML) of a drive, of all drives of a night, or of the map.",
        {
            "drive": ("report:drive", "2026-03-02_taper", "3 --out third.html"),
            "night": ("report:night", "", "2026-03-03"),
            "quality": ("report:quality", "", "--checkpoints survey.csv --sigma-m 0.01 --as-of 2026-03-03"),
        },
    ),
    "base": (
        "Import, list and drop base layers: LiDAR points and lane boundaries.",
        {
            "import": (
                "map.base_layers:import_files",
                "survey.laz lanes.osm",
                "lanes.geojson --layer lanes --crs EPSG:25832",
            ),
            "list": ("map.base_layers:list_layers", ""),
            "drop": ("map.base_layers:drop", "survey"),
        },
    ),
    "db": (
        "Start, check, migrate, archive and prune the PostGIS database.",
        {
            "up": ("database:up", ""),
            "down": ("database:down", ""),
            "status": ("database:status", "", "--json"),
            "migrate": ("database:migrate", ""),
            "audit": ("database:audit", ""),
            "archive": (
                "database:archive",
                "--keep-positions 90d",
                "--keep-positions 90d --yes",
                "--restore 2026-03-02_taper_pass1",
            ),
            "prune": ("database:prune", "--keep-positions 90d --keep-results 30d", "--keep-results 30d --yes"),
        },
    ),
    "user": (
        "Logins of people for the map viewer, and what they may do there.",
        {
            "add": ("user:add", '"Ada Mayer" --role review'),
            "list": ("user:users", ""),
            "remove": ("user:remove", '"Ada Mayer"'),
        },
    ),
    "labels": (
        "Collect labelled images to teach the detector: from decisions about a map, and from other tools.",
        {
            "export": ("tools.labels:export", "labels", "labels --map night_survey --format coco"),
            "import": (
                "tools.labels:import_",
                "cvat --out labels",
                "result.json --out labels --class Leitkegel=traffic_cone",
            ),
        },
    ),
    "rig": (
        "Show the calibration of a rig, or convert it to the format of another tool.",
        {
            "show": ("tools.rig:show", "rig.yaml"),
            "convert": ("tools.rig:convert", "camchain.yaml rig.yaml --to rig"),
        },
    ),
}


class LazyGroup(TyperGroup):
    """A group of commands whose modules are imported when they run."""

    targets: Mapping[str, tuple[str, ...]] = {name: one for panel in _COMMANDS.values() for name, one in panel.items()}
    prefix = ""
    """Before the names of its commands in examples."""
    listing = False

    def list_commands(self, ctx: Any) -> list[str]:
        return [*self.targets, *super().list_commands(ctx)]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        target = self.targets.get(cmd_name)
        if target is None:
            return super().get_command(ctx, cmd_name)
        if self.listing:
            text = _summary(target[0]) if target else _GROUPS[f"{self.prefix}{cmd_name}"][0]
            panel = next((panel for panel, names in _COMMANDS.items() if cmd_name in names), None)
            return TyperCommand(
                cmd_name, help=text, rich_help_panel=panel if self.targets is LazyGroup.targets else None
            )
        if target:
            return _load(cmd_name, self.prefix, *target)
        path = f"{self.prefix}{cmd_name}"
        group = LazyGroup(name=cmd_name, help=_GROUPS[path][0], no_args_is_help=True)
        group.targets, group.prefix = _GROUPS[path][1], f"{path} "
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


def _load(name: str, prefix: str, target: str, *examples: str) -> Any:
    module, function = target.split(":")
    command = getattr(import_module(f"conetl.cli.{module}"), function)
    paragraphs = (inspect.getdoc(command) or "").split("\n\n")
    one = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    text = "\n\n".join(" ".join(paragraph.split()) for paragraph in paragraphs)
    lines = ["Examples:", *(f"conetl {prefix}{name} {example}".rstrip() for example in examples)]
    one.command(name, help=text, epilog="\n\n".join(lines))(command)
    loaded: Any = typer.main.get_command(one)
    for param in loaded.params:
        if getattr(param, "is_flag", False):
            param.metavar = ""  # else the help page names the type of a switch, and its texts get narrower
    return loaded


app = typer.Typer(
    name="conetl",
    cls=LazyGroup,
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
    epilog=f"Exit codes: {'; '.join(f'{code} {meaning}' for code, meaning in EXIT_CODES.items())}.",
)


def _print_version(wanted: bool) -> None:
    if wanted:
        say(f"conetl {version('conetl')}")
        raise typer.Exit


@app.callback()
def main(
    verbose: Annotated[
        int,
        typer.Option(
            "--verbose", "-v", count=True, show_default=False, help="Log to standard error; -vv: more detail."
        ),
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
            note(f"unknown environment variables are ignored: {', '.join(ignored)}")
