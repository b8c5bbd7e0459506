"""Read the map in PostGIS: its features, changesets and history; and its lock and clock, which every change uses."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from difflib import get_close_matches
from typing import Any
from uuid import UUID

import numpy as np

from conetl.db import connection as db
from conetl.db.connection import Connection
from conetl.db.copy_rows import clean_text
from conetl.db.map.results import CommittedChangeset, FeatureAtInstant, MapInfo, MapInstant
from conetl.db.map.rows import feature_of, version_of
from conetl.model.errors import InputError, MapMismatchError
from conetl.model.map_records import DeltaKind, FeatureChange, FeatureVersion, MapFeature
from conetl.model.work_zone_records import DrivePath

_log = logging.getLogger(__name__)
_PATH_TOLERANCE_M = 0.05
Bbox = tuple[float, float, float, float]
"""west, south, east, north in metres of the map's CRS."""


@contextmanager
def map_transaction(
    conn: Connection, map_name: str = "default", *, lock_timeout_s: float = db.LOCK_TIMEOUT_S
) -> Iterator[None]:
    """One transaction under the map's lock: committed at the end of the block, rolled back on any error.

    Raises `DatabaseError` if the database is lost meanwhile, or another ingest holds the map longer than `lock_timeout_s`;
    nothing was written then (a commit whose answer was lost is found by its idempotency key).
    """
    with drive_transaction(conn, map_name, lock_timeout_s=lock_timeout_s):
        map_lock(conn, map_name)
        yield


@contextmanager
def drive_transaction(
    conn: Connection, map_name: str = "default", *, lock_timeout_s: float = db.LOCK_TIMEOUT_S
) -> Iterator[None]:
    """As `map_transaction`, but without the lock: a drive takes its own locks (`lock_neighbourhood`)."""
    with db.transaction(conn, f"The map {map_name} could not be changed, and is unchanged"):
        db.query(conn, "commit.set_lock_timeout", timeout=f"{lock_timeout_s * 1000:.0f}ms")
        yield


def map_lock(conn: Connection, map_name: str = "default", *, shared: bool = False) -> None:
    """Take the map's lock until the end of the open transaction. shared: as a shared lock."""
    db.query(conn, "commit.share_map" if shared else "commit.lock_map", map_name=map_name)


def find_map(conn: Connection, map_name: str = "default") -> MapInfo | None:
    """The map; None before the first commit to it."""
    rows = db.read(conn, f"The map {map_name} cannot be read", "map.find_map", map_name=map_name)
    return MapInfo(**rows[0]) if rows else None


def require_map(conn: Connection, map_name: str) -> MapInfo:
    """The map. Raises InputError if it does not exist, with the most similar names."""
    info = find_map(conn, map_name)
    if info is not None:
        return info
    names = [row["map_name"] for row in db.read(conn, "The maps of the database cannot be read", "map.maps")]
    if not names:
        raise InputError(
            f"this database has no map named {map_name}, and no other one: ingest a drive or import a map first"
        )
    near = get_close_matches(map_name, names, n=3, cutoff=0.5)
    others = (
        f"did you mean {' or '.join(near)}?" if near else f"it has {', '.join(names[:5])}{' ...' if names[5:] else ''}."
    )
    raise InputError(
        f"this database has no map named {map_name}; {others} Choose one with --map; `conetl map list` lists all."
    )


def read_current_features(conn: Connection, *, map_name: str = "default", lines: bool = False) -> list[MapFeature]:
    """The point objects, and with `lines` the lane markings, that stand on the map now, by feature id; [] without a map."""
    return [version.feature for version in read_features_as_of(conn, map_name=map_name, lines=lines)]


