"""The map as an MCAP recording for Foxglove: cones in true size, coloured by what changed.

Topics, all JSON with the schemas of https://docs.foxglove.dev/docs/sdk/schemas: /cones (SceneUpdate), /tf (FrameTransform
from the map's CRS
to a frame `map` with its origin near the first cone, because the graphics card counts in float32) and /origin (LocationFix
of that
origin). Features and changes are one instant; a history is told in the order of the road's time, in one belief (that of
`believed_at`): cones come, change and go as the recording plays.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from datetime import UTC, datetime
from itertools import groupby, islice
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import Writer

from conetl.exports.foxglove_schemas import FRAME_TRANSFORM, LOCATION_FIX, SCENE_UPDATE
from conetl.exports.kind_marks import KIND_MARKS
from conetl.exports.source import Source, What
from conetl.model.map_records import DeltaKind

FRAME = "map"
TOPIC = "/cones"
#: Entities of one message.
_MESSAGE_ROWS = 1000
#: A road cone: diameter of the foot over the height, and of the top over that of the foot.
_FOOT_WIDTH, _TOP_SHARE = 0.4, 0.175
_EMPTY = ("arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models")
_NO_TURN = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
Row = dict[str, Any]


def write(source: Source, path: Path) -> int:
    """Write the scene; the number of rows."""
    count = 0
    rows = _rows(source)
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="", library="conetl")
        channels = [
            writer.register_channel(
                topic, "json", writer.register_schema(name, "jsonschema", json.dumps(schema).encode())
            )
            for topic, name, schema in (
                (TOPIC, "foxglove.SceneUpdate", SCENE_UPDATE),
                ("/tf", "foxglove.FrameTransform", FRAME_TRANSFORM),
                ("/origin", "foxglove.LocationFix", LOCATION_FIX),
            )
        ]
        origin: tuple[float, float, float] | None = None
        for instant_us, group in groupby(rows, key=lambda row: row["instant_us"]):
            log_time_ns = instant_us * 1000
            while chunk := list(islice(group, _MESSAGE_ROWS)):
                if origin is None:
                    origin = _origin(chunk[0])
                    for channel, message in zip(channels[1:], _place_of(origin, source, instant_us), strict=True):
                        _add(writer, channel, log_time_ns, message)
                _add(writer, channels[0], log_time_ns, _scene(chunk, origin, source.request.what))
                count += len(chunk)
        writer.finish()  # type: ignore[no-untyped-call]
    return count


def _rows(source: Source) -> Iterator[Row]:
    """Rows with `instant_us`, the instant that they are shown at (UTC microseconds since 1970), rising."""
    request = source.request
    shown_at = request.until if request.what is What.CHANGES else request.as_of
    shown_at = shown_at or request.believed_at or source.info.last_committed_at or datetime.now(UTC)
    fixed_us = _microseconds(shown_at)
    for batch in source.batches():
        for row in batch.to_pylist():
            row["instant_us"] = _microseconds(row["valid_from"]) if request.what is What.HISTORY else fixed_us
            yield row


def _scene(rows: list[Row], origin: tuple[float, float, float], what: What) -> Row:
    gone = [row for row in rows if what is What.HISTORY and not row["present"]]
    drawn = [row for row in rows if what is not What.HISTORY or row["present"]]
    return {
        "deletions": [{"timestamp": _time(row["instant_us"]), "type": 0, "id": row["feature_id"]} for row in gone],
        "entities": [_entity(row, origin) for row in drawn],
    }


def _entity(row: Row, origin: tuple[float, float, float]) -> Row:
    x, y, z = row["easting_m"] - origin[0], row["northing_m"] - origin[1], row["ellipsoidal_height_m"] - origin[2]
    height_m = row["height_m"]
    colour = _colour(row["change"], row["existence_probability"])
    width_m = _FOOT_WIDTH * height_m
    entity: Row = {
        "timestamp": _time(row["instant_us"]),
        "frame_id": FRAME,
        "id": row["feature_id"],
        "lifetime": {"sec": 0, "nsec": 0},
        "frame_locked": False,
        "metadata": [{"key": key, "value": _text(row[key])} for key in row if key not in ("feature_id", "instant_us")],
        **{kind: [] for kind in _EMPTY},
    }
    entity["cylinders"] = [
        {
            "pose": {"position": {"x": x, "y": y, "z": z + height_m / 2}, "orientation": _NO_TURN},
            "size": {"x": width_m, "y": width_m, "z": height_m},
            "bottom_scale": 1.0,
            "top_scale": _TOP_SHARE,
            "color": colour,
        }
    ]
    if row["change"] == "moved" and row.get("old_easting_m") is not None:
        old = (row["old_easting_m"] - origin[0], row["old_northing_m"] - origin[1], row["old_height_m"] - origin[2])
        entity["arrows"] = [_arrow(old, (x, y, z), width_m, colour)]
    return entity


def _arrow(start: tuple[float, float, float], end: tuple[float, float, float], width_m: float, colour: Row) -> Row:
    """Flat on the ground, from the old place to the new one."""
    length_m = math.hypot(end[0] - start[0], end[1] - start[1])
    heading = math.atan2(end[1] - start[1], end[0] - start[0])
    head_m = min(0.3, length_m / 2)
    turn = {"x": 0.0, "y": 0.0, "z": math.sin(heading / 2), "w": math.cos(heading / 2)}
    return {
        "pose": {"position": dict(zip("xyz", start, strict=True)), "orientation": turn},
        "shaft_length": length_m - head_m,
        "shaft_diameter": width_m / 6,
        "head_length": head_m,
        "head_diameter": width_m / 2,
        "color": colour,
    }


def _place_of(origin: tuple[float, float, float], source: Source, instant_us: int) -> tuple[Row, Row]:
    lon_deg, lat_deg = source.to_wgs84.transform(origin[0], origin[1])
    transform = {
        "timestamp": _time(instant_us),
        "parent_frame_id": f"EPSG:{source.info.srid}",
        "child_frame_id": FRAME,
        "translation": dict(zip("xyz", origin, strict=True)),
        "rotation": _NO_TURN,
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


def _origin(row: Row) -> tuple[float, float, float]:
    return (
        math.floor(row["easting_m"] / 100) * 100.0,
        math.floor(row["northing_m"] / 100) * 100.0,
        float(math.floor(row["ellipsoidal_height_m"])),
    )


def _colour(change: str | None, existence_probability: float) -> Row:
    code = KIND_MARKS[DeltaKind(change or "confirmed")].colour
    red, green, blue = (int(code[i : i + 2], 16) / 255 for i in (1, 3, 5))
    return {"r": red, "g": green, "b": blue, "a": round(0.25 + 0.75 * existence_probability, 3)}


def _time(instant_us: int) -> Row:
    return {"sec": instant_us // 1_000_000, "nsec": instant_us % 1_000_000 * 1000}


def _microseconds(instant: datetime) -> int:
    return int(np.datetime64(instant.astimezone(UTC).replace(tzinfo=None), "us").astype(np.int64))


def _text(value: Any) -> str:
    if isinstance(value, datetime):
        return value.astimezone(UTC).isoformat(timespec="microseconds").replace("+00:00", "Z")
    return "" if value is None else str(value)


def _add(writer: Writer, channel: int, log_time_ns: int, message: Row) -> None:
    data = json.dumps(message, allow_nan=False, separators=(",", ":")).encode()
    writer.add_message(channel_id=channel, log_time=log_time_ns, publish_time=log_time_ns, data=data)
