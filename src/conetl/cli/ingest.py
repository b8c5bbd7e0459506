"""`conetl ingest`: drives into the map."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from contextlib import ExitStack, nullcontext, suppress
from pathlib import Path
from tempfile import TemporaryFile
from typing import Annotated

import typer

from conetl.cli.console import JsonOption, complain, err, note_unmeasured, out, print_json, print_table, progress_bar
from conetl.files.partial_files import sweep
from conetl.files.storage import as_path, is_remote
from conetl.files.yaml_model import read_yaml_model
from conetl.model.errors import (
    EXIT_BAD_INPUT,
    EXIT_DONE,
    EXIT_TOO_MANY_REJECTIONS,
    ConetlError,
    InputError,
    ServiceError,
)
from conetl.model.ingest_report import IngestReport, TooManyRejectionsError
from conetl.model.map_records import DeltaKind
from conetl.model.params import IngestParams
from conetl.perception.model_card import read_model_card
from conetl.pipeline.settings import Settings, prefect_environment, read_settings
from conetl.readers.drives import drive_format, read_drive
from conetl.readers.drives.header import DriveHeader, read_header


def ingest(
    drives: Annotated[list[Path], typer.Argument(help="Drive folders, in any order.")],
    params: Annotated[Path | None, typer.Option(help="YAML file of parameters; see `src/conetl/params.py`.")] = None,
    map_srid: Annotated[
        int | None, typer.Option(help="EPSG code of the map; the drive's UTM zone unless given.")
    ] = None,
    refine: Annotated[
        bool, typer.Option(help="Refine the logged poses by visual odometry, where the pictures allow it.")
    ] = True,
    self_calibrate: Annotated[
        bool,
        typer.Option(
            help="Correct the rig's calibration where the drive's own pictures contradict it; needs --refine."
        ),
    ] = True,
    as_json: JsonOption = False,
) -> None:
    """Find the cones of stereo drives and merge them into the map; each drive is one changeset.

    The same drive again changes nothing and says so. A drive that cannot be used is named, and the others go on.
    """
    reports, exit_code = ingest_drives(
        drives,
        read_settings(),
        _with_refinement(read_params(params), refine=refine, self_calibrate=self_calibrate),
        map_srid=map_srid,
        show=(lambda _: None) if as_json else print_report,
    )
    if as_json:
        print_json([report.model_dump(mode="json") for report in reports])
    raise typer.Exit(exit_code)


def ingest_drives(
    drives: Sequence[Path],
    settings: Settings,
    params: IngestParams,
    *,
    map_srid: int | None,
    show: Callable[[IngestReport], None],
) -> tuple[list[IngestReport], int]:
    """Ingest drives one after the other; the reports and the exit code of the worst of them."""
    drives = [as_path(drive) for drive in drives]
    missing = [str(drive) for drive in drives if not drive.is_dir() and drive_format(drive) is None]
    if len(missing) == len(drives):  # before any service is started
        raise InputError(f"no such drive folder: {', '.join(missing)}")
    headers = [read_header(drive) for drive in drives]
    reasons = [reason for header in headers if (reason := _why_unusable(header))]
    if len(reasons) == len(drives):
        for reason in reasons:
            complain(reason)
        return [], EXIT_BAD_INPUT
    _make_home(settings)
    sweep((settings.results_folder, settings.exports_folder))
    note_unmeasured(read_model_card(settings.model_path))
    os.environ.update(prefect_environment(settings.home))
    reports: list[IngestReport] = []
    exit_code = EXIT_DONE
    with ExitStack() as running:
        with err.status("Starting Prefect") if err.is_terminal else nullcontext():
            # Prefect reads its environment when it is imported, and takes two seconds for it: not at the top of the file.
            from conetl.pipeline.database import MapDatabase
            from conetl.pipeline.ingest import as_known
            from flows.ingest_drive import ingest_by_command
            from flows.server import prefect_server

            running.enter_context(prefect_server(settings.home))
        bars = running.enter_context(progress_bar())
        bar = bars.add_task("", total=None)
        database = running.enter_context(MapDatabase(settings))
        for header in headers:
            bars.update(bar, description=header.drive_id, completed=0, total=None)
            try:
                report = ingest_by_command(
                    header, settings, params, map_srid=map_srid, database=database,
                    progress=lambda done, total: bars.update(bar, completed=done, total=total),
                )  # fmt: skip
            except TooManyRejectionsError as error:
                _take(error.report, reports, show, error)
                exit_code = max(exit_code, EXIT_TOO_MANY_REJECTIONS)
            except Exception as raised:
                failure = as_known(raised)
                if not isinstance(failure, ConetlError):
                    raise
                complain(failure)
                if isinstance(failure, ServiceError):
                    return reports, failure.exit_code
                exit_code = EXIT_BAD_INPUT
            else:
                _take(report, reports, show)
                if report.unpublished:
                    exit_code = max(exit_code, EXIT_TOO_MANY_REJECTIONS)
    return reports, exit_code


def _take(
    report: IngestReport,
    reports: list[IngestReport],
    show: Callable[[IngestReport], None],
    *complaints: ConetlError,
) -> None:
    """Keep and show the report of a drive that is on the map, and what is to be said of it besides."""
    reports.append(report)
    show(report)
    for complaint in complaints:
        complain(complaint)
    if report.unpublished:
        complain(ConetlError(report.unpublished))


def _make_home(settings: Settings) -> None:
    """Folders for services and results. Raises InputError where they cannot be written to."""
    try:
        (settings.home / "prefect").mkdir(parents=True, exist_ok=True)
        settings.results_folder.mkdir(exist_ok=True)
        with TemporaryFile(
            dir=settings.results_folder
        ):  # a folder that is there may still be read-only, or its disk full
            pass
    except OSError as error:
        raise InputError(
            f"{settings.home}: cannot be written to ({error.strerror}); set CONETL_HOME to a folder of yours"
        ) from error


def _why_unusable(header: DriveHeader) -> ConetlError | None:
    """Why a drive cannot be read where its header has a problem; None where the header is not enough to say so.

    Bags have to be unpacked to be read, and remote drives may be unavailable for a while: the flow judges them.
    """
    if header.problem is None or is_remote(header.path) or drive_format(header.path) == "bag":
        return None
    with suppress(OSError):
        try:
            read_drive(header.path, headers_only=True)
        except InputError as error:
            return error
    return None


def read_params(path: Path | None) -> IngestParams:
    """Parameters from a YAML file; the defaults without one. Raises InputError naming what is wrong."""
    return read_yaml_model(path, IngestParams, "parameters")


def _with_refinement(params: IngestParams, *, refine: bool, self_calibrate: bool) -> IngestParams:
    """The parameters as they are, or with refinement or self-calibration switched off."""
    chosen = {"refine": refine, "self_calibrate": self_calibrate}
    off = {name: False for name, wanted in chosen.items() if not wanted}
    return params.model_copy(update={"trajectory": params.trajectory.model_copy(update=off)}) if off else params


#: Kinds of change that are named also where there is none.
_USUAL = (DeltaKind.ADDED, DeltaKind.CONFIRMED, DeltaKind.MOVED, DeltaKind.REMOVED)


def print_report(report: IngestReport) -> None:
    """What one drive changed, for a person."""
    counts = ", ".join(
        f"{report.counts[kind]} {kind.replace('_', ' ')}" for kind in DeltaKind if kind in _USUAL or report.counts[kind]
    )
    when = f"{report.captured_from:%Y-%m-%d %H:%M} UTC"
    if report.status == "no changes":
        out.print(
            f"[bold]{report.drive_id}[/] ({when}): no changes. "
            f"It has been on the map since {report.committed_at:%Y-%m-%d %H:%M} UTC ({counts})."
            if report.counts_on_map
            else f"[bold]{report.drive_id}[/] ({when}): no changes. It is known since {report.committed_at:%Y-%m-%d %H:%M} UTC, "
            "but does not count: it was reverted (see `conetl map decisions`), or analysed again since."
        )
        return
    out.print(
        f"[bold]{report.drive_id}[/] ({when}): {counts}. {report.frame_pairs} frame pairs in {report.seconds:.1f} s, "
        f"{report.detections} detections, {report.matches} stereo matches, {report.tracks} cones."
    )
    if report.trajectory:
        out.print(f"Trajectory: {report.trajectory}.")
    if report.calibration:
        out.print(f"Calibration: {report.calibration}.")
    if report.replayed_drives:
        out.print(
            f"It is older than {report.replayed_drives} drive{'s' if report.replayed_drives > 1 else ''} over the same roads, "
            "which were compared with the map again."
        )
    print_changes(report)
    if report.rejections:
        rows = [(str(reason).replace("_", " "), count) for reason, count in report.rejections.items()]
        print_table("Quarantined", ("reason", "records"), rows)
    out.print()


def print_changes(report: IngestReport) -> None:
    """The table of changes of one drive."""
    rows = [
        (
            line.kind.replace("_", " "),
            str(line.feature_id)[:8],
            f"{line.xyz_m[0]:.3f}",
            f"{line.xyz_m[1]:.3f}",
            f"{line.xyz_m[2]:.3f}",
            f"{line.cone_height_m:.2f}",
            f"{line.sigma_horizontal_m:.3f}",
            "" if line.kind is DeltaKind.REMOVED else f"{line.existence_probability:.3f}",
            line.observation_count,
            "" if line.shift_m is None else f"{line.shift_m:.3f}",
        )
        for line in report.changes
    ]
    if rows:
        columns = (
            "change",
            "feature",
            "easting m",
            "northing m",
            "height m",
            "cone m",
            "sigma m",
            "exists",
            "seen",
            "shift m",
        )
        print_table("", columns, rows, numbers_from=2)
