"""fp32 network -> int8 (QDQ, static), with the ranges seen on training images.

    python -m training.quantise RUN/conetl-road-10.onnx --cones DIR --renders DIR --out data/models/conetl-road-10.onnx

Weights per channel, and in 7 bits: processors without VNNI add two 8-bit products in 16 bits and would overflow. The last layers
stay fp32, as the sides of boxes suffer most from rounding. The quantised network takes the image's bytes as they are.
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
from onnx import GraphProto, TensorProto, numpy_helper
from onnxruntime.quantization import CalibrationDataReader, CalibrationMethod, QuantFormat, QuantType, quantize_static
from onnxruntime.quantization.shape_inference import quant_pre_process

from training.dataset import read_cones, read_renders

# The output layers work on a few cells; one 8-bit scale for logits and offsets would round the offsets to nothing. The scores
# that choose the cells may be rounded.
LEFT_IN_FP32 = ("Gemm", "MatMul")


class Images(CalibrationDataReader):
    """Crops of training images, 640 x 384, one at a time."""

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
        return {"picture": image[None, y : y + 384, x : x + 640].astype(np.float32)}


def rewire(graph: GraphProto, old: str, new: str, kinds: tuple[str, ...] = ()) -> None:
    """Whoever reads `old`, or only nodes of these kinds, reads `new`."""
    for node in graph.node:
        if not kinds or node.op_type in kinds:
            node.input[:] = [new if name == old else name for name in node.input]


def pad_in_convolution(graph: GraphProto) -> None:
    """The first convolution's padding, a node of its own in the export, becomes its attribute: one copy of the image less."""
    (pad,) = (node for node in graph.node if node.op_type == "Pad")
    (convolution,) = (node for node in graph.node if pad.output[0] in node.input)
    above_and_left = [1, 1, 0, 0]  # `export.PackedStem`
    next(attribute for attribute in convolution.attribute if attribute.name == "pads").ints[:] = above_and_left
    rewire(graph, pad.output[0], pad.input[0])
    graph.node.remove(pad)


def take_bytes(graph: GraphProto) -> None:
    """The network's input becomes 8-bit, which it is at a scale of 1: the step that rounds it goes."""
    rounding = next(node for node in graph.node if node.op_type == "QuantizeLinear" and node.name.startswith("/stem/"))
    constants = {constant.name: numpy_helper.to_array(constant) for constant in graph.initializer}
    if [constants[name].item() for name in rounding.input[1:3]] != [1, 0]:
        raise SystemExit("the pictures that gave the ranges do not reach from 0 to 255: take more of them")
    rewire(graph, rounding.output[0], rounding.input[0])
    graph.node.remove(rounding)
    graph.input[0].type.tensor_type.elem_type = TensorProto.UINT8


def read_shapes_in_8_bits(graph: GraphProto) -> None:
    """Shapes are read before numbers are made floats again: else that happens for the shape alone."""
    for node in list(graph.node):
        if node.op_type == "DequantizeLinear":
            rewire(graph, node.output[0], node.input[0], ("Shape",))


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
        model = onnx.load(prepared)
        pad_in_convolution(model.graph)
        onnx.save(model, prepared)
        quantize_static(
            str(prepared),
            str(args.out),
            Images([picture.image for picture in pictures]),
            quant_format=QuantFormat.QDQ,
            activation_type=QuantType.QUInt8,
            weight_type=QuantType.QInt8,
            per_channel=True,
            reduce_range=True,
            calibrate_method=CalibrationMethod.MinMax,
            nodes_to_exclude=[node.name for node in model.graph.node if node.op_type in LEFT_IN_FP32],
        )
    model = onnx.load(args.out)
    take_bytes(model.graph)
    read_shapes_in_8_bits(model.graph)
    del model.graph.value_info[:]
    onnx.checker.check_model(model)
    onnx.save(model, args.out)
    card = json.loads(args.model.with_name(args.model.name + ".json").read_text())
    card["name"], card["input_layout"] = args.out.stem, "BGR uint8 NHWC 0..255"
    card.pop("evidence", None)  # measured on another file: calibrate_scores.py measures it anew
    card["sha256"] = hashlib.sha256(args.out.read_bytes()).hexdigest()
    args.out.with_name(args.out.name + ".json").write_text(json.dumps(card, indent=2) + "\n")
    print(f"{args.out}: {args.out.stat().st_size / 1e6:.2f} MB, ranges from {len(pictures)} pictures")


if __name__ == "__main__":
    main()
