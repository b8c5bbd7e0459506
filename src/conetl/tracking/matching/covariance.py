"""Covariance of the unknowns of a least-squares matching, from the noise in the images.

The inverse of the normal matrix is too optimistic for two reasons: noise is correlated between colours and neighbouring pixels,
and its slopes count in the normal matrix as if they determined the disparity, most of all for cones with low contrast.
"""

from __future__ import annotations

import numpy as np

from conetl.model.arrays import Floats, Ints

#: Least factor on the variance for correlated neighbours. On the sample drives residuals correlate by 0.52 side by side and by
#: 0.09 two pixels apart, along rows and along columns, by the blur of interpolation and lens: (1 + 2 * 0.61) squared. Half of
#: it would do for noise alone; the errors of cones require all of it.
_NEIGHBOURS = 5.0
#: Largest distance of correlated neighbours, in pixels.
_REACH_PX = 5
#: Sigma of the disparity common to all observations of one cone: its shape differs from a body of revolution. Measured as
#: scatter of the cones' mean disparities beyond noise on the sample drives (benchmarks/RESULTS.md).
SHARED_DISPARITY_PX = 0.02
#: Sigma of a further part, as a share of that of the matching. Measured as correlation between the errors of successive frames
#: and as scatter of the objects' mean errors, on the sample drives and mixed worlds 4 and 5.
_SHARED_SHARE = 0.4


def with_shared_part(sigma_px: float) -> float:
    """Sigma of a disparity from that of its matching, `AreaMatch.sigma_px`, with what all observations of the object share.

    Beside the constant for its shape, which `sigma_px` has, that is a share of the other errors: the less contrast an object
    has, the more the same few edges decide, from every distance.
    """
    return float(np.hypot(sigma_px, _SHARED_SHARE * matching_sigma_px(sigma_px)))


def shared_disparity_px(sigma_px: float) -> float:
    """The part that all observations share of the sigma that `with_shared_part` gives."""
    share = _SHARED_SHARE / (1 + _SHARED_SHARE**2) ** 0.5
    return float(np.hypot(SHARED_DISPARITY_PX, share * matching_sigma_px(sigma_px)))


def own_disparity_px(sigma_px: float) -> float:
    """The rest of it, which every observation has for itself."""
    return matching_sigma_px(sigma_px) / float(np.hypot(1, _SHARED_SHARE))


def matching_sigma_px(sigma_px: float) -> float:
    """Of a disparity with this sigma, the part without the constant for the object's shape."""
    return float(np.sqrt(max(sigma_px**2 - SHARED_DISPARITY_PX**2, 1e-6)))


#: Least share of the squared slopes that is signal.
_LEAST_SIGNAL = 0.1


def matching_cov(
    jacobian: Floats,
    residual: Floats,
    noise: Floats,
    weights: Floats,
    normal: Floats,
    in_left: Floats,
    *,
    place: tuple[Ints, Ints],
    prior: Floats,
    prior_variance: Floats,
) -> Floats:
    """Covariance (p, p) of the unknowns of a matching, at its solution.

    jacobian (n, channels, p) of the modelled grey values, by the slopes of the right image. residual (n, channels), and its
    variance noise (channels,). weights (n,) of the pixels. normal (p, p) = sum of weight times jacobian' jacobian over noise.
    in_left (p, n, channels): the same slopes, from the left image. place: rows and columns (n,) of the pixels. prior (p,):
    added by the fit to the diagonal of the normal matrix. prior_variance (p,): prior variances of the unknowns.

    A sandwich estimator (Huber 1967): the scatter of the pixels' gradients, all colours together, under the slopes that are
    signal.
    """
    count = jacobian.shape[2]
    colours = (residual.T * weights) @ residual / weights.sum() / np.outer(noise, noise)
    gradients = (jacobian * weights[:, None, None]).reshape(-1, count).T @ (colours @ jacobian).reshape(-1, count)
    spread = _neighbours(residual * weights[:, None], *place) * gradients + np.diag(prior**2 * prior_variance)
    shares = (weights[:, None] / noise)[:, :, None]
    crossed = (jacobian * shares).reshape(-1, count).T @ in_left.transpose(1, 2, 0).reshape(-1, count)
    inverse = _inverse_of_signal(normal, crossed, prior)
    return np.asarray(inverse @ spread @ inverse)


def _neighbours(residual: Floats, rows: Ints, columns: Ints) -> float:
    """Factor on the variance of a sum of the residuals (n, channels) compared with independent pixels.

    Sums of their correlations along rows and columns, each up to the first that may be chance (two sigmas). For noise they are
    those of the blur (`_NEIGHBOURS`); compression and model errors of a real cone reach farther.
    """
    i, j = np.unique(rows, return_inverse=True)[1], columns - columns.min()
    grid = np.zeros((i.max() + 1, j.max() + 1, residual.shape[1]))
    present = np.zeros(grid.shape[:2])
    grid[i, j], present[i, j] = residual, 1.0
    variance = float((residual**2).mean())
    factor = 1.0
    for field, mask in ((grid, present), (grid.swapaxes(0, 1), present.T)):
        correlations = 0.0
        for step in range(1, min(_REACH_PX, len(field) - 1) + 1):
            pairs = max(float((mask[:-step] * mask[step:]).sum()), 1.0)
            correlation = float((field[:-step] * field[step:]).sum()) / (pairs * residual.shape[1] * variance)
            if correlation < 2 / pairs**0.5:
                break
            correlations += correlation
        factor *= 1 + 2 * correlations
    return max(factor, _NEIGHBOURS)


def _inverse_of_signal(normal: Floats, crossed: Floats, prior: Floats) -> Floats:
    """Inverse (p, p) of the normal matrix, prior included, without the noise in the slopes of the right image.

    Noise steepens slopes and so overstates precision: errors in variables (Fuller 1987). The product of both images' slopes,
    `crossed`, is free of it on average, because their noise is independent.
    """
    # As shares of the noisy matrix, limited to `_LEAST_SIGNAL` and 1 in every direction.
    half = np.linalg.cholesky(normal + np.diag(prior))
    present = np.linalg.solve(half, np.linalg.solve(half, (crossed + crossed.T) / 2 + np.diag(prior)).T)
    share, turn = np.linalg.eigh((present + present.T) / 2)
    back = np.linalg.solve(half.T, turn)
    return np.asarray((back / np.clip(share, _LEAST_SIGNAL, 1.0)) @ back.T)
