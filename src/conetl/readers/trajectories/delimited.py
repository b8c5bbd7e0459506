"""Tables with any names of columns, separated by comma, semicolon, tab or white space: what each column is, from its name.

Names are compared without case, accents, units and punctuation (`Höhe [m]`, `hoehe_m`); drive.yaml (`trajectory: columns`) names
what is not recognised. Without a unit, angles are degrees (or what `angles` says) and lengths metres.
"""

from __future__ import annotations

import re
import unicodedata
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from conetl.files.documents import shown
from conetl.model.errors import InputError
from conetl.readers.trajectories.earth import is_geocentric
from conetl.readers.trajectories.recorded import Reading, RecordedTrajectory
from conetl.readers.trajectories.settings import TrajectoryFile
from conetl.readers.trajectories.tables import (
    ANGLES,
    POSITIONS,
    ROLES,
    TIMES,
    Column,
    TableLayout,
    require,
    table_records,
)
from conetl.readers.trajectories.text import head_lines, split_line

_ALIASES = {
    "time": "time timestamp timestamps stamp t utc utctime timeutc datetime utcdatetime capturedat unixtime unix "
        "epoch posixtime zeit zeitstempel uhrzeit utczeit gpszeit datumzeit timeofday "
        "gpstime gpstimestamp gpsdatetime gpsutc tow gpstow sow gpssow secondsofweek timeofweek gpsseconds gpssecs "
        "correctedtime localtime timelocal localdatetime localtimestamp ortszeit",
    "date": "date utcdate datum tag gpsdate gpsdatum day",
    "week": "week gpsweek weekno weeknumber gpswk wn",
    "lat": "lat latitude breite breitengrad geobreite latitud phi",
    "lon": "lon long lng longitude laenge laengengrad geolaenge longitud lambda",
    "height": "height h hell ellh ellipsoidalheight heightellipsoidal heightaboveellipsoid hae alt altitude hoehe "
        "ellhoehe ellipsoidischehoehe",
    "height_msl": "hmsl heightmsl altmsl altitudemsl mslaltitude mslheight msl orthometricheight horth elevation ele "
        "elev nhn hoehenhn hnhn",
    "easting": "easting east e rechtswert ostwert utmeast utme",
    "northing": "northing north n hochwert nordwert utmnorth utmn",
    "x": "x px posx positionx tx",
    "y": "y py posy positiony ty",
    "z": "z pz posz positionz tz",
    "roll": "roll rollangle rollwinkel",
    "pitch": "pitch pitchangle nick nickwinkel",
    "heading": "heading hdg hdt trueheading azimuth azimut azi",
    "yaw": "yaw",
    "qw": "qw quatw orientationw",
    "qx": "qx quatx orientationx",
    "qy": "qy quaty orientationy",
    "qz": "qz quatz orientationz",
    "sigma_e": "sigmae sde sdeast eastsd stde stdeast eaststd eaststddev sigmaeast easterror",
    "sigma_n": "sigman sdn sdnorth northsd stdn stdnorth northstd northstddev sigmanorth northerror",
    "sigma_u": "sigmau sdu sdup sdheight heightsd stdu stdup stdheight upstd upstddev sigmaup sigmaheight "
        "vacc verticalaccuracy stdvertical sdv verticalsd sdh sdvert",
    "sigma_horizontal": "sigmahorizontal hacc horizontalaccuracy sdhoriz horizontalsd stdhorizontal accuracy posaccuracy "
        "poshacc",
    "sigma_roll": "sigmaroll rollsd rllsd sdroll stdroll rollstd rollaccuracy",
    "sigma_pitch": "sigmapitch pitchsd ptchsd sdpitch stdpitch pitchstd pitchaccuracy",
    "sigma_heading": "sigmaheading headingsd hdngsd sdheading stdheading headingstd headingaccuracy sigmayaw yawsd sdyaw "
        "stdyaw yawstd",
}  # fmt: skip
_ROLE_OF = {alias: role for role, aliases in _ALIASES.items() for alias in aliases.split()}
_DEGREES = {
    "deg": 1.0, "degree": 1.0, "degrees": 1.0, "°": 1.0, "rad": 57.29577951308232, "radians": 57.29577951308232,
    "arcmin": 1 / 60, "amin": 1 / 60, "arcsec": 1 / 3600, "asec": 1 / 3600,
}  # fmt: skip
_LENGTHS = {"m": 1.0, "meter": 1.0, "meters": 1.0, "metres": 1.0, "mm": 1e-3, "cm": 1e-2, "km": 1e3}
_TIMES = {"s": "s", "sec": "s", "secs": "s", "seconds": "s", "ms": "ms", "us": "us", "µs": "us", "ns": "ns"}
_REFUSED = frozenset({"ft", "feet", "usft", "gon", "grad", "grads", "mil", "mils"})
_NO_UNITS = frozenset({"utc", "gps", "wgs84", "msl", "", "-", "ellipsoidal", "gpst"})
#: A header is among these lines, and has at most so many characters and names.
_HEADER_LINES, _LONGEST_HEADER, _MOST_COLUMNS = 200, 5000, 1000
#: Characters of a column's name that may be known.
_LONGEST_NAME = 60
_EARTH_M = 6.371e6
#: Steps of 2 m that the path must have to be compared with a yaw.
_LEAST_STEPS = 10
_MARKS = (",", ";", "\t", None)


