"""What 1.x keeps (docs/reference/stability.md): names, options, columns and events against `promise.json`.

Renew the file with CONETL_RENEW_PROMISE=1; what is gone from it must stand in the newest section of CHANGELOG.md.
"""

from __future__ import annotations

import inspect
import json
import os
import re
from collections.abc import Iterator
from contextlib import closing
from typing import Any, get_args, get_type_hints

import pytest
from typer.main import get_command

import conetl
from conetl.cli.app import app
from conetl.db.connection import connect, execute
from conetl.model.columns import COLUMNS, Face
from conetl.model.errors import EXIT_CODES
from conetl.model.notices import Notice, Subject
from scripts.mkdocs_hook import PROMISE
from tests.command import ROOT

#: Of the database: what docs/reference/database.md tells people to query.
QUERIED = ("current_feature", "feature_state", "latest_receipt", "feature_states", "feature_changes")
Promise = dict[str, dict[str, str]]
"""Group -> name -> its parts, separated by spaces."""


def commands(command: Any, path: str) -> Iterator[tuple[str, str]]:
    """Each command with its options, old names too."""
    context = command.make_context(path, [], resilient_parsing=True)
    if hasattr(command, "list_commands"):
        for name in command.list_commands(context):
            yield from commands(command.get_command(context, name), f"{path} {name}")
    else:
        options = {name for one in command.params for name in (*one.opts, *one.secondary_opts) if name.startswith("-")}
        yield path, " ".join(sorted(options))


def parts_of(value: Any) -> str:
    """Parameters of a function, fields of a record."""
    if inspect.isclass(value) and issubclass(value, Exception):
        return ""
    return " ".join(getattr(value, "model_fields", None) or inspect.signature(value).parameters)


def current(url: str) -> Promise:
    """What the code and the database have now."""
    with closing(connect(url)) as conn:
        columns = execute(
            conn,
            "select table_name as name, column_name as part from information_schema.columns where table_schema = 'conetl' "
            "union all select routine_name, p.parameter_name from information_schema.routines r join "
            "information_schema.parameters p using (specific_schema, specific_name) where specific_schema = 'conetl' "
            "order by 1, 2",
        )
    found = {name: " ".join(row["part"] for row in columns if row["name"] == name) for name in QUERIED}
    hints = get_type_hints(Notice)
    topics, events = get_args(get_type_hints(Subject)["topic"]), get_args(hints["event"])
    notices = [f"{topic}.{event}" for topic in topics for event in events]
    notices.remove("plan_difference.withdrawn")  # it ends
    sources = "".join(path.read_text() for path in sorted((ROOT / "flows").glob("*.py")))
    emitted = re.findall(r'"(conetl\.\w+\.\w+)"', sources)
    return {
        "Python: `from conetl import ...`": {name: parts_of(getattr(conetl, name)) for name in sorted(conetl.__all__)},
        "Commands and options": dict(commands(get_command(app), "conetl")),
        "Exit codes": {str(code): "" for code in EXIT_CODES},
        "Columns of files": {
            one.name: f"{one.kind} {one.unit}".strip() for one in COLUMNS if one.shown & (Face.FILE | Face.PLACE)
        },
        "Views and functions of the database": {f"conetl.{name}": parts for name, parts in found.items()},
        "Notices": dict.fromkeys(sorted(notices), ""),
        "Events of Prefect": dict.fromkeys(sorted(set(emitted)), ""),
    }


def words_of(promise: Promise) -> set[tuple[str, str, str]]:
    """Group, name and part of all that is promised."""
    return {
        (g, name, part)
        for g, names in promise.items()
        for name, parts in names.items()
        for part in ["", *parts.split()]
    }


def unexplained(before: Promise, now: Promise, changes: str) -> list[str]:
    """What is gone and not named in the changes, as code."""
    named = {word for code in re.findall(r"`([^`]+)`", changes) for word in (code, *code.split())}
    gone = sorted(words_of(before) - words_of(now))
    return [f"{name} {part}".strip() for _, name, part in gone if (part or name) not in named]


def test_what_is_gone_must_be_explained() -> None:
    before, now = {"Commands": {"conetl a": "--x --y", "conetl b": ""}}, {"Commands": {"conetl a": "--x"}}
    assert unexplained(before, now, "") == ["conetl a --y", "conetl b"]
    assert unexplained(before, now, "`conetl b` and the option --y of `conetl a` are gone") == ["conetl a --y"]
    assert unexplained(before, now, "`conetl b` and `conetl a --y` are gone") == []
    assert unexplained(now, before, "") == []


def test_the_promise_is_kept(database_url: str) -> None:
    now = current(database_url)
    assert all(now.values()) and all(now["Views and functions of the database"].values())
    before = json.loads(PROMISE.read_text(encoding="utf-8")) if PROMISE.exists() else {}
    if "CONETL_RENEW_PROMISE" in os.environ:
        newest = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8").split("\n## ")[1]
        if lost := unexplained(before, now, newest):
            pytest.fail(f"name these in the newest section of CHANGELOG.md, or keep them: {', '.join(lost)}")
        PROMISE.write_text(json.dumps(now, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
        return
    differ = words_of(before) ^ words_of(now)
    assert before == now, f"renew promise.json (CONETL_RENEW_PROMISE=1) and say it in CHANGELOG.md: {sorted(differ)}"
