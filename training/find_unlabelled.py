"""Label cleaning: places in the training pictures that an earlier detector takes for a cone and nobody labelled.

    python training/find_unlabelled.py MODEL.onnx --cones DIR --out unlabelled.json

Such a place is either a cone without a label or a thing that looks like one. Training neither teaches nor forbids a cone
there (`train.py --unlabelled`), which is narrower than giving up the whole band of far cones (`dataset.far_band`).
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "src"))

from dataset import read_cones

from conetl.perception.decoding import intersection_over_union
from conetl.perception.detector import detect_image, load_detector


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("model", type=Path)
    parser.add_argument("--cones", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--score", type=float, default=0.12)
    args = parser.parse_args()
    detector = load_detector(args.model)
    places: dict[str, list[list[float]]] = {}
    for picture in read_cones(args.cones, "train"):
        found = []
        for x, y, width, height, _score in detect_image(detector, picture.image, score_threshold=args.score)[:, :5]:
            box = np.array([x, y, x + width, y + height])
            if len(picture.boxes) and intersection_over_union(box, picture.boxes[:, :4]).max() > 0.1:
                continue
            found.append([round(v, 1) for v in (x - 2, y - 2, x + width + 2, y + height + 2)])
        places[picture.name] = found
    args.out.write_text(json.dumps({"model": detector.card.name, "sha256": detector.card.sha256, "places": places}))
    print(f"{sum(map(len, places.values()))} places in {len(places)} pictures")


if __name__ == "__main__":
    main()
