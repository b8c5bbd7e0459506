"""Rows of a map file -> checked statements in the map's CRS. A file with a bad row is refused: no map is imported in part."""

from __future__ import annotations

import hashlib
import math
import re
import unicodedata
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any
from uuid import UUID, uuid5

import numpy as np
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationError
from pyproj import CRS, Transformer

from conetl.files.documents import error_key, expectation, input_errors, shown
from conetl.files.parquet_store import file_sha256
from conetl.geometry.geodesy import check_map_srid, to_ellipsoidal, utm_srid
from conetl.model.arrays import Floats
from conetl.model.base import MAX_HEIGHT_M, MIN_HEIGHT_M, Cov3, ns_from_utc, utc_from_ns
from conetl.model.errors import InputError
from conetl.model.feature_classes import CONE, FEATURE_CLASSES, LINE_CLASSES
from conetl.model.map_records import ImportedFeature, ImportedMap, MapFeature
from conetl.model.params import ImportParams
from conetl.readers.base_layers.georeferencing import in_area, parse_crs
from conetl.readers.maps.tables import MapTable, add_heights, read_table
from conetl.readers.stated_sigmas import require_exact
from conetl.readers.trajectories.times import DAY_NS, clock_problem

_NAMESPACE = UUID("5f0f6f0a-1c1b-4a53-9d0e-3c7a4a5be9a1")
#: Coordinates may be outside the area of use of their CRS by this much (degrees): maps at a zone's edge.
_MARGIN_DEG = 3.0
#: Columns that only exports of history and of changes have.
_HISTORY_COLUMNS = ("system_from", "change", "old_easting_m")
_WGS84 = CRS("OGC:CRS84")
#: 2000-01-01: signs and markings of a register may be older than any drive.
_EARLIEST_NS = 946_684_800_000_000_000


#: Other English and German names of classes, in the spelling of `_checked_category`.
_SYNONYMS = {
    **dict.fromkeys(("cone", "pylon", "pylone", "leitkegel", "verkehrsleitkegel", "verkehrskegel"), CONE),
    **dict.fromkeys(("bake", "leitbake", "warnbake"), "vertical_panel"),
    **dict.fromkeys(("sign", "verkehrszeichen", "verkehrsschild"), "traffic_sign"),
    "barrel": "drum", "absperrschranke": "barricade",
}  # fmt: skip


@lru_cache(maxsize=1000)
def _checked_category(text: str) -> str:
    """The class of that name in any spelling (`Traffic Cone`) or by another name (`Leitkegel`), otherwise the text itself.

    Other first characters could be formulas for programs that open a map's CSV.
    """
    spelled = re.sub("[ -]+", "_", text.strip().lower())
    spelled = _SYNONYMS.get(spelled, spelled)
    if spelled in LINE_CLASSES:
        raise ValueError("expected a class of point objects: lines cannot be imported")
    if spelled in FEATURE_CLASSES:
        return spelled
    # Many scripts write vowels as marks beside letters.
    letters = all(c.isalnum() or c in " _.-" or unicodedata.category(c).startswith("M") for c in text)
    if not (text[:1].isalnum() and len(text) <= 64 and letters):
        raise ValueError("expected at most 64 letters, digits, spaces, _ . or -, a letter or digit first")
    return text


Sigma = Annotated[float, Field(gt=0, le=100)]


