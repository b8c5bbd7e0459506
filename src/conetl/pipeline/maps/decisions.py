"""Decisions of people about the map: there is no cone here, this cone stays or is a drum, that drive does not count.

A decision is a row and takes part in every later comparison of drives. Its consequences are computed in the same transaction.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import datetime
from functools import partial
from typing import NamedTuple
from uuid import UUID

from conetl.db.connection import LOCK_TIMEOUT_S, Connection
from conetl.db.map import decision_store as store
from conetl.db.map import replay_store as replays
from conetl.db.map.decision_store import hold_changes
from conetl.db.map.map_store import find_features, list_changesets, map_transaction, require_map, system_time
from conetl.db.map.results import DecisionTarget, MapInfo, Replay
from conetl.db.serve_store import last_changes
from conetl.mapping.history import is_within
from conetl.model.errors import ConflictError, InputError
from conetl.model.feature_classes import FEATURE_CLASSES
from conetl.model.health import HeldDrive, HoldChange
from conetl.model.map_records import Classification, FeatureVersion, Location, MapFeature
from conetl.pipeline.replay import replay_of

SUPPRESS, PIN, CLASSIFY, APPROVE = "suppress", "pin", "classify", "approve"
REVERT, ACCEPT, WITHDRAW = "revert", "accept", "withdraw"
#: Name of a hold (by the checks) in `list_decisions`.
HOLD = "hold"
#: A larger circle would not concern a single cone.
MAX_RADIUS_M = 20.0


class RevertConflict(NamedTuple):
    """A feature that was changed by a reverted changeset, and by other changesets after it."""

    feature_id: UUID
    kind: str
    """Of the reverted changeset's change."""
    was: FeatureVersion | None
    """Before the reverted changeset; None where it founded the feature."""
    changed_to: FeatureVersion | None
    """By the reverted changeset."""
    is_now: FeatureVersion | None
    """After the revert; None where without the reverted changeset it was never founded."""


class DecisionOutcome(NamedTuple):
    """A decision and its consequences."""

    decision_id: UUID
    kind: str
    decided_at: datetime
    versions_written: int
    replayed: int
    """Drives that were compared with the map again."""
    conflicts: tuple[RevertConflict, ...]
    """Of a reverted changeset: features that other drives changed after it; these changes are kept."""
    hold_changes: tuple[HoldChange, ...]
    """Drives that went on hold, or are on hold no longer."""
    changeset_id: UUID | None
    """Of the drive that it is about."""
    replaced_by: int | None
    """Number of the later delivery that keeps this drive from counting, although nothing else does."""


class _OpenDecision(NamedTuple):
    """A map under its lock while a decision is made."""

    info: MapInfo
    decided_at: datetime
    insert: Callable[..., UUID]
    held_before: list[HeldDrive]


def decide_location(
    conn: Connection,
    kind: str,
    feature: str,
    *,
    map_name: str,
    radius_m: float = 1.0,
    category: str | None = None,
    note: str = "",
    decided_by: str | None = None,
    expected_version: int | None = None,
    lock_timeout_s: float = LOCK_TIMEOUT_S,
) -> DecisionOutcome:
    """Suppress or pin the position of a feature, or correct its `category`.

    feature: its id, or the beginning of it. Raises InputError, and ConflictError if the same was already decided, or the
    feature's version is not `expected_version`, which the person saw.
    """
    if not 0 < radius_m <= MAX_RADIUS_M:
        raise InputError(f"radius {radius_m:g} m: expected more than 0 and at most {MAX_RADIUS_M:g} m")
    with _open_decision(conn, map_name, note, decided_by, lock_timeout_s) as at:
        state = _feature(conn, map_name, feature)
        known = store.list_decisions(conn, map_name=map_name)
        here = {one.kind: one for one in known if one.location is not None and is_within(state, [one.location])}
        if kind in here:
            raise ConflictError(f"there is already a decision to {kind} this position: see `conetl map decisions`")
        if SUPPRESS in here:
            raise ConflictError(
                f"feature {state.feature_id} is suppressed, so a decision to {kind} it has no effect. If the object is "
                f"there, withdraw the suppression first: `conetl map revert {here[SUPPRESS].decision_id}`"
            )
        _require_version(state.feature_id, state.version, expected_version)
        location = Location(xy_m=state.xyz_m[:2], radius_m=radius_m, of_line=state.marking is not None)
        if kind == CLASSIFY:
            location = _classification(state, category, location)
        decision_id = at.insert(kind, location=location, feature_id=state.feature_id)
        written, replayed = _judge_location(conn, at, kind, location)
        return _outcome(conn, at, decision_id, kind, written, replayed)


