"""Pairs of video frames for calibration with a board: sharp, and each different from the others.

A moving board blurs, and two cameras without a common trigger see it at two positions: frames are taken while both images are
still. Nothing is written to disk; a frame is read again when its corners are measured.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from conetl.model.arrays import Floats, Image
from conetl.model.errors import InputError
from conetl.model.rig import SIDES, Side
from conetl.perception.boards.images import ImagePair
from conetl.perception.video import LAYOUTS, VIDEO_SUFFIXES, FrameRef, Layout, VideoIndex, index_video, region_of
from conetl.perception.video_frames import frames_between
from conetl.perception.video_sync import SEARCH_S, correlation_peak

#: More pairs make a calibration slower, not better.
MAX_PAIRS = 60
#: Seconds between the frames that are compared, longest recording, width of the small images.
_STEP_S, _MAX_S, _WIDTH_PX = 0.2, 1800.0, 96
#: One frame of this many successive ones is used.
_WINDOW = 5
#: Mean difference (grey levels) of two small images: less is the noise of a still scene, and of frames that show the same view.
_STILL, _ALIKE = 1.0, 1.5


class Videos(NamedTuple):
    """Left and right video; one file twice where each frame holds both images."""

    left: VideoIndex
    right: VideoIndex
    layout: Layout | None


class VideoPairs(NamedTuple):
    """Pairs of frames in the order of recording, and the offset that converts times of the right file to those of the left."""

    pairs: list[ImagePair]
    offset_s: float


def find_videos(folder: Path, layout: Layout | None) -> list[Path]:
    """The video of both cameras, or one with `layout`, in a folder; none where it holds no videos. Raises InputError."""
    found = sorted(p for p in folder.iterdir() if p.is_file() and p.suffix.lower() in VIDEO_SUFFIXES)
    if not found or (layout is not None and len(found) == 1):
        return found
    sides = [[p for p in found if side in p.stem.lower()] for side in SIDES]
    if layout is not None or any(len(own) != 1 for own in sides) or sides[0] == sides[1]:
        raise InputError(
            f"{folder}: expected one video each with left and right in its name, or one in all and --layout; found "
            f"{', '.join(p.name for p in found[:6])}"
        )
    return [sides[0][0], sides[1][0]]


def open_videos(paths: Sequence[Path], layout: Layout | None) -> Videos:
    """The videos of two files, or of one with `layout`. Raises InputError."""
    if (len(paths) == 1) == (layout is None):
        raise InputError(
            f"{paths[0]}: give two video files, or one with --layout left-right (or {', '.join(LAYOUTS[1:])})"
        )
    indexes = [index_video(path, hashed=False) for path in paths]
    for index in indexes:
        length_s = index.times_s()[-1] - index.times_s()[0]
        if not _WINDOW * _STEP_S <= length_s <= _MAX_S:
            raise InputError(
                f"{index.path}: {length_s:.1f} s long, expected {_WINDOW * _STEP_S:g} s to {_MAX_S / 60:g} minutes; cut "
                "it to the part that shows the board"
            )
    return Videos(indexes[0], indexes[-1], layout)


def pairs_in_videos(
    videos: Videos, offset_s: float | None = None, *, on_frame: Callable[[int, int], None] = lambda done, total: None
) -> VideoPairs:
    """Up to `MAX_PAIRS` pairs of frames.

    offset_s: as in `VideoPairs`; None: estimated from the motion in both videos. on_frame: called with frames done and in total.
    Raises InputError if the images never stand still or the offset cannot be found, ImageFileError if a video cannot be decoded.
    """
    files = [videos.left] if videos.layout else [videos.left, videos.right]
    in_step = [_sample_frames(video) for video in files]
    total = sum(map(len, in_step))
    smalls: list[Image] = []
    for video, numbers in zip(files, in_step, strict=True):
        before = sum(map(len, smalls))
        smalls.append(_small_images(video, numbers, lambda done, before=before: on_frame(before + done, total)))  # type: ignore[misc]
    motions = [_motion(small) for small in smalls]
    left_s, right_s = (video.times_s() - video.times_s()[0] for video in (videos.left, videos.right))
    if videos.layout:
        offset_s, motion = 0.0, motions[0]
    else:
        offset_s = _offset_s(videos, *motions) if offset_s is None else offset_s
        motion = np.maximum(motions[0], _at(motions[1], np.arange(float(len(motions[0]))) - offset_s / _STEP_S))
    picked = _still_and_distinct(smalls[0], motion)
    if not picked:
        raise InputError(
            f"{videos.left.path}: the board never stands still for {_STEP_S:g} s; hold the board still for a second in each "
            "position"
        )
    pairs = []
    for n in picked:
        number = in_step[0][n]
        partner = number if videos.layout else int(np.abs(right_s + offset_s - left_s[number]).argmin())
        left, right = str(_frame(videos, "left", number)), str(_frame(videos, "right", partner))
        pairs.append(ImagePair(f"at {left_s[number]:.2f} s", Path(left), Path(right)))
    return VideoPairs(pairs, offset_s)


def _frame(videos: Videos, side: Side, number: int) -> FrameRef:
    video = videos.left if side == "left" else videos.right
    return FrameRef(video.path, video.pts[number], region_of(video, videos.layout, side))


def _sample_frames(video: VideoIndex) -> list[int]:
    """Numbers of the frames nearest to instants `_STEP_S` apart."""
    times_s = video.times_s() - video.times_s()[0]
    instants = np.arange(0.0, times_s[-1], _STEP_S)
    after = np.clip(np.searchsorted(times_s, instants), 1, len(times_s) - 1)
    return [int(n) for n in after - (instants - times_s[after - 1] < times_s[after] - instants)]


def _small_images(video: VideoIndex, numbers: Sequence[int], count: Callable[[int], None]) -> Image:
    """(N, pixels) small grey images of frames by number."""
    wanted = {video.pts[number] for number in numbers}
    found: dict[int, Image] = {}
    size = (_WIDTH_PX, max(1, round(_WIDTH_PX * video.height_px / video.width_px)))
    for pts, image in frames_between(video.path, min(wanted), max(wanted)):
        if pts in wanted:
            found[pts] = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8).ravel()
            count(len(found))
    blank = np.zeros(size[0] * size[1], np.uint8)  # a frame that cannot be decoded is unlike its neighbours
    return np.array([found.get(video.pts[number], blank) for number in numbers])


def _motion(small: Image) -> Floats:
    """(N,) difference of each image from the one before and the one after it, the larger; infinite at both ends."""
    steps = np.array([_difference(a, b) for a, b in pairwise(small)])
    motion = np.full(len(small), np.inf)
    motion[1:-1] = np.maximum(steps[:-1], steps[1:])
    return motion


def _at(motion: Floats, positions: Floats) -> Floats:
    """Motion between two instants, the larger of both; infinite beyond the ends."""
    found = np.full(len(positions), np.inf)
    below, above = np.floor(positions).astype(int), np.ceil(positions).astype(int)
    inside = (below >= 0) & (above < len(motion))
    found[inside] = np.maximum(motion[below[inside]], motion[above[inside]])
    return found


def _offset_s(videos: Videos, left: Floats, right: Floats) -> float:
    """The shift at which both videos move and stand still together. Raises InputError."""
    ours, theirs = (np.log(np.maximum(motion[1:-1], _STILL)) for motion in (left, right))
    most = round(SEARCH_S / _STEP_S)
    found = np.zeros(2 * most + 1)
    for k, shift in enumerate(range(-most, most + 1)):
        a, b = ours[max(shift, 0) :], theirs[max(-shift, 0) :]
        common = min(len(a), len(b))
        if common > most:
            a, b = a[:common] - a[:common].mean(), b[:common] - b[:common].mean()
            found[k] = a @ b / max(float(np.sqrt((a @ a) * (b @ b))), 1e-9)
    peak = correlation_peak(found)
    if peak is None:
        raise InputError(
            f"{videos.right.path}: its time offset from {videos.left.path.name} cannot be estimated from the images; give "
            "--offset-s, the seconds to add to its times (0 if both began together)"
        )
    return peak * _STEP_S


def _still_and_distinct(small: Image, motion: Floats) -> list[int]:
    """Numbers of still images in order: of each window the stillest, as long as it differs from those chosen before."""
    finite = motion[np.isfinite(motion)]
    quietest = float(np.percentile(finite, 10)) if finite.size else 0.0
    quiet = float(np.clip(2.0 * quietest, _STILL, 3.0 * _STILL))  # the images of some cameras are noisier
    stillest = [start + int(motion[start : start + _WINDOW].argmin()) for start in range(0, len(motion), _WINDOW)]
    picked: list[int] = []
    for number in sorted((n for n in stillest if motion[n] <= quiet), key=lambda n: motion[n]):
        if len(picked) < MAX_PAIRS and all(_difference(small[number], small[other]) > _ALIKE for other in picked):
            picked.append(number)
    return sorted(picked)


def _difference(a: Image, b: Image) -> float:
    return float(cv2.absdiff(a, b).mean())
