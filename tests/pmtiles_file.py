"""A small PMTiles file with a leaf directory, for the tests of base maps."""

from __future__ import annotations

from pathlib import Path

from pmtiles.tile import Compression, Entry, HeaderDict, TileType, serialize_directory, serialize_header, zxy_to_tileid


def write_pmtiles(path: Path, tiles: dict[tuple[int, int, int], bytes], **header: object) -> Path:
    """PNG tiles by (z, x, y), all named by one leaf directory; `header` changes fields of the header."""
    data, entries = b"", []
    for number, tile in sorted((zxy_to_tileid(*zxy), tile) for zxy, tile in tiles.items()):
        entries.append(Entry(number, len(data), len(tile), 1))
        data += tile
    leaf = serialize_directory(entries)
    root = serialize_directory([Entry(entries[0].tile_id, 0, len(leaf), 0)])
    zooms = [z for z, _, _ in tiles]
    fields: HeaderDict = {
        "root_offset": 127, "root_length": len(root), "metadata_offset": 127, "metadata_length": 0,
        "leaf_directory_offset": 127 + len(root), "leaf_directory_length": len(leaf),
        "tile_data_offset": 127 + len(root) + len(leaf), "tile_data_length": len(data), "clustered": True,
        "internal_compression": Compression.GZIP, "tile_compression": Compression.NONE, "tile_type": TileType.PNG,
        "min_zoom": min(zooms), "max_zoom": max(zooms),
    }  # fmt: skip
    path.write_bytes(serialize_header({**fields, **header}) + root + leaf + data)
    return path
