"""`conetl map suppress|pin|classify|revert|decisions`, `conetl drive held|accept`: decisions of people about the map."""

from __future__ import annotations

import getpass
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Literal
from uuid import UUID

import typer

from conetl.cli import console as ui
from conetl.cli.database import open_map
from conetl.db.connection import Connection
from conetl.db.map.decision_store import held_drives, list_decisions
from conetl.db.map.map_store import list_changesets
from conetl.exports.kind_marks import kind_label
from conetl.model.errors import EXIT_NEEDS_ATTENTION, InputError
from conetl.model.map_records import FeatureVersion
from conetl.pipeline.settings import read_settings

if TYPE_CHECKING:
    from conetl.pipeline.maps.decisions import DecisionOutcome

Feature = Annotated[str, typer.Argument(help="Id of a feature, or its first characters.")]
Radius = Annotated[float, typer.Option("--radius", help="Radius around the feature in metres, at most 20.")]
Note = Annotated[str, typer.Option("--note", help="Reason; stored with the decision.")]
By = Annotated[str | None, typer.Option("--by", help="Who decides; stored with the decision. Default: login name.")]


def suppress(
    feature: Feature,
    radius: Radius = 1.0,
    note: Note = "",
    by: By = None,
    map_name: ui.MapOption = None,
    as_json: ui.JsonOption = False,
) -> None:
    """Mark a feature as a false positive. No drive can add a cone at this location again."""
    _decide_place("suppress", feature, radius, note, by, map_name, as_json)


def pin(
    feature: Feature,
    radius: Radius = 1.0,
    note: Note = "",
    by: By = None,
    map_name: ui.MapOption = None,
    as_json: ui.JsonOption = False,
) -> None:
    """Pin a cone: drives can confirm it, but cannot move or remove it."""
    _decide_place("pin", feature, radius, note, by, map_name, as_json)


def classify(
    feature: Feature,
    category: Annotated[str, typer.Argument(metavar="CLASS", help="Class of the object, such as drum.")],
    radius: Radius = 1.0,
    note: Note = "",
    by: By = None,
    map_name: ui.MapOption = None,
    as_json: ui.JsonOption = False,
) -> None:
    """Correct the class of an object that the detector classifies wrongly here."""
    _decide_place("classify", feature, radius, note, by, map_name, as_json, category)


def revert(
    what: Annotated[
        str, typer.Argument(help="Number or id of a changeset, or id of a decision; ids may be abbreviated.")
    ],
    note: Note = "",
    by: By = None,
    map_name: ui.MapOption = None,
    as_json: ui.JsonOption = False,
) -> None:
    """Undo a changeset or a decision. Nothing is deleted: revert the revert to restore it."""
    from conetl.pipeline.maps import decisions

    with open_map(map_name) as (conn, info):
        decided = decisions.revert(conn, what, map_name=info.map_name, note=note, decided_by=who_decides(by))
        numbers = {c.changeset_id: c.changeset_no for c in list_changesets(conn, map_name=info.map_name)}
        if not as_json:
            _print_conflicts(decided, numbers)
        finish(conn, decided, info.map_name, as_json)


def _print_conflicts(decided: DecisionOutcome, numbers: Mapping[UUID, int]) -> None:
    """What other drives changed after a reverted changeset. numbers: of changesets."""
    if not decided.conflicts:
        return
    ui.say("Other drives changed these features too; their changes are kept:")
    columns: ui.Columns = {
        "feature": "feature_id",
        "change undone": lambda conflict: kind_label(conflict.kind),
        "before": lambda conflict: _state_text(conflict.was, "absent"),
        "after": lambda conflict: _state_text(conflict.changed_to, "?"),
        "now": lambda conflict: _state_text(conflict.is_now, "absent"),
        "by changeset": lambda conflict: conflict.is_now and numbers.get(conflict.is_now.changeset_id),
    }
    ui.print_records("", columns, decided.conflicts, numbers_from=5)


