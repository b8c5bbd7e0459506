"""Corners of drawn boards: chessboard, ChArUco, AprilGrid, warped into an image by a known homography."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from conetl.model.errors import InputError
from conetl.model.rejections import RejectionReason
from conetl.perception.boards.boards import Board, Found, NotFound, find_board, matched_orientation, parse_board
from conetl.perception.boards.images import find_boards, pairs_by_pattern, pairs_even_odd, pairs_in_folders

Array = NDArray[np.float64]
PX_PER_M = 2000.0
SIZE = (900, 700)
#: Drawn at this scale, so that edges fall between pixels after averaging.
FINE = 4


def _drawn(board: Board) -> tuple[Array, Array]:
    """Image of a flat board at PX_PER_M and the homography (3, 3) from board metres to its pixel edges."""
    margin = 60.0
    if board.kind == "aprilgrid":
        return _april_grid(board, margin)
    square = board.size_m * PX_PER_M
    if board.kind == "charuco":
        words = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
        drawing = cv2.aruco.CharucoBoard((board.cols, board.rows), board.size_m, board.marker_m, words).generateImage(
            (round(board.cols * square), round(board.rows * square)), marginSize=0
        )
        offset = margin
    else:
        y, x = np.mgrid[0 : round((board.rows + 1) * square), 0 : round((board.cols + 1) * square)]
        drawing = (255 * ((x // square + y // square) % 2)).astype(np.uint8)
        offset = margin + square
    image = cv2.copyMakeBorder(drawing, *(int(margin),) * 4, cv2.BORDER_CONSTANT, value=255)
    to_pixels = np.array([[PX_PER_M, 0, offset], [0, PX_PER_M, offset], [0, 0, 1.0]])
    return image.astype(np.float64), to_pixels


def _april_grid(board: Board, margin: float) -> tuple[Array, Array]:
    """Kalibr's grid: tags row by row from the lower left, a black square in each gap's corner; y counts upwards."""
    words = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    tag, gap = round(board.size_m * PX_PER_M), round(board.size_m * board.spacing * PX_PER_M)
    step = tag + gap
    width, height = (round(2 * margin) + n * step + gap for n in (board.cols, board.rows))
    image = np.full((height, width), 255.0)
    left, bottom = round(margin) + gap, height - round(margin) - gap
    for row in range(board.rows):
        for col in range(board.cols):
            x, y = left + col * step, bottom - row * step - tag
            image[y : y + tag, x : x + tag] = cv2.aruco.generateImageMarker(words, row * board.cols + col, tag)
    for row in range(board.rows + 1):
        for col in range(board.cols + 1):
            x, y = left - gap + col * step, bottom - row * step
            image[y : y + gap, x : x + gap] = 0.0
    return image, np.array([[PX_PER_M, 0, left], [0, -PX_PER_M, bottom], [0, 0, 1.0]])


def _seen(board: Board, corners: Array, blur: float = 0.8) -> tuple[NDArray[np.uint8], Array]:
    """The board with its drawing's corners at `corners` (4, 2) px (clockwise), and where its points are in the image."""
    drawing, to_pixels = _drawn(board)
    h, w = drawing.shape
    edges = np.array([[0, 0], [w, 0], [w, h], [0, h]], dtype=np.float32)
    warp = cv2.getPerspectiveTransform(edges, corners.astype(np.float32))
    # pixel edges -> pixel centres, drawn FINE times too large and averaged
    centre = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1.0]])
    enlarge = np.diag([FINE, FINE, 1.0])
    large = cv2.warpPerspective(
        drawing, np.linalg.inv(centre) @ enlarge @ warp @ centre, (SIZE[0] * FINE, SIZE[1] * FINE), borderValue=140
    )
    image = large.reshape(SIZE[1], FINE, SIZE[0], FINE).mean(axis=(1, 3))
    image = cv2.GaussianBlur(image, (0, 0), blur)
    image = 30 + 0.75 * image + np.random.default_rng(0).normal(0, 1.5, image.shape)
    flat = board.points_m()[:, :2]
    true = cv2.perspectiveTransform(flat[None], warp @ to_pixels)[0] - 0.5
    return np.clip(np.round(image), 0, 255).astype(np.uint8), true


QUAD = np.array([[150.0, 90.0], [760.0, 60.0], [700.0, 610.0], [190.0, 560.0]])
BOARDS = {
    "chessboard": (parse_board("chessboard:9x6:40mm"), 54),
    "charuco": (parse_board("charuco:7x5:4cm:3cm:5X5_100"), 24),
    "aprilgrid": (parse_board("aprilgrid:4x3:0.05m:0.3"), 48),
}


@pytest.mark.parametrize("kind", BOARDS)
def test_corners_are_where_they_were_drawn(kind: str) -> None:
    board, count = BOARDS[kind]
    image, true = _seen(board, QUAD)
    found = find_board(image, board)
    assert isinstance(found, Found), found
    assert len(found.point_ids) >= 0.9 * count
    uv = found.uv_px
    if kind == "chessboard" and np.linalg.norm(uv[0] - true[0]) > 20:  # numbered from the other end: the same board
        uv = uv[::-1]
    misses = uv - true[found.point_ids]
    assert np.hypot(*misses.T).max() < 0.35
    assert np.abs(misses.mean(axis=0)).max() < 0.05  # no shift of half a pixel


