"""`conetl map check-points`: the map against surveyed check points."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from conetl.cli.console import JsonOption, MapOption, counted, parse_instant, print_json, print_table, say
from conetl.cli.database import open_map
from conetl.db.map.map_store import read_features_as_of
from conetl.evaluation.check_points import CheckedMap, check_map
from conetl.model.errors import EXIT_DONE, EXIT_NEEDS_ATTENTION
from conetl.readers.surveyed_points import read_surveyed_points

_AXES = ("east", "north", "up", "horizontal", "3D")


def check_points(
    file: Annotated[
        Path, typer.Argument(help="Surveyed feet of cones: CSV, GeoJSON, GeoPackage, FlatGeobuf, GeoParquet.")
    ],
    crs: Annotated[
        str | None,
        typer.Option("--crs", help="CRS of the file, if it states none, e.g. EPSG:25832 or EPSG:25832+7837."),
    ] = None,
    heights: Annotated[
        str | None, typer.Option(help="Heights of the file: ellipsoidal (default), or a system like EPSG:5773.")
    ] = None,
    sigma_m: Annotated[
        float | None,
        typer.Option(min=0, help="Sigma of the survey in m, if the file has no sigma_e_m, sigma_n_m, sigma_u_m."),
    ] = None,
    within_m: Annotated[
        float, typer.Option(min=0.01, help="A cone stands on a point if it is at most this far away.")
    ] = 0.75,
    as_of: Annotated[str | None, typer.Option("--as-of", help="State of the road at this time.")] = None,
    map_name: MapOption = None,
    as_json: JsonOption = False,
) -> None:
    """Compare the map with surveyed check points: residuals, RMSE, and whether the stated sigmas are true.

    The points change nothing on the map. Exit code 1 if no point has a cone, or the residuals contradict the stated sigmas.
    """
    with open_map(map_name) as (conn, info):
        versions = list(read_features_as_of(conn, parse_instant(as_of), map_name=info.map_name))
    points = read_surveyed_points(file, info.srid, crs=crs, heights=heights, sigma_m=sigma_m)
    checked = check_map(points, [version.feature for version in versions], within_m=within_m)
    if as_json:
        print_json(_values(checked, info.srid))
    else:
        _print(checked, info.map_name, info.srid)
    raise typer.Exit(EXIT_NEEDS_ATTENTION if checked.contradicts or checked.rmse_m is None else EXIT_DONE)


def _values(checked: CheckedMap, srid: int) -> dict[str, object]:
    return {
        "srid": srid,
        "points": [
            {
                "name": r.point.name,
                "xyz_m": list(r.point.xyz_m),
                "feature_id": r.feature and str(r.feature.feature_id),
                "difference_m": None if r.difference_m is None else r.difference_m.tolist(),
            }
            for r in checked.residuals
        ],
        "rmse_m": None if checked.rmse_m is None else dict(zip(_AXES, checked.rmse_m.tolist(), strict=True)),
        "mean_m": None if checked.mean_m is None else checked.mean_m.tolist(),
        "nees": checked.nees,
        "contradicts_sigmas": checked.contradicts,
    }


def _print(checked: CheckedMap, name: str, srid: int) -> None:
    rows: list[tuple[object, ...]] = [
        (
            r.point.name,
            str(r.feature.feature_id)[:8],
            *(f"{d:+.3f}" for d in r.difference_m),
            f"{sum(r.difference_m**2) ** 0.5:.3f}",
        )
        if r.feature is not None and r.difference_m is not None
        else (r.point.name, "no cone", "", "", "", "")
        for r in checked.residuals
    ]
    say(f"Map {name}, EPSG:{srid}, minus check points:")
    print_table("", ("point", "feature", "east m", "north m", "up m", "3D m"), rows, numbers_from=2)
    used = sum(r.feature is not None for r in checked.residuals)
    if checked.rmse_m is None or checked.mean_m is None:
        say(
            "No cone of the map stands on a check point: is the CRS the right one (--crs), or the height system (--heights)?"
        )
        return
    say(f"{used} of {counted(len(checked.residuals), 'point')} with a cone. RMSE: "
        + ", ".join(f"{axis} {value:.3f}" for axis, value in zip(_AXES, checked.rmse_m, strict=True)) + " m.")  # fmt: skip
    say(
        "Mean: " + ", ".join(f"{axis} {value:+.3f}" for axis, value in zip(_AXES, checked.mean_m, strict=False)) + " m."
    )
    agrees = "contradict" if checked.contradicts else "agree with"
    say(f"The residuals {agrees} the stated sigmas (NEES {checked.nees:.2f} per axis, 1 is expected).")
