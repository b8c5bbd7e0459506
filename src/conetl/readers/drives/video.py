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
from pathlib import Path
from typing import NamedTuple

import numpy as np

from conetl.geometry import pose as se3
from conetl.geometry import rig as rigs
from conetl.geometry.geodesy import CAMERA_R_BODY
from conetl.geometry.rectification import stored_camera
from conetl.model.arrays import Floats
from conetl.model.drive import Drive
from conetl.model.errors import InputError
from conetl.model.rejections import Rejection
from conetl.model.rig import SIDES, Rig
from conetl.perception.video import VIDEO_SUFFIXES, FrameRef, VideoIndex, index_video, region_of, video_facts
from conetl.readers.drives.drive_yaml import DRIVE_YAML, DriveYaml, Images, inside, names_images
from conetl.readers.drives.formats import (
    HeaderFacts,
    add_settings,
    image_files,
    names_in,
    no_rig,
    rig_on_body,
    with_stated_shutters,
)
from conetl.readers.drives.pairs import ContentHash, Source, drive_of_couples, time_of
from conetl.readers.drives.poses import placed
from conetl.readers.drives.sparse_poses import pose_reader, with_course
from conetl.readers.drives.video_timing import CameraImages, Timing, needed_span, stamps_of_images, stated_start, timed
from conetl.readers.rigs import RIG_YAML, read_rig_yaml
from conetl.readers.trajectories import find_trajectories, read_trajectory, remarks_on
from conetl.readers.trajectories.recorded import of_images

NAME, TITLE = "video", "video or images with a trajectory file"
READS_OBJECTS, UNPACKS = False, False


def matches(path: Path) -> bool:
    """True for a folder with video files, or with folders of images that drive.yaml names. (KITTI drives may hold videos.)"""
    has_videos = path.is_dir() and not (path / "image_02").is_dir() and bool(names_in(path, VIDEO_SUFFIXES))
    return has_videos or names_images(path)


class Preview(NamedTuple):
    """What a drive is, or will be, and when its images were taken."""

    timing: Timing
    drive: Drive
    rejections: list[Rejection]


def read(source: Source) -> tuple[Drive, list[Rejection]]:
    """The drive and its rejections."""
    _, drive, rejections = _read(source)
    return drive, rejections


def preview(root: Path, settings: DriveYaml, rig: Rig | None = None) -> Preview:
    """The drive of a folder with settings that are not in its drive.yaml yet, without the content of its images.

    rig: likewise; None where rig.yaml has it. Raises as `read`.
    """
    return _read(Source(root, root.resolve(), settings, ContentHash(headers_only=True), settings.map_srid), rig)


def _read(source: Source, rig: Rig | None = None) -> Preview:
    """The drive. rig: instead of rig.yaml's. Raises InputError."""
    root, settings, content = source[1:4]
    rig, sensor_R_body = _rig(root, settings, content, rig)
    rig = with_stated_shutters(rig, settings.shutter)
    cameras = _cameras(root, settings.images, rig, content)
    trajectory = _trajectory_file(root, settings)
    _add_files(trajectory, root, content)
    recorded = read_trajectory(trajectory, settings.trajectory, needed_span(cameras, settings, root))
    from_course = recorded.rotations is None
    srid, track = placed(with_course(recorded), source, sensor_R_body)
    timing = timed(cameras, track, rig, source, from_course=from_course)
    exposures_ns = [stamp for couple in timing.couples if (stamp := time_of(couple)) is not None]
    if exposures_ns and not any(track.times_ns[0] <= stamp <= track.times_ns[-1] for stamp in exposures_ns):
        records = of_images((min(exposures_ns), max(exposures_ns)), track.times_ns)
        raise InputError(f"{trajectory}: there are no records{records}")
    hashes = {p: c.video.sha256(n, c.region) for c in cameras if c.video is not None for n, p in enumerate(c.paths)}
    pose_at = pose_reader(track, exposures_ns, settings.max_pose_gap_s, from_course=from_course)
    left, right = cameras
    drive, rejections = drive_of_couples(
        timing.couples, {"left": left.name, "right": right.name}, source, rig, srid, pose_at, hashes.get
    )
    return Preview(timing, drive.model_copy(update={"clock_sigma_s": timing.clock.sigma_s or None}), rejections)


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
    trajectory = _trajectory_file(root, settings)
    header.add_samples(root, trajectory.relative_to(root).as_posix())
    has_sigma = settings.sigmas.vertical_m is not None
    header.remarks += remarks_on(trajectory, settings.trajectory, has_vertical_sigma=has_sigma)
    header.add_file(root, RIG_YAML)
    _rig(root, settings, ContentHash())
    if not sources[0].is_dir():
        facts = video_facts(sources[0])
        header.frame_pairs = facts.frames
        if (first_ns := stated_start(settings, root)) is not None:
            header.set_times([first_ns, first_ns + round(facts.duration_s * 1e9)], root / DRIVE_YAML)
    else:
        stamps, assumed = stamps_of_images(sources[0], root, settings)
        header.remarks += assumed
        if stamps:
            header.set_times(stamps, sources[0])


