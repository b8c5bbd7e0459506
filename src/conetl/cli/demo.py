"""`conetl demo`: the main job on the sample drives, with the paper's Table 3 at the end."""

from __future__ import annotations

import time
from contextlib import closing
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from conetl.cli.console import JsonOption, out, print_json, print_table
from conetl.cli.database import open_map
from conetl.cli.ingest import ingest_drives, print_report
from conetl.errors import InputError
from conetl.geometry.rig import map_SE3_left
from conetl.io.drive_folder import read_drive
from conetl.io.exports.geojson import export_geojson
from conetl.io.map_store import read_current_features
from conetl.io.truth_file import read_truth
from conetl.params import IngestParams
from conetl.settings import read_settings
from conetl.steps.evaluation import TruthCone, TruthLine, compare_with_truth

_SAMPLES = Path("data/drives")


def demo(
    samples: Annotated[Path, typer.Argument(help="Folder of sample drives, each with a truth.csv.")] = _SAMPLES,
    as_json: JsonOption = False,
) -> None:
    """Ingest the sample drives into a map of their own and compare it with the truth."""
    started = time.monotonic()
    drives = sorted(path for path in samples.iterdir() if path.is_dir()) if samples.is_dir() else []
    if not drives:
        raise InputError(f"no sample drives in {samples}: run this in a clone of conetl, or name the folder")
    settings = read_settings().model_copy(update={"map_name": "demo"})
    if not as_json:
        out.print(f"Ingesting {len(drives)} sample drives, one after the other.\n")
    reports, exit_code = ingest_drives(
        drives, settings, IngestParams(), map_srid=None, show=(lambda _: None) if as_json else print_report
    )
    if exit_code:
        raise typer.Exit(exit_code)
    last = drives[-1]
    truth_rows = [row for row in read_truth(last / "truth.csv") if row.present]
    truth = [
        TruthCone(
            cone_id=row.cone_id,
            xyz_m=(row.easting_m, row.northing_m, row.height_ellipsoidal_m),
            cone_height_m=row.cone_height_m,
        )
        for row in truth_rows
    ]
    drive, _ = read_drive(last, map_srid=reports[-1].map_srid)
    path = np.array([map_SE3_left(pair.pose, drive.rig)[:3, 3] for pair in drive.frame_pairs])
    export = settings.exports_folder / "demo.geojson"
    with closing(open_map(settings)) as conn:
        features = read_current_features(conn, map_name=settings.map_name)
        export_geojson(conn, export, map_name=settings.map_name)
    lines, false = compare_with_truth(truth, features, path)
    seconds = time.monotonic() - started
    if as_json:
        print_json(
            {
                "reports": [report.model_dump(mode="json") for report in reports],
                "cones": [_as_dict(line) for line in lines],
                "false_features": [str(feature.feature_id) for feature in false],
                "median_error_3d_m": _median_error(lines),
                "seconds": seconds,
                "export": str(export),
            }
        )
        return
    out.print("[bold]Cones against truth[/], in metres: foot on the ground; range from the nearest point of the path")
    _print_table_3(lines)
    found = [line for line in lines if line.feature is not None]
    out.print(
        f"{len(found)} of {len(lines)} cones within 20 m of the path are on the map, {len(false)} false ones. "
        f"Median 3D error {_median_error(lines):.3f} m. {seconds:.0f} s in all."
        if found
        else f"none of the {len(lines)} cones is on the map"
    )
    out.print("\n[bold]Where the results lie[/]")
    out.print(f"  {export}: the map (drop it into QGIS)", markup=False)
    for report in reports:
        out.print(
            f"  {settings.exports_folder / report.drive_id}.png: plan view of drive {report.drive_id}", markup=False
        )
    out.print("\n[bold]How to look further[/]")
    out.print("  export CONETL_MAP_NAME=demo PATH=$PWD/.venv/bin:$PATH", markup=False)
    out.print("  conetl map show                         the cones, with sigma and existence probability", markup=False)
    out.print("  conetl map show --as-of 2026-03-02T23:00 the map before the second drive", markup=False)
    out.print(
        "  conetl map log                          the changesets; conetl map log FEATURE for one cone", markup=False
    )
    out.print("  conetl ingest YOUR_DRIVE                your own stereo drive; see README.md", markup=False)
    out.print("  conetl db down                          stop the database that this started", markup=False)


def _print_table_3(lines: list[TruthLine]) -> None:
    """Truth, computed and difference of position, range and height, per cone (the paper's Table 3)."""
    rows: list[tuple[object, ...]] = []
    for line in lines:
        truth, feature = line.truth, line.feature
        known = (*truth.xyz_m, line.truth_range_m, truth.cone_height_m)
        rows.append((truth.cone_id, "truth", *(f"{value:.3f}" for value in known), ""))
        if feature is None or line.range_m is None:
            rows.append(("", "not on the map", *[""] * 6))
            continue
        computed = (*feature.xyz_m, line.range_m, feature.cone_height_m)
        differences = [b - a for a, b in zip(known, computed, strict=True)]
        rows.append(("", "computed", *(f"{value:.3f}" for value in computed), ""))
        rows.append(("", "difference", *(f"{value:+.3f}" for value in differences), f"{line.error_3d_m:.3f}"))
    columns = ("cone", "", "easting", "northing", "height", "range", "cone", "3D error")
    print_table("", columns, rows, numbers_from=2)


def _median_error(lines: list[TruthLine]) -> float | None:
    errors = [line.error_3d_m for line in lines if line.error_3d_m is not None]
    return float(np.median(errors)) if errors else None


def _as_dict(line: TruthLine) -> dict[str, object]:
    return {
        "cone_id": line.truth.cone_id,
        "feature_id": str(line.feature.feature_id) if line.feature else None,
        "truth_xyz_m": line.truth.xyz_m,
        "xyz_m": line.feature.xyz_m if line.feature else None,
        "difference_m": line.difference_m,
        "error_3d_m": line.error_3d_m,
        "truth_range_m": line.truth_range_m,
        "range_m": line.range_m,
        "truth_cone_height_m": line.truth.cone_height_m,
        "cone_height_m": line.feature.cone_height_m if line.feature else None,
    }
