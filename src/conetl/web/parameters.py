"""Parameters of the routes, each with its bounds: FastAPI answers 422 to invalid ones, the OGC API 400."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from typing import Annotated, TypeVar
from uuid import UUID

from fastapi import Depends, HTTPException, Path, Query, Request
from pydantic import AfterValidator, BeforeValidator, Field, FiniteFloat, TypeAdapter, ValidationError
from pydantic_core import PydanticCustomError

from conetl.db.connection import Connection
from conetl.db.ogc_store import Degrees
from conetl.db.reader_pool import ReaderPool
from conetl.db.serve_store import read_origin
from conetl.model.base import Vec3

T = TypeVar("T")
#: Both ends of a temporal filter; None: open.
Interval = tuple[datetime | None, datetime | None]
_OPEN = ("", "..")


def cut(rows: list[T], most: int) -> tuple[list[T], bool]:
    """The first `most` rows, and whether there are more."""
    return rows[:most], len(rows) > most


def _utc(time: datetime) -> datetime:
    """The same instant in UTC: PostgreSQL refuses zones of more than 15:59:59, which Python accepts."""
    try:
        return time.astimezone(UTC) if time.tzinfo else time.replace(tzinfo=UTC)
    except OverflowError as error:
        raise ValueError("the instant is not between the years 1 and 9999 in UTC") from error


def dated(text: str | None) -> str | None:
    """The text of an instant, with date and time: pydantic would read a number, also a year, as seconds since 1970, and a date as
    its first instant, where commands mean its last."""
    if text is not None and not re.match(r"\d{4}-\d\d-\d\d[Tt ]\d", text, re.ASCII):
        raise PydanticCustomError(
            "instant", "{text} is not an instant such as 2026-03-02T12:00:00Z", {"text": repr(text)}
        )
    return text


MapName = Annotated[str, Path(pattern=r"^[a-z0-9_-]{1,40}$", description="Name of the map.")]
_Utc = Annotated[datetime, AfterValidator(_utc)]
Instant = Annotated[
    _Utc | None, BeforeValidator(dated),
    Query(description="ISO 8601; UTC unless it states an offset. Default: the latest."),
]  # fmt: skip
ChangesetNo = Annotated[int, Path(ge=1, le=2**62)]
Index = Annotated[int, Path(ge=0, le=2**31 - 1)]


def reading(request: Request) -> Iterator[Connection]:
    """A read-only connection for one request."""
    pool: ReaderPool = request.app.state.pool
    with pool.reading() as conn:
        yield conn


Reader = Annotated[Connection, Depends(reading)]


def origin_of(conn: Reader, map_name: MapName) -> Vec3:
    """Origin of a map; answers 404 if the map is missing or empty."""
    origin = read_origin(conn, map_name)
    if origin is None:
        raise HTTPException(404, f"There is no map {map_name}, or it is empty: add a drive with `conetl ingest DRIVE`.")
    return origin


Origin = Annotated[Vec3, Depends(origin_of)]


class BadParameterError(Exception):
    """An invalid parameter; answered 400, as the standard requires."""


_DATETIME: TypeAdapter[datetime] = TypeAdapter(Annotated[_Utc, BeforeValidator(dated)])


def parse_instant(text: str) -> datetime:
    """An instant; UTC if it names no zone. Raises BadParameterError."""
    try:
        time = _DATETIME.validate_python(text)
    except ValidationError as error:
        raise BadParameterError(f"{text!r} is not an instant such as 2026-03-02T12:00:00Z.") from error
    if time.year < 2:
        raise BadParameterError(f"{text!r} is earlier than the year 2.")
    return time


def parse_interval(text: str) -> Interval:
    """An instant (both ends are equal) or an interval a/b, a/.. or ../b. Raises BadParameterError."""
    parts = text.split("/")
    if len(parts) > 2 or (len(parts) == 1 and parts[0] in _OPEN) or set(parts) <= set(_OPEN):
        raise BadParameterError(f"datetime={text!r} should be an instant, or an interval a/b, a/.. or ../b.")
    ends = [None if part in _OPEN else parse_instant(part) for part in parts]
    start, end = ends[0], ends[-1]
    if start is not None and end is not None and start > end:
        raise BadParameterError(f"datetime={text!r} begins after its end.")
    return start, end


def parse_box(text: str) -> Degrees:
    """West, south, east, north in degrees; heights of a box with six numbers are ignored. Raises BadParameterError."""
    try:
        numbers = [float(number) for number in text.split(",")]
    except ValueError as error:
        raise BadParameterError(
            f"bbox={text!r} should be four comma-separated numbers: west,south,east,north."
        ) from error
    if len(numbers) not in (4, 6) or not all(map(math.isfinite, numbers)):
        raise BadParameterError(f"bbox={text!r} should be four finite numbers: west,south,east,north.")
    west, south, east, north = numbers if len(numbers) == 4 else (numbers[0], numbers[1], numbers[3], numbers[4])
    if max(abs(west), abs(east)) > 180 or max(abs(south), abs(north)) > 90 or south > north:
        raise BadParameterError(f"bbox={text!r} exceeds -180,-90,180,90, or south is greater than north.")
    return west, south, east, north


def check_value(name: str, kind: str, text: str) -> None:
    """Raise BadParameterError unless the text is a value of a property of this PostgreSQL type."""
    if kind not in _VALUES:
        return
    read, wanted = _VALUES[kind]
    try:
        if not text.isascii() or "_" in text:  # Python reads these as numbers, PostgreSQL does not
            raise ValueError
        read(text)
    except (ValueError, BadParameterError) as error:
        raise BadParameterError(f"{name}={text!r} should be {wanted}.") from error


_VALUES: dict[str, tuple[Callable[[str], object], str]] = {
    "integer": (
        TypeAdapter(Annotated[int, Field(ge=-(2**31), lt=2**31)]).validate_python,
        "a whole number from -2147483648 to 2147483647",
    ),
    "float8": (TypeAdapter(FiniteFloat).validate_python, "a number"),
    "uuid": (TypeAdapter(UUID).validate_python, "the id of a cone, a UUID"),
    "timestamptz": (parse_instant, "an instant such as 2026-03-02T12:00:00Z"),
}
