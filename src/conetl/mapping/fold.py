"""The map as a fold over drives: whatever order they come in, they are compared with the map in the order of their recording.

`fold(drives)` is the definition of the map. A drive that is newer than all others around it extends the fold by one
(`extend`); one that comes late, or is taken back, makes a part of it be computed again (`fold` with what the other drives left as
`given`). Both go through `extend`, so they cannot disagree. No version is ever lost: one that would begin no later than the
version that it follows (drives that overlap in time) begins a microsecond after it, which is what the database can tell apart.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from heapq import merge
from itertools import pairwise
from uuid import UUID

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from conetl.mapping.adoption import adopt
from conetl.mapping.changes import LookAt, reconcile
from conetl.mapping.existence_update import doubt_after
from conetl.model.map_records import (
    Decisions,
    Delta,
    DeltaKind,
    Doubt,
    FeatureVersion,
    FoldKey,
    MapFeature,
    Miss,
    Place,
    Statement,
)
from conetl.model.params import ReconcileParams
from conetl.model.records import Track, sound

Floats = NDArray[np.float64]
#: What two versions of a feature are at least apart: the database holds microseconds.
MIN_VALID_NS = 1000


@dataclass(frozen=True)
class Evidence:
    """All that one drive tells the map."""

    key: FoldKey
    changeset_id: UUID
    founding_key: str
    """The map and the drive's content; the ids of new features follow from it."""
    tracks: Sequence[Track]
    path_m: Floats
    """(N, 2) places of the body, easting and northing."""
    influence_m: float
    """Features farther than this from the path are neither judged nor changed by the drive."""
    look_at: LookAt
    """See `reconcile`."""
    params: ReconcileParams
    statements: Sequence[Statement] = ()
    """Of an imported map instead of tracks; it looked nowhere, so it removes nothing. `path_m` is where its cones stand."""


@dataclass(frozen=True)
class Extension:
    """What one drive does to the map."""

    deltas: list[Delta]
    versions: list[FeatureVersion]
    """One for each delta that changes anything, open."""
    misses: list[Miss]
    """One for each delta that is evidence against a feature and changes nothing."""
    untouched: list[MapFeature]
    """Features around the path that the drive did not judge."""

    @property
    def suppressed(self) -> frozenset[UUID]:
        """Features that the drive saw, at a place where a person said that nothing stands."""
        return frozenset(version.feature.feature_id for version in self.versions if version.suppressed)


@dataclass
class Folded:
    """The map in valid time."""

    chains: dict[UUID, list[FeatureVersion]] = field(default_factory=dict)
    """The versions of each feature, oldest first; the last one is open."""
    misses: list[Miss] = field(default_factory=list)
    """What was looked for and not seen but stands, in the order of the drives."""
    extensions: dict[UUID, Extension] = field(default_factory=dict)
    """What each drive that was compared did, by changeset."""


def fold(
    drives: Iterable[Evidence],
    decisions: Decisions = Decisions(),  # noqa: B008 -- frozen
    *,
    given: Iterable[tuple[FoldKey, FeatureVersion | Miss]] = (),
) -> Folded:
    """The map that the drives make, whatever order they are given in.

    given: what other drives left, each version and miss with the key of its drive; these drives are not compared again. The valid
    periods and the suppression of given versions are worked out anew.
    """
    folded = Folded()
    standing: dict[UUID, FeatureVersion] = {}
    doubts: dict[UUID, Doubt] = {}
    events: Iterable[tuple[FoldKey, str, FeatureVersion | Miss | Evidence]] = merge(
        sorted(((key, str(_feature_id(state)), state) for key, state in given), key=lambda e: e[:2]),
        sorted(((drive.key, "", drive) for drive in drives), key=lambda e: e[:2]),
        key=lambda event: event[:2],
    )
    for _, _, event in events:
        if isinstance(event, Evidence):
            extension = extend(standing, event, decisions, doubts, known=folded.chains.keys())
            folded.extensions[event.changeset_id] = extension
            versions, misses = extension.versions, extension.misses
        elif isinstance(event, Miss):
            versions, misses = [], [event]
        else:
            misses = []
            suppressed = event.standing and is_within(event.feature, decisions.suppressed)
            versions = [event.model_copy(update={"suppressed": suppressed})]
        for version in versions:
            feature_id = version.feature.feature_id
            folded.chains.setdefault(feature_id, []).append(version)
            doubts.pop(feature_id, None)
            if version.standing:
                standing[feature_id] = version
            else:
                del standing[feature_id]
        folded.misses += misses
        for miss in misses:
            doubts[miss.feature_id] = doubt_after(
                doubts.get(miss.feature_id), miss.existence_probability, miss.first_missed_ns
            )
    for chain in folded.chains.values():
        ends: list[int | None] = [after.valid_from_ns for _, after in pairwise(chain)]
        chain[:] = [
            version if version.valid_to_ns == end else version.model_copy(update={"valid_to_ns": end})
            for version, end in zip(chain, [*ends, None], strict=True)
        ]
    return folded


