"""Labels of other tools -> a folder of labels: YOLO folders, and COCO files as CVAT and Label Studio write them.

YOLO: the names of the classes stand in data.yaml, classes.txt or obj.names; the labels of an image in a text file beside it, or
below `labels` instead of `images`. COCO: `annotations/instances_*.json` of CVAT or `result.json` of Label Studio, whose ids
begin at 0; images lie below `images`. A record that cannot be used is named, and costs only itself.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

import numpy as np

from conetl.files.documents import read_json, read_limited, read_yaml
from conetl.files.names import file_name_part, printable
from conetl.learning.classes import CLASSES
from conetl.learning.labels.folder import IGNORED, BoxRow, ImageRow, Unusable, require_new, write_label_files
from conetl.model.errors import InputError
from conetl.perception.images import IMAGE_SUFFIXES, ImageFileError, read_image

#: Names that others give the network's classes, without spaces and hyphens.
ALIASES = {
    "cone": "traffic_cone", "safety_cone": "traffic_cone", "pylon": "traffic_cone", "barrel": "drum",
    "delineator": "vertical_panel", "beacon": "vertical_panel", "panel": "vertical_panel", "bollard": "tubular_marker",
    "tubular": "tubular_marker", "barrier": "barricade", "sign": "traffic_sign", "roadwork_sign": "work_zone_sign",
}  # fmt: skip
#: Folders that say nothing about the recording.
_SPLITS = {
    "train",
    "val",
    "valid",
    "validation",
    "test",
    "default",
    "images",
    "obj_train_data",
    "obj_valid_data",
    "data",
}
_UPLOAD = re.compile(r"^[0-9a-f]{8}-")
_NUMBER = re.compile(r"[_.\- ]*\d*([_.\- ]?(left|right))?$")
#: A box may reach this far beyond the image, as a share of its size: tools round.
_MAX_BEYOND = 0.02
Found = tuple[str, str, tuple[float, float, float, float] | str]
"""What it is from, the class as written, and x, y, w, h in pixels or what is wrong with it."""


class ForeignLabels(NamedTuple):
    """What was found at a source: images with their boxes, or why an image has none that can be read."""

    names: list[str]
    """All classes as written."""
    images: list[tuple[Path, str, Callable[[int, int], Iterable[Found]]]]
    """File, its path below the source, and its boxes for a width and a height in pixels."""
    unusable: list[Unusable]


class Imported(NamedTuple):
    """What `import_labels` wrote."""

    images: list[ImageRow]
    boxes: list[BoxRow]
    unknown: dict[str, int]
    """Classes that the network does not know, and their boxes: nothing is taught there."""
    unusable: list[Unusable]


def import_labels(source: Path, folder: Path, classes: Mapping[str, str] | None = None) -> Imported:
    """Write a folder of labels from a YOLO folder, or a COCO file or its folder. classes: names as written -> the network's.

    Raises InputError, with nothing written, where the source holds no labels that are known, or no image of theirs.
    """
    require_new(folder)
    if wrong := sorted(set((classes or {}).values()) - set(CLASSES)):
        raise InputError(f"{', '.join(wrong)}: the network has no such class; it has {', '.join(CLASSES)}")
    found = _read_coco(source) if (source.is_file() or _coco_file(source)) else _read_yolo(source)
    mapped = {name: mapped_class(name, classes or {}) for name in found.names}
    images: list[ImageRow] = []
    boxes: list[BoxRow] = []
    unusable, unknown = list(found.unusable), dict[str, int]()
    files: dict[str, Path] = {}
    for path, inner, boxes_of in found.images:
        try:
            height, width = read_image(path).shape[:2]
        except ImageFileError as error:
            unusable.append(Unusable(inner, str(error)))
            continue
        name = _new_name(inner, files)
        files[name] = path
        images.append(ImageRow(name, recording_of(inner), "", width, height))
        for origin, written, box in boxes_of(width, height):
            category = mapped.get(written)
            inside = box if isinstance(box, str) else _inside(box, width, height)
            if isinstance(inside, str):
                unusable.append(Unusable(origin, inside))
                continue
            if category is None:
                unknown[written] = unknown.get(written, 0) + 1
            boxes.append(BoxRow(name, category or IGNORED, *inside, origin=origin))
    if not images:
        reason = f": {unusable[0].record}: {unusable[0].reason}" if unusable else ""
        raise InputError(f"{source}: none of its images can be used{reason}")
    # Classes without a box are probably not labelled, and their absence is not taught; without any box all are.
    labelled = {box.category for box in boxes} & set(CLASSES) or {name for name in mapped.values() if name}
    text = " ".join(name for name in CLASSES if name in labelled)
    if not text:
        named = ", ".join(map(printable, found.names)) or "no class"
        raise InputError(
            f"{source}: names {named}; the network knows {', '.join(CLASSES)}. Say which is which with --class THEIRS=OURS"
        )
    images = [image._replace(classes=text) for image in images]
    (folder / "images").mkdir(parents=True, exist_ok=True)
    for name, path in files.items():
        shutil.copyfile(path, folder / "images" / name)
    write_label_files(folder, images, boxes, unusable, "yolo")
    return Imported(images, boxes, unknown, unusable)


def mapped_class(name: str, classes: Mapping[str, str]) -> str | None:
    """The network's class for a name as written; None if it is not known."""
    if name in classes:
        return classes[name]
    plain = re.sub(r"[\s\-]+", "_", name.strip().lower())
    for one in (plain, plain.removesuffix("s")):
        if one in CLASSES or one in ALIASES:
            return ALIASES.get(one, one)
    return None


