"""fp32 network -> int8 (QDQ, static), with the ranges seen on images.

Weights per channel, and in 7 bits: processors without VNNI add two 8-bit products in 16 bits and would overflow. The last layers
stay fp32, as the sides of boxes suffer most from rounding. The quantised network takes the image's bytes as they are.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import onnx
from onnx import GraphProto, TensorProto, numpy_helper
from onnxruntime.quantization import CalibrationDataReader, CalibrationMethod, QuantFormat, QuantType, quantize_static
from onnxruntime.quantization.shape_inference import quant_pre_process

from conetl.model.errors import InputError

# The output layers work on a few cells; one 8-bit scale for logits and offsets would round the offsets to nothing. The scores
# that choose the cells may be rounded.
LEFT_IN_FP32 = ("Gemm", "MatMul")


class CalibrationImages(CalibrationDataReader):
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
    above_and_left = [1, 1, 0, 0]  # `onnx_export.PackedStem`
    next(attribute for attribute in convolution.attribute if attribute.name == "pads").ints[:] = above_and_left
    rewire(graph, pad.output[0], pad.input[0])
    graph.node.remove(pad)


def take_bytes(graph: GraphProto) -> None:
    """The network's input becomes 8-bit, which it is at a scale of 1: the step that rounds it goes."""
    rounding = next(node for node in graph.node if node.op_type == "QuantizeLinear" and node.name.startswith("/stem/"))
    constants = {constant.name: numpy_helper.to_array(constant) for constant in graph.initializer}
    if [constants[name].item() for name in rounding.input[1:3]] != [1, 0]:
        raise InputError("the images that give the ranges do not reach from black to white: more images are needed")
    rewire(graph, rounding.output[0], rounding.input[0])
    graph.node.remove(rounding)
    graph.input[0].type.tensor_type.elem_type = TensorProto.UINT8


def read_shapes_in_8_bits(graph: GraphProto) -> None:
    """Shapes are read before numbers are made floats again: else that happens for the shape alone."""
    for node in list(graph.node):
        if node.op_type == "DequantizeLinear":
            rewire(graph, node.output[0], node.input[0], ("Shape",))


def quantise(model: Path, images: Sequence[np.ndarray], out: Path) -> None:
    """Write the int8 network of a float32 one of `onnx_export`. images (H, W, 3) BGR give the ranges of its features."""
    with tempfile.TemporaryDirectory() as folder:
        prepared = Path(folder) / "prepared.onnx"
        quant_pre_process(str(model), str(prepared), skip_symbolic_shape=True)
        network = onnx.load(prepared)
        pad_in_convolution(network.graph)
        onnx.save(network, prepared)
        quantize_static(
            str(prepared),
            str(out),
            CalibrationImages(list(images)),
            quant_format=QuantFormat.QDQ,
            activation_type=QuantType.QUInt8,
            weight_type=QuantType.QInt8,
            per_channel=True,
            reduce_range=True,
            calibrate_method=CalibrationMethod.MinMax,
            nodes_to_exclude=[node.name for node in network.graph.node if node.op_type in LEFT_IN_FP32],
        )
    network = onnx.load(out)
    take_bytes(network.graph)
    read_shapes_in_8_bits(network.graph)
    del network.graph.value_info[:]
    onnx.checker.check_model(network)
    onnx.save(network, out)
