"""`conetl ingest`: add drives to the map."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path
from tempfile import TemporaryFile
from typing import Annotated

import typer

from conetl.cli import console as ui
from conetl.cli.features import print_features
from conetl.exports.kind_marks import kind_label, kinds_text
from conetl.files.atomic import remove_leftovers
from conetl.files.documents import input_errors, library_errors, read_yaml_model
from conetl.files.home import make_home
from conetl.files.storage import as_path, is_remote
from conetl.model.errors import EXIT_BAD_INPUT, EXIT_DONE, EXIT_NEEDS_ATTENTION, ConetlError, InputError, ServiceError
from conetl.model.feature_classes import CONE, LANE_MARKING, LINE_CLASSES, known_classes
from conetl.model.health import Verdict, hold_checks
from conetl.model.ingest_report import ChangeLine, IngestReport, NeedsAttentionError
from conetl.model.map_records import DeltaKind
from conetl.model.params import DetectionParams, IngestParams
from conetl.perception.model_card import read_model_card
from conetl.pipeline.settings import Settings, prefect_environment, read_settings
from conetl.readers.drives import find_format, read_drive
from conetl.readers.drives.header import DriveHeader, read_header

_log = logging.getLogger(__name__)


def ingest(
    drives: Annotated[list[Path], typer.Argument(help="Drive folders, in any order.")],
    params: ui.ParamsOption = None,
    category: ui.CategoryOption = None,
    map_srid: ui.MapSridOption = None,
    refine: Annotated[bool, typer.Option(help="Refine the recorded poses by visual odometry where possible.")] = True,
    self_calibrate: Annotated[
        bool, typer.Option(help="Correct the calibration if the images contradict it; requires --refine.")
    ] = True,
    map_name: ui.MapOption = None,
    as_json: ui.JsonOption = False,
) -> None:
    """Detect cones or other objects in stereo drives and merge them into the map, one changeset per drive.

    Ingesting a drive again changes nothing. A drive that cannot be used is reported and skipped.
    """
    settings = read_settings(map_name)
    reports, exit_code = ingest_drives(
        drives,
        settings,
        _with_refinement(read_params(params, category, settings), refine=refine, self_calibrate=self_calibrate),
        map_srid=map_srid,
        show=(lambda _: None) if as_json else print_report,
    )
    if as_json:
        ui.print_json(reports)
    elif new := [report for report in reports if not report.is_known]:
        image = settings.drive_image_path(new[0].drive_id)
        drawn = len(new) == 1 and image.is_file()
        ui.say(f"Plan view, with report: {image}" if drawn else f"Plan views and reports: {settings.reports_folder}")
        ui.say(f"To show the map in a browser: conetl view --map {settings.map_name}")
    raise typer.Exit(exit_code)


def ingest_drives(
    drives: Sequence[Path],
    settings: Settings,
    params: IngestParams,
    *,
    map_srid: int | None,
    show: Callable[[IngestReport], None],
) -> tuple[list[IngestReport], int]:
    """Ingest drives one after the other. Returns their reports, and the worst exit code."""
    drives = [as_path(drive) for drive in drives]
    missing = [str(drive) for drive in drives if not drive.is_dir() and find_format(drive) is None]
    if missing and len(missing) == len(drives) and drives[0].is_file():
        raise InputError(
            f"{drives[0]}: is a file, expected a drive folder: put the videos, the GNSS/INS log and the calibration into one "
            "folder and run `conetl init FOLDER`"
        )
    if len(missing) == len(drives):  # before any service is started
        raise InputError(f"{', '.join(missing)}: no such drive folder; check the path")
    headers = [read_header(drive) for drive in drives]
    problems = [problem for header in headers if (problem := _problem_of(header))]
    if len(problems) == len(drives):
        for problem in problems:
            ui.complain(problem)
        return [], EXIT_BAD_INPUT
    ui.note(*(remark for header in headers for remark in header.remarks))
    require_room(settings)
    remove_leftovers((settings.results_folder, settings.exports_folder))
    ui.note_unmeasured(read_model_card(settings.model_path))
    os.environ.update(prefect_environment(settings.home))
    reports: list[IngestReport] = []
    exit_code = EXIT_DONE
    with ExitStack() as running:
        with ui.spinner("Starting Prefect"):
            # Prefect reads its environment when it is imported, which takes two seconds: not at the top of the file.
            from conetl.pipeline.ingest import as_conetl_error
            from flows.ingest_drive import ingest_here
            from flows.server import prefect_server

            _log.info("Prefect server %s", running.enter_context(prefect_server(settings.home)))
        for header in headers:
            _log.info("drive %s", header.path)
            complaints: list[ConetlError | str] = []
            try:
                with ui.progress_bar(header.drive_id, "images and motions") as update:
                    bar = partial(_show_progress, update, header.drive_id)
                    report = ingest_here(header, settings, params, map_srid=map_srid, bar=bar)
            except NeedsAttentionError as error:
                report, complaints = error.report, [error]
            except Exception as raised:
                failure = as_conetl_error(raised)
                if not isinstance(failure, ConetlError):
                    raise
                ui.complain(failure)
                if isinstance(failure, ServiceError):
                    return reports, failure.exit_code
                exit_code = EXIT_BAD_INPUT
                continue
            reports.append(report)
            show(report)
            complaints += report.remarks
            for complaint in complaints:
                ui.complain(complaint)
                exit_code = max(exit_code, EXIT_NEEDS_ATTENTION)
    return reports, exit_code


def _show_progress(update: Callable[..., None], drive_id: str, done: int, total: int) -> None:
    """Show the images and motions that are done; positions and changes follow, which take a few seconds."""
    update(done, total, description=drive_id if done < total else f"{drive_id}: positions and changes")


def require_room(settings: Settings) -> None:
    """Raise InputError if results cannot be written: the folder may be read-only, or its disk full."""
    make_home(settings.home)
    hint = "; set CONETL_HOME to a folder that you can write to"
    with library_errors(f"{settings.home}: cannot be written to", OSError, hint=hint):
        TemporaryFile(dir=settings.results_folder).close()


def _problem_of(header: DriveHeader) -> ConetlError | None:
    """The error that reading a drive would raise, if its header shows it; None if it does not.

    Bags must be unpacked first, and remote storage may be unavailable for a while: the flow checks those.
    """
    if header.problem is None or is_remote(header.path):
        return None
    found = find_format(header.path)
    if found is not None and found.UNPACKS:
        return None
    with suppress(OSError):
        try:
            read_drive(header.path, headers_only=True)
        except InputError as error:
            return error
    return None


def read_params(path: Path | None, categories: Sequence[str] | None, settings: Settings) -> IngestParams:
    """Parameters from a YAML file, or the defaults, and the classes to search for. Raises InputError naming what is wrong."""
    params = read_yaml_model(path, IngestParams, "parameters")
    if not categories:
        return params
    card = read_model_card(settings.model_path)
    card.require_categories(categories, besides=(*LINE_CLASSES, "all"))
    wanted = known_classes({*card.class_names, *LINE_CLASSES}) if "all" in categories else categories
    with input_errors("--category"):
        detection = DetectionParams.model_validate(params.detection.model_dump() | {"categories": wanted})
    return params.model_copy(update={"detection": detection})


def _with_refinement(params: IngestParams, *, refine: bool, self_calibrate: bool) -> IngestParams:
    """The parameters, with refinement or self-calibration switched off as chosen."""
    off = {name: False for name, wanted in (("refine", refine), ("self_calibrate", self_calibrate)) if not wanted}
    return params.model_copy(update={"trajectory": params.trajectory.model_copy(update=off)}) if off else params


#: Kinds of change that are listed even if there are none.
_USUAL = (DeltaKind.ADDED, DeltaKind.CONFIRMED, DeltaKind.MOVED, DeltaKind.REMOVED)
#: Kinds of which each is one of the drive's objects.
_OBSERVED = (DeltaKind.ADDED, DeltaKind.CONFIRMED, DeltaKind.MOVED, DeltaKind.HEIGHT_CHANGED, DeltaKind.SPLIT)


def _row_of(line: ChangeLine) -> dict[str, object]:
    position = dict(zip(("easting_m", "northing_m", "ellipsoidal_height_m"), line.xyz_m, strict=True))
    sigmas = {"sigma_m": line.sigma_horizontal_m, "sigma_u_m": line.sigma_height_m}
    return {**line.model_dump(), **position, **sigmas, "change": line.kind}


def print_report(report: IngestReport) -> None:
    """What one drive changed. Why it, or another drive, went on hold is left to the complaints, which come last."""
    kinds = [kind for kind in DeltaKind if kind in _USUAL or report.counts[kind]]
    counts = ", ".join(f"{report.counts[kind]} {kind_label(kind)}" for kind in kinds)
    lines = kinds_text(report.line_counts)
    at = f" ({report.captured_from:%Y-%m-%d %H:%M} UTC)"
    if report.is_known:
        known = f"already on the map since {report.committed_at:%Y-%m-%d %H:%M} UTC"
        if report.counts_on_map:
            state = f" ({counts}{f'; stretches of lane markings: {lines}' if lines else ''})"
        elif report.on_hold is not None:
            state = ", but on hold (see `conetl drive held`)"
        else:
            state = f", but not in effect: {report.not_counted}"
        ui.say(f"{at}: nothing to do, {known}{state}.", bold=report.drive_id)
        return
    print_features("changes by a drive", [_row_of(line) for line in report.changes], numbers_from=2)
    failed = ", ".join(check.name for check in hold_checks(report.health))
    changed = counts if report.on_hold is None else f"on hold ({failed}), the map is unchanged"
    noun = "object" if {change.category for change in report.changes} - {CONE} else "cone"
    left = _left_out(0 if report.on_hold else report.tracks - sum(report.counts[kind] for kind in _OBSERVED))
    alike = f" ({report.frame_pairs_alike:,} more show the same)" if report.frame_pairs_alike else ""
    ui.say(
        f"{at}: {changed}. {report.frame_pairs} frame pairs{alike} in {report.seconds:.1f} s, "
        f"{report.detections} detections, {report.matches} stereo matches, {ui.counted(report.tracks, noun)}{left}.",
        bold=report.drive_id,
    )
    if lines or (LANE_MARKING in report.categories and report.on_hold is None):
        found = ui.counted(report.markings, "lane marking") if report.markings or lines else "No lane markings found"
        # Their stretches are counted, not they themselves: how many were left out is known only where all were.
        left = _left_out(report.markings if report.line_counts.keys().isdisjoint(_OBSERVED) else 0)
        ui.say(f"{found}{left}; {f'stretches of them: {lines}' if lines else 'none changed on the map'}.")
    if report.trajectory:
        ui.say(f"Trajectory: {report.trajectory}.")
    if report.rejections:
        reasons = ui.counted_by_reason(report.rejections.items())
        ui.say(f"Rejected records: {sum(report.rejections.values())} ({reasons}).")
    ui.print_checks([check for check in report.health if check.verdict is not Verdict.HOLD])
    if report.replayed_drives:
        later = ui.counted(report.replayed_drives, "later drive")
        ui.say(f"{later} over the same roads recomputed.")
    for change in report.hold_changes:
        if change.sentence not in report.remarks:
            ui.say(change.sentence)
    ui.say()


def _left_out(count: int) -> str:
    """The part of a sentence on what the drive shows and the map does not."""
    return f", of which {count} not added (uncertain, or too close to another object)" if count > 0 else ""
