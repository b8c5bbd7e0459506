"""Stereo video, or folders of images with times of their own, and a trajectory file beside them.

    drive/left.mp4, drive/right.mp4       two files; or one with both images in each frame (`images.layout` in drive.yaml);
                                          or folders of images
    drive/*.pos, *.out, *.csv ...         the trajectory, any file of `readers/trajectories`
    drive/rig.yaml                        the rig, with body_SE3_left
    drive/drive.yaml                      which files, when they begin, and all that a file does not say itself

Frames are decoded as the pipeline goes and never unpacked to disk. Their times are the container's, from `images.start` on.
"""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from conetl.geometry import pose as se3
from conetl.geometry import rig as rigs
from conetl.geometry.geodesy import CAMERA_R_BODY
from conetl.geometry.rectification import stored_camera
from conetl.model.errors import CalibrationError, DriveFolderError, InputError
from conetl.model.records import Drive, Rig, Side
from conetl.model.rejections import Rejection
from conetl.perception.rectified_image import read_rig_image
from conetl.perception.video import (
    VIDEO_SUFFIXES,
    Frame,
    Region,
    VideoIndex,
    frame_of,
    index_video,
    region_of,
    video_facts,
)
from conetl.perception.video_sync import find_video_lag
from conetl.readers.drives.drive_yaml import DRIVE_YAML, Clock, DriveYaml, Images, Mount, inside, read_drive_yaml
from conetl.readers.drives.formats import HeaderFacts, ReadOptions, add_settings, image_files, names_in, rig_on_body
from conetl.readers.drives.image_clock import image_clock
from conetl.readers.drives.pairs import (
    ContentHash,
    Couple,
    Image,
    ImageFile,
    check_images,
    drive_of_couples,
    pair_by_stamp,
)
from conetl.readers.drives.poses import Samples, placed
from conetl.readers.drives.sparse_poses import pose_reader, with_course
from conetl.readers.rigs import RIG_YAML, read_rig_yaml
from conetl.readers.trajectories import find_trajectories, read_trajectory
from conetl.readers.trajectories.times import parse_timestamp
from conetl.tracking.clock_search import ImageClock

Floats = NDArray[np.float64]
NAME = "video"
READS_OBJECTS = False
#: Cameras whose shift is farther than this from a whole number of frames were not triggered together.
_WHOLE = 0.25
#: Seconds of the trajectory before and after the images that help to smooth it.
_MARGIN_S = 20.0
_log = logging.getLogger(__name__)


class _Camera(NamedTuple):
    """The images of one camera and their times from the first one on."""

    name: str
    """Of the file or folder, for messages."""
    paths: list[Path]
    times_s: Floats
    video: VideoIndex | None
    region: Region | None


class Timing(NamedTuple):
    """What ties the images to the clock of the trajectory."""

    couples: list[Couple]
    """With times by the trajectory's clock."""
    start_ns: int | None
    """UTC of the first left frame by that clock; None where every image has a time of its own."""
    right_offset_s: float
    """What to add to the right file's times to have those of the left one."""
    clock: ImageClock
    """What was added to the times as stated, and its sigma."""


def matches(path: Path) -> bool:
    """True for a folder with video files, or with folders of images that drive.yaml names. (KITTI drives may hold videos.)"""
    has_videos = path.is_dir() and not (path / "image_02").is_dir() and bool(names_in(path, VIDEO_SUFFIXES))
    return has_videos or _names_images(path)


def _names_images(path: Path) -> bool:
    """Whether drive.yaml names images; a broken one is read again by the format, which says what is wrong."""
    try:
        return (path / DRIVE_YAML).is_file() and read_drive_yaml(path).images.left is not None
    except DriveFolderError:
        return False


