"""Time stamps of drives, and which of them cannot be true."""

from __future__ import annotations

import re
import time
from bisect import bisect_left
from collections.abc import Mapping
from datetime import UTC, datetime
from statistics import median_low
from zoneinfo import ZoneInfo

EARLIEST_NS = 946_684_800_000_000_000
"""2000-01-01. A clock that was not set starts in 1970 or 1980; no drive is that old."""
MAX_AHEAD_NS = 86_400_000_000_000
"""A day: this computer's clock may be wrong, too, by a time zone."""
MAX_FROM_MEDIAN_NS = 86_400_000_000_000
"""A day: no drive is longer; a smaller error of a clock shows in the order of the frames or against the poses."""
_STAMP = re.compile(r"^\s*(\d{4})-(\d\d)-(\d\d)[ T](\d\d):(\d\d):(\d\d)(?:\.(\d{1,9}))?\s*(Z|[+-]\d\d:?\d\d)?\s*$")


def parse_timestamp(line: str, zone: str = "UTC") -> int:
    """UTC nanoseconds since 1970 of one line, `2011-09-26 13:04:32.345808896`, with an offset (Z, +01:00) or in a time zone.

    A time that is ambiguous because of a clock change is the earlier one. Raises ValueError.
    """
    match = _STAMP.match(line)
    if match is None:
        raise ValueError(f"expected a time stamp like 2011-09-26 13:04:32.345808896, found {line.strip()[:60]!r}")
    year, month, day, hour, minute, second = (int(part) for part in match.groups()[:6])
    offset = match.group(8)
    tz = datetime.strptime(offset, "%z").tzinfo if offset else ZoneInfo(zone)
    local = datetime(year, month, day, hour, minute, second, tzinfo=tz)
    try:
        seconds = int((local.astimezone(UTC) - datetime(1970, 1, 1, tzinfo=UTC)).total_seconds())
    except OverflowError:  # year 1 east of Greenwich, year 9999 west of it
        raise ValueError(f"expected a time from 2000 on, found {line.strip()[:60]!r}") from None
    return seconds * 1_000_000_000 + int((match.group(7) or "0").ljust(9, "0"))


def parse_timestamps(text: str, zone: str = "UTC") -> dict[int, int | str]:
    """Line number, from 0, -> UTC nanoseconds, or what is wrong with that line. Blank lines at the end do not count."""
    stamps: dict[int, int | str] = {}
    for number, line in enumerate(text.rstrip().splitlines()):
        try:
            stamps[number] = parse_timestamp(line, zone)
        except ValueError as error:
            stamps[number] = str(error)
    return stamps


def misplaced(stamps_ns: Mapping[int, int]) -> dict[int, str]:
    """What is wrong with the times of some frames, by number: the clock, else the order. To be put after "the time"."""
    wrong = wrong_clocks(stamps_ns)
    for number in out_of_order({number: stamp for number, stamp in stamps_ns.items() if number not in wrong}):
        wrong[number] = "does not rise with the order of recording"
    return wrong


def clock_problem(time_ns: int) -> str | None:
    """What is wrong with the clock of a time, None where nothing is. To be put after "the time"."""
    if time_ns < EARLIEST_NS:
        return "is before 2000: the clock was not set"
    if time_ns > time.time_ns() + MAX_AHEAD_NS:
        return "is more than a day in the future: another clock"
    return None


def wrong_clocks(stamps_ns: Mapping[int, int]) -> dict[int, str]:
    """Frames whose clock was not set, or is not that of most others; such stamps may rise nevertheless."""
    wrong = {n: problem for n, stamp in stamps_ns.items() if (problem := clock_problem(stamp))}
    others = {number: stamp for number, stamp in stamps_ns.items() if number not in wrong}
    if others:
        middle = median_low(others.values())
        for number, stamp in others.items():
            if abs(stamp - middle) > MAX_FROM_MEDIAN_NS:
                days = abs(stamp - middle) / MAX_FROM_MEDIAN_NS
                wrong[number] = f"is {days:.0f} days from most others of the drive: another clock"
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
