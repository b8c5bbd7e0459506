"""Base of all records, the types of their fields, and UTC times.

Pydantic refuses unknown fields, NaN and infinity. Lengths are metres, image points pixels of the original (rectified) image
with the origin at the centre of the top-left pixel, angles radians, times UTC nanoseconds since 1970. Map coordinates are
easting, northing (of the map CRS) and ellipsoidal height. See docs/reference/coordinates.md.
"""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import Annotated, NamedTuple
from uuid import UUID

from pydantic import BaseModel, ConfigDict, Field

Vec2 = tuple[float, float]
Vec3 = tuple[float, float, float]
Matrix3 = tuple[Vec3, Vec3, Vec3]
Matrix4Row = tuple[float, float, float, float]
Matrix4 = tuple[Matrix4Row, Matrix4Row, Matrix4Row, Matrix4Row]
#: Symmetric 3x3 matrix as its upper triangle xx, xy, xz, yy, yz, zz (m^2).
Cov3 = tuple[float, float, float, float, float, float]
Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Probability = Annotated[float, Field(ge=0, le=1)]
Latitude = Annotated[float, Field(ge=-90, le=90)]
Longitude = Annotated[float, Field(ge=-180, le=180)]
#: Roads are between -430 and 5,900 m above the sea, and the geoid is within 110 m of the ellipsoid.
MIN_HEIGHT_M, MAX_HEIGHT_M = -500.0, 9_000.0
Height = Annotated[float, Field(ge=MIN_HEIGHT_M, le=MAX_HEIGHT_M)]


class Record(BaseModel):
    """Base of all records: immutable, closed, finite."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Params(Record):
    """Base of the parameters of a step; the text below a field describes it in Prefect's forms."""

    model_config = ConfigDict(use_attribute_docstrings=True)


class GeodeticPosition(Record):
    """A position of WGS 84."""

    lat_deg: Latitude
    """Latitude."""
    lon_deg: Longitude
    """Longitude."""
    height_m: Height
    """Above the ellipsoid."""


class SharedErrorJacobian(NamedTuple):
    """How far a position moves for one sigma of each error that drives share: of a calibration, or of a class of objects."""

    calibrations: tuple[UUID, ...]
    """Sorted; also `class_error_id` of a class and `common_error_id` of positions."""
    moved_m: bytes
    """(C, 3, K) metres of the map, big-endian float32: by calibration, axis, error; see `geometry/calibration/covariance.py`."""


_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


#: PostgreSQL's timestamps count microseconds; periods are half-open.
TICK = timedelta(microseconds=1)


def utc_from_ns(nanoseconds: int) -> datetime:
    """UTC datetime of nanoseconds since 1970, truncated to microseconds (what datetime can hold)."""
    return _EPOCH + timedelta(microseconds=nanoseconds // 1000)


def ns_from_utc(instant: datetime) -> int:
    """UTC nanoseconds since 1970 of a datetime with a time zone."""
    return (instant - _EPOCH) // timedelta(microseconds=1) * 1000
