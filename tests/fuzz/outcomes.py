"""What readers made of a file, as lines of text: see `tests/recorded_text.py`."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import shapely
from pydantic import BaseModel

from tests.recorded_text import differences, lines_of

#: Of longer arrays: the shape, some values and sums.
_MOST_VALUES, _SHOWN = 48, 6
_MOST_CHARACTERS = 400
_MOST_NEW = 12
#: Of what was read, with the last digits of numbers, which processors round differently.
_HASH = re.compile(r"(?<=header_sha256: )[0-9a-f]{64}|(?<=content_sha256: )[0-9a-f]{64}|(?<=-)[0-9a-f]{8}\b")
#: Each version of Python words it in its own way, and GDAL's words are cut behind a name that may be longer.
_LIBRARY = re.compile(r"(is not (?:JSON|XML|YAML)|cannot be read as a map|that GDAL can read) \(.*")


def result_lines(found: object, folder: Path) -> list[str]:
    """All that was read, with names relative to the folder; of an error its message."""
    parts = found if isinstance(found, list) else [found]
    lines = (line for k, one in enumerate(parts) for line in lines_of(_plain(one), str(k)))
    words = (" / ".join(line.replace(str(folder), "<folder>").splitlines()) for line in lines)
    return [_HASH.sub("<hash>", _LIBRARY.sub(r"\1 (...)", line))[:_MOST_CHARACTERS] for line in words]


def case_lines(found: object, valid: list[str], folder: Path) -> list[str]:
    """What a mutation changed in what is read."""
    lines = result_lines(found, folder)
    if isinstance(found, BaseException):
        return lines
    if len(lines) != len(valid):
        return [f"{len(lines)} lines", *[line for line in lines if line not in set(valid)][:_MOST_NEW]]
    return [" / ".join(line.splitlines()) for line in differences(valid, lines)] or ["as without it"]


def _plain(value: Any) -> Any:
    """As mappings, lists, numbers and texts."""
    if isinstance(value, BaseException):
        return f"{type(value).__name__}: {value}"
    if isinstance(value, BaseModel):
        return {key: _plain(getattr(value, key)) for key in type(value).model_fields}
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: _plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if hasattr(value, "_asdict"):
        return {key: _plain(one) for key, one in value._asdict().items()}
    if isinstance(value, Mapping):
        return {str(key): _plain(one) for key, one in value.items()}
    if isinstance(value, pa.Table):
        return value.to_pylist()
    if isinstance(value, np.ndarray):
        return _array(value)
    if isinstance(value, Path):
        return value.as_posix()
    if isinstance(value, shapely.Geometry):
        return shapely.to_wkt(value, rounding_precision=9)
    if callable(value):
        return getattr(value, "__name__", type(value).__name__)
    if isinstance(value, (str, bytes)) or not isinstance(value, Iterable):
        return value
    return [_plain(one) for one in value]


def _array(values: np.ndarray) -> Any:
    if values.size <= _MOST_VALUES:
        return [_plain(one) for one in values.tolist()] if values.ndim else values.item()
    told: dict[str, Any] = {"shape": list(values.shape), "first": values.ravel()[:_SHOWN].tolist()}
    if values.dtype.kind in "fiub":
        finite = np.nan_to_num(values.astype(float))
        told |= {"sum": float(finite.sum()), "squares": float((finite**2).sum())}
    return told
