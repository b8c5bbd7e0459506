"""Points followed between two frame pairs, and the motions computed from them.

Points need images (`perception/visual_odometry.py`), motions only the points and the rig.
"""

from __future__ import annotations

from base64 import b64decode, b64encode
from collections.abc import Iterable, Iterator, Sequence
from enum import StrEnum
from itertools import pairwise
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BeforeValidator, Field, PlainSerializer, model_validator

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

#: The first round has the rate of the logged poses, the second that of the images.
_ROUNDS_OF_ROLLING = 2
#: During a longer pause without images (s) GNSS may jump, and a vehicle may drive any step: only the images show which.
PAUSE_S = 5.0


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
    """Of each interval the expected motion and, across a pause without images, also that of the interval before."""
    expected = expected_motions(frame_pairs, rig)
    pauses = np.diff([pair.captured_at_ns for pair in frame_pairs]) > 1e9 * PAUSE_S
    before = [*expected[:1], *expected[:-1]]
    return [[one, other] if pause else [one] for one, other, pause in zip(expected, before, pauses, strict=True)]


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

    The motion of the interval before is tried first.
    """
    cameras = cameras_of(rig)
    before: Floats | None = None
    lasts_s = np.diff([pair.captured_at_ns for pair in frame_pairs]) * 1e-9
    for points, to_try, own_s in zip(tracks, motions_to_try(frame_pairs, rig), lasts_s.tolist(), strict=True):
        motion = None
        if points.missing is None:
            for expected in to_try:
                motion = _motion_of(points, rig, cameras, expected, before, own_s, params)
                if motion.status is MotionStatus.OK:
                    break
            before = motion.next_SE3_first if motion is not None and motion.status is MotionStatus.OK else None
        yield relative_motion(points, motion)


def _motion_of(
    tracks: StereoTracks,
    rig: Rig,
    cameras: StereoCameras,
    expected: Floats,
    before: Floats | None,
    lasts_s: float,
    params: TrajectoryParams,
) -> StereoMotion:
    """The motion between two frame pairs, lasts_s apart. expected, before: possible motions, as for `estimate_motion`.

    With a rolling shutter it is estimated again, with points at the time stamps by what was found first: visual odometry stays
    independent of the log.
    """
    first_px, second_px, sigma_px = tracks.points()
    found, start = expected, None
    for _ in range(_ROUNDS_OF_ROLLING if readouts_s(rig).any() else 1):
        rate = rate_of(found, lasts_s)
        first, second = (points_at_stamp(rig, cameras, px, rate)[:, :3] for px in (first_px, second_px))
        motion = estimate_motion(
            cameras, first, second, sigma_px, expected, params, seed=tracks.first_frame_index, start=start, guess=before
        )
        if motion.status is not MotionStatus.OK:
            break
        found = start = motion.next_SE3_first
    return motion


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
