"""Statistics of a drive against truth: errors by range and axis, CE90 and LE90, and whether the stated covariances hold."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from conetl.evaluation.shared_errors import (
    calibration_of,
    outline_parts,
    pose_and_calibration,
    pose_parts,
    track_shares,
)
from conetl.evaluation.truth import TruthCone, TruthLine
from conetl.geometry.consistency import Consistency, Nees, ce90_m, consistency, le90_m, point_nees
from conetl.geometry.packing import cov_matrix, vec3
from conetl.geometry.rig import map_SE3_left
from conetl.model.records import (
    Drive,
    Position,
    Record,
    Track,
    Vec3,
)
from conetl.tracking.association import MotionError
from conetl.tracking.error_propagation import PoseCov

Floats = NDArray[np.float64]
#: Upper ends of the range bands; the last is open.
RANGE_BANDS_M = (5.0, 8.0, 12.0, 16.0, 20.0, 25.0)


@dataclass(frozen=True)
class PointErrors:
    """N estimates of known cones. East, north, up unless said otherwise."""

    cone_ids: tuple[str, ...]
    truth_m: Floats
    """(N, 3) map"""
    difference_m: Floats
    """(N, 3) estimate minus truth"""
    cov_m2: Floats
    """(N, 3, 3) absolute, as stated"""
    own_cov_m2: Floats
    """(N, 3, 3) without what the drive has in common, and without what its poses change by"""
    range_m: Floats
    """(N,) ground distance from the left camera; of tracks the nearest"""
    sight: Floats
    """(N, 3) level unit vector from the left camera to the cone"""
    common_jacobian: Floats
    """(N, 3, K) how the errors that the drive has in common move each estimate"""
    common_cov: Floats
    """(K, K) of those errors"""
    change_cov_m2: Floats | None = None
    """(3N, 3N) what pose errors that change within the drive add to `own_cov_m2`, correlated between estimates; None: nothing"""

    def whole_own_cov_m2(self) -> Floats:
        """(3N, 3N) of all that the drive does not have in common, (N, 3, 3) where that is independent."""
        if self.change_cov_m2 is None:
            return self.own_cov_m2
        return np.asarray(block_diag(*self.own_cov_m2) + self.change_cov_m2)

    def single_own_cov_m2(self) -> Floats:
        """(N, 3, 3) of the same, of each estimate by itself."""
        if self.change_cov_m2 is None:
            return self.own_cov_m2
        count = len(self.own_cov_m2)
        blocks = self.change_cov_m2.reshape(count, 3, count, 3)
        return np.asarray(self.own_cov_m2 + blocks[np.arange(count), :, np.arange(count)])

    def in_sight_axes(self, vectors: Floats) -> Floats:
        """(N, 3) vectors turned to along the sight, across it (to the left) and up."""
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


class NeesReport(Record):
    """One NEES with its 95 % band; `per_dof` is 1 where the stated sigmas are right."""

    value: float
    dof: int
    low: float
    high: float
    per_dof: float
    holds: bool


class ConsistencyReport(Record):
    """NEES of one set of estimates of one drive; None where nothing is left to tell it from."""

    absolute: NeesReport | None
    relative: NeesReport | None
    common: NeesReport | None


def track_errors(
    lines: Sequence[TruthLine[Track]], drive: Drive, positions: Sequence[Position], motion: MotionError | None = None
) -> PointErrors:
    """Errors of the tracks that were found.

    In common they have what the positions of the drive have (`position_errors`), each by its own lever: an error of the
    heading is no mere shift of all cones. The shared_jacobian of a track's sightings are put together as their adjustment puts
    the sightings together, with the information of each (a (3, 3) share: one far ahead tells the side, one abeam the way
    along). positions: single ones of the drive, those of the tracks among them. motion: of a refined trajectory, as tracks were
    fused.
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
    jacobians, variances = [np.zeros((0, 3, 6 + len(calibration_of(drive.rig))))], []
    for place, (_, track) in zip(xyz, found, strict=True):
        poses = [pose_of[frame_index] for frame_index, _ in track.members]
        lever, sigmas = pose_and_calibration(np.tile(place, (len(poses), 1)), poses, drive.rig)
        shares = track_shares([by_member[member] for member in track.members], poses, drive.rig, motion)
        jacobians.append(np.einsum("fij,fjk->ik", shares, lever)[None])
        variances.append(np.mean(sigmas**2, axis=0))
    return PointErrors(
        cone_ids=tuple(line.truth.cone_id for line, _ in found),
        truth_m=truth,
        difference_m=xyz - truth,
        cov_m2=_stack([cov_matrix(track.cov_m2) for _, track in found]),
        own_cov_m2=_stack([cov_matrix(track.relative_cov_m2) for _, track in found]),
        range_m=np.linalg.norm(level, axis=1),
        sight=_unit(level),
        common_jacobian=np.concatenate(jacobians),
        common_cov=block_diag(
            np.diag(np.mean(variances, axis=0)) if found else np.zeros((6, 6)), calibration_of(drive.rig)
        ),
    )


