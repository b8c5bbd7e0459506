"""`conetl backfill`: add all drives below a folder."""

from __future__ import annotations

import os
from collections import Counter
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from conetl.cli import console as ui
from conetl.cli.ingest import read_params
from conetl.db.map.map_store import read_changes
from conetl.db.map.results import MapInstant
from conetl.db.receipt_store import QUIET, pending_changesets
from conetl.exports.kind_marks import kinds_text
from conetl.files.names import minutes
from conetl.model.errors import EXIT_BAD_INPUT, EXIT_DONE, EXIT_NEEDS_ATTENTION, EXIT_SERVICE_MISSING
from conetl.model.map_records import DeltaKind
from conetl.pipeline.database import open_maps
from conetl.pipeline.settings import Settings, prefect_environment, read_settings

if TYPE_CHECKING:
    from conetl.db.receipt_store import Receipt
    from conetl.pipeline.backfill_plan import Plan
    from flows.backfill import Standing

_SHOWN = 25


def backfill(
    root: Annotated[Path, typer.Argument(help="Folder with drives, or with folders of drives.")],
    since: Annotated[str | None, typer.Option(help="Only drives recorded since this time, e.g. 2026-03-01.")] = None,
    until: Annotated[
        str | None, typer.Option(help="Only drives recorded before this time, or up to the end of this day.")
    ] = None,
    max_parallel: Annotated[
        int | None, typer.Option(min=1, help="Drives to run in parallel; default: one per worker, 1 without workers.")
    ] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Print the plan and exit.")] = False,
    recheck: Annotated[bool, typer.Option(help="Also compare the content of drives already on the map.")] = False,
    reanalyse: Annotated[
        bool, typer.Option("--reanalyse", help="Also analyse drives again that another version of conetl analysed.")
    ] = False,
    here: Annotated[
        bool, typer.Option("--here", help="Run the drives as child processes, even if workers are running.")
    ] = False,
    params: ui.ParamsOption = None,
    category: ui.CategoryOption = None,
    map_srid: ui.MapSridOption = None,
    map_name: ui.MapOption = None,
    as_json: ui.JsonOption = False,
) -> None:
    """Ingest all drives below a folder that are not on the map yet, one run per drive.

    Prints the plan first: which drives, why, how long it will take, and what in the folder is no drive. If it was interrupted,
    run it again to continue and to retry failed drives. Exit code 1: a drive is on hold, or an entry is no drive. Exit code 2:
    some drives would fail again. Exit code 3: all failures may be temporary (a service, a disk, a crash). The other drives are on
    the map.
    """
    settings = read_settings(map_name)
    parameters = read_params(params, category, settings)
    os.environ.update(prefect_environment(settings.home))
    from conetl.pipeline.backfill_plan import plan_as_dict, plan_drives

    begin, end = ui.parse_span(since, until, ("--since", "--until"))
    with open_maps(settings) as conn, ui.spinner("Planning"):
        plan = plan_drives(
            conn, root, settings=settings, params=parameters, since=begin, until=end, recheck=recheck, reanalyse=reanalyse,
        )  # fmt: skip
        pending = pending_changesets(conn, map_name=settings.map_name, quiet=QUIET)
    facts: dict[str, Any] = {"held": [], "hold_events": [], "plan": plan_as_dict(plan, max_parallel or 1)}
    facts |= {"drives": [], "not_drives": []}
    if not as_json:
        _print_plan(plan, max_parallel or 1)
    if dry_run or not (plan.has_news or pending):
        if as_json:
            ui.print_json(facts)
        raise typer.Exit(EXIT_NEEDS_ATTENTION if plan.open_lines else EXIT_DONE)
    with ExitStack() as running:
        with ui.spinner("Starting Prefect"):
            from flows import backfill as flow
            from flows.server import prefect_server

            running.enter_context(prefect_server(settings.home))
        bar = running.enter_context(_bar())
        task = bar.add_task("", total=100.0)
        standing, printed, noted = flow.Standing(plan, 1, "here", 0.0, [], []), 0, ""

        def show(now: Standing) -> None:
            nonlocal standing, printed, noted
            bar.update(task, completed=now.percent, description=now.sentence)
            if now.note != noted:
                ui.err.print(f"conetl: {now.note}", soft_wrap=True)
            for receipt in [] if as_json else now.ended[printed:]:
                bar.stop()
                _print_receipt(receipt)
                bar.start()
            standing, printed, noted = now, len(now.ended), now.note

        running.enter_context(flow.watch_batch(show))
        state = flow.backfill(
            str(root.absolute()), since=begin, until=end, max_parallel=max_parallel,
            map_name=settings.map_name, map_srid=map_srid, params=parameters, recheck=recheck,
            reanalyse=reanalyse, where="here" if here else "auto", return_state=True,
        )  # fmt: skip
        if state.name not in (flow.SOME_FAILED, flow.SOME_ON_HOLD, flow.NOT_RECOGNISED):
            state.result()
    difference = _difference(settings, plan) if reanalyse else {}
    if as_json:
        drives = [_receipt_as_dict(receipt) for receipt in standing.ended]
        strays = [_receipt_as_dict(receipt) for receipt in standing.strays]
        facts |= {"held": standing.held, "hold_events": standing.hold_events, "drives": drives, "not_drives": strays}
        ui.print_json(facts | ({"difference": difference} if reanalyse else {}))
    else:
        _print_summary(standing)
        if reanalyse:
            counts = kinds_text(difference) or "no differences"
            ui.say(f"The map now, compared with what was known before: {counts}.")
    raise typer.Exit(_exit_code(standing))


