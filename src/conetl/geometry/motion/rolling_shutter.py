"""Rolling shutter: image points whose rows were exposed at different instants, and those of a global shutter at the time stamp.

While a camera moves, a static point moves in its frame: X(t) = exp(t r) X(0), with the rate r = (w, d): dX/dt = w x X + d. Over
one readout the rate is constant (e.g. Hedborg, Forssen, Felsberg & Ringaby 2012, "Rolling shutter bundle adjustment"). A point
seen in the row that was exposed t after the stamp is moved back along this path: it is intersected, moved by each camera's own t
and projected again. Without a shutter (`Camera.shutter`) nothing is computed.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from conetl.geometry import pose as se3
from conetl.geometry import rig as rigs
from conetl.geometry.motion.stereo_motion import StereoCameras, triangulate
from conetl.geometry.rectification import raw_from_rectified, stored_camera
from conetl.geometry.small_arrays import cross_matrix
from conetl.model.arrays import Floats
from conetl.model.drive import FramePair
from conetl.model.rig import SIDES, Camera, Rig, Shutter, Side

_STAMP_SHARE = {"first": 0.0, "middle": 0.5, "last": 1.0, None: 0.5}
#: Iterations over the instant of a row, and over the difference of both cameras' instants, end when no point moves by more.
_MOST_ITERATIONS, _CONVERGED_PX, _CONVERGED_M = 12, 1e-4, 1e-6
_NEAREST_M = 0.3
_PAUSE_S = 2.0


def shutter_of(rig: Rig, side: Side) -> Shutter | None:
    """Of the camera that took the images."""
    return stored_camera(rig, side).shutter


def is_rolling(rig: Rig) -> bool:
    """Whether rows of its images are, or may have been, exposed one after the other."""
    shutters = (shutter_of(rig, side) for side in SIDES)
    return any(one is not None and (one.readout_ms or one.readout_sigma_ms) for one in shutters)


def with_shutters(rig: Rig, left: Shutter | None, right: Shutter | None) -> Rig:
    """The rig with these shutters of the cameras that took the images."""
    if rig.rectified_from is not None:
        return rig.model_copy(update={"rectified_from": with_shutters(rig.rectified_from, left, right)})
    cameras = {"left": rig.left.model_copy(update={"shutter": left})}
    return rig.model_copy(update=cameras | {"right": rig.right.model_copy(update={"shutter": right})})


def stamp_sigma_s(rig: Rig) -> float:
    """Sigma of the instant that time stamps belong to, where the row is not known: half a readout, as it mostly is the first or
    the last one."""
    shutter = shutter_of(rig, "left")
    if shutter is None or shutter.stamp_row is not None:
        return 0.0
    return float(np.hypot(shutter.readout_ms, shutter.readout_sigma_ms)) / 2 * 1e-3


def middle_row_s(rig: Rig) -> float:
    """When the middle row of the left image is exposed, after its stamp."""
    shutter = shutter_of(rig, "left")
    return 0.0 if shutter is None else shutter.readout_ms * 1e-3 * (0.5 - _STAMP_SHARE[shutter.stamp_row])


def readout_sigma_s(rig: Rig) -> float:
    """Sigma of the readout of both cameras, the larger one."""
    return (
        max((one.readout_sigma_ms for side in SIDES if (one := shutter_of(rig, side)) is not None), default=0.0) * 1e-3
    )


def row_shares(rig: Rig, side: Side, uv_px: Floats) -> Floats:
    """(...) shares of the readout after the stamp at which points (..., 2) of the rectified image were exposed.

    0 where the camera has no shutter, or saw nothing there.
    """
    camera, shutter = stored_camera(rig, side), shutter_of(rig, side)
    if shutter is None:
        return np.zeros(np.shape(uv_px)[:-1])
    rows = raw_from_rectified(rig, side, uv_px)[..., 1] / (camera.height_px - 1.0)
    return np.nan_to_num(rows - _STAMP_SHARE[shutter.stamp_row])


def pair_shares(rig: Rig, uv_px: Floats) -> Floats:
    """(N, 2) of points (N, 4) u_left, v_left, u_right, v_right, as `row_shares`."""
    return np.stack([row_shares(rig, "left", uv_px[:, :2]), row_shares(rig, "right", uv_px[:, 2:])], axis=1)


def readouts_s(rig: Rig) -> Floats:
    """(2,) of the left and the right camera."""
    return np.array([0.0 if (one := shutter_of(rig, side)) is None else one.readout_ms * 1e-3 for side in SIDES])


def rate_of(next_SE3_first: Floats, lasts_s: float) -> Floats:
    """(6,) rad/s and m/s: rate (w, d) of static points in the camera's frame, of a motion (4, 4); 0 if it takes no time."""
    if lasts_s <= 0:
        return np.zeros(6)
    turn = Rotation.from_matrix(next_SE3_first[:3, :3]).as_rotvec()
    cross = cross_matrix(turn)
    shift = (np.eye(3) - cross / 2 + cross @ cross / 12) @ next_SE3_first[:3, 3]
    return np.concatenate([turn, shift]) / lasts_s


