"""Poses of the two cameras of a rig on the body and in the map. Frames as in docs/reference/coordinates.md."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import numpy as np
from scipy.spatial.transform import Rotation

from conetl.geometry import camera as cameras
from conetl.geometry import pose as se3
from conetl.geometry.packing import as_rows
from conetl.model.arrays import Floats
from conetl.model.drive import Pose
from conetl.model.rig import CalibrationCovariance, Camera, Rig, Side


def camera_of(rig: Rig, side: Side) -> Camera:
    """The camera of one side."""
    return rig.left if side == "left" else rig.right


def body_SE3_camera(rig: Rig, side: Side) -> Floats:
    """(4, 4) pose of one camera on the body: lever arm and boresight."""
    return np.array(rig.body_SE3_left if side == "left" else rig.body_SE3_right)


def map_SE3_camera(pose: Pose, rig: Rig, side: Side) -> Floats:
    """(4, 4) exterior orientation of one camera."""
    return se3.compose(se3.map_SE3_body(pose), body_SE3_camera(rig, side))


def map_SE3_left(pose: Pose, rig: Rig) -> Floats:
    """(4, 4) exterior orientation of the left camera."""
    return map_SE3_camera(pose, rig, "left")


def left_SE3_right(rig: Rig) -> Floats:
    """(4, 4) relative orientation of the rig; its translation is the baseline vector in the left camera's frame."""
    return se3.compose(se3.invert(body_SE3_camera(rig, "left")), body_SE3_camera(rig, "right"))


def resized(rig: Rig, width_px: int, height_px: int) -> Rig:
    """The rig of the same images scaled to another size, each as a whole; its covariance is scaled with it.

    Edges map to edges, so a point u of the centre of pixels becomes s (u + 0.5) - 0.5. Raises ValueError for another aspect
    ratio: such images were cropped.
    """
    resized_cameras: dict[str, Camera] = {}
    factors: dict[str, float] = {}
    for side, camera in (("left", rig.left), ("right", rig.right)):
        sx, sy = width_px / camera.width_px, height_px / camera.height_px
        if abs(camera.width_px * sy - width_px) > 0.5:
            raise ValueError(
                f"images of {camera.width_px} x {camera.height_px} pixels cannot be scaled to {width_px} x {height_px}: another "
                "aspect ratio, so they were cropped; calibrate with such images"
            )
        resized_cameras[side] = camera.model_copy(update={
            "width_px": width_px, "height_px": height_px, "fx_px": sx * camera.fx_px, "fy_px": sy * camera.fy_px,
            "cx_px": sx * (camera.cx_px + 0.5) - 0.5, "cy_px": sy * (camera.cy_px + 0.5) - 0.5,
        })  # fmt: skip
        factors |= {f"{side}.{axis}_px": sx if "x" in axis else sy for axis in ("fx", "fy", "cx", "cy")}
    names = {"rig_id": f"{rig.rig_id}-{width_px}x{height_px}", "calibration_covariance": _scaled(rig, factors)}
    return rig.model_copy(update={**resized_cameras, **names})


def cropped(rig: Rig, x_px: int, y_px: int, width_px: int, height_px: int, *, binning: int = 1) -> Rig:
    """The rig of a part of the same images, each `binning` x `binning` pixels of it averaged to one.

    x_px, y_px: the first column and row of the part, negative where images were padded; width_px, height_px: its size before
    binning. The covariance is scaled. Raises ValueError for a part that is not within reach of the images.
    """
    size = width_px // binning, height_px // binning
    factors, parts = dict[str, float](), dict[str, Camera]()
    for side, camera in (("left", rig.left), ("right", rig.right)):
        outside = x_px + width_px <= 0 or y_px + height_px <= 0 or x_px >= camera.width_px or y_px >= camera.height_px
        if outside or min(size) < 1:
            raise ValueError(
                f"the part {x_px}, {y_px}, {width_px} x {height_px} is not one of {camera.width_px} x {camera.height_px} pixels"
            )
        parts[side] = camera.model_copy(update={
            "width_px": size[0], "height_px": size[1], "fx_px": camera.fx_px / binning, "fy_px": camera.fy_px / binning,
            "cx_px": (camera.cx_px - x_px + 0.5) / binning - 0.5, "cy_px": (camera.cy_px - y_px + 0.5) / binning - 0.5,
        })  # fmt: skip
        factors |= {f"{side}.{axis}_px": 1 / binning for axis in ("fx", "fy", "cx", "cy")}
    names = {
        "rig_id": f"{rig.rig_id}-{x_px},{y_px},{size[0]}x{size[1]}",
        "calibration_covariance": _scaled(rig, factors),
    }
    return rig.model_copy(update={**parts, **names})


