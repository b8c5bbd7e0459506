"""Variance factors of the observations of one drive, estimated from the residuals of its adjusted tracks (variance components).

The stated variances come from single frame pairs: the disagreement of both images about the foot, and the residuals of
matching. Errors common to both images appear only in the tracks. So the residuals of all tracks are split into rows, columns
and disparities, and the variance of each group gets a factor (Förstner 1979; Koch 1999, ch. 3.6). This is restricted maximum
likelihood: each cone's position costs degrees of freedom, and errors that all observations of a cone share
(`StereoMatch.sigma_outline_px`) are unknowns with a prior of one sigma.

Pose errors are unknowns of each frame, with their joint covariance from the adjustment of the trajectory as prior: they drift,
whereas image errors are independent from frame to frame.

The same adjustment shows single observations that contradict all others of their track: the box of a part of an object, or of
two objects (`with_contradictions`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from conetl.geometry.intersection import pair_jacobian
from conetl.geometry.linear_reference import evenly_spaced
from conetl.geometry.rig import map_SE3_camera
from conetl.model.arrays import Floats
from conetl.model.drive import Drive, Pose, StereoMatch, Track
from conetl.model.feature_classes import FEATURE_CLASSES
from conetl.model.rig import SIDES, Rig
from conetl.tracking.error_propagation import PoseCov, moved_by_poses, moved_cov
from conetl.tracking.matching.covariance import SHARED_DISPARITY_PX, matching_sigma_px, shared_disparity_px

#: Weight of the stated variances in degrees of freedom, from their differences between drives: on rendered drives the
#: logarithms of the factors scatter by 0.35 (standard deviation), those of chi-square with n degrees of freedom by sqrt(2 / n).
_STATED_DOF = 16.0
#: Limits of the factors on sigma; beyond them poses or calibration disagree, not the images.
_SIGMA_BOUNDS = (0.5, 2.0)
#: Larger residuals count as this many sigmas (Huber 1964); of normal errors that removes 0.5 % of the squares.
_HUBER_SIGMAS, _ROBUST_ROUNDS = 3.0, 4
_MAX_ITERATIONS, _CONVERGED = 50, 1e-3
#: A residual of more of its own sigmas is a gross error: with 3.3 (Baarda 1968) those of good boxes count too, and the sigmas of
#: single positions get too large (benchmarks/RESULTS.md). With a smaller share of redundancy it proves nothing,
#: and of two observations either may be wrong.
_LARGEST_RATIO, _LEAST_REDUNDANCY, _LEAST_COMPARED = 5.0, 0.05, 3
#: Frame pairs of one track that are used: the time grows with their third power, and a vehicle may wait beside a cone.
_MOST_PAIRS = 120
#: Pose errors below this share of the observations' variance need no unknown.
_LEAST_POSE_SHARE = 1e-3
#: Means of columns and of rows, and disparity, from u_left, v_left, u_right, v_right.
_GROUPS = np.array([[0.5, 0.0, 0.5, 0.0], [0.0, 0.5, 0.0, 0.5], [1.0, 0.0, -1.0, 0.0]])


class VarianceFactors(NamedTuple):
    """Factors on the stated variances of observations; 1 leaves them."""

    columns: float
    """Of the cone's axis, common to both images."""
    rows: float
    """Of its foot."""
    disparity: float
    """Of the matching."""


class ObservedCone(NamedTuple):
    """The F observations of one track, linearised at its position; axes of length 3 are in the order of the factors."""

    residual_px: Floats
    """(F, 3)"""
    design: Floats
    """(F, 3, 6 + R): derivatives by the cone's position (m), and by its shared errors and the pose errors (sigmas)"""
    stated_px2: Floats
    """(F, 3) variances to which the factors apply"""
    fixed_px2: Floats
    """(F, 3) variances added to them: the matching's part of the columns"""


