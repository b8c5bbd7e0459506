"""A QGIS project (3.22 or newer) over the live tables: styled layers, and the temporal controller set to the map's time.

The project holds no data and no password: QGIS asks the database whenever it draws, as the user named in it, and asks the
person for a password where the server wants one. Layers: what stands now, coloured by the change that made it so and the fainter
the less sure it is to exist; 95 % circles of the places; everything that ever stood, for the temporal controller.
"""

from __future__ import annotations

import zipfile
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape, quoteattr

from pyproj import CRS

from conetl.db.connection import Connection, address, database_errors, execute
from conetl.db.map.map_store import find_map
from conetl.db.statements import load_sql
from conetl.exports.kind_marks import KIND_MARKS
from conetl.files.atomic import atomic_files
from conetl.model.errors import InputError
from conetl.model.map_records import DeltaKind

#: Shape in QGIS and its size (mm) of a kind of change.
_KINDS = {
    DeltaKind.CONFIRMED: ("triangle", 3.0),
    DeltaKind.ADDED: ("cross_fill", 3.6),
    DeltaKind.MOVED: ("diamond", 3.6),
    DeltaKind.REMOVED: ("cross2", 3.0),
    DeltaKind.HEIGHT_CHANGED: ("square", 3.0),
    DeltaKind.SPLIT: ("star", 3.6),
    DeltaKind.MERGED: ("cross2", 2.2),
}
#: Radius of the circle that holds a place with 95 %, over sigma (chi-square of 2 degrees of freedom).
_CIRCLE = 2.4477
_LAYERS = (
    ("cones_standing_now", "Cones now", "qgis_now", True),
    ("circles_standing_now", "95 % circle of the place", "qgis_now", True),
    ("cones_over_time", "Cones over time (temporal controller)", "qgis_over_time", False),
)


def write_qgis_project(conn: Connection, path: Path, *, map_name: str, user: str | None = None) -> None:
    """Write a project file (.qgz or .qgs) for a map. user: login that QGIS uses; None: that of `conn`.

    Raises InputError where there is no such map, or the file cannot be written.
    """
    if path.suffix.lower() not in (".qgz", ".qgs"):
        raise InputError(f"{path}: a QGIS project is a .qgz or .qgs file")
    info = find_map(conn, map_name)
    if info is None:
        raise InputError(f"there is no map named {map_name} in this database: ingest a drive or import a map first.")
    with database_errors(f"The map {map_name} cannot be read"):
        extent = execute(conn, load_sql("exports.qgis_extent"), {"map_name": map_name})[0]
    text = _project(address(conn) | ({"user": user} if user else {}), map_name, info.srid, extent)
    with atomic_files(path) as (file,):
        if path.suffix.lower() == ".qgs":
            file.write_text(text, encoding="utf-8")
            return
        with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr(f"{path.stem}.qgs", text)


def _project(server: dict[str, str], map_name: str, srid: int, extent: dict[str, Any]) -> str:
    tree = "\n".join(
        f'<layer-tree-layer id="{layer}" name={quoteattr(title)} providerKey="postgres" expanded="1" '
        f'checked="Qt::{"Checked" if shown else "Unchecked"}"/>'
        for layer, title, _, shown in _LAYERS
    )
    layers = "\n".join(
        _layer(layer, title, _source(server, map_name, srid, query), srid) for layer, title, query, _ in _LAYERS
    )
    first, last = (_iso(extent[name]) for name in ("first_at", "last_at"))
    return f"""<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>
<qgis version="3.22.0" projectname={quoteattr(f"conetl: {map_name}")}>
<title>{escape(f"conetl: {map_name}")}</title>
<projectCrs>{_srs(srid)}</projectCrs>
<layer-tree-group>
{tree}
</layer-tree-group>
<mapcanvas name="theMapCanvas"><units>meters</units>{_extent(extent)}<rotation>0</rotation>
<destinationsrs>{_srs(srid)}</destinationsrs></mapcanvas>
<projectlayers>
{layers}
</projectlayers>
<properties>
<SpatialRefSys><ProjectionsEnabled type="int">1</ProjectionsEnabled></SpatialRefSys>
<TemporalControllerWidget>
<NavigationMode type="int">1</NavigationMode>
<StartDateTime type="QString">{first}</StartDateTime>
<EndDateTime type="QString">{last}</EndDateTime>
</TemporalControllerWidget>
</properties>
<ProjectTimeSettings cumulativeTemporalRange="0" frameRate="1" timeStepUnit="h" timeStep="1">
<TemporalRange><start>{first}</start><end>{last}</end></TemporalRange>
</ProjectTimeSettings>
</qgis>
"""


def _source(server: dict[str, str], map_name: str, srid: int, query: str) -> str:
    """QGIS's way to name a query as a table. map_name is letters, digits, - and _ (a rule of the table `map`)."""
    lines = load_sql(f"exports.{query}").splitlines()
    sql = " ".join(line.strip() for line in lines if not line.startswith("--")).rstrip("; ")
    sql = sql.replace("%(map_name)s", f"'{map_name}'")
    parts = " ".join(f"{key}='{value}'" for key, value in server.items())
    return f"{parts} key='version_row_id' estimatedmetadata=true srid={srid} type=PointZ table=\"({sql})\" (geom)"


