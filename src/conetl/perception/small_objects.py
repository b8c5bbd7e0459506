"""An enlarged look where small cones stand: the same network once more on those parts of the image, twice as large.

Far cones stand in rows: beside one that is found others stand that are too small to be found at the image's own size. What the
enlarged look sees is joined with what the first one saw, as in `closer_look.py`; what it alone sees is a candidate, too.
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from conetl.perception.decoding import Seen, intersection_over_union, without_parts
from conetl.perception.model_card import EnlargedLook
from conetl.perception.rescoring import PLACES, SAME_THING_IOU, pooled

Floats = NDArray[np.float64]
Image = NDArray[np.uint8]

#: Candidates of the first look below this are left as they are, and what it did not see counts as seen with it: so boxes above it
#: do not hang on the score that a caller asks for.
FAINTEST = 0.05
#: The parts, enlarged, are no larger than the image: where there are more of them, they are enlarged less.
MOST_AREA = 1.0
#: Less than this is not worth a look.
LEAST_SCALE = 1.2
#: What only the enlarged look sees is taken up to this times the height of what the first look calls small.
TALLEST = 1.25
#: A box nearer than this to where a part was cut may be cut itself.
CUT_PX = 3.0
#: Parts are rectangles of whole cells of this size.
CELL_PX = 8

#: x0, y0, x1, y1 in whole pixels of the image.
Part = tuple[int, int, int, int]


def look_enlarged(
    look: Callable[[Image], Seen],
    image_bgr: Image,
    candidates: Floats,
    settings: EnlargedLook,
    px_per_input_px: float,
    wanted: NDArray[np.bool_] | None = None,
) -> Floats:
    """Candidates (N, 9) of `detector.look` in pixels of the image (H, W, 3), after an enlarged look where small ones stand.

    look: runs the network on a part of the image, already enlarged, and gives its candidates in pixels of that, and the score
    below which it may know of others. px_per_input_px: pixels of the image per pixel of the network's input in the first look.
    wanted: which candidates (N,) may call for a look (None: all). Log-odds of the scores, boxes, feet and tips are averaged
    with the share of the enlarged look. Boxes that it moved on top of each other are not suppressed yet.
    """
    below_px = settings.below_px * px_per_input_px
    heights = candidates[:, 3] - candidates[:, 1]
    calls = (heights < below_px) & (candidates[:, 4] >= max(settings.from_score, FAINTEST))
    calling = candidates[calls if wanted is None else calls & wanted]
    if not len(calling):
        return candidates
    parts = parts_around(calling, settings.around_px * px_per_input_px, image_bgr.shape[1], image_bgr.shape[0])
    scale = enlargement(parts, settings.scale, image_bgr.shape[1] * image_bgr.shape[0])
    if scale < LEAST_SCALE:
        return candidates
    result = candidates.copy()
    added = []
    for part in parts:
        seen, untold = _seen_in(look, image_bgr, part, scale / px_per_input_px)
        seen = seen[_whole_in(seen, part, image_bgr)]
        inside = ((candidates[:, :2] < part[2:]) & (candidates[:, 2:4] > part[:2])).all(axis=1)
        judged = _whole_in(candidates, part, image_bgr) & (heights < below_px) & (candidates[:, 4] >= FAINTEST)
        # What is too tall to be judged has its counterpart, too: what the enlarged look sees of it is not new.
        counterparts = _counterparts(candidates, inside & (candidates[:, 4] >= FAINTEST), seen)
        for index in np.flatnonzero(judged):
            first, same = candidates[index], counterparts[index]
            if same >= 0:
                result[index] = (1.0 - settings.share) * first + settings.share * seen[same]
                score = seen[same, 4]
            else:
                # In a crowd the network tells of its best cells only: what it does not show may be as good as the last of them.
                score = min(untold, first[4]) if untold > FAINTEST else 0.0
            result[index, 4] = pooled(first[4], score, settings.share)
        new = np.delete(seen, counterparts[counterparts >= 0], axis=0)
        new = new[new[:, 3] - new[:, 1] < TALLEST * below_px]
        new[:, 4] = [pooled(FAINTEST, score, settings.share) for score in new[:, 4]]
        added.append(without_parts(new, candidates[inside & ~judged]) if len(new) else new)
    return np.concatenate((result, *added))


def _counterparts(candidates: Floats, among: NDArray[np.bool_], seen: Floats) -> NDArray[np.int64]:
    """(N,) which box of the enlarged look (M, 9) is each candidate's (N, 9), -1 for none; the surer candidate chooses first."""
    counterparts = np.full(len(candidates), -1)
    free = np.ones(len(seen), bool)
    those = np.flatnonzero(among)
    for index in those[np.argsort(-candidates[those, 4], kind="stable")]:
        overlaps = intersection_over_union(candidates[index, :4], seen[:, :4])
        same = free & (overlaps >= SAME_THING_IOU)
        if same.any():
            counterparts[index] = np.where(same, overlaps * seen[:, 4], -1.0).argmax()
            free[counterparts[index]] = False
    return counterparts


