"""Parameters that the routes share, each with its bounds; FastAPI answers 422 to invalid ones."""

from __future__ import annotations

import re
from collections.abc import Iterator
from datetime import UTC, datetime
from typing import Annotated, TypeVar

from fastapi import Depends, HTTPException, Path, Query, Request
from pydantic import AfterValidator, BeforeValidator
from pydantic_core import PydanticCustomError

from conetl.db.connection import Connection
from conetl.db.reader_pool import ReaderPool
from conetl.db.serve_store import read_origin
from conetl.model.records import Vec3

#: Largest number of features of one answer, which says whether there are more.
MAX_FEATURES = 100_000
T = TypeVar("T")


def cut(rows: list[T], most: int) -> tuple[list[T], bool]:
    """The first `most` rows, and whether there are more."""
    return rows[:most], len(rows) > most


def _utc(time: datetime | None) -> datetime | None:
    return time.replace(tzinfo=UTC) if time is not None and time.tzinfo is None else time


def dated(text: str | None) -> str | None:
    """The text of an instant, which begins with a date: pydantic would read a number, also a year, as seconds since 1970."""
    if text is not None and not re.match(r"\d{4}-\d\d-\d\d", text, re.ASCII):
        raise PydanticCustomError(
            "instant", "{text} is not an instant such as 2026-03-02T12:00:00Z", {"text": repr(text)}
        )
    return text


MapName = Annotated[str, Path(pattern=r"^[a-z0-9_-]{1,40}$", description="Name of the map.")]
Instant = Annotated[
    datetime | None, BeforeValidator(dated), AfterValidator(_utc),
    Query(description="ISO 8601; UTC where it names no zone. By default the latest."),
]  # fmt: skip
ChangesetNo = Annotated[int, Path(ge=1, le=2**62)]
Index = Annotated[int, Path(ge=0, le=2**31 - 1)]


def reading(request: Request) -> Iterator[Connection]:
    """A read-only connection for one request."""
    pool: ReaderPool = request.app.state.pool
    with pool.reading() as conn:
        yield conn


Reader = Annotated[Connection, Depends(reading)]


def origin_of(conn: Connection, map_name: str) -> Vec3:
    """Origin of a map; answers 404 if the map is missing or empty."""
    origin = read_origin(conn, map_name)
    if origin is None:
        raise HTTPException(404, f"There is no map {map_name}, or it is empty: fill it with `conetl ingest DRIVE`.")
    return origin