class _Row(BaseModel):
    """The columns of a row without position, id and times."""

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)

    category: Annotated[str, BeforeValidator(str), AfterValidator(_checked_category)] = CONE
    object_height_m: float = Field(gt=0, le=10)
    object_height_sigma_m: Sigma
    existence_probability: float = Field(ge=0, le=1)
    observation_count: int = Field(default=1, ge=1, lt=2**31)
    sigma_e_m: Sigma
    sigma_n_m: Sigma
    sigma_u_m: Sigma
    cov_en_m2: float = 0.0
    cov_eu_m2: float = 0.0
    cov_nu_m2: float = 0.0

    def covariance(self) -> Cov3:
        """Upper triangle (m^2). Raises ValueError where it is not positive definite."""
        e, n, u, en, eu, nu = (
            self.sigma_e_m, self.sigma_n_m, self.sigma_u_m, self.cov_en_m2, self.cov_eu_m2, self.cov_nu_m2,
        )  # fmt: skip
        # Leading minors; numpy would take most of the time of an import.
        plane = e * e * n * n - en * en
        if plane <= 0 or plane * u * u + 2 * en * eu * nu - e * e * nu * nu - n * n * eu * eu <= 0:
            raise ValueError("the sigmas and covariances do not form a covariance matrix (it is not positive definite)")
        return (e * e, en, eu, n * n, nu, u * u)


def read_map_file(
    path: Path,
    params: ImportParams,
    *,
    crs: str | None = None,
    map_srid: int | None = None,
    stated_at: datetime | None = None,
    layer: str | None = None,
) -> ImportedMap:
    """Read and check a map file. Raises InputError naming the file, and the row (from 1, without a header).

    crs: of the file's coordinates; it must agree with that of the file, if it has one. map_srid: CRS of the map; None: the
    file's own, if it is suitable. stated_at: time of the survey; None: the latest `last_seen_at`. layer: the one to read of
    several.
    """
    table = read_table(path, layer)
    for name in _HISTORY_COLUMNS:
        if name in table.columns:
            raise InputError(
                f"{path} is an export of history or changes (column {name}); export features to import them"
            )
    file_crs = _file_crs(table, crs)
    add_heights(table, file_crs)
    if file_crs.is_compound:
        try:
            table.xyz[:] = to_ellipsoidal(table.xyz, file_crs)
        except InputError as error:
            raise InputError(f"{path}: {error}") from error
        file_crs = file_crs.sub_crs_list[0]
    _require_all(table, file_crs, map_srid, params, stated_at)
    srid = _map_srid(table, file_crs, map_srid)
    xyz_m = _positions(table, file_crs, srid, params)
    sha256 = file_sha256(path)
    if table.layer not in (None, *table.layers[:1]):  # the hash identifies an import: of a later layer, that of both
        sha256 = hashlib.sha256(f"{sha256}/{table.layer}".encode()).hexdigest()
    rows = _Rows(table, params)
    latest_ns = rows.latest_ns()
    stated_ns = latest_ns if stated_at is None else ns_from_utc(stated_at)
    if stated_ns is None:
        raise InputError(f"{path} does not state times: give the time of the survey (--surveyed-at)")
    if problem := clock_problem(stated_ns, _EARLIEST_NS):
        raise InputError(f"{path}: the time of the survey (--surveyed-at), {stated_at}, {problem}; nothing was written")
    if latest_ns is not None and stated_ns - latest_ns > 2 * DAY_NS:
        raise InputError(
            f"{path}: the time of the survey (--surveyed-at), {stated_at}, is more than two days after the latest last_seen_at, "
            f"{utc_from_ns(latest_ns)}: leave it out, or remove this column; nothing was written"
        )
    ids = rows.ids(sha256)
    statements = [rows.statement(i, ids[i], xyz_m[i], stated_ns) for i in range(len(table))]
    _require_different_objects(path, [one.feature for one in statements])
    require_exact(table, file_crs, np.sqrt([[one.feature.cov_m2[k] for k in (0, 3, 5)] for one in statements]))
    name = f"{path.name}:{table.layer}" if len(table.layers) > 1 else path.name
    written = tuple(map(tuple, table.xyz[:, :2].tolist())) if file_crs.is_projected else ()
    return ImportedMap(
        name, str(path), sha256, srid, stated_ns, statements, rows.new_ids, table.lines_left_out, written
    )


