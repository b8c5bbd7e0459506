"""What the scores of a model mean: calibration, P(detect | height, hidden), false boxes; into its sidecar.

    python -m training.calibrate_scores MODEL.onnx --cones DIR [--more-cones DIR --left-out NAMES [--clips DIR]]
        [--labelled DIR] [--cone-free DIR] [--json OUT] [--write]

Run it after `quantise.py`, on images that took no part in training. `--left-out` names sources and clips as for `train.py`:
with them, scores mean something away from the training sources, too. With `--clips` the false boxes of the other classes are
counted on the clips left out. `--labelled` names renders (images/, labels/) with exact
labels, `--cone-free` a folder of images without any cone. With `--write` the figures go into `MODEL.onnx.json` and the
reliability curve beside the model, `MODEL.reliability.png`; the text for the model card is printed.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import tempfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.stats import chi2

from conetl.learning.classes import CLASSES
from conetl.learning.evidence.calibration import REFERENCE, folds_of
from conetl.learning.evidence.looks import LEAST_SCORE, look_at_pictures
from conetl.learning.evidence.measure import measure, sidecar_text
from conetl.learning.evidence.reliability import expected_calibration_error, reliability_bins
from conetl.learning.images import LabelledImage
from conetl.learning.scoring import at_score, of_class
from conetl.model.detector_evidence import DetectorEvidence
from conetl.model.feature_classes import CONE
from conetl.perception.detector import Detector, detect_image, load_detector
from conetl.perception.model_card import read_model_card
from training.dataset import read_cones, read_left_out, read_renders
from training.evaluate import left_out_clips


def read_cone_free(folder: Path) -> list[LabelledImage]:
    images = ((path, cv2.imread(str(path))) for path in sorted(folder.iterdir()) if path.suffix in (".jpg", ".png"))
    return [
        LabelledImage(path.stem, "cone-free", image, np.zeros((0, 9))) for path, image in images if image is not None
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("model", type=Path)
    parser.add_argument("--cones", type=Path, required=True)
    parser.add_argument("--more-cones", type=Path)
    parser.add_argument("--left-out", default="")
    parser.add_argument("--clips", type=Path)
    parser.add_argument("--labelled", type=Path)
    parser.add_argument("--cone-free", type=Path)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--write", action="store_true")
    args = parser.parse_args()
    sidecar = args.model.with_name(args.model.name + ".json")
    card = json.loads(sidecar.read_text())
    card.pop("evidence", None)  # that of an earlier file would keep this one from loading
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / args.model.name
        copy.write_bytes(args.model.read_bytes())
        copy.with_name(copy.name + ".json").write_text(json.dumps(card))
        detector = load_detector(copy)
    pictures = read_cones(args.cones, "val")
    pictures += read_left_out(args.more_cones, args.left_out) if args.more_cones else []
    renders = read_renders(args.labelled, set()) if args.labelled else []
    pictures += [dataclasses.replace(p, boxes=p.boxes[p.boxes[:, 8] == CLASSES.index(CONE)]) for p in renders]
    pictures += read_cone_free(args.cone_free) if args.cone_free else []
    looks = look_at_pictures(
        pictures,
        lambda picture: picture.source in ("renders", "cone-free"),
        lambda image: detect_image(detector, image, score_threshold=LEAST_SCORE),
    )
    evidence, held_out, figures = measure(looks, folds_of(pictures), detector.card.sha256)
    if args.clips:
        clips = left_out_clips(args.clips, args.left_out)
        evidence = evidence.model_copy(update={"false_boxes_by_class": false_box_bounds(detector, clips)})
    print(model_card_text(evidence, figures))
    if args.json:
        args.json.write_text(json.dumps({"figures": figures, "evidence": evidence.model_dump()}, indent=2) + "\n")
    if args.write:
        sidecar.write_text(sidecar_text(card | {"evidence": evidence.model_dump(mode="json")}))
        read_model_card(args.model)
        truth = np.array([row[3] for row in looks.boxes])
        curve = args.model.with_suffix(".reliability.png")
        write_reliability_figure(
            curve, held_out["score"], held_out[evidence.calibration.method], truth, detector.card.name
        )
        print(f"{sidecar}, {curve}: written")


def model_card_text(evidence: DetectorEvidence, figures: dict[str, Any]) -> str:
    """The tables for the model card, in Markdown."""
    lines = ["| apparent height px | " + " | ".join(f"hidden {h}" for h in ("0-12 %", "12-37 %", "37-62 %")) + " |"]
    lines.append("|---" * 4 + "|")
    k = evidence.score_thresholds.index(REFERENCE)
    ends = [f"{high:g}" for high in evidence.height_bands_px[1:]] + [""]
    for i, (low, high) in enumerate(zip(evidence.height_bands_px, ends, strict=True)):
        cells = [
            f"{evidence.detected[k][i][j]:.2f} ({evidence.looks[i][j]})" for j in range(len(evidence.hidden_bands))
        ]
        lines.append(f"| {low:g}-{high} | " + " | ".join(cells) + " |")
    return "\n".join((f"P(detect at {REFERENCE}) (looks)", *lines, json.dumps(figures, indent=1)))


def false_box_bounds(detector: Detector, clips: list[LabelledImage]) -> dict[str, float]:
    """Boxes on no object per image, of each class but the cone: the upper 95 % limit of the mean of a Poisson count."""
    names = [name for name in detector.card.class_names if name != CONE]
    found = [
        detect_image(detector, p.image, score_threshold=REFERENCE, single_image=True, categories=names) for p in clips
    ]
    bounds = {}
    for name in names:
        pairs = [of_class(p, boxes, CLASSES.index(name)) for p, boxes in zip(clips, found, strict=True)]
        rate = at_score([p for p, _ in pairs], [boxes for _, boxes in pairs], REFERENCE)["false_a_picture"]
        count = round(rate * len(clips))
        bounds[name] = round(float(chi2.ppf(0.95, 2 * (count + 1)) / 2 / len(clips)), 2)
    return bounds


def write_reliability_figure(path: Path, before: np.ndarray, after: np.ndarray, truth: np.ndarray, name: str) -> None:
    """Two curves, of the score as it is and of the held-out calibrated probability, with numbers of boxes below."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    figure, (top, below) = plt.subplots(
        2, 1, figsize=(4.6, 5.4), height_ratios=(4, 1), sharex=True, constrained_layout=True
    )
    top.plot((0, 1), (0, 1), color="0.7", linewidth=1)
    for values, label, colour, side in (
        (before, "score", "tab:orange", -1),
        (after, "calibrated, held out", "tab:blue", 1),
    ):
        said, true, number = (np.array(column) for column in zip(*reliability_bins(values, truth), strict=True))
        # Wilson interval of the share (95 %)
        z = 1.96
        middle = (true + z * z / (2 * number)) / (1 + z * z / number)
        half = z * np.sqrt(true * (1 - true) / number + z * z / (4 * number**2)) / (1 + z * z / number)
        bars = np.abs(np.stack((true - (middle - half), middle + half - true)))
        ece = expected_calibration_error(values, truth)
        top.errorbar(
            said, true, bars, color=colour, marker="o", markersize=4, capsize=2, label=f"{label}: ECE {ece:.3f}"
        )
        below.bar(said + 0.01 * side, number, width=0.02, color=colour)
    top.set(ylabel="share of boxes on a cone", ylim=(-0.02, 1.02), title=f"{name}: {len(truth)} boxes")
    top.legend(loc="lower right", frameon=False)
    below.set(xlabel="score, or probability", ylabel="boxes", xlim=(0, 1))
    figure.savefig(path, dpi=90)
    plt.close(figure)


if __name__ == "__main__":
    main()
