"""The table of checks: its names and limits exist, and all its messages can be written."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from string import Formatter

import pytest

from conetl.checks.check import Check
from conetl.checks.log import COMMON_MESSAGES
from conetl.checks.table import GROUPS, TABLE, as_markdown
from conetl.model.check_params import CheckParams
from conetl.model.health import AGREEMENT
from tests.folders import ROOT

_SOURCES = {
    path: path.read_text(encoding="utf-8")
    for path in sorted((ROOT / "src/conetl").rglob("*.py"))
    if path.parent.name != "checks" or path.parent.parent.name != "conetl"
}
_CODE = "\n".join(_SOURCES.values())
_OF_FINDINGS = {"value", "size", "sigma"}


def _fields(text: str) -> set[str]:
    return {name for _, name, _, _ in Formatter().parse(text) if name}


def test_names_are_unique() -> None:
    assert len(TABLE) == sum(map(len, GROUPS.values()))


@pytest.mark.parametrize("row", TABLE.values(), ids=lambda row: row.name)
def test_a_row_names_what_exists(row: Check) -> None:
    """Its limits are parameters, modules find it, and they state the facts that its messages name."""
    for name in filter(None, (row.least, row.sigmas)):
        assert CheckParams().value(name) > 0
    assert f'"{row.name.removeprefix(f"{AGREEMENT}: ")}"' in _CODE or row.name.startswith(AGREEMENT)
    facts = set().union(*map(_fields, (*row.messages.values(), row.passed, row.unobserved, row.remedy)))
    unknown = {name for name in facts - _OF_FINDINGS if f'"{name}"' not in _CODE and f"{name}=" not in _CODE}
    assert unknown == set()
    assert row.follows_from.keys() <= row.messages.keys()


def test_common_messages_name_facts_that_modules_state() -> None:
    facts = set().union(*map(_fields, COMMON_MESSAGES.values()))
    assert {name for name in facts if f'"{name}"' not in _CODE and f"{name}=" not in _CODE} == set()


@pytest.mark.parametrize("group", GROUPS)
def test_the_pages_list_every_check_with_its_limit(group: str) -> None:
    lines = as_markdown(group).split("\n")
    assert [line.removeprefix("### ") for line in lines if line.startswith("#")] == [row.name for row in GROUPS[group]]
    assert sum(line.startswith("- **Limit:** ") for line in lines) == len(GROUPS[group])
    assert not any("{" in line or "  " in line for line in lines)


def test_only_the_rule_gives_verdicts() -> None:
    """All other modules compute findings; they read verdicts, or records of them."""
    allowed = {"health.py", "decision_store.py", "drive_facts.py"}
    makers = {path.name for path, text in _SOURCES.items() if "HealthCheck(" in text}
    assert makers <= allowed


def _said(code: ast.AST) -> Iterator[str]:
    """Names of messages in a module: in `says=` of findings and arguments of `saying`."""
    for node in ast.walk(code):
        if isinstance(node, ast.keyword) and node.arg == "says":
            yield from (one.value for one in ast.walk(node.value) if isinstance(one, ast.Constant))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "saying":
            yield from (one.value for one in node.args if isinstance(one, ast.Constant))


def test_every_message_that_a_module_names_exists() -> None:
    known = COMMON_MESSAGES.keys() | {name for row in TABLE.values() for name in row.messages}
    said = {name for text in _SOURCES.values() if "Finding" in text for name in _said(ast.parse(text))}
    assert len(said) > 5 and {name for name in said if isinstance(name, str)} <= known
