"""The key `trajectory` of drive.yaml: which file, and what the file itself does not say."""

from __future__ import annotations

import datetime
from typing import Literal
from zoneinfo import ZoneInfo

from pydantic import Field, field_validator

from conetl.files.documents import shown
from conetl.model.base import Record

FormatName = Literal["rtklib", "sbet", "inertial_explorer", "nmea", "gpx", "oxts", "euroc", "tum", "table"]


def known_zone(name: str, what: str = "a time zone; expected a name such as UTC or Europe/Berlin") -> str:
    """The same name. Raises ValueError, which says that it is not `what`, where there is no such time zone."""
    try:
        ZoneInfo(name)
    except (KeyError, ValueError, OSError) as error:
        raise ValueError(f"{shown(name)} is not {what}") from error
    return name


class TrajectoryFile(Record):
    """How to read a trajectory file; every key is optional."""

    file: str | None = Field(default=None, min_length=1, max_length=1000)
    """Relative to the drive folder and inside it."""
    format: FormatName | None = None
    columns: dict[str, str | int] = Field(default={}, max_length=50)
    """Tables: name or number (from 1) of the column in the file by our name for it (`tables.ROLES`)."""
    delimiter: str | None = Field(default=None, min_length=1, max_length=1)
    """Tables: comma, semicolon, tab, or a space for any white space."""
    decimal: Literal[".", ","] | None = None
    time: str | None = Field(default=None, max_length=100)
    """utc, gps or the IANA name of a time zone."""
    week: int | None = Field(default=None, ge=0, lt=10_000)
    """GPS week, without rollover, of a file whose times are seconds of a week."""
    date: datetime.date | None = None
    """Day of the first record, where times are seconds of a week or of a day, or have no date."""
    crs: str | None = Field(default=None, min_length=1, max_length=10_000)
    heights: str | None = Field(default=None, min_length=1, max_length=10_000)
    """`ellipsoidal`, a vertical CRS such as EPSG:5773, or the name of a geoid grid (.tif, .gtx)."""
    frame: str | None = Field(default=None, min_length=1, max_length=100)
    """Dynamic frame of the positions at the times of the records, such as ITRF2020 ..."""
    map_frame: str | None = Field(default=None, min_length=1, max_length=100)
    """... and that of the map's coordinates, such as ETRF2000; without both they are taken as the same."""
    angles: Literal["degrees", "radians"] | None = None

    @field_validator("time")
    @classmethod
    def _known_time(cls, value: str | None) -> str | None:
        if value is None or value.lower() in {"utc", "gps"}:
            return value.lower() if value else None
        return known_zone(value, "a time system; expected utc, gps or a zone like Europe/Berlin")

    def scale(self, default: str) -> str:
        """`gps` or the name of a time zone: that of the settings, else the default."""
        return {None: default, "utc": "UTC"}.get(self.time, self.time or default)
