"""Second passes of the network over parts of an image, which a model's sidecar may enable.

Re-scoring pass: a small window around each candidate of medium score, scaled to a fixed height. A tail lamp that resembles a cone
at 20 px rarely does at 48 px. Small-object pass: enlarged parts around small candidates. Distant cones stand in rows: near a
detected one there are others that are too small at the image's own size; those that only this pass finds are added.

Scores of two passes are combined as a logarithmic opinion pool (Genest & Zidek 1986, Statistical Science 1:114).
"""

from __future__ import annotations

import math
from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from conetl.model.arrays import Floats, Image
from conetl.perception.decoding import NetworkBoxes, intersection_over_union, suppress_parts
from conetl.perception.model_card import ReScoringPass, SmallObjectPass

#: Columns of a candidate that hold x and y in turn; column 4 is the score, column CLASS the class.
COORDINATES = (0, 1, 2, 3, 5, 6, 7, 8)
CLASS = 9
#: Boxes of one class that overlap at least this much in two passes are the same object.
MATCH_IOU = 0.4
#: Scores are clipped to this range before their log-odds are taken; an object that a pass does not find has score 0.
SCORE_LIMITS = (0.01, 0.99)
#: Candidates of the first pass below this score stay as they are, and objects that it missed count as found with this score:
#: boxes above it do not depend on the caller's threshold.
MIN_SCORE = 0.05
#: Area of all enlarged parts over that of the image: more parts are enlarged less.
MAX_AREA_RATIO = 1.0
#: With a smaller enlargement the pass is skipped.
MIN_SCALE = 1.2
#: New candidates are at most this many times as tall as `below_px`.
MAX_HEIGHT_RATIO = 1.25
#: A box nearer than this to the edge of a part may be truncated.
EDGE_MARGIN_PX = 3.0
#: Parts are rectangles of whole cells of this size.
CELL_PX = 8
#: x0, y0, x1, y1 in whole pixels of the image.
Part = tuple[int, int, int, int]


def rescore(
    run: Callable[[list[Image], float], list[Floats]], image_bgr: Image, candidates: Floats, settings: ReScoringPass
) -> Floats:
    """Candidates (N, 10) in pixels of the image (H, W, 3), those of medium score with the result of a second pass.

    run: the network on images of one size; returns the candidates of each above a score. The log-odds of both scores are averaged
    with `settings.share`, and so are box, foot and tip where the second pass finds the same object; else its score is 0.
    """
    result = candidates.copy()
    low, high = settings.scores
    medium = np.flatnonzero((candidates[:, 4] >= low) & (candidates[:, 4] <= high))
    windows = [window_around(image_bgr, candidates[index, :4], settings) for index in medium]
    found_in_windows = run([window for window, *_ in windows], SCORE_LIMITS[0]) if windows else []
    for index, (_, left, top, scale), found in zip(medium, windows, found_in_windows, strict=True):
        candidate = candidates[index]
        found[:, COORDINATES] = found[:, COORDINATES] / scale + np.tile((left, top), 4)
        overlaps = intersection_over_union(candidate[:4], found[:, :4]) * (found[:, CLASS] == candidate[CLASS])
        second_score = 0.0
        if (overlaps >= MATCH_IOU).any():
            # Overlap times score: of two adjacent cones, the one of higher score must not replace the other.
            same = found[np.where(overlaps >= MATCH_IOU, overlaps * found[:, 4], -1.0).argmax()]
            second_score = same[4]
            result[index] = (1.0 - settings.share) * candidate + settings.share * same
        result[index, 4] = pooled_score(candidate[4], second_score, settings.share)
    return result


def window_around(image_bgr: Image, box: Floats, settings: ReScoringPass) -> tuple[Image, float, float, float]:
    """Window (window_px, window_px, 3) in which a box (4,) [x0, y0, x1, y1] is `cone_px` tall, x and y of its top-left corner in
    the image, and its scale (window pixels per image pixel).

    The box is in the middle unless the image ends there. A window larger than the image repeats the image's edge.
    """
    side_px = max(round(settings.window_px * (box[3] - box[1]) / settings.cone_px), 2)
    left, top = (
        min(max(round((low + high - side_px) / 2), 0), max(length - side_px, 0))
        for low, high, length in ((box[0], box[2], image_bgr.shape[1]), (box[1], box[3], image_bgr.shape[0]))
    )
    cut = image_bgr[top : top + side_px, left : left + side_px]
    below, beside = side_px - cut.shape[0], side_px - cut.shape[1]
    if below or beside:
        cut = np.asarray(cv2.copyMakeBorder(cut, 0, below, 0, beside, cv2.BORDER_REPLICATE), np.uint8)
    method = cv2.INTER_CUBIC if side_px < settings.window_px else cv2.INTER_AREA
    window = cv2.resize(cut, (settings.window_px, settings.window_px), interpolation=method)
    return np.asarray(window, np.uint8), left, top, settings.window_px / side_px


def pooled_score(first: float, second: float, second_share: float) -> float:
    """One score from two in 0..1: the weighted mean of their log-odds, the second with `second_share`."""
    low, high = SCORE_LIMITS
    first, second = min(max(first, low), high), min(max(second, low), high)
    log_odds = (1.0 - second_share) * math.log(first / (1.0 - first)) + second_share * math.log(second / (1.0 - second))
    return 1.0 / (1.0 + math.exp(-log_odds))  # numpy takes ten times as long for two numbers


