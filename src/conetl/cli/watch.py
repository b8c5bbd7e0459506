"""`conetl watch`: provisional features of a drive while it is recorded."""

from __future__ import annotations

import signal
import threading
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from conetl.cli import console as ui
from conetl.cli.database import require_maps
from conetl.cli.ingest import read_params
from conetl.db.live_store import read_provisional
from conetl.geometry.packing import horizontal_sigma_m
from conetl.mapping.reasons import probability_text
from conetl.model.errors import InputError
from conetl.pipeline.database import open_maps
from conetl.pipeline.settings import Settings, read_settings

if TYPE_CHECKING:  # onnxruntime and the watcher are loaded when needed
    from conetl.pipeline.watch import PairTime, WatchReport

_PRINT_EVERY = 10
_PARTS = (
    "image written -> committed",
    "waiting",
    "detect",
    "match, position, track",
    "commit",
    "processor time",
)


def watch(
    drive: Annotated[Path, typer.Argument(help="Drive folder that is being recorded: KITTI raw or plain.")],
    idle_seconds: Annotated[
        float | None,
        typer.Option(min=0.1, help="Stop after this time without new files; default: at COMPLETE or Ctrl-C."),
    ] = None,
    max_behind: Annotated[
        float, typer.Option(min=0.05, help="Skip frame pairs older than this many seconds while newer ones wait.")
    ] = 0.5,
    poll: Annotated[
        bool, typer.Option("--poll", help="Poll the file system. Required on NFS and SMB, which do not report changes.")
    ] = False,
    params: ui.ParamsOption = None,
    map_name: ui.MapOption = None,
    as_json: ui.JsonOption = False,
) -> None:
    """Detect cones while a drive is being recorded and show them as provisional features.

    Stops when the folder contains a file named COMPLETE. Provisional features are not part of the map's history; `conetl ingest`
    of the same drive replaces them.
    """
    from conetl.pipeline.watch import watch_drive

    settings, stop = read_settings(map_name), threading.Event()
    chosen = read_params(params, None, settings)
    before = signal.signal(signal.SIGINT, lambda *_: stop.set())
    try:
        report = watch_drive(
            drive, settings, chosen, stop=stop, idle_s=idle_seconds, max_behind_s=max_behind, poll=poll,
            progress=_print_ready if as_json else _print_progress,
        )  # fmt: skip
    finally:
        signal.signal(signal.SIGINT, before)
    if not report.drive_id and not stop.is_set():
        raise InputError(
            f"{drive}: no drive was recorded here ({report.ended_by}): expected image_02/data and image_03/data of KITTI, or "
            "left, right and trajectory.csv of a plain folder; `conetl inspect` shows what is missing"
        )
    if as_json:
        ui.print_json(report_as_dict(report))
        return
    ui.say(
        f"{report.drive_id or drive}: {ui.counted(len(report.pairs), 'frame pair')}, {len(report.standing)} provisional cones on "
        f"map {report.map_name}; stopped: {report.ended_by}."
    )
    if report.refused or report.left_out:
        reasons = [
            *sorted(report.refused.items()),
            *([("incomplete or too old", report.left_out)] if report.left_out else []),
        ]
        pairs = ui.counted(sum(count for _, count in reasons), "frame pair")
        ui.say(f"Skipped: {pairs} ({ui.counted_by_reason(reasons)}). `conetl ingest` will process them.")
    rows = [(name, *(f"{1000 * s:.0f}" for s in seconds)) for name, seconds in latency(report.pairs).items()]
    ui.print_table("Latency of frame pairs recorded during the watch, ms", ("", "p50", "p95", "max"), rows)
    if report.drive_id:
        ui.say(f"Next: conetl ingest --map {report.map_name} {quote(str(drive))}")


_PROVISIONAL: ui.Columns = {
    "drive": "drive_id",
    "no": "feature_index",
    "easting m": "easting_m",
    "northing m": "northing_m",
    "height m": "ellipsoidal_height_m",
    "object m": lambda row: f"{row['object_height_m']:.2f}",
    "sigma m": lambda row: horizontal_sigma_m((row["cov_xx"], row["cov_xy"], 0.0, row["cov_yy"], 0.0, 0.0)),
    "probability": lambda row: probability_text(row["existence_probability"]),
    "observations": "observation_count",
    "on the map as": lambda row: str(row["near_feature_id"] or "")[:8],
    "updated (UTC)": "updated_at",
}


def show_provisional(settings: Settings, *, as_json: bool) -> None:
    """The provisional features of a map (`conetl map show --provisional`)."""
    with open_maps(require_maps(settings)) as conn:
        found = read_provisional(conn, map_name=settings.map_name)
    if as_json:
        ui.print_json({"map": settings.map_name, "provisional_features": found})
    elif found:
        ui.print_records("", _PROVISIONAL, found)
    else:
        ui.say(f"The map {settings.map_name} has no provisional cones: `conetl watch DRIVE` adds them.")


def latency(pairs: list[PairTime]) -> dict[str, tuple[float, float, float]]:
    """p50, p95 and maximum of each step, in seconds, for pairs recorded after the watch was ready; {} without any."""
    live = [p for p in pairs if not p.backlog]
    if not live:
        return {}
    table = np.array(
        [(p.total_s, p.waited_s, p.work.detect_s, p.work.track_s, p.work.commit_s, p.work.processor_s) for p in live]
    )
    columns = zip(*np.percentile(table, (50, 95, 100), axis=0), strict=True)
    return {name: (float(a), float(b), float(c)) for name, (a, b, c) in zip(_PARTS, columns, strict=True)}


def report_as_dict(report: WatchReport) -> dict[str, Any]:
    """The report as JSON values."""
    return {
        "drive_id": report.drive_id,
        "map": report.map_name,
        "frame_pairs": len(report.pairs),
        "live_frame_pairs": sum(not p.backlog for p in report.pairs),
        "provisional_features": len(report.standing),
        "refused": dict(report.refused),
        "left_out": report.left_out,
        "earlier_watches_cleared": report.cleared,
        "ended_by": report.ended_by,
        "processor_ms_a_pair": round(1000 * report.processor_s / len(report.pairs), 1) if report.pairs else None,
        "latency_ms": {
            name: {"p50": round(1000 * a, 1), "p95": round(1000 * b, 1), "max": round(1000 * c, 1)}
            for name, (a, b, c) in latency(report.pairs).items()
        },
    }


def _print_ready(report: WatchReport) -> None:
    if not report.pairs:
        ui.err.print("Watching.")


def _print_progress(report: WatchReport) -> None:
    """A line every few pairs; on a terminal it is overwritten."""
    _print_ready(report)
    count = len(report.pairs)
    if count == 0 or (not ui.err.is_terminal and count % _PRINT_EVERY):
        return
    figures = latency(report.pairs[-100:])
    shown = ""
    if figures:
        middle, high, _ = figures[_PARTS[0]]
        shown = f", {_PARTS[0]} p50 {1000 * middle:.0f} ms, p95 {1000 * high:.0f} ms"
    line = f"frame pair {report.pairs[-1].frame_index}: {ui.counted(len(report.standing), 'cone')}{shown}"
    ui.err.print(line, end="\r" if ui.err.is_terminal else "\n")
