"""`conetl map diff` and `conetl map check-points`: two states of the map, and the map against surveyed points."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Annotated
from uuid import UUID

import numpy as np
import typer

from conetl.cli.console import (
    Columns,
    JsonOption,
    MapOption,
    class_if_mixed,
    counted,
    parse_instant,
    print_json,
    print_records,
    print_table,
    say,
)
from conetl.cli.database import open_map
from conetl.db.connection import Connection
from conetl.db.map.map_store import feature_log, list_changesets, read_features_as_of
from conetl.evaluation.check_points import CheckedMap, check_map
from conetl.exports.geojson import ChangeOrigin, export_diff_geojson
from conetl.mapping import map_diff
from conetl.model.errors import EXIT_DONE, EXIT_NEEDS_ATTENTION, InputError
from conetl.model.map_records import FeatureChange, MapFeature
from conetl.readers.surveyed_points import read_surveyed_points

_AXES = ("east", "north", "up", "horizontal", "3D")


def diff(
    before: Annotated[str, typer.Argument(help="Number of a changeset (the state after it), or a time on the road.")],
    after: Annotated[str, typer.Argument(help="Likewise.")],
    output: Annotated[Path | None, typer.Option("--out", help="GeoJSON file to write.")] = None,
    picture: Annotated[
        Path | None, typer.Option("--picture", "--image", help="PNG to write: both states, changes in colour.")
    ] = None,
    map_name: MapOption = None,
    as_json: JsonOption = False,
) -> None:
    """Show the differences between two states of the map."""
    with open_map(map_name) as (conn, info):
        old, new = state_of(conn, info.map_name, before), state_of(conn, info.map_name, after)
        changes = map_diff.diff(old, new)
        points = [change for change in changes if not change.is_of_line]
        origins = {} if output is None else _origins(conn, points, instants_of(conn, info.map_name, after))
    if output is not None:
        export_diff_geojson(points, output, srid=info.srid, origins=origins)
    if picture is not None:
        from conetl.reports.figures import draw_plan_view  # matplotlib takes half a second to load

        if not old and not new:
            raise InputError(f"there is nothing to draw: the map has no cones at {before} and at {after}")
        changed = {change.feature_id for change in changes}
        draw_plan_view(
            picture,
            title=f"Map {info.map_name}, EPSG:{info.srid}: {before} to {after}",
            trajectory_m=np.empty((0, 2)),
            deltas=changes,
            untouched=[one for one in new if one.feature_id not in changed],
            untouched_label="no difference",
        )
    if as_json:
        print_json(changes)
        return
    lines = [change for change in changes if change.is_of_line]
    say(_counts(points) or ("No differences." if not lines else "No differences of cones."))
    if lines:
        say(f"Lane markings: {_counts(lines)}")
    columns = class_if_mixed(_COLUMNS, {change.state_after.category for change in changes})
    print_records("", columns, changes, numbers_from=2)
    if output is not None:
        say(f"{len(points)} changes -> {output}")
        if lines:
            say("Lane markings are not in this file: `conetl map export --what changes` writes them.")
    if picture is not None:
        say(f"image -> {picture}")


def _origins(
    conn: Connection, changes: Sequence[FeatureChange], until: tuple[datetime | None, datetime | None]
) -> dict[UUID, ChangeOrigin]:
    """What made the later state of each feature. until: time on the road and of the database; None: the latest."""
    valid_at, known_at = until
    found = {}
    for change in changes:
        entries = [
            entry
            for entry in feature_log(conn, change.feature_id)
            if (valid_at is None or entry.changed_at <= valid_at)
            and (known_at is None or entry.committed_at <= known_at)
            and (entry.believed_until is None or (known_at is not None and entry.believed_until > known_at))
        ]
        if entries:
            last = max(entries, key=lambda entry: entry.changed_at)
            found[change.feature_id] = ChangeOrigin(last.changed_at, last.drive_id, last.changeset_no)
    return found


def _counts(changes: Sequence[FeatureChange]) -> str:
    """`2 added, 1 moved`."""
    counts = Counter(change.kind for change in changes)
    return ", ".join(f"{count} {kind}" for kind, count in sorted(counts.items()))


_COLUMNS: Columns = {
    "change": lambda change: str(change.kind),
    "feature": "feature_id",
    "class": "state_after.category",
    "easting m": lambda change: change.state_after.xyz_m[0],
    "northing m": lambda change: change.state_after.xyz_m[1],
    "height m": lambda change: change.state_after.xyz_m[2],
    "shift m": "shift_m",
    "old": lambda change: change.old and change.old.version,
    "new": lambda change: change.new and change.new.version,
}


def state_of(conn: Connection, map_name: str, name: str) -> list[MapFeature]:
    """All features after a changeset, as known then, or at a time on the road, as known now."""
    valid_at, known_at = instants_of(conn, map_name, name)
    versions = read_features_as_of(conn, valid_at, known_at=known_at, map_name=map_name, lines=True)
    return [version.feature for version in versions]


def instants_of(conn: Connection, map_name: str, name: str) -> tuple[datetime | None, datetime | None]:
    """Time on the road and time of the database for a changeset number or a time; None: the latest."""
    if name.isdigit() and len(name) < 8:
        changesets = [c for c in list_changesets(conn, map_name=map_name) if c.changeset_no == int(name)]
        if not changesets:
            raise InputError(f"the map {map_name} has no changeset {name}: `conetl map log` lists them")
        return None, changesets[0].committed_at
    return parse_instant(name), None


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
