"""MkDocs hook: the reference of the command line, of the fields and of the database, and the tables of checks, from the code."""

from __future__ import annotations

import html
import re
from typing import Any

import typer
from typer.cli import get_docs_for_click

from conetl.checks import table
from conetl.cli.app import app
from conetl.db.connection import sql_directory
from conetl.model.columns import as_markdown

_COMMENT = re.compile(
    r"^comment on (table|view|function|column|type) conetl\.([\w.]+) is\s+((?:'(?:[^']|'')*'\s*)+);", re.MULTILINE
)
_GONE = re.compile(r"^drop (?:table|view|function) ((?:conetl\.\w+(?:\(\))?(?:, )?)+);", re.MULTILINE)
_CHECKS = re.compile(r"^<!-- checks: (\w+) -->$", re.MULTILINE)
_KINDS = {"function": "Functions", "view": "Views", "table": "Tables", "type": "Types"}


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Append the help of all commands to reference/cli.md, the fields to reference/fields.md, the comments of the schema to
    reference/database.md; put the tables of checks where pages name them; other pages stay as they are."""
    if page.file.src_uri == "reference/fields.md":
        return f"{markdown}\n{as_markdown()}"
    if page.file.src_uri == "reference/database.md":
        return f"{markdown}\n{schema_as_markdown()}"
    if page.file.src_uri != "reference/cli.md":
        return _CHECKS.sub(lambda found: table.as_markdown(found[1]), markdown)
    command = typer.main.get_command(app)
    with (context := typer.Context(command, info_name="conetl")):
        text = get_docs_for_click(obj=command, ctx=context, name="conetl")
    return (
        markdown
        + "\n"
        + text.replace("# `conetl`\n", "## `conetl`\n", 1)
        .replace("\n## `", "\n### `")
        .replace("\n### `conetl`", "\n## `conetl`", 1)
    )


def schema_comments() -> dict[tuple[str, str], str]:
    """Comments of the schema as the files in sql/ leave it: kind and name (of a column: table.column) -> text."""
    files = sorted((sql_directory() / "migrations").glob("*.sql")) + sorted(
        (sql_directory() / "functions").glob("*.sql")
    )
    found: dict[tuple[str, str], str] = {}
    for path in files:
        text = path.read_text(encoding="utf-8")
        gone = {
            name.removeprefix("conetl.").removesuffix("()")
            for names in _GONE.findall(text)
            for name in names.split(", ")
        }
        found = {key: comment for key, comment in found.items() if key[1].partition(".")[0] not in gone}
        for kind, name, parts in _COMMENT.findall(text):
            found[kind, name] = "".join(re.findall(r"'((?:[^']|'')*)'", parts)).replace("''", "'")
    return found


def plain(text: str) -> str:
    """A comment is no Markdown: brackets, bars and underscores are shown as they are written."""
    return re.sub(r"([\\`*_\[\]|])", r"\\\1", html.escape(text, quote=False))


def schema_as_markdown() -> str:
    """A table per kind of object, and one of the columns."""
    found = schema_comments()
    lines: list[str] = []
    for kind, title in _KINDS.items():
        named = {name: text for (of, name), text in sorted(found.items()) if of == kind}
        lines += [
            "",
            f"## {title}",
            "",
            "| name | |",
            "|---|---|",
            *(f"| `{name}` | {plain(text)} |" for name, text in named.items()),
        ]
    columns = {name: text for (of, name), text in sorted(found.items()) if of == "column"}
    lines += ["", "## Columns", "", "Those that need more than their name.", "", "| column | |", "|---|---|"]
    return "\n".join([*lines, *(f"| `{name}` | {plain(text)} |" for name, text in columns.items()), ""])
