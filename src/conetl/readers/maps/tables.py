"""The rows of a map file of any format: columns as Arrow arrays, positions, and the file's CRS.

Row counts and sizes stated in a file are compared with its size before anything is read; rows are read in batches.
"""

from __future__ import annotations

import json
import re
import struct
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import shapely
from pyproj import CRS

from conetl.files.documents import input_errors, library_errors, require_few_features, require_size, shown
from conetl.geometry.geodesy import ELLIPSOIDAL
from conetl.model.arrays import Floats
from conetl.model.errors import InputError
from conetl.model.feature_classes import LINE_CLASSES
from conetl.readers.base_layers.georeferencing import geometries_of, height_unit_m, parse_crs, require_unit
from conetl.readers.maps.csv_text import MAX_VALUES, read_csv_text, too_many
from conetl.readers.vector_layers import layers_of

#: All rows are in memory, to be imported at once or not at all.
MAX_ROWS = 1_000_000
#: Largest uncompressed size.
MAX_BYTES = 2 << 30
_GEOJSON = (".geojson", ".json")
_BATCH = 20_000
#: GEOS's numbers of the types of points and multi-points.
_POINTS = (0, 4)
#: A feature has at least this many bytes in any format.
_MIN_ROW_BYTES = 8
#: Columns of positions in CSV files, by their names without a unit.
_POSITIONS = {
    **dict.fromkeys(("lon", "lng", "long", "longitude"), "lon_deg"),
    **dict.fromkeys(("lat", "latitude"), "lat_deg"),
    **dict.fromkeys(("easting", "east", "e", "x", "ostwert", "rechtswert"), "easting_m"),
    **dict.fromkeys(("northing", "north", "n", "y", "nordwert", "hochwert"), "northing_m"),
}
#: Names without a unit of columns with heights of the ground; the first one counts.
HEIGHTS = (
    "ellipsoidal_height", "ground_height", "height_ellipsoidal", "height_ellipsoid", "elevation", "elev", "ele", "altitude",
    "alt", "z", "height", "höhe", "hoehe", "h",
)  # fmt: skip
#: Those of them that files of objects also have for the objects, which are not higher than this.
_OF_OBJECTS, _HIGHEST_OBJECT_M = HEIGHTS[-4:], 10.0
#: Those of them that say what they are; others may be above the sea or the ellipsoid, which differ by so much.
_STATED_HEIGHTS, _LEAST_APART_M, _MOST_APART_M = HEIGHTS[:4], 1.0, 120.0
_UNIT = re.compile(r"[_\[(](m|ft|feet|deg|°|met(?:re|er)s?|degrees?)[\])]?$")
_UNITS_M = {"m": 1.0, "f": 0.3048}
#: The first bytes of a FlatGeobuf file, without the patch version.
_FGB_MAGIC = b"fgb\x03fgb"
#: Options of GDAL's drivers, which would read times in GeoJSON with milliseconds only.
_OPEN_OPTIONS = {"GeoJSON": {"DATE_AS_STRING": "YES"}}


@dataclass
class MapTable:
    """Rows of a map file; messages number them from 1."""

    path: Path
    crs: CRS | None
    """None where the file has none."""
    xyz: Floats = field(default_factory=lambda: np.empty((0, 3)))
    """(n, 3) in `crs`, east before north, longitude before latitude; heights of the geometry, else NaN (`add_heights`)."""
    columns: dict[str, pa.ChunkedArray] = field(default_factory=dict)
    """Values by name, None in empty cells; of CSV files as text."""
    layers: tuple[str, ...] = ()
    """Names of the file's layers with geometry, in its order; empty for formats without layers."""
    layer: str | None = None
    """The one that was read."""
    unit_m: float | None = None
    """Of easting and northing, by the names of their columns; None where they state none."""
    lines_left_out: int = 0
    """Lane markings of an export: only point objects are read."""

    def __len__(self) -> int:
        return len(self.xyz)


def read_table(path: Path, layer: str | None = None, *, most_rows: int = MAX_ROWS) -> MapTable:
    """All rows of a GeoJSON, CSV, GeoPackage, FlatGeobuf or GeoParquet file. Raises InputError naming the file, and the row.

    layer: required for files with several; most_rows: a file with more is refused.
    """
    read_vector = partial(_read_vector, most_rows, layer=layer)
    readers: dict[str, Callable[[Path], MapTable]] = {
        ".csv": partial(_read_csv, most_rows), **dict.fromkeys((".parquet", ".geoparquet"), partial(_read_parquet, most_rows)),
        **dict.fromkeys((".geojson", ".json", ".gpkg", ".fgb"), read_vector),
    }  # fmt: skip
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise InputError(
            f"{path}: a map can be imported from {', '.join(readers)}, not from {path.suffix or 'such a file'}"
        )
    with input_errors(path):
        size = path.stat().st_size
    if not path.is_file() or size == 0:
        raise InputError(f"{path} is {'empty' if path.is_file() else 'not a file'}: nothing to import")
    if path.suffix.lower() == ".csv":
        require_size(path)
    if path.suffix.lower() in _GEOJSON:
        require_few_features(path, most_rows)
    if layer is not None and reader is not read_vector:
        raise InputError(f"{path}: has no layers: leave out --layer")
    table = reader(path)
    if not len(table):
        raise InputError(f"{path} has no features: nothing to import")
    return table


