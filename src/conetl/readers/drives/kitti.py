"""Drive folders in the KITTI raw layout (Geiger et al., IJRR 2013).

Images may be "synced and rectified" or "synced only"; their size decides. The latter are rectified when they are read.

    drive/image_02/data/0000000000.{png,jpg}   left images        drive/image_02/timestamps.txt
    drive/image_03/data/0000000000.{png,jpg}   right images       drive/image_03/timestamps.txt, optional
    drive/oxts/data/0000000000.txt             GNSS/INS           drive/oxts/timestamps.txt
    calib_cam_to_cam.txt, calib_velo_to_cam.txt, calib_imu_to_velo.txt in the drive folder or its parent
    drive/drive.yaml                           optional, see drive_yaml.py

The number in a file's name links images, poses and time stamps (line n, from 0, is frame n). A pair with anything missing or
broken costs one rejection; without a calibration, a trajectory or one usable pair there is no drive.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping
from contextlib import suppress
from functools import partial
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import numpy as np

from conetl.files.documents import input_errors, read_bytes
from conetl.files.storage import NOT_A_FILE, fetch, is_present, is_remote, object_bytes
from conetl.geometry import geodesy
from conetl.geometry import pose as se3
from conetl.model.arrays import Floats
from conetl.model.drive import MAX_FRAME_INDEX, Drive, Pose
from conetl.model.errors import InputError
from conetl.model.rejections import Rejection, RejectionReason
from conetl.model.rig import Rig
from conetl.readers.drives import pairs
from conetl.readers.drives.camera_files import Files, Stream, folder_stream, names_in
from conetl.readers.drives.drive_yaml import DRIVE_YAML, DriveYaml, Sigmas, inside, named_in_yaml
from conetl.readers.drives.formats import HeaderFacts, add_settings, samples_of
from conetl.readers.drives.pairs import ImageFile, PairError, Source
from conetl.readers.drives.poses import checked_srid, stated_sigmas, wild_fixes
from conetl.readers.rigs import CAM_TO_CAM, IMU_TO_VELO, VELO_TO_CAM, read_kitti_rig
from conetl.readers.trajectories.oxts import MAX_RECORD_BYTES, OxtsRecord, parse_oxts
from conetl.readers.trajectories.times import Stamps, clock_problem, misplaced, parse_timestamps

NAME, TITLE = "kitti", "KITTI raw layout"
READS_OBJECTS, UNPACKS = True, False
MAX_CLOCK_DIFFERENCE_NS = 500_000_000
"""Image and OXTS record of one number that are farther apart in time do not belong together."""
MAX_GAP_NS = 500_000_000
"""Poses farther apart in time than this are not interpolated."""
OXTS_STAMPS = "oxts/timestamps.txt"


class OxtsTrajectory(NamedTuple):
    """Poses of the IMU by frame number, and their times where they are known."""

    rows: dict[int, int]
    """Row of the arrays by frame number, both rising; of the valid records."""
    map_SE3_body: Floats
    """(N, 4, 4)"""
    sigma: Floats
    """(N, 6): easting, northing, height (m), roll, pitch, yaw (rad)."""
    times_ns: list[int | None]
    """By row; None where the time is unknown."""


def matches(path: Path) -> bool:
    """True where a folder looks like a KITTI drive, complete or not."""
    return any((path / name).is_dir() for name in ("image_02", "image_03", "oxts")) or (path / DRIVE_YAML).is_file()


def read(source: Source) -> tuple[Drive, list[Rejection]]:
    """The drive and its rejections. Images are checked by header and end marker, not decoded.

    The map's CRS: that of the options, else of drive.yaml, else the UTM zone of the first pose.
    """
    path, root, settings, content = source[:4]
    calibration = calibration_path(path, settings)
    rejections: list[Rejection] = []
    left, right = (_numbered_images(stream, rejections) for stream in source.files[:2])
    rig = read_rig_for(
        source, calibration, pairs.first_size((files[0].path for _, files in sorted(left.items())), content)
    )
    name = f"{settings.cameras.left}/timestamps.txt"
    records = _record_files(source)
    stamps = _stamps(source, name, left.keys() | right.keys() | records.keys())
    split = _split_triggers(source, stamps)
    oxts_stamps = _stamps(source, OXTS_STAMPS, records) if (root / OXTS_STAMPS).is_file() else {}
    srid, track, bad_records = _trajectory(source, records, oxts_stamps)
    # A frame with a time stamp and a pose, but without images, is lost too: copied in part, or to another folder.
    numbers = sorted(left.keys() | right.keys() | stamps.keys() & (track.rows.keys() | bad_records.keys()))
    times = {n: time for n in numbers if isinstance(time := stamps.get(n), int) and n not in split}
    wrong = {n: text for n, text in stamps.items() if isinstance(text, str)}
    wrong |= {n: f"the time {text}" for n, text in misplaced(times).items()}
    wrong = {n: f"{name}, line {n + 1}: {text}" for n, text in wrong.items()} | split

    def frame(n: int) -> pairs.RecordedPair:
        problem = PairError(RejectionReason.TIMESTAMP_INVALID, wrong.get(n, ""))
        if n not in stamps:
            problem = PairError(RejectionReason.TIMESTAMP_MISSING, f"{name} has no line {n + 1} for this frame")
        captured = problem if n in wrong or n not in stamps else times[n]
        return pairs.RecordedPair(
            n, str(n), left.get(n, ()), right.get(n, ()), captured, partial(_pose_at, n, bad_records, track, root)
        )

    return pairs.drive_of_pairs([*map(frame, numbers)], source, rig, srid, rejections)


def scan(path: Path, settings: DriveYaml) -> Files:
    """Images, calibration, time stamps, and the names and some contents of the OXTS files."""
    root, cameras = path.resolve(), settings.cameras
    remedy = "expected KITTI's layout with left images in image_02/data and right images in image_03/data"
    left, right = (
        folder_stream(root, camera_folder(root, name, settings), f"{name}/data", remedy)
        for name in (cameras.left, cameras.right)
    )
    data = root / "oxts" / "data"
    records = {"oxts/data": names_in(data, (".txt",))} if data.is_dir() else {}
    names = [OXTS_STAMPS, f"{cameras.left}/timestamps.txt"]
    names += [f"oxts/data/{name}" for name in samples_of(records.get("oxts/data", []))]
    small = {name: root / name for name in names}
    with suppress(InputError):  # raised later; a drive without it has another header than with it
        calibration = calibration_path(path, settings)
        small |= {name: calibration.parent / name for name in (calibration.name, VELO_TO_CAM, IMU_TO_VELO)}
    return Files(left, right, small, listed=records)


def read_header(source: Source, header: HeaderFacts) -> None:
    """The times of the left images; calibration and OXTS files must be there."""
    stamps = f"{source.settings.cameras.left}/timestamps.txt"
    images = _numbered(chain(*(stream.paths for stream in source.files[:2]))) or None
    header.set_times(_stamps(source, stamps, images).values(), source.path / stamps)
    read_rig_for(source, calibration_path(source.path, source.settings), None)
    _record_files(source)


def calibration_path(folder: Path, settings: DriveYaml) -> Path:
    """Path of calib_cam_to_cam.txt of a drive folder, given as the user named it. Raises InputError."""
    root = folder.resolve()
    if settings.calibration is not None:
        return named_in_yaml(root, settings.calibration, "the calibration is")
    # Before the parent of the resolved folder that of the given path: the drive folder may be a symbolic link.
    for parent in (root, folder.absolute().parent, root.parent):
        if (parent / CAM_TO_CAM).is_file():
            return parent / CAM_TO_CAM
    raise InputError(
        f"{root}: {CAM_TO_CAM} is neither in the drive folder nor in its parent; KITTI delivers it with {VELO_TO_CAM} and "
        f"{IMU_TO_VELO} as the calibration of the recording day"
    )


def read_rig_for(source: Source, path: Path, size: tuple[int, int] | None) -> Rig:
    """The rig for left images of this size, with the chain from the IMU; its files are added to the content hash."""
    settings = source.settings
    left, right = (int(name[-1]) for name in (settings.cameras.left, settings.cameras.right))
    rig = read_kitti_rig(
        path, images=size, left=left, right=right, body_required=True, rig_id=settings.rig_id, sigma_px=settings.sigmas.image_px
    )  # fmt: skip
    for name in (path.name, VELO_TO_CAM, IMU_TO_VELO):
        source.content.add(f"calibration/{name}", read_bytes(path.parent / name))
    add_settings(source.content, source.root, (DRIVE_YAML,))
    return rig


def camera_folder(root: Path, name: str, settings: DriveYaml) -> Path:
    """Folder of one camera's images. Raises InputError where drive.yaml names one outside the drive folder."""
    return (inside(root, name, DRIVE_YAML) if "cameras" in settings.model_fields_set else root / name) / "data"


