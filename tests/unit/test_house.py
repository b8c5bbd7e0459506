"""Rules of the house that linters do not check."""

from __future__ import annotations

import ast
import re
from collections import Counter

from tests.folders import ROOT

MODULES = [path for folder in ("src/conetl", "flows") for path in sorted((ROOT / folder).rglob("*.py"))]


def test_no_two_public_classes_have_one_name() -> None:
    nodes = [node for path in MODULES for node in ast.parse(path.read_text()).body]
    names = Counter(node.name for node in nodes if isinstance(node, ast.ClassDef) and not node.name.startswith("_"))
    assert [name for name, count in names.items() if count > 1] == []


def test_no_folder_has_more_than_20_modules() -> None:
    folders = Counter(path.parent.relative_to(ROOT) for path in MODULES)
    assert {folder: count for folder, count in folders.items() if count > 20} == {}


def test_architecture_names_every_package() -> None:
    packages = sorted(path.parent.name for path in (ROOT / "src/conetl").glob("*/__init__.py"))
    drawing, page = (ROOT / "docs" / name for name in ("images/architecture.svg", "dev/architecture.md"))
    drawn = ", ".join(re.findall('font-weight="bold">([^<]+)<', drawing.read_text())).split(", ")
    listed = re.findall("`([^`]+)`", "".join(re.findall(r"^\| (`[^|]+) \|", page.read_text(), re.MULTILINE)))
    assert sorted(drawn) == sorted(listed) == sorted([*packages, "flows/"])


def test_every_python_gets_the_same_versions() -> None:
    """Tests run with one Python; what they show must hold for the others."""
    for file in ("requirements.txt", "requirements-runtime.txt"):
        names = Counter(re.findall(r"^([\w.-]+)==", (ROOT / file).read_text(), re.MULTILINE))
        assert len(names) > 100 and [name for name, count in names.items() if count > 1] == []
