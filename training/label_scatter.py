"""How far boxes lie from labels, and what average precision that leaves: how much of it is the labels' own scatter.

    python -m training.label_scatter MODEL.onnx --cones DIR

Prints, by source, how the sides of boxes scatter about those of the labels, in shares of a cone's height (1.48 times the median
absolute deviation, which a few wild labels do not move), and how the ratio of width to height scatters among labels and among
boxes. For cones that stand alone on a road of another colour, a third box is drawn around what is coloured; of three measurements
with errors of their own each one's error follows (triple collocation: Stoffelen 1998, J. Geophys. Res. 103:7755). Then the
average precision of boxes that are the labels themselves, each side moved by a normal error: what a detector would have that
finds every cone and nothing else, where its boxes and the labels differ by so much.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from conetl.learning.images import LabelledImage
from conetl.perception.decoding import intersection_over_union
from conetl.perception.detector import detect_image, load_detector
from training.dataset import read_cones
from training.evaluate import coco_tables

FROM_PX = 20.0
SAME_CONE_IOU = 0.5
SCORE = 0.3
EDGE_PX = 3.0
ERRORS = (0.03, 0.04, 0.05, 0.06)
SIDES = ("left", "top", "right", "bottom")
#: Cones of this height are looked at for their colour, enlarged so many times, and this much (in heights) around them.
COLOUR_FROM_PX, COLOUR_SCALE, COLOUR_AROUND = 28.0, 4, 0.3
#: A cone differs from the road by that much in the colours of CIELAB, as OpenCV scales them.
LEAST_CONTRAST = 8.0
#: Differences beyond this many robust standard deviations are mistakes, not errors: a label of half a cone, a band for a cone.
OUTLIER = 3.0


def robust_scatter(values: np.ndarray) -> np.ndarray:
    """1.4826 times the median absolute deviation along the first axis: the standard deviation, if values are normal."""
    return np.asarray(1.4826 * np.median(np.abs(values - np.median(values, axis=0)), axis=0))


def pairs_of(picture: LabelledImage, found: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """(box, label), both (4,) x0, y0, x1, y1, of the cones from FROM_PX on that lie whole in the image and were found."""
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


def colour_box(image: np.ndarray, around: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Box (4,) x0, y0, x1, y1 of what differs in colour from the surroundings of `around` (4,); None where that is not clear."""
    margin = COLOUR_AROUND * (around[3] - around[1])
    x0, y0, x1, y1 = np.round(around + np.array((-margin, -margin, margin, margin))).astype(int)
    if min(x0, y0) < 0 or x1 > image.shape[1] or y1 > image.shape[0]:
        return None
    cut = cv2.resize(image[y0:y1, x0:x1], None, fx=COLOUR_SCALE, fy=COLOUR_SCALE, interpolation=cv2.INTER_CUBIC)
    colours = cv2.cvtColor(cut, cv2.COLOR_BGR2LAB)[..., 1:].astype(np.float32)
    edge = np.concatenate([part.reshape(-1, 2) for part in (colours[:6], colours[:, :6], colours[:, -6:])])
    contrast = np.clip(3 * np.linalg.norm(colours - np.median(edge, axis=0), axis=2), 0, 255).astype(np.uint8)
    limit, coloured = cv2.threshold(contrast, 0, 255, cv2.THRESH_OTSU)
    if limit < 3 * LEAST_CONTRAST:
        return None
    band_px = max(round(margin * COLOUR_SCALE), 3)  # bands are white, grey or black
    coloured = cv2.morphologyEx(coloured, cv2.MORPH_CLOSE, np.ones((band_px, 3), np.uint8))
    count, _, stats, _ = cv2.connectedComponentsWithStats(coloured)
    if count < 2:
        return None
    left, top, width, height = stats[1 + stats[1:, 4].argmax(), :4]
    if min(left, top) < 2 or left + width > coloured.shape[1] - 2 or top + height > coloured.shape[0] - 2:
        return None
    return np.asarray(np.array((left, top, left + width, top + height)) / COLOUR_SCALE + (x0, y0, x0, y0))


