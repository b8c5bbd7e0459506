"""Statistics of a drive against truth: errors by range and axis, CE90 and LE90, and whether the stated covariances hold."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from conetl.evaluation.truth import TruthCone, TruthLine
from conetl.geometry.calibration.covariance import calibration_jacobian, known_covariance, unpack_jacobians
from conetl.geometry.consistency import Consistency, ce90_m, consistency, le90_m, pooled
from conetl.geometry.packing import cov_matrices, vec3
from conetl.geometry.rig import map_SE3_left
from conetl.model.arrays import Bools, Floats
from conetl.model.base import Record, Vec3
from conetl.model.drive import Drive, Pose, Position, Track
from conetl.model.rig import Rig
from conetl.tracking.association import MotionError
from conetl.tracking.error_propagation import (
    PoseCov,
    class_error_id,
    constant_and_change,
    moved_by_poses,
    moved_cov,
    outline_errors,
    track_shares,
)

#: Upper ends of the range bands; the last is open.
RANGE_BANDS_M = (5.0, 8.0, 12.0, 16.0, 20.0, 25.0)
#: Fields of `PointErrors` with one row per estimate.
_PER_ESTIMATE = ("truth_m", "difference_m", "cov_m2", "range_m", "sight", "common_jacobian")


@dataclass(frozen=True)
class PointErrors:
    """N estimates of known cones; east, north, up."""

    cone_ids: tuple[str, ...]
    truth_m: Floats
    """(N, 3) map"""
    difference_m: Floats
    """(N, 3) estimate minus truth"""
    cov_m2: Floats
    """(N, 3, 3) absolute, as stated"""
    own_cov_m2: Floats
    """(3N, 3N) without the common errors of the drive; pose errors that change within it correlate single positions"""
    range_m: Floats
    """(N,) ground distance from the left camera, the nearest one of tracks"""
    sight: Floats
    """(N, 3) level unit vector from the left camera to the cone"""
    common_jacobian: Floats
    """(N, 3, K) of each estimate by the common errors of the drive"""
    common_cov: Floats
    """(K, K) of the common errors"""

    def joint_cov_m2(self) -> Floats:
        """(3N, 3N) of all estimates, common errors included."""
        return self.own_cov_m2 + _propagate(self.common_jacobian, self.common_cov)

    def in_sight_axes(self, vectors: Floats) -> Floats:
        """(N, 3) vectors rotated to the line of sight, across it (to the left) and up."""
        return np.asarray(np.einsum("nij,nj->ni", _sight_axes(self.sight), vectors))

    def sigma_in_sight_axes(self) -> Floats:
        """(N, 3) stated absolute sigmas along, across, up."""
        axes = _sight_axes(self.sight)
        turned = axes @ self.cov_m2 @ np.swapaxes(axes, 1, 2)
        return np.asarray(np.sqrt(np.einsum("nii->ni", turned)))


class ErrorStatistics(Record):
    """Figures of one set of errors, metres."""

    count: int
    median_3d_m: float
    rmse_3d_m: float
    rmse_enu_m: Vec3
    bias_enu_m: Vec3
    rmse_sight_m: Vec3
    """Along, across, up."""
    bias_sight_m: Vec3
    stated_sigma_sight_m: Vec3
    """Root mean square of the stated absolute sigmas."""
    ce90_m: float
    le90_m: float


class RangeBand(Record):
    """Errors of the estimates between two ranges."""

    from_m: float
    to_m: float | None
    """None for the open last band."""
    errors: ErrorStatistics


def track_errors(
    lines: Sequence[TruthLine[Track]], drive: Drive, positions: Sequence[Position], motion: MotionError | None = None
) -> PointErrors:
    """Errors of the tracks that were found.

    The tracks share the common errors of the drive's positions (`position_errors`). Each track has its own Jacobian, because an
    error of the heading does not shift all cones equally: the Jacobians of its sightings, weighted by their share of the
    information, as in the adjustment. Errors common to a class are taken from the tracks. positions: single positions of the
    drive. motion: of a refined trajectory, as used for the tracks.
    """
    found = [(line, line.feature) for line in lines if line.feature is not None]
    path_m = np.array([map_SE3_left(pair.pose, drive.rig)[:3, 3] for pair in drive.frame_pairs])
    xyz = np.array([track.xyz_m for _, track in found]).reshape(-1, 3)
    offset = xyz[:, None, :2] - path_m[None, :, :2]
    nearest = np.linalg.norm(offset, axis=2).argmin(axis=1)
    level = offset[np.arange(len(found)), nearest]
    truth = np.array([line.truth.xyz_m for line, _ in found]).reshape(-1, 3)
    pose_of = {pair.frame_index: pair.pose for pair in drive.frame_pairs}
    by_member = {(p.frame_index, p.match_index): p for p in positions}
    members = [[by_member[member] for member in track.members] for _, track in found]
    jacobians, variances, all_shares = [np.zeros((0, 3, 6 + len(calibration_of(drive.rig))))], [], []
    for point, seen in zip(xyz, members, strict=True):
        poses = [pose_of[p.frame_index] for p in seen]
        jacobian, sigmas = pose_and_calibration(np.tile(point, (len(poses), 1)), poses, drive.rig)
        shares = track_shares(seen, poses, drive.rig, motion)
        jacobians.append(np.einsum("fij,fjk->ik", shares, jacobian)[None])
        variances.append(np.mean(sigmas**2, axis=0))
        all_shares.append(shares)
    # Pose errors that change within the drive move cones seen together equally; each track states them separately.
    between = np.zeros((xyz.size, xyz.size))
    if found and motion is not None and motion.changed_cov_m2 is not None:
        between = motion.changed_cov_m2(xyz, [[p.frame_index for p in seen] for seen in members], all_shares)
    between[np.kron(np.eye(len(found), dtype=bool), np.ones((3, 3), dtype=bool))] = 0.0
    of_poses = np.diag(np.mean(variances, axis=0)) if found else np.zeros((6, 6))
    by_class = _class_jacobian([track for _, track in found])
    return PointErrors(
        cone_ids=tuple(line.truth.cone_id for line, _ in found),
        truth_m=truth,
        difference_m=xyz - truth,
        cov_m2=cov_matrices([track.cov_m2 for _, track in found]),
        own_cov_m2=block_diag(*cov_matrices([track.relative_cov_m2 for _, track in found])) + between,
        range_m=np.linalg.norm(level, axis=1),
        sight=_unit(level),
        common_jacobian=np.concatenate([np.concatenate(jacobians), by_class], axis=2),
        common_cov=block_diag(of_poses, calibration_of(drive.rig), np.eye(by_class.shape[2])),
    )


def members_of(lines: Sequence[TruthLine[Track]]) -> dict[tuple[int, int], TruthCone]:
    """The cone of each single position of the found tracks, by (frame_index, match_index).

    Positions are not filtered by their error: the statistics would look too good.
    """
    return {member: line.truth for line in lines if line.feature is not None for member in line.feature.members}


def position_errors(
    cone_of: Mapping[tuple[int, int], TruthCone],
    positions: Sequence[Position],
    drive: Drive,
    poses: PoseCov | None = None,
) -> PointErrors:
    """Errors of the single positions with a known cone; see `members_of`.

    Their common errors are the constant part of the body's position and attitude, the rig's calibration and, per cone, the
    assumptions about its foot, axis and shape. The own error of a position is that of its image points. poses: covariance of the
    drive's poses; None: one error of the whole drive.
    """
    pose_of = {pair.frame_index: pair.pose for pair in drive.frame_pairs}
    chosen = [p for p in positions if (p.frame_index, p.match_index) in cone_of]
    cones = [cone_of[p.frame_index, p.match_index] for p in chosen]
    xyz = np.array([p.xyz_m for p in chosen]).reshape(-1, 3)
    stated = [pose_of[p.frame_index] for p in chosen]
    left = np.array([map_SE3_left(pose, drive.rig) for pose in stated]).reshape(-1, 4, 4)
    turn = left[:, :3, :3]
    camera_cov = cov_matrices([p.camera_cov_m2 for p in chosen])
    truth = np.array([cone.xyz_m for cone in cones]).reshape(-1, 3)
    jacobian, sigmas = pose_and_calibration(xyz, stated, drive.rig)
    names = tuple(cone.cone_id for cone in cones)
    outline, own_cov = _outline_parts(names, chosen, drive.rig, turn, turn @ camera_cov @ np.swapaxes(turn, 1, 2))
    constant, change = pose_parts(jacobian[:, :, :6], [p.frame_index for p in chosen], sigmas**2, poses)
    return PointErrors(
        cone_ids=names,
        truth_m=truth,
        difference_m=xyz - truth,
        cov_m2=cov_matrices([p.cov_m2 for p in chosen]),
        own_cov_m2=block_diag(*own_cov) + change,
        range_m=np.array([p.range_m for p in chosen]),
        sight=_unit(xyz[:, :2] - left[:, :2, 3]),
        common_jacobian=np.concatenate([jacobian, outline], axis=2),
        common_cov=block_diag(constant, calibration_of(drive.rig), np.eye(outline.shape[2])),
    )


def statistics(*drives: PointErrors) -> ErrorStatistics | None:
    """Figures of all errors of a drive, or of several together; None without errors."""
    difference = np.concatenate([errors.difference_m for errors in drives])
    if not len(difference):
        return None
    sight = np.concatenate([errors.in_sight_axes(errors.difference_m) for errors in drives])
    length = np.linalg.norm(difference, axis=1)
    return ErrorStatistics(
        count=len(difference),
        median_3d_m=float(np.median(length)),
        rmse_3d_m=float(np.sqrt(np.mean(length**2))),
        rmse_enu_m=_rms(difference),
        bias_enu_m=vec3(difference.mean(axis=0)),
        rmse_sight_m=_rms(sight),
        bias_sight_m=vec3(sight.mean(axis=0)),
        stated_sigma_sight_m=_rms(np.concatenate([errors.sigma_in_sight_axes() for errors in drives])),
        ce90_m=ce90_m(difference),
        le90_m=le90_m(difference),
    )


def by_range(errors: PointErrors) -> list[RangeBand]:
    """Figures by range, without empty bands."""
    bands = []
    for low, high in zip((0.0, *RANGE_BANDS_M), (*RANGE_BANDS_M, np.inf), strict=True):
        figures = statistics(select(errors, (errors.range_m >= low) & (errors.range_m < high)))
        if figures is not None:
            bands.append(RangeBand(from_m=low, to_m=None if np.isinf(high) else high, errors=figures))
    return bands


def select(errors: PointErrors, keep: Bools) -> PointErrors:
    """The errors of a mask (N,)."""
    return replace(
        errors,
        cone_ids=tuple(name for name, kept in zip(errors.cone_ids, keep.tolist(), strict=True) if kept),
        own_cov_m2=errors.own_cov_m2[np.ix_(*2 * [np.repeat(keep, 3)])],
        **{name: getattr(errors, name)[keep] for name in _PER_ESTIMATE},
    )


def conditional_errors(errors: PointErrors, chosen: Bools) -> PointErrors:
    """The errors of a mask (N,), given the others of the drive (the conditional distribution, e.g. Koch 1999, ch. 2.5.3).

    The error of GNSS/INS is one draw for the whole drive; this way it is not counted again for each class. Errors common to the
    chosen ones alone stay common; what the others leave unknown of the rest becomes part of their own.
    """
    precision, rows = np.linalg.inv(errors.joint_cov_m2()), np.repeat(chosen, 3)
    own, alone = select(errors, chosen), ~errors.common_jacobian[~chosen].any(axis=(0, 1))
    cov = np.linalg.inv(precision[np.ix_(rows, rows)])
    jacobian, common = own.common_jacobian[:, :, alone], errors.common_cov[np.ix_(alone, alone)]
    return replace(
        own,
        difference_m=(cov @ (precision @ errors.difference_m.ravel())[rows]).reshape(-1, 3),
        common_jacobian=jacobian,
        common_cov=common,
        own_cov_m2=cov - _propagate(jacobian, common),
    )


def drive_consistency(*drives: PointErrors) -> Consistency | None:
    """NEES of all errors of a drive, with its relative and common part; None without errors.

    Of several drives together, each with its own common errors. One drive in twenty is outside of a 95 % band by chance, and has
    few common errors: assess a campaign by the sum.
    """
    return pooled(
        consistency(errors.difference_m, errors.own_cov_m2, errors.common_jacobian, errors.common_cov)
        for errors in drives
        if len(errors.difference_m)
    )


def _propagate(jacobian: Floats, cov: Floats) -> Floats:
    """(3N, 3N) covariance of N estimates from common errors: (N, 3, K), (K, K)."""
    flat = jacobian.reshape(3 * len(jacobian), len(cov))
    return np.asarray(flat @ cov @ flat.T)


def _class_jacobian(tracks: Sequence[Track]) -> Floats:
    """(N, 3, 3C) Jacobian of N tracks by the errors common to each of their C classes, in sigmas (`class_error_id`)."""
    stated = {n: track.shared_jacobian for n, track in enumerate(tracks) if track.shared_jacobian is not None}
    ids = tuple(sorted({key for one in stated.values() for key in one.calibrations}))
    classes = [ids.index(key) for key in {class_error_id(track.category) for track in tracks} if key in ids]
    moved = np.zeros((len(tracks), 3, len(classes), 3))
    for n, one in stated.items():
        moved[n] = unpack_jacobians(ids, [one])[0, classes, :, :3].swapaxes(0, 1)
    return moved.reshape(len(tracks), 3, 3 * len(classes))


def _sight_axes(sight: Floats) -> Floats:
    """(N, 3, 3) rows along the line of sight, across it to the left, up."""
    up = np.broadcast_to([0.0, 0.0, 1.0], sight.shape)
    return np.stack([sight, np.cross(up, sight), up], axis=1)


def _unit(level: Floats) -> Floats:
    """(N, 2) level vectors as (N, 3) unit vectors."""
    unit = level / np.linalg.norm(level, axis=1, keepdims=True)
    return np.column_stack([unit, np.zeros(len(unit))])


def _rms(values: Floats) -> Vec3:
    return vec3(np.sqrt(np.mean(values**2, axis=0)))


def pose_and_calibration(xyz_m: Floats, poses: Sequence[Pose], rig: Rig) -> tuple[Floats, Floats]:
    """(N, 3, 6 + K) Jacobian of points (N, 3) by the errors of pose and calibration, (N, 6) sigmas of the poses."""
    by_pose = moved_by_poses(xyz_m, poses)
    left = np.array([map_SE3_left(pose, rig) for pose in poses]).reshape(-1, 4, 4)
    in_camera = np.einsum("nji,nj->ni", left[:, :3, :3], xyz_m - left[:, :3, 3])
    by_calibration = left[:, :3, :3] @ calibration_jacobian(in_camera, rig)
    sigmas = np.array([(*pose.sigma_enu_m, *pose.sigma_rpy_rad) for pose in poses]).reshape(-1, 6)
    return np.concatenate([by_pose, by_calibration], axis=2), sigmas


def pose_parts(
    jacobian: Floats, frames: Sequence[int], variances: Floats, poses: PoseCov | None
) -> tuple[Floats, Floats]:
    """Covariance (6, 6) of the constant error of all poses, and (3N, 3N) of N points by the part that changes between frames.

    jacobian (N, 3, 6): of the points by their poses; frames (N,): their indices; variances (N, 6): stated.
    """
    if not frames or poses is None:
        return np.diag(np.mean(variances, axis=0)) if frames else np.zeros((6, 6)), np.zeros(2 * (3 * len(frames),))
    order, rank = np.unique(frames, return_inverse=True)
    constant, change = constant_and_change(poses(order.tolist()))
    return constant, moved_cov(jacobian, rank, change)


def _outline_parts(
    cone_ids: Sequence[str], positions: Sequence[Position], rig: Rig, turn: Floats, cov_m2: Floats
) -> tuple[Floats, Floats]:
    """(N, 3, 3C) Jacobian of N positions by the outline errors of C cones, in sigmas; (N, 3, 3) the rest of the covariances.

    turn (N, 3, 3): map_R_left of each position. cov_m2 (N, 3, 3): of image points and outline together, in the map.
    """
    order = sorted({name for name, p in zip(cone_ids, positions, strict=True) if p.sigma_outline_m > 0})
    jacobian = np.zeros((len(positions), 3, 3 * len(order)))
    own = cov_m2.copy()
    for n, (name, position) in enumerate(zip(cone_ids, positions, strict=True)):
        if position.sigma_outline_m > 0:
            moved = turn[n] @ outline_errors(position, rig)
            k = 3 * order.index(name)
            jacobian[n, :, k : k + 3] = moved
            own[n] -= moved @ moved.T
    return jacobian, own


def calibration_of(rig: Rig) -> Floats:
    """(K, K) covariance of the calibration, (0, 0) if unknown."""
    known = known_covariance(rig)
    return np.array(known.matrix) if known else np.zeros((0, 0))
