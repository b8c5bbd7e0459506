"""`conetl evaluate`: drives against surveyed cones, with plots and one page to pass on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from conetl.cli.console import JsonOption, out, print_json, print_table
from conetl.cli.ingest import read_params
from conetl.cli.tools.drive_results import analyse_folder
from conetl.cli.tools.pooled_drives import (
    NEES_COLUMNS,
    DriveErrors,
    as_dict,
    nees_rows,
    pool,
    print_pooled,
    write_pooled_page,
)
from conetl.cli.tools.truth_table import line_as_dict, median_error, print_table_3, read_truth_cones, table_3_rows
from conetl.evaluation.accuracy import (
    ConsistencyReport,
    ErrorStatistics,
    PointErrors,
    RangeBand,
    by_range,
    consistency_report,
    drive_consistency,
    members_of,
    position_errors,
    single_nees,
    statistics,
    track_errors,
)
from conetl.evaluation.truth import TruthCone, TruthLine, compare_with_truth
from conetl.geometry.rig import map_SE3_left
from conetl.model.errors import InputError
from conetl.model.records import Track
from conetl.pipeline.settings import read_settings
from conetl.reports.accuracy_page import Section, write_accuracy_page

if TYPE_CHECKING:
    from conetl.pipeline.analysis import AnalysedDrive

_STATISTICS = ("", "estimates", "median 3D", "RMSE 3D", "RMSE E", "N", "up", "bias E", "N", "up", "CE90", "LE90")
_BANDS = (
    "range m", "estimates", "median 3D", "RMSE along", "across", "up", "stated along", "across", "up", "bias along"
)  # fmt: skip
_NEES_WORDS = (
    "NEES: the sum of squared errors over their stated covariance. Relative: the errors that the whole drive has in common "
    "(GNSS/INS) are taken out. Common: those errors themselves. Absolute: both. One per degree of freedom is right."
)
_TABLE_3 = ("cone", "", "easting", "northing", "height", "range", "cone height", "3D error")


@dataclass(frozen=True)
class _Evaluation:
    lines: list[TruthLine[Track]]
    false: list[Track]
    path_m: np.ndarray[Any, np.dtype[np.float64]]
    tracks: PointErrors
    singles: PointErrors
    figures: dict[str, ErrorStatistics]
    bands: list[RangeBand]
    nees: dict[str, ConsistencyReport]

    @property
    def found(self) -> int:
        return sum(line.feature is not None for line in self.lines)


def evaluate(
    drives: Annotated[list[Path], typer.Argument(metavar="DRIVE...", help="Drive folders.")],
    truth: Annotated[
        Path | None,
        typer.Option(
            help="truth.csv: the surveyed cones, of all drives; see data/README.md for its columns. "
            "Each drive's own truth.csv unless given."
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--out",
            help="Folder for the page and the plots (of several drives: a folder each, and a page of all); "
            "exports/evaluate/<drive> unless given.",
        ),
    ] = None,
    params: Annotated[Path | None, typer.Option(help="YAML file of parameters; see `src/conetl/params.py`.")] = None,
    within_m: Annotated[
        float, typer.Option(min=0.1, help="Cones farther than this from the path are not asked for.")
    ] = 20.0,
    as_json: JsonOption = False,
) -> None:
    """Compare the cones of drives with surveyed truth: the paper's Table 3, errors over range, and whether sigmas hold.

    Several drives are compared one by one, and judged together: one in twenty leaves a 95 % band by chance.
    Nothing is put on the map and no database is needed.
    """
    truths = _truths_of(drives, truth)
    settings = read_settings()
    chosen = read_params(params)
    folder = output or settings.exports_folder / "evaluate"
    done: dict[str, tuple[Path, _Evaluation, dict[str, object]]] = {}
    for drive, (file, cones, srid) in truths.items():
        results = analyse_folder(drive, settings, chosen, map_srid=srid)
        name = results.drive.drive_id
        if name in done:
            raise InputError(f"{drive} and {done[name][0]} are both drive {name}: a drive counts once")
        evaluation = _compare(drive, file, cones, results, within_m)
        own = folder if output is not None and len(truths) == 1 else folder / name
        files = _write(own, results, evaluation, within_m)
        done[name] = drive, evaluation, _as_dict(results, evaluation, files)
        if not as_json:
            if len(done) > 1:
                out.print()
            _print(file, results, evaluation, files, within_m)
    if len(done) == 1:
        if as_json:
            print_json(next(iter(done.values()))[2])
        return
    together = pool(
        {
            name: DriveErrors(len(one.lines), one.found, len(one.false), one.tracks, one.singles)
            for name, (_, one, _) in done.items()
        }
    )
    page = write_pooled_page(folder / "index.html", together)
    if as_json:
        print_json({"drives": [words for _, _, words in done.values()], **as_dict(together), "files": [str(page)]})
        return
    out.print()
    print_pooled(together)
    out.print(f"\n{page}: all drives on one page", markup=False)


def _truths_of(drives: Sequence[Path], truth: Path | None) -> dict[Path, tuple[Path, list[TruthCone], int]]:
    """File, cones and EPSG code of the truth of each drive; all are read before the first drive costs any time.

    Raises InputError where a drive is given twice or has no truth.
    """
    truths: dict[Path, tuple[Path, list[TruthCone], int]] = {}
    for drive in drives:
        if any(drive.resolve() == other.resolve() for other in truths):
            raise InputError(f"{drive} is given twice: a drive counts once")
        if not drive.is_dir():
            raise InputError(f"no such drive folder: {drive}")
        file = truth or drive / "truth.csv"
        if not file.is_file() and truth is None:
            raise InputError(f"{drive} has no truth.csv: name the surveyed cones by --truth")
        truths[drive] = (file, *read_truth_cones(file))
    return truths


def _compare(drive: Path, file: Path, cones: list[TruthCone], results: AnalysedDrive, within_m: float) -> _Evaluation:
    path_m = np.array([map_SE3_left(pair.pose, results.drive.rig)[:3, 3] for pair in results.drive.frame_pairs])
    lines, false = compare_with_truth(cones, results.tracks, path_m, within_m=within_m)
    if not lines:
        raise InputError(
            f"truth {file}: none of its {len(cones)} cones lies within {within_m:g} m of the path of {drive}; "
            "is it another drive's?"
        )
    return _evaluate(results, lines, false, path_m)


def _print(truth: Path, results: AnalysedDrive, evaluation: _Evaluation, files: list[Path], within_m: float) -> None:
    out.print(f"[bold]{results.drive.drive_id}[/] against {truth}, in metres\n")
    print_table_3(evaluation.lines, missing="missed")
    out.print()
    print_table("Errors", _STATISTICS, _statistics_rows(evaluation))
    out.print()
    print_table(
        "Single positions by range: root mean square errors beside the stated sigmas", _BANDS, _band_rows(evaluation)
    )
    out.print()
    print_table("Do the stated sigmas hold? (NEES)", NEES_COLUMNS, nees_rows(evaluation.nees))
    out.print()
    for sentence in _summary(results, evaluation, within_m):
        out.print(sentence, markup=False)
    out.print(f"\n{files[-1]}: everything on one page", markup=False)


def _evaluate(
    results: AnalysedDrive,
    lines: list[TruthLine[Track]],
    false: list[Track],
    path_m: np.ndarray[Any, np.dtype[np.float64]],
) -> _Evaluation:
    tracks = track_errors(lines, results.drive, results.records.positions, results.motion)
    singles = position_errors(members_of(lines), results.records.positions, results.drive, results.poses)
    figures = {
        name: figure
        for name, errors in (("tracks", tracks), ("single positions", singles))
        if (figure := statistics(errors)) is not None
    }
    nees = {
        name: consistency_report(drive_consistency(errors))
        for name, errors in (("tracks", tracks), ("single positions", singles))
    }
    return _Evaluation(lines, false, path_m, tracks, singles, figures, by_range(singles), nees)


def _write(folder: Path, results: AnalysedDrive, evaluation: _Evaluation, within_m: float) -> list[Path]:
    """The plots and, last, the page. Raises InputError where the folder cannot be written."""
    from conetl.reports import accuracy_plots

    name, tracks, singles = results.drive.drive_id, evaluation.tracks, evaluation.singles
    pictures = {
        "errors_over_range.png": accuracy_plots.errors_over_range(
            range_m=singles.range_m,
            errors_m=singles.in_sight_axes(singles.difference_m),
            sigmas_m=singles.sigma_in_sight_axes(),
            track_range_m=tracks.range_m,
            track_errors_m=tracks.in_sight_axes(tracks.difference_m),
            title=f"{name}: errors over range",
        ),
        "plan.png": accuracy_plots.error_plan(
            path_m=evaluation.path_m,
            truth_m=np.array([line.truth.xyz_m for line in evaluation.lines]),
            names=[line.truth.cone_id for line in evaluation.lines],
            found=np.array([line.feature is not None for line in evaluation.lines]),
            errors_m=tracks.difference_m,
            cov_m2=tracks.cov_m2,
            single_truth_m=singles.truth_m,
            single_errors_m=singles.difference_m,
            false_m=np.array([track.xyz_m for track in evaluation.false]).reshape(-1, 3),
            title=name,
        ),
        "nees.png": accuracy_plots.nees_histogram(
            single=single_nees(singles), tracks=single_nees(tracks), title=f"{name}: do the stated sigmas hold?"
        ),
    }
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for file, data in pictures.items():
            (folder / file).write_bytes(data)
    except OSError as error:
        raise InputError(f"{folder} cannot be written ({error.strerror}): choose another folder by --out") from error
    sections = [
        Section("Cones against truth", "Metres; range from the nearest point of the path.", _TABLE_3,
                table_3_rows(evaluation.lines, missing="missed")),
        Section("Where the errors point", image=pictures["plan.png"], image_words="plan view with error vectors"),
        Section("Errors", "Metres. Bias is the mean error, estimate minus truth.", _STATISTICS, _statistics_rows(evaluation)),
        Section("Errors over range", "Single positions, one per frame pair; root mean square errors beside the stated sigmas.",
                _BANDS, _band_rows(evaluation), pictures["errors_over_range.png"], "errors over range"),
        Section("Do the stated sigmas hold?",
                _NEES_WORDS,
                NEES_COLUMNS, nees_rows(evaluation.nees), pictures["nees.png"], "histogram of NEES against chi-square"),
    ]  # fmt: skip
    page = write_accuracy_page(
        folder / "index.html",
        title=f"{name} against truth",
        summary=_summary(results, evaluation, within_m),
        sections=sections,
    )
    return [*(folder / file for file in pictures), page]


def _summary(results: AnalysedDrive, evaluation: _Evaluation, within_m: float) -> list[str]:
    missed = [line.truth.cone_id for line in evaluation.lines if line.feature is None]
    words = [
        f"{evaluation.found} of {len(evaluation.lines)} cones within {within_m:g} m of the path found, "
        f"{len(evaluation.false)} false ones.",
        f"{len(results.drive.frame_pairs)} frame pairs, {len(results.records.positions)} positions, "
        f"{len(results.records.rejections)} rejections.",
        results.trajectory.detail,
    ]
    if missed:
        words.append(f"Missed: {', '.join(missed)}.")
    median = median_error(evaluation.lines)
    if median is not None:
        figures = evaluation.figures["tracks"]
        words.append(
            f"Median 3D error of the tracks {median:.3f} m, CE90 {figures.ce90_m:.3f} m, LE90 {figures.le90_m:.3f} m."
        )
    return words


def _statistics_rows(evaluation: _Evaluation) -> list[tuple[object, ...]]:
    return [
        (name, f.count, *(f"{value:.3f}" for value in (f.median_3d_m, f.rmse_3d_m, *f.rmse_enu_m)),
         *(f"{value:+.3f}" for value in f.bias_enu_m), f"{f.ce90_m:.3f}", f"{f.le90_m:.3f}")
        for name, f in evaluation.figures.items()
    ]  # fmt: skip


def _band_rows(evaluation: _Evaluation) -> list[tuple[object, ...]]:
    return [
        (f"{band.from_m:g} to {band.to_m:g}" if band.to_m else f"over {band.from_m:g}", f.count,
         *(f"{value:.3f}" for value in (f.median_3d_m, *f.rmse_sight_m, *f.stated_sigma_sight_m)), f"{f.bias_sight_m[0]:+.3f}")
        for band in evaluation.bands
        for f in (band.errors,)
    ]  # fmt: skip


def _as_dict(results: AnalysedDrive, evaluation: _Evaluation, files: Sequence[Path]) -> dict[str, object]:
    return {
        "drive_id": results.drive.drive_id,
        "map_srid": results.drive.map_srid,
        "frame_pairs": len(results.drive.frame_pairs),
        "trajectory": results.trajectory.detail,
        "cones": [
            {"track_index": line.feature.track_index if line.feature else None, **line_as_dict(line)}
            for line in evaluation.lines
        ],
        "missed": [line.truth.cone_id for line in evaluation.lines if line.feature is None],
        "false_tracks": [
            {
                "track_index": track.track_index,
                "xyz_m": track.xyz_m,
                "existence_probability": track.existence_probability,
            }
            for track in evaluation.false
        ],
        "median_error_3d_m": median_error(evaluation.lines),
        "errors": {name: figures.model_dump(mode="json") for name, figures in evaluation.figures.items()},
        "by_range": [band.model_dump(mode="json") for band in evaluation.bands],
        "nees": {name: report.model_dump(mode="json") for name, report in evaluation.nees.items()},
        "files": [str(file) for file in files],
    }
