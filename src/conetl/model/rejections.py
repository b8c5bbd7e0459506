"""Rejected records: an enum reason, a sentence, and the record itself."""

from __future__ import annotations

from enum import StrEnum
from typing import Any

from conetl.model.base import Record


class RejectionReason(StrEnum):
    """Why a record was rejected. The values are stored in the database; never rename one."""

    # frame pairs
    IMAGE_MISSING = "image_missing"
    IMAGE_UNREADABLE = "image_unreadable"
    IMAGE_TRUNCATED = "image_truncated"
    IMAGE_WRONG_SIZE = "image_wrong_size"
    IMAGE_FROZEN = "image_frozen"
    IMAGE_TORN = "image_torn"
    TIMESTAMP_MISSING = "timestamp_missing"
    TIMESTAMP_INVALID = "timestamp_invalid"
    POSE_MISSING = "pose_missing"
    POSE_INVALID = "pose_invalid"
    IMAGE_WITHOUT_DETAIL = "image_without_detail"
    # detections and matches
    DETECTION_INVALID = "detection_invalid"
    BOX_CUT_BY_BORDER = "box_cut_by_border"
    # positions
    RAY_ANGLE_TOO_SMALL = "ray_angle_too_small"
    BEHIND_CAMERA = "behind_camera"
    NOT_CONVERGED = "not_converged"
    RANGE_OUT_OF_BOUNDS = "range_out_of_bounds"
    RESIDUAL_TOO_LARGE = "residual_too_large"
    POSITION_INVALID = "position_invalid"
    # tracks
    HEIGHT_IMPLAUSIBLE = "height_implausible"
    NOT_ON_GROUND = "not_on_ground"
    TOO_FEW_OBSERVATIONS = "too_few_observations"
    NEVER_NEAR = "never_near"
    EXISTENCE_UNLIKELY = "existence_unlikely"
    MOVING = "moving"
    # images of a calibration board
    PARTNER_MISSING = "partner_missing"
    BOARD_NOT_FOUND = "board_not_found"
    BOARD_CUT = "board_cut"
    IMAGE_BLURRED = "image_blurred"
    BOARD_MISFIT = "board_misfit"


#: Reasons about delivered data (files, poses): such a frame pair is not used at all.
INPUT_REASONS = frozenset(
    {
        RejectionReason.IMAGE_MISSING,
        RejectionReason.IMAGE_UNREADABLE,
        RejectionReason.IMAGE_TRUNCATED,
        RejectionReason.IMAGE_WRONG_SIZE,
        RejectionReason.IMAGE_FROZEN,
        RejectionReason.IMAGE_TORN,
        RejectionReason.TIMESTAMP_MISSING,
        RejectionReason.TIMESTAMP_INVALID,
        RejectionReason.POSE_MISSING,
        RejectionReason.POSE_INVALID,
    }
)


#: Reasons that count for the exit code. A pair whose images show no detail is used, but it is not evidence that a cone is gone.
DOUBTFUL_REASONS = INPUT_REASONS | {RejectionReason.IMAGE_WITHOUT_DETAIL}


class Rejection(Record):
    """One rejected record, kept in quarantine."""

    step: str
    """The step that rejected it: frames, detections, matches, positions, tracks."""
    reason: RejectionReason
    record: str
    """Which record, so that a user can find it, e.g. 'frame pair 44' or 'image_03/data/0000000044.png'."""
    detail: str
    """What was found, what was expected, and what to do."""
    payload: dict[str, Any]
    """The record as far as it could be read; JSON-serialisable."""
