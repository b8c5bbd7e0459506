"""The map as files for other programs. A format is a function `write(sources, path)` and one line in `FORMATS`; one of work zones
is a function `export(zones, standing, path, context)`, which returns the number of features, and one line in `ZONE_FORMATS`.

It imports `db` and everything below it. Start with `export.py`; `source.py` reads the rows that every format writes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from enum import StrEnum
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, NamedTuple, cast

if TYPE_CHECKING:
    from conetl.exports.source import ExportSource
    from conetl.exports.zone_feed import FeedContext
    from conetl.model.map_records import MapFeature
    from conetl.model.work_zone_records import WorkZone


class Order(StrEnum):
    """Order of the rows; equal rows give equal files."""

    BY_ID = "feature id"
    SPATIAL = "Hilbert curve"
    BY_TIME = "time on the road"


class Format(NamedTuple):
    """A file format of `conetl map export`."""

    suffix: str
    order: Order
    entry_point: str
    """`module:function` in this package. The function writes all rows of some sources to a path."""
    geographic: bool = False
    """WGS 84 longitude and latitude instead of the map's CRS."""
    one_geometry: bool = False
    """A file holds one type of geometry: lane markings are in a second one, `<stem>_lane_markings<suffix>`."""


#: Writers are imported on first use, because GDAL, Arrow and MCAP are slow to load.
FORMATS = {
    "geojson": Format(".geojson", Order.BY_ID, "text_files:write_features", geographic=True),
    "csv": Format(".csv", Order.BY_ID, "text_files:write_csv", one_geometry=True),
    "geoparquet": Format(".parquet", Order.SPATIAL, "table_files:write_geoparquet", one_geometry=True),
    "gpkg": Format(".gpkg", Order.BY_ID, "table_files:write_geopackage"),
    "flatgeobuf": Format(".fgb", Order.BY_ID, "table_files:write_flatgeobuf", one_geometry=True),
    "mcap": Format(".mcap", Order.BY_TIME, "mcap_scene:write_scene"),
    "lanelet2": Format(".osm", Order.BY_ID, "text_files:write_lanelet2", geographic=True),
}


class ZoneFormat(NamedTuple):
    """A format of `conetl map export` that holds work zones instead of single objects."""

    suffix: str
    media_type: str
    noun: str
    """Of one feature, in messages."""
    entry_point: str
    """As of a `Format`."""
    required: tuple[str, ...] = ("publisher", "road_names")
    """Keys of the feed's description (`FeedInfo`)."""


ZONE_FORMATS = {
    "wzdx": ZoneFormat("_wzdx.geojson", "application/json", "work zone", "wzdx:export_work_zone_feed"),
    "wzdx-devices": ZoneFormat("_devices.geojson", "application/json", "device", "wzdx:export_device_feed"),
    "datex2": ZoneFormat(
        "_datex2.xml",
        "application/xml",
        "work zone",
        "datex2:export_situations",
        ("publisher", "road_names", "country"),
    ),
}


def writer_of(file_format: str) -> Callable[[Sequence[ExportSource], Path], None]:
    """The function that writes a format of `FORMATS`."""
    writer = resolve_name(f"conetl.exports.{FORMATS[file_format].entry_point}")
    return cast("Callable[[Sequence[ExportSource], Path], None]", writer)


def zone_writer_of(file_format: str) -> Callable[[Sequence[WorkZone], Sequence[MapFeature], Path, FeedContext], int]:
    """The function that writes a format of `ZONE_FORMATS`."""
    writer = resolve_name(f"conetl.exports.{ZONE_FORMATS[file_format].entry_point}")
    return cast("Callable[[Sequence[WorkZone], Sequence[MapFeature], Path, FeedContext], int]", writer)
