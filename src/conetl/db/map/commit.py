"""Write a drive, its records and its changeset into the map.

One drive is one atomic changeset. The caller holds the locks of its neighbourhood from reading the features to the commit:

    with drive_transaction(conn, map_name):
        near = lock_neighbourhood(conn, map_name, drive, key, lambda: add_drive(conn, drive, key, ...), ...)
        if isinstance(near, Neighbourhood):           # else it is already on the map
            ...                                       # compare in Python: in pipeline/replay.py
            commit_changeset(conn, records, changeset, replay=..., map_name=map_name, drive_uuid=near.drive_uuid)

Everything is committed at the end of the block, or nothing.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from datetime import datetime
from functools import partial
from typing import Any
from uuid import NAMESPACE_URL, UUID, uuid5

from conetl.db import connection as db
from conetl.db.connection import Connection
from conetl.db.copy_rows import Columns, clean_text, json_text
from conetl.db.live_store import drop_watched_recording
from conetl.db.map import rows as map_rows
from conetl.db.map.decision_store import write_holds
from conetl.db.map.map_store import list_changesets, map_for, system_time
from conetl.db.map.replay_store import apply_stages, load_stages, take_turn
from conetl.db.map.results import NOTHING, CommittedChangeset, MapInfo, Replay, RunInfo
from conetl.model.detector_evidence import AbsenceFigures
from conetl.model.drive import Drive, DriveRecords
from conetl.model.errors import MapMismatchError
from conetl.model.health import HealthCheck
from conetl.model.map_records import Changeset
from conetl.model.params import ReconcileParams

#: A drive may see features this far around its path: the farthest position plus the largest offset and move.
INFLUENCE_M = 60.0
#: Records per block: about 8 MB of positions, which are the longest rows.
BLOCK_RECORDS = 25_000
_COUNTED = {
    "detection": "detections", "match": "matches", "position": "positions", "track": "tracks", "marking": "markings",
    "rejection": "rejections",
}  # fmt: skip
#: `drives.insert_drive` makes the area larger by more than this.
_PATH_STEP_M = 3.0
_NAMESPACE = uuid5(NAMESPACE_URL, "https://conetl.example/drive")


def add_drive(
    conn: Connection,
    drive: Drive,
    idempotency_key: str,
    *,
    map_name: str = "default",
    reconcile: ReconcileParams | None = None,
    influence_m: float = INFLUENCE_M,
    figures: AbsenceFigures | None = None,
    map_id: int | None = None,
) -> UUID:
    """Add a drive to the map unless it exists, so that its neighbourhood can be read; does not commit.

    It counts only once its changeset exists. reconcile (None: the defaults), influence_m and figures (of the detector; None: not
    measured) are stored for later comparisons of the drive with the map. map_id: as for `map_for`. Raises MapMismatchError if the
    map is in another CRS, or is another one than that.
    """
    info = map_for(conn, map_name, drive.map_srid, f"drive {drive.drive_id}", map_id)
    drive_uuid = uuid5(_NAMESPACE, f"{map_name}/{idempotency_key}")
    if db.query(conn, "drives.belongs_elsewhere", drive_uuid=drive_uuid, map_id=info.map_id)[0]["elsewhere"]:
        # A map of this name was set aside.
        drive_uuid = uuid5(_NAMESPACE, f"{map_name}/{info.map_id}/{idempotency_key}")
    captured_from_ns, captured_to_ns = drive.captured_ns
    db.query(
        conn, "drives.insert_drive", drive_uuid=drive_uuid, map_id=info.map_id, srid=info.srid,
        drive_id=clean_text(drive.drive_id), source_path=clean_text(drive.source_path), path_wkt=path_wkt(drive),
        content_sha256=drive.content_sha256, rig=json_text(drive.rig.model_dump(mode="json")),
        captured_from_ns=captured_from_ns, captured_to_ns=captured_to_ns,
        captured_from=drive.captured_from, captured_to=drive.captured_to,
        expected_frame_count=drive.expected_frame_count, influence_m=influence_m,
        reconcile=json_text((reconcile or ReconcileParams()).model_dump(mode="json")),
        absence_figures=None if figures is None else json_text(figures.model_dump(mode="json")),
    )  # fmt: skip
    return drive_uuid


def with_free_id(conn: Connection, changeset: Changeset, drive_uuid: UUID) -> Changeset:
    """A new changeset; it gets another id if its own belongs to the same drive on a map of this name that was set aside."""
    if db.query(conn, "commit.changeset_exists", changeset_id=changeset.changeset_id)[0]["found"]:
        return changeset.model_copy(update={"changeset_id": uuid5(drive_uuid, str(changeset.changeset_id))})
    return changeset


def commit_changeset(
    conn: Connection,
    records: DriveRecords,
    changeset: Changeset,
    *,
    map_name: str = "default",
    run: RunInfo | None = None,
    replay: Replay = NOTHING,
    hold: Sequence[HealthCheck] = (),
    held_by_map: bool = False,
    drive_uuid: UUID | None = None,
) -> CommittedChangeset:
    """Write a drive, everything made from it, and its changeset, under the locks that the caller holds.

    The map is created by its first changeset with the drive's SRID. replay: the new state of what the changeset changes, its own
    deltas included; of the whole neighbourhood if others were compared again. hold: the checks for which the drive must not count
    until a person accepts it; held_by_map: whether the comparison with the map made them. drive_uuid: the drive, if `add_drive`
    has added it; it must have no changeset yet. Raises MapMismatchError if the drive is in another CRS, or the records do not fit
    together; DatabaseError from the surrounding transaction.
    """
    drive = records.drive
    drive_uuid = drive_uuid or add_drive(conn, drive, changeset.idempotency_key, map_name=map_name)
    _require_consistent(records, changeset)
    info = map_for(conn, map_name, drive.map_srid, f"drive {drive.drive_id}")
    blocks = _encoded_records(drive_uuid, info.srid, records)
    # Encoding takes nearly as long as sending, during which this process would only wait: a thread encodes the next block.
    with ThreadPoolExecutor(1) as pool:
        upcoming = pool.submit(next, blocks, None)
        staged = load_stages(conn, info, replay)
        while (block := upcoming.result()) is not None:
            upcoming = pool.submit(next, blocks, None)
            db.copy_block(conn, block)
    take_turn(conn, map_name)  # what follows keeps other drives of the map waiting
    committed_at = system_time(conn, info)
    insert_changeset(conn, info, drive_uuid, changeset, records, run, committed_at)
    db.copy_columns(conn, "conetl.quarantine", map_rows.rejection_columns(changeset.changeset_id, records.rejections))
    drop_watched_recording(conn, drive, map_name=map_name)
    versions_written = apply_stages(conn, staged, replay, committed_at)
    write_holds(conn, {changeset.changeset_id: hold} if hold else {}, committed_at, by_map=held_by_map)
    renew_statistics(conn, versions_written)
    [committed] = list_changesets(conn, map_name=map_name, idempotency_key=changeset.idempotency_key)
    return committed


def insert_changeset(
    conn: Connection,
    info: MapInfo,
    drive_uuid: UUID,
    changeset: Changeset,
    records: DriveRecords | None,
    run: RunInfo | None,
    committed_at: datetime,
) -> None:
    """Write a changeset's own row and its run, but not its deltas. records: of a drive; None for an import."""
    if run is not None:
        facts = None if run.facts is None else json_text(dict(run.facts))
        kept = {"finished_at": committed_at, "params": json_text(dict(run.params)), "facts": facts}
        db.query(conn, "commit.insert_run", **vars(run) | kept)
    points, lines = (
        Counter(delta.kind for delta in changeset.deltas if delta.is_line is of_line) for of_line in (False, True)
    )
    counts = {f"{name}_count": len(getattr(records, some, ())) for name, some in _COUNTED.items()}
    db.query(
        conn, "commit.insert_changeset", changeset_id=changeset.changeset_id, map_id=info.map_id, drive_uuid=drive_uuid,
        run_id=run.run_id if run else None, idempotency_key=changeset.idempotency_key,
        params_sha256=changeset.params_sha256, model_sha256=changeset.model_sha256,
        code_version=changeset.code_version, committed_at=committed_at, **counts,
        change_counts=json_text({"points": points, "lines": lines}),
        frame_pair_count=len(records.drive.frame_pairs) if records else 0,
    )  # fmt: skip


