"""Layout rules of published standards, with the source of each number: `rules/*.yaml`."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from pydantic import BaseModel, ConfigDict

from conetl.files.yaml_model import read_yaml_model
from conetl.model.params import LayoutParams

_FOLDER = Path(__file__).with_name("rules")
STANDARDS = tuple(sorted(path.stem for path in _FOLDER.glob("*.yaml")))
DEFAULT = "mutcd_2023"


class CitedRule(BaseModel):
    """One number of a standard."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    value: float
    source: str
    """Section or table."""
    text: str


class Standard(BaseModel):
    """One standard: its numbers by the names of `LayoutParams`."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    standard: str
    """Name and edition."""
    rules: dict[str, CitedRule]
    not_covered: tuple[str, ...] = ()


@cache
def read_standard(name: str) -> Standard:
    """One of `STANDARDS`."""
    return read_yaml_model(_FOLDER / f"{name}.yaml", Standard, "standard")


def layout_rules(name: str = DEFAULT, own: LayoutParams | None = None) -> LayoutParams:
    """The rules of a standard, with the values of `own` that were set; those have no source but what `own.sources` states."""
    standard = read_standard(name)
    values: dict[str, object] = {key: rule.value for key, rule in standard.rules.items()}
    sources = {key: f"{standard.standard}, {rule.source}" for key, rule in standard.rules.items()}
    if own is not None:
        set_here = own.model_dump(include=own.model_fields_set - {"sources"})
        values |= set_here
        sources = {key: text for key, text in sources.items() if key not in set_here} | own.sources
    return LayoutParams.model_validate(values | {"sources": sources})