def recording_of(inner: str) -> str:
    """The recording of an image by its path below the source: its folder, else its name without what counts images."""
    path = PurePosixPath(inner)
    if folders := [part for part in path.parts[:-1] if part.lower() not in _SPLITS]:
        return "/".join(folders)
    stem = _UPLOAD.sub("", path.stem)
    return _NUMBER.sub("", stem) or "images"


def _new_name(inner: str, taken: Mapping[str, Path]) -> str:
    parts = [part for part in PurePosixPath(inner).parts if part.lower() not in _SPLITS]
    name = file_name_part("_".join(parts))
    path, number = PurePosixPath(name), 1
    while name in taken:
        number += 1
        name = f"{path.stem}-{number}{path.suffix}"
    return name


def _inside(box: tuple[float, float, float, float], width: int, height: int) -> tuple[float, float, float, float] | str:
    """The box within the image, or what is wrong with it."""
    x, y, w, h = box
    if not np.isfinite(box).all() or w <= 0 or h <= 0:
        return f"expected a box with a width and a height above 0, found {w:g} x {h:g}"
    left, top, right, bottom = max(x, 0.0), max(y, 0.0), min(x + w, width), min(y + h, height)
    beyond = max((left - x) / width, (top - y) / height, (x + w - right) / width, (y + h - bottom) / height)
    if beyond > _MAX_BEYOND or right <= left or bottom <= top:
        return f"the box lies outside of the image of {width} x {height} pixels"
    return left, top, right - left, bottom - top


def _read_yolo(folder: Path) -> ForeignLabels:
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder or file")
    names = _yolo_names(folder)
    unusable: list[Unusable] = []
    images: list[tuple[Path, str, Callable[[int, int], Iterable[Found]]]] = []
    for path in sorted(p for p in folder.rglob("*") if p.suffix.lower() in IMAGE_SUFFIXES):
        inner = path.relative_to(folder).as_posix()
        labels = _yolo_file(folder, PurePosixPath(inner))
        if labels is None:
            unusable.append(Unusable(inner, "has no label file; an empty one says that nothing is there"))
            continue
        shown = labels.relative_to(folder).as_posix()
        text = read_limited(labels)
        images.append((path, inner, partial(_yolo_boxes, text, shown, names)))
    return ForeignLabels(list(names.values()), images, unusable)


def _yolo_file(folder: Path, inner: PurePosixPath) -> Path | None:
    parts = inner.with_suffix(".txt").parts
    beside = folder.joinpath(*parts)
    at = [k for k, part in enumerate(parts) if part == "images"]
    apart = folder.joinpath(*parts[: at[-1]], "labels", *parts[at[-1] + 1 :]) if at else folder / "labels" / parts[-1]
    return next((path for path in (apart, beside) if path.is_file()), None)


def _yolo_names(folder: Path) -> dict[int, str]:
    for name in ("data.yaml", "dataset.yaml", "data.yml"):
        if (folder / name).is_file():
            written = read_yaml(folder / name)
            names = written.get("names") if isinstance(written, dict) else None
            if isinstance(names, list):
                return {k: str(one) for k, one in enumerate(names)}
            if isinstance(names, dict) and all(str(k).isdigit() for k in names):
                return {int(k): str(one) for k, one in names.items()}
            raise InputError(f"{folder / name}: expected the key `names` with the names of the classes")
    for name in ("classes.txt", "obj.names"):
        if (folder / name).is_file():
            return dict(enumerate(line.strip() for line in read_limited(folder / name).splitlines() if line.strip()))
    raise InputError(
        f"{folder}: expected a YOLO folder with data.yaml, classes.txt or obj.names, or a COCO file "
        "(annotations/instances_default.json, result.json)"
    )