def carried(points_m: Floats, rates: Floats, times_s: Floats) -> Floats:
    """Points (N, 3) in the camera's frame after times (N,) at rates (6,) or (N, 6)."""
    turn = rates[..., :3] * times_s[:, None]
    shift = rates[..., 3:] * times_s[:, None]
    once = np.cross(turn, shift)
    return Rotation.from_rotvec(turn).apply(points_m) + shift + once / 2 + np.cross(turn, once) / 6


def at_stamp(cameras: StereoCameras, uv_px: Floats, times_s: Floats, rates: Floats) -> Floats:
    """(N, 4) u_left, v_left, u_right, v_right of points (N, 4) as a global shutter would have seen them at the time stamp.

    times_s (N, 2): when the left and the right image point were exposed, after the stamp; rates (6,) or (N, 6): of the left
    camera. Points without a depth stay as they are.
    """
    late_px = np.zeros((len(uv_px), 2))  # of the right image point against one exposed when the left one was
    for _ in range(_MOST_ITERATIONS):
        then, _, ahead = triangulate(cameras, np.column_stack([uv_px[:, :2], uv_px[:, 2] - late_px[:, 0]]))
        points = carried(then, rates, -times_s[:, 0])
        seen_right = _pinhole(cameras, 1, carried(points, rates, times_s[:, 1]))
        before, late_px = late_px, np.nan_to_num(seen_right - _pinhole(cameras, 1, then))
        if np.abs(late_px - before).max(initial=0.0) < _CONVERGED_PX:
            break
    moved = np.hstack([uv_px[:, :2], seen_right]) - np.hstack([_pinhole(cameras, side, points) for side in (0, 1)])
    return uv_px - np.where(ahead[:, None] & np.isfinite(moved), moved, 0.0)


def points_at_stamp(rig: Rig, cameras: StereoCameras, uv_px: Floats, rates: Floats) -> Floats:
    """As `at_stamp`, of points (N, 4) of a rectified rig with its shutters; cameras: its own."""
    readouts = readouts_s(rig)
    return at_stamp(cameras, uv_px, pair_shares(rig, uv_px) * readouts, rates) if readouts.any() else uv_px


def as_exposed(points_m: Floats, camera: Camera, rig: Rig, side: Side, rates: Floats) -> Floats:
    """Static points (N, 3) of one camera's frame at the time stamp, where they were when their own rows were exposed.

    camera: the rectified one of this side; rates (N, 6): in its frame. Inverse of `at_stamp` for one camera. Points that are not
    in front of it stay as they are.
    """
    shutter = shutter_of(rig, side)
    if shutter is None or not shutter.readout_ms:
        return points_m
    found = points_m
    for _ in range(_MOST_ITERATIONS):
        ahead = found[:, 2] > _NEAREST_M
        safe = np.where(ahead[:, None], found, [0.0, 0.0, 1.0])
        uv = safe[:, :2] / safe[:, 2:] * [camera.fx_px, camera.fy_px] + [camera.cx_px, camera.cy_px]
        times_s = row_shares(rig, side, uv) * shutter.readout_ms * 1e-3
        before, found = found, np.where(ahead[:, None], carried(points_m, rates, times_s), points_m)
        if np.abs(found - before).max(initial=0.0) < _CONVERGED_M:
            break
    return found


def right_rates(rig: Rig, rates: Floats) -> Floats:
    """(N, 6) rates in the right camera's frame of rates (N, 6) in the left one's."""
    right_SE3_left = se3.invert(rigs.left_SE3_right(rig))
    turn = rates[:, :3] @ right_SE3_left[:3, :3].T
    shift = rates[:, 3:] @ right_SE3_left[:3, :3].T - np.cross(turn, right_SE3_left[:3, 3])
    return np.hstack([turn, shift])


def camera_rates(frame_pairs: Sequence[FramePair], rig: Rig) -> Floats:
    """(K, 6) rate of static points in the left camera's frame at each frame pair, from the poses before and after it.

    Poses beyond a longer pause say nothing; 0 for a pair between two pauses.
    """
    left = np.stack([rigs.map_SE3_left(pair.pose, rig) for pair in frame_pairs])
    times_s = np.array([pair.captured_at_ns - frame_pairs[0].captured_at_ns for pair in frame_pairs]) * 1e-9
    joined = np.pad(np.diff(times_s) <= _PAUSE_S, 1)
    here = np.arange(len(left))
    before, after = here - joined[:-1], here + joined[1:]
    motions = se3.compose(se3.invert(left[after]), left[before])
    lasts_s = times_s[after] - times_s[before]
    return np.stack([rate_of(motion, lasts) for motion, lasts in zip(motions, lasts_s.tolist(), strict=True)])


def _pinhole(cameras: StereoCameras, side: int, points_m: Floats) -> Floats:
    """Image points (N, 2) of points (N, 3) of the left camera's frame in the left (0) or the right image (1); NaN behind it."""
    pose, (fx, fy, cx, cy) = (np.eye(4), cameras.left_px) if side == 0 else (cameras.right_SE3_left, cameras.right_px)
    own = points_m @ pose[:3, :3].T + pose[:3, 3]
    z = np.where(own[:, 2:] > _NEAREST_M, own[:, 2:], np.nan)
    return np.asarray(own[:, :2] / z * [fx, fy] + [cx, cy])
