"""HTML pages from the templates beside this file. Everything is escaped, and a page loads nothing."""

from __future__ import annotations

import base64
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup, escape

from conetl.exports.kind_marks import KIND_MARKS
from conetl.files.atomic import atomic_text_file
from conetl.mapping.reasons import probability_text
from conetl.model.map_records import DeltaKind


@dataclass(frozen=True)
class Section:
    """Part of a page: a heading, a note, a table and an image (PNG or JPEG). Empty parts are left out."""

    heading: str
    note: str = ""
    columns: Sequence[str] = ()
    rows: Sequence[Sequence[object]] = ()
    image: bytes | None = None
    image_kind: str = "png"
    image_alt: str = ""

    def is_text(self, column: int) -> bool:
        """Whether a column holds words or long cells, which are aligned to the left."""
        return any(re.search(r"[^\W\d_]{3}", text) or len(text) > 24 for row in self.rows if (text := str(row[column])))


def write_page(path: Path, page: str) -> Path:
    """Write a page, completely or not at all, and return its path. Raises InputError where it cannot be written."""
    with atomic_text_file(path) as file:
        file.write(page)
    return path


def render(template: str, **values: Any) -> str:
    """One page as text. template: name of a file in `templates`."""
    return _environment().get_template(template).render(**values)


def data_uri(data: bytes, kind: str = "png") -> Markup:
    """An image as part of a page. kind: png or jpeg."""
    return Markup(f"data:image/{kind};base64,{base64.b64encode(data).decode('ascii')}")


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent / "templates"),
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    environment.globals |= {"kinds": tuple(DeltaKind), "kind_marks": KIND_MARKS}
    environment.filters |= {
        "data_uri": data_uri,
        "name": _name,
        "plain": lambda value: str(value).replace("_", " "),
        "time": lambda value: f"{value:%Y-%m-%d %H:%M:%S}",
        "minute": lambda value: f"{value:%Y-%m-%d %H:%M}",
        "decimals": _decimals,
        "probability": lambda value: "" if value is None else probability_text(value),
        "number": lambda value: f"{value:,}".replace(",", "\u202f"),
        "percent": lambda value: f"{value:.1%}",
        "short_id": lambda value: str(value)[:8],
    }
    return environment


def _name(value: str) -> Markup:
    """Of a drive: a line breaks after `_` rather than within a date or a word."""
    text = str(escape(value)).replace("_", "_<wbr>")
    return Markup(re.sub(r"\d{4}-\d\d-\d\d", r'<span class="date">\g<0></span>', text))


def _decimals(value: float | None, count: int = 3) -> str:
    return "" if value is None else f"{value:.{count}f}"
