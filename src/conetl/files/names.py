"""Names of files as text that can be printed and stored, and texts as names of files; time spans in words."""

from __future__ import annotations

import re
from pathlib import Path

from conetl.model.errors import InputError

#: Characters that have a meaning within a line of Markdown, GitHub's included.
_MARKDOWN = re.compile(r"([\\`*_~<>\[\]()!|&:@]|(?<=www)\.)")


def printable(text: str | Path) -> str:
    """Text that is valid in UTF-8 and PostgreSQL: other bytes of a name become \\xfc, as `ls` and Python write them."""
    text = str(text)
    try:
        raw = text.encode(errors="surrogateescape")
    except UnicodeEncodeError:  # a lone surrogate, as YAML may contain
        raw = text.encode(errors="surrogatepass")
    return raw.decode(errors="backslashreplace").replace("\0", "\\x00")


def as_markdown(text: str | Path) -> str:
    """Any text, such as a drive's id, as a line of Markdown that shows it as it is: no HTML, image, link, code or cell."""
    return _MARKDOWN.sub(r"\\\1", " ".join(printable(text).split()))


def require_utf8(folder: Path) -> None:
    """Raise InputError where the path of a drive, or of a link's target, is not UTF-8: the map stores it as text."""
    for path in (folder.absolute(), folder.resolve()):
        if printable(path) != str(path):
            raise InputError(
                f"{printable(path)}: the name is not UTF-8, and neither the database nor Parquet files can store it; rename the "
                "folder (convmv does it for whole trees)"
            )


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