class _Header(NamedTuple):
    """The line that names the columns, and how its values are separated."""

    line: int
    """Index; -1 without a header."""
    names: list[str]
    columns: dict[str, Column]
    """By our name."""
    delimiter: str | None


def read(path: Path, settings: TrajectoryFile) -> Reading:
    """The records of a table. Raises InputError that names its columns where they are not understood."""
    lines = head_lines(path)
    line, names, columns, delimiter = _header(path, lines, settings)
    axes, heights = require(columns, path, names)
    if axes == "local" and settings.crs is not None:
        axes = "geocentric" if is_geocentric(settings) else "projected"
        if axes == "projected":
            columns |= dict(zip(POSITIONS[axes], (columns.pop(name) for name in "xyz"), strict=True))
    data = [split_line(row, delimiter) for row in lines[line + 1 :][:20] if row.strip()]
    if delimiter is None and "date" not in columns:
        columns = _with_date(columns, data)
    first = columns[POSITIONS[axes][0]].at
    comma = settings.decimal == "," or (
        settings.decimal is None and delimiter != "," and any("," in row[first] for row in data if len(row) > first)
    )
    layout = TableLayout(columns, axes, line + 2, delimiter, comma, scale=_scale_of(columns["time"].name))
    yaw = columns["yaw"].name if "yaw" in columns and "heading" not in columns else None
    return Reading(table_records(path, layout, settings), axes, heights, yaw)


def looks_like(lines: list[str]) -> bool:
    """Whether one of the first lines has names for a time and a position."""
    for line in lines[:_HEADER_LINES]:
        for mark in _MARKS:
            names = split_line(line[:_LONGEST_HEADER].lstrip("#% \t\ufeff"), mark)
            roles = {role_of(name) for name in names[:_MOST_COLUMNS]}
            found = {"height" if role == "height_msl" else role for role in roles}
            if "time" in found and any(set(names) <= found for names in POSITIONS.values()):
                return True
    return False


