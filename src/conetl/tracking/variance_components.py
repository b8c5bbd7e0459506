"""How exact single sightings of one drive are, by what its adjusted tracks say of them: variance components.

What a sighting states beforehand comes from single frame pairs: how much the two images disagree over the foot, and what the
matching's residuals leave open. Errors that both images have alike show in neither; they show in the cones themselves,
which stand still while the camera moves. So the residuals of all tracks are split into rows, columns and disparities, and each
group of observations gets the factor on its variance under which its squared residuals are as large as they should be
(Förstner 1979; Koch 1999, ch. 3.6). That is restricted maximum likelihood: each cone's place costs its degrees of freedom, and
what all sightings of a cone share (`StereoMatch.sigma_outline_px`) is an unknown of its own, known beforehand to one sigma.

What the poses err by while a cone is in view is no scatter of the images: each frame's pose errors are unknowns of their own,
known beforehand by their joint covariance from the adjustment of the trajectory. As independent noise of every frame they would
take the scatter of the images upon themselves; as they are, they slide, and sightings jump.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from conetl.geometry.joint_fit import pair_jacobian
from conetl.geometry.rig import map_SE3_left, map_SE3_right
from conetl.model.records import Pose, Rig, StereoMatch, Track
from conetl.tracking.matching.covariance import SHARED_DISPARITY_PX
from conetl.tracking.pose_errors import PoseCov, moved_by_poses, moved_cov

Floats = NDArray[np.float64]

#: Weight of what the sightings state, in degrees of freedom: as far as factors differ from drive to drive. On rendered drives
#: their logarithms scatter by 0.35 (standard deviation), and those of chi-square with n degrees of freedom by sqrt(2 / n).
_STATED_DOF = 16.0
#: Factors on sigma are held within these: beyond, not the images but poses or calibration would be what disagrees.
_SIGMA_BOUNDS = (0.5, 2.0)
#: Residuals beyond so many sigmas count as that many, and pull the cone's place no more than that (Huber 1964). Of normal errors
#: it takes 0.5 % of the squares.
_HUBER_SIGMAS, _ROBUST_ROUNDS = 3.0, 4
_MAX_ITERATIONS, _CONVERGED = 50, 1e-3
#: Errors of poses that move sightings by less than this share of their variance need no unknown.
_LEAST_POSE_SHARE = 1e-3
#: Means of columns and of rows, and disparity, from u_left, v_left, u_right, v_right.
_GROUPS = np.array([[0.5, 0.0, 0.5, 0.0], [0.0, 0.5, 0.0, 0.5], [1.0, 0.0, -1.0, 0.0]])


class SightingVariances(NamedTuple):
    """Factors on the variances that sightings state; 1 leaves them."""

    columns: float
    """Of where the detector puts a cone's axis, in both images alike."""
    rows: float
    """Of where it puts its foot."""
    disparity: float
    """Of what the matching of the images finds."""


class _Cone(NamedTuple):
    """The F sightings of one track, linearised at its place; the axis of length 3 in the order of `SightingVariances`."""

    residual_px: Floats
    """(F, 3)"""
    design: Floats
    """(F, 3, 6 + R): by the cone's place (m), by what its sightings share and by what the poses err by (sigmas)"""
    stated_px2: Floats
    """(F, 3) variances, which the factors are on"""
    fixed_px2: Floats
    """(F, 3) and what is added to them: the matching's part of the columns"""


def sighting_variances(
    tracks: Sequence[Track],
    matches: Sequence[StereoMatch],
    rig: Rig,
    poses: Mapping[int, Pose],
    pose_cov: PoseCov | None = None,
) -> SightingVariances:
    """Factors for the sightings of one drive, from all its tracks.

    poses: by frame index, of a refined trajectory; pose_cov: of their errors, None where they have none. Only matches refined in
    the images, of boxes with feet, take part; where few are left, the factors stay near 1.
    """
    match_of = {(m.frame_index, m.match_index): m for m in matches}
    cones = []
    for track in tracks:
        pairs = [match_of[member] for member in track.members if _tells_all(match_of[member])]
        if len(pairs) > 1:
            cones.append(_cone(np.array(track.xyz_m), pairs, rig, poses, pose_cov))
    factors = np.ones(3)
    for _ in range(_MAX_ITERATIONS):
        # What is stated counts as so many residuals, each just as large as it says.
        squares, freedom = _STATED_DOF / factors, np.full(3, _STATED_DOF)
        for cone in cones:
            of_cone = _squares_and_freedom(cone, factors)
            squares, freedom = squares + of_cone[0], freedom + of_cone[1]
        step = squares / freedom
        factors = factors * step
        if np.abs(step - 1).max() < _CONVERGED:
            break
    return SightingVariances(*np.clip(factors, _SIGMA_BOUNDS[0] ** 2, _SIGMA_BOUNDS[1] ** 2).tolist())


