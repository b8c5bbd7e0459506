"""The cells of a CSV file as columns of text, as spreadsheets and programs write them."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from functools import partial
from itertools import chain
from pathlib import Path
from typing import TextIO

import pyarrow as pa
import pyarrow.compute as pc

from conetl.files.documents import encoding_of, library_errors
from conetl.model.errors import InputError

#: Most values (rows times columns) of a map, as they are in memory.
MAX_VALUES = 10_000_000
#: Cells that are Python's strings at once.
_BATCH_CELLS = 40_000
#: Characters of a line of a text file: no row of a map is as long.
_MAX_LINE = 1 << 20
#: As many as a table of PostgreSQL has.
_MOST_COLUMNS = 1_600
_DECIMAL_COMMA = r"^[-+]?(?:\d+(?:,\d*)?|,\d+)(?:[eE][-+]?\d+)?$"


def read_csv_text(path: Path, most_rows: int) -> pa.Table:
    """Columns of text by their names in small letters, None in empty cells. Raises InputError naming the row.

    The separator is the most frequent of comma, semicolon and tab in the header; numbers with a decimal comma, where it is not
    the separator, get a point.
    """
    with library_errors(f"{path} cannot be read as CSV", OSError, UnicodeError, csv.Error):
        with path.open("rb") as raw:
            encoding = encoding_of(iter(partial(raw.read, _MAX_LINE), b""))
        with path.open(encoding=encoding, newline="") as file:
            texts = _short_lines(path, file)
            header = next(texts, "")
            header = next(texts, "") if header.lower().startswith("sep=") else header  # of Excel
            delimiter = max(",;\t", key=header.count)
            rows = csv.reader(chain([header], texts), strict=True, delimiter=delimiter)
            names = next(rows, [])
            width = len(names)
            if width > _MOST_COLUMNS:
                raise InputError(f"{path} has {width:,} columns, expected at most {_MOST_COLUMNS:,}: leave out columns")
            schema = pa.schema([(text.strip().lower(), pa.string()) for text in names])
            most, at_once = min(most_rows, MAX_VALUES // max(1, width)), _BATCH_CELLS // max(1, width)
            lines: list[list[str]] = []
            batches: list[pa.RecordBatch] = []
            for number, line in enumerate(rows, start=1):
                if number > most:
                    raise too_many(path, most)
                if not line:
                    continue
                if len(line) != width:
                    raise InputError(f"{path}, row {number}: {len(line)} values where the header has {width}")
                lines.append(line)
                if len(lines) > at_once:
                    batches.append(_batch(lines, schema))
                    lines.clear()
            batches.append(_batch(lines, schema))
    table = pa.Table.from_batches(batches, schema)
    if delimiter == ",":
        return table
    return pa.table([_with_decimal_points(column) for column in table.columns], schema=schema)


def _short_lines(path: Path, file: TextIO) -> Iterator[str]:
    """The lines of a file, one in memory at a time. Raises InputError for one that is too long."""
    for number, line in enumerate(iter(partial(file.readline, _MAX_LINE), ""), start=1):
        if len(line) == _MAX_LINE:
            raise InputError(
                f"{path}: line {number} has more than {_MAX_LINE:,} characters: that is not a table of points"
            )
        yield line


def _batch(lines: list[list[str]], schema: pa.Schema) -> pa.RecordBatch:
    """Rows of a CSV file, None for empty cells."""
    columns = zip(*lines, strict=True) if lines else ((),) * len(schema)
    texts = [pc.utf8_trim_whitespace(pa.array(column, pa.string())) for column in columns]
    return pa.record_batch([pc.if_else(pc.equal(column, ""), None, column) for column in texts], schema=schema)


def _with_decimal_points(column: pa.ChunkedArray) -> pa.ChunkedArray:
    """A column of text, its decimal commas as points if it has numbers only."""
    are_numbers = pc.all(pc.match_substring_regex(column, _DECIMAL_COMMA), min_count=0).as_py()
    return pc.replace_substring(column, ",", ".") if are_numbers else column


def too_many(path: Path, most_rows: int) -> InputError:
    return InputError(f"{path} has more than {most_rows:,} rows or {MAX_VALUES:,} values: import it in parts")
