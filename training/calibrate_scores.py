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

import cv2
import numpy as np

from conetl.learning.classes import CLASSES
from conetl.learning.evidence.calibration import folds_of
from conetl.learning.evidence.looks import LEAST_SCORE, look_at_pictures
from conetl.learning.evidence.measure import false_box_bounds, measure, model_card_text, sidecar_text
from conetl.learning.evidence.reliability import write_reliability_figure
from conetl.learning.images import LabelledImage
from conetl.model.feature_classes import CONE
from conetl.perception.detector import detect_image, load_detector
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


if __name__ == "__main__":
    main()
