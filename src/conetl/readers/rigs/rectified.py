"""Calibrations of data sets with rectified images, which have no lenses: KITTI's `calib.txt` and Middlebury's, read.

KITTI odometry and object (Geiger et al., CVPR 2012) have `P0` to `P3`: P_i = K [I | t_i] in the rectified frame of camera 0, so
camera i is at `-t_i`; P2 and P3 are the colour cameras. Poses of odometry are those of camera 0. The image size is in no file.
Middlebury (Scharstein et al., GCPR 2014) and ETH3D have `cam0`, `cam1`, [fx 0 cx; 0 fy cy; 0 0 1], and `baseline` in millimetres.
"""

from __future__ import annotations

import re

import numpy as np

from conetl.geometry import pose as se3
from conetl.model.arrays import Floats
from conetl.model.rig import Camera, Lens, Rig
from conetl.readers.rigs.common import Node, Pair, Size

#: Cameras of KITTI's projections by number, the colour pair first.
_PAIRS = (("P2", "P3"), ("P0", "P1"))


def read_projections_rig(file: Node, *, image_size: Size | None = None, pair: Pair | None = None) -> Rig:
    """Rig of two cameras of `P0` to `P3`; its body is the left one. pair: their numbers. Raises InputError."""
    if pair is not None:
        left, right = (f"P{re.sub(r'^.*?0?(?=[0-9]$)', '', name)}" for name in pair)
    else:
        left, right = next((names for names in _PAIRS if {*names} & file.value.keys()), _PAIRS[0])
    (left_camera, base_SE3_left), (right_camera, base_SE3_right) = (
        camera_of_projection(file.at(key), image_size) for key in (left, right)
    )
    right_SE3_left = se3.compose(se3.invert(base_SE3_right), base_SE3_left)
    return file.at(right).stereo_rig("kitti", left_camera, right_camera, right_SE3_left)


def camera_of_projection(node: Node, size: Size | None) -> tuple[Camera, Floats]:
    """Camera of a projection (3, 4) and its pose (4, 4) in the common frame."""
    p = node.numbers((3, 4))
    camera = node._replace(value=p[:, :3]).camera(size or _unstated(node), Lens())
    return camera, se3.se3(np.eye(3), -np.linalg.solve(p[:, :3], p[:, 3]))


def read_middlebury_rig(file: Node, *, image_size: Size | None = None) -> Rig:
    """Rig of `cam0` (left) and `cam1`. Raises InputError."""
    has_size = {"width", "height"} & file.value.keys()
    size = file.both("width", "height").size() if has_size else image_size or _unstated(file)
    left, right = (file.at(key).camera(size, Lens()) for key in ("cam0", "cam1"))
    baseline = file.at("baseline")
    pose = se3.se3(np.eye(3), np.array([-baseline.number(), 0.0, 0.0]))
    return baseline.stereo_rig("middlebury", left, right, pose, "mm")


def _unstated(file: Node) -> Size:
    raise file._replace(key="image size").bad(
        "is not in this file: state that of your images, conetl rig convert with --image-size 1241x376"
    )
