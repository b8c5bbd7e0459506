"""Records of text files with columns, whatever their format: a `TableLayout` says which column is what.

The columns have our own names: `time` (with `date` and `week` where they are separate), a position, and what else the file has.
Angles are those of surveying (heading clockwise from true north, pitch with the front up, roll with the right side down) if there
is a `heading`; with a `yaw` they are those of conetl's own trajectory.csv (docs/reference/coordinates.md).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from conetl.geometry import pose as se3
from conetl.model.arrays import Floats
from conetl.model.errors import InputError
from conetl.readers.trajectories.clocks import TimeFormat, common_clock, time_reader
from conetl.readers.trajectories.dates import with_colons, with_marks
from conetl.readers.trajectories.recorded import Axes, Heights, Reading, Records, attitude, rotations_of_quaternions
from conetl.readers.trajectories.settings import TrajectoryFile
from conetl.readers.trajectories.text import Progress, floats, line_blocks, split_line
from conetl.readers.trajectories.times import OFFSET, DateOrder

TIMES = ("time", "date", "week")
PARTS = ("year", "month", "hour", "minute", "second", "nanosecond")
"""Of a time; the day is the `date`."""
POSITIONS: dict[Axes, tuple[str, str, str]] = {
    "geodetic": ("lat", "lon", "height"), "projected": ("easting", "northing", "height"), "geocentric": ("x", "y", "z"),
    "local": ("x", "y", "z"),
}  # fmt: skip
QUATERNION = ("qw", "qx", "qy", "qz")
SIGMAS = ("sigma_e", "sigma_n", "sigma_u", "sigma_roll", "sigma_pitch", "sigma_heading")
ROLES = (
    *TIMES, "lat", "lon", "height", "height_msl", "separation", "easting", "northing", "x", "y", "z", "roll", "pitch", "heading",
    "yaw", *QUATERNION,
    *SIGMAS, "sigma_horizontal", "quality",
)  # fmt: skip
#: Columns that are not numbers, or not on their own.
_TEXTS = frozenset({*TIMES, *PARTS, "lat_side", "lon_side", "height_system"}) - {"nanosecond"}
ANGLES = frozenset({"lat", "lon", "roll", "pitch", "heading", "yaw", "sigma_roll", "sigma_pitch", "sigma_heading"})
LEVEL_SIGMA_RAD = float(np.radians(5.0))
"""Roll and pitch of a vehicle of which only the heading was recorded are 0 with this sigma: roads rise by up to 10 %."""


class Column(NamedTuple):
    """A column of a file."""

    at: int
    """From 0, among the values of a line."""
    name: str
    """In the file."""
    factor: float = 1.0
    """From its unit to metres or degrees."""
    unit: str | None = None
    """Unit of a time."""
    dms: bool = False
    """Degrees, minutes and seconds: three values."""


class TableLayout(NamedTuple):
    """Where the records of a file are, and what they consist of: up to the next line that names columns."""

    columns: Mapping[str, Column]
    """By our names."""
    axes: Axes
    first_line: int
    """Number of the line of the first record, from 1."""
    delimiter: str | None = None
    """None: any white space."""
    comma: bool = False
    """Decimals are after a comma."""
    scale: str = "UTC"
    """Time scale, unless the settings name another: `gps` or a time zone; `""`: gps for times of a week, else UTC; `?`: the same,
    but dates and times since 1970 need the settings, as the column's name speaks of GPS; `local`: the same for dates without an
    offset, as it speaks of local time."""
    clock: TimeFormat | None = None
    """None: to be found from the first values of the time."""
    order: DateOrder | None = None
    """Of days, months and years, where the file says so."""
    heights: Heights = "ellipsoidal"

    @property
    def width(self) -> int:
        """How many values a record has at least."""
        return 1 + max(column.at + (2 if column.dms else 0) for column in self.columns.values())

    def is_like(self, other: TableLayout) -> bool:
        """Whether records have the same columns."""
        return self._replace(first_line=0) == other._replace(first_line=0)


Adjust = Callable[[Mapping[str, Floats], Records], Records]
Relayout = Callable[[list[str], int], TableLayout | None]
#: What a line that names columns of a position has, in any of their languages.
_COLUMN_WORDS = ("lat", "lon", "breite", "east", "north", "ecef", "rechts", "ostwert")
_FIRST_OF_NUMBER = frozenset("0123456789+-. \t")
#: Lines with names in a file, of others with such words a tenth of them; records compared with each.
_MOST_HEADERS, _HEADER_CONTEXT = 1000, 30


def rows_of(
    path: Path, layout: TableLayout, progress: Progress, relayout: Relayout | None = None
) -> Iterator[tuple[TableLayout, list[int], list[list[str]]]]:
    """Layout, line numbers and values of consecutive pieces of a file, without comments and empty lines, and but for one in each
    piece without lines of too few values.

    relayout: the layout that a line states for those below it, given lines from it on and its number; None where it states none.
    """
    headers, width = 0, layout.width
    for first, lines in line_blocks(path, progress):
        numbers: list[int] = []
        rows: list[list[str]] = []
        has_short = False
        for number, line in enumerate(lines, first):
            if number < layout.first_line:
                continue
            stripped = line.strip("\t\r \0") if layout.delimiter is None else line.strip("\r \0")
            if stripped[:1] not in _FIRST_OF_NUMBER:
                start = stripped[:1000].lower() if relayout and headers < _MOST_HEADERS else ""
                if relayout and any(word in start for word in _COLUMN_WORDS):
                    new = relayout(lines[number - first :][:_HEADER_CONTEXT], number)
                    headers += 10 if new is None else 1
                    if new is not None:
                        if rows and not new.is_like(layout):
                            yield layout, numbers, rows
                            numbers, rows = [], []
                        layout, width = new, new.width
                        continue
                if not stripped or stripped.startswith(("#", "%")):
                    continue
            row = split_line(stripped, layout.delimiter, width)
            if len(row) < width and has_short:
                continue  # the first one says what is wrong
            has_short |= len(row) < width
            numbers.append(number)
            rows.append(row)
        if rows:
            yield layout, numbers, rows


def table_records(
    path: Path,
    layout: TableLayout,
    settings: TrajectoryFile,
    progress: Progress,
    adjust: Adjust | None = None,
    relayout: Relayout | None = None,
) -> Iterator[Records]:
    """The records of a file. Raises InputError where its times cannot be understood.

    adjust: what a format does besides, given the values of all columns (N,) by our name; relayout: see `rows_of`.
    """
    before: TableLayout | None = None
    for now, found_numbers, found_rows in rows_of(path, layout, progress, relayout):
        numbers, width, none = found_numbers, now.width, [""] * now.width
        short = {
            i: f"expected {width} or more values, found {len(row)}"
            for i, row in enumerate(found_rows)
            if len(row) < width
        }
        rows = [none if i in short else row for i, row in enumerate(found_rows)]
        words = _time_words(rows, now)
        week = now.columns.get("week")
        weeks = None if week is None else [row[week.at] for row in rows]
        if before is None or not now.is_like(before):
            read_times = time_reader(now.clock or _clock(words, short, now, settings, path))
            before = now
        times, wrong = read_times(words, weeks)
        wrong |= short
        if len(wrong) > 1:  # of records without a time the first one says what is wrong
            first = min(wrong)
            kept = [i for i in range(len(rows)) if i == first or i not in wrong]
            rows, numbers, times = [rows[i] for i in kept], [numbers[i] for i in kept], times[kept]
            wrong = {kept.index(first): wrong[first]}
        values = {role: _numbers(role, rows, column, now) for role, column in now.columns.items() if role not in _TEXTS}
        if "nanosecond" in values:
            times = times + np.nan_to_num(values["nanosecond"]).clip(-1e9, 1e9).astype(np.int64) * (times > 0)
        if "separation" in values and settings.heights is None:
            values["height"] = values["height"] + values["separation"]
        positions = np.column_stack([values[name] for name in POSITIONS[now.axes]])
        sigma = sigmas_of(values, len(rows))
        rotations = rotations_of(values, sigma)
        found = Records(times, positions, rotations, sigma, wrong, (f"line {number}" for number in numbers))
        yield adjust(values, found) if adjust else found


def _clock(
    words: Sequence[str], short: Container[int], layout: TableLayout, settings: TrajectoryFile, path: Path
) -> TimeFormat:
    column = layout.columns["time"]
    by_kind = layout.scale in {"", "?", "local"}
    clock = common_clock(
        (word for i, word in enumerate(words) if i not in short and word), column.name, path, settings,
        scale="UTC" if by_kind else layout.scale, unit=column.unit, has_week="week" in layout.columns,
    )  # fmt: skip
    if by_kind and settings.time is None:
        if clock.kind == "week":
            clock = clock._replace(scale="gps")
        elif layout.scale == "local" and not (
            clock.kind == "unix" or all(OFFSET.search(word) for word in words if word)
        ):
            raise InputError(
                f"{path}: column {column.name!r}: the time zone of this local time is unknown. Put for example "
                "trajectory: {time: Europe/Berlin} into drive.yaml"
            )
        elif layout.scale == "?" or clock.kind == "day":
            raise InputError(
                f"{path}: column {column.name!r}: is this GPS time, which is some seconds ahead of UTC, or UTC? Put "
                "trajectory: {time: gps} or {time: utc} into drive.yaml"
            )
    return clock._replace(order=layout.order)


def _time_words(rows: Sequence[list[str]], layout: TableLayout) -> list[str]:
    """The times as texts; a date of its own column is before them."""
    columns = layout.columns
    if "year" in columns:
        parts = [columns[name].at for name in ("year", "month", "date", "hour", "minute", "second")]
        words = ["{}-{}-{} {}:{:0>2}:{:0>2}".format(*(row[at].strip() for at in parts)) for row in rows]
        return [re.sub(r":(\d)([.,])", r":0\1\2", word) for word in words]
    words = [row[columns["time"].at] for row in rows]
    if "date" in columns:
        dates = [row[columns["date"].at] for row in rows]
        marked = {text: with_marks(text, layout.order) for text in {*dates}}
        timed = (word if ":" in word else with_colons(word) for word in words)
        words = [f"{marked[day]} {word}" if word else "" for day, word in zip(dates, timed, strict=True)]
    return [word.replace(",", ".") for word in words] if layout.comma else words


def _numbers(role: str, rows: Sequence[list[str]], column: Column, layout: TableLayout) -> Floats:
    words, comma = [row[column.at] for row in rows], layout.comma
    found = floats(words, comma=comma)
    if column.dms:
        minutes, seconds = (floats([row[column.at + k] for row in rows], comma=comma) for k in (1, 2))
        # The sign of -0 degrees counts.
        found = np.copysign(np.abs(found) + minutes / 60.0 + seconds / 3600.0, found)
    sides = _SIDES.get(role)
    if sides is not None:
        for i in np.flatnonzero(np.isnan(found)).tolist():
            found[i] = degrees_of(words[i].replace(",", ".") if comma else words[i], sides)
        if (side := layout.columns.get(f"{role}_side")) is not None:
            found = np.array([_on_side(a, row[side.at], sides) for a, row in zip(found.tolist(), rows, strict=True)])
    return found * column.factor if column.factor != 1.0 else found


def _on_side(angle: float, side: str, sides: str) -> float:
    """An angle with the hemisphere of its own column: a letter, a word or a sign; NaN where they contradict each other."""
    letter = side.strip()[:1].upper()
    negative = letter in {sides[1], "-"}
    if not (negative or letter in {sides[0], "+"}) or (angle < 0 and not negative):
        return np.nan
    return -abs(angle) if negative else angle


_SIDES = {"lat": "NS", "lon": "EW"}
_ANGLE = re.compile(
    r"\s*([A-Z+-]?)\s*(\d{1,3}(?:\.\d*)?)\s*(?:[°º:d]\s*(?:(\d{1,2}(?:\.\d*)?)\s*(?:['′’:m]\s*(?:(\d{1,2}(?:\.\d*)?)\s*"
    r"(?:\"|″|”|''|s)?)?)?)?)?\s*([A-Z]?)\s*",
    re.IGNORECASE,
)


def degrees_of(text: str, sides: str) -> float:
    """Degrees of a text such as 49.0019S, w 8.4296 or 49° 0' 6.86" N; NaN where it is none.

    sides: the letters of the positive and of the negative hemisphere.
    """
    match = _ANGLE.fullmatch(text[:60])
    if match is None:
        return np.nan
    before, degrees, minutes, seconds, after = match.groups(default="")
    sign = "".join({before, after} - {""}).upper()
    value = float(degrees) + float(minutes or 0) / 60.0 + float(seconds or 0) / 3600.0
    if float(minutes or 0) >= 60 or float(seconds or 0) >= 60 or sign not in {"", "+", "-", *sides}:
        return np.nan
    return -value if sign in {"-", sides[1]} else value


def sigmas_of(values: Mapping[str, Floats], count: int) -> Floats:
    """(N, 6) sigmas of east, north, up (m), roll, pitch, yaw (rad) of columns in metres and degrees; NaN without a column."""
    none = np.full(count, np.nan)
    horizontal = values.get("sigma_horizontal", none)
    found = [values.get(name, horizontal if k < 2 else none) for k, name in enumerate(SIGMAS)]
    sigma = np.column_stack(found)
    sigma[:, 3:] = np.radians(sigma[:, 3:])
    return sigma


def rotations_of(values: Mapping[str, Floats], sigma: Floats) -> Floats | None:
    """(N, 3, 3) of quaternions or angles in degrees; None without them. Sigmas of unknown roll and pitch are filled in."""
    if all(name in values for name in QUATERNION):
        return rotations_of_quaternions(np.column_stack([values[name] for name in QUATERNION]))
    angle = values.get("heading", values.get("yaw"))
    if angle is None:
        return None
    level = np.zeros(len(angle))
    for k, name in ((3, "roll"), (4, "pitch")):
        if name not in values:
            sigma[:, k] = LEVEL_SIGMA_RAD
    roll, pitch = values.get("roll", level), values.get("pitch", level)
    bounded = (np.abs(roll) <= 180.0) & (np.abs(pitch) <= 90.0) & (np.abs(angle) <= 360.0)
    angle = np.where(bounded, angle, np.nan)
    if "heading" in values:
        return attitude(roll, pitch, angle)
    return se3.rotation_from_rpy(np.radians(roll), np.radians(pitch), np.radians(angle))


def require(columns: dict[str, Column], path: Path, header: Sequence[str]) -> tuple[Axes, Heights]:
    """Axes and heights of a table's positions; heights above the sea become `height` where there are no others.

    They are ellipsoidal with the `separation` of the geoid, which is kept only then. Beside a height that states nothing it shows
    that this may be above the sea.
    Raises InputError where a column is missing.
    """
    heights: Heights = "ellipsoidal"
    above_sea = columns.pop("height_msl", None)
    separation = columns.pop("separation", None)
    if above_sea is not None and "height" not in columns:
        columns["height"], heights = above_sea, "sea level"
        if separation is not None:
            columns["separation"], heights = separation, "ellipsoidal"
    elif (
        separation is not None
        and above_sea is None
        and "height" in columns
        and not re.search("ell|hae", columns["height"].name, re.I)
    ):
        heights = "unstated"
    shown_header = ", ".join(header)[:200]
    also = "" if "time" in columns else "a time and "
    missing = f"columns for {also}a position (lat, lon, height; easting, northing, height; or x, y, z)"
    for axes in ("geodetic", "projected", "local"):
        names = POSITIONS[axes]
        if names[0] in columns and names[1] in columns:
            if names[2] not in columns:
                raise InputError(
                    f"{path}: has no column for {names[2]!r}; its columns are {shown_header}. Name it in drive.yaml, for example "
                    f"trajectory: {{columns: {{{names[2]}: H}}}}"
                )
            if "time" not in columns:
                missing = "a column for a time"
                break
            return axes, heights
    raise InputError(
        f"{path}: expected {missing}, found {shown_header}. Name them in drive.yaml, for example "
        "trajectory: {columns: {time: Zeit, lat: B, lon: L, height: H}}"
    )


# --------------------------------------------------------------------------- poses in a local level frame, columns by their order
#
#   TUM    # timestamp tx ty tz qx qy qz qw                                    seconds since 1970 (Sturm et al., IROS 2012)
#   EuRoC  #timestamp,p_RS_R_x [m],...,q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []  nanoseconds since 1970 (Burri et al., IJRR 2016)
#
# drive.yaml gives the position of the frame on the earth (`georeference`) and the sigmas.


def looks_like_euroc(lines: list[str]) -> bool:
    """Whether the first lines are those of a EuRoC trajectory: 19-digit times, and eight or more numbers."""
    rows = [line.split(",") for line in lines if line.strip() and not line.startswith("#")][:5]
    return bool(rows) and all(len(row) >= 8 and len(row[0].strip()) == 19 and row[0].strip().isdigit() for row in rows)


def looks_like_tum(lines: list[str]) -> bool:
    """Whether the first lines are a time since 1970, three numbers and a quaternion of about unit length."""
    rows = [floats(line.split()) for line in lines if line.strip() and not line.startswith("#")][:5]
    return bool(rows) and all(
        len(row) == 8 and 6e8 < row[0] < 4.2e9 and abs(float((row[4:] ** 2).sum()) - 1.0) < 2e-2 for row in rows
    )


def _read_local(
    path: Path, settings: TrajectoryFile, *, names: tuple[str, ...], delimiter: str | None, clock: TimeFormat
) -> Reading:
    columns = {"time": Column(0, "timestamp")} | {name: Column(i, name) for i, name in enumerate(names, 1)}
    layout, progress = TableLayout(columns, "local", 1, delimiter, clock=clock), Progress(path)
    return Reading(table_records(path, layout, settings, progress), axes="local", progress=progress)


#: The poses of a data.csv, and those of a TUM file.
read_euroc = partial(
    _read_local, names=("x", "y", "z", "qw", "qx", "qy", "qz"), delimiter=",", clock=TimeFormat("UTC", "unix", 0)
)
read_tum = partial(
    _read_local, names=("x", "y", "z", "qx", "qy", "qz", "qw"), delimiter=None, clock=TimeFormat("UTC", "unix")
)