def approve_change(
    conn: Connection,
    feature_id: UUID,
    *,
    map_name: str,
    note: str = "",
    decided_by: str | None = None,
    expected_version: int | None = None,
    lock_timeout_s: float = LOCK_TIMEOUT_S,
) -> DecisionOutcome:
    """Keep that the last change of a feature is right; the map stays as it is, and the next change is not covered.

    Raises InputError, and ConflictError as `decide_location` does.
    """
    with _open_decision(conn, map_name, note, decided_by, lock_timeout_s) as at:
        last = last_changes(conn, map_name, [feature_id]).get(feature_id)
        if last is None:
            raise InputError(f"there is no feature {feature_id} on the map {map_name}: see `conetl map show`")
        known = store.list_decisions(conn, map_name=map_name)
        if any(one.feature_id == feature_id and one.approves == last["changeset_id"] for one in known):
            raise ConflictError(f"this change of feature {feature_id} is already approved: see `conetl map decisions`")
        _require_version(feature_id, last["version"], expected_version)
        decision_id = at.insert(APPROVE, feature_id=feature_id, approves=last["changeset_id"])
        return _outcome(conn, at, decision_id, APPROVE, 0, 0)


def _require_version(feature_id: UUID, version: int, expected_version: int | None) -> None:
    """Raises ConflictError if a person saw another version of a feature than the last."""
    if expected_version not in (None, version):
        raise ConflictError(
            f"feature {feature_id} has changed: you decided on version {expected_version}, but it is now at "
            f"version {version}. Review it again."
        )


def revert(
    conn: Connection,
    what: str,
    *,
    map_name: str,
    note: str = "",
    decided_by: str | None = None,
    lock_timeout_s: float = LOCK_TIMEOUT_S,
) -> DecisionOutcome:
    """Revert a changeset (its drive no longer counts) or a decision. what: its id, the beginning of it, or the changeset's
    number.

    Nothing is lost: reverting the revert restores everything. Raises InputError, ConflictError if it was already reverted.
    """
    with _open_decision(conn, map_name, note, decided_by, lock_timeout_s) as at:
        target, known = _find_target(conn, map_name, what), store.list_decisions(conn, map_name=map_name)
        if target.kind == "changeset":
            if any(one.changeset_id == target.id and one.kind == REVERT for one in known):
                raise ConflictError(f"changeset {target.id} has already been reverted: see `conetl map decisions`")
            kind, withdraws, changeset_id = REVERT, None, target.changeset_id
        elif target.kind == WITHDRAW or not target.active:
            raise ConflictError(f"decision {target.id} is no longer active: record it again instead")
        else:
            kind, withdraws, changeset_id = WITHDRAW, target.id, None
        decision = next((one for one in known if one.decision_id == target.id), None)
        decide = partial(at.insert, kind, changeset_id=changeset_id, withdraws=withdraws)
        conflicts: tuple[RevertConflict, ...] = ()
        if target.drive_uuid is not None:
            decision_id, written, replayed, conflicts = _judge_drive(conn, at, target.drive_uuid, decide, changeset_id)
        elif decision is not None and (location := decision.location) is not None:
            decision_id = decide()
            written, replayed = _judge_location(conn, at, decision.kind, location)
        elif target.kind == APPROVE:
            decision_id, written, replayed = decide(), 0, 0
        else:
            raise InputError(f"decision {target.id} cannot be reverted")
        return _outcome(conn, at, decision_id, kind, written, replayed, conflicts, target.changeset_id)


