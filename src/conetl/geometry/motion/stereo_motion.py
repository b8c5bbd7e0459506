"""Motion of a calibrated stereo rig between two frame pairs, from image points in all four images.

It minimises the reprojection error of (u_left, v_left, u_right) in the second pair of points intersected in the first (Geiger,
Ziegler & Stiller 2011, "StereoScan", eq. 2-3), weighted with the image errors of both pairs. RANSAC over three-point
hypotheses (Fischler & Bolles 1981) and Cauchy's weights keep moving objects out.

`next_SE3_first` transforms points of the left camera's frame at the first exposure to that of the second. A small motion error is
(w, d): R = exp([w]x) R_true, t = t_true + d; w in radians, d in metres, both in the second frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

import numpy as np
from pydantic import Field, model_validator

from conetl.geometry.small_arrays import apply_steps, cross_matrix, inverse_of_symmetric, pose_distance, upper_median
from conetl.model.arrays import Bools, Floats
from conetl.model.base import Matrix4, Record
from conetl.model.params import TrajectoryParams

_UPPER = np.triu_indices(6)
_HYPOTHESES = 64
_MINIMAL_POINTS = 3
_MAX_ITERATIONS = 20
_CHOOSING_ITERATIONS = 3
_CAUCHY_SIGMAS = 2.385  # 95 % efficiency on normal errors (Rey 1983)
_NEAREST_M = 0.3
#: Points whose depth has a relative sigma above this are left out.
_VAGUE_SHARE = 0.25
#: No search is needed if this share of the usable points agrees with the guess.
_MAJORITY = 0.5
#: Largest step, squared and in sigmas, that ends the iteration.
_CONVERGED = 1e-2
#: A motion that is known less well counts as unknown.
_MAX_SIGMA_M, _MAX_SIGMA_RAD = 0.2, 0.01


class RelativeMotion(Record):
    """Measurement of visual odometry between two consecutive frame pairs of a drive."""

    first_frame_index: int = Field(ge=0)
    second_frame_index: int = Field(ge=0)
    second_SE3_first: Matrix4 | None
    """Motion of the left camera; None where there is no measurement."""
    cov: tuple[float, ...]
    """Upper triangle, row by row, of the (6, 6) covariance of (w, d); empty where there is no measurement."""
    inlier_count: int = Field(ge=0)
    point_count: int = Field(ge=0)
    reason: str
    """'ok', or why there is no measurement."""
    row_changes: tuple[float, ...] = ()
    """Mean grey levels by which bands of rows differ between the left images, then between the right ones."""

    @model_validator(mode="after")
    def _whole_or_nothing(self) -> RelativeMotion:
        wanted = 0 if self.second_SE3_first is None else 21
        if len(self.cov) != wanted:
            raise ValueError(f"expected {wanted} numbers of covariance, found {len(self.cov)}")
        return self

    def shift_m(self) -> Floats:
        """(3,) translation; NaN where there is no measurement."""
        return np.full(3, np.nan) if self.second_SE3_first is None else np.array(self.second_SE3_first)[:3, 3]

    def cov_matrix(self) -> Floats:
        """(6, 6) covariance; raises ValueError where there is no measurement."""
        upper = np.zeros((6, 6))
        upper[_UPPER] = self.cov
        return upper + np.triu(upper, 1).T


class MotionStatus(StrEnum):
    """Outcome of one estimate."""

    OK = "ok"
    TOO_FEW_POINTS = "too_few_points"
    NO_CONSENSUS = "no_consensus"
    DEGENERATE = "degenerate"
    NOT_CONVERGED = "not_converged"


@dataclass(frozen=True)
class StereoCameras:
    """A rectified rig: (fx, fy, cx, cy) in pixels of both cameras, and (4, 4) right_SE3_left."""

    left_px: Floats
    right_px: Floats
    right_SE3_left: Floats


class StereoMotion(NamedTuple):
    """Result of `estimate_motion`; unless `status` is OK the motion is the expected one."""

    status: MotionStatus
    next_SE3_first: Floats
    cov: Floats
    """(6, 6) of (w, d): rad^2, rad m, m^2; scaled by the residuals' own spread."""
    inliers: Bools
    """(N,)"""


