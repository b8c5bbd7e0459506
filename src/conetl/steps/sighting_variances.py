"""How exact single sightings of one drive are, by what its adjusted tracks say of them: variance components.

What a sighting states beforehand comes from single frame pairs: how much the two pictures disagree over the foot, and what the
matching's residuals leave open. Errors that both pictures have alike show in neither; they show in the cones themselves,
which stand still while the camera moves. So the residuals of the joint adjustments of all tracks are split into rows, columns
and disparities, and each group of observations gets the factor on its variance under which its squared residuals are as large
as they should be (Förstner 1979; Koch 1999, ch. 3.6). That is restricted maximum likelihood: each cone's place costs its degrees
of freedom. The motion between frames keeps the variance that the adjustment gives it, and so does what sightings of a cone share.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from conetl.geometry.joint_fit import pair_jacobian
from conetl.params import IngestParams
from conetl.records import FramePair, Position, Rig, StereoMatch, Track
from conetl.steps.association import MotionError
from conetl.steps.matching_cov import SHARED_DISPARITY_PX
from conetl.steps.tracks import motion_sigmas

Floats = NDArray[np.float64]

#: Weight of what the sightings state, in degrees of freedom: as far as factors differ from drive to drive. On six rendered drives
#: their logarithms scatter by 0.35 (standard deviation), and those of chi-square with n degrees of freedom by sqrt(2 / n).
_STATED_DOF = 16.0
#: Factors on sigma are held within these: beyond, not the pictures but poses or calibration would be what disagrees.
_SIGMA_BOUNDS = (0.5, 2.0)
#: Residuals beyond so many sigmas count as that many, as in the joint adjustment.
_HUBER_SIGMAS = 2.5
_MAX_ITERATIONS, _CONVERGED = 50, 1e-3
#: Means of columns and of rows, and disparity, from u_left, v_left, u_right, v_right.
_GROUPS = np.array([[0.5, 0.0, 0.5, 0.0], [0.0, 0.5, 0.0, 0.5], [1.0, 0.0, -1.0, 0.0]])


class SightingVariances(NamedTuple):
    """Factors on the variances that sightings state; 1 leaves them."""

    columns: float
    """Of where the detector puts a cone's axis, in both pictures alike."""
    rows: float
    """Of where it puts its foot."""
    disparity: float
    """Of what the matching of the pictures finds."""


class _Cone(NamedTuple):
    """The F sightings of one track, linearised at its place; last axes in the order of `SightingVariances`."""

    residual_px: Floats
    """(F, 3)"""
    design: Floats
    """(F, 3, 6): by the cone's place (m), and by what its sightings share (sigmas)"""
    stated_px2: Floats
    """(F, 3) what the factors are on"""
    fixed_px2: Floats
    """(F, 3, 3) what they are not on: motion, and the matching's part of the columns"""


def sighting_variances(
    tracks: Sequence[Track],
    positions: Sequence[Position],
    matches: Sequence[StereoMatch],
    frame_pairs: Mapping[int, FramePair],
    rig: Rig,
    map_SE3_left: Mapping[int, Floats],
    map_SE3_right: Mapping[int, Floats],
    params: IngestParams,
    motion: MotionError | None = None,
) -> SightingVariances:
    """Factors for the sightings of one drive, from all its tracks; the other arguments as of `fuse_tracks`.

    Only matches refined in the pictures, of boxes with feet, take part; where too few are left, the factors stay near 1.
    """
    place = {(p.frame_index, p.match_index): p for p in positions}
    match_of = {(m.frame_index, m.match_index): m for m in matches}
    cones = []
    for track in tracks:
        pairs = [match_of[member] for member in track.members if _has_all(match_of[member])]
        if len(pairs) > 1:
            group = tuple(place[m.frame_index, m.match_index] for m in pairs)
            cones.append(_cone(track, pairs, group, frame_pairs, rig, map_SE3_left, map_SE3_right, params, motion))
    factors = np.ones(3)
    for _ in range(_MAX_ITERATIONS):
        # The prior is that of so many residuals, each as large as stated: 1 / factor in units of what is believed now.
        squares, freedom = _STATED_DOF / factors**2, _STATED_DOF / factors
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
                "sigma_u_px": float(
                    np.sqrt((variances.disparity * _disparity_px2(match) + SHARED_DISPARITY_PX**2) / 2)
                ),
            }
        )
        if _has_all(match)
        else match
        for match in matches
    ]


