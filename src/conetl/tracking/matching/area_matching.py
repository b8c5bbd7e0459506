"""Area-based least-squares matching of one cone between the left and the right rectified image.

A box from a network is loose by a pixel or more; range lives on the difference of two such boxes. Matching the grey values
themselves fixes the disparity to a twentieth of a pixel. First a normalised cross-correlation over whole pixels, then
least-squares matching (Ackermann 1984; Gruen 1985) by Gauss-Newton, with a gain and an offset for each colour.

A cone is no plane: its outline lies at the depth of the axis, the surface between lies nearer by up to its radius. The left
image is therefore matched along a disparity *surface*, that of a body of revolution with the outline of `cone_outline.py`
standing upright (`cone_surface.py`), and what is looked for is the disparity of its axis at the foot. How far the cone leans,
how near its surface is and how far each edge is seen off its place are unknowns as well, about which something is known
beforehand; so neither the edges nor the texture of a large cone are believed too much, and sigma holds what such errors cost.
Sigma is that of the residuals under slopes that both images share: noise makes slopes too, and they hold nothing.

Only pixels of the body and its edges take part. What stands behind is mixed into the edges by the blur, and is another thing in
the other image: that change is measured just beyond the edge and taken out. Both images are blurred alike by the B-spline of
the interpolation; without that noise draws disparities to half pixels. What does not fit (something in front) loses its weight.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from conetl.geometry.small_arrays import median
from conetl.model.records import Camera
from conetl.tracking.matching.cone_outline import Outline
from conetl.tracking.matching.cone_pixels import ConePixels, cone_pixels
from conetl.tracking.matching.covariance import SHARED_DISPARITY_PX, matching_cov
from conetl.tracking.matching.spline_patch import SplinePatch

Floats = NDArray[np.float64]
Ints = NDArray[np.intp]

_MIN_CORRELATION = 0.75
_MAX_ITERATIONS = 24
_CONVERGED_PX = 2e-2
#: How far the disparity may run from the best whole-pixel place.
_MAX_WAY_PX = 2.0
_MAX_ROW_OFFSET_PX = 1.5
_MIN_INLIER_SHARE = 0.6
#: Residuals, in units of the usual one, from which on a pixel loses weight at first (Huber 1964), and the scale of the weights
#: with which the fit ends, by which outliers count nothing (Geman & McClure 1985).
_HUBER, _OUTLIER = 2.0, 3.0
_SOFT_ITERATIONS = 3
#: A change of background counts by half where its square is this many times its own uncertainty: noise, and what it may change
#: by on the way from where it is seen to the edge, so many pixels (a random walk: its variance grows with the way).
_BACKGROUND_NOISE, _BACKGROUND_WAY_PX = 3.0, 2.5
#: Variance of grey values that even equal images have, by rounding to 8 bits in both.
_QUANTISATION = 0.17
#: What is known beforehand, one sigma: lean of a cone towards the camera (rad), its surface's nearness (share), and how far an
#: edge is seen off its place by what stands behind it (px). Nothing of disparity and row offset.
_LEAN_SIGMA, _SURPLUS_SIGMA, _SHIFT_SIGMA_PX = 0.015, 0.05, 0.08
_PRIOR = np.array([0.0, 0.0, _LEAN_SIGMA**-2, _SURPLUS_SIGMA**-2, _SHIFT_SIGMA_PX**-2, _SHIFT_SIGMA_PX**-2])
#: Weight of what is known beforehand against grey values: variance over that of white noise.
_DESIGN_EFFECT = 15.0
_PRIOR_NORMAL = _DESIGN_EFFECT * np.diag(_PRIOR)
#: How large lean, surplus and shifts are, with which sigma reckons: variances in the order of the unknowns.
_PRIOR_VARIANCE = np.array([0.0, 0.0, 0.010**2, 0.033**2, 0.033**2, 0.033**2])


@dataclass(frozen=True)
class AreaMatch:
    """Result of `match_area`."""

    disparity_px: float
    """Of the cone's axis at its foot: left column minus right column."""
    sigma_px: float
    """Standard deviation of the disparity."""
    correlation: float
    row_offset_px: float
    """How much lower the cone is in the right image; 0 in a perfectly rectified pair with equal principal points."""