def _layer(layer: str, title: str, source: str, srid: int) -> str:
    renderer = _circles() if layer == "circles_standing_now" else _kinds()
    temporal = (
        '<temporal enabled="1" mode="2" startField="valid_from" endField="valid_to" limitMode="0" fixedDuration="0" '
        'durationField="" durationUnit="min" accumulate="0" startExpression="" endExpression=""/>'
        if layer == "cones_over_time"
        else ""
    )
    return f"""<maplayer type="vector" geometry="Point" wkbType="PointZ" hasScaleBasedVisibilityFlag="0">
<id>{layer}</id><datasource>{escape(source)}</datasource><layername>{escape(title)}</layername>
<srs>{_srs(srid)}</srs><provider encoding="">postgres</provider>
{temporal}
{renderer}
<previewExpression>"change" || ' ' || left("feature_id", 8)</previewExpression>
</maplayer>"""


def _kinds() -> str:
    categories = "".join(
        f'<category render="true" symbol="{i}" value="{kind}" label="{kind}"/>' for i, kind in enumerate(_KINDS)
    )
    symbols = "".join(
        _symbol(
            i,
            {
                "color": f"{_rgb(kind)},255",
                "name": shape,
                "size": str(size),
                "size_unit": "MM",
                "outline_color": "255,255,255,255" if shape != "cross2" else f"{_rgb(kind)},255",
                "outline_width": "0.2" if shape != "cross2" else "0.6",
            },
            symbol={"alpha": '25 + 75 * "existence_probability"'},
        )
        for i, (kind, (shape, size)) in enumerate(_KINDS.items())
    )
    return (
        '<renderer-v2 type="categorizedSymbol" attr="change" forceraster="0" enableorderby="0" symbollevels="0">'
        f"<categories>{categories}</categories><symbols>{symbols}</symbols></renderer-v2>"
    )


def _rgb(kind: DeltaKind) -> str:
    """Red, green, blue as QGIS writes them."""
    return ",".join(str(part) for part in bytes.fromhex(KIND_MARKS[kind].colour[1:]))


def _circles() -> str:
    options = {
        "color": "0,0,0,0",
        "name": "circle",
        "size": "1",
        "size_unit": "MapUnit",
        "outline_color": "31,41,51,160",
        "outline_width": "0.2",
    }
    symbol = _symbol(0, options, marker={"size": f'{2 * _CIRCLE} * "sigma_m"'})
    return (
        f'<renderer-v2 type="singleSymbol" forceraster="0" symbollevels="0"><symbols>{symbol}</symbols></renderer-v2>'
    )


def _symbol(
    name: int, options: dict[str, str], *, symbol: dict[str, str] | None = None, marker: dict[str, str] | None = None
) -> str:
    """A symbol of one simple marker; `symbol` and `marker` are its properties that follow from expressions."""
    values = "".join(
        f'<Option type="QString" name="{key}" value={quoteattr(value)}/>' for key, value in options.items()
    )
    return (
        f'<symbol type="marker" name="{name}" alpha="1" clip_to_extent="1" force_rhr="0">{_defined(symbol)}'
        f'<layer class="SimpleMarker" enabled="1" locked="0" pass="0"><Option type="Map">{values}</Option>{_defined(marker)}'
        "</layer></symbol>"
    )


def _defined(properties: dict[str, str] | None) -> str:
    if not properties:
        return ""
    entries = "".join(
        f'<Option type="Map" name="{name}"><Option type="bool" name="active" value="true"/>'
        f'<Option type="QString" name="expression" value={quoteattr(expression)}/>'
        '<Option type="int" name="type" value="3"/></Option>'
        for name, expression in properties.items()
    )
    return (
        '<data_defined_properties><Option type="Map"><Option type="QString" name="name" value=""/>'
        f'<Option type="Map" name="properties">{entries}</Option>'
        '<Option type="QString" name="type" value="collection"/></Option></data_defined_properties>'
    )


def _srs(srid: int) -> str:
    wkt = escape(CRS.from_epsg(srid).to_wkt())
    return f"<spatialrefsys><wkt>{wkt}</wkt><srid>{srid}</srid><authid>EPSG:{srid}</authid></spatialrefsys>"


def _extent(extent: dict[str, Any]) -> str:
    if extent["west_m"] is None:
        return ""
    margin_m = 0.05 * max(extent["east_m"] - extent["west_m"], extent["north_m"] - extent["south_m"]) + 5.0
    return (
        f"<extent><xmin>{extent['west_m'] - margin_m}</xmin><ymin>{extent['south_m'] - margin_m}</ymin>"
        f"<xmax>{extent['east_m'] + margin_m}</xmax><ymax>{extent['north_m'] + margin_m}</ymax></extent>"
    )


def _iso(instant: datetime | None) -> str:
    instant = (instant or datetime.now(UTC)).astimezone(UTC)
    return (instant.replace(microsecond=0) + timedelta(seconds=bool(instant.microsecond))).strftime(
        "%Y-%m-%dT%H:%M:%SZ"
    )
