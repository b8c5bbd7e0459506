"""What an ingest tells its user, as one validated record; the command line prints it, `--json` dumps it."""

from __future__ import annotations

from datetime import datetime
from typing import Literal
from uuid import UUID

from conetl.model.errors import EXIT_TOO_MANY_REJECTIONS, ConetlError
from conetl.model.map_records import DeltaKind
from conetl.model.records import Record, Vec3
from conetl.model.rejections import RejectionReason


class ChangeLine(Record):
    """One line of the table of changes."""

    kind: DeltaKind
    feature_id: UUID
    xyz_m: Vec3
    cone_height_m: float
    sigma_horizontal_m: float
    existence_probability: float
    observation_count: int
    shift_m: float | None


class IngestReport(Record):
    """Result of `ingest_drive`."""

    drive_id: str
    status: Literal["committed", "no changes"]
    """'no changes': the same drive with the same parameters and model is on the map already; nothing was written."""
    changeset_id: UUID
    captured_from: datetime
    captured_to: datetime
    map_name: str
    map_srid: int
    frame_pairs: int
    frame_pairs_rejected: int
    detections: int
    matches: int
    positions: int
    tracks: int
    counts: dict[DeltaKind, int]
    """Changes by kind; of a known drive, those that it made when it was committed."""
    changes: tuple[ChangeLine, ...]
    """What this run changed; empty for a known drive."""
    rejections: dict[RejectionReason, int]
    params_sha256: str
    model_sha256: str
    content_sha256: str
    """Of everything that was read of the drive folder."""
    seconds: float
    trajectory: str | None = None
    """What became of the logged poses, in a sentence; None of a known drive."""
    calibration: str | None = None
    """What the drive itself says of the rig's calibration, in a sentence; None of a known drive."""
    committed_at: datetime | None
    """When a known drive was committed; None for one that this run committed."""
    counts_on_map: bool = True
    """False for a known drive that was reverted, or whose recording was analysed again since."""
    unpublished: str | None = None
    """What could not be written or told after the commit, and what to do; None where all was."""
    replayed_drives: int = 0
    """Drives recorded later, already on the map, that were compared with it again because this one came late."""


class TooManyRejectionsError(ConetlError):
    """The good records were committed, but more frame pairs were refused than the parameters allow."""

    exit_code = EXIT_TOO_MANY_REJECTIONS

    def __init__(self, report: IngestReport, allowed_fraction: float) -> None:
        total = report.frame_pairs + report.frame_pairs_rejected
        super().__init__(
            f"{report.frame_pairs_rejected} of {total} frame pairs of drive {report.drive_id} were refused, allowed are "
            f"{allowed_fraction:.0%} (max_rejected_fraction). The good ones are on the map; see the table of rejections."
        )
        self.report = report
