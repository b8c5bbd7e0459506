"""Stereo matches -> positions: forward intersection of foot, box centre and tip of every cone (the collinearity equations).

Points are intersected in the left camera's frame, independent of GNSS, and then transformed to the map by the pose of the frame
pair; rigid motions change neither residuals nor image covariance. Matches that cannot be located become rejections.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from conetl.files.documents import first_message
from conetl.geometry import camera as cam
from conetl.geometry import pose as se3
from conetl.geometry import rig as rigs
from conetl.geometry.calibration.covariance import calibration_cov
from conetl.geometry.camera import add_pose_covariance
from conetl.geometry.intersection import IntersectionStatus, intersect
from conetl.geometry.packing import cov3, vec3
from conetl.model.arrays import Bools, Floats
from conetl.model.base import Cov3, NonNegative, Positive, Probability, Record, Vec3
from conetl.model.drive import FramePair, Position, StereoMatch
from conetl.model.feature_classes import FEATURE_CLASSES
from conetl.model.params import PositionParams
from conetl.model.rejections import Rejection, RejectionReason
from conetl.model.rig import Rig

_POINTS = ("foot", "centre", "tip")
_REASONS = {
    IntersectionStatus.INVALID_INPUT: RejectionReason.POSITION_INVALID,
    IntersectionStatus.RAY_ANGLE_TOO_SMALL: RejectionReason.RAY_ANGLE_TOO_SMALL,
    IntersectionStatus.BEHIND_CAMERA: RejectionReason.BEHIND_CAMERA,
    IntersectionStatus.NOT_CONVERGED: RejectionReason.NOT_CONVERGED,
}


class CameraPosition(Record):
    """One cone in the left camera's frame (x right, y down, z forward), from one pair without a trajectory: the paper's case.

    The camera is the one that took the images, even if they were rectified. "Up" is the body's +z axis if the calibration has a
    body, else minus the camera's y axis (a level camera).
    """

    frame_index: int
    match_index: int
    category: str
    xyz_m: Vec3
    """Foot centre on the ground; of signs and boards the middle of the plate's lower edge."""
    cov_m2: Cov3
    centre_xyz_m: Vec3
    """Box centre, the paper's point."""
    ground_distance_m: Positive
    """Horizontal distance from the left camera to the foot."""
    ground_distance_sigma_m: Positive
    object_height_m: float
    """Tip above foot."""
    foot_height_m: float
    """Foot above the left camera's centre, about minus the camera's height above the road."""
    centre_height_m: float
    """Box centre above the left camera's centre: the paper's height."""
    ray_angle_rad: Positive
    residual_rms_px: NonNegative
    iterations: int
    score: Probability


R = TypeVar("R", Position, CameraPosition)


class _Located(NamedTuple):
    """Intersections of M matches in the left camera's frame; the first axis of (3, M, ...) is foot, centre, tip."""

    status: NDArray[np.int8]
    """(3, M)"""
    xyz: Floats
    """(3, M, 3) m"""
    foot_cov: Floats
    """(M, 3, 3) m^2"""
    outline_m: Floats
    """(M,) m, the part of it common to all observations of a cone: sigma down, and times `outline_aside` to the right"""
    residual_rms: Floats
    """(M,) px, over the eight image coordinates of foot and tip"""
    variance_factor: Floats
    """(M,) a-posteriori variance of an image point in units of the stated one, from the two degrees of freedom of foot and tip"""
    ray_angle: Floats
    """(M,) rad, at the foot"""
    iterations: NDArray[np.int64]
    """(M,) maximum of the three points"""


