"""`conetl zones plan import|list`, `conetl zones compare|judge`: planned work zones against those that were found."""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from conetl.cli import console as ui
from conetl.cli.database import open_map
from conetl.cli.map.decisions import By, Note, who_decides
from conetl.cli.map.work_zones import LanesOption
from conetl.db.map.plan_store import read_plans as read_stored
from conetl.files.atomic import atomic_text_file, write_json
from conetl.files.documents import read_yaml_model
from conetl.model.errors import EXIT_NEEDS_ATTENTION, InputError
from conetl.model.planned_zones import DifferenceKind
from conetl.model.work_zone_params import PlanParams
from conetl.pipeline.maps.planned_zones import VERDICTS, PlanComparison, PlanRow, compare_with_plans, import_plans
from conetl.pipeline.maps.planned_zones import judge as judge_difference
from conetl.pipeline.settings import read_settings
from conetl.readers.plans import read_plans
from conetl.reports.plan_page import write_plan_page

ListOption = Annotated[str, typer.Option("--list", help="List of the plans, in which their ids are unique.")]
RulesOption = Annotated[Path | None, typer.Option("--rules", help="YAML file of PlanParams that replace the defaults.")]
#: Records that are printed; all are in the JSON.
_SHOWN = 20


def import_(
    file: Annotated[Path, typer.Argument(help="DATEX II (.xml), WZDx feed, or permits as GeoJSON, GeoPackage or CSV.")],
    list_name: ListOption = "permits",
    crs: ui.FileCrsOption = None,
    time_zone: Annotated[
        str | None, typer.Option("--time-zone", help="Of permits' times that state none, e.g. Europe/Berlin.")
    ] = None,
    column: Annotated[
        list[str] | None,
        typer.Option("--column", help="Name of a column of permits, like plan_id=Aktenzeichen; may be repeated."),
    ] = None,
    map_name: ui.MapOption = None,
    as_json: ui.JsonOption = False,
) -> None:
    """Import planned work zones: a changed plan replaces its older version, and the history is kept.

    Records that are no plans, or cannot be used, are named and left out. Exit code 1: some are broken.
    """
    named = dict(one.partition("=")[::2] for one in column or ())
    if without := [field for field, name in named.items() if not name]:
        raise InputError(
            f"--column {without[0]}: expected a field and the name of its column, like plan_id={without[0]}"
        )
    found = read_plans(file, crs=crs, time_zone=time_zone, columns=named)
    with open_map(map_name) as (conn, info):
        stored, unused = import_plans(conn, file, found, map_name=info.map_name, list_name=list_name)
    if as_json:
        ui.print_json(stored._asdict() | {"list_name": list_name, "unused": unused})
    else:
        counts = f"{len(stored.added)} new, {len(stored.changed)} changed, {stored.unchanged} as before"
        counts += f", {len(stored.older)} older than those stored" if stored.older else ""
        ui.say(f"{ui.counted(sum(map(len, stored[:3])) + stored.unchanged, 'plan')} of {file}: {counts}")
        ui.print_records("Not used", {"record": "record", "reason": "reason"}, unused[:_SHOWN], numbers_from=2)
        if len(unused) > _SHOWN:
            ui.say(f"... and {len(unused) - _SHOWN} more; all are in the output of --json.")
    if any(one.is_broken for one in unused):
        raise typer.Exit(EXIT_NEEDS_ATTENTION)


def list_(
    list_name: Annotated[str | None, typer.Option("--list", help="Only plans of this list.")] = None,
    known_at: ui.KnownOption = None,
    map_name: ui.MapOption = None,
    as_json: ui.JsonOption = False,
) -> None:
    """List the plans of the map, as known now or at an earlier time."""
    with open_map(map_name) as (conn, info):
        known = ui.parse_known(known_at, None)
        plans = read_stored(conn, map_name=info.map_name, list_name=list_name, known_at=known)
    if as_json:
        ui.print_json([{"list_name": one.list_name, **one.plan.model_dump(mode="json")} for one in plans])
        return
    columns: ui.Columns = {
        "list": "list_name",
        "plan": "plan.plan_id",
        "from (UTC)": "plan.starts_at",
        "until (UTC)": "plan.ends_at",
        "status": "plan.status",
        "road": lambda one: ", ".join(one.plan.road_names),
        "lanes": lambda one: ", ".join(one.plan.lanes),
    }
    ui.print_records("", columns, plans, numbers_from=len(columns))
    ui.say(f"{ui.counted(len(plans), 'plan')} of map {info.map_name} {ui.known_text(known_at)}")


