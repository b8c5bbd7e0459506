"""Where objects end, from the images: boxes of detectors are off by a share of the object's size.

A board ends where its mean colour changes. A barricade, whose box may end at its feet, at their shadow or at its posts, ends
where the ground has its disparity.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from conetl.geometry.camera import rays
from conetl.model.arrays import Floats, Image
from conetl.model.drive import Detection
from conetl.model.rig import Camera
from conetl.tracking.matching.apparent_boxes import nearer_boxes
from conetl.tracking.matching.area_matching import match_area
from conetl.tracking.matching.plate_pixels import Plate

#: The part of a board whose mean colours are compared, as shares of the box; sigma of the box's edges, as a share of its height;
#: pixels on both sides of the largest change that belong to it. Chosen, as the others here, on eight rendered drives
#: (docs/explanation/accuracy.md).
_INNER, _EDGE_SHARE, _BLUR_PX = (0.2, 0.8), 0.06, 2
#: The ground that is matched, as shares of the box: half width, which leaves out the feet, and rows above and below its end; the
#: search for its disparity, as a share of the object's.
_GROUND, _GROUND_SEARCH = (0.3, 0.03, 0.15), 0.15
#: Least slope (rad) of the ray to the ground, and least rows of it: of few rows, feet and posts decide.
_LEAST_DOWNWARDS, _LEAST_ROWS = 0.02, 7


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


def ground_row(
    images: tuple[Image, Image],
    detection: Detection,
    others: Sequence[Detection],
    disparity_px: float,
    *,
    camera: Camera,
    up: Floats,
    at_infinity_px: float = 0.0,
    row_offset_px: float = 0.0,
) -> float | None:
    """Row of the left image where the ground has the disparity of an object that stands on it; None if that is not visible.

    disparity_px: the object's. others: detections in the left image. The rest as for `match_area`.
    """
    middle, end = detection.x_px + detection.w_px / 2 - 0.5, detection.y_px + detection.h_px - 0.5
    half, top, bottom = (
        share * size for share, size in zip(_GROUND, (detection.w_px, detection.h_px, detection.h_px), strict=True)
    )
    downwards = -rays(camera, [(middle, end - top), (middle, end)]) @ up
    if downwards[0] < _LEAST_DOWNWARDS or top + bottom < _LEAST_ROWS:
        return None
    before = tuple(nearer_boxes((middle - half, detection.y_px, middle + half, end), others))
    ground = Plate(
        middle - half, middle + half, end - top, end + bottom, end, elliptic=False, before=before, lying=True
    )
    search_px = max(3.0, _GROUND_SEARCH * disparity_px)
    area = match_area(
        *images, ground, disparity_px, search_px,
        camera=camera, up=up, at_infinity_px=at_infinity_px, row_offset_px=row_offset_px,
    )  # fmt: skip
    if area is None:
        return None
    # On a plane the disparity is in proportion to the ray's component along its normal.
    nearer = (disparity_px - at_infinity_px) / (area.disparity_px - at_infinity_px)
    return float(end - camera.fy_px * (nearer - 1) * downwards[1] / up[1])
