"""Parameters that the routes share, each with its bounds; FastAPI answers 422 where one does not hold."""

from __future__ import annotations

import re
from collections.abc import Iterator
from datetime import UTC, datetime
from typing import Annotated

from fastapi import Depends, HTTPException, Path, Query, Request
from pydantic import AfterValidator, BeforeValidator
from pydantic_core import PydanticCustomError

from conetl.db.connection import Connection
from conetl.db.reader_pool import ReaderPool
from conetl.db.serve_store import read_origin
from conetl.model.records import Vec3

#: More rows than this are never sent in one answer; it then says so.
MAX_FEATURES = 20_000
MAX_SIGHTINGS = 2_000
MAX_TRAJECTORY = 50_000
MAX_BASE_TILES = 20_000
MAX_BASE_LINES = 20_000


def _utc(time: datetime) -> datetime:
    return time if time.tzinfo else time.replace(tzinfo=UTC)


def dated(text: str | None) -> str | None:
    """The text of an instant, which begins with a date: pydantic would take a number for seconds since 1970, a year too."""
    if text is not None and not re.match(r"\d{4}-\d\d-\d\d", text, re.ASCII):
        raise PydanticCustomError(
            "instant", "{text} is not an instant such as 2026-03-02T12:00:00Z", {"text": repr(text)}
        )
    return text


MapName = Annotated[str, Path(pattern=r"^[a-z0-9_-]{1,40}$", description="Name of the map.")]
Instant = Annotated[
    datetime | None, BeforeValidator(dated), AfterValidator(lambda t: None if t is None else _utc(t)),
    Query(description="ISO 8601; UTC where it names no zone. Without it: the latest."),
]  # fmt: skip
ChangesetNo = Annotated[int, Path(ge=1, le=2**62)]
Metres = Annotated[float, Query(ge=0.01, le=100.0, allow_inf_nan=False)]
FrameIndex = Annotated[int, Path(ge=0, le=2**31 - 1)]
MatchIndex = Annotated[int, Path(ge=0, le=2**31 - 1)]
Context = Annotated[
    float,
    Query(
        ge=1.0, le=100.0, allow_inf_nan=False, description="How many times as wide and tall as the box; 100 shows all."
    ),
]


def reading(request: Request) -> Iterator[Connection]:
    """A read-only connection for one request."""
    pool: ReaderPool = request.app.state.pool
    with pool.reading() as conn:
        yield conn


Reader = Annotated[Connection, Depends(reading)]


def origin_of(conn: Connection, map_name: str) -> Vec3:
    """Origin of a map; answers 404 where there is no such map or nothing was committed to it."""
    origin = read_origin(conn, map_name)
    if origin is None:
        raise HTTPException(404, f"There is no map {map_name}, or it is empty: fill it with `conetl ingest DRIVE`.")
    return origin