def _yolo_boxes(text: str, shown: str, names: Mapping[int, str], width: int, height: int) -> Iterator[Found]:
    for number, line in enumerate(text.splitlines(), 1):
        if not line.strip():
            continue
        origin, fields = f"{shown}, line {number}", line.split()
        try:
            index, (x, y, w, h) = int(fields[0]), map(float, fields[1:5])
        except ValueError:
            yield origin, "", f"expected `class x y width height` with four shares, found {printable(line)[:60]!r}"
            continue
        if len(fields) > 6:  # a polygon; six fields have a score at the end
            yield origin, "", "is a polygon: export the labels as boxes"
        elif index not in names:
            yield origin, "", f"class {index} has no name"
        else:
            yield origin, names[index], ((x - w / 2) * width, (y - h / 2) * height, w * width, h * height)


def _coco_file(folder: Path) -> Path | None:
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder or file")
    found = sorted([*folder.glob("annotations/*.json"), *folder.glob("*.json")])
    found = [path for path in found if path.name != "notes.json"]  # Label Studio's, beside YOLO labels
    if len(found) > 1:
        names = ", ".join(path.relative_to(folder).as_posix() for path in found)
        raise InputError(f"{folder}: has several JSON files ({names}): name the one with the labels")
    return found[0] if found else None


def _read_coco(source: Path) -> ForeignLabels:
    path = _coco_file(source) if source.is_dir() else source
    assert path is not None
    content = read_json(path)
    lists = {
        key: content.get(key) if isinstance(content, dict) else None for key in ("images", "categories", "annotations")
    }
    if missing := [key for key, value in lists.items() if not isinstance(value, list)]:
        raise InputError(f"{path}: expected a COCO file; it has no list `{missing[0]}`")
    unusable: list[Unusable] = []
    names = {
        row["id"]: str(row["name"]) for row in _rows(lists, "categories", {"id": int, "name": str}, path, unusable)
    }
    root = source if source.is_dir() else path.parent.parent if path.parent.name == "annotations" else path.parent
    by_name: dict[str, list[Path]] = {}
    for one in root.rglob("*"):
        if one.suffix.lower() in IMAGE_SUFFIXES:
            by_name.setdefault(one.name, []).append(one)
    by_image: dict[int, list[Found]] = {}
    images: list[tuple[Path, str, Callable[[int, int], Iterable[Found]]]] = []
    for row in _rows(lists, "images", {"id": int, "file_name": str}, path, unusable):
        inner = PurePosixPath(row["file_name"].replace("\\", "/"))
        same = by_name.get(inner.name, [])
        whole = [one for one in same if one.as_posix().endswith(f"/{inner.as_posix().lstrip('/')}")] or same
        if len(whole) != 1:
            problem = "is not there" if not whole else f"stands for {len(whole)} files"
            unusable.append(
                Unusable(f"{path.name}: image {row['id']}", f"{printable(str(inner))} {problem} below {root}")
            )
            continue
        boxes = by_image.setdefault(row["id"], [])
        images.append((whole[0], whole[0].relative_to(root).as_posix(), partial(_as_found, boxes)))
    stated = {row.get("id") for row in lists["images"] or () if isinstance(row, dict)}
    wanted = {"image_id": int, "category_id": int, "bbox": list}
    for row in _rows(lists, "annotations", wanted, path, unusable):
        origin, box = f"{path.name}: annotation {row.get('id', '?')}", row["bbox"]
        if row["image_id"] not in by_image:
            if row["image_id"] not in stated:
                unusable.append(Unusable(origin, f"there is no image {row['image_id']}"))
        elif len(box) != 4 or not all(isinstance(value, int | float) for value in box):
            by_image[row["image_id"]].append((origin, "", "expected four numbers as `bbox`"))
        elif row["category_id"] not in names:
            by_image[row["image_id"]].append((origin, "", f"there is no category {row['category_id']}"))
        else:
            x, y, w, h = map(float, box)
            by_image[row["image_id"]].append((origin, names[row["category_id"]], (x, y, w, h)))
    return ForeignLabels(list(names.values()), images, unusable)


def _as_found(boxes: Sequence[Found], _width: int, _height: int) -> Sequence[Found]:
    return boxes


def _rows(
    lists: Mapping[str, Any], key: str, wanted: Mapping[str, type], path: Path, unusable: list[Unusable]
) -> Iterator[dict[str, Any]]:
    """The records of a list that have these keys of these types; the others are named."""
    for number, row in enumerate(lists[key], 1):
        wrong = [
            name for name, kind in wanted.items() if not isinstance(row, dict) or not isinstance(row.get(name), kind)
        ]
        if wrong:
            unusable.append(Unusable(f"{path.name}: record {number} of {key}", f"expected the key `{wrong[0]}`"))
        else:
            yield row
