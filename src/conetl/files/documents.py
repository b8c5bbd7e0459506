"""YAML and JSON documents from untrusted sources: limits on size, depth and aliases; errors that name the keys of the file.

YAML files can be read as pydantic models: parameters, rules, settings of a drive, the description of a feed.
"""

from __future__ import annotations

import json
import reprlib
from codecs import BOM_UTF8, BOM_UTF16_BE, BOM_UTF16_LE, IncrementalDecoder, getincrementaldecoder
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from difflib import get_close_matches
from functools import partial
from io import BytesIO, FileIO
from pathlib import Path
from typing import Any, TypeVar, get_args

import yaml
from pydantic import BaseModel, ValidationError

from conetl.model.errors import ConetlError, InputError

Model = TypeVar("Model", bound=BaseModel)

#: The largest rig or parameter file is a hundredth of it.
MAX_YAML_BYTES = 256_000
MAX_JSON_BYTES = 5_000_000
#: Of a file with one line for each frame pair of a drive: those of eight hours at 10 Hz, and a row of a table for each.
MAX_TABLE_BYTES, MAX_TABLE_LINES = 32_000_000, 300_000
#: Of frame pairs that lost their images; more are of another drive, or their images were not copied.
MAX_LINES_WITHOUT_IMAGE = 10_000
#: Bytes of a line: on average, and those that are read.
_TABLE_LINE_BYTES, _MAX_TABLE_LINE = 300, 10_000
MAX_DEPTH = 40
#: Bytes of a block of XML, and for each tag of a document with content.
_XML_BLOCK, _LEAST_TAG_BYTES = 1_000_000, 10
#: Largest text of a map or its lines, of which some readers hold all.
MAX_TEXT_BYTES = 512 << 20
#: Values of a document, and of one in YAML: those behind aliases counted wherever they are used.
MAX_VALUES, MAX_YAML_VALUES = 100_000, 20_000
#: Digits of a number in YAML. The parser takes the square of their count, and reads 1:59:59 as one.
_MAX_DIGITS = 400
#: Records of a map that are left out, each with a message.
_MOST_REFUSED = 20_000
#: Characters of a value in a message, and of a message of a validator, which may quote one.
MAX_SHOWN, MAX_MESSAGE = 200, 400

#: pydantic's kind of an error -> what was expected; {} are the error's own figures.
_EXPECTED = {
    "missing": "is missing", "extra_forbidden": "unknown key", "invalid_key": "unknown key",
    "greater_than": "expected more than {gt}", "greater_than_equal": "expected at least {ge}",
    "less_than_equal": "expected at most {le}",
    "string_pattern_mismatch": "expected text that matches {pattern}",
    "string_too_long": "expected at most {max_length} characters",
    "string_too_short": "expected at least {min_length} characters",
    "string_unicode": "expected text in UTF-8", "string_type": "expected text", "path_type": "expected a path",
    "json_invalid": "expected JSON ({error})", "none_required": "expected nothing",
    "int_parsing_size": "expected a smaller number",
    "too_short": "expected at least {min_length} values, found {actual_length}",
    "too_long": "expected at most {max_length} values, found {actual_length}",
    "uuid_parsing": "expected an id like 1c223030-5d0f-4a7e-9a0d-0e4cf2a1b2c3",
    "url_parsing": "expected an address like https://example.org",
    **dict.fromkeys(("float_type", "float_parsing"), "expected a number"),
    **dict.fromkeys(("int_type", "int_parsing", "int_from_float"), "expected a whole number"),
    **dict.fromkeys(("bool_type", "bool_parsing"), "expected true or false"),
    **dict.fromkeys(("list_type", "tuple_type", "set_type"), "expected a list"),
    **dict.fromkeys(("dict_type", "model_type", "model_attributes_type", "mapping_type"), "expected keys and values"),
}  # fmt: skip
_TIME = "expected a time like 2026-03-02T10:00:00Z"
_DATE = "expected a date like 2026-03-02"

_short = reprlib.Repr()
_short.maxlevel, _short.maxdict, _short.maxlist = 2, 6, 6
_short.maxstring = _short.maxother = _short.maxlong = MAX_SHOWN


