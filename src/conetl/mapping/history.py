"""The map as the result of all drives, compared in the order of recording, whatever the order of ingestion.

`replay_drives` defines the map. A drive newer than all others around it is one more step (`apply_drive`). If a drive is late or
withdrawn, its neighbourhood is computed again, with the records of the other drives as `given`.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import compress
from operator import attrgetter
from typing import NamedTuple
from uuid import UUID

import numpy as np
from scipy.spatial import cKDTree

from conetl.geometry.packing import stack_rows
from conetl.mapping.agreement import check_agreement, check_marking_agreement, is_confirmed
from conetl.mapping.association import common_offset
from conetl.mapping.changes import reconcile
from conetl.mapping.contradiction import find_contradiction
from conetl.mapping.deltas import ReconcileContext
from conetl.mapping.existence_update import ended, missed
from conetl.mapping.imported_maps import reconcile_imported
from conetl.mapping.markings import reconcile_markings
from conetl.mapping.visibility import NotObserved, ViewCheck, VisibilityCheck, empty_view
from conetl.model.arrays import Floats
from conetl.model.drive import Track
from conetl.model.health import Finding, HealthCheck, hold_checks
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
    Miss,
)
from conetl.model.markings import MarkingTrack
from conetl.model.params import ReconcileParams

#: Least time between two versions of a feature: the database stores microseconds.
MIN_VALID_NS = 1000


class Doubt(NamedTuple):
    """Why a drive may lie in the wrong place."""

    finding: Finding
    """Why it goes on hold, unless the map confirms it or one of the drives that it continues."""
    continues: frozenset[UUID]
    """Changesets of the drives that it continues, before and after it."""


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
    judge: Callable[[Finding], HealthCheck]
    """Gives the verdict on what contradicts the drive: `checks.verdict.judge`."""
    markings: Sequence[MarkingTrack] = ()
    check_view: ViewCheck = empty_view
    """What the drive had in view of lane markings."""
    imported: Sequence[ImportedFeature] = ()
    """Features of an imported map, instead of tracks; it removes nothing."""
    doubt: Doubt | None = None
    """None if nothing contradicts the drive's position."""


@dataclass(frozen=True)
class MapUpdate:
    """What one drive changes on the map."""

    deltas: list[Delta]
    versions: list[FeatureVersion]
    """One per delta that changes a feature or the evidence for it, open."""
    hold: HealthCheck | None = None
    """Why the drive contradicts the map and changes nothing until a person accepts it; None where it counts."""
    widened: HealthCheck | None = None
    """Why the sigmas of drive and map were enlarged; None where they were not."""


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
    given: Iterable[tuple[DriveOrder, FeatureVersion | Miss]] = (),
) -> MapHistory:
    """The map made by the drives; their order does not matter.

    given: versions and misses of other drives, which are not compared again, with the keys of these drives. Their valid periods
    and suppression are recomputed. Of drives in doubt that continue each other, the map that the first of them finds decides
    which it confirms: all are judged there, once.
    """
    history, drives = MapHistory(), list(drives)
    current: dict[UUID, FeatureVersion] = {}
    in_doubt = {drive.changeset_id: drive for drive in drives if drive.doubt is not None}
    confirmed: dict[UUID, bool] = {}
    events: list[tuple[DriveOrder, str, FeatureVersion | Miss | DriveEvidence]] = [
        *((key, str(state.feature_id), state) for key, state in given),
        *((drive.key, "", drive) for drive in drives),
    ]
    for _, _, event in sorted(events, key=lambda event: event[:2]):
        versions: list[FeatureVersion] = []
        if isinstance(event, DriveEvidence):
            if event.doubt is not None:
                together = {event.changeset_id, *event.doubt.continues} & in_doubt.keys()
                confirmed |= {one: _confirms(in_doubt[one], current, decisions) for one in together - confirmed.keys()}
            known_right = event.doubt is not None and any(confirmed.get(one) for one in event.doubt.continues)
            drive = replace(event, doubt=None) if known_right else event
            update = apply_drive(current, drive, decisions, known=history.chains.keys())
            history.updates[event.changeset_id] = update
            versions = update.versions
        elif isinstance(event, Miss):
            if (before := current.get(event.feature_id)) is not None:
                state = missed(before.feature, event.existence_probability, event.missed_ns)
                versions = [_next_row(before, state, event.changeset_id, event.missed_ns, decisions)]
        else:
            suppressed = event.present and is_within(event.feature, decisions.suppressed)
            versions = [event.model_copy(update={"suppressed": suppressed})]
        for version in versions:
            chain = history.chains.setdefault(version.feature_id, [])
            chain[:] = extended(chain, version)
            if version.present:
                current[version.feature_id] = version
            else:
                del current[version.feature_id]
    return history