def extend(
    standing: Mapping[UUID, FeatureVersion],
    drive: Evidence,
    decisions: Decisions,
    doubts: Mapping[UUID, Doubt],
    *,
    known: Collection[UUID] = (),
) -> Extension:
    """Compare one drive with the map as the drives recorded before it left it.

    standing: the open versions of the features that stand, suppressed ones too, by feature id; those out of the drive's
    influence are left out of account, whether they are there or not. doubts: of those that were missed since. known: ids that are
    taken, also by features that are gone; only an imported map, which brings ids of its own, needs to be told.
    """
    around = _around(standing, drive)
    pinned = {feature.feature_id for feature in around if is_within(feature, decisions.pinned)}
    if drive.statements:
        deltas = adopt(
            drive.statements,
            around,
            drive.params,
            at_ns=drive.key[0],
            founding_key=drive.founding_key,
            known=known,
            pinned=pinned,
            doubts=doubts,
        )
    else:
        deltas = reconcile(
            drive.tracks,
            around,
            drive.look_at,
            drive.params,
            founding_key=drive.founding_key,
            pinned=pinned,
            doubts=doubts,
        )
    versions, misses = [], []
    for delta in deltas:
        if delta.kind is DeltaKind.MISSED:
            misses.append(_miss(delta, drive.changeset_id))
        if not delta.is_change:
            continue
        before = standing.get(delta.feature_id)
        earliest_ns = delta.changed_at_ns if before is None else before.valid_from_ns + MIN_VALID_NS
        number = 1 if delta.old is None else delta.old.version + 1
        state = delta.state_after
        versions.append(
            sound(
                FeatureVersion,
                feature=state if state.version == number else state.model_copy(update={"version": number}),
                changeset_id=drive.changeset_id,
                standing=delta.new is not None,
                suppressed=delta.new is not None and is_within(state, decisions.suppressed),
                valid_from_ns=max(delta.changed_at_ns, earliest_ns),
                valid_to_ns=None,
            )
        )
    judged = {delta.feature_id for delta in deltas}
    return Extension(deltas, versions, misses, [feature for feature in around if feature.feature_id not in judged])


def is_within(feature: MapFeature, places: Sequence[Place]) -> bool:
    """Whether a feature stands at one of the places (horizontally)."""
    if not places:
        return False
    x, y, _ = feature.xyz_m
    return any(float(np.hypot(x - place.xy_m[0], y - place.xy_m[1])) <= place.radius_m for place in places)


def _miss(delta: Delta, changeset_id: UUID) -> Miss:
    if delta.evidence is None:
        raise ValueError(f"the miss of feature {delta.feature_id} has no evidence")
    return Miss(
        feature_id=delta.feature_id,
        changeset_id=changeset_id,
        version=delta.state_after.version,
        existence_probability=delta.evidence.existence_probability,
        first_missed_ns=delta.changed_at_ns,
    )


def _feature_id(state: FeatureVersion | Miss) -> UUID:
    return state.feature_id if isinstance(state, Miss) else state.feature.feature_id


def _around(standing: Mapping[UUID, FeatureVersion], drive: Evidence) -> list[MapFeature]:
    """The features within the drive's influence, by feature id."""
    features = [standing[feature_id].feature for feature_id in sorted(standing)]
    if not features:
        return []
    places = np.array([feature.xyz_m[:2] for feature in features])
    distances = np.atleast_1d(cKDTree(drive.path_m).query(places)[0])
    return [feature for feature, distance in zip(features, distances, strict=True) if distance <= drive.influence_m]
