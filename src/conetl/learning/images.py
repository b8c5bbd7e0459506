"""Labelled images to learn from.

Objects are (N, 9) [x0, y0, x1, y1, foot x, foot y, tip x, tip y, class] in pixels from the image's edge; foot and tip are NaN
where they are not known (only renders and drawn objects know them).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from conetl.learning.classes import CLASSES


@dataclass
class LabelledImage:
    """One image (H, W, 3) uint8 BGR with its objects (N, 9)."""

    name: str
    source: str
    """Its recording, or the data set that it is from."""
    image: np.ndarray
    boxes: np.ndarray
    fade: np.ndarray = field(default_factory=lambda: np.zeros((0, 4)))
    """Regions (M, 4) where an unlabelled object is likely: background is not taught there."""
    judged_only: bool = False
    """Whether people judged only what lies outside of `fade`: then nothing is taught there, small or large."""
    tight: bool = True
    """Whether its boxes can be trusted to the pixel."""
    false: np.ndarray = field(default_factory=lambda: np.zeros((0, 4)))
    """Boxes (K, 4) that a detector found where nothing is: samples are centred on them."""
    taught: frozenset[str] = frozenset(CLASSES)
    """The classes that are labelled in it: of the others nothing is taught."""
    trust: float = 0.6
    """How far the sides of its boxes are believed: 1 where they are exact; hand-drawn boxes leave a margin."""
    stretch: tuple[float, float] = (0.85, 1.15)
    """By how much samples may be widened."""
    sizes: Literal["any", "as seen", "rendered"] = "as seen"
    """Sizes of its objects in samples: any; in half of them as the camera saw them, since most far objects are small already; or
    nearly those of a render."""


def objects_from(boxes: Sequence[Sequence[float]], classes: Sequence[int]) -> np.ndarray:
    """Boxes (N, 4) and classes (N,) as objects (N, 9) of unknown foot and tip."""
    objects = np.full((len(boxes), 9), np.nan)
    objects[:, :4] = np.array(boxes).reshape(-1, 4)
    objects[:, 8] = classes
    return objects
