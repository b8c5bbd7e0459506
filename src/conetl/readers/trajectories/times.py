"""Times of trajectories and images -> exact UTC nanoseconds since 1970: texts, seconds since 1970 or 1980, of a GPS week or of a
day, names of images such as `20260302_104107_250`, `left_20260302T104107.250Z`, `1772444467_250`; and which of them cannot be
true.

GPS time has no leap seconds: it was equal to UTC on 1980-01-06 and is ahead of it by one second for each that UTC has had since
(IS-GPS-200; IERS Bulletin C). Within a leap second, whose nanoseconds UTC counts twice, times repeat those of the second after.
"""

from __future__ import annotations

import re
import time
from bisect import bisect_left
from collections.abc import Container, Iterable, Mapping, Sequence
from datetime import UTC, datetime, tzinfo
from decimal import ROUND_DOWN, Context, Decimal, InvalidOperation
from functools import lru_cache
from itertools import pairwise
from statistics import median_low
from typing import Literal
from zoneinfo import ZoneInfo

import numpy as np
from numpy.typing import NDArray

from conetl.model.base import ns_from_utc

Times = NDArray[np.int64]
Stamps = dict[int, int | str]
DateOrder = Literal["ymd", "dmy", "mdy"]

SECOND_NS = 1_000_000_000
DAY_NS = 86_400 * SECOND_NS
WEEK_NS = 7 * DAY_NS
EARLIEST_NS = 1_199_145_600_000_000_000
"""2008-01-01. A clock that was not set starts in 1970 or 1980, and a receiver whose GPS week rolled over after 1024 weeks dates
what it records until August 2027 before this; no drive is that old."""
MAX_AHEAD_NS = DAY_NS
"""A day: this computer's clock may be wrong, too, by a time zone."""
MAX_FROM_MEDIAN_NS = 16 * 3600 * SECOND_NS
"""A drive may rest for half a day, but what was recorded the next morning is another one, with cones that were moved meanwhile. A
smaller error of a clock shows in the order of the frames or against the poses."""
GPS_EPOCH_NS = 315_964_800 * SECOND_NS
"""1980-01-06 00:00 UTC."""
#: Days that began after a leap second (IERS Bulletin C). No library: those that we found read a file of this computer or of the
#: internet, or are as long as this list.
_AFTER_LEAP_SECONDS = (
    "1981-07-01", "1982-07-01", "1983-07-01", "1985-07-01", "1988-01-01", "1990-01-01", "1991-01-01", "1992-07-01", "1993-07-01",
    "1994-07-01", "1996-01-01", "1997-07-01", "1999-01-01", "2006-01-01", "2009-01-01", "2012-07-01", "2015-07-01", "2017-01-01",
)  # fmt: skip
_LEAPS_UTC_NS = np.array(_AFTER_LEAP_SECONDS, "datetime64[ns]").astype(np.int64)
#: The same instants counted in GPS time.
_LEAPS_GPS_NS = _LEAPS_UTC_NS + SECOND_NS * np.arange(1, len(_LEAPS_UTC_NS) + 1)
#: More digits than any time has in ns.
_TRUNCATED = Context(prec=40, rounding=ROUND_DOWN)
#: Ends a time of the day that states its offset from UTC.
OFFSET = re.compile(r"(?:Z|UTC|:\d\d(?:\.\d*)?[+-]\d\d(?::?\d\d)?)\s*$")
_STAMP = re.compile(
    r"\s*(\d{1,4})([-/.])(\d{1,2})\2(\d{1,4})(?:T|[ ,]\s*)(\d\d?):(\d\d):(\d\d)(?:[.,](\d+))?\s*(Z|UTC|[+-]\d\d(?::?\d\d)?)?\s*",
    re.ASCII,
)

#: Text, the time, text that begins with a letter. 14 digits, in groups or not, are a date and time since 2000, else 10 are
#: seconds since 1970, from 2008 on.
_NAME = re.compile(
    r"(?:.*\D)?(?:(20\d\d)([-_.]?)([01]\d)\2([0-3]\d)[-_. T]*([0-2]\d)([-_.:]?)([0-5]\d)\6([0-5]\d)|(1[2-9]\d{8}))"
    r"(?:([-_.,]?)(\d+))?(Z|\+\d{4})?(?:[-_. ]*[A-Za-z].*)?",
    re.ASCII,
)
#: Digits of ms, us and ns.
_WHOLE_UNITS = frozenset({3, 6, 9})


