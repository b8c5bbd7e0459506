"""The key `trajectory` of drive.yaml: which file, and what the file itself does not say."""

from __future__ import annotations

import datetime
from typing import Any, Literal
from zoneinfo import ZoneInfo

from pydantic import Field, field_validator

from conetl.files.documents import shown
from conetl.model.base import Record

FormatName = Literal["rtklib", "sbet", "inertial_explorer", "nmea", "gpx", "oxts", "euroc", "tum", "table"]


def setting(text: str, example: object, default: object = None, **limits: Any) -> Any:
    """A key of drive.yaml that `conetl init` explains. text: what it means, in one sentence; limits: of pydantic's `Field`."""
    return Field(default=default, description=text, examples=[example], **limits)


def known_zone(name: str, what: str = "a time zone; expected a name such as UTC or Europe/Berlin") -> str:
    """The same name. Raises ValueError, which says that it is not `what`, where there is no such time zone."""
    try:
        ZoneInfo(name)
    except (KeyError, ValueError, OSError) as error:
        raise ValueError(f"{shown(name)} is not {what}") from error
    return name


class TrajectoryFile(Record):
    """How to read a trajectory file; every key is optional."""

    file: str | None = setting(
        "The GNSS/INS log: a file in the drive folder.", "rover.pos", min_length=1, max_length=1000
    )
    format: FormatName | None = None
    """Format of the file, if it is not recognised."""
    columns: dict[str, str | int] = setting(
        "Which columns of a table contain what, by their names or numbers from 1.",
        {"time": "Zeit", "lat": "B", "lon": "L", "height": "H", "roll": "R", "pitch": "P", "heading": "K"},
        default={},
        max_length=50,
    )
    """By conetl's names of them (`tables.ROLES`)."""
    delimiter: str | None = Field(default=None, min_length=1, max_length=1)
    """Tables: comma, semicolon, tab, or a space for any white space."""
    decimal: Literal[".", ","] | None = None
    """Tables: the decimal separator."""
    time: str | None = setting("Time system: utc, gps or a time zone.", "Europe/Berlin", max_length=100)
    week: int | None = Field(default=None, ge=0, lt=10_000)
    """GPS week, without rollover, of a file whose times are seconds of a week."""
    date: datetime.date | None = setting("Day of the first record, if its time states none.", "2026-03-02")
    crs: str | None = setting(
        "Coordinate reference system of the positions.", "EPSG:25832", min_length=1, max_length=10_000
    )
    heights: str | None = setting(
        "Heights: ellipsoidal, a vertical CRS (EPSG:5773: above sea level, EGM96), or a geoid grid (.tif, .gtx).",
        "EPSG:5773",
        min_length=1,
        max_length=10_000,
    )
    frame: str | None = Field(default=None, min_length=1, max_length=100)
    """Dynamic frame of the positions at the times of the records, such as ITRF2020."""
    map_frame: str | None = Field(default=None, min_length=1, max_length=100)
    """Frame of the map's coordinates, such as ETRF2000; without both keys the two are taken as the same."""
    angles: Literal["degrees", "radians"] | None = setting("Unit of angles of which the file states none.", "radians")

    @field_validator("time")
    @classmethod
    def _known_time(cls, value: str | None) -> str | None:
        if value is None or value.lower() in {"utc", "gps"}:
            return value.lower() if value else None
        return known_zone(value, "a time system; expected utc, gps or a zone like Europe/Berlin")

    def scale(self, default: str) -> str:
        """`gps` or the name of a time zone: that of the settings, else the default."""
        return {None: default, "utc": "UTC"}.get(self.time, self.time or default)