def read(path: Path, options: ReadOptions) -> tuple[Drive, list[Rejection]]:
    """The drive and its rejections."""
    root = path.resolve()
    settings = read_drive_yaml(root)
    content = ContentHash(headers_only=options.headers_only)
    rig, sensor_R_body = _rig(root, settings, content)
    cameras = _cameras(root, settings.images, rig, content)
    trajectory = _trajectory_file(root, settings)
    _add_files(trajectory, root, content)
    recorded = read_trajectory(trajectory, settings.trajectory, _needed(cameras, settings, root))
    from_course = recorded.rotations is None
    srid, track = placed(with_course(recorded), settings, options.map_srid, root, sensor_R_body)
    timed = _timed(cameras, track, rig, settings, root, content, from_course=from_course)

    def images_of(left: Image, right: Image) -> tuple[ImageFile, ImageFile]:
        if frame_of(left.path) is None:
            return check_images([left.path], [right.path], rig, content, root)
        ours, theirs = (ImageFile(image.path, hashes.get(image.path, "")) for image in (left, right))
        return ours, theirs

    hashes = {path: sha256 for camera in cameras for path, sha256 in _hashes(camera)}
    exposures_ns = [stamp for couple in timed.couples if (stamp := _time_ns(couple)) is not None]
    pose_at = pose_reader(track, exposures_ns, settings.max_pose_gap_s, from_course=from_course)
    drive, rejections = drive_of_couples(
        timed.couples, {"left": cameras[0].name, "right": cameras[1].name}, source=root, settings=settings, rig=rig, srid=srid,
        content=content, images_of=images_of, pose_at=pose_at,
    )  # fmt: skip
    return drive.model_copy(update={"clock_sigma_s": timed.clock.sigma_s or None}), rejections


def read_timing(root: Path) -> Timing:
    """When the first left frame was taken, as drive.yaml states it or as the images show it. Raises as `read`."""
    settings, content = read_drive_yaml(root), ContentHash(headers_only=True)
    rig, sensor_R_body = _rig(root, settings, content)
    cameras = _cameras(root, settings.images, rig, content)
    recorded = read_trajectory(_trajectory_file(root, settings), settings.trajectory, _needed(cameras, settings, root))
    _, track = placed(with_course(recorded), settings, None, root, sensor_R_body)
    return _timed(cameras, track, rig, settings, root, content, from_course=recorded.rotations is None)


def read_header(path: Path, settings: DriveYaml, header: HeaderFacts) -> None:
    """Sizes and pieces of the files; times only where drive.yaml states when the first frame was taken."""
    root = path.resolve()
    sources = _sources(root, settings.images)
    header.streams = [source.name for source in sources]
    for source in sources:
        if source.is_dir():
            header.add_images(root, {source.relative_to(root).as_posix(): source})
        else:
            header.add_samples(root, source.relative_to(root).as_posix())
    header.add_samples(root, _trajectory_file(root, settings).relative_to(root).as_posix())
    header.add_file(root, RIG_YAML)
    _rig(root, settings, ContentHash())
    if not sources[0].is_dir():
        facts = video_facts(sources[0])
        header.frame_pairs = facts.frames
        if settings.images.start is not None:
            first_ns = _parsed(settings.images.start, settings, root / DRIVE_YAML)
            header.set_times([first_ns, first_ns + round(facts.duration_s * 1e9)], root / DRIVE_YAML)


def _rig(root: Path, settings: DriveYaml, content: ContentHash) -> tuple[Rig, Floats]:
    """The rectified rig on the body, and sensor_R_body (3, 3). Raises CalibrationError."""
    path = root / RIG_YAML
    if not path.is_file():
        raise CalibrationError(
            f"{root}: {RIG_YAML} is missing: 'conetl calibrate' makes it from images of a board, 'conetl rig convert' from the "
            "calibration of another program"
        )
    add_settings(content, root)
    rig = read_rig_yaml(path)
    if settings.mount is not None:
        return rig_on_body(rig, _body_SE3_left(settings.mount), settings, path)
    if rigs.body_is_left_camera(rig):
        raise CalibrationError(
            f"{path}: where the cameras are on the vehicle is unknown. Put into {DRIVE_YAML}, as seen from the IMU or antenna "
            "whose trajectory was recorded: 'mount: {forward_m: 1.2, left_m: 0.3, up_m: -0.2, pitch_deg: 3}'"
        )
    return rig_on_body(rig, rigs.body_SE3_camera(rig, "left"), settings, path)


def _body_SE3_left(mount: Mount) -> Floats:
    """(4, 4) of a mount; the camera's own axes are right, down, forward."""
    turn = se3.rotation_from_rpy(*np.radians([mount.roll_deg, mount.pitch_deg, mount.yaw_deg]))
    return se3.se3(turn @ CAMERA_R_BODY.T, [mount.forward_m, mount.left_m, mount.up_m])


