"""Lines and numbers of text files that may be large, damaged or hostile."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from conetl.files.documents import input_errors
from conetl.model.arrays import Floats
from conetl.model.errors import InputError

MAX_TEXT_BYTES = 8 << 30
"""20 million records of 400 characters."""
MAX_LINE = 20_000
"""Characters of a line; a longer one is not a record of a trajectory."""
_BLOCK = 4 << 20
_EMPTY_BLOCKS = 8
"""So many pieces of a file without the end of a line are no text: a hole, or an attack."""
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
    return lines[:-1] if len(head) == _HEAD else lines


def line_blocks(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Number of the first line, from 1, and lines of consecutive pieces of a file, too long ones cut. Raises InputError."""
    encoding = encoding_of(head_bytes(path))
    number, rest, empty = 1, "", 0
    with input_errors(path), path.open(encoding=encoding, errors="replace") as file:
        while block := file.read(_BLOCK):
            *lines, rest = (rest + block).split("\n")
            rest = rest[: MAX_LINE + 1]
            empty = 0 if lines else empty + 1
            if empty == _EMPTY_BLOCKS:
                raise InputError(
                    f"{path}: line {number:,} has no end within {_EMPTY_BLOCKS * _BLOCK:,} characters: no text"
                )
            if lines:
                yield number, lines
                number += len(lines)
    if rest:
        yield number, [rest]


def split_line(line: str, delimiter: str | None) -> list[str]:
    """The values of a line; delimiter None: any white space. Quotes hold values with a delimiter, but not line breaks."""
    if delimiter is None:
        return line[:MAX_LINE].split()
    if '"' not in line:
        return line[:MAX_LINE].split(delimiter)
    try:
        return next(csv.reader([line[:MAX_LINE]], delimiter=delimiter), [])
    except csv.Error:
        return []


def floats(words: Sequence[str], *, comma: bool = False) -> Floats:
    """Numbers (N,), NaN in place of anything else. comma: decimals are after a comma."""
    if comma:
        words = [word.replace(",", ".") for word in words]
    return np.array([_float(word) for word in words], dtype=np.float64)


def _float(word: str) -> float:
    try:
        return float(word)
    except ValueError:
        return np.nan
