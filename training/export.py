"""Export a checkpoint to ONNX with its sidecar (`conetl.learning.onnx_export`).

python -m training.export RUN/last.pt --out RUN/conetl-road-10.onnx --version 10.0
"""

from __future__ import annotations

import argparse
import hashlib
import json
from pathlib import Path

import torch

from conetl.learning.classes import CLASSES
from conetl.learning.network import BINS, STRIDES, ConeNet
from conetl.learning.onnx_export import export_network


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("checkpoint", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--version", required=True)
    parser.add_argument(
        "--scores", type=float, nargs=2, default=(1.0, 0.0), metavar=("FACTOR", "OFFSET"),
        help="what the logits of scores are multiplied by, and what is added (Platt scaling on sources left out)",
    )  # fmt: skip
    args = parser.parse_args()
    network = ConeNet()
    network.load_state_dict(torch.load(args.checkpoint, map_location="cpu", weights_only=True)["average"])
    factor, offset = args.scores
    with torch.no_grad():
        for score in network.score:
            score.weight *= factor
            score.bias.mul_(factor).add_(offset)
    args.out.parent.mkdir(parents=True, exist_ok=True)
    worst = export_network(network, args.out)
    card = {
        "name": args.out.stem,
        "version": args.version,
        "sha256": hashlib.sha256(args.out.read_bytes()).hexdigest(),
        "input_layout": "BGR float32 NHWC 0..255",
        "head": {
            "kind": "side-distributions",
            "side_bins": BINS,
            "strides_px": list(STRIDES),
            "foot_and_tip": True,
            "class_count": len(CLASSES),
        },
        "pad_multiple_px": max(STRIDES),
        "class_names": list(CLASSES),
        # As for the shipped weights; others may do better with other numbers, or without (docs/map/models.md).
        "closer_look": {"cone_px": 48, "window_px": 96, "scores": [0.25, 0.75], "share": 0.35},
        "enlarged_look": {"below_px": 40, "from_score": 0.25, "around_px": 24, "scale": 2.0, "share": 0.65},
        "score_scale": "sigmoid 0..1, trained towards the IoU with the true box; not calibrated as a probability",
        "licence": "as conetl itself; trained on CC BY 4.0 and ODC-By 1.0 images, attribution in the model card beside this file",
    }
    args.out.with_name(args.out.name + ".json").write_text(json.dumps(card, indent=2) + "\n")
    print(f"{args.out}: {args.out.stat().st_size / 1e6:.2f} MB, largest difference {worst:.1e}")


if __name__ == "__main__":
    main()
