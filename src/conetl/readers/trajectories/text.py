"""Lines and numbers of text files that may be large, damaged or hostile."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np

from conetl.files.documents import input_errors
from conetl.model.arrays import Floats
from conetl.model.errors import InputError

MAX_TEXT_BYTES = 2 << 30
"""20 million records of 100 characters. A larger file is not opened."""
MAX_LINE, LONGEST_LINE = 20_000, 1 << 20
"""Characters of a line that are read; a file with a longer one is refused."""
MOST_UNUSED, PER_RECORD, CHARACTERS = 140_000, 1000, 100
"""Lines that a file may have without a usable record, and how many more for each record; a line of more than so many characters
counts as several. At 100 Hz a receiver may be without a fix for 20 minutes. A block has fewer lines."""
_BLOCK = 1 << 17
_HEAD = 65_536


def head_bytes(path: Path) -> bytes:
    """The first bytes of a file. Raises InputError where it cannot be read or is larger than a trajectory may be."""
    with input_errors(path), path.open("rb") as file:
        if path.stat().st_size > MAX_TEXT_BYTES:
            raise InputError(f"{path}: expected at most {MAX_TEXT_BYTES:,} bytes")
        return file.read(_HEAD)


def encoding_of(head: bytes) -> str:
    """UTF-8, UTF-16 with its mark, or what Western Windows programs write."""
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    try:
        head[: head.rfind(b"\n") + 1].decode()
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8-sig"


def head_lines(path: Path) -> list[str]:
    """The lines among the first bytes of a file, without the last one if it is cut. Raises InputError."""
    head = head_bytes(path)
    text = head.decode(encoding_of(head), errors="replace")
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    return lines[:-1] if len(head) == _HEAD and lines[1:] else lines


class Progress:
    """How much of a file was read, and how many usable records it had so far: a long text that is no log is not read on."""

    def __init__(self, path: Path) -> None:
        self.path, self.lines, self.records = path, 0, 0

    def add(self, where: object, lines: int, characters: int) -> None:
        """After so many more lines, or elements, the first of them at `where`. Raises InputError."""
        self.lines += max(lines, characters // CHARACTERS)
        if self.lines > MOST_UNUSED + PER_RECORD * self.records:
            text = f"{where}: {self.lines:,} lines have {self.records:,} usable records: not a log, or cut it to the drive's time"
            raise InputError(f"{self.path}: {text}")


def line_blocks(path: Path, progress: Progress | None = None) -> Iterator[tuple[int, list[str]]]:
    """Number of the first line, from 1, and lines of consecutive pieces of a file, too long ones cut.

    progress: of the file, to which they are added. Raises InputError.
    """
    encoding = encoding_of(head_bytes(path))
    number, rest = 1, ""
    with input_errors(path), path.open(encoding=encoding, errors="replace") as file:
        while block := file.read(_BLOCK):
            *lines, rest = (rest + block).split("\n")
            ended = len(rest) > LONGEST_LINE
            if ended and len(rest := rest.rstrip("\0")) > LONGEST_LINE:
                raise InputError(
                    f"{path}: line {number + len(lines)} has more than {LONGEST_LINE:,} characters: not a log"
                )
            if progress is not None:
                progress.add(f"line {number}", len(lines), len(block))
            if lines:
                yield number, lines
                number += len(lines)
            if ended:  # by the space that was reserved for a log
                break
    if rest:
        yield number, [rest]


def split_line(line: str, delimiter: str | None, most: int = -1) -> list[str]:
    """The values of a line; delimiter None: any white space. Quotes hold values with a delimiter, but not line breaks.

    most: of the values that are needed; what follows them may be one.
    """
    if delimiter is None or '"' not in line:
        return line[:MAX_LINE].split(delimiter, most)
    try:
        return next(csv.reader([line[:MAX_LINE]], delimiter=delimiter), [])
    except csv.Error:
        return []


def floats(words: Sequence[str], *, comma: bool = False) -> Floats:
    """Numbers (N,), NaN in place of anything else. comma: decimals are after a comma."""
    if comma:
        words = [word.replace(",", ".") for word in words]
    with suppress(ValueError):
        return np.fromiter(map(float, words), np.float64, len(words))
    return np.array([_float(word) for word in words], dtype=np.float64)


def _float(word: str) -> float:
    try:
        return float(word)
    except ValueError:
        return np.nan
