"""The map in PostGIS: read its features, commit changesets, tell what happened.

One drive is one atomic changeset. The caller holds the map's lock from reading the features to the commit:

    with map_transaction(conn, map_name):
        if find_changeset(conn, key, map_name=map_name) is None:
            drive_uuid = place_drive(conn, drive, key, ...)
            ...                                       # compare in Python: in pipeline/replay.py
            commit_changeset(conn, records, changeset, map_name=map_name)

Everything is committed at the end of the block, or nothing.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from typing import Any
from uuid import NAMESPACE_URL, UUID, uuid5

from conetl.db.connection import (
    Connection,
    copy_columns,
    database_errors,
    execute,
    execute_count,
    load_sql,
    stream,
    transaction,
)
from conetl.db.copy_binary import clean_text, json_text
from conetl.db.live_store import drop_watched_recording
from conetl.db.map import columns as map_columns
from conetl.db.map.changeset_rows import insert_changeset
from conetl.db.map.commit_checks import require_consistent
from conetl.db.map.quarantine_store import insert_rejections
from conetl.db.map.record_load import load_records, records_encoded
from conetl.db.map.replay_store import write_replay
from conetl.db.map.results import (
    CommitResult,
    CommittedChangeset,
    FeatureAtInstant,
    FeatureLogEntry,
    MapInfo,
    MapSummary,
    RecordCounts,
    Replay,
    RunInfo,
)
from conetl.db.map.rows import feature_of
from conetl.model.detector_evidence import AbsenceFigures
from conetl.model.errors import MapMismatchError
from conetl.model.map_records import Changeset, DeltaKind, MapFeature
from conetl.model.params import ReconcileParams
from conetl.model.records import (
    Drive,
    DriveRecords,
    utc_from_ns,
)

Bbox = tuple[float, float, float, float]
"""west, south, east, north in metres of the map's CRS."""
LOCK_TIMEOUT_S = 600.0
#: From so many new versions on, if they are a tenth of the table, the planner's image is renewed before autovacuum comes.
ANALYSE_FROM_VERSIONS = 10_000
#: Features this far around the path may be seen by a drive: the farthest position plus the largest offset and move.
INFLUENCE_M = 60.0
#: `write/insert_drive` makes the area larger by more than this.
_PATH_STEP_M = 3.0
_NAMESPACE = uuid5(NAMESPACE_URL, "https://conetl.example/drive")


# --------------------------------------------------------------------------- reading


@contextmanager
def map_transaction(
    conn: Connection, map_name: str = "default", *, lock_timeout_s: float = LOCK_TIMEOUT_S
) -> Iterator[None]:
    """One transaction under the map's lock: committed at the end of the block, rolled back on any error.

    Raises `DatabaseError` where the database is lost on the way, or another ingest holds the map longer than
    `lock_timeout_s`; nothing was written then (a commit whose answer was lost is found by its idempotency key).
    """
    with transaction(conn, f"The map {map_name} could not be changed, and is as it was before"):
        execute(conn, load_sql("write/set_lock_timeout"), {"timeout": f"{lock_timeout_s * 1000:.0f}ms"})
        map_lock(conn, map_name)
        yield


def map_lock(conn: Connection, map_name: str = "default") -> None:
    """Take the map's lock until the end of the open transaction; other ingests into the same map wait."""
    execute(conn, load_sql("write/lock_map"), {"map_name": map_name})


def find_map(conn: Connection, map_name: str = "default") -> MapInfo | None:
    """The map, None where no drive was ever committed to it."""
    with database_errors(f"The map {map_name} cannot be read"):
        rows = execute(conn, load_sql("map/find_map"), {"map_name": map_name})
    return MapInfo(**rows[0]) if rows else None


def read_current_features(
    conn: Connection, *, map_name: str = "default", within: Bbox | None = None
) -> list[MapFeature]:
    """The features that stand on the map now, by feature id; `within` in the map's CRS. [] where there is no such map."""
    parameters = _box(conn, map_name, within)
    with database_errors(f"The features of map {map_name} cannot be read"):
        return [feature_of(row) for row in stream(conn, load_sql("map/current_features"), parameters)]


