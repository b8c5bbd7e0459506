"""One self-contained HTML page of a drive against truth: tables and embedded PNG images, no scripts, nothing to load."""

from __future__ import annotations

import base64
import html
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from conetl.files.atomic import atomic_text_file

_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 62rem; margin: 2rem auto; padding: 0 1rem; color: #1c2328; }
h1 { font-size: 1.5rem; } h2 { font-size: 1.15rem; margin-top: 2rem; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; margin: .5rem 0; }
th, td { padding: .2rem .7rem; text-align: right; border-bottom: 1px solid #e3e8eb; }
th:first-child, td:first-child { text-align: left; }
img { max-width: 100%; height: auto; } p.note { color: #57646d; } li { margin: .2rem 0; }
@media (prefers-color-scheme: dark) { body { background: #14191d; color: #dde3e7; } th, td { border-color: #333c43; }
p.note { color: #9aa7ae; } img { background: white; } }
"""


@dataclass(frozen=True)
class Section:
    """Part of the page: a heading, words, a table, a image; what is empty is left out."""

    heading: str
    text: str = ""
    columns: Sequence[str] = ()
    rows: Sequence[Sequence[object]] = ()
    image: bytes | None = None
    image_words: str = ""


def write_accuracy_page(path: Path, *, title: str, summary: Sequence[str], sections: Sequence[Section]) -> Path:
    """Write the page and return its path. All words are escaped; images are PNG bytes."""
    parts = [
        "<!doctype html>\n<html lang='en'><head><meta charset='utf-8'>",
        "<meta name='viewport' content='width=device-width, initial-scale=1'>",
        f"<title>{html.escape(title)}</title><style>{_STYLE}</style></head><body>",
        f"<h1>{html.escape(title)}</h1>",
        "<ul>" + "".join(f"<li>{html.escape(line)}</li>" for line in summary) + "</ul>",
        *(_section(section) for section in sections),
        "</body></html>\n",
    ]
    with atomic_text_file(path) as file:
        file.write("\n".join(parts))
    return path


def _section(section: Section) -> str:
    parts = [f"<h2>{html.escape(section.heading)}</h2>"]
    if section.text:
        parts.append(f"<p class='note'>{html.escape(section.text)}</p>")
    if section.rows:
        head = "".join(f"<th>{html.escape(str(column))}</th>" for column in section.columns)
        body = "".join(
            "<tr>" + "".join(f"<td>{html.escape(str(cell))}</td>" for cell in row) + "</tr>" for row in section.rows
        )
        parts.append(f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>")
    if section.image is not None:
        data = base64.b64encode(section.image).decode()
        parts.append(f"<img alt='{html.escape(section.image_words)}' src='data:image/png;base64,{data}'>")
    return "\n".join(parts)