class _Loader(yaml.CSafeLoader):
    """Dates and times stay text, which says to which digit a time is known."""

    def construct_scalar(self, node: yaml.ScalarNode | yaml.MappingNode) -> Any:
        if len(node.value) > _MAX_DIGITS and node.tag.endswith((":int", ":float")):
            raise ValueError(f"a number has {len(node.value):,} characters")
        return super().construct_scalar(node)


_Loader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in resolvers if not tag.endswith(":timestamp")]
    for first, resolvers in yaml.CSafeLoader.yaml_implicit_resolvers.items()
}


def shown(value: object) -> str:
    """A value as error messages quote it: at most `MAX_SHOWN` characters."""
    try:
        text = _short.repr(value)
    except ValueError:  # more digits than Python converts
        return "a number of thousands of digits"
    return text if len(text) <= MAX_SHOWN else f"{text[: MAX_SHOWN - 3]}..."


def expectation(error: Any) -> str:
    """What one of `ValidationError.errors()` expected, without the value that was found."""
    kind, figures = str(error["type"]), error.get("ctx", {})
    if kind.startswith("datetime_"):
        return _TIME
    if kind.startswith("date_"):
        return _DATE
    if kind in _EXPECTED:
        plain = {name: f"{value:g}" if isinstance(value, float) else value for name, value in figures.items()}
        return _EXPECTED[kind].format(**plain)[:MAX_MESSAGE]
    text = str(error["msg"]).removeprefix("Value error, ").removeprefix("Assertion failed, ")
    return text.replace("Input should be", "expected", 1)[:MAX_MESSAGE]


def error_key(error: Any) -> str:
    """The key of one of `ValidationError.errors()`, with dots between the levels; empty if it concerns the whole file."""
    return ".".join(str(part) for part in error["loc"])[:MAX_SHOWN]


def first_message(error: ValueError) -> str:
    """The message of an error, or of the first error of a validation: `key: expected ..., found ...`."""
    if not isinstance(error, ValidationError):
        return str(error)
    first = error.errors()[0]
    key, wanted = error_key(first), expectation(first)
    text = f"{key}: {wanted}" if key else wanted
    complete = first["type"] in ("missing", "extra_forbidden", "value_error") or ", found " in wanted
    return text if complete else f"{text}, found {shown(first['input'])}"


def require_size(path: Path, max_bytes: int = MAX_TEXT_BYTES) -> None:
    """Raise InputError for a file that is larger, that cannot be read, or whose reader would wait for another program."""
    with input_errors(path):
        size, is_file = path.stat().st_size, path.is_file()
    if not is_file:
        raise InputError(f"{path}: expected a file, found a folder, a pipe or a device")
    if size > max_bytes:
        raise InputError(f"{path} has {size:,} bytes, expected at most {max_bytes:,}: import it in parts")


def require_few_features(path: Path, most: int) -> None:
    """Raise InputError for a GeoJSON file of more features, which GDAL would first read, or larger than a text may be."""
    require_size(path)
    with input_errors(path), path.open("rb") as file:
        count = sum(block.count(b'"Feature"') for block in iter(partial(file.read, 1 << 20), b""))
    if count > most:
        raise InputError(f"{path} has more than {most:,} features: import it in parts")


def require_few_refused(path: Path, refused: Sequence[str]) -> None:
    """Raise InputError for more records of a file that cannot be used than anyone would read about."""
    if len(refused) > _MOST_REFUSED:
        raise InputError(f"{path}: more than {_MOST_REFUSED:,} of its records cannot be used; the first: {refused[0]}")


class XmlFile(FileIO):
    """A large XML file, read in large blocks: expat parses an unfinished tag again with every block."""

    def __init__(self, path: Path, max_bytes: int = MAX_TEXT_BYTES) -> None:
        require_size(path, max_bytes)
        super().__init__(path)
        self._tags = self._open = self._bytes = 0

    def read(self, size: int | None = -1, /) -> bytes:
        """The next block, whatever size is requested. Raises ValueError if it is not of a document with content: of a whole block
        without a tag, many elements that are not closed, or hardly more than tags."""
        block = bytes(super().read(_XML_BLOCK))
        tags = block.count(b"<")
        self._tags, self._bytes = self._tags + tags, self._bytes + len(block)
        self._open += tags - 2 * block.count(b"</") - block.count(b"/>")
        if len(block) == _XML_BLOCK and not tags:
            raise ValueError(f"expected XML, found {_XML_BLOCK:,} bytes without a tag")
        if self._open > MAX_VALUES or self._tags > MAX_VALUES + self._bytes // _LEAST_TAG_BYTES:
            raise ValueError(
                f"{self._tags:,} tags in {self._bytes:,} bytes, or {MAX_VALUES:,} elements that are not closed"
            )
        return block