def read_features_as_of(
    conn: Connection,
    valid_at: datetime | None = None,
    *,
    known_at: datetime | None = None,
    map_name: str = "default",
    within: Bbox | None = None,
) -> Iterator[FeatureAtInstant]:
    """The features that stood on the road at `valid_at` (None: latest), as the database knew it at `known_at` (None: now).

    By feature id, read as they are consumed; both instants need a time zone (ValueError without).
    """
    for instant in (valid_at, known_at):
        if instant is not None and instant.tzinfo is None:
            raise ValueError(f"{instant} has no time zone: UTC or another one must be stated")
    parameters = _box(conn, map_name, within) | {
        "valid_at": valid_at.isoformat() if valid_at else "infinity",
        "known_at": known_at.isoformat() if known_at else "infinity",
    }
    with database_errors(f"The features of map {map_name} cannot be read"):
        for row in stream(conn, load_sql("map/features_as_of"), parameters):
            yield FeatureAtInstant(feature_of(row), *row[22:27])


def find_changeset(conn: Connection, idempotency_key: str, *, map_name: str = "default") -> CommittedChangeset | None:
    """The changeset that the same drive with the same parameters, model and CRS made before; None where it is new."""
    rows = _changesets(conn, map_name, idempotency_key, 1)
    return rows[0] if rows else None


def list_changesets(
    conn: Connection, *, map_name: str = "default", limit: int | None = None
) -> list[CommittedChangeset]:
    """Changesets of a map, newest first."""
    return _changesets(conn, map_name, None, limit)


def feature_log(conn: Connection, feature_id: UUID) -> list[FeatureLogEntry]:
    """Everything that happened to a feature, oldest first; [] where there is no such feature."""
    with database_errors(f"The history of feature {feature_id} cannot be read"):
        rows = execute(conn, load_sql("map/feature_log"), {"feature_id": feature_id})
    return [FeatureLogEntry(**row | {"kind": DeltaKind(row["kind"])}) for row in rows]


def find_features(conn: Connection, beginning: str, *, map_name: str = "default") -> list[UUID]:
    """Ids that begin with `beginning`, of standing and removed features; at most two."""
    parameters = {"map_name": map_name, "beginning": clean_text(beginning).lower()}
    with database_errors(f"The map {map_name} cannot be read"):
        return [row["feature_id"] for row in execute(conn, load_sql("map/find_features"), parameters)]


def map_summary(conn: Connection, map_name: str = "default") -> MapSummary | None:
    """The map in figures, None where there is no such map."""
    with database_errors(f"The map {map_name} cannot be read"):
        rows = execute(conn, load_sql("map/summary"), {"map_name": map_name})
    return MapSummary(**rows[0]) if rows else None


# --------------------------------------------------------------------------- committing