def renew_statistics(conn: Connection, versions: int) -> None:
    """Update the planner's statistics if a tenth of the map's versions are new; autovacuum runs only after a minute."""
    if versions and db.query(conn, "commit.has_outgrown", versions=versions)[0]["outgrown"]:
        db.execute(conn, "analyze (skip_locked) conetl.feature, conetl.feature_version, conetl.delta")


def _require_consistent(records: DriveRecords, changeset: Changeset) -> None:
    """The checks of foreign keys, at a tenth of the cost of row-by-row checks. Raises MapMismatchError."""
    drive, detections, matches, positions, tracks, *_ = records
    frames = {pair.frame_index for pair in drive.frame_pairs}
    boxes = {(d.frame_index, d.side, d.detection_index) for d in detections}
    positioned = {(p.frame_index, p.match_index) for p in positions}
    matched = {(m.frame_index, m.match_index) for m in matches}
    numbered = {track.track_index for track in tracks}
    problems = [
        *([f"a changeset of drive {changeset.drive_id}"] if changeset.drive_id != drive.drive_id else ()),
        *(f"detection of frame {f}, which the drive lacks" for f in {d.frame_index for d in detections} - frames),
        *(f"position of frame {f}, which the drive lacks" for f in {p.frame_index for p in positions} - frames),
        *(
            f"stereo match {m.match_index} of frame {m.frame_index} without its detections"
            for m in matches
            if not {(m.frame_index, b.side, b.detection_index) for b in m.boxes} <= boxes
        ),
        *(f"position {p} without its stereo match" for p in (positioned - matched if matches else ())),
        *(
            f"track {track.track_index} with the unknown position {member}"
            for track in tracks
            for member in track.members
            if member not in positioned
        ),
        *(
            f"delta of feature {d.feature_id} with the unknown track {d.track_index}"
            for d in changeset.deltas
            if d.track_index is not None and d.track_index not in numbered
        ),
        *(
            f"{count} deltas of feature {feature_id}, where one is allowed"
            for feature_id, count in Counter(d.feature_id for d in changeset.deltas).items()
            if count > 1
        ),
    ]
    if problems:
        more = f" and {len(problems) - 1} more problems" if len(problems) > 1 else ""
        raise MapMismatchError(f"drive {drive.drive_id} comes with {problems[0]}{more}: nothing was written.")


