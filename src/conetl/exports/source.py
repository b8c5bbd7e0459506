"""The rows that an export writes: Arrow record batches, read from the server while they are written."""

from __future__ import annotations

from collections import Counter
from collections.abc import Generator, Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, replace
from datetime import datetime
from enum import StrEnum
from functools import cached_property
from typing import Any

import numpy as np
import pyarrow as pa
import shapely
from pyproj import Transformer

from conetl.db.arrow_rows import batches_of, schema_of
from conetl.db.connection import Connection, database_errors, load_sql, or_infinity, query
from conetl.db.map.map_store import require_map
from conetl.db.map.results import MapInfo
from conetl.exports import Order
from conetl.geometry.geodesy import axis_rotations, height_system_name, to_crs
from conetl.model.arrays import Floats, Ints
from conetl.model.columns import BY_NAME, DERIVED, Face, names
from conetl.model.errors import InputError
from conetl.model.feature_classes import LINE_CLASSES, require_classes

#: Rows in memory at a time, and rows of a GeoParquet row group.
BATCH_ROWS = 50_000
POSITION_NAMES = ("easting_m", "northing_m", "ellipsoidal_height_m")
#: The line itself, as well-known binary in hexadecimal digits.
LINE_NAME = "line"
#: Columns of changes that differ from those of the state, or are not among them.
_OF_CHANGES = {name: f"c.{name}" for name in names(Face.CHANGE)}
_LINE_WKB = f"encode(ST_AsBinary(s.line), 'hex') as {LINE_NAME}"


class ExportContent(StrEnum):
    """Which rows an export contains."""

    FEATURES = "features"
    """What stood on the road at `as_of`, as known at `known_at`."""
    HISTORY = "history"
    """Every state that the database ever held; with `known_at` only those that it held then."""
    CHANGES = "changes"
    """The difference between the road at `since` (None: the beginning) and at `until`, both as known at `known_at`."""


@dataclass(frozen=True)
class ExportRequest:
    """What to export. Instants need a time zone; None: latest."""

    map_name: str = "default"
    what: ExportContent = ExportContent.FEATURES
    as_of: datetime | None = None
    known_at: datetime | None = None
    since: datetime | None = None
    until: datetime | None = None
    box_m: tuple[float, float, float, float] | None = None
    """West, south, east, north in the map's CRS; None: everywhere."""
    crs: tuple[int, int | None] | None = None
    """EPSG codes of the plane and of the height system (None: ellipsoidal) of the positions; None: those of the map."""
    category: str | None = None
    """Objects of this class alone."""


