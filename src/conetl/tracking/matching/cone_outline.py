"""Axis and width of the body of a standing cone, or another round object, in one image.

A box gives the width of the base plate, not of the body. Both edges of the body are straight lines, each estimated as the line
of largest change of grey values across the rows, near to the prediction from box, foot and tip.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from conetl.geometry.small_arrays import upper_median
from conetl.model.arrays import Floats, Image
from conetl.model.drive import Detection
from conetl.model.feature_classes import CONE, FEATURE_CLASSES

#: Search ranges of the half width of a body, at the tip and at the foot, as shares of the width of its box. The predicted values
#: (`FeatureClass.body`) and these are from the sample drives and one real street.
_REACH_TOP, _REACH_FOOT = 0.08, 0.12
#: Rows of the body alone, as shares from tip to foot, without the blunt tip and the base plate.
BODY_ROWS = (0.08, 0.84)
_COARSE_TOP, _COARSE_FOOT, _FINE = np.linspace(-1, 1, 7), np.linspace(-1, 1, 11), np.linspace(-1, 1, 7)
#: Half width (sigma) of the window around an edge, by iteration.
_WINDOWS_PX = (1.5, 1.5, 1.2, 1.2, 1.0, 1.0, 1.0, 1.0)
_ROW_SIGMA_PX = 1.0
#: Change of grey values by noise alone, at least.
_LEAST_STEP = 2.0


@dataclass(frozen=True)
class Outline:
    """Both edges of a cone's body as straight lines; image points (0 = the centre of the first pixel)."""

    tip_row: float
    foot_row: float
    left_top: float
    """Column of the left edge in the tip's row."""
    left_foot: float
    """Likewise in the foot's row, as if the body continued into the base plate."""
    right_top: float
    right_foot: float

    def share(self, rows: Floats) -> Floats:
        """0 in the tip's row, 1 in the foot's."""
        return (rows - self.tip_row) / (self.foot_row - self.tip_row)

    def axis(self, rows: Floats) -> Floats:
        """Columns of the axis (px) in rows (px)."""
        top, foot = (self.left_top + self.right_top) / 2, (self.left_foot + self.right_foot) / 2
        return top + (foot - top) * self.share(rows)

    def radius(self, rows: Floats) -> Floats:
        """Half width of the body (px) in rows (px)."""
        top, foot = (self.right_top - self.left_top) / 2, (self.right_foot - self.left_foot) / 2
        return top + (foot - top) * self.share(rows)


def expected_outline(detection: Detection) -> Outline:
    """The outline predicted from box, foot and tip."""
    width = detection.w_px
    half_top, half_foot = (width * share for share in FEATURE_CLASSES[detection.category].body)
    middle = detection.x_px + width / 2
    tip_x, tip_y = detection.tip_px or (middle, detection.y_px)
    foot_x, foot_y = detection.foot_px or (middle, detection.y_px + detection.h_px)
    if foot_y - tip_y < 0.5 * detection.h_px:
        tip_x, tip_y, foot_x, foot_y = middle, detection.y_px, middle, detection.y_px + detection.h_px
    return Outline(
        tip_row=tip_y - 0.5, foot_row=foot_y - 0.5,
        left_top=tip_x - 0.5 - half_top, right_top=tip_x - 0.5 + half_top,
        left_foot=foot_x - 0.5 - half_foot, right_foot=foot_x - 0.5 + half_foot,
    )  # fmt: skip


def find_outline(image: Image, detection: Detection) -> Outline:
    """The outline of a detection's cone in its image (H, W, 3), uint8."""
    expected = expected_outline(detection)
    width = detection.w_px
    first = int(np.ceil(expected.tip_row + BODY_ROWS[0] * (expected.foot_row - expected.tip_row)))
    last = int(np.floor(expected.tip_row + BODY_ROWS[1] * (expected.foot_row - expected.tip_row)))
    first, last = max(first, 0), min(last, image.shape[0] - 1)
    margin = int(0.35 * width) + 3
    column0 = max(int(detection.x_px) - margin, 0)
    column1 = min(int(detection.x_px + width) + margin, image.shape[1])
    if last - first < 4 or column1 - column0 < 6:
        return expected
    patch = image[first : last + 1, column0:column1].astype(np.float64)
    steps = np.zeros(patch.shape[:2])
    steps[:, 1:-1] = np.sqrt((((patch[:, 2:] - patch[:, :-2]) / 2) ** 2).sum(axis=2))
    rows = np.arange(first, last + 1, dtype=np.float64)
    share = expected.share(rows)
    floor = max(upper_median(steps.ravel()), _LEAST_STEP)
    tops = np.array([expected.left_top, expected.right_top]) - column0
    feet = np.array([expected.left_foot, expected.right_foot]) - column0
    (left_top, right_top), (left_foot, right_foot) = (_edges(steps, share, tops, feet, width, floor) + column0).tolist()
    found = Outline(
        tip_row=expected.tip_row, foot_row=expected.foot_row,
        left_top=left_top, left_foot=left_foot, right_top=right_top, right_foot=right_foot,
    )  # fmt: skip
    radii = found.radius(rows[[0, -1]])
    least = 0.0 if detection.category != CONE else radii[0]  # only a cone must become wider towards its foot
    return found if radii[0] > 0 and radii[1] > least else expected


