"""Drives, one module per format: `read_drive` recognises the format.

To add a format, write a module that provides what `formats.DriveFormat` lists, and add it to `FORMATS`.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np

from conetl.files.names import require_utf8
from conetl.files.storage import as_path, forget_listing, is_remote, storage_errors
from conetl.geometry.packing import vec3
from conetl.model.drive import CommonError, Drive
from conetl.model.errors import DriveFolderError, InputError
from conetl.model.rejections import Rejection
from conetl.readers.drives import bags, euroc, kitti, plain, video
from conetl.readers.drives.camera_files import image_files, names_in
from conetl.readers.drives.drive_yaml import named_in_yaml, read_drive_yaml
from conetl.readers.drives.formats import DriveFormat, with_stated_shutters
from conetl.readers.drives.pairs import ContentHash, Source, no_images, without_frozen
from conetl.readers.stated_sigmas import implausible_sigma
from conetl.readers.surveyed_points import read_surveyed_points
from conetl.tracking.error_propagation import common_axes

__all__ = ["FORMATS", "OpenDrive", "find_format", "open_drive", "read_drive", "zed_recording"]

#: The first format that matches reads the drive.
FORMATS: tuple[DriveFormat, ...] = (plain, euroc, bags, video, kitti)
_OF_ZED = frozenset({".svo", ".svo2"})


def find_format(path: Path) -> DriveFormat | None:
    """The format of a folder (or a bag's file), complete or not; None for anything else."""
    candidates = (found for found in FORMATS if found.READS_OBJECTS or not is_remote(path))
    return next((found for found in candidates if found.matches(path)), None)


class OpenDrive(NamedTuple):
    """A drive whose files were found, once for all who ask for them."""

    format: DriveFormat
    source: Source


def open_drive(
    path: Path | str, *, map_srid: int | None = None, images_folder: Path | None = None, headers_only: bool = False
) -> OpenDrive:
    """Recognise a drive and find its files; arguments and errors are those of `read_drive`."""
    path = as_path(path)
    forget_listing(path)
    with storage_errors(path), _of_the_drive():
        if not path.exists():
            raise InputError(f"{path}: there is no such folder; give the folder of one drive")
        if not is_remote(path):
            require_utf8(path)
        found = find_format(path)
        settings = read_drive_yaml(path.resolve())
        if found is None:
            raise _not_a_drive(path)
        content, srid = ContentHash(headers_only=headers_only), map_srid or settings.map_srid
        files = found.scan(path, settings)
        return OpenDrive(found, Source(path, path.resolve(), settings, content, srid, images_folder, files))


def read_drive(
    path: Path | str | OpenDrive,
    *,
    map_srid: int | None = None,
    images_folder: Path | None = None,
    headers_only: bool = False,
) -> tuple[Drive, list[Rejection]]:
    """Read a drive; returns it with the rejected frame pairs.

    path: a drive folder, a bag, or the address of a drive in object storage (s3://bucket/drive); or a drive that is open already,
    with its options.
    map_srid: EPSG code of the map; default: that of drive.yaml, otherwise the UTM zone of the first pose.
    images_folder: folder to which the images of a bag are unpacked; other formats do not need it.
    headers_only: check only the first and last bytes of images. This is fast, but does not find damage in between, and
    content_sha256 covers only the small files: to inspect a drive, not to ingest it.
    Raises DriveFolderError if the drive as a whole cannot be used.
    """
    if not isinstance(path, OpenDrive):
        path = open_drive(path, map_srid=map_srid, images_folder=images_folder, headers_only=headers_only)
    found, source = path
    settings = source.settings
    with storage_errors(source.path), _of_the_drive():
        if not (found.UNPACKS or source.files.image_count):
            raise no_images(source.path, source.files.left.name, source.files.right.name)
        control_file = _control_file(source)
        drive, rejections = found.read(source)
        drive = drive.model_copy(update={"rig": with_stated_shutters(drive.rig, settings.shutter)})
        if control_file is not None and settings.control_points is not None:
            stated = settings.control_points.model_dump(exclude={"file"})
            points = tuple(read_surveyed_points(control_file, drive.map_srid, **stated))
            drive = drive.model_copy(update={"control_points": points})
        if problem := implausible_sigma(np.array([pair.pose.sigma_enu_m[:2] for pair in drive.frame_pairs])):
            worst_m = np.median([max(pair.pose.sigma_enu_m[:2]) for pair in drive.frame_pairs])
            raise InputError(
                f"{drive.source_path}: {problem} State the sigma in drive.yaml, for example "
                f"'sigmas: {{horizontal_m: {worst_m**0.5 or 0.02:.2g}}}'"
            )
        drive = _with_common_errors(drive, settings.common_errors)
    drive, frozen = without_frozen(drive)
    return drive, [*rejections, *frozen]


@contextmanager
def _of_the_drive() -> Iterator[None]:
    """What is wrong with any file of a drive is wrong with the drive: another try does not help (`may_pass`)."""
    try:
        yield
    except InputError as error:
        raise DriveFolderError(str(error)) from error.__cause__


def _with_common_errors(drive: Drive, errors: tuple[CommonError, ...]) -> Drive:
    """The drive with errors of its positions that others share; sigmas of the poses that are smaller are enlarged to them."""
    if not errors:
        return drive
    rotation = np.array([pair.pose.map_R_body for pair in drive.frame_pairs])
    stated_m = np.array([pair.pose.sigma_enu_m for pair in drive.frame_pairs])
    common_m = np.linalg.norm(np.concatenate([common_axes(one, rotation) for one in errors], axis=2), axis=2)
    sigmas_m = map(vec3, np.maximum(stated_m, common_m))
    pairs = tuple(pair.with_pose(sigma_enu_m=m) for pair, m in zip(drive.frame_pairs, sigmas_m, strict=True))
    return drive.model_copy(update={"common_errors": errors, "frame_pairs": pairs})


def _control_file(source: Source) -> Path | None:
    """The file of control points, which becomes part of the drive's hash. Raises InputError."""
    if source.settings.control_points is None:
        return None
    folder = source.root.parent if source.root.is_file() else source.root
    path = named_in_yaml(folder, source.settings.control_points.file, "the control points are")
    source.content.add_file(source.settings.control_points.file, path)
    return path


def _not_a_drive(path: Path) -> InputError:
    if (error := zed_recording(path)) is not None:
        return error
    if not path.is_dir():
        return InputError(f"{path}: this is a file; give the folder of one drive, or a .mcap or .bag file")
    children = sorted(child for child in path.iterdir() if not child.name.startswith("."))
    if not children:
        return InputError(f"{path}: the folder is empty; a drive contains image_02, image_03, oxts and the calibration")
    drives = [child.name for child in children if find_format(child)]
    if len(drives) == 1:
        return InputError(f"{path}: this folder contains one drive ({drives[0]}): conetl ingest {path / drives[0]}")
    if drives:
        return InputError(
            f"{path}: this folder contains {len(drives)} drives ({', '.join(drives[:3])}{', ...' if len(drives) > 3 else ''}); "
            f"name one of them, or all: conetl ingest {path}/*"
        )
    if sum(child.is_dir() and bool(image_files(child)) for child in children) > 1:
        return InputError(
            f"{path}: folders of images become a drive with 'conetl init {path}', which writes drive.yaml and lists what is "
            "missing"
        )
    return InputError(
        f"{path}: this is not a drive in KITTI's raw layout (image_02/data, image_03/data, oxts/data, calib_*.txt), a "
        f"plain one (left, right, trajectory.csv, rig.yaml), a EuRoC one (mav0/cam0, cam1) or a "
        f"bag (metadata.yaml, *.mcap, *.bag); found {', '.join(child.name for child in children[:5])}. 'conetl init {path}' "
        "makes a drive of two videos or folders of images with a trajectory file"
    )


def zed_recording(path: Path) -> InputError | None:
    """How to export a recording of a ZED camera, which is this file or in this folder; None if there is none."""
    if path.is_dir():
        found = [path / name for name in names_in(path, _OF_ZED)]
    else:
        found = [path] if path.is_file() and path.suffix.lower() in _OF_ZED else []
    if not found:
        return None
    return InputError(
        f"{found[0]}: recordings of ZED cameras are not read; export it with Stereolabs' 'svo_export.py --mode 0' and give "
        "the AVI to 'conetl init'"
    )
