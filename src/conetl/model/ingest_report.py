"""Result of an ingest: printed by the command line, written by `--json`."""

from __future__ import annotations

from datetime import datetime
from typing import Literal
from uuid import UUID

from pydantic import Field

from conetl.model.base import Record, Vec3
from conetl.model.errors import EXIT_NEEDS_ATTENTION, ConetlError
from conetl.model.feature_classes import CONE
from conetl.model.health import HealthCheck, HoldChange, hold_remedy
from conetl.model.map_records import DeltaKind
from conetl.model.rejections import RejectionReason


class ChangeLine(Record):
    """One row of the table of changes."""

    kind: DeltaKind
    feature_id: UUID
    category: str = CONE
    xyz_m: Vec3
    object_height_m: float
    sigma_horizontal_m: float
    sigma_height_m: float
    existence_probability: float
    observation_count: int
    shift_m: float | None


class CommitReport(Record):
    """What one drive did to the map; result of `commit`."""

    drive_id: str
    status: Literal["committed", "held", "no changes"]
    """'held': stored, now or before, and on hold. 'no changes': this drive with these parameters and this model is
    already on the map; nothing was written."""
    changeset_id: UUID
    captured_from: datetime
    captured_to: datetime
    map_name: str
    map_srid: int
    frame_pairs: int
    frame_pairs_rejected: int
    frame_pairs_alike: int = 0
    """Frame pairs that this run left out because they show what others show; neither searched nor rejected."""
    detections: int
    matches: int
    positions: int
    tracks: int
    counts: dict[DeltaKind, int]
    """Of point objects."""
    line_counts: dict[DeltaKind, int] = Field(default_factory=dict)
    """Changes of stretches of lane markings, by kind."""
    markings: int = 0
    """Lane markings that the drive shows."""
    changes: tuple[ChangeLine, ...] = ()
    """Changes of point objects of this run; empty for a known drive."""
    rejections: dict[RejectionReason, int] = Field(default_factory=dict)
    """Rejected records of this run; empty for a known drive."""
    params_sha256: str
    model_sha256: str
    content_sha256: str
    trajectory: str | None = None
    """Outcome of the trajectory refinement, as a sentence; None for a known drive."""
    calibration: str | None = None
    """Outcome of the self-calibration, as a sentence; None for a known drive."""
    committed_at: datetime | None
    """None of a drive that was committed now."""
    counts_on_map: bool = True
    """False for a drive on hold, and for a known one that was reverted or analysed again."""
    not_counted: str | None = None
    """Why a known drive that is not on hold does not count, and what makes it count; None where it counts."""
    categories: tuple[str, ...] = ()
    """Classes that were searched for; empty for a known drive."""
    health: tuple[HealthCheck, ...] = ()
    """Checks of the recording, and of it against the map; of a known drive those for which it is on hold."""
    on_hold: str | None = None
    """Why the drive does not count until a person accepts it; None unless it is on hold."""
    hold_changes: tuple[HoldChange, ...] = ()
    """Other drives that went on hold because of this one, or are on hold no longer; empty for a known drive."""
    replayed_drives: int = 0
    """Later drives that were compared with the map again because this one came late."""

    @property
    def is_known(self) -> bool:
        """Whether the drive was already stored; then nothing was written."""
        return self.committed_at is not None


class IngestReport(CommitReport):
    """Result of `ingest`."""

    seconds: float
    """Until the commit."""
    unpublished: str | None = None
    """Files or notifications that failed after the commit, and what to do; None if all succeeded."""

    @property
    def remarks(self) -> tuple[str, ...]:
        """What a person has to check besides the drive itself: unpublished files, and other drives that went on hold."""
        others = [change.sentence for change in self.hold_changes if change.state == "on hold"]
        return (*([self.unpublished] if self.unpublished else ()), *others)


class NeedsAttentionError(ConetlError):
    """The drive was stored, but a person has to check it."""

    exit_code = EXIT_NEEDS_ATTENTION

    def __init__(self, report: IngestReport, message: str) -> None:
        super().__init__(message)
        self.report = report


class DriveOnHoldError(NeedsAttentionError):
    """The recording contradicts itself: it is stored and changes nothing on the map until a person accepts it."""

    def __init__(self, report: IngestReport) -> None:
        super().__init__(
            report,
            f"Drive {report.drive_id} is on hold and changes nothing on the map. {report.on_hold} "
            f"{hold_remedy(report.drive_id, report.map_name)}",
        )


class TooManyRejectionsError(NeedsAttentionError):
    """The good records were committed, but more frame pairs are unusable or show too little than the parameters allow."""

    def __init__(self, report: IngestReport, rejected: int, allowed_fraction: float) -> None:
        total = report.frame_pairs + report.frame_pairs_rejected
        blind = report.rejections.get(RejectionReason.IMAGE_WITHOUT_DETAIL, 0)
        cause = (
            f" The images of {blind} of them show too little detail: look for a covered lens, darkness, fog, blur or strong "
            "compression. What they show is on the map, but nothing is removed by them."
            if blind
            else ""
        )
        super().__init__(
            report,
            f"{rejected} of {total} frame pairs of drive {report.drive_id} were rejected or show too little, more than "
            f"{allowed_fraction:.0%} (max_rejected_fraction). The others are on the map.{cause}",
        )