def check_yaw(path: Path, found: RecordedTrajectory, column: str) -> None:
    """Raise InputError where a yaw is a heading, clockwise from north: then the vehicle would not drive where it looks."""
    if found.rotations is None or found.is_local:
        return
    lat, lon, _ = np.radians(found.positions).T
    metres = _EARTH_M * np.column_stack([lon * np.cos(lat[0]), lat])
    # The first record at least 2 m of path after each record that is compared.
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(metres, axis=0), axis=1))])
    starts = np.unique(np.searchsorted(along, np.arange(0.0, min(along[-1], 1e5), 2.0)))
    steps, seconds = np.diff(metres[starts], axis=0), np.diff(found.times_ns[starts]) * 1e-9
    moving = (np.linalg.norm(steps, axis=1) > 1.0) & (seconds < 5.0)
    if np.count_nonzero(moving) < _LEAST_STEPS:
        return
    course = np.arctan2(steps[moving, 1], steps[moving, 0])
    forward = found.rotations[starts[:-1][moving], :, 0]
    yaw = np.arctan2(forward[:, 1], forward[:, 0])
    as_yaw, as_heading = (np.median(np.abs(np.angle(np.exp(1j * (a - course))))) for a in (yaw, np.pi / 2 - yaw))
    if as_yaw > np.pi / 4 and as_heading < np.pi / 9:
        raise InputError(
            f"{path}: compared with the drive path, the column {shown(column)} counts clockwise from north, as a "
            f"heading does; a yaw counts counter-clockwise from east. Put trajectory: {{columns: {{heading: {column[:60]}}}}}"
        )


def _header(path: Path, lines: list[str], settings: TrajectoryFile) -> _Header:
    """The line that names most columns. Raises InputError."""
    marks: tuple[str | None, ...] = _MARKS
    if settings.delimiter is not None:
        marks = (None if settings.delimiter == " " else settings.delimiter,)
    if settings.columns and all(isinstance(name, int) for name in settings.columns.values()):
        first = next((line for line in lines if line.strip() and not line.startswith(("#", "%"))), "")
        needed = max(int(at) for at in settings.columns.values())
        mark = next((mark for mark in marks if len(split_line(first, mark)) >= needed), marks[0])
        columns = {role: _numbered(path, role, int(at), settings) for role, at in settings.columns.items()}
        return _Header(-1, [], columns, mark)
    best: _Header | None = None
    for i, whole in enumerate(lines[:_HEADER_LINES]):
        line = whole[:_LONGEST_HEADER]
        text = line.lstrip("#% \t\ufeff") if line.startswith(("#", "%", "\ufeff")) else line
        for mark in marks:
            names = [name.strip() for name in split_line(text.strip("\r\n"), mark)]
            if (
                not 3 <= len(names) <= _MOST_COLUMNS
                or sum(any(c.isalpha() for c in name) for name in names) < len(names) / 2
            ):
                continue
            found = _columns(path, names, settings)
            # White space is in names of columns, too.
            if best is None or len(found) > max(len(best.columns), 2 if mark is None else 0):
                best = _Header(i, names, found, mark)
    if best is None:
        raise InputError(
            f"{path}: there is no line with the names of the columns; write one, or number the columns in drive.yaml, for "
            "example trajectory: {columns: {time: 1, lat: 2, lon: 3, height: 4}}"
        )
    missing = [str(name) for name in settings.columns.values() if isinstance(name, str) and name not in best.names]
    if missing:
        raise InputError(
            f"{path}: has no column {shown(missing[0])}, which trajectory.columns names; its columns are "
            f"{', '.join(best.names)[:200]}"
        )
    return best


def _columns(path: Path, names: list[str], settings: TrajectoryFile) -> dict[str, Column]:
    """Columns by our name: those of the settings, then those recognised. Raises InputError where two claim one name."""
    mapped = {str(name): role for role, name in settings.columns.items() if isinstance(name, str)}
    columns: dict[str, Column] = {}
    for stated, number in settings.columns.items():
        if isinstance(number, int):
            columns[stated] = _numbered(path, stated, number, settings)
        if stated not in ROLES:
            raise InputError(
                f"drive.yaml: trajectory.columns: {shown(stated)} is unknown; known are {', '.join(ROLES)}"
            )
    for at, name in enumerate(names):
        role = mapped.get(name) or role_of(name)
        if role is None or (role in settings.columns and name not in mapped):
            continue
        if role in columns:
            raise InputError(
                f"{path}: the columns {shown(columns[role].name)} and {shown(name)} may both be the {role}; name one "
                f"in drive.yaml, trajectory: {{columns: {{{role}: ...}}}}"
            )
        columns[role] = column_of(path, role, at, name, _unit_of(name), settings)
    return columns


