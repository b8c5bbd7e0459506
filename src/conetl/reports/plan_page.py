"""The page of differences between planned and found work zones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

from markupsafe import Markup

from conetl.model.planned_zones import WORST_FIRST, DifferenceKind
from conetl.reports.html import Section, render, write_page

#: Heading -> columns of a row, whose values are joined.
_COLUMNS = {
    "plan": ("plan_id",), "zone": ("zone_id",), "what": ("text",), "absent": ("absent_at", "absent_drive"),
    "first seen": ("first_at", "first_drive"), "last seen": ("last_at", "last_drive"), "gone": ("gone_at", "gone_drive"),
    "planned": ("planned_from", "planned_until"), "looked at": ("coverage",), "confidence": ("confidence",),
    "verdict": ("verdict", "note", "decided_by"),
}  # fmt: skip
_NOTE = "Set up between the passes absent and first seen, taken away between last seen and gone. Times are in UTC."


def write_plan_page(path: Path, map_name: str, at: datetime, rows: Sequence[Mapping[str, Any]], view: str) -> Path:
    """Write the page, differences first. rows: by column; view: address of the map viewer, for links. Raises InputError."""
    rows = sorted(rows, key=lambda row: row["rank"] or 0)
    sections = []
    for kind in (*WORST_FIRST, DifferenceKind.PERMITTED, DifferenceKind.NOT_LOOKED):
        cells = [_cells(row, view) for row in rows if row["kind"] == kind]
        if cells:
            used = [k for k in range(len(cells[0])) if any(row[k] for row in cells)]
            shown = [[row[k] for k in used] for row in cells]
            headings = [[*_COLUMNS, "images"][k] for k in used]
            sections.append(Section(f"{kind.capitalize()} ({len(cells)})", _NOTE, headings, shown))
    summary = [f"State of the road at {at:%Y-%m-%d %H:%M} UTC.", f"{len(rows)} rows."]
    title = f"Planned and found work zones, map {map_name}"
    return write_page(path, render("accuracy.html.j2", title=title, summary=summary, sections=sections))


def _cells(row: Mapping[str, Any], view: str) -> list[object]:
    parts = ([text for name in names if (text := _text(name, row[name]))] for names in _COLUMNS.values())
    plan, *others = (", ".join(texts) for texts in parts)
    images = Markup(", ").join(_image(path, number) for number, path in enumerate(row["images"], 1))
    linked = Markup('<a href="{}/{}">{}</a>').format(view, row["link"], plan or "show") if view else plan
    return [linked, *others, images]


def _image(path: str, number: int) -> str:
    return Markup('<a href="{}" title="{}">image {}</a>').format(_as_uri(path), path, number)


def _as_uri(path: str) -> str:
    """Address of a file; addresses of objects stay as they are."""
    return Path(path).as_uri() if Path(path).is_absolute() else path


def _text(name: str, value: object) -> str:
    """As a person reads it: times to the minute, ids by their beginning, shares in per cent."""
    if value is None:
        return ""
    if name.endswith("_at") or name.startswith("planned_"):
        return str(value)[:16].replace("T", " ")
    if isinstance(value, float):
        return f"{value:.0%}"
    return str(value)[:8] if name == "zone_id" else str(value)