@contextmanager
def input_errors(source: object) -> Iterator[None]:
    """Turn OSErrors and ValueErrors of the block into InputErrors that name the file or folder that was read."""
    try:
        yield
    except OSError as error:
        raise InputError(f"{source}: cannot be read ({error.strerror})") from error
    except ValueError as error:
        raise InputError(f"{source}: {first_message(error)}") from error


@contextmanager
def library_errors(problem: str, *kinds: type[Exception], hint: str = "") -> Iterator[None]:
    """Turn errors of a library or the system into InputErrors: `problem (their message in one line, or their type)hint`.

    kinds: their types; without any all errors except conetl's own, as many libraries raise anything for a damaged file.
    """
    try:
        yield
    except Exception as error:
        if isinstance(error, ConetlError) or not isinstance(error, kinds or Exception):
            raise
        words = str(getattr(error, "strerror", None) or error).split() or [type(error).__name__]
        raise InputError(f"{problem} ({' '.join(words)[:MAX_SHOWN].rstrip('.')}){hint}") from error


def read_bytes(path: Path, max_bytes: int = MAX_JSON_BYTES) -> bytes:
    """Bytes of a small file. Raises InputError if it is larger than the limit, or cannot be read."""
    local = isinstance(path, Path)  # errors of an object's storage are its reader's
    with input_errors(path) if local else nullcontext(), path.open("rb") as file:
        content = file.read(max_bytes + 1)
    if len(content) > max_bytes:
        raise InputError(f"{path}: expected at most {max_bytes:,} bytes")
    return content


def encoding_of(blocks: Iterable[bytes]) -> str:
    """Encoding of a text: UTF-8; UTF-16 if its mark says so; else Windows-1252, in which spreadsheets write.

    blocks: its bytes in order. Raises UnicodeDecodeError for bytes that are none of them.
    """
    decoder: IncrementalDecoder = getincrementaldecoder("utf-8")()
    found = "utf-8-sig"
    for number, block in enumerate(blocks):
        if number == 0 and block.startswith((BOM_UTF16_LE, BOM_UTF16_BE)):
            return "utf-16"
        try:
            decoder.decode(block)
        except UnicodeDecodeError:
            if b"\0" in block or found == "cp1252":
                raise
            decoder, found = getincrementaldecoder("cp1252")(), "cp1252"
            decoder.decode(block)
    return found


def read_table_bytes(path: Path, images: int | None = None) -> bytes:
    """Bytes of a file with one line for each frame pair. Raises InputError if it is too large, or cannot be read.

    images: their number, where each line more is a rejection.
    """
    most, most_bytes = MAX_TABLE_LINES, MAX_TABLE_BYTES
    if images is not None:
        most = images + MAX_LINES_WITHOUT_IMAGE
        most_bytes = most * _TABLE_LINE_BYTES
    content = read_bytes(path, max(most_bytes, MAX_TABLE_BYTES))
    if max(map(content.count, (b"\n", b"\r"))) > most or len(content) > most_bytes:
        hint = "" if images is None else ": copy the other images, or remove their lines"
        raise InputError(f"{path}: expected at most {most:,} lines, one for each frame pair{hint}")
    return content


def table_lines(content: bytes) -> Iterator[str]:
    """The lines of such a file, one in memory at a time: text in UTF-8, with their ends."""
    content = (content if b"\n" in content else content.replace(b"\r", b"\n")).removeprefix(BOM_UTF8)
    return (line[:_MAX_TABLE_LINE].decode(errors="replace") for line in BytesIO(content))


def read_limited(path: Path, max_bytes: int = MAX_JSON_BYTES) -> str:
    """UTF-8 text of a small file. Raises InputError if it is larger than the limit, is not text, or cannot be read."""
    with library_errors(f"{path}: this is not a text file", UnicodeDecodeError):
        return read_bytes(path, max_bytes).decode("utf-8-sig")


