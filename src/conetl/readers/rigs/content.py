"""The content of a calibration file as one mapping, whatever its syntax, which is found by looking at the text.

YAML, also as OpenCV writes it (`%YAML:1.0`, tags of matrices, `data:[` without a space); JSON; XML; MATLAB's .mat; and lines, in
sections or not: `key: 1 2 3` (KITTI), `key=value` (ZED, Middlebury), or a name with the numbers below it (ROS's oST). Values are
not interpreted here: `Node` of common.py reads numbers from lists, texts and {rows, cols, data}.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from conetl.files.documents import MAX_DEPTH, encoding_of, library_errors, parse_json, parse_yaml, read_bytes, shown
from conetl.model.errors import InputError
from conetl.readers.rigs.matlab import is_mat, variables_of

_NUMBERS = r"(?:[ \t]+[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?)"
#: `[section]`, `key=value` or `key: 1 2` at the beginning of a line: none of them is YAML of a calibration.
_LINES = re.compile(rf"^[ \t]*(?:\[[A-Za-z][^\]\[=:,\n]*\]|\w+[ \t]*=.*|\w+:{_NUMBERS}{{2,}})[ \t]*$", re.MULTILINE)
_JSON = re.compile(r'\s*\{\s*["}]')
_NUMBER_LINE = re.compile(rf"{_NUMBERS}+")
_COMMENT = re.compile(r"(?:^|\s)[#;].*")
_YAML_HEADER = re.compile(r"^\s*%YAML[^\n]*\n")
#: Messages that are printed one after the other: the first one counts.
_DOCUMENTS, _CONTENT = re.compile(r"^---[ \t]*$", re.MULTILINE), re.compile(r"^[ \t]*[^#\s]", re.MULTILINE)
_MATRIX_TAG = re.compile(r"!!opencv-(nd-)?matrix")
_NO_SPACE = re.compile(r"^([ \t]*[\w.]+):(?=[\[{])", re.MULTILINE)
_DOTTED = {".nan": math.nan, ".inf": math.inf, "-.inf": -math.inf}
#: Of XML elements, each with two tags, or of keys with a sign behind them, lists or lines.
_MOST_KEYS = 100_000
#: The root of OpenCV's XML.
_OPENCV_ROOT = "opencv_storage"
_OF_PYTHON = (".npz", ".npy", ".pkl", ".pickle")
_UNKNOWN = "not a calibration that conetl knows"


def read_content(path: Path, *, of_lines: bool = False) -> Any:
    """A mapping of the file's keys; the root element of an XML file that is not OpenCV's. Raises InputError.

    of_lines: it must be `key: 1 2 3`.

    `cv2.FileStorage` is not used: a damaged file corrupts its memory (OpenCV 5.0).
    """
    data = read_bytes(path)
    if is_mat(data):
        return variables_of(path, data)
    if path.suffix.lower() in _OF_PYTHON:
        raise InputError(f"{path}: files of NumPy and pickle are not read: write M1, D1, M2, D2, R, T as JSON or YAML")
    with library_errors(f"{path}: this is not a text file", UnicodeDecodeError):
        text = data.decode(encoding_of([data])).replace("\r\n", "\n").replace("\r", "\n")
    is_xml, is_json = text.lstrip()[:1] == "<", _JSON.match(text)
    if text.count("<") / 2 + max(map(text.count, ":=[{\n")) > _MOST_KEYS:
        raise InputError(f"{path}: {_UNKNOWN}: expected at most {_MOST_KEYS:,} keys, elements, lists or lines")
    if of_lines or (_LINES.search(text) and not (is_xml or is_json)):
        return _of_lines(path, text)
    if is_xml:
        with library_errors(f"{path}: this is not XML", ElementTree.ParseError, ValueError):
            root = ElementTree.fromstring(text)
        if root.tag != _OPENCV_ROOT:
            return root
        content = _of_element(path, root, 0)
    elif is_json:
        content = parse_json(path, text)
    else:
        plain = _NO_SPACE.sub(r"\1: ", _MATRIX_TAG.sub("", _YAML_HEADER.sub("", text, count=1)))
        try:
            content = parse_yaml(path, next(filter(_CONTENT.search, _DOCUMENTS.split(plain)), ""))
        except InputError as error:
            if path.suffix.lower() in (".yaml", ".yml"):
                raise
            raise InputError(
                f"{path}: {_UNKNOWN}, found neither XML, JSON, YAML nor lines of keys and numbers"
            ) from error
    if not isinstance(content, Mapping):
        raise InputError(f"{path}: {_UNKNOWN}: expected keys and values, found {shown(content)}")
    with library_errors(f"{path}: nested too deeply", RecursionError):
        return {str(key): _plain(value) for key, value in content.items()}


def keys_of(content: Any, levels: int = 3) -> Iterator[str]:
    """The keys of a content, those of inner mappings after the outer ones with a dot; of XML the names of the outer elements."""
    if isinstance(content, ElementTree.Element):
        yield from (f"{content.tag}.{child.tag}" for child in content)
        return
    for key, value in content.items():
        if isinstance(value, Mapping) and value and "data" not in value and levels > 1:
            yield from (f"{key}.{inner}" for inner in keys_of(value, levels - 1))
        else:
            yield str(key)


def _of_element(path: Path, element: ElementTree.Element, depth: int) -> Any:
    """Elements as dictionaries by name, those named `_` as lists, their texts as they are."""
    if depth > MAX_DEPTH:
        raise InputError(f"{path}: nested too deeply")
    if len(element) == 0:
        return (element.text or "").strip().strip('"')
    if element[0].tag == "_":
        return [_of_element(path, child, depth + 1) for child in element]
    return {child.tag: _of_element(path, child, depth + 1) for child in element}


def _of_lines(path: Path, text: str) -> dict[str, Any]:
    """Texts by key; those of a section in a mapping of its own."""
    parts: dict[str, dict[str, list[str]]] = {"": {}}
    section, words = "", list[str]()
    for raw in text.split("\n"):
        line = _COMMENT.sub("", raw).strip()
        if line.startswith("[") and line.endswith("]"):
            section, words = line[1:-1].strip(), []
            parts.setdefault(section, {})
        elif words and _NUMBER_LINE.fullmatch(f" {line}"):
            words.append(line)  # below its name, or a matrix in several lines
        elif line:
            name, sign, value = re.match(r"([^=:]*)([=:]?)(.*)", line).groups()  # type: ignore[union-attr]
            key = name.strip()
            if key in parts[section]:
                raise InputError(f"{path}: {shown(f'{section}.{key}'.lstrip('.'))} is in the file twice")
            words = parts[section][key] = [value.strip() if sign else ""]
    for name in parts[""].keys() & parts.keys():
        raise InputError(f"{path}: {shown(name)} is in the file twice, as a key and as a section")
    found = {name: {key: " ".join(filter(None, words)) for key, words in part.items()} for name, part in parts.items()}
    return found.pop("") | found


def _plain(value: Any) -> Any:
    """A value of the file; matrices as `Node.numbers` reads them."""
    if isinstance(value, dict) and {"dt", "data"} <= value.keys():
        sizes = _words(value["sizes"]) if "sizes" in value else [value.get("rows"), value.get("cols")]
        channels = re.match(r"\d*", str(value["dt"]).strip())
        many = int(channels.group()[:2]) if channels and channels.group() else 1
        rows, *others = [int(str(n)) if str(n).isdecimal() and len(str(n)) < 9 else 0 for n in sizes] or [0]
        return {"rows": rows, "cols": math.prod(others) * many, "data": _words(value["data"])}
    if isinstance(value, dict):
        return {str(key): _plain(inner) for key, inner in value.items()}
    return _words(value) if isinstance(value, list) else value


def _words(value: Any) -> list[Any]:
    """The numbers of a list, or of a text of several; OpenCV writes NaN and infinity with a dot."""
    words = value if isinstance(value, list) else value.split() if isinstance(value, str) else [value]
    return [_DOTTED.get(word.lower(), word) if isinstance(word, str) else word for word in words]
