"""`conetl inspect`: what conetl understands of a drive, before anything is computed from it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from conetl.cli.console import JsonOption, out, print_json, print_table
from conetl.model.errors import EXIT_DONE, EXIT_TOO_MANY_REJECTIONS, InputError
from conetl.model.params import IngestParams
from conetl.pipeline.settings import read_settings
from conetl.readers.drives import drive_format, read_drive
from conetl.readers.drives.summary import DriveSummary, summarise
from conetl.reports.drive_image import draw_drive

FORMAT_NAMES = {
    "kitti": "KITTI raw layout", "plain": "plain folder", "euroc": "EuRoC / ASL folder", "bag": "ROS 2 bag or MCAP",
}  # fmt: skip
#: Processor seconds of one whole `conetl ingest`, measured (docs/reference/drives.md): to start, and for a million pixels of left and right
#: pictures.
START_CPU_S = 28.0
CPU_S_PER_MEGAPIXEL = 0.33
_MOST_LINES = 12


def inspect(
    drive: Annotated[Path, typer.Argument(help="Drive folder, bag folder or .mcap file.")],
    picture: Annotated[
        Path | None, typer.Option(help="PNG to draw: the way with gaps and quality, and one pair with rows.")
    ] = None,
    map_srid: Annotated[
        int | None, typer.Option(help="EPSG code of the map; the drive's UTM zone unless given.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Say what is understood of a drive: format, rig, pairs and losses, rate, gaps, quality of the poses, extent, likely time.

    Images are judged by their headers and ends only; nothing is decoded and nothing is written to the map. Exit code 2: the
    drive cannot be ingested; 1: it can, but too many of its pairs are lost.
    """
    settings = read_settings()
    found, rejections = read_drive(drive, map_srid=map_srid, images_folder=settings.images_folder, headers_only=True)
    kind = drive_format(drive) or "kitti"
    summary = summarise(found, rejections)
    seconds = estimated_seconds(summary, settings.workers)
    if picture is not None:
        try:
            draw_drive(picture, found, summary)
        except OSError as error:
            raise InputError(f"{picture}: the picture cannot be written: {error.strerror or error}") from error
    if as_json:
        print_json(
            {
                "format": kind, **summary.model_dump(mode="json"), "estimated_seconds": round(seconds, 1),
                "picture": None if picture is None else str(picture),
            }
        )  # fmt: skip
    else:
        _print(drive, kind, summary, seconds, settings.workers)
        if picture is not None:
            out.print(f"picture: {picture}", markup=False)
    lost = 1.0 - summary.usable_pairs / summary.expected_pairs
    raise typer.Exit(EXIT_TOO_MANY_REJECTIONS if lost > IngestParams().max_rejected_fraction else EXIT_DONE)


def estimated_seconds(summary: DriveSummary, workers: int) -> float:
    """What `conetl ingest` takes where nothing else runs, by processor times measured (docs/reference/drives.md), on this many cores."""
    megapixels = 2e-6 * summary.rig.width_px * summary.rig.height_px * summary.usable_pairs
    return START_CPU_S + CPU_S_PER_MEGAPIXEL * megapixels / workers


def _print(drive: Path, kind: str, summary: DriveSummary, seconds: float, workers: int) -> None:
    rig, poses, extent = summary.rig, summary.poses, summary.extent
    stored = f"{rig.stored_width_px} x {rig.stored_height_px}"
    resampled = (
        f", lens {rig.lens}, resampled to {rig.width_px} x {rig.height_px} when read"
        if rig.rectified_on_reading
        else ", rectified"
    )
    lost = summary.expected_pairs - summary.usable_pairs
    rate = f"{summary.rate_hz:.2f} Hz" if summary.rate_hz else "one pair only"
    rows: list[tuple[str, str]] = [
        ("format", FORMAT_NAMES[kind]),
        ("drive", summary.drive_id),
        ("rig", f"{rig.rig_id}: base {rig.baseline_m:.4f} m, focal length {rig.focal_px:.1f} px"),
        ("pictures", f"{stored}{resampled}"),
        ("calibration covariance", "known" if rig.calibration_covariance_known else "not told by the calibration"),
        ("frame pairs", f"{summary.usable_pairs} of {summary.expected_pairs} usable, {lost} lost"),
        ("recorded", f"{summary.captured_from:%Y-%m-%d %H:%M:%S} to {summary.captured_to:%H:%M:%S} UTC, {rate}"),
        ("way", f"{summary.length_m:.1f} m in {summary.duration_s:.1f} s"),
        ("gaps", f"{len(summary.gaps)}"),
        (
            "pose sigma",
            f"horizontal {poses.horizontal_sigma_median_m:.3f} m (worst {poses.horizontal_sigma_max_m:.3f}), vertical "
            f"{poses.vertical_sigma_median_m:.3f} m, heading {poses.yaw_sigma_median_deg:.2f} degrees",
        ),
        ("jumps of the place", f"{len(poses.jumps)}"),
        ("map", f"EPSG:{summary.map_srid}, east {extent.east_m[0]:.0f} to {extent.east_m[1]:.0f}, "
                f"north {extent.north_m[0]:.0f} to {extent.north_m[1]:.0f}, "
                f"height {extent.height_m[0]:.1f} to {extent.height_m[1]:.1f}"),
        ("lon, lat", f"{extent.lon_deg[0]:.6f}, {extent.lat_deg[0]:.6f} to {extent.lon_deg[1]:.6f}, {extent.lat_deg[1]:.6f}"),
        ("ingest will take", f"about {_duration(seconds)} with {workers} workers and nothing else running (measured elsewhere)"),
    ]  # fmt: skip
    print_table(str(drive), ("what", "understood"), rows, numbers_from=2)
    _print_some("Lost pairs", ("record", "reason", "detail"), [(p.record, p.reason, p.detail) for p in summary.lost])
    _print_some(
        "Gaps",
        ("from frame", "to frame", "seconds", "metres", "in"),
        [(str(g.after_frame), str(g.before_frame), f"{g.seconds:.2f}", f"{g.metres:.1f}", _where(g.in_time, g.in_space))
         for g in summary.gaps],
    )  # fmt: skip
    _print_some(
        "Jumps", ("frame", "off the line (m)"), [(str(jump.frame), f"{jump.off_m:.2f}") for jump in poses.jumps]
    )


def _where(in_time: bool, in_space: bool) -> str:
    return " and ".join(name for name, there in (("time", in_time), ("space", in_space)) if there)


def _print_some(title: str, columns: tuple[str, ...], rows: list[tuple[str, ...]]) -> None:
    """A table of the first rows, and how many more there are."""
    if not rows:
        return
    out.print()
    print_table(title, columns, rows[:_MOST_LINES], numbers_from=len(columns))
    if len(rows) > _MOST_LINES:
        out.print(f"... and {len(rows) - _MOST_LINES} more (--json lists all)")


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