def match_area(
    left: NDArray[np.uint8],
    right: NDArray[np.uint8],
    outline: Outline,
    disparity_px: float,
    search_px: float,
    *,
    camera: Camera,
    up: Floats,
    at_infinity_px: float = 0.0,
    row_offset_px: float = 0.0,
) -> AreaMatch | None:
    """Disparity of the cone with `outline` in the left image, or None where the images do not settle it.

    left, right: rectified images, (H, W, 3) or (H, W), uint8. disparity_px: first guess; search_px: half width of the search.
    camera: the left one. up: unit vector (3,) in its frame (x right, y down, z forward). at_infinity_px: disparity of a point at
    infinity. row_offset_px: how much lower all things are in the right image by calibration.
    """
    if left.ndim == 2:
        left, right = left[:, :, None], right[:, :, None]
    pixels = cone_pixels(left, outline, camera, up)
    if pixels is None:
        return None
    coarse = _whole_pixel_disparity(pixels, right, disparity_px, search_px, at_infinity_px, round(row_offset_px))
    if coarse is None:
        return None
    return _least_squares(pixels, right, float(coarse), at_infinity_px, row_offset_px)


def _whole_pixel_disparity(
    pixels: ConePixels, right: NDArray[np.uint8], guess: float, search_px: float, at_infinity_px: float, row_offset: int
) -> int | None:
    """Disparity at which the pixels fit best; None at the search's end, below the bar, or where it leaves the image."""
    reach = int(np.ceil(search_px)) + 1
    candidates = round(guess) + np.arange(-reach, reach + 1)
    shape = at_infinity_px + (candidates[:, None] - at_infinity_px) / pixels.depth
    columns = np.rint(pixels.columns - shape).astype(np.intp)  # (candidates, n)
    if columns.min() < 2 or columns.max() > right.shape[1] - 3:
        return None
    rows = np.minimum(np.maximum(pixels.rows + row_offset, 0), right.shape[0] - 1)
    height, width, channels = right.shape
    count = len(pixels.rows)
    flat = np.ascontiguousarray(right).reshape(height * width, channels)
    samples = flat.take(rows * width + columns, axis=0).reshape(len(candidates), count * channels).astype(np.float64)
    template = pixels.values - pixels.values.mean(axis=0)
    # Sums of squares about the mean, from sums of whole numbers: nothing is lost by taking the mean out afterwards.
    sums = samples.reshape(len(candidates), count, channels).sum(axis=1)
    squares = np.einsum("kn,kn->k", samples, samples) - (sums**2).sum(axis=1) / count
    norms = np.sqrt(np.maximum(squares, 0.0) * (template**2).sum())
    with np.errstate(divide="ignore", invalid="ignore"):
        scores = np.where(norms > 0, samples @ template.ravel() / norms, -1.0)
    best = int(np.argmax(scores))
    if best in (0, 2 * reach) or scores[best] < 0.65 * _MIN_CORRELATION:
        return None
    return int(candidates[best])


