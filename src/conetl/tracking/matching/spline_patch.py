"""A part of an image, blurred and interpolated by cubic B-splines (Unser 1999), with its slopes.

The grey values themselves are the coefficients: that blurs by 0.58 px (sigma) at every sub-pixel position alike. An
interpolating spline passes all noise at whole pixels and half of it between them, which biases matching towards half pixels.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.intp]


class SplinePatch(NamedTuple):
    """Cubic B-spline coefficients of a part of an image."""

    rows_of_four: Floats
    """(4, channels * rows * columns): in [k] the coefficients from row k on, colour by colour, so that interpolation across the
    rows is one product with (4,) weights."""
    shape: tuple[int, int, int]
    """channels, rows (three fewer than were cut out), columns"""
    row0: int
    column0: int

    @staticmethod
    def of(image: NDArray[np.uint8], row0: float, row1: float, column0: float, column1: float) -> SplinePatch | None:
        """The part with rows and columns between two limits; None if it would leave the image at the sides."""
        first, last = int(np.floor(column0)) - 2, int(np.floor(column1)) + 4
        if first < 0 or last > image.shape[1]:
            return None
        top = int(np.floor(row0)) - 2
        rows = np.arange(top, int(np.floor(row1)) + 4)
        if top < 0 or rows[-1] >= image.shape[0]:
            rows = np.clip(rows, 0, image.shape[0] - 1)
        by_colour = image[rows, first:last].transpose(2, 0, 1).astype(np.float64)
        channels, count = by_colour.shape[0], len(rows) - 3
        rows_of_four = np.stack([by_colour[:, k : k + count].ravel() for k in range(4)])
        return SplinePatch(rows_of_four, (channels, count, last - first), top, first)

    def at(self, rows: Ints, columns: Floats, down_px: float) -> tuple[Floats, Floats, Floats]:
        """Grey values and their slopes along columns and rows, each (n, channels), at rows + down_px and columns.

        In memory they are ordered colour by colour, as least squares reads them.
        """
        channels, height, width = self.shape
        whole = int(np.floor(down_px))
        # All pixels have the same fraction of a row: interpolate whole rows first, then four columns per pixel.
        down = np.stack(_weights(np.array(down_px - whole)))
        blend = (down @ self.rows_of_four).reshape(2 * channels, height * width)
        base = np.floor(columns)
        value_u, slope_u = _weights(columns - base)
        top = np.minimum(np.maximum(rows + (whole - 1 - self.row0), 0), height - 1)
        first = np.minimum(np.maximum(base.astype(np.intp) - (1 + self.column0), 0), width - 4)
        first += top * width
        picked = blend.take(first + np.arange(4)[:, None], axis=1)  # (2 * channels, 4, n): values, then slopes down
        along = (picked[:channels] * slope_u).sum(axis=1)
        both = (picked * value_u).sum(axis=1)
        return both[:channels].T, along.T, both[channels:].T


def _weights(part: Floats) -> tuple[Floats, Floats]:
    """Cubic B-spline weights (4, ...) of the four neighbours of a point, and their derivatives; part: 0..1 after the second."""
    t, rest = part, 1 - part
    t2, rest2 = t * t, rest * rest
    value, slope = np.empty((4, *part.shape)), np.empty((4, *part.shape))
    value[0], value[3] = rest2 * rest / 6, t2 * t / 6
    value[1] = 2 / 3 - t2 + t2 * t / 2
    value[2] = 1 - value[0] - value[1] - value[3]
    slope[0], slope[3] = -rest2 / 2, t2 / 2
    slope[1] = 1.5 * t2 - 2 * t
    slope[2] = -slope[0] - slope[1] - slope[3]
    return value, slope
