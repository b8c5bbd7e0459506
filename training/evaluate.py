"""Average precision of a model on labelled images (pycocotools), by source and by cone height, through conetl's own detector.

    python -m training.evaluate MODEL.onnx --cones DIR [--more-cones DIR --left-out NAMES [--clips DIR]] [--labelled DIR]
        [--json OUT.json]

`--left-out` names the sources and clips of `--more-cones` that `train.py --leave-out` kept aside: they are judged one by one and
together, which tells more of unknown streets than the validation split, whose sources are those of the training. Every class is
judged, and how often a cone is called a drum or the reverse: with `--clips` on the clips left out (labels/), with `--labelled` on
a folder with images/ and labels/ (YOLO text), for instance renders kept out of training. The validation split is judged twice:
by its labels, and without boxes on the cones that a person saw but nobody labelled (`val_unlabelled.csv`). These were looked for
among boxes of conetl's own detector, so the second figures flatter it beside others.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval

from conetl.learning.classes import CLASSES
from conetl.learning.evidence.looks import MATCH_IOU
from conetl.learning.images import LabelledImage
from conetl.learning.scoring import at_score, of_class
from conetl.perception.decoding import intersection_over_union
from conetl.perception.detector import detect_image, load_detector
from training.dataset import read_cones, read_labelled_clips, read_left_out, read_renders

SPLIT = ("rf_traffic_cones", "fs_onboard", "css_safety_cone")
SCORES = (0.3, 0.5)
RESAMPLES = 100
LABELS = Path(__file__).parent / "labels"
HEIGHTS_PX = {
    "all": (0.0, 1e5),
    ">=20 px": (20.0, 1e5),
    "<20 px": (0.0, 20.0),
    "20-60 px": (20.0, 60.0),
    ">=60 px": (60.0, 1e5),
}

ANY_HEIGHT = {"all": HEIGHTS_PX["all"]}


def coco_tables(
    pictures: list[LabelledImage], found: list[np.ndarray], heights_px: Mapping[str, tuple[float, float]] = HEIGHTS_PX
) -> dict[str, dict[str, float]]:
    """AP50, AP75, AP50:95 by range of heights: COCO's areas are replaced by squared heights."""
    truth = COCO()
    annotations: list[dict[str, Any]] = []
    for image_id, picture in enumerate(pictures):
        for x0, y0, x1, y1 in picture.boxes[:, :4].tolist():
            box = {"bbox": [x0, y0, x1 - x0, y1 - y0], "area": (y1 - y0) ** 2, "iscrowd": 0}
            annotations.append({"id": len(annotations) + 1, "image_id": image_id, "category_id": 1, **box})
    images = [{"id": k} for k in range(len(pictures))]
    truth.dataset = {
        "info": {},
        "images": images,
        "annotations": annotations,
        "categories": [{"id": 1, "name": "cone"}],
    }
    rows = [
        {"image_id": k, "category_id": 1, "bbox": box[:4].tolist(), "score": float(box[4])}
        for k, boxes in enumerate(found)
        for box in boxes
    ]
    nowhere = {"image_id": 0, "category_id": 1, "bbox": [-9.0, -9.0, 1.0, 1.0], "score": 0.0}
    rows = rows or [nowhere]  # COCO loads no empty list
    with contextlib.redirect_stdout(io.StringIO()):
        truth.createIndex()
        given = truth.loadRes(rows)
        for annotation in given.dataset["annotations"]:
            annotation["area"] = annotation["bbox"][3] ** 2
        run = COCOeval(truth, given, "bbox")
        run.params.areaRng = [[low**2, high**2] for low, high in heights_px.values()]
        run.params.areaRngLbl = list(heights_px)
        run.evaluate()
        run.accumulate()
    precision = run.eval["precision"][:, :, 0, :, -1]  # (IoU, recall, height)
    recall = run.eval["recall"][0, 0, :, -1]
    tables = {}
    for k, (label, (low, high)) in enumerate(heights_px.items()):
        cones = sum(low**2 <= a["area"] <= high**2 for a in annotations)
        if cones == 0:
            continue
        values = {"ap50": precision[0, :, k], "ap75": precision[5, :, k], "ap50_95": precision[:, :, k]}
        tables[label] = {name: round(float(value.mean()), 3) for name, value in values.items()}
        tables[label] |= {"recall50": round(float(recall[k]), 3), "cones": cones}
    return tables


