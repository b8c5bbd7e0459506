"""Pages of the reference that scripts/mkdocs_hook.py makes from the code."""

from __future__ import annotations

import re

from conetl.files.documents import nested_model
from conetl.readers.drives.proposals.template import KEYS
from scripts.mkdocs_hook import commands_as_markdown, keys_as_markdown


def test_every_key_of_drive_yaml_is_explained() -> None:
    section, found = "", set()
    for line in keys_as_markdown().splitlines():
        if line.startswith("## "):
            section = f"{line[4:-1]}." if "`" in line else ""
        elif match := re.match(r"- `([\w.]+)`(?: \(.*?\))?: \S.{3,}", line):
            found.add(match[1] if "." in match[1] else section + match[1])
    keys = {key for key, field in KEYS.items() if nested_model(field.annotation) is None}
    assert {key for key in keys if not key.startswith("shutter.right.")} == found - {"shutter.right"}


def test_every_command_is_in_the_reference() -> None:
    page = commands_as_markdown()
    assert page.startswith("## Exit codes\n\n- 0: done\n") and "\n## `conetl`\n" in page
    assert all(f"### `conetl {name}`" in page for name in ("ingest", "map export", "zones plan import"))