def members_of(lines: Sequence[TruthLine[Track]]) -> dict[tuple[int, int], TruthCone]:
    """The cone of each single position, by (frame_index, match_index), as the tracks that were found have it.

    A position belongs to the cone of its track, however far off it is: a gate on the error would flatter the statistics.
    """
    return {member: line.truth for line in lines if line.feature is not None for member in line.feature.members}


def position_errors(
    cone_of: Mapping[tuple[int, int], TruthCone],
    positions: Sequence[Position],
    drive: Drive,
    poses: PoseCov | None = None,
) -> PointErrors:
    """Errors of the single positions whose cone is known; see `members_of`.

    poses: how the errors of the drive's poses hang together; None: one error of the whole drive.

    In common they have place and attitude of the body as far as their error stays, the rig's calibration and, those of one cone,
    what is taken for its foot, axis and shape; of its own each position has the error of its image points.
    """
    pose_of = {pair.frame_index: pair.pose for pair in drive.frame_pairs}
    chosen = [p for p in positions if (p.frame_index, p.match_index) in cone_of]
    cones = [cone_of[p.frame_index, p.match_index] for p in chosen]
    xyz = np.array([p.xyz_m for p in chosen]).reshape(-1, 3)
    stated = [pose_of[p.frame_index] for p in chosen]
    left = np.array([map_SE3_left(pose, drive.rig) for pose in stated]).reshape(-1, 4, 4)
    turn = left[:, :3, :3]
    camera_cov = _stack([cov_matrix(p.camera_cov_m2) for p in chosen])
    truth = np.array([cone.xyz_m for cone in cones]).reshape(-1, 3)
    jacobian, sigmas = pose_and_calibration(xyz, stated, drive.rig)
    names = tuple(cone.cone_id for cone in cones)
    outline, own_cov = outline_parts(names, chosen, drive.rig, turn, turn @ camera_cov @ np.swapaxes(turn, 1, 2))
    constant, change = pose_parts(jacobian[:, :, :6], [p.frame_index for p in chosen], sigmas**2, poses)
    common = block_diag(constant, calibration_of(drive.rig))
    return PointErrors(
        cone_ids=names,
        truth_m=truth,
        difference_m=xyz - truth,
        cov_m2=_stack([cov_matrix(p.cov_m2) for p in chosen]),
        own_cov_m2=own_cov,
        range_m=np.array([p.range_m for p in chosen]),
        sight=_unit(xyz[:, :2] - left[:, :2, 3]),
        common_jacobian=np.concatenate([jacobian, outline], axis=2),
        common_cov=block_diag(common, np.eye(outline.shape[2])),
        change_cov_m2=change,
    )


def statistics(errors: PointErrors) -> ErrorStatistics | None:
    """Figures of all errors, None where there are none."""
    if not len(errors.difference_m):
        return None
    difference = errors.difference_m
    sight = errors.in_sight_axes(difference)
    length = np.linalg.norm(difference, axis=1)
    return ErrorStatistics(
        count=len(difference),
        median_3d_m=float(np.median(length)),
        rmse_3d_m=float(np.sqrt(np.mean(length**2))),
        rmse_enu_m=_rms(difference),
        bias_enu_m=vec3(difference.mean(axis=0)),
        rmse_sight_m=_rms(sight),
        bias_sight_m=vec3(sight.mean(axis=0)),
        stated_sigma_sight_m=_rms(errors.sigma_in_sight_axes()),
        ce90_m=ce90_m(difference),
        le90_m=le90_m(difference),
    )


def by_range(errors: PointErrors) -> list[RangeBand]:
    """Figures by range; bands without an estimate are left out."""
    bands = []
    for low, high in zip((0.0, *RANGE_BANDS_M), (*RANGE_BANDS_M, np.inf), strict=True):
        figures = statistics(select(errors, (errors.range_m >= low) & (errors.range_m < high)))
        if figures is not None:
            bands.append(RangeBand(from_m=low, to_m=None if np.isinf(high) else high, errors=figures))
    return bands


