"""Rows of a map file -> checked statements in the map's CRS. The first bad row ends it: a half-imported map is worse than
none."""

from __future__ import annotations

import hashlib
import math
import unicodedata
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from uuid import UUID, uuid5

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS, Transformer
from pyproj.exceptions import CRSError

from conetl.files.parquet_store import file_sha256
from conetl.model.errors import InputError
from conetl.model.map_records import ImportedFeature, ImportedMap, MapFeature
from conetl.model.params import ImportParams
from conetl.model.records import Cov3
from conetl.readers.maps.tables import MapTable, read_table

_NAMESPACE = UUID("5f0f6f0a-1c1b-4a53-9d0e-3c7a4a5be9a1")
#: How far beyond the area for which a CRS is made its coordinates may lie (degrees): maps at a zone's edge.
_MARGIN_DEG = 3.0
_MAX_SIGMA_M = 100.0
_MAX_CONE_HEIGHT_M = 10.0
#: Of cones of which the file does not say what they are.
_CATEGORY = "traffic_cone"
_MAX_CATEGORY = 64
#: Columns that only exports of history and of changes have.
_HISTORY_COLUMNS = ("system_from", "change", "old_easting_m")
_WGS84 = CRS("OGC:CRS84")


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

    crs: of the file's coordinates, where it names none; must agree where it does. map_srid: CRS of the map; None: the
    file's own, if
    that can be a map's. stated_at: the instant for which the file speaks; None: the latest `last_seen_at` in it.
    layer: the one to read of a file with several.
    """
    table = read_table(path, layer)
    for name in _HISTORY_COLUMNS:
        if name in table.columns:
            raise InputError(
                f"{path} is an export of history or changes (column {name}); export features to import them"
            )
    file_crs = _file_crs(table, crs)
    _ask_at_once(table, file_crs, map_srid, params, stated_at)
    srid = _map_srid(table, file_crs, map_srid)
    xyz_m = _places(table, file_crs, srid, params)
    _refuse_duplicate_places(path, xyz_m)
    sha256 = _content_sha256(table)
    reader = _RowReader(table, params)
    stated_ns = reader.stated_ns(stated_at)
    ids = reader.ids(sha256)
    statements = [reader.statement(i, ids[i], xyz_m[i], stated_ns) for i in range(len(table))]
    name = f"{path.name}:{table.layer}" if len(table.layers) > 1 else path.name
    return ImportedMap(name, str(path), sha256, srid, stated_ns, statements, founds_ids=reader.founds_ids)


def _content_sha256(table: MapTable) -> str:
    """What an import is known by. The first layer goes by its file alone: it was what imports took before there was a choice."""
    sha256 = file_sha256(table.path)
    if table.layer in (None, *table.layers[:1]):
        return sha256
    return hashlib.sha256(f"{sha256}/{table.layer}".encode()).hexdigest()


class _RowReader:
    """The columns of a table, with messages that name the row."""

    def __init__(self, table: MapTable, params: ImportParams) -> None:
        self.table = table
        self.params = params
        self.founds_ids = params.new_ids or "feature_id" not in table.columns

    def fail(self, index: int, what: str) -> InputError:
        return InputError(f"{self.table.path}, row {index + 1}: {what}; nothing was written")

    def ids(self, sha256: str) -> list[UUID]:
        """One a row: those of the file, or, where ids are founded, ones that follow from file and row."""
        texts = self.table.columns.get("feature_id")
        if texts is None or self.founds_ids:
            return [uuid5(_NAMESPACE, f"{sha256}/{index}") for index in range(len(self.table))]
        ids: list[UUID] = []
        first: dict[UUID, int] = {}
        for index, text in enumerate(texts):
            try:
                feature_id = UUID(str(text))
            except ValueError:
                raise self.fail(
                    index, f"feature_id is {text!r}, which is no UUID (--new-ids founds new ones)"
                ) from None
            if feature_id in first:
                raise self.fail(index, f"feature_id {feature_id} stands in row {first[feature_id] + 1} already")
            first[feature_id] = index
            ids.append(feature_id)
        return ids

    def stated_ns(self, stated_at: datetime | None) -> int:
        if stated_at is not None:
            return _ns(stated_at)
        seen = [self.instant(index, "last_seen_at") for index in range(len(self.table))]
        known: list[int] = [instant for instant in seen if instant is not None]
        if not known:
            raise InputError(
                f"{self.table.path} does not tell when its cones were seen: say for which time it speaks (--surveyed-at)"
            )
        return max(known)

    def statement(self, index: int, feature_id: UUID, xyz_m: NDArray[np.float64], stated_ns: int) -> ImportedFeature:
        params = self.params
        height_m = self.number(
            index, "height_m", params.cone_height_m, lambda v: 0 < v <= _MAX_CONE_HEIGHT_M, "between 0 and 10 m"
        )
        sigma = "more than 0 and at most 100 m"
        height_sigma_m = self.number(
            index, "height_sigma_m", params.cone_height_sigma_m, lambda v: 0 < v <= _MAX_SIGMA_M, sigma
        )
        belief = self.number(
            index,
            "existence_probability",
            params.existence_probability,
            lambda v: 0 <= v <= 1,
            "a probability (0 to 1)",
        )
        count = self.number(
            index, "observation_count", 1, lambda v: v >= 1 and v == int(v) and v < 2**31, "a whole number from 1"
        )
        last_ns = self.instant(index, "last_seen_at", stated_ns)
        first_ns = self.instant(index, "first_seen_at", last_ns)
        valid_from_ns = self.instant(index, "valid_from", first_ns)
        if not first_ns <= last_ns <= stated_ns:
            raise self.fail(
                index, "first_seen_at, last_seen_at and the time for which the file speaks are not in this order"
            )
        if valid_from_ns > stated_ns:
            raise self.fail(index, "valid_from lies after the time for which the file speaks")
        x, y, z = (float(value) for value in xyz_m)
        feature = MapFeature(
            feature_id=feature_id,
            version=1,
            category=self.category(index),
            xyz_m=(x, y, z),
            cov_m2=self.covariance(index),
            centre_xyz_m=(x, y, z + height_m / 2),
            cone_height_m=height_m,
            cone_height_sigma_m=height_sigma_m,
            existence_probability=belief,
            observation_count=int(count),
            first_seen_ns=first_ns,
            last_seen_ns=last_ns,
        )
        return ImportedFeature(feature=feature, valid_from_ns=valid_from_ns)

    def category(self, index: int) -> str:
        """A word or a few. What begins otherwise is a formula to the programs in which people open a map's CSV."""
        value = self.table.columns["category"][index] if "category" in self.table.columns else None
        if value is None:
            return _CATEGORY
        category = str(value)
        rule = f"at most {_MAX_CATEGORY} letters, digits, spaces, _ . or -, a letter or digit first"
        if not (category[:1].isalnum() and len(category) <= _MAX_CATEGORY and all(map(_is_of_words, category))):
            raise self.fail(index, f"category is {category[:100]!r}, expected {rule}")
        return category

    def covariance(self, index: int) -> Cov3:
        rule = "more than 0 and at most 100 m"
        e, n, u = (
            self.number(index, f"sigma_{axis}_m", self.params.sigma_m, lambda v: 0 < v <= _MAX_SIGMA_M, rule)
            for axis in "enu"
        )
        en, eu, nu = (
            self.number(index, f"cov_{axes}_m2", 0.0, lambda v: True, "a number") for axes in ("en", "eu", "nu")
        )
        if np.linalg.eigvalsh([[e * e, en, eu], [en, n * n, nu], [eu, nu, u * u]])[0] <= 0:
            raise self.fail(index, "the sigmas and covariances make no covariance matrix (it is not positive definite)")
        return (e * e, en, eu, n * n, nu, u * u)

    def number(self, index: int, name: str, default: float, allowed: Callable[[float], bool], rule: str) -> float:
        value = self.table.columns[name][index] if name in self.table.columns else None
        if value is None:
            return default
        try:
            number = float(value)
        except (TypeError, ValueError):
            number = math.nan
        if not math.isfinite(number) or not allowed(number):
            raise self.fail(index, f"{name} is {value}, expected {rule}")
        return number

    def instant(self, index: int, name: str, default: Any = None) -> Any:
        """UTC nanoseconds; `name`_us (microseconds since 1970) is exact where a format's own times are not."""
        for column in (f"{name}_us", name):
            value = self.table.columns[column][index] if column in self.table.columns else None
            if value is None:
                continue
            if column.endswith("_us"):
                if isinstance(value, int | float) and math.isfinite(value) and abs(value) < 9e15:
                    return int(value) * 1000
                raise self.fail(index, f"{column} is {value!r}, expected microseconds since 1970")
            try:
                text = str(value).replace("/", "-")  # 2026/03/02, as some programs write it
                instant = value if isinstance(value, datetime) else datetime.fromisoformat(text)
                return _ns(instant if instant.tzinfo else instant.replace(tzinfo=UTC))
            except (ValueError, OverflowError):
                raise self.fail(index, f"{column} is {value!r}, expected a time like 2026-03-02T10:00:00Z") from None
        return default


