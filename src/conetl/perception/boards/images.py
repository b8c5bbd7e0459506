"""Images of a calibration board: pairing the files of a folder, and the corners in each image."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from conetl.geometry import pose as se3
from conetl.geometry.calibration.stereo_bundle import BoardView
from conetl.geometry.calibration.stereo_calibration import MIN_PAIRS, Start
from conetl.model.arrays import Floats
from conetl.model.errors import InputError
from conetl.model.rejections import Rejection, RejectionReason
from conetl.model.rig import SIDES, Camera, Lens, Side
from conetl.perception.boards.boards import Board, Found, NotFound, find_board, matched_orientation
from conetl.perception.images import IMAGE_SUFFIXES, ImageFileError, read_image
from conetl.perception.video import frame_of
from conetl.perception.video_frames import read_frame

Size = tuple[int, int]
_FLAGS = cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K3
#: OpenCV's time grows fast with the number of images; a start needs no more than this.
_MAX_VIEWS = 40
#: Views with this many times the median RMS are left out of the start; the adjustment judges them later.
_OUTLIER = 5.0


@dataclass(frozen=True)
class ImagePair:
    """Two images of one instant, files or frames of videos; None where one is missing. name: what they have in common."""

    name: str
    left: Path | None
    right: Path | None

    def path(self, side: Side) -> Path | None:
        return self.left if side == "left" else self.right


@dataclass(frozen=True)
class BoardImages:
    """Views of the board (pair_index counts `pairs`), size of the images by side, and what was refused."""

    pairs: tuple[ImagePair, ...]
    views: tuple[BoardView, ...]
    sizes: dict[Side, Size]
    rejections: tuple[Rejection, ...]


def pairs_in_folders(folder: Path) -> list[ImagePair]:
    """Pairs of `left/` and `right/` with equal stems. Raises InputError."""
    found = {side: {p.stem: p for p in _images(folder / side)} for side in SIDES if (folder / side).is_dir()}
    if len(found) != 2:
        raise InputError(
            f"{folder}: expected the folders left/ and right/ in it. Images in one folder are paired by --left-pattern and "
            "--right-pattern (left_*.png and right_*.png), or by --pairing even-odd where their numbers alternate"
        )
    return _joined(folder, found["left"], found["right"])


def pairs_by_pattern(folder: Path, left_pattern: str, right_pattern: str) -> list[ImagePair]:
    """Pairs of files whose names agree in what the `*` of their patterns stands for. Raises InputError."""
    found = []
    for option, pattern in (("--left-pattern", left_pattern), ("--right-pattern", right_pattern)):
        if pattern.count("*") != 1:
            raise InputError(f"{option} '{pattern}': expected one * for what left and right names have in common")
        before, after = pattern.split("*")
        paths = [p for p in folder.glob(pattern) if p.is_file() and p.suffix.lower() in IMAGE_SUFFIXES]
        names = {str(p.relative_to(folder)): p for p in sorted(paths)}
        found.append({name[len(before) : len(name) - len(after)]: p for name, p in names.items()})
    return _joined(folder, *found)


def pairs_even_odd(folder: Path) -> list[ImagePair]:
    """Pairs of an even number (left) and the next one (right); the number is the last one in a file's stem. Raises InputError."""
    found: tuple[dict[str, Path], dict[str, Path]] = ({}, {})
    for path in _images(folder):
        numbers = re.findall(r"\d+", path.stem)
        if not numbers:
            raise InputError(f"{path}: pairing even-odd needs a number in each name, and there is none")
        number = int(numbers[-1])
        key = str(number // 2 * 2).zfill(len(numbers[-1]))
        if key in found[number % 2]:
            raise InputError(f"{path}: {number} is also the number of {found[number % 2][key].name}")
        found[number % 2][key] = path
    return _joined(folder, *found)


def find_boards(
    pairs: Sequence[ImagePair], board: Board, *, progress: Callable[[int, int], object] = lambda done, total: None
) -> BoardImages:
    """Corners in all images; each image without a board is a rejection. progress: called with (images done, total images)."""
    jobs = [(i, side, path) for i, pair in enumerate(pairs) for side in SIDES if (path := pair.path(side)) is not None]
    searched: dict[tuple[int, Side], tuple[Size | None, Found | NotFound]] = {}
    # OpenCV works without the interpreter's lock.
    with ThreadPoolExecutor(min(os.cpu_count() or 1, 8)) as pool:
        for (i, side, _), found_in in zip(jobs, pool.map(lambda job: _search(job[2], board), jobs), strict=True):
            searched[i, side] = found_in
            progress(len(searched), len(jobs))
    sizes: dict[Side, Size] = {}
    for side in SIDES:
        counted = Counter(size for (_, s), (size, _) in searched.items() if s == side and size is not None)
        if counted:
            sizes[side] = counted.most_common(1)[0][0]
    views: list[BoardView] = []
    rejections: list[Rejection] = []
    for i, pair in enumerate(pairs):
        found: dict[Side, Found] = {}
        for side in SIDES:
            size, result = searched.get((i, side), (None, _missing(pair, side)))
            if size is not None and size != sizes[side]:
                text = f"{size[0]} x {size[1]} pixels, the other {side} images have {sizes[side][0]} x {sizes[side][1]}"
                result = NotFound(RejectionReason.IMAGE_WRONG_SIZE, text)
            if isinstance(result, Found):
                found[side] = result
            else:
                rejections.append(rejection(pair, side, result.reason, result.detail))
        if len(found) == 2:
            found["right"] = matched_orientation(found["left"], found["right"], board)
        views += [BoardView(i, side, corners.point_ids, corners.uv_px) for side, corners in found.items()]
    return BoardImages(tuple(pairs), tuple(views), sizes, tuple(rejections))


def rejection(pair: ImagePair, side: Side, reason: RejectionReason, detail: str) -> Rejection:
    """An image that is not used."""
    path = pair.path(side)
    record = f"{side} image of pair {pair.name}" if path is None else f"{side} image {path.name}"
    return Rejection(
        step="calibration", reason=reason, record=record, detail=detail, payload={"pair": pair.name, "side": side}
    )


def _missing(pair: ImagePair, side: Side) -> NotFound:
    other = pair.left or pair.right
    name = "" if other is None else other.name
    return NotFound(RejectionReason.PARTNER_MISSING, f"there is no such file; {name} counts for its own camera only")


def _search(path: Path, board: Board) -> tuple[Size | None, Found | NotFound]:
    try:
        frame = frame_of(path)
        image = read_image(path) if frame is None else read_frame(frame)
    except ImageFileError as error:
        return None, NotFound(error.reason, str(error))
    grey = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), dtype=np.uint8)
    return (grey.shape[1], grey.shape[0]), find_board(grey, board)


