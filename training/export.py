"""Export a checkpoint to ONNX with its sidecar, and check that the runtime gives what PyTorch gave.

python training/export.py RUN/last.pt --out data/models/conetl-cone-2.onnx --version 1.0
"""

from __future__ import annotations

import argparse
import hashlib
import json
from pathlib import Path

import numpy as np
import onnxruntime
import torch
from network import BINS, STRIDES, ConeNet, fuse_batch_norms


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("checkpoint", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--version", required=True)
    args = parser.parse_args()
    network = ConeNet()
    network.load_state_dict(torch.load(args.checkpoint, map_location="cpu", weights_only=True)["average"])
    network.eval()
    picture = torch.rand(2, 3, 96, 160)
    with torch.no_grad():
        expected = network(picture)
    fuse_batch_norms(network)
    names = [f"stride{stride}" for stride in STRIDES]
    axes = {"picture": {0: "batch", 2: "height", 3: "width"}} | {
        n: {0: "batch", 2: f"{n}_h", 3: f"{n}_w"} for n in names
    }
    args.out.parent.mkdir(parents=True, exist_ok=True)
    torch.onnx.export(
        network,
        (picture,),
        str(args.out),
        input_names=["picture"],
        output_names=names,
        dynamic_axes=axes,
        opset_version=17,
        dynamo=False,
    )
    given = onnxruntime.InferenceSession(str(args.out)).run(None, {"picture": picture.numpy()})
    worst = max(float(np.abs(a - b.numpy()).max()) for a, b in zip(given, expected, strict=True))
    if worst > 1e-2:
        raise SystemExit(f"the exported network differs from the trained one by {worst}")
    card = {
        "name": args.out.stem,
        "version": args.version,
        "sha256": hashlib.sha256(args.out.read_bytes()).hexdigest(),
        "input_layout": "RGB float32 NCHW 0..1",
        "head": {
            "kind": "side-distributions",
            "side_bins": BINS,
            "strides_px": list(STRIDES),
            "foot_and_tip": True,
        },
        "pad_multiple_px": max(STRIDES),
        "class_names": ["traffic_cone"],
        "score_scale": "sigmoid 0..1, trained towards the IoU with the true box; not calibrated as a probability",
        "licence": "as conetl itself; trained on CC BY 4.0 and ODC-By 1.0 pictures, attribution in README.md beside this file",
    }
    args.out.with_name(args.out.name + ".json").write_text(json.dumps(card, indent=2) + "\n")
    print(f"{args.out}: {args.out.stat().st_size / 1e6:.2f} MB, largest difference {worst:.1e}")


if __name__ == "__main__":
    main()