def decisions(map_name: ui.MapOption = None, as_json: ui.JsonOption = False) -> None:
    """List the active decisions."""
    with open_map(map_name) as (conn, info):
        found = list_decisions(conn, map_name=info.map_name)
        numbers = {one.changeset_id: one.changeset_no for one in list_changesets(conn, map_name=info.map_name)}
    if as_json:
        ui.print_json(found)
        return
    columns: ui.Columns = {
        "decision": "decision_id",
        "kind": "kind",
        "about": lambda decision: decision.feature_id or f"changeset {numbers[decision.changeset_id]}",
        "decided (UTC)": "decided_at",
        "easting m": "easting_m",
        "northing m": "northing_m",
        "radius m": lambda decision: decision.radius_m and f"{decision.radius_m:g}",
        "class": "category",
        "by": "decided_by",
        "note": "note",
    }
    ui.print_records("", columns, found, numbers_from=4)
    if not found:
        ui.say("No decisions.")


def held(map_name: ui.MapOption = None, as_json: ui.JsonOption = False) -> None:
    """List the drives on hold, and why."""
    with open_map(map_name) as (conn, info):
        found = held_drives(conn, map_name=info.map_name)
        known = {one.changeset_id: one for one in list_changesets(conn, map_name=info.map_name)}
    if as_json:
        ui.print_json([vars(known[one.changeset_id]) | one.model_dump(mode="json") for one in found])
        return
    ui.print_held(found, info.map_name)
    if not found:
        ui.say("No drive is on hold.")


def accept(
    drive: Annotated[str, typer.Argument(help="Drive on hold: its id, or the number of its changeset.")],
    note: Note = "",
    by: By = None,
    map_name: ui.MapOption = None,
    as_json: ui.JsonOption = False,
) -> None:
    """Accept a drive on hold: merge it into the map, and recompute later drives over the same roads."""
    from conetl.pipeline.maps.decisions import accept_drive

    with open_map(map_name) as (conn, info):
        decided = accept_drive(conn, drive, map_name=info.map_name, note=note, decided_by=who_decides(by))
        finish(conn, decided, info.map_name, as_json)


def _decide_place(
    kind: Literal["suppress", "pin", "classify"],
    feature: str,
    radius: float,
    note: str,
    by: str | None,
    map_name: str | None,
    as_json: bool,
    category: str | None = None,
) -> None:
    from conetl.pipeline.maps.decisions import decide_location

    with open_map(map_name) as (conn, info):
        decided = decide_location(
            conn, kind, feature, map_name=info.map_name, radius_m=radius, category=category, note=note,
            decided_by=who_decides(by),
        )  # fmt: skip
        finish(conn, decided, info.map_name, as_json)


def who_decides(by: str | None) -> str:
    """The name that is stored with a decision: as given, or that of the login."""
    try:
        return by or getpass.getuser()
    except (OSError, KeyError) as error:  # a container whose user has no name
        raise InputError("the login name is unknown: state who decides with --by NAME") from error


def finish(conn: Connection, decided: DecisionOutcome, map_name: str, as_json: bool) -> None:
    """Print what a decision did, and write the QA reports of the drives again whose state it changed. Exits with 1 where a report
    cannot be written: the decision is made."""
    if as_json:
        ui.print_json(decided._asdict() | {"conflicts": [conflict._asdict() for conflict in decided.conflicts]})
    else:
        ui.say(
            f"Decision {str(decided.decision_id)[:8]} ({decided.kind}): "
            f"{ui.counted(decided.versions_written, 'feature version')} written, "
            f"{ui.counted(decided.replayed, 'drive')} recomputed."
        )
        if decided.replaced_by is not None:
            ui.say(f"This drive has no effect: changeset {decided.replaced_by}, a later delivery, replaced it.")
        for change in decided.hold_changes:
            ui.say(change.sentence)
    from conetl.pipeline.publish import publish_decision  # matplotlib takes half a second to load

    problem = publish_decision(conn, decided, read_settings(map_name))
    if problem is not None:
        ui.complain(problem)
        raise typer.Exit(EXIT_NEEDS_ATTENTION)


def _state_text(version: FeatureVersion | None, nothing: str) -> str:
    """Position of a feature in the map's CRS, or that it does not exist."""
    if version is None:
        return nothing
    if not version.present:
        return "removed"
    x, y, _ = version.feature.xyz_m
    return f"{x:.2f} {y:.2f}" + (" (suppressed)" if version.suppressed else "")
