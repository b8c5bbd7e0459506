"""The page of differences between planned and found work zones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

from markupsafe import Markup

from conetl.model.planned_zones import DifferenceKind
from conetl.reports.html import Section, render, write_page

#: Heading -> columns of a row, whose values are joined.
_COLUMNS = {
    "plan": ("plan_id",), "zone": ("zone_id",), "what": ("text",), "absent": ("absent_at", "absent_drive"),
    "first seen": ("first_at", "first_drive"), "last seen": ("last_at", "last_drive"), "gone": ("gone_at", "gone_drive"),
    "planned": ("planned_from", "planned_until"), "looked at": ("coverage",), "confidence": ("confidence",),
    "verdict": ("verdict", "note", "decided_by"), "images": ("images",),
}  # fmt: skip
_NOTE = "Set up between the passes `absent` and `first seen`, taken away between `last seen` and `gone`; times in UTC."


def write_plan_page(path: Path, map_name: str, at: datetime, rows: Sequence[Mapping[str, Any]], view: str) -> Path:
    """Write the page, differences first. rows: by column; view: address of the web view, for links. Raises InputError."""
    quiet = (DifferenceKind.PERMITTED, DifferenceKind.NOT_LOOKED)
    sections = []
    for kind in [*(kind for kind in DifferenceKind if kind not in quiet), *quiet]:
        cells = [_cells(row, view) for row in rows if row["kind"] == kind]
        if cells:
            sections.append(Section(f"{kind.capitalize()} ({len(cells)})", _NOTE, list(_COLUMNS), cells))
    summary = [f"State of the road at {at:%Y-%m-%d %H:%M} UTC.", f"{len(rows)} rows."]
    title = f"Planned and found work zones, map {map_name}"
    return write_page(path, render("accuracy.html.j2", title=title, summary=summary, sections=sections))


def _cells(row: Mapping[str, Any], view: str) -> list[object]:
    plan, *others = (" ".join(_text(row[name]) for name in names).strip() for names in _COLUMNS.values())
    return [Markup('<a href="{}/{}">{}</a>').format(view, row["link"], plan or "none") if view else plan, *others]


def _text(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.2f}"
    return "" if value is None else ", ".join(value) if isinstance(value, list) else str(value)
