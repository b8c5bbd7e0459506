"""All commands in one place; each is a few lines in a module of its own."""

from __future__ import annotations

import typer

from conetl.cli import database, demo, images, ingest, maps, simulate

app = typer.Typer(
    name="conetl",
    help="Stereo survey drives in, a versioned HD map of traffic cones out.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    epilog="Exit codes: 0 done; 1 done, but too many records were quarantined; 2 bad usage or input, nothing written; "
    "3 a service (database, Prefect) is not to be had, nothing written.",
)
app.command("ingest")(ingest.ingest)
app.command("locate")(images.locate)
app.command("detect")(images.detect)
app.command("simulate")(simulate.simulate)
app.command("demo")(demo.demo)
app.add_typer(maps.app, name="map")
app.add_typer(database.app, name="db")