def triangulate(cameras: StereoCameras, observed_px: Floats) -> tuple[Floats, Floats, Bools]:
    """Points (N, 3) m in the left camera's frame of observations (N, 3) u_left, v_left, u_right.

    Three numbers fix three coordinates exactly: the left ray meets the plane of the right column. Also returns the
    derivatives (N, 3, 3) m/px and which points lie in front of the rig (False: the values are invalid).
    """
    fx, fy, cx, cy = cameras.left_px
    rotation, shift = cameras.right_SE3_left[:3, :3], cameras.right_SE3_left[:3, 3]
    ray = np.stack([(observed_px[:, 0] - cx) / fx, (observed_px[:, 1] - cy) / fy, np.ones(len(observed_px))], axis=1)
    column = (observed_px[:, 2] - cameras.right_px[2]) / cameras.right_px[0]
    across, ahead = ray @ rotation[0], ray @ rotation[2]
    above, below = column * shift[2] - shift[0], across - column * ahead
    usable = np.abs(below) > 1e-9
    safe = np.where(usable, below, 1.0)
    depth = above / safe
    d_column = (shift[2] * safe + above * ahead) / safe**2
    d_x = -above / safe**2 * (rotation[0, 0] - column * rotation[2, 0])
    d_y = -above / safe**2 * (rotation[0, 1] - column * rotation[2, 1])
    d_depth = np.stack([d_x / fx, d_y / fy, d_column / cameras.right_px[0]], axis=1)
    jacobian = ray[:, :, None] * d_depth[:, None, :]
    jacobian[:, 0, 0] += depth / fx
    jacobian[:, 1, 1] += depth / fy
    return ray * depth[:, None], jacobian, usable & (depth > _NEAREST_M)


def project(cameras: StereoCameras, points_m: Floats) -> tuple[Floats, Floats, Bools]:
    """Image points (..., 3) u_left, v_left, u_right of points (..., 3) in the left camera's frame.

    Also returns the derivatives (..., 3, 3) px/m and which points lie in front of both cameras.
    """
    image, jacobian, valid = _project_components(cameras, np.moveaxis(points_m, -1, 0))
    return np.moveaxis(image, 0, -1), np.moveaxis(jacobian, (0, 1), (-2, -1)), valid


def _directions(cameras: StereoCameras, points_m: Floats) -> tuple[Floats, Floats, Floats, Floats, Floats, Bools]:
    """x / z, y / z and z (...) in the left camera, x / z and z in the right one, and which points lie in front of both."""
    turn, shift = cameras.right_SE3_left[:3, :3], cameras.right_SE3_left[:3, 3]
    right_x, right_z = points_m @ turn[0] + shift[0], points_m @ turn[2] + shift[2]
    valid = (points_m[..., 2] > _NEAREST_M) & (right_z > _NEAREST_M)
    z, zr = np.where(valid, points_m[..., 2], 1.0), np.where(valid, right_z, 1.0)
    return points_m[..., 0] / z, points_m[..., 1] / z, z, right_x / zr, zr, valid


def _consensus(cameras: StereoCameras, points: Floats, second_px: Floats, reach_px: Floats, poses: Floats) -> Bools:
    """(H, N): which points agree with motions (H, 4, 4) to within their tolerance."""
    moved = points @ np.swapaxes(poses[:, :3, :3], 1, 2) + poses[:, None, :3, 3]
    x, y, _, xr, _, valid = _directions(cameras, moved)
    fx, fy, cx, cy = cameras.left_px
    follows = valid & (np.abs(fx * x + (cx - second_px[:, 0])) <= reach_px)
    follows &= np.abs(fy * y + (cy - second_px[:, 1])) <= reach_px
    follows &= np.abs(cameras.right_px[0] * xr + (cameras.right_px[2] - second_px[:, 2])) <= reach_px
    return np.asarray(follows)


