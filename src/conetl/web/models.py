"""Answers of the server: lengths in metres, positions as offsets from the map's `origin_m`, times in UTC, covariances in m^2."""

from __future__ import annotations

from datetime import datetime
from typing import Literal
from uuid import UUID

from conetl.db.map.results import ChangesetFacts, DecisionFacts
from conetl.model.base import Cov3, Matrix3, Record, Vec3
from conetl.model.map_records import DeltaKind
from conetl.model.markings import MarkingColour, MarkingPattern
from conetl.reports.drive_passes import DrivePass

Cov2 = tuple[float, float, float]
"""xx, xy, yy on the ground."""
ChangeKind = DeltaKind | Literal["unchanged"]
"""What a drive did to a feature; between two instants, `unchanged` for the same version."""


class Listing(Record):
    origin_m: Vec3
    truncated: bool
    """True if the map has more than one answer can hold."""


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


class MapProjection(Record):
    """Polynomials between the map's CRS and WGS 84 within a square, exact to 1 cm.

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
    """Of longitude and latitude."""
    to_degrees: list[list[float]]
    """Two lists: the coefficients of longitude and of latitude."""
    to_metres: list[list[float]]
    """Two lists: those of x and of y."""


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
    cone_height_m: float
    existence_probability: float
    observation_count: int
    last_seen_at: datetime
    changeset_no: int
    """Of the changeset that wrote this version; in a history, of the drive."""


class Feature(FeatureState):
    feature_id: UUID
    sigma_m: float
    """Along the major axis of the horizontal error ellipse."""


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
    """Across the line, of the vertex with the largest one."""


class Stretch(Feature):
    """A stretch of a lane marking; its position is that of the middle vertex."""

    marking: MarkingShape


class Features(Listing):
    features: list[Feature]
    markings: list[Stretch]


class Change(Feature):
    kind: ChangeKind
    changed_at: datetime | None
    shift_m: float | None
    old_xyz_m: Vec3 | None


class StretchChange(Change):
    marking: MarkingShape
    old_marking: MarkingShape | None


class Changes(Listing):
    changes: list[Change]
    markings: list[StretchChange]


class HistoryItem(FeatureState):
    """What one drive did to a feature: the version after it, and the evidence up to it."""

    cov_m2: Cov3
    cone_height_sigma_m: float
    first_seen_at: datetime
    seen_count: int
    """Drives that observed it."""
    missed_count: int
    """Drives that did not observe it although it was visible."""
    drive_id: str
    drive_uuid: UUID
    captured_from: datetime
    """Beginning of the drive."""
    kind: DeltaKind
    changed_at: datetime
    committed_at: datetime
    shift_m: float | None
    other_feature_id: UUID | None
    """Of a split, the feature that was both; of a merger, the one that remains."""
    frames_empty: int | None
    """Frame pairs of this drive without an observation although the feature was visible; None if unknown."""
    map_xyz_m: Vec3
    """Easting, northing, ellipsoidal height."""
    sighting_count: int
    marking: MarkingShape | None
    """Of a lane marking; None of point objects."""
    why: str
    """What happened, in one sentence with numbers."""


class FeatureHistory(Record):
    feature_id: UUID
    origin_m: Vec3
    history: list[HistoryItem]
    """In the order of the drives on the road."""


class Box(Record):
    x_px: float
    y_px: float
    w_px: float
    h_px: float
    score: float


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
    """True if this server accepts decisions from holders of its writer token."""
    decisions: list[Decision]
    """Newest first."""


class Decided(Record):
    """A decision that was written, and its effects."""

    decision_id: UUID
    kind: Literal["suppress", "pin", "classify", "revert", "accept", "withdraw"]
    decided_at: datetime
    versions_written: int
    replayed: int
    """Drives that were compared with the map again."""
    also_changed: list[UUID]
    """Of a reverted changeset: features that later drives changed too; their observations are kept."""
    hold_changes: list[str]
    """Drives that it put on hold or released, a sentence each."""
    report_problem: str | None
    """Why a QA report on disk could not be written again; null if nothing failed. The decision is stored in any case."""


class FoundDrive(Record):
    changeset_no: int
    drive_id: str
    kind: Literal["drive", "import"]
    captured_from: datetime


class FoundPosition(Record):
    label: str
    """Name of a place, or how a coordinate pair was read."""
    xy_m: tuple[float, float]
    lat_lon_deg: tuple[float, float] | None
    """None outside the area of the map's CRS."""


class SearchResult(Record):
    """What a searched text may mean."""

    feature_ids: list[UUID]
    drives: list[FoundDrive]
    """Newest first."""
    positions: list[FoundPosition]
    places: list[FoundPosition]
    truncated: bool
    """True if there are more cones or drives."""


class BaseLayer(Record):
    layer_name: str
    kind: Literal["points", "lines"]
    files: int
    count: int


class BaseTile(Record):
    """A square of points with a side of 4096 m / 2^level. A point is origin_m + steps * scale_m."""

    level: int
    points: int
    origin_m: Vec3
    scale_m: Vec3
    high_m: float
    sha256: str


class BaseLayers(Listing):
    layers: list[BaseLayer]
    tiles: list[BaseTile]
    """Coarse levels first; the tiles of all levels together are the whole cloud."""


class BaseLine(Record):
    kind: str
    subtype: str | None
    xyz_m: list[float]
    """x, y, z of one vertex after the other."""


class BaseLines(Listing):
    lines: list[BaseLine]


class ProvisionalFeature(Record):
    """A cone of a drive that is being recorded, or that was recorded and is not ingested yet; not part of the map."""

    drive_id: str
    feature_index: int
    """Number within its drive; it stays the same while the drive is watched."""
    is_watched: bool
    """False: its watch has ended, and its drive is not ingested yet."""
    xyz_m: Vec3
    cov_m2: Cov2
    cone_height_m: float
    existence_probability: float
    observation_count: int
    last_seen_at: datetime
    near_feature_id: UUID | None
    """The standing feature nearby that it may be."""


class ProvisionalFeatures(Listing):
    features: list[ProvisionalFeature]


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
    """What was measured, its sigma and its limit; empty if the recording does not show it."""
    detail: str


class ReviewItem(Record):
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


class Review(Record):
    origin_m: Vec3
    counts: dict[str, int]
    """Items by kind."""
    items: list[ReviewItem]
    """Held drives first, then removals (latest first), moves (largest first), doubtful cones (least certain first)."""


class Problem(Record):
    """Every error."""

    detail: str


class Conflict(Problem):
    """A decision about a state that has changed."""

    now: HistoryItem | None
    """The feature's newest state; None if it is gone or the decision was not about a feature."""
