"""OXTS records of KITTI (readers/trajectories/oxts.py) -> poses of the IMU in the map frame, by frame number."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from conetl.geometry import geodesy
from conetl.geometry import pose as se3
from conetl.model.records import Pose
from conetl.readers.drives.drive_yaml import Sigmas
from conetl.readers.drives.poses import attitude_sigmas, to_pose, wild_fixes
from conetl.readers.trajectories.oxts import OxtsRecord
from conetl.readers.trajectories.recorded import VERTICAL_FACTOR

Array = NDArray[np.float64]

MAX_GAP_NS = 500_000_000
"""Poses farther apart in time than this are not interpolated."""


class OxtsTrajectory(NamedTuple):
    """Poses of the IMU by frame number, and their times where they are known."""

    numbers: list[int]
    """Rising, of the valid records."""
    map_SE3_body: Array
    """(N, 4, 4)"""
    sigma_enu_m: Array
    """(N, 3)"""
    times_ns: dict[int, int]
    """By frame number; frames without a time are missing."""
    rows: dict[int, int]
    """Row of the arrays by frame number."""


def trajectory(
    records: Mapping[int, OxtsRecord], times_ns: Mapping[int, int], srid: int, sigmas: Sigmas
) -> OxtsTrajectory:
    """Poses in the map frame: positions by the map projection, yaw turned from true to grid east by the convergence.

    Raises ValueError where the map CRS cannot express the positions.
    """
    numbers = sorted(records)
    table = np.array([records[number] for number in numbers])
    positions = geodesy.to_map(srid, table[:, 0], table[:, 1], table[:, 2])
    grid_yaw = table[:, 5] + geodesy.grid_convergence_rad(srid, table[:, 0], table[:, 1])
    poses = se3.se3(se3.rotation_from_rpy(table[:, 3], table[:, 4], grid_yaw), positions)
    horizontal = table[:, 6] if sigmas.horizontal_m is None else np.full(len(numbers), sigmas.horizontal_m)
    vertical = VERTICAL_FACTOR * horizontal if sigmas.vertical_m is None else np.full(len(numbers), sigmas.vertical_m)
    return OxtsTrajectory(
        numbers, poses, np.stack([horizontal, horizontal, vertical], axis=1),
        {number: times_ns[number] for number in numbers if number in times_ns},
        {number: k for k, number in enumerate(numbers)},
    )  # fmt: skip


def wild_records(track: OxtsTrajectory) -> dict[int, str]:
    """Frame numbers whose position cannot be true, and why (`wild_fixes`)."""
    timed = [i for i, number in enumerate(track.numbers) if number in track.times_ns]
    numbers = [track.numbers[i] for i in timed]
    wild = wild_fixes([track.times_ns[number] for number in numbers], track.map_SE3_body[timed, :3, 3])
    return {numbers[k]: text for k, text in wild.items()}


def poses_at(track: OxtsTrajectory, exposures_ns: Mapping[int, int], sigmas: Sigmas) -> dict[int, Pose]:
    """Poses at the exposures of frames, by number; each of them has a valid record.

    The pose is interpolated between the records before and after the exposure (straight line, slerp). Where one of them is
    missing (first and last frame, beside a gap of more than 0.5 s) the motion between the record of the same number and its
    other neighbour is extrapolated, by at most the time between them. Where that is impossible too, the record of the same
    number is used, and the distance that the body may have driven is added to the sigma of its position. A record without a
    time is used as it is.
    """
    index = track.rows
    poses = {number: track.map_SE3_body[index[number]] for number in exposures_ns}
    sigma_enu_m = {number: track.sigma_enu_m[index[number]] for number in exposures_ns}
    moving: dict[int, tuple[Array, float]] = {}
    for number, time_ns in exposures_ns.items():
        if time_ns == track.times_ns.get(number, time_ns):
            continue
        neighbour = _neighbour(track, index[number], time_ns)
        if neighbour is not None:
            moving[number] = neighbour
        else:
            late_s = abs(time_ns - track.times_ns[number]) * 1e-9
            sigma_enu_m[number] = np.hypot(sigma_enu_m[number], late_s * _speed_m_s(track, index[number]))
    ends, weights = [end for end, _ in moving.values()], [weight for _, weight in moving.values()]
    found = se3.interpolate_each([poses[number] for number in moving], ends, weights)
    poses |= dict(zip(moving, found, strict=True))
    return {number: pose_record(pose, sigma_enu_m[number], sigmas) for number, pose in poses.items()}


def _neighbour(track: OxtsTrajectory, index: int, time_ns: int) -> tuple[Array, float] | None:
    """The record (4, 4) to interpolate with from the one at `index`, and its weight at the time: 0 at `index`, 1 at it.

    The record beyond the time, else that on the other side with a negative weight, down to -1; None where both are unusable.
    """
    t0 = track.times_ns[track.numbers[index]]
    towards = 1 if time_ns > t0 else -1
    for step, least, most in ((towards, 0.0, 1.0), (-towards, -1.0, 0.0)):
        other = index + step
        if not 0 <= other < len(track.numbers) or track.numbers[other] not in track.times_ns:
            continue
        t1 = track.times_ns[track.numbers[other]]
        if t0 != t1 and abs(t1 - t0) <= MAX_GAP_NS and least <= (weight := (time_ns - t0) / (t1 - t0)) <= most:
            return track.map_SE3_body[other], weight
    return None


def _speed_m_s(track: OxtsTrajectory, index: int) -> float:
    """Largest mean speed between a record and its neighbours with a time; 0 without one."""
    found = [0.0]
    for other in (index - 1, index + 1):
        if 0 <= other < len(track.numbers) and track.numbers[other] in track.times_ns:
            apart_ns = abs(track.times_ns[track.numbers[other]] - track.times_ns[track.numbers[index]])
            distance_m = np.linalg.norm(track.map_SE3_body[other, :3, 3] - track.map_SE3_body[index, :3, 3])
            if apart_ns:
                found.append(float(distance_m) / (apart_ns * 1e-9))
    return max(found)


def pose_record(pose: Array, sigma_enu_m: Array, sigmas: Sigmas) -> Pose:
    """The record of a pose (4, 4) with the sigmas (3,) of its position."""
    return to_pose(pose, [*sigma_enu_m, *attitude_sigmas(sigmas, None)])