def _ask_at_once(
    table: MapTable, file_crs: CRS, map_srid: int | None, params: ImportParams, stated_at: datetime | None
) -> None:
    """Raises InputError where a file leaves open more than one thing that a user has to state."""
    wanted = []
    if map_srid is None and file_crs.is_geographic:
        wanted.append("the CRS of the map that it begins (--map-srid)")
    if params.ground_height_m is None and np.isnan(table.xyz[:, 2]).any():
        wanted.append("the ellipsoidal height of the ground (--ground-height-m)")
    if stated_at is None and "last_seen_at" not in table.columns:
        wanted.append("for which time it speaks (--surveyed-at)")
    if len(wanted) > 1:
        raise InputError(
            f"{table.path} does not tell {', '.join(wanted[:-1])} and {wanted[-1]}: state them"
            + (_zone_hint(table, file_crs) if map_srid is None and file_crs.is_geographic else "")
        )


def _file_crs(table: MapTable, stated: str | None) -> CRS:
    try:
        wanted = None if stated is None else CRS.from_user_input(stated)
    except CRSError as error:
        raise InputError(
            f"--crs {stated} is not a known coordinate reference system; write it like EPSG:32632"
        ) from error
    if table.crs is None and wanted is None:
        raise InputError(f"{table.path} does not name the CRS of its coordinates: state it (--crs EPSG:...)")
    crs = table.crs or wanted
    if crs is None:
        raise ValueError("one of the two is there")
    if table.crs is not None and wanted is not None and not _same(table.crs, wanted):
        raise InputError(
            f"{table.path} says that its CRS is {table.crs.name}, --crs says {wanted.name}: which is right?"
        )
    if crs.is_compound:
        raise InputError(
            f"{table.path}: {crs.name} has heights of its own; the map's are ellipsoidal. Convert the file to a "
            "CRS without heights above a geoid"
        )
    if not (crs.is_geographic or crs.is_projected):
        raise InputError(f"{table.path}: {crs.name} is neither geographic nor projected")
    return crs


