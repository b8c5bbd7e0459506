"""How exact a least-squares matching is: the covariance of its unknowns, from what the pictures themselves say of their noise.

Two things make the usual inverse of the normal matrix a bad judge. Noise errs alike in all colours and in neighbouring pixels:
there are fewer observations than grey values. And noise has slopes of its own: in the normal matrix they count as if they held the
disparity, the more the poorer a cone stands out from what is behind it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

#: By how much more variance neighbours leave that err together: residuals of pixels side by side correlate by 0.52, two apart by
#: 0.09, along rows and columns alike, which makes (1 + 2 * 0.61) squared. Measured on the sample drives (docs/accuracy.md).
_NEIGHBOURS = 5.0
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
    prior: Floats,
    prior_variance: Floats,
) -> Floats:
    """Covariance (p, p) of the unknowns of a matching, at its solution.

    jacobian (n, channels, p) of the modelled grey values, by the slopes of the right picture. residual (n, channels), and its
    variance noise (channels,). weights (n,) of the pixels. normal (p, p) = sum of weight times jacobian' jacobian over noise.
    in_left (p, n, channels): the same slopes, seen in the left picture. prior (p,): what the fit added to the diagonal of the
    normal matrix. prior_variance (p,): variances of the unknowns themselves where there is a prior.

    A sandwich (Huber 1967): the pulls of the pixels as they scatter, all colours together, under the slopes that hold something.
    """
    colours = np.einsum("nc,nd,n->cd", residual, residual, weights) / weights.sum() / np.outer(noise, noise)
    pulls = np.einsum("ncp,cd,ndq,n->pq", jacobian, colours, jacobian, weights, optimize=True)
    spread = _NEIGHBOURS * pulls + np.diag(prior**2 * prior_variance)
    crossed = np.einsum("ncp,qnc,nc->pq", jacobian, in_left, weights[:, None] / noise, optimize=True)
    inverse = _inverse_of_signal(normal, crossed, prior)
    return np.asarray(inverse @ spread @ inverse)


def _inverse_of_signal(normal: Floats, crossed: Floats, prior: Floats) -> Floats:
    """Inverse (p, p) of the normal matrix, prior included, without the noise that the slopes of the right picture hold.

    Noise steepens slopes, and so the normal matrix promises a precision that is not there: errors in variables (Fuller 1987).
    The noise of the left picture is another one, so the product of both pictures' slopes, `crossed`, is free of it on average.
    """
    # As shares of the matrix with the noise in it: no direction may end with nothing, or with more than there is.
    half = np.linalg.cholesky(normal + np.diag(prior))
    there = np.linalg.solve(half, np.linalg.solve(half, (crossed + crossed.T) / 2 + np.diag(prior)).T)
    share, turn = np.linalg.eigh((there + there.T) / 2)
    back = np.linalg.solve(half.T, turn)
    return np.asarray((back / np.clip(share, _LEAST_SIGNAL, 1.0)) @ back.T)
