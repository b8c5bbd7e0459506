"""Labelled images to learn from, and cut-outs of their cones.

Objects are (N, 9) [x0, y0, x1, y1, foot x, foot y, tip x, tip y, class] in pixels from the image's edge; foot and tip are NaN
where they are not known (only renders and drawn objects know them).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import cv2
import numpy as np

from conetl.learning.classes import CLASSES
from conetl.learning.drawing.cut_outs import CutOut


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


def read_labels(path: Path, width: int, height: int) -> np.ndarray:
    """YOLO text file, with foot and tip behind the box or without -> objects (N, 9). An absent file means none."""
    if not path.exists() or not path.read_text().strip():
        return np.zeros((0, 9))
    classes, rows = np.split(np.loadtxt(path, ndmin=2), [1], axis=1)
    ends = rows[:, 4:8] if rows.shape[1] >= 8 else np.full((len(rows), 4), np.nan)
    rows = np.concatenate((rows[:, :2] - rows[:, 2:4] / 2, rows[:, :2] + rows[:, 2:4] / 2, ends), 1)
    return np.column_stack((rows * np.tile((width, height), 4), classes))


def objects_from(boxes: Sequence[Sequence[float]], classes: Sequence[int]) -> np.ndarray:
    """Boxes (N, 4) and classes (N,) as objects (N, 9) of unknown foot and tip."""
    objects = np.full((len(boxes), 9), np.nan)
    objects[:, :4] = np.array(boxes).reshape(-1, 4)
    objects[:, 8] = classes
    return objects


def cut_out_cones(pictures: list[LabelledImage]) -> list[CutOut]:
    """GrabCut cut-outs of whole upright cones, trimmed to the cone's own outline: exact boxes for pasting."""
    cutouts = []
    for picture in pictures:
        height, width = picture.image.shape[:2]
        for x0, y0, x1, y1 in picture.boxes[:, :4]:
            w, h = x1 - x0, y1 - y0
            if h < 70 or h < 0.9 * w or x0 < 4 or y0 < 4 or x1 > width - 4 or y1 > height - 4:
                continue
            left, top = int(max(x0 - 0.15 * w, 0)), int(max(y0 - 0.15 * h, 0))
            right, bottom = int(min(x1 + 0.15 * w, width)), int(min(y1 + 0.15 * h, height))
            patch = picture.image[top:bottom, left:right]
            scale = min(1.0, 200 / patch.shape[0])
            patch = cv2.resize(patch, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
            frame = [round(v * scale) for v in (x0 - left, y0 - top, w, h)]
            mask = np.zeros(patch.shape[:2], np.uint8)
            cv2.grabCut(patch, mask, frame, np.zeros((1, 65)), np.zeros((1, 65)), 3, cv2.GC_INIT_WITH_RECT)
            solid = ((mask == cv2.GC_FGD) | (mask == cv2.GC_PR_FGD)).astype(np.uint8)
            solid = cv2.morphologyEx(solid, cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8))
            count, labels, stats, _ = cv2.connectedComponentsWithStats(solid)
            if count < 2:
                continue
            largest = 1 + int(stats[1:, cv2.CC_STAT_AREA].argmax())
            bx, by, bw, bh, area = stats[largest]
            # A good outline fills its box like a cone does and covers most of the label.
            if not (0.28 < area / (bw * bh) < 0.72 and bh > 0.8 * frame[3] and 1.1 < bh / bw < 3.5):
                continue
            alpha = cv2.GaussianBlur((labels == largest).astype(np.uint8) * 255, (3, 3), 0)
            cutouts.append(CutOut(np.dstack((patch, alpha))[by : by + bh, bx : bx + bw]))
    return cutouts
