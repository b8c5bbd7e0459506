"""Base maps: templates, PMTiles files, and the polynomials that place their tiles."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from pmtiles.tile import TileType

from conetl.geometry.geodesy import to_geodetic, to_map
from conetl.model.errors import InputError, StorageError
from conetl.web.basemap import base_map
from conetl.web.search import RADIUS_M, fit_projection
from tests.pmtiles_file import write_pmtiles


def polynomial(coefficients: list[float], degree: int, uv: np.ndarray) -> np.ndarray:
    """As web/src/lonlat.ts computes it."""
    terms = [uv[:, 0] ** i * uv[:, 1] ** j for i in range(degree + 1) for j in range(degree + 1 - i)]
    return np.array(coefficients) @ terms


@pytest.mark.parametrize(
    ("srid", "lat_deg", "lon_deg"),
    [
        (32632, 49.0, 8.43), (32632, 52.0, 11.99), (32601, 65.0, -179.95), (32733, -33.9, 18.4), (25833, 69.6, 18.9),
        (2056, 46.9, 7.4), (27700, 57.1, -4.0),
    ],
)  # fmt: skip
def test_polynomials_equal_pyproj_to_a_centimetre(srid, lat_deg, lon_deg):
    origin = tuple(np.round(to_map(srid, lat_deg, lon_deg, 0.0), -2).tolist())
    p = fit_projection(srid, origin, (10_000.0, -20_000.0))
    uv = np.random.default_rng(0).uniform(-1, 1, (2_000, 2))
    xy = np.array(p.centre_m) + uv * RADIUS_M
    lat, lon, _ = to_geodetic(srid, np.column_stack([xy + origin[:2], np.zeros(len(xy))])).T
    found = np.column_stack([polynomial(c, p.degree, uv) for c in p.to_degrees]) / p.unit_per_degree
    off_m = (found - np.column_stack([(lon - p.lon_deg + 180) % 360 - 180, lat - p.lat_deg])) * 111_320.0
    off_m[:, 0] *= np.cos(np.radians(lat_deg))
    assert np.abs(off_m).max() < 0.01
    back = np.column_stack([polynomial(c, p.degree, found * p.unit_per_degree) for c in p.to_metres])
    assert np.abs(back - uv).max() * RADIUS_M < 0.01


def test_templates_name_one_host(tmp_path):
    found = base_map("https://tiles.example:8443/w?layer=a&m={TileMatrix}&c={TileCol}&r={TileRow}", None, 18)
    assert found.host == "https://tiles.example:8443" and found.item.attribution == "tiles.example:8443"
    assert found.item.template.endswith("m={z}&c={x}&r={y}") and found.item.max_zoom == 18
    for wrong in (
        "https://{s}.tiles.example/{z}/{x}/{y}.png", "https://me:secret@tiles.example/{z}/{x}/{y}", "ftp://a/{z}/{x}/{y}",
        "https://a b/{z}/{x}/{y}", "https://a:70000/{z}/{x}/{y}", "https://tiles.example;script-src/{z}/{x}/{y}", "https://tiles.example/{z}/{x}.png",
    ):  # fmt: skip
        with pytest.raises(InputError, match="expected"):
            base_map(wrong)


def test_pmtiles_are_found_by_their_number(tmp_path: Path):
    tiles = {(14, 8580, 5631): b"one", (14, 8581, 5631): b"two", (3, 4, 2): b"far"}
    chosen = base_map(str(write_pmtiles(tmp_path / "a.pmtiles", tiles)), "(c) a survey office")
    assert chosen.host is None and chosen.item.max_zoom == 14 and chosen.archive is not None
    assert {zxy: chosen.archive.tile(*zxy) for zxy in tiles} == tiles
    assert chosen.archive.tile(14, 0, 0) is None and chosen.archive.tile(15, 0, 0) is None
    assert json.loads(chosen.item.model_dump_json())["attribution"] == "(c) a survey office"


def test_damaged_files_are_refused(tmp_path: Path):
    tiles = {(2, 1, 1): b"x" * 50}
    good = write_pmtiles(tmp_path / "a.pmtiles", tiles).read_bytes()
    vector = write_pmtiles(tmp_path / "vector.pmtiles", tiles, tile_type=TileType.MVT).read_bytes()
    for name, data, said in (
        ("short", good[:100], "truncated"), ("text", b"{}", "not a PMTiles file"), ("vector", vector, "no raster tiles"),
        ("root", good[:130] + b"\0" * 20 + good[150:], "damaged"), ("header", good[:99] + b"\xff" + good[100:], "damaged"),
        ("packed", good[:97] + b"\1" + good[98:], "expected gzip for directories"),
    ):  # fmt: skip
        path = tmp_path / name
        path.write_bytes(data)
        with pytest.raises(InputError, match=said):
            base_map(str(path))
    with pytest.raises(InputError, match="No such file"):
        base_map(str(tmp_path / "missing.pmtiles"))
    # The root is its own leaf.
    looping = base_map(str(write_pmtiles(tmp_path / "b.pmtiles", tiles, leaf_directory_offset=127))).archive
    assert looping is not None
    assert looping.tile(2, 1, 1) is None
    cut = tmp_path / "cut.pmtiles"
    cut.write_bytes(good[:-30])
    archive = base_map(str(cut)).archive
    assert archive is not None
    with pytest.raises(StorageError, match="truncated"):
        archive.tile(2, 1, 1)
