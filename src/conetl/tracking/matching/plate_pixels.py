"""Pixels of the left image used to match a flat object: a sign, a board, a panel, a barricade.

Its surface is an upright plane that faces the camera, with slopes across and down as the unknowns of the matching that for a cone
are the nearness of its surface and its lean (`area_matching.py`). Only the middle of the box is used: what is in its corners, and
between the boards of a barricade, lies behind the object, and is down-weighted where it disagrees.

Boxes of detectors are off by a share of the object's size: where a board ends is found in the images (`board_edges`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from conetl.model.arrays import Floats, Image
from conetl.model.drive import Detection
from conetl.model.feature_classes import FEATURE_CLASSES
from conetl.model.rig import Camera
from conetl.tracking.matching.apparent_boxes import nearer_boxes
from conetl.tracking.matching.cone_pixels import Beyond, BodyPixels, smooth, some_rows

#: Half axes of the ellipse inside of a plate, as shares of the box: that of a diamond touches it at 0.35.
_ELLIPSE = 0.36
#: The used rows of the box of other flat objects, from the top, where their boards are; `FeatureClass.board` is half its width.
_ROWS = (0.04, 0.75)
#: The part of a board whose mean colours are compared, as shares of the box; sigma of the box's edges, as a share of its height;
#: pixels on both sides of the largest change that belong to it. Chosen on eight rendered drives
#: (benchmarks/RESULTS.md).
_INNER, _EDGE_SHARE, _BLUR_PX = (0.2, 0.8), 0.06, 2


@dataclass(frozen=True)
class Plate:
    """The middle of a flat object in an image: a rectangle, or the ellipse inside of it (px)."""

    left: float
    right: float
    top: float
    bottom: float
    foot_row: float
    """Of the lower edge of the box."""
    elliptic: bool
    before: tuple[Detection, ...] = ()
    """Nearer objects that may hide parts of it."""


def find_plate(detection: Detection, others: Sequence[Detection] = ()) -> Plate:
    """The part of a detection's box that shows its object. others: detections in the same image."""
    middle, top = detection.x_px + detection.w_px / 2 - 0.5, detection.y_px - 0.5
    its = FEATURE_CLASSES[detection.category]
    elliptic = not its.on_road
    half = detection.w_px * (_ELLIPSE if elliptic else its.board)
    first, last = (0.5 - _ELLIPSE, 0.5 + _ELLIPSE) if elliptic else _ROWS
    height = detection.h_px
    before = tuple(nearer_boxes((middle - half, top, middle + half, top + height), others))
    return Plate(
        middle - half, middle + half, top + first * height, top + last * height, top + height, elliptic, before
    )


def plate_pixels(left: Image, plate: Plate, camera: Camera, up: Floats) -> BodyPixels | None:
    """The pixels of a plate, with the plane over them; None if there are too few. up: unit vector (3,) in the camera's frame."""
    v = np.arange(max(int(np.ceil(plate.top)), 0), min(int(plate.bottom), left.shape[0] - 1) + 1)
    u = np.arange(max(int(np.ceil(plate.left)), 0), min(int(plate.right), left.shape[1] - 1) + 1)
    if len(v) < 4 or len(u) < 4:
        return None
    middle = (plate.left + plate.right) / 2
    inside = np.ones((len(v), len(u)), dtype=bool)
    if plate.elliptic:
        across = (u - middle) / (plate.right - middle)
        down = (2 * v - plate.top - plate.bottom) / (plate.bottom - plate.top)
        inside = across[None, :] ** 2 + down[:, None] ** 2 <= 1
    for one in plate.before:
        columns = (u >= one.x_px - 0.5) & (u <= one.x_px + one.w_px - 0.5)
        inside &= ~(((v >= one.y_px - 0.5) & (v <= one.y_px + one.h_px - 0.5))[:, None] & columns)
    chosen = some_rows(inside)
    if chosen is None:
        return None
    i, j = chosen
    # An upright plane's normal is the level part of the camera's axis: rows are at different depths if that looks up or down.
    normal = np.array([0.0, 0.0, 1.0]) - up[2] * up
    x, y = (u[j] - camera.cx_px) / camera.fx_px, (v[i] - camera.cy_px) / camera.fy_px
    foot = np.array([(middle - camera.cx_px) / camera.fx_px, (plate.foot_row - camera.cy_px) / camera.fy_px, 1.0])
    depth = foot @ normal / (normal[0] * x + normal[1] * y + normal[2])
    count = len(i)
    values, *slopes = (part[i, j] for part in smooth(left, v, u))
    none = np.zeros(0)
    return BodyPixels(
        v[i], u[j], values, np.stack(slopes), depth=depth, nearer=(u[j] - middle) / camera.fx_px,
        height=(plate.foot_row - v[i]) / camera.fy_px, at_edge=np.zeros((count, 2)), edge=np.zeros(count, dtype=np.intp),
        cover=np.zeros(count), beyond=Beyond(none.astype(np.intp), none, none, np.zeros((0, 2, values.shape[1]))),
    )  # fmt: skip


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
