"""What OGC API - Features - Part 1 (17-069r4), queryables, OGC API - Tiles and TileJSON 3.0 require of answers.

JSON Schemas, written from the requirements in our own words; the standards' schema files are not part of this repository.
"""

from __future__ import annotations

from typing import Any

Schema = dict[str, Any]
URI = {"type": "string", "pattern": "^https?://"}
DEGREES = {
    "type": "array", "minItems": 4, "maxItems": 4,
    "prefixItems": [{"minimum": -180, "maximum": 180}, {"minimum": -90, "maximum": 90}] * 2, "items": {"type": "number"},
}  # fmt: skip
TIME = {"type": ["string", "null"], "pattern": r"^\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(\.\d+)?(Z|[+-]\d\d:\d\d)$"}
LINK: Schema = {
    "type": "object",
    "required": ["href", "rel"],
    "properties": {
        "href": URI, "rel": {"type": "string"}, "type": {"type": "string", "pattern": "^[a-z]+/"}, "title": {"type": "string"},
    },
}  # fmt: skip


def with_links(*rels: str) -> Schema:
    """An array of links that holds each of these relations."""
    return {
        "type": "array",
        "items": LINK,
        "allOf": [{"contains": {"properties": {"rel": {"const": rel}}, "required": ["rel", "type"]}} for rel in rels],
    }


