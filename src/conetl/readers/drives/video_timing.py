"""When the images of videos and image folders were taken, by the clock of their trajectory.

Times come from drive.yaml or from files of time stamps; what neither states is found from the images: by how much the right
file is shifted against the left one, and when the left one begins.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from conetl.geometry.motion.rolling_shutter import middle_row_s
from conetl.geometry.motion.stereo_motion import RelativeMotion
from conetl.model.drive import FramePair
from conetl.model.errors import InputError
from conetl.model.params import TrajectoryParams
from conetl.model.rig import Rig, Side
from conetl.perception.images import ImageFileError
from conetl.perception.rectified_image import read_rig_image
from conetl.perception.unguided_odometry import measure_motions
from conetl.perception.video_sync import find_video_lag
from conetl.readers.drives.drive_yaml import DRIVE_YAML, MAX_SEARCH_S, Clock, DriveYaml, Images
from conetl.readers.drives.image_times import CameraImages, UnknownTimeError, listed, stated_start
from conetl.readers.drives.pairs import Couple, PairError, Source, pair_by_stamp, time_of
from conetl.readers.drives.poses import Samples
from conetl.readers.drives.sparse_poses import pose_reader
from conetl.tracking.clock import estimate_clock
from conetl.tracking.clock_search import LEAST_SIGMA_S, ImageClock, find_clock_offset, rates_of
from conetl.tracking.trajectory import measured_motions, read_log

#: Cameras whose shift is farther than this from a whole number of frames were not triggered together.
_WHOLE = 0.25
#: Seconds of the trajectory before and after the images that help to smooth it.
_MARGIN_S = 20.0
#: At most so many parts of 2.5 minutes of a drive are tried.
_MOST_PARTS = 4
#: Sigma of an offset that is stated without one (s), for example from a flash of light. The poses show the rest of it.
_STATED_SIGMA_S = 0.01
#: Offsets of two methods that differ by more sigmas contradict each other.
_CONTRADICTS = 4.0
_log = logging.getLogger(__name__)


class Timing(NamedTuple):
    """The times of the images by the clock of the trajectory."""

    couples: list[Couple]
    """Their times are by the trajectory's clock."""
    start_ns: int | None
    """UTC of the first left frame by that clock; None where every image has a time of its own."""
    right_offset_s: float
    """What to add to the right file's times to have those of the left one."""
    clock: ImageClock
    """What was added to the times as stated, and its sigma."""


def timed(cameras: Sequence[CameraImages], track: Samples, rig: Rig, source: Source, *, from_course: bool) -> Timing:
    """The couples of images with their times. Raises InputError."""
    root, settings = source.root, source.settings
    images, (left, right), start_ns, shift_s, clock = settings.images, cameras, None, 0.0, settings.clock
    search_s = None
    if images.timestamps is not None or left.video is None:
        own = images.right_timestamps
        hint = f": its {len(left.paths)} lines are those of {left.name}. Name the times of the right images in {DRIVE_YAML}, "
        hint = "" if own else hint + "too: 'images: {right_timestamps: right.txt}'"
        ours = listed(left, images.timestamps, source, track)
        theirs = listed(right, own or images.timestamps, source, track, hint)
    else:
        start_ns, search_s = _start_ns(left, track, settings, root)
        if search_s is not None and search_s > MAX_SEARCH_S:
            raise _unknown_start(
                root,
                left,
                f"{track.name} is too long ({search_s / 1800:.0f} hours with the video) to search in it when {left.name} "
                "was recorded",
            )
        if search_s is not None:
            clock = Clock(search_s=search_s)
        if left.video is not right.video:
            shift_s = _right_offset_s(left, right, images)
        ours, theirs = left.from_start(start_ns), right.from_start(start_ns + round(shift_s * 1e9))
    couples = _chosen(pair_by_stamp(ours, theirs, settings.pair_tolerance_ns), images, root)
    if not couples:
        raise InputError(
            f"{root}: no left image has a right one within {settings.pair_tolerance_ms:g} ms (pair_tolerance_ms in {DRIVE_YAML})"
        )
    pairs = [(a.stamp, {"left": a.path, "right": b.path}) for a, b in couples if a and b and isinstance(a.stamp, int)]

    def read_image(number: int, side: Side) -> NDArray[np.uint8]:
        return read_rig_image(pairs[number][1][side], rig, side)

    try:
        found = image_clock(clock, track, [t for t, _ in pairs], rig, read_image, from_course=from_course)
    except InputError as error:
        if search_s is None:
            raise
        raise _unknown_start(
            root,
            left,
            f"the recording time of {left.name} cannot be estimated from the images: too few turns and changes of speed, or "
            f"{track.name} is of another time",
        ) from error
    if clock is not None and clock.offset_s == "estimate":  # motions are those of the middle row
        found = found._replace(offset_s=found.offset_s - middle_row_s(rig))
    offset_ns = round(found.offset_s * 1e9)
    moved = [(a and a.later(offset_ns), b and b.later(offset_ns)) for a, b in couples]
    return Timing(moved, None if start_ns is None else start_ns + offset_ns, shift_s, found)


