"""A small PMTiles file with a leaf directory, for the tests of base maps."""

from __future__ import annotations

import gzip
import struct
from pathlib import Path

from conetl.web.basemap import tile_id


def _varint(value: int) -> bytes:
    out = bytearray()
    while value >= 0x80:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*out, value])


def _directory(entries: list[tuple[int, int, int, int]]) -> bytes:
    """Entries (tile id, run, length, offset), compressed."""
    ids = [entry[0] for entry in entries]
    deltas = [b - a for a, b in zip([0, *ids], ids, strict=False)]
    columns = [deltas, [e[1] for e in entries], [e[2] for e in entries], [e[3] + 1 for e in entries]]
    return gzip.compress(b"".join(map(_varint, [len(entries), *(v for column in columns for v in column)])))


def write_pmtiles(path: Path, tiles: dict[tuple[int, int, int], bytes], *, tile_type: int = 2) -> Path:
    """PNG tiles by (z, x, y), all named by one leaf directory."""
    data, entries = b"", []
    for number, tile in sorted((tile_id(*zxy), tile) for zxy, tile in tiles.items()):
        entries.append((number, 1, len(tile), len(data)))
        data += tile
    leaf = _directory(entries)
    root = _directory([(entries[0][0], 0, len(leaf), 0)])
    zooms = [z for z, _, _ in tiles]
    leaf_at = 127 + len(root)
    numbers = (127, len(root), leaf_at, 0, leaf_at, len(leaf), leaf_at + len(leaf), len(data), *[len(tiles)] * 3)
    header = b"PMTiles\x03" + struct.pack("<11Q6B", *numbers, 1, 2, 1, tile_type, min(zooms), max(zooms))
    path.write_bytes(header.ljust(127, b"\0") + root + leaf + data)
    return path
