"""Imported maps in the database: merged like a drive, with statements in place of tracks."""

from __future__ import annotations

from collections.abc import Sequence
from uuid import NAMESPACE_URL, UUID, uuid5

import numpy as np

from conetl.db import connection as db
from conetl.db.connection import Connection
from conetl.db.copy_rows import Columns, clean_text, json_text
from conetl.db.map import rows as map_rows
from conetl.db.map.commit import insert_changeset, renew_statistics
from conetl.db.map.map_store import require_map, system_time
from conetl.db.map.replay_store import write_replay
from conetl.db.map.results import MapInfo, Replay, RunInfo
from conetl.db.map.rows import Row, feature_of
from conetl.model.arrays import Bools, Floats
from conetl.model.base import utc_from_ns
from conetl.model.map_records import Changeset, ImportedFeature, ImportedMap, MapFeature
from conetl.model.params import ReconcileParams

#: An import judges features this far around a stated position: what it may pair or move, with a margin.
IMPORT_INFLUENCE_M = 10.0
#: Largest number of cells that make the area of an import.
_MAX_CELLS = 2000
#: Columns of cones that an imported map does not state.
_NOT_STATED = ("centre_geom", "calibrations", "shared_jacobian_m")
_NAMESPACE = uuid5(NAMESPACE_URL, "https://conetl.example/import")


def known_ids(conn: Connection, feature_ids: Sequence[UUID]) -> dict[UUID, Row]:
    """The features of this database, in any map, that have one of the ids: rows of `map.known_ids`."""
    rows = db.read(conn, "The features of the database cannot be read", "map.known_ids", feature_ids=list(feature_ids))
    return {row["feature_id"]: row for row in rows}


def far_from_all(conn: Connection, info: MapInfo, places_m: Floats, far_m: float) -> Bools:
    """Which positions (N, 2 or 3) are farther than this from every drive and imported map; none if the map is empty."""
    cells, of = np.unique(np.floor(places_m[:, :2] / (far_m / 10)), axis=0, return_inverse=True)
    east, north = ((cells + 0.5) * (far_m / 10)).T.tolist()
    what, where = f"The map {info.map_name} cannot be read", {"eastings_m": east, "northings_m": north, "far_m": far_m}
    far = [row["is_far"] for row in db.read(conn, what, "map.far_from_all", map_id=info.map_id, **where)]
    return np.array(far, bool)[of.reshape(-1)]


def versions_of_ids(conn: Connection, info: MapInfo, feature_ids: Sequence[UUID]) -> dict[UUID, list[MapFeature]]:
    """All versions of those features of the map that have one of the ids."""
    found: dict[UUID, list[MapFeature]] = {}
    what, wanted = f"The map {info.map_name} cannot be read", {"map_id": info.map_id, "feature_ids": list(feature_ids)}
    for row in db.stream(conn, what, "map.versions_of_ids", **wanted):
        found.setdefault(row["feature_id"], []).append(feature_of(row))
    return found


def add_import(
    conn: Connection, info: MapInfo, imported: ImportedMap, idempotency_key: str, reconcile: ReconcileParams
) -> UUID:
    """Add an imported map as an event that counts once its changeset exists; does not commit."""
    drive_uuid = uuid5(_NAMESPACE, f"{info.id_name}/{idempotency_key}")
    cells, cell_m = _cells(imported.statements)
    db.query(
        conn, "drives.insert_import", drive_uuid=drive_uuid, map_id=info.map_id, srid=info.srid,
        drive_id=clean_text(imported.name), source_path=clean_text(imported.source_path),
        content_sha256=imported.content_sha256, stated_at_ns=imported.stated_at_ns,
        stated_at=utc_from_ns(imported.stated_at_ns), reconcile=json_text(reconcile.model_dump(mode="json")),
        influence_m=IMPORT_INFLUENCE_M, cell_m=cell_m,
        cells_wkt="MULTIPOINT(" + ", ".join(f"({x!r} {y!r})" for x, y in cells) + ")",
    )  # fmt: skip
    return drive_uuid


def commit_import(
    conn: Connection,
    info: MapInfo,
    imported: ImportedMap,
    drive_uuid: UUID,
    changeset: Changeset,
    replay: Replay,
    run: RunInfo,
) -> None:
    """Write an import's statements and changeset, inside the caller's `map_transaction`. drive_uuid: of `add_import`."""
    committed_at = system_time(conn, info)
    insert_changeset(conn, info, drive_uuid, changeset, None, run, committed_at)
    db.copy_columns(conn, "conetl.statement", _statement_columns(drive_uuid, info.srid, imported.statements))
    renew_statistics(conn, write_replay(conn, info, replay, committed_at))


def read_statements(conn: Connection, drive_uuid: UUID) -> list[ImportedFeature]:
    """The features that an imported map states, in the order of its file."""
    rows = db.stream(conn, f"Drive {drive_uuid} cannot be read", "drives.statements", drive_uuid=drive_uuid)
    return [
        ImportedFeature.model_construct(feature=feature_of(row), valid_from_ns=row["valid_from_ns"]) for row in rows
    ]


def read_licence(conn: Connection, map_name: str) -> str | None:
    """Licence of a map's data, None if none was set. Raises InputError if the map does not exist."""
    require_map(conn, map_name)
    facts = db.read(conn, f"The map {map_name} cannot be read", "exports.facts", map_name=map_name)[0]
    return facts["licence"]  # type: ignore[no-any-return]


def set_licence(conn: Connection, map_name: str, licence: str) -> None:
    """Set the licence of a map's data; an empty text removes it."""
    with db.transaction(conn, f"The licence of the map {map_name} could not be set"):
        db.query(conn, "map.set_licence", map_name=map_name, licence=clean_text(licence).strip() or None)


def _statement_columns(drive_uuid: UUID, srid: int, statements: Sequence[ImportedFeature]) -> Columns:
    features = [statement.feature for statement in statements]
    cones = map_rows.cone_columns(srid, features)
    return {
        "drive_uuid": [drive_uuid] * len(statements),
        "statement_index": np.arange(len(statements)),
        "feature_id": [feature.feature_id for feature in features],
        **{name: column for name, column in cones.items() if name not in _NOT_STATED},
        "valid_from_ns": [statement.valid_from_ns for statement in statements],
    }


def _cells(statements: Sequence[ImportedFeature]) -> tuple[list[tuple[float, float]], float]:
    """Centres of the grid cells that contain the stated positions, and the largest distance of a position from its centre (m)."""
    positions = np.array([statement.feature.xyz_m[:2] for statement in statements])
    side_m = IMPORT_INFLUENCE_M
    while True:
        cells = np.unique(np.floor(positions / side_m), axis=0)
        if len(cells) <= _MAX_CELLS:
            return [(float(x), float(y)) for x, y in (cells + 0.5) * side_m], side_m * 0.7072
        side_m *= 2
