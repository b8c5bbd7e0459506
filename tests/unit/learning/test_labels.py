"""Labels of other tools and the folder of labels: every record that is wrong is named and costs only itself."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest

from conetl.learning.classes import CLASSES
from conetl.learning.labels.folder import (
    BOXES,
    IGNORED,
    NOTHING,
    BoxRow,
    ImageRow,
    labelled_image,
    read_label_folder,
    without,
    write_label_files,
)
from conetl.learning.labels.foreign import import_labels, mapped_class, recording_of
from conetl.model.errors import InputError

SIZE = (60, 80)


def write_image(path):
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), np.full((*SIZE, 3), 120, np.uint8))
    return path


def yolo(folder, names="names: [pylon, sign]\n"):
    for number in range(3):
        write_image(folder / f"images/train/street_{number:04d}.jpg")
        (folder / "labels/train").mkdir(parents=True, exist_ok=True)
        (folder / f"labels/train/street_{number:04d}.txt").write_text("0 0.5 0.5 0.25 0.5\n")
    (folder / "data.yaml").write_text(names)
    return folder


def coco(folder, first_id):
    """As CVAT (ids from 1, annotations/) or Label Studio (ids from 0, result.json) write it."""
    cvat = first_id == 1
    names = ["a1b2c3d4-street_0000.jpg", "a1b2c3d4-street_0001.jpg"]
    for name in names:
        write_image(folder / "images" / ("default" if cvat else "") / name)
    content = {
        "images": [
            {"id": k + first_id, "file_name": name if cvat else f"images/{name}", "width": 80, "height": 60}
            for k, name in enumerate(names)
        ],
        "categories": [{"id": first_id, "name": "traffic cone"}, {"id": first_id + 1, "name": "Leitkegel"}],
        "annotations": [
            {"id": 0, "image_id": first_id, "category_id": first_id, "bbox": [10, 20, 30.5, 30], "iscrowd": 0},
            {"id": 1, "image_id": first_id, "category_id": first_id + 1, "bbox": [50, 20, 10, 30], "iscrowd": 0},
        ],
    }
    path = folder / ("annotations/instances_default.json" if cvat else "result.json")
    path.parent.mkdir(exist_ok=True)
    path.write_text(json.dumps(content))
    return path, content


def test_a_yolo_folder_becomes_labelled_images(tmp_path):
    found = import_labels(yolo(tmp_path / "in"), tmp_path / "out")
    assert (len(found.images), len(found.boxes), found.unknown, found.unusable) == (3, 3, {}, [])
    images, unusable = read_label_folder(tmp_path / "out")
    assert unusable == [] and {one.source for one in images} == {"street"}
    np.testing.assert_allclose(images[0].boxes[:, [0, 1, 2, 3, 8]], [[30, 15, 50, 45, 0]])
    # Signs have no box, so perhaps they were not labelled: their absence is not taught.
    assert images[0].taught == {"traffic_cone"} and not images[0].judged_only


def test_broken_records_of_yolo_are_named(tmp_path):
    folder = yolo(tmp_path / "in")
    box = "0 0.5 0.5 0.25 0.5"
    wrong = ["7 0.5 0.5 0.1 0.1", "0 0.5 0.5", "0 0.9 0.5 0.5 0.5", "0 0.1 0.1 0.2 0.2 0.3 0.3 0.1", "0 0.5 0.5 0 1"]
    (folder / "labels/train/street_0000.txt").write_text("\n".join([box, *wrong]))
    (folder / "labels/train/street_0001.txt").unlink()
    (folder / "images/train/street_0002.jpg").write_bytes(b"\xff\xd8 no image")
    found = import_labels(folder, tmp_path / "out")
    assert [one.image for one in found.images] == ["street_0000.jpg"] and len(found.boxes) == 1
    said = {one.record: one.reason for one in found.unusable}
    first = "labels/train/street_0000.txt, line"
    assert said.keys() == {
        "images/train/street_0001.jpg",
        "images/train/street_0002.jpg",
        *(f"{first} {k}" for k in range(2, 7)),
    }
    assert "no name" in said[f"{first} 2"] and "four shares" in said[f"{first} 3"] and "outside" in said[f"{first} 4"]
    assert "polygon" in said[f"{first} 5"] and "above 0" in said[f"{first} 6"]
    assert "no label file" in said["images/train/street_0001.jpg"]


@pytest.mark.parametrize("first_id", [1, 0], ids=["CVAT", "Label Studio"])
def test_coco_of_both_tools(tmp_path, first_id):
    path, _ = coco(tmp_path / "in", first_id)
    for number, source in enumerate((path, tmp_path / "in")):
        found = import_labels(source, tmp_path / f"out{number}")
        assert found.unknown == {"Leitkegel": 1} and found.unusable == []
        assert [(box.category, box.x_px, box.w_px) for box in found.boxes] == [
            ("traffic_cone", 10, 30.5),
            (IGNORED, 50, 10),
        ]
    images, _ = read_label_folder(tmp_path / "out0")
    # What is not known is neither an object nor background, and an image without a box says that nothing is there.
    assert images[0].fade.tolist() == [[50, 20, 60, 50]] and len(images[1].boxes) == 0 and images[1].source == "street"
    mapped = import_labels(path, tmp_path / "mapped", {"Leitkegel": "traffic_cone"})
    assert mapped.unknown == {} and {box.category for box in mapped.boxes} == {"traffic_cone"}


def test_broken_records_of_coco_are_named(tmp_path):
    path, content = coco(tmp_path / "in", 1)
    content["images"] += [{"id": 9, "file_name": "gone.jpg"}, {"id": "x"}]
    content["annotations"] += [
        {"id": 2, "image_id": 1, "category_id": 1, "bbox": [1, 2, 3]},
        {"id": 3, "image_id": 1, "category_id": 8, "bbox": [1, 2, 3, 4]},
        {"id": 4, "image_id": 77, "category_id": 1, "bbox": [1, 2, 3, 4]},
        {"id": 5, "image_id": 1, "category_id": 1},
        "no record",
    ]
    path.write_text(json.dumps(content))
    found = import_labels(path, tmp_path / "out")
    assert len(found.boxes) == 2
    records = [one.record.partition(": ")[2] for one in found.unusable]
    wanted = ["image 9", "record 4 of images", "annotation 4", "record 6 of annotations", "record 7 of annotations"]
    assert sorted(records) == sorted([*wanted, "annotation 2", "annotation 3"])


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda folder: folder.mkdir(), "data.yaml, classes.txt or obj.names"),
        (lambda folder: yolo(folder, "nc: 3\n"), "the key `names`"),
        (lambda folder: yolo(folder, "names: [car]\n"), "Say which is which"),
        (lambda folder: (folder.mkdir(), (folder / "a.json").write_text("{}")), "no list `images`"),
    ],
)
def test_what_holds_no_labels_is_refused_and_nothing_written(tmp_path, make, words):
    make(tmp_path / "in")
    with pytest.raises(InputError, match=words):
        import_labels(tmp_path / "in", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_folder_with_files_is_kept(tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out/mine.txt").write_text("mine")
    with pytest.raises(InputError, match="choose a new folder"):
        import_labels(yolo(tmp_path / "in"), tmp_path / "out")


def test_names_of_classes_and_recordings():
    wanted = {
        "Traffic Cone": "traffic_cone",
        "cones": "traffic_cone",
        "barrels": "drum",
        "Arrow-Board": "arrow_board",
        "car": None,
    }
    assert {name: mapped_class(name, {}) for name in wanted} == wanted
    paths = {
        "images/train/drive_0012.jpg": "drive", "images/monday/0001.png": "monday", "0001.png": "images",
        "images/4e5f6a7b-city_000017_left.jpg": "city", "obj_train_data/city-3.jpg": "city",
    }  # fmt: skip
    assert {path: recording_of(path) for path in paths} == paths


def test_what_is_written_is_read_again(tmp_path):
    write_image(tmp_path / "images/a.jpg")
    write_image(tmp_path / "images/b.jpg")
    images = [ImageRow("a.jpg", "drive_1", "", 80, 60), ImageRow("b.jpg", "drive_2", " ".join(CLASSES), 80, 60)]
    boxes = [
        BoxRow("a.jpg", "drum", 10, 10, 20, 30, "pin", "d1", "f1", "Ann", "detected"),
        BoxRow("a.jpg", NOTHING, 50, 10, 10, 30, "suppress", "d2"),
    ]
    for form, written in (("yolo", "labels/a.txt"), ("coco", "annotations.json")):
        write_label_files(tmp_path, images, boxes, [], form)
        assert (tmp_path / written).exists()
    content = json.loads((tmp_path / "annotations.json").read_text())
    assert content["annotations"][0]["attributes"] == {
        "origin": "pin", "decision_id": "d1", "feature_id": "f1", "decided_by": "Ann", "box": "detected"
    }  # fmt: skip
    assert (tmp_path / "labels/a.txt").read_text() == "2 0.250000 0.416667 0.250000 0.500000\n"
    (first, second), unusable = read_label_folder(tmp_path)
    assert unusable == [] and first.judged_only and not second.judged_only
    assert first.boxes[:, [0, 1, 2, 3, 8]].tolist() == [[10, 10, 30, 40, 2]] and first.false.tolist() == [
        [50, 10, 60, 40]
    ]
    text = (tmp_path / BOXES).read_text()
    (tmp_path / BOXES).write_text(
        text + "a.jpg,tree,1,1,1,1,x,,,,\na.jpg,drum,one,1,1,1,x,,,,\nz.jpg,drum,1,1,1,1,x,,,,\n"
    )
    _, unusable = read_label_folder(tmp_path)
    assert [one.record for one in unusable] == [f"{BOXES}, row 4", f"{BOXES}, row 5", f"{BOXES}, z.jpg"]


def test_what_nobody_judged_is_covered_and_nothing_else():
    rng = np.random.default_rng(4)
    for count in (0, 1, 2, 5):
        low = rng.uniform(-10, 70, (count, 2))
        boxes = np.column_stack((low, low + rng.uniform(1, 40, (count, 2))))
        regions = without(boxes, 80, 60)
        points = rng.uniform((0, 0), (80, 60), (500, 2))

        def holds(areas, points=points):
            return ((points[:, None] >= areas[:, :2]) & (points[:, None] < areas[:, 2:])).all(2).sum(1)

        judged, covered = holds(boxes) > 0, holds(regions)
        assert (covered[judged] == 0).all() and (covered[~judged] == 1).all()


def test_of_a_judged_image_only_its_boxes_are_taught():
    box = BoxRow("a", "traffic_cone", 20, 20, 10, 20, "pin")
    image = labelled_image("a", "drive", [], np.zeros((*SIZE, 3), np.uint8), [box])
    assert image.judged_only and len(image.fade) == 4
