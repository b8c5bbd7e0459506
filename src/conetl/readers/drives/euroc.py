"""EuRoC / ASL folders (Burri et al., IJRR 2016): two cameras with data.csv and sensor.yaml, and a trajectory as a csv file.

    drive/mav0/cam0/data.csv, data/*.png, sensor.yaml     left camera: `#timestamp [ns],filename`, UTC nanoseconds since 1970
    drive/mav0/cam1/...                                   right camera
    drive/mav0/state_groundtruth_estimate0/data.csv       `#timestamp,p_x,p_y,p_z,q_w,q_x,q_y,q_z,...`; sensor.yaml with T_BS;
                                                          or odometry0, or the folder that drive.yaml names
    drive/drive.yaml                                      georeference and sigmas, see drive_yaml.py
    drive/rig.yaml                                        optional, wins over the sensor.yaml files

T_BS transforms points of the sensor to points of the body B (the IMU); the trajectory is that of its own sensor S in a frame R
that must be level. The folder mav0 may be left out.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from conetl.files.documents import library_errors, read_bytes, read_yaml, shown
from conetl.geometry import pose as se3
from conetl.model.arrays import Floats
from conetl.model.drive import Drive
from conetl.model.errors import InputError
from conetl.model.rejections import Rejection, RejectionReason
from conetl.model.rig import Camera, Rig, Side
from conetl.readers.drives import pairs
from conetl.readers.drives.camera_files import Files, folder_stream
from conetl.readers.drives.drive_yaml import DRIVE_YAML, DriveYaml, inside
from conetl.readers.drives.formats import HeaderFacts, add_settings, own_rig, rig_on_body
from conetl.readers.drives.poses import Samples, placed
from conetl.readers.drives.sparse_poses import pose_reader
from conetl.readers.rigs import RIG_YAML
from conetl.readers.rigs.common import Node
from conetl.readers.trajectories import read_trajectory

NAME, TITLE = "euroc", "EuRoC / ASL folder"
READS_OBJECTS, UNPACKS = False, False
#: Bytes of a file's name on most file systems.
_LONGEST_NAME = 255
SENSOR_YAML = "sensor.yaml"
TRAJECTORIES = ("state_groundtruth_estimate0", "state_groundtruth_estimate", "odometry0", "odometry")
_LENSES: dict[str | None, str | None] = {
    "radial-tangential": "opencv", "radtan": "opencv", "plumb_bob": "opencv", "equidistant": "fisheye", "none": None, None: None,
}  # fmt: skip


def matches(path: Path) -> bool:
    """True where a folder looks like a EuRoC recording, complete or not."""
    return (path / "mav0").is_dir() or (path / "cam0" / "data.csv").is_file()


def read(source: pairs.Source) -> tuple[Drive, list[Rejection]]:
    """The drive and its rejections."""
    settings = source.settings
    add_settings(source.content, source.root)
    names = _camera_names(settings)
    left, right = (_images(source, name) for name in names.values())
    rig, sensor_R_body = _read_rig(source)
    srid, track = _trajectory(source, sensor_R_body)
    couples = pairs.pair_by_stamp(left, right, settings.pair_tolerance_ns)
    poses_at = partial(pose_reader, track, max_gap_s=settings.max_pose_gap_s)
    return pairs.drive_of_couples(couples, names, source, rig, srid, poses_at)


def scan(path: Path, settings: DriveYaml) -> Files:
    """Images, times, calibrations and trajectories."""
    root = path.resolve()
    trajectories = [_stream_folder(root, name) for name in _trajectory_names(settings)]
    cameras = [_stream_folder(root, name) for name in _camera_names(settings).values()]
    left, right = (
        folder_stream(
            root, camera / "data", f"{camera.relative_to(root).as_posix()}/data", "expected the images of data.csv"
        )
        for camera in cameras
    )
    small = [camera / name for camera in cameras for name in ("data.csv", SENSOR_YAML)]
    small += [root / RIG_YAML, *(folder / SENSOR_YAML for folder in trajectories)]
    logs = [folder / "data.csv" for folder in trajectories]
    named, logged = ({file.relative_to(root).as_posix(): file for file in files} for files in (small, logs))
    return Files(left, right, named, logged)


def read_header(source: pairs.Source, header: HeaderFacts) -> None:
    """The times of the left images; calibration and trajectory must be there."""
    tables = [_stream_folder(source.root, name) / "data.csv" for name in _camera_names(source.settings).values()]
    left, _ = ([*_rows(table, source)] for table in tables)
    header.set_times([_stamp(words[0], "") for _, words in left], source.path / tables[0].relative_to(source.root))
    _read_rig(source)
    _trajectory_path(source.root, source.settings)


def _camera_names(settings: DriveYaml) -> dict[Side, str]:
    """Folders of both cameras: those named in drive.yaml, else EuRoC's own."""
    return {"left": settings.streams.left or "cam0", "right": settings.streams.right or "cam1"}


