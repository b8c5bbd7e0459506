"""The rig of a recording: its rig.yaml or its own calibration, on the body whose trajectory was recorded."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from conetl.geometry import pose as se3
from conetl.geometry import rig as rigs
from conetl.geometry.geodesy import sensor_R_body
from conetl.model.errors import CalibrationError
from conetl.model.records import Rig
from conetl.readers.drives.content import ContentHash
from conetl.readers.drives.drive_yaml import DRIVE_YAML, DriveYaml, small_file
from conetl.readers.rigs import RIG_YAML, read_rig_yaml
from conetl.readers.rigs.common import rectified_rig

Array = NDArray[np.float64]


def rig_on_body(rig: Rig, sensor_SE3_left: Array, settings: DriveYaml, source: Path) -> tuple[Rig, Array]:
    """The rectified rig, and sensor_R_body (3, 3): the body is the sensor with its axes renamed to forward, left, up.

    rig: only its cameras and their relative pose are used. sensor_SE3_left (4, 4): from points of the left camera to points of
    the sensor whose trajectory was recorded. Raises CalibrationError.
    """
    turn = sensor_R_body(sensor_SE3_left[:3, :3])
    body_SE3_left = se3.compose(se3.se3(turn.T, np.zeros(3)), sensor_SE3_left)
    body_SE3_right = se3.compose(body_SE3_left, rigs.left_SE3_right(rig))
    poses = {"body_SE3_left": se3.to_matrix4(body_SE3_left), "body_SE3_right": se3.to_matrix4(body_SE3_right)}
    return rectified_rig(rig.model_copy(update=poses | overrides(settings)), source), turn


def overrides(settings: DriveYaml) -> dict[str, object]:
    """Fields of the rig that drive.yaml overrides."""
    changes: dict[str, object] = {"rig_id": settings.rig_id} if settings.rig_id else {}
    return changes | ({"sigma_px": settings.sigmas.image_px} if "image_px" in settings.sigmas.model_fields_set else {})


def own_rig(path: Path) -> tuple[Rig, Array] | None:
    """Rig of a rig.yaml beside the recording, which overrides the recording's own calibration, and its body_SE3_left.

    None without the file. Raises CalibrationError where the file has no pose of the left camera on the body.
    """
    if not path.is_file():
        return None
    rig = read_rig_yaml(path)
    if rigs.body_is_left_camera(rig):
        raise CalibrationError(
            f"{path}: 'body_SE3_left' is missing: R and t_m, from points of the left camera to points of the body whose "
            "trajectory was recorded"
        )
    return rig, rigs.body_SE3_camera(rig, "left")


def add_settings(content: ContentHash, source: Path, names: tuple[str, ...] = (RIG_YAML, DRIVE_YAML)) -> None:
    """Add the small files of a drive to its content hash, under their usual names."""
    for name in names:
        path = small_file(source, name)
        if path.is_file():
            content.add(name, path.read_bytes())
