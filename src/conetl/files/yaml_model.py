"""YAML files of the user as pydantic models: parameters, rules, the description of a feed."""

from __future__ import annotations

from collections.abc import Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from conetl.files.documents import first_message, read_yaml
from conetl.model.errors import InputError

Model = TypeVar("Model", bound=BaseModel)


def read_yaml_model(path: Path | None, model: type[Model], what: str) -> Model:
    """The file's values as a model; the model's defaults without a file, or where it is empty.

    what: name of the kind of file in messages. Raises InputError naming the file, the key and what was expected.
    """
    return model() if path is None else validated(read_yaml_mapping(path, what), model, f"{what} {path}")


def read_yaml_mapping(path: Path, what: str, example: str = "") -> dict[str, Any]:
    """Keys and values of a YAML file, none if it is empty. Raises InputError."""
    content = read_yaml(path)
    if content is None:
        return {}
    if not isinstance(content, dict):
        shown = f", for example:{example}" if example else ""
        raise InputError(f"{what} {path}: expected keys and values{shown}")
    return {str(key): value for key, value in content.items()}


def validated(values: Mapping[str, Any], model: type[Model], name: str) -> Model:
    """Values as a model. Raises InputError that starts with `name` and states the wrong value and what was expected."""
    try:
        return model.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        if first["type"] != "extra_forbidden":
            raise InputError(f"{name}: {first_message(error)}") from error
        known = _fields_at(model, first["loc"][:-1])
        near = get_close_matches(str(first["loc"][-1]), known, n=1)
        hint = f"did you mean {near[0]}?" if near else f"known are {', '.join(known)}"
        raise InputError(f"{name}: {first_message(error)}; {hint}") from error


def _fields_at(model: type[BaseModel], path: tuple[int | str, ...]) -> list[str]:
    """Names of the fields of the nested model at `path`."""
    for part in path:
        inner = model.model_fields[str(part)].annotation
        if not (isinstance(inner, type) and issubclass(inner, BaseModel)):
            return []
        model = inner
    return list(model.model_fields)
