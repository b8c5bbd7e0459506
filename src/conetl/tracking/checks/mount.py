"""Health checks by turns and slopes: whether lever arm and roll of the cameras on the body, and the shape of their pixels, are
those of the calibration, and whether the log's heights have the right unit and sign.

The direction of motion shows which way they look (`poses.py`), but not their roll about that direction, nor the lever arm. Turns
do: the images turn about an axis that is rolled against that of the log, and cameras elsewhere move otherwise. (Hand-eye
calibration, Tsai & Lenz 1989, for small errors.) Images that were stretched vertically leave all distances as they are and make
heights wrong; they show the vehicle pitching more than it does. So do attitudes that are smoothed, or interpolated between few
records, but these lack the faster part of every turn.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from conetl.geometry.motion.pose_graph import LoggedPoses, MeasuredMotions
from conetl.geometry.small_arrays import cross_matrix
from conetl.model.arrays import Bools, Floats
from conetl.model.health import Finding
from conetl.model.params import MountCheckParams
from conetl.tracking.clock import robust_fit

#: What is known beforehand (one sigma) of roll, pitch, yaw (rad), of right, down, forward (m), and of the scale of the motions.
_PRIOR = (0.1, 0.1, 0.1, 3.0, 3.0, 3.0, 0.02)
STRETCH = "aspect ratio of the images"
_LEAST_MOTIONS, _ROUNDS = 20, 6
#: Prior of the share by which images show more pitch than the log, and of what smoothing takes from turns, in their second
#: differences; and of the share by which the log climbs more than the images.
_STRETCH_PRIOR, _HEIGHTS_PRIOR = (0.3, 1.0), 3.0
#: Heights have another unit where the factor is one foot in metres, to this share.
_FOOT_M, _SAME_FACTOR = 0.3048, 0.3
#: Slopes are those of about so many intervals (sigma of a Gaussian), where the vehicle drives at least so many metres in each.
_SMOOTHED, _DRIVEN_M = 4.0, 0.1


def check_mount(
    log: LoggedPoses, measured: MeasuredMotions, good: Bools, residual: Floats, limits: MountCheckParams
) -> list[Finding]:
    """The roll of the cameras, their lever arm and the height of their pixels by the motions that are plausible (M,).

    residual: (M, 6), measured minus logged. The log has more noise than the images, so the measured motions show the turns.
    """
    if good.size < _LEAST_MOTIONS:
        return []
    motions = measured.next_SE3_first
    turns, moves = Rotation.from_matrix(motions[:, :3, :3]).as_rotvec(), motions[:, :3, 3]
    by = np.zeros((len(motions), 6, len(_PRIOR)))
    by[:, :3, :3], by[:, 3:, :3] = (np.roll(cross_matrix(part), 1, axis=2) for part in (turns, moves))
    by[:, 3:, 3:6], by[:, 3:, 6] = motions[:, :3, :3] - np.eye(3), moves
    heights = _check_heights(log, measured, by, residual)  # of all, since wrong heights leave few that are plausible
    if good.sum() < _LEAST_MOTIONS:
        return [heights]
    by, turns = by[good], turns[good]
    fit = robust_fit(residual[good], by, np.diag(np.array(_PRIOR) ** -2), _ROUNDS)
    sigmas = np.sqrt(np.diag(np.linalg.inv(fit.normal)))
    (right_m, _, forward_m), roll_sigma = fit.solution[3:6], np.hypot(sigmas[0], log.drift[:, 3].max())
    arm = max((-right_m, sigmas[3], "left"), (forward_m, sigmas[5], "forward"), key=lambda one: abs(one[0]) / one[1])
    roll_deg, roll_sigma_deg = np.degrees([fit.solution[0], roll_sigma]).tolist()
    return [
        Finding(check="roll of the cameras", value=roll_deg, sigma=roll_sigma_deg),
        Finding(check="lever arm of the cameras", value=float(arm[0]), sigma=float(arm[1]), facts={"way": arm[2]}),
        _check_stretch(residual[good], by, turns, limits),
        heights,
    ]


def _check_heights(log: LoggedPoses, measured: MeasuredMotions, by: Floats, residual: Floats) -> Finding:
    """Whether the vehicle climbs by GNSS/INS as it does in the images. by: (M, 6, 7) derivatives of the residuals (M, 6)."""
    map_R_left = log.rotations[measured.start + 1] @ log.body_SE3_left[:3, :3]
    moves = measured.next_SE3_first[:, :3, 3]
    climbs_m = gaussian_filter1d(-np.einsum("mj,mj->m", map_R_left[:, 2], moves), _SMOOTHED, mode="nearest")
    columns = np.concatenate([(map_R_left[:, 2] * climbs_m[:, None])[..., None], by[:, 3:]], axis=2)
    fit = robust_fit(residual[:, 3:], columns, np.diag(np.array([_HEIGHTS_PRIOR, *_PRIOR]) ** -2), _ROUNDS)
    # Errors of the attitudes look like slopes that GNSS/INS does not have: the factor is too small by their share.
    lengths_m = np.linalg.norm(moves, axis=1)
    slopes = climbs_m[lengths_m > _DRIVEN_M] / lengths_m[lengths_m > _DRIVEN_M]
    wrong = float(np.median(log.drift[:, 3:5].max(axis=1))) ** 2 / max(
        float(slopes.var()) if slopes.size else 0.0, 1e-12
    )
    factor, sigma = 1 + float(fit.solution[0]), float(np.hypot(np.linalg.inv(fit.normal)[0, 0] ** 0.5, wrong))
    likely = {1 / _FOOT_M: "feet", _FOOT_M: "feet twice"}
    named = (cause for times, cause in likely.items() if abs(factor / times - 1) < _SAME_FACTOR)
    cause = "sign" if factor < 0 else next(named, "unit")
    return Finding(check="heights of GNSS/INS", value=factor, sigma=sigma, says=("", cause))


def _check_stretch(residual: Floats, by: Floats, turns: Floats, limits: MountCheckParams) -> Finding:
    """Whether the images were stretched vertically. by: (N, 6, 7) derivatives of the residuals (N, 6); turns: (N, 3) rad."""
    more, first = np.zeros((*residual.shape, 2)), len(_PRIOR)
    more[:, 0, 0], more[1:-1, :3, 1] = turns[:, 0], np.diff(turns, 2, axis=0)
    columns, prior = np.concatenate([by, more], axis=2), np.diag(np.array([*_PRIOR, *_STRETCH_PRIOR]) ** -2)
    found = []
    for count in (first + 1, first + 2):  # without and with smoothed attitudes: both have to show it
        fit = robust_fit(residual, columns[..., :count], prior[:count, :count], _ROUNDS)
        found.append((100 * float(fit.solution[first]), 100 * float(np.linalg.inv(fit.normal)[first, first] ** 0.5)))
    share, sigma = min(found, key=lambda one: abs(one[0]) / max(limits.stretch_percent, limits.stretch_sigmas * one[1]))
    opposite = found[0][0] * found[1][0] <= 0
    return Finding(check=STRETCH, value=share, sigma=sigma, found=False if opposite else None)