def estimate_variance_factors(
    drive: Drive, matches: Sequence[StereoMatch], tracks: Sequence[Track], pose_cov: PoseCov
) -> dict[str, VarianceFactors]:
    """Factors for the observations of one drive, from all its tracks, by their classes.

    Detectors show the edges of some classes better than those of others, and the shape assumed in matching fits some better: each
    class has its own factors. drive: with refined poses; pose_cov: of their errors. Only matches refined in the images, whose
    shared errors are known, count; with few of them the factors stay near 1.
    """
    classes = sorted({track.category for track in tracks})
    seen = observed_cones(drive, matches, tracks, pose_cov, 2)
    cones = [(classes.index(track.category), cone) for track, _, cone in seen]
    factors = np.ones((len(classes), 3))
    for _ in range(_MAX_ITERATIONS):
        squares, freedom = np.zeros_like(factors), np.zeros_like(factors)
        for number, cone in cones:
            of_cone = _squares_and_freedom(cone, factors[number])
            squares[number] += of_cone[0]
            freedom[number] += of_cone[1]
        # The stated variances count as this many residuals of the stated size.
        step = (squares + _STATED_DOF / factors) / (freedom + _STATED_DOF)
        factors = factors * step
        if np.abs(step - 1).max(initial=0.0) < _CONVERGED:
            break
    factors = np.clip(factors, _SIGMA_BOUNDS[0] ** 2, _SIGMA_BOUNDS[1] ** 2)
    return {category: VarianceFactors(*own) for category, own in zip(classes, factors.tolist(), strict=True)}


def observed_cones(
    drive: Drive, matches: Sequence[StereoMatch], tracks: Sequence[Track], pose_cov: PoseCov, least: int
) -> Iterator[tuple[Track, list[StereoMatch], ObservedCone]]:
    """The tracks with at least so many matches whose shared errors are known, with these matches, not too many."""
    match_of = {(m.frame_index, m.match_index): m for m in matches}
    poses = {pair.frame_index: pair.pose for pair in drive.frame_pairs}
    for track in tracks:
        usable = [match_of[member] for member in track.members if _is_usable(match_of[member])]
        if len(usable) >= least:
            pairs = evenly_spaced(usable, _MOST_PAIRS)
            yield track, pairs, _observed_cone(track, pairs, drive.rig, poses, pose_cov)


def with_variance_factors(
    matches: Sequence[StereoMatch], variances: Mapping[str, VarianceFactors]
) -> list[StereoMatch]:
    """The matches of a drive with the factors of their classes applied, where `estimate_variance_factors` used them."""
    return [_weighed(m, variances[m.category]) if m.category in variances and _is_usable(m) else m for m in matches]


def _weighed(match: StereoMatch, variances: VarianceFactors) -> StereoMatch:
    own_px2 = variances.disparity * matching_sigma_px(_disparity_px(match)) ** 2
    return match.model_copy(
        update={
            "sigma_pointing_px": match.sigma_pointing_px * variances.columns**0.5,
            "sigma_v_px": match.sigma_v_px * variances.rows**0.5,
            "sigma_u_px": ((own_px2 + SHARED_DISPARITY_PX**2) / 2) ** 0.5,
        }
    )


