"""`conetl backfill`: all drives below a folder."""

from __future__ import annotations

import os
from contextlib import ExitStack, closing, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from conetl.cli.console import JsonOption, counted, err, out, parse_time, print_json, print_table
from conetl.cli.database import open_map
from conetl.cli.ingest import read_params
from conetl.db.notification_store import QUIET, untold_changesets
from conetl.model.errors import EXIT_BAD_INPUT, EXIT_DONE, EXIT_SERVICE_MISSING, EXIT_TOO_MANY_REJECTIONS
from conetl.pipeline.settings import prefect_environment, read_settings

if TYPE_CHECKING:
    from conetl.pipeline.backfill_plan import Plan
    from flows.backfill import Standing

_SHOWN = 25


def backfill(
    root: Annotated[Path, typer.Argument(help="Folder with drives, or with folders of drives.")],
    since: Annotated[str | None, typer.Option(help="Drives recorded at this time or later, e.g. 2026-03-01.")] = None,
    until: Annotated[str | None, typer.Option(help="Drives recorded before this time.")] = None,
    max_parallel: Annotated[
        int | None, typer.Option(min=1, help="Drives at the same time; as many as there are workers, or 1 without.")
    ] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Print the plan and do nothing.")] = False,
    recheck: Annotated[bool, typer.Option(help="Compare drives that are on the map by their content as well.")] = False,
    here: Annotated[bool, typer.Option("--here", help="Work in this process also where there are workers.")] = False,
    params: Annotated[Path | None, typer.Option(help="YAML file of parameters; see `src/conetl/params.py`.")] = None,
    map_srid: Annotated[
        int | None, typer.Option(min=1, help="EPSG code of the map; the first drive's UTM zone unless given.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Bring all drives below a folder onto the map that are not there yet, each as a run of its own.

    The plan comes first: what, why, how long. Run it again after a stop: it goes on; what failed is tried again.
    Exit code 2 where drives failed (the others are on the map), 3 where services were missing.
    """
    settings = read_settings()
    parameters = read_params(params)
    os.environ.update(prefect_environment(settings.home))
    from conetl.pipeline.backfill_plan import plan_as_dict, plan_drives

    with closing(open_map(settings)) as conn, err.status("Planning") if err.is_terminal else nullcontext():
        plan = plan_drives(
            conn,
            root,
            settings=settings,
            params=parameters,
            since=parse_time(since),
            until=parse_time(until),
            recheck=recheck,
        )
        untold = untold_changesets(conn, map_name=settings.map_name, quiet=QUIET)
    if dry_run or not (plan.todo or untold):
        if as_json:
            print_json({"plan": plan_as_dict(plan, max_parallel or 1), "drives": []})
        else:
            _print_plan(plan, max_parallel or 1)
        return
    if not as_json:
        _print_plan(plan, max_parallel or 1)
    ended: list[Any] = []
    noted: set[str] = set()
    with ExitStack() as running:
        with err.status("Starting Prefect") if err.is_terminal else nullcontext():
            from flows import backfill as flow
            from flows.server import prefect_server

            running.enter_context(prefect_server(settings.home))
        bar = running.enter_context(_bar())
        task = bar.add_task("", total=100.0)

        def show(standing: Standing) -> None:
            from flows.batch_artifacts import percent, sentence

            bar.update(task, completed=percent(standing), description=sentence(standing))
            if standing.note and standing.note not in noted:
                noted.add(standing.note)
                err.print(f"conetl: {standing.note}", markup=False, soft_wrap=True)
            for receipt in standing.ended[len(ended) :]:
                ended.append(receipt)
                if not as_json:
                    _print_receipt(receipt)

        flow.watch(show)
        try:
            flow.backfill(
                root.absolute(), since=parse_time(since), until=parse_time(until), max_parallel=max_parallel,
                map_name=settings.map_name, map_srid=map_srid, params=parameters, recheck=recheck,
                where="here" if here else "auto", return_state=True,
            ).result()  # fmt: skip
        finally:
            flow.unwatch(show)
    failed = [receipt for receipt in ended if not receipt.done]
    if as_json:
        print_json({"plan": plan_as_dict(plan, max_parallel or 1), "drives": [_receipt_as_dict(r) for r in ended]})
    else:
        out.print(
            f"\nOn map {settings.map_name}: {counted(len(ended) - len(failed), 'drive')}; failed: {len(failed)}.",
            markup=False,
        )
        if failed:
            out.print("Run the same command again to try the failed ones again.", markup=False)
    raise typer.Exit(_exit_code(ended, failed))


def _exit_code(ended: list[Any], failed: list[Any]) -> int:
    if not failed:  # a committed drive has a reason where too much of it was refused
        return EXIT_TOO_MANY_REJECTIONS if any(receipt.reason for receipt in ended) else EXIT_DONE
    return EXIT_SERVICE_MISSING if all(receipt.may_pass for receipt in failed) else EXIT_BAD_INPUT


def _bar() -> Progress:
    columns = (
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TextColumn("{task.description}"),
        TimeElapsedColumn(),
    )
    return Progress(*columns, console=err, disable=not err.is_terminal, transient=True)


def _print_plan(plan: Plan, parallel: int) -> None:
    from conetl.pipeline.backfill_plan import reasons
    from flows.batch_artifacts import minutes

    span = " to ".join(f"{t:%Y-%m-%d %H:%M}" if t else "..." for t in (plan.since, plan.until))
    within = f", recorded {span}" if plan.since or plan.until else ""
    out.print(
        f"{counted(len(plan.lines), 'drive')} below {plan.root}{within}; map {plan.map_name}; planned in {plan.seconds:.1f} s.",
        markup=False,
    )
    if not plan.lines:
        return
    print_table("", ("plan", "drives"), reasons(plan))
    estimate = plan.estimate_s(parallel)
    how_long = (
        "how long is not known before the first drive is done"
        if estimate is None
        else f"about {minutes(estimate)}, {parallel} at a time, as earlier drives took"
    )
    out.print(
        f"{counted(plan.count('ingest'), 'drive')} with {counted(plan.frame_pairs, 'frame pair')} to ingest"
        f"{': ' + how_long if plan.count('ingest') else ''}.",
        markup=False,
    )
    rows = [
        (
            line.header.drive_id[:60],
            f"{line.header.captured_from:%Y-%m-%d %H:%M}" if line.header.captured_from else "?",
            {"ingest": "ingest", "wait": "wait", "skip": "-", "refuse": "not usable"}[line.action],
            line.why[:110],
            line.header.frame_pairs,
        )
        for line in plan.lines
    ]
    print_table("", ("drive", "recorded (UTC)", "plan", "why", "pairs"), rows[:_SHOWN], numbers_from=4)
    if len(rows) > _SHOWN:
        out.print(f"... and {len(rows) - _SHOWN} more; --dry-run --json lists all.", markup=False)


def _print_receipt(receipt: Any) -> None:
    if receipt.done:
        took = f" in {receipt.seconds:.1f} s" if receipt.seconds else ""
        note = f"; {receipt.reason}" if receipt.reason else ""
        word = "on the map" if receipt.state == "committed" else "was on the map already"
        out.print(f"{receipt.drive_id}: {word}{took}{note}", markup=False)
    else:
        out.print(f"{receipt.drive_id}: {receipt.state}: {receipt.reason}", markup=False)


def _receipt_as_dict(receipt: Any) -> dict[str, Any]:
    names = (
        "drive_id",
        "drive_path",
        "state",
        "reason",
        "may_pass",
        "changeset_id",
        "content_sha256",
        "frame_pairs",
        "seconds",
    )
    return {name: getattr(receipt, name) for name in names}
