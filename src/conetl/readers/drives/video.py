"""Stereo video, or folders of images with times of their own, and a trajectory file beside them.

    drive/left.mp4, drive/right.mp4       two files; or one with both images in each frame (`images.layout` in drive.yaml);
                                          or folders of images; or patterns of files (`camera_files`)
    drive/*.pos, *.out, *.csv ...         the trajectory: a file of `readers/trajectories`, or `pose_rows`
    drive/rig.yaml                        the rig, with body_SE3_left
    drive/drive.yaml                      which files, when they begin, and all that a file does not say itself

Frames are decoded as the pipeline goes and never unpacked to disk. Their times are the container's, from `images.start` on.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from conetl.files.documents import input_errors
from conetl.geometry import pose as se3
from conetl.geometry import rig as rigs
from conetl.geometry.geodesy import CAMERA_R_BODY
from conetl.geometry.rectification import stored_camera
from conetl.model.arrays import Floats
from conetl.model.drive import Drive
from conetl.model.errors import InputError
from conetl.model.rejections import Rejection
from conetl.model.rig import SIDES, Rig, Side
from conetl.perception.video import VIDEO_SUFFIXES, FrameRef, VideoIndex, index_video, region_of
from conetl.readers.drives import camera_files, pose_rows
from conetl.readers.drives.camera_files import Files, Stream
from conetl.readers.drives.drive_yaml import DRIVE_YAML, DriveYaml, Images, Mount, named_in_yaml, names_images
from conetl.readers.drives.formats import HeaderFacts, add_settings, no_rig, rig_on_body, with_stated_shutters
from conetl.readers.drives.image_times import CameraImages, listed, stated_start, times_of
from conetl.readers.drives.pairs import ContentHash, Source, drive_of_couples, file_digest, time_of
from conetl.readers.drives.poses import placed
from conetl.readers.drives.sparse_poses import pose_reader, with_course
from conetl.readers.drives.video_timing import Timing, needed_span, timed
from conetl.readers.rigs import RIG_YAML, read_rig_yaml
from conetl.readers.trajectories import read_trajectory, remarks_on
from conetl.readers.trajectories.recorded import of_images
from conetl.readers.trajectories.times import OFFSET

NAME, TITLE = "video", "video or images with a trajectory file"
READS_OBJECTS, UNPACKS = False, False


def matches(path: Path) -> bool:
    """True for a folder with video files, or with folders of images that drive.yaml names. (KITTI drives may hold videos.)"""
    has_videos = (
        path.is_dir() and not (path / "image_02").is_dir() and bool(camera_files.names_in(path, VIDEO_SUFFIXES))
    )
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
    content, files = ContentHash(headers_only=True), scan(root, settings)
    return _read(Source(root, root.resolve(), settings, content, settings.map_srid, None, files), rig)


def _read(source: Source, rig: Rig | None = None) -> Preview:
    """The drive. rig: instead of rig.yaml's. Raises InputError."""
    root, settings, content = source[1:4]
    files, trajectory = source.files, source.files.trajectory
    of_cameras = pose_rows.looks_like(trajectory)
    rig, sensor_R_body = _rig(source, rig, of_cameras=of_cameras)
    rig = with_stated_shutters(rig, settings.shutter)
    cameras = _cameras(files, source, rig)
    for file in sorted(trajectory.rglob("*")) if trajectory.is_dir() else [trajectory]:
        if file.is_file():
            content.add(file.relative_to(root).as_posix(), file_digest(file))
    if of_cameras:
        images = listed(cameras[0], settings.images.timestamps, source, None)
        recorded, sensor_R_body = pose_rows.read(trajectory, images, rig), np.eye(3)
    else:
        recorded = read_trajectory(trajectory, settings.trajectory, needed_span(cameras, settings, root))
    from_course = recorded.rotations is None
    srid, track = placed(with_course(recorded), source, sensor_R_body)
    timing = timed(cameras, track, rig, source, from_course=from_course)
    exposures_ns = [stamp for couple in timing.couples if (stamp := time_of(couple)) is not None]
    if exposures_ns and not any(track.times_ns[0] <= stamp <= track.times_ns[-1] for stamp in exposures_ns):
        records = of_images((min(exposures_ns), max(exposures_ns)), track.times_ns)
        raise InputError(f"{trajectory}: there are no records{records}")
    poses_at = partial(pose_reader, track, max_gap_s=settings.max_pose_gap_s, from_course=from_course)
    left, right = cameras
    names: dict[Side, str] = {"left": left.name, "right": right.name}
    drive, rejections = drive_of_couples(timing.couples, names, source, rig, srid, poses_at)
    return Preview(timing, drive.model_copy(update={"clock_sigma_s": timing.clock.sigma_s or None}), rejections)


def scan(path: Path, settings: DriveYaml) -> Files:
    """Images or videos, the trajectory and rig.yaml."""
    root = path.resolve()
    left, right = camera_streams(root, settings.images)
    videos = [path for stream in (left, right) if stream.is_video for path in stream.paths]
    logs = {file.relative_to(root).as_posix(): file for file in [*videos, _trajectory_file(root, settings)]}
    return Files(left, right, {RIG_YAML: root / RIG_YAML}, logs)


