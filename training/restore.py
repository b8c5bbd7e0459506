"""A checkpoint to train on from, out of the shipped int8 network (`conetl.learning.restore`).

python -m training.restore data/models/conetl-road-10.onnx --cones DIR --out RUN/start.pt
python -m training.train --start RUN/start.pt ...
"""

from __future__ import annotations

import argparse
from pathlib import Path

import torch

from conetl.learning.restore import restored_network
from training.dataset import read_cones


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("model", type=Path)
    parser.add_argument("--cones", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--count", type=int, default=120)
    args = parser.parse_args()
    pictures = read_cones(args.cones, "train")
    chosen = [pictures[k].image for k in range(0, len(pictures), max(len(pictures) // args.count, 1))]
    args.out.parent.mkdir(parents=True, exist_ok=True)
    torch.save({"average": restored_network(args.model, chosen).state_dict()}, args.out)


if __name__ == "__main__":
    main()
