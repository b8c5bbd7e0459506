"""The replay set: drawn things of all classes, pasted on the operator's images, so that the network forgets none of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from conetl.learning.augment import one_of, paste_cutout, relight
from conetl.learning.classes import CLASSES
from conetl.learning.drawing.cones import draw_cone
from conetl.learning.drawing.cut_outs import CutOut
from conetl.learning.drawing.objects import DRAW, draw_object
from conetl.learning.images import LabelledImage

DRAWN = "drawn"


def drawn_cut_outs(seed: int, count: int) -> dict[str, list[CutOut]]:
    """Things to paste, by class, half of them cones."""
    rng = np.random.default_rng(seed)
    cones = [draw_cone(rng) for _ in range(count // 2)]
    others = {name: [draw_object(rng, name) for _ in range(count // 2 // len(DRAW))] for name in DRAW}
    return {"traffic_cone": cones} | others


def draw_more(cut_outs: dict[str, list[CutOut]], rng: np.random.Generator) -> None:
    """Add a drawn cone and a drawn thing of another class."""
    cut_outs["traffic_cone"].append(draw_cone(rng))
    name = str(rng.choice(list(DRAW)))
    cut_outs[name].append(draw_object(rng, name))


def drawn_scenes(images: Sequence[LabelledImage], count: int, seed: int) -> list[LabelledImage]:
    """Images with drawn things on them, which alone are labelled: what else is there counts neither way."""
    rng = np.random.default_rng(seed)
    cut_outs = drawn_cut_outs(seed, 4 * count)
    scenes = []
    for number in range(count):
        base = images[number % len(images)]
        canvas, boxes = base.image.copy(), base.boxes
        for _ in range(int(rng.integers(4, 10))):
            boxes = np.concatenate((boxes, paste_cutout(canvas, one_of(cut_outs, rng, CLASSES), boxes, rng)))
        height, width = canvas.shape[:2]
        whole = np.array([[0.0, 0.0, width, height]])
        pasted = boxes[len(base.boxes) :]
        scenes.append(
            LabelledImage(f"{DRAWN}_{number:03d}", DRAWN, relight(canvas, rng), pasted, whole, judged_only=True)
        )
    return scenes
