"""What the text of a parameter says, or why it says nothing."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime
from typing import Annotated
from uuid import UUID

from pydantic import BeforeValidator, TypeAdapter, ValidationError

from conetl.web.parameters import dated

_DATETIME: TypeAdapter[datetime] = TypeAdapter(Annotated[datetime, BeforeValidator(dated)])


class BadParameterError(Exception):
    """A parameter that says nothing that can be understood; answered 400, as the standard wants it."""


def read_instant(text: str) -> datetime:
    """An instant; UTC where it names no zone. Raises BadParameterError."""
    try:
        time = _DATETIME.validate_python(text)
    except ValidationError as error:
        raise BadParameterError(f"{text!r} is no instant such as 2026-03-02T12:00:00Z.") from error
    if time.year < 2:
        raise BadParameterError(f"{text!r} is earlier than the year 2.")
    return time if time.tzinfo else time.replace(tzinfo=UTC)


def check_value(name: str, kind: str, text: str) -> None:
    """Raise BadParameterError unless the text is a value of a property of this type of PostgreSQL."""
    known = _VALUES.get(kind)
    if known is None:
        return
    read, wanted = known
    try:
        if not text.isascii() or "_" in text:  # Python reads these as numbers, PostgreSQL does not
            raise ValueError
        read(text)
    except (ValueError, BadParameterError) as error:
        raise BadParameterError(f"{name}={text!r} should be {wanted}.") from error


def _integer(text: str) -> None:
    if not -(2**31) <= int(text) < 2**31:
        raise ValueError


def _uuid(text: str) -> None:
    UUID(text)
    if len(text) not in (32, 36):  # Python also reads urn:uuid:...
        raise ValueError


_VALUES: dict[str, tuple[Callable[[str], object], str]] = {
    "integer": (_integer, "a whole number from -2147483648 to 2147483647"),
    "float8": (float, "a number"),
    "uuid": (_uuid, "the id of a cone, a UUID"),
    "timestamptz": (read_instant, "an instant such as 2026-03-02T12:00:00Z"),
}
