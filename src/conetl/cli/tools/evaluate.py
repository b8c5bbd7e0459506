"""`conetl evaluate` and `conetl lidar-check`: drives against surveyed cones, with plots, and against their own LiDAR."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from conetl.cli import console as ui
from conetl.cli.ingest import read_params
from conetl.evaluation.drive_evaluation import (
    DriveEvaluation,
    as_dict,
    evaluate_drive,
    false_in_words,
    pooled_tables,
    write_evaluation,
    write_pooled_page,
)
from conetl.evaluation.lidar_check import ResidualBand, summarise
from conetl.evaluation.lidar_drive import lidar_residuals
from conetl.evaluation.markings import TRUTH_FILE, read_truth_markings
from conetl.evaluation.truth import TABLE_3_COLUMNS, TruthCone, median_error, read_truth_cones
from conetl.model.errors import InputError
from conetl.model.feature_classes import LANE_MARKING, LINE_CLASSES, known_classes
from conetl.model.params import IngestParams
from conetl.perception.model_card import read_model_card
from conetl.pipeline.settings import Settings, read_settings
from conetl.readers.drives import read_drive
from conetl.reports.html import Section

if TYPE_CHECKING:
    from conetl.pipeline.analysis import AnalysedDrive

_COLUMNS = (
    "range m",
    "matches",
    "median m",
    "median |m|",
    "robust std m",
    "std of residual / sigma",
    "within 2 sigmas",
)


def evaluate(
    drives: Annotated[list[Path], typer.Argument(metavar="DRIVE", help="Drive folders.")],
    truth: Annotated[
        Path | None,
        typer.Option(
            help="truth.csv with the surveyed cones of all drives, see data/README.md; default: truth.csv of each drive."
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--out",
            help="Folder for page and plots, with a subfolder per drive if there are several; default: "
            "exports/evaluate/<drive>.",
        ),
    ] = None,
    params: ui.ParamsOption = None,
    category: ui.CategoryOption = None,
    within_m: Annotated[
        float, typer.Option(min=0.1, help="Ignore surveyed cones farther than this from the drive path.")
    ] = 20.0,
    as_json: ui.JsonOption = False,
) -> None:
    """Compare the cones of drives with surveyed ground truth: errors of each cone, over range, and consistency of the sigmas.

    With --category lane_marking it compares lane markings with truth_markings.geojson of the drive. Several drives are evaluated
    separately and pooled: by chance, one value in twenty is outside its 95 % band. Writes nothing to the map; needs no database.
    """
    settings = read_settings()
    chosen = read_params(params, category, settings)
    truths = _truths_of(drives, truth, chosen.detection.categories)
    folder = output or settings.exports_folder / "evaluate"
    done: dict[str, DriveEvaluation] = {}
    answers: list[dict[str, object]] = []
    for drive, (file, cones, srid) in truths.items():
        results = analyse_folder(drive, settings, chosen, map_srid=srid)
        name = results.drive.drive_id
        if name in done:
            raise InputError(f"{drive}: has the same drive id, {name}, as another folder; evaluate each drive once")
        marking_truth, markings = drive / TRUTH_FILE, None
        if marking_truth.is_file() and LANE_MARKING in chosen.detection.categories:
            markings = read_truth_markings(marking_truth, results.drive.map_srid)
        one = evaluate_drive(cones, results, within_m=within_m, markings=markings)
        done[name] = one
        summary = _summary(results, one, within_m)
        files = write_evaluation(folder if output is not None and len(truths) == 1 else folder / name, one, summary)
        if not as_json:
            _print(file, one, summary, files[-1])
        facts = {"drive_id": name, "map_srid": results.drive.map_srid, "frame_pairs": len(results.drive.frame_pairs)}
        answers.append(
            {**facts, "trajectory": results.trajectory.detail, **one.as_dict(), "files": [str(file) for file in files]}
        )
    if len(done) == 1:
        if as_json:
            ui.print_json(answers[0])
        return
    together = list(done.values())
    page = write_pooled_page(folder, together)
    if as_json:
        ui.print_json({"drives": answers, "pooled": as_dict(together), "files": [str(page)]})
        return
    ui.say(bold=f"{len(done)} drives together")
    _print_tables(pooled_tables(together))
    ui.say(f"\n{page}: all drives on one page")


def _truths_of(
    drives: Sequence[Path], truth: Path | None, categories: Collection[str]
) -> dict[Path, tuple[Path, list[TruthCone], int | None]]:
    """File, objects of these categories and EPSG code of the truth of each drive, all read before the first drive is analysed.

    Where lane markings alone are searched for, their file, no objects, and None, as its coordinates are longitudes and latitudes.
    Raises InputError if a drive is given twice or has no truth.
    """
    only_lines = set(categories) <= set(LINE_CLASSES)
    if only_lines and truth is not None:
        raise InputError(
            f"--truth names surveyed objects; the true lane markings are in {TRUTH_FILE} of each drive: omit it, or search for "
            "objects too, with --category"
        )
    truths: dict[Path, tuple[Path, list[TruthCone], int | None]] = {}
    for drive in drives:
        if any(drive.resolve() == other.resolve() for other in truths):
            raise InputError(f"{drive} is given twice")
        if not drive.is_dir():
            raise InputError(f"{drive}: no such drive folder; check the path")
        if only_lines:
            if not (drive / TRUTH_FILE).is_file():
                raise InputError(f"{drive}: contains no {TRUTH_FILE}, which data/README.md describes")
            truths[drive] = (drive / TRUTH_FILE, [], None)
            continue
        file = truth or drive / "truth.csv"
        if not file.is_file() and truth is None:
            raise InputError(f"{drive}: contains no truth.csv; give a file of surveyed cones with --truth")
        known, srid = read_truth_cones(file)
        searched = [cone for cone in known if cone.category in categories]
        if not searched:
            wanted, present = (
                ", ".join(known_classes(names)) for names in (categories, {cone.category for cone in known})
            )
            raise InputError(f"{file}: contains no {wanted}, only {present}; choose classes with --category")
        truths[drive] = (file, searched, srid)
    return truths


def analyse_folder(
    folder: Path, settings: Settings, params: IngestParams, *, map_srid: int | None = None
) -> AnalysedDrive:
    """Read and analyse one drive without server and database; results of chunks are kept as in an ingest. Raises ConetlError."""
    from conetl.pipeline.analysis import analyse

    drive, rejections = read_drive(folder, map_srid=map_srid, images_folder=settings.images_folder.resolve())
    ui.note_unmeasured(read_model_card(settings.model_path))
    with ui.progress_bar(drive.drive_id, "images and motions") as update:
        return analyse(drive, params, rejections=rejections, settings=settings, progress=update)


def _summary(results: AnalysedDrive, evaluation: DriveEvaluation, within_m: float) -> list[str]:
    cones = (
        f"{evaluation.found} of {len(evaluation.lines)} cones within {within_m:g} m of the drive path found, "
        f"{false_in_words([evaluation])}"
    )
    sentences = [
        *([cones] if evaluation.lines else []),
        f"{len(results.drive.frame_pairs)} frame pairs, {len(results.records.positions)} positions, "
        f"{len(results.records.rejections)} rejections.",
        results.trajectory.detail,
    ]
    if evaluation.missed:
        sentences.append(f"Missed: {', '.join(evaluation.missed)}.")
    median = median_error(evaluation.lines)
    if median is not None:
        figures = evaluation.figures["tracks"]
        sentences.append(
            f"Median 3D error of the tracks {median:.3f} m, CE90 {figures.ce90_m:.3f} m, LE90 {figures.le90_m:.3f} m."
        )
    if evaluation.markings is not None:
        lines = evaluation.markings.figures
        found = lines.truth_m * (lines.completeness or 0.0)
        sentences.append(
            f"{found:.0f} of {lines.truth_m:.0f} m of lane markings found, "
            f"{lines.found_m * (1.0 - (lines.correctness or 0.0)):.0f} m of false ones."
        )
    return sentences


def _print(truth: Path, evaluation: DriveEvaluation, summary: Sequence[str], page: Path) -> None:
    ui.say(f" compared with {truth}", bold=evaluation.drive_id)
    _print_tables(evaluation.tables())
    ui.say("\n" + "\n".join(summary))
    ui.say(f"\n{page}: everything on one page\n")


def _print_tables(tables: Sequence[Section]) -> None:
    for table in tables:
        ui.say()
        ui.print_table(
            table.heading, table.columns, table.rows, numbers_from=2 if table.columns is TABLE_3_COLUMNS else 1
        )
        ui.say(table.note)


def lidar_check(
    drive: Annotated[Path, typer.Argument(help="Drive folder in the KITTI layout with velodyne_points.")],
    self_calibrate: Annotated[
        bool, typer.Option(help="First correct the calibration if the images of the drive contradict it.")
    ] = True,
    as_json: ui.JsonOption = False,
) -> None:
    """Compare stereo ranges of cones with the drive's own LiDAR, with and without a correction of the calibration."""
    with ui.progress_bar("LiDAR check", "scans") as update:
        check = lidar_residuals(
            drive, model_path=read_settings().model_path, self_calibrate=self_calibrate, progress=update
        )
    scene = check.scene
    bands, corrected = summarise(check.residuals), summarise(check.corrected)
    if as_json:
        bias = scene and scene._asdict() | {"coefficients_px": scene.coefficients_px.tolist()}
        ui.print_json(
            {
                "scan_count": check.scan_count,
                "calibration": check.calibration,
                "bands": [band._asdict() for band in bands],
                "bands_without_scene_bias": [band._asdict() for band in corrected] if scene else None,
                "scene": bias,
                "residuals": [residual._asdict() for residual in check.residuals],
                "problems": check.problems,
            }
        )
        return
    ui.say(f"{check.scan_count} scans, {len(check.residuals)} refined matches with LiDAR points.")
    ui.say(f"Calibration: {check.calibration}.")
    ui.print_table("Stereo minus LiDAR", _COLUMNS, [_cells(band) for band in bands])
    if scene is not None:
        ui.say(
            f"Scene without cones ({scene.sample_count} windows): {scene.range_offset_m:+.3f} m beyond LiDAR, disparities "
            f"{float(scene.coefficients_px[0]):+.2f} px off in the centre."
        )
        ui.print_table("Without the calibration error of the scene", _COLUMNS, [_cells(band) for band in corrected])
    for problem in check.problems:
        ui.say(f"not used: {problem}")


def _cells(band: ResidualBand) -> tuple[Any, ...]:
    figures = (band.median_m, band.median_abs_m, band.robust_std_m, band.ratio_std, band.within_2_sigmas)
    return (f"{band.from_m:g}-{band.to_m:g}", band.pairs, *("-" if x is None else x for x in figures))
