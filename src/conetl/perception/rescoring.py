"""Re-scoring pass: the network runs again on a small window around each candidate of medium score, scaled to a fixed height.

A tail lamp that resembles a cone at 20 px rarely does at 48 px. Both scores are combined as a logarithmic opinion pool (Genest &
Zidek 1986, Statistical Science 1:114).
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from conetl.perception.decoding import intersection_over_union
from conetl.perception.model_card import ReScoringPass

Floats = NDArray[np.float64]
Image = NDArray[np.uint8]

#: Columns of a candidate that hold x and y in turn; column 4 is the score.
COORDINATES = (0, 1, 2, 3, 5, 6, 7, 8)
#: Boxes of two passes that overlap at least this much are the same object.
MATCH_IOU = 0.4
#: Scores are clipped to this range before their log-odds are taken; an object that a pass does not find has score 0.
SCORE_LIMITS = (0.01, 0.99)


def rescore(
    run: Callable[[list[Image], float], list[Floats]], image_bgr: Image, candidates: Floats, settings: ReScoringPass
) -> Floats:
    """Candidates (N, 9) in pixels of the image (H, W, 3), those of medium score with the result of a second pass.

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
        overlaps = intersection_over_union(candidate[:4], found[:, :4])
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
    shares = np.array((1.0 - second_share, second_share))
    scores = np.clip((first, second), *SCORE_LIMITS)
    return float(1.0 / (1.0 + np.exp(-(shares @ np.log(scores / (1.0 - scores))))))
