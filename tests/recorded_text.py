"""Outputs as short lines of text that are the same in each run, recorded in files, and how two of them differ.

Ids that a run draws, hashes, its folder and its clock are replaced by names. Numbers are written with a digit more than anybody
needs and compared with a tolerance of one of these digits, so that another processor gives the same and a millimetre is seen.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime, timedelta
from enum import Enum
from functools import cache
from html.parser import HTMLParser
from itertools import zip_longest
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from matplotlib.collections import LineCollection, PathCollection
from matplotlib.figure import Figure
from matplotlib.text import Text

#: Numbers of these columns are degrees, in which a millimetre is in the eighth decimal.
_DEGREES = re.compile(r"lon|lat(?!e)|coordinates|bbox|centre_deg")
_FRACTION = re.compile(r"(?<![\w.:])-?\d+\.\d+(?:e[+-]?\d+)?(?![\w.])")
_UUID = re.compile(r"\b[0-9a-f]{8}-[0-9a-f]{4}-[0-9a-f]{4}-[0-9a-f]{4}-[0-9a-f]{12}\b")
#: What differs between two builds of the same source.
_BUILD = {"bytes", "seconds", "database", "code_version", "schema_version", "exported_at", "sha256"}
_LISTS = (list, tuple, np.ndarray)
_MOST_SHOWN = 12
#: Values of so many characters are written once in a file.
_LONG = 32
#: What a record of a table does not have.
MISSING = "."


def number(value: float, path: str = "") -> str:
    """To 0.1 mm in metres and degrees; small ones, such as sigmas and covariances, to five digits."""
    if not np.isfinite(value):
        return str(value)
    if _DEGREES.search(path) and 1 < abs(value) <= 180:
        return f"{value:.9f}"
    return f"{value:.4f}" if abs(value) >= 1 else f"{value:#.5g}" if abs(value) > 1e-12 else "0.0"


def scalar(value: Any, path: str = "") -> str:
    if isinstance(value, Enum):
        value = value.value
    if isinstance(value, bool) or value is None:
        return {True: "true", False: "false", None: "-"}[value]
    if isinstance(value, (float, np.floating)):
        return number(float(value), path)
    if isinstance(value, datetime):
        return value.astimezone(UTC).isoformat().replace("+00:00", "Z")
    if isinstance(value, (bytes, memoryview)):
        return f"{len(bytes(value))} bytes"
    return _rounded(str(value), path) or '""'


def _rounded(text: str, path: str = "") -> str:
    """Numbers with more digits than a person writes as `number` has them."""
    return _FRACTION.sub(lambda m: number(float(m[0]), path) if len(m[0].partition(".")[2]) > 9 else m[0], text)


def lines_of(value: Any, path: str = "") -> Iterator[str]:
    """Lines `path: value` of a document. A list of records is a table, each column a line, so that a difference is short."""
    if hasattr(value, "_asdict"):
        value = value._asdict()
    if isinstance(value, Mapping):
        for key, one in value.items():
            if str(key) not in _BUILD:
                yield from lines_of(one, f"{path}.{key}".lstrip("."))
    elif not isinstance(value, _LISTS):
        yield f"{path}: {scalar(value, path)}"
    elif len(value) and all(isinstance(one, Mapping) for one in value):
        for key in dict.fromkeys(key for one in value for key in one if key not in _BUILD):
            yield from _column([one.get(key, MISSING) for one in value], path, key)
    elif any(isinstance(one, (Mapping, *_LISTS)) and len(str(one)) > 200 for one in value):
        for index, one in enumerate(value):
            yield from lines_of(one, f"{path}[{index}]")
    else:
        yield f"{path}: {_inline(value, path)}"


def _column(values: Sequence[Any], path: str, key: str) -> Iterator[str]:
    """One column of a table: a line, or of records in it a table again."""
    values = [_record(one) for one in values]
    if all(len(one) < 2 for one in values if isinstance(one, list)) and any(isinstance(one, list) for one in values):
        values = [one[0] if isinstance(one, list) and one and isinstance(one[0], Mapping) else one for one in values]
    parts = [item for one in values if isinstance(one, _LISTS) for item in one]
    if any(isinstance(one, Mapping) for one in values):
        yield from lines_of([one if isinstance(one, Mapping) else {} for one in values], f"{path}[].{key}")
    elif any(isinstance(item, Mapping) for item in parts):
        for index, one in enumerate(values):
            if one and one != MISSING:
                yield from lines_of(one, f"{path}[{index}].{key}")
    else:
        yield f"{path}[].{key}: {_listed([_inline(one, key) for one in values])}"


def _record(value: Any) -> Any:
    """A list of keys and values as a record; all else as it is."""
    if (
        isinstance(value, list)
        and value
        and all(isinstance(one, Mapping) and one.keys() == {"key", "value"} for one in value)
    ):
        return {one["key"]: one["value"] for one in value}
    return value


def _listed(words: Sequence[str]) -> str:
    """Values of a column; equal ones once."""
    if len(words) > 1 and len(set(words)) == 1:
        return f"{len(words)} times {words[0]}"
    return " | ".join(words)


def _inline(value: Any, path: str) -> str:
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key} {_inline(one, f'{path}.{key}')}" for key, one in value.items()) + "}"
    if isinstance(value, _LISTS):
        return "[" + ", ".join(_inline(one, path) for one in value) + "]"
    return scalar(value, path)


def text_lines(text: str) -> Iterator[str]:
    """Lines without the spaces that depend on widths."""
    for line in text.splitlines():
        if short := _rounded(re.sub(r"\s{2,}", "  ", line).strip()):
            yield short


class _Visible(HTMLParser):
    """Text of a page by lines of tables and blocks."""

    _BLOCKS = frozenset(
        {
            "p",
            "div",
            "h1",
            "h2",
            "h3",
            "h4",
            "tr",
            "li",
            "figcaption",
            "section",
            "header",
            "footer",
            "dt",
            "title",
            "summary",
        }
    )

    def __init__(self) -> None:
        super().__init__()
        self.lines: list[str] = []
        self._parts: list[str] = []
        self._hidden = 0

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._hidden += tag in ("style", "script")
        if tag in self._BLOCKS:
            self.end_line()
        if tag == "img":
            self._parts.append(f"<image: {dict(attrs).get('alt') or ''}>")
        if tag in ("td", "th", "span", "br", "dd"):
            self._parts.append("|")

    def handle_endtag(self, tag: str) -> None:
        self._hidden -= tag in ("style", "script")
        if tag in self._BLOCKS:
            self.end_line()

    def handle_data(self, data: str) -> None:
        if not self._hidden:
            self._parts.append(data)

    def end_line(self) -> None:
        line = " ".join("".join(f" {part} " if part == "|" else part for part in self._parts).split()).lstrip("| ")
        self._parts = []
        if line:
            self.lines.append(line)


def page_lines(page: str) -> list[str]:
    """The visible text of an HTML page."""
    reader = _Visible()
    reader.feed(page)
    reader.end_line()
    return reader.lines


def xml_lines(text: str, *, once: bool = False) -> Iterator[str]:
    """The declaration, the namespaces, and elements with their attributes and text, each with its last two names. once: equal
    ones once."""

    def walk(element: ElementTree.Element, parent: str) -> Iterator[str]:
        name = element.tag.rpartition("}")[2]
        own = " ".join(f"{key.rpartition('}')[2]}={_rounded(value)}" for key, value in element.attrib.items())
        words = _rounded(" ".join((element.text or "").split()))
        if own or words:
            yield f"{parent}/{name}: {own} {words}".rstrip()
        for child in element:
            yield from walk(child, name)

    root = ElementTree.fromstring(text)
    yield text[: text.index(">") + 1] if text.startswith("<?xml") else "no declaration"
    yield "; ".join(sorted({element.tag.rpartition("}")[0].lstrip("{") for element in root.iter()}))
    lines = walk(root, "")
    yield from dict.fromkeys(lines) if once else lines


def osm_lines(text: str) -> Iterator[str]:
    """Nodes and ways of an OSM file as tables."""
    root = ElementTree.fromstring(text)
    for kind in ("node", "way", "relation"):
        found = [
            {
                **one.attrib,
                **{tag.get("k"): tag.get("v") for tag in one.iter("tag")},
                "refs": " ".join(nd.get("ref", "") for nd in one.iter("nd")),
            }
            for one in root.findall(kind)
        ]
        yield from lines_of(found, kind)


def figure_lines(figure: Figure) -> Iterator[str]:
    """What a figure shows: numbers of its lines, points and bars, and its texts."""

    def numbers(values: Any) -> str:
        return " ".join(f"{one:.3f}" for one in np.ravel(np.asarray(values, float))[:200])

    for axes in figure.axes:
        labels = (axes.get_title(), axes.get_xlabel(), axes.get_ylabel())
        yield f"axes: {' | '.join(labels)} | {numbers([*axes.get_xlim(), *axes.get_ylim()])}"
        for line in axes.get_lines():
            yield f"line {line.get_color()} {line.get_label()}: {numbers(line.get_xydata())}"
        for some in axes.collections:
            if isinstance(some, PathCollection):
                yield f"points: {numbers(some.get_offsets())}"
            elif isinstance(some, LineCollection):
                yield f"lines: {' / '.join(numbers(one) for one in some.get_segments())}"
        bars = [patch.get_height() for patch in axes.patches if hasattr(patch, "get_height")]
        if bars:
            yield f"bars: {numbers(bars)}"
        texts = [text for text in axes.findobj(Text) if text.get_text().strip() and text.get_visible()]
        yield f"texts: {' | '.join(' '.join(text.get_text().split()) for text in texts)}"


class Names:
    """Replaces what a run draws by names: ids, hashes, folders, the time of the run."""

    def __init__(self, ids: Mapping[str, str], words: Mapping[str, str], since: datetime) -> None:
        self._ids = dict(ids)
        self._short = {
            key[:8]: name for key, name in self._ids.items() if _UUID.fullmatch(key) and not key.startswith("0000")
        }
        self._words = dict(sorted(words.items(), key=lambda pair: -len(pair[0])))
        days = {f"{since + timedelta(days=k):%Y-%m-%d}" for k in range(2)}
        dashes = "|".join(days)
        plain = "|".join(day.replace("-", "") for day in days)
        self._now = re.compile(
            rf"(?:{dashes})(?:[T ]\d\d[:-]?\d\d(?:[:-]?\d\d(?:\.\d+)?)?)?(?:Z|\+00:00)?|(?:{plain})T\d+Z?"
        )

    def apply(self, text: str) -> str:
        for word, name in self._words.items():
            text = text.replace(word, name)
        text = re.sub(r"\(\d+ kB\)", "(<size>)", self._now.sub("<now>", text))
        text = re.sub(r"\b[0-9a-f]{64}\b", lambda found: self._ids.get(found[0], "<sha256>"), text)
        text = _UUID.sub(lambda found: self._ids.get(found[0], found[0][:8]), text)
        return re.sub(r"\b[0-9a-f]{8}\b", lambda found: self._short.get(found[0], found[0]), text)


@cache
def recorded(path: Path) -> dict[str, list[str]]:
    """Entry -> its lines, of a file."""
    sections = path.read_text(encoding="utf-8").split("\n### ")[1:] if path.exists() else []
    known: dict[str, str] = {}
    return {
        name: [_whole(line, known) for line in lines.splitlines()]
        for name, _, lines in (one.partition("\n") for one in sections)
    }


def write(path: Path, entries: Mapping[str, Sequence[str]]) -> None:
    """Renew a file."""
    path.parent.mkdir(exist_ok=True)
    known: dict[str, str] = {}
    text = "".join(
        f"\n### {name}\n" + "\n".join(_short(one, known) for one in lines) + "\n" for name, lines in entries.items()
    )
    path.write_text(text, encoding="utf-8")
    recorded.cache_clear()


def _mark(words: str) -> str:
    return f"@{hashlib.sha256(words.encode()).hexdigest()[:6]}"


def _short(line: str, known: dict[str, str]) -> str:
    """A line whose values stand in an earlier one of the file names them by a mark, which they have there."""
    key, _, words = line.partition(": ")
    if len(words) < _LONG:
        return line
    mark = _mark(words)
    if mark in known:
        return f"{key}: {mark}"
    known[mark] = words
    return line


def _whole(line: str, known: dict[str, str]) -> str:
    key, _, words = line.partition(": ")
    if words.startswith("@") and words in known:
        return f"{key}: {known[words]}"
    if len(words) >= _LONG:
        known[_mark(words)] = words
    return line


def differences(expected: Sequence[str], found: Sequence[str]) -> list[str]:
    """At most some lines that say where two outputs differ, each with the first differing words."""
    told = [one for pair in zip_longest(expected, found) if (one := _difference(*pair)) is not None]
    if len(expected) != len(found):
        lost, new = (
            [line for line in one if line not in set(other)] for one, other in ((expected, found), (found, expected))
        )
        told = [f"{len(expected)} lines expected, {len(found)} found"]
        told += [f"- {_cut(line)}" for line in lost] + [f"+ {_cut(line)}" for line in new]
    return told[:_MOST_SHOWN] + ([f"... {len(told) - _MOST_SHOWN} more"] if len(told) > _MOST_SHOWN else [])


def _difference(expected: str | None, found: str | None) -> str | None:
    if expected == found or expected is None or found is None:
        return None if expected == found else f"- {expected} + {found}"
    if _FRACTION.sub("#", expected) == _FRACTION.sub("#", found):
        pairs = zip(_FRACTION.findall(expected), _FRACTION.findall(found), strict=True)
        if all(_same(*pair) for pair in pairs):
            return None
    name = expected.partition(": ")[0] if ": " in expected else ""
    words = [re.split(r" \| | {2,}|, |\s", line) for line in (expected, found)]
    apart = [(k, *pair) for k, pair in enumerate(zip_longest(*words)) if pair[0] != pair[1] and not _near(*pair)]
    shown = "; ".join(f"[{k}] {a} -> {b}" for k, a, b in apart[:4])
    return f"{_cut(name, 60)}: {_cut(shown, 200)}" if apart else f"- {_cut(expected)}\n+ {_cut(found)}"


def _near(one: str | None, other: str | None) -> bool:
    both = one is not None and other is not None and _FRACTION.fullmatch(one) and _FRACTION.fullmatch(other)
    return bool(both) and _same(one or "", other or "")


def _same(one: str, other: str) -> bool:
    """Of two fractions: within one unit of the last digit of the longer one."""
    places = [len(text.partition("e")[0].partition(".")[2]) - int(text.partition("e")[2] or 0) for text in (one, other)]
    return abs(float(one) - float(other)) <= 1.01 * 10.0 ** -max(places)


def _cut(text: str, most: int = 160) -> str:
    return text if len(text) <= most else f"{text[:most]}..."


def json_lines(text: str) -> list[str]:
    return [*lines_of(json.loads(text))]
