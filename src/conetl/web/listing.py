"""Answers with many point objects and lane markings."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fastapi import Response
from pydantic import BaseModel

from conetl.db.connection import Connection
from conetl.db.serve_store import read_listing
from conetl.model.base import Vec3


def listing(
    conn: Connection, sql: str, models: Mapping[str, type[BaseModel]], origin: Vec3, *, head: str, **parameters: Any
) -> Response:
    """Point objects and lane markings, by the names and models of their lists. PostgreSQL writes the JSON: it is twice as fast.

    sql: a statement with a column `marking`; head: other members of the answer, each with a comma.
    """
    fields = [tuple(model.model_fields) for model in models.values()]
    lists = read_listing(conn, sql, fields, origin_m=list(origin), **parameters)
    body = [f'"{name}":[{found or ""}]' for name, found in zip(models, lists, strict=True)]
    return Response(",".join([f'{{{head}"origin_m":{list(origin)}', *body]) + "}", media_type="application/json")
