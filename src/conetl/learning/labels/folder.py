"""The folder of labels between `conetl labels` and `conetl train`: images, two tables, and YOLO or COCO files for other tools.

`images.csv` has a row per image, `boxes.csv` a row per box with the decision or file that it is from. The tables alone are read
again: YOLO and COCO cannot say that a place was judged and holds nothing, or that the rest of an image was not looked at.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from conetl.files.atomic import atomic_text_file, write_json
from conetl.files.documents import library_errors
from conetl.learning.classes import CLASSES
from conetl.learning.images import LabelledImage, objects_from
from conetl.model.errors import InputError
from conetl.perception.images import ImageFileError, read_image

LabelFormat = Literal["yolo", "coco"]
#: Instead of a class: nothing stands there, whatever the network found; nobody knows what is there.
NOTHING, IGNORED = "nothing", "ignored"
IMAGES, BOXES, NOT_WRITTEN = "images.csv", "boxes.csv", "not_written.csv"


class ImageRow(NamedTuple):
    """A row of images.csv."""

    image: str
    """File below images/."""
    recording: str
    """Images of one recording resemble each other: they are held out together."""
    classes: str
    """Classes of which every object in the image has a box, separated by spaces; empty: only the boxes were judged."""
    width_px: int
    height_px: int


class BoxRow(NamedTuple):
    """A row of boxes.csv; pixels from the image's upper left corner."""

    image: str
    category: str
    """A class of the network, NOTHING or IGNORED."""
    x_px: float
    y_px: float
    w_px: float
    h_px: float
    origin: str
    """Kind of the decision, or the file and record that it is from."""
    decision_id: str = ""
    feature_id: str = ""
    decided_by: str = ""
    box: str = "drawn"
    """detected: as the network found it; projected: from the position on the map; drawn: by a person."""

    @property
    def corners(self) -> tuple[float, float, float, float]:
        return self.x_px, self.y_px, self.x_px + self.w_px, self.y_px + self.h_px


class Unusable(NamedTuple):
    """A record that was left out."""

    record: str
    reason: str


def require_new(folder: Path) -> None:
    """Raise InputError unless a folder is empty or not there."""
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"{folder} already holds files: choose a new folder for the labels")


def write_label_files(
    folder: Path, images: Sequence[ImageRow], boxes: Sequence[BoxRow], unusable: Sequence[Unusable], form: LabelFormat
) -> None:
    """Write the tables, and labels of `form` for other tools; the images are there already."""
    by_image: dict[str, list[BoxRow]] = {}
    for box in boxes:
        by_image.setdefault(box.image, []).append(box)
    if form == "yolo":
        _write_yolo(folder, images, by_image)
    else:
        write_json(folder / "annotations.json", coco_of(images, by_image))
    _write_table(folder / BOXES, BoxRow._fields, [box._replace(**_rounded(box)) for box in boxes])
    _write_table(folder / NOT_WRITTEN, Unusable._fields, unusable)
    _write_table(folder / IMAGES, ImageRow._fields, images)


def _rounded(box: BoxRow) -> dict[str, Any]:
    return {name: round(getattr(box, name), 2) for name in ("x_px", "y_px", "w_px", "h_px")}