def _cameras(root: Path, settings: Images, rig: Rig, content: ContentHash) -> list[_Camera]:
    """Left and right camera. Raises DriveFolderError or CalibrationError."""
    sources = _sources(root, settings)
    sides: tuple[Side, Side] = ("left", "right")
    if any(source.is_dir() for source in sources):
        return [_folder_camera(root, source) for source in sources]
    videos = {source: _indexed(source, root, content) for source in dict.fromkeys(sources)}
    cameras = []
    for side, source in zip(sides, sources, strict=True):
        video, stored = videos[source], stored_camera(rig, side)
        region = region_of(video, settings.layout, side)
        found = region[2:] if region else (video.width_px, video.height_px)
        if found != (stored.width_px, stored.height_px):
            raise CalibrationError(
                f"{source}: the {side} image has {found[0]} x {found[1]} pixels, but the calibration is for {stored.width_px} x "
                f"{stored.height_px}; use the calibration of these images; where one file holds both, name "
                f"'images.layout' in {DRIVE_YAML}"
            )
        paths = [Path(str(Frame(source, pts, region))) for pts in video.pts]
        cameras.append(_Camera(source.name, paths, video.times_s() - video.times_s()[0], video, region))
    return cameras


def _sources(root: Path, settings: Images) -> list[Path]:
    """File or folder of the left and of the right camera, one file twice where it holds both. Raises DriveFolderError."""
    videos = [root / name for name in names_in(root, VIDEO_SUFFIXES)]
    found: dict[str, Path | None] = {}
    for side in ("left", "right"):
        named = settings.left if side == "left" or settings.layout else settings.right
        if named is not None:
            found[side] = inside(root, named, DRIVE_YAML)
        elif settings.layout is not None and len(videos) == 1:
            found[side] = videos[0]
        else:
            candidates = [video for video in videos if side in video.stem.lower()]
            found[side] = candidates[0] if len(candidates) == 1 else None
    missing = [side for side, source in found.items() if source is None or not source.exists()]
    if missing:
        raise DriveFolderError(
            f"{root}: the {missing[0]} camera's images are not clear (videos: {', '.join(v.name for v in videos) or 'none'}). "
            f"Name them in {DRIVE_YAML}: 'images: {{left: left.mp4, right: right.mp4}}', or 'images: {{left: both.mp4, layout: "
            "left-right}' for one file with both"
        )
    return [source for source in found.values() if source is not None]


def _indexed(source: Path, root: Path, content: ContentHash) -> VideoIndex:
    """The index of a video, whose packets become part of the drive's hash. Raises DriveFolderError."""
    try:
        video = index_video(source, hashed=not content.headers_only)
    except InputError as error:
        raise DriveFolderError(str(error)) from error
    content.add(source.relative_to(root).as_posix(), b"".join(video.sha256s))
    return video


def _folder_camera(root: Path, source: Path) -> _Camera:
    paths = image_files(source)
    if not paths:
        raise DriveFolderError(f"{source}: there are no images (*.jpg, *.png)")
    return _Camera(source.relative_to(root).as_posix(), paths, np.empty(0), None, None)


def _hashes(camera: _Camera) -> list[tuple[Path, str]]:
    video = camera.video
    return [] if video is None else [(p, video.sha256(n, camera.region)) for n, p in enumerate(camera.paths)]


# --------------------------------------------------------------------------- times


def _timed(
    cameras: Sequence[_Camera],
    track: Samples,
    rig: Rig,
    settings: DriveYaml,
    root: Path,
    content: ContentHash,
    *,
    from_course: bool,
) -> Timing:
    """The couples of images with their times. Raises DriveFolderError."""
    images, (left, right), start_ns, shift_s, clock = settings.images, cameras, None, 0.0, settings.clock
    if images.timestamps is not None or left.video is None:
        names = (images.timestamps, images.right_timestamps or images.timestamps)
        ours, theirs = (
            _listed(camera, name, settings, root, content) for camera, name in zip(cameras, names, strict=True)
        )
    else:
        start_ns, search_s = _start_ns(left, track, settings, root)
        if search_s is not None:
            clock = Clock(search_s=search_s)
        if left.video is not right.video:
            shift_s = _right_offset_s(left, right, images)
        ours, theirs = _at(left, start_ns), _at(right, start_ns + round(shift_s * 1e9))
    couples = _chosen(pair_by_stamp(ours, theirs, settings.pair_tolerance_ns), images)
    if not couples:
        raise DriveFolderError(
            f"{root}: no left image has a right one within {settings.pair_tolerance_ms:g} ms (pair_tolerance_ms in {DRIVE_YAML})"
        )
    pairs = [
        (t, {"left": a.path, "right": b.path}) for a, b in couples if a and b and (t := _time_ns((a, b))) is not None
    ]

    def read_image(number: int, side: Side) -> NDArray[np.uint8]:
        return read_rig_image(pairs[number][1][side], rig, side)

    found = image_clock(clock, track, [t for t, _ in pairs], rig, read_image, from_course=from_course)
    offset_ns = round(found.offset_s * 1e9)
    moved = [(_later(a, offset_ns), _later(b, offset_ns)) for a, b in couples]
    return Timing(moved, None if start_ns is None else start_ns + offset_ns, shift_s, found)


