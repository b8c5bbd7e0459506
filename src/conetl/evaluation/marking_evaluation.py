"""The lane markings of drives against their truth: tables and JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from conetl.evaluation.accuracy import calibration_of, pose_and_calibration
from conetl.evaluation.markings import (
    NEES_PARTS,
    MarkingErrors,
    MarkingFigures,
    TruthMarking,
    compare_markings,
    marking_consistency,
    marking_figures,
    visible_to,
)
from conetl.evaluation.nees_table import NEES_COLUMNS, NEES_TEXT, nees_as_dict, nees_rows
from conetl.geometry.consistency import Consistency, pooled
from conetl.geometry.rig import map_SE3_left
from conetl.model.arrays import Floats
from conetl.model.drive import Drive
from conetl.model.markings import MarkingTrack
from conetl.reports.html import Section
from conetl.tracking.error_propagation import PoseCov, constant_and_change

#: Depths between which markings are measured, and where they are measured well.
_VIEW_M, _TYPICAL_RANGE_M = (4.0, 16.0), 8.0
#: Least sigma of a vertex against the truth, whose coordinates are rounded (degrees to nine digits: 0.1 mm; heights to 1 mm). In
#: a gap the fit ties vertices to each other, so that neighbours could not differ otherwise.
_RESOLUTION_M = 1e-4
_FIGURES = (
    "", "visible m", "found m", "complete", "correct", "double", "lateral median", "95 %", "height median", "95 %", "width",
    "dash", "gap", "pattern right", "colour right",
)  # fmt: skip
_FIGURES_TEXT = (
    "Metres, and shares of length. Complete: of what was visible, found within 0.15 m; correct: of what was found, right "
    "(Wiedemann 2003); double: right, but found before. Errors are medians of their size. Pattern: solid or dashed, dash and "
    "gap to 0.5 m."
)
_EACH = ("marking", "pattern", "colour", "visible m", "complete", "lateral median", "height median", "width error")


@dataclass(frozen=True)
class MarkingEvaluation:
    """The lane markings of one drive compared with the truth."""

    truth: Sequence[TruthMarking]
    errors: MarkingErrors
    figures: MarkingFigures
    nees: dict[str, Consistency | None]

    def tables(self) -> list[Section]:
        """Figures of all markings, one row per marking, and NEES."""
        return [
            Section("Lane markings", _FIGURES_TEXT, _FIGURES, [_row("all", self.figures)]),
            Section("Each marking of the ground truth", "Metres, and shares of length.", _EACH, self._rows()),
            Section(
                "Do the sigmas of lane markings hold?",
                f"Vertices, across the marking and in height. {NEES_TEXT}",
                NEES_COLUMNS,
                nees_rows(self.nees),
            ),
        ]

    def _rows(self) -> list[tuple[object, ...]]:
        rows: list[tuple[object, ...]] = []
        for k, one in enumerate(self.truth):
            figures = marking_figures([self.errors.of_truth(k)])
            if figures.truth_m > 0:
                errors = figures.lateral_median_m, figures.height_median_m, figures.width_median_m
                shares = f"{figures.truth_m:.0f}", _shown(figures.completeness)
                rows.append((one.marking_id, one.pattern, one.colour, *shares, *map(_shown, errors)))
        return rows


def evaluate_markings(
    truth: Sequence[TruthMarking], tracks: Sequence[MarkingTrack], drive: Drive, poses: PoseCov
) -> MarkingEvaluation:
    """Compare the markings of a drive (refined poses) with the truth. poses: covariance of the drive's poses."""
    errors = compare_markings(truth, [track.marking for track in tracks], visible_to(drive))
    nees = marking_consistency(errors, *_covariances(tracks, drive, poses))
    return MarkingEvaluation(truth, errors, marking_figures([errors]), nees)


def pooled_markings(drives: Mapping[str, MarkingEvaluation]) -> list[Section]:
    """One row per drive and one for all, and the NEES of all; nothing without drives."""
    if not drives:
        return []
    rows = [_row(name, one.figures) for name, one in drives.items()]
    rows.append(_row("all drives", marking_figures([one.errors for one in drives.values()])))
    return [
        Section("Lane markings, drive by drive", _FIGURES_TEXT, _FIGURES, rows),
        Section(
            "Do the sigmas of lane markings hold for all drives together?",
            "",
            NEES_COLUMNS,
            nees_rows(_pooled_nees(drives)),
        ),
    ]


def markings_as_dict(drives: Mapping[str, MarkingEvaluation]) -> dict[str, object]:
    """Figures and NEES of all drives as JSON values under one key; empty without drives."""
    if not drives:
        return {}
    figures = marking_figures([one.errors for one in drives.values()]).model_dump(mode="json")
    nees = {name: nees_as_dict(result) for name, result in _pooled_nees(drives).items()}
    return {"lane_markings": {**figures, "nees": nees}}


def _pooled_nees(drives: Mapping[str, MarkingEvaluation]) -> dict[str, Consistency | None]:
    return {name: pooled(drive.nees[name] for drive in drives.values()) for name in NEES_PARTS}


def _covariances(tracks: Sequence[MarkingTrack], drive: Drive, poses: PoseCov) -> tuple[Floats, Floats, Floats]:
    """Covariances of all vertices of a drive, for `marking_consistency`: their own errors, correlated along each marking and by
    poses that change within the drive, and those common to the drive.

    A vertex moves with the poses from which it was in view, near ones most, as in its fit.
    """
    vertices = np.array([vertex for track in tracks for vertex in track.marking.vertices_m]).reshape(-1, 3)
    pairs = drive.frame_pairs
    left = np.array([map_SE3_left(pair.pose, drive.rig) for pair in pairs])
    ahead = np.einsum("nfi,fi->nf", vertices[:, None] - left[:, :3, 3], left[:, :3, 2])
    seen = (ahead > _VIEW_M[0]) & (ahead < _VIEW_M[1])
    seen[np.arange(len(seen)), np.abs(ahead - _TYPICAL_RANGE_M).argmin(axis=1)] = True
    weight = np.where(seen, np.maximum(ahead, _VIEW_M[0]) ** -2.0, 0.0)
    weight /= weight.sum(axis=1, keepdims=True)
    by_frame = np.stack([pose_and_calibration(vertices, [pair.pose] * len(vertices), drive.rig)[0] for pair in pairs])
    # Points behind a camera have no derivative by its calibration (NaN).
    moved = weight.T[:, :, None, None] * np.nan_to_num(by_frame)
    constant, change = constant_and_change(poses([pair.frame_index for pair in pairs]))
    by_pose = moved[..., :6].transpose(1, 2, 0, 3).reshape(3 * len(vertices), -1)
    stretches = [stretch for track in tracks for stretch in track.image_covs()]
    own = block_diag(*stretches) if stretches else np.zeros((0, 0))
    own += _RESOLUTION_M**2 * np.eye(len(own))
    return own + by_pose @ change @ by_pose.T, moved.sum(axis=0), block_diag(constant, calibration_of(drive.rig))


def _row(name: str, figures: MarkingFigures) -> tuple[object, ...]:
    lengths = (f"{figures.truth_m:.0f}", f"{figures.found_m:.0f}")
    return (name, *lengths, *(_shown(value) for key, value in figures if not key.endswith(("truth_m", "found_m"))))


def _shown(value: float | None) -> str:
    return "" if value is None else f"{value:.3f}"
