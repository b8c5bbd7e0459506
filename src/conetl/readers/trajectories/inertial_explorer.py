"""Text exports of NovAtel (Waypoint) Inertial Explorer and GrafNav: lines about the project, names of columns, units, records.

      GPSTime  Week    Latitude   Longitude     H-Ell      Roll     Pitch   Heading  SDNorth   SDEast SDHeight ...
        (sec) (weeks)  (+/-D M S)  (+/-D M S)      (m)     (deg)     (deg)     (deg)      (m)      (m)      (m) ...

Columns and units are those of an export profile that the user may change, so they are taken from these two lines. Angles: heading
clockwise from true north, pitch with the front up, roll with the right side down (Waypoint Software user manual, export wizard).
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Literal

from conetl.model.errors import DriveFolderError
from conetl.readers.trajectories.recorded import Reading
from conetl.readers.trajectories.settings import TrajectoryFile
from conetl.readers.trajectories.tables import ANGLES, Column, TableLayout, require, table_records
from conetl.readers.trajectories.text import head_lines

_ROLES = {
    "gpstime": "time", "utctime": "time", "correctedtime": "time", "time": "time", "week": "week", "date": "date",
    "gpsdate": "date", "utcdate": "date",
    "latitude": "lat", "longitude": "lon", "h-ell": "height", "h-msl": "height_msl", "easting": "easting", "northing": "northing",
    "roll": "roll", "pitch": "pitch", "heading": "heading", "sdnorth": "sigma_n", "sdeast": "sigma_e", "sdheight": "sigma_u",
    "sd-n": "sigma_n", "sd-e": "sigma_e", "sd-h": "sigma_u", "sd-vert": "sigma_u", "sdvert": "sigma_u",
    "sdhoriz": "sigma_horizontal",
    "rollsd": "sigma_roll", "sdroll": "sigma_roll", "rllsd": "sigma_roll", "pitchsd": "sigma_pitch", "sdpitch": "sigma_pitch",
    "ptchsd": "sigma_pitch", "headingsd": "sigma_heading", "hdngsd": "sigma_heading", "sdheading": "sigma_heading",
}  # fmt: skip
_UNITS = {
    "m": 1.0, "meters": 1.0, "metres": 1.0, "deg": 1.0, "degrees": 1.0, "rad": 57.29577951308232, "radians": 57.29577951308232,
    "arcmin": 1 / 60, "arcsec": 1 / 3600, "asec": 1 / 3600, "amin": 1 / 60, "mm": 1e-3, "cm": 1e-2, "km": 1e3,
}  # fmt: skip
_DMS = re.compile(r"\(\s*(?:\+/-\s*)?(?:d\s*m\s*s|deg\s+min\s+sec|dms)\s*\)", re.IGNORECASE)
_MAKERS = ("inertial explorer", "grafnav", "waypoint")


def header_of(lines: list[str]) -> int | None:
    """Index of the line with the names of the columns, None without one."""
    for i, line in enumerate(lines):
        found = {_ROLES.get(word.lower()) for word in line.split()}
        if "time" in found and (({"lat", "lon"} <= found) or ({"easting", "northing"} <= found)) and i + 1 < len(lines):
            return i if "(" in lines[i + 1] else None
    return None


def looks_like(lines: list[str]) -> bool:
    """Whether the first lines of a file are those of an export."""
    return header_of(lines) is not None or any(maker in line.lower() for maker in _MAKERS for line in lines[:5])


def read(path: Path, settings: TrajectoryFile) -> Reading:
    """The records of an export. Raises DriveFolderError."""
    lines = head_lines(path)
    at = header_of(lines)
    if at is None:
        raise DriveFolderError(
            f"{path}: expected a line with the names of the columns (GPSTime, Week, Latitude, Longitude, H-Ell, ...) and one "
            "with their units; export with a profile that writes both"
        )
    names, units = lines[at].split(), re.findall(r"\([^()]*\)", lines[at + 1])
    if len(names) != len(units):
        raise DriveFolderError(f"{path}, line {at + 2}: there are {len(names)} columns, but {len(units)} units")
    delimiter = "," if "," in next((line for line in lines[at + 2 :] if line.strip()), "") else None
    columns, order = _columns(path, names, units)
    axes, heights = require(columns, path, names)
    scale = "UTC" if columns["time"].name.lower() == "utctime" else "gps"
    layout = TableLayout(columns, axes, at + 3, delimiter, scale=scale, order=order)
    return Reading(table_records(path, layout, settings), axes, heights)


def _columns(path: Path, names: list[str], units: list[str]) -> tuple[dict[str, Column], Literal["dmy", "mdy"] | None]:
    """Columns by our name, the first of each, and the order of the date. Raises DriveFolderError for an unknown unit."""
    columns: dict[str, Column] = {}
    order: Literal["dmy", "mdy"] | None = None
    at = 0
    for name, unit in zip(names, units, strict=True):
        role = _ROLES.get(name.lower())
        dms = _DMS.fullmatch(unit) is not None
        if role is not None and role not in columns:
            columns[role] = _column(path, role, name, unit, at, dms)
        if role == "date":
            order = "dmy" if "dmy" in unit.lower() else "mdy" if "mdy" in unit.lower() else order
        at += 3 if dms else 1
    if "week" in columns:
        columns.pop("date", None)
    return columns, order


def _column(path: Path, role: str, name: str, unit: str, at: int, dms: bool) -> Column:
    word = unit.strip("() ").lower()
    if role in {"time", "week", "date"}:
        return Column(at, name, unit="s" if role == "time" and word in {"sec", "s", "seconds"} else None)
    if dms:
        return Column(at, name, dms=True)
    factor = _UNITS.get(word)
    if factor is None or (word in {"rad", "radians", "deg"} and role not in ANGLES):
        raise DriveFolderError(
            f"{path}: column {name}: the unit {unit[:40]} is unknown; export {'degrees' if role in ANGLES else 'metres'}"
        )
    return Column(at, name, factor)
