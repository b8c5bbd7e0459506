"""Drives that are what they say they are: paths with bends, braking and stops, logs and odometry with errors as stated.

Nothing here may be held. RTK or plain GNSS whose sigmas change along the drive and part of whose error stays the same, INS
attitudes, visual odometry that fails at times and in runs, clock and lever arm off by their priors, a calibration off by its
stated covariance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from conetl.checks.verdict import judge, judge_all
from conetl.geometry import pose as se3
from conetl.geometry.consistency import Nees
from conetl.geometry.motion.stereo_motion import RelativeMotion
from conetl.model.drive import FramePair
from conetl.model.health import HealthCheck
from conetl.model.params import IngestParams, TrajectoryParams
from conetl.tracking.checks.poses import check_calibration, check_trajectory
from conetl.tracking.clock import ClockOffset, estimate_clock
from conetl.tracking.drive_refinement import refine_with_cones
from conetl.tracking.self_calibration import SelfCalibration, Span, self_calibrate
from conetl.tracking.trajectory import RefinedTrajectory, measured_motions, read_log
from tests.synthetic.odometry import STEP_S, log_of, motions_of, pose_errors
from tests.synthetic.spans import CX_PX, FOCAL_PX, followed, make_span
from tests.synthetic.world import ORIGIN_M, calibrated, make_rig

Floats = NDArray[np.float64]
PARAMS, RIG = TrajectoryParams(), make_rig()
_FINE_S = 0.01
_BEND_M_S2, _BRAKING_M_S2 = 2.5, 3.0
_SPANS, _POINTS = 16, 60


@dataclass(frozen=True)
class GoodDrive:
    """A drawn drive and the truth about it."""

    kind: str
    truth: Floats
    """(K, 4, 4) body -> map at the instants of the images."""
    logged: list[FramePair]
    motions: list[RelativeMotion]
    offset_s: float
    """By how much the stamps of the poses lag."""


class Path:
    """A path over time: straight or with bends, at 5 to 25 m/s, with braking and stops."""

    def __init__(self, rng: np.random.Generator, lasts_s: float, *, turns: bool) -> None:
        self._fine_s = np.arange(-1.0, lasts_s + 1.0, _FINE_S)
        count = len(self._fine_s)
        cruise = rng.uniform(5.0, 25.0)
        wanted = np.full(count, cruise)
        at = 0.0
        while (at := at + rng.exponential(15.0)) < lasts_s:  # slower for some seconds, or a stop
            slower = (self._fine_s > at) & (self._fine_s < at + rng.uniform(2.0, 10.0))
            wanted[slower] = cruise * rng.choice([0.0, rng.uniform(0.3, 0.9)])
        speed = np.empty(count)
        speed[0] = wanted[0]
        step = _BRAKING_M_S2 * _FINE_S
        for k in range(1, count):
            speed[k] = speed[k - 1] + np.clip(wanted[k] - speed[k - 1], -step, 0.6 * step)
        speed = gaussian_filter1d(speed, 0.4 / _FINE_S, mode="nearest")
        curvature = np.zeros(count)
        at = -1.0
        while turns and (at := at + rng.exponential(5.0)) < lasts_s:
            tightest = min(_BEND_M_S2 / max(cruise, 5.0) ** 2, 1 / 12)
            bent = (self._fine_s > at) & (self._fine_s < at + rng.uniform(1.5, 6.0))
            curvature[bent] = rng.uniform(-1, 1) * tightest
        curvature = gaussian_filter1d(curvature, 0.5 / _FINE_S, mode="nearest")
        sway = 0.003 * np.sin(2 * np.pi * rng.uniform(0.05, 0.2) * self._fine_s + rng.uniform(0, 6))  # within the lane
        yaw = rng.uniform(-3, 3) + np.cumsum(curvature * speed) * _FINE_S + sway
        pitch = -0.003 * np.gradient(speed, _FINE_S) + 0.003 * np.sin(2 * np.pi * 0.7 * self._fine_s)
        roll = 0.004 * curvature * speed**2 + 0.003 * np.sin(2 * np.pi * 0.5 * self._fine_s)
        along = np.stack([np.cos(yaw), np.sin(yaw), np.full(count, rng.normal(0, 0.01))])
        self._columns = (*np.cumsum(along * speed * _FINE_S, axis=1), roll, pitch, yaw)

    def poses_at(self, times_s: Floats) -> Floats:
        """(K, 4, 4) body -> map."""
        x, y, z, roll, pitch, yaw = (np.interp(times_s, self._fine_s, column) for column in self._columns)
        return se3.se3(se3.rotation_from_rpy(roll, pitch, yaw), np.stack([x, y, z], axis=1) + ORIGIN_M)


def draw_drive(
    rng: np.random.Generator,
    *,
    offset_s: float | None = None,
    turns: bool | None = None,
    constant_share: float | None = None,
    steady: bool = False,
    lasts_s: float | None = None,
    sigma_rad: float | None = None,
) -> GoodDrive:
    """A drive of 6 to 60 s; what is not given is drawn. offset_s: of the clocks.

    constant_share: of the variance of the best record, what stays the same over the drive. steady: with one stated sigma of the
    place. sigma_rad: of roll and pitch; three times that of heading.
    """
    times_s = np.arange(int((lasts_s or rng.uniform(6.0, 60.0)) / STEP_S)) * STEP_S
    turns = bool(rng.uniform() < 0.6) if turns is None else turns
    path = Path(rng, float(times_s[-1]), turns=turns)
    offset_s = rng.normal(0, PARAMS.clock_sigma_s) if offset_s is None else offset_s
    truth, stamped = path.poses_at(times_s), path.poses_at(times_s + offset_s)
    stamped[:, :3, 3] += stamped[:, :3, :3] @ rng.normal(0, PARAMS.lever_arm_sigma_m, 3)
    rtk = rng.uniform() < 0.5
    best_m = 0.02 if rtk else rng.uniform(0.3, 1.5)
    growth = np.exp(3 * gaussian_filter1d(rng.normal(0, 1, len(times_s) + 300), 30)[150:-150])
    sigma_m = best_m * (np.ones(len(times_s)) if steady else growth / growth.min())
    share = rng.uniform() if constant_share is None else constant_share
    sigma_rad = sigma_rad or float(rng.choice([0.0009, 0.003]))
    logged = log_of(stamped, rng, sigma_m, sigma_rad, PARAMS, best_m * share**0.5)
    motions = motions_of(truth, RIG, rng, PARAMS)
    lost = rng.uniform(size=len(motions)) < rng.uniform(0.0, 0.2)
    if rng.uniform() < 0.6:
        first = int(rng.integers(len(motions)))
        lost[first : first + int(rng.uniform(0.1, 0.25) * len(motions))] = True
    motions = [m if not gone else failed(m) for m, gone in zip(motions, lost, strict=True)]
    kind = f"{'RTK' if rtk else 'plain GNSS'}, {'with bends' if turns else 'straight'}"
    return GoodDrive(kind, truth, logged, motions, offset_s)


def failed(motion: RelativeMotion) -> RelativeMotion:
    """The same interval, not measured."""
    return motion.model_copy(update={"second_SE3_first": None, "cov": (), "reason": "too_few_points"})


def checked(drive: GoodDrive) -> tuple[RefinedTrajectory, list[HealthCheck]]:
    """The refined trajectory of a drive, and the checks of it."""
    refined = refine_with_cones(drive.logged, RIG, drive.motions, [], IngestParams())
    seen = [pair.model_copy(update={"detail": 10.0}) for pair in refined.logged]
    return refined, judge_all(check_trajectory(seen, RIG, drive.motions, refined, PARAMS))


def position_nees(drive: GoodDrive, refined: RefinedTrajectory, frame: int) -> Nees:
    """Of one refined position."""
    assert refined.covariance is not None
    off = pose_errors(refined.frame_pairs, drive.truth)[frame, :3]
    return Nees(float(off @ np.linalg.solve(refined.covariance.of(frame)[:3, :3], off)), 3)


def clock_of(drive: GoodDrive) -> ClockOffset | None:
    """The offset of the clocks as the drive shows it."""
    log, motions = read_log(drive.logged, RIG, PARAMS), measured_motions(drive.logged, drive.motions, PARAMS)
    return estimate_clock(drive.logged, log, motions)


def draw_calibration(rng: np.random.Generator) -> tuple[SelfCalibration, list[HealthCheck]]:
    """Self-calibration of a rig whose calibration is off by its covariance, stated or assumed, and the check of it."""
    unknown = rng.uniform() < 0.3
    px = PARAMS.self_calibration_prior_px if unknown else rng.uniform(0.1, 0.7)
    sigma = dict.fromkeys(("relative.rx_rad", "relative.ry_rad", "relative.rz_rad"), px / FOCAL_PX)
    if not unknown:
        sigma |= dict.fromkeys(("right.cx_px", "left.fx_px", "right.fx_px", "right.cy_px"), px)
    error = {name: rng.normal(0, size) for name, size in sigma.items()}
    turn = np.array([error[f"relative.r{axis}_rad"] for axis in "xyz"])
    spans, tracks = [], []
    for k in range(_SPANS):
        made = make_span(rng, turn, points=_POINTS, way_m=rng.uniform(2.0, 3.0))
        for seen in (made.first_px, made.last_px):
            for column, name in ((0, "left.fx_px"), (2, "right.fx_px")):
                seen[:, column] += error.get(name, 0.0) * (seen[:, column] - CX_PX) / FOCAL_PX
            seen[:, 2] += error.get("right.cx_px", 0.0)
            seen[:, 3] += error.get("right.cy_px", 0.0)
        spans.append(Span(k, k + 1, made.last_SE3_first))
        tracks.append(followed(made, k))
    found = self_calibrate(RIG if unknown else calibrated(RIG, sigma), spans, tracks, PARAMS)
    return found, [judge(check_calibration(found))]