class _Rows:
    """The rows of a table; errors name the file and the row."""

    def __init__(self, table: MapTable, params: ImportParams) -> None:
        self.table = table
        self.new_ids = params.new_ids or "feature_id" not in table.columns
        self.defaults = {
            "object_height_m": params.cone_height_m, "object_height_sigma_m": params.cone_height_sigma_m,
            "existence_probability": params.existence_probability,
            **dict.fromkeys(("sigma_e_m", "sigma_n_m", "sigma_u_m"), params.sigma_m),
        }  # fmt: skip

    def fail(self, index: int, what: object) -> InputError:
        return InputError(f"{self.table.path}, row {index + 1}: {what}; nothing was written")

    def values(self, index: int) -> dict[str, Any]:
        """Values by column, without empty cells; those of the object's height also by their names before 0.3."""
        values = {name: column[index] for name, column in self.table.columns.items() if column[index] is not None}
        for name in ("height_m", "height_sigma_m"):
            if name in values:
                values.setdefault(f"object_{name}", values[name])
        return values

    def ids(self, sha256: str) -> list[UUID]:
        """One per row: those of the file, or new ones made of the file's hash and the row number."""
        if self.new_ids:
            return [uuid5(_NAMESPACE, f"{sha256}/{index}") for index in range(len(self.table))]
        first: dict[UUID, int] = {}
        for index, text in enumerate(self.table.columns["feature_id"]):
            try:
                feature_id = UUID(str(text))
            except ValueError:
                raise self.fail(
                    index, f"feature_id is {shown(text)}, which is not a UUID (--new-ids creates new ones)"
                ) from None
            if feature_id in first:
                raise self.fail(index, f"feature_id {feature_id} is in row {first[feature_id] + 1} already")
            first[feature_id] = index
        return list(first)

    def latest_ns(self) -> int | None:
        """The latest `last_seen_at`; None if no row has one."""
        columns = {
            name: self.table.columns[name] for name in ("last_seen_at_us", "last_seen_at") if name in self.table.columns
        }
        seen = (
            self.instant_ns(index, {name: column[index] for name, column in columns.items()}, "last_seen_at", None)
            for index in range(len(self.table))
        )
        return max((instant for instant in seen if instant is not None), default=None)

    def statement(self, index: int, feature_id: UUID, xyz_m: Floats, stated_ns: int) -> ImportedFeature:
        values = self.values(index)
        try:
            row = _Row.model_validate(self.defaults | values)
            covariance = row.covariance()
        except ValidationError as error:
            first = error.errors()[0]
            raise self.fail(index, f"{error_key(first)} is {first['input']!r:.100}, {expectation(first)}") from None
        except ValueError as error:
            raise self.fail(index, error) from None
        last_ns = self.instant_ns(index, values, "last_seen_at", stated_ns)
        first_ns = self.instant_ns(index, values, "first_seen_at", last_ns)
        valid_from_ns = self.instant_ns(index, values, "valid_from", first_ns)
        if not first_ns <= last_ns <= stated_ns:
            raise self.fail(index, "first_seen_at, last_seen_at and the time of the survey are not in this order")
        if valid_from_ns > stated_ns:
            raise self.fail(index, "valid_from is after the time of the survey")
        x, y, z = (float(value) for value in xyz_m)
        feature = MapFeature(
            feature_id=feature_id, version=1, category=row.category, xyz_m=(x, y, z), cov_m2=covariance,
            centre_xyz_m=(x, y, z + row.object_height_m / 2),
            object_height_m=row.object_height_m, object_height_sigma_m=row.object_height_sigma_m,
            existence_probability=row.existence_probability, observation_count=row.observation_count,
            first_seen_ns=first_ns, last_seen_ns=last_ns,
        )  # fmt: skip
        stated_id, stated_version = self.stated(values)
        return ImportedFeature(
            feature=feature, valid_from_ns=valid_from_ns, stated_id=stated_id, stated_version=stated_version
        )

    def stated(self, values: Mapping[str, Any]) -> tuple[UUID | None, int | None]:
        """Feature id and version of a row, by which our own export is recognised; None where they are missing or invalid."""
        try:
            stated_id = UUID(str(values["feature_id"]))
        except (KeyError, ValueError):
            return None, None
        version = str(values.get("version", ""))
        return stated_id, int(version) if version.isdecimal() and len(version) < 10 else None

    def instant_ns(self, index: int, values: Mapping[str, Any], name: str, default: Any) -> Any:
        """UTC nanoseconds; `name`_us (microseconds since 1970) is exact where a format's own times are not."""
        micros, value = values.get(f"{name}_us"), values.get(name)
        if micros is None and value is None:
            return default
        if micros is not None:
            name, value = f"{name}_us", micros
            if not (isinstance(micros, int | float) and math.isfinite(micros) and abs(micros) < 9e15):
                raise self.fail(index, f"{name} is {shown(micros)}, expected microseconds since 1970")
            time_ns = int(micros) * 1000
        else:
            try:
                time_ns = _time_ns(value if isinstance(value, datetime) else str(value))
            except (ValueError, OverflowError):
                raise self.fail(index, f"{name} is {shown(value)}, expected a time like 2026-03-02T10:00:00Z") from None
        if problem := clock_problem(time_ns, _EARLIEST_NS):
            raise self.fail(index, f"{name}, {shown(value)}, {problem}")
        return time_ns


