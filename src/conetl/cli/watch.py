"""`conetl watch`: a drive while it is recorded, on the map as provisional features."""

from __future__ import annotations

import signal
import threading
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from conetl.cli.console import JsonOption, err, out, print_json, print_table
from conetl.cli.database import open_map
from conetl.cli.ingest import read_params
from conetl.db.live_store import read_provisional
from conetl.model.errors import DriveFolderError
from conetl.pipeline.settings import Settings, read_settings

if TYPE_CHECKING:  # onnxruntime and the watcher are loaded when they are needed
    from conetl.pipeline.watch import PairTime, WatchReport

_TOLD_EVERY = 10
_PARTS = (
    "image written -> committed",
    "waiting",
    "detect",
    "match, locate, tracks",
    "commit",
    "processor time on its way",
)


def watch(
    drive: Annotated[Path, typer.Argument(help="Drive folder that is being recorded: KITTI raw or plain.")],
    idle_seconds: Annotated[
        float | None,
        typer.Option(min=0.1, help="End when nothing came for so long; without it only at COMPLETE or Ctrl-C."),
    ] = None,
    max_behind: Annotated[
        float, typer.Option(min=0.05, help="Seconds: older frame pairs are left to the ingest while newer ones wait.")
    ] = 0.5,
    poll: Annotated[
        bool,
        typer.Option("--poll", help="Ask the file system again and again: for NFS and SMB, which tell of no change."),
    ] = False,
    params: Annotated[Path | None, typer.Option(help="YAML file of parameters; see `src/conetl/params.py`.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Put the cones of a drive on the map while it is recorded, as provisional features; ends when the folder holds COMPLETE.

    They are no part of the map's history; `conetl ingest` of the same drive replaces them.
    """
    from conetl.pipeline.watch import watch_drive

    settings, stop = read_settings(), threading.Event()
    before = signal.signal(signal.SIGINT, lambda *_: stop.set())
    try:
        report = watch_drive(
            drive, settings, read_params(params), stop=stop, idle_s=idle_seconds, max_behind_s=max_behind, poll=poll,
            progress=_tell_ready if as_json else _tell,
        )  # fmt: skip
    finally:
        signal.signal(signal.SIGINT, before)
    if not report.drive_id and not stop.is_set():
        raise DriveFolderError(
            f"{drive}: nothing came that makes it a drive ({report.ended_by}): expected image_02/data and image_03/data of "
            "KITTI, or a plain folder's left, right and trajectory.csv; `conetl inspect` says what is missing"
        )
    if as_json:
        print_json(report_as_dict(report))
        return
    out.print(
        f"{report.drive_id or drive}: {len(report.pairs)} frame pairs, {len(report.standing)} provisional cones on map "
        f"{report.map_name}; ended: {report.ended_by}.",
        markup=False,
    )
    if report.refused or report.left_out:
        reasons = [f"{count} {reason.replace('_', ' ')}" for reason, count in sorted(report.refused.items())]
        reasons += [f"{report.left_out} not whole, or too old, when their turn came"] if report.left_out else []
        out.print(f"Not used: {', '.join(reasons)}. The ingest looks at them again.", markup=False)
    figures = latency(report.pairs)
    if figures:
        rows = [(name, *(f"{1000 * f:.0f}" for f in values)) for name, values in figures.items()]
        print_table("Latency of frame pairs that came during the watch, ms", ("", "p50", "p95", "largest"), rows)
    if report.drive_id:
        out.print(f"Now: conetl ingest {drive}", markup=False)


def show_provisional(settings: Settings, *, as_json: bool) -> None:
    """The provisional features of a map (`conetl map show --provisional`)."""
    with closing(open_map(settings)) as conn:
        found = read_provisional(conn, map_name=settings.map_name)
    if as_json:
        print_json({"map": settings.map_name, "provisional_features": found})
        return
    if not found:
        out.print(
            f"The map {settings.map_name} has no provisional cones: `conetl watch DRIVE` shows them.", markup=False
        )
        return
    rows = [
        (
            row["drive_id"], row["feature_index"],
            *(f"{row[name]:.3f}" for name in ("easting_m", "northing_m", "height_m")),
            f"{row['cone_height_m']:.2f}", f"{((row['cov_xx'] + row['cov_yy']) / 2) ** 0.5:.3f}",
            f"{row['existence_probability']:.3f}", row["observation_count"], str(row["near_feature_id"] or "")[:8],
            f"{row['updated_at']:%Y-%m-%d %H:%M:%S}",
        )
        for row in found
    ]  # fmt: skip
    columns = (
        "drive", "no", "easting m", "northing m", "height m", "cone m", "sigma m", "exists", "seen", "on the map as", "at (UTC)"
    )  # fmt: skip
    print_table("", columns, rows)


def latency(pairs: list[PairTime]) -> dict[str, tuple[float, float, float]]:
    """p50, p95 and the largest, in seconds, of each part; of pairs that came while the watch was ready. {} without any."""
    live = [p for p in pairs if not p.backlog]
    if not live:
        return {}
    table = np.array(
        [(p.total_s, p.waited_s, p.work.detect_s, p.work.track_s, p.work.commit_s, p.work.processor_s) for p in live]
    )
    columns = zip(*np.percentile(table, (50, 95, 100), axis=0), strict=True)
    return {name: (float(a), float(b), float(c)) for name, (a, b, c) in zip(_PARTS, columns, strict=True)}


def report_as_dict(report: WatchReport) -> dict[str, Any]:
    """The report as values that JSON knows."""
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


def _tell_ready(report: WatchReport) -> None:
    if not report.pairs:
        err.print("Watching.")


def _tell(report: WatchReport) -> None:
    """A line every few pairs; on a terminal it stays one line."""
    count = len(report.pairs)
    if count == 0:
        _tell_ready(report)
        return
    if not err.is_terminal and count % _TOLD_EVERY:
        return
    figures = latency(report.pairs[-100:])
    shown = ""
    if figures:
        middle, high, _ = figures[_PARTS[0]]
        shown = f", image written -> committed p50 {1000 * middle:.0f} ms, p95 {1000 * high:.0f} ms"
    line = f"frame pair {report.pairs[-1].frame_index}: {len(report.standing)} cones{shown}"
    err.print(line, end="\r" if err.is_terminal else "\n", markup=False)
