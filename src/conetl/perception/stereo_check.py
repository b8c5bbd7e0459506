"""Whether the two images of a pair belong together: sides, trigger and rows, from the images alone.

In a rectified pair every point lies in the right image at the same row and not farther right than in the left one. Of ORB
features (Rublee et al. 2011) matched in the sample drives and a real street 73 to 86 % do; with the right image of the frame
before or after 24 to 68 %, and with swapped, mirrored or upside-down images 0 to 15 %.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from conetl.geometry.rig import right_camera_turned
from conetl.model.errors import DriveFolderError
from conetl.model.health import HealthCheck, Verdict
from conetl.model.records import Drive, Rig, Side
from conetl.perception.images import ImageFileError
from conetl.perception.rectified_image import read_pair_image

Floats = NDArray[np.float64]
_PAIRS, _FEATURES, _MIN_MATCHES = 5, 1000, 50
_SHRINK, _MAX_HAMMING = 2, 50
#: Share of the matches from which the sides are wrong, and below which the right images of other frames are tried.
_WRONG_SHARE, _FITTING_SHARE = 0.7, 0.7
#: Rows by which right images may lie off, scatter of a match, and what self-calibration finds (px of the whole image).
_MAX_ROWS_PX, _SCATTER_PX, _FINE_ROWS_PX = 40.0, 2.0, 0.7
#: Positions of a corner are good to this, whatever their number (px of the whole image).
_FLOOR_PX = 0.3
#: Right images of another frame must fit so many times as many points: while the vehicle stands all fit alike.
_FITS_BETTER = 1.3
_LAGS = (-3, -2, -1, 1, 2, 3)


def check_stereo(drive: Drive) -> tuple[Rig, list[HealthCheck]]:
    """Look at some pairs of a drive; its rig, with the right camera turned where its images lie some rows off, and the checks.

    Images without detail pass. Raises DriveFolderError where the sides are wrong.
    """
    count = len(drive.frame_pairs)
    chosen = np.unique(np.linspace(0, count - 1, _PAIRS).astype(int)).tolist()
    features = cache(lambda number, side: _features(drive, number, side))

    def offsets(lag: int) -> Floats:
        """(N, 2): columns left minus right, and rows right minus left, of matches with the right images `lag` frames later."""
        both = [(features(k, "left"), features(k + lag, "right")) for k in chosen if 0 <= k + lag < count]
        return np.concatenate([np.empty((0, 2)), *(_offsets(left, right) for left, right in both)])

    found = offsets(0)
    near = found[np.abs(found[:, 1]) <= _MAX_ROWS_PX]
    wrong = int((near[:, 0] < -_SHRINK).sum())
    if len(near) >= _MIN_MATCHES and wrong > _WRONG_SHARE * len(near):
        raise DriveFolderError(
            f"{drive.source_path}: the images are swapped, mirrored or upside down: of {len(near)} points in both images "
            f"{wrong} lie farther right in the right image. Exchange the cameras' folders (drive.yaml: cameras), or turn the "
            "images."
        )
    rows = _rows_of_one_scene(found)
    checks = [_check_trigger(len(rows), len(found), lambda lag: len(_rows_of_one_scene(offsets(lag))))]
    if len(rows) < _MIN_MATCHES or checks[0].verdict is not Verdict.PASS:
        return drive.rig, checks
    off_px, sigma_px = float(rows.mean()), float(np.hypot(rows.std() / np.sqrt(len(rows)), _FLOOR_PX))
    figures = {
        "name": "rows of the right images",
        "value": off_px,
        "sigma": sigma_px,
        "limit": _FINE_ROWS_PX,
        "unit": "px",
    }
    if abs(off_px) <= _FINE_ROWS_PX:
        return drive.rig, [
            *checks,
            HealthCheck(**figures, verdict=Verdict.PASS, detail="Both images have the same rows."),
        ]
    detail = (
        f"The right images lie {off_px:+.1f} +- {sigma_px:.1f} px lower than the left ones: the right camera was turned by that. "
        "Calibrate the rig anew (conetl calibrate), or see whether the images were cropped."
    )
    turned = right_camera_turned(drive.rig, np.array([off_px / drive.rig.right.fy_px, 0.0, 0.0]))
    return turned, [*checks, HealthCheck(**figures, verdict=Verdict.CORRECTED, detail=detail)]


def _check_trigger(fitting: int, matched: int, fitting_at: Callable[[int], int]) -> HealthCheck:
    """Whether right images of other frames fit the left ones better than their own."""
    best, lag = fitting, 0
    if fitting < _FITTING_SHARE * max(matched, _MIN_MATCHES):
        best, lag = max((fitting_at(lag), lag) for lag in _LAGS)
    if best < _MIN_MATCHES or best < _FITS_BETTER * fitting:
        lag = 0
    detail = "Left and right images are of the same instants."
    if lag:
        detail = (
            f"The right images belong to left images {abs(lag)} frames {'earlier' if lag > 0 else 'later'}: {best} points fit, "
            f"{fitting} as delivered. Correct the numbers of the images or the trigger."
        )
    return HealthCheck(
        name="trigger of both cameras", verdict=Verdict.HOLD if lag else Verdict.PASS, value=float(lag), limit=0.0,
        unit="frames", detail=detail,
    )  # fmt: skip


def _rows_of_one_scene(offsets: Floats) -> Floats:
    """Row offsets of the matches that lie on equal rows but for a common offset, and not farther right in the right image."""
    rows = offsets[(np.abs(offsets[:, 1]) <= _MAX_ROWS_PX) & (offsets[:, 0] >= -_SHRINK), 1]
    kept: Floats = rows[np.abs(rows - np.median(rows)) <= _SCATTER_PX] if len(rows) else rows
    return kept


def _features(drive: Drive, number: int, side: Side) -> tuple[Floats, NDArray[np.uint8]]:
    """(N, 2) corners (px of the whole image) of one image and their descriptors; none where it is broken or blank."""
    try:
        image = read_pair_image(drive.frame_pairs[number], side, drive.rig, grey=True)
    except ImageFileError:
        return np.empty((0, 2)), np.empty((0, 32), np.uint8)
    small = cv2.resize(image, None, fx=1 / _SHRINK, fy=1 / _SHRINK, interpolation=cv2.INTER_AREA)
    points, found = cv2.ORB.create(_FEATURES).detectAndCompute(small, None)
    if found is None:
        return np.empty((0, 2)), np.empty((0, 32), np.uint8)
    return np.array([point.pt for point in points]) * _SHRINK, np.asarray(found, np.uint8)


def _offsets(left: tuple[Floats, NDArray[np.uint8]], right: tuple[Floats, NDArray[np.uint8]]) -> Floats:
    """(M, 2) columns left minus right and rows right minus left of mutually best matches."""
    if not len(left[0]) or not len(right[0]):
        return np.empty((0, 2))
    matches = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(left[1], right[1])
    close = [(m.queryIdx, m.trainIdx) for m in matches if m.distance < _MAX_HAMMING]
    i, j = np.array(close, dtype=np.intp).reshape(-1, 2).T
    return np.column_stack([left[0][i, 0] - right[0][j, 0], right[0][j, 1] - left[0][i, 1]])
