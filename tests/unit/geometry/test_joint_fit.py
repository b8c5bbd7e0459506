from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from conetl.geometry.intersection import JointFit, fit_point, pair_jacobian
from tests.synthetic.world import ORIGIN_M, camera_poses, make_path, make_rig

RIG = make_rig()
POINT = ORIGIN_M + np.array([20.0, 2.0, 0.1])
FRAMES = 12


def poses() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    path = make_path(FRAMES)
    left, right = camera_poses(path, RIG, "left"), camera_poses(path, RIG, "right")
    return np.stack(list(left.values())), np.stack(list(right.values()))


def fit(observed: NDArray[np.float64], motion_m: float = 0.01) -> JointFit:
    left, right = poses()
    ones = np.ones(len(observed))
    result = fit_point(
        observed,
        POINT + np.array([0.8, -0.4, 0.3]),
        left,
        right,
        RIG,
        sigma_u_px=0.15 * ones,
        sigma_v_px=0.8 * ones,
        sigma_pointing_px=0.6 * ones,
        sigma_motion_m=motion_m * ones,
    )
    assert result is not None
    return result


def perfect() -> NDArray[np.float64]:
    return pair_jacobian(POINT, *poses(), RIG)[0]


def test_perfect_observations_give_the_point_to_a_micrometre() -> None:
    result = fit(perfect())
    assert np.linalg.norm(result.xyz_m - POINT) < 1e-6
    assert np.abs(result.residuals_px).max() < 1e-5


def test_one_wrong_box_hardly_moves_the_point() -> None:
    observed = perfect()
    observed[3] += np.array([25.0, -10.0, 8.0, 12.0])
    result = fit(observed)
    assert np.linalg.norm(result.xyz_m - POINT) < 0.03
    assert np.abs(np.delete(result.residuals_px, 3, axis=0)).max() < 1.0 < np.abs(result.residuals_px[3]).min()


def test_a_point_behind_the_cameras_is_no_result() -> None:
    left, right = poses()
    ones = np.ones(FRAMES)
    sigmas = {"sigma_u_px": ones, "sigma_v_px": ones, "sigma_pointing_px": ones, "sigma_motion_m": ones}
    behind = ORIGIN_M - np.array([50.0, 0.0, 0.0])
    assert fit_point(perfect(), behind, left, right, RIG, **sigmas) is None
