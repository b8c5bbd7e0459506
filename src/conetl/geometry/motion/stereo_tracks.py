"""Points followed between two frame pairs, and the motions computed from them.

Points need images (`perception/visual_odometry.py`), motions only the points and the rig.
"""

from __future__ import annotations

import math
from base64 import b64decode, b64encode
from collections.abc import Callable, Iterable, Iterator, Sequence
from enum import StrEnum
from itertools import chain, pairwise
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BeforeValidator, Field, PlainSerializer, model_validator
from scipy.ndimage import median_filter, uniform_filter1d
from scipy.spatial.transform import Rotation

from conetl.geometry import pose as se3
from conetl.geometry.camera import intrinsics
from conetl.geometry.motion.rolling_shutter import points_at_stamp, rate_of, readouts_s
from conetl.geometry.motion.stereo_motion import (
    MotionStatus,
    RelativeMotion,
    StereoCameras,
    StereoMotion,
    estimate_motion,
)
from conetl.geometry.rig import left_SE3_right, map_SE3_left
from conetl.model.arrays import Floats
from conetl.model.base import Positive, Record
from conetl.model.drive import FramePair
from conetl.model.params import TrajectoryParams
from conetl.model.rig import Rig

#: During a longer pause without images (s) GNSS may jump, and a vehicle may drive any step: only the images show which.
PAUSE_S = 5.0
#: Expected motions may scatter by this much from one interval to the next, beyond it they are means of at most so many around.
_MOST_SCATTER_M, _MOST_SCATTER_RAD, _MOST_AROUND = 0.1, 0.01, 10
#: A log steps where its motion differs by more from the median of so many, in metres and as a share: too far for points to be
#: followed.
_STEP_M, _STEP_SHARE, _STEP_OF = 0.3, 0.3, 9
#: Stated sigma of sparse positions from which on they show a motion only in the mean over some of them.
_COARSE_M = 0.2


class NoMeasurement(StrEnum):
    """Why no points were followed between two frame pairs."""

    IMAGE_UNREADABLE = "image_unreadable"
    IMAGE_BLANK = "image_blank"
    IMAGE_FROZEN = "image_frozen"
    IMAGE_UNFIT = "image_unfit"
    """The image library refused to work on what was read."""
    TOO_FEW_POINTS = "too_few_points"


def _packed(points_px: ArrayLike | bytes | str) -> bytes:
    """Image points as bytes, from an array, from bytes, or from their base64 text in a file."""
    if isinstance(points_px, bytes):
        return points_px
    if isinstance(points_px, str):
        return b64decode(points_px, validate=True)
    return np.asarray(points_px, dtype="<f8").tobytes()


#: N points (u_left, v_left, u_right, v_right) as the bytes of a (N, 4) array of little-endian doubles: a record of thousands of
#: Python numbers takes longer to validate and to write than the points take to follow.
PackedPoints = Annotated[
    bytes, BeforeValidator(_packed), PlainSerializer(lambda data: b64encode(data).decode(), when_used="json")
]


class StereoTracks(Record):
    """Points followed between two frame pairs, in pixels of the rectified images; without points, the reason."""

    first_frame_index: int = Field(ge=0)
    second_frame_index: int = Field(ge=0)
    first_px: PackedPoints
    """In the first frame pair; arrays (N, 4) are accepted."""
    second_px: PackedPoints
    """The same points in the second."""
    sigma_px: Positive
    """Of each coordinate."""
    missing: NoMeasurement | None
    row_changes: tuple[float, ...] = ()
    """See `RelativeMotion`."""

    @model_validator(mode="after")
    def _same_points_in_both(self) -> StereoTracks:
        if len(self.first_px) % 32 or len(self.first_px) != len(self.second_px):
            raise ValueError("expected four numbers per point, for the same points in both frame pairs")
        if not all(np.isfinite(px).all() for px in self.points()):
            raise ValueError("expected finite image points")
        return self

    def points(self) -> tuple[Floats, Floats, Floats]:
        """(N, 4), (N, 4) points in both frame pairs and (N,) their sigma."""
        first, second = (np.frombuffer(px, dtype="<f8").reshape(-1, 4) for px in (self.first_px, self.second_px))
        return first, second, np.full(len(first), self.sigma_px)


def cameras_of(rig: Rig) -> StereoCameras:
    """Cameras of a rectified rig, whose right camera may be turned. Raises ValueError for a rig with lenses."""
    if any(camera.lens.model != "none" for camera in (rig.left, rig.right)):
        raise ValueError("cameras_of: the rig must be rectified")
    return StereoCameras(intrinsics(rig.left), intrinsics(rig.right), se3.invert(left_SE3_right(rig)))


