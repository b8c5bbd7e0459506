"""Drive folders in the KITTI raw layout (Geiger et al., IJRR 2013), as a `Drive` with its rejections.

Images may be "synced and rectified" or "synced only": their size says which. Those of the latter are rectified when read.

    drive/image_02/data/0000000000.{png,jpg}   left images        drive/image_02/timestamps.txt
    drive/image_03/data/0000000000.{png,jpg}   right images
    drive/oxts/data/0000000000.txt             GNSS/INS           drive/oxts/timestamps.txt
    calib_cam_to_cam.txt, calib_velo_to_cam.txt, calib_imu_to_velo.txt in the drive folder or its parent
    drive/drive.yaml                           optional, see drive_yaml.py

The number in a file's name links images, poses and time stamps (line n, from 0, is frame n). A pair with anything missing or
broken costs one rejection; without a calibration, a trajectory or one usable pair there is no drive.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

from conetl.files.storage import fetch, is_remote, object_bytes
from conetl.geometry import geodesy
from conetl.model.errors import CalibrationError, DriveFolderError
from conetl.model.records import Drive, FramePair, Rig
from conetl.model.rejections import Rejection, RejectionReason
from conetl.readers.drives import oxts
from conetl.readers.drives.content import ContentHash
from conetl.readers.drives.drive_yaml import DRIVE_YAML, DriveYaml, inside, read_drive_yaml
from conetl.readers.drives.pairs import (
    IMAGE_SUFFIXES,
    ImageFile,
    PairError,
    check_images,
    first_size,
    images_ahead,
    require_pairs,
)
from conetl.readers.drives.timestamps import misplaced, parse_timestamps
from conetl.readers.rigs import CAM_TO_CAM, IMU_TO_VELO, VELO_TO_CAM, kitti_rig_for_images

MAX_CLOCK_DIFFERENCE_NS = 500_000_000
"""Image and OXTS record of one number that are farther apart in time do not belong together."""


def is_kitti_folder(folder: Path) -> bool:
    """True where a folder looks like a KITTI drive, whole or not."""
    return any((folder / name).is_dir() for name in ("image_02", "image_03", "oxts")) or (folder / DRIVE_YAML).is_file()


def read_kitti_drive(
    folder: Path, *, map_srid: int | None = None, headers_only: bool = False
) -> tuple[Drive, list[Rejection]]:
    """Everything about a drive but its pixels; images are checked by header and end marker, not decoded.

    map_srid: EPSG code of the map; wins over drive.yaml, and both over the UTM zone of the first pose. Raises DriveFolderError
    or CalibrationError where there is no drive to speak of.
    """
    root = folder.resolve()
    content = ContentHash(headers_only=headers_only)
    settings = read_drive_yaml(root)
    calibration = calibration_path(folder, settings)
    rejections: list[Rejection] = []
    left = _numbered_images(camera_folder(root, settings.cameras.left, settings), folder, rejections)
    right = _numbered_images(camera_folder(root, settings.cameras.right, settings), folder, rejections)
    numbers = sorted(left.keys() | right.keys())
    if not numbers:
        raise DriveFolderError(f"{folder}: there are no images (*.png, *.jpg) in {settings.cameras.left}/data")
    size = first_size((paths[0] for _, paths in sorted(left.items())), content)
    rig = read_rig_for(root, calibration, size, settings, content)
    zone = settings.timestamps_timezone
    stamps = parse_timestamps(_text(root, f"{settings.cameras.left}/timestamps.txt", content, required=True), zone)
    oxts_stamps = parse_timestamps(_text(root, "oxts/timestamps.txt", content, required=False), zone)
    records, bad_records = _read_oxts(root, folder, settings, content)
    if not records:
        first = next(iter(bad_records.items()), None)
        shown = f", for example {first[0]:010d}.txt: {first[1]}" if first else ""
        raise DriveFolderError(f"{folder}: not one usable pose in oxts/data{shown}")
    srid = map_srid or settings.map_srid
    try:
        start = records[min(records)]
        srid = srid or geodesy.utm_srid(start.lat_deg, start.lon_deg)
        geodesy.check_map_srid(srid)
        geodesy.check_scale(srid, start.lat_deg, start.lon_deg)
        times = {number: stamp for number, stamp in oxts_stamps.items() if isinstance(stamp, int)}
        track = oxts.trajectory(records, times, srid, settings.sigmas)
        wild = oxts.jumps(track)
        if wild:
            bad_records |= wild
            kept = {number: record for number, record in records.items() if number not in wild}
            track = oxts.trajectory(kept, times, srid, settings.sigmas)
    except ValueError as error:
        raise DriveFolderError(f"{folder}: {error}") from error

    usable: dict[int, tuple[ImageFile, ImageFile, int]] = {}
    rising = {n: t for n in numbers if isinstance(t := stamps.get(n), int)}
    wrong_times = misplaced(rising)
    for number in images_ahead(numbers, left, right, content):
        try:
            images = check_images(left.get(number, []), right.get(number, []), rig, content, root)
            captured = _captured_at(number, stamps, wrong_times, settings)
            _check_pose(number, captured, bad_records, track, root)
        except PairError as error:
            rejections.append(error.rejection(f"frame pair {number}", number))
        else:
            usable[number] = *images, captured
    pairs = _frame_pairs(usable, track, settings)
    require_pairs(pairs, rejections, len(numbers), folder)
    drive = Drive(
        drive_id=settings.id_of(root), source_path=str(root), rig=rig, map_srid=srid,
        content_sha256=content.hexdigest(), frame_pairs=tuple(pairs), expected_frame_count=len(numbers),
    )  # fmt: skip
    return drive, rejections


def _frame_pairs(
    usable: Mapping[int, tuple[ImageFile, ImageFile, int]], track: oxts.Trajectory, settings: DriveYaml
) -> list[FramePair]:
    """Records of the frame pairs that can be used: number -> left and right image, UTC nanoseconds."""
    poses = oxts.poses_at(track, {number: captured for number, (_, _, captured) in usable.items()}, settings.sigmas)
    return [
        FramePair(
            frame_index=number,
            left_path=str(left.path),
            right_path=str(right.path),
            captured_at_ns=captured,
            pose=poses[number],
            left_sha256=left.sha256,
            right_sha256=right.sha256,
        )
        for number, (left, right, captured) in usable.items()
    ]


def calibration_path(folder: Path, settings: DriveYaml) -> Path:
    """Where calib_cam_to_cam.txt of a drive folder, named as the user did, is. Raises CalibrationError."""
    root = folder.resolve()
    if settings.calibration is not None:
        path = inside(root, settings.calibration, DRIVE_YAML)
        if not path.is_file():
            raise CalibrationError(
                f"{root / DRIVE_YAML}: 'calibration' names {settings.calibration}, which does not exist"
            )
    else:
        # The folder's parent as the user wrote it comes first: the drive folder itself may be a symbolic link.
        places = [parent / CAM_TO_CAM for parent in (root, folder.absolute().parent, root.parent)]
        path = next((place for place in places if place.is_file()), places[0])
        if not path.is_file():
            raise CalibrationError(
                f"{root}: {CAM_TO_CAM} is neither in the drive folder nor in its parent; KITTI delivers it with "
                f"{VELO_TO_CAM} and {IMU_TO_VELO} as the calibration of the recording day"
            )
    return path


def read_rig_for(
    root: Path, path: Path, size: tuple[int, int] | None, settings: DriveYaml, content: ContentHash
) -> Rig:
    """The rig for left images of this size, with the chain from the IMU; its files go into the content hash."""
    numbers = int(settings.cameras.left[-1]), int(settings.cameras.right[-1])
    rig = kitti_rig_for_images(
        path, size, left=numbers[0], right=numbers[1], body_required=True,
        rig_id=settings.rig_id, sigma_px=settings.sigmas.image_px,
    )  # fmt: skip
    for name in (path.name, VELO_TO_CAM, IMU_TO_VELO):
        content.add(f"calibration/{name}", (path.parent / name).read_bytes())
    if (root / DRIVE_YAML).is_file():
        content.add(DRIVE_YAML, (root / DRIVE_YAML).read_bytes())
    return rig


def camera_folder(root: Path, name: str, settings: DriveYaml) -> Path:
    """Folder of one camera's images. Where drive.yaml names it, it must lie inside the drive folder."""
    return (inside(root, name, DRIVE_YAML) if "cameras" in settings.model_fields_set else root / name) / "data"


