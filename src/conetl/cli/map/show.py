"""`conetl map show` and `conetl map log`: the cones and their history."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from datetime import datetime
from math import dist
from operator import attrgetter
from typing import Annotated, Any

import typer

from conetl.cli import console as ui
from conetl.cli.database import open_map
from conetl.cli.features import print_features, row_of
from conetl.db.map.decision_store import hold_events, read_decisions
from conetl.db.map.map_store import feature_log, find_features, list_changesets, map_summary, read_features_as_of
from conetl.db.map.results import CommittedChangeset
from conetl.exports.kind_marks import kind_label, kinds_text
from conetl.model.errors import InputError
from conetl.model.feature_classes import noun_of, require_classes
from conetl.model.health import HoldEvent
from conetl.model.map_records import Classification, DeltaKind
from conetl.pipeline.settings import read_settings


def show(
    as_of: ui.AsOfOption = None,
    known_at: ui.KnownOption = None,
    provisional: Annotated[
        bool, typer.Option("--provisional", help="Show the provisional cones of drives being recorded instead.")
    ] = False,
    category: ui.ClassesOption = None,
    map_name: ui.MapOption = None,
    as_json: ui.JsonOption = False,
) -> None:
    """List the cones and other objects on the map."""
    if provisional:
        if as_of or known_at:
            raise InputError("--provisional has no history: omit --as-of and --known-at")
        from conetl.cli.watch import show_provisional

        show_provisional(read_settings(map_name), as_json=as_json)
        return
    with open_map(map_name) as (conn, info):
        summary = map_summary(conn, info.map_name)
        valid_at = ui.parse_instant(as_of)
        known = ui.parse_known(known_at, valid_at)
        versions = list(read_features_as_of(conn, valid_at, known_at=known, map_name=info.map_name, lines=True))
    if category:
        require_classes(category, {*(version.feature.category for version in versions), "all"})
        versions = [version for version in versions if "all" in category or version.feature.category in category]
    if as_json:
        ui.print_json({"map": summary, "features": [v.feature.model_dump(mode="json") for v in versions]})
    elif summary is not None:
        when = f" as of {as_of}" if as_of else ""
        when += f", {ui.known_text(known_at)}" if as_of or known_at else ""
        changesets = ui.counted(summary["changeset_count"], "changeset")
        classes = Counter(version.feature.category for version in versions)
        ui.say(f"Map {info.map_name}, EPSG:{info.srid}: {ui.counted_by_class(classes)}{when}, {changesets}.")
        for table, is_line in (("features", False), ("lane markings", True)):
            shown = [v.feature for v in versions if (v.feature.marking is not None) is is_line]
            print_features(table, [row_of(feature) for feature in shown])


def log(
    feature: Annotated[
        str | None, typer.Argument(help="Id of a feature, or its first characters; default: the changesets of the map.")
    ] = None,
    known_at: Annotated[
        str | None, typer.Option(help="As known at this time; default: now, with what was superseded.")
    ] = None,
    map_name: ui.MapOption = None,
    as_json: ui.JsonOption = False,
) -> None:
    """Show the history of the map, or of one feature."""
    from conetl.reports.drive_passes import reasons_of  # OpenCV takes a while to load

    known = ui.parse_instant(known_at)
    with open_map(map_name) as (conn, info):
        name = info.map_name
        if feature is None:
            changesets = [c for c in list_changesets(conn, map_name=name) if known is None or c.committed_at <= known]
            events = [e for e in hold_events(conn, map_name=name) if known is None or e.at <= known]
        else:
            found = find_features(conn, feature, map_name=name)
            if not found:
                raise InputError(f"the map {name} has no feature {feature}: see `conetl map show`")
            if len(found) > 1:
                raise InputError(f"{feature!r} matches several features: give more characters of the id")
            entries = [entry for entry in feature_log(conn, found[0]) if _is_known(entry, known)]
            classified = read_decisions(conn, map_name=name).classified
            reasons = reasons_of(conn, entries)
    if as_json and feature is None:
        ui.print_json(
            [vars(c) | {"holds": [e for e in events if e.changeset_id == c.changeset_id]} for c in changesets]
        )
    elif as_json:
        ui.print_json([entry | {"why": reason} for entry, reason in zip(entries, reasons, strict=True)])
    elif feature is None:
        # Newest first; what happened at the instant of a commit comes after it.
        rows: list[CommittedChangeset | HoldEvent] = [*reversed(changesets), *events]
        rows.sort(key=lambda row: row.at if isinstance(row, HoldEvent) else row.committed_at)
        markings = any(one.change_counts.lines for one in changesets)
        columns = {
            heading: read for heading, read in _LOG.items() if markings or heading != "stretches of lane markings"
        }
        ui.print_records("", columns, rows[::-1], numbers_from=3)
    else:
        others = {"log_odds": _log_odds, "frame_pairs": _frames, "with": _with, "superseded_(UTC)": "known_to"}
        print_features("history", [entry | {"change": entry["kind"]} for entry in entries], numbers_from=3, **others)
        for entry, reason in zip(entries, reasons, strict=True):
            if entry["known_to"] is None:
                ui.say(reason)
        for one in classified:
            if any(entry["known_to"] is None and _is_about(one, entry) for entry in entries):
                classes = f"{noun_of(one.category)} instead of {noun_of(one.found_as)}"
                ui.say(f"Class corrected by a decision: {classes} (see `conetl map decisions`).")


def _is_known(entry: Mapping[str, Any], at: datetime | None) -> bool:
    return at is None or (entry["known_from"] <= at and (entry["known_to"] is None or at < entry["known_to"]))


def _is_about(decision: Classification, entry: Mapping[str, Any]) -> bool:
    """Whether the decision gives the feature its class."""
    apart_m = dist((entry["easting_m"], entry["northing_m"]), decision.xy_m)
    return entry["category"] == decision.category and apart_m <= decision.radius_m


def _state_of(changeset: CommittedChangeset) -> str:
    return "" if changeset.counts else "on hold" if changeset.hold else "not in effect"


def _frames(entry: Mapping[str, Any]) -> str:
    """In how many frame pairs a drive saw the feature, and in how many it did not although visible."""
    parts = ((entry["frames_seen"], "seen"), (entry["frames_empty"], "empty"))
    return ", ".join(f"{count} {word}" for count, word in parts if count)


def _count_of(kind: DeltaKind) -> Callable[[CommittedChangeset], int]:
    return lambda c: c.change_counts.points[kind]


#: Kinds with a column each.
_COLUMNS = (DeltaKind.ADDED, DeltaKind.CONFIRMED, DeltaKind.MOVED, DeltaKind.REMOVED, DeltaKind.MISSED)
_COUNTS: ui.Columns = {
    **{kind_label(kind): _count_of(kind) for kind in _COLUMNS},
    "other": lambda c: kinds_text({kind: n for kind, n in c.change_counts.points.items() if kind not in _COLUMNS}),
    "stretches of lane markings": lambda c: kinds_text(c.change_counts.lines),
    "quarantined": "rejection_count",
}


def _of_changeset(read: str | Callable[[Any], object]) -> Callable[[Any], object]:
    """A column that is empty for what happened to a drive on hold."""
    reader = attrgetter(read) if isinstance(read, str) else read
    return lambda row: None if isinstance(row, HoldEvent) else reader(row)


_LOG: ui.Columns = {
    "no": "changeset_no",
    "drive": lambda row: f"{row.drive_id} (imported map)" if getattr(row, "kind", "") == "import" else row.drive_id,
    "committed (UTC)": lambda row: row.at if isinstance(row, HoldEvent) else row.committed_at,
    **{heading: _of_changeset(read) for heading, read in _COUNTS.items()},
    "": lambda row: row.sentence if isinstance(row, HoldEvent) else _state_of(row),
}


def _log_odds(entry: Mapping[str, Any]) -> str | None:
    ratio = entry["log_likelihood_ratio"]
    return None if ratio is None else f"{ratio:+.1f}"


def _with(entry: Mapping[str, Any]) -> str:
    return "suppressed" if entry["suppressed"] else ui.cell(entry["other_feature_id"])
