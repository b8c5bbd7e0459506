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
    height, width = image.shape[0] // _SHRINK, image.shape[1] // _SHRINK
    if min(height, width) < _SQUARE:
        return 0.0
    green = cv2.resize(np.ascontiguousarray(image[..., 1]), (width, height), interpolation=cv2.INTER_AREA).astype(
        np.float32
    )
    fine = green - cv2.GaussianBlur(green, (0, 0), _SIGMA)
    squares = cv2.resize(fine * fine, (width // _SQUARE, height // _SQUARE), interpolation=cv2.INTER_AREA)
    return float(np.sqrt(np.median(squares)))
