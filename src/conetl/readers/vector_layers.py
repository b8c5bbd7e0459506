"""Layers of a file that GDAL reads."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

from conetl.files.documents import shown
from conetl.model.errors import InputError

_OF_SQLITE = b"SQLite format 3\0"
#: Table of a GeoPackage with its layers.
_LAYERS = "gpkg_contents"


def layers_of(path: Path) -> tuple[str, ...]:
    """Names of the layers with geometry, without views of a database that are none.

    Raises InputError for a layer that is a view, whose query may take minutes or have no end, and errors of pyogrio and sqlite3.
    """
    import pyogrio  # GDAL takes half a second to load

    views: set[str] = set()
    with path.open("rb") as file:
        is_sqlite = file.read(len(_OF_SQLITE)) == _OF_SQLITE
    if is_sqlite:
        with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro&immutable=1", uri=True)) as database:
            kinds = dict(
                database.execute("select lower(name), type from sqlite_master where type in ('table', 'view')")
            )
            views = {name for name, kind in kinds.items() if kind == "view"}
            if kinds.get(_LAYERS) == "table":
                layers = {name for (name,) in database.execute(f"select lower(table_name) from {_LAYERS}")}
                for name in sorted(views & layers):
                    raise InputError(f"{path}: layer {shown(name)} is a view: save it as a table of another GeoPackage")
            elif _LAYERS in views:
                raise InputError(f"{path}: {_LAYERS} is a view: expected the table of a GeoPackage")
    found = pyogrio.list_layers(path)
    return tuple(str(name) for name, kind in found if kind is not None and str(name).lower() not in views)
