"""Area-based least-squares matching of one object between the left and the right rectified image.

Boxes are loose by a pixel or more; matching grey values determines the disparity to a twentieth of a pixel. A normalised
cross-correlation over whole pixels is followed by least-squares matching (Ackermann 1984; Gruen 1985) by Gauss-Newton, with
gain and offset per colour.

The left image is matched along the disparity *surface* of an upright body of revolution (`cone_outline.py`, `cone_pixels.py`);
of flat objects along a plane (`plate_pixels.py`); the result is the disparity of its axis at the foot. Lean of the cone,
nearness of its surface and shift of each edge are unknowns with priors, so that sigma contains their effect. Sigma is that of
the residuals under slopes common to both images (`covariance.py`).

Only pixels of the body and its edges are used. The background mixed into the edges by blur differs between the images: its
change is measured just beyond the edge and subtracted. Both images are blurred alike by the B-spline of the interpolation,
which avoids a bias to half pixels. Outliers (objects in front) are down-weighted.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from conetl.geometry.small_arrays import upper_median
from conetl.model.arrays import Floats, Image
from conetl.model.rig import Camera
from conetl.tracking.matching.cone_outline import Outline
from conetl.tracking.matching.cone_pixels import BodyPixels, SplinePatch, cone_pixels
from conetl.tracking.matching.covariance import SHARED_DISPARITY_PX, matching_cov
from conetl.tracking.matching.plate_pixels import Plate, plate_pixels

_MIN_CORRELATION = 0.75
_MAX_ITERATIONS = 24
_CONVERGED_PX = 2e-2
#: Largest change of the disparity from the best whole-pixel value.
_MAX_WAY_PX = 2.0
_MAX_ROW_OFFSET_PX = 1.5
_MIN_INLIER_SHARE = 0.6
#: Huber limit of residuals, in units of the usual one, in the first iterations (Huber 1964), and the scale of the final
#: weights, under which outliers count nothing (Geman & McClure 1985).
_HUBER, _OUTLIER = 2.0, 3.0
_SOFT_ITERATIONS = 3
#: A change of background has half weight where its square is this many times its variance: noise, plus a random walk over so
#: many pixels from the sampled point to the edge.
_BACKGROUND_NOISE, _BACKGROUND_WAY_PX = 3.0, 2.5
#: Variance of grey values by rounding to 8 bits in both images.
_QUANTISATION = 0.17
#: Priors, one sigma: lean of the cone towards the camera (rad), nearness of its surface (share), and shift of an edge by the
#: background (px). None for disparity and row offset.
_LEAN_SIGMA, _SURPLUS_SIGMA, _SHIFT_SIGMA_PX = 0.015, 0.05, 0.08
_PRIOR = np.array([0.0, 0.0, _LEAN_SIGMA**-2, _SURPLUS_SIGMA**-2, _SHIFT_SIGMA_PX**-2, _SHIFT_SIGMA_PX**-2])
#: Weight of the priors against grey values: variance over that of white noise.
_DESIGN_EFFECT = 15.0
_PRIOR_NORMAL = _DESIGN_EFFECT * np.diag(_PRIOR)
#: Variances of lean, surplus and shifts used for sigma, in the order of the unknowns.
_PRIOR_VARIANCE = np.array([0.0, 0.0, 0.010**2, 0.033**2, 0.033**2, 0.033**2])


class AreaMatch(NamedTuple):
    """Result of `match_area`."""

    disparity_px: float
    """Of the cone's axis at its foot: left column minus right column."""
    sigma_px: float
    """Standard deviation of the disparity."""
    correlation: float