def _unknown_start(root: Path, left: CameraImages, cause: str) -> UnknownTimeError:
    """The error, with the time that the container states: a person knows whether its clock was set."""
    if left.video is not None and left.video.created_at is not None:
        stated = f"{left.video.created_at:%Y-%m-%d %H:%M:%S}"
        cause += (
            f". {left.name} states {stated} UTC as its time of creation, which may be that of its end, or in local time"
        )
    remedy = f"State the time of its first frame in {DRIVE_YAML}: 'images: {{start: 2026-03-02 10:00:00.250Z}}'"
    return UnknownTimeError("images.start", root, cause, remedy)


def needed_span(cameras: Sequence[CameraImages], settings: DriveYaml, root: Path) -> tuple[int, int] | None:
    """First and last time (UTC ns) of the trajectory, which may be of a whole day, that are needed; None if unknown."""
    left, start_ns = cameras[0], stated_start(settings, root)
    if left.video is None or start_ns is None:
        return None
    clock = settings.clock or Clock(offset_s=0.0)
    offset_s, reach_s = (0.0, clock.search_s) if clock.offset_s == "estimate" else (clock.offset_s, 0.0)
    first_ns = start_ns + round(offset_s * 1e9)
    margin_ns = round((reach_s + _MARGIN_S) * 1e9)
    return first_ns - margin_ns, first_ns + round(float(left.times_s[-1]) * 1e9) + margin_ns


def _start_ns(left: CameraImages, track: Samples, settings: DriveYaml, root: Path) -> tuple[int, float | None]:
    """Time of the first left frame, and within how many seconds of that it has to be searched; None where it is stated."""
    if (stated_ns := stated_start(settings, root)) is not None:
        return stated_ns, None
    if settings.clock is not None and settings.clock.offset_s != "estimate":
        raise InputError(f"{root / DRIVE_YAML}: clock.offset_s counts from images.start, which is missing")
    search_s = Clock().search_s if settings.clock is None else settings.clock.search_s
    first_ns, last_ns, length_ns = track.times_ns[0], track.times_ns[-1], round(float(left.times_s[-1]) * 1e9)
    created = left.video.created_at if left.video is not None else None
    if created is not None:
        created_ns = round(created.timestamp()) * 10**9
        # If the container's clock was set, it states the beginning of the recording or its end.
        for start_ns in (created_ns, created_ns - length_ns):
            if first_ns - search_s * 1e9 < start_ns < last_ns:
                return start_ns, search_s
    # The middle of both together, and all other ways in which they overlap.
    return (first_ns + last_ns - length_ns) // 2, (last_ns - first_ns + length_ns) / 2e9


def _right_offset_s(left: CameraImages, right: CameraImages, settings: Images) -> float:
    """What to add to the right file's times, as drive.yaml states it or as the images show it. Raises InputError."""
    if settings.right_offset_s is not None:
        return settings.right_offset_s
    assert left.video is not None and right.video is not None
    try:
        lag = find_video_lag(left.video, right.video)
    except ImageFileError as error:
        raise InputError(str(error)) from error
    if lag is None:
        raise UnknownTimeError(
            "images.right_offset_s",
            left.video.path.parent,
            f"the time shift between {right.name} and {left.name} cannot be estimated from the images",
            f"Put 'images: {{right_offset_s: 0}}' into {DRIVE_YAML} if both begin with the same trigger, else what to add to the "
            "right file's times",
        )
    if not lag.is_constant:
        found = "; ".join(f"{offset_s:+.2f} s at {at_s:.0f} s" for at_s, offset_s in lag.windows)
        raise InputError(
            f"{right.video.path}: its frames are shifted against {left.name} by a changing time ({found}): one of the files lost "
            "frames that its time stamps do not show. Name the true times of all frames (images.timestamps, "
            "images.right_timestamps)"
        )
    frames = lag.offset_s / lag.period_s
    if abs(frames - round(frames)) > _WHOLE:
        raise InputError(
            f"{right.video.path}: its frames were taken {frames:+.2f} frame periods from those of {left.name}: the cameras were "
            "not triggered together, and what moves cannot be located. Record with a common trigger, or state "
            "images.right_offset_s"
        )
    offset_s = round(frames) * lag.period_s
    _log.info("%s begins %.3f s after %s, by the motion that both show", right.name, offset_s, left.name)
    return offset_s