def judge(pictures: list[LabelledImage], found: list[np.ndarray]) -> dict[str, dict[str, float]]:
    """`coco_tables` and `at_score`, with bootstrap intervals of 90 % by recording where there are three and more.

    A clip is a recording, of other sources an image.
    """
    tables = coco_tables(pictures, found)
    for score in SCORES:
        tables[f"at {score}"] = at_score(pictures, found, score)
        # A box of another extent than the label's is found all the same; the pipeline asks for this overlap only.
        tables[f"at {score}, IoU {MATCH_IOU}"] = at_score(pictures, found, score, MATCH_IOU)
    recordings: dict[str, list[int]] = {}
    for k, picture in enumerate(pictures):
        is_clip = (LABELS / f"{picture.name.rsplit('_', 1)[0]}.csv").exists()
        recordings.setdefault(picture.name.rsplit("_", 1)[0] if is_clip else picture.name, []).append(k)
    rng, blocks = np.random.default_rng(1), list(recordings.values())
    if len(blocks) < 3:
        return tables
    drawn = []
    for _ in range(RESAMPLES):
        chosen = [k for b in rng.integers(len(blocks), size=len(blocks)) for k in blocks[b]]
        some, boxes = [pictures[k] for k in chosen], [found[k] for k in chosen]
        if any(len(p.boxes) for p in some):
            at = at_score(some, boxes, SCORES[0])
            drawn.append((coco_tables(some, boxes, ANY_HEIGHT)["all"]["ap50"], at["recall"], at["false_a_picture"]))
    low, high = np.quantile(drawn, (0.05, 0.95), axis=0).round(3).tolist()
    names = ("ap50", f"recall at {SCORES[0]}", f"false_a_picture at {SCORES[0]}")
    tables["90 %"] = {
        f"{name} {side}": v for side, vs in (("from", low), ("to", high)) for name, v in zip(names, vs, strict=True)
    }
    return tables


def off_unlabelled(picture: LabelledImage, found: NDArray[np.float64]) -> np.ndarray:
    """Boxes (N, 5 or more) x, y, w, h, score of an image without those on an unlabelled cone and on no labelled one.

    On one: as `calibrate_scores.py` asks of a box that is to be right, not that it touches it only.
    """

    def on_one_of(box: np.ndarray, cones: np.ndarray) -> bool:
        corners = np.concatenate((box[:2], box[:2] + box[2:4]))
        return bool((intersection_over_union(corners, cones[:, :4]) >= MATCH_IOU).any())

    kept = [on_one_of(box, picture.boxes) or not on_one_of(box, picture.fade) for box in found]
    return found[np.flatnonzero(kept)]


def called(
    pictures: list[LabelledImage], found: list[np.ndarray], score: float, one: str, other: str
) -> tuple[int, int]:
    """How many labelled objects of class `one` have a box of class `other`, and how many have a box of either."""
    wrong = seen = 0
    for picture, boxes in zip(pictures, found, strict=True):
        best = boxes[boxes[:, 4] >= score]
        corners = np.concatenate((best[:, :2], best[:, :2] + best[:, 2:4]), axis=1)
        for thing in picture.boxes[picture.boxes[:, 8] == CLASSES.index(one)]:
            classes = best[intersection_over_union(thing[:4], corners) >= 0.5, 9]
            is_other = bool((classes == CLASSES.index(other)).any())
            wrong, seen = wrong + is_other, seen + (is_other or bool((classes == CLASSES.index(one)).any()))
    return wrong, seen


