"""Time stamps of drives, and which of them cannot be true."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping
from statistics import median_low

from conetl.readers.trajectories.times import clock_problem, parse_timestamp

MAX_FROM_MEDIAN_NS = 86_400_000_000_000
"""A day: no drive is longer; a smaller error of a clock shows in the order of the frames or against the poses."""


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
