"""`conetl map suppress|pin|revert|decisions|diff`: what people decide about the map, and what differs between two maps."""

from __future__ import annotations

import getpass
from collections.abc import Mapping
from contextlib import closing
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated
from uuid import UUID

import numpy as np
import typer

from conetl.cli.console import JsonOption, out, parse_time, print_json, print_table
from conetl.cli.database import open_map
from conetl.db.connection import Connection
from conetl.db.map.decision_store import list_decisions
from conetl.db.map.map_store import find_map, list_changesets, read_features_as_of
from conetl.exports.diff_geojson import export_diff_geojson
from conetl.mapping.map_diff import diff as diff_of
from conetl.model.errors import InputError
from conetl.model.map_records import FeatureChange, FeatureVersion, MapFeature
from conetl.pipeline.settings import Settings, read_settings
from conetl.reports.plan_view import draw_plan_view

if TYPE_CHECKING:
    from conetl.pipeline.decisions import DecisionOutcome

Feature = Annotated[str, typer.Argument(help="A feature's id, or how it begins.")]
Radius = Annotated[float, typer.Option("--radius", help="Radius of the place in metres, at most 20.")]
Note = Annotated[str, typer.Option("--note", help="Why; kept with the decision.")]
By = Annotated[str | None, typer.Option("--by", help="Who decides; kept with the decision. Default: your login name.")]


def suppress(
    feature: Feature, radius: Radius = 1.0, note: Note = "", by: By = None, as_json: JsonOption = False
) -> None:
    """Nothing stands where this feature is, whatever drives see: a false positive."""
    _decide_place("suppress", feature, radius, note, by, as_json)


def pin(feature: Feature, radius: Radius = 1.0, note: Note = "", by: By = None, as_json: JsonOption = False) -> None:
    """This cone stands: drives may confirm it, but neither remove nor move it."""
    _decide_place("pin", feature, radius, note, by, as_json)


def revert(
    what: Annotated[str, typer.Argument(help="A changeset's number or id, or a decision's id; ids may be cut short.")],
    note: Note = "",
    by: By = None,
    as_json: JsonOption = False,
) -> None:
    """Take back a changeset (its drive does not count any more) or a decision. Nothing is lost: revert the revert to restore."""
    from conetl.pipeline.decisions import revert as take_back

    settings = read_settings()
    with closing(open_map(settings)) as conn:
        decided = take_back(conn, what, map_name=settings.map_name, note=note, decided_by=_who(by))
        numbers = {c.changeset_id: c.changeset_no for c in list_changesets(conn, map_name=settings.map_name)}
    _print(decided, as_json, numbers)


def decisions(as_json: JsonOption = False) -> None:
    """The decisions that hold."""
    settings = read_settings()
    with closing(open_map(settings)) as conn:
        found = list_decisions(conn, map_name=settings.map_name)
    if as_json:
        print_json([asdict(decision) for decision in found])
        return
    rows = [
        (
            str(d.decision_id)[:8],
            d.kind,
            str(d.feature_id or d.changeset_id)[:8],
            f"{d.decided_at:%Y-%m-%d %H:%M:%S}",
            "" if d.easting_m is None else f"{d.easting_m:.3f}",
            "" if d.northing_m is None else f"{d.northing_m:.3f}",
            "" if d.radius_m is None else f"{d.radius_m:g}",
            d.decided_by or "",
            d.note,
        )
        for d in found
    ]
    if rows:
        columns = ("decision", "kind", "about", "decided (UTC)", "easting m", "northing m", "radius m", "by", "note")
        print_table("", columns, rows, numbers_from=4)
    else:
        out.print("No decisions.")


