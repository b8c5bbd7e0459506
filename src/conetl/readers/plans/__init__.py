"""Readers of planned work zones: publications and permits as records of `model/planned_zones.py`. They know no database."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from conetl.files.documents import MAX_JSON_BYTES, MAX_TEXT_BYTES, input_errors, read_json, require_size
from conetl.model.errors import InputError
from conetl.model.planned_zones import PlanFile
from conetl.readers.plans.datex2 import read_datex2
from conetl.readers.plans.national_highways import is_planned_works, read_planned_works
from conetl.readers.plans.permits import Permits, read_permits
from conetl.readers.plans.wzdx import is_feed, read_feed

#: By suffix; a JSON file is a WZDx feed or permits.
SUFFIXES = (".xml", ".geojson", ".json", ".gpkg", ".csv")


def read_plans(
    path: Path, *, crs: str | None = None, time_zone: str | None = None, columns: Mapping[str, str] | None = None
) -> PlanFile:
    """All plans of a file, and why each other record is not used. Raises InputError for a file that holds no plans.

    crs, time_zone: of permits that state none; columns: names of their columns, by field of `PlannedZone`.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"{path}: plans are read from {', '.join(SUFFIXES)}, not from {suffix or 'such a file'}")
    require_size(path, MAX_JSON_BYTES if suffix == ".csv" else MAX_TEXT_BYTES)
    document = read_json(path) if suffix in (".geojson", ".json") else None
    with input_errors(path):
        if suffix != ".xml" and not is_feed(document):
            return read_permits(path, document, Permits(crs, time_zone, dict(columns or {})))
        if crs or time_zone or columns:
            raise InputError(
                f"{path}: its format states CRS, times and fields: leave out --crs, --time-zone and --column"
            )
        if suffix == ".xml":
            return read_planned_works(path) if is_planned_works(path) else read_datex2(path)
        return read_feed(path, document)