def extended(chain: Sequence[FeatureVersion], row: FeatureVersion) -> list[FeatureVersion]:
    """The rows of a feature after one more, without the misses that it precedes on the road: a removal begins with the first."""
    begins_us = row.valid_from_ns // 1000  # as the database stores it
    kept = [one for one in chain if not one.is_missed or one.valid_from_ns // 1000 < begins_us]
    if kept and kept[-1].valid_to_ns != row.valid_from_ns:
        kept[-1] = kept[-1].model_copy(update={"valid_to_ns": row.valid_from_ns})
    return [*kept, row if row.valid_to_ns is None else row.model_copy(update={"valid_to_ns": None})]


def apply_drive(
    current: Mapping[UUID, FeatureVersion],
    drive: DriveEvidence,
    decisions: Decisions,
    *,
    known: Collection[UUID] = (),
) -> MapUpdate:
    """Compare one drive with the map after the drives recorded before it.

    current: open versions of present features, suppressed ones included, by feature id; those outside the drive's influence are
    ignored. known: all ids in use, required for imported maps only. A row that would begin no later than the version before it
    (drives that overlap in time) begins `MIN_VALID_NS` after it.
    """
    around, drive = _within_influence(current, drive), _apply_classes(drive, decisions.classified)
    points, lines = ([one for one in around if (one.marking is not None) == is_line] for is_line in (False, True))
    pinned = {feature.feature_id for feature in around if is_within(feature, decisions.pinned)}
    context = ReconcileContext(drive.params, drive.founding_key, pinned)
    if drive.imported:
        deltas = reconcile_imported(drive.imported, points, context, at_ns=drive.key[0], known=known)
    else:
        contradiction = find_contradiction(drive.tracks, points, drive.params)
        context = context._replace(contradiction=contradiction)
        deltas = reconcile(drive.tracks, points, drive.check_visibility, context)
        line_deltas: list[Delta] = []
        if contradiction is None and (drive.markings or lines):
            offset = common_offset(sorted(drive.tracks, key=lambda track: track.members[0]), points, drive.params)
            line_deltas = reconcile_markings(drive.markings, lines, drive.check_view, context, offset=offset)
        if drive.changeset_id not in decisions.accepted:
            tracks = drive.tracks if contradiction is None else list(map(contradiction.on_map, drive.tracks))
            is_sure = contradiction is None and is_confirmed(deltas, drive.key[0])
            found = None if drive.doubt is None or is_sure else drive.doubt.finding
            found = found or check_agreement(tracks, points, deltas, drive.params)
            if contradiction is None:
                found = found or check_marking_agreement(drive.markings, lines, line_deltas, drive.params)
            for hold in hold_checks([] if found is None else [drive.judge(found)]):
                return MapUpdate([], [], hold)
        if line_deltas:
            deltas = sorted([*deltas, *line_deltas], key=attrgetter("changed_at_ns", "feature_id.int"))
    widened = None if context.contradiction is None else drive.judge(context.contradiction.finding)
    return MapUpdate(deltas, next_rows(deltas, current, drive.changeset_id, decisions), widened=widened)


def _confirms(drive: DriveEvidence, current: Mapping[UUID, FeatureVersion], decisions: Decisions) -> bool:
    """Whether the map confirms a drive, and nothing on it contradicts the drive."""
    update = apply_drive(current, replace(drive, doubt=None), decisions)
    return update.widened is None and is_confirmed(update.deltas, drive.key[0])


def next_rows(
    deltas: Iterable[Delta], current: Mapping[UUID, FeatureVersion], changeset_id: UUID, decisions: Decisions
) -> list[FeatureVersion]:
    """The open rows that deltas bring; current: as for `apply_drive`."""
    return [
        _next_row(
            current.get(delta.feature_id), delta.new or ended(delta.state_after, delta.evidence), changeset_id,
            delta.changed_at_ns, decisions, present=delta.new is not None,
        )
        for delta in deltas
        if delta.is_change or delta.kind is DeltaKind.MISSED
    ]  # fmt: skip


def _next_row(
    before: FeatureVersion | None,
    state: MapFeature,
    changeset_id: UUID,
    changed_at_ns: int,
    decisions: Decisions,
    *,
    present: bool = True,
) -> FeatureVersion:
    """The open row of a feature after a change; before: the one that was open."""
    from_ns = changed_at_ns if before is None else max(changed_at_ns, before.version_from_ns + MIN_VALID_NS)
    same_version = before is not None and before.feature.version == state.version
    return FeatureVersion(
        feature=state,
        changeset_id=changeset_id,
        present=present,
        suppressed=present and is_within(state, decisions.suppressed),
        version_from_ns=before.version_from_ns if before is not None and same_version else from_ns,
        valid_from_ns=from_ns,
        valid_to_ns=None,
    )


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
