"""Records of text files with columns, whatever their format: a `TableLayout` says which column is what.

The columns have our own names: `time` (with `date` and `week` where they are separate), a position, and what else the file has.
Angles are those of surveying (heading clockwise from true north, pitch with the front up, roll with the right side down) if there
is a `heading`; with a `yaw` they are those of conetl's own trajectory.csv (docs/reference/coordinates.md).
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from conetl.geometry import pose as se3
from conetl.model.arrays import Floats
from conetl.model.errors import InputError
from conetl.readers.trajectories.recorded import Axes, Heights, Reading, Records, attitude, rotations_of_quaternions
from conetl.readers.trajectories.settings import TrajectoryFile
from conetl.readers.trajectories.text import floats, line_blocks, split_line
from conetl.readers.trajectories.times import OFFSET, TimeFormat, TimeReader, common_clock, time_reader

TIMES = ("time", "date", "week")
POSITIONS: dict[Axes, tuple[str, str, str]] = {
    "geodetic": ("lat", "lon", "height"), "projected": ("easting", "northing", "height"), "geocentric": ("x", "y", "z"),
    "local": ("x", "y", "z"),
}  # fmt: skip
QUATERNION = ("qw", "qx", "qy", "qz")
SIGMAS = ("sigma_e", "sigma_n", "sigma_u", "sigma_roll", "sigma_pitch", "sigma_heading")
ROLES = (
    *TIMES, "lat", "lon", "height", "height_msl", "easting", "northing", "x", "y", "z", "roll", "pitch", "heading", "yaw",
    *QUATERNION,
    *SIGMAS, "sigma_horizontal", "quality",
)  # fmt: skip
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
    """Where the records of a file are, and what they consist of."""

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
    order: Literal["dmy", "mdy"] | None = None
    """`mdy` or `dmy`, where the file says so."""


def rows_of(path: Path, layout: TableLayout) -> Iterator[tuple[list[int], list[list[str]]]]:
    """Line numbers and values of consecutive pieces of a file, without comments and empty lines."""
    for first, lines in line_blocks(path):
        numbers: list[int] = []
        rows: list[list[str]] = []
        for number, line in enumerate(lines, first):
            stripped = line.strip("\t\r \0") if layout.delimiter is None else line.strip("\r \0")
            if number >= layout.first_line and stripped and not stripped.startswith(("#", "%")):
                numbers.append(number)
                rows.append(split_line(stripped, layout.delimiter))
        if rows:
            yield numbers, rows


def table_records(
    path: Path, layout: TableLayout, settings: TrajectoryFile,
    adjust: Callable[[Mapping[str, Floats], Records], Records] | None = None,
) -> Iterator[Records]:  # fmt: skip
    """The records of a file. Raises InputError where its times cannot be understood.

    adjust: what a format does besides, given the values of all columns (N,) by our name.
    """
    width = 1 + max(column.at + (2 if column.dms else 0) for column in layout.columns.values())
    read_times: TimeReader | None = None
    for numbers, rows in rows_of(path, layout):
        short = {
            i: f"expected {width} or more values, found {len(row)}" for i, row in enumerate(rows) if len(row) < width
        }
        for i in short:
            rows[i] = [""] * width
        words = _time_words(rows, layout)
        week = layout.columns.get("week")
        weeks = None if week is None else [row[week.at] for row in rows]
        if read_times is None:
            read_times = time_reader(layout.clock or _clock(words, short, layout, settings, path))
        times, wrong = read_times(words, weeks)
        wrong = wrong | short
        values = {
            role: _numbers(rows, column, layout.comma) for role, column in layout.columns.items() if role not in TIMES
        }
        positions = np.column_stack([values[name] for name in POSITIONS[layout.axes]])
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
    words = [row[layout.columns["time"].at] for row in rows]
    if "date" in layout.columns:
        date = layout.columns["date"].at
        words = [f"{row[date].strip()} {word.strip()}" if word else "" for row, word in zip(rows, words, strict=True)]
    return [word.replace(",", ".") for word in words] if layout.comma else words


def _numbers(rows: Sequence[list[str]], column: Column, comma: bool) -> Floats:
    found = floats([row[column.at] for row in rows], comma=comma)
    if column.dms:
        minutes, seconds = (floats([row[column.at + k] for row in rows], comma=comma) for k in (1, 2))
        # The sign of -0 degrees counts.
        found = np.copysign(np.abs(found) + minutes / 60.0 + seconds / 3600.0, found)
    return found * column.factor if column.factor != 1.0 else found


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

    Raises InputError where a column is missing.
    """
    heights: Heights = "ellipsoidal"
    above_sea = columns.pop("height_msl", None)
    if above_sea is not None and "height" not in columns:
        columns["height"], heights = above_sea, "sea level"
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
    return Reading(
        table_records(path, TableLayout(columns, "local", 1, delimiter, clock=clock), settings), axes="local"
    )


#: The poses of a data.csv, and those of a TUM file.
read_euroc = partial(
    _read_local, names=("x", "y", "z", "qw", "qx", "qy", "qz"), delimiter=",", clock=TimeFormat("UTC", "unix", 0)
)
read_tum = partial(
    _read_local, names=("x", "y", "z", "qx", "qy", "qz", "qw"), delimiter=None, clock=TimeFormat("UTC", "unix")
)
