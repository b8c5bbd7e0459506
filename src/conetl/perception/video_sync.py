"""Time shift between the two video files of a rig, from the motion that both show.

Between successive frames the whole image moves up and down as the vehicle pitches, in both cameras equally; sideways it also
moves as near objects pass, which one camera sees earlier. The shifts are measured by phase correlation (Kuglin & Hines 1975) of
small images, and both series are correlated with each other.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from scipy.ndimage import median_filter

from conetl.model.arrays import Floats
from conetl.perception.video import VideoIndex
from conetl.perception.video_frames import frames_between

#: Windows along the recording, and by how much the files may be shifted.
_WINDOWS, _WINDOW_S, SEARCH_S = 6, 7.5, 5.0
#: Width of the small images, and over how many of them the slow part of the motion is removed: it is similar at many shifts.
_WIDTH_PX, _SLOW = 160, 15
#: A correlation that gives a shift, by how much it must be better than at any other shift, and better than one frame to either
#: side: the smooth motion of a good road is similar over some frames.
_LEAST, _LEAST_LEAD, _LEAST_STEP = 0.5, 0.1, 0.25
#: Of 500 Hz; time stamps of a damaged file may be a nanosecond apart, and a correlation has a value for each.
_SHORTEST_PERIOD_S = 0.002


class VideoLag(NamedTuple):
    """What to add to the times of the right file to have those of the left one."""

    offset_s: float
    period_s: float
    """Between two frames; the offset is not a whole number of them where the cameras were not triggered together."""
    windows: tuple[tuple[float, float], ...]
    """Time in the left file and offset (s), of every part of the recording that shows one by itself."""

    @property
    def is_constant(self) -> bool:
        """False if one of the files lost frames that its time stamps do not show."""
        return all(abs(offset_s - self.offset_s) < self.period_s / 2 for _, offset_s in self.windows)


def find_video_lag(left: VideoIndex, right: VideoIndex) -> VideoLag | None:
    """The shift of two files that begin within `SEARCH_S` of each other; None where the images do not show it.

    Raises ImageFileError where a file cannot be decoded at all.
    """
    left_s, right_s = (index.times_s() - index.times_s()[0] for index in (left, right))
    if min(len(left_s), len(right_s)) < 2 * _SLOW:
        return None
    period_s = float(np.median(np.diff(left_s)))
    if period_s < _SHORTEST_PERIOD_S:
        return None
    span_s = min(left_s[-1], right_s[-1])
    count = int(np.clip(np.ceil(span_s / _WINDOW_S), 1, _WINDOWS))
    curves, windows = [], []
    for start_s in np.linspace(0.0, max(span_s - _WINDOW_S, 0.0), count).tolist():
        ours = _motion(left, left_s, start_s, start_s + _WINDOW_S)
        theirs = _motion(right, right_s, start_s - SEARCH_S, start_s + _WINDOW_S + SEARCH_S)
        curves.append(_correlations(ours, theirs, period_s))
        if (shift := correlation_peak(curves[-1], _LEAST_STEP)) is not None:
            windows.append((start_s, shift * period_s))
    shift = correlation_peak(np.mean(curves, axis=0), _LEAST_STEP)
    if shift is None and len(windows) > 1:  # they contradict each other
        shift = windows[0][1] / period_s
    return None if shift is None else VideoLag(shift * period_s, period_s, tuple(windows))


def _motion(video: VideoIndex, times_s: Floats, from_s: float, to_s: float) -> tuple[Floats, Floats]:
    """Instants (N,) and shifts down (N,) in px of a small image between the frames of a part of a video."""
    inside = np.flatnonzero((times_s >= from_s) & (times_s <= to_s))
    if len(inside) < 2:
        return np.empty(0), np.empty(0)
    time_of = dict(zip(video.pts, times_s, strict=True))
    height = max(round(video.height_px * _WIDTH_PX / video.width_px), 2)  # of all, though a stream may change its size
    at_s, shifts, before = [], [], None
    for pts, image in frames_between(video.path, video.pts[inside[0]], video.pts[inside[-1]]):
        small = cv2.resize(image, (_WIDTH_PX, height), interpolation=cv2.INTER_AREA).astype(np.float32)
        if before is not None and pts in time_of:
            at_s.append((before[0] + time_of[pts]) / 2)
            window = cv2.createHanningWindow(small.shape[::-1], cv2.CV_32F)
            shifts.append(cv2.phaseCorrelate(before[1], small, window)[0][1])
        before = (time_of[pts], small) if pts in time_of else before
    return np.array(at_s), np.array(shifts)


def _correlations(left: tuple[Floats, Floats], right: tuple[Floats, Floats], period_s: float) -> Floats:
    """Correlation of both series at every whole shift of the right one up to SEARCH_S; zero where too little overlaps."""
    most = round(SEARCH_S / period_s)
    found = np.zeros(2 * most + 1)
    if min(len(left[0]), len(right[0])) < 2 * _SLOW:
        return found
    first_s, last_s = min(left[0][0], right[0][0]), max(left[0][-1], right[0][-1])
    grid_s = np.arange(first_s, last_s + period_s / 2, period_s)
    ours, theirs = (_on_grid(series, grid_s) for series in (left, right))
    for k, shift in enumerate(range(-most, most + 1)):
        if abs(shift) >= len(grid_s):
            continue
        moved = np.full_like(theirs, np.nan)
        moved[max(shift, 0) : len(grid_s) + min(shift, 0)] = theirs[max(-shift, 0) : len(grid_s) - max(shift, 0)]
        both = np.isfinite(ours) & np.isfinite(moved)
        if both.sum() >= 2 * _SLOW:
            a, b = ours[both], moved[both]
            found[k] = float(a @ b) / max(float(a @ a) * float(b @ b), 1e-18) ** 0.5
    return found


def _on_grid(series: tuple[Floats, Floats], grid_s: Floats) -> Floats:
    """(M,) quick part of the motion at the instants of a grid, of unit spread; NaN outside of the series."""
    at_s, shifts = series
    quick = shifts - median_filter(shifts, size=_SLOW, mode="nearest")
    quick = np.clip(quick / max(1.4826 * float(np.median(np.abs(quick))), 1e-3), -5.0, 5.0)
    return np.interp(grid_s, at_s, quick, left=np.nan, right=np.nan)


def correlation_peak(curve: Floats, least_step: float = 0.0) -> float | None:
    """Shift of the best of correlations at whole shifts around zero, in steps; None where it does not stand out.

    By a parabola through it and its neighbours. least_step: by how much it must be better than the lesser of these.
    """
    best = int(np.argmax(curve))
    others = np.delete(curve, range(max(best - 2, 0), min(best + 3, len(curve))))
    if curve[best] < _LEAST or (len(others) and curve[best] - others.max() < _LEAST_LEAD):
        return None
    shift = float(best - len(curve) // 2)
    if 0 < best < len(curve) - 1:
        before, at, after = curve[best - 1 : best + 2]
        if at - min(before, after) < least_step:
            return None
        shift += 0.5 * (before - after) / min(before - 2 * at + after, -1e-9)
    return shift
