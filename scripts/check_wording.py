"""Find wording that the project has retired, in everything that a person reads. Run: python scripts/check_wording.py [FILES]

Without files it checks all tracked ones. Prints one line per finding, `file:line: 'phrase': write ...`, and exits with 1 where
there is one.
"""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

#: Retired phrase (regular expression, matched in any case) and what to write for it.
RETIRED = {
    r"not to be had|not to be got": "unavailable, cannot be reached",
    r"a mistake of conetl|mistakes? of the program": "internal error",
    r"in vain": "not observed although visible, without result",
    r"takes? no decisions": "read-only",
    r"(?:closer|enlarged) looks?": "re-scoring pass, small-object pass",
    r"(?:is|are|was|were|be) told|untold|tells? of": "published, notified, reported; pending; describes",
    r"let(?:s|ting)? go of": "releases, drops",
    r"that is none|there is none of": "name the thing that is missing",
    r"\brooms? of": "package, module",
    r"at the most": "at most",
    r"\blevers\b": "shared-error Jacobian",
    r"\beyes\b": "visibility",
    r"\bbeliefs?\b": "existence probability",
    r"at a glance": "header, overview",
    r"left and right pictures?": "left and right images",
    r"\bway of the\b": "drive path, camera path, trajectory",
    r"exists already|on the map already": "already exists, already on the map",
    r"costs? (?:its|the|their|that|those) (?:frame )?pairs?\b": "only its frame pair is lost",
    r"\berrs? alike": "have the same errors",
    r"something needs a person": "needs attention",
    r"on the safe side": "conservative",
    r"is as it was\b": "is unchanged",
    r"story begins": "Start with",
    r"\bmended\b": "fixed",
    r"too little to tell": "not enough for this check",
    r"gained nothing": "made no difference",
    r"(?:surveyed|known) truth": "ground truth",
    r"aside of\b": "beside",
    r"brought onto": "committed to, put on",
    r"at a stated \{": "with a stated sigma of",
    r"unless (?:given|told)\b": "by default, default:",
}
#: Files whose text is not ours, or that must name what is retired.
EXEMPT = (
    "scripts/check_wording.py", "requirements.txt", "web/package-lock.json", "src/conetl/web/static/",
    "src/conetl/exports/wzdx_schemas/",
    "data/", "CHANGELOG.md",
)  # fmt: skip
SUFFIXES = {".py", ".md", ".sql", ".ts", ".html", ".css", ".j2", ".toml", ".yaml", ".yml", ".sh", ""}


def findings(path: Path) -> list[str]:
    """One line per retired phrase in a file; files that are not UTF-8 text have none."""
    try:
        text = path.read_text(encoding="utf-8")
    except (UnicodeDecodeError, OSError):
        return []
    return [
        f"{path}:{text.count(chr(10), 0, match.start()) + 1}: {' '.join(match.group().split())!r}: write {instead}"
        for pattern, instead in RETIRED.items()
        for match in re.finditer(pattern.replace(" ", r"\s+"), text, re.IGNORECASE)
    ]


def main(arguments: list[str]) -> int:
    """Check the files, all tracked ones where none is given; exit code."""
    names = arguments or subprocess.run(["git", "ls-files"], capture_output=True, text=True, check=True).stdout.split(
        "\n"
    )
    paths = [Path(n) for n in names if n and not n.startswith(EXEMPT) and Path(n).suffix in SUFFIXES]
    found = [line for path in paths for line in findings(path)]
    print("\n".join(found) if found else "No retired wording.")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