def expected_motions(frame_pairs: Sequence[FramePair], rig: Rig) -> list[Floats]:
    """(4, 4) next_SE3_first of the left camera between each frame pair and the next, by the poses that they have."""
    poses = [map_SE3_left(pair.pose, rig) for pair in frame_pairs]
    return [se3.compose(se3.invert(second), first) for first, second in pairwise(poses)]


def motions_to_try(frame_pairs: Sequence[FramePair], rig: Rig) -> list[list[Floats]]:
    """Of each interval the expected motions that may be near enough to follow points by.

    A log that scatters is smoothed, so that motions are those of some intervals in the mean. Across a pause without images, the
    motion of the interval before is tried, too, where the log steps, the median of those around, and where positions are sparse,
    their mean.
    """
    expected = _without_scatter(np.array(expected_motions(frame_pairs, rig)).reshape(-1, 4, 4))
    pauses = np.diff([pair.captured_at_ns for pair in frame_pairs]) > 1e9 * PAUSE_S
    usual = _filtered(expected, lambda parts: median_filter(parts, (_STEP_OF, 1), mode="nearest"))
    off_m, usual_m = (np.linalg.norm(part[:, :3, 3], axis=1) for part in (expected - usual, usual))
    steps = off_m > np.maximum(_STEP_M, _STEP_SHARE * usual_m)
    before = [*expected[:1], *expected[:-1]]
    found = [
        [one, *([other] if pause else []), *([around] if step else [])]
        for one, other, around, pause, step in zip(expected, before, usual, pauses, steps, strict=True)
    ]
    sparse_s = [pair.pose.interpolated.apart_s for pair in frame_pairs if pair.pose.interpolated is not None]
    if sparse_s and max(np.median([pair.pose.sigma_enu_m[:2] for pair in frame_pairs], axis=0)) > _COARSE_M:
        lasts_s = float(np.median(np.diff([pair.captured_at_ns for pair in frame_pairs]))) * 1e-9
        around = _mean_motions(expected, round(1.5 * float(np.median(sparse_s)) / max(lasts_s, 1e-3)))
        found = [[*ones, other] for ones, other in zip(found, around, strict=True)]
    return found


def _without_scatter(motions: Floats) -> Floats:
    """(N, 4, 4) motions, each the mean of as many around it as their scatter requires."""
    if len(motions) < 3:
        return motions
    turns = Rotation.from_matrix(motions[:, :3, :3]).as_rotvec()
    # Of two intervals side by side one is too long if the other is too short, by independent errors of three poses.
    scatter = [float(np.median(np.abs(np.diff(part, axis=0)).max(axis=1))) for part in (motions[:, :3, 3], turns)]
    around = max((one / most - 1) / 2 for one, most in zip(scatter, (_MOST_SCATTER_M, _MOST_SCATTER_RAD), strict=True))
    return _mean_motions(motions, min(math.ceil(max(around, 0.0)), _MOST_AROUND))


def _mean_motions(motions: Floats, around: int) -> Floats:
    """(N, 4, 4) means of the motions (N, 4, 4) of an interval and so many before and after it."""
    return _filtered(motions, lambda parts: uniform_filter1d(parts, 2 * around + 1, axis=0, mode="reflect"))


def _filtered(motions: Floats, method: Callable[[Floats], Floats]) -> Floats:
    """(N, 4, 4) motions whose rotation vectors and translations, together (N, 6), are filtered."""
    if not len(motions):
        return motions
    parts = np.hstack([Rotation.from_matrix(motions[:, :3, :3]).as_rotvec(), motions[:, :3, 3]])
    parts = method(parts)
    return se3.se3(Rotation.from_rotvec(parts[:, :3]).as_matrix(), parts[:, 3:])


def motions_between(frame_pairs: Sequence[FramePair], motions: Iterable[RelativeMotion]) -> list[RelativeMotion | None]:
    """The motion of every interval between neighbouring frame pairs; None where it is not among `motions`."""
    by_frames = {(motion.first_frame_index, motion.second_frame_index): motion for motion in motions}
    return [by_frames.get((one.frame_index, other.frame_index)) for one, other in pairwise(frame_pairs)]


def shifts_between(frame_pairs: Sequence[FramePair], motions: Iterable[RelativeMotion]) -> Floats:
    """(N, 3) m: translations of the same intervals; NaN where none was measured."""
    found = motions_between(frame_pairs, motions)
    return np.array([np.full(3, np.nan) if motion is None else motion.shift_m() for motion in found]).reshape(-1, 3)


def motions_of(
    tracks: Iterable[StereoTracks],
    frame_pairs: Sequence[FramePair],
    rig: Rig,
    params: TrajectoryParams,
) -> Iterator[RelativeMotion]:
    """Motion of every interval of `tracks`, in their order; tracks[k] runs from frame_pairs[k] to frame_pairs[k + 1].

    The motion of the interval before is tried first. With a rolling shutter each one is estimated again when that of the next
    interval is known, with points at the time stamps.
    """
    lasts_s = (np.diff([pair.captured_at_ns for pair in frame_pairs]) * 1e-9).tolist()
    intervals = _intervals(tracks, frame_pairs, rig, lasts_s, params)
    if readouts_s(rig).any():
        intervals = _at_stamps(intervals, rig, lasts_s, params)
    for interval in intervals:
        yield relative_motion(interval.tracks, interval.motion)


