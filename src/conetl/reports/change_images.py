"""Images of each changed cone: seen by this drive, seen before, and the position where a removed one stood."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from uuid import UUID

import numpy as np
from markupsafe import Markup

from conetl.db.connection import Connection, database_errors, execute
from conetl.db.statements import load_sql
from conetl.geometry import camera as cameras
from conetl.geometry import pose as se3
from conetl.geometry.rig import camera_of, map_SE3_camera
from conetl.model.errors import StorageError
from conetl.model.records import FramePair, Rig, Side, utc_from_ns
from conetl.perception.images import ImageFileError
from conetl.reports.camera_images import Box, ImageMissingError, crop_jpeg, image_file
from conetl.reports.drive_facts import DriveChange, DriveFacts
from conetl.reports.html import data_uri

#: Changes with images on one page; the table lists all.
MAX_ILLUSTRATED = 120
_CONTEXT = 3.0
_SIDES: tuple[Side, Side] = ("left", "right")
#: Width of a cone's box over its height.
_ASPECT = 0.62
_BORDER_PX, _LEAST_RANGE_M = 12.0, 2.5


@dataclass(frozen=True)
class PairOfCrops:
    """Left and right crop with a title. Without crops, `missing` holds the reason."""

    title: str
    crops: tuple[Markup, ...]
    missing: str = ""


def images_of(conn: Connection, facts: DriveFacts, changes: Sequence[DriveChange]) -> dict[int, list[PairOfCrops]]:
    """Pairs of crops, earlier ones first, by number of the change; of at most `MAX_ILLUSTRATED`, confirmations excluded."""
    shown = [change for change in changes if not change.is_confirmation][:MAX_ILLUSTRATED]
    return {change.number: _of_change(conn, facts, change) for change in shown}


def _of_change(conn: Connection, facts: DriveFacts, change: DriveChange) -> list[PairOfCrops]:
    found: list[PairOfCrops] = []
    if not change.kind.founds:
        captured_from_ns = facts.changeset.captured_from_ns
        for row in _rows(conn, "seen_before", feature_id=change.feature_id, before_ns=captured_from_ns)[:1]:
            title = f"before: {row['drive_id']}, {utc_from_ns(row['captured_from_ns']):%Y-%m-%d}"
            found.append(_sighting(conn, row["drive_uuid"], row["track_index"], title))
    if change.track_index is not None:
        found.append(_sighting(conn, facts.changeset.drive_uuid, change.track_index, "this drive"))
    elif not facts.pruned_at:
        found.append(_expected(facts, change))
    return found


def _sighting(conn: Connection, drive_uuid: UUID, track_index: int, title: str) -> PairOfCrops:
    """The nearest frame pair of a track."""
    rows = _rows(conn, "sighting", drive_uuid=drive_uuid, track_index=track_index)
    if not rows:
        return PairOfCrops(title, (), "its raw records were pruned")
    row = rows[0]
    title += f", frame {row['frame_index']}, {row['range_m']:.1f} m"
    boxes = [tuple(row[f"{side}_{name}_px"] for name in "xywh") for side in _SIDES]
    paths = [row["left_path"], row["right_path"]]
    return _crops(title, row["source_path"], Rig.model_validate(row["rig"]), paths, boxes)


def _expected(facts: DriveFacts, change: DriveChange) -> PairOfCrops:
    """The expected image of the cone, in the pair where it is largest."""
    best: tuple[FramePair, list[Box]] | None = None
    for pair in facts.frame_pairs:
        boxes = [box for side in _SIDES if (box := _expected_box(pair, facts.rig, side, change)) is not None]
        if len(boxes) == len(_SIDES) and (best is None or boxes[0][3] > best[1][0][3]):
            best = pair, boxes
    if best is None:
        return PairOfCrops("this drive", (), "its position is not completely in view in any image pair")
    pair, boxes = best
    title = f"this drive, frame {pair.frame_index}: expected position"
    return _crops(title, facts.source_path, facts.rig, [pair.left_path, pair.right_path], boxes)


def _expected_box(pair: FramePair, rig: Rig, side: Side, change: DriveChange) -> Box | None:
    """The box of a cone of the feature's height at its position; None where it is not completely in view."""
    camera = camera_of(rig, side)
    points = np.add(change.xyz_m, [[0.0, 0.0, 0.0], [0.0, 0.0, change.cone_height_m]])
    seen = se3.apply(se3.invert(map_SE3_camera(pair.pose, rig, side)), points)
    if seen[:, 2].min() < _LEAST_RANGE_M:
        return None
    (u, bottom), (_, top) = cameras.project(camera, seen).tolist()
    height = bottom - top
    width = _ASPECT * height
    left = u - width / 2
    inside = (
        left >= _BORDER_PX and left + width <= camera.width_px - _BORDER_PX
        and top >= _BORDER_PX and bottom <= camera.height_px - _BORDER_PX
    )  # fmt: skip
    return (left + 0.5, top + 0.5, width, height) if inside and height > 1 else None


def _crops(title: str, source_path: str, rig: Rig, paths: Sequence[str], boxes: Sequence[Any]) -> PairOfCrops:
    try:
        crops = [
            data_uri(crop_jpeg(image_file(source_path, path), rig, side, box, context=_CONTEXT), "jpeg")
            for side, path, box in zip(_SIDES, paths, boxes, strict=True)
        ]
    except (ImageMissingError, ImageFileError, StorageError, OSError) as error:
        return PairOfCrops(title, (), f"{Path(paths[0]).name}: {error}")
    return PairOfCrops(title, tuple(crops))


def _rows(conn: Connection, name: str, **parameters: Any) -> list[dict[str, Any]]:
    with database_errors("The sightings cannot be read"):
        return execute(conn, load_sql(f"reports.{name}"), parameters)
