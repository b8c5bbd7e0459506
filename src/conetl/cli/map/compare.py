"""`conetl map diff`, `picture` and `check-points`: states of the map, as lists and plans, and against surveyed points."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from pyproj import Transformer

from conetl.cli import console as ui
from conetl.cli.database import open_map
from conetl.cli.features import print_features, row_of
from conetl.db.connection import Connection
from conetl.db.map.map_store import Bbox, list_changesets, read_changes, read_features_as_of
from conetl.db.map.results import MapInstant
from conetl.exports.kind_marks import KIND_MARKS, STANDING, kinds_text
from conetl.exports.text_files import export_diff_geojson
from conetl.model.errors import EXIT_DONE, EXIT_NEEDS_ATTENTION, InputError
from conetl.model.feature_classes import CONE, LANE_MARKING
from conetl.model.map_records import DeltaKind, FeatureChange, MapFeature

if TYPE_CHECKING:  # what draws and checks takes half a second to load
    from conetl.evaluation.truth import CheckedMap
    from conetl.reports.map_picture import PlanContent

_AXES = ("east", "north", "up", "horizontal", "3D")


def diff(
    before: Annotated[
        str,
        typer.Argument(
            help="Number of a changeset (the road right after its drive, as known now), or a time; a date: its beginning."
        ),
    ],
    after: Annotated[str, typer.Argument(help="The later state, in the same form; a date: its end.")],
    known_at: ui.KnownOption = None,
    output: Annotated[Path | None, typer.Option("--out", help="GeoJSON file to write.")] = None,
    picture: Annotated[
        Path | None, typer.Option("--image", "--picture", help="PNG to write: both states, changes in colour.")
    ] = None,
    map_name: ui.MapOption = None,
    as_json: ui.JsonOption = False,
) -> None:
    """Show the differences between two states of the map."""
    if output is not None and output.suffix.lower() not in {".geojson", ".json"}:
        raise InputError(f"{output}: --out writes GeoJSON (.geojson, .json); --image writes an image")
    with open_map(map_name) as (conn, info):
        begin, end = instants_of(conn, info.map_name, (before, after), known_at)
        changes = read_changes(conn, begin, end, map_name=info.map_name)
        new = [] if picture is None else _standing(conn, end, info.map_name)
    points = [change for change in changes if not change.is_line]
    if output is not None:
        export_diff_geojson(points, output, srid=info.srid)
    if picture is not None:
        from conetl.reports.figures import save_figure  # matplotlib takes half a second to load
        from conetl.reports.map_picture import draw_plan

        if not changes and not new:
            raise InputError(f"nothing to draw: the map has no cones at {before} or at {after}")
        title = f"Map {info.map_name}: {_span(before, after)}"
        footer = _footer(end, (before, after), known_at, info.last_committed_at)
        save_figure(draw_plan(_content(info.srid, new, changes), title=title, footer=footer), picture)
    if as_json:
        ui.print_json(changes)
        return
    counts, lines = (
        kinds_text(Counter(one.kind for one in changes if one.is_line is of_line)) for of_line in (False, True)
    )
    ui.say(
        f"From {_span(before, after)}, {ui.known_text(known_at)}: {counts or ('no cones differ' if lines else 'no differences')}."
    )
    if lines:
        ui.say(f"Stretches of lane markings: {lines}.")
    ordered = sorted(changes, key=lambda change: change.kind is DeltaKind.CONFIRMED)
    print_features("changes", [_row_of(change) for change in ordered], numbers_from=2)
    if output is not None:
        ui.say(f"{len(points)} changes -> {output}")
        if lines:
            ui.say("This file does not contain lane markings: use `conetl map export --what changes`.")
    if picture is not None:
        ui.say(f"image -> {picture}")


def _row_of(change: FeatureChange) -> dict[str, Any]:
    old, new = (None if state is None else state.version for state in (change.old, change.new))
    own = {"change": change.kind, "shift_m": change.shift_m, "old_version": old, "new_version": new}
    return row_of(change.state_after, **own)


def _standing(conn: Connection, at: MapInstant, map_name: str) -> list[MapFeature]:
    versions = read_features_as_of(conn, at.valid_at, known_at=at.known_at, map_name=map_name, lines=True)
    return [version.feature for version in versions]


def _shown(state: str, edge: str = "") -> str:
    """A state as it is named in pictures: `changeset 2`, or the time; edge: of a date, which is meant."""
    if _is_number(state):
        return f"changeset {state}"
    return f"{edge} of {state}" if edge and ui.is_date(state) else state


def _span(before: str, after: str, word: str = "to") -> str:
    return f"{_shown(before, 'the beginning')} {word} {_shown(after, 'the end')}"


def _is_number(state: str) -> bool:
    return state.isdigit() and len(state) < 8


def instants_of(
    conn: Connection, map_name: str, states: tuple[str, str], known_at: str | None
) -> tuple[MapInstant, MapInstant]:
    """Two states of a map, from the earlier to the later one. Raises InputError for unknown ones, and in reversed order.

    states: numbers of changesets (the road right after the drive), or times (a date at the begin or end belongs to the span).
    known_at: None: now; `then`: the whole map as known right after its changeset, or at its time; or a time.
    """
    changesets = {c.changeset_no: c for c in list_changesets(conn, map_name=map_name)}
    if unknown := [one for one in states if _is_number(one) and int(one) not in changesets]:
        raise InputError(f"the map {map_name} has no changeset {unknown[0]}: see `conetl map log`")
    chosen = [changesets[int(one)] if _is_number(one) else None for one in states]
    first, last = (None if changeset else state for changeset, state in zip(chosen, states, strict=True))
    times = ui.parse_span(first, last, ("the earlier state", "the later state"))
    found = []
    for changeset, time in zip(chosen, times, strict=True):
        if changeset is None:
            found.append(MapInstant(time, ui.parse_known(known_at, time)))
        elif known_at == ui.THEN:
            found.append(MapInstant(None, changeset.effective_at))
        else:
            found.append(MapInstant(changeset.valid_at, ui.parse_instant(known_at)))
    begin, end = found
    for earlier, later in ((begin.valid_at, end.valid_at), (begin.known_at, end.known_at)):
        if earlier is not None and later is not None and earlier > later:
            raise InputError(f"{_shown(states[0])} is later than {_shown(states[1])}: exchange them")
    return begin, end


def check_points(
    file: Annotated[
        Path, typer.Argument(help="Surveyed feet of cones: CSV, GeoJSON, GeoPackage, FlatGeobuf, GeoParquet.")
    ],
    crs: ui.FileCrsOption = None,
    heights: ui.HeightsOption = None,
    sigma_m: ui.SurveySigmaOption = None,
    within_m: ui.WithinOption = 0.75,
    as_of: ui.AsOfOption = None,
    known_at: ui.KnownOption = None,
    map_name: ui.MapOption = None,
    as_json: ui.JsonOption = False,
) -> None:
    """Compare the map with surveyed check points: residuals, RMSE, and whether the residuals agree with the stated sigmas.

    Does not change the map. Exit code 1: no point has a cone, or the residuals contradict the stated sigmas.
    """
    from conetl.evaluation.truth import check_map
    from conetl.readers.surveyed_points import read_surveyed_points

    with open_map(map_name) as (conn, info):
        valid_at = ui.parse_instant(as_of)
        known = ui.parse_known(known_at, valid_at)
        versions = list(read_features_as_of(conn, valid_at, known_at=known, map_name=info.map_name))
    points = read_surveyed_points(file, info.srid, crs=crs, heights=heights, sigma_m=sigma_m)
    checked = check_map(points, [version.feature for version in versions], within_m=within_m)
    if as_json:
        ui.print_json(_values(checked, info.srid))
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
    ui.say(f"Map {name}, EPSG:{srid}, minus check points:")
    ui.print_table("", ("point", "feature", "east m", "north m", "up m", "3D m"), rows, numbers_from=2)
    used = sum(r.feature is not None for r in checked.residuals)
    if checked.rmse_m is None or checked.mean_m is None:
        ui.say("No cone of the map is at a check point: check the CRS (--crs) and the height system (--heights).")
        return
    ui.say(f"{used} of {ui.counted(len(checked.residuals), 'point')} with a cone. RMSE: "
        + ", ".join(f"{axis} {value:.3f}" for axis, value in zip(_AXES, checked.rmse_m, strict=True)) + " m.")  # fmt: skip
    ui.say(
        "Mean: " + ", ".join(f"{axis} {value:+.3f}" for axis, value in zip(_AXES, checked.mean_m, strict=False)) + " m."
    )
    agrees = "contradict" if checked.contradicts else "agree with"
    ui.say(f"The residuals {agrees} the stated sigmas (NEES {checked.nees:.2f} per axis, 1 is expected).")


def picture(
    output: Annotated[Path, typer.Argument(metavar="OUT", help="File to write: .png, .svg, .pdf.")],
    at: Annotated[str | None, typer.Option("--as-of", "--at", help=ui.AS_OF)] = None,
    known_at: ui.KnownOption = None,
    changes: Annotated[
        tuple[str, str] | None,
        typer.Option(metavar="A B", help="Show the changes between two changeset numbers or two times, as `map diff`."),
    ] = None,
    bbox: Annotated[
        str | None,
        typer.Option(help="west,south,east,north in the map's CRS or in degrees; default: the whole map."),
    ] = None,
    size: Annotated[str | None, typer.Option(help="Width x height in millimetres, e.g. 240x160.")] = None,
    title: Annotated[str | None, typer.Option(help="Title; default: the name of the map.")] = None,
    map_name: ui.MapOption = None,
    as_json: ui.JsonOption = False,
) -> None:
    """Draw a plan of the map for a report: cones, lane markings, base layers, drive paths, scale bar, legend, CRS and date."""
    from conetl.reports.figures import SUFFIXES, save_figure
    from conetl.reports.map_picture import draw_plan, with_surroundings

    if output.suffix.lower() not in SUFFIXES:
        raise InputError(f"{output}: the file name must end in one of {', '.join(SUFFIXES)}")
    if changes is not None and at is not None:
        raise InputError("--changes already gives both states: omit --as-of")
    size_mm = ui.parse_size("--size", size, "millimetres", 60, 1200, "240x160")
    with open_map(map_name) as (conn, info):
        name = info.map_name
        if changes is None:
            valid_at = ui.parse_instant(at)
            state, differing = MapInstant(valid_at, ui.parse_known(known_at, valid_at)), None
        else:
            begin, state = instants_of(conn, name, changes, known_at)
            differing = read_changes(conn, begin, state, map_name=name)
        standing = _standing(conn, state, name)
        content = _content(info.srid, standing, differing)
        extent = content.extent() if bbox is None else _bbox(bbox, info.srid)
        content = with_surroundings(conn, name, content, extent, state.valid_at, state.known_at)
    classes = Counter(feature.category for feature in standing)
    if title is None:
        drawn = [*standing, *(change.old for change in differing or () if change.old is not None)]
        title = f"Traffic cones, map {name}" if {one.category for one in drawn} <= {CONE} else f"Map {name}"
        title += f": changes from {_span(*changes)}" if changes else ""
    footer = _footer(state, changes, known_at, info.last_committed_at)
    done = save_figure(draw_plan(content, bbox=extent, size_mm=size_mm, title=title, footer=footer), output)
    lines, points = len(content.boundaries_m), len(content.points_m)
    facts = {
        "picture": str(done),
        "objects_by_class": dict(classes),
        "changes": None if differing is None else len(differing),
        "lines": lines,
        "points": points,
        "bbox": extent,
    }
    painted = classes.pop(LANE_MARKING, 0)
    shown = f"{ui.counted_by_class(classes)}, "
    if painted:
        shown += f"{ui.counted_by_class({LANE_MARKING: painted})}, "
    ui.answer(as_json, facts, f"{shown}{lines} lane boundaries, {points} points -> {done}")


def _content(srid: int, standing: Sequence[MapFeature], changes: Sequence[FeatureChange] | None) -> PlanContent:
    """A state of the map, or its changes (None: no comparison) with what is unchanged."""
    from conetl.reports.figures import changes_of, marks_of
    from conetl.reports.map_picture import PlanContent

    changed = {change.feature_id for change in changes or ()}
    shown = changes or (), [feature for feature in standing if feature.feature_id not in changed]
    others = STANDING if changes is None else KIND_MARKS[DeltaKind.CONFIRMED]._replace(label="unchanged")
    return PlanContent(srid, marks_of(*shown), changes_of(*shown), others=others)


def _footer(state: MapInstant, changes: tuple[str, str] | None, known_at: str | None, last: datetime | None) -> str:
    """Which state of the map is drawn."""
    if changes:
        parts = [_span(*changes, "compared with")]
    else:
        parts = [f"on the road at {state.valid_at:%Y-%m-%d %H:%M} UTC" if state.valid_at else "latest state"]
    parts.append(
        f"as known at {state.known_at:%Y-%m-%d %H:%M} UTC"
        if state.known_at and known_at != ui.THEN
        else ui.known_text(known_at)
    )
    if last and known_at is None:
        parts.append(f"last change of the database {last:%Y-%m-%d %H:%M} UTC")
    return " · ".join([*parts, "grid north · conetl"])


def _bbox(text: str, srid: int) -> Bbox:
    """In the map's CRS; numbers in the range of degrees are longitudes and latitudes. Raises InputError."""
    try:
        west, south, east, north = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"--bbox {text}: expected west,south,east,north") from None
    if not all(map(math.isfinite, (west, south, east, north))) or west >= east or south >= north:
        raise InputError(f"--bbox {text}: west must be less than east and south less than north")
    if abs(west) <= 180 and abs(east) <= 180 and abs(south) <= 90 and abs(north) <= 90:
        to_map = Transformer.from_crs(4326, srid, always_xy=True)
        west, south, east, north = to_map.transform_bounds(west, south, east, north)
        if not all(map(math.isfinite, (west, south, east, north))):
            raise InputError(f"--bbox {text}: this area does not exist in the map's CRS, EPSG:{srid}")
    if max(east - west, north - south) > 100_000:
        raise InputError(f"--bbox {text}: at most 100 km can be drawn")
    return west, south, east, north
