"""What Prefect's UI shows of a batch of drives: a bar that moves, a table of drives, a summary."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any, cast
from uuid import UUID

from prefect import artifacts

from conetl.files.names import as_markdown, minutes
from conetl.model.health import HeldDrive, HoldEvent, hold_remedy
from conetl.pipeline.backfill_plan import reason_counts

if TYPE_CHECKING:
    from flows.backfill import Standing

#: The table is written again at most this often: each time it is a new artifact, which is large with a thousand drives.
_TABLE_EVERY_S = 600.0
_SHOWN_ROWS = 300


def batch_progress(standing: Standing) -> Callable[[Standing], None]:
    """The progress bar of a batch that begins: a callback that moves it, and writes the table from time to time."""
    bar = cast(UUID, artifacts.create_progress_artifact(0.0, key="batch-progress", description=sentence(standing)))
    table_at = 0.0

    def show(now: Standing) -> None:
        nonlocal table_at
        artifacts.update_progress_artifact(bar, percent(now), description=sentence(now))
        if time.monotonic() - table_at > _TABLE_EVERY_S:
            _write_table(now)
            table_at = time.monotonic()

    return show


def show_summary(standing: Standing) -> None:
    """Write the summary of a batch."""
    _write_table(standing)
    plan = standing.plan
    lines = [
        *_held_lines(standing),
        f"## {standing.done} drives committed to map {plan.map_name}, {len(standing.failed)} failed",
        "",
        f"{len(plan.lines)} drives below {as_markdown(plan.root)}, planned in {plan.seconds:.1f} s, "
        f"done in {standing.seconds:.0f} s, {standing.parallel} at a time "
        f"({'by workers' if standing.where == 'workers' else 'in this process'}).",
        "",
        *_table("plan, drives", [(as_markdown(reason), count) for reason, count in reason_counts(plan)]),
    ]
    if standing.failed:
        rows = [map(as_markdown, (r.drive_id, r.drive_path, r.reason)) for r in standing.failed[:_SHOWN_ROWS]]
        lines += _table("failed, recorded in, reason", rows)
        lines.append("Run the same backfill again to retry the failed drives; drives on the map are skipped.")
    artifacts.create_markdown_artifact(
        "\n".join(lines), key="batch-summary", description=f"{standing.done} of {standing.todo} drives"
    )


def _held_lines(standing: Standing) -> list[str]:
    """The drives on hold, and what happened to them during the batch; nothing without any."""
    lines: list[str] = []
    if standing.held:
        held = []
        for drive in standing.held[:_SHOWN_ROWS]:
            remedy = as_markdown(hold_remedy(drive.changeset_no, standing.plan.map_name))
            held += [
                (_named(drive), check.name, check.figures, f"{as_markdown(check.detail)} {remedy}")
                for check in drive.checks
            ]
        lines += [f"## {len(standing.held)} on hold", "", *_table("drive, check, measured, what to do", held)]
    if standing.hold_events:
        shown = standing.hold_events[:_SHOWN_ROWS]
        events = [(f"{one.at:%Y-%m-%d %H:%M:%S}", _named(one), as_markdown(one.sentence)) for one in shown]
        lines += _table("time (UTC), drive, holds and releases", events)
    return lines


def _named(drive: HeldDrive | HoldEvent) -> str:
    return f"{as_markdown(drive.drive_id)} (changeset {drive.changeset_no})"


def _table(headings: str, rows: Iterable[Iterable[object]]) -> list[str]:
    """Lines of a table in Markdown, and an empty one. headings: with commas between them."""
    head = headings.split(", ")
    return [*(f"| {' | '.join(map(str, row))} |" for row in (head, ["---"] * len(head), *rows)), ""]


def _write_table(standing: Standing) -> None:
    ended = {receipt.header_sha256: receipt for receipt in standing.ended}
    running = {run.line.header.header_sha256 for run in standing.running}
    rows: list[dict[str, Any]] = []
    for line in standing.plan.lines:
        receipt = ended.get(line.header.header_sha256) if line.action != "skip" else None
        state: str
        if receipt is not None:
            state, why = receipt.state, receipt.reason
        elif line.action == "skip":
            state, why = "nothing to do", line.why
        else:
            state, why = ("running" if line.header.header_sha256 in running else "waiting"), line.why
        rows.append(
            {
                "drive": as_markdown(line.header.drive_id),
                "recorded": f"{line.header.captured_from:%Y-%m-%d %H:%M}" if line.header.captured_from else "",
                "frame pairs": line.header.frame_pairs,
                "state": state,
                "seconds": round(receipt.seconds, 1) if receipt is not None and receipt.seconds else None,
                "why": as_markdown(why),
            }
        )
    order = ("failed", "crashed", "held", "running", "waiting", "committed", "known", "nothing to do")
    rows.sort(key=lambda row: order.index(row["state"]))
    note = f"; the first {_SHOWN_ROWS} are shown" if len(rows) > _SHOWN_ROWS else ""
    artifacts.create_table_artifact(rows[:_SHOWN_ROWS], key="batch-drives", description=f"{len(rows)} drives{note}")


def percent(standing: Standing) -> float:
    if pairs := standing.plan.frame_pairs:
        return min(100.0, 100.0 * standing.pairs_done / pairs)
    return 100.0 * len(standing.ended) / max(1, standing.todo)


def sentence(standing: Standing) -> str:
    left = standing.left_s
    rate = f", {standing.pairs_done / standing.seconds:.1f} frame pairs per second" if standing.pairs_done else ""
    when = "" if left is None else f", about {minutes(left)} left"
    counts = f"{len(standing.ended)} of {standing.todo} drives ({len(standing.failed)} failed), {len(standing.running)} running"
    return counts + rate + when
