"""The rows of a map file of any kind: columns as Python values, places, and the CRS that the file names.

What a file claims about itself (row counts, sizes) is compared with its size before anything is read, and rows are read in
batches.
"""

from __future__ import annotations

import csv
import json
import struct
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pyogrio
import shapely
from numpy.typing import NDArray
from pyproj import CRS
from pyproj.exceptions import CRSError

from conetl.model.errors import InputError

#: Files with more are no cone maps; they would not fit into memory either.
MAX_ROWS = 1_000_000
#: What a compressed file may grow to.
MAX_BYTES = 2 << 30
_BATCH = 20_000
#: A feature of any format takes at least so many bytes of the file.
_MIN_ROW_BYTES = 8
#: What others call the columns of a place in a CSV file.
_CSV_NAMES = {
    **dict.fromkeys(("lon", "lng", "long", "longitude"), "lon_deg"),
    **dict.fromkeys(("lat", "latitude"), "lat_deg"),
    "easting": "easting_m",
    "northing": "northing_m",
}
#: The first bytes of a FlatGeobuf file, without the patch version.
_FGB_MAGIC = b"fgb\x03fgb"
#: Options of GDAL's drivers. It takes texts in GeoJSON that look like times for times, of which it keeps milliseconds only.
_OPEN_OPTIONS = {"GeoJSON": {"DATE_AS_STRING": "YES"}}


@dataclass
class MapTable:
    """n rows; rows are numbered from 1 in messages."""

    path: Path
    crs: CRS | None
    """None where the file names none."""
    xyz: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 3)))
    """(n, 3) in `crs`, east before north, longitude before latitude; heights NaN where there are none."""
    columns: dict[str, list[Any]] = field(default_factory=dict)
    layers: tuple[str, ...] = ()
    """Names of the file's layers that hold places, in its order; empty for formats that have none."""
    layer: str | None = None
    """The one that was read."""

    def __len__(self) -> int:
        return len(self.xyz)


def read_table(path: Path, layer: str | None = None) -> MapTable:
    """All rows of a GeoJSON, CSV, GeoPackage, FlatGeobuf or GeoParquet file. Raises InputError naming the file, and the row.

    layer: of a file with several, which one; None: the file has to have just one.
    """
    read_vector = partial(_read_vector, layer=layer)
    readers: dict[str, Callable[[Path], MapTable]] = {
        ".csv": _read_csv,
        ".parquet": _read_parquet,
        ".geoparquet": _read_parquet,
        ".geojson": read_vector,
        ".json": read_vector,
        ".gpkg": read_vector,
        ".fgb": read_vector,
    }
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise InputError(
            f"{path}: a map can be imported from {', '.join(readers)}, not from {path.suffix or 'such a file'}"
        )
    try:
        size = path.stat().st_size
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror})") from error
    if not path.is_file() or size == 0:
        raise InputError(f"{path} is {'empty' if path.is_file() else 'no file'}: nothing to import")
    if layer is not None and reader is not read_vector:
        raise InputError(f"{path}: such a file has no layers: leave out --layer")
    table = reader(path)
    if not len(table):
        raise InputError(f"{path} holds no features: nothing to import")
    return table


def _read_vector(path: Path, layer: str | None) -> MapTable:
    if path.suffix.lower() == ".fgb":
        _check_flatgeobuf_header(path)
    try:
        layers = tuple(str(name) for name, geometry in pyogrio.list_layers(path) if geometry is not None)
        layer = _choose_layer(path, layers, layer)
        info = pyogrio.read_info(path, layer=layer)
        _check_claim(path, info["features"], "features")
        table = MapTable(path, _crs_of(path, info["crs"]), layers=layers, layer=layer)
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
            _append_batches(table, reader, name)
    except InputError:
        raise
    except Exception as error:  # GDAL raises what it likes for a broken file
        raise InputError(f"{path} cannot be read as a map ({_line(error)})") from error
    return table