def estimate_motion(
    cameras: StereoCameras,
    first_px: Floats,
    second_px: Floats,
    sigma_px: Floats,
    expected: Floats,
    params: TrajectoryParams,
    seed: int = 0,
    start: Floats | None = None,
    guess: Floats | None = None,
) -> StereoMotion:
    """Motion of the rig between two frame pairs.

    first_px, second_px (N, 3): u_left, v_left, u_right of the same points; sigma_px (N,) of each of their coordinates; expected
    (4, 4): guess of next_SE3_first (from INS), which bounds and starts the search; start (4, 4): nearly the result, such as the
    motion of the same points with another calibration, in place of a search; guess (4, 4): possibly the result, such as the
    motion of the interval before, used where most points follow it. Never raises on bad points.
    """
    points, d_points, usable = triangulate(cameras, first_px)
    usable &= np.isfinite(first_px).all(axis=1) & np.isfinite(second_px).all(axis=1)
    # An uncertain depth is biased as well: noise makes far points appear near.
    usable &= sigma_px * np.linalg.norm(d_points[:, 2, :], axis=1) <= _VAGUE_SHARE * points[:, 2]
    chosen = np.flatnonzero(usable)

    def result(status: MotionStatus, pose: Floats, inliers: Bools, cov: Floats | None = None) -> StereoMotion:
        """inliers: among the usable points."""
        everywhere = np.zeros(len(first_px), dtype=bool)
        everywhere[chosen] = inliers
        return StereoMotion(status, pose, np.zeros((6, 6)) if cov is None else cov, everywhere)

    if len(chosen) < params.min_points:
        return result(MotionStatus.TOO_FEW_POINTS, expected, np.zeros(len(chosen), dtype=bool))
    points, second_px, sigma_px = (a[chosen] for a in (points, second_px, sigma_px))
    d_points = np.ascontiguousarray(d_points[chosen].transpose(1, 2, 0))
    # A residual is expected to grow with the point's own errors: near points magnify them.
    _, jacobian, _ = _project_components(cameras, expected[:3, :3] @ points.T + expected[:3, 3:])
    most = np.nan_to_num(_spread(jacobian, d_points, expected).reshape(9, -1)[::4].max(axis=0), nan=2.0)
    reach = params.inlier_px * sigma_px * np.sqrt(np.clip(most, 2.0, 50.0)) / np.median(sigma_px) / 2**0.5

    def best_of(poses: Floats) -> tuple[Floats, Bools]:
        """The motion near the expected one that most points follow, and which do."""
        turn, shift = pose_distance(poses, expected)
        poses = poses[(shift <= params.gate_m) & (turn <= params.gate_rad)]
        follows = _consensus(cameras, points, second_px, reach, poses)
        winner = int(follows.sum(axis=1).argmax())
        return poses[winner], follows[winner]

    if start is not None:
        pose, inliers = start, _consensus(cameras, points, second_px, reach, start[None])[0]
    if start is None or inliers.sum() < params.min_points:
        pose, inliers = best_of(expected[None] if guess is None else np.stack([guess, expected]))
        if inliers.sum() < max(params.min_points, _MAJORITY * len(points)):
            pose, inliers = best_of(
                np.concatenate([expected[None], _hypotheses(cameras, points, second_px, expected, seed)])
            )
    if inliers.sum() < max(params.min_points, params.min_inlier_share * len(points)):
        return result(MotionStatus.NO_CONSENSUS, expected, inliers & (inliers.sum() >= _MINIMAL_POINTS))
    return result(*_refine(cameras, points, d_points, second_px, sigma_px, reach, pose, params.min_points))