def _edges(steps: Floats, share: Floats, top: Floats, foot: Floats, width_px: float, floor: float) -> Floats:
    """Columns (2, 2), at tip and foot, of the lines of largest change of grey values near to the predicted ones.

    top, foot: (2,) of the predicted left and right line.
    """
    reach_top, reach_foot = max(_REACH_TOP * width_px, 1.0), max(_REACH_FOOT * width_px, 1.5)
    tops, feet = top[:, None] + reach_top * _COARSE_TOP, foot[:, None] + reach_foot * _COARSE_FOOT
    # The square root favours an edge in all rows over one bright object behind a few of them.
    score = _along(np.sqrt(steps), share, tops, feet)
    # A small preference for the predicted line decides between equal ones.
    score -= 0.1 * score.max(axis=(1, 2), keepdims=True) * (_COARSE_TOP[:, None] ** 2 + _COARSE_FOOT**2)
    tops, feet = _best(score, tops, feet)
    tops = tops[:, None] + max(0.5, reach_top / 4) * _FINE
    feet = feet[:, None] + max(0.5, reach_foot / 6) * _FINE
    start = _best(_along(steps, share, tops, feet), tops, feet)
    prior = np.array([1 / max(0.5 * reach_top, 0.3) ** 2, 1 / max(0.5 * reach_foot, 0.3) ** 2])
    return _settled(steps / floor, share, start, np.stack([top, foot]), prior)


def _best(score: Floats, tops: Floats, feet: Floats) -> Floats:
    """(2, 2) columns at tip and foot of both edges' best lines; score (2, tops, feet)."""
    i, j = np.divmod(score.reshape(len(score), -1).argmax(axis=1), score.shape[2])
    both = np.arange(len(score))
    return np.stack([tops[both, i], feet[both, j]])


def _settled(steps: Floats, share: Floats, start: Floats, expected: Floats, prior: Floats) -> Floats:
    """The lines centred on the change of grey values in each row, by mean shift (Comaniciu & Meer 2002).

    Each row has a centre of change under a window about the line; the weighted line through these is the next one. The window
    narrows, so that the line converges to one edge. steps: in units of the usual change; a row with no more than that
    determines its edge to `_ROW_SIGMA_PX`. The expected line has the weights `prior` (1/px^2). start, expected, and the result:
    (2, 2) columns at tip and foot of both edges.
    """
    columns = np.arange(steps.shape[1], dtype=np.float64)
    ends = np.stack([1 - share, share])  # (2, rows): the share of the column at the tip and at the foot
    products = np.stack([ends[0] ** 2, ends[0] * ends[1], ends[1] ** 2])
    lines = start
    for window_px in _WINDOWS_PX:
        aside = columns - (lines.T @ ends)[:, :, None]  # (edges, rows, columns)
        aside *= aside
        aside *= -0.5 / window_px**2
        weights = np.exp(aside, out=aside)
        weights *= steps
        unit = _ROW_SIGMA_PX**2 * window_px * np.sqrt(2 * np.pi)
        # Normal equations of two unknowns, written out: [a b; b c] (top, foot) = (p, q), for both edges at once.
        a, b, c = products @ weights.sum(axis=2).T / unit
        p, q = ends @ (weights @ columns).T / unit + prior[:, None] * expected
        a, c = a + prior[0], c + prior[1]
        lines = np.stack([c * p - b * q, a * q - b * p]) / (a * c - b * b)
    return lines


def _along(steps: Floats, share: Floats, tops: Floats, feet: Floats) -> Floats:
    """Mean change of grey values (2, tops, feet) along straight lines between columns (2, tops) at the tip and (2, feet)."""
    lines = (tops[:, :, None] * (1 - share))[:, :, None] + (feet[:, :, None] * share)[:, None]  # (2, tops, feet, rows)
    np.maximum(lines, 0.0, out=lines)
    np.minimum(lines, steps.shape[1] - 1.001, out=lines)
    base = lines.astype(np.intp)
    lines -= base
    base += np.arange(len(share)) * steps.shape[1]
    flat = steps.ravel()
    values = flat.take(base)
    values += lines * (flat.take(base + 1) - values)
    return np.asarray(values.mean(axis=3))