def with_variances(matches: Sequence[StereoMatch], variances: SightingVariances) -> list[StereoMatch]:
    """The matches of a drive with these factors on what they state; only those of which `sighting_variances` tells."""
    return [
        match.model_copy(
            update={
                "sigma_pointing_px": match.sigma_pointing_px * variances.columns**0.5,
                "sigma_v_px": match.sigma_v_px * variances.rows**0.5,
                "sigma_u_px": ((variances.disparity * _disparity_px2(match) + SHARED_DISPARITY_PX**2) / 2) ** 0.5,
            }
        )
        if _tells_all(match)
        else match
        for match in matches
    ]


def _tells_all(match: StereoMatch) -> bool:
    return match.refined and match.left.foot_px is not None and match.right.foot_px is not None


def _disparity_px2(match: StereoMatch) -> float:
    """Variance of a disparity but for what all sightings of the cone have in common, which no scatter shows."""
    return max(2 * match.sigma_u_px**2 - SHARED_DISPARITY_PX**2, 1e-6)


def _cone(
    place_m: Floats, pairs: Sequence[StereoMatch], rig: Rig, poses: Mapping[int, Pose], pose_cov: PoseCov | None
) -> _Cone:
    stated_poses = [poses[m.frame_index] for m in pairs]
    left, right = (np.stack([pose_of(p, rig) for p in stated_poses]) for pose_of in (map_SE3_left, map_SE3_right))
    # Millimetre corrections on coordinates of millions of metres: work around the cone.
    left[:, :3, 3] -= place_m
    right[:, :3, 3] -= place_m
    focal_px = np.array([rig.left.fx_px, rig.left.fy_px, rig.right.fx_px, rig.right.fy_px])
    principal_px = np.array([rig.left.cx_px, rig.left.cy_px, rig.right.cx_px, rig.right.cy_px])
    computed, jacobian = pair_jacobian(np.zeros(3), left, right, focal_px, principal_px)
    observed = np.array([(*m.foot_left_uv_px, *m.foot_right_uv_px) for m in pairs])
    shared = np.array([(m.sigma_outline_px, m.sigma_outline_px, SHARED_DISPARITY_PX) for m in pairs])
    stated = np.array([(m.sigma_pointing_px**2, m.sigma_v_px**2 / 2, _disparity_px2(m)) for m in pairs])
    fixed = np.zeros((len(pairs), 3))
    fixed[:, 0] = [m.sigma_u_px**2 / 2 for m in pairs]
    by_place = _GROUPS @ jacobian
    design = [by_place, shared[:, :, None] * np.eye(3)]
    if pose_cov is not None:
        by_pose = by_place @ moved_by_poses(np.tile(place_m, (len(pairs), 1)), stated_poses)
        design.append(_by_pose_sigmas(by_pose, pose_cov([m.frame_index for m in pairs]), (stated + fixed) ** 0.5))
    return _Cone((observed - computed) @ _GROUPS.T, np.concatenate(design, axis=2), stated, fixed)


def _by_pose_sigmas(by_pose: Floats, cov: Floats, stated_px: Floats) -> Floats:
    """(F, 3, R) px: how F sightings move with R independent errors of one sigma, which make up those of their poses.

    by_pose (F, 3, 6), by the pose of each; cov (6F, 6F) of these; stated_px (F, 3): what is far below it is left out.
    """
    count = len(by_pose)
    together = moved_cov(by_pose / stated_px[:, :, None], np.arange(count), cov)
    values, vectors = np.linalg.eigh(together)
    told = values > _LEAST_POSE_SHARE
    return np.asarray((vectors[:, told] * values[told] ** 0.5).reshape(count, 3, -1) * stated_px[:, :, None])


def _squares_and_freedom(cone: _Cone, factors: Floats) -> tuple[Floats, Floats]:
    """(3,) each: per group the squares of a cone's residuals over their variances, and how many those count as.

    By the score of restricted maximum likelihood they are equal where the factors are right.
    """
    own = factors * cone.stated_px2 + cone.fixed_px2
    huber = np.ones_like(own)
    known = np.arange(3, cone.design.shape[2])
    for _ in range(_ROBUST_ROUNDS):
        weighted = cone.design * (huber / own)[:, :, None]
        normal = np.tensordot(cone.design, weighted, axes=((0, 1), (0, 1)))
        normal[known, known] += 1.0  # what sightings share and poses err by is known beforehand to one sigma
        inverse = np.linalg.inv(normal)
        unknown = inverse @ np.einsum("fik,fi->k", weighted, cone.residual_px)
        ratio = np.abs(cone.residual_px - cone.design @ unknown) / own**0.5
        huber = np.minimum(1.0, _HUBER_SIGMAS / np.maximum(ratio, 1e-9))
    freedom = 1 - np.einsum("fik,kl,fil->fi", weighted, inverse, cone.design, optimize=True)
    share = factors * cone.stated_px2 / own
    return (share * np.minimum(ratio, _HUBER_SIGMAS) ** 2).sum(axis=0), (share * freedom).sum(axis=0)