def _same(a: CRS, b: CRS) -> bool:
    both_wgs84 = all(crs.is_geographic and crs.to_2d().equals(_WGS84, ignore_axis_order=True) for crs in (a, b))
    return both_wgs84 or a.equals(b, ignore_axis_order=True)


def _map_srid(table: MapTable, crs: CRS, map_srid: int | None) -> int:
    if map_srid is not None:
        return map_srid
    if crs.is_projected and (srid := crs.to_epsg()) is not None:
        return int(srid)
    raise InputError(f"{table.path} begins a new map, whose CRS has to be stated (--map-srid){_zone_hint(table, crs)}")


def _zone_hint(table: MapTable, crs: CRS) -> str:
    """In which UTM zone the first cone would be; nothing where it is nowhere."""
    lon, lat = _to_wgs84(crs, table.xyz[:1])[0]
    if not (-180 <= lon <= 180 and -80 <= lat <= 84):
        return ""
    zone = min(int((lon + 180) // 6) + 1, 60) + (32600 if lat >= 0 else 32700)
    return f"; its first cone, at longitude {lon:.4f}, latitude {lat:.4f}, would be in EPSG:{zone}"


def _places(table: MapTable, crs: CRS, srid: int, params: ImportParams) -> NDArray[np.float64]:
    """(n, 3) in the map's CRS, each row where that CRS is made for."""
    path, xyz = table.path, table.xyz.copy()
    if params.ground_height_m is not None:
        xyz[np.isnan(xyz[:, 2]), 2] = params.ground_height_m
    for index in np.flatnonzero(~np.isfinite(xyz).all(axis=1))[:1]:
        if np.isfinite(xyz[index, :2]).all() and np.isnan(table.xyz[index, 2]):
            raise InputError(
                f"{path}, row {index + 1}: the cone has no height; state the ground's ellipsoidal one (--ground-height-m)"
            )
        raise InputError(f"{path}, row {index + 1}: the place {_text(xyz[index])} is not finite; nothing was written")
    if crs.is_geographic:
        for index in np.flatnonzero((np.abs(xyz[:, 1]) > 90) | (np.abs(xyz[:, 0]) > 180))[:1]:
            hint = (
                " (longitude and latitude look swapped)"
                if abs(xyz[index, 0]) <= 90 and abs(xyz[index, 1]) <= 180
                else ""
            )
            raise InputError(
                f"{path}, row {index + 1}: {_text(xyz[index, :2])} is no longitude, latitude in degrees{hint}: "
                "swapped, or is --crs wrong?"
            )
    target = CRS.from_epsg(srid)
    lon_lat = _to_wgs84(crs, xyz)
    outside = np.flatnonzero(~_within_use(target, lon_lat))
    if len(outside):
        index = outside[0]
        swapped = crs.is_geographic and bool(_within_use(target, lon_lat[index : index + 1, ::-1])[0])
        hint = ": longitude and latitude are swapped" if swapped else ": is --crs the CRS of the file's coordinates?"
        raise InputError(
            f"{path}, row {index + 1}: {_text(xyz[index, :2])} lies outside the area of the "
            f"map's CRS EPSG:{srid} ({target.name}){hint}"
        )
    east, north = Transformer.from_crs(crs, target, always_xy=True).transform(xyz[:, 0], xyz[:, 1])
    heights = xyz[:, 2]
    if not (np.isfinite(east).all() and np.isfinite(north).all()):
        raise InputError(f"{path}: not all places can be expressed in EPSG:{srid}")
    for index in np.flatnonzero((heights < -500) | (heights > 9000))[:1]:
        raise InputError(f"{path}, row {index + 1}: a height of {heights[index]:g} m is not on this earth's roads")
    return np.stack([east, north, heights], axis=1)


def _to_wgs84(crs: CRS, xyz: NDArray[np.float64]) -> NDArray[np.float64]:
    lon, lat = Transformer.from_crs(crs, _WGS84, always_xy=True).transform(xyz[:, 0], xyz[:, 1])
    return np.stack([np.asarray(lon), np.asarray(lat)], axis=1)


def _within_use(crs: CRS, lon_lat: NDArray[np.float64]) -> NDArray[np.bool_]:
    area = crs.area_of_use
    if area is None:
        return np.asarray(np.isfinite(lon_lat).all(axis=1))
    lon, lat = np.where(np.isfinite(lon_lat), lon_lat, np.nan).T
    # An area across the antimeridian ends west of where it begins, so longitudes are told from its western edge.
    width = (area.east - area.west) % 360 or 360.0
    inside = (lon - area.west + _MARGIN_DEG) % 360 <= width + 2 * _MARGIN_DEG
    return np.asarray(inside & (lat >= area.south - _MARGIN_DEG) & (lat <= area.north + _MARGIN_DEG))


def _refuse_duplicate_places(path: Path, xyz_m: NDArray[np.float64]) -> None:
    """Two rows within a millimetre are one cone written down twice."""
    first: dict[tuple[int, int], int] = {}
    for index, (x, y) in enumerate(np.round(xyz_m[:, :2] * 1000).astype(np.int64).tolist()):
        if (x, y) in first:
            raise InputError(f"{path}, row {index + 1}: the same place as row {first[x, y] + 1}; nothing was written")
        first[x, y] = index


def _ns(instant: datetime) -> int:
    return int(np.datetime64(instant.astimezone(UTC).replace(tzinfo=None), "us").astype(np.int64)) * 1000


def _is_of_words(character: str) -> bool:
    # Many scripts write vowels as marks beside letters.
    return character.isalnum() or character in " _.-" or unicodedata.category(character).startswith("M")


def _text(values: NDArray[np.float64]) -> str:
    return ", ".join(
        f"{value:g}" if not math.isfinite(value) else f"{value:.6f}".rstrip("0").rstrip(".") for value in values
    )