def read_features_as_of(
    conn: Connection,
    valid_at: datetime | None = None,
    *,
    known_at: datetime | None = None,
    map_name: str = "default",
    within: Bbox | None = None,
    lines: bool = False,
) -> Iterator[FeatureAtInstant]:
    """The point objects that stood on the road at `valid_at` (None: latest), as the database knew it at `known_at` (None: now).

    lines: the lane markings, too. By feature id, read as they are consumed. Raises ValueError for an instant without a time zone.
    """
    for instant in (valid_at, known_at):
        if instant is not None and instant.tzinfo is None:
            raise ValueError(f"{instant} has no time zone: UTC or another one must be stated")
    west_m, south_m, east_m, north_m = within or (None, None, None, None)
    info = find_map(conn, map_name) if within else None
    parameters = {
        "map_name": map_name, "srid": info.srid if info else 0, "max_rows": None,
        "west_m": west_m, "south_m": south_m, "east_m": east_m, "north_m": north_m,
        "lines": lines,
        "valid_at": db.or_infinity(valid_at), "known_at": db.or_infinity(known_at),
    }  # fmt: skip
    own = ("valid_from", "valid_to", "changeset_id")
    for row in db.stream(conn, f"The features of map {map_name} cannot be read", "map.features_as_of", **parameters):
        yield FeatureAtInstant(feature_of(row), **{name: row[name] for name in own})


def read_changes(
    conn: Connection, begin: MapInstant, end: MapInstant, *, map_name: str = "default"
) -> list[FeatureChange]:
    """Features that differ between two states of a map, by feature id; [] without a map."""
    parameters = {
        "map_name": map_name, "from_at": db.or_infinity(begin.valid_at), "known_from": db.or_infinity(begin.known_at),
        "to_at": db.or_infinity(end.valid_at), "known_at": db.or_infinity(end.known_at),
    }  # fmt: skip
    found: dict[UUID, dict[str, Any]] = {}
    for row in db.stream(conn, f"The changes of map {map_name} cannot be read", "map.changes", **parameters):
        own = ("feature_id", "kind", "changed_at", "shift_m", "changeset_no", "drive_id")
        change = found.setdefault(row["feature_id"], {name: row[name] for name in own})
        change["old" if row["is_old"] else "new"] = feature_of(row)
    return [FeatureChange(**change) for change in found.values()]


def find_changeset(conn: Connection, idempotency_key: str, *, map_name: str = "default") -> CommittedChangeset | None:
    """The earlier changeset of the same drive with the same parameters, model and CRS; None if it is new."""
    rows = list_changesets(conn, map_name=map_name, idempotency_key=idempotency_key)
    return rows[0] if rows else None


def list_changesets(
    conn: Connection, *, map_name: str = "default", idempotency_key: str | None = None
) -> list[CommittedChangeset]:
    """Changesets of a map, newest first; or the one of an idempotency key."""
    what = f"The changesets of map {map_name} cannot be read"
    rows = db.read(conn, what, "history.changesets", map_name=map_name, idempotency_key=idempotency_key)
    return [CommittedChangeset(**row) for row in rows]


def feature_log(conn: Connection, feature_id: UUID) -> list[dict[str, Any]]:
    """Everything that happened to a feature, oldest first, columns of `history.feature_log`; [] if it does not exist."""
    what = f"The history of feature {feature_id} cannot be read"
    rows = db.read(conn, what, "history.feature_log", feature_id=feature_id)
    return [row | {"kind": DeltaKind(row["kind"])} for row in rows]


def find_features(conn: Connection, beginning: str, *, map_name: str = "default", max_rows: int = 2) -> list[UUID]:
    """Ids that begin with `beginning`, of standing and removed features; two results mean that it is ambiguous."""
    text = clean_text(beginning).lower()
    try:
        first_id, last_id = (UUID(text.replace("-", "").ljust(32, digit)) for digit in "0f")
    except ValueError:  # no id begins so
        return []
    rows = db.read(
        conn, f"The map {map_name} cannot be read", "map.find_features", map_name=map_name, beginning=text,
        first_id=first_id, last_id=last_id, max_rows=max_rows,
    )  # fmt: skip
    return [row["feature_id"] for row in rows]