def parts_around(boxes: Floats, around_px: float, width_px: int, height_px: int) -> list[Part]:
    """Rectangles x0, y0, x1, y1 of an image that hold boxes (N, 4 or more) with so much around them; no two of them touch."""
    size = -(-width_px // CELL_PX), -(-height_px // CELL_PX)
    low = np.floor((boxes[:, :2] - around_px) / CELL_PX).clip(0, size).astype(int)
    high = np.ceil((boxes[:, 2:4] + around_px) / CELL_PX).clip(0, size).astype(int)
    cells = np.concatenate((low, high), axis=1)
    while True:
        shown = np.zeros(size[::-1], np.uint8)
        for x0, y0, x1, y1 in cells:
            shown[y0:y1, x0:x1] = 1
        _, _, stats, _ = cv2.connectedComponentsWithStats(shown, connectivity=8)
        found = stats[1:, :4]  # left, top, width, height; the first is what is not shown
        hulls = np.concatenate((found[:, :2], found[:, :2] + found[:, 2:4]), axis=1)
        if len(hulls) == len(cells):
            break
        cells = hulls  # hulls of odd shapes may touch each other
    pixels = (hulls * CELL_PX).clip(0, (width_px, height_px, width_px, height_px))
    return [(int(x0), int(y0), int(x1), int(y1)) for x0, y0, x1, y1 in pixels]


def enlargement(parts: list[Part], wanted: float, image_px: float) -> float:
    """By how much to enlarge the parts, so that all together are at most MOST_AREA times the image's number of pixels."""
    pixels = sum((x1 - x0) * (y1 - y0) for x0, y0, x1, y1 in parts)
    return float(min(wanted, np.sqrt(MOST_AREA * image_px / max(pixels, 1))))


def _seen_in(look: Callable[[Image], Seen], image_bgr: Image, part: Part, scale: float) -> Seen:
    """What the network sees in a part of the image, enlarged; candidates (N, 9) in pixels of the image."""
    x0, y0, x1, y1 = part
    method = cv2.INTER_CUBIC if scale > 1.0 else cv2.INTER_AREA
    size = max(round((x1 - x0) * scale), 1), max(round((y1 - y0) * scale), 1)
    enlarged = np.asarray(cv2.resize(image_bgr[y0:y1, x0:x1], size, interpolation=method), np.uint8)
    seen, untold = look(enlarged)
    seen[:, PLACES] *= np.tile(((x1 - x0) / size[0], (y1 - y0) / size[1]), 4)
    seen[:, PLACES] += np.tile((x0, y0), 4)
    return seen, untold


def _whole_in(boxes: Floats, part: Part, image_bgr: Image) -> NDArray[np.bool_]:
    """(N,) whether boxes (N, 4 or more) lie in a part and do not touch where it was cut. The image's own edges are no cuts."""
    sides = np.array(part, np.float64)
    cut = (sides > 0) & (sides < (np.inf, np.inf, image_bgr.shape[1], image_bgr.shape[0]))
    low = np.where(cut[:2], sides[:2] + CUT_PX, -np.inf)
    high = np.where(cut[2:], sides[2:] - CUT_PX, np.inf)
    return np.asarray(((boxes[:, :2] >= low) & (boxes[:, 2:4] <= high)).all(axis=1))
