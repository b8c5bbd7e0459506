"""Merge one drive into the map, in the order of recording or later: between `mapping/history.py` and the tables.

All of it runs inside the caller's transaction: `drive_transaction`, or `map_transaction` if the whole map is changed.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import NamedTuple
from uuid import UUID

import numpy as np

from conetl.checks.verdict import judge
from conetl.db.connection import Connection
from conetl.db.map import replay_store as store
from conetl.db.map.commit import INFLUENCE_M, add_drive, commit_changeset, path_wkt, with_free_id
from conetl.db.map.decision_store import held_drives, hold_changes, read_decisions
from conetl.db.map.drive_store import read_evidence
from conetl.db.map.map_store import require_map
from conetl.db.map.results import NOTHING, CommittedChangeset, DriveRef, Replay, RunInfo
from conetl.db.retention import require_comparable
from conetl.mapping.history import (
    DriveEvidence,
    MapHistory,
    MapUpdate,
    apply_drive,
    extended,
    founding_key,
    replay_drives,
)
from conetl.mapping.visibility import observations_of_drive, visibility_checks
from conetl.model.detector_evidence import UNMEASURED, AbsenceFigures, DetectorEvidence
from conetl.model.drive import Drive, DriveRecords
from conetl.model.health import HealthCheck, HoldChange
from conetl.model.map_records import Changeset, Decisions, FeatureVersion
from conetl.model.params import IngestParams
from conetl.pipeline.compared.adjoining import WITHIN_NS, NewDrive, find_doubts


@contextmanager
def gc_paused() -> Iterator[None]:
    """Pause the garbage collector while many records are made.

    Records have no reference cycles, and with millions of them the search for cycles takes a quarter of the whole time; reference
    counts still free memory. Afterwards the records are moved to the oldest generation, so that the next collection does not scan
    them all.
    """
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.freeze()
            gc.unfreeze()  # into the oldest generation
            gc.enable()


class MergeResult(NamedTuple):
    """How a drive changed the map."""

    changeset: Changeset
    extension: MapUpdate
    replayed: int
    """Later drives that were compared with the map again because of it."""
    committed: CommittedChangeset
    hold_changes: tuple[HoldChange, ...]
    """Other drives that went on hold because of it, or are on hold no longer."""


@gc_paused()
def merge_drive(
    conn: Connection,
    records: DriveRecords,
    changeset: Changeset,
    params: IngestParams,
    *,
    map_name: str,
    evidence: DetectorEvidence | None = None,
    run: RunInfo | None = None,
    hold: Sequence[HealthCheck] = (),
    map_id: int | None = None,
) -> MergeResult | CommittedChangeset:
    """Compare a drive with the map as the drives recorded before it left it, and commit the differences.

    changeset: without deltas; they are computed here. Later drives around it are compared again. evidence: measured response of
    the detector (None: not measured), which gives the weight of a missed cone. hold: the checks for which the recording must not
    count; it is stored and changes nothing until a person accepts it. map_id: of the map when the work began (`map_for`). If the
    drive is already on the map, the result is its changeset, and nothing is merged.
    """
    drive, reach_m = records.drive, influence_m(params)
    figures = AbsenceFigures(
        evidence=evidence or UNMEASURED,
        score_threshold=params.detection.score_threshold,
        categories=params.detection.categories,
        unclear=drive.unclear,
    )
    add = partial(
        add_drive, conn, drive, changeset.idempotency_key, map_name=map_name, reconcile=params.reconcile, influence_m=reach_m,
        figures=figures, map_id=map_id,
    )  # fmt: skip

    def is_in_doubt(found: store.Neighbourhood) -> bool:
        """Whether adjoining drives contradict some of those that are compared; drives far away may have to be, too, then."""
        compared = [*found.aside, *(ref.drive_uuid for ref in found.later)]
        return any(
            doubt or on_hold for doubt, on_hold in find_doubts(conn, compared, _new_drive(found, drive)).values()
        )

    near = store.lock_neighbourhood(
        conn, map_name, drive, changeset.idempotency_key, add, path_wkt=None if hold else path_wkt(drive), influence_m=reach_m,
        adjoining_ns=WITHIN_NS, reaches_far=is_in_doubt,
    )  # fmt: skip
    if isinstance(near, CommittedChangeset):  # another ingest of the same drive finished first
        return near
    extension, replay = MapUpdate([], []), NOTHING
    changeset = with_free_id(conn, changeset, near.drive_uuid)
    affected, held_before = [ref.changeset_id for ref in near.affected], held_drives(conn, map_name=map_name)
    by_map = not hold
    if by_map:
        key = founding_key(require_map(conn, map_name).id_name, drive.content_sha256)
        extension, replay = _compare(
            conn, near, _own_evidence(records, changeset, key, params, figures), drive, map_name
        )
        affected = [*replay.holds]
        hold = () if extension.hold is None else (extension.hold,)
    changeset = changeset.model_copy(update={"deltas": tuple(extension.deltas)})
    committed = commit_changeset(
        conn, records, changeset, map_name=map_name, run=run, replay=replay, hold=hold, held_by_map=by_map,
        drive_uuid=near.drive_uuid,
    )  # fmt: skip
    others: tuple[HoldChange, ...] = ()
    if held_before or affected:  # else there is no drive whose hold could begin or end
        others = hold_changes(conn, held_before, map_name=map_name, by=changeset.changeset_id, among=affected)
    return MergeResult(changeset, extension, len(replay.holds), committed, others)


def _own_evidence(
    records: DriveRecords, changeset: Changeset, founding_key: str, params: IngestParams, figures: AbsenceFigures
) -> DriveEvidence:
    """The evidence of a drive that is compared for the first time."""
    drive, spots = records.drive, [(p.frame_index, p.category, p.xyz_m) for p in records.positions]
    view = observations_of_drive(drive.rig, drive.frame_pairs, records.detections, spots, figures)
    visible, in_view = visibility_checks(lambda: view, records.markings, params.reconcile)
    return DriveEvidence(
        key=(int(view.captured_at_ns.min()), drive.content_sha256, changeset.idempotency_key),
        changeset_id=changeset.changeset_id,
        founding_key=founding_key,
        tracks=records.tracks,
        path_m=np.array([pair.pose.map_t_body_m[:2] for pair in drive.frame_pairs]),
        influence_m=influence_m(params),
        check_visibility=visible,
        markings=records.markings,
        check_view=in_view,
        params=params.reconcile,
        judge=judge,
    )


def _compare(
    conn: Connection, near: store.Neighbourhood, own: DriveEvidence, drive: Drive, map_name: str
) -> tuple[MapUpdate, Replay]:
    """The changes by a drive, and the new state of what it changes, or of the neighbourhood if others are compared again."""
    decisions, later = read_decisions(conn, map_name=map_name), near.later
    if later or len(near.aside) > 1 or near.reaches_far:
        again = [*near.aside, *(ref.drive_uuid for ref in later)]
        merged, replay = replay_of(conn, again, later, decisions, own=[own], new_drive=_new_drive(near, drive))
        return merged.updates[own.changeset_id], replay
    standing = store.read_standing_around(conn, near.drive_uuid)
    update = apply_drive({one: next(reversed(rows)) for one, rows in standing.items()}, own, decisions)
    return update, replay_of_newest(standing, update, own.changeset_id)


def replay_of_newest(
    standing: Mapping[UUID, Mapping[FeatureVersion, int]], update: MapUpdate, changeset_id: UUID
) -> Replay:
    """The changes by a drive that is newer than all others around it; standing: as of `read_standing_around`."""
    before: dict[FeatureVersion, int] = {}
    after: list[FeatureVersion] = []
    for new in update.versions:
        rows = standing.get(new.feature_id, {})
        before |= rows
        after += extended([*rows], new)
    return Replay(
        versions_before=before,
        deltas_before={},
        versions=after,
        deltas=[(changeset_id, delta) for delta in update.deltas],
        holds={},
    )


def _new_drive(near: store.Neighbourhood, drive: Drive) -> NewDrive:
    return NewDrive(near.drive_uuid, drive, frozenset(near.aside) - {near.drive_uuid})


def replay_of(
    conn: Connection,
    aside: Sequence[UUID],
    again: Sequence[DriveRef],
    decisions: Decisions,
    *,
    own: Sequence[DriveEvidence] = (),
    around: Sequence[UUID] = (),
    new_drive: NewDrive | None = None,
) -> tuple[MapHistory, Replay]:
    """Compute a neighbourhood of the map again.

    aside: the drives whose changes are set aside; again: those of them that are compared again, as stored; own: drives that are
    compared for the first time; new_drive: the recorded one of them. Changes by all other drives to the features around `aside`
    and `around` stay, except for their suppression. Drives whose position adjoining ones contradict, and all that continue these,
    are compared again, too: each may go on hold, or be released.
    """
    again_ids = {ref.drive_uuid for ref in again}
    fixed = [one for one in aside if one not in again_ids]
    found = find_doubts(conn, aside, new_drive)
    while more := [one for one, (doubt, on_hold) in found.items() if (doubt or on_hold) and one not in aside]:
        again = [ref for ref in store.affected_drives(conn, [*aside, *more]) if ref.drive_uuid not in fixed]
        aside = [*fixed, *(ref.drive_uuid for ref in again)]
        found = find_doubts(conn, aside, new_drive)
    require_comparable(conn, [ref.drive_uuid for ref in again])
    changesets = {ref.drive_uuid: ref.changeset_id for ref in again}
    if new_drive is not None:
        changesets[new_drive.drive_uuid] = own[0].changeset_id
    doubts = {
        changesets[one]: doubt._replace(continues=frozenset(changesets[other] for other in doubt.continues))
        for one, (doubt, _) in found.items()
        if doubt is not None
    }
    out = set(aside)
    versions, others = store.read_versions(conn, [*aside, *around], without=out)
    deltas = store.read_deltas(conn, aside)
    misses = store.read_misses(conn, [*aside, *around], without=out)
    evidence = (replace(one, doubt=doubts.get(one.changeset_id)) for one in [*own, *read_evidence(conn, again)])
    merged = replay_drives(evidence, decisions, given=[*others, *misses])
    replay = Replay(
        versions_before=versions,
        deltas_before=deltas,
        versions=[version for chain in merged.chains.values() for version in chain],
        deltas=[
            (changeset_id, delta) for changeset_id, extension in merged.updates.items() for delta in extension.deltas
        ],
        holds={ref.changeset_id: merged.updates[ref.changeset_id].hold for ref in again},
    )
    return merged, replay


def influence_m(params: IngestParams) -> float:
    """How far from its path a drive may change anything: its farthest position, the largest offset and a move."""
    farthest_m = params.position.max_range_m + params.reconcile.max_offset_m + params.reconcile.moved_max_m
    return max(INFLUENCE_M, farthest_m + 10.0)
