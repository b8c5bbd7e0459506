"""A QGIS project (3.22 or newer) over the live tables, with styled layers and the temporal controller set to the map's time.

The project holds no data and no password: QGIS queries the database whenever it draws, and prompts for a password if the server
requires one. Layers: the standing cones, coloured by their latest change and transparent by their existence probability; the
95 % circles of their positions; the lane markings in the width, colour and pattern of the paint; all cones that ever stood, for
the temporal controller.
"""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from jinja2 import Environment, StrictUndefined
from pyproj import CRS

from conetl.db.connection import Connection, address, database_errors, load_sql, query_columns, read
from conetl.db.map.map_store import require_map
from conetl.exports.kind_marks import CASING, KIND_MARKS, PAINT
from conetl.files.atomic import atomic_files
from conetl.model.columns import COLUMNS, Face, names
from conetl.model.errors import InputError
from conetl.model.map_records import DeltaKind

_TEMPLATE = Path(__file__).with_suffix(".qgs.j2")
#: QGIS marker and size (mm) per kind of change.
_KINDS = {
    DeltaKind.CONFIRMED: ("triangle", 3.0),
    DeltaKind.MISSED: ("circle", 3.0),
    DeltaKind.ADDED: ("cross_fill", 3.6),
    DeltaKind.MOVED: ("diamond", 3.6),
    DeltaKind.HEIGHT_CHANGED: ("square", 3.0),
    DeltaKind.SPLIT: ("star", 3.6),
}
#: Radius of the 95 % circle of a position, in sigmas (chi-square of 2 degrees of freedom).
_CIRCLE = 2.4477
_CIRCLE_OPTIONS = {
    "color": "0,0,0,0", "name": "circle", "size": "1", "size_unit": "MapUnit", "outline_color": "31,41,51,160",
    "outline_width": "0.2",
}  # fmt: skip
#: Categories of `"colour" || ' ' || "pattern"`, with the colour of the paint.
_PAINTS = {f"{colour} {pattern}": (colour, pattern) for colour in PAINT for pattern in ("solid", "dashed")}
#: Id, title and statement of each layer, and how it differs from `_DEFAULTS`.
_LAYERS: tuple[tuple[str, str, str, dict[str, bool]], ...] = (
    ("cones_standing_now", "Cones now", "qgis_now", {}),
    ("circles_standing_now", "95 % circle of the position", "qgis_now", {"circles": True}),
    ("lane_markings_now", "Lane markings", "qgis_now", {"lines": True}),
    ("cones_over_time", "Cones over time (temporal controller)", "qgis_over_time", {"temporal": True, "shown": False}),
)
_DEFAULTS = {"shown": True, "circles": False, "temporal": False, "lines": False}


def write_qgis_project(conn: Connection, path: Path, *, map_name: str, user: str | None = None) -> None:
    """Write a project file (.qgz or .qgs) for a map. user: login that QGIS uses; None: that of `conn`.

    Raises InputError for an unknown map, and if the file cannot be written.
    """
    if path.suffix.lower() not in (".qgz", ".qgs"):
        raise InputError(f"{path}: a QGIS project is a .qgz or .qgs file")
    info = require_map(conn, map_name)
    extent = read(conn, f"The map {map_name} cannot be read", "exports.qgis_extent", map_name=map_name)[0]
    server = address(conn) | ({"user": user} if user else {})
    template = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    ).from_string(_TEMPLATE.read_text(encoding="utf-8"))
    text = template.render(
        title=f"conetl: {map_name}",
        srid=info.srid,
        wkt=CRS.from_epsg(info.srid).to_wkt(),
        layers=[
            {
                "id": key,
                "title": title,
                **_DEFAULTS,
                **flags,
                "fields": _fields(conn, map_name, sql),
                "source": _source(server, map_name, info.srid, sql, lines="lines" in flags),
            }
            for key, title, query, flags in _LAYERS
            for sql in [_statement(query, flags)]
        ],
        aliases={column.name: f"{column.title} [{column.unit}]" if column.unit else column.title for column in COLUMNS},
        markers={str(kind): _marker(kind) for kind in _KINDS},
        paints=_PAINTS,
        stripes=_stripe,
        circle=_CIRCLE_OPTIONS,
        circle_diameter=f'{2 * _CIRCLE} * "sigma_m"',
        extent=_bounds(extent),
        first=_iso(extent["first_at"]),
        last=_iso(extent["last_at"]),
    )
    with atomic_files(path) as (file,):
        if path.suffix.lower() == ".qgs":
            file.write_text(text, encoding="utf-8")
            return
        with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr(f"{path.stem}.qgs", text)


