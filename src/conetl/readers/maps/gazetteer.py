"""Names of places with their positions, from a table of points: the search of the web view flies there."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from pyproj import Transformer

from conetl.files.documents import shown
from conetl.model.arrays import Floats
from conetl.model.errors import InputError
from conetl.readers.maps.tables import read_table


class Gazetteer(NamedTuple):
    """Places by name."""

    names: tuple[str, ...]
    lon_lat_deg: Floats
    """(n, 2) WGS 84."""

    def find(self, text: str, most: int) -> list[int]:
        """Indices of at most `most` places whose name contains a text, in any case; those that begin with it first."""
        wanted = text.casefold()
        found = [(name.casefold(), i) for i, name in enumerate(self.names) if wanted in name.casefold()]
        return [i for _, _, i in sorted((not name.startswith(wanted), name, i) for name, i in found)[:most]]


def read_gazetteer(path: Path) -> Gazetteer:
    """The places of a CSV file with the columns name, lon, lat, or of the points with a `name` in a GeoJSON or GeoPackage file.

    Raises InputError naming the file, the row and the cause.
    """
    table = read_table(path)
    if "name" not in table.columns:
        found = ", ".join(map(str, table.columns))[:200]
        raise InputError(f"{path}: no column `name`, found: {found or 'none'}. A gazetteer has name, lon, lat")
    if table.crs is None:
        raise InputError(f"{path}: a gazetteer has the columns lon and lat (WGS 84), not easting and northing")
    for row, name in enumerate(table.columns["name"], start=1):
        if not isinstance(name, str) or not name.strip():
            raise InputError(f"{path}, row {row}: name is {shown(name)}, expected a text")
    to_wgs84 = Transformer.from_crs(table.crs, 4326, always_xy=True)
    lon_lat = np.column_stack(to_wgs84.transform(table.xyz[:, 0], table.xyz[:, 1]))
    for axis, (column, limit) in enumerate((("lon", 180), ("lat", 90))):
        [bad] = np.nonzero(~(np.abs(lon_lat[:, axis]) <= limit))
        if len(bad):
            value = f"{column} is {lon_lat[bad[0], axis]:g}"
            raise InputError(
                f"{path}, row {bad[0] + 1}: {value}, expected -{limit} to {limit}: are the columns swapped?"
            )
    return Gazetteer(tuple(name.strip() for name in table.columns["name"]), lon_lat)
