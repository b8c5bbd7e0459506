"""The map as an MCAP recording for Foxglove: cones in true size, coloured by their change, and lane markings in true width.

Topics, all JSON with the schemas of https://docs.foxglove.dev/docs/sdk/schemas: /cones and, if the map has them, /lane_markings
(SceneUpdate), /tf (FrameTransform from the map's CRS to a frame `map` with its origin near the first cone, because graphics
cards compute in float32) and /origin (LocationFix of that origin). Features and changes are shown at one instant. A history
follows the time on the road, in one database state (that of `known_at`): cones appear, change and disappear as the recording
plays.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from itertools import groupby, islice
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import Writer

from conetl.exports.kind_marks import KIND_MARKS, PAINT, dashes_of
from conetl.exports.source import LINE_NAME, ExportContent, ExportSource
from conetl.exports.text_files import iso_utc
from conetl.model.base import ns_from_utc
from conetl.model.feature_classes import CONE, width_over_height
from conetl.model.map_records import DeltaKind

FRAME = "map"
TOPIC = "/cones"
LINES_TOPIC = "/lane_markings"
#: Entities per message.
_MESSAGE_ROWS = 1000
#: A road cone: diameter of the foot over the height, and of the top over that of the foot.
_FOOT_WIDTH, _TOP_SHARE = 0.4, 0.175
_PRIMITIVES = ("arrows", "cylinders", "cubes", "spheres", "lines", "triangles", "texts", "models")
#: Type of `foxglove.LinePrimitive`: each point is joined to the next one.
_LINE_STRIP = 0
_NO_ROTATION = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
Object = dict[str, Any]
Point = tuple[float, float, float]


def write_scene(sources: Sequence[ExportSource], path: Path) -> None:
    """Write the scene."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="", library="conetl")
        topics = {LINES_TOPIC if source.lines else TOPIC: SCENE_UPDATE for source in sources}
        *scenes, frame, place = (
            writer.register_channel(
                topic, "json", writer.register_schema(schema["title"], "jsonschema", json.dumps(schema).encode())
            )
            for topic, schema in (topics | {"/tf": FRAME_TRANSFORM, "/origin": LOCATION_FIX}).items()
        )
        origin: Point | None = None
        for scene, source in zip(scenes, sources, strict=True):
            for instant_us, group in groupby(_rows(source), key=lambda row: row["instant_us"]):
                while chunk := list(islice(group, _MESSAGE_ROWS)):
                    messages: list[tuple[int, Object]] = []
                    if origin is None:
                        origin = _origin(chunk[0])
                        messages += zip((frame, place), _origin_messages(origin, source, instant_us), strict=True)
                    messages.append((scene, _scene(chunk, origin, source.request.what)))
                    for channel, message in messages:
                        data = json.dumps(message, allow_nan=False, separators=(",", ":")).encode()
                        writer.add_message(
                            channel, log_time=instant_us * 1000, publish_time=instant_us * 1000, data=data
                        )
        writer.finish()  # type: ignore[no-untyped-call]


def _rows(source: ExportSource) -> Iterator[Object]:
    """Rows in the order of `instant_us`, the time at which they are shown (UTC microseconds since 1970)."""
    request = source.request
    shown_at = request.until if request.what is ExportContent.CHANGES else request.as_of
    shown_at = shown_at or request.known_at or source.info.last_committed_at or datetime.now(UTC)
    fixed_us = ns_from_utc(shown_at) // 1000
    for batch in source.batches:
        rows = batch.to_pylist()
        if source.lines:
            vertices_m, of_row = source.vertices_m(batch)
            for row, line in zip(rows, np.split(vertices_m, np.flatnonzero(np.diff(of_row)) + 1), strict=True):
                row[LINE_NAME] = line
        for row in rows:
            row["instant_us"] = (
                ns_from_utc(row["valid_from"]) // 1000 if request.what is ExportContent.HISTORY else fixed_us
            )
            yield row


def _scene(rows: list[Object], origin: Point, what: ExportContent) -> Object:
    gone = [row for row in rows if what is ExportContent.HISTORY and not row["present"]]
    drawn = [row for row in rows if what is not ExportContent.HISTORY or row["present"]]
    return {
        "deletions": [{"timestamp": _time(row["instant_us"]), "type": 0, "id": row["feature_id"]} for row in gone],
        "entities": [_entity(row, origin) for row in drawn],
    }