def _scaled(rig: Rig, factors: Mapping[str, float]) -> CalibrationCovariance | None:
    """The covariance of the calibration of a rig whose constants change by these factors."""
    covariance = rig.calibration_covariance
    if covariance is None:
        return None
    scale = np.array([factors.get(name, 1.0) for name in covariance.names])
    return covariance.model_copy(update={"matrix": as_rows(np.array(covariance.matrix) * np.outer(scale, scale))})


@lru_cache(maxsize=8)  # of a drive's one rig, or of a few while it is calibrated, for every frame pair
def infinity_homography(rig: Rig) -> Floats:
    """(3, 3) from image points of infinitely far points in the left image to those in the right one. Cameras without a lens.

    Also from a right camera with the left one's interior orientation and axes to the right one.
    """
    right_R_left = left_SE3_right(rig)[:3, :3].T
    return np.asarray(cameras.matrix_k(rig.right) @ right_R_left @ np.linalg.inv(cameras.matrix_k(rig.left)))


def infinity_shift_px(rig: Rig, left_uv_px: Floats) -> Floats:
    """(..., 2) left minus right image point of an infinitely far point, at points (..., 2) of the left image.

    The difference of the principal points where the axes of a rectified rig are parallel; where the right camera is turned a
    little, as after self-calibration, it depends on the image point.
    """
    uv = np.asarray(left_uv_px, dtype=np.float64)
    matrix = infinity_homography(rig)
    in_right = uv @ matrix[:, :2].T + matrix[:, 2]
    return np.asarray(uv - in_right[..., :2] / in_right[..., 2:])


def right_camera_turned(rig: Rig, rotation_rad: Floats) -> Rig:
    """The rig with its right camera, and the one that took its images, turned by a rotation vector (3,) in the camera's frame.

    A small turn about x moves all rows of the right image down, about y all columns to the right.
    """
    own = body_SE3_camera(rig, "right")
    in_body = own[:3, :3] @ Rotation.from_rotvec(rotation_rad).as_matrix() @ own[:3, :3].T

    def turned(one: Rig) -> Rig:
        pose = body_SE3_camera(one, "right")
        pose[:3, :3] = in_body @ pose[:3, :3]
        return one.model_copy(update={"body_SE3_right": se3.to_matrix4(pose)})

    taken = rig.rectified_from
    return turned(rig).model_copy(update={"rectified_from": taken and turned(taken)})


def body_is_left_camera(rig: Rig) -> bool:
    """True if the rig has no body frame (no INS): then it is the left camera's."""
    return bool(np.allclose(body_SE3_camera(rig, "left"), np.eye(4), rtol=0.0, atol=1e-12))


def stored_R_camera(rig: Rig, side: Side) -> Floats:
    """(3, 3) rotation from one of the rig's cameras to the one that took the images: identity where they are used as they are."""
    if rig.rectified_from is None:
        return np.eye(3)
    return np.asarray(body_SE3_camera(rig.rectified_from, side)[:3, :3].T @ body_SE3_camera(rig, side)[:3, :3])


def up_in_left_camera(rig: Rig) -> Floats:
    """(3,) unit vector in the left camera's frame that is up when the body stands level.

    The body's +z where the rig has a body of its own, else minus the y axis of the camera that took the images (it is held
    level: rectification turns images, not cameras).
    """
    if body_is_left_camera(rig.rectified_from or rig):
        return np.array([0.0, -1.0, 0.0]) @ stored_R_camera(rig, "left")
    return np.asarray(body_SE3_camera(rig, "left")[2, :3].copy())
