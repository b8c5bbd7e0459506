"""`conetl map`: look at the map and take it elsewhere; decisions are in `decisions.py`."""

from __future__ import annotations

from contextlib import closing
from dataclasses import asdict
from typing import Annotated

import typer

from conetl.cli.console import JsonOption, out, parse_time, print_json, print_table
from conetl.cli.database import open_map
from conetl.cli.map import decisions, exchange, picture, work_zones
from conetl.cli.watch import show_provisional
from conetl.db.map.map_store import feature_log, find_features, list_changesets, map_summary, read_features_as_of
from conetl.db.map.results import CommittedChangeset, FeatureLogEntry
from conetl.model.errors import InputError
from conetl.model.records import utc_from_ns
from conetl.pipeline.settings import read_settings

app = typer.Typer(help="Look at the map, decide about it and take it elsewhere.", no_args_is_help=True)
for decide in (decisions.suppress, decisions.pin, decisions.revert, decisions.decisions, decisions.diff):
    app.command()(decide)
for exchanged in (exchange.export, exchange.licence, exchange.qgis):
    app.command()(exchanged)
app.command()(picture.picture)
app.command("import")(exchange.import_)
app.command("check-layout")(work_zones.check_layout_command)


AsOf = Annotated[
    str | None,
    typer.Option(
        "--as-of", help="The map as it stood on the road at this time, e.g. 2026-03-02 or 2026-03-02T10:00+01:00."
    ),
]


@app.command()
def show(
    as_of: AsOf = None,
    provisional: Annotated[
        bool, typer.Option("--provisional", help="Instead, what drives show that are being recorded (`conetl watch`).")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """The cones on the map."""
    settings = read_settings()
    if provisional:
        if as_of:
            raise InputError("--provisional and --as-of do not go together: what drives show now has no history")
        show_provisional(settings, as_json=as_json)
        return
    with closing(open_map(settings)) as conn:
        summary = map_summary(conn, settings.map_name)
        versions = list(read_features_as_of(conn, parse_time(as_of), map_name=settings.map_name))
    if as_json:
        print_json(
            {
                "map": summary and asdict(summary),
                "features": [
                    v.feature.model_dump(mode="json") | {"seen_count": v.seen_count, "missed_count": v.missed_count}
                    for v in versions
                ],
            }
        )
        return
    if summary is None:
        out.print(
            f"The map {settings.map_name} is empty: fill it with `conetl ingest DRIVE` or `conetl map import FILE`.",
            markup=False,
        )
        return
    when = f" as of {as_of}" if as_of else ""
    drives = f"{summary.changeset_count} changeset{'' if summary.changeset_count == 1 else 's'}"
    out.print(f"Map {summary.map_name}, EPSG:{summary.srid}: {len(versions)} cones{when}, {drives}.")
    rows: list[tuple[object, ...]] = [
        (
            str(v.feature.feature_id)[:8],
            v.feature.version,
            *(f"{value:.3f}" for value in v.feature.xyz_m),
            f"{v.feature.cone_height_m:.2f}",
            f"{((v.feature.cov_m2[0] + v.feature.cov_m2[3]) / 2) ** 0.5:.3f}",
            f"{v.feature.existence_probability:.3f}",
            v.feature.observation_count,
            v.seen_count,
            v.missed_count or "",
            f"{utc_from_ns(v.feature.first_seen_ns):%Y-%m-%d %H:%M}",
        )
        for v in versions
    ]
    if rows:
        columns = (
            "feature",
            "version",
            "easting m",
            "northing m",
            "height m",
            "cone m",
            "sigma m",
            "exists",
            "seen",
            "drives",
            "missed",
            "first seen (UTC)",
        )
        print_table("", columns, rows)


@app.command()
def log(
    feature: Annotated[
        str | None, typer.Argument(help="A feature's id, or how it begins; without it the changesets.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """What happened: to one feature, or to the whole map."""
    settings = read_settings()
    with closing(open_map(settings)) as conn:
        if feature is None:
            changesets = list_changesets(conn, map_name=settings.map_name)
            if as_json:
                print_json([asdict(c) for c in changesets])
                return
            rows: list[tuple[object, ...]] = [
                (
                    c.changeset_no,
                    c.drive_id,
                    f"{c.committed_at:%Y-%m-%d %H:%M:%S}",
                    c.added_count,
                    c.confirmed_count,
                    c.moved_count,
                    c.removed_count,
                    c.missed_count,
                    _others(c),
                    c.rejection_count,
                    "" if c.counts else "does not count",
                )
                for c in changesets
            ]
            columns = (
                "no",
                "drive",
                "committed (UTC)",
                "added",
                "confirmed",
                "moved",
                "removed",
                "missed",
                "other",
                "quarantined",
                "",
            )
            print_table("", columns, rows, numbers_from=3)
            return
        found = find_features(conn, feature, map_name=settings.map_name)
        entries = feature_log(conn, found[0]) if len(found) == 1 else []
    if not found:
        raise InputError(f"the map {settings.map_name} knows no feature {feature}: `conetl map show` lists them")
    if len(found) > 1:
        raise InputError(f"{feature!r} is the beginning of several features' ids: write more of it")
    if as_json:
        print_json([asdict(e) for e in entries])
        return
    history: list[tuple[object, ...]] = [
        (
            e.kind.replace("_", " "),
            e.drive_id,
            f"{e.changed_at:%Y-%m-%d %H:%M:%S}",
            "" if e.log_likelihood_ratio is None else f"{e.log_likelihood_ratio:+.1f}",
            _frames(e),
            f"{e.easting_m:.3f}",
            f"{e.northing_m:.3f}",
            f"{e.height_m:.3f}",
            f"{e.existence_probability:.3f}",
            e.observation_count,
            "" if e.shift_m is None else f"{e.shift_m:.3f}",
            "suppressed" if e.suppressed else "" if e.other_feature_id is None else str(e.other_feature_id)[:8],
            "" if e.believed_until is None else f"{e.believed_until:%Y-%m-%d %H:%M:%S}",
        )
        for e in entries
    ]
    history_columns = (
        "change",
        "drive",
        "on the road since (UTC)",
        "log odds",
        "frame pairs",
        "easting m",
        "northing m",
        "height m",
        "exists",
        "seen",
        "shift m",
        "with",
        "believed until (UTC)",
    )
    print_table("", history_columns, history, numbers_from=3)


def _others(changeset: CommittedChangeset) -> str:
    """The rare kinds, as far as there are any."""
    counts = {
        "height changed": changeset.height_changed_count,
        "split": changeset.split_count,
        "merged": changeset.merged_count,
    }
    return ", ".join(f"{count} {kind}" for kind, count in counts.items() if count)


def _frames(entry: FeatureLogEntry) -> str:
    """In how many frame pairs a drive saw it, or looked in vain."""
    parts = ((entry.frames_seen, "seen"), (entry.frames_empty, "empty"))
    return ", ".join(f"{count} {word}" for count, word in parts if count)