def _chosen(couples: Sequence[Couple], settings: Images, root: Path) -> list[Couple]:
    """Couples of the wanted part, while both cameras recorded; every n-th."""
    both = [n for n, (left, right) in enumerate(couples) if left is not None and right is not None]
    if not both:
        return []
    inside = couples[both[0] : both[-1] + 1]
    if alone := len(couples) - len(inside):
        _log.warning(
            "%s: %d frames at the beginning or end have none of the other camera, and are not used. If both cameras recorded "
            "all the time, a file was cut off: copy it again",
            root,
            alone,
        )
    first_ns = min((t for couple in inside if (t := time_of(couple)) is not None), default=0)
    from_ns = first_ns + round(settings.from_s * 1e9)
    to_ns = 2**63 if settings.to_s is None else first_ns + round(settings.to_s * 1e9)
    return [c for c in inside if (t := time_of(c)) is None or from_ns <= t <= to_ns][:: settings.every]


def image_clock(
    settings: Clock | None,
    track: Samples,
    times_ns: Sequence[int],
    rig: Rig,
    read: Callable[[int, Side], NDArray[np.uint8]],
    *,
    from_course: bool,
) -> ImageClock:
    """What to add to the times of the images to have those of the trajectory, and its sigma (s).

    times_ns: of the frame pairs, rising; rig: rectified; read: the rectified image of a frame pair, by its number in `times_ns`.
    Only an offset that is to be estimated reads images: 2.5 minutes of them, the following where those show nothing, 10 minutes
    at most. from_course: the trajectory has no attitudes of its own. Raises InputError where the offset cannot be
    determined.
    """
    if settings is None:
        return ImageClock(0.0, 0.0)  # the parameters' `clock_sigma_s` covers it
    if settings.offset_s != "estimate":
        return ImageClock(settings.offset_s, settings.sigma_s or _STATED_SIGMA_S)
    poses, first = track.map_SE3_body, 0
    for _ in range(_MOST_PARTS):
        motions = measure_motions(times_ns, rig, read, first)
        if not motions:
            break
        rates = rates_of(motions, dict(enumerate(times_ns)), rig)
        found = find_clock_offset(
            rates, times_ns[0], track.times_ns, poses[:, :3, 3], None if from_course else poses[:, :3, :3],
            track.sigma[:, :3], settings.search_s,
        )  # fmt: skip
        if found is not None:
            return found if from_course else refined_clock(found, motions, track, times_ns, rig)
        first = motions[-1].second_frame_index
    raise InputError(
        f"{track.name}: the offset between the clocks of images and trajectory cannot be determined within "
        f"+-{settings.search_s:g} s: the drive has too few turns and changes of speed, or images and trajectory were not "
        "recorded at the same time. State it in drive.yaml: 'clock: {offset_s: ..., sigma_s: ...}', the seconds to add to the "
        "times of the images"
    )


def refined_clock(
    found: ImageClock, motions: Sequence[RelativeMotion], track: Samples, times_ns: Sequence[int], rig: Rig
) -> ImageClock:
    """The same offset from turns about all axes and speeds along them; unchanged where they show it less well, or contradict it.

    The search over many seconds compares heading and speed, but a vehicle pitches and rolls far more quickly than it turns.

    motions: of the images, whose frame indices are numbers in `times_ns`; track: with attitudes of its own.
    """
    numbers = sorted({n for m in motions for n in (m.first_frame_index, m.second_frame_index)})
    offset_ns = round(found.offset_s * 1e9)
    pose_at = pose_reader(track, [times_ns[n] + offset_ns for n in numbers])
    pairs = []
    for n in numbers:
        with suppress(PairError):  # beyond the trajectory, or in a gap of it
            pose = pose_at(times_ns[n] + offset_ns)
            pairs.append(FramePair(frame_index=n, left_path="", right_path="", captured_at_ns=times_ns[n], pose=pose))
    params = TrajectoryParams()
    if len(pairs) < 2:
        return found
    lag = estimate_clock(pairs, read_log(pairs, rig, params), measured_motions(pairs, motions, params))
    if lag is None or lag.sigma_s >= found.sigma_s or abs(lag.offset_s) > _CONTRADICTS * found.sigma_s:
        return found
    return ImageClock(found.offset_s - lag.offset_s, max(lag.sigma_s, LEAST_SIGMA_S))
