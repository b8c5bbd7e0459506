"""Recall and false boxes of a detector on labelled images."""

from __future__ import annotations

import dataclasses

import numpy as np

from conetl.learning.evidence.looks import share_within
from conetl.learning.images import LabelledImage
from conetl.perception.decoding import intersection_over_union


def at_score(
    pictures: list[LabelledImage], found: list[np.ndarray], score: float, overlap: float = 0.5
) -> dict[str, float]:
    """Share of cones that have a box of this score and overlap (IoU), and boxes on no cone per image."""
    hits = cones = false = 0
    for picture, boxes in zip(pictures, found, strict=True):
        free = np.ones(len(picture.boxes), bool)
        cones += len(free)
        for x, y, width, height, *_ in boxes[boxes[:, 4] >= score]:
            shares = intersection_over_union(np.array([x, y, x + width, y + height]), picture.boxes[:, :4]) * free
            if len(shares) and shares.max() >= overlap:
                free[shares.argmax()] = False
            else:
                false += 1
        hits += int((~free).sum())
    return {"recall": round(hits / max(cones, 1), 3), "false_a_picture": round(false / max(len(pictures), 1), 3)}


def of_class(picture: LabelledImage, found: np.ndarray, number: int) -> tuple[LabelledImage, np.ndarray]:
    """An image with its objects of one class, and the boxes of that class but for those in ignored regions on no object."""
    objects = picture.boxes[picture.boxes[:, 8] == number]
    boxes = found[found[:, 9] == number]

    def counts(box: np.ndarray) -> bool:
        corners = np.concatenate((box[:2], box[:2] + box[2:4]))
        if (intersection_over_union(corners, objects[:, :4]) >= 0.5).any():
            return True
        return not any(share_within(corners[None], region)[0] > 0.5 for region in picture.fade)

    kept = np.array([counts(box) for box in boxes], bool)
    return dataclasses.replace(picture, boxes=objects), boxes[kept]