def match_area(
    left: Image,
    right: Image,
    outline: Outline | Plate,
    disparity_px: float,
    search_px: float,
    *,
    camera: Camera,
    up: Floats,
    at_infinity_px: float = 0.0,
    row_offset_px: float = 0.0,
) -> AreaMatch | None:
    """Disparity of the object with `outline` in the left image, or None if the images do not determine it.

    left, right: rectified images, (H, W, 3) or (H, W), uint8. disparity_px: first guess; search_px: half width of the search.
    camera: the left one. up: unit vector (3,) in its frame (x right, y down, z forward). at_infinity_px: disparity of a point
    at infinity. row_offset_px: how much lower points are in the right image by calibration.
    """
    if left.ndim == 2:
        left, right = left[:, :, None], right[:, :, None]
    pixels = body_pixels(left, outline, camera, up)
    if pixels is None:
        return None
    coarse = whole_pixel_disparity(pixels, right, disparity_px, search_px, at_infinity_px, round(row_offset_px))
    if coarse is None:
        return None
    return least_squares(pixels, right, float(coarse), at_infinity_px, row_offset_px)


def body_pixels(image: Image, outline: Outline | Plate, camera: Camera, up: Floats) -> BodyPixels | None:
    """The pixels of an object in its image (H, W, C); None if there are too few. camera: its camera; up: as for `match_area`."""
    if isinstance(outline, Plate):
        return plate_pixels(image, outline, camera, up)
    return cone_pixels(image, outline, camera, up)


def whole_pixel_disparity(
    pixels: BodyPixels,
    right: Image,
    guess: float,
    search_px: float,
    at_infinity_px: float,
    row_offset: int,
    lead: tuple[float, float] | None = None,
) -> int | None:
    """Best whole-pixel disparity; None at the limit of the search, below the threshold, outside the image, or without a lead.

    lead: by how much its correlation must exceed those at disparities that differ by more than so many px. Others: as for
    `match_area`.
    """
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
    # Sums of squares about the mean, exact because the grey values are whole numbers.
    sums = samples.reshape(len(candidates), count, channels).sum(axis=1)
    squares = np.einsum("kn,kn->k", samples, samples) - (sums**2).sum(axis=1) / count
    norms = np.sqrt(np.maximum(squares, 0.0) * (template**2).sum())
    with np.errstate(divide="ignore", invalid="ignore"):
        scores = np.where(norms > 0, samples @ template.ravel() / norms, -1.0)
    best = int(np.argmax(scores))
    if best in (0, 2 * reach) or scores[best] < 0.65 * _MIN_CORRELATION:
        return None
    if lead is not None:
        others = scores[np.abs(candidates - candidates[best]) > lead[1]]
        if others.max(initial=-1.0) > scores[best] - lead[0]:
            return None
    return int(candidates[best])


def least_squares(
    pixels: BodyPixels, right: Image, start: float, at_infinity_px: float, row_offset_px: float
) -> AreaMatch | None:
    """Gauss-Newton on all unknowns from a whole-pixel disparity; gain and offset of each colour are eliminated in every step."""
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
    background = np.zeros((max(len(beyond.values), 1), pixels.values.shape[1]))
    for iteration in range(_MAX_ITERATIONS):
        disparity, down, lean, surplus = unknown[:4]
        if abs(disparity - start) > _MAX_WAY_PX or abs(down - row_offset_px) > _MAX_ROW_OFFSET_PX:
            return None
        scale = disparity - at_infinity_px
        depth = pixels.depth + lean * pixels.height - surplus * pixels.nearer
        columns = pixels.columns - at_infinity_px - scale / depth - pixels.at_edge @ unknown[4:]
        # The background is fixed in the second half: otherwise it may oscillate with the disparity.
        sample_background = len(beyond.values) > 0 and iteration < _MAX_ITERATIONS // 2
        beside = beyond.columns - at_infinity_px - scale / beyond.depth
        sample, slope_u, slope_v = (
            patch.at(np.concatenate([pixels.rows, beyond.rows]), np.concatenate([columns, beside]), down)
            if sample_background
            else patch.at(pixels.rows, columns, down)
        )
        behind = sample[len(columns) :]
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
        size /= max(1.2 * upper_median(size), 1e-6)
        settled = bool(np.abs(move[:2]).max() < _CONVERGED_PX)
        if settled and iteration >= _SOFT_ITERATIONS + 2:
            break
        weights = (
            1 / np.maximum(size / _HUBER, 1.0) if iteration < _SOFT_ITERATIONS else (1 + (size / _OUTLIER) ** 2) ** -2
        )
        if sample_background:
            behind = step_of.gain * behind.reshape(beyond.values.shape) + step_of.shift
            background = _background(behind - beyond.values, step_of.noise)
    else:
        return None
    if step_of.correlation < _MIN_CORRELATION or np.mean(size < 2 * _HUBER) < _MIN_INLIER_SHARE:
        return None
    cov = matching_cov(
        step_of.jacobian, step_of.residual, step_of.noise, weights, step_of.normal, _by_unknown(along.T, *pixels.slopes),
        place=(pixels.rows, pixels.columns), prior=_DESIGN_EFFECT * _PRIOR, prior_variance=_PRIOR_VARIANCE,
    )  # fmt: skip
    sigma = np.hypot(cov[0, 0] ** 0.5, SHARED_DISPARITY_PX)
    return AreaMatch(float(unknown[0]), float(sigma), step_of.correlation)


