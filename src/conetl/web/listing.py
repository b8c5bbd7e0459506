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
    conn: Connection,
    statement: str,
    models: Mapping[str, type[BaseModel]],
    origin: Vec3,
    *,
    most: int | None = None,
    head: str = "",
    **parameters: Any,
) -> Response:
    """Point objects and lane markings, by the names and models of their lists. PostgreSQL writes the JSON; for a drive of 60,000
    features that takes half of the time.

    most: largest number of rows; the answer says whether there are more. head: other members of the answer, each with a comma.
    """
    fields = [tuple(model.model_fields) for model in models.values()]
    *lists, truncated = read_listing(conn, statement, fields, most=most, origin_m=list(origin), **parameters)
    body = [f'"{name}":[{found or ""}]' for name, found in zip(models, lists, strict=True)]
    start = f'{{{head}"origin_m":{list(origin)},"truncated":{str(truncated).lower()}'
    return Response(",".join([start, *body]) + "}", media_type="application/json")
