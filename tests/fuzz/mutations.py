"""Mutations of a file's bytes: what damaged copies, wrong tools and hostile authors make of it."""

from __future__ import annotations

import random
import re
import zlib
from collections.abc import Callable

_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
_WORD = re.compile(rb"[A-Za-z_]{2,}")
NUMBERS = (
    b"0", b"-1", b"1e308", b"-1e308", b"1e-308", b"nan", b"inf", b"-inf", b"1.5e9", b"99999999999999999999", b"2147483648",
    b"-9223372036854775809", b"9" * 400, b"9" * 5000, b"0x1F", b"1_000", b"\xd9\xa3", b"", b"null", b"true", b"[]", b"{}", b"'a'",
)  # fmt: skip
TEXTS = (
    b"A" * 5000, b"\0", b"\xff\xfe", b"\xed\xa0\x80", "\u202e\u0661".encode(), b"../../etc/passwd",
    b"&a [*a]", b"!!python/name:os",
    b"<![CDATA[", b"%YAML:1.0", b"\r", b'"', b",", b":", b"{", b"]", b"\n\n", b"<", b"&lt;", b"-0", b"1970-01-01T00:00:00Z",
    b"2099-01-01T00:00:00Z", b"0001-01-01T00:00:00+14:00", b"9999-12-31T23:59:59-14:00", b"24:61:61",
)  # fmt: skip
OPENERS = (b"[", b"{", b"{a: ", b"- ", b'{"a":', b"<a>", b'[{"a":', b"(", b"? ")


def _at(rng: random.Random, data: bytes) -> int:
    return rng.randint(0, len(data))


def _run(rng: random.Random, data: bytes, longest: int = 400) -> tuple[int, int]:
    start = _at(rng, data)
    return start, min(len(data), start + rng.choice((1, 2, 4, 8, rng.randint(1, longest))))


