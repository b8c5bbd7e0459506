"""Validation errors of pydantic in the words of a user's file: the key, and what was expected of it."""

from __future__ import annotations

from typing import Any

from pydantic import ValidationError

from conetl.files.documents import MAX_MESSAGE, MAX_SHOWN, shown

#: pydantic's kind of an error -> what was expected; {} are the error's own figures.
_EXPECTED = {
    "missing": "is missing",
    "extra_forbidden": "there is no such key here",
    "greater_than": "expected more than {gt}",
    "greater_than_equal": "expected at least {ge}",
    "less_than": "expected less than {lt}",
    "less_than_equal": "expected at most {le}",
    "finite_number": "expected a finite number",
    "literal_error": "expected {expected}",
    "enum": "expected {expected}",
    "string_pattern_mismatch": "expected text that matches {pattern}",
    "string_too_long": "expected at most {max_length} characters",
    "string_too_short": "expected at least {min_length} characters",
    "string_unicode": "expected text in UTF-8",
    "multiple_of": "expected a multiple of {multiple_of}",
    "json_invalid": "expected JSON ({error})",
    "float_type": "expected a number",
    "float_parsing": "expected a number",
    "int_type": "expected a whole number",
    "int_parsing": "expected a whole number",
    "int_parsing_size": "expected a smaller number",
    "int_from_float": "expected a whole number",
    "bool_type": "expected true or false",
    "bool_parsing": "expected true or false",
    "string_type": "expected text",
    "path_type": "expected a path",
    "none_required": "expected nothing",
    "list_type": "expected a list",
    "tuple_type": "expected a list",
    "set_type": "expected a list",
    "dict_type": "expected keys and values",
    "model_type": "expected keys and values",
    "model_attributes_type": "expected keys and values",
    "mapping_type": "expected keys and values",
    "too_short": "expected at least {min_length} values, found {actual_length}",
    "too_long": "expected at most {max_length} values, found {actual_length}",
    "uuid_parsing": "expected an id like 1c223030-5d0f-4a7e-9a0d-0e4cf2a1b2c3",
    "url_parsing": "expected an address like https://example.org",
}
_TIME = "expected a time like 2026-03-02T10:00:00Z"
_DATE = "expected a date like 2026-03-02"


def expectation(error: Any) -> str:
    """What one of `ValidationError.errors()` asks for, without the value that was found."""
    kind, figures = str(error["type"]), error.get("ctx", {})
    if kind.startswith("datetime_"):
        return _TIME
    if kind.startswith("date_"):
        return _DATE
    if kind in _EXPECTED:
        plain = {name: f"{value:g}" if isinstance(value, float) else value for name, value in figures.items()}
        return _EXPECTED[kind].format(**plain)[:MAX_MESSAGE]
    text = str(error["msg"]).removeprefix("Value error, ").removeprefix("Assertion failed, ")
    return text.replace("Input should be", "expected", 1)[:MAX_MESSAGE]


def key_of(error: Any) -> str:
    """The key of one of `ValidationError.errors()`, with dots between the levels; empty for the whole file."""
    return ".".join(str(part) for part in error["loc"])[:MAX_SHOWN]


def sentence(error: ValidationError) -> str:
    """The first error: `key: expected ..., found ...`."""
    first = error.errors()[0]
    key, wanted = key_of(first), expectation(first)
    text = f"{key}: {wanted}" if key else wanted
    return text if first["type"] in ("missing", "extra_forbidden") else f"{text}, found {shown(first['input'])}"
