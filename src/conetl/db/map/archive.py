"""Maps as a whole: list, rename, delete, and the file (dump) from which a deleted map can be restored with its history.

A dump is a ZIP file: `manifest.json`, and per table one file in the text format of COPY.
"""

from __future__ import annotations

import json
import zipfile
import zlib
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from pydantic import BaseModel, Field

from conetl.db import connection as db
from conetl.db.connection import Connection
from conetl.db.map.map_store import find_map, map_lock, map_transaction, require_map
from conetl.db.map.results import MapInfo
from conetl.db.receipt_store import drives_under_way
from conetl.db.schema import applied_migrations
from conetl.files.atomic import atomic_files
from conetl.files.documents import MAX_JSON_BYTES, first_message
from conetl.model.errors import InputError
from conetl.model.map_records import MAP_NAME

_FORMAT = "conetl map 1"
_MANIFEST = "manifest.json"


class _MapRow(BaseModel, extra="forbid"):
    """The row of `conetl.map` in a dump."""

    map_name: str = Field(pattern=f"^{MAP_NAME.pattern}$")
    id_name: str = Field(min_length=1, max_length=200)
    srid: int = Field(gt=0)
    vertical_srid: int | None = Field(gt=0)
    licence: str | None
    created_at: datetime


class _Manifest(BaseModel):
    """Description of a dump. rows: of each table; columns: of each table, as SQL."""

    format: str
    schema_: list[str] = Field(alias="schema", min_length=1)
    map: _MapRow
    columns: dict[str, str]
    rows: dict[str, int]


def list_maps(conn: Connection) -> list[dict[str, Any]]:
    """All maps of the database, by name: columns of `archive.list_maps`."""
    return db.read(conn, "The maps of the database cannot be read", "archive.list_maps")


def rename_map(conn: Connection, map_name: str, new_name: str) -> None:
    """Give a map another name; its history, decisions and receipts stay with it.

    Raises InputError where the name is in use, or a drive is being ingested into the map.
    """
    _require_idle(conn, map_name)
    with map_transaction(conn, map_name):
        map_lock(conn, new_name)
        info = require_map(conn, map_name)
        _require_free_name(conn, new_name)
        db.query(conn, "archive.rename_map", map_id=info.map_id, map_name=map_name, new_name=new_name)


def delete_map(conn: Connection, map_name: str, dump: Path) -> dict[str, int]:
    """Write the map to the file `dump`, then delete it, in one transaction. Returns the number of rows by table.

    Raises InputError if the map does not exist, a drive is being ingested into it, or the file cannot be written. Then nothing
    was deleted.
    """
    _require_idle(conn, map_name)
    with map_transaction(conn, map_name):
        info = require_map(conn, map_name)
        rows = _write_dump(conn, info, dump)
        key = {"map_id": info.map_id, "map_name": map_name}
        runs = [row["run_id"] for row in db.query(conn, "archive.run_ids", **key)]
        for table in reversed(db.query(conn, "archive.tables")):
            if table["table_name"] not in ("run", "run_step"):  # which are known by the changesets
                db.execute(conn, f"delete from conetl.{table['table_name']} where {table['condition']}", key)
        db.query(conn, "archive.delete_map_row", **key | {"run_ids": runs})
    return rows


def _require_idle(conn: Connection, map_name: str) -> None:
    """Raise InputError while a drive is being ingested: the ingest would create a new map of that name."""
    if busy := drives_under_way(conn, map_name=map_name):
        raise InputError(f"map {map_name}: drive {busy[0]} is being ingested into it; try again when that is done")


def restore_map(conn: Connection, dump: Path, map_name: str | None = None) -> MapInfo:
    """Bring back a map from its dump, under its own name or another one; all or nothing.

    Raises InputError if the file is not a dump, was written with another schema, or holds what is in the database.
    """
    try:
        with zipfile.ZipFile(dump) as file:
            if file.getinfo(_MANIFEST).file_size > MAX_JSON_BYTES:
                raise ValueError(f"{_MANIFEST} has more than {MAX_JSON_BYTES} bytes")
            manifest = _Manifest.model_validate_json(file.read(_MANIFEST))
            if manifest.format != _FORMAT:
                raise InputError(f"{dump}: the format is {manifest.format:.40}, expected {_FORMAT}")
            if (damaged := file.testzip()) is not None:
                raise ValueError(f"{damaged:.40} has another checksum")
            return _restore(conn, dump, file, manifest, map_name or manifest.map.map_name)
    except OSError as error:
        raise InputError(f"{dump}: cannot be read ({error.strerror})") from error
    except (ValueError, zipfile.BadZipFile, zlib.error, KeyError, EOFError, NotImplementedError, RuntimeError) as error:
        reason = first_message(error) if isinstance(error, ValueError) else error
        raise InputError(f"{dump}: is damaged, or not a file that `conetl map delete` wrote ({reason})") from error


