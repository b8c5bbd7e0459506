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
from conetl.model.health import HealthCheck, Verdict, hold_if
from conetl.tracking.clock import robust_fit

#: What is known beforehand (one sigma) of roll, pitch, yaw (rad), of right, down, forward (m), and of the scale of the motions.
_PRIOR = (0.1, 0.1, 0.1, 3.0, 3.0, 3.0, 0.02)
#: Errors are at least this many degrees or metres, and this many sigmas: 120 simulated good drives have up to 3.8.
_LEAST_DEG, _LEAST_M, _SIGMAS = 1.0, 0.3, 5.5
_LEAST_MOTIONS, _ROUNDS = 20, 6
#: Prior of the share by which images show more pitch than the log, and of what smoothing takes from turns, in their second
#: differences; the share is at least this much, and this many sigmas.
_STRETCH_PRIOR, _LEAST_STRETCH, _STRETCH_SIGMAS = (0.3, 1.0), 0.05, 5.0
#: Prior of the share by which the log climbs more than the images; it is at least this much, and this many sigmas.
_HEIGHTS_PRIOR, _LEAST_HEIGHTS, _HEIGHTS_SIGMAS, _FOOT_M, _SAME_FACTOR = 3.0, 0.3, 6.0, 0.3048, 0.3
#: Slopes are those of about so many intervals (sigma of a Gaussian), where the vehicle drives at least so many metres in each.
_SMOOTHED, _DRIVEN_M = 4.0, 0.1


def check_mount(log: LoggedPoses, measured: MeasuredMotions, good: Bools, residual: Floats) -> list[HealthCheck]:
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
    roll_deg, (right_m, _, forward_m) = np.degrees(fit.solution[0]), fit.solution[3:6]
    roll_sigma_deg = np.degrees(np.hypot(sigmas[0], log.drift[:, 3].max()))
    arm = max((-right_m, sigmas[3], "left"), (forward_m, sigmas[5], "forward"), key=lambda one: abs(one[0]) / one[1])
    return [
        _judged("roll of the cameras", roll_deg, roll_sigma_deg, _LEAST_DEG, "degrees", "rolled", "left side up"),
        _judged("lever arm of the cameras", arm[0], arm[1], _LEAST_M, "m", "mounted", arm[2]),
        _check_stretch(residual[good], by, turns),
        heights,
    ]  # fmt: skip


def _check_heights(log: LoggedPoses, measured: MeasuredMotions, by: Floats, residual: Floats) -> HealthCheck:
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
    limit = max(_LEAST_HEIGHTS, _HEIGHTS_SIGMAS * sigma)
    held = abs(factor - 1) > limit
    detail = "GNSS/INS and images show the same climbs, or the road is too level for this check."
    if held:
        likely = {1 / _FOOT_M: "they are in feet", _FOOT_M: "they were converted from feet twice"}
        named = (cause for times, cause in likely.items() if abs(factor / times - 1) < _SAME_FACTOR)
        cause = "their sign is wrong" if factor < 0 else next(named, "they have another unit or are filtered")
        detail = (
            f"In GNSS/INS the vehicle climbs {factor:.2f} +- {sigma:.2f} times as much as in the images. Check the heights of "
            f"the log: perhaps {cause}."
        )
    factor, sigma, limit = np.round([factor, sigma, limit], 3).tolist()
    return hold_if(held, "heights of GNSS/INS", detail, value=factor, sigma=sigma, limit=limit)


def _check_stretch(residual: Floats, by: Floats, turns: Floats) -> HealthCheck:
    """Whether the images were stretched vertically. by: (N, 6, 7) derivatives of the residuals (N, 6); turns: (N, 3) rad."""
    more, first = np.zeros((*residual.shape, 2)), len(_PRIOR)
    more[:, 0, 0], more[1:-1, :3, 1] = turns[:, 0], np.diff(turns, 2, axis=0)
    columns, prior = np.concatenate([by, more], axis=2), np.diag(np.array([*_PRIOR, *_STRETCH_PRIOR]) ** -2)
    found = []
    for count in (first + 1, first + 2):  # without and with smoothed attitudes: both have to show it
        fit = robust_fit(residual, columns[..., :count], prior[:count, :count], _ROUNDS)
        found.append((float(fit.solution[first]), float(np.linalg.inv(fit.normal)[first, first] ** 0.5)))
    share, sigma = min(found, key=lambda one: abs(one[0]) / one[1])
    least = min(abs(one) for one, _ in found) if found[0][0] * found[1][0] > 0 else 0.0
    warned = least > _LEAST_STRETCH and abs(share) > _STRETCH_SIGMAS * sigma
    detail = "Images and GNSS/INS show the same pitch of the vehicle."
    if warned:
        detail = (
            f"In the images the vehicle pitches {100 * share:+.0f} +- {100 * sigma:.0f} % more than in GNSS/INS: they were "
            "stretched vertically (wrong aspect ratio of the video?), or fy of the calibration is wrong. Heights relative to the "
            "cameras are wrong by the same percentage. Deliver the original images, or calibrate the rig (conetl calibrate)."
        )
    return HealthCheck(
        name="aspect ratio of the images", verdict=Verdict.WARN if warned else Verdict.PASS, value=round(100 * share, 1),
        sigma=round(100 * sigma, 1), limit=round(100 * max(_LEAST_STRETCH, _STRETCH_SIGMAS * sigma), 1), unit="%", detail=detail,
    )  # fmt: skip


def _judged(name: str, value: float, sigma: float, least: float, unit: str, how: str, positive: str) -> HealthCheck:
    limit = max(least, _SIGMAS * sigma)
    held = abs(value) > limit
    detail = "In turns, the images agree with the mount of the cameras."
    if held:
        detail = (
            f"In turns, the images show the cameras {how} by {value:+.2f} +- {sigma:.2f} {unit} ({positive}) relative to the "
            "calibration and GNSS/INS: correct body_SE3_left in rig.yaml (mount in drive.yaml; KITTI: calib_imu_to_velo.txt), or "
            "the axes and antenna position of the GNSS/INS log."
        )
    value, sigma, limit = np.round([value, sigma, limit], 3).tolist()
    return hold_if(held, name, detail, value=value, sigma=sigma, limit=limit, unit=unit)
