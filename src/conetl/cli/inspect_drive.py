"""`conetl inspect`: the contents of a drive, before anything is computed from it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from operator import itemgetter
from pathlib import Path
from shlex import quote
from typing import Annotated, Any

import typer

from conetl.checks.verdict import judge_all
from conetl.cli import console as ui
from conetl.files.names import minutes
from conetl.model.errors import EXIT_DONE, EXIT_NEEDS_ATTENTION
from conetl.model.health import Verdict
from conetl.model.params import IngestParams
from conetl.perception.checks.stereo_check import check_stereo
from conetl.pipeline.settings import read_settings
from conetl.readers.drives import open_drive, read_drive
from conetl.readers.drives.formats import DriveFormat
from conetl.readers.drives.header import remarks_of
from conetl.readers.drives.summary import DriveSummary, summarise
from conetl.reports.html import render, write_page

#: Processor seconds of one `conetl ingest`, measured (benchmarks/RESULTS.md): at the start, and per million pixels of both
#: images.
START_CPU_S = 28.0
CPU_S_PER_MEGAPIXEL = 0.33
_MAX_LINES = 12


def inspect(
    drive: Annotated[Path, typer.Argument(help="Drive folder, bag folder, .mcap or .bag file.")],
    page: Annotated[
        Path | None,
        typer.Option(help="HTML page to write, with all results, the drive path and one image pair."),
    ] = None,
    map_srid: ui.MapSridOption = None,
    as_json: ui.JsonOption = False,
) -> None:
    """Check a drive before you ingest it: format, rig, lost frame pairs, gaps, pose quality, extent, expected time.

    Reads only the headers and ends of the images and compares five frame pairs; writes nothing to the map. Exit code 2: the
    drive cannot be ingested. Exit code 1: it can, but too many frame pairs are lost, poses jump, or a health check did not pass.
    """
    settings = read_settings()
    opened = open_drive(drive, map_srid=map_srid, images_folder=settings.images_folder, headers_only=True)
    found, rejections = read_drive(opened)
    kind = opened.format
    ui.note(*remarks_of(opened))
    summary = summarise(found, rejections)
    seconds = estimated_seconds(summary, settings.workers)
    checks = [] if kind.UNPACKS else judge_all(check_stereo(found)[1])  # here nothing is unpacked
    facts = _facts(kind, summary, seconds, settings.workers)
    if page is not None:
        from conetl.reports.inspection_images import draw_drive  # matplotlib takes half a second to load

        shown = {"facts": facts, "summary": summary, "checks": checks, "figure": draw_drive(found, summary)}
        write_page(page, render("inspection.html.j2", title=f"Drive {summary.drive_id}", **shown))
    if as_json:
        values = {"format": kind.NAME, **summary.model_dump(mode="json"), "estimated_seconds": round(seconds, 1)}
        values["health"] = [check.model_dump(mode="json") for check in checks]
        ui.print_json({**values, "page": page and str(page)})
    else:
        _print(drive, facts, summary)
        ui.print_all_checks(checks)
        if kind.UNPACKS:
            ui.say(
                "Health checks: not run, because `inspect` does not unpack the images of a bag; `conetl ingest` runs them."
            )
        if page is not None:
            ui.say(f"Page: {page}")
    lost = 1.0 - summary.usable_pairs / summary.expected_pairs
    warned = any(check.verdict in (Verdict.NOTE, Verdict.HOLD) for check in checks)
    doubtful = lost > IngestParams().max_rejected_fraction or summary.poses.jumps or warned
    if not (doubtful or as_json):
        ui.say(f"Next: conetl ingest {quote(str(drive))}")
    raise typer.Exit(EXIT_NEEDS_ATTENTION if doubtful else EXIT_DONE)


def estimated_seconds(summary: DriveSummary, workers: int) -> float:
    """Expected time of `conetl ingest` on this many cores with nothing else running, from measured processor times."""
    megapixels = 2e-6 * summary.rig.width_px * summary.rig.height_px * summary.usable_pairs
    return START_CPU_S + CPU_S_PER_MEGAPIXEL * megapixels / workers


def _facts(kind: DriveFormat, summary: DriveSummary, seconds: float, workers: int) -> list[tuple[str, object]]:
    """Properties of a drive and their values, as a person reads them."""
    rig, poses, extent = summary.rig, summary.poses, summary.extent
    (west, east), (south, north), (low, high) = extent.lon_deg, extent.lat_deg, extent.height_m
    how_read = "rectified"
    if rig.rectified_on_reading:
        how_read = f"lens {rig.lens}, resampled to {rig.width_px} x {rig.height_px} when read"
    rate = f"{summary.rate_hz:.2f} Hz" if summary.rate_hz else "one pair only"
    values: dict[str, object] = {
        "format": kind.TITLE,
        "drive": summary.drive_id,
        "rig": f"{rig.rig_id}: baseline {rig.baseline_m:.4f} m, focal length {rig.focal_px:.1f} px",
        "images": f"{rig.stored_width_px} x {rig.stored_height_px}, {how_read}",
        "calibration covariance": "given" if rig.calibration_covariance_known else "not given",
        "frame pairs": f"{summary.usable_pairs} of {summary.expected_pairs} usable, "
        f"{summary.expected_pairs - summary.usable_pairs} lost",
        "recorded": f"{summary.captured_from:%Y-%m-%d %H:%M:%S} to {summary.captured_to:%H:%M:%S} UTC, {rate}",
        "distance": f"{summary.length_m:.1f} m in {summary.duration_s:.1f} s",
        "gaps": len(summary.gaps),
        "pose sigma": f"horizontal {poses.horizontal_sigma_median_m:.3f} m (worst {poses.horizontal_sigma_max_m:.3f}), vertical "
        f"{poses.vertical_sigma_median_m:.3f} m, heading {poses.yaw_sigma_median_deg:.2f} degrees",
        "position jumps": len(poses.jumps),
        "map": f"EPSG:{summary.map_srid}, east {extent.east_m[0]:.0f} to {extent.east_m[1]:.0f}, "
        f"north {extent.north_m[0]:.0f} to {extent.north_m[1]:.0f}, height {low:.1f} to {high:.1f}",
        "lon, lat": f"{west:.6f}, {south:.6f} to {east:.6f}, {north:.6f}",
        "ingest time": f"about {minutes(seconds)} with {ui.counted(workers, 'worker')} on an idle machine",
    }
    return list(values.items())


def _print(drive: Path, facts: Sequence[tuple[str, object]], summary: DriveSummary) -> None:
    ui.print_table(str(drive), ("property", "value"), facts, numbers_from=2)
    _print_first("Lost pairs", {key: itemgetter(key) for key in ("record", "reason", "detail")}, summary.lost)
    gaps: ui.Columns = {
        "from frame": "after_frame",
        "to frame": "before_frame",
        "seconds": lambda gap: f"{gap.seconds:.2f}",
        "metres": lambda gap: f"{gap.metres:.1f}",
        "in": lambda gap: " and ".join(
            name for name, is_so in (("time", gap.in_time), ("space", gap.in_space)) if is_so
        ),
    }
    _print_first("Gaps", gaps, summary.gaps)
    jumps: ui.Columns = {"frame": "frame", "not explained by its neighbours (m)": lambda jump: f"{jump.off_m:.2f}"}
    _print_first("Position jumps", jumps, summary.poses.jumps)


def _print_first(title: str, columns: Mapping[str, Any], records: Sequence[Any]) -> None:
    """A table of the first records, and how many more there are."""
    if records:
        ui.say()
        ui.print_records(title, columns, records[:_MAX_LINES], numbers_from=len(columns))
        if len(records) > _MAX_LINES:
            ui.say(f"... and {len(records) - _MAX_LINES} more (--json lists all)")