def _hypotheses(cameras: StereoCameras, points: Floats, second_px: Floats, expected: Floats, seed: int) -> Floats:
    """(H, 4, 4) three-point motions."""
    rng = np.random.default_rng(seed)
    # A point drawn twice only wastes that hypothesis.
    draws = rng.integers(0, len(points), (_HYPOTHESES, _MINIMAL_POINTS))
    poses = np.broadcast_to(expected, (_HYPOTHESES, 4, 4)).copy()
    for _ in range(4):
        moved = np.einsum("hij,hnj->hni", poses[:, :3, :3], points[draws]) + poses[:, None, :3, 3]
        image, jacobian, valid = project(cameras, moved)
        turned = moved - poses[:, None, :3, 3]
        design = np.concatenate([-jacobian @ cross_matrix(turned), jacobian], axis=-1).reshape(_HYPOTHESES, -1, 6)
        residual = np.where(valid[..., None], second_px[draws] - image, 0.0).reshape(_HYPOTHESES, -1)
        design *= np.repeat(valid, 3, axis=1)[..., None]
        # Three points in a row or far away leave the normal matrix singular: a little damping keeps them harmless.
        scale = np.einsum("hni,hni->hi", design, design)
        normal = np.swapaxes(design, 1, 2) @ design + (1e-9 * scale + 1e-12)[:, :, None] * np.eye(6)
        step = np.linalg.solve(normal, np.einsum("hni,hn->hi", design, residual)[..., None])[..., 0]
        poses = apply_steps(poses, np.clip(np.nan_to_num(step), -1.0, 1.0))
    return poses


def _refine(
    cameras: StereoCameras,
    points: Floats,
    d_points: Floats,
    second_px: Floats,
    sigma_px: Floats,
    reach_px: Floats,
    pose: Floats,
    min_inliers: int,
) -> tuple[MotionStatus, Floats, Bools, Floats | None]:
    """Iteratively reweighted Gauss-Newton over the inliers, which are chosen again in the first iterations.

    Returns status, motion, inliers and covariance, as `StereoMotion`.
    """
    # Coordinates come first and points last, so that each line below is a few long operations over all points.
    at, seen = points.T.copy(), second_px.T.copy()
    inliers = np.ones(len(points), dtype=bool)
    for iteration in range(_MAX_ITERATIONS):
        turned = pose[:3, :3] @ at
        x, y, z, xr, zr, valid = _directions(cameras, (turned + pose[:3, 3:]).T)
        if iteration in (
            0,
            _CHOOSING_ITERATIONS,
        ):  # in between, a motion changes by too little to change the derivatives
            jacobian = _jacobian(cameras, x, y, z, xr, zr)
            # A weight only: the covariance comes from the residuals.
            if not iteration:
                information = inverse_of_symmetric(sigma_px**2 * _spread(jacobian, d_points, pose))
            design = _design(jacobian, turned)
            weighted = np.einsum("ijn,ajn->ain", information, design)  # (6, 3, N): the information is symmetric
        r = seen - _image(cameras, x, y, xr)
        if iteration < _CHOOSING_ITERATIONS:  # later a point at the bound could alternate
            inliers = valid & (np.abs(r).max(axis=0) <= reach_px)
            good = np.flatnonzero(inliers)
            if len(good) < min_inliers:
                return MotionStatus.NO_CONSENSUS, pose, inliers, None
        misfit2 = np.einsum("in,ijn,jn->n", r, information, r) / 3
        factor2 = max(upper_median(misfit2.take(good)) / 0.7887, 1e-6)  # median of chi-square(3) / 3
        wide = (weighted * (inliers / (1 + misfit2 / factor2 / _CAUCHY_SIGMAS**2))).reshape(6, -1)
        normal = wide @ design.reshape(6, -1).T
        try:
            inverse = np.linalg.inv(normal)
        except np.linalg.LinAlgError:
            return MotionStatus.DEGENERATE, pose, inliers, None
        step = inverse @ (wide @ r.ravel())
        pose = apply_steps(pose, step)
        if iteration >= _CHOOSING_ITERATIONS and float((step**2 * np.diag(normal)).max()) < _CONVERGED:
            # Sandwich of M-estimation: scatter of the weighted scores around the curvature (Huber 1981, ch. 6).
            scores = np.einsum("in,ain->an", r, wide.reshape(weighted.shape))
            cov = inverse @ (scores @ scores.T) @ inverse
            cov = np.maximum(1.0, len(good) / max(len(good) - 6, 1)) * (cov + cov.T) / 2
            sigma = np.sqrt(np.diag(cov))
            known = sigma[:3].max() <= _MAX_SIGMA_RAD and sigma[3:].max() <= _MAX_SIGMA_M
            return MotionStatus.OK if known else MotionStatus.DEGENERATE, pose, inliers, cov
    return MotionStatus.NOT_CONVERGED, pose, inliers, None


