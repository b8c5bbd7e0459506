"""Names of files and folders as text that can be shown and stored, and texts as names of files."""

from __future__ import annotations

from pathlib import Path

from conetl.model.errors import DriveFolderError


def printable(text: str | Path) -> str:
    """Text that UTF-8 and PostgreSQL can hold: bytes of a name that are not UTF-8 become \\xfc, as `ls` and Python write them."""
    text = str(text)
    try:
        raw = text.encode(errors="surrogateescape")
    except UnicodeEncodeError:  # a lone surrogate that no file system gave, as YAML may write one
        raw = text.encode(errors="surrogatepass")
    return raw.decode(errors="backslashreplace").replace("\0", "\\x00")


def require_utf8(folder: Path) -> None:
    """Raise DriveFolderError where the path of a drive, or of what a link leads to, is not UTF-8: the map keeps it as text."""
    for path in (folder.absolute(), folder.resolve()):
        if printable(path) != str(path):
            raise DriveFolderError(
                f"{printable(path)}: the name is not UTF-8, and neither the database nor Parquet files can hold it; rename the "
                "folder (convmv does it for whole trees)"
            )


def file_name_part(text: str, most_bytes: int = 200) -> str:
    """Any text, a drive's id for one, as part of a file name. File systems count bytes (255), and some letters are four."""
    name = "".join(c if c.isalnum() or c in "-_." else "_" for c in text).lstrip(".")
    return cut_to_bytes(name, most_bytes) or "drive"


def cut_to_bytes(text: str, most_bytes: int) -> str:
    """The beginning of a name that takes at most so many bytes, whole letters only."""
    raw = text.encode(errors="surrogateescape")
    return text if len(raw) <= most_bytes else raw[:most_bytes].decode(errors="ignore")
