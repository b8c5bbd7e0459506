"""Routes of what stands on a map by what is in view: tiles with all features, or with clusters where there are many, and numbers.

A tile is a square of 2^(20 - zoom) m of the map's CRS; tile (0, 0) begins at its origin. A feature belongs to the tile of its
position, a lane marking to that of its middle vertex, so the numbers of tiles that do not overlap add up to that of the map.
"""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Path, Response

from conetl.db.connection import Connection, load_sql, or_infinity
from conetl.db.map.map_store import require_map
from conetl.db.serve_store import Row, read_rows
from conetl.web import models as m
from conetl.web import rows as to
from conetl.web.listing import listing
from conetl.web.parameters import Instant, MapName, Origin, Reader

router = APIRouter(tags=["maps"], prefix="/maps/{map_name}")
#: Tiles with more features are answered with clusters: a view shows some tiles, and a computer without graphics card draws
#: about 10,000 features fluently.
MAX_IN_TILE = 2_000
#: Clusters per side of a tile, as a power of two.
_CELL_STEPS = 4
#: Zooms of conetl.feature_cell, see conetl.cell_zooms.
STORED_ZOOMS = range(4, 13, 2)
_LISTS: dict[str, type[m.Feature]] = {"features": m.Feature, "markings": m.Stretch}
Zoom = Annotated[int, Path(ge=0, le=20)]
Index = Annotated[int, Path(ge=-(2**31), le=2**31 - 1)]


@router.get("/tiles/{zoom}/{x}/{y}", response_model=m.FeatureTile)
def tile(
    map_name: MapName,
    zoom: Zoom,
    x: Index,
    y: Index,
    conn: Reader,
    origin: Origin,
    valid_at: Instant = None,
    known_at: Instant = None,
) -> m.FeatureTile | Response:
    """What stood in a tile at `valid_at`, as known at `known_at`: all features, or clusters if there are more than 2,000."""
    side_m = 2.0 ** (20 - zoom)
    edges: dict[str, Any] = {
        "west_m": x * side_m,
        "south_m": y * side_m,
        "east_m": (x + 1) * side_m,
        "north_m": (y + 1) * side_m,
    }
    state = MapState(conn, map_name, valid_at, known_at)
    cells = state.cells(zoom + _CELL_STEPS, edges)
    count = sum(cell["feature_count"] for cell in cells)
    if count > MAX_IN_TILE:
        clusters = [
            m.Cluster(xyz_m=xyz_m, count=sum(counts.values()), categories=counts)
            for xyz_m, counts in to.clusters(cells, "category", origin)
        ]
        return m.FeatureTile(origin_m=origin, count=count, clusters=clusters, features=[], markings=[])
    head = f'"count":{count},"clusters":[],'
    sql = load_sql("serving.features_in_tile")
    return listing(conn, sql, _LISTS, origin, head=head, **state.parameters, **edges)


@router.get("/summary")
def summary(
    map_name: MapName, conn: Reader, origin: Origin, valid_at: Instant = None, known_at: Instant = None
) -> m.Summary:
    """How many features of each class stood on a map, and where."""
    found = MapState(conn, map_name, valid_at, known_at).summary()
    return m.Summary(
        origin_m=list(origin),
        categories={row["category"]: row["feature_count"] for row in found},
        box_m=None if not found else [
            min(row["west_m"] for row in found) - origin[0], min(row["south_m"] for row in found) - origin[1],
            max(row["east_m"] for row in found) - origin[0], max(row["north_m"] for row in found) - origin[1],
        ],
    )  # fmt: skip


class MapState:
    """One state of a map; numbers of the one of now are stored."""

    def __init__(self, conn: Connection, map_name: str, valid_at: Instant, known_at: Instant) -> None:
        instants = {"valid_at": or_infinity(valid_at), "known_at": or_infinity(known_at)}
        srid = require_map(conn, map_name).srid
        self.parameters: dict[str, Any] = {"map_name": map_name, "srid": srid, **instants}
        self._conn = conn
        [row] = read_rows(conn, "serving.is_now", map_name=map_name, **instants)
        self._is_now = row["is_now"]

    def cells(self, zoom: int, edges: dict[str, float]) -> list[Row]:
        """Numbers by cell and class within a tile, in cells of about this zoom."""
        stored = [z for z in STORED_ZOOMS if z >= zoom]
        kind = "stored" if self._is_now and stored else "counted"
        cell_zoom = stored[0] if kind == "stored" else zoom
        return read_rows(self._conn, f"serving.{kind}_cells", cell_zoom=cell_zoom, **edges, **self.parameters)

    def summary(self) -> list[Row]:
        """Number and box of each class."""
        return read_rows(self._conn, f"serving.{'stored' if self._is_now else 'counted'}_summary", **self.parameters)