def _entity(row: Object, origin: Point) -> Object:
    colour = _colour(row["change"], row["existence_probability"])
    primitives = _stripes(row, origin, colour) if LINE_NAME in row else _body(row, origin, colour)
    left_out = ("feature_id", "instant_us", LINE_NAME)
    return {
        "timestamp": _time(row["instant_us"]),
        "frame_id": FRAME,
        "id": row["feature_id"],
        "lifetime": {"sec": 0, "nsec": 0},
        "frame_locked": False,
        "metadata": [{"key": key, "value": _text(row[key])} for key in row if key not in left_out],
        **{kind: primitives.get(kind, []) for kind in _PRIMITIVES},
    }


def _stripes(row: Object, origin: Point, colour: Object) -> Object:
    """A lane marking in its width: one line, or one per dash."""
    line = row[LINE_NAME] - np.array(origin)
    if row["change"] in (None, "confirmed", "missed"):
        colour = _rgb(PAINT[row["colour"]]) | {"a": colour["a"]}
    return {
        "lines": [
            {
                "type": _LINE_STRIP,
                "pose": {"position": {"x": 0.0, "y": 0.0, "z": 0.0}, "orientation": _NO_ROTATION},
                "thickness": row["width_m"],
                "scale_invariant": False,
                "points": [dict(zip("xyz", map(float, vertex), strict=True)) for vertex in part],
                "color": colour,
                "colors": [],
                "indices": [],
            }
            for part in dashes_of(line, row["dash_m"], row["gap_m"])
        ]
    }


def _body(row: Object, origin: Point, colour: Object) -> Object:
    """A cone (a cylinder for objects of other classes), and an arrow if it was moved."""
    x, y, z = row["easting_m"] - origin[0], row["northing_m"] - origin[1], row["ellipsoidal_height_m"] - origin[2]
    height_m = row["object_height_m"]
    category = row["category"]
    width, top_share = (_FOOT_WIDTH, _TOP_SHARE) if category == CONE else (width_over_height(category), 1.0)
    width_m = width * height_m
    cone = {
        "pose": {"position": {"x": x, "y": y, "z": z + height_m / 2}, "orientation": _NO_ROTATION},
        "size": {"x": width_m, "y": width_m, "z": height_m},
        "bottom_scale": 1.0,
        "top_scale": top_share,
        "color": colour,
    }
    arrows = []
    if row["change"] == "moved" and row.get("old_easting_m") is not None:
        old = (
            row["old_easting_m"] - origin[0],
            row["old_northing_m"] - origin[1],
            row["old_ellipsoidal_height_m"] - origin[2],
        )
        arrows = [_arrow(old, (x, y, z), width_m, colour)]
    return {"arrows": arrows, "cylinders": [cone]}


def _arrow(start: Point, end: Point, width_m: float, colour: Object) -> Object:
    """A level arrow from the old to the new position."""
    length_m = math.hypot(end[0] - start[0], end[1] - start[1])
    heading = math.atan2(end[1] - start[1], end[0] - start[0])
    head_m = min(0.3, length_m / 2)
    rotation = {"x": 0.0, "y": 0.0, "z": math.sin(heading / 2), "w": math.cos(heading / 2)}
    return {
        "pose": {"position": dict(zip("xyz", start, strict=True)), "orientation": rotation},
        "shaft_length": length_m - head_m,
        "shaft_diameter": width_m / 6,
        "head_length": head_m,
        "head_diameter": width_m / 2,
        "color": colour,
    }


def _origin(row: Object) -> Point:
    return (
        math.floor(row["easting_m"] / 100) * 100.0,
        math.floor(row["northing_m"] / 100) * 100.0,
        float(math.floor(row["ellipsoidal_height_m"])),
    )


