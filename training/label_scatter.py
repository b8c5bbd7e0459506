"""How far boxes lie from labels, and what average precision that leaves: how much of it is the labels' own scatter.

    python training/label_scatter.py MODEL.onnx --cones DIR

Prints, by source, how the sides of boxes scatter about those of the labels, in shares of a cone's height (1.48 times the median
absolute deviation, which a few wild labels do not move), and how the ratio of width to height scatters among labels and among
boxes. Then the average precision of boxes that are the labels themselves, each side moved by a normal error: what a
detector would have that finds every cone and nothing else, where its boxes and the labels differ by so much.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "src"))

from dataset import Picture, read_cones
from evaluate import coco_tables

from conetl.io.detector import detect_image, load_detector
from conetl.io.detector_decode import intersection_over_union

FROM_PX = 20.0
SAME_CONE_IOU = 0.5
SCORE = 0.3
EDGE_PX = 3.0
ERRORS = (0.03, 0.04, 0.05, 0.06)


def robust_scatter(values: np.ndarray) -> np.ndarray:
    """1.4826 times the median absolute deviation along the first axis: the standard deviation, if values are normal."""
    return np.asarray(1.4826 * np.median(np.abs(values - np.median(values, axis=0)), axis=0))


def pairs_of(picture: Picture, found: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """(box, label), both (4,) x0, y0, x1, y1, of the cones from FROM_PX on that lie whole in the picture and were found."""
    height, width = picture.image.shape[:2]
    pairs = []
    for x, y, w, h in found[:, :4]:
        box = np.array([x, y, x + w, y + h])
        overlaps = intersection_over_union(box, picture.boxes[:, :4])
        if len(overlaps) == 0 or overlaps.max() < SAME_CONE_IOU:
            continue
        label = picture.boxes[overlaps.argmax(), :4]
        whole = min(label[0], label[1], width - label[2], height - label[3]) >= EDGE_PX
        if whole and label[3] - label[1] >= FROM_PX:
            pairs.append((box, label))
    return pairs


def moved_labels(picture: Picture, error: float, rng: np.random.Generator) -> np.ndarray:
    """The labels as boxes (N, 5) x, y, w, h, score, each side moved by a normal error in shares of the height."""
    labels = picture.boxes[:, :4]
    moved = labels + rng.normal(size=labels.shape) * error * (labels[:, 3:4] - labels[:, 1:2])
    scores = rng.uniform(0.5, 1.0, len(labels))
    return np.column_stack((moved[:, :2], moved[:, 2:] - moved[:, :2], scores))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("model", type=Path)
    parser.add_argument("--cones", type=Path, required=True)
    args = parser.parse_args()
    detector = load_detector(args.model)
    pictures = read_cones(args.cones, "val")
    for source in sorted({picture.source for picture in pictures}):
        ours = [picture for picture in pictures if picture.source == source]
        pairs = [pair for p in ours for pair in pairs_of(p, detect_image(detector, p.image, score_threshold=SCORE))]
        boxes, labels = (np.array(part) for part in zip(*pairs, strict=True))
        heights = labels[:, 3:4] - labels[:, 1:2]
        sides = robust_scatter((boxes - labels) / heights)
        ratios = [np.log((c[:, 2] - c[:, 0]) / (c[:, 3] - c[:, 1])) for c in (labels, boxes)]
        print(
            f"{source}: {len(pairs)} cones; left, top, right, bottom {sides.round(3).tolist()} of the height;", end=" "
        )
        print(f"width to height of labels {ratios[0].std():.3f}, of boxes {ratios[1].std():.3f},", end=" ")
        print(f"correlation {np.corrcoef(*ratios)[0, 1]:.2f}")
    rng = np.random.default_rng(0)
    for error in ERRORS:
        table = coco_tables(pictures, [moved_labels(picture, error, rng) for picture in pictures])[">=20 px"]
        print(f"labels moved by {error:.2f} of the height, >=20 px: AP50 {table['ap50']}, AP50:95 {table['ap50_95']}")


if __name__ == "__main__":
    main()
