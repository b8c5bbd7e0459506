"""What the points of one stereo pair show of its calibration.

Rows: a point is on the same row of both rectified images, so that any pair shows a turn of the right camera up or down and about
its axis. Columns: points at finite depth do not show an offset of disparities, as each may be nearer or farther; but no point
is beyond infinity. Where points are, the smallest offset that explains them is corrected, and what its prior leaves open remains
in the sigma of positions.

Offsets that contradict the stated errors refute the statement: the calibration then counts as one without. What is implausible
even so is another rig's, or the images are cropped, swapped, or not of one instant.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from conetl.geometry.calibration.covariance import known_covariance, with_covariance
from conetl.geometry.rig import infinity_shift_px
from conetl.geometry.small_arrays import robust_std
from conetl.model.arrays import Floats
from conetl.model.errors import InputError
from conetl.model.params import PairParams, TrajectoryParams
from conetl.model.rig import Rig
from conetl.tracking.self_calibration import (
    SelfCalibration,
    SelfCalibrationOutcome,
    pixels_per_unit,
    self_calibrated_rig,
    turn_and_bend_cov,
    with_assumed_errors,
)

_REJECTED_SIGMAS = 3.0
_CAUSES = (
    "Check whether the calibration is that of these cameras, and whether the images are cropped, swapped, already rectified, or "
    "of different instants; otherwise calibrate the rig (conetl calibrate)."
)


class PairOffsets(NamedTuple):
    """Offsets of the right image from where the calibration expects it."""

    points: int
    """Number of those that agree on the rows."""
    rows_px: Floats
    """(2,): how much lower the right image lies in its middle, and how much more at its right side."""
    rows_cov_px2: Floats
    """(2, 2)"""
    farthest_px: float
    """Disparity, relative to infinity, of all but `PairParams.beyond_share` of the points."""
    farthest_at: float
    """Distance of these points from the middle of the image (root mean square) in focal lengths."""


class PairCalibration(NamedTuple):
    """The calibration of a pair as its points show it."""

    rig: Rig
    """With its right camera corrected where the points contradict it, and the errors that remain, stated or assumed."""
    stated: bool
    """Whether the errors are those that the calibration states."""
    offsets: PairOffsets | None
    """None: too few points."""
    detail: str
    """For a person."""


def measure_offsets(points_px: Floats, rig: Rig, params: PairParams) -> PairOffsets | None:
    """Offsets by points (N, 4) px (u and v left, u and v right) of a rectified rig; None with too few."""
    shift = infinity_shift_px(rig, points_px[:, :2])
    columns, rows = points_px[:, 0] - points_px[:, 2] - shift[:, 0], points_px[:, 3] - points_px[:, 1] + shift[:, 1]
    side = (points_px[:, 2] - rig.right.cx_px) / (rig.right.width_px / 2)
    kept = np.isfinite(points_px).all(axis=1)
    design = np.column_stack([np.ones(len(side)), side])
    off: Floats = np.zeros(2)
    scatter = params.least_scatter_px
    for _ in range(3):
        if int(kept.sum()) < params.min_points:
            return None
        off = np.asarray(np.linalg.lstsq(design[kept], rows[kept], rcond=None)[0])
        scatter = max(robust_std((rows - design @ off)[kept]), params.least_scatter_px)
        kept = np.abs(rows - design @ off) <= _REJECTED_SIGMAS * scatter
    cov = scatter**2 * np.linalg.inv(design[kept].T @ design[kept])
    farthest = float(np.quantile(columns[kept], params.beyond_share))
    beyond = kept & (columns <= farthest)
    at = float(np.sqrt(np.mean(side[beyond] ** 2))) * rig.right.width_px / 2 / rig.right.fx_px
    return PairOffsets(int(kept.sum()), off, cov, farthest, at)


def calibrate_pair(points_px: Floats, rig: Rig, params: PairParams, trajectory: TrajectoryParams) -> PairCalibration:
    """The rig by the points (N, 4) px of a pair, see `measure_offsets`. Raises InputError if it is not the rig of the pair."""
    offsets = measure_offsets(points_px, rig, params)
    stated = known_covariance(rig) is not None
    if offsets is None:
        said = f"not compared with the images, which have fewer than {params.min_points} points in common"
        return PairCalibration(with_assumed_errors(rig, trajectory), stated, None, said + _errors(stated, trajectory))
    found = _correction(offsets, rig, params, trajectory)
    refuted = stated and found.outcome is SelfCalibrationOutcome.IMPLAUSIBLE
    if refuted:
        rig = with_covariance(rig, None)
        found = _correction(offsets, rig, params, trajectory)
    if found.outcome is SelfCalibrationOutcome.IMPLAUSIBLE:
        raise InputError(f"The calibration does not fit the images: {found.detail}. {_CAUSES}")
    stated &= not refuted
    said = found.detail + (", against the errors that it states" if refuted else "") + _errors(stated, trajectory)
    return PairCalibration(self_calibrated_rig(rig, found, trajectory), stated, offsets, said)


def _errors(stated: bool, params: TrajectoryParams) -> str:
    return "" if stated else f"; an error of +-{params.self_calibration_prior_px:g} px is assumed"


def _correction(offsets: PairOffsets, rig: Rig, params: PairParams, trajectory: TrajectoryParams) -> SelfCalibration:
    """The turn and bend that the offsets show, given the errors of the calibration; or that they are implausible.

    Turn and bend are in pixels here, see `pixels_per_unit`.
    """
    unit_px, significance = pixels_per_unit(rig), trajectory.self_calibration_significance
    prior = turn_and_bend_cov(rig, trajectory) * np.outer(unit_px, unit_px)
    of_rows, of_columns = _by_turn_and_bend(offsets, rig)
    rows_cov = offsets.rows_cov_px2 + trajectory.self_calibration_sigma_floor_px**2 * np.eye(2)
    limit_px = np.maximum(significance * np.sqrt(np.diag(rows_cov)), trajectory.self_calibration_least_px)
    found, left_over = np.zeros(4), prior
    said: list[str] = []
    implausible: list[str] = []
    if (np.abs(offsets.rows_px) > limit_px).any():
        spread = of_rows @ prior @ of_rows.T + rows_cov
        gain = prior @ of_rows.T @ np.linalg.inv(spread)
        found, left_over = gain @ offsets.rows_px, prior - gain @ of_rows @ prior
        middle, side = (f"{abs(v):.2f} px too {'low' if v > 0 else 'high'}" for v in np.cumsum(offsets.rows_px))
        said.append(f"the right image lies {middle} in its middle and {side} at its right side")
        if offsets.rows_px @ np.linalg.solve(spread, offsets.rows_px) > trajectory.self_calibration_max_chi2:
            implausible.append(said[-1])
    beyond_px = offsets.farthest_px - float(of_columns @ found)
    if beyond_px < -significance * params.farthest_sigma_px:
        variance = float(of_columns @ left_over @ of_columns)
        # Errors that are not among the stated ones explain nothing.
        found = found + left_over @ of_columns / max(variance, 1e-12) * beyond_px
        said.append(f"{params.beyond_share:.0%} of the points are at least {-beyond_px:.1f} px beyond infinity")
        if beyond_px**2 > significance**2 * (variance + params.farthest_sigma_px**2):
            implausible.append(said[-1])
    outcome, detail = SelfCalibrationOutcome.NO_ESTIMATE, f"the rows of {offsets.points} points agree"
    if implausible:
        outcome, detail = SelfCalibrationOutcome.IMPLAUSIBLE, ", and ".join(implausible)
    elif said:
        outcome, detail = SelfCalibrationOutcome.APPLIED, ", and ".join(said) + ", which was corrected"
    (rx, ry, rz, bend), cov = (found / unit_px).tolist(), left_over / np.outer(unit_px, unit_px)
    return SelfCalibration(
        outcome=outcome, detail=detail, rotation_rad=(rx, ry, rz), bend=bend, cov=tuple(cov[np.triu_indices(4)].tolist()),
        model_gap=(0.0, 0.0, 0.0, 0.0),
    )  # fmt: skip


def _by_turn_and_bend(offsets: PairOffsets, rig: Rig) -> tuple[Floats, Floats]:
    """Row offsets (2, 4) as in `PairOffsets`, and the disparity of the farthest points (4,), by turn and bend in pixels."""
    square = offsets.farthest_at**2
    side = rig.right.width_px / 2 / rig.right.fx_px
    of_rows = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -rig.right.fy_px / rig.right.fx_px, 0.0]])
    return of_rows, np.array([0.0, 1.0 + square, 0.0, -square / side**2])
