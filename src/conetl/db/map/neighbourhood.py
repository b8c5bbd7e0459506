"""The locks of a drive: drives in different regions of a map are merged side by side.

A drive shares the map's lock, which decisions, imports and everything else take for themselves, and has for itself the squares
of the map that it, and the later drives that are compared again because of it, come near. Two drives with no square in common
read and write different features: none is farther than the influence of a drive from its path. Locks are taken in one order, all
before anything is written, so no two drives wait for each other. `take_turn` then lets one drive at a time number its changeset
and commit, because numbers and instants of changesets rise in the order in which readers see them.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import NamedTuple
from uuid import UUID

from conetl.db.connection import Connection, execute
from conetl.db.map.map_store import find_changeset, find_map, map_lock
from conetl.db.map.replay_store import affected_drives, superseded_drives
from conetl.db.map.results import CommittedChangeset, DriveRef
from conetl.db.statements import load_sql
from conetl.model.records import Drive

#: A town is a few regions, a drive of 100 km about a hundred.
REGION_M = 2048.0
#: A feature that was moved over the edge of two areas is within this of both: they have a region in common.
MARGIN_M = 50.0
#: A drive that comes near more of them takes the whole map: the private server has room for 5,000 locks of all sessions.
MAX_REGIONS = 200


class Neighbourhood(NamedTuple):
    """A drive on the map, and whom it affects; nobody else changes that until the transaction ends."""

    drive_uuid: UUID
    aside: list[UUID]
    """The drive, and the analyses and deliveries of its recording that it replaces."""
    affected: list[DriveRef]
    """Active drives of `aside`, and the later drives that must be compared again, in the order of the fold."""

    @property
    def later(self) -> list[DriveRef]:
        return [ref for ref in self.affected if ref.drive_uuid not in self.aside]


def lock_neighbourhood(
    conn: Connection,
    map_name: str,
    drive: Drive,
    idempotency_key: str,
    place: Callable[[], UUID],
    *,
    path_wkt: str | None,
    influence_m: float,
) -> Neighbourhood | CommittedChangeset:
    """Take the locks of a drive in an open transaction, which must not have written before, and add it to the map.

    place: adds it (`place_drive`). path_wkt: its path (line, map CRS), of which it may change everything within influence_m;
    None: it changes nothing, because its recording is on hold. The result is a changeset, and nothing was added, where
    the drive is on the map already.
    """
    recording = {f"{map_name}/drive/{drive.drive_id}", f"{map_name}/content/{drive.content_sha256}"}
    regions = set[str]() if path_wkt is None else regions_of(conn, [], path_wkt=path_wkt, influence_m=influence_m)
    whole = False
    while True:
        execute(conn, "savepoint neighbourhood")
        map_lock(conn, map_name, shared=not whole)
        names = recording | {f"{map_name}/region/{region}" for region in regions}
        execute(conn, load_sql("locks.take_parts"), {"names": [] if whole else sorted(names)})
        info = find_map(conn, map_name)
        # A drive that may create the map, or set it aside, does so alone.
        if whole or (info is not None and info.counts and len(regions) <= MAX_REGIONS):
            if (known := find_changeset(conn, idempotency_key, map_name=map_name)) is not None:
                return known
            drive_uuid = place()
            if path_wkt is None:
                found = Neighbourhood(drive_uuid, [drive_uuid], [])
            else:
                aside = [drive_uuid, *superseded_drives(conn, drive_uuid)]
                found = Neighbourhood(drive_uuid, aside, affected_drives(conn, aside))
            near = regions_of(conn, [*found.aside[1:], *(ref.drive_uuid for ref in found.later)])
            if whole or near <= regions:
                execute(conn, "release savepoint neighbourhood")
                return found
            regions |= near  # another drive was there meanwhile, or a late one affects drives farther away
        whole = len(regions) > MAX_REGIONS or info is None or not info.counts
        execute(conn, "rollback to savepoint neighbourhood")  # frees the locks, too


def regions_of(
    conn: Connection, drive_uuids: Collection[UUID], *, path_wkt: str | None = None, influence_m: float = 0.0
) -> set[str]:
    """The regions that the areas of some drives, and of a path of a drive that is not stored yet, come near."""
    parameters = {
        "drive_uuids": list(drive_uuids),
        "path_wkt": path_wkt,
        "influence_m": influence_m,
        "side_m": REGION_M,
        "margin_m": MARGIN_M,
    }
    if not drive_uuids and path_wkt is None:
        return set()
    return {row["region"] for row in execute(conn, load_sql("locks.regions"), parameters)}


def take_turn(conn: Connection, map_name: str) -> None:
    """Be the only one that numbers and commits a changeset of the map, until the transaction ends."""
    execute(conn, load_sql("locks.take_parts"), {"names": [f"{map_name}/turn"]})
