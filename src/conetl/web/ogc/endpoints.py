"""Routes: tipg's own without HTML, and pages of items, which PostgreSQL makes as GeoJSON."""

from __future__ import annotations

import csv
import io
from typing import Annotated, Any
from urllib.parse import urlencode

import orjson
import tipg.factory
from fastapi import Depends, Query, Request, Response
from morecantile import tms as all_tilings
from morecantile.defaults import TileMatrixSets
from tipg import model
from tipg.dependencies import properties_filter_query
from tipg.factory import EndpointsFactory, OGCFeaturesFactory, OGCTilesFactory
from tipg.resources.enums import MediaType
from tipg.resources.response import GeoJSONResponse, ORJSONResponse

from conetl.db.ogc_store import Degrees
from conetl.web.ogc import parameters as p
from conetl.web.ogc.collections import AsOfCollection, Page, as_ewkt
from conetl.web.ogc.values import Interval

ITEMS = "/collections/{collectionId}/items"
_TILING = "WebMercatorQuad"
#: Parameters that links to items carry: a link leads to the same state of the map.
_CARRIED = ("at", "known_at", "from", "to", "known_from", "known_to")
#: Stands for the id of an item in its links; no name of a map and no instant contains it.
_ID = "ITEM-ID"
_FORMS = (MediaType.geojson, MediaType.csv, MediaType.json, MediaType.geojsonseq, MediaType.ndjson)


async def items(
    request: Request,
    collection: Annotated[AsOfCollection, Depends(p.one_collection)],
    box: Annotated[Degrees | None, Depends(p.read_box)],
    interval: Annotated[Interval | None, Depends(p.read_interval)],
    ids: Annotated[str | None, Query(description="Only these items, comma-separated.")] = None,
    properties: Annotated[
        str | None, Query(description="Only these properties, comma-separated; empty: none. By default all.")
    ] = None,
    sortby: Annotated[
        str | None, Query(description="Properties, comma-separated; - before one sorts it in descending order.")
    ] = None,
    limit: Annotated[
        int, Query(ge=1, json_schema_extra={"maximum": p.MAX_LIMIT}, description="At most this number of items.")
    ] = 10,
    offset: Annotated[int, Query(ge=0, le=p.MAX_OFFSET, description="Number of items to skip.")] = 0,
    f: p.ItemForm = "geojson",
) -> Response:
    """Items of a collection."""
    limit = min(limit, p.MAX_LIMIT)  # a larger one is not an error (17-069r4, 7.15.2)
    wanted = None if properties is None else [name.strip() for name in properties.split(",")]
    asked = _pinned(request, collection)
    before, after = orjson.dumps(_item_links(request, collection, asked)).decode().split(_ID)
    async with request.app.state.pool.acquire() as conn:
        page = await collection.page(
            conn, limit=limit, offset=offset, ids=ids.split(",") if ids else None, box=box, interval=interval,
            values=properties_filter_query(request, collection), sortby=sortby, properties=wanted, links=(before, after),
        )  # fmt: skip
    if f == "geojson":
        return _geojson(request, collection, page, asked, limit, offset)
    if f == "geojsonseq":
        return _lines(page.parsed(), MediaType.geojsonseq, "items.geojson")
    rows = [
        {
            "collectionId": collection.id,
            "itemId": item["id"],
            **item["properties"],
            "geometry": as_ewkt(item["geometry"]),
        }
        for item in page.parsed()
    ]
    if f == "json":
        return ORJSONResponse(rows)
    if f == "ndjson":
        return _lines(rows, MediaType.ndjson, "items.ndjson")
    table = io.StringIO()
    writer = csv.DictWriter(table, ["collectionId", "itemId", *collection.columns(wanted), "geometry"])
    writer.writeheader()
    writer.writerows(rows)
    return _attachment(table.getvalue().encode(), MediaType.csv, "items.csv")


def _pinned(request: Request, collection: AsOfCollection) -> dict[str, str]:
    """The query of a request with the state of the database that it shows: links to other pages lead to the same state."""
    name = "known_to" if collection.table == "changes" else "known_at"
    latest = collection.served.last_committed_at.isoformat().replace("+00:00", "Z")
    return {**request.query_params} | ({} if name in request.query_params else {name: latest})