def _numbered_images(data: Path, folder: Path, rejections: list[Rejection]) -> dict[int, list[Path]]:
    """Images by the number that is their name; images without a number are rejected, hidden files do not count."""
    if not data.is_dir():
        raise DriveFolderError(
            f"{folder}: the folder {data.parent.name}/data is missing; expected KITTI's layout with left images in "
            "image_02/data and right images in image_03/data"
        )
    paths = [p for p in sorted(data.iterdir()) if p.suffix.lower() in IMAGE_SUFFIXES and not p.name.startswith(".")]
    for path in paths:
        if not is_number(path.stem):
            name = f"{data.parent.name}/data/{path.name}"
            detail = (
                f"{name}: the name is no frame number, so it has neither a partner nor a pose; expected 0000000044.png"
            )
            rejections.append(
                Rejection(
                    step="frames", reason=RejectionReason.IMAGE_UNREADABLE, record=name, detail=detail, payload={}
                )
            )
    return _numbered(paths)


def is_number(stem: str) -> bool:
    return stem.isascii() and stem.isdigit()


def _numbered(paths: Iterable[Path]) -> dict[int, list[Path]]:
    """Files by the number that is their name; others are left out."""
    found: dict[int, list[Path]] = {}
    for path in sorted(paths):
        if is_number(path.stem):
            found.setdefault(int(path.stem), []).append(path)
    return found


