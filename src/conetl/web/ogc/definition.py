"""The API definition (OpenAPI) of what is served: tipg's own, without HTML and what is not offered, with filters by property."""

from __future__ import annotations

from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi

from conetl.web.models import Problem
from conetl.web.ogc.collections import CHANGE_COLUMNS, FEATURE_COLUMNS


class Refusal(Problem):
    """Every refusal, with the code that the standard wants."""

    code: str


#: Parameters of tipg that are not offered: expressions may call any function of the database, the others mean nothing for points.
NOT_OFFERED = frozenset({"filter", "filter-lang", "geom-column", "datetime-column", "simplify", "bbox-only", "type"})
_HTML = "text/html"
_ITEMS = ("/collections/{collectionId}/items", "/collections/{collectionId}/tiles/{tileMatrixSetId}/{z}/{x}/{y}")


def define(app: FastAPI) -> dict[str, Any]:
    """Build the definition once and keep it as FastAPI does."""
    if app.openapi_schema is None:
        document = get_openapi(title=app.title, version=app.version, routes=app.routes, description=app.description)
        for path, operations in document["paths"].items():
            operation = operations["get"]
            parameters = [p for p in operation.get("parameters", ()) if p["name"] not in NOT_OFFERED]
            operation["parameters"] = parameters + (_filters(parameters) if path in _ITEMS else [])
            operation["responses"] = {
                status: _without_html(answer) for status, answer in operation["responses"].items() if status != "422"
            }
            operation["responses"] |= _refusals()
        document["components"]["schemas"]["Refusal"] = Refusal.model_json_schema()
        document["components"]["parameters"] = {"limit": _limit(document)}  # where QGIS looks for the size of its pages
        app.openapi_schema = document
    return app.openapi_schema


def _limit(document: dict[str, Any]) -> dict[str, Any]:
    """The parameter as it is: from 1 on, where tipg takes 0 for none given."""
    [limit] = [p for p in document["paths"][_ITEMS[0]]["get"]["parameters"] if p["name"] == "limit"]
    limit["schema"]["minimum"] = 1
    found: dict[str, Any] = limit
    return found


def _filters(parameters: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """One parameter a property; its value is the text of what the property should be."""
    taken = {parameter["name"] for parameter in parameters}
    return [
        {
            "name": name,
            "in": "query",
            "required": False,
            "description": f"Only items with this value: {text}.",
            "schema": {"type": "string"},
        }
        for name, (_, text) in (CHANGE_COLUMNS | FEATURE_COLUMNS).items()
        if name not in taken
    ]


def _without_html(answer: dict[str, Any]) -> dict[str, Any]:
    return answer | {"content": {kind: schema for kind, schema in answer.get("content", {}).items() if kind != _HTML}}


def _refusals() -> dict[str, Any]:
    schema = {"$ref": "#/components/schemas/Refusal"}
    reasons = {
        "400": "A parameter says nothing that can be understood, or does not exist.",
        "404": "There is no such map, collection, item or tile.",
        "503": "The database cannot be reached or is busy, or the question takes too long.",
    }
    return {
        status: {"description": text, "content": {"application/json": {"schema": schema}}}
        for status, text in reasons.items()
    }
