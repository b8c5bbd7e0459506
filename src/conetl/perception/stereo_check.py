"""Whether the two images of a pair belong together and show the road: sides, trigger, rows and lenses, from the images alone.

In a rectified pair every point is at the same row of the right image and not farther right than in the left one. Of ORB
features (Rublee et al. 2011) matched in the sample drives and a real street 73 to 86 % do; with the right image of the frame
before or after 24 to 68 %, and with swapped, mirrored or upside-down images 0 to 15 %.

The lower half of an image shows the road, and no part of a road is without structure: of squares of 32 px there (median over five
images) none of the sample drives has less than 11 % of the detail that a fifth of the whole image exceeds, and of a real street
9 %. A partly covered lens gives squares without any. Rain, dirt and grease on a lens remove structure finer than 25 px
and keep coarser structure. In squares of 64 px of ten rendered drives and a real street the ratio of both (standard deviations)
is at least 0.64, and at least 0.75 times that in the other image; a blur of 5 px makes it 0.4 to 0.7, and 0.55 times that.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import cache, partial
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from conetl.geometry.linear_reference import evenly_spaced
from conetl.geometry.rig import right_camera_turned
from conetl.model.arrays import Floats, Image
from conetl.model.drive import MIN_DETAIL, Drive, FramePair, UnclearSquares
from conetl.model.errors import DriveFolderError
from conetl.model.health import HealthCheck, Verdict, hold_if
from conetl.model.rig import SIDES, Side
from conetl.perception.image_detail import SQUARE_PX, detail_by_octaves, local_detail
from conetl.perception.images import ImageFileError
from conetl.perception.lens_check import check_distortion
from conetl.perception.pair_points import SHRINK as _SHRINK
from conetl.perception.pair_points import Corners, find_corners, match_corners
from conetl.perception.rectified_image import read_pair_image, rectify_image
from conetl.perception.torn_images import MOST_OTHERS, check_seams, thinned

TRIGGER = "trigger of both cameras"
_PAIRS, _MIN_MATCHES = 5, 50
#: Share of the matches from which the sides are wrong, and below which the right images of other frames are tried.
_WRONG_SHARE, _FITTING_SHARE = 0.7, 0.7
#: Rows by which right images may be off, scatter of a match, and what self-calibration finds (px of the whole image).
_MAX_ROWS_PX, _SCATTER_PX, _FINE_ROWS_PX = 40.0, 2.0, 0.7
#: Up to here an offset is corrected, as a turn of the camera. For a shift by 12 px the columns in the corners are then 2 px off.
_CORRECTED_ROWS_PX = 4.0
#: Positions of a corner are good to this, whatever their number (px of the whole image).
_FLOOR_PX = 0.3
#: Right images of another frame must fit this many times as many points: while the vehicle stands, all fit equally.
_FITS_BETTER = 1.3
_LAGS = (-3, -2, -1, 1, 2, 3)
#: Pairs that are tried of a part that cannot be followed, and most parts.
_PAIRS_OF_PART, _MOST_PARTS = 3, 10
#: Of points on equal rows at most 0.3 % lie farther right in the right image of a good drive; shifted by 6 columns 5 to 10 %.
_MAX_BEYOND_SHARE = 0.02
#: A square shows nothing below this share of the detail of the sharper ones; this many of the lower half may.
_BLANK, _SHARP_QUANTILE, _MAX_BLANK_SHARE = 0.05, 0.8, 0.1
#: A square is unclear below this ratio of fine to coarse structure, or this share of that ratio, or of the fine structure, in
#: the other image; so are those connected with it below the larger limits. Noise of grey levels is not structure.
_BLURRED, _BLURRED_BESIDE, _FAINT_BESIDE, _NOISE = (0.6, 0.75), (0.68, 0.74), (0.4, 0.5), 0.3


class _Features(NamedTuple):
    """What one image shows; empty if it is broken or blank."""

    corners: Corners = Corners()
    detail: NDArray[np.float32] = np.empty((0, 0), np.float32)
    """`local_detail`."""
    octaves: NDArray[np.float32] = np.empty((2, 0, 0), np.float32)
    """`detail_by_octaves`."""
    thin: Image = np.empty((0, 0), np.uint8)
    """The stored image, `thinned`."""


def check_stereo(drive: Drive) -> tuple[Drive, list[HealthCheck]]:
    """Check some pairs of a drive; the drive and the checks.

    The right camera of the result is turned if its images are some rows off, and unclear parts of its images are marked. Images
    without detail pass. Raises DriveFolderError if the sides are wrong.
    """
    count = len(drive.frame_pairs)
    tried = np.unique(np.linspace(0, count - 1, _PAIRS).astype(int)).tolist()
    features, points, offsets = _matching(drive)
    # Of a video in two files much is decoded for one frame: both at once.
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(lambda side: [features(k, side) for k in tried], SIDES))
    # An image that cannot be decoded fits none: the right image of another frame would always fit better.
    chosen = [k for k in tried if all(features(k, side).thin.size for side in SIDES)]
    found = offsets(chosen, 0)
    near = found[np.abs(found[:, 1]) <= _MAX_ROWS_PX]
    wrong = int((near[:, 0] < -_SHRINK).sum())
    if len(near) >= _MIN_MATCHES and wrong > _WRONG_SHARE * len(near):
        raise DriveFolderError(
            f"{drive.source_path}: the images are swapped, mirrored or upside down: of {len(near)} points in both images, "
            f"{wrong} lie farther right in the right image. Exchange left and right in drive.yaml (`images` of videos and "
            "image folders, `cameras` of KITTI drives), or rotate the images."
        )
    rows = _rows_of_one_scene(found)
    trigger = _check_trigger(drive.frame_pairs, chosen, offsets)
    unclear = _unclear_squares({side: [features(k, side).octaves for k in chosen] for side in SIDES})
    drive = drive.model_copy(update={"unclear": unclear})
    checks = [
        *_check_decoding([drive.frame_pairs[k].frame_index for k in tried if k not in chosen], len(tried)),
        _check_lenses({side: [features(k, side).detail for k in chosen] for side in SIDES}),
        _check_sharpness(unclear, drive),
        trigger,
        check_seams(
            {side: [thin for k in chosen if (thin := features(k, side).thin).size] for side in SIDES},
            partial(_others, drive, chosen),
        ),
    ]
    if len(rows) < _MIN_MATCHES or trigger.verdict is not Verdict.PASS:
        return drive, checks
    checks.append(_check_columns(near[np.abs(near[:, 1] - np.median(rows)) <= _SCATTER_PX, 0]))
    seen = [(features(k, "left").corners.small, features(k, "right").corners.small, *points(k, 0)) for k in chosen]
    checks.append(check_distortion(seen, drive.rig, _SHRINK))
    off_px, sigma_px = float(rows.mean()), float(np.hypot(rows.std() / np.sqrt(len(rows)), _FLOOR_PX))
    judged = partial(
        HealthCheck, name="rows of the right images", value=off_px, sigma=sigma_px, limit=_FINE_ROWS_PX, unit="px"
    )
    if abs(off_px) > _CORRECTED_ROWS_PX:
        detail = (
            f"The right images lie {off_px:+.1f} +- {sigma_px:.1f} px lower than the left ones, too far to be corrected. Check "
            "whether they were cropped, or recalibrate the rig (conetl calibrate)."
        )
        return drive, [*checks, judged(verdict=Verdict.HOLD, detail=detail)]
    if abs(off_px) <= _FINE_ROWS_PX:
        return drive, [*checks, judged(verdict=Verdict.PASS, detail="The rows of both images match.")]
    detail = (
        f"The right images lie {off_px:+.1f} +- {sigma_px:.1f} px lower than the left ones: the right camera has rotated. "
        "Recalibrate the rig (conetl calibrate), or check whether the images were cropped."
    )
    turned = right_camera_turned(drive.rig, np.array([off_px / drive.rig.right.fy_px, 0.0, 0.0]))
    return drive.model_copy(update={"rig": turned}), [*checks, judged(verdict=Verdict.CORRECTED, detail=detail)]


def check_lost_parts(drive: Drive, lost: Sequence[bool]) -> list[HealthCheck]:
    """Check the trigger within parts of the drive where visual odometry failed; empty unless right images of other frames fit.

    lost: (K - 1,) whether visual odometry failed between frame pairs.
    """
    offsets = _matching(drive).offsets
    gone = np.array(lost)
    gone[1:-1] |= gone[:-2] & gone[2:]  # one may be measured by chance
    ends = np.flatnonzero(np.diff(gone, prepend=False, append=False)).reshape(-1, 2).tolist()
    parts = [
        evenly_spaced(range(first + 1, end), _PAIRS_OF_PART) for first, end in ends if end - first > _PAIRS_OF_PART
    ]
    checks = (
        _check_trigger(drive.frame_pairs, part, offsets, whole=False) for part in evenly_spaced(parts, _MOST_PARTS)
    )
    return [check for check in checks if check.verdict is not Verdict.PASS][:1]


class _Matching(NamedTuple):
    """Cached functions that give what the images of a drive show."""

    features: Callable[[int, Side], _Features]
    """Of the image of a frame pair, by its number."""
    points: Callable[[int, int], tuple[Floats, Floats]]
    """(M, 2) px each: matches of a left image, by its number, with the right one that many frames later."""
    offsets: Callable[[Sequence[int], int], Floats]
    """(N, 2) columns left minus right (of infinitely far points zero), and rows right minus left, of the matches of several left
    images."""


def _matching(drive: Drive) -> _Matching:
    count, at_infinity_px = len(drive.frame_pairs), drive.rig.left.cx_px - drive.rig.right.cx_px
    features = cache(lambda number, side: _features(drive, number, side))
    points = cache(
        lambda number, lag: match_corners(features(number, "left").corners, features(number + lag, "right").corners)
    )

    def offsets(numbers: Sequence[int], lag: int) -> Floats:
        found = [points(k, lag) for k in numbers if 0 <= k + lag < count]
        parts = [
            np.column_stack([ours[:, 0] - theirs[:, 0] - at_infinity_px, theirs[:, 1] - ours[:, 1]])
            for ours, theirs in found
        ]
        return np.concatenate([np.empty((0, 2)), *parts])

    return _Matching(features, points, offsets)


def _check_decoding(lost: Sequence[int], tried: int) -> list[HealthCheck]:
    """Whether the images can be decoded; empty if they can. lost: frame indices of pairs of which one cannot."""
    detail = (
        f"An image cannot be decoded in {len(lost)} of {tried} frame pairs that were tried, frame pairs "
        f"{', '.join(map(str, lost))}: copy the recording again. Such frame pairs are not used."
    )
    check = HealthCheck(
        name="images that can be decoded", verdict=Verdict.WARN, value=len(lost) / tried, limit=0.0, detail=detail
    )
    return [check] if lost else []


def _check_lenses(details: dict[Side, list[NDArray[np.float32]]]) -> HealthCheck:
    """Whether a part of a lens is covered. (A wholly covered lens, darkness and fog reduce `ImageDetail`.)"""
    shares = {side: _blank_share(details[side]) for side in SIDES}
    known = {side: share for side, share in shares.items() if share is not None}
    blank = [side for side, share in known.items() if share > _MAX_BLANK_SHARE]
    worst = max(known.values(), default=None)
    detail = "No part of a lens is covered."
    if None in shares.values():
        detail = "The images do not show enough for this check."
    if blank and worst is not None:
        detail = (
            f"{worst:.0%} of the lower half of the {' and '.join(blank)} images is blank, although the rest is sharp: the lens "
            "is covered in part or dazzled, and the drive would remove cones there. Clean the lens. If the vehicle itself is in "
            "view there, accept the drive."
        )
    return hold_if(blank, "covered parts of the lenses", detail, value=worst, limit=_MAX_BLANK_SHARE)


def _blank_share(details: list[NDArray[np.float32]]) -> float | None:
    """Share of the squares of the lower half that show nothing in most images; None if no image is sharp anywhere."""
    seen = [detail for detail in details if detail.size]
    if not seen:
        return None
    detail = np.median(seen, axis=0)
    sharp = float(np.quantile(detail, _SHARP_QUANTILE))
    return float((detail[len(detail) // 2 :] < _BLANK * sharp).mean()) if sharp >= MIN_DETAIL else None


def _unclear_squares(octaves: dict[Side, list[NDArray[np.float32]]]) -> UnclearSquares | None:
    """Squares in which the images of a side have less fine structure than their coarse structure, or the other side, predicts.
    None if there are none, or one of the sides shows nothing."""
    seen = {side: [one for one in octaves[side] if one.size] for side in SIDES}
    if not all(seen.values()):
        return None
    energies = [np.mean(seen[side], axis=0) for side in SIDES]
    fine = [np.sqrt(energy[0]) for energy in energies]
    ratio = [own / np.sqrt(energy[1] + _NOISE**2) for own, energy in zip(fine, energies, strict=True)]
    found = []
    for own, other in ((0, 1), (1, 0)):
        # Rectified images may differ in width.
        columns = np.minimum(np.arange(ratio[own].shape[1]), ratio[other].shape[1] - 1)
        ratio_there, fine_there = ratio[other][:, columns], fine[other][:, columns]
        certain, likely = (
            (ratio[own] < least) | (ratio[own] < beside * ratio_there) | (fine[own] < faint * fine_there)
            for least, beside, faint in zip(_BLURRED, _BLURRED_BESIDE, _FAINT_BESIDE, strict=True)
        )
        part = cv2.connectedComponents(likely.astype(np.uint8), connectivity=4)[1]
        rows, columns = np.nonzero(np.isin(part, part[certain]) & likely)
        found.append(tuple(zip(rows.tolist(), columns.tolist(), strict=True)))
    return UnclearSquares(side_px=SQUARE_PX, left=found[0], right=found[1]) if any(found) else None


def _check_sharpness(unclear: UnclearSquares | None, drive: Drive) -> HealthCheck:
    """Whether a part of a lens is smeared: the drive is then no evidence of absence there."""
    shares = dict.fromkeys(SIDES, 0.0)
    for side in SIDES if unclear else ():
        camera = drive.rig.left if side == "left" else drive.rig.right
        rows, columns = camera.height_px // SQUARE_PX, camera.width_px // SQUARE_PX
        lower = [row for row, _ in getattr(unclear, side) if row >= rows // 2]
        shares[side] = len(lower) / ((rows - rows // 2) * columns)
    blurred = [side for side in SIDES if shares[side] > _MAX_BLANK_SHARE]
    detail = "The images are sharp in all parts."
    if blurred:
        detail = (
            f"{max(shares.values()):.0%} of the lower half of the {' and '.join(blurred)} images is blurred: a lens is smeared "
            "or wet. A cone that is not found there does not count as gone. Clean the lens."
        )
    return HealthCheck(
        name="blurred parts of the lenses", verdict=Verdict.WARN if blurred else Verdict.PASS, value=max(shares.values()),
        limit=_MAX_BLANK_SHARE, detail=detail,
    )  # fmt: skip


def _check_trigger(
    pairs: Sequence[FramePair],
    chosen: Sequence[int],
    offsets: Callable[[Sequence[int], int], Floats],
    *,
    whole: bool = True,
) -> HealthCheck:
    """Whether right images of other frames fit the left ones better than their own, in the drive or in a part of it: one camera
    may lose a frame, after which all its images are those of another instant. whole: the chosen pairs are of the whole drive."""
    ends = [(first, last) for first in range(len(chosen)) for last in range(first + 1, len(chosen))]
    parts = [chosen[first : last + 1] for first, last in sorted(ends, key=lambda end: end[0] - end[1])] or [chosen]
    if len(chosen) > 1 and not _is_fitting(offsets(chosen[-1:], 0)):
        parts.append([max(chosen[-1] - 2, 0), chosen[-1]])  # one pair may look wrong by chance
    fitting, lag = len(_rows_of_one_scene(offsets(chosen, 0))), 0
    detail = "Left and right images were taken at the same time."
    if fitting < _MIN_MATCHES:
        detail = "The images do not show enough for this check."
    for part in parts:
        found = offsets(part, 0)
        own = len(_rows_of_one_scene(found))
        best, lag = (
            (own, 0) if _is_fitting(found) else max((len(_rows_of_one_scene(offsets(part, k))), k) for k in _LAGS)
        )
        if best < _MIN_MATCHES or best < _FITS_BETTER * own:
            lag = 0
        in_part = not whole or part is not parts[0]
        if in_part and not _is_fitting(offsets(part, lag)):
            lag = 0  # of few pairs the number of points varies
        if lag:
            first, last = (pairs[part[end]].frame_index for end in (0, -1))
            where = f" in frame pairs {first} to {last}" if in_part else ""
            detail = (
                f"The right images{where} belong to left images {abs(lag)} frames {'earlier' if lag > 0 else 'later'}: {best} "
                f"points match, but only {own} as delivered. Correct the image numbers or the trigger."
            )
            break
    value = float(lag) if lag or fitting >= _MIN_MATCHES else None
    return hold_if(lag, TRIGGER, detail, value=value, limit=0.0, unit="frames")


def _is_fitting(found: Floats) -> bool:
    """Whether enough matches (N, 2) are of one scene, so that other frames need not be tried."""
    return len(_rows_of_one_scene(found)) >= _FITTING_SHARE * max(len(found), _MIN_MATCHES)


def _check_columns(columns: Floats) -> HealthCheck:
    """Whether points lie farther right in the right image than infinitely far ones; columns: (N,) left minus right, px."""
    beyond = columns < -_SHRINK
    share = float(beyond.mean())
    detail = "No point lies farther right in the right image."
    if share > _MAX_BEYOND_SHARE:
        detail = (
            f"{share:.0%} of the points lie up to {-np.quantile(columns, 0.01):.0f} px farther right in the right image, which "
            "is impossible even on the horizon: the right images are shifted sideways, or the calibration belongs to another "
            "rig. Check whether the images were cropped, or calibrate the rig (conetl calibrate)."
        )
    held = share > _MAX_BEYOND_SHARE
    return hold_if(held, "columns of the right images", detail, value=share, limit=_MAX_BEYOND_SHARE)


def _rows_of_one_scene(offsets: Floats) -> Floats:
    """Row offsets of the matches that agree with a common row offset and lie not farther right in the right image."""
    rows = offsets[(np.abs(offsets[:, 1]) <= _MAX_ROWS_PX) & (offsets[:, 0] >= -_SHRINK), 1]
    kept: Floats = rows[np.abs(rows - np.median(rows)) <= _SCATTER_PX] if len(rows) else rows
    return kept


def _features(drive: Drive, number: int, side: Side) -> _Features:
    """What one image of a frame pair shows."""
    try:
        stored = _stored(drive, number, side)
    except ImageFileError:
        return _Features()
    image = stored if drive.rig.rectified_from is None else rectify_image(stored, drive.rig, side)
    return _Features(find_corners(image), local_detail(image), detail_by_octaves(image), thinned(stored))


def _stored(drive: Drive, number: int, side: Side) -> Image:
    """The grey image of a frame pair as it is stored. Raises ImageFileError."""
    return read_pair_image(drive.frame_pairs[number], side, drive.rig.rectified_from or drive.rig, grey=True)


def _others(drive: Drive, chosen: Sequence[int], side: Side) -> list[Image]:
    """Thinned images of other frame pairs than the chosen ones."""
    found = []
    for number in evenly_spaced([k for k in range(1, len(drive.frame_pairs)) if k not in chosen], MOST_OTHERS):
        with suppress(ImageFileError):
            found.append(thinned(_stored(drive, number, side)))
    return found