def _write_table(path: Path, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    with atomic_text_file(path) as file:
        csv.writer(file, lineterminator="\n").writerows([columns, *rows])


def _write_yolo(folder: Path, images: Sequence[ImageRow], boxes: Mapping[str, Sequence[BoxRow]]) -> None:
    (folder / "labels").mkdir(parents=True, exist_ok=True)
    for image in images:
        size = np.array((image.width_px, image.height_px) * 2)
        lines = []
        for box in boxes.get(image.image, ()):
            if box.category in CLASSES:
                x0, y0, x1, y1 = np.array(box.corners) / size
                numbers = ((x0 + x1) / 2, (y0 + y1) / 2, x1 - x0, y1 - y0)
                lines.append(f"{CLASSES.index(box.category)} {' '.join(f'{value:.6f}' for value in numbers)}\n")
        (folder / "labels" / Path(image.image).with_suffix(".txt")).write_text("".join(lines))
    names = "".join(f"  {k}: {name}\n" for k, name in enumerate(CLASSES))
    (folder / "data.yaml").write_text(f"path: .\ntrain: images\nval: images\nnames:\n{names}")


def coco_of(images: Sequence[ImageRow], boxes: Mapping[str, Sequence[BoxRow]]) -> dict[str, Any]:
    """The labels in the format of COCO, with what each is from as attributes."""
    annotations: list[dict[str, Any]] = []
    for number, image in enumerate(images, 1):
        for box in boxes.get(image.image, ()):
            if box.category in CLASSES:
                about = {name: value for name, value in box._asdict().items() if name in BoxRow._fields[6:] and value}
                numbers = [round(value, 2) for value in (box.x_px, box.y_px, box.w_px, box.h_px)]
                annotations.append(
                    {
                        "id": len(annotations) + 1, "image_id": number, "category_id": CLASSES.index(box.category) + 1,
                        "bbox": numbers, "area": round(numbers[2] * numbers[3], 2), "iscrowd": 0, "segmentation": [],
                        "attributes": about,
                    }
                )  # fmt: skip
    return {
        "images": [
            {"id": number, "file_name": image.image, "width": image.width_px, "height": image.height_px}
            for number, image in enumerate(images, 1)
        ],
        "categories": [{"id": k, "name": name, "supercategory": ""} for k, name in enumerate(CLASSES, 1)],
        "annotations": annotations,
    }


def read_label_folder(folder: Path) -> tuple[list[LabelledImage], list[Unusable]]:
    """The labelled images of a folder, and the records that cannot be used. Raises InputError where it is no such folder."""
    if not (folder / IMAGES).is_file() or not (folder / BOXES).is_file():
        raise InputError(
            f"{folder}: has no {IMAGES} and {BOXES}, as `conetl labels export` and `conetl labels import` write them; "
            f"labels of other tools: `conetl labels import {folder} --out LABELS`"
        )
    unusable: list[Unusable] = []
    boxes: dict[str, list[BoxRow]] = {}
    for number, row in _read_table(folder / BOXES, BoxRow._fields):
        record = f"{BOXES}, row {number}"
        try:
            x, y, w, h = (float(row[name]) for name in ("x_px", "y_px", "w_px", "h_px"))
        except ValueError as error:
            unusable.append(Unusable(record, f"expected a number: {error}"))
            continue
        box = BoxRow(row["image"], row["category"], x, y, w, h, row["origin"])
        if not all(map(math.isfinite, box.corners)) or min(w, h) <= 0:
            unusable.append(Unusable(record, "expected a box with a width and a height above 0"))
        elif box.category not in (*CLASSES, NOTHING, IGNORED):
            unusable.append(Unusable(record, f"expected one of {', '.join(CLASSES)}; found {box.category!r}"))
        else:
            boxes.setdefault(box.image, []).append(box)
    images: list[LabelledImage] = []
    for number, row in _read_table(folder / IMAGES, ImageRow._fields):
        path = folder / "images" / row["image"]
        if not path.resolve().is_relative_to(folder.resolve()):
            unusable.append(Unusable(f"{IMAGES}, row {number}", "the image lies outside of the folder"))
            continue
        try:
            pixels = read_image(path)
        except ImageFileError as error:
            unusable.append(Unusable(f"{IMAGES}, row {number}", str(error)))
            continue
        images.append(
            labelled_image(row["image"], row["recording"], row["classes"].split(), pixels, boxes.pop(row["image"], []))
        )
    unusable += [Unusable(f"{BOXES}, {name}", f"{IMAGES} has no such image") for name in boxes]
    return images, unusable


def _read_table(path: Path, columns: Sequence[str]) -> list[tuple[int, dict[str, str]]]:
    """Rows by column, with their number in the file. Raises InputError for other columns."""
    problems = library_errors(f"{path}: cannot be read as a table", OSError, UnicodeDecodeError, csv.Error)
    with problems, path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.reader(file))
    if not rows or not set(columns) <= set(rows[0]):
        raise InputError(f"{path}: expected the columns {', '.join(columns)}")
    return [
        (number, dict(zip(rows[0], row, strict=False)))
        for number, row in enumerate(rows[1:], 2)
        if len(row) == len(rows[0])
    ]


def labelled_image(
    name: str, recording: str, classes: Sequence[str], pixels: np.ndarray, boxes: Sequence[BoxRow]
) -> LabelledImage:
    """An image (H, W, 3) to learn from. classes: those that are labelled everywhere in it; none: only the boxes were judged."""
    objects = [box for box in boxes if box.category in CLASSES]
    known = objects_from([box.corners for box in objects], [CLASSES.index(box.category) for box in objects])
    false, ignored = (
        np.array([box.corners for box in boxes if box.category == kind]).reshape(-1, 4) for kind in (NOTHING, IGNORED)
    )
    if classes:
        return LabelledImage(name, recording, pixels, known, ignored, false=false, taught=frozenset(classes))
    judged = np.concatenate((known[:, :4], false))
    rest = without(judged, pixels.shape[1], pixels.shape[0])
    return LabelledImage(name, recording, pixels, known, np.concatenate((rest, ignored)), judged_only=True, false=false)


def without(boxes: np.ndarray, width: int, height: int) -> np.ndarray:
    """Regions (M, 4) [x0, y0, x1, y1] that cover an image but for some boxes (N, 4)."""
    inside = np.clip(boxes, 0, (width, height, width, height))
    ys = np.unique(np.concatenate(([0.0, height], inside[:, 1], inside[:, 3])))
    regions = []
    for top, bottom in pairwise(ys.tolist()):
        x = 0.0
        here = inside[(inside[:, 1] < bottom) & (inside[:, 3] > top)]
        for left, _, right, _ in here[np.argsort(here[:, 0])]:
            if left > x:
                regions.append((x, top, left, bottom))
            x = max(x, right)
        if x < width:
            regions.append((x, top, width, bottom))
    return np.array(regions, dtype=np.float64).reshape(-1, 4)