def commit_changeset(
    conn: Connection,
    records: DriveRecords,
    changeset: Changeset,
    *,
    map_name: str = "default",
    now: datetime | None = None,
    run: RunInfo | None = None,
    suppressed: Collection[UUID] = (),
    replay: Replay | None = None,
) -> CommitResult:
    """Write a drive, everything made from it, and its changeset, inside the caller's `map_transaction`.

    The map is made by its first changeset and takes the drive's SRID. `now` is the system time of the changeset (None: the
    server's clock); it is pushed past the map's last one where it is not later. Versions are numbered here: the open one's
    plus one. suppressed: features that end up where a person said that nothing stands. replay: for a drive that is older than
    others around it, the whole neighbourhood as it is to be believed, the changeset's own deltas included. Raises
    MapMismatchError where the drive is in another CRS, the records do not fit together, or a delta's `old` is not what the map
    holds now; DatabaseError from the surrounding `map_transaction`.
    """
    map_lock(conn, map_name)
    known = find_changeset(conn, changeset.idempotency_key, map_name=map_name)
    if known is not None:
        return CommitResult(committed=False, changeset=known, versions_written=0)
    require_consistent(records, changeset)
    drive, detections, matches, positions, tracks, rejections = records
    drive_uuid = place_drive(conn, drive, changeset.idempotency_key, map_name=map_name, now=now)
    info = map_for(conn, map_name, drive.map_srid, f"drive {drive.drive_id}", now)
    committed_at = system_time(conn, info, now)
    counts = RecordCounts(
        frame_pair_count=len(drive.frame_pairs),
        detection_count=len(detections),
        match_count=len(matches),
        position_count=len(positions),
        track_count=len(tracks),
        rejection_count=len(rejections),
    )
    insert_changeset(conn, info, drive_uuid, changeset, counts, run, committed_at)
    insert_rejections(conn, changeset.changeset_id, rejections)
    drop_watched_recording(conn, drive, map_name=map_name)
    if replay is None:
        _stage_deltas(conn, info, changeset, suppressed)
    with records_encoded(drive_uuid, info.srid, records) as blocks:
        if replay is None:
            versions_written = _merge_deltas(conn, info, drive_uuid, changeset, committed_at)
        else:
            versions_written = write_replay(conn, info, replay, committed_at)
        load_records(conn, blocks)
    written = find_changeset(conn, changeset.idempotency_key, map_name=map_name)
    if written is None:
        raise MapMismatchError(f"changeset {changeset.changeset_id} was written but cannot be found again")
    return CommitResult(committed=True, changeset=written, versions_written=versions_written)


def place_drive(
    conn: Connection,
    drive: Drive,
    idempotency_key: str,
    *,
    map_name: str = "default",
    now: datetime | None = None,
    reconcile: ReconcileParams | None = None,
    influence_m: float = INFLUENCE_M,
    figures: AbsenceFigures | None = None,
) -> UUID:
    """Make the drive known to the map unless it is, so that it can be asked what is around it; does not commit.

    It counts only once its changeset is there. reconcile (default: the defaults), influence_m and figures (of the detector; None:
    nothing was measured) are kept, so that the drive can be compared with the map again. Raises MapMismatchError where the map
    is in another CRS.
    """
    info = map_for(conn, map_name, drive.map_srid, f"drive {drive.drive_id}", now)
    drive_uuid = uuid5(_NAMESPACE, f"{map_name}/{idempotency_key}")
    times_ns = [pair.captured_at_ns for pair in drive.frame_pairs]
    parameters = {
        "drive_uuid": drive_uuid,
        "map_id": info.map_id,
        "srid": info.srid,
        "drive_id": clean_text(drive.drive_id),
        "source_path": clean_text(drive.source_path),
        "content_sha256": drive.content_sha256,
        "rig": json_text(drive.rig.model_dump(mode="json")),
        "captured_from_ns": min(times_ns),
        "captured_to_ns": max(times_ns),
        "captured_from": utc_from_ns(min(times_ns)),
        "captured_to": utc_from_ns(max(times_ns)),
        "expected_frame_count": drive.expected_frame_count,
        "reconcile": json_text((reconcile or ReconcileParams()).model_dump(mode="json")),
        "influence_m": influence_m,
        "absence_figures": None if figures is None else json_text(figures.model_dump(mode="json")),
        "path_wkt": _path_wkt(drive),
    }
    execute(conn, load_sql("write/insert_drive"), parameters)
    return drive_uuid


def system_time(conn: Connection, info: MapInfo, now: datetime | None = None) -> datetime:
    """The instant of a new changeset or decision: now (None: the server's clock), but later than the map's last one."""
    clock = {"now": now, "last_committed_at": info.last_committed_at}
    instant: datetime = execute(conn, load_sql("write/system_time"), clock)[0]["committed_at"]
    return instant


def _path_wkt(drive: Drive) -> str:
    """The drive's path as a line, without points nearer than `_PATH_STEP_M` to the one before."""
    points = [drive.frame_pairs[0].pose.map_t_body_m]
    for pair in drive.frame_pairs:
        at = pair.pose.map_t_body_m
        if max(abs(at[0] - points[-1][0]), abs(at[1] - points[-1][1])) >= _PATH_STEP_M:
            points.append(at)
    points.append((points[-1][0] + 0.1, *points[-1][1:]))  # a line needs two points
    return "LINESTRING(" + ", ".join(f"{x!r} {y!r}" for x, y, _ in points) + ")"


