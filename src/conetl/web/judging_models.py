"""Answers for the review of changes: drives past a cone, frames with their boxes, and the review queue."""

from __future__ import annotations

from datetime import datetime
from typing import Literal
from uuid import UUID

from conetl.model.base import Matrix3, Vec3
from conetl.reports.drive_passes import DrivePass
from conetl.web.models import Answer, Box, Listing


class Passes(Listing):
    feature_id: UUID
    version: int
    """Whose position it is."""
    passes: list[DrivePass]
    """Latest drive first."""


class FrameBox(Box):
    match_index: int | None
    """null: without a stereo match."""
    range_m: float | None


class FrameView(Answer):
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


class Frame(Answer):
    drive_id: str
    drive_uuid: UUID
    frame_index: int
    captured_at: datetime
    origin_m: Vec3
    pixelated: bool
    """Images are pixelated outside detections."""
    left: FrameView
    right: FrameView


class Measured(Answer):
    """A health check that a drive did not pass."""

    name: str
    figures: str
    """What was measured, its sigma and its limit; empty if the recording does not show it."""
    detail: str


class ReviewItem(Answer):
    """What a person should review. Of held drives `feature_id`, `xyz_m` and `version` are null."""

    kind: Literal["held", "removal", "move", "doubtful"]
    changeset_no: int
    changeset_id: UUID | None
    """Of a held drive."""
    drive_id: str
    at: datetime
    """Since when a drive is on hold, or a change was true on the road."""
    why: str
    checks: list[Measured]
    feature_id: UUID | None
    version: int | None
    xyz_m: Vec3 | None
    existence_probability: float | None


class Review(Answer):
    origin_m: Vec3
    counts: dict[str, int]
    """Items by kind."""
    items: list[ReviewItem]
    """Held drives first, then removals (latest first), moves (largest first), doubtful cones (least certain first)."""