def _numbered_images(stream: Stream, rejections: list[Rejection]) -> dict[int, list[ImageFile]]:
    """Images by the number that is their name; images without a number are rejected, hidden files do not count."""
    for path in stream.paths:
        if not is_number(path.stem):
            name = f"{stream.name}/{path.name}"
            detail = f"{name}: the name is not a frame number such as 0000000044.png, so the image has no pose"
            reason = RejectionReason.IMAGE_UNREADABLE
            rejections.append(Rejection(step="frames", reason=reason, record=name, detail=detail, payload={}))
    return _numbered(stream.paths)


def is_number(stem: str) -> bool:
    """Whether a file's name is a frame number."""
    return stem.isascii() and stem.isdigit() and int(stem) <= MAX_FRAME_INDEX


def _numbered(paths: Iterable[Path]) -> dict[int, list[ImageFile]]:
    """Files by the number that is their name; others are left out."""
    found: dict[int, list[ImageFile]] = {}
    for stem, files in pairs.by_stem(sorted(paths)).items():
        if is_number(stem):
            found.setdefault(int(stem), []).extend(files)
    return found


def _stamps(
    source: Source, name: str, wanted: Container[int] | None = None, content: pairs.ContentHash | None = None
) -> Stamps:
    """Times of a timestamps.txt, see `parse_timestamps`. Raises InputError."""
    lines = (content or source.content).lines(
        source.root, name, "expected one line with a time stamp for each frame number"
    )
    return parse_timestamps(lines, source.settings.timestamps_timezone, wanted)


