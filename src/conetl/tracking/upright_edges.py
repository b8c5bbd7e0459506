"""Roll of a vehicle whose log has positions only, from upright edges: posts, walls, windows.

Images of vertical lines meet in one point, which gives roll and pitch (vanishing point; Caprile & Torre 1990). Visual
odometry gives the changes of both, the edges of many images their values.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from conetl.geometry import pose as se3
from conetl.geometry.motion.stereo_motion import RelativeMotion
from conetl.geometry.rig import camera_of
from conetl.model.arrays import Floats, Image
from conetl.model.drive import FramePair
from conetl.model.params import TrajectoryParams
from conetl.model.rig import Camera, Rig
from conetl.perception.images import ImageFileError
from conetl.perception.working_size import ImageReader
from conetl.tracking.trajectory import RefinementOutcome, refine_trajectory

#: One tilt is found for every part of a drive of this many seconds, from this many of its images.
_PART_S, _IMAGES = 10.0, 12
#: Edges are at least this long; the direction of a longer one is known better (px, rad).
_LEAST_PX, _END_PX, _UNEVEN_RAD = 20.0, 0.7, np.radians(0.25)
#: Edges are searched this near to the vertical by course and odometry; upright ones are this near to each other (rad).
_SEARCH_RAD, _NEAR_RAD = np.radians(8.0), np.radians(0.6)
#: At least this many are upright, and such a share of those that are searched: of edges of all directions it is 0.08, and up to
#: 0.25 in clips whose halves contradict each other.
_LEAST_EDGES, _LEAST_SHARE = 40, 0.3
#: An edge is seen in many images, and houses lean (rad, one sigma): it counts as one in this many, and no roll is known better.
_ALIKE, _LEANS_RAD = 10.0, np.radians(0.25)
#: Roll and pitch from a course, and without information from edges (rad, one sigma).
_BY_COURSE_RAD, _UNKNOWN_RAD = np.radians([2.5, 1.5]), np.radians(10.0)


def with_roll(
    frame_pairs: Sequence[FramePair], rig: Rig, motions: Sequence[RelativeMotion], read: ImageReader, params: TrajectoryParams
) -> tuple[FramePair, ...]:  # fmt: skip
    """The same frame pairs, whose poses are those of a course, with the roll that edges show, and its sigma.

    motions: of the drive's intervals; read: grey rectified images. A pair is unchanged where odometry or edges do not show its
    roll, and where the camera looks to the side.
    """
    refined = refine_trajectory(frame_pairs, rig, motions, params)
    if refined.outcome is not RefinementOutcome.REFINED:
        return tuple(frame_pairs)
    times_s = np.array([pair.captured_at_ns - frame_pairs[0].captured_at_ns for pair in frame_pairs]) * 1e-9
    axes, camera, found = refined.map_SE3_left[:, :3, :3], camera_of(rig, "left"), []
    for part in np.array_split(np.arange(len(times_s)), np.clip(round(times_s[-1] / _PART_S), 1, len(times_s))):
        middle, edges = axes[part[len(part) // 2]], [np.empty((0, 4))]
        for k in sorted(set(np.linspace(part[0], part[-1], _IMAGES).round().astype(int))):
            with suppress(ImageFileError, cv2.error):
                edges.append(edges_near(read(frame_pairs[k], "left"), camera, axes[k], middle))
        tilt, cov = tilt_of(np.concatenate(edges))
        turns = middle[:, [2, 0]]
        found.append([times_s[part].mean(), *(turns @ tilt), *(turns @ cov @ turns.T).ravel()])
    at_s, *columns = np.array(found).T
    tilts = np.stack([np.interp(times_s, at_s, column) for column in columns], axis=1)
    return tuple(
        _tilted(pair, axes[k], refined.body_SE3_left[:3, :3], tilts[k, :3], tilts[k, 3:].reshape(3, 3))
        for k, pair in enumerate(frame_pairs)
    )


def _tilted(pair: FramePair, map_R_left: Floats, body_R_left: Floats, tilt: Floats, cov: Floats) -> FramePair:
    """A frame pair with the roll of an adjusted attitude that is tilted by (3,), with a covariance (3, 3), in the map's axes."""
    logged, stated, axis = np.array(pair.pose.map_R_body), np.array(pair.pose.sigma_rpy_rad), body_R_left[:, 2]
    variance = map_R_left[:, 2] @ cov @ map_R_left[:, 2] + _LEANS_RAD**2 + np.sum((axis * stated)[1:] ** 2)
    sigma = float(np.sqrt(variance)) / max(abs(float(axis[0])), 1e-9)
    if sigma >= stated[0]:
        return pair
    adjusted = Rotation.from_rotvec(tilt).as_matrix() @ map_R_left @ body_R_left.T
    roll = Rotation.from_matrix(logged.T @ adjusted).as_rotvec() @ axis
    turned = se3.to_matrix3(logged @ Rotation.from_rotvec(roll * axis).as_matrix())
    return pair.with_pose(map_R_body=turned, sigma_rpy_rad=(sigma, *stated[1:].tolist()))


