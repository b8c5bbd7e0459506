"""Text with columns, of any program: which line names them, how values are separated, what each column is.

The names may be separated in another way than the values (POSPac), have their units in brackets apart (TerraPos) or in a line of
their own (Inertial Explorer); columns are what `columns.py` knows and the first values do not contradict. drive.yaml
(`trajectory: columns`) names what is not recognised. Without a unit, angles are degrees (or what `angles` says), lengths metres.
Angles of Inertial Explorer and POSPac: heading clockwise from true north, pitch with the front up, roll with the right side down.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from datetime import date
from functools import partial
from pathlib import Path

import numpy as np

from conetl.files.documents import input_errors, shown
from conetl.model.errors import InputError
from conetl.readers.trajectories.columns import (
    MOST_COLUMNS,
    Header,
    columns_of,
    is_course,
    order_of_dates,
    sides_of,
    values_of,
)
from conetl.readers.trajectories.earth import is_geocentric, unstated_heights
from conetl.readers.trajectories.names import aligned, is_unit, is_zone, require_unit, role_of, scale_of
from conetl.readers.trajectories.recorded import Reading
from conetl.readers.trajectories.settings import FormatName, TrajectoryFile
from conetl.readers.trajectories.tables import POSITIONS, Adjust, Column, TableLayout, require, table_records
from conetl.readers.trajectories.text import Progress, floats, head_lines, split_line

#: A header is among these lines, and has at most so many characters; it is compared with so many records.
_HEADER_LINES, _LONGEST_HEADER, _COMPARED = 200, 5000, 20
_MARKS = (",", ";", "\t", None)
#: Names that white space separates, with units in brackets of their own.
_NAMES = re.compile(r"\"[^\"]*\"|[^\s(\[]\S*(?:\s*[\[(][^\[\]()]*[\])])*")
_UNITS = re.compile(r"\([^()]*\)|\[[^\[\]]*\]")
_MAKERS = ("inertial explorer", "grafnav", "waypoint")
_DATED = re.compile(r"(?:date|day|datum|mission|start).*?\b(\d{4})[-/](\d\d?)[-/](\d\d?)\b", re.IGNORECASE | re.ASCII)
_IN_WORDS = re.compile(r"\bin (feet|foot|ft|radians?|gons?|grads?)\b", re.IGNORECASE)
#: Distance of the earth's surface from its centre.
_EARTH_M, _EARTH_OFF_M = 6.367e6, 3e4
#: Of conetl's own trajectory.csv.
_OWN_NAMES = frozenset({"captured_at", "yaw_deg"})


def read(path: Path, settings: TrajectoryFile, *, kind: FormatName = "table", adjust: Adjust | None = None) -> Reading:
    """The records of a table. Raises InputError that names its columns where they are not understood.

    kind: whose names and units the columns have; adjust: as of `table_records`.
    """
    lines = head_lines(path)
    header = header_of(lines, settings)
    if header is None:
        raise InputError(
            f"{path}: there is no line with the names of the columns; write one, or number the columns in drive.yaml, for "
            "example trajectory: {columns: {time: 1, lat: 2, lon: 3, height: 4}}"
        )
    notes: list[str] = []
    if (day := _stated_day(lines[: header.line + 1], header, settings)) is not None:
        settings = settings.model_copy(update={"date": day})
        notes.append(f"{path}: the date of its times of a week is that of its heading, {day}")
    between = " ".join(lines[header.line + 1 : header.first])[:_LONGEST_HEADER]
    if (match := _IN_WORDS.search(between)) is not None and settings.angles is None:
        raise InputError(f"{path}: the unit {match[1].lower()} is not supported; write degrees and metres")
    layout = _layout(path, header, settings, kind, notes)
    if layout.heights == "unstated" and settings.heights is None and settings.crs is None:
        notes.append(unstated_heights(path))
    angle = layout.columns.get("heading", layout.columns.get("yaw"))
    unitless = (
        angle.name if angle is not None and angle.unit is None and settings.angles is None and not angle.dms else None
    )
    yaw = layout.columns["yaw"].name if "yaw" in layout.columns and "heading" not in layout.columns else None
    stated = "yaw" in settings.columns or set(header.names) >= _OWN_NAMES
    relayout = None if settings.columns else partial(_next_layout, path, settings, layout, kind)
    progress = Progress(path)
    records = table_records(path, layout, settings, progress, adjust, relayout)
    return Reading(records, layout.axes, layout.heights, yaw, stated, notes, progress, unitless)


def kind_of(lines: list[str]) -> FormatName | None:
    """The format of text whose first lines name a time and a position, None for other text."""
    header = header_of(lines, TrajectoryFile())
    if any(maker in line.lower() for maker in _MAKERS for line in lines[:5]) or (
        header is not None and header.is_complete and header.units and "GPSTime" in header.names
    ):
        return "inertial_explorer"
    return "table" if header is not None and header.is_complete else None


def _next_layout(
    path: Path, settings: TrajectoryFile, layout: TableLayout, kind: FormatName, lines: list[str], number: int
) -> TableLayout | None:
    """The layout of records below another line with names, None where the line, of this number, is not one."""
    header = header_of(lines, settings, most_lines=1)
    if header is None or not header.is_complete or header.spare not in {0, 1}:
        return None
    found = _layout(path, header, settings, kind, [])._replace(first_line=number + header.first)
    if found.axes != layout.axes or found.heights != layout.heights:
        raise InputError(
            f"{path}: line {number} names other coordinates than the first columns: read the parts on their own"
        )
    return found


# --------------------------------------------------------------------------- the header


def header_of(lines: list[str], settings: TrajectoryFile, most_lines: int = _HEADER_LINES) -> Header | None:
    """The line that explains the file best, None where no line can be a header."""
    if settings.columns and all(isinstance(name, int) for name in settings.columns.values()):
        return _without_header(lines, settings)
    best: Header | None = None
    for i, whole in enumerate(lines[:most_lines]):
        line = whole[:_LONGEST_HEADER]
        text = line.lstrip("#% \t\ufeff") if line.startswith(("#", "%", "\ufeff")) else line
        for found in _headers(text, i, lines, settings):
            best = found if best is None or found.fit > best.fit else best
        if best is not None and best.fit[:2] == (True, True):
            break  # another line with names is of records below it
    return best


def _headers(line: str, i: int, lines: list[str], settings: TrajectoryFile) -> Iterator[Header]:
    """The ways to read a line, of this index, as names of columns."""
    splits: list[tuple[str | None, list[str]]] = [(mark, split_line(line.strip("\r\n"), mark)) for mark in ",;\t"]
    splits += [(None, re.split(r"\s{2,}|\t", line.strip())), (None, _NAMES.findall(line))]
    for own_mark, cells in splits:
        names = [name.strip().strip('"') for name in cells]
        if not 3 <= len(names) <= MOST_COLUMNS or sum(any(map(str.isalpha, name)) for name in names) < len(names) / 2:
            continue
        stated = {role: name for role, name in settings.columns.items() if isinstance(name, int) or name in names}
        roles = {role_of(name) for name in names} | stated.keys()
        units, first = _units_below(line, names, own_mark, lines, i)
        marks = [own_mark, *(mark for mark in _MARKS if mark != own_mark)]
        if settings.delimiter is not None:
            marks = [None if settings.delimiter == " " else settings.delimiter]
        for mark in marks:
            first_record, rows = _first_records(lines, first, mark)
            if rows or mark == own_mark or len(marks) == 1:
                known = frozenset(role for role in roles if role is not None)
                yield Header(i, names, units, mark, first_record, rows, known)


def _units_below(line: str, names: list[str], mark: str | None, lines: list[str], i: int) -> tuple[list[str], int]:
    """Units of the columns in the line below their names, none without such a line; and the index of the line after them."""
    below = lines[i + 1].lstrip("#%")[:_LONGEST_HEADER] if i + 1 < len(lines) else ""
    cells = [cell.strip() for cell in split_line(below, mark)] if mark else []
    if cells and len(cells) == len(names) and any(cells) and all(is_unit(cell) for cell in cells):
        return cells, i + 2
    found = [*_UNITS.finditer(below)]
    if len(found) < 2 or _UNITS.sub("", below).strip(" \t,;") or not len(found) <= len(names):
        return [], i + 1
    offset = len(lines[i]) - len(line)  # of the marks of a comment
    at, starts = 0, []
    for name in names:
        at = max(line.find(name, at), at)
        starts.append((name, at + offset + len(name) / 2))
        at += len(name)
    return aligned(starts, [(match[0], (match.start() + match.end()) / 2) for match in found]), i + 2


def _first_records(lines: list[str], first: int, mark: str | None) -> tuple[int, list[list[str]]]:
    """Index of the first line from `first` on that is a record, and the first records."""
    start = first
    rows: list[list[str]] = []
    for i, line in enumerate(lines[first : first + 3 * _COMPARED], first):
        if not line.strip() or line.startswith(("#", "%")):
            if rows and line.strip():
                break  # names of other columns may follow
            continue
        cells = split_line(line.strip("\r \0" if mark else "\t\r \0"), mark)
        if len(cells) > 2 and sum(any(c.isdigit() for c in cell) for cell in cells) > 0.3 * len(cells):
            start = start if rows else i
            rows.append(cells)
        elif rows:
            break
        if len(rows) == _COMPARED:
            break
    return start, rows


def _without_header(lines: list[str], settings: TrajectoryFile) -> Header:
    """A table whose columns are numbered."""
    needed = max(int(at) for at in settings.columns.values())
    first = next((line for line in lines if line.strip() and not line.startswith(("#", "%"))), "")
    stated = None if settings.delimiter == " " else settings.delimiter
    marks = _MARKS if settings.delimiter is None else (stated,)
    mark = next((mark for mark in marks if len(split_line(first, mark)) >= needed), marks[0])
    return Header(-1, [], [], mark, *_first_records(lines, 0, mark), frozenset(settings.columns))._replace(first=0)


def _stated_day(lines: list[str], header: Header, settings: TrajectoryFile) -> date | None:
    """The only date that lines above the header state, where the times need one and are of its day of the week."""
    if settings.date or settings.week or {"week", "date"} & header.roles:
        return None
    days = {match.groups() for line in lines[:_HEADER_LINES] if (match := _DATED.search(line[:_LONGEST_HEADER]))}
    at = next((k for k, name in enumerate(header.names) if role_of(name) == "time"), None)
    if len(days) != 1 or at is None or not header.rows or len(header.rows[0]) <= at:
        return None
    seconds = float(floats([header.rows[0][at]])[0])
    try:
        day = date(*map(int, days.pop()))
    except ValueError:
        return None
    return day if 0 <= seconds < 604_800 and int(seconds // 86_400) == (day.weekday() + 1) % 7 else None


# --------------------------------------------------------------------------- the columns


def _scale(path: Path, columns: dict[str, Column], header: Header) -> str:
    """The time scale that the names of time and date state, or a column beside them. Raises InputError for AM and PM."""
    for at in range(min(map(len, header.rows), default=0)):
        if {row[at].strip().upper() for row in header.rows} <= {"AM", "PM"}:
            raise InputError(f"{path}: a column has AM and PM: write the times with hours from 0 to 23")
    named = [scale_of(columns[role].name) for role in ("time", "date") if role in columns]
    return next(filter(None, named), "local" if any(map(is_zone, header.names)) else "")


def _is_on_earth(columns: dict[str, Column], rows: list[list[str]]) -> bool:
    """Whether x, y, z of most of the first records are geocentric coordinates of the earth's surface."""
    at = [columns[name].at for name in "xyz"]
    xyz = floats([word for row in rows if len(row) > max(at) for word in map(row.__getitem__, at)]).reshape(-1, 3)
    far_m = np.linalg.norm(xyz * columns["x"].factor, axis=1)
    return bool(2 * np.count_nonzero(np.abs(far_m - _EARTH_M) < _EARTH_OFF_M) > len(far_m))


