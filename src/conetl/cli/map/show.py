"""`conetl map show` and `conetl map log`: the cones and their history."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from itertools import pairwise
from math import dist, sqrt
from operator import attrgetter
from typing import Annotated, Any

import typer

from conetl.cli import console as ui
from conetl.cli.database import open_map
from conetl.db.map.decision_store import hold_events, read_decisions
from conetl.db.map.map_store import feature_log, find_features, list_changesets, map_summary, read_features_as_of
from conetl.db.map.results import CommittedChangeset
from conetl.exports.kind_marks import kind_label
from conetl.geometry.packing import horizontal_sigma_m
from conetl.mapping.reasons import probability_text
from conetl.model.base import utc_from_ns
from conetl.model.errors import InputError
from conetl.model.feature_classes import noun_of, require_classes
from conetl.model.health import HoldEvent
from conetl.model.map_records import Classification
from conetl.model.markings import Marking
from conetl.pipeline.settings import read_settings

_FEATURES: ui.Columns = {
    "feature": lambda v: v.feature.feature_id,
    "class": lambda v: v.feature.category,
    "version": lambda v: v.feature.version,
    "easting m": lambda v: v.feature.xyz_m[0],
    "northing m": lambda v: v.feature.xyz_m[1],
    "height m": lambda v: v.feature.xyz_m[2],
    "object m": lambda v: f"{v.feature.cone_height_m:.2f}",
    "sigma horiz. m": lambda v: horizontal_sigma_m(v.feature.cov_m2),
    "sigma height m": lambda v: sqrt(v.feature.cov_m2[5]),
    "probability": lambda v: probability_text(v.feature.existence_probability),
    "observations": lambda v: v.feature.observation_count,
    "drives": "seen_count",
    "not observed": lambda v: v.missed_count or "",
    "first seen (UTC)": lambda v: f"{utc_from_ns(v.feature.first_seen_ns):%Y-%m-%d %H:%M}",
}
_LINES: ui.Columns = {
    **{heading: read for heading, read in _FEATURES.items() if heading not in ("class", "object m", "not observed")},
    "length m": lambda v: f"{_length_m(v.feature.marking):.1f}",
    "width m": lambda v: f"{v.feature.marking.width_m:.2f}",
    "paint": lambda v: f"{v.feature.marking.colour}, {v.feature.marking.pattern}",
    "not observed": _FEATURES["not observed"],
}


def _length_m(marking: Marking) -> float:
    return float(sum(dist(a[:2], b[:2]) for a, b in pairwise(marking.vertices_m)))


def show(
    as_of: Annotated[
        str | None,
        typer.Option(help="State of the road at this time, e.g. 2026-03-02 or 2026-03-02T10:00+01:00."),
    ] = None,
    provisional: Annotated[
        bool, typer.Option("--provisional", help="Show the provisional cones of drives being recorded instead.")
    ] = False,
    category: Annotated[
        list[str] | None, typer.Option(help="Only objects of this class, such as drum; may be repeated.")
    ] = None,
    map_name: ui.MapOption = None,
    as_json: ui.JsonOption = False,
) -> None:
    """List the cones and other objects on the map."""
    if provisional:
        if as_of:
            raise InputError("--provisional and --as-of cannot be used together: provisional cones have no history")
        from conetl.cli.watch import show_provisional

        show_provisional(read_settings(map_name), as_json=as_json)
        return
    with open_map(map_name) as (conn, info):
        summary = map_summary(conn, info.map_name)
        versions = list(read_features_as_of(conn, ui.parse_instant(as_of), map_name=info.map_name, lines=True))
    if category:
        require_classes(category, {*(version.feature.category for version in versions), "all"})
        versions = [version for version in versions if "all" in category or version.feature.category in category]
    if as_json:
        features = [
            v.feature.model_dump(mode="json") | {"seen_count": v.seen_count, "missed_count": v.missed_count}
            for v in versions
        ]
        ui.print_json({"map": summary, "features": features})
    elif summary is not None:
        when = f" as of {as_of}" if as_of else ""
        changesets = ui.counted(summary["changeset_count"], "changeset")
        classes = Counter(version.feature.category for version in versions)
        ui.say(f"Map {info.map_name}, EPSG:{info.srid}: {ui.counted_by_class(classes)}{when}, {changesets}.")
        points, lines = ([v for v in versions if (v.feature.marking is not None) is one] for one in (False, True))
        ui.print_records("", ui.class_if_mixed(_FEATURES, {v.feature.category for v in points}), points)
        ui.print_records("", _LINES, lines)


def log(
    feature: Annotated[
        str | None, typer.Argument(help="Id of a feature, or its first characters; default: the changesets of the map.")
    ] = None,
    map_name: ui.MapOption = None,
    as_json: ui.JsonOption = False,
) -> None:
    """Show the history of the map, or of one feature."""
    from conetl.reports.drive_passes import reasons_of  # OpenCV takes a while to load

    with open_map(map_name) as (conn, info):
        name = info.map_name
        if feature is None:
            changesets = list_changesets(conn, map_name=name)
            events = hold_events(conn, map_name=name)
        else:
            found = find_features(conn, feature, map_name=name)
            if not found:
                raise InputError(f"the map {name} has no feature {feature}: see `conetl map show`")
            if len(found) > 1:
                raise InputError(f"{feature!r} matches several features: give more characters of the id")
            entries = feature_log(conn, found[0])
            classified = read_decisions(conn, map_name=name).classified
            reasons = reasons_of(conn, name, found[0], entries)
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
        markings = any(one.line_counts for one in changesets)
        columns = {
            heading: read for heading, read in _LOG.items() if markings or heading != "stretches of lane markings"
        }
        ui.print_records("", columns, rows[::-1], numbers_from=3)
    else:
        ui.print_records(
            "", ui.class_if_mixed(_HISTORY, {entry["category"] for entry in entries}), entries, numbers_from=3
        )
        for entry, reason in zip(entries, reasons, strict=True):
            if entry["believed_until"] is None:
                ui.say(reason)
        for one in classified:
            if any(entry["believed_until"] is None and _is_about(one, entry) for entry in entries):
                classes = f"{noun_of(one.category)} instead of {noun_of(one.found_as)}"
                ui.say(f"Class corrected by a decision: {classes} (see `conetl map decisions`).")


def _is_about(decision: Classification, entry: Mapping[str, Any]) -> bool:
    """Whether the decision gives the feature its class."""
    apart_m = dist((entry["easting_m"], entry["northing_m"]), decision.xy_m)
    return entry["category"] == decision.category and apart_m <= decision.radius_m


def _others(changeset: CommittedChangeset) -> str:
    """The rare kinds of changes, if any."""
    counts = {kind: getattr(changeset, f"{kind}_count") for kind in ("height_changed", "split", "merged")}
    return ", ".join(f"{count} {kind_label(kind)}" for kind, count in counts.items() if count)


def _state_of(changeset: CommittedChangeset) -> str:
    return "" if changeset.counts else "on hold" if changeset.hold else "not in effect"


def _frames(entry: Mapping[str, Any]) -> str:
    """In how many frame pairs a drive saw the feature, and in how many it did not although visible."""
    parts = ((entry["frames_seen"], "seen"), (entry["frames_empty"], "empty"))
    return ", ".join(f"{count} {word}" for count, word in parts if count)


_COUNTS: ui.Columns = {
    "added": "added_count",
    "confirmed": "confirmed_count",
    "moved": "moved_count",
    "removed": "removed_count",
    "not observed": "missed_count",
    "other": _others,
    "stretches of lane markings": lambda c: ", ".join(
        f"{count} {kind_label(kind)}" for kind, count in sorted(c.line_counts.items())
    ),
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
_HISTORY: ui.Columns = {
    "change": lambda e: kind_label(e["kind"]),
    "class": "category",
    "drive": "drive_id",
    "on the road since (UTC)": "changed_at",
    "log odds": lambda e: None if e["log_likelihood_ratio"] is None else f"{e['log_likelihood_ratio']:+.1f}",
    "frame pairs": _frames,
    "easting m": "easting_m",
    "northing m": "northing_m",
    "height m": "height_m",
    "probability": lambda e: probability_text(e["existence_probability"]),
    "observations": "observation_count",
    "shift m": "shift_m",
    "with": lambda e: "suppressed" if e["suppressed"] else ui.cell(e["other_feature_id"]),
    "superseded (UTC)": "believed_until",
}