def _split_triggers(source: Source, left: Mapping[int, int | str]) -> dict[int, str]:
    """What is wrong with the times of right images, by frame number; nothing without their timestamps.txt.

    The file is part of the content hash only where it rejects a pair: else the hash of drives would change that earlier
    versions ingested with the same result.
    """
    name = f"{source.settings.cameras.right}/timestamps.txt"
    if not (source.root / name).is_file():
        return {}
    own = pairs.ContentHash()
    right = _stamps(source, name, left, own)
    found = {number: trigger_problem(time, right.get(number), source.settings) for number, time in left.items()}
    wrong = {number: f"{name}, line {number + 1}: {problem}" for number, problem in found.items() if problem}
    if wrong:
        source.content.add(name, own.hexdigest().encode())
    return wrong


def trigger_problem(left: int | str, right: int | str | None, settings: DriveYaml) -> str | None:
    """Why two images (UTC nanoseconds, or what is wrong with a time) are not of one trigger.

    None where they are, where the right image has no time, or where the left time is wrong by itself.
    """
    if right is None or isinstance(left, str) or clock_problem(left):
        return None
    if isinstance(right, str):
        return right
    if abs(right - left) <= settings.pair_tolerance_ns:
        return None
    return (
        f"left and right image are {abs(right - left) * 1e-6:.3f} ms apart, allowed {settings.pair_tolerance_ms:g} ms "
        "(pair_tolerance_ms in drive.yaml)"
    )