def _least_squares(
    pixels: ConePixels, right: NDArray[np.uint8], start: float, at_infinity_px: float, row_offset_px: float
) -> AreaMatch | None:
    """Gauss-Newton on disparity and row offset; gain and offset of each colour are taken out in every step."""
    beyond = pixels.beyond
    reach = np.concatenate(
        [part.columns - at_infinity_px - (start - at_infinity_px) / part.depth for part in (pixels, beyond)]
    )
    patch = SplinePatch.of(
        right, pixels.rows[0] + row_offset_px - _MAX_ROW_OFFSET_PX, pixels.rows[-1] + row_offset_px + _MAX_ROW_OFFSET_PX,
        reach.min() - _MAX_WAY_PX, reach.max() + _MAX_WAY_PX,
    )  # fmt: skip
    if patch is None:
        return None
    # Disparity of the axis at the foot, row offset, lean of the axis, surplus of the surface's nearness, shift of either edge.
    unknown = np.array([start, row_offset_px, 0.0, 0.0, 0.0, 0.0])
    weights, size = np.ones(len(pixels.rows)), np.zeros(len(pixels.rows))
    background = np.zeros_like(beyond.values[:, 0])
    for iteration in range(_MAX_ITERATIONS):
        disparity, down, lean, surplus = unknown[:4]
        if abs(disparity - start) > _MAX_WAY_PX or abs(down - row_offset_px) > _MAX_ROW_OFFSET_PX:
            return None
        scale = disparity - at_infinity_px
        depth = pixels.depth + lean * pixels.height - surplus * pixels.nearer
        columns = pixels.columns - at_infinity_px - scale / depth - pixels.at_edge @ unknown[4:]
        # The background stays as it is from half way on: it may follow the disparity to and fro.
        looks = iteration < _MAX_ITERATIONS // 2
        beside = beyond.columns - at_infinity_px - scale / beyond.depth
        sample, slope_u, slope_v = (
            patch.at(np.concatenate([pixels.rows, beyond.rows]), np.concatenate([columns, beside]), down)
            if looks
            else patch.at(pixels.rows, columns, down)
        )
        seen = sample[len(columns) :]
        sample, slope_u, slope_v = sample[: len(columns)], slope_u[: len(columns)], slope_v[: len(columns)]
        inverse = 1 / depth
        slant = scale * inverse * inverse
        along = np.empty((5, len(depth)))
        along[0], along[1], along[2] = -inverse, slant * pixels.height, -slant * pixels.nearer
        along[3:] = -pixels.at_edge.T
        slopes = _by_unknown(along.T, slope_u, slope_v)
        values = pixels.values + pixels.cover[:, None] * background[pixels.edge]
        step_of = _linearise(values, sample, slopes, unknown, weights)
        if step_of is None:
            return None
        move = np.clip(step_of.inverse @ step_of.pull, -0.7, 0.7)
        unknown = unknown + move
        size = np.sqrt(step_of.residual**2 @ (1 / step_of.noise) / len(step_of.noise))
        size /= max(1.2 * median(size), 1e-6)
        settled = bool(np.abs(move[:2]).max() < _CONVERGED_PX)
        if settled and iteration >= _SOFT_ITERATIONS + 2:
            break
        weights = (
            1 / np.maximum(size / _HUBER, 1.0) if iteration < _SOFT_ITERATIONS else (1 + (size / _OUTLIER) ** 2) ** -2
        )
        if looks:
            seen = step_of.gain * seen.reshape(beyond.values.shape) + step_of.shift
            background = _background(seen - beyond.values, step_of.noise)
    else:
        return None
    if step_of.correlation < _MIN_CORRELATION or np.mean(size < 2 * _HUBER) < _MIN_INLIER_SHARE:
        return None
    cov = matching_cov(
        step_of.jacobian, step_of.residual, step_of.noise, weights, step_of.normal, _by_unknown(along.T, *pixels.slopes),
        place=(pixels.rows, pixels.columns), prior=_DESIGN_EFFECT * _PRIOR, prior_variance=_PRIOR_VARIANCE,
    )  # fmt: skip
    sigma = np.hypot(cov[0, 0] ** 0.5, SHARED_DISPARITY_PX)
    return AreaMatch(float(unknown[0]), float(sigma), step_of.correlation, float(unknown[1]))


def _by_unknown(along: Floats, slope_u: Floats, slope_v: Floats) -> Floats:
    """(6, n, channels): how grey values change with each unknown, from their slopes (n, channels) along columns and rows.

    along (n, 5): how the column changes with the unknowns but the row offset, which comes second.
    """
    slopes = np.empty((slope_u.shape[1], 6, len(along)))
    slopes[:, 0], slopes[:, 1] = along[:, 0] * slope_u.T, slope_v.T
    np.multiply(along.T[1:], slope_u.T[:, None], out=slopes[:, 2:])
    return slopes.transpose(1, 2, 0)