def _difference(settings: Settings, plan: Plan) -> dict[DeltaKind, int]:
    """How the map differs from what was known of the same roads before the batch: number of features by kind."""
    with open_maps(settings) as conn:
        changes = read_changes(conn, MapInstant(known_at=plan.made_at), MapInstant(), map_name=settings.map_name)
    return dict(Counter(change.kind for change in changes))


def _print_summary(standing: Standing) -> None:
    """What became of the drives of a batch, those on hold first."""
    ui.say()
    for receipt in standing.strays:
        _print_receipt(receipt)
    ui.print_held(standing.held, standing.plan.map_name)
    ui.print_hold_events(standing.hold_events)
    failed = standing.failed
    may_pass = sum(receipt.may_pass for receipt in failed)
    on_hold = f"on hold: {len(standing.held)}; " if standing.held else ""
    strays = f"; no drive: {len(standing.strays)}" if standing.strays else ""
    ui.say(
        f"On map {standing.plan.map_name}: {ui.counted(standing.done, 'drive')}; {on_hold}failed: {len(failed)}{strays}."
    )
    if may_pass:
        ui.say(f"The failure of {ui.counted(may_pass, 'drive')} may be temporary: run the same command again to retry.")
    if may_pass < len(failed):
        rest = ui.counted(len(failed) - may_pass, "drive")
        ui.say(f"{rest} would fail again: correct the problems listed above first.")


def _exit_code(standing: Standing) -> int:
    if not (failed := standing.failed):  # a committed drive has a reason if too many of its records were rejected
        person = standing.held or standing.plan.open_lines or any(one.reason for one in standing.ended)
        return EXIT_NEEDS_ATTENTION if person else EXIT_DONE
    return EXIT_SERVICE_MISSING if all(receipt.may_pass for receipt in failed) else EXIT_BAD_INPUT


def _bar() -> Progress:
    columns = (
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TextColumn("{task.description}"),
        TimeElapsedColumn(),
    )
    return Progress(*columns, console=ui.err, disable=not ui.err.is_terminal, transient=True, redirect_stdout=False)


_ACTIONS = {"ingest": "ingest", "wait": "wait", "skip": "-", "refuse": "not usable"}


def _print_plan(plan: Plan, parallel: int) -> None:
    from conetl.pipeline.backfill_plan import reason_counts

    span = " to ".join(f"{t:%Y-%m-%d %H:%M}" if t else "..." for t in (plan.since, plan.until))
    recorded = f", recorded {span}" if plan.since or plan.until else ""
    drives = ui.counted(sum(not line.is_stray for line in plan.lines), "drive")
    strays = sum(line.is_stray for line in plan.lines)
    drives += f", and {strays} entries that are none," if strays else ""
    ui.say(f"{drives} below {plan.root}{recorded}; map {plan.map_name}; planned in {plan.seconds:.1f} s.")
    if not plan.lines:
        return
    ui.print_table("", ("plan", "drives"), reason_counts(plan))
    how_long = ""
    if plan.count("ingest"):
        how_long = ": time unknown until the first drive is done"
        if (estimate := plan.estimate_s(parallel)) is not None:
            how_long = f": about {minutes(estimate)}, {parallel} at a time, from the times of earlier drives"
    ui.say(
        f"{ui.counted(plan.count('ingest'), 'drive')} with {ui.counted(plan.frame_pairs, 'frame pair')} to ingest{how_long}."
    )
    columns: ui.Columns = {
        "drive": lambda line: line.header.drive_id[:60],
        "recorded (UTC)": lambda line: f"{at:%Y-%m-%d %H:%M}" if (at := line.header.captured_from) else "?",
        "plan": lambda line: _ACTIONS.get(line.action, line.action),
        "why": lambda line: line.reason.removeprefix(f"{line.action}: "),
        "pairs": lambda line: line.header.frame_pairs,
    }
    ui.print_records("", columns, plan.lines[:_SHOWN], numbers_from=4)
    if len(plan.lines) > _SHOWN:
        ui.say(f"... and {len(plan.lines) - _SHOWN} more; --dry-run --json lists all.")
    if remarks := [remark for line in plan.lines if line.action == "ingest" for remark in line.header.remarks]:
        others = f" ({ui.counted(len(remarks) - 1, 'more note')} like this)" if remarks[1:] else ""
        ui.note(remarks[0] + others)


def _print_receipt(receipt: Receipt) -> None:
    if not receipt.done:
        ui.say(f"{receipt.drive_id}: {receipt.state}: {receipt.reason}")
    elif receipt.state == "held":
        ui.say(receipt.reason)
    else:
        took = f" in {receipt.seconds:.1f} s" if receipt.seconds else ""
        reason = f"; {receipt.reason}" if receipt.reason else ""
        ui.say(f"{receipt.drive_id}: {'on' if receipt.state == 'committed' else 'already on'} the map{took}{reason}")


def _receipt_as_dict(receipt: Receipt) -> dict[str, Any]:
    names = (
        "drive_id", "drive_path", "state", "reason", "may_pass", "changeset_id", "content_sha256", "frame_pairs", "seconds"
    )  # fmt: skip
    return {name: getattr(receipt, name) for name in names}
