"""Trajectories that come with times of their own (odometry, GNSS, IMU): the pose at the instant of an exposure."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from conetl.geometry import pose as se3
from conetl.model.errors import DriveFolderError
from conetl.model.records import Pose
from conetl.model.rejections import RejectionReason
from conetl.readers.drives.drive_yaml import Sigmas
from conetl.readers.drives.oxts import MAX_SPEED_M_S, VERTICAL_FACTOR
from conetl.readers.drives.pairs import PairError

Array = NDArray[np.float64]


class Samples(NamedTuple):
    """Valid records by time, and what is wrong with the others."""

    name: str
    """What they are called in the drive, for messages."""
    times_ns: list[int]
    """Rising."""
    map_SE3_body: Array
    """(N, 4, 4); of a receiver without attitude the rotation is the identity, of an IMU the place is zero."""
    sigma: Array
    """(N, 6): easting, northing, height (m), roll, pitch, yaw (rad)."""
    bad: dict[int, str]
    """By time."""


def samples(name: str, records: Mapping[int, tuple[Array, tuple[float, ...]]], bad: Mapping[int, str]) -> Samples:
    """Samples of (pose (4, 4), six sigmas) by time. Raises DriveFolderError where there is not one."""
    if not records:
        first = next(iter(bad.values()), "there are none")
        raise DriveFolderError(f"{name}: not one usable pose: {first}")
    times = sorted(records)
    return Samples(
        name, times, np.array([records[t][0] for t in times]), np.array([records[t][1] for t in times]), dict(bad)
    )


def without_jumps(track: Samples) -> Samples:
    """Without places that are reached and left at more than 100 m/s while their neighbours fit each other; those become bad."""
    if len(track.times_ns) < 3:
        return track
    times, places = np.array(track.times_ns), track.map_SE3_body[:, :3, 3]

    def speed(a: slice, b: slice) -> Array:
        apart_s = np.maximum((times[b] - times[a]) * 1e-9, 1e-3)
        found: Array = np.linalg.norm(places[b] - places[a], axis=1) / apart_s
        return found

    first, middle, last = slice(None, -2), slice(1, -1), slice(2, None)
    reached, left, past = speed(first, middle), speed(middle, last), speed(first, last)
    wild = np.flatnonzero((reached > MAX_SPEED_M_S) & (left > MAX_SPEED_M_S) & (past <= MAX_SPEED_M_S)) + 1
    if not len(wild):
        return track
    keep = np.setdiff1d(np.arange(len(times)), wild)
    text = f"m/s, more than {MAX_SPEED_M_S:g}: a wild fix"
    bad = {int(times[i]): f"the place is reached and left at {reached[i - 1]:.0f} {text}" for i in wild}
    return Samples(track.name, times[keep].tolist(), track.map_SE3_body[keep], track.sigma[keep], track.bad | bad)


def at(track: Samples, time_ns: int, max_gap_ns: int) -> tuple[Array, Array]:
    """Pose (4, 4), by straight line and slerp between the records around the instant, and the larger of their sigmas (6,).

    Raises PairError: POSE_INVALID where a bad record lies between them, POSE_MISSING where they are too far apart or the instant
    lies beyond the trajectory.
    """
    times = track.times_ns
    after = bisect_left(times, time_ns)
    if after < len(times) and times[after] == time_ns:
        return track.map_SE3_body[after], track.sigma[after]
    before, end = after - 1, after
    start_ns = times[before] if before >= 0 else None
    end_ns = times[end] if end < len(times) else None
    near = [
        (t, text) for t, text in track.bad.items()
        if (start_ns is None or t > start_ns) and (end_ns is None or t < end_ns) and abs(t - time_ns) <= max_gap_ns
    ]  # fmt: skip
    if near:
        t, text = min(near, key=lambda item: abs(item[0] - time_ns))
        raise PairError(RejectionReason.POSE_INVALID, f"{track.name}, record of {t} ns: {text}")
    if start_ns is None or end_ns is None:
        apart_s = (times[0] - time_ns if start_ns is None else time_ns - times[-1]) * 1e-9
        where = "begins" if start_ns is None else "ended"
        raise PairError(
            RejectionReason.POSE_MISSING,
            f"{track.name} {where} {apart_s:.3f} s {'after' if start_ns is None else 'before'} the exposure",
        )
    if end_ns - start_ns > max_gap_ns:
        raise PairError(
            RejectionReason.POSE_MISSING,
            f"{track.name} has a gap of {(end_ns - start_ns) * 1e-9:.3f} s around the exposure, allowed {max_gap_ns * 1e-9:g} s "
            "(max_pose_gap_s in drive.yaml)",
        )
    weight = (time_ns - start_ns) / (end_ns - start_ns)
    pose = se3.interpolate(track.map_SE3_body[before], track.map_SE3_body[end], weight)
    return pose, np.maximum(track.sigma[before], track.sigma[end])


def to_pose(map_SE3_body: Array, sigma: Array) -> Pose:
    """The record."""
    x, y, z = (float(c) for c in map_SE3_body[:3, 3])
    e, n, u, roll, pitch, yaw = (float(s) for s in sigma)
    return Pose(
        map_R_body=se3.to_matrix3(map_SE3_body[:3, :3]), map_t_body_m=(x, y, z), sigma_enu_m=(e, n, u),
        sigma_rpy_rad=(roll, pitch, yaw),
    )  # fmt: skip


def place_sigmas(settings: Sigmas, recorded_m: tuple[float, float, float] | None) -> tuple[float, float, float]:
    """Sigmas of easting, northing, height (m): drive.yaml's, else what was recorded with the place. Raises ValueError."""
    if settings.horizontal_m is not None:
        horizontal = settings.horizontal_m
        return horizontal, horizontal, settings.vertical_m or VERTICAL_FACTOR * horizontal
    if recorded_m is None:
        raise ValueError("no covariance was recorded with the place; give sigmas.horizontal_m in drive.yaml")
    if not all(0.0 < value <= 1000.0 for value in recorded_m):  # NaN fails too
        raise ValueError(f"sigmas of the place are {recorded_m}, expected metres between 0 and 1000")
    east, north, up = recorded_m
    return east, north, settings.vertical_m or up


def attitude_sigmas(settings: Sigmas, recorded_rad: tuple[float, ...] | None) -> tuple[float, float, float]:
    """Sigmas of roll, pitch, yaw (rad): what drive.yaml says, else what was recorded, else drive.yaml's defaults."""
    found = []
    for index, name in enumerate(("roll_deg", "pitch_deg", "yaw_deg")):
        own = recorded_rad[index] if recorded_rad else 0.0
        told = name in settings.model_fields_set or not own > 0.0 or not math.isfinite(own)
        found.append(math.radians(getattr(settings, name)) if told else own)
    return found[0], found[1], found[2]


def rotation_of(w: float, x: float, y: float, z: float) -> Array:
    """Rotation matrix (3, 3) of a quaternion of about unit length. Raises ValueError."""
    length = math.sqrt(w * w + x * x + y * y + z * z)
    if not abs(length - 1.0) <= 1e-2:  # NaN fails too
        raise ValueError(f"the quaternion has the length {length:.3g}, expected 1")
    w, x, y, z = w / length, x / length, y / length, z / length
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def nearest_index(times_ns: list[int], time_ns: int) -> int:
    """Index of the time nearest to one; of two equally near the earlier. The list must not be empty."""
    after = bisect_right(times_ns, time_ns)
    around = [i for i in (after - 1, after) if 0 <= i < len(times_ns)]
    return min(around, key=lambda i: abs(times_ns[i] - time_ns))
