"""The computations of the accuracy study: Monte Carlo through the real intersection beside its analytic covariance.

Frame: left camera of the first station, x right, y down, z forward; metres. Nothing is drawn here, see `accuracy_study.py`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from conetl.geometry.calibration import covariance as calibration_covariance
from conetl.geometry.camera import intrinsics
from conetl.geometry.intersection import IntersectionResult, fit_point, intersect
from conetl.geometry.rig import left_SE3_right
from conetl.model.rig import Rig
from docs.figures.paper_rig import CAMERA_HEIGHT_M, GROUND_DISTANCE_M, changed_views, drawn_views

Array = NDArray[np.float64]
Views = tuple[Array, Array, Array]
DRAWS = 4000
#: Rays of a 10 cm base at 30 m meet under 0.2 degrees; the pipeline refuses that, the study wants to see it.
_LEAST_ANGLE_RAD = 5e-4


@dataclass(frozen=True)
class Spread:
    """Errors of many draws of one case, along the sight (level), across it, up."""

    analytic_m: Array
    """(3,) sigmas from the covariance"""
    monte_carlo_m: Array
    """(3,) root mean square errors"""
    bias_m: Array
    """(3,) mean errors"""
    expected_cov_m2: Array
    """(3, 3) at the truth, in the frame of the first station"""
    normalised_along: Array
    """(N,) error along the sight over the sigma that the draw itself stated"""
    inside_95: Array
    """(4,) share of draws within the stated 95 % interval of each axis, and of the 95 % ellipsoid"""


def foot_at(ground_m: float, bearing_rad: float = 0.0) -> Array:
    """(3,) foot of a cone on level ground at a ground distance and a bearing to the right of the axis."""
    return np.array([ground_m * np.sin(bearing_rad), CAMERA_HEIGHT_M, ground_m * np.cos(bearing_rad)])


def views_of(rig: Rig) -> Views:
    """k (2, 4), rotation (2, 3, 3), centre (2, 3) of both cameras, frame: left camera."""
    relative = left_SE3_right(rig)
    return (
        np.stack([intrinsics(rig.left), intrinsics(rig.right)]),
        np.stack([np.eye(3), relative[:3, :3]]),
        np.stack([np.zeros(3), relative[:3, 3]]),
    )


def stations(rig_views: Views, poses: Sequence[Array]) -> Views:
    """The views of one rig at S stations, first_SE3_station (4, 4) each: (2S, ...) or (P, 2S, ...)."""
    k, rotation, centre = rig_views
    turned = [pose[:3, :3] @ rotation for pose in poses]
    placed = [centre @ pose[:3, :3].T + pose[:3, 3] for pose in poses]
    axis = k.ndim - 2
    return (
        np.concatenate([k] * len(poses), axis=axis),
        np.concatenate(turned, axis=axis),
        np.concatenate(placed, axis=axis),
    )


def project(views: Views, point_m: Array) -> Array:
    """(..., V, 2) image points of one point."""
    k, rotation, centre = views
    local = np.einsum("...vji,...vj->...vi", rotation, point_m - centre)
    return k[..., :2] * local[..., :2] / local[..., 2:] + k[..., 2:]


def solve(uv_px: Array, views: Views, sigma_px: float) -> IntersectionResult:
    """The real intersection; every point must come out."""
    result = intersect(uv_px, *views, sigma_px, min_ray_angle_rad=_LEAST_ANGLE_RAD)
    if not result.ok.all():
        raise RuntimeError(f"{np.sum(~result.ok)} of {len(uv_px)} draws did not come out")
    return result


def image_noise(rig: Rig, point_m: Array, sigma_px: float, rng: np.random.Generator, draws: int = DRAWS) -> Spread:
    """One frame pair with exact calibration."""
    return exact_stations(rig, point_m, sigma_px, rng, (np.eye(4),), draws)


def exact_stations(
    rig: Rig, point_m: Array, sigma_px: float, rng: np.random.Generator, poses: Sequence[Array], draws: int = DRAWS
) -> Spread:
    """Frame pairs at S stations with exact calibration and poses."""
    views = stations(views_of(rig), poses)
    exact = project(views, point_m)
    result = solve(exact + rng.normal(0, sigma_px, (draws, *exact.shape)), views, sigma_px)
    return spread(result.xyz_m - point_m, result.cov_m2, point_m, solve(exact[None], views, sigma_px).cov_m2[0])


def jacobian_by_differences(rig: Rig, points_m: Array, poses: Sequence[Array] = (np.eye(4),)) -> Array:
    """(P, 3, K) how points (P, 3) seen from S stations move with each calibration parameter when their image points stay.

    By central differences of the intersection itself: owes nothing to the formulas that the pipeline uses.
    """
    covariance = rig.calibration_covariance
    if covariance is None:
        raise ValueError("jacobian_by_differences: the rig has no calibration covariance")
    steps = 0.1 * np.sqrt(np.diag(covariance.matrix))
    changes = np.vstack([np.diag(steps), -np.diag(steps)])
    changed = stations(changed_views(rig, covariance.names, changes), poses)
    count, both = len(points_m), len(changes)
    views = stations(views_of(rig), poses)
    uv = np.repeat(np.stack([project(views, point) for point in points_m]), both, axis=0)
    k, rotation, centre = (np.tile(part, (count, *[1] * (part.ndim - 1))) for part in changed)
    moved = solve(uv, (k, rotation, centre), 1.0).xyz_m.reshape(count, 2, len(steps), 3)
    return np.asarray(np.swapaxes(moved[:, 0] - moved[:, 1], 1, 2) / (2 * steps))


def calibration_and_noise(
    rig: Rig,
    point_m: Array,
    sigma_px: float,
    rng: np.random.Generator,
    *,
    poses: Sequence[Array] = (np.eye(4),),
    draws: int = DRAWS,
) -> Spread:
    """Frame pairs at S stations, taken by a rig that differs from its calibration by one draw, the same at every station."""
    views = stations(views_of(rig), poses)
    truly = stations(drawn_views(rig, rng, draws), poses)
    uv = project(truly, point_m)
    result = solve(uv + rng.normal(0, sigma_px, uv.shape), views, sigma_px)
    matrix = np.array(rig.calibration_covariance.matrix) if rig.calibration_covariance else np.zeros((0, 0))

    # Each draw states the covariance at its own estimate, as the pipeline would: it does not know the truth.
    points = np.vstack([result.xyz_m, point_m])
    # The pipeline's own derivatives hold for one frame pair; several stations at once are the study's.
    one_pair = len(poses) == 1
    jacobian = (
        calibration_covariance.calibration_jacobian(points, rig)
        if one_pair
        else jacobian_by_differences(rig, points, poses)
    )
    common = jacobian @ matrix @ np.swapaxes(jacobian, 1, 2)
    stated = result.cov_m2 + common[:-1]
    expected = solve(project(views, point_m)[None], views, sigma_px).cov_m2[0] + common[-1]
    return spread(result.xyz_m - point_m, stated, point_m, expected)


def spread(errors_m: Array, cov_m2: Array, point_m: Array, expected_cov_m2: Array) -> Spread:
    """Errors (N, 3) with the covariances (N, 3, 3) that each draw states for itself, and the one at the truth (3, 3)."""
    axes = sight_axes(point_m)
    errors = errors_m @ axes.T
    stated = np.sqrt(np.einsum("nii->ni", axes @ cov_m2 @ axes.T))
    inside = np.mean(np.abs(errors) <= stats.norm.ppf(0.975) * stated, axis=0)
    squared = np.einsum("ni,ni->n", errors_m, np.linalg.solve(cov_m2, errors_m[..., None])[..., 0])
    ellipsoid = np.mean(squared <= stats.chi2.ppf(0.95, 3))
    return Spread(
        np.sqrt(np.diag(axes @ expected_cov_m2 @ axes.T)),
        np.sqrt(np.mean(errors**2, axis=0)),
        errors.mean(axis=0),
        expected_cov_m2,
        errors[:, 0] / stated[:, 0],
        np.append(inside, ellipsoid),
    )


def sight_axes(point_m: Array) -> Array:
    """(3, 3) rows along the level sight to a point, across it to the right, up."""
    ahead = np.array([point_m[0], 0.0, point_m[2]]) / np.hypot(point_m[0], point_m[2])
    return np.array([ahead, [ahead[2], 0.0, -ahead[0]], [0.0, -1.0, 0.0]])


def around(ground_m: float, angles_rad: Sequence[float]) -> list[Array]:
    """first_SE3_station of rigs on a circle around the cone, each looking at it; angle 0 is the first station."""
    poses = []
    foot = foot_at(ground_m)
    for angle in angles_rad:
        c, s = np.cos(angle), np.sin(angle)
        pose = np.eye(4)
        pose[:3, :3] = [[c, 0, s], [0, 1, 0], [-s, 0, c]]
        pose[:3, 3] = pose[:3, :3] @ -foot_at(ground_m) + foot
        pose[1, 3] = 0.0
        poses.append(pose)
    return poses


def passing(
    frames: int, *, far_m: float = 20.0, near_m: float = 6.0, aside_m: float = 3.0
) -> tuple[list[Array], Array]:
    """Stations of a drive past a cone that stands aside, the nearest first, and its foot (3,), frame: that station."""
    poses = []
    for ahead in np.linspace(near_m, far_m, frames):
        pose = np.eye(4)
        pose[2, 3] = near_m - ahead
        poses.append(pose)
    return poses, np.array([aside_m, CAMERA_HEIGHT_M, near_m])


def adjusted_drive(
    rig: Rig,
    point_m: Array,
    sigma_px: float,
    sigma_motion_m: float,
    rng: np.random.Generator,
    poses: Sequence[Array],
    draws: int,
) -> Spread:
    """As `exact_stations`, by the joint adjustment of a track, with stations that are off their place by a sigma each."""
    relative = left_SE3_right(rig)
    left = np.stack(poses)
    right = left @ relative
    count = len(poses)
    sigmas = {name: np.full(count, sigma_px) for name in ("sigma_u_px", "sigma_v_px")}
    fits = []
    for _ in range(draws):
        moved = left.copy()
        moved[:, :3, 3] += rng.normal(0, sigma_motion_m, (count, 3))
        uv = np.concatenate([project(stations(views_of(rig), [pose]), point_m).reshape(1, 4) for pose in moved])
        fit = fit_point(
            uv + rng.normal(0, sigma_px, uv.shape), point_m, left, right, rig, **sigmas,
            sigma_pointing_px=np.zeros(count), sigma_motion_m=np.full(count, sigma_motion_m),
        )  # fmt: skip
        if fit is None:
            raise RuntimeError("a drive's adjustment did not come out")
        fits.append(fit)
    cov = np.stack([fit.cov_m2 for fit in fits])
    return spread(np.stack([fit.xyz_m for fit in fits]) - point_m, cov, point_m, np.median(cov, axis=0))


def paper_point() -> Array:
    """(3,) the paper's cone: 8.53 m ground distance."""
    return foot_at(GROUND_DISTANCE_M)
