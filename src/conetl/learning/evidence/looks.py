"""Looks at labelled cones and at what is taken for one: the raw material of `measure.py`.

Each image is looked at several times: as it is, smaller and larger with other light (a look from another distance), and with
things pasted in front of its cones. A cone is found where a box overlaps its label as `tracking/existence.py` asks.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from conetl.learning.images import LabelledImage
from conetl.perception.decoding import intersection_over_union

#: Scores below this are not looked at: nothing in the pipeline does.
LEAST_SCORE = 0.05
MATCH_IOU = 0.3
#: A box that touches a label by more than this is not called false: half a cone, or two in one.
NEAR_IOU = 0.1
#: Below this height the real images leave cones without a label (training/README.md): a box there counts neither way.
LABELLED_FROM_PX = 20.0
SCALES = (1.0, 0.5, 0.7, 0.85, 1.2, 0.99)
HIDDEN = (0.25, 0.5)
EDGE_PX = 2.0
Detect = Callable[[np.ndarray], np.ndarray]


@dataclass
class ConeLooks:
    """Rows of numbers; `image` numbers images, `thing` cones and lookalikes over all images."""

    cones: list[tuple[int, int, int, float, float, float]] = field(default_factory=list)
    """image, thing, look, height in px, hidden share, best score (0 where no box)"""
    boxes: list[tuple[int, float, float, bool]] = field(default_factory=list)
    """image, height, score, whether on a cone: boxes of the plain look that count for or against"""
    lookalikes: list[tuple[int, int, int, float, float]] = field(default_factory=list)
    """image, thing, look, height in px, best score (0 where no box)"""
    false_boxes: list[tuple[float, float]] = field(default_factory=list)
    """height, score of the boxes of plain looks that are on no cone"""
    exact: list[bool] = field(default_factory=list)
    """By image: whether it has no cone without a label at any height."""


def look_at_pictures(
    pictures: list[LabelledImage], exact: Callable[[LabelledImage], bool], detect: Detect, seed: int = 5
) -> ConeLooks:
    """All looks at all images. detect: image -> boxes (N, 5 or more) x, y, w, h, score down to LEAST_SCORE."""
    rng, looks = np.random.default_rng(seed), ConeLooks()
    for number, picture in enumerate(pictures):
        looks.exact.append(exact(picture))
        cones = picture.boxes[:, :4]
        first_cone = 1 + max((row[1] for row in looks.cones), default=-1)
        found_by_scale = []
        for look, scale in enumerate(SCALES):
            found = _corners(detect(_another_look(picture.image, scale, rng)))
            found[:, :4] /= scale
            found_by_scale.append(found)
            _add_cones(looks, number, first_cone, look, cones, found, scale, np.zeros((0, 4)), picture)
        for look, share in enumerate(HIDDEN, len(SCALES)):
            image, covers = _hide(picture.image, cones, share, pictures, rng)
            _add_cones(looks, number, first_cone, look, cones, _corners(detect(image)), 1.0, covers, picture)
        countable = [_countable(found, picture, looks.exact[number]) for found in found_by_scale]
        _add_boxes(looks, number, cones, countable[0])
        _add_lookalikes(looks, number, cones, countable)
    return looks


def _another_look(image: np.ndarray, scale: float, rng: np.random.Generator) -> np.ndarray:
    if scale == 1.0:
        return image
    resized = cv2.resize(
        image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
    )
    light = (resized / 255.0) ** rng.uniform(0.75, 1.3) * 255.0 * rng.uniform(0.85, 1.15)
    noisy = light + rng.normal(0.0, rng.uniform(0.5, 4.0), resized.shape)
    return np.asarray(np.clip(noisy, 0, 255), dtype=np.uint8)


def _hide(
    image: np.ndarray, cones: np.ndarray, share: float, pictures: list[LabelledImage], rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """The image with something before each cone that covers `share` of its box, and what was pasted (N, 4).

    A post across it, or a car's side or front (from the left, the right or below), filled with a cut of some image.
    """
    image, covers = image.copy(), []
    rows, columns = image.shape[:2]
    for x0, y0, x1, y1 in cones:
        w, h = x1 - x0, y1 - y0
        kind = rng.choice(["post", "left", "right", "below"])
        if kind == "post":
            left = x0 + rng.uniform(0, 1 - share) * w
            cover = (left, y0 - 0.5 * h, left + share * w, y1 + 0.15 * h)
        elif kind == "left":
            cover = (x0 - 1.5 * w, y0 - 0.3 * h, x0 + share * w, y1 + 0.15 * h)
        elif kind == "right":
            cover = (x1 - share * w, y0 - 0.3 * h, x1 + 1.5 * w, y1 + 0.15 * h)
        else:
            cover = (x0 - 0.5 * w, y1 - share * h, x1 + 0.5 * w, y1 + 0.3 * h)
        a, b, c, d = (round(float(np.clip(v, 0, most))) for v, most in zip(cover, (columns, rows) * 2, strict=True))
        if c - a < 1 or d - b < 1:
            continue
        source = pictures[int(rng.integers(len(pictures)))].image
        x, y = int(rng.integers(source.shape[1] // 2)), int(rng.integers(source.shape[0] // 2))
        cut = source[y : y + source.shape[0] // 2, x : x + source.shape[1] // 2]
        # Upper halves of images hold cones, too: a cut turned on its head and without much colour is none.
        grey = cut[::-1].mean(axis=2, keepdims=True) * 0.8 + cut[::-1] * 0.2
        image[b:d, a:c] = cv2.resize(grey, (c - a, d - b), interpolation=cv2.INTER_AREA)[..., :3]
        covers.append((a, b, c, d))
    return image, np.array(covers, dtype=np.float64).reshape(-1, 4)


def _corners(found: np.ndarray) -> np.ndarray:
    return np.concatenate((found[:, :2], found[:, :2] + found[:, 2:4], found[:, 4:5]), axis=1)


def _add_cones(
    looks: ConeLooks, number: int, first: int, look: int, cones: np.ndarray, found: np.ndarray,
    scale: float, covers: np.ndarray, picture: LabelledImage,
) -> None:  # fmt: skip
    """Cones that lie wholly inside the image, with the share of the box behind pasted things and behind nearer cones."""
    rows, columns = picture.image.shape[:2]
    for k, box in enumerate(cones):
        if min(box[0], box[1], columns - box[2], rows - box[3]) < EDGE_PX:
            continue
        height = box[3] - box[1]
        nearer = cones[cones[:, 3] > box[3] + 0.1 * height]
        hidden = hidden_share(box, np.concatenate((nearer, covers)))
        scores = found[:, 4][intersection_over_union(box, found[:, :4]) >= MATCH_IOU] if len(found) else np.zeros(0)
        looks.cones.append((number, first + k, look, height * scale, hidden, float(scores.max(initial=0.0))))


def hidden_share(box: np.ndarray, nearer: np.ndarray) -> float:
    """Share of a box (4,) that lies behind the union of nearer boxes (N, 4), on a grid of 24 x 24 points."""
    x = box[0] + (np.arange(24) + 0.5) / 24 * (box[2] - box[0])
    y = box[1] + (np.arange(24) + 0.5) / 24 * (box[3] - box[1])
    inside = np.zeros((24, 24), dtype=bool)
    for x0, y0, x1, y1 in nearer[:, :4]:
        inside |= ((y >= y0) & (y <= y1))[:, None] & ((x >= x0) & (x <= x1))[None, :]
    return float(inside.mean())


def _countable(found: NDArray[np.float64], picture: LabelledImage, exact: bool) -> np.ndarray:
    """Boxes that can be judged: not cut by the image's edge, not where an unlabelled cone stands or may stand."""
    rows, columns = picture.image.shape[:2]
    good = (found[:, :2] >= EDGE_PX).all(1) & (found[:, 2] <= columns - EDGE_PX) & (found[:, 3] <= rows - EDGE_PX)
    if not exact:
        good &= found[:, 3] - found[:, 1] >= LABELLED_FROM_PX
    on_label = np.array([_best_overlap(box, picture.boxes) >= MATCH_IOU for box in found], bool)
    for region in picture.fade:
        apart = (intersection_over_union(region, found[:, :4]) < NEAR_IOU) & (share_within(found, region) <= 0.5)
        good &= on_label | apart
    return found[np.flatnonzero(good)]