def _later(image: Image | None, offset_ns: int) -> Image | None:
    if image is None or not isinstance(image.stamp, int):
        return image
    return image._replace(stamp=image.stamp + offset_ns)


def _at(camera: _Camera, start_ns: int) -> list[Image]:
    return [
        Image(start_ns + round(time_s * 1e9), path)
        for time_s, path in zip(camera.times_s.tolist(), camera.paths, strict=True)
    ]


def _listed(camera: _Camera, name: str | None, settings: DriveYaml, root: Path, content: ContentHash) -> list[Image]:
    """Images with the times of a file, one line per image, or else with those that their names are. Raises DriveFolderError."""
    if name is None:
        return [Image(_stamp(path.stem, settings), path) for path in camera.paths]
    file = inside(root, name, DRIVE_YAML)
    try:
        data = file.read_bytes()
    except OSError as error:
        raise DriveFolderError(f"{file}: the time stamps cannot be read: {error.strerror}") from error
    content.add(name, data)
    lines = [
        line for line in data.decode("utf-8-sig", errors="replace").splitlines() if line.strip() and line[0] != "#"
    ]
    if len(lines) != len(camera.paths):
        raise DriveFolderError(f"{file}: {len(lines)} time stamps for the {len(camera.paths)} images of {camera.name}")
    return [Image(_stamp(line, settings), path) for line, path in zip(lines, camera.paths, strict=True)]


def _stamp(text: str, settings: DriveYaml) -> int | str:
    """UTC nanoseconds of a time stamp, or of a number of nanoseconds or seconds since 1970; what is wrong with another text."""
    word = text.strip()
    try:
        if word.replace(".", "", 1).isdigit() and word.isascii() and len(word) < 31:
            whole, _, fraction = word.partition(".")
            return int(whole) if len(whole) > 15 else int(whole) * 10**9 + int(fraction[:9].ljust(9, "0"))
        return parse_timestamp(word, settings.timestamps_timezone)
    except ValueError as error:
        return str(error)


def _parsed(text: str, settings: DriveYaml, path: Path) -> int:
    stamp = _stamp(text, settings)
    if isinstance(stamp, str):
        raise DriveFolderError(f"{path}: images.start: {stamp}")
    return stamp


def _needed(cameras: Sequence[_Camera], settings: DriveYaml, root: Path) -> tuple[int, int] | None:
    """First and last time (UTC ns) that are needed of a trajectory, which may be of a whole day; None where that is unknown."""
    left = cameras[0]
    if left.video is None or settings.images.start is None:
        return None
    clock = settings.clock or Clock(offset_s=0.0)
    offset_s, reach_s = (0.0, clock.search_s) if clock.offset_s == "estimate" else (clock.offset_s, 0.0)
    first_ns = _parsed(settings.images.start, settings, root / DRIVE_YAML) + round(offset_s * 1e9)
    margin_ns = round((reach_s + _MARGIN_S) * 1e9)
    return first_ns - margin_ns, first_ns + round(float(left.times_s[-1]) * 1e9) + margin_ns


