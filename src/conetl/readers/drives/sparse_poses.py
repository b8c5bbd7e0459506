"""Poses at the exposures from sparse records (a 1 Hz receiver), with or without attitude.

Positions between the records are those of a smoothing spline, and without a recorded attitude heading and pitch are those of its
course (`geometry/motion/position_spline.py`). What that adds to the sigmas is marked in each pose (`Pose.interpolated`), so that
the frame pairs between two records do not count as measurements of their own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from conetl.files.documents import input_errors
from conetl.geometry import geodesy
from conetl.geometry import pose as se3
from conetl.geometry.motion import position_spline
from conetl.geometry.motion.position_spline import PositionSpline
from conetl.geometry.packing import vec3
from conetl.model.arrays import Floats
from conetl.model.drive import Interpolated, Pose
from conetl.model.errors import InputError
from conetl.model.params import TrajectoryParams
from conetl.readers.drives.drive_yaml import MAX_POSE_GAP_S
from conetl.readers.drives.poses import Samples, around, at
from conetl.readers.trajectories.recorded import RecordedTrajectory

#: Records farther apart than this (median, s) are sparse: straight lines between them would cut bends by more than centimetres.
SPARSE_S = 0.3
#: Sparse records are interpolated over gaps of so many times their median distance, a lost one, and at most so long (s).
_GAP_FACTOR, _LONGEST_GAP_S = 2.5, 5.0
#: Of a spline; two are joined by a straight line.
_LEAST_RECORDS = 3
#: Angular acceleration of a vehicle (rad/s^2, one sigma; roll, pitch, yaw): by it a slerp between sparse attitudes errs.
_TURNS_RAD_S2 = np.array([0.1, 0.1, 0.5])


def pose_reader(
    track: Samples, exposures_ns: Sequence[int], max_gap_s: float | None = None, *, from_course: bool = False
) -> Callable[[int], Pose]:
    """Pose of the body at each of the exposures, by the trajectory's clock (ns); the function raises PairError for those that
    have none.

    from_course: the attitudes are not recorded (`with_course`). max_gap_s: `max_pose_gap_s` of drive.yaml; without it records
    are interpolated over gaps of 0.5 s, and sparse ones over 2.5 times their median distance, at most 5 s; never over more than
    60 s. A dense trajectory with attitudes, or of two records, is interpolated in straight lines (`poses.at`). Raises
    InputError where positions alone do not show a heading.
    """
    step_s = float(np.median(np.diff(track.times_ns))) * 1e-9 if len(track.times_ns) > 1 else 0.0
    sparse = step_s > SPARSE_S
    usual_s = min(_GAP_FACTOR * step_s, _LONGEST_GAP_S) if sparse else MAX_POSE_GAP_S
    gap_s = max_gap_s or max(usual_s, MAX_POSE_GAP_S)
    if not from_course and (not sparse or len(track.times_ns) < _LEAST_RECORDS):
        return lambda time_ns: se3.to_pose(*at(track, time_ns, round(gap_s * 1e9)))
    gap_ns = round(min(gap_s, position_spline.LONGEST_GAP_S) * 1e9)
    spline = _spline(track.name, track.times_ns, track.map_SE3_body[:, :3, 3], track.sigma[:, :3])
    inside = sorted({t for t in exposures_ns if track.times_ns[0] <= t <= track.times_ns[-1]})
    times_s = _seconds(inside, track.times_ns[0])
    moved = position_spline.states_at(spline, times_s)
    if from_course:
        rotations, angles, short = _course(track.name, spline, times_s)
    rank = {t: k for k, t in enumerate(inside)}

    def pose_at(time_ns: int) -> Pose:
        first, second = around(track, time_ns, gap_ns, across_bad=True)
        k = rank[time_ns]
        apart_s = max(track.times_ns[second] - track.times_ns[first], 1) * 1e-9 if first != second else step_s
        sigma = np.maximum(track.sigma[first], track.sigma[second])
        if from_course:
            rotation, sigma_rpy, turned = rotations[k], angles[k], short[k]
        else:
            weight = (time_ns - track.times_ns[first]) * 1e-9 / apart_s
            rotation = se3.interpolate(track.map_SE3_body[first], track.map_SE3_body[second], weight)[:3, :3]
            turned = _TURNS_RAD_S2 * apart_s**2 / 2 * weight * (1 - weight)
            sigma_rpy = np.hypot(sigma[3:], turned)
        sigma_enu = np.hypot(moved.slow_m[k], moved.sigma_m[k])
        pose = se3.to_pose(se3.se3(rotation, moved.positions_m[k]), np.concatenate([sigma_enu, sigma_rpy]))
        part = Interpolated(sigma_enu_m=vec3(moved.sigma_m[k]), sigma_rpy_rad=vec3(turned), apart_s=apart_s)
        return pose.model_copy(update={"interpolated": part})

    return pose_at


def with_course(recorded: RecordedTrajectory) -> RecordedTrajectory:
    """The same trajectory with attitudes from its course, and their sigmas, where it has none.

    Yaw is the course, pitch the grade, roll zero; see `course_attitude`. Raises InputError where the vehicle never moves.
    """
    if recorded.rotations is not None:
        return recorded
    positions, convergence = recorded.positions, np.zeros(len(recorded.positions))
    if not recorded.is_local:
        lat, lon, height = recorded.positions.T
        srid = geodesy.utm_srid(float(lat[0]), float(lon[0]))
        positions = geodesy.to_map(srid, lat, lon, height)
        convergence = geodesy.grid_convergence_rad(srid, lat, lon)
    sigma = np.where(
        np.isfinite(recorded.sigma[:, :3]), recorded.sigma[:, :3], 1.0
    )  # only the smoothness depends on it
    times_ns = recorded.times_ns.tolist()
    spline = _spline(recorded.name, times_ns, positions, sigma)
    grid_R_body, angles, _ = _course(recorded.name, spline, _seconds(times_ns, times_ns[0]))
    enu_R_grid = se3.rotation_from_rpy(np.zeros(len(times_ns)), np.zeros(len(times_ns)), -convergence)
    rotations = np.asarray(enu_R_grid @ grid_R_body, dtype=np.float64)
    return recorded._replace(rotations=rotations, sigma=np.hstack([recorded.sigma[:, :3], angles]))


def _spline(name: str, times_ns: Sequence[int], positions_m: Floats, sigma_m: Floats) -> PositionSpline:
    defaults = TrajectoryParams()
    with input_errors(f"{name}: positions cannot be interpolated"):
        return position_spline.position_spline(
            _seconds(times_ns, times_ns[0]), positions_m, sigma_m, white_share=defaults.gnss_white_share,
            correlation_s=defaults.gnss_correlation_s,
        )  # fmt: skip


def _course(name: str, spline: PositionSpline, times_s: Floats) -> tuple[Floats, Floats, Floats]:
    try:
        return position_spline.course_attitude(spline, times_s)
    except ValueError as error:
        raise InputError(f"{name}: it has no attitudes, and {error}; record a drive or the attitudes") from error


def _seconds(times_ns: Sequence[int], first_ns: int) -> Floats:
    return np.asarray((np.array(times_ns, dtype=np.int64) - first_ns) * 1e-9)