@dataclass(frozen=True)
class ExportSource:
    """The rows of one request with one type of geometry. Created by `open_source`, valid within its block."""

    conn: Connection
    info: MapInfo
    request: ExportRequest
    order: Order
    lines: bool = False
    """Lane markings instead of point objects; their position is that of the middle vertex."""

    @cached_property
    def schema(self) -> pa.Schema:
        """Columns of every batch: the properties, then `POSITION_NAMES` and, of lines, the line."""
        with database_errors(f"The map {self.request.map_name} cannot be read"):
            read = {field.name: field for field in schema_of(self.conn, self._sql, self._parameters)}
        derived = {
            name: pa.field(name, pa.string() if BY_NAME[name].kind == "text" else pa.float64()) for name in DERIVED
        }
        return pa.schema([(read | derived)[name] for name in (*self.property_names, *self._geometry_names)])

    @cached_property
    def property_names(self) -> list[str]:
        """Names of the columns except position and line."""
        shown = Face.FILE | (Face.CHANGE if self._is_changes else Face.HISTORY if self._has_change else Face.NONE)
        found = names(shown, "lines" if self.lines else "points")
        return [name for name in found if name not in DERIVED or DERIVED[name] in (*found, *POSITION_NAMES)]

    @property
    def _geometry_names(self) -> tuple[str, ...]:
        return (*POSITION_NAMES, LINE_NAME) if self.lines else POSITION_NAMES

    @property
    def epsg(self) -> tuple[int, int | None]:
        """EPSG codes of the plane of easting and northing, and of the height system (None: ellipsoidal)."""
        return self.request.crs or (self.info.srid, self.info.vertical_srid)

    @property
    def crs_text(self) -> str:
        """`EPSG:25832`, or `EPSG:25832+7837`."""
        return f"EPSG:{'+'.join(str(code) for code in self.epsg if code)}"

    def lon_lat_deg(self, batch: pa.RecordBatch) -> tuple[Floats, Floats]:
        """WGS 84 longitudes and latitudes (n,) of a batch."""
        easting, northing = (np.asarray(batch.column(name)) for name in POSITION_NAMES[:2])
        lons, lats = self.to_wgs84.transform(easting, northing)
        return lons, lats

    def vertices_m(self, batch: pa.RecordBatch) -> tuple[Floats, Ints]:
        """Vertices of the lines of a batch, (n, 3) with ellipsoidal heights in the map's CRS, and the row (n,) of each."""
        lines = shapely.from_wkb(batch.column(LINE_NAME).to_pylist())
        vertices, rows = shapely.get_coordinates(lines, include_z=True, return_index=True)
        return vertices, rows

    @cached_property
    def to_wgs84(self) -> Transformer:
        """From easting, northing to longitude, latitude."""
        return Transformer.from_crs(self.epsg[0], 4326, always_xy=True)

    @cached_property
    def counts(self) -> Counter[str]:
        """Rows that were read from `batches`, by category."""
        return Counter()

    @cached_property
    def batches(self) -> Generator[pa.RecordBatch]:
        """All rows once, `BATCH_ROWS` at a time, with `schema`."""
        return self._read()

    def _read(self) -> Generator[pa.RecordBatch]:
        columns = pa.schema([field for field in self.schema if field.name not in DERIVED])
        rest = columns.empty_table()
        with (
            database_errors(f"The map {self.request.map_name} cannot be read"),
            closing(batches_of(self.conn, self._sql, self._parameters, columns)) as blocks,
        ):
            for block in blocks:
                rest = pa.concat_tables([rest, pa.Table.from_batches([block])])
                while len(rest) >= BATCH_ROWS:
                    yield self._derived(rest.slice(0, BATCH_ROWS).combine_chunks().to_batches()[0])
                    rest = rest.slice(BATCH_ROWS)
            yield from map(self._derived, rest.combine_chunks().to_batches())

    def _derived(self, batch: pa.RecordBatch) -> pa.RecordBatch:
        """The rows with positions and sigmas in `crs`, and with derived columns."""
        columns = dict(zip(batch.schema.names, batch.columns, strict=True))
        self.counts.update({one["values"]: one["counts"] for one in columns["category"].value_counts().to_pylist()})
        ground_m = _floats(columns["ellipsoidal_height_m"])
        old_ground_m = _floats(columns["old_ellipsoidal_height_m"]) if self._is_changes else None
        if self.epsg != (self.info.srid, None):
            xyz_m = _floats(*(columns[name] for name in POSITION_NAMES))
            columns |= _rotated(columns, axis_rotations(xyz_m, self.info.srid, self.epsg[0]))
            done_m = to_crs(xyz_m, self.info.srid, *self.epsg)
            columns |= {name: pa.array(done_m[:, axis]) for axis, name in enumerate(POSITION_NAMES[:2])}
            ground_m = done_m[:, 2]
            if old_ground_m is not None:
                old_names = [f"old_{name}" for name in POSITION_NAMES]
                old_m = _floats(*(columns[name] for name in old_names))
                known = np.isfinite(old_m[:, 0])
                old_m[known] = to_crs(old_m[known], self.info.srid, *self.epsg)
                columns |= {name: pa.array(old_m[:, axis], from_pandas=True) for axis, name in enumerate(old_names[:2])}
                old_ground_m = old_m[:, 2]
        columns["ground_height_m"] = pa.array(ground_m)
        columns["height_system"] = pa.repeat(height_system_name(self.epsg[1]), len(batch))
        if old_ground_m is not None:
            columns["old_ground_height_m"] = pa.array(old_ground_m, from_pandas=True)
        return pa.record_batch([columns[name] for name in self.schema.names], schema=self.schema)

    @cached_property
    def _sql(self) -> str:
        of_changes = _OF_CHANGES if self._is_changes else {}
        chosen = [name for name in (*self.property_names, *POSITION_NAMES) if name not in DERIVED]
        columns = [f"{of_changes.get(name, f's.{name}')} as {name}" for name in chosen] + [_LINE_WKB] * self.lines
        text = load_sql(f"exports.{'states' if self.request.what is ExportContent.FEATURES else self.request.what}")
        return text.replace("{{columns}}", ", ".join(columns)).rstrip(";")

    @property
    def _is_changes(self) -> bool:
        return self.request.what is ExportContent.CHANGES

    @property
    def _has_change(self) -> bool:
        """Whether standing features also carry their latest change: only if rows are in the order of time."""
        return self.order is Order.BY_TIME or self.request.what is not ExportContent.FEATURES

    @property
    def _parameters(self) -> dict[str, Any]:
        request = self.request
        # Rows in the order of time are those of one database state.
        every_state = self.request.what is ExportContent.HISTORY and self.order is not Order.BY_TIME
        return {
            "map_name": request.map_name,
            "valid_at": or_infinity(request.as_of),
            "known_at": None if every_state and request.known_at is None else or_infinity(request.known_at),
            "from_valid_at": "-infinity" if request.since is None else request.since.isoformat(),
            "to_valid_at": or_infinity(request.until),
            "srid": self.info.srid,
            **dict(zip(("west_m", "south_m", "east_m", "north_m"), request.box_m or (None,) * 4, strict=True)),
            "lines": self.lines,
            "category": request.category,
            "spatial_order": self.order is Order.SPATIAL,
            "time_order": self.order is Order.BY_TIME,
        }


