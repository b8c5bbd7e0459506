"""The map as the result of all drives, compared in the order of recording, whatever the order of ingestion.

`replay_drives` defines the map. A drive newer than all others around it is one more step (`apply_drive`). If a drive is late or
withdrawn, its neighbourhood is computed again, with the records of the other drives as `given`.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import compress, pairwise
from operator import attrgetter
from uuid import UUID

import numpy as np
from scipy.spatial import cKDTree

from conetl.geometry.packing import stack_rows
from conetl.mapping.agreement import check_agreement, check_marking_agreement, is_confirmed
from conetl.mapping.association import common_offset
from conetl.mapping.changes import reconcile
from conetl.mapping.deltas import ReconcileContext
from conetl.mapping.existence_update import miss_of, summarize_miss
from conetl.mapping.imported_maps import reconcile_imported
from conetl.mapping.markings import reconcile_markings
from conetl.mapping.visibility import NotObserved, ViewCheck, VisibilityCheck, empty_view
from conetl.model.arrays import Floats
from conetl.model.drive import Track
from conetl.model.health import HealthCheck
from conetl.model.map_records import (
    Classification,
    Decisions,
    Delta,
    DeltaKind,
    DriveOrder,
    FeatureVersion,
    ImportedFeature,
    Location,
    MapFeature,
    MissSummary,
)
from conetl.model.markings import MarkingTrack
from conetl.model.params import ReconcileParams

#: Least time between two versions of a feature: the database stores microseconds.
MIN_VALID_NS = 1000


@dataclass(frozen=True)
class DriveEvidence:
    """Everything that one drive, or one imported map, contributes to the map."""

    key: DriveOrder
    changeset_id: UUID
    founding_key: str
    """Map name and content hash of the drive; the ids of new features follow from it."""
    tracks: Sequence[Track]
    path_m: Floats
    """(N, 2) easting and northing of the body; of an imported map, of its cones."""
    influence_m: float
    """Features farther than this from the path are not compared."""
    check_visibility: VisibilityCheck
    params: ReconcileParams
    markings: Sequence[MarkingTrack] = ()
    check_view: ViewCheck = empty_view
    """What the drive had in view of lane markings."""
    imported: Sequence[ImportedFeature] = ()
    """Features of an imported map, instead of tracks; it removes nothing."""
    doubt: HealthCheck | None = None
    """Why the drive's position is in doubt: it goes on hold unless the map confirms it. None if it is not in doubt."""


@dataclass(frozen=True)
class MapUpdate:
    """What one drive changes on the map."""

    deltas: list[Delta]
    versions: list[FeatureVersion]
    """One per delta that changes a feature, open."""
    hold: HealthCheck | None = None
    """Why the drive contradicts the map and changes nothing until a person accepts it; None where it counts."""


@dataclass
class MapHistory:
    """The map in valid time."""

    chains: dict[UUID, list[FeatureVersion]] = field(default_factory=dict)
    """The versions of each feature, oldest first; the last one is open."""
    updates: dict[UUID, MapUpdate] = field(default_factory=dict)
    """By changeset, of the drives that were compared."""


def founding_key(id_name: str, content_sha256: str) -> str:
    """Seed for the ids of the features that a drive adds; the other part is their first observation."""
    return f"{id_name}/{content_sha256}"


def replay_drives(
    drives: Iterable[DriveEvidence],
    decisions: Decisions = Decisions(),  # noqa: B008 -- frozen
    *,
    given: Iterable[tuple[DriveOrder, FeatureVersion | MissSummary]] = (),
) -> MapHistory:
    """The map made by the drives; their order does not matter.

    given: versions and single misses of other drives, which are not compared again, with the keys of these drives. Their valid
    periods and suppression are recomputed.
    """
    history = MapHistory()
    current: dict[UUID, FeatureVersion] = {}
    summaries: dict[UUID, MissSummary] = {}
    events: list[tuple[DriveOrder, str, FeatureVersion | MissSummary | DriveEvidence]] = [
        *((key, str(state.feature_id), state) for key, state in given),
        *((drive.key, "", drive) for drive in drives),
    ]
    for _, _, event in sorted(events, key=lambda event: event[:2]):
        versions: list[FeatureVersion] = []
        misses: list[MissSummary] = []
        if isinstance(event, DriveEvidence):
            update = apply_drive(current, event, decisions, summaries, known=history.chains.keys())
            history.updates[event.changeset_id] = update
            versions = update.versions
            misses = [miss_of(delta) for delta in update.deltas if delta.kind is DeltaKind.MISSED]
        elif isinstance(event, MissSummary):
            misses = [event]
        else:
            suppressed = event.present and is_within(event.feature, decisions.suppressed)
            versions = [event.model_copy(update={"suppressed": suppressed})]
        for version in versions:
            history.chains.setdefault(version.feature_id, []).append(version)
            summaries.pop(version.feature_id, None)
            if version.present:
                current[version.feature_id] = version
            else:
                del current[version.feature_id]
        for miss in misses:
            summaries[miss.feature_id] = summarize_miss(summaries.get(miss.feature_id), miss)
    for chain in history.chains.values():
        ends: list[int | None] = [after.valid_from_ns for _, after in pairwise(chain)]
        chain[:] = [
            version if version.valid_to_ns == end else version.model_copy(update={"valid_to_ns": end})
            for version, end in zip(chain, [*ends, None], strict=True)
        ]
    return history