@pytest.mark.parametrize("kind", ["charuco", "aprilgrid"])
def test_a_part_of_a_tag_board_will_do(kind: str) -> None:
    board, count = BOARDS[kind]
    image, true = _seen(board, QUAD - (330.0, 0.0))
    found = find_board(image, board)
    assert isinstance(found, Found)
    assert 6 <= len(found.point_ids) < count
    assert np.hypot(*(found.uv_px - true[found.point_ids]).T).max() < 0.5


def test_small_chessboards_are_measured_as_well_as_large_ones() -> None:
    board, _ = BOARDS["chessboard"]
    image, true = _seen(board, QUAD * 0.4 + 200)
    found = find_board(image, board)
    assert isinstance(found, Found)
    uv = found.uv_px if np.linalg.norm(found.uv_px[0] - true[0]) < 10 else found.uv_px[::-1]
    assert np.sqrt(((uv - true) ** 2).sum(axis=1).mean()) < 0.12


def test_why_there_is_no_board() -> None:
    board, _ = BOARDS["chessboard"]
    cut, _ = _seen(board, QUAD - (330.0, 0.0))
    blurred, _ = _seen(board, QUAD, blur=5.0)
    image, _ = _seen(board, QUAD)
    empty = np.full((400, 400), 90, dtype=np.uint8)
    for shown, wanted, reason, words in (
        (cut, board, RejectionReason.BOARD_CUT, "partly outside the image"),
        (blurred, board, RejectionReason.IMAGE_BLURRED, ""),
        (
            image,
            parse_board("chessboard:8x5:37.8mm"),
            RejectionReason.BOARD_NOT_FOUND,
            "9 x 6 inner corners instead of 8 x 5",
        ),
        (empty, board, RejectionReason.BOARD_NOT_FOUND, ""),
    ):
        found = find_board(shown, wanted)
        assert isinstance(found, NotFound) and found.reason == reason and words in found.detail


def test_a_symmetric_board_is_numbered_alike_in_both_images() -> None:
    board = Board("chessboard", 4, 4, 0.05)
    ids = np.arange(16)
    uv = board.points_m()[:, :2] * 1000 + 100
    grid = ids.reshape(4, 4)
    for turn in (grid, grid[::-1, ::-1], grid.T[::-1], grid.T[:, ::-1]):
        right = matched_orientation(Found(ids, uv), Found(ids, uv[turn.ravel()] - (40.0, 3.0)), board)
        np.testing.assert_allclose(right.uv_px, uv - (40.0, 3.0))


@pytest.mark.parametrize(
    "text",
    ["chessboard:9x6", "chessboard:9x6:37.8", "circles:9x6:1mm", "charuco:7x5:30mm:40mm", "aprilgrid:6x6:88mm:3",
     "chessboard:2x6:1mm", "charuco:7x5:30mm:20mm:9X9_1", "chessboard:9x6:0mm"],
)  # fmt: skip
def test_a_board_that_makes_no_sense_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="board"):
        parse_board(text)


def _written(path: Path, image: NDArray[np.uint8]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), image)


def test_images_are_paired(tmp_path: Path) -> None:
    blank = np.zeros((20, 30), dtype=np.uint8)
    for name in ("a/left/x", "a/right/x", "a/left/y", "b/left_1", "b/right_1", "c/p08", "c/p09"):
        _written(tmp_path / f"{name}.png", blank)
    assert [(p.name, p.left is None, p.right is None) for p in pairs_in_folders(tmp_path / "a")] == [
        ("x", False, False), ("y", False, True)
    ]  # fmt: skip
    assert [p.name for p in pairs_by_pattern(tmp_path / "b", "left_*.png", "right_*.png")] == ["1"]
    (pair,) = pairs_even_odd(tmp_path / "c")
    assert pair.left is not None and pair.right is not None
    assert (pair.left.name, pair.right.name) == ("p08.png", "p09.png")
    with pytest.raises(InputError, match="--pairing even-odd"):
        pairs_in_folders(tmp_path / "b")
    with pytest.raises(InputError, match="no pair"):
        pairs_by_pattern(tmp_path / "b", "left_*.png", "x_*.png")


def test_each_image_that_is_not_used_has_a_reason(tmp_path: Path) -> None:
    board, _ = BOARDS["chessboard"]
    image, _ = _seen(board, QUAD)
    for name in ("0", "1", "2"):
        _written(tmp_path / "left" / f"{name}.png", image)
    _written(tmp_path / "right" / "0.png", image)
    _written(tmp_path / "right" / "1.png", np.ascontiguousarray(image[:400]))
    (tmp_path / "right" / "3.png").write_bytes((tmp_path / "left" / "0.png").read_bytes()[:5000])
    _written(tmp_path / "right" / "4.png", image)
    images = find_boards(pairs_in_folders(tmp_path), board)
    views = sorted(f"{view.pair_index} {view.side}" for view in images.views)
    assert views == ["0 left", "0 right", "1 left", "2 left", "4 right"]
    reasons = {r.record: r.reason for r in images.rejections}
    assert reasons == {
        "right image 1.png": RejectionReason.IMAGE_WRONG_SIZE,
        "right image of pair 2": RejectionReason.PARTNER_MISSING,
        "left image of pair 3": RejectionReason.PARTNER_MISSING,
        "right image 3.png": RejectionReason.IMAGE_TRUNCATED,
        "left image of pair 4": RejectionReason.PARTNER_MISSING,
    }