class _Interval(NamedTuple):
    """Between a frame pair and the next."""

    tracks: StereoTracks
    expected: Floats
    """(4, 4) motion by the poses; the last one of those that were tried."""
    motion: StereoMotion | None
    """None without points."""


def _intervals(
    tracks: Iterable[StereoTracks], frame_pairs: Sequence[FramePair], rig: Rig, lasts_s: Sequence[float],
    params: TrajectoryParams,
) -> Iterator[_Interval]:  # fmt: skip
    """All intervals in order; points are moved to the time stamps by the expected motions. lasts_s: time of each."""
    cameras, rolling = cameras_of(rig), bool(readouts_s(rig).any())
    before: Floats | None = None
    for points, to_try, own_s in zip(tracks, motions_to_try(frame_pairs, rig), lasts_s, strict=True):
        motion, expected = None, to_try[0]
        if points.missing is None:
            first_px, second_px, sigma_px = points.points()
            for expected in to_try:
                first, second = first_px[:, :3], second_px[:, :3]
                if rolling:
                    rate = rate_of(expected, own_s)
                    first, second = (points_at_stamp(rig, cameras, px, rate)[:, :3] for px in (first_px, second_px))
                motion = estimate_motion(
                    cameras, first, second, sigma_px, expected, params, seed=points.first_frame_index, guess=before
                )
                if motion.status is MotionStatus.OK:
                    break
            before = motion.next_SE3_first if motion is not None and motion.status is MotionStatus.OK else None
        yield _Interval(points, expected, motion)


def _at_stamps(
    intervals: Iterable[_Interval], rig: Rig, lasts_s: Sequence[float], params: TrajectoryParams
) -> Iterator[_Interval]:
    """The intervals with motions of points that were moved to the time stamps by the measured motions, not by those of the log.

    The rate at a frame pair is that between its two intervals: with the rate of one interval at both of its ends, motions would
    be those of a later time, by the mean of the rows' times.
    """
    cameras = cameras_of(rig)
    rate_before: tuple[Floats, float] | None = None
    for (interval, following), own_s, next_s in zip(
        pairwise(chain(intervals, [None])), lasts_s, [*lasts_s[1:], 0.0], strict=True
    ):
        assert interval is not None  # only the last one is
        own = _rate(interval, own_s)
        after = None if following is None else _rate(following, next_s)
        if own is not None and interval.motion is not None:
            first_px, second_px, sigma_px = interval.tracks.points()
            first = points_at_stamp(rig, cameras, first_px, _between(rate_before, own))[:, :3]
            second = points_at_stamp(rig, cameras, second_px, _between(after, own))[:, :3]
            motion = estimate_motion(
                cameras, first, second, sigma_px, interval.expected, params, seed=interval.tracks.first_frame_index,
                start=interval.motion.next_SE3_first,
            )  # fmt: skip
            yield interval._replace(motion=motion)
        else:
            yield interval
        rate_before = own


def _rate(interval: _Interval, lasts_s: float) -> tuple[Floats, float] | None:
    """(6,) rate in an interval and its length (s); None where its motion is not known, or across a pause."""
    if interval.motion is None or interval.motion.status is not MotionStatus.OK or lasts_s > PAUSE_S:
        return None
    return rate_of(interval.motion.next_SE3_first, lasts_s), lasts_s


def _between(beside: tuple[Floats, float] | None, own: tuple[Floats, float]) -> Floats:
    """(6,) rate at the frame pair between two intervals of known rates and lengths; that of the own one where it is alone."""
    if beside is None:
        return own[0]
    return np.asarray((beside[0] * own[1] + own[0] * beside[1]) / max(own[1] + beside[1], 1e-9))


def relative_motion(tracks: StereoTracks, motion: StereoMotion | None) -> RelativeMotion:
    """The record of a motion between the two frame pairs of `tracks`; motion: None where they have no points."""
    known = motion is not None and motion.status is MotionStatus.OK
    return RelativeMotion(
        first_frame_index=tracks.first_frame_index, second_frame_index=tracks.second_frame_index,
        second_SE3_first=se3.to_matrix4(motion.next_SE3_first) if motion is not None and known else None,
        cov=tuple(motion.cov[np.triu_indices(6)].tolist()) if motion is not None and known else (),
        inlier_count=0 if motion is None else int(motion.inliers.sum()), point_count=len(tracks.points()[0]),
        reason=str(tracks.missing if motion is None else motion.status), row_changes=tracks.row_changes,
    )  # fmt: skip