def clock_problem(time_ns: int, earliest_ns: int = EARLIEST_NS) -> str | None:
    """What is wrong with the clock of a time, None where nothing is; it continues a sentence that begins with "the time"."""
    if time_ns < earliest_ns:
        year = np.datetime64(earliest_ns, "ns").astype("datetime64[Y]")
        return f"is before {year}: the clock was not set, or its GPS week rolled over (1024 weeks too early)"
    if time_ns > time.time_ns() + MAX_AHEAD_NS:
        return "is more than a day in the future: the clock was wrong"
    return None


def misplaced(stamps_ns: Mapping[int, int]) -> dict[int, str]:
    """What is wrong with the times of some frames, by number: the clock, else the order; as `clock_problem`."""
    wrong = wrong_clocks(stamps_ns)
    for number in out_of_order({number: stamp for number, stamp in stamps_ns.items() if number not in wrong}):
        wrong[number] = "is not in the order of recording"
    return wrong


def wrong_clocks(stamps_ns: Mapping[int, int]) -> dict[int, str]:
    """Frames whose clock was not set, or is not that of most others; such stamps may rise nevertheless."""
    wrong = {n: problem for n, stamp in stamps_ns.items() if (problem := clock_problem(stamp))}
    others = {number: stamp for number, stamp in stamps_ns.items() if number not in wrong}
    if others:
        middle = median_low(others.values())
        apart = {n: abs(stamp - middle) for n, stamp in others.items() if abs(stamp - middle) > MAX_FROM_MEDIAN_NS}
        ends = f"{min(apart, default=0)} to {max(apart, default=0)}"
        for number, apart_ns in apart.items():
            wrong[number] = f"is {apart_ns / DAY_NS:.1f} days from most other times of the drive: the clock was wrong"
            if len(apart) > 1:
                wrong[number] += (
                    f", or frame pairs {ends} are of another recording: split them into folders of their own"
                )
    return wrong


def out_of_order(stamps_ns: Mapping[int, int]) -> set[int]:
    """Frame numbers whose time does not fit their order: the fewest without which the other times rise strictly.

    By a longest strictly increasing subsequence, so that one wild stamp costs its own frame and not all that follow.
    """
    numbers = sorted(stamps_ns)
    tails: list[int] = []
    tail_at: list[int] = []
    before: dict[int, int | None] = {}
    for number in numbers:
        end = bisect_left(tails, stamps_ns[number])
        before[number] = tail_at[end - 1] if end else None
        tails[end : end + 1] = [stamps_ns[number]]
        tail_at[end : end + 1] = [number]
    keep: set[int] = set()
    at = tail_at[-1] if tail_at else None
    while at is not None:
        keep.add(at)
        at = before[at]
    return set(numbers) - keep


def gps_to_utc(gps_ns: Times) -> Times:
    """UTC nanoseconds since 1970 (N,) of GPS times (N,), counted as nanoseconds since 1970 without leap seconds."""
    leaps = np.searchsorted(_LEAPS_GPS_NS, gps_ns, side="right")
    return np.asarray(gps_ns - SECOND_NS * leaps, dtype=np.int64)


def parse_timestamp(text: str, zone: str = "UTC", order: DateOrder | None = None) -> int:
    """UTC nanoseconds since 1970 of a text such as `2011-09-26 13:04:32.345808896`, with an offset (Z, +01:00) or in a time zone.

    Years first with -, / or . between; years last with points (26.09.2011), else only where `order` says what is the month.
    A time that is ambiguous because of a clock change is the earlier one. Raises ValueError.
    """
    match = _STAMP.fullmatch(text)
    if match is None:
        raise ValueError(f"expected a time stamp like 2011-09-26 13:04:32.345, found {text.strip()[:60]!r}")
    first, mark, middle, last, hour, minute, second, fraction, offset = match.groups()
    if len(first) == 4:
        year, month, day = first, middle, last
    elif len(last) == 4 and (mark == "." or order):
        year, month, day = (last, first, middle) if order == "mdy" else (last, middle, first)
    else:
        raise ValueError(
            f"the date of {text.strip()[:60]!r} may be read in two ways; expected the year first, or 26.09.2011"
        )
    if int(second) > 59:
        raise ValueError(f"the seconds of {text.strip()[:60]!r} are above 59")
    return _whole_ns(year, month, day, hour, minute, second, offset or zone) + int((fraction or "")[:9].ljust(9, "0"))


