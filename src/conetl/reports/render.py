"""Facts into HTML by the templates beside this file: everything is escaped, nothing is loaded from anywhere."""

from __future__ import annotations

import base64
from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup


def render(template: str, **values: Any) -> str:
    """One page as text. template: name of a file in `templates`."""
    return _environment().get_template(template).render(**values)


def data_uri(data: bytes, kind: str) -> Markup:
    """A image as part of the page. kind: png or jpeg."""
    return Markup(f"data:image/{kind};base64,{base64.b64encode(data).decode('ascii')}")


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent / "templates"),
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    environment.filters["words"] = lambda value: str(value).replace("_", " ")
    environment.filters["time"] = lambda value: f"{value:%Y-%m-%d %H:%M:%S}"
    environment.filters["minute"] = lambda value: f"{value:%Y-%m-%d %H:%M}"
    environment.filters["m"] = lambda value: "" if value is None else f"{value:.3f}"
    environment.filters["number"] = lambda value: f"{value:,}".replace(",", " ")
    environment.filters["percent"] = lambda value: f"{value:.1%}"
    return environment
