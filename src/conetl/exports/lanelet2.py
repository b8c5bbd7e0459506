"""The map as points of an OSM file, as Lanelet2 and JOSM read them: one node a cone, with its properties as tags.

Ids are negative (new objects, which never meet those of a lanelet map), and `upload` is `never`: no cone gets into
OpenStreetMap by accident. `ele` is the ellipsoidal height; `local_x`, `local_y` are easting and northing in the map's CRS.
"""

from __future__ import annotations

from pathlib import Path
from xml.sax.saxutils import quoteattr

from conetl.exports.feature_rows import rows_of
from conetl.exports.source import Source


def write(source: Source, path: Path) -> int:
    """Write one node per row; the number of rows."""
    count = 0
    with path.open("w", encoding="utf-8", newline="") as file:
        file.write("<?xml version='1.0' encoding='UTF-8'?>\n<osm version='0.6' generator='conetl' upload='never'>\n")
        for row in rows_of(source):
            count += 1
            file.write(f"  <node id='-{count}' visible='true' lat='{row.lat_deg:.10f}' lon='{row.lon_deg:.10f}'>\n")
            properties = {name: value for name, value in row.properties.items() if value is not None}
            tags = {
                "type": properties["category"],
                "ele": f"{row.ellipsoidal_height_m:.4f}",
                "local_x": f"{row.easting_m:.4f}",
                "local_y": f"{row.northing_m:.4f}",
                **properties,
            }
            for key, value in tags.items():
                file.write(f"    <tag k={quoteattr(key)} v={quoteattr(str(value))} />\n")
            file.write("  </node>\n")
        file.write("</osm>\n")
    return count
