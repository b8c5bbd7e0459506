"""Answers about what people judge: passes of a feature, frame pairs with boxes, the review queue; units as in `models.py`."""

from __future__ import annotations

from datetime import datetime
from typing import Literal
from uuid import UUID

from conetl.model.base import Matrix3, Record, Vec3
from conetl.reports.drive_passes import DrivePass
from conetl.web.models import Box, Listing


class Passes(Listing):
    feature_id: UUID
    version: int
    """Version of the feature that has this position."""
    passes: list[DrivePass]
    """Latest drive first."""


class FrameBox(Box):
    match_index: int | None
    """Null if there is no stereo match."""
    range_m: float | None


class FrameView(Record):
    """One image of a frame pair, and its camera; rectified, without distortion."""

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    xyz_m: Vec3
    """Projection centre."""
    map_R_camera: Matrix3
    """Rows of the rotation from the camera's axes (right, down, forward) to the map's."""
    boxes: list[FrameBox]
    problem: str | None
    """Why there is no image; null if there is one."""


class Frame(Record):
    drive_id: str
    drive_uuid: UUID
    frame_index: int
    captured_at: datetime
    origin_m: Vec3
    pixelated: bool
    """Images are pixelated outside detections."""
    left: FrameView
    right: FrameView


class Measured(Record):
    """A health check that a drive did not pass."""

    name: str
    figures: str
    """Measured value, its sigma and its limit; empty if nothing could be measured."""
    detail: str


class ReviewItem(Record):
    """An item to review. For drives on hold, `feature_id`, `xyz_m` and `version` are null."""

    kind: Literal["held", "removal", "move", "doubtful"]
    changeset_no: int
    changeset_id: UUID | None
    """Only for a drive on hold."""
    drive_id: str
    at: datetime
    """Time at which the drive was put on hold, or from which the change was true on the road."""
    why: str
    checks: list[Measured]
    feature_id: UUID | None
    version: int | None
    xyz_m: Vec3 | None
    existence_probability: float | None
    category: str | None


class Review(Record):
    origin_m: Vec3
    counts: dict[str, int]
    """Number of items by kind."""
    items: list[ReviewItem]
    """Drives on hold first, then removals (latest first), moves (largest first), doubtful cones (least certain first)."""
