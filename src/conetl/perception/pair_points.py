"""Points that the left and the right image of a pair both show: ORB features (Rublee et al. 2011), refined by optical flow."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from conetl.model.arrays import Bools, Floats, Image
from conetl.model.params import TrajectoryParams

#: Features are found in images of half the size.
SHRINK = 2
_FEATURES, _MAX_HAMMING = 1000, 50
_WINDOW_PX = (15, 15)
_STOP = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 0.01)
#: Features are accurate to a pixel of the smaller image and its pyramid: a refinement that moves farther found something else.
_MAX_REFINED_PX = 4.0


class Corners(NamedTuple):
    """Features of one image."""

    points_px: Floats = np.empty((0, 2))
    """(N, 2) px of the whole image."""
    descriptors: Image = np.empty((0, 32), np.uint8)
    small: Image = np.empty((0, 0), np.uint8)
    """The image in which they were found."""


def find_corners(image: Image) -> Corners:
    """Features of a grey image (H, W); none in an image without detail."""
    small = cv2.resize(image, None, fx=1 / SHRINK, fy=1 / SHRINK, interpolation=cv2.INTER_AREA)
    points, found = cv2.ORB.create(_FEATURES).detectAndCompute(small, None)
    if found is None:
        return Corners()
    points_px = np.array([point.pt for point in points]) * SHRINK
    return Corners(points_px, np.asarray(found, np.uint8), np.asarray(small, np.uint8))


def match_corners(left: Corners, right: Corners) -> tuple[Floats, Floats]:
    """(M, 2) px each: mutually best matches."""
    if not len(left.points_px) or not len(right.points_px):
        return np.empty((0, 2)), np.empty((0, 2))
    matches = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(left.descriptors, right.descriptors)
    close = [(m.queryIdx, m.trainIdx) for m in matches if m.distance < _MAX_HAMMING]
    i, j = np.array(close, dtype=np.intp).reshape(-1, 2).T
    return left.points_px[i], right.points_px[j]


def pair_points(left: Image, right: Image, params: TrajectoryParams) -> Floats:
    """(N, 4) px: u and v of points in the left and the right grey image (H, W), to a fraction of a pixel.

    A point whose way to the right image and back ends elsewhere is left out.
    """
    ours, theirs = match_corners(find_corners(left), find_corners(right))
    if not len(ours):
        return np.empty((0, 4))
    refined, found = _flow(left, right, ours, theirs)
    back, returned = _flow(right, left, refined, ours)
    closed = np.linalg.norm(back - ours, axis=1) <= params.circle_tolerance_px
    near = np.linalg.norm(refined - theirs, axis=1) <= _MAX_REFINED_PX
    return np.asarray(np.column_stack([ours, refined])[found & returned & closed & near])


def _flow(source: Image, target: Image, points_px: Floats, guess_px: Floats) -> tuple[Floats, Bools]:
    """(N, 2) points in another image, from a guess, and (N,) whether they were found."""
    moved, status, _ = cv2.calcOpticalFlowPyrLK(
        source, target, points_px.astype(np.float32), guess_px.astype(np.float32), maxLevel=0, winSize=_WINDOW_PX,
        criteria=_STOP, flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )  # fmt: skip
    return np.asarray(moved, np.float64), status.reshape(-1).astype(bool) & np.isfinite(moved).all(axis=1)
