"""Labels and drawn objects of the training: well-formed labels, boxes between keys, exact boxes of what is drawn."""

from __future__ import annotations

import csv

import numpy as np

from conetl.learning.classes import CLASSES
from conetl.learning.drawing import objects as drawn
from tests.folders import ROOT
from training.dataset import IGNORED, NOTHING
from training.label_clips import between

TRAINING = ROOT / "training"


def test_labels_of_the_clips_are_well_formed() -> None:
    frames: set[tuple[str, str]] = set()
    for path in TRAINING.glob("labels/*.csv"):
        with path.open() as lines:
            rows = list(csv.DictReader(lines))
        for row in rows:
            frames.add((path.stem, row["frame"]))
            assert int(row["frame"]) % 15 == 7, (path.name, row)
            if row["class"] == NOTHING:
                assert sum(other["frame"] == row["frame"] for other in rows) == 1, (path.name, row)
                continue
            assert row["class"] in (*CLASSES, IGNORED), (path.name, row)
            x0, y0, x1, y1 = (float(row[side]) for side in ("x0", "y0", "x1", "y1"))
            assert 0 <= x0 < x1 <= 722 and 0 <= y0 < y1 <= 406, (path.name, row)
    assert len(frames) >= 400


def test_between_two_keys_a_standing_object_is_approached_at_constant_speed() -> None:
    focal, aside, height, eye = 600.0, 2.0, 0.7, 1.3

    def seen(ahead_m: float) -> np.ndarray:
        bottom = 200 + focal * eye / ahead_m
        return np.array([0, bottom - focal * height / ahead_m, 0, bottom]) + focal / ahead_m * np.array(
            [aside - 0.2, 0, aside + 0.2, 0]
        )

    np.testing.assert_allclose(between(seen(20.0), seen(8.0), 0.25), seen(17.0), atol=1e-9)
    np.testing.assert_allclose(between(seen(9.0), seen(9.0), 0.5), seen(9.0), atol=1e-9)


def test_boxes_of_drawn_objects_hold_what_is_drawn() -> None:
    rng = np.random.default_rng(8)
    for name in drawn.DRAW:
        for _ in range(10):
            thing = drawn.draw_object(rng, name)
            x0, y0, x1, y1 = box = thing.box_or_all
            height, width = thing.image.shape[:2]
            assert 0 <= x0 < x1 <= width and 0 <= y0 < y1 <= height
            solid = thing.image[..., 3] > 127
            inside = np.zeros_like(solid)
            inside[int(y0) : int(np.ceil(y1)), int(x0) : int(np.ceil(x1))] = True
            if thing.box is None:  # labelled whole
                assert not (solid & ~inside).any(), name
            rows, columns = np.nonzero(solid & inside)
            extent = np.array([columns.min(), rows.min(), columns.max() + 1, rows.max() + 1])
            assert np.abs(extent - box).max() < 0.06 * max(width, height), (name, extent, box)