def flip_bits(rng: random.Random, data: bytes) -> bytes:
    changed = bytearray(data)
    for _ in range(rng.choice((1, 1, 3, 20)) if data else 0):
        changed[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def overwrite(rng: random.Random, data: bytes) -> bytes:
    start, end = _run(rng, data)
    fill = rng.choice((b"\0", b"\xff", b"\x7f", b" ", rng.randbytes(1)))
    return data[:start] + (fill * (end - start) if rng.random() < 0.7 else rng.randbytes(end - start)) + data[end:]


def set_integer(rng: random.Random, data: bytes) -> bytes:
    """A whole number of 1 to 8 bytes, as counts and offsets of binary files are."""
    width = rng.choice((1, 2, 4, 8))
    start = rng.randint(0, max(0, len(data) - width))
    value = rng.choice(
        (0, 1, 2 ** (8 * width) - 1, 2 ** (8 * width - 1), 2 ** (8 * width - 1) - 1, rng.getrandbits(8 * width), 65536)
    )
    return (
        data[:start] + (value % 2 ** (8 * width)).to_bytes(width, rng.choice(("little", "big"))) + data[start + width :]
    )


_BOX = re.compile(
    rb"(?:mvhd|tkhd|mdhd|elst|stsd|avc1|avcC|stts|ctts|stss|stsc|stsz|stco|co64|hdlr|dref|avih|strh|strf|idx1|LIST|movi)"
)


def set_box_field(rng: random.Random, data: bytes) -> bytes:
    """A number near the name of a box of an MP4 or AVI file: its size, a count, a size of images, an offset."""
    found = list(_BOX.finditer(data))
    if not found:
        return set_integer(rng, data)
    start = max(rng.choice(found).start() - 4 + 4 * rng.randrange(24), 0)
    value = rng.choice(
        (0, 1, 2, 16384, 65535, 10**9, 2**31 - 1, 2**31, 2**32 - 1, rng.getrandbits(32), rng.getrandbits(12))
    )
    return data[:start] + value.to_bytes(4, rng.choice(("little", "big"))) + data[start + 4 :]


def truncate(rng: random.Random, data: bytes) -> bytes:
    return data[: _at(rng, data)]


def drop_run(rng: random.Random, data: bytes) -> bytes:
    start, end = _run(rng, data)
    return data[:start] + data[end:]


def repeat_run(rng: random.Random, data: bytes) -> bytes:
    start, end = _run(rng, data)
    return data[:end] + data[start:end] * rng.choice((1, 2, 50)) + data[end:]


def splice(rng: random.Random, data: bytes) -> bytes:
    """A run of the file at another position."""
    (start, end), (to, over) = _run(rng, data), _run(rng, data)
    return data[:to] + data[start:end] + data[over:]


def replace_number(rng: random.Random, data: bytes) -> bytes:
    return _replaced(rng, data, _NUMBER, NUMBERS)


def scale_number(rng: random.Random, data: bytes) -> bytes:
    """Another unit, another sign: the mistakes of people."""
    found = list(_NUMBER.finditer(data))
    if not found:
        return data
    match = rng.choice(found)
    try:
        value = float(match.group()) * rng.choice((-1, 10, 1000, 1e-3, 1e6, 1e9, 1e-9))
    except (ValueError, OverflowError):
        return data
    return data[: match.start()] + repr(value).encode() + data[match.end() :]


def replace_word(rng: random.Random, data: bytes) -> bytes:
    words = [match.group() for match in _WORD.finditer(data)]
    return _replaced(rng, data, _WORD, (*TEXTS, *NUMBERS, *words[:50]))


def _replaced(rng: random.Random, data: bytes, what: re.Pattern[bytes], by: tuple[bytes, ...]) -> bytes:
    found = list(what.finditer(data))
    if not found:
        return data
    match = rng.choice(found)
    return data[: match.start()] + rng.choice(by) + data[match.end() :]


def insert_text(rng: random.Random, data: bytes) -> bytes:
    start = _at(rng, data)
    return data[:start] + rng.choice(TEXTS + NUMBERS) + data[start:]


def change_lines(rng: random.Random, data: bytes) -> bytes:
    lines = data.split(b"\n")
    i, j = rng.randrange(len(lines)), rng.randrange(len(lines))
    match rng.randrange(4):
        case 0:
            del lines[i]
        case 1:
            lines[i:i] = [lines[j]] * rng.choice((1, 1, 30))
        case 2:
            lines[i], lines[j] = lines[j], lines[i]
        case _:
            lines = lines[: i + 1]
    return b"\n".join(lines)


def nest(rng: random.Random, data: bytes) -> bytes:
    start = rng.choice((0, _at(rng, data), len(data)))
    return data[:start] + rng.choice(OPENERS) * rng.choice((30, 300, 3000, 20_000)) + data[start:]


_ANY = (flip_bits, overwrite, set_integer, truncate, drop_run, repeat_run, splice)
_TEXT = (
    replace_number, replace_number, replace_number, scale_number, scale_number, replace_word, replace_word, insert_text,
    change_lines, change_lines, nest,
)  # fmt: skip
Mutation = Callable[[random.Random, bytes], bytes]


def is_text(data: bytes) -> bool:
    return b"\0" not in data[:1000] and sum(byte < 127 for byte in data[:1000]) > 0.95 * len(data[:1000])


def mutated(rng: random.Random, data: bytes) -> bytes:
    """The bytes after one to three mutations; of a PNG every other time with checksums that fit."""
    text = is_text(data)
    boxes = data[4:8] == b"ftyp" or data[8:12] == b"AVI "
    png = data.startswith(b"\x89PNG") and rng.random() < 0.5
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        kind: Mutation = rng.choice(_TEXT if text and rng.random() < 0.7 else _ANY)
        if boxes and rng.random() < 0.5:
            kind = set_box_field
        data = kind(rng, data)
    return with_checksums(data) if png else data


def with_checksums(data: bytes) -> bytes:
    """The chunks of a PNG with the checksums of their content, as far as they can be walked."""
    changed, position = bytearray(data), 8
    while position + 12 <= len(data):
        end = position + 8 + int.from_bytes(data[position : position + 4], "big")
        if end + 4 > len(data):
            break
        changed[end : end + 4] = zlib.crc32(changed[position + 4 : end]).to_bytes(4, "big")
        position = end + 4
    return bytes(changed)
