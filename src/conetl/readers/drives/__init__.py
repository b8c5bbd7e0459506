"""Drives, one reader per format: `read_drive` finds out which one it is."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from conetl.files.names import require_utf8
from conetl.files.storage import forget_listing, is_remote, place, reached
from conetl.model.errors import DriveFolderError
from conetl.model.records import Drive
from conetl.model.rejections import Rejection
from conetl.readers.drives.euroc import is_euroc_folder, read_euroc_drive
from conetl.readers.drives.kitti import is_kitti_folder, read_kitti_drive
from conetl.readers.drives.plain import is_plain_folder, read_plain_drive
from conetl.readers.drives.ros_bag import is_bag, read_bag_drive

__all__ = ["drive_format", "read_drive"]

DriveFormat = Literal["kitti", "plain", "euroc", "bag"]


def drive_format(path: Path) -> DriveFormat | None:
    """What a folder (or a bag's file) looks like, whole or not; None for anything else."""
    if is_remote(path):
        return _remote_format(path)
    if not path.is_dir():
        return "bag" if is_bag(path) else None
    if is_plain_folder(path):
        return "plain"
    if is_euroc_folder(path):
        return "euroc"
    if (path / "image_02").is_dir() or not is_bag(path):  # a KITTI drive may hold a bag of something else
        return "kitti" if is_kitti_folder(path) else None
    return "bag"


def _remote_format(path: Path) -> DriveFormat | None:
    """Bags need files that can be sought in, and EuRoC folders have not been read from object storage yet."""
    if is_plain_folder(path):
        return "plain"
    return "kitti" if is_kitti_folder(path) else None


def read_drive(
    path: Path, *, map_srid: int | None = None, images_folder: Path | None = None, headers_only: bool = False
) -> tuple[Drive, list[Rejection]]:
    """A drive and the frame pairs that had to be refused.

    map_srid: EPSG code of the map that the drive is for; default drive.yaml's, else the UTM zone of the first pose.
    images_folder: where the images of a bag are unpacked to, by the hash of their bytes; no other format needs it.
    headers_only: images are judged by their first and last bytes; quick, but damage in between goes unseen and
    content_sha256 covers only the small files: for a look at a drive, not for one that is ingested.
    Raises DriveFolderError or CalibrationError where the folder as a whole cannot be used.
    """
    path = place(path)
    forget_listing(path)
    with reached(path):
        if not path.exists():
            raise DriveFolderError(f"{path}: there is no such folder; give the folder of one drive")
        if not is_remote(path):
            require_utf8(path)
        return _read(path, map_srid, images_folder, headers_only)


def _read(
    path: Path, map_srid: int | None, images_folder: Path | None, headers_only: bool
) -> tuple[Drive, list[Rejection]]:
    match drive_format(path):
        case "bag":
            return read_bag_drive(path, map_srid=map_srid, headers_only=headers_only, images_folder=images_folder)
        case "plain":
            return read_plain_drive(path, map_srid=map_srid, headers_only=headers_only)
        case "euroc":
            return read_euroc_drive(path, map_srid=map_srid, headers_only=headers_only)
        case "kitti":
            return read_kitti_drive(path, map_srid=map_srid, headers_only=headers_only)
    if not path.is_dir():
        raise DriveFolderError(f"{path}: this is a file; give the folder of one drive, or a .mcap file")
    children = sorted(child for child in path.iterdir() if not child.name.startswith("."))
    if not children:
        raise DriveFolderError(
            f"{path}: the folder is empty; a drive holds image_02, image_03, oxts and the calibration"
        )
    drives = [child.name for child in children if drive_format(child)]
    if drives:
        raise DriveFolderError(
            f"{path}: this folder holds {len(drives)} drives ({', '.join(drives[:3])}{', ...' if len(drives) > 3 else ''}); "
            f"name the drives themselves: conetl ingest {path}/*"
        )
    raise DriveFolderError(
        f"{path}: this is not a drive in KITTI's raw layout (image_02/data, image_03/data, oxts/data, calib_*.txt), a "
        f"plain one (left, right, trajectory.csv, rig.yaml), a EuRoC one (mav0/cam0, cam1) or a "
        f"bag (metadata.yaml, *.mcap); found {', '.join(child.name for child in children[:5])}"
    )
