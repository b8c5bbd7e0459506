"""Drives against surveyed cones: errors, whether the stated sigmas hold, plots and pages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from conetl.evaluation.accuracy import (
    ErrorStatistics,
    PointErrors,
    by_range,
    conditional_errors,
    drive_consistency,
    members_of,
    position_errors,
    statistics,
    track_errors,
)
from conetl.evaluation.marking_evaluation import MarkingEvaluation, evaluate_markings, markings_as_dict, pooled_markings
from conetl.evaluation.markings import TruthMarking
from conetl.evaluation.nees_table import NEES_COLUMNS, NEES_TEXT, nees_as_dict, nees_rows, parts_of
from conetl.evaluation.truth import (
    TABLE_3_COLUMNS,
    TruthCone,
    TruthLine,
    compare_with_truth,
    line_as_dict,
    median_error,
    split_by_extent,
    table_3_rows,
)
from conetl.files.documents import library_errors
from conetl.geometry.consistency import Consistency
from conetl.geometry.rig import map_SE3_left
from conetl.model.arrays import Floats
from conetl.model.drive import Track
from conetl.model.errors import InputError
from conetl.model.feature_classes import known_classes, noun_of
from conetl.pipeline.analysis import AnalysedDrive
from conetl.reports.html import Section, render, write_page

#: The two kinds of estimates whose errors are evaluated.
KINDS = ("tracks", "single positions")
_STATISTICS = (
    "", "estimates", "median 3D", "RMSE 3D", "RMSE E", "N", "up", "bias E", "N", "up", "CE90", "LE90",
)  # fmt: skip
_BANDS = (
    "range m", "estimates", "median 3D", "RMSE along", "across", "up", "stated along", "across", "up", "bias along"
)  # fmt: skip
_CLASSES = ("class", "found", "false", "median 3D", "largest", "NEES relative", "common", "absolute", "95 % band")
_DRIVES = ("drive", "cones found", "false", "not judged", "median 3D", "tracks: relative", "common", "absolute",
           "single positions: relative", "common", "absolute")  # fmt: skip
_DRIVES_TEXT = (
    "Metres. NEES per degree of freedom, 1 if the stated sigmas are right; * outside its 95 % band, as one value in twenty is by "
    "chance. All drives: sums over drives with independent errors."
)


@dataclass(frozen=True)
class DriveEvaluation:
    """The cones of one drive compared with the truth."""

    drive_id: str
    lines: list[TruthLine[Track]]
    false: list[Track]
    not_judged: list[Track]
    """Outside of the area that was surveyed."""
    path_m: Floats
    tracks: PointErrors
    singles: PointErrors
    markings: MarkingEvaluation | None = None
    """None where lane markings were not searched for, or have no truth."""

    @cached_property
    def figures(self) -> dict[str, ErrorStatistics]:
        return figures_of([self])

    @property
    def found(self) -> int:
        return sum(line.feature is not None for line in self.lines)

    @property
    def missed(self) -> list[str]:
        return [line.truth.cone_id for line in self.lines if line.feature is None]

    def tables(self) -> list[Section]:
        """Objects, errors, errors by range, NEES; figures by class if there are several; lane markings. Without cones only the
        last."""
        of_markings = self.markings.tables() if self.markings else []
        if not self.lines:
            return of_markings
        cones = table_3_rows(self.lines, missing="missed")
        errors = [
            (name, f.count, *(f"{value:.3f}" for value in (f.median_3d_m, f.rmse_3d_m, *f.rmse_enu_m)),
             *(f"{value:+.3f}" for value in f.bias_enu_m), f"{f.ce90_m:.3f}", f"{f.le90_m:.3f}")
            for name, f in self.figures.items()
        ]  # fmt: skip
        bands = [
            (f"{band.from_m:g} to {band.to_m:g}" if band.to_m else f"over {band.from_m:g}", f.count,
             *(f"{value:.3f}" for value in (f.median_3d_m, *f.rmse_sight_m, *f.stated_sigma_sight_m)),
             f"{f.bias_sight_m[0]:+.3f}")
            for band in by_range(self.singles)
            for f in (band.errors,)
        ]  # fmt: skip
        return [
            Section(
                "Cones compared with ground truth",
                "Metres; range from the nearest point of the drive path.",
                TABLE_3_COLUMNS,
                cones,
            ),
            Section("Errors", "Metres. Bias is the mean error (estimate minus ground truth).", _STATISTICS, errors),
            Section(
                "Errors over range",
                "Single positions, one per frame pair; root mean square errors beside the stated sigmas.",
                _BANDS,
                bands,
            ),
            Section("Do the stated sigmas hold?", NEES_TEXT, NEES_COLUMNS, nees_rows(nees_of([self]))),
            *_class_section([self]),
            *of_markings,
        ]

    def as_dict(self) -> dict[str, object]:
        """As JSON values."""
        return {
            "cones": [
                {"track_index": line.feature.track_index if line.feature else None, **line_as_dict(line)}
                for line in self.lines
            ],
            "missed": self.missed,
            "false_tracks": _as_json(self.false),
            "not_judged_tracks": _as_json(self.not_judged),
            "median_error_3d_m": median_error(self.lines),
            "by_range": [band.model_dump(mode="json") for band in by_range(self.singles)],
            **as_dict([self]),
        }


def _as_json(tracks: Sequence[Track]) -> list[dict[str, object]]:
    return [
        track.model_dump(mode="json", include={"track_index", "xyz_m", "existence_probability"}) for track in tracks
    ]


def false_in_words(drives: Sequence[DriveEvaluation]) -> str:
    """How many cones that were found are false, and how many were not judged."""
    false, outside = (sum(map(len, of)) for of in zip(*((d.false, d.not_judged) for d in drives), strict=True))
    not_judged = f", {outside} outside of the surveyed area and not judged" if outside else ""
    return f"{false} false ones{not_judged}."


def figures_of(drives: Sequence[DriveEvaluation]) -> dict[str, ErrorStatistics]:
    """Error figures of several drives together, by kind of estimate."""
    kinds = {kind: statistics(*errors) for kind, errors in _errors_of(drives).items()}
    return {kind: figures for kind, figures in kinds.items() if figures is not None}


def nees_of(drives: Sequence[DriveEvaluation]) -> dict[str, Consistency | None]:
    """NEES of several drives together, by kind of estimate."""
    return {kind: drive_consistency(*errors) for kind, errors in _errors_of(drives).items()}


def _errors_of(drives: Sequence[DriveEvaluation]) -> dict[str, list[PointErrors]]:
    return {KINDS[0]: [drive.tracks for drive in drives], KINDS[1]: [drive.singles for drive in drives]}


def as_dict(drives: Sequence[DriveEvaluation]) -> dict[str, object]:
    """Statistics and NEES of drives together as JSON values."""
    return {
        "errors": {kind: figures.model_dump(mode="json") for kind, figures in figures_of(drives).items()},
        "nees": {kind: nees_as_dict(result) for kind, result in nees_of(drives).items()},
        "by_class": class_figures(drives),
        **markings_as_dict(_markings_of(drives)),
    }


def _markings_of(drives: Sequence[DriveEvaluation]) -> dict[str, MarkingEvaluation]:
    return {drive.drive_id: drive.markings for drive in drives if drive.markings is not None}


def evaluate_drive(
    cones: Sequence[TruthCone], found: AnalysedDrive, *, within_m: float, markings: Sequence[TruthMarking] | None = None
) -> DriveEvaluation:
    """Compare the tracks of a drive with surveyed cones at most within_m from the drive path.

    cones: empty if only lane markings were searched for. markings: true ones; None: not compared. Raises InputError if none of
    the cones is near the path.
    """
    drive, positions = found.drive, found.records.positions
    path_m = np.array([map_SE3_left(pair.pose, drive.rig)[:3, 3] for pair in drive.frame_pairs])
    lines, others = compare_with_truth(cones, found.tracks, path_m, within_m=within_m)
    if cones and not lines:
        raise InputError(
            f"none of the {len(cones)} surveyed cones is within {within_m:g} m of the path of {drive.drive_id}; do they belong "
            "to another drive?"
        )
    return DriveEvaluation(
        drive.drive_id,
        lines,
        *split_by_extent(cones, others),
        path_m=path_m,
        tracks=track_errors(lines, drive, positions, found.motion),
        singles=position_errors(members_of(lines), positions, drive, found.poses),
        markings=None if markings is None else evaluate_markings(markings, found.records.markings, drive, found.poses),
    )


def class_figures(drives: Sequence[DriveEvaluation]) -> dict[str, dict[str, object]]:
    """Figures of the tracks of each class of the truth, as JSON values."""
    figures: dict[str, dict[str, object]] = {}
    for category in known_classes(line.truth.category for drive in drives for line in drive.lines):
        lines = [line for drive in drives for line in drive.lines if line.truth.category == category]
        errors_m = [line.error_3d_m for line in lines if line.error_3d_m is not None]
        figures[category] = {
            "found": len(errors_m),
            "of": len(lines),
            "false": sum(track.category == category for drive in drives for track in drive.false),
            "median_3d_m": float(np.median(errors_m)) if errors_m else None,
            "largest_3d_m": max(errors_m, default=None),
            "nees": nees_as_dict(drive_consistency(*(_of_class(drive, category) for drive in drives))),
        }
    return figures


def _of_class(drive: DriveEvaluation, category: str) -> PointErrors:
    named = {line.truth.cone_id for line in drive.lines if line.truth.category == category}
    return conditional_errors(drive.tracks, np.array([name in named for name in drive.tracks.cone_ids], dtype=bool))


def _class_section(drives: Sequence[DriveEvaluation]) -> list[Section]:
    """A row per class; empty if the truth has one class only."""
    rows: list[tuple[object, ...]] = []
    for category, figures in class_figures(drives).items():
        nees = figures["nees"]
        assert isinstance(nees, dict)
        absolute = nees["absolute"]
        rows.append((
            noun_of(category), f"{figures['found']} of {figures['of']}", figures["false"],
            *("" if value is None else f"{value:.3f}" for value in (figures["median_3d_m"], figures["largest_3d_m"])),
            *("" if part is None else f"{part['per_dof']:.2f}" for part in (nees["relative"], nees["common"], absolute)),
            "" if absolute is None else f"{absolute['low'] / absolute['dof']:.2f} to {absolute['high'] / absolute['dof']:.2f}",
        ))  # fmt: skip
    note = "Metres; NEES of tracks per degree of freedom given the other classes: scatter, common error, both and their band."
    return [Section("By class", note, _CLASSES, rows)] if len(rows) > 1 else []


def write_evaluation(folder: Path, evaluation: DriveEvaluation, summary: Sequence[str]) -> list[Path]:
    """Write the plots and then the page; for lane markings the page only. Raises InputError if the folder cannot be written."""
    title = f"{evaluation.drive_id} compared with ground truth"
    if not evaluation.lines:
        return [_write_page(folder, title, summary, evaluation.tables(), {})]
    from conetl.evaluation import accuracy_plots  # matplotlib takes half a second to load

    images = {
        "errors_over_range.png": accuracy_plots.errors_over_range(evaluation),
        "plan.png": accuracy_plots.error_plan(evaluation),
        "nees.png": accuracy_plots.nees_histogram(evaluation),
    }
    cones, errors, bands, nees, *others = evaluation.tables()
    sections = [
        cones,
        Section("Directions of the errors", image=images["plan.png"], image_alt="plan view with error vectors"),
        errors,
        replace(bands, image=images["errors_over_range.png"], image_alt="errors over range"),
        replace(nees, image=images["nees.png"], image_alt="histogram of NEES against chi-square"),
        *others,
    ]
    page = _write_page(folder, title, summary, sections, images)
    return [*(folder / file for file in images), page]


def pooled_tables(drives: Sequence[DriveEvaluation]) -> list[Section]:
    """One row per drive and one for all; NEES of all drives. Without cones only those of lane markings."""
    of_markings = pooled_markings(_markings_of(drives))
    if not any(drive.lines for drive in drives):
        return of_markings
    rows = [*(_drive_row(drive.drive_id, [drive]) for drive in drives), _drive_row("all drives", drives)]
    return [
        Section("Drive by drive", _DRIVES_TEXT, _DRIVES, rows),
        Section("Do the stated sigmas hold for all drives together?", "", NEES_COLUMNS, nees_rows(nees_of(drives))),
        *_class_section(drives),
        *of_markings,
    ]


def write_pooled_page(folder: Path, drives: Sequence[DriveEvaluation]) -> Path:
    """Write all drives on one page. Raises InputError if it cannot be written."""
    found, cones = sum(d.found for d in drives), sum(len(d.lines) for d in drives)
    summary = [f"{found} of {cones} cones found, {false_in_words(drives)}"] if cones else []
    if figures := figures_of(drives).get(KINDS[0]):
        summary.append(
            f"Median 3D error of the tracks {figures.median_3d_m:.3f} m, CE90 {figures.ce90_m:.3f} m, "
            f"LE90 {figures.le90_m:.3f} m."
        )
    return _write_page(folder, f"{len(drives)} drives compared with ground truth", summary, pooled_tables(drives), {})


def _write_page(
    folder: Path, title: str, summary: Sequence[str], sections: Sequence[Section], images: Mapping[str, bytes]
) -> Path:
    """Write images and page into a folder. Returns the path of the page. Raises InputError."""
    with library_errors(f"{folder} cannot be written", OSError, hint=": choose another folder with --out"):
        folder.mkdir(parents=True, exist_ok=True)
        for file, data in images.items():
            (folder / file).write_bytes(data)
        page = render("accuracy.html.j2", title=title, summary=summary, sections=sections)
        return write_page(folder / "index.html", page)


def _drive_row(name: str, drives: Sequence[DriveEvaluation]) -> tuple[object, ...]:
    tracks = figures_of(drives).get(KINDS[0])
    parts = [part for result in nees_of(drives).values() for part in parts_of(result).values()]
    found, cones = sum(d.found for d in drives), sum(len(d.lines) for d in drives)
    return (
        name, f"{found} of {cones}", sum(len(d.false) for d in drives), sum(len(d.not_judged) for d in drives),
        "" if tracks is None else f"{tracks.median_3d_m:.3f}",
        *("" if part is None else f"{part.per_dof:.2f}{'' if part.holds() else ' *'}" for part in parts),
    )  # fmt: skip
