"""Where boards end, from the images: boxes of detectors are off by a share of the object's size."""

from __future__ import annotations

import numpy as np

from conetl.model.arrays import Floats, Image
from conetl.model.drive import Detection

#: The part of a board whose mean colours are compared, as shares of the box; sigma of the box's edges, as a share of its height;
#: pixels on both sides of the largest change that belong to it. Chosen on eight rendered drives
#: (docs/explanation/accuracy.md).
_INNER, _EDGE_SHARE, _BLUR_PX = (0.2, 0.8), 0.06, 2


def board_edges(image: Image, detection: Detection) -> Detection:
    """The detection with the edges of its board, which is upright and level, in its image (H, W, 3) instead of its box's."""
    x, y, w, h = detection.x_px, detection.y_px, detection.w_px, detection.h_px
    across = image[int(y + _INNER[0] * h) : int(y + _INNER[1] * h) + 1].mean(axis=0)
    down = image[:, int(x + _INNER[0] * w) : int(x + _INNER[1] * w) + 1].mean(axis=1)
    left, right = (_largest_change(across, end, h) for end in (x, x + w))
    top, bottom = (_largest_change(down, end, h) for end in (y, y + h))
    return detection.model_copy(update={"x_px": left, "w_px": right - left, "y_px": top, "h_px": bottom - top})


def _largest_change(profile: Floats, end_px: float, height_px: float) -> float:
    """Where the colours (n, channels) of successive pixels change most near to the end of a box; both from the image's edge.

    height_px: of the box; its other end is never taken.
    """
    sigma_px = max(_EDGE_SHARE * height_px, 1.0)
    reach_px = min(3 * sigma_px + 2, height_px / 3)
    first = max(int(end_px - reach_px), 0)
    near = profile[first : int(end_px + reach_px) + 1]
    change = np.sqrt(((near[2:] - near[:-2]) ** 2).sum(axis=1))
    at = first + 1.5 + np.arange(len(change))
    best = int(np.argmax(change * np.exp(-0.5 * ((at - end_px) / sigma_px) ** 2)))
    part = slice(max(best - _BLUR_PX, 0), best + _BLUR_PX + 1)
    weights = change[part] - change[part].min()
    return float(weights @ at[part] / weights.sum()) if weights.any() else end_px
