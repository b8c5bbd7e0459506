"""MkDocs hook: the reference of the command line, drive.yaml, checks, fields, database and what 1.x keeps, from the code."""

from __future__ import annotations

import ast
import html
import inspect
import json
import re
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any, get_origin

import typer
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from typer.cli import get_docs_for_click

from conetl.checks import table
from conetl.cli.app import app
from conetl.db.connection import sql_directory
from conetl.exports.wzdx import SOURCES
from conetl.files.documents import nested_model
from conetl.model.columns import as_markdown
from conetl.model.errors import EXIT_CODES
from conetl.readers.drives.drive_yaml import DriveYaml
from conetl.readers.drives.proposals.template import in_yaml

PROMISE = Path(__file__).resolve().parents[1] / "tests" / "integration" / "promise.json"
_COMMENT = re.compile(
    r"^comment on (table|view|function|column|type) conetl\.([\w.]+) is\s+((?:'(?:[^']|'')*'\s*)+);", re.MULTILINE
)
_GONE = re.compile(r"^drop (?:table|view|function) ((?:conetl\.\w+(?:\(\))?(?:, )?)+);", re.MULTILINE)
_CHECKS = re.compile(r"^<!-- checks: (\w+) -->$", re.MULTILINE)
_KINDS = {"function": "Functions", "view": "Views", "table": "Tables", "type": "Types", "column": "Columns"}


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Append what the code states to pages of the reference, and put the checks of a group where a page names it; other pages
    stay as they are."""
    made = {
        "reference/cli.md": commands_as_markdown,
        "reference/database.md": schema_as_markdown,
        "reference/drive_yaml.md": keys_as_markdown,
        "reference/fields.md": as_markdown,
        "reference/stability.md": promise_as_markdown,
        "reference/wzdx.md": feed_as_markdown,
    }
    if page.file.src_uri in made:
        return f"{markdown}\n{made[page.file.src_uri]()}"
    return _CHECKS.sub(lambda found: table.as_markdown(found[1]), markdown)


def commands_as_markdown() -> str:
    """The exit codes, and the help of all commands."""
    codes = "\n".join(["## Exit codes", "", *(f"- {code}: {meaning}" for code, meaning in EXIT_CODES.items()), "", ""])
    command = typer.main.get_command(app)
    with (context := typer.Context(command, info_name="conetl")):
        text = get_docs_for_click(obj=command, ctx=context, name="conetl")
    text = text.replace("# `conetl`\n", "## `conetl`\n", 1).replace("\n## `", "\n### `")
    return codes + text.replace("\n### `conetl`", "\n## `conetl`", 1)


def promise_as_markdown() -> str:
    """What 1.x keeps, by group. tests/integration/test_promise.py compares the file with the code and the database."""
    lines: list[str] = []
    for group, names in json.loads(PROMISE.read_text(encoding="utf-8")).items():
        lines += [
            "",
            f"## {group}",
            "",
            *(f"- `{name}`" + (f": `{parts}`" if parts else "") for name, parts in names.items()),
        ]
    return "\n".join([*lines, ""])


def keys_as_markdown() -> str:
    """The keys of drive.yaml: those of the highest level, then a list for each section."""
    sections = {name: nested_model(field.annotation) for name, field in DriveYaml.model_fields.items()}
    lines = [
        "",
        "## Keys of the highest level",
        "",
        *keys_of(DriveYaml, [n for n, model in sections.items() if model is None]),
    ]
    for name, model in sections.items():
        if model is not None:
            lines += ["", f"## `{name}`", "", inspect.cleandoc(model.__doc__ or ""), "", *keys_of(model)]
            lines += [
                f"- `{name}.{key}`: the same keys."
                for key, field in model.model_fields.items()
                if nested_model(field.annotation)
            ]
    return "\n".join([*lines, ""])


def keys_of(model: type[BaseModel], names: list[str] | None = None) -> Iterator[str]:
    """A line per key: default, meaning, example."""
    for name, field in model.model_fields.items():
        if (names is None and nested_model(field.annotation) is None) or (names is not None and name in names):
            facts = [f"default {in_yaml(field.default)}"] if shown_default(field) else []
            facts += ["required"] if field.is_required() else []
            text = " ".join(filter(None, (field.description, docstrings(model).get(name))))
            example = f" Example: `{in_yaml(field.examples[0])}`." if field.examples else ""
            yield f"- `{name}`{f' ({facts[0]})' if facts else ''}: {text}{example}"


def shown_default(field: FieldInfo) -> bool:
    """Whether the default of a key is a value that a reader could write."""
    return isinstance(field.default, str | int | float) and get_origin(field.annotation) is not dict


def docstrings(model: type[BaseModel]) -> dict[str, str]:
    """The texts below the fields of a model and of the models that it extends."""
    found: dict[str, str] = {}
    for each in reversed([one for one in model.__mro__ if one.__module__.startswith("conetl.")]):
        body = ast.parse(inspect.cleandoc("\n" + inspect.getsource(each))).body[0].body  # type: ignore[attr-defined]
        for field, text in pairwise(body):
            if isinstance(field, ast.AnnAssign) and isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant):
                found[field.target.id] = " ".join(str(text.value.value).split())  # type: ignore[union-attr]
    return found


def feed_as_markdown() -> str:
    """The fields of a road event of WZDx."""
    return "\n".join(["## Fields of a road event", "", *(f"- `{name}`: {text}" for name, text in SOURCES.items()), ""])


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
    """A list per kind of object, and one of the columns."""
    found = schema_comments()
    lines: list[str] = []
    for kind, title in _KINDS.items():
        lines += [
            "",
            f"## {title}",
            "",
            *(f"- `{name}`: {plain(text)}" for (of, name), text in sorted(found.items()) if of == kind),
        ]
    return "\n".join([*lines, ""])