def _start_ns(left: _Camera, track: Samples, settings: DriveYaml, root: Path) -> tuple[int, float | None]:
    """Time of the first left frame, and within how many seconds of that it has to be searched; None where it is stated."""
    if settings.images.start is not None:
        return _parsed(settings.images.start, settings, root / DRIVE_YAML), None
    if settings.clock is not None and settings.clock.offset_s != "estimate":
        raise DriveFolderError(f"{root / DRIVE_YAML}: clock.offset_s counts from images.start, which is missing")
    search_s = Clock().search_s if settings.clock is None else settings.clock.search_s
    first_ns, last_ns, length_ns = track.times_ns[0], track.times_ns[-1], round(float(left.times_s[-1]) * 1e9)
    created = left.video.created_at if left.video is not None else None
    if created is not None:
        created_ns = round(created.timestamp()) * 10**9
        # The container's clock may be set, and tell the beginning of the recording or its end.
        for start_ns in (created_ns, created_ns - length_ns):
            if first_ns - search_s * 1e9 < start_ns < last_ns:
                return start_ns, search_s
    # The middle of both together, and all other ways in which they overlap.
    return (first_ns + last_ns - length_ns) // 2, (last_ns - first_ns + length_ns) / 2e9


def _right_offset_s(left: _Camera, right: _Camera, settings: Images) -> float:
    """What to add to the right file's times, as drive.yaml states it or as the images show it. Raises DriveFolderError."""
    if settings.right_offset_s is not None:
        return settings.right_offset_s
    assert left.video is not None and right.video is not None
    lag = find_video_lag(left.video, right.video)
    if lag is None:
        raise DriveFolderError(
            f"{left.video.path.parent}: the images do not show how {right.name} and {left.name} are shifted in time. Put "
            f"'images: {{right_offset_s: 0}}' into {DRIVE_YAML} if both begin with the same trigger, else what to add to the "
            "right file's times"
        )
    if not lag.is_constant:
        found = "; ".join(f"{offset_s:+.2f} s at {at_s:.0f} s" for at_s, offset_s in lag.windows)
        raise DriveFolderError(
            f"{right.video.path}: its frames are shifted against {left.name} by a changing time ({found}): one of the files lost "
            "frames that its time stamps do not tell. Name the true times of all frames (images.timestamps, "
            "images.right_timestamps)"
        )
    frames = lag.offset_s / lag.period_s
    if abs(frames - round(frames)) > _WHOLE:
        raise DriveFolderError(
            f"{right.video.path}: its frames were taken {frames:+.2f} frame periods from those of {left.name}: the cameras were "
            "not triggered together, and what moves cannot be located. Record with a common trigger, or state "
            "images.right_offset_s"
        )
    offset_s = round(frames) * lag.period_s
    _log.info("%s begins %.3f s after %s, by the motion that both show", right.name, offset_s, left.name)
    return offset_s


def _chosen(couples: Sequence[Couple], settings: Images) -> list[Couple]:
    """Couples of the wanted part, while both cameras recorded; every n-th."""
    both = [n for n, (left, right) in enumerate(couples) if left is not None and right is not None]
    if not both:
        return []
    inside = couples[both[0] : both[-1] + 1]
    first_ns = min((t for couple in inside if (t := _time_ns(couple)) is not None), default=0)
    from_ns = first_ns + round(settings.from_s * 1e9)
    to_ns = 2**63 if settings.to_s is None else first_ns + round(settings.to_s * 1e9)
    return [c for c in inside if (t := _time_ns(c)) is None or from_ns <= t <= to_ns][:: settings.every]


def _time_ns(couple: Couple) -> int | None:
    stamp = next(image.stamp for image in couple if image is not None)
    return stamp if isinstance(stamp, int) else None


def _add_files(path: Path, root: Path, content: ContentHash) -> None:
    """Add a trajectory, which may be large or a folder, to the drive's hash."""
    for file in sorted(path.rglob("*")) if path.is_dir() else [path]:
        if file.is_file():
            with file.open("rb") as opened:
                content.add(file.relative_to(root).as_posix(), hashlib.file_digest(opened, "sha256").digest())


def _trajectory_file(root: Path, settings: DriveYaml) -> Path:
    """The trajectory. Raises DriveFolderError where drive.yaml names none and there is not just one."""
    named = settings.trajectory.file
    if named is not None:
        path = inside(root, named, DRIVE_YAML)
        if not path.exists():
            raise DriveFolderError(f"{path}: the trajectory is missing")
        return path
    found = find_trajectories(root)
    if len(found) != 1:
        names = ", ".join(path.name for path in found) or "none"
        raise DriveFolderError(
            f"{root}: which file is the trajectory? Found: {names}. Name it in {DRIVE_YAML}: 'trajectory: {{file: rover.pos}}'"
        )
    return found[0]