def _is_sequence(path: Path, info: dict[str, Any]) -> bool:
    """Whether a file holds GeoJSON features one after the other (RFC 8142, or one a line) and not one collection.

    GDAL calls it a collection of one feature where the second of them is no JSON.
    """
    if info["driver"] != "GeoJSON" or info["features"] != 1:
        return bool(info["driver"] == "GeoJSONSeq")
    try:
        json.loads(path.read_bytes())
    except ValueError:
        return True
    return False


def _collection_of_sequence(path: Path) -> bytes:
    """A sequence of features as one collection. Raises InputError naming the first row that is no feature.

    GDAL passes over rows that are broken, and keeps only the milliseconds of a sequence's times.
    """
    data = path.read_bytes().removeprefix(b"\xef\xbb\xbf")
    # Neither stands inside of a JSON text: in its strings both are escaped.
    records = [record for record in data.split(b"\x1e" if b"\x1e" in data else b"\n") if record.strip()]
    for number, record in enumerate(records, start=1):
        try:
            row = json.loads(record)
        except ValueError as error:
            raise InputError(
                f"{path}, row {number}: this is no GeoJSON feature ({error}): the file is cut or broken; nothing was written"
            ) from None
        if not (isinstance(row, dict) and row.get("type") == "Feature"):
            raise InputError(f"{path}, row {number}: expected a GeoJSON Feature; nothing was written")
    return b'{"type":"FeatureCollection","features":[' + b",".join(records) + b"]}"


def _choose_layer(path: Path, layers: Sequence[str], wanted: str | None) -> str:
    """The layer to read. GDAL would take the first of several and not say so. Raises InputError naming the layers."""
    if not layers:
        raise InputError(f"{path} has no geometry: a cone map is a layer of points")
    if wanted is not None and wanted not in layers:
        raise InputError(f"{path} has no layer {wanted} with places; it has: {', '.join(layers)}")
    if wanted is None and len(layers) > 1:
        raise InputError(
            f"{path} holds {len(layers)} layers of places: {', '.join(layers)}; say which one to import (--layer NAME)"
        )
    return wanted or layers[0]


def _read_parquet(path: Path) -> MapTable:
    try:
        file = pq.ParquetFile(path)
        metadata = file.metadata
        groups = [metadata.row_group(i) for i in range(metadata.num_row_groups)]
        _check_claim(path, metadata.num_rows, "rows")
        if sum(group.total_byte_size for group in groups) > MAX_BYTES:
            raise InputError(f"{path} claims to hold more than {MAX_BYTES >> 30} GiB: that is no cone map")
        geo = json.loads((metadata.metadata or {}).get(b"geo", b"null"))
        if not isinstance(geo, dict):
            raise InputError(f"{path} is no GeoParquet file: it has no `geo` metadata")
        name = geo["primary_column"]
        column = geo["columns"][name]
        if column["encoding"] != "WKB":
            raise InputError(f"{path}: geometry encoded as {column['encoding']}; WKB is read")
        crs = column.get("crs", "OGC:CRS84")  # what the standard says where none is named
        table = MapTable(path, None if crs is None else CRS.from_user_input(crs))
        names = [field.name for field in file.schema_arrow if not pa.types.is_nested(field.type)]
        _append_batches(table, file.iter_batches(_BATCH, columns=names), name)
    except InputError:
        raise
    except (OSError, pa.ArrowException, ValueError, KeyError, TypeError, MemoryError, CRSError) as error:
        raise InputError(f"{path} cannot be read as GeoParquet ({_line(error)})") from error
    return table


def _append_batches(table: MapTable, batches: Iterable[pa.RecordBatch], geometry: str) -> None:
    parts = []
    count = 0
    for batch in batches:
        points = shapely.from_wkb(np.asarray(batch.column(geometry).to_pylist(), object))
        bad = np.flatnonzero((shapely.get_type_id(points) != 0) | shapely.is_empty(points))
        if len(bad):
            point = points[bad[0]]
            kind = "nothing" if point is None else "no numbers" if point.geom_type == "Point" else point.geom_type
            raise InputError(f"{table.path}, row {count + int(bad[0]) + 1}: {kind} where a point is expected")
        parts.append(shapely.get_coordinates(points, include_z=True))
        count += batch.num_rows
        if count > MAX_ROWS:
            raise _too_many(table.path)
        for name, column in zip(batch.schema.names, batch.columns, strict=True):
            if name != geometry:
                table.columns.setdefault(name, []).extend(column.to_pylist())
    table.xyz = np.concatenate(parts) if parts else table.xyz


