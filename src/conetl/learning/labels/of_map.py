"""Labels out of a map: the boxes that people's decisions confirm, correct or refuse, in the images of the drives.

pin: the object stands there; in images in which nothing was observed at its position, its box is projected. classify: the boxes
have another class. approve: the boxes of the drive that made the change are right or, where it removed an object, nothing stands
there. suppress: nothing stands there. A drive that was accepted or reverted says nothing about a box.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from uuid import UUID

import numpy as np

from conetl.db import serve_store as store
from conetl.db.connection import Connection
from conetl.db.map.decision_store import list_decisions
from conetl.db.map.map_store import list_changesets
from conetl.db.map.results import StoredDecision
from conetl.files.names import file_name_part
from conetl.learning.classes import CLASSES
from conetl.learning.labels.folder import (
    NOTHING,
    BoxRow,
    ImageRow,
    LabelFormat,
    Unusable,
    require_new,
    write_label_files,
)
from conetl.model.errors import ConetlError, InputError
from conetl.model.map_records import DeltaKind
from conetl.model.rig import SIDES, Rig, Side
from conetl.perception.decoding import intersection_over_union
from conetl.perception.images import ImageFileError
from conetl.perception.rectified_image import read_rig_image
from conetl.reports.camera_images import Box, image_file, jpeg
from conetl.reports.drive_passes import PassFrame, expected_box, passes_of, pose_of

_KINDS = ("pin", "classify", "approve", "suppress")
#: More drives past one object add nothing.
_MAX_DRIVES = 200
#: Boxes that overlap more are of one object: the last decision about it counts.
_SAME_BOX_IOU = 0.5
#: Of a projected box, at least this share must lie in the image.
_LEAST_SHARE = 0.6
_JPEG_QUALITY = 95


class Place(NamedTuple):
    """One image: drive, frame pair, side."""

    drive_uuid: UUID
    frame_index: int
    side: Side


class MapLabels(NamedTuple):
    """What `export_labels` wrote."""

    images: list[ImageRow]
    boxes: list[BoxRow]
    unusable: list[Unusable]


def export_labels(
    conn: Connection, folder: Path, *, map_name: str, frames: int, form: LabelFormat = "yolo"
) -> MapLabels:
    """Write the images and boxes that the active decisions of a map judge. frames: pairs per decision and drive.

    Raises InputError, with nothing written, where no decision judges a box or the folder holds files.
    """
    require_new(folder)
    unusable: list[Unusable] = []
    wanted: dict[Place, list[BoxRow]] = {}
    drives = {one.changeset_id: one.drive_uuid for one in list_changesets(conn, map_name=map_name)}
    decisions = [d for d in list_decisions(conn, map_name=map_name) if d.kind in _KINDS and not d.of_line]
    for decision in decisions:  # oldest first
        approved = decision.approves and drives.get(decision.approves)
        for place, box in _boxes_of(conn, map_name, decision, approved, frames, unusable):
            known = wanted.setdefault(place, [])
            corners = np.array([one.corners for one in known]).reshape(-1, 4)
            same = intersection_over_union(np.array(box.corners), corners) > _SAME_BOX_IOU
            wanted[place] = [one for one, is_same in zip(known, same, strict=True) if not is_same] + [box]
    if not wanted:
        raise InputError(
            f"no decision about the map {map_name} judges a box in an image: pin, classify, suppress or approve objects first "
            "(`conetl view --decisions`)"
        )
    (folder / "images").mkdir(parents=True, exist_ok=True)
    images: list[ImageRow] = []
    boxes: list[BoxRow] = []
    for place, judged in wanted.items():
        row = _frame(conn, map_name, place)
        name = f"{file_name_part(row['drive_id'], 150)}_{str(place.drive_uuid)[:8]}_{place.frame_index:06d}_{place.side}.jpg"
        try:
            path = image_file(row["source_path"], row[f"{place.side}_path"])
            image = read_rig_image(path, Rig.model_validate(row["rig"]), place.side)
        except (ConetlError, ImageFileError) as error:
            unusable += [Unusable(f"{box.origin} {box.decision_id}: {name}", str(error)) for box in judged]
            continue
        (folder / "images" / name).write_bytes(jpeg(image, _JPEG_QUALITY))
        images.append(ImageRow(name, row["drive_id"], "", image.shape[1], image.shape[0]))
        boxes += [box._replace(image=name) for box in judged]
    write_label_files(folder, images, boxes, unusable, form)
    return MapLabels(images, boxes, unusable)


def _boxes_of(
    conn: Connection,
    map_name: str,
    decision: StoredDecision,
    approved: UUID | None,
    frames: int,
    unusable: list[Unusable],
) -> Iterator[tuple[Place, BoxRow]]:
    """The boxes that one decision judges; why there are none goes to `unusable`. approved: the drive whose change it approves."""
    record = f"{decision.kind} {decision.decision_id}"
    history = [] if decision.feature_id is None else store.read_feature_history(conn, map_name, decision.feature_id)
    if decision.feature_id is None or not history:
        unusable.append(Unusable(record, "its feature is no longer on the map"))
        return
    state, only = history[-1], None
    category = decision.category or state["category"]
    judged = category if decision.kind != "suppress" else NOTHING
    if decision.kind == "approve":
        changes = [row["kind"] for row in history if row["drive_uuid"] == approved]
        if approved is None or not changes:
            unusable.append(Unusable(record, "the change that it approves is no longer in effect"))
            return
        only = [approved]
        judged = NOTHING if changes[-1] == DeltaKind.REMOVED else category
    if category not in CLASSES:
        unusable.append(Unusable(record, f"the network does not know the class {category}"))
        return
    found = 0
    observed = store.observed_frames(conn, map_name, decision.feature_id)
    for one in passes_of(conn, map_name, decision.feature_id, state, max_drives=_MAX_DRIVES, only=only):
        matches = observed.get(one.drive_uuid, ("", {}))[1]
        shown = [frame for frame in one.frames if frame.state == "observed"]
        if (judged != NOTHING and decision.kind == "pin") or (judged == NOTHING and decision.kind == "approve"):
            shown += [frame for frame in one.frames if frame.state == "empty"]
        for frame in _spread(shown, frames):
            for side in SIDES:
                place = Place(one.drive_uuid, frame.frame_index, side)
                box, kind = _box_in(conn, map_name, place, matches.get(frame.frame_index), state)
                if box is None:
                    continue
                found += 1
                yield place, BoxRow(
                    "", judged, *box, origin=decision.kind, decision_id=str(decision.decision_id),
                    feature_id=str(decision.feature_id), decided_by=decision.decided_by or "", box=kind,
                )  # fmt: skip
    if found == 0:
        unusable.append(
            Unusable(record, "no kept record of a drive shows it: pruned, archived, or from an imported map")
        )


def _spread(frames: Sequence[PassFrame], most: int) -> list[PassFrame]:
    """At most so many frame pairs, evenly over the distances from which they were taken."""
    ordered = sorted(frames, key=lambda frame: frame.range_m)
    chosen = np.unique(np.linspace(0, len(ordered) - 1, min(most, len(ordered))).round().astype(int))
    return [ordered[k] for k in chosen.tolist()]


def _box_in(
    conn: Connection, map_name: str, place: Place, match_index: int | None, state: dict[str, Any]
) -> tuple[Box | None, str]:
    """The box of a feature in one image: as it was detected there, else projected; None where it is not in the image."""
    for box in store.read_frame_boxes(conn, place.drive_uuid, place.frame_index)[place.side]:
        if match_index is not None and box["match_index"] == match_index and box["score"] is not None:
            return (box["x_px"], box["y_px"], box["w_px"], box["h_px"]), "detected"
    row = _frame(conn, map_name, place)
    rig = Rig.model_validate(row["rig"])
    xyz_m = (state["easting_m"], state["northing_m"], state["ellipsoidal_height_m"])
    whole = expected_box(xyz_m, state["object_height_m"], pose_of(row), rig, place.side, state["category"])
    if whole is None:
        return None, ""
    camera = rig.left if place.side == "left" else rig.right
    x, y, w, h = whole
    left, top = max(x, 0.0), max(y, 0.0)
    seen_w, seen_h = min(x + w, camera.width_px) - left, min(y + h, camera.height_px) - top
    is_seen = min(seen_w, seen_h) > 0 and seen_w * seen_h >= _LEAST_SHARE * w * h
    return ((left, top, seen_w, seen_h) if is_seen else None), "projected"


def _frame(conn: Connection, map_name: str, place: Place) -> dict[str, Any]:
    where = {"drive_uuid": place.drive_uuid, "frame_index": place.frame_index}
    return store.read_rows(conn, "judging.frame", map_name=map_name, **where)[0]
