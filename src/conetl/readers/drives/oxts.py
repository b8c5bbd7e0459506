"""OXTS records of KITTI (readers/trajectories/oxts.py) -> poses of the IMU in the map frame, by frame number."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from conetl.geometry import geodesy
from conetl.geometry import pose as se3
from conetl.model.arrays import Floats
from conetl.model.drive import Pose
from conetl.readers.drives.drive_yaml import Sigmas
from conetl.readers.drives.poses import stated_sigmas, wild_fixes
from conetl.readers.trajectories.oxts import OxtsRecord

MAX_GAP_NS = 500_000_000
"""Poses farther apart in time than this are not interpolated."""


class OxtsTrajectory(NamedTuple):
    """Poses of the IMU by frame number, and their times where they are known."""

    rows: dict[int, int]
    """Row of the arrays by frame number, both rising; of the valid records."""
    map_SE3_body: Floats
    """(N, 4, 4)"""
    sigma: Floats
    """(N, 6): easting, northing, height (m), roll, pitch, yaw (rad)."""
    times_ns: list[int | None]
    """By row; None where the time is unknown."""


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
    recorded = np.full((len(numbers), 6), np.nan)
    recorded[:, :2] = table[:, [6]]
    rows = {number: row for row, number in enumerate(numbers)}
    return OxtsTrajectory(rows, poses, stated_sigmas(recorded, sigmas), [times_ns.get(number) for number in numbers])


def wild_records(track: OxtsTrajectory) -> dict[int, str]:
    """Frame numbers whose position cannot be true, and why (`wild_fixes`)."""
    timed = [(number, row, t) for number, row in track.rows.items() if (t := track.times_ns[row]) is not None]
    wild = wild_fixes([t for _, _, t in timed], track.map_SE3_body[[row for _, row, _ in timed], :3, 3])
    return {timed[k][0]: text for k, text in wild.items()}


def pose_at(track: OxtsTrajectory, number: int, exposure_ns: int) -> Pose:
    """Pose at the exposure of a frame that has a valid record.

    The pose is interpolated between the records before and after the exposure (straight line, slerp). Where one of them is
    missing (first and last frame, beside a gap of more than 0.5 s) the motion between the record of the same number and its
    other neighbour is extrapolated, by at most the time between them. Where that is impossible too, the record of the same
    number is used, and the distance that the body may have driven is added to the sigma of its position. A record without a
    time is used as it is.
    """
    row = track.rows[number]
    end, weight, apart_m = _neighbour(track, row, exposure_ns)
    sigma = track.sigma[row].copy()
    sigma[:3] = np.hypot(sigma[:3], apart_m)
    return se3.to_pose(se3.interpolate(track.map_SE3_body[row], track.map_SE3_body[end], weight), sigma)


def _neighbour(track: OxtsTrajectory, row: int, time_ns: int) -> tuple[int, float, float]:
    """The row to interpolate with from `row`, and its weight at a time: 0 at `row`, 1 at it.

    The record beyond the time, else that on the other side with a negative weight, down to -1. Where both are unusable `row`
    itself, and the distance (m) that the body may have driven.
    """
    t0, speed = track.times_ns[row], 0.0
    if t0 is None or t0 == time_ns:
        return row, 0.0, 0.0
    late_ns = time_ns - t0
    for other in (row + 1, row - 1) if late_ns > 0 else (row - 1, row + 1):
        t1 = track.times_ns[other] if 0 <= other < len(track.times_ns) else None
        if t1 is None or t1 == t0:
            continue
        step_ns = t1 - t0
        if abs(late_ns) <= abs(step_ns) <= MAX_GAP_NS:
            return other, late_ns / step_ns, 0.0
        moved_m = np.linalg.norm(track.map_SE3_body[other, :3, 3] - track.map_SE3_body[row, :3, 3])
        speed = max(speed, float(moved_m) / abs(step_ns))
    return row, 0.0, speed * abs(late_ns)