def map_summary(conn: Connection, map_name: str = "default") -> dict[str, Any] | None:
    """The map in figures, columns of `map.summary`; None if it does not exist."""
    rows = db.read(conn, f"The map {map_name} cannot be read", "map.summary", map_name=map_name)
    return rows[0] if rows else None


def map_for(conn: Connection, map_name: str, srid: int, what: str, map_id: int | None = None) -> MapInfo:
    """The map, created if it is missing; does not commit. Raises MapMismatchError if it is not in EPSG:srid, as `what` is.

    map_id: of the map of this name when the work on `what` began: if it was renamed or deleted since, nothing is created. If all
    its drives are on hold, perhaps with swapped coordinates, its CRS is not fixed: that map is renamed to set it aside.
    """
    info = find_map(conn, map_name)
    if map_id is not None and (info is None or info.map_id != map_id):
        raise map_gone(what, map_name)
    if info is not None and info.srid != srid and not info.counts:
        new_name = f"{map_name[:20]}-held-{info.srid}-{info.map_id}"
        db.query(conn, "map.set_aside", map_id=info.map_id, new_name=new_name)
        _log.warning("No drive of map %s is in effect: it was renamed to %s", map_name, new_name)
        info = None
    if info is None:
        info = insert_map(conn, map_name, srid)
    if info.srid != srid:
        raise MapMismatchError(
            f"{what} is in EPSG:{srid}, the map {map_name} in EPSG:{info.srid}: set "
            "the drive's map CRS in its drive.yaml to the map's, or ingest it into a separate map. If it was recorded on the "
            "same roads, check whether its latitude and longitude are swapped, or in radians."
        )
    return info


def map_gone(what: str, map_name: str) -> MapMismatchError:
    """The error where the map of `what` does not exist any more."""
    return MapMismatchError(
        f"{what}: the map {map_name} was renamed or deleted during the ingest: it was not made anew, nothing was written. "
        "`conetl map list` shows the maps: name one with --map, and ingest the drive again"
    )


def insert_map(conn: Connection, map_name: str, srid: int, *, vertical_srid: int | None = None) -> MapInfo:
    """Create a map unless it exists; does not commit. The map of that name."""
    db.query(conn, "map.insert_map", map_name=map_name, srid=srid, vertical_srid=vertical_srid)
    return require_map(conn, map_name)


def system_time(conn: Connection, info: MapInfo) -> datetime:
    """The instant of a new changeset or decision: the server's clock, but after the map's last one. Requires the map's lock or
    turn."""
    instant: datetime = db.query(conn, "commit.system_time", map_id=info.map_id)[0]["committed_at"]
    return instant


def read_versions(conn: Connection, *, map_name: str, until: datetime | None = None) -> list[FeatureVersion]:
    """Every current version that began until then (None: all), by feature, with the evidence of then; [] if the map does not
    exist."""
    parameters = {"map_name": map_name, "feature_id": None, "valid_until": db.or_infinity(until)}
    rows = db.stream(conn, f"The history of map {map_name} cannot be read", "map.current_versions", **parameters)
    found: list[FeatureVersion] = []
    for row in map(version_of, rows):
        if row.is_missed:  # the same version, with other evidence
            found[-1] = found[-1].model_copy(update={"feature": row.feature, "valid_to_ns": row.valid_to_ns})
        else:
            found.append(row)
    return found


def read_paths(conn: Connection, *, map_name: str, until: datetime | None = None) -> list[DrivePath]:
    """The paths of the active drives that began until then (None: all), by time."""
    parameters = {"map_name": map_name, "valid_until": db.or_infinity(until), "tolerance_m": _PATH_TOLERANCE_M}
    rows = db.stream(conn, f"The drives of map {map_name} cannot be read", "drives.paths_of_map", **parameters)
    return [
        DrivePath(row["drive_id"], row["captured_from_ns"], np.column_stack([row["eastings_m"], row["northings_m"]]))
        for row in rows
    ]
