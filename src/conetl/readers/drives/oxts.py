"""OXTS records of KITTI (GNSS/INS, 30 numbers a file) -> poses of the IMU in the map frame.

Fields used: 0 lat, 1 lon (degrees), 2 alt (m, ellipsoidal), 3 roll, 4 pitch, 5 yaw (rad, yaw 0 = true east, counter-
clockwise), 23 pos_accuracy (m, north/east). KITTI's `dataformat.txt` describes all of them.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from conetl.geometry import geodesy
from conetl.geometry import pose as se3
from conetl.model.records import Pose
from conetl.readers.drives.drive_yaml import Sigmas

Array = NDArray[np.float64]

FIELD_COUNT = 30
VERTICAL_FACTOR = 1.5
"""Height of a GNSS fix is about that much worse than its place."""
MAX_POS_ACCURACY_M = 100.0
MAX_SPEED_M_S = 100.0
MAX_GAP_NS = 500_000_000
"""Poses farther apart in time than this are not interpolated."""


class OxtsRecord(NamedTuple):
    """What conetl needs of one OXTS file."""

    lat_deg: float
    lon_deg: float
    height_m: float
    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    pos_accuracy_m: float


def parse_oxts(text: str, *, accuracy_required: bool = True) -> OxtsRecord:
    """One OXTS file. Raises ValueError, saying what was found and expected.

    accuracy_required: refuse a `pos_accuracy` that cannot be a sigma; not needed where drive.yaml gives the sigma.
    """
    words = text.split()
    if len(words) != FIELD_COUNT:
        raise ValueError(f"expected {FIELD_COUNT} numbers, found {len(words)}")
    try:
        values = [float(word) for word in words]
    except ValueError:
        raise ValueError(f"expected {FIELD_COUNT} numbers, found text that is none") from None
    lat, lon, height, roll, pitch, yaw = values[:6]
    record = OxtsRecord(lat, lon, height, roll, pitch, yaw, values[23])
    limits = {
        "lat_deg": 90.0, "lon_deg": 180.0, "height_m": 20_000.0,
        "roll_rad": math.pi + 1e-3, "pitch_rad": math.pi / 2 + 1e-3, "yaw_rad": 2 * math.pi + 1e-3,
    }  # fmt: skip
    for name, limit in limits.items():
        value = getattr(record, name)
        if not abs(value) <= limit:  # NaN and infinity fail too
            raise ValueError(f"{name} is {value}, expected a number between {-limit:g} and {limit:g}")
    if record.lat_deg == 0.0 and record.lon_deg == 0.0:
        raise ValueError("latitude and longitude are both 0: the receiver had no fix")
    if accuracy_required and not 0.0 < record.pos_accuracy_m <= MAX_POS_ACCURACY_M:
        raise ValueError(
            f"pos_accuracy is {record.pos_accuracy_m}, expected metres between 0 and {MAX_POS_ACCURACY_M:g}; "
            "give sigmas.horizontal_m in drive.yaml if the recorder does not write it"
        )
    return record


class Trajectory(NamedTuple):
    """Poses of the IMU by frame number, and the times they hold for (where the folder tells)."""

    numbers: list[int]
    """Rising, of the valid records."""
    map_SE3_body: Array
    """(N, 4, 4)"""
    sigma_enu_m: Array
    """(N, 3)"""
    times_ns: dict[int, int]
    """By frame number; frames without a time are missing."""


def trajectory(records: Mapping[int, OxtsRecord], times_ns: Mapping[int, int], srid: int, sigmas: Sigmas) -> Trajectory:
    """Poses in the map frame: places by the map projection, yaw turned from true to grid east by the convergence.

    Raises ValueError where the map CRS cannot express the places.
    """
    numbers = sorted(records)
    table = np.array([records[number] for number in numbers])
    places = geodesy.to_map(srid, table[:, 0], table[:, 1], table[:, 2])
    grid_yaw = table[:, 5] + geodesy.grid_convergence_rad(srid, table[:, 0], table[:, 1])
    poses = se3.se3(se3.rotation_from_rpy(table[:, 3], table[:, 4], grid_yaw), places)
    horizontal = table[:, 6] if sigmas.horizontal_m is None else np.full(len(numbers), sigmas.horizontal_m)
    vertical = VERTICAL_FACTOR * horizontal if sigmas.vertical_m is None else np.full(len(numbers), sigmas.vertical_m)
    return Trajectory(
        numbers, poses, np.stack([horizontal, horizontal, vertical], axis=1),
        {number: times_ns[number] for number in numbers if number in times_ns},
    )  # fmt: skip


def jumps(track: Trajectory) -> dict[int, str]:
    """Frame numbers whose place cannot be true: faster than 100 m/s from and to its neighbours, which fit each other."""
    timed = [(number, i) for i, number in enumerate(track.numbers) if number in track.times_ns]
    found: dict[int, str] = {}
    for (a, i), (b, j), (c, k) in zip(timed, timed[1:], timed[2:], strict=False):
        speeds = [
            float(np.linalg.norm(track.map_SE3_body[q, :3, 3] - track.map_SE3_body[p, :3, 3]))
            / max(abs(track.times_ns[y] - track.times_ns[x]) * 1e-9, 1e-3)
            for p, q, x, y in ((i, j, a, b), (j, k, b, c), (i, k, a, c))
        ]
        if speeds[0] > MAX_SPEED_M_S and speeds[1] > MAX_SPEED_M_S and speeds[2] <= MAX_SPEED_M_S:
            found[b] = f"the place is reached and left at {speeds[0]:.0f} m/s, more than {MAX_SPEED_M_S:g}: a wild fix"
    return found


def has_record(track: Trajectory, number: int) -> bool:
    """Whether there is a pose of this frame number."""
    place = bisect_left(track.numbers, number)
    return place < len(track.numbers) and track.numbers[place] == number


def poses_at(track: Trajectory, exposures_ns: Mapping[int, int], sigmas: Sigmas) -> dict[int, Pose]:
    """Poses at the exposures of frames, by number; each of them has a valid record.

    Between the two records before and after an exposure the pose is interpolated (straight line, slerp). Where one of them is
    missing (first and last frame, beside a gap of more than 0.5 s) the motion between the record of the same number and its
    other neighbour is carried on, by no more than the time between them. Where that cannot be either, the record of the same
    number holds, and what the body may have driven meanwhile is added to the sigma of its place. A record without a time holds
    as it is.
    """
    places = {number: k for k, number in enumerate(track.numbers)}
    poses = {number: track.map_SE3_body[places[number]] for number in exposures_ns}
    sigma_enu_m = {number: track.sigma_enu_m[places[number]] for number in exposures_ns}
    moving: dict[int, tuple[Array, float]] = {}
    for number, time_ns in exposures_ns.items():
        if time_ns == track.times_ns.get(number, time_ns):
            continue
        neighbour = _neighbour(track, places[number], time_ns)
        if neighbour is not None:
            moving[number] = neighbour
        else:
            late_s = abs(time_ns - track.times_ns[number]) * 1e-9
            sigma_enu_m[number] = np.hypot(sigma_enu_m[number], late_s * _speed_m_s(track, places[number]))
    ends, weights = [end for end, _ in moving.values()], [weight for _, weight in moving.values()]
    found = se3.interpolate_each([poses[number] for number in moving], ends, weights)
    poses |= dict(zip(moving, found, strict=True))
    return {number: pose_record(pose, sigma_enu_m[number], sigmas) for number, pose in poses.items()}


def _neighbour(track: Trajectory, place: int, time_ns: int) -> tuple[Array, float] | None:
    """The record (4, 4) with which the one at `place` tells the pose at an instant, and its weight there: 0 at `place`, 1 at it.

    That beyond the instant, else that on the other side, whose weight is negative, down to -1. None where neither can.
    """
    t0 = track.times_ns[track.numbers[place]]
    towards = 1 if time_ns > t0 else -1
    for step, least, most in ((towards, 0.0, 1.0), (-towards, -1.0, 0.0)):
        other = place + step
        if not 0 <= other < len(track.numbers) or track.numbers[other] not in track.times_ns:
            continue
        t1 = track.times_ns[track.numbers[other]]
        if t0 != t1 and abs(t1 - t0) <= MAX_GAP_NS and least <= (weight := (time_ns - t0) / (t1 - t0)) <= most:
            return track.map_SE3_body[other], weight
    return None


def _speed_m_s(track: Trajectory, place: int) -> float:
    """Largest mean speed between a record and those beside it that have a time; 0 where none has."""
    found = [0.0]
    for other in (place - 1, place + 1):
        if 0 <= other < len(track.numbers) and track.numbers[other] in track.times_ns:
            apart_ns = abs(track.times_ns[track.numbers[other]] - track.times_ns[track.numbers[place]])
            way_m = np.linalg.norm(track.map_SE3_body[other, :3, 3] - track.map_SE3_body[place, :3, 3])
            if apart_ns:
                found.append(float(way_m) / (apart_ns * 1e-9))
    return max(found)


def pose_record(pose: Array, sigma_enu_m: Array, sigmas: Sigmas) -> Pose:
    """The record of a pose (4, 4) with the sigmas (3,) of its place."""
    e, n, u = (float(s) for s in sigma_enu_m)
    x, y, z = (float(c) for c in pose[:3, 3])
    return Pose(
        map_R_body=se3.to_matrix3(pose[:3, :3]), map_t_body_m=(x, y, z), sigma_enu_m=(e, n, u),
        sigma_rpy_rad=(math.radians(sigmas.roll_deg), math.radians(sigmas.pitch_deg), math.radians(sigmas.yaw_deg)),
    )  # fmt: skip
