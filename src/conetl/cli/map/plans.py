"""`conetl zones plan import|list`, `conetl zones compare|judge`: planned work zones against those that were found."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Annotated

import typer

from conetl.cli import console as ui
from conetl.cli.database import open_map
from conetl.cli.map.decisions import By, Note, who_decides
from conetl.cli.map.work_zones import LanesOption
from conetl.db.map import plan_store as store
from conetl.files.atomic import atomic_text_file, write_json
from conetl.files.documents import read_yaml_model
from conetl.model.errors import EXIT_NEEDS_ATTENTION, InputError
from conetl.model.planned_zones import DIFFERENCE_COLUMNS, VERDICTS, DifferenceKind
from conetl.model.work_zone_params import PlanParams
from conetl.pipeline.maps import planned_zones as plans
from conetl.pipeline.settings import read_settings
from conetl.readers.plans import read_plans
from conetl.reports.plan_page import write_plan_page

ListOption = Annotated[str, typer.Option("--list", help="List of the plans, in which their ids are unique.")]
#: Records that are printed; all are in the JSON.
_SHOWN = 20
_SUFFIXES = (".csv", ".geojson", ".html")


def import_(
    file: Annotated[
        Path,
        typer.Argument(
            help="DATEX II or planned works of National Highways (.xml), WZDx feed, or permits as GeoJSON, GeoPackage or CSV."
        ),
    ],
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
        raise InputError(f"--column {without[0]}: expected a field and its column, like plan_id={without[0]}")
    found = read_plans(file, crs=crs, time_zone=time_zone, columns=named)
    with open_map(map_name) as (conn, info):
        stored, unused = plans.import_plans(conn, file, found, map_name=info.map_name, list_name=list_name)
    if as_json:
        ui.print_json(stored._asdict() | {"list_name": list_name, "unused": unused})
    else:
        counts = f"{len(stored.added)} new, {len(stored.changed)} changed, {stored.unchanged} as before"
        counts += f", {len(stored.older)} older than those stored" if stored.older else ""
        ui.say(f"{file}: {counts}")
        ui.print_records("Not used", {"record": "record", "reason": "reason"}, unused[:_SHOWN], numbers_from=2)
        if len(unused) > _SHOWN:
            ui.say(f"... and {len(unused) - _SHOWN} more; all are in the output of --json.")
    if any(one.is_broken for one in unused):
        raise typer.Exit(EXIT_NEEDS_ATTENTION)


def list_(known_at: ui.KnownOption = None, map_name: ui.MapOption = None, as_json: ui.JsonOption = False) -> None:
    """List the plans of the map, as known now or at an earlier time."""
    with open_map(map_name) as (conn, info):
        found = store.read_plans(conn, map_name=info.map_name, known_at=ui.parse_known(known_at, None))
    if as_json:
        ui.print_json([{"list_name": one.list_name, **one.plan.model_dump(mode="json")} for one in found])
        return
    columns: ui.Columns = {
        "list": "list_name", "plan": "plan.plan_id", "from (UTC)": "plan.starts_at", "until (UTC)": "plan.ends_at",
        "status": "plan.status", "lanes": lambda one: ", ".join(one.plan.lanes),
    }  # fmt: skip
    ui.print_records("", columns, found, numbers_from=len(columns))
    ui.say(f"{ui.counted(len(found), 'plan')} of map {info.map_name} {ui.known_text(known_at)}")


def compare(
    as_of: ui.AsOfOption = None,
    known_at: ui.KnownOption = None,
    output: Annotated[
        list[Path] | None, typer.Option("--out", help=f"File to write ({', '.join(_SUFFIXES)}); may be repeated.")
    ] = None,
    rules: Annotated[
        Path | None, typer.Option("--rules", help="YAML file of PlanParams that replace the defaults.")
    ] = None,
    lanes: LanesOption = None,
    map_name: ui.MapOption = None,
    as_json: ui.JsonOption = False,
) -> None:
    """Compare planned work zones with those that were found, where drives looked.

    Each row has its time between two drives, its place, the share of the plan that drives passed, images, and a person's verdict.
    """
    for path in output or ():
        if path.suffix.lower() not in _SUFFIXES:
            raise InputError(f"--out {path}: expected a name that ends with {', '.join(_SUFFIXES)}")
    valid_at = ui.parse_instant(as_of)
    with open_map(map_name) as (conn, info):
        found = plans.compare_with_plans(
            conn, map_name=info.map_name, as_of=valid_at, known_at=ui.parse_known(known_at, valid_at), lanes=lanes,
            params=read_yaml_model(rules, PlanParams, "rules"),
        )  # fmt: skip
    for path in output or ():
        _write(path, info.map_name, found)
    if as_json:
        ui.print_json({"map": info.map_name, "at": found.at, "rows": [row.flat() for row in found.rows]})
        return
    columns: ui.Columns = {
        "id": "difference.difference_id", "result": lambda row: row.difference.kind.value, "plan": "difference.plan_id",
        "zone": "difference.zone_id", "what": "difference.text",
        "first seen (UTC)": lambda row: row.difference.first and row.difference.first.at,
        "last seen (UTC)": lambda row: row.difference.last and row.difference.last.at, "verdict": "verdict",
        "confidence": "difference.confidence",
    }  # fmt: skip
    ui.print_records("", columns, found.rows, numbers_from=len(columns) - 1)
    counts = [f"{kind}: {count}" for kind in DifferenceKind if (count := found.counts[kind])]
    ui.say(", ".join(counts) or "No plans, no zones.")


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
        judged = plans.judge(
            conn, difference, verdict, map_name=info.map_name, note=note, decided_by=who_decides(by),
            as_of=ui.parse_instant(as_of),
        )  # fmt: skip
    text = f"Difference {str(judged.difference_id)[:8]} ({judged.kind}): {verdict}"
    ui.answer(as_json, {"difference_id": judged.difference_id, "verdict": verdict}, text)


def _write(path: Path, map_name: str, found: plans.PlanComparison) -> None:
    rows = [row.flat() for row in found.rows]
    if path.suffix.lower() == ".html":
        write_plan_page(path, map_name, found.at, rows, read_settings(map_name).view_url or "")
    elif path.suffix.lower() == ".csv":
        with atomic_text_file(path) as file:
            table = csv.DictWriter(file, [column.name for column in DIFFERENCE_COLUMNS], lineterminator="\n")
            table.writeheader()
            table.writerows(row | {"images": " ".join(row["images"])} for row in rows)
    else:
        features = [
            {"type": "Feature", "id": row["difference_id"], "properties": row,
                "geometry": {"type": "Point", "coordinates": [row["lon_deg"], row["lat_deg"]]}}
            for row in rows
        ]  # fmt: skip
        write_json(path, {"type": "FeatureCollection", "features": features})
