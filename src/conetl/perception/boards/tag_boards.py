"""Boards with numbered markers: ChArUco and Kalibr's AprilGrid."""

from __future__ import annotations

from itertools import product

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Grey = NDArray[np.uint8]

_REFINE = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 60, 1e-4)


def find_charuco(
    image: Grey, cols: int, rows: int, square_m: float, marker_m: float, dictionary: str
) -> tuple[Ints, Array]:
    """Numbers (n,) and places (n, 2) px of the inner corners of a ChArUco board of cols x rows squares.

    Boards made before OpenCV 4.6 begin with another colour in their first corner; both kinds are tried.
    """
    words = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{dictionary}"))
    best: tuple[Ints, Array] = (np.zeros(0, dtype=np.int64), np.zeros((0, 2)))
    for legacy in (False, True):
        board = cv2.aruco.CharucoBoard((cols, rows), square_m, marker_m, words)
        board.setLegacyPattern(legacy)
        corners, ids, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(image)
        if ids is not None and len(ids) > len(best[0]):
            best = ids.ravel().astype(np.int64), corners.reshape(-1, 2).astype(np.float64)
    return best


def find_april_grid(image: Grey, cols: int, rows: int, spacing: float) -> tuple[Ints, Array]:
    """Numbers (n,) and places (n, 2) px of the tag corners of an AprilGrid (tag36h11, Kalibr's layout).

    Tags are numbered row by row from the lower left; corner 4 t + k is the lower left, lower right, upper right, upper left one
    of tag t. Which corner of a tag a detector calls first differs between libraries: the turn that makes one flat grid is taken.
    """
    words = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    # By outline, not by OpenCV's AprilTag detector: that one loses tags whose corners touch the black squares between them.
    quads, ids, _ = cv2.aruco.ArucoDetector(words, cv2.aruco.DetectorParameters()).detectMarkers(image)
    none: tuple[Ints, Array] = (np.zeros(0, dtype=np.int64), np.zeros((0, 2)))
    if ids is None:
        return none
    tags = ids.ravel().astype(np.int64)
    once = np.array([(tags == tag).sum() == 1 and tag < cols * rows for tag in tags])
    if once.sum() < 2:
        return none
    tags, corners = tags[once], np.array(quads)[once].reshape(-1, 4, 2).astype(np.float64)
    side = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).min(axis=1)
    best_miss, best = np.inf, corners
    origins = np.stack([tags % cols, tags // cols], axis=1) * (1.0 + spacing)
    plane = (origins[:, None] + np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])).reshape(-1, 2)
    for turn, backwards in product(range(4), (False, True)):
        order = np.roll(corners[:, ::-1] if backwards else corners, turn, axis=1)
        homography, _ = cv2.findHomography(plane, order.reshape(-1, 2), cv2.RANSAC, float(np.median(side)) * 0.1)
        if homography is None:
            continue
        mapped = cv2.perspectiveTransform(plane[None], homography)[0]
        miss = float(np.median(np.linalg.norm(mapped - order.reshape(-1, 2), axis=1)))
        if miss < best_miss:
            best_miss, best = miss, order
    if not best_miss < 0.1 * float(np.median(side)):
        return none
    # Kalibr's grid has a black square at each corner of a tag: a saddle point, which is refined in a window within it.
    refined = []
    for quad, length in zip(best, side, strict=True):
        window = int(np.clip(0.25 * spacing * length, 2, 7))
        start = quad.astype(np.float32).reshape(-1, 1, 2).copy()
        refined.append(cv2.cornerSubPix(image, start, (window, window), (-1, -1), _REFINE).reshape(4, 2))
    uv = np.array(refined, dtype=np.float64)
    settled = np.linalg.norm(uv - best, axis=2) < np.maximum(0.1 * side, 1.5)[:, None]
    numbers = 4 * tags[:, None] + np.arange(4)
    return numbers[settled], uv[settled]
