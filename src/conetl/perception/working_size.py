"""The images of a frame pair in which points are followed: grey, one size for both sides, of limited width.

Rectified images have equal rows but each its own columns. The smaller one is padded at its right and lower border, then both are
reduced by one scale. Stored pixels are those of the rig's rectified cameras, working pixels those of the reduced images; both
count from the centre of the first pixel.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import ArrayLike

from conetl.geometry.motion.stereo_tracks import NoMeasurement
from conetl.geometry.rig import camera_of, infinity_shift_px
from conetl.model.arrays import Floats, Image
from conetl.model.drive import FramePair
from conetl.model.rig import Rig, Side
from conetl.perception.images import ImageFileError

#: Reads one rectified image of a frame pair, grey or in blue, green, red order; raises ImageFileError.
ImageReader = Callable[[FramePair, Side], Image]

#: Grey values of an image must spread at least this much for anything to be followed.
_LEAST_CONTRAST = 3.0
#: Rounding errors of a zero shift must not decide about disparities of block matching, which are multiples of a quarter pixel.
_SHIFT_DECIMALS = 6


@dataclass(frozen=True)
class WorkingSize:
    """How stored images of a rig become working ones. Sizes are width and height."""

    rig: Rig
    common_px: tuple[int, int]
    """Stored pixels that hold both images."""
    size_px: tuple[int, int]
    """Working pixels of both."""

    @cached_property
    def scale(self) -> Floats:
        """(2,) working pixels per stored pixel along u and v; they differ a little because sizes are whole numbers."""
        return np.asarray(np.array(self.size_px) / np.array(self.common_px))

    def seen_px(self, side: Side) -> Floats:
        """(2,) working pixels of an image without its padding, along u and v; infinite where it has none."""
        own = np.array(_stored_size(self.rig, side))
        return np.where(own < self.common_px, own * self.scale, np.inf)

    def to_working(self, stored_px: ArrayLike) -> Floats:
        """Image points (..., 2) in working pixels for stored ones: (u + 0.5) scale - 0.5."""
        return np.asarray(np.asarray(stored_px, dtype=np.float64) * self.scale + (self.scale - 1) / 2)

    def to_stored(self, working_px: ArrayLike) -> Floats:
        """Inverse of `to_working`: image points (..., 2) in stored pixels."""
        return np.asarray((np.asarray(working_px, dtype=np.float64) - (self.scale - 1) / 2) / self.scale)

    def infinity_shift(self, left_px: ArrayLike) -> Floats:
        """(..., 2) working pixels: left minus right image point of an infinitely far point, at points (..., 2) of the left."""
        shift = infinity_shift_px(self.rig, self.to_stored(left_px)) * self.scale
        return np.asarray(shift.round(_SHIFT_DECIMALS) + 0.0)


@dataclass(frozen=True)
class WorkingImages:
    """Both images of one frame pair, grey, at working size and at a quarter of it; the left one without padding at half, too."""

    left: Image
    right: Image
    half_left: Image
    quarter_left: Image
    quarter_right: Image


def working_size(rig: Rig, max_width_px: int) -> WorkingSize:
    """The size at which images of a rectified rig are worked on: the larger of both sides, reduced where it is too wide."""
    (left_w, left_h), (right_w, right_h) = _stored_size(rig, "left"), _stored_size(rig, "right")
    common = max(left_w, right_w), max(left_h, right_h)
    scale = min(1.0, max_width_px / common[0])
    size = (round(common[0] * scale), max(round(common[1] * scale), 1)) if scale < 1.0 else common
    return WorkingSize(rig=rig, common_px=common, size_px=size)


def read_working_images(pair: FramePair, read: ImageReader, working: WorkingSize) -> WorkingImages | NoMeasurement:
    """One frame pair at working size, or the reason why it cannot be used."""
    grey: list[Image] = []
    try:
        for side in ("left", "right"):
            image = read(pair, side)
            if image.ndim == 3:
                image = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), dtype=np.uint8)
            if image.shape[::-1] != _stored_size(working.rig, side):
                return NoMeasurement.IMAGE_UNREADABLE  # no image of this rig
            image = _resize(image, working)
            if float(cv2.meanStdDev(_crop_padding(image, working.seen_px(side)))[1][0, 0]) < _LEAST_CONTRAST:
                return NoMeasurement.IMAGE_BLANK
            grey.append(image)
        left, right = grey
        half_left, half_right = half_size(left), half_size(right)
        seen = _crop_padding(half_left, working.seen_px("left") / 2)
        return WorkingImages(left, right, seen, half_size(half_left), half_size(half_right))
    except ImageFileError:
        return NoMeasurement.IMAGE_UNREADABLE
    except cv2.error:
        return NoMeasurement.IMAGE_UNFIT


def _stored_size(rig: Rig, side: Side) -> tuple[int, int]:
    """Width and height, px."""
    camera = camera_of(rig, side)
    return camera.width_px, camera.height_px


def _resize(image: Image, working: WorkingSize) -> Image:
    """A grey image padded to the common size, then reduced. The border is repeated: a step would give fixed corners."""
    right, below = working.common_px[0] - image.shape[1], working.common_px[1] - image.shape[0]
    if right or below:
        padded = cv2.copyMakeBorder(image, 0, below, 0, right, cv2.BORDER_REPLICATE)
        image = np.asarray(padded, dtype=np.uint8)
    if working.size_px == working.common_px:
        return image
    return np.asarray(cv2.resize(image, working.size_px, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _crop_padding(image: Image, seen_px: Floats) -> Image:
    """The whole pixels of the first `seen_px` along u and v: an image without its padding."""
    width, height = np.minimum(seen_px, image.shape[::-1]).astype(int).tolist()
    return image[: max(height, 1), : max(width, 1)]


def half_size(image: Image) -> Image:
    """Half the size, without a last odd row or column: OpenCV is 30 times faster at a ratio of exactly two."""
    height, width = (size // 2 for size in image.shape)
    if not height or not width:
        return image
    half = cv2.resize(image[: 2 * height, : 2 * width], (width, height), interpolation=cv2.INTER_AREA)
    return np.asarray(half, dtype=np.uint8)