def judge_classes(
    source: str, images: list[LabelledImage], found: list[np.ndarray]
) -> dict[str, dict[str, dict[str, float]]]:
    """Tables of every class that is labelled in images of one source, and mix-ups of cones and drums."""
    tables = {}
    for number, name in enumerate(CLASSES):
        if not any((image.boxes[:, 8] == number).any() for image in images):
            continue
        pictures, boxes = zip(*(of_class(*pair, number) for pair in zip(images, found, strict=True)), strict=True)
        tables[f"{source}: {name}"] = judge(list(pictures), list(boxes))
    for pair in (("traffic_cone", "drum"), ("drum", "traffic_cone")):
        wrong, seen = called(images, found, SCORES[0], *pair)
        tables[f"{source}: {pair[0]} as {pair[1]}"] = {f"at {SCORES[0]}": {"wrong": wrong, "of": seen}}
    return tables


def left_out_clips(clips: Path, left_out: str) -> list[LabelledImage]:
    """The labelled frames, of all classes, of the clips that were left out of training."""
    others = frozenset(path.stem for path in LABELS.glob("*.csv")) - set(left_out.split(","))
    return read_labelled_clips(clips, LABELS, others)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("model", type=Path)
    parser.add_argument("--clips", type=Path)
    parser.add_argument("--cones", type=Path)
    parser.add_argument("--more-cones", type=Path)
    parser.add_argument("--left-out", default="", help="sources and clips, separated by commas")
    parser.add_argument("--labelled", type=Path)
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    detector = load_detector(args.model)
    pictures = read_cones(args.cones, "val") if args.cones else []
    if args.more_cones:
        pictures += read_left_out(args.more_cones, args.left_out)
    found = [detect_image(detector, p.image, score_threshold=0.01, single_image=True) for p in pictures]
    groups = {
        source: [k for k, p in enumerate(pictures) if p.source == source] for source in {p.source for p in pictures}
    }
    if args.cones:
        groups["validation split"] = [k for k, p in enumerate(pictures) if p.source in SPLIT]
    for clip in set(args.left_out.split(",")) & {p.name.rsplit("_", 1)[0] for p in pictures}:
        groups[clip] = [k for k, p in enumerate(pictures) if p.name.startswith(f"{clip}_")]
    judged = {group: (chosen, found) for group, chosen in groups.items()}
    if args.cones:
        elsewhere = [off_unlabelled(picture, boxes) for picture, boxes in zip(pictures, found, strict=True)]
        judged["the split, off unlabelled"] = groups["validation split"], elsewhere
    of_all_classes = {
        "clips": left_out_clips(args.clips, args.left_out) if args.clips else [],
        "renders": read_renders(args.labelled, set()) if args.labelled else [],
    }
    found_in = {
        source: [
            detect_image(detector, p.image, score_threshold=0.01, single_image=True, categories=None) for p in images
        ]
        for source, images in of_all_classes.items()
    }
    tables: dict[str, dict[str, dict[str, float]]] = {}
    for source, images in of_all_classes.items():
        tables |= judge_classes(source, images, found_in[source]) if images else {}
    clips: dict[str, list[tuple[LabelledImage, np.ndarray]]] = {}
    for picture, boxes in zip(of_all_classes["clips"], found_in["clips"], strict=True):
        clips.setdefault(picture.name.rsplit("_", 1)[0], []).append(of_class(picture, boxes, 0))
    for clip, pairs in clips.items():
        tables[f"clip {clip}: {CLASSES[0]}"] = judge(*map(list, zip(*pairs, strict=True)))
    for group, (chosen, found_here) in sorted(judged.items()):
        tables[group] = judge([pictures[k] for k in chosen], [found_here[k] for k in chosen])
    for group, table in tables.items():
        for label, row in table.items():
            print(f"{group:25s} {label:15s} " + " ".join(f"{name} {value}" for name, value in row.items()))
    if args.json:
        args.json.write_text(
            json.dumps({"model": detector.card.name, "sha256": detector.card.sha256, "tables": tables}, indent=2) + "\n"
        )


if __name__ == "__main__":
    main()
