"""Rigs that are not quite what their calibration says."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from conetl.geometry import pose as se3
from conetl.geometry import rig as rigs
from conetl.model.rig import Rig


def wrong_rig(rig: Rig, step: NDArray[np.float64]) -> Rig:
    """The rig whose calibration is off by these errors of left.fx_px, right.cx_px, relative.ry_rad and relative.tx_m."""
    fx, cx, ry, tx = step.tolist()
    relative = rigs.left_SE3_right(rig)
    relative[:3, :3] = relative[:3, :3] @ Rotation.from_rotvec([0.0, ry, 0.0]).as_matrix()
    relative[0, 3] += tx
    return rig.model_copy(
        update={
            "left": rig.left.model_copy(update={"fx_px": rig.left.fx_px + fx}),
            "right": rig.right.model_copy(update={"cx_px": rig.right.cx_px + cx}),
            "body_SE3_right": se3.to_matrix4(se3.compose(rigs.body_SE3_camera(rig, "left"), relative)),
        }
    )
