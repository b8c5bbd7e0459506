"""fp32 network -> int8, with the ranges seen on training images (`conetl.learning.quantise`).

python -m training.quantise RUN/conetl-road-10.onnx --cones DIR --renders DIR --out data/models/conetl-road-10.onnx
"""

from __future__ import annotations

import argparse
import hashlib
import json
from pathlib import Path

from conetl.learning.quantise import quantise
from training.dataset import read_cones, read_renders


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("model", type=Path)
    parser.add_argument("--cones", type=Path, required=True)
    parser.add_argument("--renders", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--count", type=int, default=90)
    args = parser.parse_args()
    pictures = read_cones(args.cones, "train")
    pictures = pictures[:: max(len(pictures) * 3 // (2 * args.count), 1)]
    if args.renders:
        pictures += read_renders(args.renders, set(), limit=args.count // 3)
    quantise(args.model, [picture.image for picture in pictures], args.out)
    card = json.loads(args.model.with_name(args.model.name + ".json").read_text())
    card["name"], card["input_layout"] = args.out.stem, "BGR uint8 NHWC 0..255"
    card.pop("evidence", None)  # measured on another file: calibrate_scores.py measures it anew
    card["sha256"] = hashlib.sha256(args.out.read_bytes()).hexdigest()
    args.out.with_name(args.out.name + ".json").write_text(json.dumps(card, indent=2) + "\n")
    print(f"{args.out}: {args.out.stat().st_size / 1e6:.2f} MB, ranges from {len(pictures)} pictures")


if __name__ == "__main__":
    main()