def _read_vector(most_rows: int, path: Path, layer: str | None) -> MapTable:
    import pyogrio  # GDAL takes half a second to load, and few drives come with points to read

    if path.suffix.lower() == ".fgb":
        _check_flatgeobuf_header(path)
    with library_errors(f"{path} cannot be read as a map"):
        # GDAL reads a whole text for its layers, and again for the facts of one.
        info = pyogrio.read_info(path) if layer is None and path.suffix.lower() in _GEOJSON else {}
        layers = (info["layer_name"],) if str(info.get("driver")).startswith("GeoJSON") else layers_of(path)
        layer = _choose_layer(path, layers, layer)
        info = info or pyogrio.read_info(path, layer=layer)
        _check_claim(path, info["features"], "features", len(info["fields"]), most_rows)
        with input_errors(path):
            crs = None if info["crs"] is None else parse_crs(info["crs"])
        table = MapTable(path, crs, layers=layers, layer=layer)
        source: Path | bytes = path
        options = {"layer": layer, **_OPEN_OPTIONS.get(info["driver"], {})}
        if _is_sequence(path, info):
            source, options = _collection_of_sequence(path), _OPEN_OPTIONS["GeoJSON"]
        with pyogrio.open_arrow(source, use_pyarrow=True, batch_size=_BATCH, datetime_as_string=True, **options) as (
            meta,
            reader,
        ):
            name = meta["geometry_name"] or "wkb_geometry"
            if name not in reader.schema.names:
                raise InputError(f"{path} has no geometry: a cone map is a layer of points")
            _append_batches(table, reader, name, most_rows)
    may_be_unstated = info["driver"].startswith("GeoJSON") and crs is not None and crs.is_geographic
    if may_be_unstated and 2 * (np.abs(table.xyz[:, :2]) > 180).any(axis=1).sum() > len(table):
        table.crs = None  # its standard has degrees only, so that programs leave another CRS out
    return table


def _is_sequence(path: Path, info: dict[str, Any]) -> bool:
    """Whether a file is a sequence of GeoJSON features (RFC 8142, or one per line) and not one collection.

    GDAL reads it as one feature if the second one is not JSON.
    """
    if info["driver"] != "GeoJSON" or info["features"] != 1:
        return bool(info["driver"] == "GeoJSONSeq")
    try:
        json.loads(path.read_bytes())
    except ValueError:
        return True
    return False


def _collection_of_sequence(path: Path) -> bytes:
    """A sequence of features as one collection. Raises InputError naming the first row that is not a feature.

    GDAL skips broken rows, and reads times in sequences with milliseconds only.
    """
    data = path.read_bytes().removeprefix(b"\xef\xbb\xbf")
    # Neither occurs within a JSON text: both are escaped in its strings.
    records = [record for record in data.split(b"\x1e" if b"\x1e" in data else b"\n") if record.strip()]
    for number, record in enumerate(records, start=1):
        try:
            row = json.loads(record)
        except ValueError as error:
            raise InputError(
                f"{path}, row {number}: this is not a GeoJSON feature ({error}): truncated or damaged; nothing was written"
            ) from None
        if not (isinstance(row, dict) and row.get("type") == "Feature"):
            raise InputError(f"{path}, row {number}: expected a GeoJSON Feature; nothing was written")
    return b'{"type":"FeatureCollection","features":[' + b",".join(records) + b"]}"


def _choose_layer(path: Path, layers: Sequence[str], wanted: str | None) -> str:
    """The layer to read. (GDAL reads the first of several silently.) Raises InputError naming the layers."""
    if not layers:
        raise InputError(f"{path} has no geometry: a cone map is a layer of points")
    if wanted is not None and wanted not in layers:
        raise InputError(f"{path} has no layer {wanted} with geometry; it has: {', '.join(layers)}")
    if wanted is None and len(layers) > 1:
        raise InputError(
            f"{path} has {len(layers)} layers with geometry: {', '.join(layers)}; name the layer to import (--layer NAME)"
        )
    return wanted or layers[0]