def _numbered(path: Path, role: str, number: int, settings: TrajectoryFile) -> Column:
    if role not in ROLES or not 1 <= number <= 1000:
        raise InputError(
            f"drive.yaml: trajectory.columns: {shown(role)}: {number}: expected a number from 1 to 1000 for "
            f"one of {', '.join(ROLES)}"
        )
    return column_of(path, role, number - 1, f"column {number}", "", settings)


def column_of(
    path: Path, role: str, at: int, name: str, unit: str, settings: TrajectoryFile, *, required: bool = False
) -> Column:
    """A column with the factor of its unit. Raises InputError for units that are not supported.

    required: the file states all units; else what is not one of this column's is part of its name.
    """
    if role in TIMES:
        return Column(at, name, unit=_TIMES.get(unit))
    units = _DEGREES if role in ANGLES else _LENGTHS
    if unit in _REFUSED or (required and unit not in units):
        raise InputError(
            f"{path}: column {shown(name)}: the unit {unit[:40]} is not supported; write degrees, radians or metres"
        )
    unstated = "rad" if role in ANGLES and settings.angles == "radians" else ""
    return Column(at, name, units.get(unit or unstated, 1.0))


def _plain(text: str) -> str:
    """Lower case, umlauts as two letters, other accents removed."""
    text = text.lower().translate({ord("ä"): "ae", ord("ö"): "oe", ord("ü"): "ue", ord("ß"): "ss"})
    return "".join(c for c in unicodedata.normalize("NFKD", text) if not unicodedata.combining(c))


def _unit_of(name: str) -> str:
    """The unit in brackets or after the last underscore or blank, as far as it is one."""
    bracket = re.search(r"[\[(]([^\])]*)[\])]", name)
    word = bracket[1] if bracket else re.split(r"[_ ]", name.strip())[-1] if re.search(r"[_ ]", name.strip()) else ""
    word = word.strip().lower()
    return word if word in {*_DEGREES, *_LENGTHS, *_TIMES, *_REFUSED, *_NO_UNITS} else ""


@lru_cache(maxsize=10_000)
def role_of(name: str) -> str | None:
    """Our name of a column, None where it is unknown."""
    if len(name) > _LONGEST_NAME:
        return None
    unit = _unit_of(name)
    base = re.sub(r"[\[(]" + re.escape(unit) + r"[\])]", "", name, flags=re.IGNORECASE)
    whole = re.sub(r"[^a-z0-9]", "", _plain(base))
    short = whole.removesuffix(re.sub(r"[^a-z0-9]", "", unit)) if unit and base == name else whole
    role = _ROLE_OF.get(whole) or _ROLE_OF.get(short)
    return "height_msl" if role == "height" and unit == "msl" else role


def _scale_of(name: str) -> str:
    """How a time is counted by the name of its column, see `TableLayout.scale`."""
    plain = re.sub(r"[^a-z0-9]", "", _plain(name))
    if "utc" in plain or "unix" in plain or "posix" in plain:
        return "UTC"
    return "local" if re.search("lo[ck]al|ortszeit", plain) else "?" if "gps" in plain else ""


def _with_date(columns: dict[str, Column], data: list[list[str]]) -> dict[str, Column]:
    """The columns; a date and a time of one column, which white space separates like all others, as two."""
    time = columns["time"]
    votes = [re.fullmatch(r"\d+[-/.]\d+[-/.]\d+", row[time.at]) is not None for row in data if len(row) > time.at]
    if sum(votes) <= len(votes) / 2:
        return columns
    return {role: c._replace(at=c.at + (c.at >= time.at)) for role, c in columns.items()} | {"date": time}
