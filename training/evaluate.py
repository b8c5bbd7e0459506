"""Average precision of an exported model on labelled pictures, by source and by cone height, through conetl's own detector.

    python training/evaluate.py MODEL.onnx --cones DIR [--labelled DIR] [--json OUT.json]

`--labelled` names a folder with images/ and labels/ (YOLO text), for instance renders kept out of training.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "src"))

from dataset import Picture, read_cones, read_labels

from conetl.io.detector import detect_image, load_detector
from conetl.io.detector_decode import intersection_over_union


def average_precision(
    found: list[np.ndarray], truths: list[np.ndarray], iou: float, least_px: float
) -> tuple[float, int]:
    """Area under the precision envelope (all points) and number of true cones of `least_px` and more.

    True cones and unmatched detections below `least_px` in height are left out of the count, as COCO does by area.
    """
    rows, total = [], 0
    for boxes, truth in zip(found, truths, strict=True):
        small = (truth[:, 3] - truth[:, 1]) < least_px
        total += int((~small).sum())
        used = np.zeros(len(truth), bool)
        for box in boxes:
            corners = np.array([box[0], box[1], box[0] + box[2], box[1] + box[3]])
            overlaps = intersection_over_union(corners, truth) * ~used if len(truth) else np.zeros(0)
            order = np.where(overlaps >= iou, overlaps + ~small, -1.0) if len(truth) else np.zeros(0)
            best = int(order.argmax()) if len(truth) and order.max() > 0 else -1
            if best >= 0:
                used[best] = True
                if not small[best]:
                    rows.append((box[4], 1))
            elif box[3] >= least_px:
                rows.append((box[4], 0))
    if not rows or total == 0:
        return 0.0, total
    hits = np.array([hit for _, hit in sorted(rows, key=lambda row: -row[0])])
    recall = np.cumsum(hits) / total
    precision = np.cumsum(hits) / np.arange(1, len(hits) + 1)
    precision = np.maximum.accumulate(precision[::-1])[::-1]
    return float(np.sum(np.diff(recall, prepend=0.0) * precision)), total


def read_labelled(root: Path) -> list[Picture]:
    pictures = []
    for path in sorted((root / "images").glob("*")):
        image = cv2.imread(str(path))
        boxes = read_labels(root / "labels" / f"{path.stem}.txt", image.shape[1], image.shape[0])
        pictures.append(Picture(path.stem, "renders", image, boxes))
    return pictures


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("model", type=Path)
    parser.add_argument("--cones", type=Path)
    parser.add_argument("--labelled", type=Path)
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    detector = load_detector(args.model)
    pictures = read_cones(args.cones, "val") if args.cones else []
    if args.labelled:
        pictures += read_labelled(args.labelled)
    found = [detect_image(detector, picture.image, score_threshold=0.01) for picture in pictures]
    table = []
    for source in ["all", *sorted({picture.source for picture in pictures})]:
        chosen = [k for k, picture in enumerate(pictures) if source in ("all", picture.source)]
        for least_px in (0.0, 20.0):
            row: dict[str, object] = {"source": source, "least_px": least_px}
            for iou in (0.5, 0.75):
                ap, count = average_precision(
                    [found[k] for k in chosen], [pictures[k].boxes[:, :4] for k in chosen], iou, least_px
                )
                row[f"ap{round(100 * iou)}"], row["cones"] = round(ap, 3), count
            table.append(row)
            print(" ".join(f"{key}={value}" for key, value in row.items()))
    if args.json:
        args.json.write_text(json.dumps({"model": detector.name, "sha256": detector.sha256, "table": table}, indent=2))


if __name__ == "__main__":
    main()