@lru_cache(maxsize=10_000)
def _time_ns(stated: datetime | str) -> int:
    """UTC nanoseconds of a time, UTC unless it states an offset. Raises ValueError, OverflowError."""
    # 2026/03/02, as some programs write it
    instant = stated if isinstance(stated, datetime) else datetime.fromisoformat(stated.replace("/", "-"))
    return ns_from_utc(instant if instant.tzinfo else instant.replace(tzinfo=UTC))


def _require_all(
    table: MapTable, file_crs: CRS, map_srid: int | None, params: ImportParams, stated_at: datetime | None
) -> None:
    """Raise one InputError where a file lacks more than one thing that the user has to state."""
    wanted = []
    if map_srid is None and file_crs.is_geographic:
        wanted.append("the CRS of the new map (--map-srid)")
    if params.ground_height_m is None and np.isnan(table.xyz[:, 2]).any():
        wanted.append("the ellipsoidal height of the ground (--ground-height-m)")
    if stated_at is None and "last_seen_at" not in table.columns:
        wanted.append("the time of the survey (--surveyed-at)")
    if len(wanted) > 1:
        raise InputError(
            f"{table.path} does not have {', '.join(wanted[:-1])} and {wanted[-1]}: state them"
            + (_zone_hint(table, file_crs) if map_srid is None and file_crs.is_geographic else "")
        )


def _file_crs(table: MapTable, stated: str | None) -> CRS:
    with input_errors("--crs"):
        wanted = None if stated is None else parse_crs(stated)
    crs = table.crs or wanted
    if crs is None:
        raise InputError(f"{table.path} does not state the CRS of its coordinates: give it with --crs EPSG:...")
    if table.crs is not None and wanted is not None and not _same(table.crs, wanted):
        raise InputError(f"{table.path} has the CRS {table.crs.name}, but --crs is {wanted.name}: which is right?")
    flat = crs.sub_crs_list[0] if crs.is_compound else crs
    if not (flat.is_geographic or flat.is_projected):
        raise InputError(f"{table.path}: {crs.name} is neither geographic nor projected")
    return crs


def _same(a: CRS, b: CRS) -> bool:
    both_wgs84 = all(crs.is_geographic and crs.to_2d().equals(_WGS84, ignore_axis_order=True) for crs in (a, b))
    return both_wgs84 or a.equals(b, ignore_axis_order=True)


def _map_srid(table: MapTable, crs: CRS, map_srid: int | None) -> int:
    srid = map_srid if map_srid is not None or not crs.is_projected else crs.to_epsg()
    if srid is None:
        raise InputError(f"{table.path} would create a new map: state its CRS (--map-srid){_zone_hint(table, crs)}")
    try:
        check_map_srid(srid)
    except ValueError as error:
        raise InputError(f"{error}: choose another one (--map-srid)") from error
    return srid