#: 7.2.4: a title and links to this page, to the API definition, to the conformance declaration and to the collections.
LANDING: Schema = {
    "type": "object",
    "required": ["links"],
    "properties": {
        "title": {"type": "string"}, "description": {"type": "string"},
        "links": with_links("self", "service-desc", "conformance", "data"),
    },
}  # fmt: skip
#: 7.4.3
CONFORMANCE: Schema = {
    "type": "object",
    "required": ["conformsTo"],
    "properties": {
        "conformsTo": {
            "type": "array",
            "items": URI,
            "allOf": [
                {"contains": {"const": f"http://www.opengis.net/spec/ogcapi-features-1/1.0/conf/{name}"}}
                for name in ("core", "geojson")
            ],
        }
    },
}
#: 7.14.3: id, links to the items; extents in CRS84, times in the Gregorian calendar; itemType feature.
COLLECTION: Schema = {
    "type": "object",
    "required": ["id", "links", "extent", "crs"],
    "properties": {
        "id": {"type": "string"},
        "title": {"type": "string"},
        "description": {"type": "string"},
        "links": with_links("items"),
        "itemType": {"const": "feature"},
        "crs": {"type": "array", "contains": {"const": "http://www.opengis.net/def/crs/OGC/1.3/CRS84"}},
        "extent": {
            "type": "object",
            "required": ["spatial", "temporal"],
            "properties": {
                "spatial": {
                    "required": ["bbox"],
                    "properties": {
                        "bbox": {"type": "array", "minItems": 1, "items": DEGREES},
                        "crs": {"const": "http://www.opengis.net/def/crs/OGC/1.3/CRS84"},
                    },
                },
                "temporal": {
                    "required": ["interval"],
                    "properties": {
                        "interval": {
                            "type": "array", "minItems": 1,
                            "items": {"type": "array", "minItems": 2, "maxItems": 2, "items": TIME},
                        },
                        "trs": {"const": "http://www.opengis.net/def/uom/ISO-8601/0/Gregorian"},
                    },
                },
            },
        },
    },
}  # fmt: skip
#: 7.13.3
COLLECTIONS: Schema = {
    "type": "object",
    "required": ["links", "collections"],
    "properties": {"links": with_links("self"), "collections": {"type": "array", "items": COLLECTION}},
}
#: 7.16, and RFC 7946: a feature with an identifier, a point in longitude, latitude and height.
FEATURE: Schema = {
    "type": "object",
    "required": ["type", "id", "geometry", "properties"],
    "properties": {
        "type": {"const": "Feature"},
        "id": {"type": "string", "minLength": 1},
        "properties": {"type": "object"},
        "geometry": {
            "type": "object",
            "required": ["type", "coordinates"],
            "properties": {
                "type": {"const": "Point"},
                "coordinates": {
                    "type": "array", "minItems": 3, "maxItems": 3, "items": {"type": "number"},
                    "prefixItems": [{"minimum": -180, "maximum": 180}, {"minimum": -90, "maximum": 90}],
                },
            },
        },
    },
}  # fmt: skip
#: 7.16.4: a link to the item's collection and to itself.
ITEM: Schema = {"allOf": [FEATURE, {"required": ["links"], "properties": {"links": with_links("self", "collection")}}]}
#: 7.15.3 to 7.15.7: links to this page (and the next one), how many there are and how many came.
ITEMS: Schema = {
    "type": "object",
    "required": ["type", "features", "links", "numberMatched", "numberReturned"],
    "properties": {
        "type": {"const": "FeatureCollection"},
        "features": {"type": "array", "items": FEATURE},
        "links": with_links("self"),
        "numberMatched": {"type": "integer", "minimum": 0},
        "numberReturned": {"type": "integer", "minimum": 0},
    },
}
#: 7.5.2 names the exception's code as required.
REFUSAL: Schema = {
    "type": "object",
    "required": ["code", "detail"],
    "properties": {"code": {"type": "string"}, "detail": {"type": "string", "minLength": 10}},
    "additionalProperties": False,
}
#: 19-079r2, 6.2: a JSON Schema of an object whose properties are what may be asked for.
QUERYABLES: Schema = {
    "type": "object",
    "required": ["$schema", "$id", "type", "properties"],
    "properties": {
        "$schema": {"enum": ["https://json-schema.org/draft/2019-09/schema", "https://json-schema.org/draft/2020-12/schema"]},
        "$id": URI,
        "type": {"const": "object"},
        "properties": {"type": "object", "minProperties": 2},
    },
}  # fmt: skip
#: 20-057: which tiling, of vectors, with the link to it and the template of its tiles.
TILESET: Schema = {
    "type": "object",
    "required": ["dataType", "crs", "links"],
    "properties": {
        "dataType": {"const": "vector"},
        "links": {
            "allOf": [
                with_links("self", "http://www.opengis.net/def/rel/ogc/1.0/tiling-scheme"),
                {
                    "contains": {
                        "properties": {
                            "rel": {"const": "tile"},
                            "type": {"const": "application/vnd.mapbox-vector-tile"},
                            "href": {"pattern": r"\{z\}/\{x\}/\{y\}$"},
                        },
                        "required": ["rel", "type", "href"],
                    }
                },
            ]
        },
    },
}
TILESETS: Schema = {
    "type": "object", "required": ["tilesets"], "properties": {"tilesets": {"type": "array", "minItems": 1, "items": TILESET}},
}  # fmt: skip
TILE_MATRIX_SETS: Schema = {
    "type": "object",
    "required": ["tileMatrixSets"],
    "properties": {
        "tileMatrixSets": {
            "type": "array",
            "minItems": 1,
            "items": {
                "required": ["id", "links"],
                "properties": {"links": with_links("http://www.opengis.net/def/rel/ogc/1.0/tiling-scheme")},
            },
        }
    },
}
TILEJSON: Schema = {
    "type": "object",
    "required": ["tilejson", "tiles", "vector_layers", "bounds"],
    "properties": {
        "tilejson": {"const": "3.0.0"},
        "tiles": {"type": "array", "minItems": 1, "items": {"type": "string", "pattern": r"^http.*\{z\}/\{x\}/\{y\}"}},
        "vector_layers": {"type": "array", "minItems": 1, "items": {"required": ["id", "fields"]}},
        "bounds": DEGREES,
        "minzoom": {"type": "integer", "minimum": 0, "maximum": 30},
        "maxzoom": {"type": "integer", "minimum": 0, "maximum": 30},
    },
}
