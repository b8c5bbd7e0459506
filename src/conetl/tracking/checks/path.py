"""What the path of the log and that of the images differ by, and whether the stated sigmas of the log cover it.

Scale, direction, lever arm and heights change the path in ways of their own (`path_changes`). All are estimated together by
generalised least squares with the model of the log's errors (`log_errors.py`), so that what a drive does not show has a large
sigma, and errors of the log within its stated sigmas are significant for none of them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from conetl.geometry.motion.pose_graph import LoggedPoses, MeasuredMotions
from conetl.model.arrays import Bools
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
    assumed_errors,
    fitted_changes,
    path_changes,
    path_difference,
)
from conetl.tracking.trajectory import RefinedTrajectory, RefinementOutcome, only, stated_errors

DISTANCES, SIGMAS = "distances by images and by GNSS/INS", "stated sigmas of the poses"
#: What is known beforehand of scale, direction (rad), lever arm (m), clock (s) and the heights' factor: one sigma.
_PRIOR = np.array([0.1, 0.2, 0.2, 3.0, 3.0, 3.0, 0.05, 3.0])
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
    changes = np.zeros((len(frame_pairs), 3, len(_PRIOR)))
    changes[:, :, :-1] = path_changes(difference)
    changes[:, 2, -1] = difference.path_m[:, 2] - difference.off[:, 2]
    errors = trajectory.errors or assumed_errors(params)
    found, cov = fitted_changes(difference, records, errors, changes, _PRIOR)
    sigmas = np.sqrt(np.diag(cov))
    tilt, heading = (float(np.median(records.stated[:, axes].max(axis=1))) for axes in ((3, 4), (5,)))
    directions = [(found[ASIDE], np.hypot(sigmas[ASIDE], heading), "sideways")]
    directions.append((found[UP], np.hypot(sigmas[UP], tilt), "up or down"))
    angle, angle_sigma, way = max(directions, key=lambda one: abs(one[0]) / one[1])
    forward, left, _ = zip(found[LEVER], sigmas[LEVER], ("forward", "left", "up"), strict=True)
    arm_m, arm_sigma_m, arm_way = max(forward, left, key=lambda one: abs(one[0]) / one[1])
    factor = 1 + float(found[-1])
    likely = {1 / _FOOT_M: "feet", _FOOT_M: "feet twice"}
    named = (cause for times, cause in likely.items() if abs(factor / times - 1) < _SAME_FACTOR)
    cause = "sign" if factor < 0 else next(named, "unit")
    doubtful = trajectory.scale is not None and scale_is_doubtful(*trajectory.scale, params.scale_sigma)
    return [
        *findings,
        Finding(
            check=DISTANCES, value=100 * float(found[SCALE]), sigma=100 * float(sigmas[SCALE]),
            treated="widened" if doubtful else "", says=("", "covered"),
        ),
        Finding(
            check="alignment of cameras and GNSS/INS", value=float(np.degrees(abs(angle))),
            sigma=float(np.degrees(angle_sigma)), facts={"way": way, "drift_cm": 100 * float(abs(angle))},
        ),
        Finding(
            check="lever arm of the cameras", value=float(arm_m), sigma=float(arm_sigma_m), facts={"way": arm_way}
        ),
        Finding(check="heights of GNSS/INS", value=factor, sigma=float(sigmas[-1]), says=("", cause)),
    ]  # fmt: skip


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
        says=("", "widened" if factor <= limits.sigma_factor else "scatter"),
    )  # fmt: skip


assert len(_NAMES) == len(GROUPS)
