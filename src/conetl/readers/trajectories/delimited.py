"""Text with columns, of any program: which line names them, how values are separated, what each column is.

The names may be separated in another way than the values (POSPac), have their units in brackets apart (TerraPos) or in a line of
their own (Inertial Explorer); columns are what `columns.py` knows and the first values do not contradict. drive.yaml
(`trajectory: columns`) names what is not recognised. Without a unit, angles are degrees (or what `angles` says), lengths metres.
Angles of Inertial Explorer and POSPac: heading clockwise from true north, pitch with the front up, roll with the right side down.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from datetime import date
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from conetl.files.documents import input_errors, shown
from conetl.model.errors import InputError
from conetl.readers.trajectories.columns import (
    aligned,
    column_of,
    is_exact,
    is_short_sigma,
    is_unit,
    require_unit,
    role_of,
    scale_of,
    unit_of,
)  # fmt: skip
from conetl.readers.trajectories.earth import is_geocentric
from conetl.readers.trajectories.recorded import Reading
from conetl.readers.trajectories.settings import FormatName, TrajectoryFile
from conetl.readers.trajectories.tables import (
    PARTS,
    POSITIONS,
    QUATERNION,
    ROLES,
    TIMES,
    Adjust,
    Column,
    TableLayout,
    degrees_of,
    require,
    table_records,
)  # fmt: skip
from conetl.readers.trajectories.text import floats, head_lines, refusal, split_line
from conetl.readers.trajectories.times import DateOrder, date_order

#: A header is among these lines, and has at most so many characters and names; its roles are compared with so many records.
_HEADER_LINES, _LONGEST_HEADER, _MOST_COLUMNS, _COMPARED = 200, 5000, 1000, 20
_MARKS = (",", ";", "\t", None)
#: Names that white space separates, with units in brackets of their own.
_NAMES = re.compile(r"\"[^\"]*\"|[^\s(\[]\S*(?:\s*[\[(][^\[\]()]*[\])])*")
_UNITS = re.compile(r"\([^()]*\)|\[[^\[\]]*\]")
_MAKERS = ("inertial explorer", "grafnav", "waypoint")
_DATE = re.compile(r"\d{1,4}([-/.])\d{1,2}\1\d{1,4}|\d{6}|\d{8}", re.ASCII)
_STAMP = re.compile(r"\d[-/.]\d.*\d:\d\d", re.ASCII)
_DATED = re.compile(r"(?:date|day|datum|mission|start).*?\b(\d{4})[-/](\d\d?)[-/](\d\d?)\b", re.IGNORECASE | re.ASCII)
_IN_WORDS = re.compile(r"\bin (feet|foot|ft|radians?|gons?|grads?)\b", re.IGNORECASE)
_OF_RTKLIB = frozenset({"quality", "sdx", "sdy", "sdz", "sdxy", "sdyz", "sdzx"})
#: Of conetl's own trajectory.csv.
_OWN_NAMES = frozenset({"captured_at", "yaw_deg"})
_WITH_UNIT = re.compile(r"(.*\S)\s*[\[(]([^\[\]()]*)[\])]")
_NORTH_SOUTH, _EAST_WEST = frozenset({"N", "S", "NORTH", "SOUTH"}), frozenset({"E", "W", "O", "EAST", "WEST"})
_SIDE_NAME = re.compile(r"lat|lon|dir|hemi|ref|side|\bns\b|\bew\b|n/s|e/w", re.IGNORECASE)


class _Header(NamedTuple):
    """The line that names the columns, and how its values are separated."""

    line: int
    """Index; -1 without a header."""
    names: list[str]
    units: list[str]
    """Of each column; empty where they stand with the names, or are not stated."""
    delimiter: str | None
    """Of the values."""
    first: int
    """Index of the first record."""
    rows: list[list[str]]
    """The first records."""
    roles: frozenset[str]

    @property
    def widths(self) -> list[int]:
        """How many values each column has."""
        units = self.units or [unit_of(name) for name in self.names]
        is_dms = ("d" in unit.lower() and re.search(r"m\s*s|'", unit.lower()) is not None for unit in units)
        return [3 if dms else 1 for dms in is_dms]

    @property
    def spare(self) -> int | None:
        """How many values most records have more than columns, None without a record."""
        lengths = Counter(map(len, self.rows))
        return max(lengths, key=lambda n: lengths[n]) - sum(self.widths) if lengths else None

    @property
    def is_complete(self) -> bool:
        """Whether it names a time and a position."""
        found = {"height" if role == "height_msl" else role for role in self.roles}
        timed = "time" in found or "date" in found
        return timed and any(set(names[:2]) <= found for names in POSITIONS.values())

    @property
    def fit(self) -> tuple[bool, bool, int]:
        """How well it explains the file."""
        return self.is_complete, self.spare in {0, 1}, len(self.roles)


def read(path: Path, settings: TrajectoryFile, *, kind: FormatName = "table", adjust: Adjust | None = None) -> Reading:
    """The records of a table. Raises InputError that names its columns where they are not understood.

    kind: whose names and units the columns have; adjust: as of `table_records`.
    """
    lines = head_lines(path)
    header = header_of(lines, settings)
    if header is None:
        raise refusal(
            path,
            "there is no line with the names of the columns; write one, or number the columns in drive.yaml, for "
            "example trajectory: {columns: {time: 1, lat: 2, lon: 3, height: 4}}",
        )
    notes: list[str] = []
    if (day := _stated_day(lines[: header.line + 1], header, settings)) is not None:
        settings = settings.model_copy(update={"date": day})
        notes.append(f"{path}: the date of its times of a week is that of its heading, {day}")
    between = " ".join(lines[header.line + 1 : header.first])[:_LONGEST_HEADER]
    if (match := _IN_WORDS.search(between)) is not None and settings.angles is None:
        raise refusal(path, f"the unit {match[1].lower()} is not supported; write degrees and metres")
    layout = _layout(path, header, settings, kind, notes)
    yaw = layout.columns["yaw"].name if "yaw" in layout.columns and "heading" not in layout.columns else None
    stated = "yaw" in settings.columns or set(header.names) >= _OWN_NAMES
    relayout = None if settings.columns else partial(_next_layout, path, settings, layout, kind)
    records = table_records(path, layout, settings, adjust, relayout)
    return Reading(records, layout.axes, layout.heights, yaw, stated, notes)


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
        raise refusal(
            path, f"line {number} names other coordinates than the first columns: read the parts on their own"
        )
    return found


# --------------------------------------------------------------------------- the header


def header_of(lines: list[str], settings: TrajectoryFile, most_lines: int = _HEADER_LINES) -> _Header | None:
    """The line that explains the file best, None where no line can be a header."""
    if settings.columns and all(isinstance(name, int) for name in settings.columns.values()):
        return _without_header(lines, settings)
    best: _Header | None = None
    for i, whole in enumerate(lines[:most_lines]):
        line = whole[:_LONGEST_HEADER]
        text = line.lstrip("#% \t\ufeff") if line.startswith(("#", "%", "\ufeff")) else line
        best = max(
            [*([best] if best else []), *_headers(text, i, lines, settings)], key=lambda one: one.fit, default=None
        )
        if best is not None and best.fit[:2] == (True, True):
            break  # another line with names is of records below it
    return best


def _headers(line: str, i: int, lines: list[str], settings: TrajectoryFile) -> Iterator[_Header]:
    """The ways to read a line, of this index, as names of columns."""
    splits: list[tuple[str | None, list[str]]] = [(mark, split_line(line.strip("\r\n"), mark)) for mark in ",;\t"]
    splits += [(None, re.split(r"\s{2,}|\t", line.strip())), (None, _NAMES.findall(line))]
    for own_mark, cells in splits:
        names = [name.strip().strip('"') for name in cells]
        if not 3 <= len(names) <= _MOST_COLUMNS or sum(any(map(str.isalpha, name)) for name in names) < len(names) / 2:
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
                yield _Header(i, names, units, mark, first_record, rows, known)


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


def _without_header(lines: list[str], settings: TrajectoryFile) -> _Header:
    """A table whose columns are numbered."""
    needed = max(int(at) for at in settings.columns.values())
    first = next((line for line in lines if line.strip() and not line.startswith(("#", "%"))), "")
    stated = None if settings.delimiter == " " else settings.delimiter
    marks = _MARKS if settings.delimiter is None else (stated,)
    mark = next((mark for mark in marks if len(split_line(first, mark)) >= needed), marks[0])
    return _Header(-1, [], [], mark, *_first_records(lines, 0, mark), frozenset(settings.columns))._replace(first=0)


def _stated_day(lines: list[str], header: _Header, settings: TrajectoryFile) -> date | None:
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


def _layout(path: Path, header: _Header, settings: TrajectoryFile, kind: FormatName, notes: list[str]) -> TableLayout:
    """Where the columns of a header are. Raises InputError where they are not understood."""
    rows = header.rows
    may_be_two = header.spare == 1 if header.names else header.delimiter is None
    columns = _with_time(_columns(path, header, settings, kind), rows, may_be_two)
    axes, heights = require(columns, path, header.names)
    if axes == "local" and (settings.crs is not None or columns["x"].name.startswith("x-ecef")):
        axes = "geocentric" if settings.crs is None or is_geocentric(settings) else "projected"
        if axes == "projected":
            columns |= dict(zip(POSITIONS[axes], (columns.pop(name) for name in "xyz"), strict=True))
    system = " ".join(_values(rows, columns.pop("height_system", None))).lower()
    if heights == "ellipsoidal" and re.search("msl|sea|geoid", system):
        heights = "unstated"  # above the sea by no geoid that has a name
    if axes == "geodetic":
        columns |= _sides(columns, header)
    comma = settings.decimal == "," or (
        settings.decimal is None
        and header.delimiter != ","
        and any("," in value for value in _values(rows, columns[POSITIONS[axes][0]]))
    )
    for role in ("sigma_horizontal", "sigma_u"):
        values = floats(_values(rows, columns.get(role)), comma=comma)
        if len(values):
            require_unit(path, role, columns[role], values[np.isfinite(values)].tolist())
    if _is_course(columns, rows) and "heading" not in settings.columns:
        name = columns.pop("heading").name
        notes.append(
            f"{path}: column {shown(name)} has whole degrees, as a course over ground; it is not used as attitude"
        )
    scale = scale_of(columns["time"].name)
    if kind == "inertial_explorer":
        scale = "gps" if scale != "UTC" else scale
    with input_errors(path):
        order = _date_order(columns, header, settings)
    return TableLayout(columns, axes, header.first + 1, header.delimiter, comma, scale, None, order, heights)


def _columns(path: Path, header: _Header, settings: TrajectoryFile, kind: FormatName) -> dict[str, Column]:
    """Columns by our name: those of the settings, then those recognised. Raises InputError where two claim one name."""
    columns: dict[str, Column] = {}
    claims: dict[str, list[Column]] = {}
    mapped = _mapped(path, header.names, settings)
    names_short = {re.sub(r"[^a-z]", "", name.lower().split("(")[0]) for name in header.names} >= {"sn", "se"}
    at = 0
    for k, (name, width) in enumerate(zip(header.names, header.widths, strict=True)):
        role, unit = mapped.get(name, (role_of(name), ""))
        unit = unit or (header.units[k] if header.units else unit_of(name))
        is_short = name not in mapped and not names_short and is_short_sigma(name)
        if role is not None and not is_short and not (role in settings.columns and name not in mapped):
            required = kind == "inertial_explorer" and bool(header.units)
            claims.setdefault(role, []).append(column_of(path, role, at, name, unit, settings, required=required))
        at += width
    for role, number in settings.columns.items():
        if isinstance(number, int):
            claims[role] = [column_of(path, role, number - 1, f"column {number}", "", settings)]
    for role, found in claims.items():
        if kind != "rtklib" and role in _OF_RTKLIB:
            continue
        is_day = "year" in claims  # of a time in parts
        chosen = found if len(found) == 1 and (role != "date" or is_day) else _fitting(role, found, header.rows)
        if len(chosen) > 1 and kind != "inertial_explorer":
            raise refusal(
                path,
                f"the columns {shown(chosen[0].name)} and {shown(chosen[1].name)} may both be the {role}; name one in "
                f"drive.yaml, trajectory: {{columns: {{{role}: ...}}}}",
            )
        if chosen:
            columns[role] = chosen[0]
    return columns


def _mapped(path: Path, names: list[str], settings: TrajectoryFile) -> dict[str, tuple[str, str]]:
    """Our name and the unit of columns that drive.yaml names, as `hAcc` or `hAcc [mm]`. Raises InputError."""
    found = {}
    for role, stated in settings.columns.items():
        if role not in ROLES:
            raise InputError(f"drive.yaml: trajectory.columns: {shown(role)} is unknown; known are {', '.join(ROLES)}")
        if isinstance(stated, int):
            if not 1 <= stated <= _MOST_COLUMNS:
                raise InputError(
                    f"drive.yaml: trajectory.columns: {shown(role)}: {stated}: expected a number from 1 to {_MOST_COLUMNS}"
                )
            continue
        name, unit = stated, ""
        if stated not in names and (match := _WITH_UNIT.fullmatch(stated)) is not None:
            name, unit = match.groups()
        if name not in names:
            raise refusal(
                path,
                f"has no column {shown(stated)}, which trajectory.columns names; its columns are {', '.join(names)[:200]}",
            )
        found[name] = role, unit
    return found


def _values(rows: Sequence[list[str]], column: Column | None) -> list[str]:
    """The first values of a column that are not empty."""
    return (
        []
        if column is None
        else [row[column.at].strip() for row in rows if row[column.at : column.at + 1] not in ([], [""])]
    )


def _fitting(role: str, found: list[Column], rows: list[list[str]]) -> list[Column]:
    """Of the columns that claim one name those that may be it, by their names and values; one where they are the same."""
    exact = [column for column in found if is_exact(column.name)]
    found = exact or found
    if rows and (len(found) > 1 or role == "date"):
        fitting = [column for column in found if _may_be(role, _values(rows, column))]
        found = fitting if fitting or role == "date" else found
    if len(found) > 1:
        numbers = [floats(_values(rows, column)) * column.factor for column in found]
        same = all(len(n) == len(numbers[0]) and np.allclose(n, numbers[0], atol=1e-6) for n in numbers)
        found = found[:1] if same and not found[0].dms and len(numbers[0]) else found
    return found


def _may_be(role: str, values: list[str]) -> bool:
    """Whether most of the first values of a column can be what its name says."""
    if role == "date":
        good = [_DATE.match(value) is not None for value in values]
    elif role in TIMES:
        good = [any(map(str.isdigit, value)) for value in values]
    else:
        good = [np.isfinite(degrees_of(v.replace(",", "."), "NS" if role == "lat" else "EW")) for v in values]
        good = [a or bool(np.isfinite(b)) for a, b in zip(good, floats(values, comma=True).tolist(), strict=True)]
    return 2 * sum(good) > len(good)


def _with_time(columns: dict[str, Column], rows: list[list[str]], may_be_two: bool) -> dict[str, Column]:
    """The columns with a time: of a date that has one, of parts, or (may_be_two) of two values under one name."""
    if "time" not in columns and {"year", "month", "date", "hour", "minute", "second"} <= columns.keys():
        return columns | {"time": columns["year"]}
    columns = {role: column for role, column in columns.items() if role not in PARTS}
    if "week" in columns:
        columns.pop("date", None)
    date = columns.get("date")
    if date is not None and all(_STAMP.search(value) for value in _values(rows, date)) and rows:
        if not all(":" in value for value in _values(rows, columns.get("time"))) or "time" not in columns:
            columns["time"] = columns.pop("date")
    elif date is not None and "time" not in columns and may_be_two:
        columns["time"] = columns.pop("date")
    if not may_be_two or "time" not in columns or {"date", "week"} & columns.keys():
        return columns
    time = columns["time"]
    pairs = [row[time.at : time.at + 2] for row in rows if len(row) > time.at + 1]
    dated = [_DATE.fullmatch(a) is not None and ":" in b for a, b in pairs]
    weeks = [re.fullmatch(r"\d{4}", a.strip()) is not None and "." in b for a, b in pairs]
    first = "date" if 2 * sum(dated) > len(pairs) else "week" if 2 * sum(weeks) > len(pairs) else None
    if first is None:
        return columns
    moved = {role: column._replace(at=column.at + (column.at >= time.at)) for role, column in columns.items()}
    return moved | {first: time, "time": moved["time"]._replace(unit="s" if first == "week" else None)}


def _sides(columns: dict[str, Column], header: _Header) -> dict[str, Column]:
    """The columns of the hemispheres: behind the angle, or called so, or both there are, with nothing but their letters."""
    letters: dict[str, list[int]] = {"lat": [], "lon": []}
    for at in range(min(map(len, header.rows), default=0)):
        values = {row[at].strip().upper() for row in header.rows} - {""}
        for role, sides in (("lat", _NORTH_SOUTH), ("lon", _EAST_WEST)):
            if values and values <= sides:
                letters[role].append(at)
    starts = np.cumsum([0, *header.widths[:-1]]).tolist() if header.names else []
    name_at = dict(zip(starts, header.names, strict=True))
    found: dict[str, Column] = {}
    for role, places in letters.items():
        behind = columns[role].at + (3 if columns[role].dms else 1)
        called = [at for at in places if _SIDE_NAME.search(name_at.get(at, ""))]
        near = [at for at in places if at == behind] or called or (places if all(letters.values()) else [])
        if len(near) == 1:
            found[f"{role}_side"] = Column(near[0], name_at.get(near[0], ""))
    return found


def _is_course(columns: dict[str, Column], rows: list[list[str]]) -> bool:
    """Whether a heading is a course over ground: in whole degrees, without roll, pitch and a sigma."""
    values = _values(rows, columns.get("heading"))
    return (
        len(values) > 1
        and columns.keys().isdisjoint({"roll", "pitch", "sigma_heading", *QUATERNION})
        and all(re.fullmatch(r"\d+", value) for value in values)
    )


def _date_order(columns: dict[str, Column], header: _Header, settings: TrajectoryFile) -> DateOrder | None:
    """Of days and months. Raises ValueError where it cannot be known."""
    column = columns.get("date", columns["time"])
    starts = np.cumsum([0, *header.widths[:-1]]).tolist() if header.units else []
    unit = header.units[starts.index(column.at)].lower() if column.at in starts else ""
    if "dmy" in unit or "mdy" in unit:
        return "dmy" if "dmy" in unit else "mdy"
    texts = [] if "year" in columns else _values(header.rows, column)
    return date_order([text for text in texts if "date" in columns or "/" in text], settings.date)