def path_wkt(drive: Drive) -> str:
    """The drive's path as a line, without points nearer than `_PATH_STEP_M` to the previous one."""
    points = [drive.frame_pairs[0].pose.map_t_body_m]
    for pair in drive.frame_pairs:
        at = pair.pose.map_t_body_m
        if max(abs(at[0] - points[-1][0]), abs(at[1] - points[-1][1])) >= _PATH_STEP_M:
            points.append(at)
    points.append((points[-1][0] + 0.1, *points[-1][1:]))  # a line requires two points
    return "LINESTRING(" + ", ".join(f"{x!r} {y!r}" for x, y, _ in points) + ")"


def _encoded_records(drive_uuid: UUID, srid: int, records: DriveRecords) -> Iterator[db.CopyBlock]:
    tables: tuple[tuple[str, Sequence[Any], Callable[[Any], Columns]], ...] = (
        ("frame_pair", records.drive.frame_pairs, partial(map_rows.frame_pair_columns, drive_uuid, srid)),
        ("detection", records.detections, partial(map_rows.detection_columns, drive_uuid)),
        ("stereo_match", records.matches, partial(map_rows.match_columns, drive_uuid)),
        ("position", records.positions, partial(map_rows.position_columns, drive_uuid, srid)),
        ("track", records.tracks, partial(map_rows.track_columns, drive_uuid, srid)),
        ("marking_track", records.markings, partial(map_rows.marking_track_columns, drive_uuid, srid)),
    )
    for table, some, columns_of in tables:
        for start in range(0, len(some), BLOCK_RECORDS):
            yield db.encoded_block(f"conetl.{table}", columns_of(some[start : start + BLOCK_RECORDS]))