def edges_near(image: Image, camera: Camera, map_R_left: Floats, map_R_middle: Floats) -> Floats:
    """(N, 4) edges near the vertical: angle against it (rad), its derivatives by turns of the camera in the middle of the part
    about its optical axis and its x axis, and its sigma (rad)."""
    lines = cv2.createLineSegmentDetector().detect(image)[0]
    ends = np.empty((0, 2, 2)) if lines is None else np.asarray(lines, dtype=np.float64).reshape(-1, 2, 2)
    along, up = ends[:, 1] - ends[:, 0], map_R_left[2]
    length = np.linalg.norm(along, axis=1)
    at = (ends.mean(axis=1) - (camera.cx_px, camera.cy_px)) / (camera.fx_px, camera.fy_px)
    upwards = up[:2] - up[2] * at
    angle = np.arctan2(along[:, 0], -along[:, 1]) - np.arctan2(upwards[:, 0], -upwards[:, 1])
    angle = (angle + np.pi / 2) % np.pi - np.pi / 2
    by = -np.stack([np.ones(len(at)), at[:, 0]], axis=1) @ (map_R_left.T @ map_R_middle)[np.ix_([2, 0], [2, 0])]
    near = (length >= _LEAST_PX) & (np.abs(angle) < _SEARCH_RAD)
    sigma = np.hypot(_END_PX / np.maximum(length, 1.0), _UNEVEN_RAD)
    return np.asarray(np.column_stack([angle, by, sigma])[near])


def tilt_of(edges: Floats) -> tuple[Floats, Floats]:
    """Turns (2,) of the camera in the middle by which most edges (N, 4) of `edges_near` stand upright; covariance (2, 2), rad."""
    angle, by, sigma = edges[:, 0], edges[:, 1:3], edges[:, 3]
    tried = np.stack(np.meshgrid(np.arange(-8.0, 8.1, 0.2), np.arange(-1.5, 1.6, 0.25)), axis=-1).reshape(-1, 2)
    tilt = max(np.radians(tried), key=lambda one: _weights(angle - by @ one, sigma).sum())
    for _ in range(20):
        weight = _weights(angle - by @ tilt, sigma) / _ALIKE
        normal = by.T @ (by * weight[:, None]) + np.diag(_BY_COURSE_RAD**-2)
        tilt = np.linalg.solve(normal, by.T @ (weight * angle))
    if np.count_nonzero(weight) < max(_LEAST_EDGES, _LEAST_SHARE * len(edges)):
        return np.zeros(2), _UNKNOWN_RAD**2 * np.eye(2)
    return np.asarray(tilt), np.asarray(np.linalg.inv(normal))


def _weights(off: Floats, sigma: Floats) -> Floats:
    """Tukey's, by the sigmas."""
    return np.asarray(np.maximum(1 - (off / _NEAR_RAD) ** 2, 0.0) ** 2 / sigma**2)