def _read_parquet(most_rows: int, path: Path) -> MapTable:
    with library_errors(f"{path} cannot be read as GeoParquet"):
        file = pq.ParquetFile(path)
        metadata = file.metadata
        groups = [metadata.row_group(i) for i in range(metadata.num_row_groups)]
        _check_claim(path, metadata.num_rows, "rows", metadata.num_columns, most_rows)
        if sum(group.total_byte_size for group in groups) > MAX_BYTES:
            raise InputError(f"{path} states more than {MAX_BYTES >> 30} GiB, too much for a cone map")
        geo = json.loads((metadata.metadata or {}).get(b"geo", b"null"))
        if not isinstance(geo, dict):
            raise InputError(f"{path} is not a GeoParquet file: it has no `geo` metadata")
        name = geo["primary_column"]
        column = geo["columns"][name]
        if column["encoding"] != "WKB":
            raise InputError(f"{path}: geometry encoded as {column['encoding']}; only WKB is supported")
        crs = column.get("crs", "OGC:CRS84")  # the default of the standard
        table = MapTable(path, None if crs is None else CRS.from_user_input(crs))
        names = [field.name for field in file.schema_arrow if not pa.types.is_nested(field.type)]
        _append_batches(table, file.iter_batches(_BATCH, columns=names), name, most_rows)
    return table


def _append_batches(table: MapTable, batches: Iterable[pa.RecordBatch], geometry: str, most_rows: int) -> None:
    parts, kept = [], []
    count = 0
    for every in batches:
        damaged = "a feature has no geometry where a point is expected, or the file is damaged"
        # GDAL 3.12 shifts the values of FlatGeobuf behind a feature without geometry.
        with library_errors(f"{table.path}, from row {count + 1} on: {damaged}", pa.ArrowInvalid):
            every.validate(full=True)
        batch = every
        if "category" in every.schema.names:
            batch = every.filter(pc.invert(pc.is_in(every.column("category"), pa.array(LINE_CLASSES))))
        table.lines_left_out += every.num_rows - batch.num_rows
        shapes, part_at, vertex_at, xyz = geometries_of(batch.column(geometry).to_pylist())
        is_point = np.isin(shapely.get_type_id(shapes), _POINTS) & (np.diff(vertex_at[part_at]) == 1)
        for bad in np.flatnonzero(~is_point)[:1].tolist():
            kind = getattr(shapes[bad], "geom_type", None)
            kind = {None: "no or a broken geometry", "Point": "an empty point"}.get(kind, kind)
            raise InputError(f"{table.path}, row {count + bad + 1}: {kind} where a point is expected")
        parts.append(xyz)
        count += batch.num_rows
        if count > most_rows:
            raise too_many(table.path, most_rows)
        kept.append(batch.drop_columns([geometry]))
    if kept:
        table.xyz = np.concatenate(parts)
        columns = pa.Table.from_batches(kept)
        table.columns = dict(zip(columns.column_names, columns.columns, strict=True))


def _read_csv(most_rows: int, path: Path) -> MapTable:
    """Columns lon_deg, lat_deg (WGS 84), or easting_m, northing_m (their CRS has to be stated), their names in any spelling."""
    text = read_csv_text(path, most_rows)
    stated = [_split(name) for name in text.column_names]
    units_m = [unit_m for base, unit_m in stated if unit_m and _POSITIONS.get(base, "").endswith("_m")]
    names = [_POSITIONS.get(base, name) for (base, _), name in zip(stated, text.column_names, strict=True)]
    if len(set(names)) != len(names):
        raise InputError(f"{path}: the header contains a column name twice")
    columns = dict(zip(names, text.columns, strict=True))
    geographic = {"lon_deg", "lat_deg"} <= set(names)
    if not geographic and not {"easting_m", "northing_m"} <= set(names):
        found = shown(names)
        raise InputError(f"{path}: no columns lon_deg and lat_deg, nor easting_m and northing_m; found: {found}")
    horizontal = ("lon_deg", "lat_deg") if geographic else ("easting_m", "northing_m")
    axes = [numbers_of(path, name, columns[name], required=True) for name in horizontal]
    xyz = np.column_stack([*axes, np.full(text.num_rows, np.nan)])
    crs = CRS("OGC:CRS84") if geographic else None
    return MapTable(path, crs, xyz, columns, unit_m=max(units_m, default=None))


def numbers_of(path: Path, name: str, column: pa.ChunkedArray, *, required: bool = False) -> Floats:
    """The values of a column (N,) as numbers, NaN for empty cells. Raises InputError, which names the row."""
    if not (required and column.null_count):
        with suppress(pa.ArrowInvalid, pa.ArrowNotImplementedError):
            return np.asarray(column.cast(pa.float64()), np.float64).copy()
    values = column.to_pylist()
    found = np.empty(len(values))
    for index, value in enumerate(values):
        try:
            found[index] = np.nan if value is None and not required else float(value)
        except (TypeError, ValueError, OverflowError):
            problem = f"{name} is {shown(value)}, which is not a number"
            raise InputError(f"{path}, row {index + 1}: {problem}") from None
    return found