def _rig(root: Path, settings: DriveYaml, content: ContentHash, rig: Rig | None = None) -> tuple[Rig, Floats]:
    """The rectified rig on the body, and sensor_R_body (3, 3). rig: instead of rig.yaml's. Raises InputError."""
    path = root / RIG_YAML
    if rig is None:
        if not path.is_file():
            raise no_rig(root)
        rig = read_rig_yaml(path, pair=settings.pair)
    add_settings(content, root)
    if settings.mount is not None:
        mount = settings.mount
        turn = se3.rotation_from_rpy(*np.radians([mount.roll_deg, mount.pitch_deg, mount.yaw_deg]))
        # The camera's own axes are right, down, forward.
        body_SE3_left = se3.se3(turn @ CAMERA_R_BODY.T, [mount.forward_m, mount.left_m, mount.up_m])
        return rig_on_body(rig, body_SE3_left, settings, path)
    if rigs.body_is_left_camera(rig):
        raise InputError(
            f"{path}: the mount of the cameras is unknown. Put into {DRIVE_YAML}, as seen from the IMU or antenna "
            "whose trajectory was recorded: 'mount: {forward_m: 1.2, left_m: 0.3, up_m: -0.2, pitch_deg: 3}'"
        )
    return rig_on_body(rig, rigs.body_SE3_camera(rig, "left"), settings, path)


def _cameras(root: Path, settings: Images, rig: Rig, content: ContentHash) -> list[CameraImages]:
    """Left and right camera. Raises InputError."""
    sources = _sources(root, settings)
    if any(source.is_dir() for source in sources):
        if files := [source for source in sources if not source.is_dir()]:
            raise InputError(
                f"{files[0]}: this is a file, the images of the other camera are a folder; name two files or two folders in "
                f"{DRIVE_YAML}"
            )
        return [_folder_camera(root, source) for source in sources]
    videos: dict[Path, VideoIndex] = {}
    for source in dict.fromkeys(sources):
        videos[source] = index_video(source, hashed=not content.headers_only)
        content.add(source.relative_to(root).as_posix(), b"".join(videos[source].sha256s))
    cameras = []
    for side, source in zip(SIDES, sources, strict=True):
        video, stored = videos[source], stored_camera(rig, side)
        region = region_of(video, settings.layout, side)
        found = region[2:] if region else (video.width_px, video.height_px)
        if found != (stored.width_px, stored.height_px):
            raise InputError(
                f"{source}: the {side} image has {found[0]} x {found[1]} pixels, but the calibration is for {stored.width_px} x "
                f"{stored.height_px}; use the calibration of these images; if one file contains both, set "
                f"'images.layout' in {DRIVE_YAML}"
            )
        paths = [Path(str(FrameRef(source, pts, region))) for pts in video.pts]
        cameras.append(CameraImages(source.name, paths, video.times_s() - video.times_s()[0], video, region))
    return cameras


def _sources(root: Path, settings: Images) -> list[Path]:
    """File or folder of the left and of the right camera, one file twice where it holds both. Raises InputError."""
    videos = [root / name for name in names_in(root, VIDEO_SUFFIXES)]
    whole = settings.layout is not None and len(videos) == 1
    found: list[Path] = []
    for side in SIDES:
        named = settings.left if side == "left" or settings.layout else settings.right
        candidates = [video for video in videos if whole or side in video.stem.lower()]
        source = None
        if named is not None:
            source = inside(root, named, DRIVE_YAML)
        elif len(candidates) == 1:
            source = inside(root, candidates[0].name, str(root))
        if source is None or not (source.is_dir() or source.is_file()):
            raise InputError(
                f"{root}: the {side} camera's images cannot be identified (videos: {', '.join(v.name for v in videos) or 'none'}"
                f"). Name them in {DRIVE_YAML}: 'images: {{left: left.mp4, right: right.mp4}}', or 'images: {{left: both.mp4, "
                "layout: left-right}' for one file with both"
            )
        found.append(source)
    return found


def _folder_camera(root: Path, source: Path) -> CameraImages:
    paths = image_files(source)
    if not paths:
        raise InputError(f"{source}: there are no images (*.jpg, *.png)")
    return CameraImages(source.relative_to(root).as_posix(), paths, np.empty(0), None, None)


def _add_files(path: Path, root: Path, content: ContentHash) -> None:
    """Add a trajectory, which may be large or a folder, to the drive's hash."""
    for file in sorted(path.rglob("*")) if path.is_dir() else [path]:
        if file.is_file():
            with file.open("rb") as opened:
                content.add(file.relative_to(root).as_posix(), hashlib.file_digest(opened, "sha256").digest())


def _trajectory_file(root: Path, settings: DriveYaml) -> Path:
    """The trajectory. Raises InputError where drive.yaml names none and there is not just one."""
    named = settings.trajectory.file
    if named is not None:
        path = inside(root, named, DRIVE_YAML)
        if not (path.is_file() or path.is_dir()):
            raise InputError(f"{path}: the trajectory is missing")
        return path
    found = find_trajectories(root)
    if len(found) != 1:
        names = ", ".join(path.name for path in found) or "none"
        raise InputError(
            f"{root}: which file is the trajectory? Found: {names}. Name it in {DRIVE_YAML}: 'trajectory: {{file: rover.pos}}'"
        )
    return found[0]