def select(errors: PointErrors, keep: NDArray[np.bool_]) -> PointErrors:
    """The errors of a mask (N,)."""
    return PointErrors(
        cone_ids=tuple(name for name, kept in zip(errors.cone_ids, keep.tolist(), strict=True) if kept),
        truth_m=errors.truth_m[keep],
        difference_m=errors.difference_m[keep],
        cov_m2=errors.cov_m2[keep],
        own_cov_m2=errors.own_cov_m2[keep],
        range_m=errors.range_m[keep],
        sight=errors.sight[keep],
        common_jacobian=errors.common_jacobian[keep],
        common_cov=errors.common_cov,
        change_cov_m2=None if errors.change_cov_m2 is None else errors.change_cov_m2[np.ix_(*2 * [np.repeat(keep, 3)])],
    )


def drive_consistency(errors: PointErrors) -> Consistency | None:
    """NEES of all errors of one drive, split into relative and common part; None without errors."""
    if not len(errors.difference_m):
        return None
    return consistency(errors.difference_m, errors.whole_own_cov_m2(), errors.common_jacobian, errors.common_cov)


def pooled_consistency(drives: Sequence[PointErrors]) -> Consistency | None:
    """NEES of several drives together, each with common errors of its own; None without errors.

    One drive in twenty leaves a 95 % band though its sigmas are right, and its few common errors say little: judge a campaign by
    its sum.
    """
    total: Consistency | None = None
    for errors in drives:
        one = drive_consistency(errors)
        if one is not None:
            total = one if total is None else total + one
    return total


def pooled_statistics(drives: Sequence[PointErrors]) -> ErrorStatistics | None:
    """Figures of the errors of several drives together, None where there are none."""
    everything = [errors for errors in drives if len(errors.difference_m)]
    if not everything:
        return None
    count = sum(len(errors.difference_m) for errors in everything)
    return statistics(
        PointErrors(
            cone_ids=tuple(name for errors in everything for name in errors.cone_ids),
            truth_m=np.concatenate([errors.truth_m for errors in everything]),
            difference_m=np.concatenate([errors.difference_m for errors in everything]),
            cov_m2=np.concatenate([errors.cov_m2 for errors in everything]),
            own_cov_m2=np.concatenate([errors.own_cov_m2 for errors in everything]),
            range_m=np.concatenate([errors.range_m for errors in everything]),
            sight=np.concatenate([errors.sight for errors in everything]),
            common_jacobian=np.zeros((count, 3, 0)),
            common_cov=np.zeros((0, 0)),
        )
    )


def consistency_report(result: Consistency | None) -> ConsistencyReport:
    """A consistency with its bands, for printing and JSON."""
    if result is None:
        return ConsistencyReport(absolute=None, relative=None, common=None)
    return ConsistencyReport(
        absolute=_nees_report(result.absolute),
        relative=_nees_report(result.relative),
        common=_nees_report(result.common),
    )


def single_nees(errors: PointErrors) -> Floats:
    """(N,) NEES of each estimate by itself under its own covariance, the common errors taken out: chi-square with 3, nearly.

    The common errors are estimated from all N and subtracted; with many estimates this takes little from each.
    """
    count = len(errors.difference_m)
    if not count:
        return np.zeros(0)
    own_cov_m2 = errors.single_own_cov_m2()
    weight = np.linalg.inv(own_cov_m2)
    values, vectors = np.linalg.eigh(errors.common_cov)
    scaled = errors.common_jacobian @ (vectors * np.sqrt(np.maximum(values, 0.0)))
    # Prior and observations together, so that what the points cannot tell stays at nothing.
    normal = np.einsum("nik,nij,njl->kl", scaled, weight, scaled) + np.eye(len(values))
    side = np.einsum("nik,nij,nj->k", scaled, weight, errors.difference_m)
    return point_nees(errors.difference_m - scaled @ np.linalg.solve(normal, side), own_cov_m2)


def _nees_report(nees: Nees) -> NeesReport | None:
    if nees.dof == 0:
        return None
    low, high = nees.band()
    return NeesReport(
        value=nees.value, dof=nees.dof, low=low, high=high, per_dof=nees.per_dof, holds=low <= nees.value <= high
    )


def _sight_axes(sight: Floats) -> Floats:
    """(N, 3, 3) rows along the sight, across it to the left, up."""
    up = np.broadcast_to([0.0, 0.0, 1.0], sight.shape)
    return np.stack([sight, np.cross(up, sight), up], axis=1)


def _unit(level: Floats) -> Floats:
    """(N, 2) level vectors as (N, 3) unit vectors."""
    unit = level / np.linalg.norm(level, axis=1, keepdims=True)
    return np.column_stack([unit, np.zeros(len(unit))])


def _stack(matrices: Sequence[Floats]) -> Floats:
    return np.array(matrices).reshape(-1, 3, 3)


def _rms(values: Floats) -> Vec3:
    return vec3(np.sqrt(np.mean(values**2, axis=0)))
