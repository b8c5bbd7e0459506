"""Fine structure of an image: covered lenses, darkness, fog and blur reduce it before the detector stops finding objects.

The measure is the standard deviation of what is finer than about 25 pixels, in grey levels, at a quarter of the resolution (where
noise of single pixels is averaged away), in the median over squares of 32 pixels. Images of the sample drives and of a real
street have 7.7 and more (benchmarks/RESULTS.md has what degraded ones have, and what the detector finds in them).
"""

from __future__ import annotations

from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from conetl.geometry.small_arrays import upper_median
from conetl.perception.working_size import half_size

#: Images are shrunk by halving them twice.
_SHRINK, _SQUARE, _SIGMA = 4, 8, 1.5
#: Side of the squares in which sharpness is compared, px.
SQUARE_PX = 64
#: Blocks of JPEG, px, and below which share they hide what is inside: 0.7 to 0.9 in good images, 0.3 to 0.46 at quality 10,
#: 0.22 to 0.32 at quality 5, 0.11 to 0.2 at quality 2, of which the detector finds no cone.
_BLOCK, _LEAST_INSIDE = 8, 0.25


def fine_detail(image: NDArray[np.uint8]) -> float:
    """Grey levels; image: (H, W, 3) in blue, green, red. 0 for one smaller than 32 pixels, or that shows only JPEG blocks."""
    green = np.asarray(cv2.extractChannel(image, 1), np.uint8)
    if _inside_blocks(green[::_SHRINK]) < _LEAST_INSIDE:
        return 0.0
    squares = _squares(green)
    return upper_median(squares.ravel()) ** 0.5 if squares.size else 0.0


def local_detail(image: NDArray[np.uint8]) -> NDArray[np.float32]:
    """(H // 32, W // 32): as `fine_detail`, for every square of 32 pixels; image: (H, W) grey."""
    return np.sqrt(_squares(image))


def detail_by_octaves(image: NDArray[np.uint8]) -> NDArray[np.float32]:
    """(2, H // 64, W // 64) variance of what is finer than about 25 px, and of what is from there to 75 px, in squares of 64 px
    (`SQUARE_PX`); image: (H, W) grey.

    Blur removes the former, not the latter.
    """
    squares = image.shape[0] // SQUARE_PX, image.shape[1] // SQUARE_PX
    if min(squares) < 1:
        return np.empty((2, 0, 0), np.float32)
    small = half_size(half_size(image)).astype(np.float32)
    levels = small, cv2.GaussianBlur(small, (0, 0), _SIGMA), cv2.GaussianBlur(small, (0, 0), 3 * _SIGMA)
    own = SQUARE_PX // _SHRINK
    used = np.s_[: squares[0] * own, : squares[1] * own]
    energies = [cv2.GaussianBlur((fine - coarse) ** 2, (0, 0), own / 2) for fine, coarse in pairwise(levels)]
    return np.stack([cv2.resize(e[used], squares[::-1], interpolation=cv2.INTER_AREA) for e in energies])


def _inside_blocks(image: NDArray[np.uint8]) -> float:
    """Mean difference of neighbours inside the blocks of JPEG over that between them; 1 without blocks. image: (H, W)."""
    if image.shape[1] <= _BLOCK:
        return 1.0
    steps = cv2.reduce(cv2.absdiff(image[:, 1:], image[:, :-1]), 0, cv2.REDUCE_SUM, dtype=cv2.CV_32S)[0]
    between = np.arange(1, image.shape[1]) % _BLOCK == 0
    inside, across = (float(steps[those].sum() / (those.sum() * len(image))) for those in (~between, between))
    return inside / across if across > 0 else 1.0


def _squares(image: NDArray[np.uint8]) -> NDArray[np.float32]:
    """(H // 32, W // 32) variance of the fine structure of every square; image: (H, W)."""
    height, width = (size // _SHRINK // _SQUARE for size in image.shape)
    if min(height, width) < 1:
        return np.empty((0, 0), np.float32)
    small = half_size(half_size(image)).astype(np.float32)
    fine = (small - cv2.GaussianBlur(small, (0, 0), _SIGMA))[: height * _SQUARE, : width * _SQUARE]
    return np.asarray(cv2.resize(fine * fine, (width, height), interpolation=cv2.INTER_AREA), np.float32)
