"""trajectory.csv of a plain folder while it is being written: rows so far, each line once it ends with a newline."""

from __future__ import annotations

import csv
from dataclasses import dataclass, field
from pathlib import Path

from pydantic import ValidationError

from conetl.model.errors import DriveFolderError
from conetl.readers.drives.plain import Row


@dataclass
class ArrivingRows:
    """Rows by stem (a sentence where one is wrong) and their numbers from 0."""

    path: Path
    by_stem: dict[str, Row | str] = field(default_factory=dict)
    numbers: dict[str, int] = field(default_factory=dict)
    bad_count: int = 0
    """Rows that name no stem."""
    _offset: int = 0
    _header: list[str] | None = None
    _next: int = 0

    def read_on(self) -> None:
        """Take in what was appended since the last time. Raises DriveFolderError where the columns do not fit."""
        try:
            with self.path.open("rb") as file:
                file.seek(self._offset)
                data = file.read()
        except FileNotFoundError:
            return
        end = data.rfind(b"\n") + 1
        self._offset += end
        for values in csv.reader(data[:end].decode("utf-8-sig", errors="replace").splitlines()):
            if self._header is None:
                self._take_header(values)
            elif values:
                self._take(values, self._header)

    def _take_header(self, values: list[str]) -> None:
        wanted = set(Row.model_fields)
        if set(values) != wanted:
            raise DriveFolderError(
                f"{self.path}: the columns do not fit: expected {', '.join(Row.model_fields)}, found {', '.join(values)}"
            )
        self._header = values

    def _take(self, values: list[str], header: list[str]) -> None:
        number, self._next = self._next, self._next + 1
        named = dict(zip(header, values, strict=False))
        stem = named.get("stem", "")
        if not stem:
            self.bad_count += 1
            return
        if stem in self.numbers:
            self.by_stem[stem] = f"{self.path.name}, row {number}: the stem '{stem}' stands in two rows; keep one"
            return
        self.numbers[stem] = number
        try:
            self.by_stem[stem] = Row.model_validate(named)
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(str(part) for part in first["loc"])
            self.by_stem[stem] = f"{self.path.name}, row {number}: {where}: {first['msg']}, found {first['input']!r}"
