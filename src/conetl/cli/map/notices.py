"""`conetl zones notify|undelivered|history`: notify other systems of work zones, and list their versions."""

from __future__ import annotations

from typing import Annotated

import typer

from conetl.cli import console as ui
from conetl.cli.database import open_map
from conetl.db.map import notice_store as store
from conetl.model.errors import EXIT_NEEDS_ATTENTION, InputError
from conetl.pipeline.maps.notices import notify_receivers, receivers_of, record_notices
from conetl.pipeline.settings import read_settings


def notify(
    again: Annotated[bool, typer.Option("--again", help="Also what was given up.")] = False,
    map_name: ui.MapOption = None,
    as_json: ui.JsonOption = False,
) -> None:
    """Notify the receivers of CONETL_WEBHOOKS which work zones began, changed or ended, and how they differ from plans.

    Schedules do the same every 5 minutes. Exit code 1: a notice could not be delivered; it is tried again later.
    """
    from flows.notices import send_event  # Prefect takes a second to load

    with open_map(map_name) as (conn, info):
        receivers = receivers_of(read_settings(info.map_name), send_event)
        if not receivers:
            raise InputError("CONETL_WEBHOOKS is not set: it names the addresses to be notified, separated by commas")
        if again:
            store.try_again(conn, info.map_id)
        done = notify_receivers(conn, receivers, map_name=info.map_name)
    text = f"{ui.counted(done.recorded, 'new notice')} of map {info.map_name}; {done.delivered} delivered, {done.failed} failed"
    ui.answer(as_json, done._asdict(), text)
    if done.failed:
        raise typer.Exit(EXIT_NEEDS_ATTENTION)


def undelivered(map_name: ui.MapOption = None, as_json: ui.JsonOption = False) -> None:
    """List the notices that could not be delivered, with the reason and the next attempt."""
    with open_map(map_name) as (conn, info):
        rows = store.undelivered(conn, info.map_name)
    if as_json:
        ui.print_json(rows)
        return
    columns: ui.Columns = {
        "no": "notice_no", "receiver": "receiver", "notice": lambda row: f"{row['topic']}.{row['event']}",
        "attempts": "attempts", "next attempt (UTC)": lambda row: row["next_at"] or "given up", "problem": "problem",
    }  # fmt: skip
    ui.print_records("", columns, rows)
    ui.say(f"{ui.counted(len(rows), 'undelivered notice')} of map {info.map_name}")


def history(
    zone: Annotated[str, typer.Argument(help="Id of a work zone, or its first characters; default: all.")] = "",
    known_at: ui.KnownOption = None,
    now: Annotated[bool, typer.Option("--store", help="First store what was written since the last versions.")] = False,
    map_name: ui.MapOption = None,
    as_json: ui.JsonOption = False,
) -> None:
    """List the versions of work zones, as known now or at an earlier time: how each began, changed, was split, merged, ended.

    They are stored after each merge; of maps with more than 500 features by schedules, at night, or with --store.
    """
    with open_map(map_name) as (conn, info):
        if now:
            record_notices(conn, map_name=info.map_name)
        known = ui.parse_known(known_at, None)
        rows = store.read_zone_versions(conn, map_name=info.map_name, beginning=zone.lower(), known_at=known)
        due = store.round_due(conn, info.map_id, most_s=1e9)
    if as_json:
        ui.print_json([{**row, "zone_id": str(row["zone_id"])} for row in rows])
        return
    columns: ui.Columns = {
        "zone": lambda row: row["zone_id"][:8], "version": "version", "event": "event", "stored (UTC)": "recorded_at",
        "start (UTC)": lambda row: row["state"]["start"][:16], "end (UTC)": lambda row: (row["state"]["end"] or "")[:16],
        "length m": lambda row: row["state"]["length_m"], "devices": lambda row: len(row["state"]["devices"]),
        "part of, merged into": lambda row: (row["state"]["merged_into"] or row["state"].get("split_from") or "")[:8],
    }  # fmt: skip
    ui.print_records("", columns, rows, numbers_from=len(columns) - 3)
    count = len({row["zone_id"] for row in rows})
    ui.say(
        f"{ui.counted(len(rows), 'version')} of {ui.counted(count, 'work zone')} of map {info.map_name} {ui.known_text(known_at)}"
    )
    if due["is_due"]:
        ui.say("What was written since the last version is not among them: `conetl zones notify` stores it.")