def _has_all(match: StereoMatch) -> bool:
    return match.refined and match.left.foot_px is not None and match.right.foot_px is not None


def _disparity_px2(match: StereoMatch) -> float:
    """Variance of a disparity but for what all sightings of the cone have in common, which no scatter shows."""
    return max(2 * match.sigma_u_px**2 - SHARED_DISPARITY_PX**2, 1e-6)


def _cone(
    track: Track,
    pairs: Sequence[StereoMatch],
    group: tuple[Position, ...],
    frame_pairs: Mapping[int, FramePair],
    rig: Rig,
    map_SE3_left: Mapping[int, Floats],
    map_SE3_right: Mapping[int, Floats],
    params: IngestParams,
    motion: MotionError | None,
) -> _Cone:
    left, right = (np.stack([poses[m.frame_index] for m in pairs]) for poses in (map_SE3_left, map_SE3_right))
    # Millimetre corrections on coordinates of millions of metres: work around the track.
    point = np.array(track.xyz_m)
    left[:, :3, 3] -= point
    right[:, :3, 3] -= point
    computed, jacobian = pair_jacobian(
        np.zeros(3), left, right,
        np.array([rig.left.fx_px, rig.left.fy_px, rig.right.fx_px, rig.right.fy_px]),
        np.array([rig.left.cx_px, rig.left.cy_px, rig.right.cx_px, rig.right.cy_px]),
    )  # fmt: skip
    observed = np.array([(*m.foot_left_uv_px, *m.foot_right_uv_px) for m in pairs])
    by_place = _GROUPS @ jacobian
    shared = np.array([(m.sigma_outline_px, m.sigma_outline_px, SHARED_DISPARITY_PX) for m in pairs])
    nearest = min(group, key=lambda p: p.range_m)
    left[:, :3, 3] += point
    motion_m = motion_sigmas(group, nearest, frame_pairs, left, map_SE3_left, params.track, motion)
    fixed = motion_m[:, None, None] ** 2 * by_place @ np.swapaxes(by_place, 1, 2)
    fixed[:, 0, 0] += [m.sigma_u_px**2 / 2 for m in pairs]
    return _Cone(
        (observed - computed) @ _GROUPS.T,
        np.concatenate([by_place, shared[:, :, None] * np.eye(3)], axis=2),
        np.array([(m.sigma_pointing_px**2, m.sigma_v_px**2 / 2, _disparity_px2(m)) for m in pairs]),
        fixed,
    )


def _squares_and_freedom(cone: _Cone, factors: Floats) -> tuple[Floats, Floats]:
    """(3,) each: per group the weighted squares of a cone's residuals, and what they would be if the factors were right.

    Both sides of the score of restricted maximum likelihood, r' P S P r = tr(P S) with S the stated variances of one group
    (Koch 1999, eq. 3.6.20); rounds with squares over freedom end where they are equal.
    """
    design = cone.design
    weight = np.linalg.inv(cone.fixed_px2 + (factors * cone.stated_px2)[:, :, None] * np.eye(3))
    weighted = weight @ design
    normal = np.einsum("fik,fil->kl", design, weighted)
    normal[[3, 4, 5], [3, 4, 5]] += 1.0  # what sightings share is known beforehand to one sigma
    inverse = np.linalg.inv(normal)
    unknown = inverse @ np.einsum("fik,fi->k", weighted, cone.residual_px)
    left_over = cone.residual_px - design @ unknown
    pull = np.einsum("fij,fj->fi", weight, left_over)
    misfit = np.sqrt(np.einsum("fi,fi->f", left_over, pull) / 3)
    pull *= np.minimum(1.0, _HUBER_SIGMAS / np.maximum(misfit, 1e-9))[:, None]
    freedom = np.einsum("fii->fi", weight) - np.einsum("fik,kl,fil->fi", weighted, inverse, weighted)
    return (pull**2 * cone.stated_px2).sum(axis=0), (freedom * cone.stated_px2).sum(axis=0)
