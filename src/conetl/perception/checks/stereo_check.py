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
from conetl.model.check_params import StereoCheckParams
from conetl.model.drive import MIN_DETAIL, Drive, FramePair, UnclearSquares
from conetl.model.errors import DriveFolderError
from conetl.model.health import Finding
from conetl.model.rig import SIDES, Side
from conetl.perception.checks.lens_check import check_distortion
from conetl.perception.checks.torn_images import MOST_OTHERS, check_seams, thinned
from conetl.perception.image_detail import SQUARE_PX, detail_by_octaves, local_detail
from conetl.perception.images import ImageFileError
from conetl.perception.pair_points import SHRINK as _SHRINK
from conetl.perception.pair_points import Corners, find_corners, match_corners
from conetl.perception.rectified_image import read_pair_image, rectify_image

TRIGGER = "trigger of both cameras"
_DEFAULT = StereoCheckParams()
_PAIRS, _MIN_MATCHES = 5, 50
#: Share of the matches below which the right images of other frames are tried.
_FITTING_SHARE = 0.7
#: Rows by which right images may be off, and scatter of a match (px of the whole image).
_MAX_ROWS_PX, _SCATTER_PX = 40.0, 2.0
#: Positions of a corner are good to this, whatever their number (px of the whole image).
_FLOOR_PX = 0.3
_LAGS = (-3, -2, -1, 1, 2, 3)
#: Pairs that are tried of a part that cannot be followed, and most parts.
_PAIRS_OF_PART, _MOST_PARTS = 3, 10
#: A square shows nothing below this share of the detail of the sharper ones.
_BLANK, _SHARP_QUANTILE = 0.05, 0.8
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


