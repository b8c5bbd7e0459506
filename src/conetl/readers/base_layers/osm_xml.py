"""Nodes, ways and relations of an OSM XML file as arrays, a million nodes in about a second.

A call of Python for each element would take ten. But the text between two values repeats: `" lat="` is there for each node. So a
file is cut at its quotes, each different text between values is understood once, and values become numbers in arrays. Text that
is not as plain as programs write it (comments, both kinds of quotes, another encoding) is first rewritten by expat.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from conetl.files.documents import MAX_VALUES, XmlFile, input_errors, library_errors, require_few_refused, shown
from conetl.model.arrays import Bools, Floats, Ints
from conetl.model.errors import InputError

_OBJECTS = ("node", "way", "relation")
#: Elements in them, and in which.
_PARTS = {"tag": frozenset(_OBJECTS), "nd": frozenset({"way"}), "member": frozenset({"relation"})}
#: Objects begin here, so that a file can be cut into blocks of whole ones.
_BEGINNINGS = tuple(f"<{name} ".encode() for name in _OBJECTS)
_ROOT = re.compile(rb"\s*(?:<\?xml[^>]*\?>)?\s*<osm\b[^>]*?(/?)>")
_OTHER_ENCODING = re.compile(rb"<\?xml[^>]*encoding=.(?!utf-?8)", re.IGNORECASE)
#: Text before a value: the end of a tag, ends of elements and the beginning of the next one, if any; the name of the value.
_BEFORE = re.compile(rb"(?:\s*(/?>)\s*((?:</\w+\s*>\s*)*)<(\w+))?\s+([\w:.-]+)\s*=\s*")
_LAST = re.compile(rb"\s*(/?>)\s*((?:</\w+\s*>\s*)*)")
_ENTITY = re.compile(r"&(?:(\w+)|#(\d{1,9})|#x([\da-fA-F]{1,8}));", re.ASCII)
_QUOTES = (b'"', b"'")
#: In place of an id that is not a whole number.
NO_ID = -(2**63)
#: Parts of an object, and bytes of one.
_MOST_PARTS, _MOST_BYTES = 2000, 64_000_000


class OsmMap(NamedTuple):
    """Objects that are not deleted (JOSM: `action`, `visible`)."""

    node_ids: Ints
    """(N,) rising; of nodes that a file has twice the last one."""
    lon_lat_ele: Floats
    """(N, 3) degrees, metres; heights are NaN where the file has none."""
    has_local: bool
    """Whether nodes have the tag local_x."""
    ways: dict[int, tuple[Ints, dict[str, str]]]
    """Node ids and tags by way id."""
    lanelet_ways: frozenset[int]
    """Left and right members of relations of the type lanelet."""
    refused: list[str]


class _NotPlainError(Exception):
    """A text that has to be rewritten."""


def read_osm(path: Path) -> OsmMap:
    """Raises InputError where a file is not OSM XML."""
    try:
        return _map_of(path, _plain_blocks(path))
    except _NotPlainError:
        pass
    kinds = (expat.ExpatError, LookupError, _NotPlainError)  # LookupError: an unknown encoding
    not_osm = library_errors(f"{path}: is not OSM XML", *kinds, hint="; expected a Lanelet2 map")
    with not_osm, input_errors(path):
        return _map_of(path, _rewritten_blocks(path))


# --------------------------------------------------------------------------- blocks of whole objects


def _plain_blocks(path: Path) -> Iterator[bytes]:
    """The text between `<osm>` and `</osm>`, in blocks of whole objects. Raises _NotPlainError."""
    with input_errors(path), XmlFile(path) as file:
        rest = file.read().removeprefix(b"\xef\xbb\xbf")
        root = _ROOT.match(rest)
        if root is None or root[1] or _OTHER_ENCODING.match(rest):
            raise _NotPlainError
        rest = rest[root.end() :]
        while block := file.read():
            rest += block
            cut = max(map(rest.rfind, _BEGINNINGS))
            if cut > 0:
                yield rest[:cut]
                rest = rest[cut:]
            elif len(rest) > _MOST_BYTES:
                raise _NotPlainError
    body, end, after = rest.rpartition(b"</osm>")
    if not end or after.strip():
        raise _NotPlainError
    yield body


def _rewritten_blocks(path: Path) -> Iterator[bytes]:
    """The same, of any XML. Raises ExpatError, InputError."""
    parser, written, open_elements = expat.ParserCreate(), list[str](), list[str]()
    objects, others, marks = 0, 0, {'"': "&quot;"}

    def start(name: str, attributes: dict[str, str]) -> None:
        nonlocal objects, others
        inside = open_elements[-1] if open_elements else ""
        open_elements.append(name)
        if name in _OBJECTS and inside == "osm":
            objects += 1
        elif inside not in _PARTS.get(name, ()):
            others += 1
            if others > MAX_VALUES + _MOST_PARTS * objects:
                raise InputError(
                    f"{path}: is not OSM XML: {others:,} elements are no nodes or ways; expected a Lanelet2 map"
                )
            return
        values = "".join(f" {key}={quoteattr(value, marks)}" for key, value in attributes.items())
        written.append(f'<{name} _=""{values}>')

    def end(name: str) -> None:
        open_elements.pop()
        inside = open_elements[-1] if open_elements else ""
        if (name in _OBJECTS and inside == "osm") or inside in _PARTS.get(name, ()):
            written.append(f"</{name}>")

    parser.StartElementHandler, parser.EndElementHandler = start, end
    kept = ""
    with XmlFile(path) as file:
        while block := file.read():
            parser.Parse(block, False)
            text = kept + "".join(written)
            written.clear()
            cut = max(text.rfind(beginning.decode()) for beginning in _BEGINNINGS)
            kept = text[max(cut, 0) :]
            if cut > 0:
                yield text[:cut].encode()
        parser.Parse(b"", True)
    yield (kept + "".join(written)).encode()


# --------------------------------------------------------------------------- values of a block


class _Before(NamedTuple):
    """What the text before a value says."""

    tag_end: str
    """`/>` or `>` of the element before, empty within an element."""
    closed: tuple[str, ...]
    opened: str
    """Empty within an element."""
    key: str


class _Block(NamedTuple):
    """The values of a block, with the elements that have them."""

    values: pa.Array
    """(V,) strings."""
    kind: Ints
    """(V,) index of the pair of an element's name and a value's name in `kinds`."""
    kinds: dict[tuple[str, str], int]
    element: Ints
    """(V,) number of the element in the block."""
    owner: Ints
    """(V,) number of the object in the block."""

    def of(self, element: str, key: str) -> tuple[Ints, Ints, pa.Array]:
        """Objects, elements and strings of all values of this name."""
        at = np.flatnonzero(self.kind == self.kinds.get((element, key), -1))
        return self.owner[at], self.element[at], self.values.take(pa.array(at))


def _block_of(text: bytes, known: dict[bytes, _Before]) -> _Block | None:
    """None where a block has no values. Raises _NotPlainError."""
    data = np.frombuffer(b">" + text, np.uint8)  # as if it followed the name of the root
    _, quote = min((text.find(mark) % (len(text) + 1), mark) for mark in _QUOTES)  # the first; another is of a value
    is_quote = data == ord(quote)
    at = np.flatnonzero(is_quote)
    if len(at) % 2:
        raise _NotPlainError
    ends = np.concatenate([[0], at - np.arange(len(at)), [len(data) - len(at)]]).astype(np.int32)
    pieces = pa.Array.from_buffers(
        pa.binary(), len(ends) - 1, [None, pa.py_buffer(ends), pa.py_buffer(np.ascontiguousarray(data[~is_quote]))]
    )
    count = len(at) // 2
    between = pieces.take(pa.array(np.arange(0, 2 * count + 1, 2))).dictionary_encode()
    texts, codes = between.dictionary.to_pylist(), np.asarray(between.indices)
    if len(texts) > MAX_VALUES:
        raise _NotPlainError
    last = _understood(_LAST, texts[codes[-1]])
    if not count:
        if last.closed or last.tag_end == "/>":
            raise _NotPlainError
        return None
    codes = codes[:-1]
    used = np.flatnonzero(np.bincount(codes))
    understood = {code: known.setdefault(texts[code], _understood(_BEFORE, texts[code])) for code in used.tolist()}
    names = sorted({"osm", *(before.opened for before in understood.values())} - {""})
    keys = sorted({before.key for before in understood.values()})

    def per_code(value: Callable[[_Before], int]) -> Any:
        table = np.full(len(texts), -1)
        table[used] = [value(understood[code]) for code in used.tolist()]
        return table[codes]

    opened = per_code(lambda before: names.index(before.opened) if before.opened else -1)
    element = np.cumsum(opened >= 0) - 1
    if element[0] < 0:
        raise _NotPlainError
    element_name = opened[opened >= 0]
    is_object = np.isin(element_name, [names.index(name) for name in _OBJECTS if name in names])
    owner_of = np.cumsum(is_object) - 1
    object_name = element_name[is_object]
    root = names.index("osm")
    owner_name = np.where(owner_of >= 0, object_name[owner_of] if len(object_name) else root, root)
    # What is open before each text, and whether that fits to what it closes and opens.
    inside, owner = np.append(root, element_name[element][:-1]), np.append(root, owner_name[element][:-1])
    states = (codes * len(names) + inside) * len(names) + owner
    for state in np.flatnonzero(np.bincount(states)).tolist():
        rest, owned = divmod(state, len(names))
        _require_nested(understood[rest // len(names)], names[rest % len(names)], names[owned])
    _require_nested(last, names[element_name[element[-1]]], names[owner_name[element[-1]]])
    pairs = element_name[element] * len(keys) + per_code(lambda before: keys.index(before.key))
    kinds = {
        (names[pair // len(keys)], keys[pair % len(keys)]): pair for pair in np.flatnonzero(np.bincount(pairs)).tolist()
    }
    values = pieces.take(pa.array(np.arange(1, 2 * count, 2)))
    return _Block(values, pairs, kinds, element, owner_of[element])


def _understood(pattern: re.Pattern[bytes], text: bytes) -> _Before:
    match = pattern.fullmatch(text)
    if match is None:
        raise _NotPlainError
    end, closed, *rest = (group.decode() for group in match.groups(default=b""))
    return _Before(end, tuple(re.findall(r"\w+", closed)), *(rest or ("", "")))


def _require_nested(before: _Before, inside: str, owner: str) -> None:
    """Raise _NotPlainError unless a text closes what is open, and opens what may be there.

    inside: the element whose tag has not ended yet; owner: the object that it is, or is in.
    """
    stack = ["osm"] if inside == "osm" else ["osm", owner, inside] if inside in _PARTS else ["osm", inside]
    if not before.tag_end:
        if before.key and inside != "osm":
            return
        raise _NotPlainError
    if before.tag_end == "/>":
        stack.pop()
    for name in before.closed:
        if len(stack) < 2 or stack.pop() != name:
            raise _NotPlainError
    fits = stack == ["osm"] if before.opened not in _PARTS else len(stack) == 2 and stack[-1] in _PARTS[before.opened]
    if not fits or before.opened == "osm":
        raise _NotPlainError


# --------------------------------------------------------------------------- objects


class _Tags(NamedTuple):
    """Of the objects of a block."""

    owner: Ints
    keys: Ints
    """Index in `names`."""
    names: list[str]
    values: pa.Array

    def of(self, name: str) -> tuple[Ints, pa.Array]:
        """Objects and values of the tags of this name."""
        at = np.flatnonzero(self.keys == self.names.index(name)) if name in self.names else np.empty(0, np.int64)
        return self.owner[at], self.values.take(pa.array(at))


def _map_of(path: Path, blocks: Iterator[bytes]) -> OsmMap:
    nodes: list[tuple[Ints, Floats]] = [(np.empty(0, np.int64), np.empty((0, 3)))]
    ways: dict[int, tuple[Ints, dict[str, str]]] = {}
    lanelet_ways: set[int] = set()
    refused: list[str] = []
    known: dict[bytes, _Before] = {}
    has_local = False
    for block in filter(None, (_block_of(text, known) for text in blocks)):
        count, tags = int(block.owner[-1]) + 1, _tags(block)
        kept = np.ones(count, bool)
        for kind in _OBJECTS:
            for key, value in (("action", b"delete"), ("visible", b"false")):
                owner, _, texts = block.of(kind, key)
                kept[owner[np.asarray(pc.equal(texts, value))]] = False
        nodes.append(_nodes(block, tags, kept, refused))
        has_local |= "local_x" in tags.names
        ways |= _ways(block, tags, kept, refused)
        lanelet_ways |= _lanelet_ways(block, tags, kept)
        require_few_refused(path, refused)
    ids, places = (np.concatenate(parts) for parts in zip(*nodes, strict=True))
    nodes.clear()  # as large as both
    if not (np.diff(ids) > 0).all():
        order = np.argsort(ids, kind="stable")
        order = order[np.append(np.diff(ids[order]) > 0, True)]
        ids, places = ids[order], places[order]
    return OsmMap(ids, places, has_local, ways, frozenset(lanelet_ways), refused)


def _tags(block: _Block) -> _Tags:
    owner, element, keys = block.of("tag", "k")
    _, element_of_value, values = block.of("tag", "v")
    if not np.array_equal(element, element_of_value):
        _, a, b = np.intersect1d(element, element_of_value, return_indices=True)
        owner, keys, values = owner[a], keys.take(pa.array(a)), values.take(pa.array(b))
    different = keys.dictionary_encode()
    return _Tags(owner, np.asarray(different.indices), [*map(_text, different.dictionary.to_pylist())], values)


def _nodes(block: _Block, tags: _Tags, kept: Bools, refused: list[str]) -> tuple[Ints, Floats]:
    """Ids (N,) and longitudes, latitudes, heights (N, 3)."""
    owner, _, texts = block.of("node", "id")
    ids = _whole_numbers(texts)
    place = np.full((len(kept), 3), np.nan)
    for column, key in enumerate(("lon", "lat")):
        at, _, found = block.of("node", key)
        place[at, column] = _numbers(found)
    at, found = tags.of("ele")
    place[at, 2] = _numbers(found)
    good = np.isfinite(place[:, :2]).all(axis=1)
    good[at[~np.isfinite(place[at, 2])]] = False
    good = good[owner] & (ids != NO_ID)
    for row in np.flatnonzero(~good & kept[owner]).tolist():
        refused.append(f"node {shown(_text(texts[row].as_py()))}: id, longitude, latitude or height is not a number")
    good &= kept[owner]
    return ids[good], place[owner[good]]


def _ways(block: _Block, tags: _Tags, kept: Bools, refused: list[str]) -> dict[int, tuple[Ints, dict[str, str]]]:
    owner, _, texts = block.of("way", "id")
    ids = _whole_numbers(texts)
    for row in np.flatnonzero((ids == NO_ID) & kept[owner]).tolist():
        refused.append(f"way {shown(_text(texts[row].as_py()))}: its id is not a whole number")
    good = kept[owner] & (ids != NO_ID)
    tags_of: dict[int, dict[str, str]] = {one: {} for one in owner[good].tolist()}
    of_ways = np.flatnonzero(np.isin(tags.owner, owner[good]))
    values = tags.values.take(pa.array(of_ways)).to_pylist()
    for one, key, value in zip(tags.owner[of_ways].tolist(), tags.keys[of_ways].tolist(), values, strict=True):
        tags_of[one][tags.names[key]] = _text(value)
    way, _, references = block.of("nd", "ref")
    nodes = _whole_numbers(references)
    starts, ends = (np.searchsorted(way, owner[good], side=side).tolist() for side in ("left", "right"))
    return {
        identity: (nodes[start:end], own)
        for identity, own, start, end in zip(ids[good].tolist(), tags_of.values(), starts, ends, strict=True)
    }


def _lanelet_ways(block: _Block, tags: _Tags, kept: Bools) -> set[int]:
    owner, kinds = tags.of("type")
    lanelets = owner[np.asarray(pc.equal(kinds, b"lanelet"), bool)]
    member, element, references = block.of("member", "ref")
    _, element_of_role, roles = block.of("member", "role")
    is_side = np.asarray(pc.is_in(roles, pa.array([b"left", b"right"], pa.binary())), bool)
    used = np.isin(element, element_of_role[is_side]) & np.isin(member, lanelets) & kept[member]
    return set(_whole_numbers(references)[used].tolist())


def _whole_numbers(texts: pa.Array) -> Ints:
    """(N,) `NO_ID` where a text is none."""
    with suppress(pa.ArrowInvalid):
        return np.asarray(texts.cast(pa.string()).cast(pa.int64()))
    return np.array([_converted(text, int, NO_ID) for text in texts.to_pylist()], np.int64)


def _numbers(texts: pa.Array) -> Floats:
    """(N,) NaN where a text is none."""
    with suppress(pa.ArrowInvalid):
        return np.asarray(texts.cast(pa.string()).cast(pa.float64()))
    return np.array([_converted(text, float, np.nan) for text in texts.to_pylist()], np.float64)


def _converted(text: bytes, kind: Callable[[bytes], Any], none: Any) -> Any:
    try:
        value = kind(text)
    except ValueError:
        return none
    return value if abs(value) < 2**63 else none  # NaN is not


def _text(value: bytes) -> str:
    text = value.decode(errors="replace")
    return _ENTITY.sub(_character, text) if "&" in text else text


def _character(match: re.Match[str]) -> str:
    name, decimal, hexadecimal = match.groups()
    if name:
        return {"amp": "&", "lt": "<", "gt": ">", "quot": '"', "apos": "'"}.get(name, match[0])
    number = int(decimal or hexadecimal, 10 if decimal else 16)
    return chr(number) if number <= sys.maxunicode else match[0]
