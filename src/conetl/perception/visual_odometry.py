"""Points of the static scene followed through the four images of two frame pairs (pyramidal Lucas-Kanade, Bouguet 2001).

Corners get a rough disparity by block matching and are followed left -> right, left -> next left -> next right and right -> next
right, which must end at the same point. Points without disparity (sky, far scenery) are left out.
Points on moving objects are found later (`geometry/motion/stereo_motion.py`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from conetl.geometry.motion.rolling_shutter import readout_sigma_s
from conetl.geometry.motion.stereo_motion import StereoCameras, project, triangulate
from conetl.geometry.motion.stereo_tracks import NoMeasurement, StereoTracks, cameras_of, motions_to_try
from conetl.model.arrays import Bools, Floats, Image
from conetl.model.drive import FramePair
from conetl.model.params import TrajectoryParams
from conetl.model.rig import Rig, Side
from conetl.perception.checks.torn_images import row_changes
from conetl.perception.working_size import ImageReader, WorkingImages, WorkingSize, read_working_images, working_size

Points = NDArray[np.float32]
_Found = tuple[Floats, Floats, float, NoMeasurement | None]
_Size = tuple[int, int]

#: Width and height of the windows that are followed, px. Time grows with their area and cones gain nothing from it; the few
#: spans of self-calibration, where 0.01 px counts, use larger ones. OpenCV computes eight columns at once and the rest of a row
#: one by one: windows of 11 x 11 are no more accurate and take 1.5 times as long.
_WINDOW_PX: _Size = (16, 7)
_WINDOW_OF_SPANS_PX: _Size = (16, 14)
#: A point is found when its last step is below 0.05 px: with 0.01 px motions are no more accurate.
_STOP = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 20, 0.05)
#: Least eigenvalue of a corner's structure matrix as a share of a strong corner's: weaker ones are skipped.
_WEAK_SHARE = 0.004
#: Side of the blocks that are matched, at a quarter of the size.
_BLOCK_PX = 9
#: Disparities are searched up to this share of the image width. Block matching finds no disparity of points within this
#: distance of the left border: a wider search loses more points than it finds.
_WIDEST_DISPARITY = 0.10


def follow_drive(
    frame_pairs: Sequence[FramePair], rig: Rig, read: ImageReader, params: TrajectoryParams
) -> Iterator[StereoTracks]:
    """Points between each frame pair and the next: len(frame_pairs) - 1 results, in order.

    Dark, blank, frozen, missing or broken images give a result with `missing` set, never an exception.
    """
    cameras, working = cameras_of(rig), working_size(rig, params.max_width_px)
    previous: WorkingImages | NoMeasurement | None = None
    guesses = motions_to_try(frame_pairs, rig)
    for k, pair in enumerate(frame_pairs):
        images = read_working_images(pair, read, working)
        if previous is not None:
            every = [_follow_pair(previous, images, working, cameras, guess, params) for guess in guesses[k - 1]]
            found = max(every, key=lambda one: len(one[0]))
            tracks = _tracks(frame_pairs[k - 1], pair, *found)
            if not isinstance(previous, NoMeasurement) and not isinstance(images, NoMeasurement):
                changes = [row_changes(previous.left, images.left), row_changes(previous.right, images.right)]
                tracks = tracks.model_copy(update={"row_changes": tuple(np.concatenate(changes).tolist())})
            yield tracks
        previous = images


def follow_spans(
    spans: Iterable[tuple[int, int, Floats]],
    frame_pairs: Sequence[FramePair],
    rig: Rig,
    read: ImageReader,
    params: TrajectoryParams,
) -> Iterator[StereoTracks]:
    """Points between two frame pairs that need not be neighbours, for each span in order.

    spans: positions of the first and last pair in `frame_pairs`, and a guess (4, 4) of last_SE3_first of the left camera, which
    must be good to some pixels. Images of a pair that ends one span and begins the next are read once.
    """
    cameras, working = cameras_of(rig), working_size(rig, params.max_width_px)
    # An unknown readout shows in how points move where the image grows; there large windows are followed too far.
    window_px = _WINDOW_PX if readout_sigma_s(rig) else _WINDOW_OF_SPANS_PX
    at, end = -1, None
    for first, last, guess in spans:
        start = end if end is not None and at == first else read_working_images(frame_pairs[first], read, working)
        at, end = last, read_working_images(frame_pairs[last], read, working)
        found = _follow_pair(start, end, working, cameras, guess, params, window_px)
        yield _tracks(frame_pairs[first], frame_pairs[last], *found)


def _follow_pair(
    first: WorkingImages | NoMeasurement,
    second: WorkingImages | NoMeasurement,
    working: WorkingSize,
    cameras: StereoCameras,
    expected: Floats,
    params: TrajectoryParams,
    window_px: _Size = _WINDOW_PX,
) -> _Found:
    """Points (N, 4) in stored pixels of the first and second pair and their sigma; without points, the reason."""
    if isinstance(first, NoMeasurement):
        return _no_points(first)
    if isinstance(second, NoMeasurement):
        return _no_points(second)
    if np.array_equal(first.left, second.left) or np.array_equal(first.right, second.right):
        return _no_points(NoMeasurement.IMAGE_FROZEN)  # not even noise differs: a stuck camera, not a standing car
    try:
        return _follow(first, second, working, cameras, expected, params, window_px)
    except cv2.error:  # costs this interval, never the drive
        return _no_points(NoMeasurement.IMAGE_UNFIT)


def _follow(
    first: WorkingImages,
    second: WorkingImages,
    working: WorkingSize,
    cameras: StereoCameras,
    expected: Floats,
    params: TrajectoryParams,
    window_px: _Size,
) -> _Found:
    """As `_follow_pair`, for images that can be followed. Points are in working pixels until the end."""
    left, right = _stereo_points(first, working, params, window_px)
    guess, usable = _expected_points(left, right, working, cameras, expected, window_px)
    left, right, guess = left[usable], right[usable], guess[usable]
    if len(left) < params.min_points:
        return _no_points(NoMeasurement.TOO_FEW_POINTS)
    # Points that fail one check are not followed further.
    next_left, good = _flow(first.left, second.left, left, guess[:, 0], 2, window_px)
    good &= _clear_of_padding(next_left, working, "left", window_px)
    left, right, guess, next_left = left[good], right[good], guess[good], next_left[good]
    shift = working.infinity_shift(next_left).astype(np.float32)
    across = next_left - _offset(guess[:, 0, 0] - guess[:, 1, 0], shift[:, 1])
    next_right, good = _flow(second.left, second.right, next_left, across, 0, window_px)
    good &= _on_equal_rows(next_left, next_right, shift, params)
    good &= _clear_of_padding(next_right, working, "right", window_px)
    good &= next_left[:, 0] - next_right[:, 0] - shift[:, 0] >= _least_disparity(working, params) / 2
    left, right, next_left, next_right = left[good], right[good], next_left[good], next_right[good]
    other_route, good = _flow(first.right, second.right, right, next_right, 0, window_px)
    good &= np.linalg.norm(other_route - next_right, axis=1) <= params.circle_tolerance_px
    if int(good.sum()) < params.min_points:
        return _no_points(NoMeasurement.TOO_FEW_POINTS)
    left, right, next_left, next_right = left[good], right[good], next_left[good], next_right[good]
    centre = _centre_of_texture(first.left, left, window_px)
    first_px = _stored(working, left + centre, right + centre)
    second_px = _stored(working, next_left + centre, next_right + centre)
    return first_px, second_px, params.sigma_px / float(working.scale[0]), None


def _stereo_points(
    images: WorkingImages, working: WorkingSize, params: TrajectoryParams, window_px: _Size
) -> tuple[Points, Points]:
    """Corners (N, 2) of the left image that are near enough, and their image points (N, 2) in the right one."""
    corners = _corners(images.half_left, params)
    disparity, shift = _disparity(images, corners, working), working.infinity_shift(corners)
    known = np.isfinite(disparity) & (disparity - shift[:, 0] >= _least_disparity(working, params))
    if int(known.sum()) < params.min_points:
        return corners[:0], corners[:0]
    left, shift = corners[known], shift[known].astype(np.float32)
    beginning = left - _offset(disparity[known], shift[:, 1])
    right, good = _flow(images.left, images.right, left, beginning, 0, window_px)
    good &= _on_equal_rows(left, right, shift, params) & _clear_of_padding(right, working, "right", window_px)
    return left[good], right[good]


def _expected_points(
    left: Points, right: Points, working: WorkingSize, cameras: StereoCameras, expected: Floats, window_px: _Size
) -> tuple[Points, Bools]:
    """Expected image points in the next pair of static points, by the expected motion, and which are inside the image.

    (N, 2, 2): left and right image point; the row of the right one is that of the left.
    """
    points, _, placed = triangulate(cameras, _stored(working, left, right)[:, :3])
    image, _, ahead = project(cameras, points @ expected[:3, :3].T + expected[:3, 3])
    guess = working.to_working(image[:, [0, 1, 2, 1]].reshape(-1, 2, 2)).astype(np.float32)
    inside = ((guess[:, 0] > 0) & (guess[:, 0] < working.size_px)).all(axis=1)
    return guess, placed & ahead & inside & _clear_of_padding(guess[:, 0], working, "left", window_px)


def _corners(half: Image, params: TrajectoryParams) -> Points:
    """Corners (N, 2) of an image given at half its size: the best few of each cell of a grid."""
    response = cv2.cornerMinEigenVal(half, 5)
    highest = cv2.dilate(response, np.ones((5, 5), np.uint8))
    some = response[::4, ::4].ravel()
    rank = int(0.99 * (len(some) - 1))
    strong = float(np.partition(some, rank)[rank])
    border = 6
    inner, around = (image[border:-border, border:-border] for image in (response, highest))
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


def _disparity(images: WorkingImages, corners: Points, working: WorkingSize) -> Floats:
    """Rough disparity (N,) px of corners by block matching at a quarter of the size; NaN where there is none.

    The search begins at the shift of infinitely far points, which is not 0 where the principal points differ.
    """
    height, width = images.quarter_left.shape
    if not len(corners) or min(height, width) < _BLOCK_PX:
        return np.full(len(corners), np.nan)
    columns, rows = (working.infinity_shift(np.array(working.size_px) / 2) / 4).tolist()
    farthest = int(np.floor(columns))
    steps = max(int(np.ceil(images.left.shape[1] / 4 * _WIDEST_DISPARITY / 16)) * 16, 16)
    matcher = cv2.StereoBM.create(numDisparities=steps, blockSize=_BLOCK_PX)
    matcher.setMinDisparity(farthest)
    matcher.setUniquenessRatio(8)
    table = matcher.compute(images.quarter_left, _shift_down(images.quarter_right, rows))
    at = np.clip(((corners - 1.5) / 4).round().astype(int), 0, [width - 1, height - 1])
    raw = table[at[:, 1], at[:, 0]].astype(np.float64)
    return np.where(raw >= 16 * farthest, raw / 16 * 4, np.nan)


def _shift_down(image: Image, rows: float) -> Image:
    """The image moved down by `rows`; unchanged for less than a twentieth of a row."""
    if abs(rows) < 0.05:
        return image
    down = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, rows]])
    moved = cv2.warpAffine(image, down, image.shape[::-1], flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(moved, dtype=np.uint8)


def _flow(
    source: Image,
    target: Image,
    points: Points,
    guess: NDArray[np.floating],
    levels: int,
    window_px: _Size,
) -> tuple[Points, Bools]:
    """Image points (N, 2) in another image, from a guess on the `levels`-th pyramid level, and which were found."""
    if not len(points):
        return points, np.zeros(0, dtype=bool)
    found, status, _ = cv2.calcOpticalFlowPyrLK(
        source, target, np.ascontiguousarray(points), np.array(guess, np.float32, order="C"), maxLevel=levels,
        winSize=window_px, criteria=_STOP, flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )  # fmt: skip
    return np.asarray(found, dtype=np.float32), status.reshape(-1).astype(bool) & np.isfinite(found).all(axis=1)


def _centre_of_texture(image: Image, points: Points, window_px: _Size) -> Points:
    """Centre of the texture of a window (N, 2), relative to the window's centre: the point nearest to all its edges, by their
    gradients (Förstner & Gülch 1987).

    The measured shift of a window is that of this point. The window's own centre moves differently if the image grows towards the
    camera or is foreshortened: 2 px off and 15 % larger are 0.3 px, to the same side in all intervals that see a corner.
    """
    across, down = (np.arange(-1, size + 1, dtype=np.float32) - np.float32((size - 1) / 2) for size in window_px)
    columns, rows = points[:, :1] + np.tile(across, len(down)), points[:, 1:] + np.repeat(down, len(across))
    seen = cv2.remap(image.astype(np.float32), columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    patches = seen.reshape(-1, len(down), len(across))
    along_u, along_v = patches[:, 1:-1, 2:] - patches[:, 1:-1, :-2], patches[:, 2:, 1:-1] - patches[:, :-2, 1:-1]
    towards = along_u * across[1:-1] + along_v * down[1:-1, None]
    terms = np.stack([along_u, along_v, towards], axis=1).reshape(-1, 3, window_px[0] * window_px[1])
    (uu, uv, u), (_, vv, v) = np.moveaxis(terms[:, :2] @ terms.transpose(0, 2, 1), 0, -1)
    found = np.stack([vv * u - uv * v, uu * v - uv * u], axis=1) / np.maximum(uu * vv - uv**2, 1e-6)[:, None]
    return np.asarray(np.clip(found, -np.array(window_px) / 2, np.array(window_px) / 2), dtype=np.float32)


def _offset(columns: NDArray[np.floating], rows: NDArray[np.floating]) -> Points:
    """(N, 2) from points of the right image to those of the left."""
    return np.stack([columns, rows], axis=1).astype(np.float32)


def _least_disparity(working: WorkingSize, params: TrajectoryParams) -> float:
    """In working pixels."""
    return params.min_disparity_px * float(working.scale[0])


def _on_equal_rows(left: Points, right: Points, shift: NDArray[np.floating], params: TrajectoryParams) -> Bools:
    """Which points (N, 2) of both images lie on the same row of the rig; shift (N, 2): their shift at infinity."""
    return np.asarray(np.abs(right[:, 1] - left[:, 1] + shift[:, 1]) <= params.epipolar_tolerance_px)


def _clear_of_padding(points: Points, working: WorkingSize, side: Side, window_px: _Size) -> Bools:
    """(N,) whether windows are clear of the padding, whose streaks do not move with the car."""
    return np.asarray((points <= working.seen_px(side) - 0.5 - np.array(window_px) / 2).all(axis=1))


def _stored(working: WorkingSize, left: Points, right: Points) -> Floats:
    """(N, 4) in stored pixels: u and v left, u and v right."""
    return np.column_stack([working.to_stored(left), working.to_stored(right)])


def _no_points(reason: NoMeasurement) -> _Found:
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
        first_px=first_px, second_px=second_px, sigma_px=sigma_px, missing=missing,
    )  # fmt: skip