def _background(change: Floats, noise: Floats) -> Floats:
    """(e, channels): how much the background changes between the images at e edges, as far as it can be told from beside them.

    change (e, 2, channels): at the two points beyond each edge; edges left and right in turn, row by row. noise (channels,).
    Beside a far cone a pixel is a large piece of the world, and what is seen two pixels off says little of the edge: where the
    change differs from pixel to pixel, across the rows or along them, it is believed the less.
    """
    mean = (change[:, 0] + change[:, 1]) / 2
    rows = mean.reshape(-1, 2, mean.shape[1])
    share = 1 / (noise * len(noise))
    steps = (rows[1:] - rows[:-1]) ** 2 @ share
    along = np.zeros(rows.shape[:2])
    along[1:] += steps
    along[:-1] += steps
    along[1:-1] /= 2
    across = (change[:, 0] - change[:, 1]) ** 2 @ share
    power = mean**2 @ share
    unsure = _BACKGROUND_NOISE + _BACKGROUND_WAY_PX * (across + along.ravel())
    return np.asarray(mean * (power / (power + unsure))[:, None])


class _Linearised(NamedTuple):
    """The matching problem at one point; gain and offset of each colour eliminated."""

    centred: Floats
    """(channels, 2 + p, n): left and right grey values and slopes, less their means"""
    along: Floats
    """(channels, p): how much of the right grey values is in each slope"""
    residual: Floats
    """(n, channels)"""
    noise: Floats
    """(channels,) variance of the residuals"""
    inverse: Floats
    """(p, p) of the normal matrix, what is known beforehand included"""
    normal: Floats
    """(p, p) of the images alone, were the residuals white"""
    pull: Floats
    """(p,)"""
    correlation: float
    gain: Floats
    """(channels,) left over right"""
    shift: Floats
    """(channels,) left less gain times right"""

    @property
    def jacobian(self) -> Floats:
        """(n, channels, p) of the modelled grey values, gain and offset eliminated; only sigma asks for it."""
        free = self.centred[:, 2:] - self.along[:, :, None] * self.centred[:, 1:2]
        return np.asarray((free * self.gain[:, None, None]).transpose(2, 0, 1))


def _linearise(values: Floats, sample: Floats, slopes: Floats, unknown: Floats, weights: Floats) -> _Linearised | None:
    """None where the right image has nothing to hold on to, or is the negative of the left one.

    values, sample (n, channels): grey values left and right. slopes (p, n, channels): of the sample with respect to the unknowns.
    """
    total = weights.sum()
    # Colour by colour in memory, so that the products below are those of the linear algebra library.
    every = np.empty((values.shape[1], 2 + len(slopes), len(values)))
    every[:, 0], every[:, 1], every[:, 2:] = values.T, sample.T, slopes.transpose(2, 0, 1)
    means = every @ weights / total
    every -= means[:, :, None]
    # Of each colour the inner products of template, sample and slopes: all that least squares needs.
    gram = (every * weights) @ every.transpose(0, 2, 1)
    tt, ts, ss = gram[:, 0, 0], gram[:, 0, 1], gram[:, 1, 1]
    if (ss <= 1e-6 * total).any() or (tt <= 1e-6 * total).any():
        return None
    gain = ts / ss
    if (gain <= 0).all():
        return None
    noise = np.maximum((tt - gain * ts) / total, _QUANTISATION)
    along = gram[:, 2:, 1] / ss[:, None]  # (channels, p)
    square = gram[:, 2:, 2:] - along[:, :, None] * gram[:, None, 2:, 1]
    normal = (gain**2 / noise @ square.reshape(len(gain), -1)).reshape(square.shape[1:])
    pull = (gain / noise) @ (gram[:, 2:, 0] - along * ts[:, None]) - _DESIGN_EFFECT * _PRIOR * unknown
    if not normal[0, 0] * normal[1, 1] - normal[0, 1] ** 2 > 1e-9 * normal[0, 0] * normal[1, 1]:
        return None
    inverse = np.linalg.inv(normal + _PRIOR_NORMAL)
    correlation = float((ts / noise).sum() / np.sqrt((tt / noise).sum() * (ss / noise).sum()))
    residual = (every[:, 0] - gain[:, None] * every[:, 1]).T
    shift = means[:, 0] - gain * means[:, 1]
    return _Linearised(every, along, residual, noise, inverse, normal, pull, correlation, gain, shift)
