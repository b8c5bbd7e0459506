"""Poses of the left camera, one row per image, as KITTI odometry and many SLAM programs write them: no times, 12 numbers.

A row is the upper 3 x 4 part of the matrix from the camera (x right, y down, z forward) to the frame of the file. That is the
camera at its first image (Geiger et al., CVPR 2012), or a level frame with z up: which of them is seen from where the cameras are
upright. Times are those of the images.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from conetl.files.documents import read_table_bytes, table_lines
from conetl.geometry import pose as se3
from conetl.geometry import rig as rigs
from conetl.model.arrays import Floats
from conetl.model.errors import InputError
from conetl.model.rig import Rig
from conetl.readers.drives.image_times import of_images
from conetl.readers.drives.pairs import Image
from conetl.readers.trajectories import find_trajectories
from conetl.readers.trajectories.recorded import RecordedTrajectory, Records, assembled
from conetl.readers.trajectories.text import floats, head_lines

_COLUMNS = 12
#: Largest entry of R^T R - 1 of a rotation in text; a file has a few digits.
_NOT_A_ROTATION = 2e-3
#: Least mean component of the cameras' upward direction along the axis of the frame that points up.
_UPRIGHT = 0.9
_MOST_FILES = 500
_SUFFIXES = frozenset({".txt", ".csv", ".kitti"})


def looks_like(path: Path) -> bool:
    """Whether a file begins with rows of 12 numbers that are poses. Raises InputError where it cannot be read."""
    if not path.is_file():
        return False
    rows = _table([line for line in head_lines(path) if line.strip()][:5])
    return bool(len(rows)) and bool(_is_pose(rows).all())


def find_logs(folder: Path) -> list[Path]:
    """Files (and folders) in a folder and its folders that look like trajectories, of any format."""
    found = find_trajectories(folder)
    folders = [folder, *(p for p in folder.glob("[!.]*") if p.is_dir())]
    files = sorted(p for f in folders for p in f.glob("[!.]*") if p.suffix.lower() in _SUFFIXES and p not in found)
    return [*found, *(path for path in files[:_MOST_FILES] if looks_like(path))]


def read(path: Path, images: Sequence[Image], rig: Rig) -> RecordedTrajectory:
    """Poses of the body (forward, left, up) in a level frame, at the times of the left images.

    Of a file in the frame of the first camera, the frame is that of the body at its first row. rig: with the left camera on the
    body. Raises InputError where rows and images do not belong together, or no row is a pose.
    """
    lines = [line for line in table_lines(read_table_bytes(path, len(images))) if line.strip()]
    rows = _table(of_images(lines, [image.path for image in images]))
    if len(rows) != len(images):
        raise InputError(
            f"{path}: {len(rows)} poses for {len(images)} left images, expected one row of 12 numbers per image"
        )
    is_pose = _is_pose(rows)
    if not is_pose.any():
        raise InputError(f"{path}: no row has the 12 numbers of a pose, a rotation and a translation")
    frame_SE3_left = se3.se3(rows[:, :, :3], rows[:, :, 3])
    body_SE3_left = rigs.body_SE3_camera(rig, "left")
    up = -rows[is_pose][:, :, 1].mean(axis=0)
    if up[2] >= _UPRIGHT:
        poses = se3.compose(frame_SE3_left, se3.invert(body_SE3_left))
    elif up[1] <= -_UPRIGHT:
        poses = se3.compose(se3.compose(body_SE3_left, frame_SE3_left), se3.invert(body_SE3_left))
    else:
        raise InputError(
            f"{path}: neither in the frame of the first camera (y down) nor in a level one (z up): the mean upward direction of "
            f"the cameras is {np.round(up, 2).tolist()}; convert the poses to one of them"
        )
    wrong = dict.fromkeys(np.flatnonzero(~is_pose).tolist(), "the row has no 12 numbers of a pose")
    stamps = np.array([image.stamp if isinstance(image.stamp, int) else 0 for image in images], dtype=np.int64)
    records = Records(stamps, poses[:, :3, 3], poses[:, :3, :3], np.full((len(rows), 6), np.nan), wrong)
    return assembled(path, [records], is_local=True, between_ns=None)


def _table(lines: Sequence[str]) -> Floats:
    """(N, 3, 4) of lines of 12 numbers; NaN in place of other lines."""
    words = [line.replace(",", " ").split()[: _COLUMNS + 1] for line in lines]
    rows = [floats(w) if len(w) == _COLUMNS else np.full(_COLUMNS, np.nan) for w in words]
    return np.array(rows).reshape(-1, 3, 4)


def _is_pose(rows: Floats) -> np.ndarray:
    """(N,) whether the left 3 x 3 parts are rotations."""
    turns = rows[:, :, :3]
    with np.errstate(all="ignore"):
        off = np.abs(np.swapaxes(turns, 1, 2) @ turns - np.eye(3)).max(axis=(1, 2))
        return np.asarray((off <= _NOT_A_ROTATION) & (np.linalg.det(turns) > 0) & np.isfinite(rows).all(axis=(1, 2)))