def _write_dump(conn: Connection, info: MapInfo, dump: Path) -> dict[str, int]:
    key = {"map_id": info.map_id, "map_name": info.map_name}
    row = db.query(conn, "archive.map_row", **key)[0]
    rows: dict[str, int] = {}
    tables = db.query(conn, "archive.tables")
    dump.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    with atomic_files(dump) as [path], zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as file:
        for table in tables:
            sorting = f" order by {table['sorting']}" if table["sorting"] else ""
            query = f"select {table['columns']} from conetl.{table['table_name']} where {table['condition']}{sorting}"
            with file.open(table["table_name"], "w", force_zip64=True) as sink:
                rows[table["table_name"]] = db.copy_out(conn, query, key, sink)
        manifest = {
            "format": _FORMAT,
            "written_at": datetime.now(UTC).isoformat(),
            "schema": applied_migrations(conn),
            "map": row | {"created_at": row["created_at"].isoformat()},
            "columns": {table["table_name"]: table["columns"] for table in tables},
            "rows": rows,
        }
        file.writestr(_MANIFEST, json.dumps(manifest, indent=1))
        path.chmod(0o600)  # with the names and images' paths of drives
    return rows


def _restore(conn: Connection, dump: Path, file: zipfile.ZipFile, manifest: _Manifest, map_name: str) -> MapInfo:
    with db.transaction(conn, "The schema of the database cannot be read"):
        schema, tables = applied_migrations(conn), db.query(conn, "archive.tables")
    if manifest.schema_ != schema or manifest.columns != {t["table_name"]: t["columns"] for t in tables}:
        raise InputError(
            f"{dump}: was written with the database schema {manifest.schema_[-1]:.80}, this one has {schema[-1]}: restore it "
            "with the version of conetl that wrote it, then migrate"
        )
    with map_transaction(conn, map_name):
        _require_free_name(conn, map_name)
        row = manifest.map.model_dump()
        for other in db.query(conn, "archive.same_ids", id_name=row["id_name"]):
            raise InputError(
                f"{dump}: its features have the same ids as those of the map {other['map_name']}: restore it into another "
                f"database, or delete that map first (`conetl map delete {other['map_name']}`)"
            )
        id_name = None if row["id_name"] == map_name else row["id_name"]
        made = db.query(conn, "archive.restore_map_row", **row | {"map_name": map_name, "id_name": id_name})[0]
        key = {"map_id": made["map_id"], "map_name": map_name}
        for table in tables:
            name, columns, own = table["table_name"], table["columns"], table["map_column"]
            db.execute(
                conn, f"create temporary table stage on commit drop as select {columns} from conetl.{name} limit 0"
            )
            with file.open(name) as source:
                db.copy_in(conn, f"stage ({columns})", source, str(dump))
            owner = ("", "") if own is None else (f"{own}, ", f"%({own})s, ")
            copied = f"insert into conetl.{name} ({owner[0]}{columns}) select {owner[1]}{columns} from stage"
            if db.execute_count(conn, copied, key) != manifest.rows[name]:
                raise InputError(f"{dump}: the table {name} is incomplete; nothing was restored")
            db.execute(conn, "drop table stage")
        for table in tables:
            belonging = f"select count(*) as n from conetl.{table['table_name']} where {table['condition']}"
            if db.execute(conn, belonging, key)[0]["n"] != manifest.rows[table["table_name"]]:
                raise InputError(f"{dump}: rows of {table['table_name']} belong to another map; nothing was restored")
        info = require_map(conn, map_name)
    with db.transaction(conn, "The planner's figures could not be renewed"):
        db.execute(conn, "analyze conetl.feature, conetl.feature_version, conetl.delta")
    return info


def _require_free_name(conn: Connection, map_name: str) -> None:
    if find_map(conn, map_name) is not None:
        raise InputError(f"a map named {map_name} already exists: choose another name")