def _trajectory(
    source: Source, files: Mapping[int, list[ImageFile]], stamps: Stamps
) -> tuple[int, OxtsTrajectory, dict[int, str]]:
    """EPSG code of the map, the poses in it, and what is wrong with the other OXTS records, by frame number."""
    folder, settings = source.path, source.settings
    records, bad = _read_oxts(source, files)
    if not records:
        shown = "".join(f", for example {number:010d}.txt: {text}" for number, text in [*bad.items()][:1])
        raise InputError(f"{folder}: no usable pose in oxts/data{shown}")
    start = records[min(records)]
    srid = checked_srid(source.map_srid, start.lat_deg, start.lon_deg, folder)
    times = {number: stamp for number, stamp in stamps.items() if isinstance(stamp, int)}
    with input_errors(folder):
        track = oxts_trajectory(records, times, srid, settings.sigmas)
        timed = [(number, row, t) for number, row in track.rows.items() if (t := track.times_ns[row]) is not None]
        found = wild_fixes([t for *_, t in timed], track.map_SE3_body[[row for _, row, _ in timed], :3, 3])
        if wild := {timed[k][0]: text for k, text in found.items()}:
            kept = {number: record for number, record in records.items() if number not in wild}
            track = oxts_trajectory(kept, times, srid, settings.sigmas)
    return srid, track, bad | wild


def _read_oxts(source: Source, files: Mapping[int, list[ImageFile]]) -> tuple[dict[int, OxtsRecord], dict[int, str]]:
    """Valid OXTS records and, for the others, what is wrong with them, by frame number."""
    fetch([file.path for same in files.values() for file in same], fresh=True)
    records: dict[int, OxtsRecord] = {}
    bad: dict[int, str] = {}
    for number, same in files.items():
        path = same[0].path
        if not (is_remote(path) or is_present(path)):
            bad[number] = NOT_A_FILE
            continue
        try:
            if not is_remote(path) and path.stat().st_size > MAX_RECORD_BYTES:
                raise ValueError(f"expected a record of at most {MAX_RECORD_BYTES:,} bytes")
            raw = object_bytes(path) if is_remote(path) else path.read_bytes()
            source.content.add(f"oxts/data/{path.name}", raw)
            if len(same) > 1:
                raise ValueError(f"{len(same)} files have this number: {', '.join(file.path.name for file in same)}")
            text = raw.decode("utf-8", errors="replace")
            records[number] = parse_oxts(text, accuracy_required=source.settings.sigmas.horizontal_m is None)
        except ValueError as error:
            bad[number] = str(error)
    return records, bad


def _record_files(source: Source) -> dict[int, list[ImageFile]]:
    """The OXTS files by the number that is their name. Raises InputError where there are none."""
    found = _numbered(source.root / "oxts/data" / name for name in source.files.listed.get("oxts/data", ()))
    if not found:
        raise InputError(
            f"{source.path}: there are no poses in oxts/data (one file of 30 numbers per frame); without a trajectory use "
            "'conetl locate' on single pairs"
        )
    return found


def _pose_at(number: int, bad: Mapping[int, str], track: OxtsTrajectory, root: Path, captured: int) -> Pose:
    """The pose of a frame. Raises PairError unless there is a record of this number at about the image's time."""
    name = f"oxts/data/{number:010d}.txt"
    if number in bad:
        path = root / name
        text = None
        if path.is_file():
            with path.open("rb") as file:
                text = file.read(1000).decode(errors="replace")
        raise PairError(RejectionReason.POSE_INVALID, f"{name}: {bad[number]}", path=name, text=text)
    if number not in track.rows:
        raise PairError(RejectionReason.POSE_MISSING, f"{name}: there is no such file", path=name)
    require_same_time(captured, track.times_ns[track.rows[number]])
    return oxts_pose(track, number, captured)