def _text(root: Path, name: str, content: ContentHash, *, required: bool) -> str:
    """A small text file of the drive, "" where it is missing and not required."""
    path = root / name
    if not path.is_file():
        if required:
            raise DriveFolderError(
                f"{root}: {name} is missing; it holds one line with a time stamp for each frame number"
            )
        return ""
    fetched = is_remote(path) and name.startswith("oxts/data/")
    data = object_bytes(path) if fetched else path.read_bytes()
    content.add(name, data)
    return data.decode("utf-8", errors="replace")


def _read_oxts(
    root: Path, folder: Path, settings: DriveYaml, content: ContentHash
) -> tuple[dict[int, oxts.OxtsRecord], dict[int, str]]:
    """Valid OXTS records and, for the others, what is wrong with them, by frame number."""
    data = root / "oxts" / "data"
    files = _numbered(data.glob("*.txt")) if data.is_dir() else {}
    if not files:
        raise no_poses(folder)
    fetch([path for paths in files.values() for path in paths], fresh=True)
    records: dict[int, oxts.OxtsRecord] = {}
    bad: dict[int, str] = {}
    for number, paths in files.items():
        text = _text(root, f"oxts/data/{paths[0].name}", content, required=True)
        try:
            if len(paths) > 1:
                raise ValueError(f"{len(paths)} files have this number: {', '.join(path.name for path in paths)}")
            records[number] = oxts.parse_oxts(text, accuracy_required=settings.sigmas.horizontal_m is None)
        except ValueError as error:
            bad[number] = str(error)
    return records, bad


def no_poses(folder: Path) -> DriveFolderError:
    """The error of a drive without one OXTS file."""
    return DriveFolderError(
        f"{folder}: there are no poses in oxts/data (one file of 30 numbers per frame); without a trajectory use "
        "'conetl locate' on single pairs"
    )


def _captured_at(
    number: int, stamps: Mapping[int, int | str], wrong_times: Mapping[int, str], settings: DriveYaml
) -> int:
    """Time of the left image, UTC nanoseconds. Raises PairError."""
    name = f"{settings.cameras.left}/timestamps.txt"
    stamp = stamps.get(number)
    if stamp is None:
        raise PairError(
            RejectionReason.TIMESTAMP_MISSING,
            f"{name} has {len(stamps)} lines, line {number + 1} is needed for this frame",
        )
    if isinstance(stamp, str):
        raise PairError(RejectionReason.TIMESTAMP_INVALID, f"{name}, line {number + 1}: {stamp}")
    if number in wrong_times:
        raise PairError(
            RejectionReason.TIMESTAMP_INVALID,
            f"{name}, line {number + 1}: the time {wrong_times[number]}",
        )
    return stamp


def _check_pose(number: int, captured: int, bad: Mapping[int, str], track: oxts.Trajectory, root: Path) -> None:
    """Raise PairError unless there is a pose of this number, of about the image's time."""
    name = f"oxts/data/{number:010d}.txt"
    if number in bad:
        path = root / name
        text = path.read_text(encoding="utf-8", errors="replace")[:1000] if path.is_file() else None
        raise PairError(RejectionReason.POSE_INVALID, f"{name}: {bad[number]}", path=name, text=text)
    if not oxts.has_record(track, number):
        raise PairError(RejectionReason.POSE_MISSING, f"{name}: there is no such file", path=name)
    apart = abs(captured - track.times_ns.get(number, captured))
    if apart > MAX_CLOCK_DIFFERENCE_NS:
        raise PairError(
            RejectionReason.TIMESTAMP_INVALID,
            f"image and pose are {apart * 1e-9:.3f} s apart by their time stamps, allowed 0.5 s: another clock or zone",
        )
