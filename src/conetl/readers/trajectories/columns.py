"""Which column of a table is what: what drive.yaml names, else what the names say and the first values do not contradict."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from conetl.files.documents import shown
from conetl.model.errors import InputError
from conetl.readers.trajectories.dates import date_order
from conetl.readers.trajectories.names import column_of, is_dms, is_exact, is_short_sigma, role_of, scale_of, unit_of
from conetl.readers.trajectories.settings import FormatName, TrajectoryFile
from conetl.readers.trajectories.tables import PARTS, POSITIONS, QUATERNION, ROLES, TIMES, Column, degrees_of
from conetl.readers.trajectories.text import floats
from conetl.readers.trajectories.times import DateOrder

MOST_COLUMNS = 1000
_DATE = re.compile(r"\d{1,4}([-/.])\d{1,2}\1\d{1,4}|\d{6}|\d{8}", re.ASCII)
_STAMP = re.compile(r"\d[-/.]\d.*\d:\d\d", re.ASCII)
_WITH_UNIT = re.compile(r"(.*\S)\s*[\[(]([^\[\]()]*)[\])]")
_OF_RTKLIB = frozenset({"quality", "sdx", "sdy", "sdz", "sdxy", "sdyz", "sdzx"})
#: Letters and words of the hemispheres of an angle, and how a column of them is called.
_SIDES = (
    ("lat", frozenset({"N", "S", "NORTH", "SOUTH"}), re.compile(r"lat|hemi|\bn.?s\b", re.IGNORECASE)),
    ("lon", frozenset({"E", "W", "O", "EAST", "WEST"}), re.compile(r"lon|lng|hemi|\be.?w\b", re.IGNORECASE)),
)


class Header(NamedTuple):
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
        return [3 if is_dms(unit) else 1 for unit in self.units or map(unit_of, self.names)]

    @property
    def starts(self) -> list[int]:
        """Where the values of each column begin, in a record."""
        return [sum(self.widths[:k]) for k in range(len(self.names))]

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


def columns_of(path: Path, header: Header, settings: TrajectoryFile, kind: FormatName) -> dict[str, Column]:
    """Columns by our name. Raises InputError where two may be one, or the settings name what is not there.

    kind: whose names and units they are.
    """
    claims: dict[str, list[Column]] = {}
    mapped = _mapped(path, header.names, settings)
    are_short = sum(map(is_short_sigma, header.names)) > 2
    for k, (name, at) in enumerate(zip(header.names, header.starts, strict=True)):
        role, unit = mapped.get(name, (role_of(name), ""))
        role = "height_msl" if role == "height" and role_of(name) == "height_msl" else role
        unit = unit or (header.units[k] if header.units else unit_of(name))
        unmapped = name not in mapped and (role in settings.columns or (is_short_sigma(name) and not are_short))
        if role is not None and not unmapped and (kind == "rtklib" or role not in _OF_RTKLIB):
            required = kind == "inertial_explorer" and bool(header.units)
            claims.setdefault(role, []).append(column_of(path, role, at, name, unit, settings, required=required))
    for role, number in settings.columns.items():
        if isinstance(number, int):
            claims[role] = [column_of(path, role, number - 1, f"column {number}", "", settings)]
    columns: dict[str, Column] = {}
    for role, found in claims.items():
        chosen = found if role == "date" and "year" in claims else _fitting(role, found, header.rows)
        if len(chosen) > 1 and kind != "inertial_explorer":
            raise InputError(
                f"{path}: the columns {shown(chosen[0].name)} and {shown(chosen[1].name)} may both be the {role}; name one in "
                f"drive.yaml, trajectory: {{columns: {{{role}: ...}}}}"
            )
        if chosen:
            columns[role] = chosen[0]
    if not values_of(header.rows, columns.get("separation")):
        columns.pop("separation", None)
    may_be_two = header.spare == 1 if header.names else header.delimiter is None
    return _with_time(columns, header.rows, may_be_two)


def _mapped(path: Path, names: list[str], settings: TrajectoryFile) -> dict[str, tuple[str, str]]:
    """Our name and the unit of columns that drive.yaml names, as `hAcc` or `hAcc [mm]`. Raises InputError."""
    found = {}
    for role, stated in settings.columns.items():
        if role not in ROLES or (isinstance(stated, int) and not 1 <= stated <= MOST_COLUMNS):
            problem = f"is unknown; known are {', '.join(ROLES)}" if role not in ROLES else f"is no column {stated}"
            raise InputError(f"drive.yaml: trajectory.columns: {shown(role)} {problem}")
        if isinstance(stated, int):
            continue
        match = None if stated in names else _WITH_UNIT.fullmatch(stated)
        name, unit = match.groups() if match else (stated, "")
        if name not in names:
            raise InputError(
                f"{path}: has no column {shown(stated)}, which trajectory.columns names; its columns are "
                f"{', '.join(names)[:200]}"
            )
        found[name] = role, unit
    return found


def values_of(rows: Sequence[list[str]], column: Column | None) -> list[str]:
    """The first values of a column that are not empty."""
    cells = [] if column is None else [row[column.at].strip() for row in rows if len(row) > column.at]
    return [cell for cell in cells if cell]


def _fitting(role: str, found: list[Column], rows: list[list[str]]) -> list[Column]:
    """Of the columns that claim one name those that may be it, by their names and values; one where they are the same."""
    if len(found) == 1 and role != "date":
        return found
    if role == "time":
        found = [column for column in found if scale_of(column.name) != "local"] or found
        # Of a ROS message: others are when it was received.
        found = [column for column in found if "header" in column.name.lower()] or found
    found = [column for column in found if is_exact(column.name)] or found
    fitting = [column for column in found if not rows or _may_be(role, values_of(rows, column))]
    found = fitting if fitting or role == "date" else found
    numbers = [floats(values_of(rows, column)) * column.factor for column in found]
    same = all(len(n) == len(numbers[0]) > 0 and np.allclose(n, numbers[0], atol=1e-6) for n in numbers)
    return found[:1] if same else found


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
    if "time" not in columns and {"date", *PARTS} - {"nanosecond"} <= columns.keys():
        return columns | {"time": columns["year"]}
    columns = {role: column for role, column in columns.items() if role not in PARTS}
    if "week" in columns:
        columns.pop("date", None)
    dates, times = values_of(rows, columns.get("date")), values_of(rows, columns.get("time"))
    has_time = bool(dates) and all(map(_STAMP.search, dates)) and not (times and all(":" in value for value in times))
    if has_time or ("date" in columns and "time" not in columns and may_be_two):
        columns["time"] = columns.pop("date")
    if not may_be_two or "time" not in columns or {"date", "week"} & columns.keys():
        return columns
    time = columns["time"]
    pairs = [row[time.at : time.at + 2] for row in rows if len(row) > time.at + 1]
    dated = sum(_DATE.fullmatch(a) is not None and ":" in b for a, b in pairs)
    weeks = sum(re.fullmatch(r"\d{4}", a) is not None and "." in b for a, b in pairs)
    if 2 * max(dated, weeks) <= len(pairs):
        return columns
    moved = {role: column._replace(at=column.at + (column.at >= time.at)) for role, column in columns.items()}
    return moved | ({"date": time} if dated > weeks else {"week": time, "time": moved["time"]._replace(unit="s")})


def sides_of(columns: dict[str, Column], header: Header) -> dict[str, Column]:
    """The columns of the hemispheres, with nothing but their letters or words: called so, or each behind its angle."""
    name_at = dict(zip(header.starts, header.names, strict=True))
    called: dict[str, Column] = {}
    behind: dict[str, Column] = {}
    for role, letters, names in _SIDES:
        for at in range(min(map(len, header.rows), default=0)):
            values = {row[at].strip().upper() for row in header.rows} - {""}
            if values and values <= letters:
                if names.search(name_at.get(at, "")):
                    called.setdefault(f"{role}_side", Column(at, name_at[at]))
                if at == columns[role].at + (3 if columns[role].dms else 1):
                    behind[f"{role}_side"] = Column(at, "")
    return called | (behind if len(behind) == len(_SIDES) else {})


def is_course(columns: dict[str, Column], rows: list[list[str]]) -> bool:
    """Whether a heading is a course over ground: in whole degrees, without roll, pitch and a sigma."""
    values = values_of(rows, columns.get("heading"))
    attitude = columns.keys() & {"roll", "pitch", "sigma_heading", *QUATERNION}
    return len(values) > 1 and not attitude and all(value.isdigit() for value in values)


def order_of_dates(columns: dict[str, Column], header: Header, settings: TrajectoryFile) -> DateOrder | None:
    """Of days and months. Raises ValueError where it cannot be known."""
    column = columns.get("date", columns["time"])
    unit = dict(zip(header.starts, header.units, strict=False)).get(column.at, "").lower()
    if "dmy" in unit or "mdy" in unit:
        return "dmy" if "dmy" in unit else "mdy"
    texts = [] if "year" in columns else values_of(header.rows, column)
    return date_order([text for text in texts if "date" in columns or "/" in text], settings.date)
