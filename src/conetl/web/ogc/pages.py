"""Pages of items as GeoJSON: PostgreSQL makes the items, and they go out as they come."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import orjson
from fastapi import Request, Response
from starlette.datastructures import QueryParams

GEOJSON_TYPE = "application/geo+json"
#: Where the id of an item comes in its links; no name of a map and no instant holds it.
_ID = "ITEM-ID"
#: Address of a page of the API by the name of its route and what its path names.
Address = Callable[..., str]


@dataclass(frozen=True)
class Page:
    """Items as JSON with commas between them, how many they are, and how many there are on all pages."""

    items: bytes
    returned: int
    matched: int


def item_links(collection_id: str, address: Address) -> tuple[str, str]:
    """The links of each item as JSON: what stands before the item's id, and what behind it."""
    links = [
        _link(address("collection", collectionId=collection_id), "collection", "application/json", "Collection"),
        _link(address("item", collectionId=collection_id, itemId=_ID), "item", GEOJSON_TYPE, "Item"),
    ]
    before, after = orjson.dumps(links).decode().split(_ID)
    return before, after


def page_answer(
    request: Request, collection: Any, page: Page, *, limit: int, offset: int, address: Address
) -> Response:
    """The page with its links to itself and to its neighbours."""
    here = address("items", collectionId=collection.id)

    def place(at: int | None) -> str:
        asked = QueryParams({**request.query_params, **({} if at is None else {"offset": str(at)})})
        return f"{here}?{asked}" if asked else here

    links = [
        _link(address("collection", collectionId=collection.id), "collection", "application/json", "Collection"),
        _link(place(None), "self", GEOJSON_TYPE, "Items"),
    ]
    if page.returned and offset + page.returned < page.matched:
        links.append(_link(place(offset + page.returned), "next", GEOJSON_TYPE, "Next page"))
    if offset:
        links.append(_link(place(max(offset - limit, 0)), "prev", GEOJSON_TYPE, "Previous page"))
    head = {
        "type": "FeatureCollection",
        "id": collection.id,
        "title": collection.title,
        "description": collection.description,
        "numberMatched": page.matched,
        "numberReturned": page.returned,
        "links": links,
    }
    body = b'%b,"features":[%b]}' % (orjson.dumps(head)[:-1], page.items)
    return Response(body, media_type=GEOJSON_TYPE)


def _link(href: str, rel: str, kind: str, title: str) -> dict[str, str]:
    return {"title": title, "href": href, "rel": rel, "type": kind}
