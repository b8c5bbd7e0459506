"""All commands in one place; each is a few lines in a module of its own."""

from __future__ import annotations

import typer

from conetl.cli.backfill import backfill
from conetl.cli.database import app as database
from conetl.cli.demo import demo
from conetl.cli.ingest import ingest
from conetl.cli.inspect_drive import inspect
from conetl.cli.map.base import app as base
from conetl.cli.map.show import app as maps
from conetl.cli.report import app as report
from conetl.cli.services import down, status, up
from conetl.cli.tools.calibrate import calibrate
from conetl.cli.tools.detect import detect
from conetl.cli.tools.evaluate import evaluate
from conetl.cli.tools.lidar_check import lidar_check
from conetl.cli.tools.locate import locate
from conetl.cli.tools.rig import app as rig
from conetl.cli.tools.simulate import simulate
from conetl.cli.view import view
from conetl.cli.watch import watch

app = typer.Typer(
    name="conetl",
    help="Stereo survey drives in, a versioned HD map of traffic cones out.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    epilog="Exit codes: 0 done; 1 done, but too many records were quarantined, or the map's files or events could not be made; "
    "2 bad usage or input, nothing written; 3 a service (database, Prefect, storage) is not to be had, nothing written.",
)
for command in (
    ingest,
    inspect,
    watch,
    backfill,
    up,
    down,
    status,
    view,
    calibrate,
    locate,
    detect,
    evaluate,
    lidar_check,
    simulate,
    demo,
):
    app.command()(command)
app.add_typer(maps, name="map")
app.add_typer(base, name="base")
app.add_typer(database, name="db")
app.add_typer(report, name="report")
app.add_typer(rig, name="rig")
