"""Names of images that are times, such as `20260302_104107_250`, `left_20260302T104107.250Z`, `1772444467_250`."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import pairwise

#: Text, the time, text that begins with a letter. 14 digits, in groups or not, are a date and time since 2000, else 10 are
#: seconds since 1970, from 2008 on.
_NAME = re.compile(
    r"(?:.*\D)?(?:(20\d\d)([-_.]?)([01]\d)\2([0-3]\d)[-_. T]*([0-2]\d)([-_.:]?)([0-5]\d)\6([0-5]\d)|(1[2-9]\d{8}))"
    r"(?:([-_.,]?)(\d+))?(Z|\+\d{4})?(?:[-_. ]*[A-Za-z].*)?",
    re.ASCII,
)
#: Digits of ms, us and ns.
_WHOLE_UNITS = frozenset({3, 6, 9})


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