def _item_links(request: Request, collection: AsOfCollection, asked: dict[str, str]) -> list[dict[str, str]]:
    here = f"{request.base_url}collections/{collection.id}"
    item = f"{here}/items/{_ID}?{_carried(asked)}"
    return [_link(here, "collection", MediaType.json, "Collection"), _link(item, "item", MediaType.geojson, "Item")]


def _geojson(
    request: Request, collection: AsOfCollection, page: Page, asked: dict[str, str], limit: int, offset: int
) -> Response:
    """A page with links to itself and its neighbours."""
    here = f"{request.base_url}collections/{collection.id}"

    def page_at(at: int) -> str:
        return f"{here}/items?{urlencode(asked | {'offset': str(at)})}"

    links = [
        _link(here, "collection", MediaType.json, "Collection"),
        _link(f"{here}/items?{urlencode(asked)}", "self", MediaType.geojson, "Items"),
    ]
    if page.returned and offset + page.returned < page.matched:
        links.append(_link(page_at(offset + page.returned), "next", MediaType.geojson, "Next page"))
    if offset:
        links.append(_link(page_at(max(offset - limit, 0)), "prev", MediaType.geojson, "Previous page"))
    head = {
        "type": "FeatureCollection", "id": collection.id, "title": collection.title, "description": collection.description,
        "numberMatched": page.matched, "numberReturned": page.returned, "links": links,
    }  # fmt: skip
    return Response(b'%b,"features":[%b]}' % (orjson.dumps(head)[:-1], page.items), media_type=MediaType.geojson.value)


def _lines(rows: list[dict[str, Any]], kind: MediaType, name: str) -> Response:
    return _attachment(b"".join(orjson.dumps(row) + b"\n" for row in rows), kind, name)


def _attachment(body: bytes, kind: MediaType, name: str) -> Response:
    return Response(body, media_type=kind.value, headers={"Content-Disposition": f"attachment;filename={name}"})


def _link(href: str, rel: str, kind: MediaType, title: str) -> dict[str, str]:
    return {"title": title, "href": href, "rel": rel, "type": kind.value}


def _carried(query: Any) -> str:
    return urlencode([(name, value) for name, value in query.items() if name in _CARRIED])


class _Features(OGCFeaturesFactory):
    """tipg's routes with our pages of items; links to an item carry the requested instants."""

    def _items_route(self) -> None:
        answer = {"content": {form.value: {} for form in _FORMS}, "model": model.Items}
        route = self.router.get(
            ITEMS, response_class=GeoJSONResponse, responses={200: answer}, tags=["OGC Features API"]
        )
        route(items)

    def url_for(self, request: Request, name: str, **path_params: Any) -> str:
        url: str = super().url_for(request, name, **path_params)
        carried = _carried(request.query_params) if name == "item" else ""
        return f"{url}?{carried}" if carried else url


def endpoints() -> list[EndpointsFactory]:
    """The routers of the API.

    While tipg declares its routes, its dependencies are ours: FastAPI's dependency_overrides would resolve them for every
    request, which takes 20 ms of processor time.
    """
    ours = {
        "bbox_query": p.read_box, "datetime_query": p.read_interval, "filter_query": p.refuse_filter,
        "ItemsOutputType": p.read_form, "OutputType": p.read_json_only, "QueryablesOutputType": p.read_json_only,
    }  # fmt: skip
    theirs = {name: getattr(tipg.factory, name) for name in ours}
    tilings = TileMatrixSets({_TILING: all_tilings.get(_TILING)})
    one: Any = p.one_collection  # tipg's types allow no coroutines here, FastAPI does
    every: Any = p.all_collections
    try:
        vars(tipg.factory).update(ours)
        return [
            _Features(collection_dependency=one, collections_dependency=every, with_common=False),
            OGCTilesFactory(collection_dependency=one, supported_tms=tilings, with_viewer=False, with_common=False),
        ]
    finally:
        vars(tipg.factory).update(theirs)