def read_header(source: Source, header: HeaderFacts) -> None:
    """Times only where drive.yaml states when the first frame was taken; the rig must be there."""
    root, settings, files = source.root, source.settings, source.files
    left, has_sigma = files.left, settings.sigmas.vertical_m is not None
    header.remarks += remarks_on(files.trajectory, settings.trajectory, has_vertical_sigma=has_sigma)
    _rig(source, of_cameras=pose_rows.looks_like(files.trajectory))
    if left.is_video:
        facts = camera_files.facts_of(left)
        header.frame_pairs = facts.frames
        if (first_ns := stated_start(settings, root)) is not None:
            header.set_times([first_ns, first_ns + round(facts.duration_s * 1e9)], root / DRIVE_YAML)
    else:
        name, zone = settings.images.timestamps, settings.timestamps_timezone
        if name is not None and name == settings.trajectory.file:
            return  # the header of a drive reads no trajectory
        stamps, texts = times_of("the left camera", left.paths, name, source)
        if any(":" in text and not OFFSET.search(text) for text in texts):
            remark = f"the times of the images state no time zone and are taken as {zone} (timestamps_timezone in {DRIVE_YAML})"
            header.remarks.append(remark)
        header.set_times(stamps, root / left.name)


def _rig(source: Source, rig: Rig | None = None, *, of_cameras: bool) -> tuple[Rig, Floats]:
    """The rectified rig on the body, and sensor_R_body (3, 3). Raises InputError.

    rig: instead of rig.yaml's. of_cameras: the poses are those of the left camera, so the body needs no mount.
    """
    settings, path = source.settings, source.root / RIG_YAML
    if rig is None:
        if not path.is_file():
            raise no_rig(source.root)
        rig = read_rig_yaml(path, pair=settings.pair)
    add_settings(source.content, source.root)
    if settings.images.crop is not None:
        with input_errors(f"{path}: images.crop"):
            rig = rigs.cropped(rig, *settings.images.crop, binning=settings.images.binning)
    no_mount = Mount(forward_m=0, left_m=0, up_m=0) if of_cameras and rigs.body_is_left_camera(rig) else None
    if (mount := settings.mount or no_mount) is not None:
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


def _cameras(files: Files, source: Source, rig: Rig) -> list[CameraImages]:
    """Left and right camera. Raises InputError."""
    settings, content = source.settings.images, source.content
    left, right = files[:2]
    if left.is_video != right.is_video:
        file, other = (left, right) if left.is_video else (right, left)
        raise InputError(
            f"{file.paths[0]}: this is a file, the images of the other camera are a folder ({other.name}); name two files or two "
            f"folders in {DRIVE_YAML}"
        )
    if not left.is_video:
        return [
            CameraImages(stream.name, [*stream.paths], np.empty(0), None, [None] * len(stream.paths))
            for stream in (left, right)
        ]
    videos: dict[Path, VideoIndex] = {}
    for path in dict.fromkeys([*left.paths, *right.paths]):
        videos[path] = index_video(path, hashed=not content.headers_only)
        content.add(path.relative_to(source.root).as_posix(), b"".join(videos[path].sha256s))
    return [
        _video_camera(stream.name, [videos[path] for path in stream.paths], settings, rig, side)
        for side, stream in zip(SIDES, (left, right), strict=True)
    ]


def _video_camera(name: str, chapters: Sequence[VideoIndex], settings: Images, rig: Rig, side: Side) -> CameraImages:
    """One camera of a video, whose chapters follow each other without a gap. Raises InputError."""
    stored, paths, hashes, times, begin_s = stored_camera(rig, side), list[Path](), list[str](), list[Floats](), 0.0
    for video in chapters:
        region = region_of(video, settings.layout, side)
        found = region[2:] if region else (video.width_px, video.height_px)
        if found != (stored.width_px, stored.height_px):
            raise InputError(
                f"{video.path}: the {side} image has {found[0]} x {found[1]} pixels, but the calibration is for "
                f"{stored.width_px} x {stored.height_px}; use the calibration of these images; if one file contains both, set "
                f"'images.layout' in {DRIVE_YAML}"
            )
        paths += [Path(str(FrameRef(video.path, pts, region))) for pts in video.pts]
        hashes += [video.sha256(number, region) for number in range(len(video.pts))]
        times.append(video.times_s() - video.times_s()[0] + begin_s)
        steps = np.diff(times[-1])
        begin_s = float(times[-1][-1] + (np.median(steps) if len(steps) else 0.0))
    return CameraImages(name, paths, np.concatenate(times), chapters[0], hashes)


def camera_streams(root: Path, settings: Images) -> tuple[Stream, Stream]:
    """Files of the left and of the right camera, the same twice where one file holds both. Raises InputError."""
    named = {"left": settings.left, "right": settings.left if settings.layout else settings.right}
    names: dict[Side, str] = {side: name for side in SIDES if (name := named[side])}
    if len(names) < len(SIDES):
        videos = [stream.name for stream in camera_files.find_streams(root) if stream.is_video]
        whole: dict[Side, str] = dict.fromkeys(SIDES, videos[0]) if settings.layout and len(videos) == 1 else names
        names = camera_files.with_likely_sides(whole, videos)
        if unknown := [side for side in SIDES if side not in names]:
            raise InputError(
                f"{root}: the {unknown[0]} camera's images cannot be identified (videos: {', '.join(videos) or 'none'}). Name "
                f"them in {DRIVE_YAML}: 'images: {{left: left.mp4, right: right.mp4}}', or 'images: {{left: both.mp4, layout: "
                "left-right}' for one file with both"
            )
    left, right = (camera_files.stream_of(root, names[side], DRIVE_YAML) for side in SIDES)
    return left, right


def _trajectory_file(root: Path, settings: DriveYaml) -> Path:
    """The trajectory. Raises InputError where drive.yaml names none and there is not just one."""
    if settings.trajectory.file is not None:
        return named_in_yaml(root, settings.trajectory.file, "the trajectory is", folder=True)
    found = pose_rows.find_logs(root)
    if len(found) != 1:
        names = ", ".join(path.name for path in found) or "none"
        raise InputError(
            f"{root}: which file is the trajectory? Found: {names}. Name it in {DRIVE_YAML}: 'trajectory: {{file: rover.pos}}'"
        )
    return found[0]
