"""MkDocs hook: the reference of the command line and of the fields, from the code."""

from __future__ import annotations

from typing import Any

import click
import typer
from typer.cli import get_docs_for_click

from conetl.cli.app import app
from conetl.exports.fields import as_markdown


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Append the help of all commands to reference/cli.md, the fields to reference/fields.md; other pages stay as they are."""
    if page.file.src_uri == "reference/fields.md":
        return f"{markdown}\n{as_markdown()}"
    if page.file.src_uri != "reference/cli.md":
        return markdown
    command = typer.main.get_command(app)
    with click.Context(command, info_name="conetl") as context:
        text = get_docs_for_click(obj=command, ctx=context, name="conetl")
    return (
        markdown
        + "\n"
        + text.replace("# `conetl`\n", "## `conetl`\n", 1)
        .replace("\n## `", "\n### `")
        .replace("\n### `conetl`", "\n## `conetl`", 1)
    )
