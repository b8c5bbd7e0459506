"""Trajectories: poses and sigmas of the body, and the pose at the time of an exposure between recorded poses."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from conetl.files.documents import input_errors
from conetl.geometry import geodesy
from conetl.geometry import pose as se3
from conetl.geometry.geodesy import enu_to_grid, local_to_map
from conetl.model.arrays import Floats
from conetl.model.drive import MAX_SPEED_M_S
from conetl.model.errors import InputError
from conetl.model.rejections import RejectionReason
from conetl.readers.drives.drive_yaml import DriveYaml, Sigmas
from conetl.readers.drives.pairs import PairError, Source
from conetl.readers.trajectories.recorded import VERTICAL_FACTOR, RecordedTrajectory

MAX_SIGMA_M = 1000.0
NO_SIGMAS = "no sigmas of the position between 0 and 1000 m; give sigmas.horizontal_m in drive.yaml"
_LOOK_BACK = 500
#: A way that shows its direction, and the share of one that is upwards, where z is forward.
_LEAST_WAY_M, _UPWARDS = 5.0, 0.9


class Samples(NamedTuple):
    """Valid records by time, and what is wrong with the others."""

    name: str
    """Name of the stream in the drive, for messages."""
    times_ns: list[int]
    """Rising."""
    map_SE3_body: Floats
    """(N, 4, 4); without attitude the rotation is the identity, without position the translation is zero."""
    sigma: Floats
    """(N, 6): easting, northing, height (m), roll, pitch, yaw (rad)."""
    bad: dict[int, str]
    """By time."""


def wild_fixes(times_ns: Sequence[int], positions_m: Floats) -> dict[int, str]:
    """What is wrong with some of the positions (N, 3), by index: the fewest without which no step exceeds `MAX_SPEED_M_S`.

    By a longest chain of positions (each at most `_LOOK_BACK` records before the next) that a vehicle can drive through.
    """
    times = np.array(times_ns, dtype=np.int64)

    def speeds(a: slice, b: slice) -> Floats:
        apart_s = np.maximum(np.abs(times[b] - times[a]) * 1e-9, 1e-3)
        return np.asarray(np.linalg.norm(positions_m[b] - positions_m[a], axis=1) / apart_s)

    if not np.any(speeds(slice(None, -1), slice(1, None)) > MAX_SPEED_M_S):
        return {}
    length, before = np.ones(len(times), np.int64), np.full(len(times), -1)
    for i in range(1, len(times)):
        first = max(0, i - _LOOK_BACK)
        near = slice(first, i)
        best = np.where(speeds(near, slice(i, i + 1)) <= MAX_SPEED_M_S, length[near], 0)
        # Among equally long chains the one with the nearest record.
        chosen = len(best) - 1 - int(np.argmax(best[::-1]))
        if best[chosen] > 0:
            length[i], before[i] = best[chosen] + 1, first + chosen
    kept, at_index = set(), int(np.argmax(length))
    while at_index >= 0:
        kept.add(at_index)
        at_index = int(before[at_index])
    text = f"the position implies a speed above {MAX_SPEED_M_S:g} m/s: a GNSS outlier"
    return {i: text for i in range(len(times)) if i not in kept}


def without_wild_fixes(track: Samples) -> Samples:
    """The same samples; wild fixes become bad records."""
    wild = wild_fixes(track.times_ns, track.map_SE3_body[:, :3, 3])
    keep = [i for i in range(len(track.times_ns)) if i not in wild]
    bad = {track.times_ns[i]: text for i, text in wild.items()}
    times = [track.times_ns[i] for i in keep]
    return Samples(track.name, times, track.map_SE3_body[keep], track.sigma[keep], track.bad | bad)


def at(track: Samples, time_ns: int, max_gap_ns: int) -> tuple[Floats, Floats]:
    """Pose (4, 4), interpolated (straight line, slerp) between the neighbouring records, and the larger of their sigmas (6,).

    Raises PairError: POSE_INVALID where a bad record is between them, POSE_MISSING where they are too far apart or the time
    is outside the trajectory.
    """
    first, second = around(track, time_ns, max_gap_ns)
    if first == second:
        return track.map_SE3_body[first], track.sigma[first]
    weight = (time_ns - track.times_ns[first]) / (track.times_ns[second] - track.times_ns[first])
    pose = se3.interpolate(track.map_SE3_body[first], track.map_SE3_body[second], weight)
    return pose, np.maximum(track.sigma[first], track.sigma[second])


def around(track: Samples, time_ns: int, max_gap_ns: int, *, across_bad: bool = False) -> tuple[int, int]:
    """Indices of the records before and after a time, equal where one is of that time. Raises PairError as `at`.

    across_bad: a bad record between them counts as none.
    """
    times = track.times_ns
    end = bisect_left(times, time_ns)
    if end < len(times) and times[end] == time_ns:
        return end, end
    start_ns = times[end - 1] if end else None
    end_ns = times[end] if end < len(times) else None
    if across_bad and start_ns is not None and end_ns is not None and end_ns - start_ns <= max_gap_ns:
        return end - 1, end
    near = [
        (abs(t - time_ns), t) for t in track.bad
        if (start_ns is None or t > start_ns) and (end_ns is None or t < end_ns) and abs(t - time_ns) <= max_gap_ns
    ]  # fmt: skip
    if near:
        t = min(near)[1]
        raise PairError(RejectionReason.POSE_INVALID, f"{track.name}, record of {t} ns: {track.bad[t]}")
    if start_ns is None or end_ns is None:
        apart_s = (times[0] - time_ns if start_ns is None else time_ns - times[-1]) * 1e-9
        where = f"begins {apart_s:.3f} s after" if start_ns is None else f"ended {apart_s:.3f} s before"
        raise PairError(RejectionReason.POSE_MISSING, f"{track.name} {where} the exposure")
    if end_ns - start_ns > max_gap_ns:
        raise PairError(
            RejectionReason.POSE_MISSING,
            f"{track.name} has a gap of {(end_ns - start_ns) * 1e-9:.3f} s around the exposure, allowed {max_gap_ns * 1e-9:g} s "
            "(max_pose_gap_s in drive.yaml)",
        )
    return end - 1, end


def stated_sigmas(recorded: Floats, settings: Sigmas) -> Floats:
    """(N, 6) sigmas of easting, northing, height (m), roll, pitch, yaw (rad): those given in drive.yaml, else the recorded ones
    (N, 6), else the defaults; NaN where those of the position are unknown.

    A height that is less certain than drive.yaml's horizontal_m implies stays so, unless vertical_m is given: it may be above an
    unknown geoid.
    """
    found = recorded.copy()
    found[~((found > 0.0) & np.isfinite(found))] = np.nan
    if settings.horizontal_m is not None:
        found[:, :2] = settings.horizontal_m
        found[~(found[:, 2] <= MAX_SIGMA_M), 2] = np.nan
        found[:, 2] = np.fmax(found[:, 2], VERTICAL_FACTOR * settings.horizontal_m)
    found[:, 2] = np.where(np.isnan(found[:, 2]), VERTICAL_FACTOR * found[:, :2].max(axis=1), found[:, 2])
    if settings.vertical_m is not None:
        found[:, 2] = settings.vertical_m
    given_m = (settings.horizontal_m, settings.horizontal_m, settings.vertical_m or settings.horizontal_m)
    limited = [k for k, value in enumerate(given_m) if value is None]
    found[~(found[:, limited] <= MAX_SIGMA_M).all(axis=1), :3] = np.nan
    for k, name in enumerate(("roll_deg", "pitch_deg", "yaw_deg"), 3):
        found[np.isnan(found[:, k]) | (name in settings.model_fields_set), k] = math.radians(getattr(settings, name))
    return found


def rotation_of(w: float, x: float, y: float, z: float) -> Floats:
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


def georeferenced(source: Source, stream: str, local: Floats) -> tuple[int, Floats]:
    """EPSG code of the map and map_SE3_sensor (N, 4, 4) of poses in a local frame (N, 4, 4).

    Raises InputError where drive.yaml has no georeference of that frame.
    """
    origin = source.settings.georeference
    if origin is None:
        raise InputError(
            f"{source.root}: {stream} is in a local frame whose position on the earth is unknown. Put into drive.yaml: "
            "'georeference: {lon_deg: ..., lat_deg: ..., height_m: ..., heading_deg: ...}', the position of its origin "
            "(ellipsoidal height) and the direction of its x axis, clockwise from true north"
        )
    srid = checked_srid(source.map_srid, origin.lat_deg, origin.lon_deg, source.root)
    tilt = se3.rotation_from_rpy(*np.radians([origin.roll_deg, origin.pitch_deg, 0.0]))
    level = se3.compose(se3.se3(tilt, np.zeros(3)), local)
    with input_errors(source.root):
        return srid, local_to_map(srid, origin.lat_deg, origin.lon_deg, origin.height_m, origin.heading_deg, level)


def placed(recorded: RecordedTrajectory, source: Source, sensor_R_body: Floats) -> tuple[int, Samples]:
    """EPSG code of the map and the poses of the body in it, without wild fixes.

    sensor_R_body (3, 3): from the body's axes to those that the attitudes are of. Positions are those of the antenna where
    drive.yaml has antenna_t_m. Raises InputError where the file has no attitudes, or no sigmas and drive.yaml neither.
    """
    if recorded.rotations is None:
        raise InputError(f"{source.root}: {recorded.name} has positions without attitudes (roll, pitch, heading)")
    positions, rotations = recorded.positions, recorded.rotations
    if recorded.is_local:
        srid, poses = georeferenced(source, recorded.name, se3.se3(rotations, positions))
    else:
        lat, lon, height = positions.T
        srid = checked_srid(source.map_srid, float(lat[0]), float(lon[0]), source.root)
        with input_errors(source.root):
            poses = se3.se3(enu_to_grid(srid, lat, lon, rotations), geodesy.to_map(srid, lat, lon, height))
    sigma = _sigmas(recorded, source.settings)
    known = np.isfinite(sigma).all(axis=1)
    bad = recorded.bad | dict.fromkeys(recorded.times_ns[~known].tolist(), NO_SIGMAS)
    if not known.any():
        raise InputError(f"{source.root}: {recorded.name} has {NO_SIGMAS}")
    antenna_m = np.array(source.settings.antenna_t_m or (0.0, 0.0, 0.0))
    body = se3.compose(poses, se3.se3(sensor_R_body, -antenna_m))
    track = without_wild_fixes(
        Samples(recorded.name, recorded.times_ns[known].tolist(), body[known], sigma[known], bad)
    )
    if recorded.is_local and _goes_upwards(track):
        raise InputError(
            f"{source.root}: the poses of {recorded.name} move along their z axis, as those of a camera do; expected x forward, "
            "y left, z up. Write poses of the left camera as rows of 12 numbers, one per image (evo_traj tum F --save_as_kitti)"
        )
    return srid, track


def _goes_upwards(track: Samples) -> bool:
    """Whether the body moves along its own z axis on most of its way, which no vehicle does."""
    moved = np.diff(track.map_SE3_body[:, :3, 3], axis=0)
    length_m = np.linalg.norm(moved, axis=1)
    along_m = np.abs((moved * track.map_SE3_body[:-1, :3, 2]).sum(axis=1))
    return bool(length_m.sum() > _LEAST_WAY_M and along_m.sum() > _UPWARDS * length_m.sum())


def _sigmas(recorded: RecordedTrajectory, settings: DriveYaml) -> Floats:
    """(N, 6) as `stated_sigmas`, with the errors of the attitude times the antenna's lever arm."""
    sigma = recorded.sigma.copy()
    if recorded.is_local:  # the frame may be turned against the map's
        sigma[:, :2] = sigma[:, :2].max(axis=1, keepdims=True)
    found = stated_sigmas(sigma, settings.sigmas)
    x, y, z = settings.antenna_t_m or (0.0, 0.0, 0.0)
    level_m, up_m = np.hypot(x, y), abs(z)
    tilt = found[:, 3:5].max(axis=1)
    found[:, :2] = np.hypot(found[:, :2], np.hypot(level_m * found[:, 5], up_m * tilt)[:, None])
    found[:, 2] = np.hypot(found[:, 2], level_m * tilt)
    return found


def checked_srid(srid: int | None, lat_deg: float, lon_deg: float, source: Path) -> int:
    """EPSG code of the map: the given one, or the UTM zone of the position. Raises InputError if it is unusable there."""
    with input_errors(source):
        srid = srid or geodesy.utm_srid(lat_deg, lon_deg)
        geodesy.check_map_srid(srid)
        geodesy.check_scale(srid, lat_deg, lon_deg)
        return srid