def _zone_hint(table: MapTable, crs: CRS) -> str:
    """The UTM zone of the first cone; empty outside of UTM."""
    lon, lat = _to_wgs84(crs, table.xyz[:1])[0]
    try:
        srid = utm_srid(float(lat), float(lon))
    except ValueError:
        return ""
    return f"; the first cone, at longitude {lon:.4f}, latitude {lat:.4f}, would be in EPSG:{srid}"


def _positions(table: MapTable, crs: CRS, srid: int, params: ImportParams) -> Floats:
    """(n, 3) in the map's CRS. Raises InputError naming the first row whose position is invalid or outside its area of use."""

    def require(good: Any, problem: Callable[[int], str]) -> None:
        for index in np.flatnonzero(~np.asarray(good, bool))[:1].tolist():
            raise InputError(f"{table.path}, row {index + 1}: {problem(index)}; nothing was written")

    xyz = table.xyz.copy()
    if params.ground_height_m is not None:
        xyz[np.isnan(xyz[:, 2]), 2] = params.ground_height_m
    no_height = np.isfinite(xyz[:, :2]).all(axis=1) & np.isnan(xyz[:, 2])
    require(~no_height, lambda _: "the cone has no height; state the ground's ellipsoidal one (--ground-height-m)")
    require(np.isfinite(xyz).all(axis=1), lambda i: f"the position {_text(xyz[i])} is not finite")
    if crs.is_geographic:
        require(
            (np.abs(xyz[:, 1]) <= 90) & (np.abs(xyz[:, 0]) <= 180),
            lambda i: f"{_text(xyz[i, :2])} is not longitude, latitude in degrees: swapped, or is --crs wrong?",
        )
    target = CRS.from_epsg(srid)
    lon_lat = _to_wgs84(crs, xyz)

    def outside(index: int) -> str:
        axes = "longitude and latitude" if crs.is_geographic else "easting and northing"
        swapped = in_area(target, _to_wgs84(crs, xyz[[index]][:, [1, 0, 2]]), _MARGIN_DEG)[0]
        hint = f"{axes} are swapped" if swapped else "is --crs the CRS of the file's coordinates?"
        name = f"EPSG:{srid} ({target.name})"
        return f"{_text(xyz[index, :2])} is outside the area of use of the map's CRS {name}: {hint}"

    require(in_area(target, lon_lat, _MARGIN_DEG), outside)
    east, north = Transformer.from_crs(crs, target, always_xy=True).transform(xyz[:, 0], xyz[:, 1])
    require(np.isfinite(east) & np.isfinite(north), lambda i: f"{_text(xyz[i])} cannot be expressed in EPSG:{srid}")
    heights = xyz[:, 2]
    require(
        (heights >= MIN_HEIGHT_M) & (heights <= MAX_HEIGHT_M),
        lambda i: f"a height of {heights[i]:g} m is not plausible for a road",
    )
    return np.stack([east, north, heights], axis=1)


def _to_wgs84(crs: CRS, xyz: Floats) -> Floats:
    lon, lat = Transformer.from_crs(crs, _WGS84, always_xy=True).transform(xyz[:, 0], xyz[:, 1])
    return np.stack([np.asarray(lon), np.asarray(lat)], axis=1)


def _require_different_objects(path: Path, features: Sequence[MapFeature]) -> None:
    """Raise InputError where two rows are within a millimetre: one object written twice. Signs may be above others on a post."""
    first: dict[tuple[object, ...], int] = {}
    for row, feature in enumerate(features):
        east_mm, north_mm, up_mm = (round(1000 * metres) for metres in feature.xyz_m)
        known = FEATURE_CLASSES.get(feature.category)
        on_post = (feature.category, up_mm) if known is None or not known.on_road else ()
        if (same := first.setdefault((east_mm, north_mm, *on_post), row)) != row:
            raise InputError(f"{path}, row {row + 1}: the same position as row {same + 1}; nothing was written")


def _text(values: Floats) -> str:
    return ", ".join(f"{value:.6f}".rstrip("0").rstrip(".") for value in values)