def detect_small_objects(
    run: Callable[[Image], NetworkBoxes],
    image_bgr: Image,
    candidates: Floats,
    settings: SmallObjectPass,
    px_per_input_px: float,
    wanted: NDArray[np.bool_] | None = None,
) -> Floats:
    """Candidates (N, 10) in pixels of the image (H, W, 3) after the small-object pass, overlaps not suppressed.

    run: the network on an enlarged part; returns candidates in pixels of that part and the score below which it may omit some.
    px_per_input_px: pixels of the image per pixel of the network's input in the first pass. wanted (N,): which candidates may
    start the pass (None: all). Log-odds of the scores, boxes, feet and tips are averaged with `settings.share`.
    """
    below_px = settings.below_px * px_per_input_px
    heights = candidates[:, 3] - candidates[:, 1]
    small = (heights < below_px) & (candidates[:, 4] >= max(settings.from_score, MIN_SCORE))
    seeds = candidates[small if wanted is None else small & wanted]
    if not len(seeds):
        return candidates
    parts = parts_around(seeds, settings.around_px * px_per_input_px, image_bgr.shape[1], image_bgr.shape[0])
    scale = enlargement(parts, settings.scale, image_bgr.shape[1] * image_bgr.shape[0])
    if scale < MIN_SCALE:
        return candidates
    result = candidates.copy()
    added = []
    for part in parts:
        found, omitted = _run_on_part(run, image_bgr, part, scale / px_per_input_px)
        found = found[_whole_in(found, part, image_bgr)]
        inside = ((candidates[:, :2] < part[2:]) & (candidates[:, 2:4] > part[:2])).all(axis=1)
        judged = _whole_in(candidates, part, image_bgr) & (heights < below_px) & (candidates[:, 4] >= MIN_SCORE)
        # Candidates too tall to be judged have counterparts as well, which are not new.
        counterparts = _counterparts(candidates, inside & (candidates[:, 4] >= MIN_SCORE), found)
        for index in np.flatnonzero(judged):
            first, same = candidates[index], counterparts[index]
            if same >= 0:
                result[index] = (1.0 - settings.share) * first + settings.share * found[same]
                score = found[same, 4]
            else:
                # The network returns a limited number of cells: an omitted one may score as high as the last of them.
                score = min(omitted, first[4]) if omitted > MIN_SCORE else 0.0
            result[index, 4] = pooled_score(first[4], score, settings.share)
        new = np.delete(found, counterparts[counterparts >= 0], axis=0)
        new = new[new[:, 3] - new[:, 1] < MAX_HEIGHT_RATIO * below_px]
        new[:, 4] = [pooled_score(MIN_SCORE, score, settings.share) for score in new[:, 4]]
        added.append(suppress_parts(new, candidates[inside & ~judged]) if len(new) else new)
    return np.concatenate((result, *added))


def _counterparts(candidates: Floats, among: NDArray[np.bool_], found: Floats) -> NDArray[np.int64]:
    """(N,) row of the found boxes (M, 10) that matches each candidate (N, 10), -1 for none; the highest score chooses first."""
    counterparts = np.full(len(candidates), -1)
    free = np.ones(len(found), bool)
    those = np.flatnonzero(among)
    for index in those[np.argsort(-candidates[those, 4], kind="stable")]:
        overlaps = intersection_over_union(candidates[index, :4], found[:, :4])
        same = free & (overlaps >= MATCH_IOU) & (found[:, CLASS] == candidates[index, CLASS])
        if same.any():
            counterparts[index] = np.where(same, overlaps * found[:, 4], -1.0).argmax()
            free[counterparts[index]] = False
    return counterparts


def parts_around(boxes: Floats, around_px: float, width_px: int, height_px: int) -> list[Part]:
    """Rectangles x0, y0, x1, y1 of an image that hold boxes (N, 4 or more) with a margin of `around_px`; no two of them touch."""
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
    """Enlargement at which all parts together have at most MAX_AREA_RATIO times the pixels of the image."""
    pixels = sum((x1 - x0) * (y1 - y0) for x0, y0, x1, y1 in parts)
    return float(min(wanted, np.sqrt(MAX_AREA_RATIO * image_px / max(pixels, 1))))


def _run_on_part(run: Callable[[Image], NetworkBoxes], image_bgr: Image, part: Part, scale: float) -> NetworkBoxes:
    """Candidates (N, 10) of an enlarged part, in pixels of the image, and the score below which some may be omitted."""
    x0, y0, x1, y1 = part
    method = cv2.INTER_CUBIC if scale > 1.0 else cv2.INTER_AREA
    size = max(round((x1 - x0) * scale), 1), max(round((y1 - y0) * scale), 1)
    enlarged = np.asarray(cv2.resize(image_bgr[y0:y1, x0:x1], size, interpolation=method), np.uint8)
    found, omitted = run(enlarged)
    found[:, COORDINATES] *= np.tile(((x1 - x0) / size[0], (y1 - y0) / size[1]), 4)
    found[:, COORDINATES] += np.tile((x0, y0), 4)
    return found, omitted


def _whole_in(boxes: Floats, part: Part, image_bgr: Image) -> NDArray[np.bool_]:
    """(N,) whether boxes (N, 4 or more) are inside a part, away from its edges; edges of the image itself do not count."""
    sides = np.array(part, np.float64)
    cut = (sides > 0) & (sides < (np.inf, np.inf, image_bgr.shape[1], image_bgr.shape[0]))
    low = np.where(cut[:2], sides[:2] + EDGE_MARGIN_PX, -np.inf)
    high = np.where(cut[2:], sides[2:] - EDGE_MARGIN_PX, np.inf)
    return np.asarray(((boxes[:, :2] >= low) & (boxes[:, 2:4] <= high)).all(axis=1))
