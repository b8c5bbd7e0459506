"""Torn images: from a row on they show the instant of the image before, because a buffer was overwritten while it was read, or a
packet was lost.

Such an image repeats rows of the one before, noise included, while the rest of it and the intervals before and after move:
repeated rows change by less than 0.01 of the usual change, rows of intact drives by at least 0.2 of it. The hood of the vehicle,
a bar or a standing vehicle change as little in all intervals.

If all images are torn at one row, nothing repeats. But neighbouring rows differ there more than anywhere else: a seam is sharp, a
lens is not. A single image hides it; the mean of five shows the row, and in twenty others its seam exceeds those of the rows
around 2.4 times (in intact drives 1.16 times). After an image that repeats rows, the seam shows whether the next ones are torn.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from scipy.ndimage import median_filter

from conetl.geometry.motion.stereo_motion import RelativeMotion
from conetl.geometry.motion.stereo_tracks import motions_between
from conetl.model.arrays import Floats, Image
from conetl.model.check_params import ImageCheckParams
from conetl.model.drive import Drive, FramePair
from conetl.model.health import Finding
from conetl.model.rejections import Rejection, RejectionReason
from conetl.model.rig import SIDES, Side
from conetl.perception.images import ImageFileError
from conetl.perception.working_size import ImageReader

#: Number of bands of rows over which changes are averaged.
BANDS = 64
#: A band is repeated if it changes by less than `_REPEATED` of its change in the intervals before and after, and moves above
#: `_MOVING`, where that change is at least `_LEAST_CHANGE` grey levels. `_LEAST_SHARE` of an image must be repeated, and as much
#: must move.
_REPEATED, _MOVING, _LEAST_CHANGE, _LEAST_SHARE = 0.15, 0.5, 1.0, 0.05
#: Repeated bands are contiguous: they make up at least this share of those from the first to the last.
_MOST_OF_BANDS = 0.8
#: Seams are searched at this share of the width, in this many strips; larger differences are clipped to this many grey levels.
_THINNED, _STRIPS, _MOST_LEVELS = 4, 6, 20
#: Rows on either side with which a seam is compared: with the third largest, or for mean seams the second largest.
_ROWS_BESIDE, _MEAN_ROWS_BESIDE = 12, 24
#: Factors by which the seam of one image exceeds that row, and the mean seam of all images does in all strips but one.
_LEAST_SEAM, _LEAST_IN_STRIPS = 1.5, 1.2
#: If the strongest seam of the first few images exceeds all other rows by the factor `_SUSPECTED`, up to `MOST_OTHERS` other
#: images are read; the check needs `_LEAST_IMAGES`. Up to `_MOST_EDGES` of the strongest rows are tried, since some are edges,
#: such as those of the hood or of captions.
_SUSPECTED, MOST_OTHERS, _LEAST_IMAGES, _MOST_EDGES = 1.1, 20, 12, 4
#: Not a seam: steps of one sign, and rows below that change less from image to image, or are less sharp, than those above.
_ONE_SIGN, _STATIC, _BLURRED = 0.7, 0.3, 0.3
_DEFAULT = ImageCheckParams()


class TornImage(NamedTuple):
    """An image with rows from another instant."""

    pair: FramePair
    side: Side
    row_px: int
    """The first of these rows, roughly."""


def row_changes(first: Image, second: Image) -> Floats:
    """(BANDS,) mean grey levels by which bands of rows differ between two images (H, W)."""
    rows = cv2.reduce(cv2.absdiff(first, second), 1, cv2.REDUCE_AVG, dtype=cv2.CV_32F)
    return np.asarray(cv2.resize(rows, (1, BANDS), interpolation=cv2.INTER_AREA)[:, 0], np.float64)


def find_torn(
    drive: Drive, motions: Sequence[RelativeMotion], read: ImageReader, params: ImageCheckParams = _DEFAULT
) -> list[TornImage]:
    """Images that repeat rows of the one before, and following ones that are torn at the same row.

    read: grey images of a frame pair as they are stored.
    """
    pairs = drive.frame_pairs
    unknown = np.full((len(SIDES), BANDS), np.nan)
    changes = np.array(
        [
            unknown if motion is None or not motion.row_changes else np.reshape(motion.row_changes, unknown.shape)
            for motion in motions_between(pairs, motions)
        ]
        or [unknown]
    )
    beside = np.fmin(np.concatenate([unknown[None], changes[:-1]]), np.concatenate([changes[1:], unknown[None]]))
    ratios = changes / np.where(beside >= _LEAST_CHANGE, beside, np.nan)
    enough = [(part.mean(axis=2) >= _LEAST_SHARE) for part in (ratios < _REPEATED, ratios > _MOVING)]
    torn: dict[tuple[int, int], TornImage] = {}
    for k, side in np.argwhere(enough[0] & enough[1]).tolist():
        bands = np.flatnonzero(ratios[k, side] < _REPEATED)
        if len(bands) >= _MOST_OF_BANDS * (bands[-1] - bands[0] + 1):
            row = int(bands[0] * drive.rig.left.height_px / BANDS)
            torn[k + 1, side] = TornImage(pairs[k + 1], SIDES[side], row)
    if len({k for k, _ in torn}) <= params.max_torn_share * len(pairs):
        for (k, side), one in list(torn.items()):
            for later, again in enumerate(_following_torn(one, pairs[k:], read), k + 1):
                torn.setdefault((later, side), again)
    return [torn[key] for key in sorted(torn)]


def _following_torn(torn: TornImage, pairs: Sequence[FramePair], read: ImageReader) -> Iterator[TornImage]:
    """Images of the pairs after the first that have a seam at the row of the first."""
    row = None
    for pair in pairs:
        try:
            seams = _seams(thinned(read(pair, torn.side))).mean(axis=1)
        except ImageFileError:
            return
        if row is None:
            reach = len(seams) // BANDS + 2
            start = max(torn.row_px - 2 * reach, 0)
            row = start + int(seams[start : torn.row_px + reach].argmax())
        if _excess(seams, row, _ROWS_BESIDE, 3) < _LEAST_SEAM:
            return
        if pair is not pairs[0]:
            yield TornImage(pair, torn.side, row)


def check_torn(torn: Sequence[TornImage], drive: Drive) -> tuple[Finding, list[Rejection]]:
    """Whether so many pairs of a drive are torn that undetected ones matter; rejections of the torn pairs."""
    first = {one.pair.frame_index: one for one in reversed(torn)}
    rejections = [_rejection(first[frame]) for frame in sorted(first)]
    facts: dict[str, int | str] = {"torn": len(first), "pairs": len(drive.frame_pairs)}
    if rejections:
        facts |= {"record": rejections[0].record, "row": rejections[0].payload["row_px"]}
    return Finding(check="torn images", value=len(first) / len(drive.frame_pairs), facts=facts), rejections


def _rejection(torn: TornImage) -> Rejection:
    path, frame = torn.pair.image(torn.side)[0], torn.pair.frame_index
    return Rejection(
        step="detections",
        reason=RejectionReason.IMAGE_TORN,
        record=f"frame pair {frame}",
        detail=f"{Path(path).name}: from about row {torn.row_px} on, the {torn.side} image shows the previous frame: it is torn. "
        "Check the recorder and its connection",
        payload={"frame_index": frame, "side": torn.side, "path": path, "row_px": torn.row_px},
    )


def check_seams(images: dict[Side, list[Image]], others: Callable[[Side], list[Image]]) -> Finding:
    """How strong a seam at one row of all images is. images: some of each side, `thinned`; others: more of a side."""
    found = {side: _mean_seam(images[side], partial(others, side)) for side in SIDES}
    known = {side: seam for side, seam in found.items() if seam is not None}
    strongest = max((size for size, _ in known.values()), default=None)
    # The seam of a side without one is 1.
    rows = [f"row {row} of the {side} images" for side, (size, row) in known.items() if 2 * size > 1 + (strongest or 1)]
    return Finding(check="seams in the images", value=strongest, facts={"rows": " and ".join(rows)})


def _mean_seam(images: Sequence[Image], others: Callable[[], list[Image]]) -> tuple[float, int] | None:
    """How far the strongest seam exceeds the rows around it, and its row; None if the images show too little."""
    if not images or min(len(image) for image in images) < 4 * _ROWS_BESIDE:
        return None
    [first, second] = [size for _, size in _strongest(_mean_of_strips(images).mean(axis=1), 2)]
    if first < _SUSPECTED * second:
        return 1.0, 0
    more = [*images, *others()]
    if len(more) < _LEAST_IMAGES:
        return None
    strips, stack = _mean_of_strips(more), np.array(more, np.float64)
    seams = strips.mean(axis=1)
    found = [
        (float(_excess(seams, row, _MEAN_ROWS_BESIDE, 2)), row)
        for row, _ in _strongest(seams, _MOST_EDGES)
        if np.sort(_excess(strips, row, _MEAN_ROWS_BESIDE, 2))[1] > _LEAST_IN_STRIPS and not _is_edge(stack, row)
    ]
    return max(found, default=(1.0, 0))


def _mean_of_strips(images: Sequence[Image]) -> Floats:
    """(H, _STRIPS)"""
    return np.asarray(np.mean([_seams(image) for image in images], axis=0))


def _strongest(seams: Floats, count: int) -> list[tuple[int, float]]:
    """The `count` rows, no two of them adjacent, that stand out most from the rows around them, and by what factor."""
    sizes = seams / (median_filter(seams, 2 * _ROWS_BESIDE + 1) + 0.05)
    found = []
    for _ in range(count):
        row = int(sizes.argmax())
        found.append((row, float(sizes[row])))
        sizes[max(row - 2, 0) : row + 3] = 0.0
    return found


def _is_edge(images: Floats, row: int) -> bool:
    """Whether a row of images (N, H, W) is the edge of the vehicle, a bar or a blurred part of the lens."""
    steps = images[:, row] - images[:, row - 1]
    steps -= np.median(steps, axis=1, keepdims=True)
    one_sign = np.abs(steps.mean(axis=0)).sum() > _ONE_SIGN * np.abs(steps).mean(axis=0).sum()
    above, below = images[:, max(row - _ROWS_BESIDE, 0) : row], images[:, row : row + _ROWS_BESIDE]
    moving = [float(np.std(part, axis=0).mean()) for part in (above, below)]
    sharp = [float(np.abs(np.diff(part, axis=1)).mean()) for part in (above, below)]
    return bool(one_sign or min(moving) < _STATIC * max(moving) or min(sharp) < _BLURRED * max(sharp))


def _excess(seams: Floats, row: int, reach: int, rank: int) -> Floats:
    """How many times as strong a row's seam is as the `rank`-th strongest of the rows beside, apart from the next ones.

    seams: (H,), or (H, K) of K strips.
    """
    start = max(row - reach, 0)
    beside = np.delete(seams[start : row + reach + 1], np.s_[max(row - start - 1, 0) : row - start + 2], axis=0)
    return np.asarray(seams[row] / np.maximum(np.sort(beside, axis=0)[-rank], 0.05))


def thinned(image: Image) -> Image:
    """(H, W // 4) means of four neighbours in a row: less noise, seams as sharp as before."""
    size = max(image.shape[1] // _THINNED, 1), image.shape[0]
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


def _seams(image: Image) -> Floats:
    """(H, _STRIPS) by how much each row of a thinned image differs from the one above, beyond what the rows beside do."""
    steps = cv2.absdiff(image[1:], image[:-1])
    beyond = np.minimum(cv2.subtract(steps[1:-1], cv2.max(steps[:-2], steps[2:])), _MOST_LEVELS)
    means = cv2.resize(beyond.astype(np.float32), (_STRIPS, len(beyond)), interpolation=cv2.INTER_AREA)
    return np.pad(means.astype(np.float64), ((2, 1), (0, 0)))
