"""Health checks by turns: whether the roll of the cameras on the body, and the shape of their pixels, are as calibrated.

The direction of motion shows which way they look (`path.py`), but not their roll about that direction. Turns do: the images turn
about an axis that is rolled against that of the log (hand-eye calibration, Tsai & Lenz 1989, for small errors). Images that were
stretched vertically leave all distances as they are and make heights wrong; they show the vehicle pitching more than it does. So
do attitudes that are smoothed, or interpolated between few records, but these lack the faster part of every turn.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from conetl.geometry.motion.pose_graph import LoggedPoses, MeasuredMotions
from conetl.geometry.small_arrays import cross_matrix
from conetl.model.arrays import Bools, Floats
from conetl.model.check_params import MountCheckParams
from conetl.model.health import Finding
from conetl.tracking.clock import robust_fit

#: What is known beforehand (one sigma) of roll, pitch, yaw (rad), of right, down, forward (m), and of the scale of the motions.
_PRIOR = (0.1, 0.1, 0.1, 3.0, 3.0, 3.0, 0.02)
STRETCH = "aspect ratio of the images"
_LEAST_MOTIONS, _ROUNDS = 20, 6
#: Prior of the share by which images show more pitch than the log, and of what smoothing takes from turns, in their second
#: differences.
_STRETCH_PRIOR = (0.3, 1.0)


def check_mount(
    log: LoggedPoses, measured: MeasuredMotions, good: Bools, residual: Floats, limits: MountCheckParams
) -> list[Finding]:
    """The roll of the cameras and the height of their pixels by the motions that are plausible (M,).

    residual: (M, 6), measured minus logged. The log has more noise than the images, so the measured motions show the turns.
    """
    if good.sum() < _LEAST_MOTIONS:
        return []
    motions = measured.next_SE3_first
    turns, moves = Rotation.from_matrix(motions[:, :3, :3]).as_rotvec(), motions[:, :3, 3]
    by = np.zeros((len(motions), 6, len(_PRIOR)))
    by[:, :3, :3], by[:, 3:, :3] = (np.roll(cross_matrix(part), 1, axis=2) for part in (turns, moves))
    by[:, 3:, 3:6], by[:, 3:, 6] = motions[:, :3, :3] - np.eye(3), moves
    by, turns = by[good], turns[good]
    fit = robust_fit(residual[good], by, np.diag(np.array(_PRIOR) ** -2), _ROUNDS)
    sigmas = np.sqrt(np.diag(np.linalg.inv(fit.normal)))
    roll_deg, roll_sigma_deg = np.degrees([fit.solution[0], np.hypot(sigmas[0], log.drift[:, 3].max())]).tolist()
    return [
        Finding(check="roll of the cameras", value=roll_deg, sigma=roll_sigma_deg),
        _check_stretch(residual[good], by, turns, limits),
    ]


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
