"""The page of differences between planned and found work zones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

from markupsafe import Markup

from conetl.model.planned_zones import DifferenceKind
from conetl.reports.html import Section, render, write_page

_COLUMNS = (
    "plan", "zone", "what", "absent", "first seen", "last seen", "gone", "planned", "looked at", "confidence", "verdict",
    "images",
)  # fmt: skip
_NOTE = "Set up between the passes `absent` and `first seen`, taken away between `last seen` and `gone`; times in UTC."


def write_plan_page(path: Path, map_name: str, at: datetime, rows: Sequence[Mapping[str, Any]], view: str) -> Path:
    """Write the page, differences first. rows: by column; view: address of the web view, for links. Raises InputError."""
    by_kind = {kind: [row for row in rows if row["kind"] == kind] for kind in DifferenceKind}
    quiet = (DifferenceKind.PERMITTED, DifferenceKind.NOT_LOOKED)
    order = [*(kind for kind in DifferenceKind if kind not in quiet), *quiet]
    sections = [
        Section(f"{kind.capitalize()} ({len(some)})", _NOTE, _COLUMNS, [_cells(row, view) for row in some])
        for kind in order
        if (some := by_kind[kind])
    ]
    summary = [f"State of the road at {at:%Y-%m-%d %H:%M} UTC.", f"{len(rows)} rows."]
    title = f"Planned and found work zones, map {map_name}"
    return write_page(path, render("accuracy.html.j2", title=title, summary=summary, sections=sections))


def _cells(row: Mapping[str, Any], view: str) -> list[object]:
    link = (
        Markup('<a href="{}/{}">{}</a>').format(view, row["link"], row["plan_id"] or "none") if view else row["plan_id"]
    )
    passes = [_pass(row[f"{name}_at"], row[f"{name}_drive"]) for name in ("absent", "first", "last", "gone")]
    planned = [f"{one:%Y-%m-%d %H:%M}" if one else "" for one in (row["planned_from"], row["planned_until"])]
    looked = "" if row["coverage"] is None else f"{row['coverage']:.0%}"
    verdict = " ".join(str(row[name]) for name in ("verdict", "note", "decided_by") if row[name])
    zone = str(row["zone_id"] or "")[:8]
    shown = [link or "none", zone, row["text"], *passes, " to ".join(planned) if any(planned) else "", looked]
    return [*shown, f"{row['confidence']:.2f}", verdict, ", ".join(row["images"])]


def _pass(at: datetime | None, drive_id: str | None) -> str:
    return "" if at is None else f"{at:%Y-%m-%d %H:%M} {drive_id or ''}".strip()
