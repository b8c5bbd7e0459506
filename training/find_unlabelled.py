"""What an earlier detector finds in the training images where no label is.

    python -m training.find_unlabelled MODEL.onnx --cones DIR --more-cones DIR --clips DIR --leave-out NAMES --out unlabelled.json

Of `cones`, where labels are missing, such a box is either a cone without a label or a thing that looks like one: training neither
teaches nor forbids a cone there (`train.py --unlabelled`), which is narrower than giving up the whole band of far cones
(`dataset.far_band`). In the labelled clips and in the images without cones every such box is false: training centres samples
on them.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import cv2
import numpy as np

from conetl.learning.classes import CLASSES
from conetl.learning.images import LabelledImage
from conetl.perception.decoding import intersection_over_union
from conetl.perception.detector import Detector, detect_image, load_detector
from training.dataset import read_cones, read_labelled_clips, read_more_cones

SCALES = (0.6, 1.0, 2.0)  #: at which false boxes are looked for


def boxes_without_label(
    detector: Detector, picture: LabelledImage, scale: float, score: float, margin_px: float
) -> list[list[float]]:
    """Boxes [x0, y0, x1, y1] px of the classes that are labelled in an image, where no label and no fade is."""
    image = picture.image if scale == 1 else np.asarray(cv2.resize(picture.image, None, fx=scale, fy=scale), np.uint8)
    known, found = np.concatenate((picture.boxes[:, :4], picture.fade)), []
    wanted = [name for name in CLASSES if name in picture.taught]
    for x, y, width, height in detect_image(detector, image, score_threshold=score, categories=wanted)[:, :4] / scale:
        box = np.array([x - margin_px, y - margin_px, x + width + margin_px, y + height + margin_px])
        if len(known) == 0 or intersection_over_union(box, known).max() <= 0.1:
            found.append(box.round(1).tolist())
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("model", type=Path)
    parser.add_argument("--cones", type=Path, required=True)
    parser.add_argument("--more-cones", type=Path)
    parser.add_argument("--clips", type=Path)
    parser.add_argument("--leave-out", default="")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--score", type=float, default=0.12)
    args = parser.parse_args()
    detector = load_detector(args.model)
    unlabelled = {
        p.name: boxes_without_label(detector, p, 1.0, args.score, 2.0) for p in read_cones(args.cones, "train")
    }
    complete, left_out = [], frozenset(args.leave_out.split(","))
    if args.more_cones:
        complete += [p for p in read_more_cones(args.more_cones, left_out) if p.source.endswith("_negatives")]
    if args.clips:
        labels = Path(__file__).parent / "labels"
        complete += read_labelled_clips(args.clips, labels, left_out)
    false = {
        p.name: [box for scale in SCALES for box in boxes_without_label(detector, p, scale, args.score, 0.0)]
        for p in complete
    }
    args.out.write_text(
        json.dumps(
            {"model": detector.card.name, "sha256": detector.card.sha256, "unlabelled": unlabelled, "false": false}
        )
    )
    print(f"{sum(map(len, unlabelled.values()))} boxes without a label, {sum(map(len, false.values()))} false ones")


if __name__ == "__main__":
    main()