def diff(
    before: Annotated[
        str, typer.Argument(help="A changeset's number (the map right after it), or a time on the road.")
    ],
    after: Annotated[str, typer.Argument(help="Likewise.")],
    output: Annotated[Path | None, typer.Option("--out", help="GeoJSON file to write.")] = None,
    picture: Annotated[
        Path | None, typer.Option("--picture", help="PNG to write: both maps, changes coloured.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """What differs between two states of the map."""
    settings = read_settings()
    with closing(open_map(settings)) as conn:
        info = find_map(conn, settings.map_name)
        if info is None:
            raise InputError(f"there is no map named {settings.map_name} in this database: ingest a drive first.")
        old, new = state_of(conn, settings, before), state_of(conn, settings, after)
    changes = diff_of(old, new)
    if output is not None:
        export_diff_geojson(changes, output, srid=info.srid)
    if picture is not None:
        if not old and not new:
            raise InputError(f"neither {before} nor {after} has a cone on the map: there is nothing to draw")
        changed = {change.feature_id for change in changes}
        draw_plan_view(
            picture,
            title=f"Map {settings.map_name}, EPSG:{info.srid}: {before} to {after}",
            trajectory_m=np.empty((0, 2)),
            deltas=changes,
            untouched=[feature for feature in new if feature.feature_id not in changed],
            untouched_label="no difference",
        )
    if as_json:
        print_json([change.model_dump(mode="json") for change in changes])
        return
    counts = {kind: sum(change.kind == kind for change in changes) for kind in {change.kind for change in changes}}
    out.print(", ".join(f"{count} {kind}" for kind, count in sorted(counts.items())) or "No difference.")
    if changes:
        columns = ("change", "feature", "easting m", "northing m", "height m", "shift m", "old", "new")
        print_table("", columns, [_change_row(change) for change in changes], numbers_from=2)
    if output is not None:
        out.print(f"{len(changes)} changes -> {output}", markup=False)
    if picture is not None:
        out.print(f"picture -> {picture}", markup=False)


def _change_row(change: FeatureChange) -> tuple[object, ...]:
    place = (change.new or change.old or _nothing()).xyz_m
    return (
        change.kind,
        str(change.feature_id)[:8],
        *(f"{value:.3f}" for value in place),
        "" if change.shift_m is None else f"{change.shift_m:.3f}",
        change.old.version if change.old else "",
        change.new.version if change.new else "",
    )


def _nothing() -> MapFeature:
    raise ValueError("a change has an old or a new side")


def state_of(conn: Connection, settings: Settings, name: str) -> list[MapFeature]:
    """The map that `name` stands for: as known right after a changeset, or at a time on the road as known now."""
    valid_at, known_at = instants_of(conn, settings, name)
    versions = read_features_as_of(conn, valid_at, known_at=known_at, map_name=settings.map_name)
    return [version.feature for version in versions]


def instants_of(conn: Connection, settings: Settings, name: str) -> tuple[datetime | None, datetime | None]:
    """Instant on the road and instant of the database that the number of a changeset, or a time, stands for; None: the latest."""
    if name.isdigit() and len(name) < 8:
        changesets = [c for c in list_changesets(conn, map_name=settings.map_name) if c.changeset_no == int(name)]
        if not changesets:
            raise InputError(f"the map {settings.map_name} has no changeset {name}: `conetl map log` lists them")
        return None, changesets[0].committed_at
    return parse_time(name), None


def _decide_place(kind: str, feature: str, radius: float, note: str, by: str | None, as_json: bool) -> None:
    from conetl.pipeline.decisions import decide_place

    settings = read_settings()
    with closing(open_map(settings)) as conn:
        decided = decide_place(
            conn, kind, feature, map_name=settings.map_name, radius_m=radius, note=note, decided_by=_who(by)
        )
    _print(decided, as_json, {})


def _who(by: str | None) -> str:
    try:
        return by or getpass.getuser()
    except (OSError, KeyError) as error:  # a container whose user has no name
        raise InputError("this system does not know your name: say who decides with --by NAME") from error


def _print(decided: DecisionOutcome, as_json: bool, numbers: Mapping[UUID, int]) -> None:
    """numbers: of changesets, by id."""
    if as_json:
        conflicts = [
            {
                name: v.model_dump(mode="json") if isinstance(v, FeatureVersion) else v
                for name, v in one._asdict().items()
            }
            for one in decided.conflicts
        ]
        print_json(decided._asdict() | {"conflicts": conflicts})
        return
    out.print(
        f"Decision {str(decided.decision_id)[:8]} ({decided.kind}): {decided.versions_written} feature versions written, "
        f"{decided.replayed} drives compared with the map again."
    )
    if decided.conflicts:
        out.print("Other drives had something to say about these features too; what they saw is kept:")
        columns = ("feature", "change taken back", "was", "it made of it", "is now", "by changeset")
        rows = [
            (
                str(one.feature_id)[:8],
                one.kind,
                _state_text(one.was, "not there"),
                _state_text(one.changed_to, "?"),
                _state_text(one.is_now, "never there"),
                "" if one.is_now is None else numbers.get(one.is_now.changeset_id, ""),
            )
            for one in decided.conflicts
        ]
        print_table("", columns, rows, numbers_from=5)


def _state_text(version: FeatureVersion | None, nothing: str) -> str:
    """Where a feature stands, in the map's CRS."""
    if version is None:
        return nothing
    if not version.present:
        return "gone"
    x, y, _ = version.feature.xyz_m
    return f"{x:.2f} {y:.2f}" + (" (suppressed)" if version.suppressed else "")
