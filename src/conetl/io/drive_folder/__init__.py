"""Drive folders, one reader per format: `read_drive` finds out which one it is."""

from __future__ import annotations

from pathlib import Path

from conetl.errors import DriveFolderError
from conetl.io.drive_folder.kitti import is_kitti_folder, read_kitti_drive
from conetl.io.drive_folder.plain import is_plain_folder, read_plain_drive
from conetl.records import Drive
from conetl.rejections import Rejection

__all__ = ["read_drive"]


def read_drive(path: Path, *, map_srid: int | None = None) -> tuple[Drive, list[Rejection]]:
    """A drive and the frame pairs that had to be refused.

    map_srid: EPSG code of the map that the drive is for; default drive.yaml's, else the UTM zone of the first pose.
    Raises DriveFolderError or CalibrationError where the folder as a whole cannot be used.
    """
    if not path.exists():
        raise DriveFolderError(f"{path}: there is no such folder; give the folder of one drive")
    if not path.is_dir():
        raise DriveFolderError(f"{path}: this is a file; give the folder of one drive")
    if is_plain_folder(path):
        return read_plain_drive(path, map_srid=map_srid)
    if is_kitti_folder(path):
        return read_kitti_drive(path, map_srid=map_srid)
    children = sorted(child for child in path.iterdir() if not child.name.startswith("."))
    if not children:
        raise DriveFolderError(
            f"{path}: the folder is empty; a drive holds image_02, image_03, oxts and the calibration"
        )
    drives = [child.name for child in children if child.is_dir() and (is_kitti_folder(child) or is_plain_folder(child))]
    if drives:
        raise DriveFolderError(
            f"{path}: this folder holds {len(drives)} drives ({', '.join(drives[:3])}{', ...' if len(drives) > 3 else ''}); "
            f"name the drives themselves: conetl ingest {path}/*"
        )
    raise DriveFolderError(
        f"{path}: this is not a drive in KITTI's raw layout (image_02/data, image_03/data, oxts/data, calib_*.txt) nor a "
        f"plain one (left, right, trajectory.csv, rig.yaml); found {', '.join(child.name for child in children[:5])}"
    )