@lru_cache(maxsize=1000)  # of the same second are several frames
def _whole_ns(year: str, month: str, day: str, hour: str, minute: str, second: str, zone: str) -> int:
    """UTC nanoseconds of a whole second in a time zone, or at an offset from UTC. Raises ValueError."""
    tz: tzinfo | None = UTC if zone == "Z" else None
    if tz is None:
        tz = datetime.strptime(zone.ljust(5, "0"), "%z").tzinfo if zone[0] in "+-" else ZoneInfo(zone)
    instant = datetime(int(year), int(month), int(day), int(hour), int(minute), int(second), tzinfo=tz)
    if not 1970 <= instant.year < 2262:  # 64 bits of nanoseconds end in 2262
        raise ValueError(f"expected a time from 2000 to 2261, found {instant.date()}")
    return ns_from_utc(instant)


def parse_timestamps(lines: Iterable[str], zone: str = "UTC", wanted: Container[int] | None = None) -> Stamps:
    """Line number, from 0, -> UTC nanoseconds, or what is wrong with that line. Blank lines at the end do not count.

    wanted: numbers of lines; None for all.
    """
    count = 0
    found: Stamps = {}
    for number, line in enumerate(lines):
        if wanted is None or number in wanted:
            found[number] = stamp_or_problem(line, zone)
        count = count if line.isspace() else number + 1
    return {number: stamp for number, stamp in found.items() if number < count}


def stamp_or_problem(text: str, zone: str) -> int | str:
    """UTC nanoseconds of a time stamp, or what is wrong with it."""
    try:
        return parse_timestamp(text, zone)
    except ValueError as error:
        return str(error)


def decimal_ns(text: str, digits: int = 9) -> int:
    """Nanoseconds of a number of seconds (digits 9), ms (6), us (3) or ns (0), without rounding; digits below 1 ns are dropped.

    Raises ValueError unless it is between 0 and 2**63 ns.
    """
    try:
        value = Decimal(text)
        # The exponent is checked before 10**exponent is computed.
        if not value.is_finite() or value < 0 or value.adjusted() > 20:
            raise ValueError
        ns = int(value.scaleb(digits, _TRUNCATED))
    except (InvalidOperation, ValueError):
        raise ValueError(f"{text.strip()[:40]!r} is not a time; expected a number above 0") from None
    if ns >= 2**63 - WEEK_NS:
        raise ValueError(f"{text.strip()[:40]!r} is not a time: it is too large")
    return ns


def times_of_names(stems: Sequence[str]) -> tuple[list[str], str | None]:
    """Names of consecutive images with those that are times as `parse_timestamp` or `decimal_ns` read them; and what makes it
    doubtful that they are the times of the images."""
    texts, seconds, fractions = [*stems], dict[int, str](), dict[int, tuple[str, str]]()
    for n, stem in enumerate(stems):
        if (match := _NAME.fullmatch(stem)) is None:
            continue
        year, _, month, day, hour, _, minute, second, since_1970, mark, fraction, offset = match.groups(default="")
        seconds[n] = since_1970 or f"{year}-{month}-{day} {hour}:{minute}:{second}"
        fractions[n] = mark, fraction
        texts[n] = f"{seconds[n]}{'.' * bool(fraction)}{fraction}{offset}"
    problem = _doubt([*fractions.values()])
    return texts, problem and next(f"{stems[n]}: {text}{problem}" for n, text in seconds.items())


def _doubt(fractions: Sequence[tuple[str, str]]) -> str | None:
    """Why the digits after the seconds are no fraction of them. fractions: their mark and digits, by image."""
    if fractions and not any(digits for _, digits in fractions):
        return ", but whole seconds: when in this second is unknown"
    lengths = sorted({len(digits) for mark, digits in fractions if mark != "."})
    if len(lengths) > 1 or not _WHOLE_UNITS.issuperset(lengths):
        return f", then numbers of {' or '.join(map(str, lengths))} digits; read are 3, 6 or 9 digits for all images"
    numbers = [int(digits) for mark, digits in fractions if mark in {"_", "-"}]
    if sum(0 < b - a < 10 for a, b in pairwise(numbers)) > len(numbers) // 2:
        return ", then numbers that count the images"
    return None
