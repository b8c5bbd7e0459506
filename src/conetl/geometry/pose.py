"""Rigid motions as 4x4 matrices, named `dst_SE3_src`: `p_dst = dst_SE3_src @ p_src`.

All functions work on stacks: `(..., 4, 4)` poses, `(..., 3, 3)` rotations, `(..., 3)` points. Lengths are metres, angles
radians. The body frame is x forward, y left, z up; roll, pitch and yaw follow KITTI's OXTS convention
`R = Rz(yaw) @ Ry(pitch) @ Rx(roll)`, with yaw counted from east (grid east in the map frame) counter-clockwise,
pitch positive with the front down and roll positive with the left side up (Geiger et al., IJRR 2013).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import cast

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from conetl.geometry.packing import as_rows, vec3
from conetl.model.arrays import Floats
from conetl.model.base import Matrix3, Matrix4
from conetl.model.drive import Pose

#: Largest deviation of R @ R.T from the identity that still counts as a rotation written with few digits.
ROTATION_TOLERANCE = 1e-3


def se3(rotation: ArrayLike, translation_m: ArrayLike) -> Floats:
    """Pose (..., 4, 4) from rotations (..., 3, 3) and translations (..., 3)."""
    r = np.asarray(rotation, dtype=np.float64)
    t = np.asarray(translation_m, dtype=np.float64)
    lead = np.broadcast_shapes(r.shape[:-2], t.shape[:-1])
    pose = np.zeros((*lead, 4, 4))
    pose[..., :3, :3] = r
    pose[..., :3, 3] = t
    pose[..., 3, 3] = 1.0
    return pose


def compose(a_SE3_b: ArrayLike, b_SE3_c: ArrayLike) -> Floats:
    """`a_SE3_c` (..., 4, 4) of two (stacks of) poses."""
    return np.asarray(np.matmul(np.asarray(a_SE3_b, dtype=np.float64), np.asarray(b_SE3_c, dtype=np.float64)))


def invert(dst_SE3_src: ArrayLike) -> Floats:
    """`src_SE3_dst` (..., 4, 4), exact for rigid motions."""
    pose = np.asarray(dst_SE3_src, dtype=np.float64)
    back = np.swapaxes(pose[..., :3, :3], -1, -2)
    return se3(back, -np.einsum("...ij,...j->...i", back, pose[..., :3, 3]))


def apply(dst_SE3_src: ArrayLike, points_src_m: ArrayLike) -> Floats:
    """Points (..., 3) of the source frame in the destination frame; leading dimensions broadcast."""
    pose = np.asarray(dst_SE3_src, dtype=np.float64)
    points = np.asarray(points_src_m, dtype=np.float64)
    return np.asarray(np.einsum("...ij,...j->...i", pose[..., :3, :3], points) + pose[..., :3, 3])


def find_pose(dst_SE3_src: Mapping[tuple[str, str], Floats], dst: str, src: str) -> Floats | None:
    """Pose (4, 4) of the frame `src` in `dst`, by chaining known poses {(dst, src): pose} in either direction.

    The shortest chain is used. None if the frames are not connected.
    """
    both = {**{(b, a): invert(pose) for (a, b), pose in dst_SE3_src.items()}, **dst_SE3_src}
    found: dict[str, Floats] = {dst: np.eye(4)}
    edge = [dst]
    while edge and src not in found:
        here = edge.pop(0)
        for (parent, child), pose in both.items():
            if parent == here and child not in found:
                found[child] = compose(found[here], pose)
                edge.append(child)
    return found.get(src)


def rotation_from_rpy(roll_rad: ArrayLike, pitch_rad: ArrayLike, yaw_rad: ArrayLike) -> Floats:
    """Rotations (..., 3, 3) `Rz(yaw) @ Ry(pitch) @ Rx(roll)`, body to level frame."""
    roll, pitch, yaw = np.broadcast_arrays(roll_rad, pitch_rad, yaw_rad)
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (np.cos, np.sin))
    rows = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def is_rotation(rotation: ArrayLike, tolerance: float = ROTATION_TOLERANCE) -> bool:
    """True where a 3x3 matrix is orthonormal within `tolerance` and right-handed."""
    r = np.asarray(rotation, dtype=np.float64)
    if r.shape != (3, 3) or not np.all(np.isfinite(r)):
        return False
    return bool(np.abs(r @ r.T - np.eye(3)).max() <= tolerance and np.linalg.det(r) > 0)


def nearest_rotation(matrix: ArrayLike) -> Floats:
    """The rotation nearest to a (3, 3) matrix in the Frobenius norm; removes the rounding of a text file.

    Raises ValueError if the matrix is not a rotation within `ROTATION_TOLERANCE`.
    """
    m = np.asarray(matrix, dtype=np.float64)
    if not is_rotation(m):
        raise ValueError("the matrix is not a rotation: rows must be orthonormal and the determinant +1")
    u, _, vt = np.linalg.svd(m)
    return np.asarray(u @ vt)


def interpolate(a: ArrayLike, b: ArrayLike, weight: float) -> Floats:
    """Pose (4, 4) between two poses of one frame: linear in position, shortest turn (slerp) in rotation.

    `weight` 0 gives `a`, 1 gives `b`.
    """
    first, last = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    between = Rotation.from_matrix(first[:3, :3].T @ last[:3, :3])
    turn = Rotation.from_rotvec(weight * between.as_rotvec()).as_matrix()
    return se3(first[:3, :3] @ turn, (1.0 - weight) * first[:3, 3] + weight * last[:3, 3])


def to_matrix3(rotation: ArrayLike) -> Matrix3:
    """Nested tuple of a (3, 3) array, as the records want it."""
    return cast(Matrix3, as_rows(np.asarray(rotation, dtype=np.float64)))


def to_matrix4(pose: ArrayLike) -> Matrix4:
    """Nested tuple of a (4, 4) array, as the records want it."""
    return cast(Matrix4, as_rows(np.asarray(pose, dtype=np.float64)))


def map_SE3_body(pose: Pose) -> Floats:
    """(4, 4) array of a pose record."""
    return se3(np.array(pose.map_R_body), np.array(pose.map_t_body_m))


def to_pose(map_SE3_body: Floats, sigma: ArrayLike) -> Pose:
    """The record of a pose (4, 4) and its six sigmas: east, north, up (m), roll, pitch, yaw (rad)."""
    sigmas = np.asarray(sigma)
    return Pose(
        map_R_body=to_matrix3(map_SE3_body[:3, :3]), map_t_body_m=vec3(map_SE3_body[:3, 3]), sigma_enu_m=vec3(sigmas[:3]),
        sigma_rpy_rad=vec3(sigmas[3:]),
    )  # fmt: skip
