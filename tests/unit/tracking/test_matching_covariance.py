"""The covariance of a matching against its errors, where the truth is known: a texture shifted by part of a pixel, with noise."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from conetl.tracking.matching.cone_pixels import SplinePatch
from conetl.tracking.matching.covariance import SHARED_DISPARITY_PX, matching_cov, shared_disparity_px, with_shared_part

Floats = NDArray[np.float64]
ROWS, COLUMNS, MARGIN = 20, 12, 8
ROW_OF, COLUMN_OF = (part.ravel() for part in np.mgrid[:ROWS, :COLUMNS])


def draw(rng: np.random.Generator, contrast: float, noise: float, alike: float) -> tuple[float, float]:
    """Error (px) of a matching of one unknown, and its sigma.

    contrast, noise: standard deviations of grey values. alike: share of the noise's variance that all colours have in common.
    """
    size = (ROWS + 2 * MARGIN, COLUMNS + 2 * MARGIN)
    texture = gaussian_filter(rng.normal(size=size), 1.2)
    texture *= contrast / texture.std()
    images = [128 + texture[..., None] + noise * noisy(rng, size, alike) for _ in range(2)]
    left, right = (np.clip(np.round(image), 0, 255).astype(np.uint8) for image in images)
    patches = [SplinePatch.of(image, 0, size[0] - 8, 4, size[1] - 8) for image in (left, right)]
    assert patches[0] is not None
    assert patches[1] is not None
    rows, columns = ROW_OF + MARGIN, COLUMN_OF + float(MARGIN)
    values, slopes_left, _ = patches[0].at(rows, columns, 0.0)
    shift, weights = 0.0, np.ones(len(rows))
    for _ in range(12):
        sample, slopes, _ = patches[1].at(rows, columns + shift, 0.0)
        residual = values - sample
        residual -= residual.mean(axis=0)
        step = float((slopes * residual).sum() / (slopes**2).sum())
        shift += step
    variance = residual.var(axis=0)
    normal = np.array([[(slopes**2 / variance).sum()]])
    cov = matching_cov(
        slopes[:, :, None], residual, variance, weights, normal, slopes_left[None],
        place=(rows, columns.astype(np.intp)), prior=np.zeros(1), prior_variance=np.zeros(1),
    )  # fmt: skip
    return shift, float(cov[0, 0] ** 0.5)


def noisy(rng: np.random.Generator, size: tuple[int, int], alike: float) -> Floats:
    return alike**0.5 * rng.normal(size=(*size, 1)) + (1 - alike) ** 0.5 * rng.normal(size=(*size, 3))


@pytest.mark.parametrize(("contrast", "alike"), [(40.0, 0.0), (40.0, 0.9), (9.0, 0.0), (9.0, 0.9)])
def test_sigma_is_that_of_the_errors_however_poor_the_contrast(contrast: float, alike: float) -> None:
    """120 draws each, of which the mean square scatters by 13 %. Half: cones' errors are larger than noise alone makes them."""
    rng = np.random.default_rng(int(contrast + 10 * alike))
    error, sigma = np.array([draw(rng, contrast, 8.0, alike) for _ in range(120)]).T
    assert 0.3 < np.mean((error / sigma) ** 2) < 1.5


def test_residuals_that_go_together_farther_than_the_blur_make_sigma_larger() -> None:
    rng = np.random.default_rng(1)
    fine = rng.normal(size=(ROWS, COLUMNS, 3))
    broad = gaussian_filter(rng.normal(size=(ROWS, COLUMNS, 3)), (2.0, 1.5, 0.0))
    jacobian = rng.normal(size=(ROWS * COLUMNS, 3, 1))
    variances = []
    for field in (fine, broad / broad.std()):
        residual = field.reshape(-1, 3)
        cov = matching_cov(
            jacobian, residual, np.ones(3), np.ones(len(residual)), (jacobian[:, :, 0] ** 2).sum().reshape(1, 1),
            jacobian[None, :, :, 0], place=(ROW_OF, COLUMN_OF), prior=np.zeros(1), prior_variance=np.zeros(1),
        )  # fmt: skip
        variances.append(float(cov[0, 0]))
    assert variances[1] > 2 * variances[0]


def test_an_error_known_beforehand_enters_with_its_own_size() -> None:
    """Nothing but the prior holds the second unknown: its variance comes out, whatever weight the fit gave to it."""
    jacobian = np.zeros((40, 1, 2))
    jacobian[:, 0, 0] = np.tile([1.0, -1.0], 20)
    residual = np.tile([[0.1], [0.1], [-0.1], [-0.1]], (10, 1))
    cov = matching_cov(
        jacobian, residual, np.array([0.01]), np.ones(40), np.diag([40 / 0.01, 0.0]), jacobian.transpose(2, 0, 1),
        place=(np.arange(40) // 4, np.arange(40) % 4), prior=np.array([0.0, 7.0]), prior_variance=np.array([0.0, 0.3**2]),
    )  # fmt: skip
    assert cov[1, 1] == pytest.approx(0.3**2)
    assert cov[0, 1] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("sigma_px", [0.03, 0.1, 0.4])
def test_what_all_observations_share_is_part_of_the_sigma(sigma_px: float) -> None:
    """The rest is that of the matching; objects with low contrast have more in common, and all of them their shape."""
    by_matching = (sigma_px**2 - SHARED_DISPARITY_PX**2) ** 0.5
    whole = with_shared_part(sigma_px)
    in_common = shared_disparity_px(whole)
    assert whole**2 - in_common**2 == pytest.approx(by_matching**2)
    assert in_common == pytest.approx(np.hypot(SHARED_DISPARITY_PX, 0.4 * by_matching))
