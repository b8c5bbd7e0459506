"""tipg's routes without its HTML pages, whose links lead to what is served and to the state of the map that was asked for."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial, wraps
from typing import Any
from urllib.parse import urlencode

import tipg.factory
from fastapi import Request
from fastapi.routing import APIRoute
from morecantile import tms as all_tilings
from morecantile.defaults import TileMatrixSets
from tipg.dependencies import properties_filter_query
from tipg.factory import EndpointsFactory, OGCFeaturesFactory, OGCTilesFactory
from tipg.resources.enums import MediaType
from tipg.resources.response import GeoJSONResponse

from conetl.web.ogc.collections import AsOfCollection
from conetl.web.ogc.definition import NOT_OFFERED
from conetl.web.ogc.pages import item_links, page_answer
from conetl.web.ogc.parameters import (
    CARRIED,
    all_collections,
    one_collection,
    read_box,
    read_ids,
    read_interval,
    read_json_only,
    read_order,
    read_output,
    read_properties,
    refuse_filter,
)

TITLE = "conetl: maps of traffic cones"
DESCRIPTION = (
    "Each map has two collections: MAP.features, the cones as of an instant (at, known_at), "
    "and MAP.changes, what changed between two "
    "(from, to, known_from, known_to)."
)
API_DEFINITION_TYPE = "application/vnd.oai.openapi+json;version=3.1"
TILING = "WebMercatorQuad"
#: What is kept of each standard. tipg would also claim HTML, OpenAPI 3.0 (the API definition is of 3.1) and filter expressions.
CONFORMS_TO = [
    "http://www.opengis.net/spec/ogcapi-common-1/1.0/conf/core",
    "http://www.opengis.net/spec/ogcapi-common-1/1.0/conf/landingPage",
    "http://www.opengis.net/spec/ogcapi-common-1/1.0/conf/json",
    "http://www.opengis.net/spec/ogcapi-common-2/1.0/conf/collections",
    "http://www.opengis.net/spec/ogcapi-features-1/1.0/conf/core",
    "http://www.opengis.net/spec/ogcapi-features-1/1.0/conf/geojson",
    "http://www.opengis.net/spec/ogcapi-tiles-1/1.0/conf/core",
    "http://www.opengis.net/spec/ogcapi-tiles-1/1.0/conf/mvt",
    "http://www.opengis.net/spec/ogcapi-tiles-1/1.0/conf/tileset",
    "http://www.opengis.net/spec/ogcapi-tiles-1/1.0/conf/tilesets-list",
]


@dataclass
class _Features(OGCFeaturesFactory):
    """Links of items are made once a request and not once an item, and lead to the item as of the instants asked for."""

    def _items_route(self) -> None:
        """Pages as GeoJSON are PostgreSQL's work; tipg makes the other forms."""
        super()._items_route()  # type: ignore[no-untyped-call]
        [route] = [r for r in self.router.routes if isinstance(r, APIRoute) and r.name == "items"]
        self.router.routes.remove(route)
        others = route.endpoint

        @wraps(others)
        async def items(
            request: Request,
            collection: AsOfCollection,
            output_type: MediaType,
            limit: int,
            offset: int | None,
            **asked: Any,
        ) -> Any:
            if output_type is not MediaType.geojson:
                return await others(
                    request=request,
                    collection=collection,
                    output_type=output_type,
                    limit=limit,
                    offset=offset,
                    cql_filter=None,
                    **asked,
                )
            address = partial(self.url_for, request)
            async with request.app.state.pool.acquire() as conn:
                page = await collection.page(
                    conn, ids=asked["ids_filter"], box=asked["bbox_filter"], interval=asked["datetime_filter"],
                    values=properties_filter_query(request, collection), sortby=asked["sortby"],
                    properties=asked["properties"], limit=limit, offset=offset or 0,
                    links=item_links(collection.id, address),
                )  # fmt: skip
            return page_answer(request, collection, page, limit=limit, offset=offset or 0, address=address)

        declared = inspect.signature(others)
        offered = [
            p
            for name, p in declared.parameters.items()
            if name.replace("_", "-") not in NOT_OFFERED and name != "cql_filter"
        ]
        items.__signature__ = declared.replace(parameters=offered)  # type: ignore[attr-defined]  # the fewer, the sooner FastAPI is done
        self.router.get(route.path, response_class=GeoJSONResponse, responses=route.responses, tags=route.tags)(items)

    def url_for(self, request: Request, name: str, **path_params: Any) -> str:
        if name not in ("item", "collection") or ("itemId" in path_params and "{" in str(path_params["itemId"])):
            return super().url_for(request, name, **path_params)
        made: dict[str, str] = request.scope.setdefault("conetl.links", {})
        if name not in made:
            made[name] = super().url_for(
                request, name, **(path_params | ({"itemId": "ITEM"} if name == "item" else {}))
            )
            carried = urlencode([(key, value) for key, value in request.query_params.items() if key in CARRIED])
            made["carried"] = f"?{carried}" if carried else ""
        if name == "collection":
            return made[name]
        return f"{made[name].removesuffix('ITEM')}{path_params['itemId']}{made['carried']}"


@contextmanager
def _our_parameters() -> Iterator[None]:
    """While tipg declares its routes, its parameters are ours. (FastAPI's dependency_overrides would work them out for every
    request, which takes 20 ms of processor time.)"""
    names = {
        "bbox_query": read_box, "datetime_query": read_interval, "filter_query": refuse_filter, "ItemsOutputType": read_output,
        "OutputType": read_json_only, "QueryablesOutputType": read_json_only,
        "ids_query": read_ids, "properties_query": read_properties, "sortby_query": read_order,
    }  # fmt: skip
    theirs = {name: getattr(tipg.factory, name) for name in names}
    try:
        for name, ours in names.items():
            setattr(tipg.factory, name, ours)
        yield
    finally:
        for name, original in theirs.items():
            setattr(tipg.factory, name, original)


def endpoints() -> list[EndpointsFactory]:
    """The routers of the API."""
    tilings = TileMatrixSets({TILING: all_tilings.get(TILING)})
    one: Any = one_collection  # tipg's types know no coroutines here, FastAPI does
    every: Any = all_collections
    with _our_parameters():
        return [
            _Features(collection_dependency=one, collections_dependency=every, with_common=False, title=TITLE),
            OGCTilesFactory(collection_dependency=one, supported_tms=tilings, with_viewer=False, with_common=False),
        ]


def landing(request: Request) -> dict[str, Any]:
    """Where everything is."""
    base = str(request.base_url)
    pages = [
        ("", "self", "application/json", "This page"),
        ("api", "service-desc", API_DEFINITION_TYPE, "API definition"),
        ("conformance", "conformance", "application/json", "Standards that are kept"),
        ("collections", "data", "application/json", "Collections"),
        ("tileMatrixSets", "http://www.opengis.net/def/rel/ogc/1.0/tiling-schemes", "application/json", "Tilings"),
    ]
    links = [{"href": base + path, "rel": rel, "type": kind, "title": title} for path, rel, kind, title in pages]
    return {"title": TITLE, "description": DESCRIPTION, "links": links}


def conformance() -> dict[str, list[str]]:
    """Standards that are kept."""
    return {"conformsTo": CONFORMS_TO}
