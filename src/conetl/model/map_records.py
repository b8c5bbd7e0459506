"""The nouns of the map as frozen, validated records: features, their versions, and what drives and people did to them.

Units and frames as in `records.py`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from uuid import UUID

from pydantic import Field, model_validator

from conetl.model.records import Cov3, NonNegative, Positive, Probability, Record, SharedErrorJacobian, Vec2, Vec3


class MapFeature(Record):
    """The current version of one feature of the map."""

    feature_id: UUID
    version: int = Field(ge=1)
    category: str
    xyz_m: Vec3
    cov_m2: Cov3
    centre_xyz_m: Vec3
    cone_height_m: Positive
    cone_height_sigma_m: Positive
    existence_probability: Probability
    observation_count: int = Field(ge=1)
    first_seen_ns: int
    last_seen_ns: int
    shared_jacobian: SharedErrorJacobian | None = Field(default=None, exclude=True, repr=False)
    """What of `cov_m2` later drives of the same rig may share with it; None: nothing that is known. Left out of JSON."""


class DeltaKind(StrEnum):
    """What one drive did to one feature. Stored in the database; never rename one."""

    ADDED = "added"
    CONFIRMED = "confirmed"
    MOVED = "moved"
    REMOVED = "removed"
    MISSED = "missed"
    """Looked and not seen, but not surely enough to remove it: evidence only, the feature stays as it is."""
    HEIGHT_CHANGED = "height_changed"
    """A cone of another height class stands in the same place."""
    SPLIT = "split"
    """One feature turned out to be two cones: this is the second one."""
    MERGED = "merged"
    """Two features turned out to be one cone: this one is given up."""

    @property
    def founds(self) -> bool:
        """Whether a feature begins with it."""
        return self in (DeltaKind.ADDED, DeltaKind.SPLIT)

    @property
    def ends(self) -> bool:
        """Whether the feature is gone after it."""
        return self in (DeltaKind.REMOVED, DeltaKind.MERGED)


class SightingEvidence(Record):
    """How much one drive says for a feature or against it."""

    log_likelihood_ratio: float
    """ln p(what the drive saw | the cone stands there) / p(the same | it does not)."""
    existence_probability: Probability
    """Belief after it."""
    frames_seen: int = Field(ge=0)
    """Frame pairs in which it was seen."""
    frames_empty: int = Field(ge=0)
    """Frame pairs in which its spot was in view and no cone was found; counted only where the drive did not see it."""


class Delta(Record):
    """Old -> new of one feature. `new` is the feature after the drive; None where it was removed."""

    kind: DeltaKind
    feature_id: UUID
    old: MapFeature | None
    new: MapFeature | None
    track_index: int | None
    changed_at_ns: int
    """When this became true on the road, as far as the drive can tell."""
    shift_m: NonNegative | None
    """Horizontal distance between old and new place; None where there is only one."""
    other_feature_id: UUID | None = None
    """Of a split, the feature that was both; of a merger, the one that is left."""
    evidence: SightingEvidence | None = None
    """None where no belief was worked out: mergers, and what was written before it was kept."""

    @model_validator(mode="after")
    def _sides_fit_kind(self) -> Delta:
        wanted = (not self.kind.founds, not self.kind.ends)
        if (self.old is not None, self.new is not None) != wanted:
            raise ValueError(f"a delta of kind {self.kind} has old/new = {wanted}")
        return self

    @property
    def state_after(self) -> MapFeature:
        """The feature after the delta; the last state of one that was removed."""
        state = self.new or self.old
        if state is None:
            raise ValueError(f"the delta of feature {self.feature_id} has neither old nor new")
        return state

    @property
    def is_change(self) -> bool:
        """False for a miss, and a confirmation that leaves every stored value as it was: recorded, but no version."""
        if self.kind is DeltaKind.MISSED:
            return False
        if self.kind is not DeltaKind.CONFIRMED or self.old is None or self.new is None:
            return True
        new, old = self.new.__dict__, self.old.__dict__
        for name in _STATE:  # noqa: SIM110 -- asked of every delta, and half as long as any()
            if new[name] != old[name]:
                return True
        return False


#: All of a feature but its number, what a confirmation changes first.
_STATE = sorted(MapFeature.model_fields.keys() - {"version"}, key=lambda name: name != "observation_count")


class Statement(Record):
    """What a map that was made elsewhere says: here stands a cone, since when, and how sure that is."""

    feature: MapFeature
    """As the other map has it, version 1."""
    valid_from_ns: int
    """Since when it stands there."""


class FeatureChange(Record):
    """What differs of one feature between two states of a map; `confirmed`: the same place, known otherwise;
    `missed`: the same version, believed less."""

    kind: DeltaKind
    feature_id: UUID
    old: MapFeature | None
    new: MapFeature | None
    shift_m: NonNegative | None
    """Horizontal distance between old and new place; None for added and removed."""


class FeatureVersion(Record):
    """One version of one feature in valid time, as it is believed: what follows from a drive until the next drive changed it."""

    feature: MapFeature
    """Of a removed feature, its last state."""
    changeset_id: UUID
    """Of the drive that it follows from."""
    standing: bool
    """False where that drive removed it."""
    suppressed: bool
    """A person said that nothing stands at this place: it is on no map, but drives are still compared with it."""
    valid_from_ns: int
    valid_to_ns: int | None
    """None while open."""


class Miss(Record):
    """A drive looked at a feature's spot and did not see it; it stands all the same."""

    feature_id: UUID
    changeset_id: UUID
    version: int
    """That stood at the time."""
    existence_probability: Probability
    """After it."""
    first_missed_ns: int


class Doubt(Record):
    """What the misses since a feature's last version make of it."""

    existence_probability: Probability
    first_missed_ns: int
    """The earliest of them: from here on the cone may have been gone."""


#: Order in which drives are compared with the map: start of the recording (ns), hash of its content, idempotency key.
FoldKey = tuple[int, str, str]


class Place(Record):
    """A spot that a person decided about."""

    xy_m: Vec2
    radius_m: Positive


class Decisions(Record):
    """What people decided about places; it holds for all drives, whenever they come."""

    suppressed: tuple[Place, ...] = ()
    """Nothing stands there, whatever drives see."""
    pinned: tuple[Place, ...] = ()
    """A cone there is neither removed nor moved by drives."""


class Changeset(Record):
    """The atomic set of deltas of one drive, with everything needed to make it again."""

    changeset_id: UUID
    drive_id: str
    idempotency_key: str = Field(pattern=r"^[0-9a-f]{64}$")
    """Hash over the drive's content, the params, the model and the map's CRS."""
    params_sha256: str
    model_sha256: str
    code_version: str
    deltas: tuple[Delta, ...]


@dataclass(frozen=True)
class ImportedMap:
    """A map that was made elsewhere, read and checked."""

    name: str
    """Of the file; it stands where drives have their id."""
    source_path: str
    content_sha256: str
    srid: int
    stated_at_ns: int
    """The instant on the road for which it speaks (UTC)."""
    statements: Sequence[Statement]
    founds_ids: bool = False
    """The file brings no ids, or none that are wanted: those of the statements follow from file and row alone, and each map that
    takes it founds its own."""
