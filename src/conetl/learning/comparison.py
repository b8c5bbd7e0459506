"""Two detectors on the same images: recall and false boxes by class, the images that changed, and a page of both."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from conetl.learning.classes import CLASSES
from conetl.learning.images import LabelledImage
from conetl.learning.replay import DRAWN
from conetl.learning.scoring import at_score, of_class
from conetl.model.errors import InputError
from conetl.perception.decoding import intersection_over_union
from conetl.perception.detector import Detector, detect_image
from conetl.reports.camera_images import draw_boxes, pairs_jpeg
from conetl.reports.html import Section, render, write_page

SCORES = (0.3, 0.5)
#: Boxes of both detectors that overlap more are the same.
_SAME_IOU = 0.5
_MOST_IMAGES = 6
_LEAST_SCORE = 0.05
Boxes = NDArray[np.float64]
Seen = tuple[LabelledImage, tuple[Boxes, Boxes]]
"""An image with the boxes of the old and of the new detector."""


class ClassFigures(NamedTuple):
    """Of one class in one set of images; pairs are of the old and the new detector."""

    images: str
    """own, or drawn."""
    category: str
    objects: int
    score: float
    recall: tuple[float | None, float | None]
    """None without an object."""
    false_boxes: tuple[float | None, float | None]
    """Per image; None where the images are not labelled wholly."""


class ModelComparison(NamedTuple):
    """Figures, and the own images that changed, most first, with the boxes of both."""

    figures: list[ClassFigures]
    refused: tuple[int, int, int]
    """Places where nothing stands, and how many of them have a box of SCORES[0] by the old and by the new detector."""
    changed: list[Seen]


def compare(old: Detector, new: Detector, images: Sequence[LabelledImage]) -> ModelComparison:
    """Compare two detectors of CLASSES on labelled images; those of source DRAWN are a set of their own."""
    found = {
        detector.card.sha256: [
            detect_image(detector, one.image, score_threshold=_LEAST_SCORE, single_image=True, categories=None)
            for one in images
        ]
        for detector in (old, new)
    }
    both = zip(found[old.card.sha256], found[new.card.sha256], strict=True)
    pairs: list[Seen] = list(zip(images, both, strict=True))
    figures = []
    for kind in ("own", DRAWN):
        of_kind = [pair for pair in pairs if (pair[0].source == DRAWN) == (kind == DRAWN)]
        for number, name in enumerate(CLASSES):
            figures += _figures(kind, number, [pair for pair in of_kind if name in pair[0].taught])
    places = [(place, boxes) for one, boxes in pairs for place in one.false]
    hits = [sum(_has_box(place, boxes[k]) for place, boxes in places) for k in (0, 1)]
    own = [pair for pair in pairs if pair[0].source != DRAWN]
    changed = sorted((pair for pair in own if _differences(*pair[1])), key=lambda pair: -_differences(*pair[1]))
    return ModelComparison(figures, (len(places), hits[0], hits[1]), changed)


def _figures(kind: str, number: int, pairs: Sequence[Seen]) -> list[ClassFigures]:
    objects = sum(int((one.boxes[:, 8] == number).sum()) for one, _ in pairs)
    whole = [pair for pair in pairs if not pair[0].judged_only]
    rows = []
    for score in SCORES:
        recall, false = [], []
        for k in (0, 1):
            seen = [of_class(one, boxes[k], number) for one, boxes in pairs]
            recall.append(at_score([one for one, _ in seen], [boxes for _, boxes in seen], score)["recall"])
            seen = [of_class(one, boxes[k], number) for one, boxes in whole]
            false.append(at_score([one for one, _ in seen], [boxes for _, boxes in seen], score)["false_a_picture"])
        nothing = (None, None)
        rows.append(
            ClassFigures(
                kind, CLASSES[number], objects, score, (recall[0], recall[1]) if objects else nothing,
                (false[0], false[1]) if whole else nothing,
            )
        )  # fmt: skip
    return rows if objects or any(any(row.false_boxes) for row in rows if whole) else []


def _corners(boxes: Boxes) -> Boxes:
    best = boxes[boxes[:, 4] >= SCORES[0]]
    return np.concatenate((best[:, :2], best[:, :2] + best[:, 2:4], best[:, 9:10]), axis=1)


def _has_box(place: NDArray[np.float64], boxes: Boxes) -> bool:
    return bool((intersection_over_union(place, _corners(boxes)[:, :4]) >= _SAME_IOU).any())


def _differences(old: Boxes, new: Boxes) -> int:
    """Boxes of SCORES[0] and more that one detector has and the other has not, in place and class."""

    def alone(some: Boxes, others: Boxes) -> int:
        return sum(
            not ((intersection_over_union(box[:4], others[:, :4]) >= _SAME_IOU) & (others[:, 4] == box[4])).any()
            for box in some
        )

    ours, theirs = _corners(old), _corners(new)
    return alone(ours, theirs) + alone(theirs, ours)


def write_comparison_page(path: Path, title: str, summary: Sequence[str], found: ModelComparison, how: str) -> Path:
    """Write figures, old and new, and the images that changed. how: which images were kept out. Raises InputError."""
    notes = {
        "own": f"{how} Recall: share of the labelled objects with a box (IoU 0.5) from that score.",
        DRAWN: "Drawn objects of all classes on these images, others than it was taught with: what it should not forget.",
    }
    sections = []
    for kind, heading in (("own", "Your images"), (DRAWN, "Drawn objects")):
        columns = ["class", "objects"]
        for score in SCORES:
            columns += [
                f"{what} at {score}, {which}"
                for what in ("recall", "false boxes per image")
                for which in ("old", "new")
            ]
        by_class: dict[str, list[object]] = {}
        for row in found.figures:
            if row.images == kind:
                cells = by_class.setdefault(row.category, [row.category.replace("_", " "), row.objects])
                cells += [_number(value) for value in (*row.recall, *row.false_boxes)]
        used = [k for k in range(len(columns)) if any(cells[k] != "" for cells in by_class.values())]
        if by_class:
            table = [[cells[k] for k in used] for cells in by_class.values()]
            sections.append(Section(heading, notes[kind], [columns[k] for k in used], table))
    places, before, after = found.refused
    if places:
        note = "Boxes that people refused, in the images kept out, which the network still finds."
        sections.append(Section("Refused boxes", note, ["places", "old", "new"], [[places, before, after]]))
    if found.changed:
        shown = found.changed[:_MOST_IMAGES]
        rows = []
        for one, found_boxes in shown:
            both = [draw_boxes(one.image, boxes[boxes[:, 4] >= SCORES[0]], CLASSES) for boxes in found_boxes]
            rows.append((both[0], both[1], f"{one.name}: old | new"))
        note = f"{len(shown)} of {len(found.changed)} images kept out whose boxes from {SCORES[0]} differ; left old, right new."
        picture = pairs_jpeg(rows)
        sections.append(
            Section("Images that changed", note, image=picture, image_kind="jpeg", image_alt="old and new boxes")
        )
    return write_page(path, render("accuracy.html.j2", title=title, summary=summary, sections=sections))


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.2f}"


def require_same_classes(detector: Detector) -> None:
    """Raise InputError for a network of other classes than those that can be taught."""
    if detector.card.class_names != CLASSES:
        raise InputError(
            f"{detector.path}: has the classes {', '.join(detector.card.class_names)}; only networks that come with conetl, and "
            f"those trained from them, can be taught ({', '.join(CLASSES)})"
        )