def _by_unknown(along: Floats, slope_u: Floats, slope_v: Floats) -> Floats:
    """(6, n, channels): derivatives of grey values by the unknowns, from their slopes (n, channels) along columns and rows.

    along (n, 5): derivatives of the column by all unknowns but the row offset, which is the second one.
    """
    slopes = np.empty((slope_u.shape[1], 6, len(along)))
    slopes[:, 0], slopes[:, 1] = along[:, 0] * slope_u.T, slope_v.T
    np.multiply(along.T[1:], slope_u.T[:, None], out=slopes[:, 2:])
    return slopes.transpose(1, 2, 0)


def _background(change: Floats, noise: Floats) -> Floats:
    """(e, channels): change of the background between the images at e edges.

    change (e, 2, channels): at the two points beyond each edge; edges left and right in turn, row by row. noise (channels,).
    Beside a far cone two pixels are a large distance: where the change varies between pixels, across or along the rows, it has
    less weight.
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
    """(p, p) of the normal matrix with priors"""
    normal: Floats
    """(p, p) of the images alone, for white residuals"""
    pull: Floats
    """(p,)"""
    correlation: float
    gain: Floats
    """(channels,) left over right"""
    shift: Floats
    """(channels,) left less gain times right"""

    @property
    def jacobian(self) -> Floats:
        """(n, channels, p) of the modelled grey values, gain and offset eliminated; for sigma only."""
        free = self.centred[:, 2:] - self.along[:, :, None] * self.centred[:, 1:2]
        return np.asarray((free * self.gain[:, None, None]).transpose(2, 0, 1))


def _linearise(values: Floats, sample: Floats, slopes: Floats, unknown: Floats, weights: Floats) -> _Linearised | None:
    """None if the right image has no contrast, or is the negative of the left one.

    values, sample (n, channels): grey values left and right. slopes (p, n, channels): of the sample by the unknowns.
    """
    total = weights.sum()
    # Colour by colour in memory, so that the products below are done by BLAS.
    stacked = np.empty((values.shape[1], 2 + len(slopes), len(values)))
    stacked[:, 0], stacked[:, 1], stacked[:, 2:] = values.T, sample.T, slopes.transpose(2, 0, 1)
    means = stacked @ weights / total
    stacked -= means[:, :, None]
    # Per colour the inner products of template, sample and slopes, all that least squares needs.
    gram = (stacked * weights) @ stacked.transpose(0, 2, 1)
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
    correlation = min(
        float((ts / noise).sum() / np.sqrt((tt / noise).sum() * (ss / noise).sum())), 1.0
    )  # but for rounding
    residual = (stacked[:, 0] - gain[:, None] * stacked[:, 1]).T
    shift = means[:, 0] - gain * means[:, 1]
    return _Linearised(stacked, along, residual, noise, inverse, normal, pull, correlation, gain, shift)
