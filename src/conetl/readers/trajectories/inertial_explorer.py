"""Text exports of NovAtel (Waypoint) Inertial Explorer and GrafNav: lines about the project, names of columns, units, records.

      GPSTime  Week    Latitude   Longitude     H-Ell      Roll     Pitch   Heading  SDNorth   SDEast SDHeight ...
        (sec) (weeks)  (+/-D M S)  (+/-D M S)      (m)     (deg)     (deg)     (deg)      (m)      (m)      (m) ...

Columns and units are those of an export profile that the user may change, so they are taken from these two lines. Angles: heading
clockwise from true north, pitch with the front up, roll with the right side down (Waypoint Software user manual, export wizard).
"""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path
from typing import Literal

from conetl.model.errors import InputError
from conetl.readers.trajectories.delimited import column_of, role_of
from conetl.readers.trajectories.recorded import Reading
from conetl.readers.trajectories.settings import TrajectoryFile
from conetl.readers.trajectories.tables import Column, TableLayout, require, table_records
from conetl.readers.trajectories.text import head_lines

_DMS = re.compile(r"\(\s*(?:\+/-\s*)?(?:d\s*m\s*s|deg\s+min\s+sec|dms)\s*\)", re.IGNORECASE)
_MAKERS = ("inertial explorer", "grafnav", "waypoint")


def header_of(lines: list[str]) -> int | None:
    """Index of the line with the names of the columns, None without one."""
    for i, (line, units) in enumerate(pairwise(lines)):
        found = {role_of(word) for word in line.split()} if "(" in units else set()
        if "time" in found and ({"lat", "lon"} <= found or {"easting", "northing"} <= found):
            return i
    return None


def looks_like(lines: list[str]) -> bool:
    """Whether the first lines of a file are those of an export."""
    return header_of(lines) is not None or any(maker in line.lower() for maker in _MAKERS for line in lines[:5])


def read(path: Path, settings: TrajectoryFile) -> Reading:
    """The records of an export. Raises InputError."""
    lines = head_lines(path)
    at = header_of(lines)
    if at is None:
        raise InputError(
            f"{path}: expected a line with the names of the columns (GPSTime, Week, Latitude, Longitude, H-Ell, ...) and one "
            "with their units; export with a profile that writes both"
        )
    names, units = lines[at].split(), re.findall(r"\([^()]*\)", lines[at + 1])
    if len(names) != len(units):
        raise InputError(f"{path}, line {at + 2}: there are {len(names)} columns, but {len(units)} units")
    delimiter = "," if "," in next((line for line in lines[at + 2 :] if line.strip()), "") else None
    columns, order = _columns(path, names, units, settings)
    axes, heights = require(columns, path, names)
    scale = "UTC" if columns["time"].name.lower() == "utctime" else "gps"
    layout = TableLayout(columns, axes, at + 3, delimiter, scale=scale, order=order)
    return Reading(table_records(path, layout, settings), axes, heights)


def _columns(
    path: Path, names: list[str], units: list[str], settings: TrajectoryFile
) -> tuple[dict[str, Column], Literal["dmy", "mdy"] | None]:
    """Columns by our name, the first of each, and the order of the date. Raises InputError for an unknown unit."""
    columns: dict[str, Column] = {}
    order: Literal["dmy", "mdy"] | None = None
    at = 0
    for name, unit in zip(names, units, strict=True):
        role, dms = role_of(name), _DMS.fullmatch(unit) is not None
        if role is not None and role not in columns:
            word = unit.strip("() ").lower()
            column = Column(at, name, dms=True)
            columns[role] = column if dms else column_of(path, role, at, name, word, settings, required=True)
        if role == "date":
            order = "dmy" if "dmy" in unit.lower() else "mdy" if "mdy" in unit.lower() else order
        at += 3 if dms else 1
    if "week" in columns:
        columns.pop("date", None)
    return columns, order