def _split(name: str) -> tuple[str, float | None]:
    """A column's name in small letters without its unit, and the unit (m), None where there is none or it is no length."""
    base = name.strip().lower().replace(" ", "_")
    found = _UNIT.search(base)
    return (base, None) if found is None else (base[: found.start()].rstrip("_"), _UNITS_M.get(found[1][0]))


def add_heights(table: MapTable, crs: CRS, *, of_points: bool = False) -> None:
    """Make the heights of `xyz` metres (of a compound CRS, its unit), and take those that are not in the geometry from a column.

    crs: of the positions. of_points: all names are those of points, not of objects above them. A column is removed if it has such
    a name. Raises InputError for heights of another system than that of the CRS.
    """
    require_unit(table.path, crs, table.unit_m)
    crs_unit_m = height_unit_m(crs)
    heights_m = table.xyz[:, 2] * crs_unit_m
    absent = np.isnan(heights_m) | (heights_m == 0.0 if not heights_m.any() else False)
    named = [
        (HEIGHTS.index(base), name, unit_m)
        for name in table.columns
        for base, unit_m in [_split(name)]
        if base in HEIGHTS
    ]
    for order, name, unit_m in sorted(named, key=lambda one: one[0]) if absent.any() else ():
        found_m = numbers_of(table.path, name, table.columns[name]) * (crs_unit_m if unit_m is None else unit_m)
        known_m = found_m[np.isfinite(found_m)]
        if not of_points and HEIGHTS[order] in _OF_OBJECTS:
            if _are_of_objects(known_m):
                continue
            del table.columns[name]
        stated = table.columns.get("height_system", pa.chunked_array([], pa.string()))
        systems = {str(system) for system in stated.drop_null().to_pylist()}
        if HEIGHTS[order] == "ground_height" and not crs.is_compound and systems - {ELLIPSOIDAL}:
            raise InputError(
                f"{table.path}: {shown(name)} is in the height system {shown(sorted(systems)[0])}: state it with the CRS, like "
                "--crs EPSG:25832+7837"
            )
        if HEIGHTS[order] not in _STATED_HEIGHTS:
            _require_one_height(table, [other for _, other, _ in named], name, known_m)
        heights_m[absent] = found_m[absent]
        break
    table.xyz[:, 2] = heights_m / crs_unit_m if crs.is_compound else heights_m


def _are_of_objects(heights_m: Floats) -> bool:
    """Whether heights may be those of objects, and not of the ground."""
    return bool(((heights_m > 0) & (heights_m <= _HIGHEST_OBJECT_M)).all())


def _require_one_height(table: MapTable, names: Sequence[str], chosen: str, known_m: Floats) -> None:
    """Raise InputError where another of these columns may be the height of the ground, too: above the sea, or ellipsoidal."""
    for name in names:
        if name == chosen or name not in table.columns:
            continue
        try:
            other_m = numbers_of(table.path, name, table.columns[name])
        except InputError:  # texts
            continue
        other_m = other_m[np.isfinite(other_m)]
        if _are_of_objects(other_m) or len(other_m) != len(known_m):
            continue
        if _LEAST_APART_M < np.abs(other_m - known_m).min() < _MOST_APART_M:
            raise InputError(
                f"{table.path}: the columns {shown(chosen)} and {shown(name)} may both be the height of the ground; call the "
                "ellipsoidal one ellipsoidal_height_m"
            )


def _check_flatgeobuf_header(path: Path) -> None:
    """GDAL allocates the stated header size (bytes 8 to 12)."""
    with path.open("rb") as file:
        start = file.read(12)
    if len(start) < 12 or not start.startswith(_FGB_MAGIC):
        raise InputError(f"{path} is not a FlatGeobuf file (version 3)")
    (size,) = struct.unpack("<I", start[8:])
    if size + 12 > path.stat().st_size:
        raise InputError(
            f"{path} states a header of {size} bytes, but has only {path.stat().st_size}: it is truncated or damaged"
        )


def _check_claim(path: Path, count: int, noun: str, columns: int, most_rows: int) -> None:
    if count > most_rows:
        raise too_many(path, most_rows)
    if count * columns > MAX_VALUES:
        raise InputError(
            f"{path} has {count:,} {noun} with {columns:,} columns, expected at most {MAX_VALUES:,} values: leave out columns"
        )
    # Equal values compress to almost nothing; but geometries differ.
    if count * _MIN_ROW_BYTES > path.stat().st_size + 4096:
        raise InputError(f"{path} states {count} {noun}, but has {path.stat().st_size} bytes: truncated or damaged")
