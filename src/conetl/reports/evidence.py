"""Images of each changed cone: as the drive saw it, as it was seen before, and the empty place of one that is gone."""

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
from conetl.reports.crops import Box, ImageMissingError, crop_jpeg, picture_file
from conetl.reports.drive_facts import Change, DriveFacts
from conetl.reports.render import data_uri

#: Images of more changes would make a page that nobody opens; the table has them all.
MAX_ILLUSTRATED = 120
_CONTEXT = 3.0
_SIDES: tuple[Side, Side] = ("left", "right")
#: A cone's box is about so many times as wide as it is tall.
_WIDTH_OF_HEIGHT = 0.62
_BORDER_PX, _LEAST_RANGE_M = 12.0, 2.5


@dataclass(frozen=True)
class PairOfCrops:
    """Left and right crop with what they show; where a image is gone, `missing` says why."""

    title: str
    crops: tuple[Markup, ...]
    missing: str = ""


def images_of(conn: Connection, facts: DriveFacts, changes: Sequence[Change]) -> dict[int, list[PairOfCrops]]:
    """Pairs of crops by a change's number, earlier ones first; of the first `MAX_ILLUSTRATED` changes that are no
    confirmations."""
    shown = [change for change in changes if not change.is_confirmation][:MAX_ILLUSTRATED]
    return {change.number: _of_change(conn, facts, change) for change in shown}


def _of_change(conn: Connection, facts: DriveFacts, change: Change) -> list[PairOfCrops]:
    found: list[PairOfCrops] = []
    if not change.kind.founds:
        before = _rows(conn, "seen_before", feature_id=change.feature_id, before_ns=facts.changeset.captured_from_ns)
        if before:
            at = utc_from_ns(before[0]["captured_from_ns"])
            title = f"before: {before[0]['drive_id']}, {at:%Y-%m-%d}"
            found.append(_sighting(conn, before[0]["drive_uuid"], before[0]["track_index"], title))
    if change.track_index is not None:
        found.append(_sighting(conn, facts.changeset.drive_uuid, change.track_index, "this drive"))
    elif not facts.pruned_at:
        found.append(_empty_place(facts, change))
    return found


def _sighting(conn: Connection, drive_uuid: UUID, track_index: int, title: str) -> PairOfCrops:
    rows = _rows(conn, "sighting", drive_uuid=drive_uuid, track_index=track_index)
    if not rows:
        return PairOfCrops(title, (), "its raw records were pruned")
    row = rows[0]
    boxes = [tuple(row[f"{side}_{name}_px"] for name in "xywh") for side in _SIDES]
    return _crops(
        f"{title}, frame {row['frame_index']}, {row['range_m']:.1f} m", row["source_path"], Rig.model_validate(row["rig"]),
        [row["left_path"], row["right_path"]], boxes,
    )  # fmt: skip


def _empty_place(facts: DriveFacts, change: Change) -> PairOfCrops:
    """Where the cone should show in the pair that saw its place best."""
    best: tuple[float, FramePair, list[Box]] | None = None
    for pair in facts.frame_pairs:
        boxes = [_expected_box(pair, facts.rig, side, change) for side in _SIDES]
        good = [box for box in boxes if box is not None]
        if len(good) == len(boxes) and (best is None or good[0][3] > best[0]):
            best = good[0][3], pair, good
    if best is None:
        return PairOfCrops("this drive", (), "its place is in no pair of images as a whole")
    _, pair, boxes_in_view = best
    return _crops(
        f"this drive, frame {pair.frame_index}: where it should stand, by pose alone", facts.source_path, facts.rig,
        [pair.left_path, pair.right_path], boxes_in_view,
    )  # fmt: skip


def _expected_box(pair: FramePair, rig: Rig, side: Side, change: Change) -> Box | None:
    """The box of a cone of the feature's height at its place; None where it is not in view as a whole."""
    camera = camera_of(rig, side)
    foot = np.array(change.xyz_m)
    points = np.stack([foot, foot + np.array([0.0, 0.0, change.cone_height_m])])
    seen = se3.apply(se3.invert(map_SE3_camera(pair.pose, rig, side)), points)
    if seen[:, 2].min() < _LEAST_RANGE_M:
        return None
    (u, bottom), (_, top) = cameras.project(camera, seen).tolist()
    height = bottom - top
    width = _WIDTH_OF_HEIGHT * height
    left, right = u - width / 2, u + width / 2
    inside = (
        left >= _BORDER_PX and right <= camera.width_px - _BORDER_PX
        and top >= _BORDER_PX and bottom <= camera.height_px - _BORDER_PX
    )  # fmt: skip
    return (left + 0.5, top + 0.5, width, height) if inside and height > 1 else None


def _crops(title: str, source_path: str, rig: Rig, paths: Sequence[str], boxes: Sequence[Any]) -> PairOfCrops:
    try:
        crops = [
            data_uri(crop_jpeg(picture_file(source_path, path), rig, side, box, context=_CONTEXT), "jpeg")
            for side, path, box in zip(_SIDES, paths, boxes, strict=True)
        ]
    except (ImageMissingError, ImageFileError, StorageError, OSError) as error:
        return PairOfCrops(title, (), f"{Path(paths[0]).name}: {error}")
    return PairOfCrops(title, tuple(crops))


def _rows(conn: Connection, name: str, **parameters: Any) -> list[dict[str, Any]]:
    with database_errors("The sightings cannot be read"):
        return execute(conn, load_sql(f"reports.{name}"), parameters)