def locate_positions(
    matches: Sequence[StereoMatch], frame_pairs: Iterable[FramePair], rig: Rig, params: PositionParams
) -> tuple[list[Position], list[Rejection]]:
    """Positions of stereo matches in the map frame; frame_pairs: with the drive's poses.

    Every match is in exactly one of the two lists, in the order given. `xyz_m` is the foot; `cov_m2` includes image, calibration
    and pose sigmas, `camera_cov_m2` the image sigmas alone.
    """
    used = {match.frame_index for match in matches}
    poses = {pair.frame_index: pair.pose for pair in frame_pairs if pair.frame_index in used}
    posed = np.array([match.frame_index in poses for match in matches], dtype=bool)
    if not posed.any():
        return [], [_no_pose(match) for match in matches]
    located = _locate(matches, rig, params)
    order = sorted(poses)
    rank = {frame_index: i for i, frame_index in enumerate(order)}
    slot = np.array([rank.get(m.frame_index, 0) for m in matches])  # matches without a pose are rejected below
    body = np.stack([se3.map_SE3_body(poses[i]) for i in order])[slot]
    left = se3.compose(body, rigs.body_SE3_camera(rig, "left"))
    xyz = se3.apply(left, located.xyz)
    # Positions of one rig are compared in its camera frame without the calibration's error, which is the same for all.
    in_camera = located.foot_cov + calibration_cov(located.xyz[0], rig)
    turned = left[:, :3, :3] @ in_camera @ np.swapaxes(left[:, :3, :3], 1, 2)
    sigma_enu = np.array([poses[i].sigma_enu_m for i in order])[slot]
    sigma_rpy = np.array([poses[i].sigma_rpy_rad for i in order])[slot]
    cov = add_pose_covariance(turned, xyz[0], body[:, :3, :3], body[:, :3, 3], sigma_enu, sigma_rpy)
    ground = np.hypot(*(xyz[0] - left[:, :3, 3]).T[:2])

    def position(i: int) -> Position:
        return Position(
            **_shared_fields(matches[i], located, i),
            xyz_m=vec3(xyz[0, i]),
            cov_m2=cov3(cov[i]),
            centre_xyz_m=vec3(xyz[1, i]),
            object_height_m=float(xyz[2, i, 2] - xyz[0, i, 2]),
            camera_xyz_m=vec3(located.xyz[0, i]),
            camera_cov_m2=cov3(located.foot_cov[i]),
            sigma_outline_m=float(located.outline_m[i]),
            range_m=float(ground[i]),
        )

    return _records(position, matches, located, ground, params, posed)


def locate_in_camera(
    matches: Sequence[StereoMatch], rig: Rig, params: PositionParams
) -> tuple[list[CameraPosition], list[Rejection]]:
    """Positions of stereo matches without a trajectory, in the frame of the left camera that took the images.

    No other pair shows whether the sigmas of the image points are right: where a pair's own residuals are larger, so are its
    sigmas, by the variance factor.
    """
    if not matches:
        return [], []
    located = _locate(matches, rig, params)
    of_images = located.foot_cov * np.maximum(located.variance_factor, 1.0)[:, None, None]
    foot_cov = of_images + calibration_cov(located.xyz[0], rig)
    up = rigs.up_in_left_camera(rig)
    height = located.xyz @ up
    level = located.xyz[0] - height[0][:, None] * up
    ground = np.linalg.norm(level, axis=1)
    turn = rigs.stored_R_camera(rig, "left")

    xyz, cov = located.xyz @ turn.T, turn @ foot_cov @ turn.T

    def position(i: int) -> CameraPosition:
        along = level[i] / ground[i]
        return CameraPosition(
            **_shared_fields(matches[i], located, i),
            xyz_m=vec3(xyz[0, i]),
            cov_m2=cov3(cov[i]),
            centre_xyz_m=vec3(xyz[1, i]),
            object_height_m=float(height[2, i] - height[0, i]),
            ground_distance_m=float(ground[i]),
            ground_distance_sigma_m=float(np.sqrt(along @ foot_cov[i] @ along)),
            foot_height_m=float(height[0, i]),
            centre_height_m=float(height[1, i]),
        )

    return _records(position, matches, located, ground, params, np.ones(len(matches), dtype=bool))


def _shared_fields(match: StereoMatch, located: _Located, i: int) -> dict[str, Any]:
    """The fields that do not depend on the frame of the record."""
    return {
        "frame_index": match.frame_index, "match_index": match.match_index, "category": match.category,
        "ray_angle_rad": float(located.ray_angle[i]), "residual_rms_px": float(located.residual_rms[i]),
        "iterations": int(located.iterations[i]), "score": min(box.score for box in match.boxes),
    }  # fmt: skip


def _records(
    record_of: Callable[[int], R], matches: Sequence[StereoMatch], located: _Located, ground: Floats, params: PositionParams,
    posed: Bools,
) -> tuple[list[R], list[Rejection]]:  # fmt: skip
    """Records of the good matches and rejections of the others. ground (M,): horizontal distances; posed (M,)."""
    records: list[R] = []
    rejections: list[Rejection] = []
    for i, match in enumerate(matches):
        rejection = _rejection_of(match, located, i, float(ground[i]), params) if posed[i] else _no_pose(match)
        if rejection is None:
            try:
                records.append(record_of(i))
                continue
            except ValidationError as error:
                rejection = _reject(match, RejectionReason.POSITION_INVALID, first_message(error))
        rejections.append(rejection)
    return records, rejections