def _stream_folder(root: Path, name: str) -> Path:
    """Folder of a camera or a trajectory, beside the others. Raises InputError where it is not in the drive folder."""
    return inside(root, name, DRIVE_YAML, "mav0" if (root / "mav0").is_dir() else ".")


def _images(source: pairs.Source, name: str) -> list[pairs.Image]:
    """Images of one camera in the order of its data.csv."""
    root = source.root
    path = _stream_folder(root, name) / "data.csv"
    found: list[pairs.Image] = []
    for line, words in _rows(path, source):
        stamp = _stamp(words[0], f"{name}/data.csv, line {line}")
        file = words[1].strip() if len(words) > 1 else ""
        image = pairs.Image(stamp, path.parent / "data" / file)
        if not 0 < len(file.encode()) <= _LONGEST_NAME or "\0" in file or not image.path.resolve().is_relative_to(root):
            detail = f"{name}/data.csv, line {line}: {shown(file)} is not a file name inside the drive folder"
            image = pairs.Image(stamp, path, pairs.PairError(RejectionReason.IMAGE_MISSING, detail))
        found.append(image)
    return found


def _rows(path: Path, source: pairs.Source) -> Iterator[tuple[int, list[str]]]:
    """Line numbers and rows of a csv file, without empty ones and comments. Raises InputError."""
    name = path.relative_to(source.root).as_posix()
    remedy = "it has the times and names of the images"
    reader = csv.reader(source.content.lines(source.root, name, remedy, source.files.image_count))
    with library_errors(f"{path}: not a CSV file", csv.Error):
        for words in reader:
            if words and words[0].strip() and not words[0].lstrip().startswith("#"):
                yield reader.line_num, words


def _stamp(text: str, where: str) -> int | str:
    """UTC nanoseconds, or a text that says what is wrong."""
    word = text.strip()
    if word.isascii() and word.isdigit() and len(word) < 20 and 0 < int(word) < 2**63:
        return int(word)
    return f"{where}: {shown(word[:40])} is not a time stamp; expected nanoseconds since 1970"


def _read_rig(source: pairs.Source) -> tuple[Rig, Floats]:
    """The rectified rig and body_R (3, 3) of it in B. Raises InputError."""
    root, settings, content = source[1:4]
    given = own_rig(root / RIG_YAML, settings.pair)
    if given is not None:
        return rig_on_body(*given, settings, root / RIG_YAML)
    cameras: list[Camera] = []
    poses: list[Floats] = []
    for name in _camera_names(settings).values():
        path = _stream_folder(root, name) / SENSOR_YAML
        sensor = Node(path, read_yaml(path))
        content.add(f"{name}/{SENSOR_YAML}", read_bytes(path))
        cameras.append(sensor.pinhole_camera("distortion_coefficients", _LENSES))
        poses.append(sensor.at("T_BS").motion())
    rig = sensor.at("T_BS").stereo_rig("euroc", cameras[0], cameras[1], se3.compose(se3.invert(poses[1]), poses[0]))
    return rig_on_body(rig, poses[0], settings, path)


def _trajectory_names(settings: DriveYaml) -> Sequence[str]:
    """Folders that may hold a trajectory: the one named in drive.yaml, else those of EuRoC."""
    return [settings.streams.trajectory] if settings.streams.trajectory else TRAJECTORIES


def _trajectory_path(root: Path, settings: DriveYaml) -> Path:
    """The file of the trajectory. Raises InputError where there is none."""
    wanted = _trajectory_names(settings)
    path = next((p for name in wanted if (p := _stream_folder(root, name) / "data.csv").is_file()), None)
    if path is None:
        raise InputError(
            f"{root}: there is no trajectory: none of {', '.join(f'{name}/data.csv' for name in wanted)} exists; name its "
            "folder in drive.yaml (streams.trajectory)"
        )
    return path


def _trajectory(source: pairs.Source, sensor_R_body: Floats) -> tuple[int, Samples]:
    """EPSG code of the map and the poses of the body in it. Raises InputError."""
    root, settings, content = source[1:4]
    path = _trajectory_path(root, settings)
    sensor_path = path.parent / SENSOR_YAML
    B_SE3_S = np.eye(4)
    if sensor_path.is_file():
        content.add(sensor_path.relative_to(root).as_posix(), read_bytes(sensor_path))
        B_SE3_S = Node(sensor_path, read_yaml(sensor_path)).at("T_BS").motion()
    name = path.relative_to(root).as_posix()
    recorded = read_trajectory(path, settings.trajectory.model_copy(update={"format": "euroc"}))
    content.add_file(name, path)
    assert recorded.rotations is not None  # a EuRoC file without them has no valid record
    # Poses of B, whose axes are those of the IMU.
    R_SE3_B = se3.compose(se3.se3(recorded.rotations, recorded.positions), se3.invert(B_SE3_S))
    recorded = recorded._replace(name=name, rotations=R_SE3_B[:, :3, :3], positions=R_SE3_B[:, :3, 3])
    return placed(recorded, source, sensor_R_body)
