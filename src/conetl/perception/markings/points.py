"""Record of the points of lane markings that one frame pair shows."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from pydantic import Field, model_validator

from conetl.geometry.motion.stereo_tracks import PackedPoints
from conetl.model.arrays import Floats
from conetl.model.base import Record


class PointColumns(NamedTuple):
    """N points of lane markings, one array (N,) each. NaN in the heights of the road beside: not measured."""

    u_px: Floats
    """Middle of the paint in the left image ..."""
    v_px: Floats
    disparity_px: Floats
    """... against a right camera turned like the left one."""
    width_m: Floats
    """Along the row of the image: wider than the marking where that is not at a right angle."""
    contrast: Floats
    """Grey levels between paint and road."""
    blue: Floats
    """Logarithm of the ratio of paint to road in blue over that in green; 0 for white paint ..."""
    red: Floats
    """... and likewise of red over green."""
    above_left_m: Floats
    """Height above the road on the left of the paint ..."""
    above_right_m: Floats
    """... and on the right."""
    road_px: Floats
    """Disparity of the plane of the road behind the paint."""
    row: Floats
    """Which of the searched rows."""
    blur_px2: Floats
    """Variance of the Gaussian that blurs its edges along the row; scatters about the true one, and so may be negative."""


class MarkingPoints(Record):
    """Points of lane markings in one frame pair, and the rows that were searched for them."""

    frame_index: int = Field(ge=0)
    points: PackedPoints = b""
    """(N, 12) numbers, the columns of `PointColumns`."""
    rows: PackedPoints = b""
    """(R, 2): row of the left image (px) and depth of the road there (m), the nearest first."""

    @model_validator(mode="after")
    def _whole(self) -> MarkingPoints:
        if len(self.points) % (8 * len(PointColumns._fields)) or len(self.rows) % 16:
            raise ValueError("points or rows are not whole")
        return self

    def columns(self) -> PointColumns:
        """All points: one array (N,) per column."""
        return PointColumns(*np.frombuffer(self.points, "<f8").reshape(-1, len(PointColumns._fields)).T)

    def searched(self) -> Floats:
        """As `rows`, (R, 2)."""
        return np.frombuffer(self.rows, "<f8").reshape(-1, 2)