def accept_drive(
    conn: Connection,
    drive: str,
    *,
    map_name: str,
    note: str = "",
    decided_by: str | None = None,
    lock_timeout_s: float = LOCK_TIMEOUT_S,
) -> DecisionOutcome:
    """Accept a drive on hold, so that it counts. drive: its id, or its changeset's number or id.

    Reverting the decision puts it on hold again. Raises ConflictError if no such drive is on hold, or another delivery of it
    counts.
    """
    with _open_decision(conn, map_name, note, decided_by, lock_timeout_s) as at:
        found = [
            known
            for known in list_changesets(conn, map_name=map_name)
            if drive in (known.drive_id, str(known.changeset_no), str(known.changeset_id))
        ]
        held = [known for known in found if known.hold is not None]
        if not held:
            state = "see `conetl drive held`"
            if found and found[0].counts:
                state = f"changeset {found[0].changeset_no} is already in effect"
            elif found:
                state = store.why_not_counted(conn, found[0], map_name)
            raise ConflictError(f"no drive {drive} is on hold on the map {map_name}: {state}")
        if len(held) > 1:
            raise InputError(
                f"{len(held)} drives named {drive} are on hold: give the number that `conetl drive held` lists"
            )
        known = held[0]
        captured_ns = known.captured_from_ns, known.captured_to_ns
        others = replays.other_deliveries(conn, known.drive_id, captured_ns, known.content_sha256, map_name=map_name)
        if others:
            raise ConflictError(
                f"another delivery of drive {known.drive_id} is already on the map (changeset {others[-1]}). To use this one "
                f"instead, first revert that one with `conetl map revert {others[-1]} --map {map_name}`."
            )
        decide = partial(at.insert, ACCEPT, changeset_id=known.changeset_id)
        decision_id, written, replayed, _ = _judge_drive(conn, at, known.drive_uuid, decide, None)
        return _outcome(conn, at, decision_id, ACCEPT, written, replayed, changeset_id=known.changeset_id)


def _classification(state: MapFeature, category: str | None, location: Location) -> Classification:
    """The correction of a feature's class. Raises InputError if it is not another known class of the same geometry."""
    geometry = FEATURE_CLASSES[state.category].geometry if state.category in FEATURE_CLASSES else "point"
    known = [name for name, one in FEATURE_CLASSES.items() if one.geometry == geometry and name != state.category]
    if not known:
        raise InputError(f"feature {state.feature_id} is a {state.category}; there is no other class of its kind")
    if category is None or category not in known:
        raise InputError(
            f"feature {state.feature_id} is a {state.category}; expected another class: {', '.join(known)}"
        )
    return Classification(xy_m=location.xy_m, radius_m=location.radius_m, found_as=state.category, category=category)


@contextmanager
def _open_decision(
    conn: Connection, map_name: str, note: str, decided_by: str | None, lock_timeout_s: float
) -> Iterator[_OpenDecision]:
    """Lock the map for a decision: its instant, `insert_decision` for it, and the drives on hold before."""
    with map_transaction(conn, map_name, lock_timeout_s=lock_timeout_s):
        info = require_map(conn, map_name)
        decided_at = system_time(conn, info)
        insert = partial(store.insert_decision, conn, info, decided_at=decided_at, note=note, decided_by=decided_by)
        yield _OpenDecision(info, decided_at, insert, store.held_drives(conn, map_name=map_name))


def _outcome(
    conn: Connection,
    at: _OpenDecision,
    decision_id: UUID,
    kind: str,
    written: int,
    replayed: int,
    conflicts: tuple[RevertConflict, ...] = (),
    changeset_id: UUID | None = None,
) -> DecisionOutcome:
    """The consequences of a decision, read before it is committed. changeset_id: of the drive that it is about."""
    changes = hold_changes(conn, at.held_before, map_name=at.info.map_name)
    replaced_by = None if changeset_id is None else store.replaced_by_delivery(conn, changeset_id)
    return DecisionOutcome(
        decision_id, kind, at.decided_at, written, replayed, conflicts, changes, changeset_id, replaced_by
    )


