"""GPX tracks (GPX 1.0, 1.1): points of all tracks and segments.

Read with expat, point by point: gpxpy holds the whole document, and knows neither entities that must be refused nor nanoseconds.
`ele` should be above the sea, but many programs write what the receiver gave: with `geoidheight` it is above the geoid; otherwise
`heights` of drive.yaml says what it is, and without that a height has a sigma of at least 100 m.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import NoReturn
from xml.parsers import expat

import numpy as np

from conetl.files.documents import XmlFile, input_errors, library_errors
from conetl.model.errors import InputError
from conetl.readers.trajectories.clocks import TimeFormat, TimeReader, time_reader
from conetl.readers.trajectories.recorded import Reading, Records
from conetl.readers.trajectories.settings import TrajectoryFile
from conetl.readers.trajectories.text import MAX_TEXT_BYTES, Progress, floats, head_bytes

_LONGEST = 100
_VALUES = frozenset({"ele", "time", "geoidheight"})


def read(path: Path, settings: TrajectoryFile) -> Reading:
    """The points of a file, of one that was cut those before. Raises InputError without a point, or with a document type."""
    stated, notes = states_geoid(path), list[str]()
    progress = Progress(path)
    records = _records(path, settings, notes, progress, add_geoid=stated and settings.heights is None)
    return Reading(records, heights="ellipsoidal" if stated else "unstated", notes=notes, progress=progress)


def states_geoid(path: Path) -> bool:
    """Whether the first points have the height of the geoid, so that `ele` is above it."""
    points = _Points()
    with suppress(expat.ExpatError, LookupError, ValueError):
        points.parser.Parse(head_bytes(path), False)
    return bool(np.isfinite(floats([row[3] for row in points.rows])).any())


def cut_note(path: Path) -> str | None:
    """What to say of a file whose end is missing."""
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - 1000))
        return None if b"gpx>" in file.read().lower() else f"{path}: its end is missing; the whole points are used"


_Row = tuple[str, str, str, str, str, int]
"""Latitude, longitude, ele, geoidheight, time, and the line in which the point ends."""


class _Points:
    """Handlers of expat: values of the point that is being read, and the points since the last piece."""

    def __init__(self) -> None:
        self.rows: list[_Row] = []
        self.point: dict[str, str] | None = None
        self.key: str | None = None
        self.inside = self.elements = 0  # elements in the point around the text, and of the file
        self.parser = expat.ParserCreate()
        self.parser.buffer_text = True
        self.parser.StartDoctypeDeclHandler = self.refuse
        self.parser.StartElementHandler = self.start
        self.parser.EndElementHandler = self.end
        self.parser.CharacterDataHandler = self.text

    def refuse(self, *_: object) -> NoReturn:
        raise ValueError("it has a document type (DOCTYPE), which GPX files do not need and which may hide its content")

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        name = tag.rpartition(":")[2]
        self.elements += 1
        if self.point is not None:
            self.inside += 1
            # Elements of extensions may have the same names.
            self.key = name if self.inside == 1 and name in _VALUES and name not in self.point else None
        elif name == "trkpt":
            self.point = {key: attributes.get(key, "")[:_LONGEST] for key in ("lat", "lon")}

    def text(self, text: str) -> None:
        if self.point is not None and self.key is not None:
            self.point[self.key] = (self.point.get(self.key, "") + text)[:_LONGEST]

    def end(self, tag: str) -> None:
        self.key = None
        if self.point is None:
            return
        if self.inside:
            self.inside -= 1
            return
        point, self.point = self.point, None
        lat, lon, ele, geoid, time = (point.get(key, "") for key in ("lat", "lon", "ele", "geoidheight", "time"))
        self.rows.append((lat, lon, ele, geoid, time, self.parser.CurrentLineNumber))


def _records(
    path: Path, settings: TrajectoryFile, notes: list[str], progress: Progress, *, add_geoid: bool
) -> Iterator[Records]:
    points, found = _Points(), False
    read_times = time_reader(TimeFormat(settings.scale("UTC"), "stamp"))
    not_gpx = library_errors(f"{path}: this is not GPX", expat.ExpatError, LookupError)
    with not_gpx, input_errors(path), XmlFile(path, MAX_TEXT_BYTES) as file:
        try:
            while block := file.read():
                before = points.elements
                points.parser.Parse(block, False)
                progress.add(f"line {points.parser.CurrentLineNumber}", points.elements - before, len(block))
                if points.rows:
                    found = True
                    yield _piece(points.rows, read_times, add_geoid)
                    points.rows = []
            points.parser.Parse(b"", True)
        except expat.ExpatError as error:
            if not found and not points.rows:
                raise
            notes.append(f"{path}: ends or is damaged in line {error.lineno}; the whole points before it are used")
    if not points.rows and not found:
        raise InputError(f"{path}: there is no point of a track (trkpt): export the track, not waypoints or a route")
    if points.rows:
        yield _piece(points.rows, read_times, add_geoid)


def _piece(rows: list[_Row], read_times: TimeReader, add_geoid: bool) -> Records:
    """Points as records. add_geoid: `ele` is above the geoid, whose height the points have."""
    *numbers, texts, lines = zip(*rows, strict=True)
    lat, lon, ele, geoid = map(floats, numbers)
    times, wrong = read_times(texts, None)
    height = ele + (geoid if add_geoid else 0.0)
    names = (f"the point that ends in line {line}" for line in lines)
    return Records(times, np.column_stack([lat, lon, height]), None, np.full((len(rows), 6), np.nan), wrong, names)
