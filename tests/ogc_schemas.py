"""What OGC API - Features - Part 1 (17-069r4), queryables, OGC API - Tiles and TileJSON 3.0 require of answers.

JSON Schemas, written from the requirements in our own words; the standards' schema files are not part of this repository.
"""

from __future__ import annotations

from typing import Any

Schema = dict[str, Any]
TEXT: Schema = {"type": "string"}
COUNT: Schema = {"type": "integer", "minimum": 0}
URI: Schema = {"type": "string", "pattern": "^https?://"}
CRS84 = "http://www.opengis.net/def/crs/OGC/1.3/CRS84"
TILING_SCHEME = "http://www.opengis.net/def/rel/ogc/1.0/tiling-scheme"
LON_LAT = [{"minimum": -180, "maximum": 180}, {"minimum": -90, "maximum": 90}]


def obj(required: str, **properties: Schema) -> Schema:
    """An object with these required properties."""
    return {"type": "object", "required": required.split(), "properties": properties}


def array(items: Schema, least: int = 1, most: int | None = None, **more: Any) -> Schema:
    return {"type": "array", "minItems": least, "items": items} | ({} if most is None else {"maxItems": most}) | more


def with_links(*rels: str) -> Schema:
    """An array of links that contains each of these relations."""
    link = obj("href rel", href=URI, rel=TEXT, type={"type": "string", "pattern": "^[a-z]+/"}, title=TEXT)
    return array(link, 0, allOf=[{"contains": obj("rel type", rel={"const": rel})} for rel in rels])


DEGREES = array({"type": "number"}, 4, 4, prefixItems=LON_LAT * 2)
TIME: Schema = {
    "type": ["string", "null"],
    "pattern": r"^\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(\.\d+)?(Z|[+-]\d\d:\d\d)$",
}
#: 7.2.4: a title and links to this page, to the API definition, to the conformance declaration and to the collections.
LANDING = obj("links", title=TEXT, description=TEXT, links=with_links("self", "service-desc", "conformance", "data"))
#: 7.4.3
CONFORMANCE = obj("conformsTo", conformsTo=array(URI, allOf=[
    {"contains": {"const": f"http://www.opengis.net/spec/ogcapi-features-1/1.0/conf/{name}"}} for name in ("core", "geojson")
]))  # fmt: skip
#: 7.14.3: id, links to the items; extents in CRS84, times in the Gregorian calendar; itemType feature.
COLLECTION = obj(
    "id links extent crs", id=TEXT, title=TEXT, description=TEXT, links=with_links("items"), itemType={"const": "feature"},
    crs={"type": "array", "contains": {"const": CRS84}},
    extent=obj(
        "spatial temporal",
        spatial=obj("bbox", bbox=array(DEGREES), crs={"const": CRS84}),
        temporal=obj(
            "interval", interval=array(array(TIME, 2, 2)),
            trs={"const": "http://www.opengis.net/def/uom/ISO-8601/0/Gregorian"},
        ),
    ),
)  # fmt: skip
#: 7.13.3
COLLECTIONS = obj("links collections", links=with_links("self"), collections=array(COLLECTION, 0))
_PLACE = array({"type": "number"}, 2, 3, prefixItems=LON_LAT)
#: 7.16, and RFC 7946: a feature with an identifier, a point or a line in longitude, latitude and, of features, height.
FEATURE = obj(
    "type id geometry properties", type={"const": "Feature"}, id={"type": "string", "minLength": 1},
    properties={"type": "object"},
    geometry={
        "oneOf": [
            obj("type coordinates", type={"const": "Point"}, coordinates=_PLACE),
            obj("type coordinates", type={"const": "LineString"}, coordinates=array(_PLACE, 2)),
        ]
    },
)  # fmt: skip
#: 7.16.4: a link to the item's collection and to itself.
ITEM: Schema = {"allOf": [FEATURE, obj("links", links=with_links("self", "collection"))]}
#: 7.15.3 to 7.15.7: links to this page (and the next one), how many there are and how many came.
ITEMS = obj(
    "type features links numberMatched numberReturned", type={"const": "FeatureCollection"}, features=array(FEATURE, 0),
    links=with_links("self"), numberMatched=COUNT, numberReturned=COUNT,
)  # fmt: skip
#: 7.5.2 requires the exception's code.
PROBLEM = obj("code detail", code=TEXT, detail={"type": "string", "minLength": 10}) | {"additionalProperties": False}
#: 19-079r2, 6.2: a JSON Schema of an object whose properties can be queried.
QUERYABLES = obj("$schema $id type properties", **{
    "$schema": {"enum": [f"https://json-schema.org/draft/{draft}/schema" for draft in ("2019-09", "2020-12")]},
    "$id": URI, "type": {"const": "object"}, "properties": {"type": "object", "minProperties": 2},
})  # fmt: skip
#: 20-057: which tiling, of vectors, with the link to it and the template of its tiles.
TILESET = obj("dataType crs links", dataType={"const": "vector"}, links={"allOf": [
    with_links("self", TILING_SCHEME),
    {"contains": obj(
        "rel type href", rel={"const": "tile"}, type={"const": "application/vnd.mapbox-vector-tile"},
        href={"pattern": r"\{z\}/\{x\}/\{y\}$"},
    )},
]})  # fmt: skip
TILESETS = obj("tilesets", tilesets=array(TILESET))
TILE_MATRIX_SETS = obj("tileMatrixSets", tileMatrixSets=array(obj("id links", links=with_links(TILING_SCHEME))))
TILEJSON = obj(
    "tilejson tiles vector_layers bounds", tilejson={"const": "3.0.0"},
    tiles=array({"type": "string", "pattern": r"^http.*\{z\}/\{x\}/\{y\}"}), vector_layers=array(obj("id fields")),
    bounds=DEGREES, minzoom=COUNT | {"maximum": 30}, maxzoom=COUNT | {"maximum": 30},
)  # fmt: skip
