"""truth.csv: surveyed cones of a drive, for evaluation."""

from __future__ import annotations

import csv
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from conetl.model.errors import InputError


class TruthRow(BaseModel):
    """One line of truth.csv; the foot centre on the ground."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    cone_id: str = Field(min_length=1)
    easting_m: float
    northing_m: float
    height_ellipsoidal_m: float
    cone_height_m: float = Field(gt=0)
    map_srid: int
    present: bool
    """False where the cone was taken away since the pass before."""
    change: str
    """added, confirmed, moved or removed, against the pass before."""


def read_truth(path: Path) -> list[TruthRow]:
    """All lines of a truth.csv. Raises InputError naming file, line and field."""
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"truth {path}: cannot be read ({error})") from error
    truth = []
    for number, row in enumerate(rows, 2):
        try:
            truth.append(TruthRow.model_validate(row))
        except ValidationError as error:
            first = error.errors()[0]
            raise InputError(f"truth {path}, line {number}, {first['loc'][0]}: {first['msg']}") from error
    return truth