def apply_drive(
    current: Mapping[UUID, FeatureVersion],
    drive: DriveEvidence,
    decisions: Decisions,
    summaries: Mapping[UUID, MissSummary],
    *,
    known: Collection[UUID] = (),
) -> MapUpdate:
    """Compare one drive with the map after the drives recorded before it.

    current: open versions of present features, suppressed ones included, by feature id; those outside the drive's influence are
    ignored. summaries: misses since these versions. known: all ids in use, required for imported maps only. A version that would
    begin no later than its predecessor (drives that overlap in time) begins `MIN_VALID_NS` after it.
    """
    around, drive = _within_influence(current, drive), _apply_classes(drive, decisions.classified)
    points, lines = ([one for one in around if (one.marking is not None) == is_line] for is_line in (False, True))
    pinned = {feature.feature_id for feature in around if is_within(feature, decisions.pinned)}
    context = ReconcileContext(drive.params, drive.founding_key, pinned, summaries)
    if drive.imported:
        deltas = reconcile_imported(drive.imported, points, context, at_ns=drive.key[0], known=known)
    else:
        deltas = reconcile(drive.tracks, points, drive.check_visibility, context)
        line_deltas: list[Delta] = []
        if drive.markings or lines:
            offset = common_offset(sorted(drive.tracks, key=lambda track: track.members[0]), points, drive.params)
            line_deltas = reconcile_markings(drive.markings, lines, drive.check_view, context, offset=offset)
        hold = None
        if drive.changeset_id not in decisions.accepted:
            hold = None if is_confirmed(deltas, drive.key[0]) else drive.doubt
            hold = hold or check_agreement(drive.tracks, points, deltas, drive.params)
            hold = hold or check_marking_agreement(drive.markings, lines, line_deltas, drive.params)
        if hold is not None:
            return MapUpdate([], [], hold)
        if line_deltas:
            deltas = sorted([*deltas, *line_deltas], key=attrgetter("changed_at_ns", "feature_id.int"))
    versions = []
    for delta in deltas:
        if not delta.is_change:
            continue
        before = current.get(delta.feature_id)
        earliest_ns = delta.changed_at_ns if before is None else before.valid_from_ns + MIN_VALID_NS
        number = 1 if delta.old is None else delta.old.version + 1
        state = delta.state_after
        versions.append(
            FeatureVersion(
                feature=state if state.version == number else state.model_copy(update={"version": number}),
                changeset_id=drive.changeset_id,
                present=delta.new is not None,
                suppressed=delta.new is not None and is_within(state, decisions.suppressed),
                valid_from_ns=max(delta.changed_at_ns, earliest_ns),
                valid_to_ns=None,
            )
        )
    return MapUpdate(deltas, versions)


def _apply_classes(drive: DriveEvidence, decided: Sequence[Classification]) -> DriveEvidence:
    """The drive with the classes that people decided. Boxes keep theirs: absence is judged by the class that is detected."""
    if not decided:
        return drive

    def of(one: Track) -> Track:
        category = next((d.category for d in decided if d.found_as == one.category and is_within(one, [d])), None)
        return one if category is None else one.model_copy(update={"category": category})

    def check(feature: MapFeature, offset_m: Floats, others_m: Floats) -> NotObserved | None:
        found_as = next(
            (d.found_as for d in decided if d.category == feature.category and is_within(feature, [d])), None
        )
        if found_as is not None:
            feature = feature.model_copy(update={"category": found_as})
        return drive.check_visibility(feature, offset_m, others_m)

    return replace(drive, tracks=list(map(of, drive.tracks)), check_visibility=check)


def is_within(feature: MapFeature | Track, locations: Sequence[Location]) -> bool:
    """Whether a feature is at one of the locations (horizontally) of its kind."""
    if not locations:
        return False
    x, y, _ = feature.xyz_m
    is_line = isinstance(feature, MapFeature) and feature.marking is not None
    return any(
        one.of_line == is_line and float(np.hypot(x - one.xy_m[0], y - one.xy_m[1])) <= one.radius_m
        for one in locations
    )


def _within_influence(current: Mapping[UUID, FeatureVersion], drive: DriveEvidence) -> list[MapFeature]:
    """The features within the drive's influence, by feature id."""
    features = [current[feature_id].feature for feature_id in sorted(current, key=attrgetter("int"))]
    if not features:
        return []
    xy_m = stack_rows([feature.xyz_m for feature in features], 3)[:, :2]
    distances = np.atleast_1d(cKDTree(drive.path_m).query(xy_m)[0])
    return list(compress(features, (distances <= drive.influence_m).tolist()))
