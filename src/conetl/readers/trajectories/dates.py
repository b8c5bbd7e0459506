"""Dates and times of day without marks, and which of their numbers is the day."""

from __future__ import annotations

import re
from collections.abc import Iterable
from datetime import date
from itertools import pairwise

import numpy as np

from conetl.readers.trajectories.times import DAY_NS, DateOrder, clock_problem, parse_timestamp


def with_marks(text: str, order: DateOrder | None) -> str:
    """A date of 6 or 8 digits as 2026-03-02; any other text, or one whose order is unknown, as it is."""
    digits = text.strip()
    if order is None or not (digits.isascii() and digits.isdigit() and len(digits) in {6, 8}):
        return digits
    lengths = {"y": len(digits) - 4, "m": 2, "d": 2}
    ends = np.cumsum([0, *(lengths[part] for part in order)]).tolist()
    part = {name: digits[a:b] for name, (a, b) in zip(order, pairwise(ends), strict=True)}
    return f"{part['y'].rjust(4, '0') if len(part['y']) == 4 else '20' + part['y']}-{part['m']}-{part['d']}"


def with_colons(text: str) -> str:
    """A time of day of six digits, hhmmss.ss, with colons; any other text as it is."""
    return re.sub(r"^\s*(\d\d)(\d\d)(\d\d)(?!\d)", r"\1:\2:\3", text)


def date_order(texts: Iterable[str], day: date | None) -> DateOrder | None:
    """The only order in which dates such as 03/02/2026 or 260302 are since 2008 and not in the future, None for other texts.

    day: which the first of them is, if that is known. Raises ValueError where there are two, or none.
    """
    words = [re.split(r"[T ,]", text.strip())[0] for text in texts if text.strip()]
    words = [word for word in words if re.fullmatch(r"\d{6}|\d{8}|\d\d?[/-]\d\d?[/-]\d{4}", word, re.ASCII)]
    if not words:
        return None
    found: dict[tuple[int, ...], DateOrder] = {}
    orders: tuple[DateOrder, ...] = ("ymd", "dmy", "mdy")
    for order in orders:
        try:
            days = tuple(parse_timestamp(f"{with_marks(word, order)} 00:00:00", "UTC", order) for word in words)
        except ValueError:
            continue
        stated = day is None or days[0] == (day - date(1970, 1, 1)).days * DAY_NS
        if stated and not any(clock_problem(time_ns) for time_ns in days):
            found.setdefault(days, order)
    if len(found) == 1:
        return next(iter(found.values()))
    several = "may be read in two ways" if found else "is not one since 2008" if day is None else f"is not {day}"
    raise ValueError(
        f"the date {words[0]!r} {several}: put trajectory: {{date: 2024-02-07}}, the first day, into drive.yaml"
    )
