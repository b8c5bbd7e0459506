"""Records of the map: features, their versions, and what drives and people changed. Units and frames as in `base.py`."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from uuid import UUID

from pydantic import Field, field_serializer, model_validator

from conetl.model.arrays import Floats
from conetl.model.base import Cov3, NonNegative, Positive, Probability, Record, SharedErrorJacobian, Vec2, Vec3
from conetl.model.markings import Marking

#: Not an option of a command, whatever stands before it.
MAP_NAME = re.compile(r"[a-z0-9_][a-z0-9_-]{0,39}")


class MapFeature(Record):
    """One version of one feature of the map."""

    feature_id: UUID
    version: int = Field(ge=1)
    category: str
    xyz_m: Vec3
    cov_m2: Cov3
    centre_xyz_m: Vec3
    object_height_m: Positive
    object_height_sigma_m: Positive
    existence_probability: Probability
    """After the last drive to which it was visible."""
    observation_count: int = Field(ge=1)
    seen_count: int = Field(default=0, ge=0)
    """Drives that observed it; imported maps do not count."""
    missed_count: int = Field(default=0, ge=0)
    """Drives to which it was visible and that did not observe it."""
    first_missed_ns: int | None = None
    """When the first of the drives that missed it since its last observation did: it may be gone since then. None: none did."""
    first_seen_ns: int
    last_seen_ns: int
    shared_jacobian: SharedErrorJacobian | None = Field(default=None, exclude=True, repr=False)
    """Part of `cov_m2` shared with later drives of the same rig; None where unknown. Not part of JSON."""
    marking: Marking | None = None
    """Shape of a line; `xyz_m` is the middle vertex then. None of point objects."""

    @field_serializer("object_height_m", "object_height_sigma_m")
    def _height(self, value: float) -> float | None:
        """A line has no height: the stored one is that of its paint."""
        return value if self.marking is None else None


class DeltaKind(StrEnum):
    """Kind of change of one feature by one drive. Stored in the database; never rename one."""

    ADDED = "added"
    CONFIRMED = "confirmed"
    MOVED = "moved"
    REMOVED = "removed"
    MISSED = "missed"
    """Not observed although visible, with too little evidence to remove it: the feature stays as it is."""
    HEIGHT_CHANGED = "height_changed"
    """A cone of another height class stands at the same position."""
    SPLIT = "split"
    """One feature turned out to be two cones; this is the second one."""
    MERGED = "merged"
    """Two features turned out to be one cone; this one ends."""

    @property
    def founds(self) -> bool:
        """Whether this kind creates a feature."""
        return self in (DeltaKind.ADDED, DeltaKind.SPLIT)

    @property
    def ends(self) -> bool:
        """Whether the feature is gone after it."""
        return self in (DeltaKind.REMOVED, DeltaKind.MERGED)


class ExistenceEvidence(Record):
    """Evidence of one drive for or against a feature."""

    log_likelihood_ratio: float
    """ln p(observations of the drive | the cone exists) / p(the same | it does not)."""
    existence_probability: Probability
    frames_seen: int = Field(ge=0)
    """Frame pairs in which it was observed."""
    frames_empty: int = Field(ge=0)
    """Frame pairs in which its location was visible and empty; 0 where the drive observed it."""


class _StateChange(Record):
    """One feature before and after a change; `old` is None for a new feature, `new` is None for one that is gone."""

    kind: DeltaKind
    feature_id: UUID
    old: MapFeature | None = None
    new: MapFeature | None = None

    @property
    def state_after(self) -> MapFeature:
        """The new state, or the last one of a feature that is gone."""
        state = self.new or self.old
        if state is None:
            raise ValueError(f"the change of feature {self.feature_id} has neither old nor new")
        return state

    @property
    def is_line(self) -> bool:
        """Whether the feature is a lane marking."""
        return self.state_after.marking is not None


class Delta(_StateChange):
    """What one drive changed, or confirmed, of one feature."""

    track_index: int | None = None
    changed_at_ns: int
    """When this became true on the road, as far as the drive shows."""
    shift_m: NonNegative | None = None
    other_feature_id: UUID | None = None
    """Of a split, the feature that was both cones; of a merger, the one that remains."""
    evidence: ExistenceEvidence | None = None
    """None for mergers, and for deltas stored before evidence was."""

    @model_validator(mode="after")
    def _sides_fit_kind(self) -> Delta:
        wanted = (not self.kind.founds, not self.kind.ends)
        if (self.old is not None, self.new is not None) != wanted:
            raise ValueError(f"a delta of kind {self.kind} has old/new = {wanted}")
        return self

    @property
    def is_change(self) -> bool:
        """False for a miss, and for a confirmation that leaves all stored values unchanged: the version keeps its number."""
        if self.kind is DeltaKind.MISSED:
            return False
        if self.kind is not DeltaKind.CONFIRMED or self.old is None or self.new is None:
            return True
        new, old = self.new.__dict__, self.old.__dict__
        return any(new[name] != old[name] for name in _STATE)


#: All fields of a feature but its version; first the one that a confirmation changes first.
_STATE = sorted(MapFeature.model_fields.keys() - {"version"}, key=lambda name: name != "observation_count")


class ImportedFeature(Record):
    """One feature of an imported map."""

    feature: MapFeature
    valid_from_ns: int
    stated_id: UUID | None = None
    """Feature id in the file, also where another one is used; None: it has none."""
    stated_version: int | None = None


class FeatureChange(_StateChange):
    """Difference of one feature between two states of a map, by the SQL function `feature_changes`."""

    shift_m: NonNegative | None
    changed_at: datetime | None
    """On the road; None if it is nowhere as known at the later state."""
    changeset_no: int
    """Of the changeset that made the later state, of a removed feature the last one."""
    drive_id: str


class FeatureVersion(Record):
    """One row of the history of a feature in valid time, in the current state of the database.

    A drive that does not observe a visible feature begins a new row of the same version: only the evidence has changed.
    """

    feature: MapFeature
    """Of a removed feature, its last state, with the evidence after the drive that removed it."""
    changeset_id: UUID
    """Of the drive that made the row."""
    present: bool
    """False where that drive removed it."""
    suppressed: bool
    """A person decided that no cone stands at this location: on no map, but still compared with drives."""
    version_from_ns: int
    """Beginning of the first row of this version."""
    valid_from_ns: int
    valid_to_ns: int | None

    @property
    def feature_id(self) -> UUID:
        return self.feature.feature_id

    @property
    def is_missed(self) -> bool:
        """Whether a drive that did not observe the feature made this row."""
        return self.feature.first_missed_ns is not None


class Miss(Record):
    """One drive to which a feature was visible did not observe it, and it stays on the map."""

    feature_id: UUID
    changeset_id: UUID
    existence_probability: Probability
    """After the drive."""
    missed_ns: int


#: Order in which drives are compared: start of the recording (ns), hash of its content, idempotency key.
DriveOrder = tuple[int, str, str]


class Location(Record):
    """A circle that a decision applies to."""

    xy_m: Vec2
    radius_m: Positive
    of_line: bool = False
    """Whether the decision is about lane markings; else it is about point objects."""


class Classification(Location):
    """What drives detect as `found_as` within the circle is a `category`."""

    found_as: str
    category: str


class Decisions(Record):
    """Decisions of people. Those about locations apply to all drives, earlier and later ones."""

    suppressed: tuple[Location, ...] = ()
    """No cone stands here, whatever drives observe."""
    pinned: tuple[Location, ...] = ()
    """A cone here is neither removed nor moved by drives."""
    classified: tuple[Classification, ...] = ()
    """Another class than the detector's."""
    accepted: frozenset[UUID] = frozenset()
    """Changesets of drives that count although they contradict the map."""


class Changeset(Record):
    """The atomic set of deltas of one drive, with everything needed to reproduce it."""

    changeset_id: UUID
    drive_id: str
    idempotency_key: str = Field(pattern=r"^[0-9a-f]{64}$")
    """Hash of drive content, parameters, model and map CRS."""
    params_sha256: str
    model_sha256: str
    code_version: str
    deltas: tuple[Delta, ...]


@dataclass(frozen=True)
class ImportedMap:
    """A map read from a file and checked."""

    name: str
    """Of the file; used in place of a drive id."""
    source_path: str
    content_sha256: str
    srid: int
    stated_at_ns: int
    """The instant on the road for which it is valid (UTC)."""
    statements: Sequence[ImportedFeature]
    classes: Mapping[str, int]
    """Number of statements of each category."""
    founds_ids: bool = False
    """True where the file has no ids, or they are not to be used: the ids follow from file and row, and each map that imports
    it assigns its own."""
    lines_left_out: int = 0
    """Lane markings in the file, which are not imported."""
    as_written: Floats | None = None
    """(N, 2): the first two coordinates of each statement in a file of projected coordinates, as they are written there."""
