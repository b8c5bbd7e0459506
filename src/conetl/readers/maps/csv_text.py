"""The cells of a CSV file as columns of text, as spreadsheets and programs write them."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator
from contextlib import suppress
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any, TextIO

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as pv

from conetl.files.documents import encoding_of, library_errors
from conetl.model.errors import InputError

#: Most values (rows times columns) of a map, as they are in memory.
MAX_VALUES = 50_000_000
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
            raw.seek(0)
            is_plain = not any(b'"' in block or b"\0" in block for block in iter(partial(raw.read, _MAX_LINE), b""))
        with path.open(encoding=encoding, newline="") as file:
            texts = _short_lines(path, file)
            header = next(texts, "")
            has_mark = header.lower().startswith("sep=")  # of Excel
            header = next(texts, "") if has_mark else header
            delimiter = max(",;\t", key=header.count)
            rows = csv.reader(chain([header], texts), strict=True, delimiter=delimiter)
            names = next(rows, [])
            if len(names) > _MOST_COLUMNS:
                raise InputError(
                    f"{path} has {len(names):,} columns, expected at most {_MOST_COLUMNS:,}: leave out columns"
                )
            schema = pa.schema([(text.strip().lower(), pa.string()) for text in names])
            most = min(most_rows, MAX_VALUES // max(1, len(names)))
            table = _by_arrow(path, encoding, delimiter, 1 + has_mark, schema, most) if is_plain and names else None
            table = _by_python(path, rows, schema, most) if table is None else table
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


def _by_arrow(path: Path, encoding: str, delimiter: str, skipped: int, schema: pa.Schema, most: int) -> pa.Table | None:
    """The rows of a file without quotes in a tenth of the time of Python; None where one of them is wrong, or there is none."""
    names = [str(number) for number in range(len(schema))]
    batches: list[pa.RecordBatch] = []
    rows = 0
    with suppress(pa.ArrowInvalid):
        found = pv.open_csv(
            path,
            pv.ReadOptions(
                use_threads=False,
                skip_rows=skipped,
                column_names=names,
                encoding={"utf-8-sig": "utf8"}.get(encoding, encoding),
            ),
            pv.ParseOptions(delimiter=delimiter, quote_char=False),
            pv.ConvertOptions(column_types=dict.fromkeys(names, pa.string())),
        )
        for batch in found:
            batches.append(_batch(batch.columns, schema))
            rows += batch.num_rows
            if rows > most:
                raise too_many(path, most)
        return pa.Table.from_batches(batches, schema)
    return None


def _by_python(path: Path, rows: Iterable[list[str]], schema: pa.Schema, most: int) -> pa.Table:
    """Raises InputError naming a row with more or fewer values than the header."""
    lines: list[list[str]] = []
    batches: list[pa.RecordBatch] = []
    for number, line in enumerate(rows, start=1):
        if number > most:
            raise too_many(path, most)
        if not line:
            continue
        if len(line) != len(schema):
            raise InputError(f"{path}, row {number}: {len(line)} values where the header has {len(schema)}")
        lines.append(line)
        if len(lines) * len(schema) > _BATCH_CELLS:
            batches.append(_batch(zip(*lines, strict=True), schema))
            lines.clear()
    batches.append(_batch(zip(*lines, strict=True) if lines else ((),) * len(schema), schema))
    return pa.Table.from_batches(batches, schema)


def _batch(columns: Iterable[Any], schema: pa.Schema) -> pa.RecordBatch:
    """Columns of text, None for empty cells."""
    texts = [pc.utf8_trim_whitespace(pa.array(column, pa.string())) for column in columns]
    return pa.record_batch([pc.if_else(pc.equal(column, ""), None, column) for column in texts], schema=schema)


def _with_decimal_points(column: pa.ChunkedArray) -> pa.ChunkedArray:
    """A column of text, its decimal commas as points if it has numbers only."""
    are_numbers = pc.all(pc.match_substring_regex(column, _DECIMAL_COMMA), min_count=0).as_py()
    return pc.replace_substring(column, ",", ".") if are_numbers else column


def too_many(path: Path, most_rows: int) -> InputError:
    return InputError(f"{path} has more than {most_rows:,} rows or {MAX_VALUES:,} values: import it in parts")