def _stage_deltas(conn: Connection, info: MapInfo, changeset: Changeset, suppressed: Collection[UUID]) -> None:
    """All deltas into a table of the transaction's own."""
    execute(conn, load_sql("write/create_delta_stage"))
    copy_columns(conn, "delta_stage", map_columns.delta_columns(info.srid, changeset.deltas, suppressed))
    execute(conn, "analyze delta_stage (feature_id, kind, is_change)")


def _merge_deltas(
    conn: Connection, info: MapInfo, drive_uuid: UUID, changeset: Changeset, committed_at: datetime
) -> int:
    """Set-based: check the staged deltas against the map, close what they replace, write what they bring."""
    execute(conn, load_sql("write/create_open_version"), {"drive_uuid": drive_uuid})
    execute(conn, "analyze open_version")
    execute(conn, load_sql("write/add_open_versions"))
    conflicts = execute(conn, load_sql("map/delta_conflicts"), {"map_id": info.map_id})
    if conflicts:
        raise MapMismatchError(_conflict_text(info.map_name, conflicts))
    parameters = {
        "map_id": info.map_id,
        "srid": info.srid,
        "changeset_id": changeset.changeset_id,
        "committed_at": committed_at,
    }
    execute(conn, load_sql("write/insert_features"), parameters)
    execute(conn, load_sql("write/close_versions"), parameters)
    execute(conn, load_sql("write/insert_ended_versions"), parameters)
    versions = execute_count(conn, load_sql("write/insert_versions"), parameters)
    execute(conn, load_sql("write/insert_deltas"), parameters)
    execute(conn, "drop table delta_stage, open_version")
    if (
        versions >= ANALYSE_FROM_VERSIONS
        and execute(conn, load_sql("map/has_outgrown"), {"versions": versions})[0]["outgrown"]
    ):
        execute(conn, "analyze conetl.feature, conetl.feature_version")
    return versions


def _conflict_text(map_name: str, conflicts: Sequence[Mapping[str, Any]]) -> str:
    first = conflicts[0]
    found = "nothing" if first["version"] is None else f"version {first['version']}"
    state = "" if first["present"] is None else (" (standing)" if first["present"] else " (removed)")
    return (
        f"The map {map_name} is not the one that this drive was compared with: feature {first['feature_id']} should be "
        f"{first['kind']} from version {first['old_version']}, but the map holds {found}{state}. Nothing was written; ingest "
        "the drive again."
    )


def map_for(conn: Connection, map_name: str, srid: int, what: str, now: datetime | None = None) -> MapInfo:
    """The map, made where there is none; does not commit. Raises MapMismatchError where it is not in EPSG:srid, as `what` is."""
    info = find_map(conn, map_name)
    if info is None:
        created = {"map_name": map_name, "srid": srid, "created_at": now or datetime.now(UTC)}
        execute(conn, load_sql("write/insert_map"), created)
        info = find_map(conn, map_name)
    if info is None or info.srid != srid:
        raise MapMismatchError(
            f"{what} is in EPSG:{srid}, the map {map_name} in EPSG:{info.srid if info else '?'}: set "
            "the drive's map CRS in its drive.yaml to the map's, or ingest it into a map of its own."
        )
    return info


def _changesets(conn: Connection, map_name: str, key: str | None, limit: int | None) -> list[CommittedChangeset]:
    parameters = {"map_name": map_name, "idempotency_key": key, "max_rows": limit}
    with database_errors(f"The changesets of map {map_name} cannot be read"):
        return [CommittedChangeset(**row) for row in execute(conn, load_sql("map/changesets"), parameters)]


def _box(conn: Connection, map_name: str, within: Bbox | None) -> dict[str, Any]:
    west_m, south_m, east_m, north_m = within or (None, None, None, None)
    info = find_map(conn, map_name) if within else None
    parameters = {"map_name": map_name, "srid": info.srid if info else 0}
    return parameters | {"west_m": west_m, "south_m": south_m, "east_m": east_m, "north_m": north_m}
