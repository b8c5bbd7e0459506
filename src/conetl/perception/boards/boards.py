"""Calibration boards in images: chessboard, ChArUco, AprilGrid -> corners with their numbers.

Corners are pixels with the origin at the centre of the top-left pixel. A chessboard must be seen whole; of the other two any part
suffices, because markers number their corners. Points of the board lie in z = 0, in metres.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from itertools import product
from typing import Literal

import cv2
import numpy as np

from conetl.geometry.calibration.stereo_calibration import MIN_CORNERS
from conetl.model.arrays import Floats, Image, Ints
from conetl.model.errors import InputError
from conetl.model.rejections import RejectionReason

#: A blurred edge is at most this wide (contrast over steepest slope, px); what is wider is rejected.
MAX_EDGE_WIDTH_PX = 6.0
#: Chessboards are measured in a copy enlarged so far that a square is about this wide: the sector-based detector looks at a
#: neighbourhood of fixed size, and on small squares its corners are pulled by the next ones.
_SQUARE_PX = 44.0
_MAX_ENLARGEMENT = 3
_REFINE = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 60, 1e-4)

_SPEC_HELP = (
    "expected chessboard:COLSxROWS:SQUARE (inner corners), charuco:COLSxROWS:SQUARE:MARKER[:DICTIONARY] (squares) or "
    "aprilgrid:COLSxROWS:TAG:SPACING (tags, gap as a share of the tag), lengths as 37.8mm, 3.78cm or 0.0378m"
)


@dataclass(frozen=True)
class Board:
    """A calibration board. cols, rows: inner corners of a chessboard, squares of a ChArUco board, tags of an AprilGrid.

    size_m: side of a square or tag. marker_m: side of a ChArUco marker; spacing: an AprilGrid's gap as a share of the tag.
    """

    kind: Literal["chessboard", "charuco", "aprilgrid"]
    cols: int
    rows: int
    size_m: float
    marker_m: float = 0.0
    spacing: float = 0.0
    dictionary: str = "4X4_50"

    def points_m(self) -> Floats:
        """(n, 3) corners in the order of their numbers."""
        if self.kind == "aprilgrid":
            tag = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]) * self.size_m
            origins = _lattice(self.cols, self.rows) * self.size_m * (1.0 + self.spacing)
            flat = (origins[:, None] + tag).reshape(-1, 2)
        elif self.kind == "charuco":
            flat = (_lattice(self.cols - 1, self.rows - 1) + 1.0) * self.size_m
        else:
            flat = _lattice(self.cols, self.rows) * self.size_m
        return np.column_stack([flat, np.zeros(len(flat))])


@dataclass(frozen=True)
class Found:
    """Corners in one image: point_ids (n,), uv_px (n, 2)."""

    point_ids: Ints
    uv_px: Floats


@dataclass(frozen=True)
class NotFound:
    """Why no corners were found in an image."""

    reason: RejectionReason
    detail: str


def parse_board(text: str) -> Board:
    """Board from e.g. `chessboard:9x6:37.8mm`, `charuco:11x8:30mm:22mm:5X5_100`, `aprilgrid:6x6:88mm:0.3`. Raises InputError."""
    kind, *fields = text.split(":")
    counts = re.fullmatch(r"(\d+)x(\d+)", fields[0]) if fields else None
    wanted = {"chessboard": (2, 2), "charuco": (3, 4), "aprilgrid": (3, 3)}.get(kind)
    if wanted is None or counts is None or not wanted[0] <= len(fields) <= wanted[1]:
        raise InputError(f"board '{text}': {_SPEC_HELP}")
    cols, rows = int(counts[1]), int(counts[2])
    least = 1 if kind == "aprilgrid" else 3
    if not (least <= min(cols, rows) and max(cols, rows) <= 100):
        raise InputError(f"board '{text}': {least} to 100 columns and rows, found {cols} x {rows}")
    size_m = _length_m(fields[1], text)
    if kind == "chessboard":
        return Board("chessboard", cols, rows, size_m)
    if kind == "charuco":
        dictionary = fields[3].upper().removeprefix("DICT_") if len(fields) > 3 else "4X4_50"
        if not hasattr(cv2.aruco, f"DICT_{dictionary}"):
            raise InputError(f"board '{text}': OpenCV has no dictionary DICT_{dictionary}; one is 5X5_100")
        marker_m = _length_m(fields[2], text)
        if not marker_m < size_m:
            raise InputError(f"board '{text}': markers must be smaller than squares, found {fields[2]} in {fields[1]}")
        return Board("charuco", cols, rows, size_m, marker_m=marker_m, dictionary=dictionary)
    try:
        spacing = float(fields[2])
    except ValueError:
        spacing = math.nan
    if not 0.0 < spacing < 2.0:
        raise InputError(f"board '{text}': the gap is a share of the tag between 0 and 2, found {fields[2]}")
    return Board("aprilgrid", cols, rows, size_m, spacing=spacing)


def find_board(image: Image, board: Board) -> Found | NotFound:
    """Corners of the board in a grey image (height, width), or why there are none."""
    if board.kind == "chessboard":
        corners = _find_chessboard(image, board)
        if isinstance(corners, NotFound):
            return corners
        found = Found(np.arange(board.cols * board.rows), corners)
    else:
        ids, uv = (_find_charuco if board.kind == "charuco" else _find_april_grid)(image, board)
        if len(ids) < MIN_CORNERS:
            return NotFound(
                RejectionReason.BOARD_NOT_FOUND,
                f"{len(ids)} corners of the {board.kind} found, at least {MIN_CORNERS} are needed",
            )
        found = Found(ids, uv)
    width = edge_width_px(image, found.uv_px)
    if width > MAX_EDGE_WIDTH_PX:
        return NotFound(
            RejectionReason.IMAGE_BLURRED,
            f"edges are {width:.1f} px wide, more than {MAX_EDGE_WIDTH_PX:g}: hold the board still, expose shorter",
        )
    return found


def matched_orientation(left: Found, right: Found, board: Board) -> Found:
    """The right corners in the order of the left ones: a symmetric chessboard looks the same upside down.

    Only for whole chessboards; other boards are returned unchanged.
    """
    if board.kind != "chessboard":
        return right
    grid = np.arange(board.cols * board.rows).reshape(board.rows, board.cols)
    turns = [grid, grid[::-1, ::-1]]
    if board.cols == board.rows:
        turns += [grid.T[::-1], grid.T[:, ::-1]]
    offset = left.uv_px - left.uv_px.mean(axis=0)
    orders = [turn.ravel() for turn in turns]
    misses = [float(((right.uv_px[o] - right.uv_px.mean(axis=0) - offset) ** 2).sum()) for o in orders]
    return Found(right.point_ids, right.uv_px[orders[int(np.argmin(misses))]])


def edge_width_px(image: Image, uv_px: Floats) -> float:
    """Median over corners of contrast divided by steepest slope around them: how many pixels an edge takes."""
    widths = []
    for u, v in uv_px:
        x, y, reach = round(float(u)), round(float(v)), 6
        patch = image[max(y - reach, 0) : y + reach + 1, max(x - reach, 0) : x + reach + 1].astype(np.float64)
        if min(patch.shape) < 5:
            continue
        low, high = np.percentile(patch, (5, 95))
        slope = np.hypot(
            cv2.Scharr(patch, cv2.CV_64F, 1, 0)[1:-1, 1:-1], cv2.Scharr(patch, cv2.CV_64F, 0, 1)[1:-1, 1:-1]
        )
        widths.append((high - low) / max(float(slope.max()) / 32.0, 1e-9))
    return float(np.median(widths)) if widths else math.inf


# --------------------------------------------------------------------------- chessboard


def _find_chessboard(image: Image, board: Board) -> Floats | NotFound:
    """(cols rows, 2) corners row by row: found with ever more effort, then measured in an enlarged copy."""
    size = board.cols, board.rows
    accurate = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
    attempts: tuple[tuple[int, int], ...] = (
        (1, accurate), (1, accurate | cv2.CALIB_CB_NORMALIZE_IMAGE), (2, cv2.CALIB_CB_EXHAUSTIVE)
    )  # fmt: skip
    rough = _sectors(image, size, 0, 1)
    if rough is None:
        seen = _largest_grid(image)
        # The board that was stated would not be found with more effort either.
        if seen is not None and _is_larger(seen, board):
            return _why_no_chessboard(image, seen, board)
        tries = (_sectors(image, size, flags, scale) for scale, flags in attempts)
        rough = next((found for found in tries if found is not None), None)
        if rough is None:
            return _why_no_chessboard(image, seen, board)
    grid = rough.reshape(size[1], size[0], 2)
    steps = np.concatenate([np.diff(grid, axis=axis).reshape(-1, 2) for axis in (0, 1)])
    length = float(np.median(np.hypot(*steps.T)))
    enlarge = int(np.clip(round(_SQUARE_PX / length), 1, _MAX_ENLARGEMENT))
    margin = 1.6 * float(np.hypot(*steps.T).max())
    top = np.maximum(np.floor(rough.min(axis=0) - margin), 0).astype(int)
    end = np.ceil(rough.max(axis=0) + margin).astype(int) + 1
    part = image[top[1] : end[1], top[0] : end[0]]
    fine = _sectors(part, size, cv2.CALIB_CB_ACCURACY, enlarge)
    if fine is None:
        fine = _sectors(part, size, accurate, enlarge)
    if fine is None or np.hypot(*(_nearest_order(fine + top, rough) - rough).T).max() > 0.25 * length:
        fine = rough - top  # seen in the whole image only: rougher, and the adjustment will say whether it fits
    return _right_handed(np.asarray(fine + top), size)


def _sectors(image: Image, size: tuple[int, int], flags: int, scale: int) -> Floats | None:
    enlarged = image if scale == 1 else cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    found, corners = cv2.findChessboardCornersSB(enlarged, size, flags=flags)
    if not found:
        return None
    return np.asarray((corners.reshape(-1, 2).astype(np.float64) + 0.5) / scale - 0.5)


def _nearest_order(corners: Floats, like: Floats) -> Floats:
    """The corners, forwards or backwards, whichever is nearer to `like`."""
    return min((corners, corners[::-1]), key=lambda c: float(((c - like) ** 2).sum()))


def _right_handed(corners: Floats, size: tuple[int, int]) -> Floats:
    """Corners with columns to the right of descending rows: a board seen from its front."""
    grid = corners.reshape(size[1], size[0], 2)
    along, down = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
    if along[0] * down[1] - along[1] * down[0] < 0:
        grid = grid[::-1]
    return np.ascontiguousarray(grid.reshape(-1, 2))


def _largest_grid(image: Image) -> Floats | None:
    """(rows, cols, 2) corners of the largest chessboard of any size; None for nine or fewer: a fence or a shirt has those."""
    flags = cv2.CALIB_CB_LARGER | cv2.CALIB_CB_EXHAUSTIVE
    for least in (5, 4, 3):  # a search for few corners often ends before it reaches the board's edge
        found, corners, meta = cv2.findChessboardCornersSBWithMeta(image, (least, least), flags)
        if found and meta.size > 9:
            return np.asarray(corners.reshape(*meta.shape[:2], 2), dtype=np.float64)
    return None


def _is_larger(grid: Floats, board: Board) -> bool:
    rows, cols = grid.shape[:2]
    return sorted((cols, rows)) > sorted((board.cols, board.rows)) and rows * cols > board.rows * board.cols


def _why_no_chessboard(image: Image, grid: Floats | None, board: Board) -> NotFound:
    """Distinguishes a board that is cut off from one that is missing or has another size. grid: of `_largest_grid`."""
    if grid is None:
        return NotFound(RejectionReason.BOARD_NOT_FOUND, "no chessboard found")
    rows, cols = grid.shape[:2]
    sizes = f"a grid of {cols} x {rows} inner corners instead of {board.cols} x {board.rows}"
    if _is_larger(grid, board):
        return NotFound(RejectionReason.BOARD_NOT_FOUND, f"{sizes}: check the size of the board")
    step = float(np.median(np.hypot(*np.diff(grid, axis=1).reshape(-1, 2).T)))
    low, high = grid.reshape(-1, 2).min(axis=0), grid.reshape(-1, 2).max(axis=0)
    near_edge = low.min() < 2 * step or (np.array(image.shape[::-1]) - high).min() < 2 * step
    where = "the board is partly outside the image" if near_edge else "a part is covered, overexposed or in shadow"
    return NotFound(RejectionReason.BOARD_CUT, f"{sizes}: {where}")


# --------------------------------------------------------------------------- small help


def _lattice(cols: int, rows: int) -> Floats:
    """(cols rows, 2) whole numbers x, y, row by row."""
    x, y = np.meshgrid(np.arange(cols, dtype=np.float64), np.arange(rows, dtype=np.float64))
    return np.stack([x.ravel(), y.ravel()], axis=1)


def _length_m(text: str, spec: str) -> float:
    match = re.fullmatch(r"(\d+(?:\.\d+)?|\.\d+)(mm|cm|m)", text)
    if match is None or float(match[1]) <= 0:
        raise InputError(f"board '{spec}': '{text}' is not a length; {_SPEC_HELP}")
    return float(match[1]) * {"mm": 1e-3, "cm": 1e-2, "m": 1.0}[match[2]]


# --------------------------------------------------------------------------- boards with markers


def _find_charuco(image: Image, board: Board) -> tuple[Ints, Floats]:
    """Numbers (n,) and places (n, 2) px of the inner corners of a ChArUco board.

    Boards made before OpenCV 4.6 begin with another colour in their first corner; both kinds are tried.
    """
    words = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{board.dictionary}"))
    best: tuple[Ints, Floats] = (np.zeros(0, dtype=np.intp), np.zeros((0, 2)))
    for legacy in (False, True):
        pattern = cv2.aruco.CharucoBoard((board.cols, board.rows), board.size_m, board.marker_m, words)
        pattern.setLegacyPattern(legacy)
        corners, ids, _, _ = cv2.aruco.CharucoDetector(pattern).detectBoard(image)
        if ids is not None and len(ids) > len(best[0]):
            best = ids.ravel().astype(np.intp), corners.reshape(-1, 2).astype(np.float64)
    return best


def _find_april_grid(image: Image, board: Board) -> tuple[Ints, Floats]:
    """Numbers (n,) and places (n, 2) px of the tag corners of an AprilGrid (tag36h11, Kalibr's layout).

    Tags are numbered row by row from the lower left; corner 4 t + k is the lower left, lower right, upper right, upper left one
    of tag t. Which corner of a tag a detector calls first differs between libraries: the turn that makes one flat grid is taken.
    """
    words = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    # By outline, not by OpenCV's AprilTag detector: that one loses tags whose corners touch the black squares between them.
    quads, ids, _ = cv2.aruco.ArucoDetector(words, cv2.aruco.DetectorParameters()).detectMarkers(image)
    none: tuple[Ints, Floats] = (np.zeros(0, dtype=np.intp), np.zeros((0, 2)))
    if ids is None:
        return none
    tags = ids.ravel().astype(np.intp)
    once = np.array([(tags == tag).sum() == 1 and tag < board.cols * board.rows for tag in tags])
    if once.sum() < 2:
        return none
    tags, corners = tags[once], np.array(quads)[once].reshape(-1, 4, 2).astype(np.float64)
    side = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).min(axis=1)
    best_miss, best = np.inf, corners
    origins = np.stack([tags % board.cols, tags // board.cols], axis=1) * (1.0 + board.spacing)
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
        window = int(np.clip(0.25 * board.spacing * length, 2, 7))
        start = quad.astype(np.float32).reshape(-1, 1, 2).copy()
        refined.append(cv2.cornerSubPix(image, start, (window, window), (-1, -1), _REFINE).reshape(4, 2))
    uv = np.array(refined, dtype=np.float64)
    settled = np.linalg.norm(uv - best, axis=2) < np.maximum(0.1 * side, 1.5)[:, None]
    numbers = 4 * tags[:, None] + np.arange(4)
    return numbers[settled], uv[settled]
