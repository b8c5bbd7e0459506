"""Names of files as text that can be printed and stored, and texts as names of files; time spans in words."""

from __future__ import annotations

import re
from pathlib import Path

from conetl.model.errors import InputError

#: Characters that have a meaning within a line of Markdown, GitHub's included.
_MARKDOWN = re.compile(r"([\\`*_~<>\[\]()!|&:@]|(?<=www)\.)")
#: Of terminals, and those that change the direction or the lines of the text around them.
_CONTROL = re.compile("[\x00-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069]")
_CONTROL_BUT_LINES = re.compile(f"(?![\t\n]){_CONTROL.pattern}")


def printable(text: str | Path, *, lines: bool = False) -> str:
    """Text that is valid in UTF-8 and PostgreSQL and moves no cursor: other bytes of a name, and control characters, become
    \\xfc, as `ls` and Python write them. lines: tabs and ends of lines stay."""
    text = str(text)
    try:
        raw = text.encode(errors="surrogateescape")
    except UnicodeEncodeError:  # a lone surrogate, as YAML may contain
        raw = text.encode(errors="surrogatepass")
    shown = raw.decode(errors="backslashreplace")
    return (_CONTROL_BUT_LINES if lines else _CONTROL).sub(_escaped, shown)


def _escaped(found: re.Match[str]) -> str:
    return found[0].encode("unicode_escape").decode()


def as_markdown(text: str | Path) -> str:
    """Any text, such as a drive's id, as a line of Markdown that shows it as it is: no HTML, image, link, code or cell."""
    return _MARKDOWN.sub(r"\\\1", " ".join(printable(text, lines=True).split()))


def require_utf8(folder: Path) -> None:
    """Raise InputError where the path of a drive, or of a link's target, is not UTF-8: the map stores it as text."""
    for path in (folder.absolute(), folder.resolve()):
        try:
            str(path).encode()
        except UnicodeEncodeError:
            raise InputError(
                f"{printable(path)}: the name is not UTF-8, and neither the database nor Parquet files can store it; rename the "
                "folder (convmv does it for whole trees)"
            ) from None


def file_name_part(text: str, most_bytes: int = 200) -> str:
    """Any text, such as a drive's id, as part of a file name, which is limited to 255 bytes."""
    name = "".join(c if c.isalnum() or c in "-_." else "_" for c in text).lstrip(".")
    return truncate_to_bytes(name, most_bytes) or "drive"


def truncate_to_bytes(text: str, most_bytes: int) -> str:
    """The start of a name in at most this many bytes, whole characters only."""
    raw = text.encode(errors="surrogateescape")
    return text if len(raw) <= most_bytes else raw[:most_bytes].decode(errors="ignore")


def minutes(seconds: float) -> str:
    """A time span in words."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
