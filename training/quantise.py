"""fp32 network -> int8 (QDQ, static), with the ranges seen on training pictures.

    python training/quantise.py RUN/conetl-cone-2.onnx --cones DIR --renders DIR --out data/models/conetl-cone-2.onnx

Weights per channel, and in 7 bits: processors without VNNI add two 8-bit products in 16 bits and would overflow. The last layers
stay fp32, as the sides of boxes suffer most from rounding, and so does the first: with 3 channels it is twice as slow in int8.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import tempfile
from pathlib import Path

import cv2
import numpy as np
import onnx
from dataset import read_cones, read_renders
from onnxruntime.quantization import CalibrationDataReader, CalibrationMethod, QuantFormat, QuantType, quantize_static
from onnxruntime.quantization.shape_inference import quant_pre_process

# The output layers work on a few cells; one 8-bit scale for logits and offsets would round the offsets to nothing.
LEFT_IN_FP32 = ("/stem/", "/outputs.")


class Pictures(CalibrationDataReader):
    """Crops of training pictures, 640 x 384, one at a time."""

    def __init__(self, images: list[np.ndarray], seed: int = 3) -> None:
        self.images, self.rng = iter(images), np.random.default_rng(seed)

    def get_next(self) -> dict[str, np.ndarray] | None:
        image = next(self.images, None)
        if image is None:
            return None
        height, width = image.shape[:2]
        scale = max(640 / width, 384 / height)
        image = cv2.resize(
            image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
        )
        y = int(self.rng.integers(image.shape[0] - 384 + 1))
        x = int(self.rng.integers(image.shape[1] - 640 + 1))
        return {"picture": cv2.dnn.blobFromImage(image[y : y + 384, x : x + 640], 1 / 255.0, swapRB=True)}


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
    with tempfile.TemporaryDirectory() as folder:
        prepared = Path(folder) / "prepared.onnx"
        quant_pre_process(str(args.model), str(prepared), skip_symbolic_shape=True)
        nodes = [node.name for node in onnx.load(str(prepared)).graph.node if node.name.startswith(LEFT_IN_FP32)]
        quantize_static(
            str(prepared),
            str(args.out),
            Pictures([picture.image for picture in pictures]),
            quant_format=QuantFormat.QDQ,
            activation_type=QuantType.QUInt8,
            weight_type=QuantType.QInt8,
            per_channel=True,
            reduce_range=True,
            calibrate_method=CalibrationMethod.MinMax,
            nodes_to_exclude=nodes,
        )
    card = json.loads(args.model.with_name(args.model.name + ".json").read_text())
    card["name"] = args.out.stem
    card.pop("evidence", None)  # measured on another file: calibrate_scores.py measures it anew
    card["sha256"] = hashlib.sha256(args.out.read_bytes()).hexdigest()
    args.out.with_name(args.out.name + ".json").write_text(json.dumps(card, indent=2) + "\n")
    print(f"{args.out}: {args.out.stat().st_size / 1e6:.2f} MB, ranges from {len(pictures)} pictures")


if __name__ == "__main__":
    main()
