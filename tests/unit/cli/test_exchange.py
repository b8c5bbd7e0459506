"""What `conetl map export` understands of the name of a file."""

from __future__ import annotations

from pathlib import Path

import pytest

from conetl.cli.map.exchange import _format_by_name
from conetl.model.errors import InputError


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("cones.geojson", "geojson"), ("cones.json", "geojson"), ("cones", "geojson"), ("cones.csv", "csv"),
        ("cones.GPKG", "gpkg"), ("cones.parquet", "geoparquet"), ("cones.fgb", "flatgeobuf"), ("cones.mcap", "mcap"),
        ("cones.osm", "lanelet2"),
    ],
)  # fmt: skip
def test_the_name_of_a_file_tells_its_format(name: str, expected: str) -> None:
    """GeoJSON in a file called cones.csv helps nobody."""
    assert _format_by_name(Path(name)) == expected


def test_a_name_that_tells_nothing_is_asked_about() -> None:
    with pytest.raises(InputError, match=r"cones\.shp: .*--format \(geojson, csv"):
        _format_by_name(Path("cones.shp"))