def compare(
    as_of: ui.AsOfOption = None,
    known_at: ui.KnownOption = None,
    output: Annotated[
        list[Path] | None,
        typer.Option("--out", help="File to write: .csv, .json, .geojson or .html; may be repeated."),
    ] = None,
    rules: RulesOption = None,
    lanes: LanesOption = None,
    map_name: ui.MapOption = None,
    as_json: ui.JsonOption = False,
) -> None:
    """Compare planned work zones with those that were found, where drives looked.

    Each row has its time between two drives, its place, the share of the plan that drives passed, images, and a person's verdict.
    """
    writers = [(path, _writer(path)) for path in output or ()]
    valid_at = ui.parse_instant(as_of)
    with open_map(map_name) as (conn, info):
        found = compare_with_plans(
            conn, map_name=info.map_name, as_of=valid_at, known_at=ui.parse_known(known_at, valid_at), lanes=lanes,
            params=read_yaml_model(rules, PlanParams, "rules"),
        )  # fmt: skip
    view = read_settings(info.map_name).view_url or ""
    for path, write in writers:
        write(path, info.map_name, found, view)
    if as_json:
        ui.print_json({"map": info.map_name, "at": found.at, "rows": [row.flat() for row in found.rows]})
        return
    _print(found.rows)
    ui.say(
        ", ".join(f"{kind}: {found.counts[kind]}" for kind in DifferenceKind if found.counts[kind])
        or "No plans, no zones."
    )
    for path, _ in writers:
        ui.say(f"{ui.counted(len(found.rows), 'row')} -> {path}")


def judge(
    difference: Annotated[str, typer.Argument(help="Id of a difference, or its first characters.")],
    verdict: Annotated[str, typer.Argument(help=f"One of {', '.join(VERDICTS)}; open takes a verdict back.")],
    note: Note = "",
    by: By = None,
    as_of: ui.AsOfOption = None,
    map_name: ui.MapOption = None,
    as_json: ui.JsonOption = False,
) -> None:
    """Say whether a difference is confirmed, accepted or wrong. It stays with the difference when the comparison is repeated."""
    with open_map(map_name) as (conn, info):
        judged = judge_difference(
            conn, difference, verdict, map_name=info.map_name, note=note, decided_by=who_decides(by),
            as_of=ui.parse_instant(as_of),
        )  # fmt: skip
    text = f"Difference {str(judged.difference_id)[:8]} ({judged.kind}): {verdict}"
    ui.answer(as_json, {"difference_id": judged.difference_id, "verdict": verdict}, text)


def _print(rows: Sequence[PlanRow]) -> None:
    columns: ui.Columns = {
        "id": "difference.difference_id",
        "result": lambda row: row.difference.kind.value,
        "plan": "difference.plan_id",
        "zone": "difference.zone_id",
        "what": "difference.text",
        "first seen (UTC)": lambda row: row.difference.first and row.difference.first.at,
        "last seen (UTC)": lambda row: row.difference.last and row.difference.last.at,
        "verdict": "verdict",
        "confidence": "difference.confidence",
    }
    ui.print_records("", columns, rows, numbers_from=len(columns) - 1)


def _writer(path: Path) -> Callable[[Path, str, PlanComparison, str], object]:
    writers: dict[str, Callable[[Path, str, PlanComparison, str], object]] = {
        ".csv": _write_csv,
        ".json": _write_json,
        ".geojson": partial(_write_json, geo=True),
        ".html": _write_html,
    }
    if path.suffix.lower() not in writers:
        raise InputError(f"--out {path}: expected a name that ends with {', '.join(writers)}")
    return writers[path.suffix.lower()]


def _write_csv(path: Path, map_name: str, found: PlanComparison, view: str) -> None:
    names = [*PlanRow.model_fields, *found.rows[0].flat()] if found.rows else []
    names = [name for name in names if name not in ("difference",)]
    with atomic_text_file(path) as file:
        table = csv.DictWriter(file, list(dict.fromkeys(names)), lineterminator="\n")
        table.writeheader()
        for row in found.rows:
            table.writerow(_texts(row) | {"images": " ".join(row.images)})


def _texts(row: PlanRow) -> dict[str, Any]:
    return {name: value.isoformat() if hasattr(value, "isoformat") else value for name, value in row.flat().items()}


def _write_json(path: Path, map_name: str, found: PlanComparison, view: str, geo: bool = False) -> None:
    rows = [
        {
            name: value if isinstance(value, int | float | list | None) else str(value)
            for name, value in _texts(row).items()
        }
        for row in found.rows
    ]
    features = [
        {"type": "Feature", "id": row["difference_id"], "properties": row,
            "geometry": {"type": "Point", "coordinates": [row["lon_deg"], row["lat_deg"]]}}
        for row in rows
    ]  # fmt: skip
    shown = {"type": "FeatureCollection", "features": features} if geo else {"map": map_name, "rows": rows}
    write_json(path, shown)


def _write_html(path: Path, map_name: str, found: PlanComparison, view: str) -> None:
    write_plan_page(path, map_name, found.at, [row.flat() for row in found.rows], view)
