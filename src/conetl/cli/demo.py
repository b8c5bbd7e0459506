"""`conetl demo`: ingest the sample drives and compare the map with the truth."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from conetl.cli.console import JsonOption, print_json, print_table, say
from conetl.cli.database import open_map
from conetl.cli.ingest import ingest_drives, print_report
from conetl.cli.map.base_layers import import_one, print_imported
from conetl.db.map.map_store import read_current_features
from conetl.evaluation import truth
from conetl.exports.text_files import export_geojson
from conetl.geometry.rig import map_SE3_left
from conetl.model.errors import InputError
from conetl.model.params import IngestParams
from conetl.pipeline.settings import read_settings
from conetl.readers.drives import read_drive

_SAMPLES = Path("data/drives")
#: Base layers, beside the folder of drives.
_BASE_LAYERS = ("base/street.laz", "base/lane_boundaries.geojson")
_NEXT_STEPS = """\
  export CONETL_MAP_NAME=demo PATH=$PWD/.venv/bin:$PATH
  conetl view                                show the map in a browser, with LiDAR points and lane boundaries
  conetl map show                            list the cones with sigma and existence probability
  conetl map show --as-of 2026-03-02T23:00   the map before the second drive
  conetl map log                             list the changesets; conetl map log FEATURE for one cone
  conetl ingest --map mine YOUR_DRIVE        ingest your own drive into another map; see README.md
  conetl db down                             stop the database that this command started"""


def demo(
    samples: Annotated[Path, typer.Argument(help="Folder of sample drives, each with a truth.csv.")] = _SAMPLES,
    map_name: Annotated[str, typer.Option("--map", metavar="NAME", help="Name of the map.")] = "demo",
    as_json: JsonOption = False,
) -> None:
    """Ingest the sample drives into the map `demo` and compare the map with the ground truth."""
    started = time.monotonic()
    drives = sorted(path for path in samples.iterdir() if path.is_dir()) if samples.is_dir() else []
    if not drives:
        raise InputError(f"{samples}: contains no sample drives; run this in a clone of conetl, or give their folder")
    settings = read_settings(map_name)
    if not as_json:
        say(f"Ingesting {len(drives)} sample drives, one after the other.\n")
    reports, exit_code = ingest_drives(
        drives, settings, IngestParams(), map_srid=None, show=(lambda _: None) if as_json else print_report
    )
    if exit_code:
        raise typer.Exit(exit_code)
    for name in _BASE_LAYERS:
        if (layer := samples.parent / name).is_file():
            imported = import_one(settings.map_name, layer)
            if not as_json:
                print_imported(imported)
    last = drives[-1]
    known, _ = truth.read_truth_cones(last / "truth.csv")
    drive, _ = read_drive(last, map_srid=reports[-1].map_srid)
    path = np.array([map_SE3_left(pair.pose, drive.rig)[:3, 3] for pair in drive.frame_pairs])
    export = settings.exports_folder / "demo.geojson"
    with open_map(settings.map_name) as (conn, _):
        features = read_current_features(conn, map_name=settings.map_name)
        export_geojson(conn, export, map_name=settings.map_name)
    lines, false = truth.compare_with_truth(known, features, path)
    seconds = time.monotonic() - started
    if as_json:
        print_json(
            {
                "reports": reports,
                "cones": [
                    {"feature_id": str(line.feature.feature_id) if line.feature else None, **truth.line_as_dict(line)}
                    for line in lines
                ],
                "false_features": [str(feature.feature_id) for feature in false],
                "median_error_3d_m": truth.median_error(lines),
                "seconds": seconds,
                "export": str(export),
            }
        )
        return
    say(
        ", in metres (position: foot; range: from the nearest point of the path)",
        bold="Cones compared with the ground truth",
    )
    print_table("", truth.TABLE_3_COLUMNS, truth.table_3_rows(lines, missing="not on the map"), numbers_from=2)
    found = [line for line in lines if line.feature is not None]
    say(
        f"{len(found)} of {len(lines)} cones within 20 m of the drive path are on the map, {len(false)} false positives. "
        f"Median 3D error {truth.median_error(lines):.3f} m. {seconds:.0f} s in total."
        if found
        else f"None of the {len(lines)} cones is on the map."
    )
    say(bold="\nResults")
    say(f"  {export}: the map (open it in QGIS)")
    say(f"  {settings.reports_folder}: plan view and report of each drive, with images of its changes")
    say(bold="\nNext steps")
    say(_NEXT_STEPS)
