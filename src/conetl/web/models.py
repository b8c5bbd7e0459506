"""Answers of the server: lengths in metres, positions as offsets from the map's `origin_m`, times in UTC, covariances in m^2."""

from __future__ import annotations

from datetime import datetime
from typing import Literal
from uuid import UUID

from conetl.db.map.results import ChangesetFacts, DecisionFacts
from conetl.model.base import Cov3, Matrix3, Record, Vec3
from conetl.model.map_records import DeltaKind
from conetl.model.markings import MarkingColour, MarkingPattern

Cov2 = tuple[float, float, float]
"""xx, xy, yy of the horizontal position."""


class Listing(Record):
    origin_m: Vec3
    truncated: bool
    """True if the response contains only a part of the items."""


class MapItem(Record):
    map_name: str
    srid: int
    changeset_count: int
    feature_count: int
    last_committed_at: datetime | None


class BaseMapItem(Record):
    """Tiles under the map, in the Web Mercator scheme of XYZ."""

    template: str
    """URL with {z}, {x} and {y} ({-y}: counted from the south)."""
    attribution: str
    max_zoom: int


class Maps(Record):
    maps: list[MapItem]
    chosen: str
    """The map with which `conetl view` was started."""
    basemap: BaseMapItem | None
    embeddable: bool
    """Another server's pages may show this one in a frame (CONETL_EMBED_HOST)."""


class NearTown(Record):
    label: str
    """Name and country."""
    xy_m: tuple[float, float]


class MapProjection(Record):
    """Polynomials between the map's CRS and WGS 84 within a square, accurate to 1 cm.

    With u, v = ((x, y) - centre_m) / radius_m, to_degrees gives ((lon, lat) - (lon_deg, lat_deg)) * unit_per_degree; to_metres is
    its inverse. Coefficients of u^i v^j with i + j <= degree, in the order of i, then j.
    """

    centre_m: list[float]
    """x, y as an offset from the map's origin."""
    radius_m: float
    """Half the side of the square."""
    lon_deg: float
    lat_deg: float
    degree: int
    unit_per_degree: list[float]
    """For longitude and for latitude."""
    to_degrees: list[list[float]]
    """Two lists: the coefficients of longitude and of latitude."""
    to_metres: list[list[float]]
    """Two lists: the coefficients of x and of y."""
    towns: list[NearTown]
    """Of 15,000 and more inhabitants, within 50 km of the centre (GeoNames, CC BY 4.0)."""


class TimelineItem(ChangesetFacts):
    """One changeset: one drive, or one imported map."""

    captured_from: datetime
    captured_to: datetime
    valid_at: datetime
    """An instant just after the drive: the map of this instant includes all changes by the drive."""
    known_before: datetime
    """The last instant of the database before `effective_at`."""


class Timeline(Record):
    map_name: str
    srid: int
    origin_m: Vec3
    changesets: list[TimelineItem]
    """Oldest first."""


class FeatureState(Record):
    version: int
    category: str
    xyz_m: Vec3
    object_height_m: float | None
    """Null for lane markings."""
    existence_probability: float
    observation_count: int
    last_seen_at: datetime
    changeset_no: int
    """Number of the changeset that wrote this version; in a history, of the changeset of the drive."""


class Feature(FeatureState):
    feature_id: UUID
    sigma_m: float
    """Standard deviation along the major axis of the horizontal error ellipse."""


class MarkingShape(Record):
    """Shape of a lane marking, or of a stretch of one."""

    line_m: list[Vec3]
    """Vertices of its centre line, in the direction of travel of the drive that first observed it."""
    width_m: float
    width_sigma_m: float
    colour: MarkingColour
    pattern: MarkingPattern
    dash_m: float | None
    gap_m: float | None
    sigma_lateral_m: float
    """Largest standard deviation across the line, of all vertices."""


class Stretch(Feature):
    """A stretch of a lane marking; its position is that of the middle vertex."""

    marking: MarkingShape


class Cluster(Record):
    """The features of one cell of a tile."""

    xyz_m: Vec3
    """Their mean position."""
    count: int
    categories: dict[str, int]
    """Number of each class."""


class FeatureTile(Record):
    """What stands in a square of the map: all features, or clusters."""

    origin_m: Vec3
    count: int
    """Number of features in the tile."""
    clusters: list[Cluster]
    features: list[Feature]
    markings: list[Stretch]


class Summary(Record):
    origin_m: list[float]
    """Easting, northing, height."""
    categories: dict[str, int]
    """Number of features of each class."""
    box_m: list[float] | None
    """West, south, east, north around them, as offsets from the origin; of the map now to 256 m. Null without features."""


class Change(Feature):
    kind: DeltaKind
    """Change by a drive, or difference between two instants."""
    changed_at: datetime | None
    shift_m: float | None
    old_xyz_m: Vec3 | None
    """Before a move; null for other kinds."""


class StretchChange(Change):
    marking: MarkingShape
    old_marking: MarkingShape | None


class FeaturePage(Record):
    origin_m: Vec3
    features: list[Feature]
    next: str | None
    """`after` of the next page; null: this is the last one."""