def _origin_messages(origin: Point, source: ExportSource, instant_us: int) -> tuple[Object, Object]:
    """The FrameTransform and the LocationFix of the origin."""
    lon_deg, lat_deg = source.to_wgs84.transform(origin[0], origin[1])
    transform = {
        "timestamp": _time(instant_us),
        "parent_frame_id": f"EPSG:{source.info.srid}",
        "child_frame_id": FRAME,
        "translation": dict(zip("xyz", origin, strict=True)),
        "rotation": _NO_ROTATION,
    }
    fix = {
        "timestamp": _time(instant_us),
        "frame_id": FRAME,
        "latitude": lat_deg,
        "longitude": lon_deg,
        "altitude": origin[2],
        "position_covariance": [0.0] * 9,
        "position_covariance_type": 0,
    }
    return transform, fix


def _colour(change: str | None, existence_probability: float) -> Object:
    alpha = round(0.25 + 0.75 * existence_probability, 3)
    return _rgb(KIND_MARKS[DeltaKind(change or "confirmed")].colour) | {"a": alpha}


def _rgb(colour: str) -> Object:
    return dict(zip("rgb", (part / 255 for part in bytes.fromhex(colour[1:])), strict=True))


def _time(instant_us: int) -> Object:
    return {"sec": instant_us // 1_000_000, "nsec": instant_us % 1_000_000 * 1000}


def _text(value: Any) -> str:
    if isinstance(value, datetime):
        return iso_utc(value)
    return "" if value is None else str(value)


def _object(title: str, **properties: Object) -> Object:
    return {"title": title, "type": "object", "properties": properties}


def _list(items: Object | None = None) -> Object:
    return {"type": "array"} | ({"items": items} if items else {})


_NUMBER, _STRING, _INTEGER = {"type": "number"}, {"type": "string"}, {"type": "integer"}
_NANOSECONDS: Object = {"type": "integer", "minimum": 0, "maximum": 999_999_999}
_TIME = _object("time", sec={"type": "integer", "minimum": 0}, nsec=_NANOSECONDS)
_DURATION = _object("duration", sec=_INTEGER, nsec=_NANOSECONDS)
_VECTOR = _object("foxglove.Vector3", **dict.fromkeys("xyz", _NUMBER))
_QUATERNION = _object("foxglove.Quaternion", **dict.fromkeys("xyzw", _NUMBER))
_POSE = _object("foxglove.Pose", position=_VECTOR, orientation=_QUATERNION)
_COLOUR = _object("foxglove.Color", **dict.fromkeys("rgba", _NUMBER))
_ARROW = _object(
    "foxglove.ArrowPrimitive", pose=_POSE, shaft_length=_NUMBER, shaft_diameter=_NUMBER, head_length=_NUMBER,
    head_diameter=_NUMBER, color=_COLOUR,
)  # fmt: skip
_CYLINDER = _object(
    "foxglove.CylinderPrimitive", pose=_POSE, size=_VECTOR, bottom_scale=_NUMBER, top_scale=_NUMBER, color=_COLOUR
)
_ENTITY = _object(
    "foxglove.SceneEntity", timestamp=_TIME, frame_id=_STRING, id=_STRING, lifetime=_DURATION, frame_locked={"type": "boolean"},
    metadata=_list(_object("foxglove.KeyValuePair", key=_STRING, value=_STRING)),
    arrows=_list(_ARROW), cylinders=_list(_CYLINDER), **{kind: _list() for kind in _PRIMITIVES[2:]},
)  # fmt: skip
#: The three messages, with the names and fields of Foxglove's documentation.
SCENE_UPDATE = _object(
    "foxglove.SceneUpdate",
    deletions=_list(_object("foxglove.SceneEntityDeletion", timestamp=_TIME, type=_INTEGER, id=_STRING)),
    entities=_list(_ENTITY),
)
FRAME_TRANSFORM = _object(
    "foxglove.FrameTransform", timestamp=_TIME, parent_frame_id=_STRING, child_frame_id=_STRING, translation=_VECTOR,
    rotation=_QUATERNION,
)  # fmt: skip
LOCATION_FIX = _object(
    "foxglove.LocationFix", timestamp=_TIME, frame_id=_STRING, latitude=_NUMBER, longitude=_NUMBER, altitude=_NUMBER,
    position_covariance=_list(_NUMBER), position_covariance_type=_INTEGER,
)  # fmt: skip
