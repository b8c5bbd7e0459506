"""Which way a yaw counts, by the course over ground: a table's name for it does not say.

ENU (forward, left, up; Xsens, ROS, KITTI): counter-clockwise from east, pitch positive with the front down.
NED (forward, right, down; VectorNav, autopilots): clockwise from north, pitch positive with the front up.
On a straight drive to the north-east or south-west both are the same angle; in a turn one of them rises and the other falls.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from conetl.files.documents import shown
from conetl.model.arrays import Floats
from conetl.model.errors import InputError
from conetl.readers.trajectories.recorded import Reading, RecordedTrajectory, attitude

_EARTH_M = 6.371e6
_STEP_M, _LEAST_STEPS, _LONGEST_STEP_S = 2.0, 10, 5.0
#: Scatter (rad) of the wrong reading about its own mean that is a turn of the vehicle, and how much smaller the right one's is.
_TURN_RAD, _CLEARER = float(np.radians(6.0)), 3.0
#: Straight ahead: the difference (rad) to the course of the right reading at most, and of the wrong one at least.
_NEAR_RAD, _FAR_RAD = float(np.radians(5.0)), float(np.radians(15.0))


def resolved(path: Path, found: RecordedTrajectory, reading: Reading) -> RecordedTrajectory:
    """The trajectory with its yaw as the course shows it. Raises InputError where that does not show it, or another one."""
    if reading.angle_column is not None and found.rotations is not None and not found.is_local:
        _require_degrees(path, found, reading.angle_column)
    if reading.yaw_column is None or found.rotations is None or found.is_local:
        return found
    name, angles, word = shown(reading.yaw_column), _angles(found), reading.yaw_column[:60]
    is_heading = None if angles is None else _is_heading(*angles)
    if reading.yaw_is_stated:
        if is_heading:
            raise InputError(
                f"{path}: compared with the drive path, the column {name} counts clockwise from north, as a heading does; a yaw "
                f"counts counter-clockwise from east. Put trajectory: {{columns: {{heading: {word}}}}}"
            )
        return found
    if is_heading is None:
        raise InputError(
            f"{path}: the column {name} may count clockwise from north (NED) or counter-clockwise from east (ENU); the drive "
            f"path does not show which. Put trajectory: {{columns: {{heading: {word}}}}} or {{yaw: {word}}} into drive.yaml"
        )
    if not is_heading:
        return found
    yaw, pitch, roll = Rotation.from_matrix(found.rotations).as_euler("ZYX", degrees=True).T
    note = f"{path}: compared with the drive path, the column {name} counts clockwise from north (NED)"
    return found._replace(rotations=attitude(roll, pitch, yaw), notes=(*found.notes, note))


def _require_degrees(path: Path, found: RecordedTrajectory, column: str) -> None:
    """Raise InputError where angles without a unit, read as degrees, fit to the course only as radians."""
    if (angles := _angles(found)) is None:
        return
    yaw, course = angles
    turns = (yaw, np.pi / 2 - yaw)  # one of them is the column, the other one what it would be by the other axes

    def apart(read_as: Floats) -> float:
        return float(np.median(np.abs(np.angle(np.exp(1j * (read_as - course))))))

    if min(map(apart, turns)) < _FAR_RAD:
        return
    for turn in turns:
        written = np.degrees(np.angle(np.exp(1j * turn)))
        if np.abs(written).max() <= 2 * np.pi and min(apart(written), apart(np.pi / 2 - written)) < _NEAR_RAD * 2:
            raise InputError(
                f"{path}: compared with the drive path, the column {shown(column)} is in radians, but nothing states so: put "
                "trajectory: {angles: radians} into drive.yaml"
            )


def _angles(found: RecordedTrajectory) -> tuple[Floats, Floats] | None:
    """Yaw and course (N,), counter-clockwise from east (rad), of steps of 2 m; None where there are too few."""
    lat, lon, _ = np.radians(found.positions).T
    metres = _EARTH_M * np.column_stack([lon * np.cos(lat[0]), lat])
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(metres, axis=0), axis=1))])
    starts = np.unique(np.searchsorted(along, np.arange(0.0, min(along[-1], 1e5), _STEP_M)))
    steps, seconds = np.diff(metres[starts], axis=0), np.diff(found.times_ns[starts]) * 1e-9
    moving = (np.linalg.norm(steps, axis=1) > _STEP_M / 2) & (seconds < _LONGEST_STEP_S)
    if np.count_nonzero(moving) < _LEAST_STEPS or found.rotations is None:
        return None
    forward = found.rotations[starts, :2, 0]
    middle = (forward[:-1] + forward[1:])[moving]
    return np.arctan2(middle[:, 1], middle[:, 0]), np.arctan2(steps[moving, 1], steps[moving, 0])


def _is_heading(yaw: Floats, course: Floats) -> bool | None:
    """Whether angles (N,) are clockwise from north, by the course (N,); None where that does not show."""
    scatter, offset = [], []
    for read_as in (yaw, np.pi / 2 - yaw):
        apart = np.exp(1j * (read_as - course))
        mean = np.angle(apart.mean())
        scatter.append(float(np.median(np.abs(np.angle(apart * np.exp(-1j * mean))))))
        offset.append(float(abs(mean)))
    if max(scatter) > _TURN_RAD and max(scatter) > _CLEARER * min(scatter):
        return scatter[1] < scatter[0]
    if min(offset) < _NEAR_RAD and max(offset) > _FAR_RAD:
        return offset[1] < offset[0]
    return None
