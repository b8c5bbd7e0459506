"""What the path of the log and that of the images differ by, and whether the stated sigmas of the log cover it.

Scale, direction, lever arm and heights change the path in ways of their own (`path_changes`). All are estimated together by
generalised least squares with the model of the log's errors (`log_errors.py`), so that what a drive does not show has a large
sigma, and errors of the log within its stated sigmas are significant for none of them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from conetl.geometry.motion.pose_graph import LoggedPoses, MeasuredMotions
from conetl.model.arrays import Bools, Floats
from conetl.model.drive import FramePair
from conetl.model.health import Finding
from conetl.model.params import PathCheckParams, TrajectoryParams
from conetl.tracking.drive_refinement import scale_is_doubtful
from conetl.tracking.log_errors import (
    ASIDE,
    GROUPS,
    LEVER,
    SCALE,
    UP,
    LogErrors,
    PathDifference,
    StatedErrors,
    assumed_errors,
    compared_frames,
    fitted_changes,
    measured_cov,
    path_changes,
    path_difference,
)
from conetl.tracking.trajectory import RefinedTrajectory, RefinementOutcome, only, stated_errors

DISTANCES, SIGMAS = "distances by images and by GNSS/INS", "stated sigmas of the poses"
#: What is known beforehand of scale, direction (rad), lever arm (m) and clock (s), and of the heights' factor: one sigma.
_PRIOR, _HEIGHTS_PRIOR = np.array([0.1, 0.2, 0.2, 3.0, 3.0, 3.0, 0.05]), 3.0
#: Heights have another unit where their factor is one foot in metres, to this share.
_FOOT_M, _SAME_FACTOR = 0.3048, 0.3
_NAMES = ("easting and northing", "height", "roll and pitch", "heading")


def check_path(
    frame_pairs: Sequence[FramePair],
    log: LoggedPoses,
    measured: MeasuredMotions,
    good: Bools,
    trajectory: RefinedTrajectory,
    params: TrajectoryParams,
    limits: PathCheckParams,
) -> list[Finding]:
    """Distances, directions, lever arm and heights of a log against the motions that are plausible (M,); its stated sigmas."""
    findings = [_stated_sigmas(trajectory, limits)]
    if not good.any():
        return findings
    records = stated_errors(frame_pairs)
    rotations = trajectory.map_SE3_left[:, :3, :3] @ log.body_SE3_left[:3, :3].T
    difference = path_difference(log, rotations, only(measured, good), records.times_s, params)
    errors = trajectory.errors or assumed_errors(params)
    changes = path_changes(difference)
    found, cov = fitted_changes(difference, records, errors, changes, _PRIOR)
    sigmas = np.sqrt(np.diag(cov))
    tilt, heading = (float(np.median(records.stated[:, axes].max(axis=1))) for axes in ((3, 4), (5,)))
    directions = [(found[ASIDE], np.hypot(sigmas[ASIDE], heading), "sideways")]
    directions.append((found[UP], np.hypot(sigmas[UP], tilt), "up or down"))
    angle, angle_sigma, way = max(directions, key=lambda one: abs(one[0]) / one[1])
    forward, left, _ = zip(found[LEVER], sigmas[LEVER], ("forward", "left", "up"), strict=True)
    arm_m, arm_sigma_m, arm_way = max(forward, left, key=lambda one: abs(one[0]) / one[1])
    doubtful = trajectory.scale is not None and scale_is_doubtful(*trajectory.scale, params.scale_sigma)
    return [
        *findings,
        Finding(
            check=DISTANCES, value=100 * float(found[SCALE]), sigma=100 * float(np.hypot(sigmas[SCALE], params.scale_sigma)),
            treated="widened" if doubtful else "", says=("", "covered"),
        ),
        Finding(
            check="alignment of cameras and GNSS/INS", value=float(np.degrees(abs(angle))),
            sigma=float(np.degrees(angle_sigma)), facts={"way": way, "drift_cm": 100 * float(abs(angle))},
        ),
        Finding(
            check="lever arm of the cameras", value=float(arm_m), sigma=float(arm_sigma_m), facts={"way": arm_way}
        ),
        _heights(difference, records, errors, changes),
    ]  # fmt: skip


def _heights(difference: PathDifference, records: StatedErrors, errors: LogErrors, changes: Floats) -> Finding:
    """By what factor the log climbs more than the images. changes: of `path_changes`."""
    climbs = np.zeros((*changes.shape[:2], 1))
    climbs[:, 2, 0] = difference.path_m[:, 2]
    prior = np.append(_PRIOR, _HEIGHTS_PRIOR)
    found, cov = fitted_changes(difference, records, errors, np.concatenate([changes, climbs], axis=2), prior)
    # Errors of the measured path look like climbs that GNSS/INS does not have: the factor is too small by their share.
    frames = compared_frames(records)
    even = np.column_stack([np.ones(len(frames)), difference.driven_m[frames]])
    rest = np.eye(len(frames)) - even @ np.linalg.pinv(even)
    shown = float(np.square(rest @ climbs[frames, 2, 0]).sum())
    wrong = float(np.trace(rest @ measured_cov(difference, records, frames, 2) @ rest)) / max(shown, 1e-12)
    factor, sigma = 1 + float(found[-1]), float(np.hypot(cov[-1, -1] ** 0.5, wrong))
    likely = {1 / _FOOT_M: "feet", _FOOT_M: "feet twice"}
    named = (cause for times, cause in likely.items() if abs(factor / times - 1) < _SAME_FACTOR)
    return Finding(
        check="heights of GNSS/INS",
        value=factor,
        sigma=sigma,
        says=("", "sign" if factor < 0 else next(named, "unit")),
    )


def _stated_sigmas(trajectory: RefinedTrajectory, limits: PathCheckParams) -> Finding:
    """By what factor the stated sigmas are too small, where the images show that."""
    if trajectory.outcome is RefinementOutcome.AGAINST_STATED_SIGMAS:
        detail = trajectory.detail
        return Finding(
            check=SIGMAS, found=True, says=("moved",), facts={"outcome": f"{detail[0].upper()}{detail[1:]}."}
        )
    if trajectory.errors is None:
        return Finding(check=SIGMAS)
    factor, group = max((shares.factor**0.5, k) for k, shares in enumerate(trajectory.errors))
    return Finding(
        check=SIGMAS, value=factor, treated="widened" if factor > 1.0 else "", facts={"of": _NAMES[group]},
        says=("", "widened" if factor <= limits.sigma_factor else "beyond"),
    )  # fmt: skip


assert len(_NAMES) == len(GROUPS)
