"""Results of the map store: frozen values, times in UTC, lengths in metres of the map's CRS."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Literal
from uuid import UUID

from conetl.model.base import TICK, Record, utc_from_ns
from conetl.model.health import HealthCheck
from conetl.model.map_records import Classification, Delta, DeltaKind, FeatureVersion, Location, MapFeature


@dataclass(frozen=True)
class MapInfo:
    """One map; its SRID does not change once anything counts on it."""

    map_id: int
    map_name: str
    id_name: str
    """Name in the ids of its features: the one that the map had first."""
    srid: int
    vertical_srid: int | None
    """Height system in which exports state heights (EPSG); None: ellipsoidal."""
    last_committed_at: datetime | None
    counts: bool
    """False while all its drives are on hold or reverted."""


@dataclass(frozen=True)
class RunInfo:
    """The run that made a changeset, with its parameters in full."""

    run_id: UUID
    started_at: datetime
    params: Mapping[str, Any]
    flow_run_id: str | None = None
    facts: Mapping[str, Any] | None = None
    """Sentences about trajectory and calibration, and the identity of the code (`pipeline/commit.py`)."""


class ChangeCounts(Record):
    """Number of changes by kind; kinds without changes are left out."""

    points: Counter[DeltaKind]
    """Of point objects."""
    lines: Counter[DeltaKind]
    """Of stretches of lane markings."""


class ChangesetFacts(Record):
    """What the database and the web view state of a changeset."""

    changeset_no: int
    changeset_id: UUID
    drive_id: str
    """Of an import, the name of the map."""
    kind: Literal["drive", "import"]
    drive_uuid: UUID
    code_version: str
    committed_at: datetime
    effective_at: datetime
    """Instant of the database from which on its changes are on the map; later than the commit where it was on hold."""
    change_counts: ChangeCounts
    frame_pair_count: int
    detection_count: int
    track_count: int
    rejection_count: int
    counts: bool
    """False if the drive is on hold or was reverted, or a later analysis or delivery of the same recording replaced it."""
    hold: str | None
    """Why the drive is on hold; None unless it is."""


class CommittedChangeset(ChangesetFacts):
    """One changeset as the database holds it."""

    idempotency_key: str
    params_sha256: str
    model_sha256: str
    match_count: int
    position_count: int
    marking_count: int
    captured_from_ns: int
    captured_to_ns: int
    content_sha256: str
    expected_frame_count: int
    map_srid: int

    @property
    def valid_at(self) -> datetime:
        """An instant just after the drive: the map of this instant includes all changes by the drive."""
        return utc_from_ns(self.captured_to_ns) + TICK

    @property
    def lost_pairs(self) -> int:
        """Frame pairs of the recording that could not be used."""
        return self.expected_frame_count - self.frame_pair_count


@dataclass(frozen=True)
class MapInstant:
    """A state of a map: what was on the road at `valid_at`, as known at `known_at`; None: latest."""

    valid_at: datetime | None = None
    known_at: datetime | None = None


@dataclass(frozen=True)
class FeatureAtInstant:
    """A feature as it stood at an instant, with the valid period of that version."""

    feature: MapFeature
    valid_from: datetime
    valid_to: datetime | None
    """None while open."""
    changeset_id: UUID


@dataclass(frozen=True)
class DriveRef:
    """An active drive; in the order of recording."""

    drive_uuid: UUID
    changeset_id: UUID
    idempotency_key: str


StoredDeltas = Mapping[tuple[Any, ...], int]
"""Row ids of current deltas by the values of their columns from changeset_id to frames_empty."""


@dataclass(frozen=True)
class Replay:
    """What may change in a neighbourhood, before and after; the new deltas with their changesets."""

    versions_before: Mapping[FeatureVersion, int]
    """With their row ids."""
    deltas_before: StoredDeltas
    versions: Sequence[FeatureVersion]
    deltas: Sequence[tuple[UUID, Delta]]
    holds: Mapping[UUID, HealthCheck | None]
    """Why the drives that were compared again are on hold, by changeset; None of those that count."""


NOTHING = Replay({}, {}, (), (), {})
"""What a drive on hold changes."""


class DecisionFacts(Record):
    """What the database and the web view state of a decision."""

    decision_id: UUID
    kind: Literal["suppress", "pin", "classify", "approve", "revert", "accept", "hold"]
    radius_m: float | None
    """Of a suppressed or pinned area, and of one where the class is another one."""
    feature_id: UUID | None
    """The feature that the person selected."""
    changeset_id: UUID | None
    approves: UUID | None
    """Of approve: the changeset whose change of the feature is right."""
    of_line: bool
    """Of suppress and pin: whether it is about lane markings, else about point objects."""
    found_as: str | None
    """Of classify: the class that drives detect ..."""
    category: str | None
    """... and the one that the person gives it."""
    decided_by: str | None
    """None of a hold, and if no name was given."""
    decided_at: datetime


class StoredDecision(DecisionFacts):
    """A person's decision about a map, or the hold of a drive."""

    easting_m: float | None
    northing_m: float | None
    note: str

    @property
    def location(self) -> Location | None:
        """The location that it applies to, with the classes of a `classify`; None for a revert or an approval."""
        if self.easting_m is None or self.northing_m is None or self.radius_m is None:
            return None
        location = Location(xy_m=(self.easting_m, self.northing_m), radius_m=self.radius_m, of_line=self.of_line)
        if self.found_as is None or self.category is None:
            return location
        return Classification(**dict(location), found_as=self.found_as, category=self.category)


@dataclass(frozen=True)
class DecisionTarget:
    """A changeset that can be reverted, or a decision that can be withdrawn."""

    id: UUID
    kind: str
    """changeset, or the decision's kind."""
    drive_uuid: UUID | None
    """Of a changeset, and of the changeset that a decision reverts."""
    changeset_id: UUID | None
    active: bool
    """False for a decision that was withdrawn."""
