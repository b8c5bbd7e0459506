"""Area-based least-squares matching of one cone between the left and the right rectified image.

A box from a network is loose by a pixel or more; range lives on the difference of two such boxes. Matching the grey values
themselves fixes the disparity to a tenth of a pixel. First a normalised cross-correlation over whole pixels, then least-squares
matching (Ackermann 1984; Gruen 1985) with a shift along the row, a gain and an offset. Only pixels inside the cone's
silhouette count, so that a far cone is not pulled by what stands behind it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_MIN_PIXELS = 24
_MIN_CORRELATION = 0.6
_MAX_ITERATIONS = 12
_CONVERGED_PX = 1e-3
#: Least-squares matching knows only noise, not slant, reflections or the other cheek of the cone; figures below this are
#: not to be believed (residuals of the sample drives, see docs/accuracy.md).
_SIGMA_FLOOR_PX = 0.10


@dataclass(frozen=True)
class AreaMatch:
    """Result of `match_area`."""

    disparity_px: float
    sigma_px: float
    """Standard deviation of the disparity."""
    correlation: float


def silhouette_mask(height_px: int, width_px: int) -> NDArray[np.bool_]:
    """Pixels (height, width) of a box that a standing cone covers: a plate at the foot, above it a taper to a blunt tip."""
    rows = (np.arange(height_px) + 0.5) / height_px
    half_width = np.where(rows > 0.9, 0.5, 0.09 + 0.27 * rows)
    columns = np.abs((np.arange(width_px) + 0.5) / width_px - 0.5)
    return np.asarray(columns[None, :] <= half_width[:, None])


def match_area(
    left: NDArray[np.uint8],
    right: NDArray[np.uint8],
    box: tuple[float, float, float, float],
    disparity_px: float,
    search_px: float,
) -> AreaMatch | None:
    """Disparity of the cone in `box` of the left image, or None where the pictures do not settle it.

    left, right: rectified images, (H, W, 3) or (H, W), uint8. box: x, y, width, height in the left image (px).
    disparity_px: first guess (left column minus right column). search_px: half width of the search.
    """
    x0, y0 = int(np.floor(box[0])), int(np.floor(box[1]))
    width, height = int(np.ceil(box[2])), int(np.ceil(box[3]))
    image_height, image_width = left.shape[:2]
    x1, y1 = min(x0 + width, image_width), min(y0 + height, image_height)
    x0, y0 = max(x0, 0), max(y0, 0)
    if x1 - x0 < 4 or y1 - y0 < 6:
        return None
    mask = silhouette_mask(y1 - y0, x1 - x0)
    if int(mask.sum()) < _MIN_PIXELS:
        return None
    reach = int(np.ceil(search_px)) + 2
    shift0 = round(disparity_px)
    strip_x0, strip_x1 = x0 - shift0 - reach, x1 - shift0 + reach
    if strip_x0 < 0 or strip_x1 > image_width:
        return None
    patch = _grey(left[y0:y1, x0:x1])
    strip = _grey(right[y0:y1, strip_x0:strip_x1])
    best = _whole_pixel_shift(patch, strip, mask, reach)
    if best is None:
        return None
    column, _ = best
    fine = _least_squares_shift(patch, strip, mask, float(column))
    if fine is None:
        return None
    column_fine, sigma, correlation = fine
    if abs(column_fine - column) > 1.0:
        return None
    return AreaMatch(shift0 + reach - column_fine, max(sigma, _SIGMA_FLOOR_PX), correlation)


def _grey(pixels: NDArray[np.uint8]) -> Floats:
    values = pixels.astype(np.float64)
    return np.asarray(values.mean(axis=2)) if values.ndim == 3 else values


def _whole_pixel_shift(patch: Floats, strip: Floats, mask: NDArray[np.bool_], reach: int) -> tuple[int, float] | None:
    """Column of the strip at which the patch fits best, and the correlation there; None on the border or below the bar."""
    width = patch.shape[1]
    windows = np.lib.stride_tricks.sliding_window_view(strip, width, axis=1)  # (h, n, w)
    candidates = windows.transpose(1, 0, 2)[:, mask]  # (n, pixels)
    template = patch[mask] - patch[mask].mean()
    centred = candidates - candidates.mean(axis=1, keepdims=True)
    norms = np.linalg.norm(centred, axis=1) * np.linalg.norm(template)
    with np.errstate(divide="ignore", invalid="ignore"):
        scores = np.where(norms > 0, centred @ template / norms, -1.0)
    best = int(np.argmax(scores))
    if best in (0, 2 * reach) or scores[best] < _MIN_CORRELATION:
        return None
    return best, float(scores[best])


def _least_squares_shift(
    patch: Floats, strip: Floats, mask: NDArray[np.bool_], column: float
) -> tuple[float, float, float] | None:
    """Sub-pixel column, its sigma and the final correlation, by Gauss-Newton on shift, gain and offset."""
    rows, columns = np.nonzero(mask)
    template = patch[rows, columns]
    gradient_strip = np.gradient(strip, axis=1)
    for _ in range(_MAX_ITERATIONS):
        sample = _interpolate(strip, rows, columns.astype(np.float64) + column)
        slope = _interpolate(gradient_strip, rows, columns.astype(np.float64) + column)
        if sample is None or slope is None:
            return None
        # template = gain * strip(x + shift) + offset, linear in gain and offset, linearised in shift
        design = np.column_stack([sample, np.ones_like(sample)])
        (gain, offset), *_ = np.linalg.lstsq(design, template, rcond=None)
        if gain <= 0.2:
            return None
        jacobian = np.column_stack([gain * slope, sample, np.ones_like(sample)])
        residual = template - (gain * sample + offset)
        normal = jacobian.T @ jacobian
        try:
            inverse = np.linalg.inv(normal)
        except np.linalg.LinAlgError:
            return None
        step = float((inverse @ (jacobian.T @ residual))[0])
        column += float(np.clip(step, -0.7, 0.7))
        if abs(step) < _CONVERGED_PX:
            freedom = max(len(residual) - 3, 1)
            # Grey values of neighbours are correlated by optics and demosaicing: about one in four is independent.
            sigma = 2.0 * float(np.sqrt(residual @ residual / freedom * inverse[0, 0]))
            spread = float(np.std(template) * np.std(sample))
            if spread == 0:
                return None
            correlation = float(np.mean((template - template.mean()) * (sample - sample.mean())) / spread)
            return (column, sigma, correlation) if correlation >= _MIN_CORRELATION else None
    return None


def _interpolate(image: Floats, rows: NDArray[np.intp], columns: Floats) -> Floats | None:
    """Linear interpolation along rows; None when a sample falls outside."""
    base = np.floor(columns).astype(np.intp)
    if base.min() < 0 or base.max() + 1 >= image.shape[1]:
        return None
    part = columns - base
    return np.asarray((1 - part) * image[rows, base] + part * image[rows, base + 1])