def _images(folder: Path) -> list[Path]:
    return sorted(p for p in folder.iterdir() if p.is_file() and p.suffix.lower() in IMAGE_SUFFIXES)


def _joined(folder: Path, left: dict[str, Path], right: dict[str, Path]) -> list[ImagePair]:
    if not set(left) & set(right):
        raise InputError(
            f"{folder}: found {len(left)} left and {len(right)} right images, but no pair: the names of the two images "
            "of a pair must match"
        )
    return [ImagePair(name, left.get(name), right.get(name)) for name in sorted(set(left) | set(right))]


def start_values(points_m: Floats, views: Sequence[BoardView], sizes: Mapping[Side, tuple[int, int]]) -> Start:
    """Cameras with radial distortion and the board's pose in each view. points_m: (n, 3) board; sizes: width, height by side.

    Raises InputError where a camera has too few views or OpenCV finds no solution.
    """
    cameras: dict[Side, Camera] = {}
    poses: dict[Side, dict[int, Floats]] = {}
    for side in SIDES:
        own = [view for view in views if view.side == side]
        if len(own) < MIN_PAIRS:
            raise InputError(
                f"the board was found in {len(own)} {side} images, at least {MIN_PAIRS} are needed (20 to 40 are good)"
            )
        cameras[side], poses[side] = _one_camera(points_m, own, sizes[side], side)
    return Start(cameras["left"], cameras["right"], poses["left"], poses["right"])


def _one_camera(
    points_m: Floats, views: Sequence[BoardView], size: tuple[int, int], side: Side
) -> tuple[Camera, dict[int, Floats]]:
    chosen = [views[i] for i in np.unique(np.linspace(0, len(views) - 1, _MAX_VIEWS).round().astype(int))]
    try:
        for _ in range(3):
            objects = [points_m[v.point_ids].astype(np.float32) for v in chosen]
            images = [v.uv_px.astype(np.float32) for v in chosen]
            _, k, lens, _, _, _, _, rms = cv2.calibrateCameraExtended(
                objects, images, size, np.eye(3), np.zeros(5), flags=_FLAGS
            )
            good = rms.ravel() <= _OUTLIER * np.median(rms)
            if good.all():
                break
            chosen = [v for v, g in zip(chosen, good, strict=True) if g]
        matrix, coefficients = (np.asarray(a, dtype=np.float64) for a in (k, lens))
        poses = {v.pair_index: _pose(points_m, v, matrix, coefficients) for v in views}
    except cv2.error as error:
        raise InputError(
            f"OpenCV finds no calibration of the {side} camera: {str(error).strip()}. Are all images similar? Tilt the "
            "board, and vary its distance"
        ) from error
    k1, k2 = (float(c) for c in coefficients.ravel()[:2])
    camera = Camera(
        width_px=size[0], height_px=size[1], fx_px=float(matrix[0, 0]), fy_px=float(matrix[1, 1]), cx_px=float(matrix[0, 2]),
        cy_px=float(matrix[1, 2]), lens=Lens(model="radial", coefficients=(k1, k2)),
    )  # fmt: skip
    return camera, poses


def _pose(points_m: Floats, view: BoardView, k: Floats, lens: Floats) -> Floats:
    """(4, 4) camera_SE3_board; of the two that a plane allows the one of the smaller residuals."""
    _, turns, shifts, _ = cv2.solvePnPGeneric(
        points_m[view.point_ids], view.uv_px[:, None], k, lens, flags=cv2.SOLVEPNP_IPPE
    )
    turn, shift = cv2.solvePnPRefineLM(points_m[view.point_ids], view.uv_px[:, None], k, lens, turns[0], shifts[0])
    return se3.se3(Rotation.from_rotvec(turn.ravel()).as_matrix(), shift.ravel())
