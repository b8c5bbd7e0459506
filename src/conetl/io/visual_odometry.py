"""Image points that stand still in the world, followed through the four pictures of two consecutive frame pairs.

Corners spread over the left picture are found at half its size and get a disparity by block matching at a quarter of it, since
both only say where to begin. At full size they are then followed by pyramidal Lucas-Kanade (Bouguet 2001) round a circle:
left -> right, left -> next left -> next right, and right -> next right must end at the same point, and the way back from the
next left must lead home. Points without disparity (sky, clouds, far scenery) are left out.
Which of the points belong to moving objects is found later (`geometry/stereo_motion.py`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from conetl.geometry.stereo_motion import RelativeMotion, StereoCameras, project, triangulate
from conetl.geometry.stereo_tracks import NoMeasurement, StereoTracks, cameras_of, expected_motions, motions_of
from conetl.io.pictures.images import ImageFileError
from conetl.params import TrajectoryParams
from conetl.records import FramePair, Rig, Side

Floats = NDArray[np.float64]
Bytes = NDArray[np.uint8]
Points = NDArray[np.float32]
#: Reads one rectified picture of a frame pair, grey or in blue, green, red order; raises ImageFileError.
PictureReader = Callable[[FramePair, Side], Bytes]
_Found = tuple[Floats, Floats, float, NoMeasurement | None]

#: Side of the windows that are followed, px. Larger ones cost time in proportion to their area, and the cones of the street stood
#: no stiller for it; but over the spans of self-calibration, which are few, a hundredth of a pixel counts.
_WINDOW_PX, _WINDOW_OF_SPANS_PX = 11, 15
_STOP = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 20, 0.01)
#: Of ways back, which are only compared with a tolerance of most of a pixel.
_STOP_OF_CHECKS = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 20, 0.05)
#: Least eigenvalue of a corner's structure matrix as a share of a strong corner's: weaker ones are followed badly.
_WEAK_SHARE = 0.004
#: Grey values of a picture must spread at least this much for anything to be followed.
_LEAST_CONTRAST = 3.0
#: Side of what block matching compares, at a quarter of the size.
_BLOCK_PX = 9
#: Disparities are searched up to this share of a picture's width.
_WIDEST_DISPARITY = 0.12


@dataclass(frozen=True)
class _Frame:
    """Both pictures of one frame pair, grey, at working size; both at a quarter of it, the left one at half of it, too."""

    left: Bytes
    right: Bytes
    half_left: Bytes
    quarter_left: Bytes
    quarter_right: Bytes


def measure_motions(
    frame_pairs: Sequence[FramePair], rig: Rig, read: PictureReader, params: TrajectoryParams
) -> Iterator[RelativeMotion]:
    """Motion between each frame pair and the next: len(frame_pairs) - 1 results, in order, each as soon as it is known.

    Equal inputs give equal results. An interval without a measurement says so in `reason`.
    """
    yield from motions_of(follow_drive(frame_pairs, rig, read, params), frame_pairs, rig, params)


def follow_drive(
    frame_pairs: Sequence[FramePair], rig: Rig, read: PictureReader, params: TrajectoryParams
) -> Iterator[StereoTracks]:
    """Points between each frame pair and the next: len(frame_pairs) - 1 results, in order.

    Dark, blank, frozen, missing or broken pictures give a result with `missing` set, never an exception.
    """
    cameras, previous = cameras_of(rig), None
    guesses = expected_motions(frame_pairs, rig)
    for k, pair in enumerate(frame_pairs):
        frame = _prepare(pair, read, params)
        if previous is not None:
            found = _between(previous[0], frame[0], frame[1], cameras, guesses[k - 1], params)
            yield _tracks(frame_pairs[k - 1], pair, *found)
        previous = frame


def follow_span(
    first: FramePair, last: FramePair, guess: Floats, rig: Rig, read: PictureReader, params: TrajectoryParams
) -> StereoTracks:
    """Points between two frame pairs that need not be neighbours; guess (4, 4): last_SE3_first of the left camera.

    What is searched reaches a little farther than between neighbours (pyramid), the guess must be good to some pixels.
    """
    (start, _), (end, scale) = _prepare(first, read, params), _prepare(last, read, params)
    return _tracks(first, last, *_between(start, end, scale, cameras_of(rig), guess, params, _WINDOW_OF_SPANS_PX))


def _prepare(pair: FramePair, read: PictureReader, params: TrajectoryParams) -> tuple[_Frame | NoMeasurement, float]:
    """One frame pair at working size, and the scale from stored to working pixels."""
    grey: list[Bytes] = []
    scale = 1.0
    for side in ("left", "right"):
        try:
            picture = read(pair, side)
        except ImageFileError:
            return NoMeasurement.PICTURE_UNREADABLE, scale
        scale = min(1.0, params.max_width_px / picture.shape[1])
        if picture.ndim == 3:
            picture = np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), dtype=np.uint8)
        if scale < 1.0:
            size = (round(picture.shape[1] * scale), round(picture.shape[0] * scale))
            picture = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        if float(cv2.meanStdDev(picture)[1][0, 0]) < _LEAST_CONTRAST:
            return NoMeasurement.PICTURE_BLANK, scale
        grey.append(picture)
    halves = [_halved(picture) for picture in grey]
    return _Frame(grey[0], grey[1], halves[0], *(_halved(picture) for picture in halves)), scale


def _halved(picture: Bytes) -> Bytes:
    """Means of two by two pixels. A last odd row or column is left out: with a ratio of exactly two OpenCV is 30 times faster."""
    height, width = (size // 2 for size in picture.shape)
    if not height or not width:
        return picture
    half = cv2.resize(picture[: 2 * height, : 2 * width], (width, height), interpolation=cv2.INTER_AREA)
    return np.asarray(half, dtype=np.uint8)


def _between(
    first: _Frame | NoMeasurement,
    second: _Frame | NoMeasurement,
    scale: float,
    cameras: StereoCameras,
    expected: Floats,
    params: TrajectoryParams,
    window_px: int = _WINDOW_PX,
) -> _Found:
    """Points (N, 4) in stored pixels (u and v left, u and v right) of the first and second pair, their sigma, what is missing."""
    if isinstance(first, NoMeasurement):
        return _nothing(first)
    if isinstance(second, NoMeasurement):
        return _nothing(second)
    if first.left.shape != second.left.shape:
        return _nothing(NoMeasurement.PICTURE_UNREADABLE)
    if np.array_equal(first.left, second.left) or np.array_equal(first.right, second.right):
        return _nothing(NoMeasurement.PICTURE_FROZEN)  # not even noise differs: a stuck camera, no standing car
    corners = _corners(first.half_left, params)
    disparity = _disparity(first, corners)
    known = np.isfinite(disparity) & (disparity >= params.min_disparity_px * scale)
    left = corners[known]
    if len(left) < params.min_points:
        return _nothing(NoMeasurement.TOO_FEW_POINTS)
    right, good = _flow(first.left, first.right, left, left - _along_rows(disparity[known]), 0, window_px)
    rows = (cameras.right_px[3] - cameras.left_px[3]) * scale
    good &= np.abs(right[:, 1] - left[:, 1] - rows) <= params.epipolar_tolerance_px
    left, right = left[good], right[good]
    # Where the points should be in the next pair, if INS is right and they stand still.
    points, _, placed = triangulate(cameras, _joined(left, right)[:, :3] / scale)
    image, _, ahead = project(cameras, points @ expected[:3, :3].T + expected[:3, 3])
    height, width = first.left.shape
    guess = (image * scale).astype(np.float32)
    inside = placed & ahead & (guess[:, 0] > 0) & (guess[:, 0] < width) & (guess[:, 1] > 0) & (guess[:, 1] < height)
    left, right, guess = left[inside], right[inside], guess[inside]
    if len(left) < params.min_points:
        return _nothing(NoMeasurement.TOO_FEW_POINTS)
    # Who fails at one side of the circle is not followed round the others.
    next_left, good = _flow(first.left, second.left, left, guess[:, :2], 2, window_px)
    left, right, guess, next_left = left[good], right[good], guess[good], next_left[good]
    home, good = _flow(second.left, first.left, next_left, left, 0, window_px, _STOP_OF_CHECKS)
    good &= np.linalg.norm(home - left, axis=1) <= params.circle_tolerance_px
    left, right, guess, next_left = left[good], right[good], guess[good], next_left[good]
    across = next_left - _along_rows(guess[:, 0] - guess[:, 2])
    next_right, good = _flow(second.left, second.right, next_left, across, 0, window_px)
    good &= np.abs(next_right[:, 1] - next_left[:, 1] - rows) <= params.epipolar_tolerance_px
    good &= next_left[:, 0] - next_right[:, 0] >= params.min_disparity_px * scale / 2
    left, right, next_left, next_right = left[good], right[good], next_left[good], next_right[good]
    other_way, good = _flow(first.right, second.right, right, next_right, 0, window_px, _STOP_OF_CHECKS)
    good &= np.linalg.norm(other_way - next_right, axis=1) <= params.circle_tolerance_px
    if int(good.sum()) < params.min_points:
        return _nothing(NoMeasurement.TOO_FEW_POINTS)
    first_px = _joined(left[good], right[good]) / scale
    return first_px, _joined(next_left[good], next_right[good]) / scale, params.sigma_px / scale, None


def _corners(half: Bytes, params: TrajectoryParams) -> Points:
    """Corners (N, 2) of a picture that comes at half its size: the best few of each cell of a grid, so that no textured wall
    takes them all."""
    response = cv2.cornerMinEigenVal(half, 5)
    highest = cv2.dilate(response, np.ones((5, 5), np.uint8))
    strong = float(np.quantile(response[::4, ::4], 0.99))
    border = 6
    inner, around = (picture[border:-border, border:-border] for picture in (response, highest))
    # One row after the other: numpy finds the few set elements of a mask much faster in one dimension than in two.
    chosen = np.flatnonzero((inner == around) & (inner > max(_WEAK_SHARE * strong, 1e-9)))
    rows, columns = np.divmod(chosen, max(inner.shape[1], 1)) + np.array(border)
    strength = response[rows, columns]
    cell = 2 * rows // params.cell_px * 10_000 + 2 * columns // params.cell_px
    order = np.lexsort((-strength, cell))
    start = np.r_[0, np.flatnonzero(np.diff(cell[order])) + 1] if len(order) else np.zeros(0, dtype=np.intp)
    rank = np.arange(len(order)) - np.repeat(start, np.diff(np.r_[start, len(order)]))
    chosen = order[rank < params.corners_per_cell]
    return 2 * np.stack([columns[chosen], rows[chosen]], axis=1).astype(np.float32) + np.float32(0.5)


def _disparity(frame: _Frame, corners: Points) -> Floats:
    """Rough disparity (N,) px of corners by block matching at a quarter of the size; NaN where there is none."""
    height, width = frame.quarter_left.shape
    if not len(corners) or min(height, width) < _BLOCK_PX:
        return np.full(len(corners), np.nan)
    steps = max(int(np.ceil(frame.left.shape[1] / 4 * _WIDEST_DISPARITY / 16)) * 16, 16)
    matcher = cv2.StereoBM.create(numDisparities=steps, blockSize=_BLOCK_PX)
    matcher.setUniquenessRatio(8)
    table = matcher.compute(frame.quarter_left, frame.quarter_right)
    at = np.clip(((corners - 1.5) / 4).round().astype(int), 0, [width - 1, height - 1])
    raw = table[at[:, 1], at[:, 0]].astype(np.float64)
    return np.where(raw > 0, raw / 16 * 4, np.nan)


def _flow(
    source: Bytes,
    target: Bytes,
    points: Points,
    guess: NDArray[np.floating],
    levels: int,
    window_px: int,
    stop: tuple[int, int, float] = _STOP,
) -> tuple[Points, NDArray[np.bool_]]:
    """Where points (N, 2) of one picture are in another, beginning at a guess on the `levels`-th pyramid level."""
    if not len(points):
        return points, np.zeros(0, dtype=bool)
    start = np.ascontiguousarray(guess, dtype=np.float32)
    found, status, _ = cv2.calcOpticalFlowPyrLK(
        source, target, np.ascontiguousarray(points), start.copy(), winSize=(window_px, window_px), maxLevel=levels,
        criteria=stop, flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )  # fmt: skip
    return np.asarray(found, dtype=np.float32), status.reshape(-1).astype(bool) & np.isfinite(found).all(axis=1)


def _along_rows(disparity: NDArray[np.floating]) -> Points:
    return np.stack([disparity, np.zeros_like(disparity)], axis=1).astype(np.float32)


def _joined(left: Points, right: Points) -> Floats:
    return np.column_stack([left, right]).astype(np.float64)


def _nothing(reason: NoMeasurement) -> _Found:
    return np.zeros((0, 4)), np.zeros((0, 4)), 1.0, reason


def _tracks(
    first: FramePair,
    second: FramePair,
    first_px: Floats,
    second_px: Floats,
    sigma_px: float,
    missing: NoMeasurement | None,
) -> StereoTracks:
    return StereoTracks(
        first_frame_index=first.frame_index, second_frame_index=second.frame_index,
        first_px=tuple(first_px.ravel().tolist()), second_px=tuple(second_px.ravel().tolist()), sigma_px=sigma_px,
        missing=missing,
    )  # fmt: skip