def _best_overlap(box: np.ndarray, others: np.ndarray) -> float:
    return float(intersection_over_union(box[:4], others[:, :4]).max(initial=0.0))


def share_within(boxes: np.ndarray, region: np.ndarray) -> np.ndarray:
    """Share (N,) of each box (N, 4 or more) [x0, y0, x1, y1] that lies in a region (4,)."""
    low, high = np.maximum(boxes[:, :2], region[:2]), np.minimum(boxes[:, 2:4], region[2:4])
    whole = (boxes[:, 2:4] - boxes[:, :2]).prod(1)
    return np.asarray(np.clip(high - low, 0, None).prod(1) / np.maximum(whole, 1e-9))


def _add_boxes(looks: ConeLooks, number: int, cones: np.ndarray, found: np.ndarray) -> None:
    """Boxes of the plain look, the best first: on a cone that no better box has, or on none."""
    free = np.ones(len(cones), dtype=bool)
    for box in found[np.argsort(-found[:, 4], kind="stable")]:
        overlap = intersection_over_union(box[:4], cones) if len(cones) else np.zeros(0)
        height, score = float(box[3] - box[1]), float(box[4])
        taken = np.flatnonzero(free & (overlap >= MATCH_IOU))
        if len(taken):
            free[taken[overlap[taken].argmax()]] = False
            looks.boxes.append((number, height, score, True))
        elif overlap.max(initial=0.0) < MATCH_IOU:
            looks.boxes.append((number, height, score, False))
            if overlap.max(initial=0.0) < NEAR_IOU:
                looks.false_boxes.append((height, score))


def _add_lookalikes(looks: ConeLooks, number: int, cones: np.ndarray, found_by_scale: list[np.ndarray]) -> None:
    """Places without a cone that had a box in any look, with the best score there in every look."""
    places: list[np.ndarray] = []
    for box in np.concatenate(found_by_scale):
        if len(cones) and intersection_over_union(box[:4], cones).max() >= NEAR_IOU:
            continue
        if not places or intersection_over_union(box[:4], np.array(places)).max() < MATCH_IOU:
            places.append(box[:4])
    thing = 1 + max((row[1] for row in looks.lookalikes), default=-1)
    for k, place in enumerate(places):
        for look, (scale, found) in enumerate(zip(SCALES, found_by_scale, strict=True)):
            same = intersection_over_union(place, found[:, :4]) >= MATCH_IOU if len(found) else np.zeros(0, bool)
            score = float(found[same, 4].max(initial=0.0)) if len(found) else 0.0
            looks.lookalikes.append((number, thing + k, look, (place[3] - place[1]) * scale, score))
