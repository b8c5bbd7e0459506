"""Rows of a query as Arrow record batches, by COPY in CSV: psycopg2 would make a Python object of every value."""

from __future__ import annotations

from collections.abc import Generator, Mapping
from tempfile import TemporaryFile
from typing import Any

import pyarrow as pa
from pyarrow import csv

from conetl.db.connection import Connection, copy_out, query_columns

_BLOCK_BYTES = 8 << 20
#: By the OIDs of PostgreSQL's types bool, int8, int4, text, float8, timestamptz and uuid.
_TYPES = {
    16: pa.bool_(), 20: pa.int64(), 23: pa.int32(), 25: pa.string(), 701: pa.float64(), 1184: pa.timestamp("us", tz="UTC"),
    2950: pa.string(),
}  # fmt: skip


def schema_of(conn: Connection, sql: str, parameters: Mapping[str, Any]) -> pa.Schema:
    """Names and types of the columns of a query (without its final semicolon), without running it."""
    return pa.schema([(name, _TYPES[oid]) for name, oid in query_columns(conn, sql, parameters)])


def batches_of(
    conn: Connection, sql: str, parameters: Mapping[str, Any], schema: pa.Schema
) -> Generator[pa.RecordBatch]:
    """Rows of a query (without its final semicolon) with the columns of `schema`, buffered in a temporary file."""
    values = csv.ConvertOptions(
        column_types=schema, null_values=[""], strings_can_be_null=True, quoted_strings_can_be_null=False,
        true_values=["t"], false_values=["f"],
    )  # fmt: skip
    with TemporaryFile() as rows:
        if not copy_out(conn, f"select {', '.join(schema.names)} from ({sql}) q", parameters, rows, "(format csv)"):
            return
        rows.seek(0)
        options = csv.ReadOptions(column_names=schema.names, block_size=_BLOCK_BYTES)
        with csv.open_csv(rows, options, convert_options=values) as blocks:
            yield from blocks