def read_yaml(path: Path) -> Any:
    """Content of a YAML file. Raises InputError where it is not YAML, exceeds a limit or cannot be read."""
    return parse_yaml(path, read_limited(path, MAX_YAML_BYTES))


def parse_yaml(source: object, text: str) -> Any:
    """Content of a text in YAML, of a file or an option. Raises InputError where it is not YAML or exceeds a limit."""
    with library_errors(f"{source}: this is not YAML"):  # values whose tag does not fit raise anything
        _require_bounded(source, text)
        return yaml.load(text, Loader=_Loader)


def read_yaml_model(path: Path | None, model: type[Model], what: str) -> Model:
    """The values of a YAML file as a model; the model's defaults if there is no file, or it is empty.

    what: the kind of file in messages. Raises InputError naming the file, the key and what was expected.
    """
    return model() if path is None else validated(read_yaml_mapping(path, what), model, f"{what} {path}")


def read_yaml_mapping(path: Path, what: str, example: str = "") -> dict[str, Any]:
    """Keys and values of a YAML file, none if it is empty. Raises InputError."""
    content = read_yaml(path)
    if content is None:
        return {}
    if not isinstance(content, dict):
        hint = f", for example:{example}" if example else ""
        raise InputError(f"{what} {path}: expected keys and values{hint}")
    return {str(key): value for key, value in content.items()}


def validated(values: Mapping[str, Any], model: type[Model], name: str) -> Model:
    """Values as a model. Raises InputError that starts with `name` and states the wrong value and what was expected."""
    try:
        return model.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        if first["type"] != "extra_forbidden":
            raise InputError(f"{name}: {first_message(error)}") from error
        known = _fields_at(model, first["loc"][:-1])
        near = get_close_matches(str(first["loc"][-1]), known, n=1)
        hint = f"did you mean {near[0]}?" if near else f"known are {', '.join(known)}"
        raise InputError(f"{name}: {first_message(error)}; {hint}") from error


def _fields_at(model: type[BaseModel], path: tuple[int | str, ...]) -> list[str]:
    """Names of the fields of the nested model at `path`."""
    for part in path:
        inner = nested_model(model.model_fields[str(part)].annotation)
        if inner is None:
            return []
        model = inner
    return list(model.model_fields)


def nested_model(annotation: Any) -> type[BaseModel] | None:
    """The model that the values of a field are, or may be."""
    kinds = (annotation, *get_args(annotation))
    return next((kind for kind in kinds if isinstance(kind, type) and issubclass(kind, BaseModel)), None)


def read_json(path: Path) -> Any:
    """Content of a JSON file. Raises InputError where it is not JSON, exceeds a limit or cannot be read."""
    return parse_json(path, read_limited(path))


def parse_json(source: object, text: str) -> Any:
    """Content of a text in JSON. Raises InputError where it is not JSON or nested too deeply."""
    too_deep = library_errors(f"{source}: nested too deeply", RecursionError)
    with too_deep, library_errors(f"{source}: this is not JSON", ValueError):
        return json.loads(text)


def _require_bounded(source: object, text: str) -> None:
    """Count depth and values from the parser's events, before anything is built."""
    sizes: dict[str, int] = {}
    open_nodes: list[tuple[str | None, int]] = [(None, 0)]  # anchor, values before it
    values = 0
    for event in yaml.parse(text, Loader=yaml.CSafeLoader):
        if isinstance(event, yaml.AliasEvent):
            values += sizes.get(str(event.anchor), MAX_YAML_VALUES)  # an alias to a node around it has no end
        elif isinstance(event, yaml.CollectionStartEvent):
            open_nodes.append((event.anchor, values))
            values += 1
        elif isinstance(event, yaml.CollectionEndEvent):
            anchor, before = open_nodes.pop()
            if anchor:
                sizes[anchor] = values - before
        elif isinstance(event, yaml.ScalarEvent):
            values += 1
            if event.anchor:
                sizes[event.anchor] = 1
        if len(open_nodes) > MAX_DEPTH or values > MAX_YAML_VALUES:
            line = event.start_mark.line + 1 if event.start_mark else 1
            raise InputError(
                f"{source}: line {line} exceeds {MAX_YAML_VALUES:,} values (each alias counts as what it refers "
                f"to) or {MAX_DEPTH} levels"
            )