def _judge_location(conn: Connection, at: _OpenDecision, kind: str, location: Location) -> tuple[int, int]:
    """Compute the consequences of a decision about a position: versions written, drives compared again."""
    around = replays.drives_at(conn, at.info.map_name, location)
    # Suppression hides detections and changes nothing that drives are compared with; a pin and a class do.
    again = replays.affected_drives(conn, around) if kind in (PIN, CLASSIFY) else []
    aside = [ref.drive_uuid for ref in again]
    decisions = store.read_decisions(conn, map_name=at.info.map_name)
    _, replay = replay_of(conn, aside, again, decisions, around=around)
    return replays.write_replay(conn, at.info, replay, at.decided_at), len(again)


def _judge_drive(
    conn: Connection, at: _OpenDecision, drive_uuid: UUID, decide: Callable[[], UUID], changeset_id: UUID | None
) -> tuple[UUID, int, int, tuple[RevertConflict, ...]]:
    """Write by `decide` that a drive starts or ceases to count, and compute the consequences."""
    counted_before = replays.superseded_drives(conn, drive_uuid)
    decision_id = decide()
    seeds = list(dict.fromkeys([drive_uuid, *counted_before, *replays.superseded_drives(conn, drive_uuid)]))
    again = replays.affected_drives(conn, seeds)
    aside = list(dict.fromkeys([*seeds, *(ref.drive_uuid for ref in again)]))
    _, replay = replay_of(conn, aside, again, store.read_decisions(conn, map_name=at.info.map_name))
    written = replays.write_replay(conn, at.info, replay, at.decided_at)
    return decision_id, written, len(again), _conflicts(replay, changeset_id)


def _conflicts(replay: Replay, changeset_id: UUID | None) -> tuple[RevertConflict, ...]:
    """The features that both this changeset and others changed, by feature id."""
    own: dict[UUID, tuple[str, int | None, int]] = {}
    others = set()
    for changed_by, feature_id, kind, old, new in (values[:5] for values in replay.deltas_before):
        if changed_by == changeset_id:
            own[feature_id] = kind, old, new
        else:
            others.add(feature_id)
    before = {(one.feature_id, one.feature.version): one for one in replay.versions_before}
    now = {version.feature.feature_id: version for version in replay.versions if version.valid_to_ns is None}
    return tuple(
        RevertConflict(
            feature_id=feature_id,
            kind=kind,
            was=None if old is None else before.get((feature_id, old)),
            changed_to=before.get((feature_id, new)),
            is_now=now.get(feature_id),
        )
        for feature_id, (kind, old, new) in sorted(own.items())
        if feature_id in others
    )


def _feature(conn: Connection, map_name: str, beginning: str) -> MapFeature:
    found = find_features(conn, beginning, map_name=map_name)
    if not found:
        raise InputError(f"there is no feature {beginning} on the map {map_name}: see `conetl map show`")
    if len(found) > 1:
        raise InputError(f"several feature ids begin with {beginning}: give more characters")
    version = replays.read_open_version(conn, map_name, found[0])
    if version is None:
        raise InputError(f"feature {found[0]} was on the map, but has been removed: see `conetl map log`")
    return version.feature


def _find_target(conn: Connection, map_name: str, beginning: str) -> DecisionTarget:
    found = store.find_decisions(conn, beginning, map_name=map_name)
    if not found:
        for known in store.list_decisions(conn, map_name=map_name):
            if known.kind == HOLD and len(beginning) >= 4 and str(known.decision_id).startswith(beginning.lower()):
                raise InputError(
                    f"{beginning} is a hold, not a decision: use `conetl drive held` and `conetl drive accept`"
                )
        raise InputError(
            f"the map {map_name} has no changeset or decision {beginning}: see `conetl map log` and `conetl map decisions`"
        )
    if len(found) > 1:
        raise InputError(f"several ids begin with {beginning}: give more characters")
    return found[0]