def _read_csv(path: Path) -> MapTable:
    """Columns lon_deg, lat_deg (WGS 84), or easting_m, northing_m (their CRS has to be stated); ellipsoidal_height_m.

    Values are parted by commas, semicolons or tabs, whichever the header has most of.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            header = file.readline()
            file.seek(0)
            rows = csv.reader(file, strict=True, delimiter=max(",;\t", key=header.count))
            names = [_CSV_NAMES.get(name.strip().lower(), name.strip()) for name in next(rows, [])]
            lines = []
            for number, line in enumerate(rows, start=1):
                if not line:
                    continue
                if len(line) != len(names):
                    raise InputError(f"{path}, row {number}: {len(line)} values where the header has {len(names)}")
                lines.append(line)
                if number > MAX_ROWS:
                    raise _too_many(path)
    except (OSError, UnicodeError, csv.Error) as error:
        raise InputError(f"{path} cannot be read as CSV ({_line(error)})") from error
    if len(set(names)) != len(names):
        raise InputError(f"{path}: a column name stands twice in the header")
    columns = {
        name: [text.strip() or None for text in values]
        for name, values in zip(names, zip(*lines, strict=True), strict=False)
    }
    geographic = {"lon_deg", "lat_deg"} <= set(names)
    if not geographic and not {"easting_m", "northing_m"} <= set(names):
        found = ", ".join(names)[:200]
        raise InputError(f"{path}: no columns lon_deg and lat_deg, nor easting_m and northing_m; found: {found}")
    place = ("lon_deg", "lat_deg") if geographic else ("easting_m", "northing_m")
    axes = [[_number(path, i, name, value) for i, value in enumerate(columns.get(name, []))] for name in place]
    heights = columns.get("ellipsoidal_height_m", [None] * len(lines))
    axes.append(
        [
            np.nan if value is None else _number(path, i, "ellipsoidal_height_m", value)
            for i, value in enumerate(heights)
        ]
    )
    return MapTable(path, CRS("OGC:CRS84") if geographic else None, np.array(axes).T.reshape(-1, 3), columns)


def _number(path: Path, index: int, name: str, text: Any) -> float:
    try:
        return float(text)
    except (TypeError, ValueError):
        raise InputError(f"{path}, row {index + 1}: {name} is {text!r}, which is no number") from None


def _check_flatgeobuf_header(path: Path) -> None:
    """GDAL reserves what the header claims; the header's size is bytes 8 to 12."""
    with path.open("rb") as file:
        start = file.read(12)
    if len(start) < 12 or not start.startswith(_FGB_MAGIC):
        raise InputError(f"{path} is no FlatGeobuf file (version 3)")
    (size,) = struct.unpack("<I", start[8:])
    if size + 12 > path.stat().st_size:
        raise InputError(
            f"{path} claims a header of {size} bytes, but is only {path.stat().st_size} long: it is cut or broken"
        )


def _check_claim(path: Path, count: int, noun: str) -> None:
    if count > MAX_ROWS:
        raise _too_many(path)
    # Columns of equal values compress to next to nothing; but geometries differ.
    if count * _MIN_ROW_BYTES > path.stat().st_size + 4096:
        raise InputError(
            f"{path} claims {count} {noun}, but is only {path.stat().st_size} bytes long: it is cut or broken"
        )


def _too_many(path: Path) -> InputError:
    return InputError(f"{path} has more than {MAX_ROWS} rows: that is no cone map; cut it into parts")


def _crs_of(path: Path, text: str | None) -> CRS | None:
    if text is None:
        return None
    try:
        return CRS.from_user_input(text)
    except CRSError as error:
        raise InputError(f"{path} names a CRS that is not known: {text[:80]}") from error


def _line(error: BaseException) -> str:
    lines = str(error).splitlines()
    return lines[0].rstrip(".") if lines else type(error).__name__
