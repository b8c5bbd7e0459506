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
from conetl.mapping.visibility import DriveObservations, observations_of_drive, pairs_in_view
from conetl.model.errors import StorageError
from conetl.model.params import ReconcileParams
from conetl.model.records import SIDES, Rig, utc_from_ns
from conetl.perception.images import ImageFileError
from conetl.reports.camera_images import SURROUNDINGS, ImageMissingError, crop_jpeg, image_file
from conetl.reports.drive_facts import DriveChange, DriveFacts
from conetl.reports.html import data_uri

#: Changes with images on one page; the table lists all.
MAX_ILLUSTRATED = 120


@dataclass(frozen=True)
class PairOfCrops:
    """Left and right crop with a title. Without crops, `missing` holds the reason."""

    title: str
    crops: tuple[Markup, ...]
    missing: str = ""


def images_of(conn: Connection, facts: DriveFacts, changes: Sequence[DriveChange]) -> dict[int, list[PairOfCrops]]:
    """Pairs of crops, earlier ones first, by number of the change; of at most `MAX_ILLUSTRATED`, confirmations excluded."""
    shown = [change for change in changes if not change.is_confirmation][:MAX_ILLUSTRATED]
    drive = observations_of_drive(facts.rig, facts.frame_pairs, (), ())
    return {change.number: _of_change(conn, facts, change, drive) for change in shown}


def _of_change(conn: Connection, facts: DriveFacts, change: DriveChange, drive: DriveObservations) -> list[PairOfCrops]:
    found: list[PairOfCrops] = []
    if not change.kind.founds:
        captured_from_ns = facts.changeset.captured_from_ns
        for row in _rows(conn, "seen_before", feature_id=change.feature_id, before_ns=captured_from_ns)[:1]:
            title = f"before: {row['drive_id']}, {utc_from_ns(row['captured_from_ns']):%Y-%m-%d}"
            found.append(_sighting(conn, row["drive_uuid"], row["track_index"], title))
    if change.track_index is not None:
        found.append(_sighting(conn, facts.changeset.drive_uuid, change.track_index, "this drive"))
    elif not facts.pruned_at:
        found.append(_expected(facts, change, drive))
    return found


def _sighting(conn: Connection, drive_uuid: UUID, track_index: int, title: str) -> PairOfCrops:
    """The nearest frame pair of a track."""
    rows = _rows(conn, "sighting", drive_uuid=drive_uuid, track_index=track_index)
    if not rows:
        return PairOfCrops(title, (), "its raw records were pruned")
    row = rows[0]
    title += f", frame {row['frame_index']}, {row['range_m']:.1f} m"
    boxes = [tuple(row[f"{side}_{name}_px"] for name in "xywh") for side in SIDES]
    paths = [row["left_path"], row["right_path"]]
    return _crops(title, row["source_path"], Rig.model_validate(row["rig"]), paths, boxes)


def _expected(facts: DriveFacts, change: DriveChange, drive: DriveObservations) -> PairOfCrops:
    """The expected image of the object, in the pair where it is largest of those in which both images would contain it."""
    rows, heights_px, boxes = pairs_in_view(
        np.array(change.xyz_m), change.cone_height_m, drive, ReconcileParams(), change.category
    )
    if not len(rows):
        return PairOfCrops("this drive", (), "its position is not completely in view in any image pair")
    largest = int(heights_px[:, 0].argmax())
    pair = facts.frame_pairs[rows[largest]]
    title = f"this drive, frame {pair.frame_index}: expected position"
    shown = [(x0 + 0.5, y0 + 0.5, x1 - x0, y1 - y0) for x0, y0, x1, y1 in boxes[largest]]
    return _crops(title, facts.source_path, facts.rig, [pair.left_path, pair.right_path], shown)


def _crops(title: str, source_path: str, rig: Rig, paths: Sequence[str], boxes: Sequence[Any]) -> PairOfCrops:
    try:
        crops = [
            data_uri(crop_jpeg(image_file(source_path, path), rig, side, box, context=SURROUNDINGS), "jpeg")
            for side, path, box in zip(SIDES, paths, boxes, strict=True)
        ]
    except (ImageMissingError, ImageFileError, StorageError, OSError) as error:
        return PairOfCrops(title, (), f"{Path(paths[0]).name}: {error}")
    return PairOfCrops(title, tuple(crops))


def _rows(conn: Connection, name: str, **parameters: Any) -> list[dict[str, Any]]:
    with database_errors("The sightings cannot be read"):
        return execute(conn, load_sql(f"reports.{name}"), parameters)
