"""`conetl labels export` out of a map with images and decisions, and `labels import` of what it wrote."""

from __future__ import annotations

import csv
import json

import cv2
import numpy as np
import pytest

from conetl.db.connection import execute
from conetl.db.map.decision_store import list_decisions
from conetl.db.map.map_store import read_current_features
from conetl.learning.labels.folder import NOTHING, read_label_folder
from conetl.pipeline.maps.decisions import approve_change
from tests.integration.conftest import command_line
from tests.integration.drives_of_days import merge, survey
from tests.view_map import with_images

CLASSES_OF = {"pin": "traffic_cone", "classify": "drum", "suppress": NOTHING, "approve": NOTHING}


def table(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def removed_feature(conn):
    sql = "select feature_id from conetl.feature_delta where kind = 'removed' and upper_inf(system_period)"
    [row] = execute(conn, sql)
    conn.rollback()
    return row["feature_id"]


@pytest.fixture(scope="module")
def judged(module_conn, module_database_url, tmp_path_factory):
    """Two days of a road with images; one cone is pinned, one a drum, one suppressed, and a removal approved."""
    folder = tmp_path_factory.mktemp("labels")
    for day in (0, 1):
        made = survey(day)
        paths = [
            {"left_path": f"left/{k}.png", "right_path": f"right/{k}.png"} for k in range(len(made.drive.frame_pairs))
        ]
        pairs = [pair.model_copy(update=path) for pair, path in zip(made.drive.frame_pairs, paths, strict=True)]
        drive = made.drive.model_copy(update={"frame_pairs": tuple(pairs)})
        drive = with_images(drive, made.detections, folder / "drives" / made.drive.drive_id)
        merge(module_conn, made._replace(drive=drive))
        module_conn.commit()
    conetl = command_line(folder / "home", module_database_url)
    gone = removed_feature(module_conn)
    features = sorted(read_current_features(module_conn), key=lambda one: one.xyz_m[0])
    module_conn.rollback()
    for kind, number, *more in (("pin", 0), ("classify", 3, "drum"), ("suppress", 5)):
        conetl("map", kind, features[number].feature_id, *more, "--by", "Ann", "--radius", "0.4")
    approve_change(module_conn, gone, map_name="default", decided_by="Ann")
    module_conn.commit()
    return conetl, folder


def test_decisions_become_labels_with_their_origin(judged, module_conn):
    conetl, folder = judged
    said = json.loads(conetl("labels", "export", folder / "labels", "--json"))
    boxes, images = (table(folder / "labels" / name) for name in ("boxes.csv", "images.csv"))
    assert said["images"] == len(images) > 0 and said["boxes"] == len(boxes) and said["not_written"] == []
    known = {str(one.decision_id): one for one in list_decisions(module_conn)}
    for box in boxes:
        decision = known[box["decision_id"]]
        assert (box["category"], box["origin"], box["decided_by"]) == (CLASSES_OF[decision.kind], decision.kind, "Ann")
        assert box["feature_id"] == str(decision.feature_id) and box["box"] in ("detected", "projected")
    assert {box["origin"] for box in boxes} == set(CLASSES_OF)
    # Detected boxes are where the images have an orange block.
    for box in boxes:
        if box["box"] == "detected":
            image = cv2.imread(str(folder / "labels/images" / box["image"]))
            x, y = (float(box[a]) + float(box[b]) / 2 for a, b in (("x_px", "w_px"), ("y_px", "h_px")))
            np.testing.assert_allclose(image[int(y), int(x)], (0, 128, 255), atol=12)
    read, unusable = read_label_folder(folder / "labels")
    assert unusable == [] and all(one.judged_only for one in read) and len(read) == len(images)


def test_images_that_are_gone_are_named_and_the_others_written(judged):
    conetl, folder = judged
    conetl("labels", "export", folder / "all")
    here, away = sorted((folder / "drives").iterdir())[0], folder / "away"
    here.rename(away)
    said = json.loads(conetl("labels", "export", folder / "some", "--json", code=1))
    away.rename(here)
    whole, some, missing = (
        table(folder / name) for name in ("all/images.csv", "some/images.csv", "some/not_written.csv")
    )
    assert 0 < len(some) < len(whole) and missing and len(said["not_written"]) == len(missing)
    assert all("is missing: restore the drive" in row["reason"] for row in missing)


def test_coco_is_read_back_as_it_was(judged):
    conetl, folder = judged
    conetl("labels", "export", folder / "coco", "--format", "coco")
    written = [box for box in table(folder / "coco/boxes.csv") if box["category"] != NOTHING]
    conetl("labels", "import", folder / "coco/annotations.json", "--out", folder / "again")
    again = table(folder / "again/boxes.csv")
    key = ("image", "category", "x_px", "y_px", "w_px", "h_px")
    assert sorted([box[k] for k in key] for box in again) == sorted([box[k] for k in key] for box in written)


def test_a_map_without_decisions_writes_nothing(conn, database_url, tmp_path):
    merge(conn, survey(0))
    conn.commit()
    conetl = command_line(tmp_path / "home", database_url)
    assert "no decision" in conetl("labels", "export", tmp_path / "labels", code=2)
    assert not (tmp_path / "labels").exists()
