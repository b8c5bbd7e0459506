"""Which drives must be compared with the map again, the current state of their neighbourhood, its locks, and its new state.

Rows are changed only by closing their system period; versions and deltas whose result is unchanged stay as they are.

Drives in different regions of a map are merged in parallel. A drive takes the map's lock as a shared one (decisions, imports and
everything else take it exclusively), and exclusive locks on the squares of the map near its own area and those of the later
drives that are compared again because of it. Two drives with no square in common read and write different features: none is
farther than the influence of a drive from its path. Locks are taken in a fixed order, all before anything is written, so that
drives cannot deadlock. `take_turn` then lets one drive at a time number its changeset and commit, because numbers and instants of
changesets must rise in the order in which readers see them.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from datetime import datetime
from typing import Any, NamedTuple
from uuid import UUID

from conetl.db import connection as db
from conetl.db.connection import Connection
from conetl.db.map import rows as map_rows
from conetl.db.map.decision_store import write_holds
from conetl.db.map.map_store import find_changeset, find_map, map_lock
from conetl.db.map.results import CommittedChangeset, DriveRef, MapInfo, Replay, StoredDeltas
from conetl.db.map.rows import Row, version_of
from conetl.model.drive import Drive
from conetl.model.errors import MapMismatchError
from conetl.model.map_records import DriveOrder, FeatureVersion, Location, Miss

#: A town is a few regions, a drive of 100 km about a hundred.
REGION_M = 2048.0
#: A feature that was moved over the edge of two areas is within this of both: they have a region in common.
MARGIN_M = 50.0
#: A drive that comes near more of them takes the whole map: the private server has room for 5,000 locks of all sessions.
MAX_REGIONS = 200
_UNREAD = "The neighbourhood of the drives cannot be read"


def read_standing_around(conn: Connection, drive_uuid: UUID) -> dict[UUID, dict[FeatureVersion, int]]:
    """The standing versions of the features (suppressed ones included) around a drive's path, by feature id: their rows, the
    open one last, with the row ids."""
    what = "The features around the drive cannot be read"
    found: dict[UUID, dict[FeatureVersion, int]] = {}
    missed: list[UUID] = []
    for row in db.stream(conn, what, "replay.standing_around", drive_uuid=drive_uuid):
        if row["first_missed_ns"] is None:
            found[row["feature_id"]] = {version_of(row): row["version_row_id"]}
        else:
            missed.append(row["feature_id"])
    for row in db.read(conn, what, "replay.rows_of_missed", feature_ids=missed) if missed else ():
        found.setdefault(row["feature_id"], {})[version_of(row)] = row["version_row_id"]
    return found


def affected_drives(conn: Connection, drive_uuids: Sequence[UUID]) -> list[DriveRef]:
    """The drives to compare again if `drive_uuids` are added, removed or judged differently, in the order of recording.

    They are the active ones of `drive_uuids`, and all later ones whose areas they meet, directly or through others.
    """
    rows = db.query(conn, "replay.affected_drives", drive_uuids=list(drive_uuids))
    return [DriveRef(**row) for row in rows]


def superseded_drives(conn: Connection, drive_uuid: UUID) -> list[UUID]:
    """The active analysis or delivery of the same recording that this drive replaces."""
    return [row["drive_uuid"] for row in db.query(conn, "replay.superseded_drives", drive_uuid=drive_uuid)]


def other_deliveries(
    conn: Connection, drive_id: str, captured_ns: tuple[int, int], content_sha256: str, *, map_name: str
) -> list[int]:
    """Numbers of active changesets of the same recording with other content, for example with corrected poses.

    captured_ns: instants of its first and last frame pair.
    """
    rows = db.read(
        conn, "Other deliveries of the drive cannot be read", "drives.other_deliveries", map_name=map_name,
        drive_id=drive_id, captured_from_ns=captured_ns[0], captured_to_ns=captured_ns[1], content_sha256=content_sha256,
    )  # fmt: skip
    return [row["changeset_no"] for row in rows]


def drives_at(conn: Connection, map_name: str, location: Location) -> list[UUID]:
    """The active drives that may judge features within the radius of a location (map CRS)."""
    easting_m, northing_m = location.xy_m
    around = {"easting_m": easting_m, "northing_m": northing_m, "radius_m": location.radius_m}
    return [row["drive_uuid"] for row in db.query(conn, "replay.drives_at", map_name=map_name, **around)]


def read_versions(
    conn: Connection, drive_uuids: Sequence[UUID], *, without: Collection[UUID] = ()
) -> tuple[dict[FeatureVersion, int], list[tuple[DriveOrder, FeatureVersion]]]:
    """All current rows of features that ever stood around the drives, with row ids; and those of versions by drives that are not
    in `without`, with drive keys."""
    rows = db.stream(conn, _UNREAD, "replay.versions_around", drive_uuids=list(drive_uuids))
    stored: dict[FeatureVersion, int] = {}
    others: list[tuple[DriveOrder, FeatureVersion]] = []
    for row in rows:
        version = version_of(row)
        stored[version] = row["version_row_id"]
        if row["drive_uuid"] not in without and not version.is_missed:  # misses: read_misses
            others.append((_key(row), version))
    return stored, others


def read_misses(
    conn: Connection, drive_uuids: Sequence[UUID], *, without: Collection[UUID]
) -> list[tuple[DriveOrder, Miss]]:
    """Every current miss of features that ever stood around the drives, by drives that are not in `without`."""
    rows = db.stream(conn, _UNREAD, "replay.misses_around", drive_uuids=list(drive_uuids))
    return [(_key(row), map_rows.record_of(Miss, row)) for row in rows if row["drive_uuid"] not in without]


def _key(row: Row) -> DriveOrder:
    return row["captured_from_ns"], row["content_sha256"], row["idempotency_key"]


def read_deltas(conn: Connection, drive_uuids: Sequence[UUID]) -> StoredDeltas:
    """The current deltas of the drives."""
    what = "The deltas of the drives cannot be read"
    rows = db.stream_values(conn, what, "replay.current_deltas", drive_uuids=list(drive_uuids))
    return {tuple(values): row_id for row_id, *values in rows}


def write_replay(conn: Connection, info: MapInfo, replay: Replay, committed_at: datetime) -> int:
    """Write the new state where it differs from the old one. Returns the number of versions written. Does not commit."""
    return apply_stages(conn, load_stages(conn, info, replay), replay, committed_at)


def load_stages(conn: Connection, info: MapInfo, replay: Replay) -> dict[str, Any]:
    """Load what differs from the old state into temporary tables; returns parameters for the statements of `apply_stages`."""
    wanted, known = set(replay.versions), replay.deltas_before
    values = {
        (changeset_id, *map_rows.change_values(delta)): (changeset_id, delta) for changeset_id, delta in replay.deltas
    }
    new = [version for version in replay.versions if version not in replay.versions_before]
    new_deltas = [change for value, change in values.items() if value not in known]
    db.query(conn, "replay.create_version_stage")
    db.copy_columns(conn, "version_stage", map_rows.version_columns(info.srid, new))
    db.query(conn, "replay.create_replayed_delta_stage")
    db.copy_columns(conn, "replayed_delta_stage", map_rows.replayed_delta_columns(new_deltas))
    db.execute(conn, "analyze version_stage, replayed_delta_stage")
    return {
        "map_id": info.map_id,
        "map_name": info.map_name,
        "srid": info.srid,
        "closed_versions": [row_id for version, row_id in replay.versions_before.items() if version not in wanted],
        "closed_deltas": [row_id for value, row_id in known.items() if value not in values],
    }


def apply_stages(conn: Connection, staged: dict[str, Any], replay: Replay, committed_at: datetime) -> int:
    """Write what `load_stages` loaded. Returns the number of versions. Raises MapMismatchError if the map has changed since."""
    parameters = staged | {"committed_at": committed_at}
    db.query(conn, "replay.insert_staged_features", **parameters)
    for rows in ("versions", "deltas"):
        closed = db.execute_count(conn, db.load_sql(f"replay.close_{rows}"), parameters)
        if closed != len(staged[f"closed_{rows}"]):
            raise MapMismatchError(
                f"The map {staged['map_name']} changed since it was read. Nothing was written; run the same command again."
            )
    written = db.execute_count(conn, db.load_sql("replay.insert_staged_versions"), parameters)
    db.query(conn, "replay.insert_replayed_deltas", **parameters)
    db.execute(conn, "drop table version_stage, replayed_delta_stage")
    checks = {changeset: () if check is None else (check,) for changeset, check in replay.holds.items()}
    write_holds(conn, checks, committed_at, by_map=True)
    return written


def read_open_version(conn: Connection, map_name: str, feature_id: UUID) -> FeatureVersion | None:
    """The current open version of one feature, standing, suppressed or removed; None if it has none."""
    wanted = {"map_name": map_name, "feature_id": feature_id, "valid_until": "infinity"}
    rows = db.stream(conn, f"Feature {feature_id} cannot be read", "map.current_versions", **wanted)
    versions = [version_of(row) for row in rows]
    return next((version for version in versions if version.valid_to_ns is None), None)


class Neighbourhood(NamedTuple):
    """A drive on the map, and the drives that it affects; no other process changes them until the transaction ends."""

    drive_uuid: UUID
    aside: list[UUID]
    """The drive, and the analyses and deliveries of its recording that it replaces."""
    affected: list[DriveRef]
    """Active drives of `aside`, and the later drives that must be compared again, in the order of recording."""
    reaches_far: bool = False
    """Whether other drives may have to be compared again; the whole map is locked then."""

    @property
    def later(self) -> list[DriveRef]:
        return [ref for ref in self.affected if ref.drive_uuid not in self.aside]


def lock_neighbourhood(
    conn: Connection,
    map_name: str,
    drive: Drive,
    idempotency_key: str,
    add: Callable[[], UUID],
    *,
    path_wkt: str | None,
    influence_m: float,
    adjoining_ns: int = 0,
    reaches_far: Callable[[Neighbourhood], bool] = lambda found: False,
) -> Neighbourhood | CommittedChangeset:
    """Lock the neighbourhood of a drive and add the drive to the map, in an open transaction that has not written yet.

    add: adds the drive (`add_drive`). path_wkt: its path (line, map CRS), around which it may change everything within
    influence_m; None: it changes nothing, because its recording is on hold. adjoining_ns: no other drive of the rig that was
    recorded within this time before or after it is merged meanwhile. reaches_far: whether drives that are still unknown may have
    to be compared again as well. If the drive is already on the map, the result is its changeset, and nothing is added.
    """
    recording = {f"{map_name}/drive/{drive.drive_id}", f"{map_name}/content/{drive.content_sha256}"}
    if path_wkt is not None and adjoining_ns:
        slots = {
            (at_ns + off_ns) // (2 * adjoining_ns)
            for at_ns in drive.captured_ns
            for off_ns in (-adjoining_ns, adjoining_ns)
        }
        recording |= {f"{map_name}/rig/{drive.rig.rig_id}/{slot}" for slot in slots}
    regions = set[str]() if path_wkt is None else regions_of(conn, [], path_wkt=path_wkt, influence_m=influence_m)
    whole = far = False
    while True:
        db.execute(conn, "savepoint neighbourhood")
        map_lock(conn, map_name, shared=not whole)
        names = recording | {f"{map_name}/region/{region}" for region in regions}
        db.query(conn, "locks.take_parts", names=[] if whole else sorted(names))
        info = find_map(conn, map_name)
        # A drive that may create the map, or set it aside, does so alone.
        if whole or (info is not None and info.counts and len(regions) <= MAX_REGIONS):
            if (known := find_changeset(conn, idempotency_key, map_name=map_name)) is not None:
                return known
            drive_uuid = add()
            if path_wkt is None:
                found = Neighbourhood(drive_uuid, [drive_uuid], [])
            else:
                aside = [drive_uuid, *superseded_drives(conn, drive_uuid)]
                found = Neighbourhood(drive_uuid, aside, affected_drives(conn, aside))
            near = regions_of(conn, [*found.aside[1:], *(ref.drive_uuid for ref in found.later)])
            if whole or near <= regions:
                far = path_wkt is not None and reaches_far(found)
                if whole or not far:
                    db.execute(conn, "release savepoint neighbourhood")
                    return found._replace(reaches_far=far)
            regions |= near  # another drive came first, or a late one affects drives farther away
        whole = far or len(regions) > MAX_REGIONS or info is None or not info.counts
        db.execute(conn, "rollback to savepoint neighbourhood")  # frees the locks, too


def regions_of(
    conn: Connection, drive_uuids: Collection[UUID], *, path_wkt: str | None = None, influence_m: float = 0.0
) -> set[str]:
    """The regions near the areas of some drives, and near the path of a drive that is not stored yet."""
    if not drive_uuids and path_wkt is None:
        return set()
    rows = db.query(
        conn, "locks.regions", drive_uuids=list(drive_uuids), path_wkt=path_wkt, influence_m=influence_m,
        side_m=REGION_M, margin_m=MARGIN_M,
    )  # fmt: skip
    return {row["region"] for row in rows}


def take_turn(conn: Connection, map_name: str) -> None:
    """Let only this transaction number and commit changesets of the map until it ends."""
    db.query(conn, "locks.take_parts", names=[f"{map_name}/turn"])