def _layout(path: Path, header: Header, settings: TrajectoryFile, kind: FormatName, notes: list[str]) -> TableLayout:
    """Where the columns of a header are. Raises InputError where they are not understood."""
    rows = header.rows
    columns = columns_of(path, header, settings, kind)
    axes, heights = require(columns, path, header.names)
    if axes == "local" and (settings.crs is not None or _is_on_earth(columns, rows)):
        axes = "geocentric" if settings.crs is None or is_geocentric(settings) else "projected"
        if axes == "projected":
            columns |= dict(zip(POSITIONS[axes], (columns.pop(name) for name in "xyz"), strict=True))
    system = " ".join(values_of(rows, columns.pop("height_system", None))).lower()
    if heights == "ellipsoidal" and re.search("msl|sea|geoid", system):
        heights = "unstated"  # above the sea by no geoid that has a name
    if axes == "geodetic":
        columns |= sides_of(columns, header)
    comma = settings.decimal == "," or (
        settings.decimal is None
        and header.delimiter != ","
        and any("," in value for value in values_of(rows, columns[POSITIONS[axes][0]]))
    )
    for role in ("sigma_horizontal", "sigma_u"):
        values = floats(values_of(rows, columns.get(role)), comma=comma)
        if len(values):
            require_unit(path, role, columns[role], values[np.isfinite(values)].tolist())
    if is_course(columns, rows) and "heading" not in settings.columns:
        name = columns.pop("heading").name
        notes.append(
            f"{path}: column {shown(name)} has whole degrees, as a course over ground; it is not used as attitude"
        )
    scale = _scale(path, columns, header)
    if kind == "inertial_explorer" and scale in {"", "?"}:
        scale = "gps"
    with input_errors(path):
        order = order_of_dates(columns, header, settings)
    return TableLayout(columns, axes, header.first + 1, header.delimiter, comma, scale, None, order, heights)
