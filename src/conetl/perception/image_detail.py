"""How much fine structure an image shows: what a covered lens, the dark, fog and blur take away before the detector is blind.

The measure is the standard deviation of what is finer than about 25 pixels, in grey levels, at a quarter of the resolution (where
noise of single pixels is averaged away), in the median over squares of 32 pixels. Images of the sample drives and of a real
street have 7.7 and more (docs/explanation/changes.md has what degraded ones have, and what the detector finds in them).
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

_SHRINK, _SQUARE, _SIGMA = 4, 8, 1.5


def fine_detail(image: NDArray[np.uint8]) -> float:
    """Grey levels; image: (H, W, 3) in blue, green, red. 0 for an image smaller than 32 pixels."""
    squares = _squares(np.ascontiguousarray(image[..., 1]))
    return float(np.sqrt(np.median(squares))) if squares.size else 0.0


def local_detail(image: NDArray[np.uint8]) -> NDArray[np.float32]:
    """(H // 32, W // 32) the same for every square of 32 pixels; image: (H, W) grey."""
    return np.sqrt(_squares(image))


def _squares(image: NDArray[np.uint8]) -> NDArray[np.float32]:
    """(H // 32, W // 32) variance of the fine structure of every square; image: (H, W)."""
    height, width = image.shape[0] // _SHRINK, image.shape[1] // _SHRINK
    if min(height, width) < _SQUARE:
        return np.empty((0, 0), np.float32)
    small = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA).astype(np.float32)
    fine = small - cv2.GaussianBlur(small, (0, 0), _SIGMA)
    squares = cv2.resize(fine * fine, (width // _SQUARE, height // _SQUARE), interpolation=cv2.INTER_AREA)
    return np.asarray(squares, np.float32)
