"""timestamps.txt of a KITTI folder while it is being written: each line once, as soon as it ends with a newline."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path


@dataclass
class ArrivingStamps:
    """Lines so far. An hour's drive has 36,000 of them and every pair asks for up to four, so none is read twice."""

    path: Path
    _lines: list[bytes] = field(default_factory=list)
    _offset: int = 0
    _inode: int = 0

    def line(self, number: int) -> str | None:
        """Line `number`, from 0; None where it is not there yet, or not all of it. Only then the file is opened."""
        if number >= len(self._lines):
            self._read_on()
        return self._lines[number].decode("utf-8", errors="replace") if number < len(self._lines) else None

    def _read_on(self) -> None:
        """Take in what was appended; all of it where another file has taken the place, or this one was cut."""
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