def check_stereo(drive: Drive, params: StereoCheckParams = _DEFAULT) -> tuple[Drive, list[Finding]]:
    """Check some pairs of a drive; the drive and the findings.

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
    if len(near) >= _MIN_MATCHES and wrong > params.max_swapped_share * len(near):
        raise DriveFolderError(
            f"{drive.source_path}: the images are swapped, mirrored or upside down: of {len(near)} points in both images, "
            f"{wrong} lie farther right in the right image. Exchange left and right in drive.yaml (`images` of videos and "
            "image folders, `cameras` of KITTI drives), or rotate the images."
        )
    rows = _rows_of_one_scene(found)
    trigger = _check_trigger(drive.frame_pairs, chosen, offsets, params)
    unclear = _unclear_squares({side: [features(k, side).octaves for k in chosen] for side in SIDES})
    drive = drive.model_copy(update={"unclear": unclear})
    findings = [
        *_check_decoding([drive.frame_pairs[k].frame_index for k in tried if k not in chosen], len(tried)),
        _check_lenses({side: [features(k, side).detail for k in chosen] for side in SIDES}),
        _check_sharpness(unclear, drive),
        trigger,
        check_seams(
            {side: [thin for k in chosen if (thin := features(k, side).thin).size] for side in SIDES},
            partial(_others, drive, chosen),
        ),
    ]
    if len(rows) < _MIN_MATCHES or trigger.value != 0:
        return drive, findings
    findings.append(_check_columns(near[np.abs(near[:, 1] - np.median(rows)) <= _SCATTER_PX, 0]))
    seen = [(features(k, "left").corners.small, features(k, "right").corners.small, *points(k, 0)) for k in chosen]
    findings.append(check_distortion(seen, drive.rig, _SHRINK))
    off_px, sigma_px = float(rows.mean()), float(np.hypot(rows.std() / np.sqrt(len(rows)), _FLOOR_PX))
    off = Finding(check="rows of the right images", value=off_px, sigma=sigma_px)
    if not params.least_rows_px < abs(off_px) <= params.most_rows_px:
        return drive, [*findings, off]
    turned = right_camera_turned(drive.rig, np.array([off_px / drive.rig.right.fy_px, 0.0, 0.0]))
    corrected = off.model_copy(update={"treated": "corrected", "says": ("turned",)})
    return drive.model_copy(update={"rig": turned}), [*findings, corrected]


def check_lost_parts(drive: Drive, lost: Sequence[bool], params: StereoCheckParams = _DEFAULT) -> list[Finding]:
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
    findings = (
        _check_trigger(drive.frame_pairs, part, offsets, params, whole=False)
        for part in evenly_spaced(parts, _MOST_PARTS)
    )
    return [finding for finding in findings if finding.value][:1]


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


def _check_decoding(lost: Sequence[int], tried: int) -> list[Finding]:
    """Whether the images can be decoded; empty if they can. lost: frame indices of pairs of which one cannot."""
    facts = {"lost": len(lost), "tried": tried, "frames": ", ".join(map(str, lost))}
    return [Finding(check="images that can be decoded", value=len(lost) / tried, facts=facts)] if lost else []


def _check_lenses(details: dict[Side, list[NDArray[np.float32]]]) -> Finding:
    """How much of a lens is covered. (A wholly covered lens, darkness and fog reduce `ImageDetail`.)"""
    shares = {side: share for side in SIDES if (share := _blank_share(details[side])) is not None}
    return _of_worst("covered parts of the lenses", shares)


def _of_worst(check: str, shares: dict[Side, float]) -> Finding:
    """The finding about the worse side, which names the sides that are about as bad."""
    worst = max(shares.values(), default=None)
    sides = " and ".join(side for side, share in shares.items() if worst is not None and 2 * share > worst)
    return Finding(check=check, value=worst, facts={"sides": sides})


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


def _check_sharpness(unclear: UnclearSquares | None, drive: Drive) -> Finding:
    """How much of a lens is smeared: the drive is no evidence of absence there."""
    shares: dict[Side, float] = dict.fromkeys(SIDES, 0.0)
    for side in SIDES if unclear else ():
        camera = drive.rig.left if side == "left" else drive.rig.right
        rows, columns = camera.height_px // SQUARE_PX, camera.width_px // SQUARE_PX
        lower = [row for row, _ in getattr(unclear, side) if row >= rows // 2]
        shares[side] = len(lower) / ((rows - rows // 2) * columns)
    return _of_worst("blurred parts of the lenses", shares)


def _check_trigger(
    pairs: Sequence[FramePair],
    chosen: Sequence[int],
    offsets: Callable[[Sequence[int], int], Floats],
    params: StereoCheckParams,
    *,
    whole: bool = True,
) -> Finding:
    """Whether right images of other frames fit the left ones better than their own, in the drive or in a part of it: one camera
    may lose a frame, after which all its images are those of another instant. whole: the chosen pairs are of the whole drive."""
    ends = [(first, last) for first in range(len(chosen)) for last in range(first + 1, len(chosen))]
    parts = [chosen[first : last + 1] for first, last in sorted(ends, key=lambda end: end[0] - end[1])] or [chosen]
    if len(chosen) > 1 and not _is_fitting(offsets(chosen[-1:], 0)):
        parts.append([max(chosen[-1] - 2, 0), chosen[-1]])  # one pair may look wrong by chance
    fitting = len(_rows_of_one_scene(offsets(chosen, 0)))
    for part in parts:
        found = offsets(part, 0)
        own = len(_rows_of_one_scene(found))
        if _is_fitting(found):
            continue
        best, lag = max((len(_rows_of_one_scene(offsets(part, k))), k) for k in _LAGS)
        in_part = not whole or part is not parts[0]
        if best < max(_MIN_MATCHES, params.fits_better * own) or (in_part and not _is_fitting(offsets(part, lag))):
            continue  # of few pairs the number of points varies
        first, last = (pairs[part[end]].frame_index for end in (0, -1))
        facts = {"apart": abs(lag), "direction": "earlier" if lag > 0 else "later", "best": best, "own": own}
        says = ("part",) if in_part else ("",)
        return Finding(check=TRIGGER, value=float(lag), says=says, facts={**facts, "first": first, "last": last})
    return Finding(check=TRIGGER, value=0.0 if fitting >= _MIN_MATCHES else None)


def _is_fitting(found: Floats) -> bool:
    """Whether enough matches (N, 2) are of one scene, so that other frames need not be tried."""
    return len(_rows_of_one_scene(found)) >= _FITTING_SHARE * max(len(found), _MIN_MATCHES)


def _check_columns(columns: Floats) -> Finding:
    """How many points lie farther right in the right image than infinitely far ones; columns: (N,) left minus right, px."""
    share, px = float((columns < -_SHRINK).mean()), -float(np.quantile(columns, 0.01))
    return Finding(check="columns of the right images", value=share, facts={"px": px})


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
