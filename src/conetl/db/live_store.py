"""Provisional features of a drive that is being recorded. Not part of the map; the ingest of the drive removes them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any
from uuid import UUID

from conetl.db.connection import Connection, execute_count, load_sql, query, read, transaction
from conetl.db.copy_rows import clean_text
from conetl.db.receipt_store import held_locks
from conetl.geometry.packing import horizontal_sigma_m
from conetl.model.drive import Drive, Track

#: Watched drives that were never ingested are deleted after this time, when the next watch begins.
KEEP_DAYS = 7
_COV = ("cov_xx", "cov_xy", "cov_xz", "cov_yy", "cov_yz", "cov_zz")
_OF_TRACK = {"object_height_m", "existence_probability", "observation_count", "first_seen_ns", "last_seen_ns"}


@dataclass(frozen=True)
class WatchedDrive:
    """A drive that is being watched while it is recorded."""

    watch_id: UUID
    map_name: str
    srid: int
    drive_id: str
    source_path: str


def watch_lock(map_name: str, drive_id: str) -> str:
    """Name of the lock that is held while a drive is watched."""
    return f"conetl.watch/{map_name}/{drive_id}"


def clear_watches(conn: Connection, *, map_name: str, drive_id: str) -> int:
    """Remove earlier watches of this drive, interrupted ones, and those older than a week. Returns the number of watches removed.

    The caller holds the drive's own `watch_lock`. Watches whose lock another process holds are running and stay.
    """
    with transaction(conn, "The watched drives cannot be read"):
        parameters = {"map_name": map_name, "drive_id": clean_text(drive_id), "keep_days": KEEP_DAYS}
        found = query(conn, "live.watches_to_drop", **parameters)
    others = {watch_lock(map_name, row["drive_id"]) for row in found if row["drive_id"] != clean_text(drive_id)}
    alive = held_locks(conn, sorted(others))
    dead = [row["watch_id"] for row in found if watch_lock(map_name, row["drive_id"]) not in alive]
    with transaction(conn, "The watched drives cannot be cleared"):
        return execute_count(conn, load_sql("live.drop_watches"), {"watch_ids": dead}) if dead else 0


def write_live(
    conn: Connection,
    watch: WatchedDrive,
    *,
    captured_ns: tuple[int, int],
    frame_pair_count: int,
    tracks: Mapping[int, Track],
    taken_back: Iterable[int],
    least_reach_m: float,
) -> None:
    """Commit the changes by one frame pair, in one transaction. captured_ns: of the first and the last pair processed.

    A standing feature of the map nearer than `least_reach_m` plus three sigmas is recorded as the same cone.
    """
    with transaction(conn, f"The provisional features of drive {watch.drive_id} cannot be written"):
        named = {name: clean_text(value) if isinstance(value, str) else value for name, value in vars(watch).items()}
        captured = {"captured_from_ns": captured_ns[0], "captured_to_ns": captured_ns[1]}
        query(conn, "live.upsert_watched_drive", **named, **captured, frame_pair_count=frame_pair_count)
        for index, track in tracks.items():
            row = {
                "feature_index": index, "east_m": track.xyz_m[0], "north_m": track.xyz_m[1], "height_m": track.xyz_m[2],
                **dict(zip(_COV, track.cov_m2, strict=True)), **track.model_dump(include=_OF_TRACK),
                "reach_m": least_reach_m + 3 * horizontal_sigma_m(track.cov_m2),
            }  # fmt: skip
            query(conn, "live.upsert_provisional_feature", **named | row)
        for index in taken_back:
            query(conn, "live.drop_provisional_feature", watch_id=watch.watch_id, feature_index=index)


def end_watch(conn: Connection, watch: WatchedDrive) -> None:
    """Mark a watch as ended normally; its features stay until the drive is ingested."""
    with transaction(conn, f"The end of drive {watch.drive_id} cannot be written"):
        query(conn, "live.end_watch", watch_id=watch.watch_id)


def drop_watched_recording(conn: Connection, drive: Drive, *, map_name: str) -> int:
    """Remove the watches of a drive that is now on the map, inside the caller's transaction. Returns their number."""
    captured_from_ns, captured_to_ns = drive.captured_ns
    parameters = {
        "map_name": map_name, "drive_id": clean_text(drive.drive_id),
        "captured_from_ns": captured_from_ns, "captured_to_ns": captured_to_ns,
    }  # fmt: skip
    return execute_count(conn, load_sql("live.drop_watched_recording"), parameters)


def read_provisional(conn: Connection, *, map_name: str) -> list[dict[str, Any]]:
    """Provisional features of a map, drive by drive; columns as in `live.provisional_features`."""
    return read(conn, f"The map {map_name} cannot be read", "live.provisional_features", map_name=map_name)