def triples_of(picture: LabelledImage, pairs: list[tuple[np.ndarray, np.ndarray]]) -> list[np.ndarray]:
    """(label, box, colour box) (3, 4) in shares of the height, of cones with all three."""
    triples = []
    for box, label in pairs:
        height = label[3] - label[1]
        alone = (intersection_over_union(label, picture.boxes[:, :4]) > 0.02).sum() == 1
        around = (box + label) / 2
        coloured = colour_box(picture.image, around) if alone and height >= COLOUR_FROM_PX else None
        if coloured is not None and intersection_over_union(coloured, around[None])[0] > 0.4:
            triples.append(np.stack((label, box, coloured)) / height)
    return triples


def errors_of_three(values: np.ndarray) -> tuple[int, list[float]]:
    """How many of N things were no outliers, and the standard deviations of the errors of their three measurements (N, 3).

    The error of the first is the covariance of its differences to the two others, and so on, since errors have nothing in common.
    """
    differences = values[:, [0, 0, 1]] - values[:, [1, 2, 2]]
    centred = differences - np.median(differences, axis=0)
    kept = (np.abs(centred) < OUTLIER * robust_scatter(differences)).all(axis=1)
    ab, ac, bc = (differences[kept] - differences[kept].mean(axis=0)).T
    variances = ((ab * ac).mean(), -(ab * bc).mean(), (ac * bc).mean())
    return int(kept.sum()), [float(np.sqrt(max(variance, 0.0))) for variance in variances]


def moved_labels(picture: LabelledImage, error: np.ndarray | float, rng: np.random.Generator) -> np.ndarray:
    """The labels as boxes (N, 5) x, y, w, h, score, each side moved by a normal error, (4,) or one, in shares of the height."""
    labels = picture.boxes[:, :4]
    moved = labels + rng.normal(size=labels.shape) * error * (labels[:, 3:4] - labels[:, 1:2])
    scores = rng.uniform(0.5, 1.0, len(labels))
    return np.column_stack((moved[:, :2], moved[:, 2:] - moved[:, :2], scores))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("model", type=Path)
    parser.add_argument("--cones", type=Path, required=True)
    args = parser.parse_args()
    detector = load_detector(args.model)
    pictures = read_cones(args.cones, "val")
    rng = np.random.default_rng(0)
    for source in sorted({picture.source for picture in pictures}):
        ours = [picture for picture in pictures if picture.source == source]
        found = [pairs_of(p, detect_image(detector, p.image, score_threshold=SCORE)) for p in ours]
        boxes, labels = (np.array(part) for part in zip(*(pair for pairs in found for pair in pairs), strict=True))
        heights = labels[:, 3:4] - labels[:, 1:2]
        sides = robust_scatter((boxes - labels) / heights)
        ratios = [np.log((c[:, 2] - c[:, 0]) / (c[:, 3] - c[:, 1])) for c in (labels, boxes)]
        print(
            f"{source}: {len(boxes)} cones; left, top, right, bottom {sides.round(3).tolist()} of the height;", end=" "
        )
        print(f"width to height of labels {ratios[0].std():.3f}, of boxes {ratios[1].std():.3f},", end=" ")
        print(f"correlation {np.corrcoef(*ratios)[0, 1]:.2f}")
        triples = np.array([t for p, pairs in zip(ours, found, strict=True) for t in triples_of(p, pairs)])
        if len(triples) < 50:
            print(f"  {len(triples)} cones alone in another colour than the road: too few for three errors")
            continue
        counts, errors = zip(*(errors_of_three(triples[:, :, side]) for side in range(4)), strict=True)
        for side, count, (of_label, of_box, of_colour) in zip(SIDES, counts, errors, strict=True):
            print(
                f"  {side}, {count} cones: error of labels {of_label:.3f}, boxes {of_box:.3f}, colour {of_colour:.3f}"
            )
        moved = [moved_labels(picture, np.array(errors)[:, 0], rng) for picture in ours]
        table = coco_tables(ours, moved)[">=20 px"]
        print(
            f"  exact boxes against labels with these errors, >=20 px: AP50 {table['ap50']}, AP50:95 {table['ap50_95']}"
        )
    for error in ERRORS:
        table = coco_tables(pictures, [moved_labels(picture, error, rng) for picture in pictures])[">=20 px"]
        print(f"labels moved by {error:.2f} of the height, >=20 px: AP50 {table['ap50']}, AP50:95 {table['ap50_95']}")


if __name__ == "__main__":
    main()