def _design(jacobian: Floats, turned: Floats) -> Floats:
    """(6, 3, N) derivatives by (w, d): the rows' cross products with the turned points (3, N), and the rows (3, 3, N)."""
    rows, at_point = jacobian.transpose(1, 0, 2), turned[:, None]
    design = np.empty((6, 3, turned.shape[1]))
    design[:3] = at_point.take((1, 2, 0), 0) * rows.take((2, 0, 1), 0)
    design[:3] -= at_point.take((2, 0, 1), 0) * rows.take((1, 2, 0), 0)
    design[3:] = rows
    return design


def _project_components(cameras: StereoCameras, points_m: Floats) -> tuple[Floats, Floats, Bools]:
    """As `project`, with the points last: (3, ...), (3, 3, ...), (...) of points (3, ...)."""
    x, y, z, xr, zr, valid = _directions(cameras, np.moveaxis(points_m, 0, -1))
    return _image(cameras, x, y, xr), _jacobian(cameras, x, y, z, xr, zr), valid


def _image(cameras: StereoCameras, x: Floats, y: Floats, xr: Floats) -> Floats:
    """(3, ...) image points of directions."""
    fx, fy, cx, cy = cameras.left_px
    image = np.empty((3, *x.shape))
    image[0], image[1], image[2] = fx * x + cx, fy * y + cy, cameras.right_px[0] * xr + cameras.right_px[2]
    return image


def _jacobian(cameras: StereoCameras, x: Floats, y: Floats, z: Floats, xr: Floats, zr: Floats) -> Floats:
    """(3, 3, ...) px/m: derivatives of image points by the point."""
    rotation, focal = cameras.right_SE3_left[:3, :3], cameras.right_px[0] / zr
    jacobian = np.zeros((3, 3, *z.shape))
    jacobian[0, 0], jacobian[1, 1] = cameras.left_px[0] / z, cameras.left_px[1] / z
    jacobian[0, 2], jacobian[1, 2] = -jacobian[0, 0] * x, -jacobian[1, 1] * y
    for axis in range(3):
        jacobian[2, axis] = focal * (rotation[0, axis] - rotation[2, axis] * xr)
    return jacobian


def _spread(jacobian: Floats, d_points: Floats, pose: Floats) -> Floats:
    """Covariance (3, 3, N) of residuals in squares of sigma_px: the second pair's image errors, and the first pair's carried
    through intersection and motion. jacobian (3, 3, N): of image points in the second pair by the point; d_points (3, 3, N): of
    the point by those in the first."""
    carried = np.einsum("ikn,kjn->ijn", np.einsum("ikn,kj->ijn", jacobian, pose[:3, :3]), d_points)
    spread = np.einsum("ikn,jkn->ijn", carried, carried)
    spread.reshape(9, -1)[::4] += 1.0  # the diagonals
    return np.asarray(spread)
