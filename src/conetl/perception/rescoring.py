"""A closer look at what the detector is unsure of: the same network once more, on a small window scaled to the candidate.

A tail lamp that passes for a cone at 20 px seldom does so once it is scaled to 48 px, and a cone stays one. Both judgements are
joined as a logarithmic opinion pool (Genest & Zidek 1986, Statistical Science 1:114).
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from conetl.perception.decoding import intersection_over_union
from conetl.perception.model_card import CloserLook

Floats = NDArray[np.float64]
Image = NDArray[np.uint8]

#: Columns of a candidate that are x and y by turns; between them lies the score.
PLACES = (0, 1, 2, 3, 5, 6, 7, 8)
#: The closer look sees the same thing where its box covers the candidate's that well.
SAME_THING_IOU = 0.4
#: No look is believed to be surer than that: where the network sees nothing, there is no score to take a logarithm of.
SUREST = (0.01, 0.99)


def look_closer(
    look: Callable[[list[Image], float], list[Floats]], image_bgr: Image, candidates: Floats, settings: CloserLook
) -> Floats:
    """Candidates (N, 9) of `detector.look` in pixels of the image (H, W, 3), with those of middling score judged once more.

    look: runs the network on images of one size and gives the candidates above a score of each. The log-odds of both looks are
    averaged with the closer one's share, and so are box, foot and tip where the closer look sees the same thing; where it sees
    nothing there, its score is the least. The order of the rows stays.
    """
    result = candidates.copy()
    least, most = settings.scores
    middling = np.flatnonzero((candidates[:, 4] >= least) & (candidates[:, 4] <= most))
    windows = [window_around(image_bgr, candidates[index, :4], settings) for index in middling]
    seen_in_windows = look([window for window, *_ in windows], SUREST[0]) if windows else []
    for index, (_, left, top, scale), seen in zip(middling, windows, seen_in_windows, strict=True):
        candidate = candidates[index]
        seen[:, PLACES] = seen[:, PLACES] / scale + np.tile((left, top), 4)
        overlaps = intersection_over_union(candidate[:4], seen[:, :4])
        closer_score = 0.0
        if (overlaps >= SAME_THING_IOU).any():
            # Of two cones side by side the surer one must not stand in for the other.
            same = seen[np.where(overlaps >= SAME_THING_IOU, overlaps * seen[:, 4], -1.0).argmax()]
            closer_score = same[4]
            result[index] = (1.0 - settings.share) * candidate + settings.share * same
        result[index, 4] = pooled(candidate[4], closer_score, settings.share)
    return result


def window_around(image_bgr: Image, box: Floats, settings: CloserLook) -> tuple[Image, float, float, float]:
    """A window (window_px, window_px, 3) in which a box (4,) [x0, y0, x1, y1] is `cone_px` tall, and where it lies.

    The box is in its middle, or nearer to the side where the image ends: what the edge cuts is cut there too. Also returns the
    image's x and y at the window's top-left corner and the scale (window pixels per image pixel). Where the window is larger than
    the image, the image's edge is repeated.
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


def pooled(first: float, closer: float, closer_share: float) -> float:
    """One score from two in 0..1: the mean of their log-odds, the second with `closer_share`."""
    shares = np.array((1.0 - closer_share, closer_share))
    scores = np.clip((first, closer), *SUREST)
    return float(1.0 / (1.0 + np.exp(-(shares @ np.log(scores / (1.0 - scores))))))