def _statement(query: str, flags: Mapping[str, bool]) -> str:
    """The statement of a layer on one line, without comments."""
    lines = "lines" in flags
    shown = names(Face.OGC, "lines" if lines else "points")
    columns = ", ".join("s.feature_id::text as feature_id" if name == "feature_id" else f"s.{name}" for name in shown)
    text = load_sql(f"exports.{query}").replace("{{geometry}}", "line" if lines else "geom")
    sql = " ".join(line.strip() for line in text.splitlines() if not line.startswith("--")).rstrip("; ")
    return sql.replace("{{columns}}", columns)


def _fields(conn: Connection, map_name: str, statement: str) -> list[str]:
    """Names of the fields of a layer, in their order."""
    with database_errors(f"The map {map_name} cannot be read"):
        columns = query_columns(conn, statement, {"map_name": map_name})
    return [name for name, _ in columns if name != "geom"]


def _source(server: dict[str, str], map_name: str, srid: int, statement: str, *, lines: bool) -> str:
    """The data source URI of a query. map_name consists of letters, digits, - and _ (a constraint of the table `map`)."""
    sql = statement.replace("%(map_name)s", f"'{map_name}'")
    parts = " ".join(f"{key}='{value}'" for key, value in server.items())
    kind = "LineStringZ" if lines else "PointZ"
    return f"{parts} key='version_row_id' estimatedmetadata=true srid={srid} type={kind} table=\"({sql})\" (geom)"


def _stripe(colour: str, pattern: str, *, casing: bool) -> dict[str, str]:
    """Options of QGIS's simple line, in metres on the ground: the paint, or a wider dark line below it."""
    rgb = ",".join(map(str, bytes.fromhex((CASING if casing else PAINT[colour])[1:])))
    return {
        "line_color": f"{rgb},255", "line_width_unit": "MapUnit", "line_width": "0.12", "capstyle": "flat", "joinstyle": "bevel",
        "use_custom_dash": str(int(pattern == "dashed")), "customdash": "3;9", "customdash_unit": "MapUnit",
    }  # fmt: skip


def _marker(kind: DeltaKind) -> dict[str, str]:
    """Options of QGIS's simple marker."""
    shape, size = _KINDS[kind]
    colour = ",".join(map(str, bytes.fromhex(KIND_MARKS[kind].colour[1:]))) + ",255"
    return {
        "color": colour, "name": shape, "size": str(size), "size_unit": "MM", "outline_color": "255,255,255,255",
        "outline_width": "0.2",
    }  # fmt: skip


def _bounds(extent: dict[str, Any]) -> tuple[float, float, float, float] | None:
    """West, south, east, north with a margin; None for an empty map."""
    west, south, east, north = (extent[f"{side}_m"] for side in ("west", "south", "east", "north"))
    if west is None:
        return None
    margin_m = 0.05 * max(east - west, north - south) + 5.0
    return west - margin_m, south - margin_m, east + margin_m, north + margin_m


def _iso(instant: datetime | None) -> str:
    """ISO 8601 in UTC, rounded up to whole seconds; now for None."""
    instant = (instant or datetime.now(UTC)).astimezone(UTC)
    whole = instant.replace(microsecond=0) + timedelta(seconds=bool(instant.microsecond))
    return f"{whole:%Y-%m-%dT%H:%M:%SZ}"
