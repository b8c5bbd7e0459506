"""What the path of the log and that of the images differ by (`path_fit.py`), and whether the log's stated sigmas cover it."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d

from conetl.model.arrays import Floats
from conetl.model.check_params import PathCheckParams
from conetl.model.health import Finding
from conetl.model.params import TrajectoryParams
from conetl.tracking.log.log_errors import GROUPS, LogErrors, assumed_errors, compared_frames
from conetl.tracking.log.path_difference import ASIDE, LEVER, SCALE, UNKNOWN, UP, measured_cov
from conetl.tracking.log.path_fit import PathFit, fitted_changes, sigma_of_any_shape
from conetl.tracking.trajectory import RefinedTrajectory, RefinementOutcome

DISTANCES, SIGMAS = "distances by images and by GNSS/INS", "stated sigmas of the poses"
#: What is known beforehand of the heights' factor: one sigma. Another unit is one foot in metres, to this share.
_HEIGHTS_PRIOR, _FOOT_M, _SAME_FACTOR = 3.0, 0.3048, 0.3
#: Slopes are those of about so many intervals (sigma of a Gaussian), where the vehicle drives at least so many metres in each.
_SMOOTHED, _DRIVEN_M = 4.0, 0.1
_NAMES = ("easting and northing", "height", "roll and pitch", "heading")
assert len(_NAMES) == len(GROUPS)


def check_path(trajectory: RefinedTrajectory, params: TrajectoryParams, limits: PathCheckParams) -> list[Finding]:
    """Distances, directions, lever arm and heights of a log against the images, and its stated sigmas."""
    findings, fit = [_stated_sigmas(trajectory, limits)], trajectory.path
    if fit is None or not fit.is_shown:
        return findings
    sigma = fit.sigma_of_any.copy()
    sigma[:3] = np.hypot(sigma[:3], fit.stated)
    k, way = max(((ASIDE, "sideways"), (UP, "up or down")), key=lambda one: abs(fit.found[one[0]]) / sigma[one[0]])
    arms = list(zip(fit.found[LEVER], sigma[LEVER], ("forward", "left"), strict=False))
    arm_m, arm_sigma_m, arm_way = max(arms, key=lambda one: abs(one[0]) / one[1])
    treated = ["widened" if doubtful else "" for doubtful in fit.doubtful]
    angle_deg, angle_sigma_deg = np.degrees([abs(fit.found[k]), sigma[k]]).tolist()
    return [
        *findings,
        Finding(
            check=DISTANCES, value=100 * float(fit.found[SCALE]), sigma=100 * float(sigma[SCALE]), treated=treated[SCALE],
            effect_m=_drift_m(fit, SCALE), says=("", "covered"),
        ),
        Finding(
            check="alignment of cameras and GNSS/INS", value=angle_deg, sigma=angle_sigma_deg, treated=treated[k],
            effect_m=_drift_m(fit, ASIDE, UP), says=("", "covered"),
            facts={"way": way, "drift_cm": 100 * float(abs(fit.found[k]))},
        ),
        Finding(check="lever arm of the cameras", value=float(arm_m), sigma=float(arm_sigma_m), facts={"way": arm_way}),
        _heights(fit, trajectory.errors or assumed_errors(params)),
    ]  # fmt: skip


def _drift_m(fit: PathFit, *which: int) -> float:
    """By how much the positions of a drive differ if the log drifts so, from one end of the path to the other. A wrong scale or
    alignment is less in cones: they are nearer than the path is long."""
    return float(np.linalg.norm(np.ptp(fit.changes[:, :, which] @ fit.found[list(which)], axis=0)))


def _heights(fit: PathFit, errors: LogErrors) -> Finding:
    """By what factor the log climbs more than the images."""
    difference, records = fit.difference, fit.records
    climbs = np.zeros((*fit.changes.shape[:2], 1))
    steps = np.diff(difference.measured_var, axis=0, prepend=0.0)
    measured = steps[:, 2] < UNKNOWN / 2  # across gaps, the path is that of the log
    climbs[:, 2, 0] = np.cumsum(np.diff(difference.path_m[:, 2], prepend=0.0) * measured)
    changes = np.concatenate([fit.changes, climbs], axis=2)
    prior = np.append(fit.prior, _HEIGHTS_PRIOR)
    found, cov = fitted_changes(difference, records, errors, changes, prior)
    alike = sigma_of_any_shape(records, changes, prior)[-1]
    # Errors of the measured path look like climbs that GNSS/INS does not have: the factor is too small by their share.
    frames = compared_frames(records)
    even = np.column_stack([np.ones(len(frames)), difference.driven_m[frames]])
    rest = np.eye(len(frames)) - even @ np.linalg.pinv(even)
    shown = float(np.square(rest @ climbs[frames, 2, 0]).sum())
    known = difference._replace(measured_var=np.cumsum(steps * measured[:, None], axis=0))
    wrong = float(np.trace(rest @ measured_cov(known, records.stated, frames, 2) @ rest)) / max(shown, 1e-12)
    # So do those of the attitudes, with which the images are turned.
    wrong += float(fit.stated[UP]) ** 2 / max(_slope_variance(climbs[:, 2, 0], difference.driven_m), 1e-12)
    factor, sigma = 1 + float(found[-1]), float(np.linalg.norm([cov[-1, -1] ** 0.5, alike, wrong]))
    likely = {1 / _FOOT_M: "feet", _FOOT_M: "feet twice"}
    named = (cause for times, cause in likely.items() if abs(factor / times - 1) < _SAME_FACTOR)
    says = "", "sign" if factor < 0 else next(named, "unit")
    return Finding(check="heights of GNSS/INS", value=factor, sigma=sigma, says=says)


def _slope_variance(climbs_m: Floats, driven_m: Floats) -> float:
    """Variance of the slope of the road within some intervals, where the vehicle drives."""
    lengths_m = np.abs(np.diff(driven_m))
    slopes = gaussian_filter1d(np.diff(climbs_m), _SMOOTHED) / np.maximum(gaussian_filter1d(lengths_m, _SMOOTHED), 1e-9)
    driven = lengths_m > _DRIVEN_M
    return float(slopes[driven].var()) if driven.any() else 0.0


def _stated_sigmas(trajectory: RefinedTrajectory, limits: PathCheckParams) -> Finding:
    """By what factor the stated sigmas are too small, where the images show that."""
    if trajectory.outcome is RefinementOutcome.AGAINST_STATED_SIGMAS:
        return Finding(check=SIGMAS, found=True, says=("moved",), facts={"outcome": sentence(trajectory.detail)})
    if trajectory.errors is None:
        return Finding(check=SIGMAS)
    factor, group = max((shares.factor**0.5, k) for k, shares in enumerate(trajectory.errors))
    return Finding(
        check=SIGMAS, value=factor, treated="widened" if factor > limits.worth_saying else "", facts={"of": _NAMES[group]},
        says=("", "widened" if factor <= limits.sigma_factor else "beyond"),
    )  # fmt: skip


def sentence(detail: str) -> str:
    """A detail as a sentence of its own."""
    return f"{detail[0].upper()}{detail[1:]}."
