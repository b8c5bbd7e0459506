"""A part of a picture, blurred and interpolated by cubic B-splines (Unser 1999), with its slopes.

The grey values themselves serve as coefficients: that blurs by 0.58 px (sigma) at every sub-pixel place alike. An interpolating
spline passes noise whole at whole pixels and half of it between them, and matching then prefers the places between.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.intp]


class SplinePatch(NamedTuple):
    """Cubic B-spline coefficients of a part of a picture."""

    coefficients: Floats
    """(rows, columns, channels)"""
    row0: int
    column0: int

    @staticmethod
    def of(picture: NDArray[np.uint8], row0: float, row1: float, column0: float, column1: float) -> SplinePatch | None:
        """The part that holds rows and columns between two ends; None where it would leave the picture at the sides."""
        first, last = int(np.floor(column0)) - 2, int(np.floor(column1)) + 4
        if first < 0 or last > picture.shape[1]:
            return None
        top = int(np.floor(row0)) - 2
        rows = np.clip(np.arange(top, int(np.floor(row1)) + 4), 0, picture.shape[0] - 1)
        return SplinePatch(picture[rows, first:last].astype(np.float64), top, first)

    def at(self, rows: Ints, columns: Floats, down_px: float) -> tuple[Floats, Floats, Floats]:
        """Grey values and their slopes along columns and rows, each (n, channels), at rows + down_px and columns."""
        height, width, channels = self.coefficients.shape
        whole = int(np.floor(down_px))
        value_v, slope_v = _weights(np.array(down_px - whole))
        # All pixels have the same part of a row to go: blend whole rows first, then only four columns are left for each pixel.
        blend = np.zeros((height - 3, width, channels, 2))
        for k in range(4):
            part = self.coefficients[k : height - 3 + k]
            blend[..., 0] += value_v[k] * part
            blend[..., 1] += slope_v[k] * part
        blend = blend.reshape(-1, 2 * channels)
        base = np.floor(columns).astype(np.intp)
        value_u, slope_u = _weights(columns - base)
        top = np.clip(rows + whole - 1 - self.row0, 0, height - 4)
        first = top * width + np.clip(base - 1 - self.column0, 0, width - 4)
        picked = blend[first[:, None] + np.arange(4)]  # (n, 4, 2 * channels): value and slope down, colour by colour
        both = np.einsum("kn,nkc->nc", value_u, picked)
        along = np.einsum("kn,nkc->nc", slope_u, picked[:, :, 0::2])
        return both[:, 0::2], along, both[:, 1::2]


def _weights(part: Floats) -> tuple[Floats, Floats]:
    """Cubic B-spline weights (4, ...) of the four neighbours of a point, and their derivatives; part: 0..1 past the second."""
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