def with_contradictions(
    drive: Drive, matches: Sequence[StereoMatch], tracks: Sequence[Track], pose_cov: PoseCov
) -> list[StereoMatch]:
    """The matches of one drive, with larger sigmas where they contradict their tracks; never with smaller ones.

    matches: with the factors applied. tracks: of these matches; all their members are compared, also those that
    `estimate_variance_factors` does not use. The other arguments are as there.
    """
    match_of = {(m.frame_index, m.match_index): m for m in matches}
    poses = {pair.frame_index: pair.pose for pair in drive.frame_pairs}
    for track in tracks:
        members = [match_of[member] for member in track.members]
        parts = -(-len(members) // _MOST_PAIRS)
        for pairs in (members[part::parts] for part in range(parts)):
            if len(pairs) < _LEAST_COMPARED:
                continue
            doubts = _doubts_px2(_observed_cone(track, pairs, drive.rig, poses, pose_cov))
            for match, own_px2 in zip(pairs, doubts.tolist(), strict=True):
                if any(own_px2):
                    match_of[match.frame_index, match.match_index] = _doubted(match, *own_px2)
    return [match_of[m.frame_index, m.match_index] for m in matches]


def _doubts_px2(cone: ObservedCone) -> Floats:
    """(F, 3) variances that the observations of a track lack, 0 for those that fit.

    Data snooping (Baarda 1968; iterated as in Kok 1984): the worst observation is compared with what all others predict, and that
    difference becomes its sigma, until none is a gross error.
    """
    stated = cone.stated_px2 + cone.fixed_px2
    own = stated.copy()
    for _ in range(own.size):
        weighted, normal, score = _normal_equations(cone, 1 / own)
        inverse = np.asarray(np.linalg.inv(normal))
        unknown = inverse @ score
        redundancy = _redundancy(cone, inverse, weighted)
        known = np.maximum(redundancy, _LEAST_REDUNDANCY)
        residual = np.where(redundancy < _LEAST_REDUNDANCY, 0.0, cone.residual_px - cone.design @ unknown)
        ratio = np.abs(residual) / (own * known) ** 0.5
        worst = np.unravel_index(int(ratio.argmax()), ratio.shape)
        if ratio[worst] <= _LARGEST_RATIO:
            break
        own[worst] = (residual[worst] / known[worst]) ** 2
    return np.asarray(own - stated)


def _doubted(match: StereoMatch, columns_px2: float, rows_px2: float, disparity_px2: float) -> StereoMatch:
    """The match with these variances added to the means of its columns and rows, and to its disparity."""
    return match.model_copy(
        update={
            "sigma_pointing_px": (match.sigma_pointing_px**2 + columns_px2) ** 0.5,
            "sigma_v_px": (match.sigma_v_px**2 + 2 * rows_px2) ** 0.5,
            "sigma_u_px": (match.sigma_u_px**2 + disparity_px2 / 2) ** 0.5,
        }
    )


def _is_usable(match: StereoMatch) -> bool:
    return match.refined and match.sigma_outline_px > 0


def _disparity_px(match: StereoMatch) -> float:
    """Sigma of a disparity."""
    return 2**0.5 * match.sigma_u_px


def _observed_cone(
    track: Track, pairs: Sequence[StereoMatch], rig: Rig, poses: Mapping[int, Pose], pose_cov: PoseCov
) -> ObservedCone:
    """pairs: matches of the track. poses: by frame index; pose_cov: of their errors."""
    xyz_m = np.array(track.xyz_m)
    stated_poses = [poses[m.frame_index] for m in pairs]
    left, right = (np.stack([map_SE3_camera(p, rig, side) for p in stated_poses]) for side in SIDES)
    # Coordinates around the cone: millimetre corrections on millions of metres would lose digits.
    left[:, :3, 3] -= xyz_m
    right[:, :3, 3] -= xyz_m
    computed, jacobian = pair_jacobian(np.zeros(3), left, right, rig)
    observed = np.array([(*m.foot_left_uv_px, *m.foot_right_uv_px) for m in pairs])
    disparity = np.array([_disparity_px(m) for m in pairs])
    in_common = np.array([shared_disparity_px(_disparity_px(m)) for m in pairs])
    down_px = np.array([m.sigma_outline_px for m in pairs])
    aside = np.array([FEATURE_CLASSES[m.category].outline_aside for m in pairs])
    shared = np.stack([aside * down_px, down_px, in_common], axis=1)
    # What all observations of an object have in common causes no scatter.
    own = np.maximum(disparity**2 - in_common**2, 1e-6)
    stated = np.array([(m.sigma_pointing_px**2, m.sigma_v_px**2 / 2, px2) for m, px2 in zip(pairs, own, strict=True)])
    fixed = np.zeros((len(pairs), 3))
    fixed[:, 0] = [m.sigma_u_px**2 / 2 for m in pairs]
    by_position = _GROUPS @ jacobian
    by_pose = by_position @ moved_by_poses(np.tile(xyz_m, (len(pairs), 1)), stated_poses)
    by_errors = _by_pose_sigmas(by_pose, pose_cov([m.frame_index for m in pairs]), (stated + fixed) ** 0.5)
    design = np.concatenate([by_position, shared[:, :, None] * np.eye(3), by_errors], axis=2)
    return ObservedCone((observed - computed) @ _GROUPS.T, design, stated, fixed)


def _by_pose_sigmas(by_pose: Floats, cov: Floats, stated_px: Floats) -> Floats:
    """(F, 3, R) px: derivatives of F observations by R independent errors of one sigma that make up those of their poses.

    by_pose (F, 3, 6), by the pose of each; cov (6F, 6F) of these; stated_px (F, 3): errors far below it are left out.
    """
    count = len(by_pose)
    together = moved_cov(by_pose / stated_px[:, :, None], np.arange(count), cov)
    values, vectors = np.linalg.eigh(together)
    relevant = values > _LEAST_POSE_SHARE
    return np.asarray((vectors[:, relevant] * values[relevant] ** 0.5).reshape(count, 3, -1) * stated_px[:, :, None])


def _squares_and_freedom(cone: ObservedCone, factors: Floats) -> tuple[Floats, Floats]:
    """(3,) each: per group the squares of a cone's residuals over their variances, and their degrees of freedom.

    With the right factors both are equal (score of restricted maximum likelihood).
    """
    own = factors * cone.stated_px2 + cone.fixed_px2
    _, inverse, weighted, ratio = adjusted(cone, own)
    freedom = _redundancy(cone, inverse, weighted)
    share = factors * cone.stated_px2 / own
    return (share * np.minimum(ratio, _HUBER_SIGMAS) ** 2).sum(axis=0), (share * freedom).sum(axis=0)


def adjusted(cone: ObservedCone, own_px2: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Robust adjustment of a track by its observations of variances (F, 3) px^2.

    Unknowns (K,), their covariance (K, K), the weighted design (F, 3, K), and residuals (F, 3) in sigmas, without their signs.
    """
    huber = np.ones_like(own_px2)
    for _ in range(_ROBUST_ROUNDS):
        weighted, normal, score = _normal_equations(cone, huber / own_px2)
        unknown = np.asarray(np.linalg.solve(normal, score))
        ratio = np.abs(cone.residual_px - cone.design @ unknown) / own_px2**0.5
        huber = np.minimum(1.0, _HUBER_SIGMAS / np.maximum(ratio, 1e-9))
    return unknown, np.asarray(np.linalg.inv(normal)), weighted, np.asarray(ratio)


def _normal_equations(cone: ObservedCone, weights: Floats) -> tuple[Floats, Floats, Floats]:
    """The weighted design (F, 3, K), normal matrix (K, K) and right-hand side (K,), by weights (F, 3) of the observations."""
    weighted = cone.design * weights[:, :, None]
    normal = np.tensordot(cone.design, weighted, axes=((0, 1), (0, 1)))
    prior = np.arange(3, len(normal))
    normal[prior, prior] += 1.0  # shared and pose errors have a prior of one sigma
    return weighted, normal, np.einsum("fik,fi->k", weighted, cone.residual_px)


def _redundancy(cone: ObservedCone, inverse: Floats, weighted: Floats) -> Floats:
    """(F, 3): share of the error of each observation that its residual shows, the others being right."""
    return np.asarray(1 - np.einsum("fik,kl,fil->fi", weighted, inverse, cone.design, optimize=True))