def _locate(matches: Sequence[StereoMatch], rig: Rig, params: PositionParams) -> _Located:
    """Intersect foot, centre and tip of all matches in the left camera's frame."""
    count = len(matches)
    uv = np.array(
        [[[getattr(m, f"{point}_{side}_uv_px") for side in ("left", "right")] for m in matches] for point in _POINTS]
    )
    sigma = np.array([(m.sigma_u_px, m.sigma_v_px) for m in matches])
    relative = rigs.left_SE3_right(rig)
    result = intersect(
        uv.reshape(3 * count, 2, 2),
        np.stack([cam.intrinsics(rig.left), cam.intrinsics(rig.right)]),
        np.stack([np.eye(3), relative[:3, :3]]),
        np.stack([np.zeros(3), relative[:3, 3]]),
        np.tile(sigma, (3, 1))[:, None, :],
        convergence_m2=params.convergence_m2,
        max_iterations=params.max_iterations,
        min_ray_angle_rad=params.min_ray_angle_rad,
    )
    residuals = result.residuals_px.reshape(3, count, 4)[[0, 2]]
    # An error of the cone's axis common to both images moves the foot along the rows, not in depth.
    foot_cov = result.cov_m2[:count].copy()
    pointing = np.array([m.sigma_pointing_px for m in matches])
    foot_cov[:, 0, 0] += (pointing * result.depth_m[:count, 0] / rig.left.fx_px) ** 2
    aside = np.array([FEATURE_CLASSES[m.category].outline_aside for m in matches])
    outline_m = np.array([m.sigma_outline_px for m in matches]) * result.depth_m[:count, 0] / rig.left.fx_px
    foot_cov[:, 0, 0] += (aside * outline_m) ** 2
    foot_cov[:, 1, 1] += outline_m**2
    return _Located(
        status=result.status.reshape(3, count),
        xyz=result.xyz_m.reshape(3, count, 3),
        foot_cov=foot_cov,
        outline_m=outline_m,
        residual_rms=np.sqrt(np.mean(residuals**2, axis=(0, 2))),
        variance_factor=np.sum((residuals / np.tile(sigma, 2)) ** 2, axis=(0, 2)) / 2,
        ray_angle=result.ray_angle_rad[:count],
        iterations=result.iterations.reshape(3, count).max(axis=0),
    )


def _rejection_of(
    match: StereoMatch, located: _Located, i: int, ground_m: float, params: PositionParams
) -> Rejection | None:
    """None for a good position."""
    for point, name in enumerate(_POINTS):
        status = IntersectionStatus(int(located.status[point, i]))
        if status is not IntersectionStatus.OK:
            return _reject(match, _REASONS[status], _explain(status, name, float(located.ray_angle[i]), params))
    if ground_m > params.max_range_m:
        detail = f"the cone is {ground_m:.1f} m away, farther than max_range_m = {params.max_range_m:g}"
        return _reject(match, RejectionReason.RANGE_OUT_OF_BOUNDS, detail)
    rms = float(located.residual_rms[i])
    if rms > params.max_residual_px:
        detail = (
            f"the rays miss each other: residual {rms:.2f} px, at most max_residual_px = {params.max_residual_px:g}; "
            "the boxes are of two objects, or the rig calibration is off"
        )
        return _reject(match, RejectionReason.RESIDUAL_TOO_LARGE, detail)
    return None


def _explain(status: IntersectionStatus, point: str, angle_rad: float, params: PositionParams) -> str:
    match status:
        case IntersectionStatus.RAY_ANGLE_TOO_SMALL:
            return (
                f"the rays to its {point} are nearly parallel (foot: {angle_rad:.4f} rad, at least min_ray_angle_rad = "
                f"{params.min_ray_angle_rad:g}): too far away for this baseline"
            )
        case IntersectionStatus.BEHIND_CAMERA:
            return f"the rays to its {point} meet behind a camera: the boxes are of two objects"
        case IntersectionStatus.NOT_CONVERGED:
            return f"the intersection of its {point} did not converge in max_iterations = {params.max_iterations}"
        case _:
            return f"an image point or sigma of its {point} is not a usable number"


def _no_pose(match: StereoMatch) -> Rejection:
    detail = f"frame pair {match.frame_index} of this match has no pose: the pair was rejected before"
    return _reject(match, RejectionReason.POSITION_INVALID, detail)


def _reject(match: StereoMatch, reason: RejectionReason, detail: str) -> Rejection:
    return Rejection(
        step="positions", reason=reason, record=f"match {match.match_index} of frame pair {match.frame_index}",
        detail=detail, payload=match.model_dump(mode="json"),
    )  # fmt: skip
