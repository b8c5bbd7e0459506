"""Is a document a valid WZDx 4.2 feed? By the published JSON schemas, which are shipped; nothing is loaded from the network."""

from __future__ import annotations

import json
from datetime import datetime
from functools import cache
from pathlib import Path
from typing import Any

from jsonschema import Draft7Validator, FormatChecker
from referencing import Registry
from referencing.jsonschema import DRAFT7

_FOLDER = Path(__file__).with_name("wzdx_schemas")
_formats = FormatChecker(formats=("email",))


@_formats.checks("date-time")
def _is_rfc3339(value: object) -> bool:
    """A date and time with an offset; strings only, as everywhere in JSON Schema."""
    if not isinstance(value, str):
        return True
    try:
        return "T" in value and datetime.fromisoformat(value).tzinfo is not None
    except ValueError:
        return False


@cache
def _registry() -> Registry[Any]:
    documents = [json.loads(path.read_text(encoding="utf-8")) for path in sorted(_FOLDER.glob("*/*.json"))]
    return Registry().with_resources([(document["$id"], DRAFT7.create_resource(document)) for document in documents])


def schema_faults(document: dict[str, Any], schema: str) -> list[str]:
    """What is wrong with a feed, [] where nothing is; schema: `WorkZoneFeed` or `DeviceFeed`. Each fault names its place."""
    root = json.loads((_FOLDER / "4.2" / f"{schema}.json").read_text(encoding="utf-8"))
    validator = Draft7Validator(root, registry=_registry(), format_checker=_formats)
    faults = []
    for error in sorted(validator.iter_errors(document), key=lambda one: list(map(str, one.absolute_path))):
        place = "/".join(map(str, error.absolute_path)) or "the document"
        # The branch of an either-or that came nearest says more than "is not valid under any of the given schemas".
        deepest = min(error.context or [error], key=lambda one: -len(one.absolute_path))
        faults.append(f"{place}: {deepest.message[:200]}")
    return faults
