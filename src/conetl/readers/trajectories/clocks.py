"""How the times of a file are counted, and many of them at once as exact UTC nanoseconds."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from datetime import date, timedelta
from itertools import islice
from typing import Any, Literal, NamedTuple
from zoneinfo import ZoneInfo

import numpy as np
import pyarrow as pa

from conetl.model.base import utc_from_ns
from conetl.model.errors import InputError
from conetl.readers.trajectories.settings import TrajectoryFile
from conetl.readers.trajectories.times import (
    DAY_NS,
    GPS_EPOCH_NS,
    OFFSET,
    SECOND_NS,
    WEEK_NS,
    DateOrder,
    Times,
    decimal_ns,
    gps_to_utc,
    parse_timestamp,
)  # fmt: skip

#: First values of a column that are looked at.
_VOTES, _MOST_COMPARED = 9, 1000
#: Time stamps that Arrow reads as `parse_timestamp` does: it would also read those without seconds.
_ISO = re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d:\d\d", re.ASCII)
_QUARTER_NS = 900 * SECOND_NS
_TIME_OF_DAY = re.compile(r"\s*\d\d?:\d\d:\d\d(?:[.,]\d*)?\s*", re.ASCII)
_HHMMSS = re.compile(r"(?:[01]\d|2[0-3])[0-5]\d[0-5]\d(?:\.\d*)?", re.ASCII)


class TimeFormat(NamedTuple):
    """How the times of a file are counted."""

    scale: str
    """`gps`, or the IANA name of a time zone."""
    kind: Literal["stamp", "unix", "gps seconds", "week", "day", "clock"]
    """Text, seconds since 1970, since 1980-01-06, of a GPS week, of a day; text of a day."""
    digits: int = 9
    """Decimal digits of the unit, as in `decimal_ns`."""
    week: int | None = None
    """GPS week of times without a week column; counted from 1980-01-06 without rollover."""
    day: date | None = None
    order: DateOrder | None = None

    @property
    def start_ns(self) -> int:
        """Epoch of the times, in ns since 1970-01-01 of the same time scale."""
        if self.kind in {"day", "clock"}:
            return ((self.day or date(1970, 1, 1)) - date(1970, 1, 1)).days * DAY_NS
        if self.kind == "week":
            return GPS_EPOCH_NS + (self.week or 0) * WEEK_NS
        return GPS_EPOCH_NS if self.kind == "gps seconds" else 0

    @property
    def period_ns(self) -> int:
        """After which times of a week or a day start over."""
        return WEEK_NS if self.kind == "week" else DAY_NS


def common_clock(
    words: Iterable[str], name: str, path: object, settings: TrajectoryFile, *, scale: str, unit: str | None,
    has_week: bool = False,
) -> TimeFormat:  # fmt: skip
    """The clock of most of the first values of a column: one of them may be damaged. Raises InputError.

    name: of the column, for messages; scale: unless the settings state another; unit: s, ms, us or ns if the column's name states
    it; has_week: whether there is a column of GPS weeks.
    """
    found: Counter[TimeFormat] = Counter()
    problem = " has no values"
    texts = [*islice(words, _MOST_COMPARED)]
    is_unclear = not (
        unit or has_week or settings.week is not None or re.search("[ts]ow|week|sec", name, re.IGNORECASE)
    )
    if is_unclear and texts and all(_HHMMSS.fullmatch(text.strip()) for text in texts):
        raise InputError(
            f"{path}: column {name!r}: {texts[0].strip()!r} may be hhmmss or seconds: write hh:mm:ss and a date, or state the "
            "unit in drive.yaml, like trajectory: {columns: {time: 'time [s]'}}"
        )
    for word in texts[:_VOTES]:
        try:
            found[_clock_of(word, settings.scale(scale), unit, has_week, settings)] += 1
        except ValueError as error:
            problem = f": {error}"
    if not found:
        raise InputError(f"{path}: column {name!r}{problem}")
    return found.most_common(1)[0][0]


def _clock_of(first: str, scale: str, unit: str | None, has_week: bool, settings: TrajectoryFile) -> TimeFormat:
    """The clock of one value. Raises ValueError where it cannot be known."""
    try:
        number = float(first)
    except ValueError:
        if settings.date is not None and _TIME_OF_DAY.fullmatch(first):
            return TimeFormat(scale, "clock", day=settings.date)
        return TimeFormat(scale, "stamp")
    units = {"s": 9, "ms": 6, "us": 3, "ns": 0}
    for digits in [units[unit]] if unit else units.values():
        seconds = number / 10.0 ** (9 - digits)
        if 0 <= seconds < 2 * 604_800 and (has_week or digits == 9 or unit):
            if has_week or (settings.week is not None and settings.date is None):
                return TimeFormat(scale, "week", digits, settings.week)
            return _clock_of_day(seconds, scale, digits, settings.date)
        if not has_week and 6e8 < seconds < 4.2e9:
            return TimeFormat(scale, "gps seconds" if scale == "gps" else "unix", digits)
    raise ValueError(
        f"{first[:40]!r} is neither a date and time nor seconds (or ms, us, ns) since 1970, of a GPS week or of a day"
    )


def _clock_of_day(seconds: float, scale: str, digits: int, day: date | None) -> TimeFormat:
    """The clock of seconds of the GPS week that holds a day, or of that day. Raises ValueError."""
    if day is None:
        raise ValueError(
            f"{seconds:.3f} is a time of a week or of a day, but the file does not state which: put "
            "trajectory: {week: 2300} (GPS week) or {date: 2024-02-07} into drive.yaml; if it counts from the start of the "
            "recording, or days, export dates and times"
        )
    weekday = (day.weekday() + 1) % 7  # from Sunday, as GPS weeks
    if int(seconds // 86_400) == weekday:
        return TimeFormat(scale, "week", digits, (day - date(1980, 1, 6)).days // 7)
    if seconds < 86_400 + 3600:
        return TimeFormat(scale, "day", digits, day=day)
    found = ("Sunday", "Monday", "Tuesday", "Wednesday", "Thursday", "Friday", "Saturday")[int(seconds // 86_400) % 7]
    raise ValueError(f"{seconds:.3f} s of a GPS week are on a {found}; 'date' of drive.yaml, {day}, is not")


TimeReader = Callable[[Sequence[str], Sequence[str] | None], tuple[Times, dict[int, str]]]


def time_reader(clock: TimeFormat) -> TimeReader:
    """A function of the texts of consecutive times and of their GPS weeks: UTC ns (N,), and what is wrong by index.

    Times of a week or a day without one of their own that start over belong to the next one: if two times were in the last 14th
    and the next is in the first 14th, so that one wild time does not move all that follow.
    """
    period_ns = clock.period_ns
    before = np.zeros(2, np.int64)
    turns = 0

    def read(words: Sequence[str], weeks: Sequence[str] | None) -> tuple[Times, dict[int, str]]:
        nonlocal before, turns
        times, wrong = _instants(words, clock)
        if clock.kind in {"week", "day", "clock"}:
            what = f"is more than two {'weeks' if clock.kind == 'week' else 'days'}"
            wrong |= {i: f"{words[i].strip()[:40]!r} {what}" for i in np.flatnonzero(times > 2 * period_ns).tolist()}
            starts: Times | int = clock.start_ns
            if weeks is not None:
                known = {text: _start_of_week(text) for text in {*weeks}}
                wrong = {
                    i: f"{text.strip()[:40]!r} is not a GPS week" for i, text in enumerate(weeks) if known[text] < 0
                } | wrong
                starts = np.array([known[text] for text in weeks], np.int64)
            good = np.ones(len(times), bool)
            good[[*wrong]] = False
            if weeks is None and good.any():
                rows = np.concatenate([before if before[1] else times[good][[0, 0]], times[good]])
                ends = np.minimum(rows[:-2], rows[1:-1]) > period_ns * 13 // 14
                later = turns + np.cumsum(ends & (rows[2:] < period_ns // 14))
                times[good] += later * period_ns
                before, turns = rows[-2:], int(later[-1])
            times = times + starts
            if clock.scale not in {"gps", "UTC"}:
                times = _utc_of(times, clock.scale)
        times[[*wrong]] = 0
        return gps_to_utc(times) if clock.scale == "gps" else times, wrong

    return read


def _start_of_week(text: str) -> int:
    """Ns since 1970 of the beginning of a GPS week, -1 of what is none."""
    digits = text.strip()
    known = re.fullmatch(r"\d{1,9}", digits, re.ASCII) is not None and int(digits) < 10_000
    return GPS_EPOCH_NS + int(digits) * WEEK_NS if known else -1


def _instants(words: Sequence[str], clock: TimeFormat) -> tuple[Times, dict[int, str]]:
    """Ns (N,) of texts by themselves: UTC (of a GPS clock GPS time) since 1970, or of a week or day; 0 where one is wrong."""
    zone = "UTC" if clock.scale == "gps" else clock.scale
    is_stamp = clock.kind == "stamp"
    start_ns = clock.start_ns if clock.kind == "gps seconds" else 0

    def one(word: str) -> int:
        if clock.kind == "clock":
            return parse_timestamp(f"1970-01-01 {word.strip()}")
        if not is_stamp:
            return start_ns + decimal_ns(word.strip(), clock.digits)
        if clock.scale == "gps" and OFFSET.search(word):
            raise ValueError(f"{word.strip()[:60]!r} has an offset from UTC, but is said to be GPS time")
        if is_stamp and _TIME_OF_DAY.fullmatch(word):
            raise ValueError(
                f"expected a time stamp like 2011-09-26 13:04:32.345, found {word.strip()!r}: name the column of the dates, or "
                "state the first one (trajectory.date in drive.yaml)"
            )
        return parse_timestamp(word, zone, clock.order)

    found = _stamps(words, zone, has_offsets=clock.scale != "gps") if is_stamp else _decimals(words, clock.digits)
    if found is not None:
        return found + start_ns, {}
    times, wrong = np.zeros(len(words), np.int64), {}
    for i, word in enumerate(words):
        try:
            times[i] = one(word)
        except (ValueError, OverflowError) as error:
            wrong[i] = str(error)
    return times, wrong


# --------------------------------------------------------------------------- many texts in one form, by Arrow


def _stamps(words: Sequence[str], zone: str, *, has_offsets: bool) -> Times | None:
    """UTC ns (N,) of time stamps as ISO 8601 has them, all with an offset or all without; None for others."""
    if not all(map(_ISO.match, words)):
        return None
    texts = pa.array(words, pa.string())
    found = None
    with suppress(pa.ArrowInvalid):
        found = _utc_of(_int64(texts.cast(pa.timestamp("ns"))), zone)
    with suppress(pa.ArrowInvalid):
        found = _int64(texts.cast(pa.timestamp("ns", "UTC"))) if found is None and has_offsets else found
    return found if found is not None and (found >= 0).all() else None


def _decimals(words: Sequence[str], digits: int) -> Times | None:
    """Ns (N,) of numbers, see `decimal_ns`; None unless all are some without spaces."""
    with suppress(pa.ArrowInvalid, UnicodeError):
        found = pa.array(words, pa.string()).cast(pa.decimal128(38, digits))
        low, high = np.frombuffer(found.buffers()[1], np.int64).reshape(-1, 2)[: len(words)].T
        return low.copy() if ((high == 0) & (low >= 0) & (low < 2**63 - WEEK_NS)).all() else None
    return None


def _int64(stamps: Any) -> Times:
    return np.array(stamps.cast(pa.int64()))


def _utc_of(local_ns: Times, zone: str) -> Times:
    """UTC ns (N,) of local times; the earlier ones of those that a change of the clock repeats."""
    quarters, at = np.unique(local_ns // _QUARTER_NS, return_inverse=True)  # changes are at quarters of an hour
    begin = (utc_from_ns(quarter * _QUARTER_NS).replace(tzinfo=ZoneInfo(zone)) for quarter in quarters.tolist())
    offsets = [(instant.utcoffset() or timedelta()) // timedelta(seconds=1) for instant in begin]
    return local_ns - np.array(offsets, np.int64)[at] * SECOND_NS