def _floats(*columns: pa.Array) -> Floats:
    """One column (n,), or several as (n, k); NaN for null."""
    values = [column.to_numpy(zero_copy_only=False).astype(np.float64) for column in columns]
    return values[0] if len(values) == 1 else np.stack(values, axis=1)


def _rotated(columns: dict[str, pa.Array], turn: Floats) -> dict[str, pa.Array]:
    """Sigmas and covariances after the rotation `turn` (n, 2, 2) of the horizontal axes."""
    sigma_e, sigma_n, cov = (_floats(columns[name]) for name in ("sigma_e_m", "sigma_n_m", "cov_en_m2"))
    flat = np.stack([np.stack([sigma_e**2, cov], -1), np.stack([cov, sigma_n**2], -1)], -2)
    flat = turn @ flat @ turn.transpose(0, 2, 1)
    upward = turn @ _floats(columns["cov_eu_m2"], columns["cov_nu_m2"])[:, :, None]
    done = {
        "sigma_e_m": np.sqrt(flat[:, 0, 0]), "sigma_n_m": np.sqrt(flat[:, 1, 1]), "cov_en_m2": flat[:, 0, 1],
        "cov_eu_m2": upward[:, 0, 0], "cov_nu_m2": upward[:, 1, 0],
    }  # fmt: skip
    return {name: pa.array(values) for name, values in done.items()}


@contextmanager
def open_source(conn: Connection, request: ExportRequest, order: Order = Order.BY_ID) -> Iterator[list[ExportSource]]:
    """The rows of a request by type of geometry: points, then lines if the map has any; for one class, that of the class.

    Raises InputError for a request that contradicts itself, and for an unknown map or class.
    """
    _check(request)
    points = ExportSource(conn, require_map(conn, request.map_name), request, order)
    _require_class(points)
    sources = [points, replace(points, lines=True)]
    if request.category is not None:
        sources = [sources[request.category in LINE_CLASSES]]
    elif not query(conn, "exports.has_lines", map_id=points.info.map_id)[0]["found"]:
        sources.pop()
    with ExitStack() as stack:
        for source in sources:
            stack.enter_context(closing(source.batches))
        yield sources


def _require_class(source: ExportSource) -> None:
    """Raise InputError for a class that neither conetl nor the map knows."""
    if (category := source.request.category) is not None:
        of_map = query(source.conn, "exports.has_class", map_id=source.info.map_id, category=category)
        require_classes([category], [category] if of_map[0]["found"] else [])


def _check(request: ExportRequest) -> None:
    for instant in (request.as_of, request.known_at, request.since, request.until):
        if instant is not None and instant.tzinfo is None:
            raise ValueError(f"{instant} has no time zone: UTC or another one must be stated")
    if request.what is ExportContent.CHANGES:
        if None not in (request.until, request.since) and request.until < request.since:  # type: ignore[operator]
            raise InputError(f"changes from {request.since} to {request.until}: the end is before the beginning")
    elif request.since is not None or request.until is not None:
        raise InputError("--from and --to require an export of changes (--what changes)")
    if request.box_m is not None and request.what is ExportContent.CHANGES:
        raise InputError("an export of changes covers the whole map: leave out the box")
    if request.as_of is not None and request.what is not ExportContent.FEATURES:
        raise InputError(f"--as-of requires an export of features: an export of the {request.what} covers all times")
