"""How exact a least-squares matching is: the covariance of its unknowns, from what the images themselves say of their noise.

Two things make the usual inverse of the normal matrix a bad judge. Noise errs alike in all colours and in neighbouring pixels:
there are fewer observations than grey values. And noise has slopes of its own: in the normal matrix they count as if they held
the disparity, the more the poorer a cone stands out from what is behind it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.intp]

#: By how much more variance neighbours leave that err together, at least. On the sample drives residuals correlate by 0.52 side
#: by side and by 0.09 two pixels apart, along rows and along columns, by the blur of interpolation and lens: (1 + 2 * 0.61)
#: squared. The slopes go together less far, so half of it would do for noise alone; the errors of cones ask for all of it.
_NEIGHBOURS = 5.0
#: How far neighbours are looked at, in pixels.
_REACH_PX = 5
#: What no residual shows, and all sightings of one cone have in common: its shape is not the matching's body of revolution.
#: Cones' mean disparities of the sample drives scatter by so much more than their noise lets them (docs/explanation/accuracy.md).
SHARED_DISPARITY_PX = 0.02
#: Share of the slopes, squared, that is no noise, at least.
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
    in_left (p, n, channels): the same slopes, seen in the left image. place: rows and columns (n,) of the pixels.
    prior (p,): what the fit added to the diagonal of the normal matrix. prior_variance (p,): variances of the unknowns themselves
    where there is a prior.

    A sandwich (Huber 1967): the pulls of the pixels as they scatter, all colours together, under the slopes that hold something.
    """
    count = jacobian.shape[2]
    colours = (residual.T * weights) @ residual / weights.sum() / np.outer(noise, noise)
    pulls = (jacobian * weights[:, None, None]).reshape(-1, count).T @ (colours @ jacobian).reshape(-1, count)
    spread = _neighbours(residual * weights[:, None], *place) * pulls + np.diag(prior**2 * prior_variance)
    shares = (weights[:, None] / noise)[:, :, None]
    crossed = (jacobian * shares).reshape(-1, count).T @ in_left.transpose(1, 2, 0).reshape(-1, count)
    inverse = _inverse_of_signal(normal, crossed, prior)
    return np.asarray(inverse @ spread @ inverse)


def _neighbours(residual: Floats, rows: Ints, columns: Ints) -> float:
    """By how much more variance the residuals (n, channels) leave in a sum than if pixels erred one by one.

    Sums of their correlations along rows and along columns, each up to the first that could be chance (two sigmas). Where all is
    noise they are those of the blur (`_NEIGHBOURS`); compression and what the model leaves of a real cone reach farther.
    """
    i, j = np.unique(rows, return_inverse=True)[1], columns - columns.min()
    grid = np.zeros((i.max() + 1, j.max() + 1, residual.shape[1]))
    there = np.zeros(grid.shape[:2])
    grid[i, j], there[i, j] = residual, 1.0
    variance = float((residual**2).mean())
    factor = 1.0
    for field, mask in ((grid, there), (grid.swapaxes(0, 1), there.T)):
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
    """Inverse (p, p) of the normal matrix, prior included, without the noise that the slopes of the right image hold.

    Noise steepens slopes, and so the normal matrix promises a precision that is not there: errors in variables (Fuller 1987).
    The noise of the left image is another one, so the product of both images' slopes, `crossed`, is free of it on average.
    """
    # As shares of the matrix with the noise in it: no direction may end with nothing, or with more than there is.
    half = np.linalg.cholesky(normal + np.diag(prior))
    there = np.linalg.solve(half, np.linalg.solve(half, (crossed + crossed.T) / 2 + np.diag(prior)).T)
    share, turn = np.linalg.eigh((there + there.T) / 2)
    back = np.linalg.solve(half.T, turn)
    return np.asarray((back / np.clip(share, _LEAST_SIGNAL, 1.0)) @ back.T)
