"""How a recording's own sensor frame becomes the body of a rig, and a rig its cameras' place on it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from conetl.geometry import geodesy
from conetl.geometry import pose as se3
from conetl.geometry import rig as rigs
from conetl.geometry.georeference import local_to_map, sensor_R_body
from conetl.model.errors import CalibrationError, DriveFolderError
from conetl.model.records import Rig
from conetl.readers.drives.content import ContentHash
from conetl.readers.drives.drive_yaml import DRIVE_YAML, DriveYaml, small_file
from conetl.readers.rigs import RIG_YAML, read_rig_yaml
from conetl.readers.rigs.common import rectified_rig

Array = NDArray[np.float64]


def rig_on_body(rig: Rig, sensor_SE3_left: Array, settings: DriveYaml, source: Path) -> tuple[Rig, Array]:
    """The rectified rig, and sensor_R_body (3, 3): the body is the sensor with its axes renamed to forward, left, up.

    rig: whatever its body, only cameras and their relative pose are used. sensor_SE3_left (4, 4): from camera points to points of
    the sensor that the trajectory is of. Raises CalibrationError.
    """
    turn = sensor_R_body(sensor_SE3_left[:3, :3])
    body_SE3_left = se3.compose(se3.se3(turn.T, np.zeros(3)), sensor_SE3_left)
    body_SE3_right = se3.compose(body_SE3_left, rigs.left_SE3_right(rig))
    changes: dict[str, object] = {
        "body_SE3_left": se3.to_matrix4(body_SE3_left),
        "body_SE3_right": se3.to_matrix4(body_SE3_right),
    }
    if "image_px" in settings.sigmas.model_fields_set:
        changes["sigma_px"] = settings.sigmas.image_px
    if settings.rig_id:
        changes["rig_id"] = settings.rig_id
    return rectified_rig(rig.model_copy(update=changes), source), turn


def own_rig(path: Path) -> tuple[Rig, Array] | None:
    """Rig of a rig.yaml that comes with the recording and wins over what it says itself, and its body_SE3_left; None without one.

    Raises CalibrationError where it does not tell how the left camera sits on the body.
    """
    if not path.is_file():
        return None
    rig = read_rig_yaml(path)
    if rigs.body_is_left_camera(rig):
        raise CalibrationError(
            f"{path}: 'body_SE3_left' is missing: R and t_m, from points of the left camera to points of the frame that the "
            "trajectory is of"
        )
    return rig, rigs.body_SE3_camera(rig, "left")


def add_settings(content: ContentHash, source: Path, names: tuple[str, ...] = (RIG_YAML, DRIVE_YAML)) -> None:
    """Small files of a drive, where they are, into its content hash, under their usual names."""
    for name in names:
        path = small_file(source, name)
        if path.is_file():
            content.add(name, path.read_bytes())


def georeferenced(
    settings: DriveYaml, map_srid: int | None, source: Path, what: str, local: Array
) -> tuple[int, Array]:
    """EPSG code of the map and map_SE3_sensor (N, 4, 4) of poses in a local frame (N, 4, 4).

    Raises DriveFolderError where drive.yaml does not say where that frame lies.
    """
    place = settings.georeference
    if place is None:
        raise DriveFolderError(
            f"{source}: {what} is in a frame of its own, and nothing says where on the earth that lies. Put into drive.yaml: "
            "'georeference: {lon_deg: ..., lat_deg: ..., height_m: ..., heading_deg: ...}', the place of its origin (ellipsoidal "
            "height) and the direction of its x axis, clockwise from true north"
        )
    try:
        srid = checked_srid(map_srid or settings.map_srid, place.lat_deg, place.lon_deg)
        return srid, local_to_map(srid, place.lat_deg, place.lon_deg, place.height_m, place.heading_deg, local)
    except ValueError as error:
        raise DriveFolderError(f"{source}: {error}") from error


def checked_srid(srid: int | None, lat_deg: float, lon_deg: float) -> int:
    """EPSG code of the map: the one given, or the UTM zone of the place. Raises ValueError for one that cannot be used there."""
    srid = srid or geodesy.utm_srid(lat_deg, lon_deg)
    geodesy.check_map_srid(srid)
    geodesy.check_scale(srid, lat_deg, lon_deg)
    return srid