def require_same_time(captured: int, pose_at: int | None) -> None:
    """Raise PairError where the times of an image and of its pose (UTC nanoseconds) are not of one frame."""
    apart = 0 if pose_at is None else abs(captured - pose_at)
    if apart > MAX_CLOCK_DIFFERENCE_NS:
        raise PairError(
            RejectionReason.TIMESTAMP_INVALID,
            f"image and pose are {apart * 1e-9:.3f} s apart by their time stamps, allowed 0.5 s: clocks or time zones differ",
        )


def oxts_trajectory(
    records: Mapping[int, OxtsRecord], times_ns: Mapping[int, int], srid: int, sigmas: Sigmas
) -> OxtsTrajectory:
    """Poses in the map frame: positions by the map projection, yaw turned from true to grid east by the convergence.

    Raises ValueError where the map CRS cannot express the positions.
    """
    numbers = sorted(records)
    table = np.array([records[number] for number in numbers])
    positions = geodesy.to_map(srid, table[:, 0], table[:, 1], table[:, 2])
    grid_yaw = table[:, 5] + geodesy.grid_convergence_rad(srid, table[:, 0], table[:, 1])
    poses = se3.se3(se3.rotation_from_rpy(table[:, 3], table[:, 4], grid_yaw), positions)
    recorded = np.full((len(numbers), 6), np.nan)
    recorded[:, :2] = table[:, [6]]
    rows = {number: row for row, number in enumerate(numbers)}
    return OxtsTrajectory(rows, poses, stated_sigmas(recorded, sigmas), [times_ns.get(number) for number in numbers])


def oxts_pose(track: OxtsTrajectory, number: int, exposure_ns: int) -> Pose:
    """Pose at the exposure of a frame that has a valid record.

    The pose is interpolated between the records before and after the exposure (straight line, slerp). Where one of them is
    missing (first and last frame, beside a gap of more than 0.5 s) the motion between the record of the same number and its
    other neighbour is extrapolated, by at most the time between them. Where that is impossible too, the record of the same
    number is used, and the distance that the body may have driven is added to the sigma of its position. A record without a
    time is used as it is.
    """
    row = track.rows[number]
    end, weight, apart_m = _neighbour(track, row, exposure_ns)
    sigma = track.sigma[row].copy()
    sigma[:3] = np.hypot(sigma[:3], apart_m)
    return se3.to_pose(se3.interpolate(track.map_SE3_body[row], track.map_SE3_body[end], weight), sigma)


def _neighbour(track: OxtsTrajectory, row: int, time_ns: int) -> tuple[int, float, float]:
    """The row to interpolate with from `row`, and its weight at a time: 0 at `row`, 1 at it.

    The record beyond the time, else that on the other side with a negative weight, down to -1. Where both are unusable `row`
    itself, and the distance (m) that the body may have driven.
    """
    t0, speed = track.times_ns[row], 0.0
    if t0 is None or t0 == time_ns:
        return row, 0.0, 0.0
    late_ns = time_ns - t0
    for other in (row + 1, row - 1) if late_ns > 0 else (row - 1, row + 1):
        t1 = track.times_ns[other] if 0 <= other < len(track.times_ns) else None
        if t1 is None or t1 == t0:
            continue
        step_ns = t1 - t0
        if abs(late_ns) <= abs(step_ns) <= MAX_GAP_NS:
            return other, late_ns / step_ns, 0.0
        moved_m = np.linalg.norm(track.map_SE3_body[other, :3, 3] - track.map_SE3_body[row, :3, 3])
        speed = max(speed, float(moved_m) / abs(step_ns))
    return row, 0.0, speed * abs(late_ns)
