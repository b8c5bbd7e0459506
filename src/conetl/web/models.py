"""What the server answers: lengths in metres, places as offsets from the map's `origin_m`, times in UTC, covariances in m^2."""

from __future__ import annotations

from datetime import datetime
from typing import Literal
from uuid import UUID

from pydantic import BaseModel, ConfigDict

from conetl.model.map_records import DeltaKind
from conetl.model.records import Matrix3, Vec3

Cov2 = tuple[float, float, float]
"""xx, xy, yy on the ground."""
ChangeKind = DeltaKind | Literal["unchanged"]
"""What a drive did to a feature; between two instants, `unchanged` where it is the same version."""


class Answer(BaseModel):
    """Base of all answers."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class MapItem(Answer):
    map_name: str
    srid: int
    changeset_count: int
    feature_count: int
    last_committed_at: datetime | None


class Maps(Answer):
    maps: list[MapItem]
    chosen: str
    """The map that `conetl view` was started for."""


class TimelineItem(Answer):
    """One changeset: one drive."""

    changeset_no: int
    changeset_id: UUID
    drive_id: str
    drive_uuid: UUID
    captured_from: datetime
    captured_to: datetime
    valid_at: datetime
    """An instant just after the drive: the map of this instant shows all that the drive saw."""
    committed_at: datetime
    known_before: datetime
    """The last instant at which the database did not know of this changeset."""
    added_count: int
    confirmed_count: int
    moved_count: int
    removed_count: int
    missed_count: int
    height_changed_count: int
    split_count: int
    merged_count: int
    frame_pair_count: int
    detection_count: int
    track_count: int
    rejection_count: int
    code_version: str
    counts: bool
    """False where it was reverted, or a later analysis of the same recording took its place."""


class Timeline(Answer):
    map_name: str
    srid: int
    origin_m: Vec3
    changesets: list[TimelineItem]
    """Oldest first."""


class Feature(Answer):
    feature_id: UUID
    version: int
    category: str
    xyz_m: Vec3
    cov_m2: tuple[float, float, float, float, float, float]
    cone_height_m: float
    cone_height_sigma_m: float
    existence_probability: float
    observation_count: int
    first_seen_at: datetime
    last_seen_at: datetime
    valid_from: datetime
    valid_to: datetime | None
    seen_count: int
    """Drives that saw it until then."""
    missed_count: int
    """Drives that looked at its spot in vain."""


class Features(Answer):
    origin_m: Vec3
    features: list[Feature]
    truncated: bool
    """True where the map holds more features than one answer may."""


class Change(Answer):
    feature_id: UUID
    kind: ChangeKind
    changed_at: datetime | None
    shift_m: float | None
    old_xyz_m: Vec3 | None
    xyz_m: Vec3
    cov_m2: Cov2
    cone_height_m: float
    existence_probability: float
    observation_count: int
    version: int


class Changes(Answer):
    origin_m: Vec3
    changes: list[Change]
    truncated: bool


class HistoryItem(Answer):
    changeset_no: int
    drive_id: str
    drive_uuid: UUID
    captured_from: datetime
    """Beginning of the drive."""
    kind: DeltaKind
    changed_at: datetime
    committed_at: datetime
    version: int
    shift_m: float | None
    other_feature_id: UUID | None
    """Of a split, the feature that was both; of a merger, the one that is left."""
    frames_empty: int | None
    """Frame pairs of this drive that looked at its spot in vain; None where that was not kept."""
    category: str
    xyz_m: Vec3
    map_xyz_m: Vec3
    """Easting, northing, ellipsoidal height."""
    cov_m2: tuple[float, float, float, float, float, float]
    cone_height_m: float
    cone_height_sigma_m: float
    existence_probability: float
    observation_count: int
    first_seen_at: datetime
    last_seen_at: datetime
    sighting_count: int
    seen_count: int
    """Drives that saw the feature, up to this one on the road."""
    missed_count: int
    """Drives that looked at its spot in vain, up to this one."""


class FeatureHistory(Answer):
    feature_id: UUID
    origin_m: Vec3
    history: list[HistoryItem]
    """In the order of the drives on the road."""


class Box(Answer):
    x_px: float
    y_px: float
    w_px: float
    h_px: float
    score: float


class Sighting(Answer):
    changeset_no: int
    drive_id: str
    drive_uuid: UUID
    frame_index: int
    match_index: int
    captured_at: datetime
    xyz_m: Vec3
    """Where this one frame pair places the cone."""
    cov_m2: Cov2
    range_m: float
    residual_rms_px: float
    score: float
    camera_xyz_m: Vec3
    map_R_camera: Matrix3
    """Rows of the rotation from the left camera's axes (right, down, forward) to the map's."""
    corners: tuple[Vec3, Vec3, Vec3, Vec3]
    """Directions of the left picture's corners in the camera's frame at unit depth, clockwise from the top left."""
    left: Box
    right: Box


class Sightings(Answer):
    feature_id: UUID
    origin_m: Vec3
    sightings: list[Sighting]
    """Oldest first."""
    truncated: bool


class Trajectory(Answer):
    """The way of the left camera."""

    drive_id: str
    drive_uuid: UUID
    origin_m: Vec3
    frame_index: list[int]
    captured_at: list[datetime]
    xyz_m: list[Vec3]
    truncated: bool


class Decision(Answer):
    """What a person decided and nobody took back."""

    decision_id: UUID
    kind: Literal["suppress", "pin", "revert"]
    xy_m: tuple[float, float] | None
    """Of a suppressed or pinned place its middle; what lies within `radius_m` of it is meant."""
    radius_m: float | None
    feature_id: UUID | None
    """The feature that the person pointed at."""
    changeset_id: UUID | None
    drive_id: str | None
    """Drive of a reverted changeset."""
    decided_by: str | None
    reason: str
    decided_at: datetime


class Decisions(Answer):
    origin_m: Vec3
    writable: bool
    """True where this server takes decisions from holders of its writer token."""
    decisions: list[Decision]
    """Newest first."""
    truncated: bool


class Decided(Answer):
    """A decision that was written, and what followed from it."""

    decision_id: UUID
    kind: Literal["suppress", "pin", "revert", "withdraw"]
    decided_at: datetime
    versions_written: int
    replayed: int
    """Drives that were compared with the map again."""
    also_changed: list[UUID]
    """Of a reverted changeset: features that later drives changed too; what they saw is kept."""


class FoundFeatures(Answer):
    feature_ids: list[UUID]
    truncated: bool


class BaseLayer(Answer):
    layer_name: str
    kind: Literal["points", "lines"]
    files: int
    count: int


class BaseTile(Answer):
    """A square of points; its side is 4096 m / 2^level. A point is origin_m + steps * scale_m."""

    level: int
    points: int
    origin_m: Vec3
    scale_m: Vec3
    high_m: float
    sha256: str


class BaseLayers(Answer):
    origin_m: Vec3
    layers: list[BaseLayer]
    tiles: list[BaseTile]
    """Coarse levels first; tiles of all levels together are the cloud."""
    truncated: bool


class BaseLine(Answer):
    kind: str
    subtype: str | None
    xyz_m: list[float]
    """x, y, z of one vertex after the other."""


class BaseLines(Answer):
    origin_m: Vec3
    lines: list[BaseLine]
    truncated: bool


class Problem(Answer):
    """Every refusal."""

    detail: str


class Conflict(Problem):
    """A decision on what is not there any more."""

    now: HistoryItem | None
    """The feature's newest state; None where it is not believed in any more, or the decision was not about a feature."""