class ChangePage(Record):
    origin_m: Vec3
    changes: list[Change]
    next: str | None
    """`after` of the next page; null: this is the last one."""


class ListCount(Record):
    count: int
    index: int | None
    """At which row of the list `feature` is; null if it is not among them."""


class ChangeSummary(Record):
    kinds: dict[str, int]
    categories: dict[str, int]


class ChangeCluster(Record):
    """The changes of one cell."""

    xyz_m: Vec3
    """Their mean position."""
    kinds: dict[str, int]


class ChangesInView(Record):
    origin_m: Vec3
    kinds: dict[str, int]
    """Number of changes of each kind in the area."""
    listed: list[str]
    """Kinds whose changes follow one by one: all, or all but `confirmed`; none where there are clusters."""
    clusters: list[ChangeCluster]
    changes: list[Change]
    markings: list[StretchChange]


class HistoryItem(FeatureState):
    """Change of a feature by one drive: the version after the drive, and the evidence up to it."""

    cov_m2: Cov3
    object_height_sigma_m: float | None
    first_seen_at: datetime
    seen_count: int
    """Number of drives that observed it."""
    missed_count: int
    """Number of drives that did not observe it although it was visible."""
    drive_id: str
    drive_uuid: UUID
    captured_from: datetime
    """Beginning of the drive."""
    kind: DeltaKind
    changed_at: datetime
    committed_at: datetime
    shift_m: float | None
    other_feature_id: UUID | None
    """For a split, the feature that was split; for a merger, the feature that remains."""
    frames_empty: int | None
    """Number of frame pairs of this drive in which the feature was visible but not observed; null if unknown."""
    map_xyz_m: Vec3
    """Easting, northing, ellipsoidal height."""
    sighting_count: int
    marking: MarkingShape | None
    """Shape of a lane marking; null for point objects."""
    why: str
    """What happened, in one sentence with numbers."""


class FeatureHistory(Record):
    feature_id: UUID
    origin_m: Vec3
    history: list[HistoryItem]
    """In the order of recording."""


class Box(Record):
    x_px: float
    y_px: float
    w_px: float
    h_px: float
    score: float | None
    """None: the network found the object in the other image only."""


class Sighting(Record):
    changeset_no: int
    drive_id: str
    drive_uuid: UUID
    frame_index: int
    match_index: int
    captured_at: datetime
    xyz_m: Vec3
    """Position from this frame pair alone."""
    cov_m2: Cov2
    range_m: float
    residual_rms_px: float
    score: float
    camera_xyz_m: Vec3
    map_R_camera: Matrix3
    """Rows of the rotation from the left camera's axes (right, down, forward) to the map's."""
    corners: tuple[Vec3, Vec3, Vec3, Vec3]
    """Directions of the left image's corners in the camera's frame at unit depth, clockwise from the top left."""
    left: Box
    right: Box


class Sightings(Listing):
    feature_id: UUID
    sightings: list[Sighting]
    """Oldest first."""


class Trajectory(Listing):
    """The path of the left camera."""

    drive_id: str
    drive_uuid: UUID
    frame_index: list[int]
    captured_at: list[datetime]
    xyz_m: list[Vec3]


class Decision(DecisionFacts):
    """A decision in effect."""

    xy_m: tuple[float, float] | None
    """Centre of the area with the radius `radius_m`."""
    drive_id: str | None
    """Drive of a changeset that is reverted or on hold."""
    reason: str


class ActiveDecisions(Listing):
    writable: bool
    """True if this server accepts decisions: from this person, or from holders of its writer token."""
    person: str | None
    """Who is logged in by name; needs no writer token."""
    decides_drives: bool
    """Whether decisions about whole drives are accepted too."""
    decisions: list[Decision]
    """Newest first."""


class Decided(Record):
    """A decision that was written, and its effects."""

    decision_id: UUID
    kind: Literal["suppress", "pin", "classify", "approve", "revert", "accept", "withdraw"]
    decided_at: datetime
    versions_written: int
    replayed: int
    """Number of drives that were compared with the map again."""
    also_changed: list[UUID]
    """For a reverted changeset, features that later drives changed too; the observations of those drives are kept."""
    hold_changes: list[str]
    """One sentence for each drive that it put on hold or released."""
    report_problem: str | None
    """Why a report on disk could not be rewritten; null if all were. The decision is stored in any case."""


class FoundDrive(Record):
    changeset_no: int
    drive_id: str
    kind: Literal["drive", "import"]
    captured_from: datetime


class FoundPosition(Record):
    label: str
    """Name and country of a town, or how a coordinate pair was read."""
    xy_m: tuple[float, float]
    lat_lon_deg: tuple[float, float] | None
    """Null outside the area of the map's CRS."""


class SearchResult(Record):
    """All matches of a search text."""

    feature_ids: list[UUID]
    drives: list[FoundDrive]
    """Newest first."""
    positions: list[FoundPosition]
    towns: list[FoundPosition]
    truncated: bool
    """True if there are more cones or drives."""


class Problem(Record):
    """Body of every error response."""

    detail: str


class Conflict(Problem):
    """A decision about a state that has changed."""

    now: HistoryItem | None
    """Latest state of the feature; null if it no longer exists or the decision was not about a feature."""
