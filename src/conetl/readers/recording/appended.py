"""Text files that a recorder appends to: each line counts once it ends with a newline, and is read once."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path

from conetl.readers.drives.plain import Rows


@dataclass
class ArrivingRows:
    """trajectory.csv of a plain folder: its rows so far."""

    rows: Rows
    _offset: int = 0

    def read_on(self) -> None:
        """Read what was appended. Raises DriveFolderError where the columns are wrong."""
        try:
            with self.rows.path.open("rb") as file:
                file.seek(self._offset)
                data = file.read()
        except FileNotFoundError:
            return
        end = data.rfind(b"\n") + 1
        if end:
            self._offset += end
            self.rows.add(data[:end].decode("utf-8-sig", errors="replace"))


@dataclass
class ArrivingStamps:
    """timestamps.txt of a KITTI folder: its lines so far (36,000 of an hour's drive, and each pair requires up to four)."""

    path: Path
    _lines: list[bytes] = field(default_factory=list)
    _offset: int = 0
    _inode: int = 0

    def line(self, number: int) -> str | None:
        """Line `number`, from 0; None where it is not complete yet. Only then the file is opened."""
        if number >= len(self._lines):
            self._read_on()
        return self._lines[number].decode("utf-8", errors="replace") if number < len(self._lines) else None

    def _read_on(self) -> None:
        """Read what was appended, or the whole file if it was replaced or truncated."""
        try:
            with self.path.open("rb") as file:
                found = os.fstat(file.fileno())
                if found.st_ino != self._inode or found.st_size < self._offset:
                    self._lines, self._offset, self._inode = [], 0, found.st_ino
                file.seek(self._offset)
                *whole, rest = file.read().split(b"\n")  # what follows the last newline may be half a line
                self._offset = file.tell() - len(rest)
        except FileNotFoundError:
            return
        self._lines += whole
