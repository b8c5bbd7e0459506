"""Well-known detection networks with random weights as ONNX files, for comparison with the speed of conetl's own network.

Random weights take as long to multiply as trained ones. Batch norms are folded into the convolutions' biases, as in every
export for inference. Decoding of boxes and non-maximum suppression are left out, which favours the rivals.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import sqrt
from pathlib import Path
from typing import Any, Literal

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

OPSET = 17
IR_VERSION = 8
INPUT_NAME = "images"

Activation = Literal["leaky", "silu", "none"]

#: Variance gain that keeps activations at about the same size (He et al. 2015): 1 / E[f(x)^2] of a standard normal x.
GAIN = {"leaky": 2.0 / (1.0 + 0.1**2), "silu": 2.8, "none": 1.0}
BRANCH_SCALE = 0.3


@dataclass(frozen=True)
class Map:
    """One feature map of the graph being built: the tensor's name and its number of channels."""

    name: str
    channels: int


@dataclass
class Graph:
    """The nodes and weights so far, with consecutive names."""

    activation: Activation
    random: np.random.Generator
    nodes: list[onnx.NodeProto] = field(default_factory=list)
    weights: list[onnx.TensorProto] = field(default_factory=list)


def add(graph: Graph, kind: str, inputs: Sequence[str], **attributes: Any) -> str:
    """Add a node with one output and give the output's name."""
    name = f"{kind.lower()}_{len(graph.nodes)}"
    graph.nodes.append(helper.make_node(kind, list(inputs), [name], name=name, **attributes))
    return name


def weight(graph: Graph, values: np.ndarray[Any, Any]) -> str:
    name = f"weight_{len(graph.weights)}"
    graph.weights.append(numpy_helper.from_array(values, name))
    return name


def conv(
    graph: Graph,
    source: Map,
    channels: int,
    kernel: int,
    *,
    stride: int = 1,
    depthwise: bool = False,
    activation: Activation | None = None,
    branch: bool = False,
) -> Map:
    """Convolution with bias, then the graph's activation unless another is given.

    branch: the last one before it is added to a shortcut; its weights are smaller, so that many sums in a row do not grow.
    """
    after = graph.activation if activation is None else activation
    fan_in = (1 if depthwise else source.channels) * kernel * kernel
    shape = (channels, fan_in // (kernel * kernel), kernel, kernel)
    values = graph.random.standard_normal(shape, dtype=np.float32) * np.float32(sqrt(GAIN[after] / fan_in))
    if branch:
        values *= np.float32(BRANCH_SCALE)
    bias = graph.random.standard_normal(channels, dtype=np.float32) * np.float32(0.1)
    name = add(
        graph, "Conv", (source.name, weight(graph, values), weight(graph, bias)),
        kernel_shape=[kernel, kernel], strides=[stride, stride], pads=[kernel // 2] * 4,
        group=source.channels if depthwise else 1,
    )  # fmt: skip
    if after == "leaky":
        name = add(graph, "LeakyRelu", (name,), alpha=0.1)
    elif after == "silu":
        name = add(graph, "Mul", (name, add(graph, "Sigmoid", (name,))))
    return Map(name, channels)


def concat(graph: Graph, maps: Sequence[Map]) -> Map:
    return Map(add(graph, "Concat", [part.name for part in maps], axis=1), sum(part.channels for part in maps))


def plus(graph: Graph, first: Map, second: Map) -> Map:
    """Sum of a shortcut and its branch."""
    return Map(add(graph, "Add", (first.name, second.name)), first.channels)


def upsample(graph: Graph, source: Map) -> Map:
    scales = weight(graph, np.array([1, 1, 2, 2], np.float32))
    return Map(add(graph, "Resize", (source.name, "", scales), mode="nearest"), source.channels)


def halves(graph: Graph, source: Map) -> tuple[Map, Map]:
    """The first and the second half of the channels."""
    half = source.channels // 2
    names = [f"split_{len(graph.nodes)}_{part}" for part in (0, 1)]
    graph.nodes.append(helper.make_node("Split", [source.name, weight(graph, np.array([half, half]))], names, axis=1))
    return Map(names[0], half), Map(names[1], half)


def write_network(graph: Graph, outputs: Sequence[Map], size_px: int, path: Path) -> None:
    """Check the graph and write it with a fixed input (1, 3, size_px, size_px)."""
    model = helper.make_model(
        helper.make_graph(
            graph.nodes,
            path.stem,
            [helper.make_tensor_value_info(INPUT_NAME, TensorProto.FLOAT, [1, 3, size_px, size_px])],
            [
                helper.make_tensor_value_info(out.name, TensorProto.FLOAT, [1, out.channels, None, None])
                for out in outputs
            ],
            initializer=graph.weights,
        ),
        opset_imports=[helper.make_opsetid("", OPSET)],
        ir_version=IR_VERSION,
    )
    onnx.checker.check_model(model)
    onnx.save(model, str(path))


def write_yolov3(path: Path, *, size_px: int = 416, classes: int = 80, seed: int = 3) -> None:
    """YOLOv3 on Darknet-53 (Redmon & Farhadi 2018): three scales with three anchors each."""
    graph = Graph("leaky", np.random.default_rng(seed))
    x = conv(graph, Map(INPUT_NAME, 3), 32, 3)
    stages = []
    for channels, blocks in ((64, 1), (128, 2), (256, 8), (512, 8), (1024, 4)):
        x = conv(graph, x, channels, 3, stride=2)
        for _ in range(blocks):
            x = plus(graph, x, conv(graph, conv(graph, x, channels // 2, 1), channels, 3, branch=True))
        stages.append(x)
    outputs = []
    for width, skip in ((512, None), (256, stages[3]), (128, stages[2])):
        if skip is not None:
            x = concat(graph, (upsample(graph, conv(graph, x, width, 1)), skip))
        for kernel in (1, 3, 1, 3, 1):
            x = conv(graph, x, width if kernel == 1 else 2 * width, kernel)
        outputs.append(conv(graph, conv(graph, x, 2 * width, 3), 3 * (5 + classes), 1, activation="none"))
    write_network(graph, outputs, size_px, path)


def bottleneck(graph: Graph, source: Map, middle: int) -> Map:
    return plus(graph, source, conv(graph, conv(graph, source, middle, 3), source.channels, 3, branch=True))


def cross_stage(graph: Graph, source: Map) -> Map:
    """A cross-stage block with two full-width bottlenecks on half of the channels."""
    half = source.channels // 2
    deep = conv(graph, source, half, 1)
    for _ in range(2):
        deep = bottleneck(graph, deep, half)
    return conv(graph, concat(graph, (deep, conv(graph, source, half, 1))), source.channels, 1)


def split_stage(graph: Graph, source: Map, channels: int, *, hidden: int, deep: bool) -> Map:
    """A split-and-concat stage: half of the maps pass one block, all of them are joined again."""
    first, second = halves(graph, conv(graph, source, 2 * hidden, 1))
    third = cross_stage(graph, second) if deep else bottleneck(graph, second, hidden // 2)
    return conv(graph, concat(graph, (first, second, third)), channels, 1)


def pyramid_pool(graph: Graph, source: Map) -> Map:
    """Three 5x5 maxima one after another, joined (the fast form of spatial pyramid pooling)."""
    pooled = [conv(graph, source, source.channels // 2, 1)]
    for _ in range(3):
        name = add(graph, "MaxPool", (pooled[-1].name,), kernel_shape=[5, 5], strides=[1, 1], pads=[2] * 4)
        pooled.append(Map(name, pooled[0].channels))
    return conv(graph, concat(graph, pooled), source.channels, 1)


def attention(graph: Graph, source: Map, cells: int, *, heads: int) -> Map:
    """Self-attention over all cells of a small map; keys are half as wide as values, positions come from a depthwise conv."""
    value = source.channels // heads
    key = value // 2
    mixed = conv(graph, source, heads * (2 * key + value), 1, activation="none")
    tall = add(graph, "Reshape", (mixed.name, weight(graph, np.array([1, heads, 2 * key + value, cells]))))
    names = [f"{part}_{len(graph.nodes)}" for part in ("query", "key", "value")]
    graph.nodes.append(helper.make_node("Split", [tall, weight(graph, np.array([key, key, value]))], names, axis=2))
    query = add(graph, "Transpose", (names[0],), perm=[0, 1, 3, 2])
    product = add(graph, "MatMul", (query, names[1]))
    scaled = add(graph, "Mul", (product, weight(graph, np.array(key**-0.5, np.float32))))
    shares = add(graph, "Transpose", (add(graph, "Softmax", (scaled,), axis=-1),), perm=[0, 1, 3, 2])
    attended = add(graph, "MatMul", (names[2], shares))
    side = round(sqrt(cells))
    square = weight(graph, np.array([1, source.channels, side, side]))
    values = Map(add(graph, "Reshape", (names[2], square)), source.channels)
    position = conv(graph, values, source.channels, 3, depthwise=True, activation="none")
    joined = plus(graph, Map(add(graph, "Reshape", (attended, square)), source.channels), position)
    return conv(graph, joined, source.channels, 1, activation="none", branch=True)


def attention_stage(graph: Graph, source: Map, cells: int) -> Map:
    first, second = halves(graph, conv(graph, source, source.channels, 1))
    second = plus(graph, second, attention(graph, second, cells, heads=2))
    wide = conv(graph, second, 2 * second.channels, 1)
    second = plus(graph, second, conv(graph, wide, second.channels, 1, activation="none", branch=True))
    return conv(graph, concat(graph, (first, second)), source.channels, 1)


def write_yolo11n(path: Path, *, size_px: int = 640, classes: int = 80, seed: int = 11) -> None:
    """A network of the layout and size of YOLO11n: split stages, pyramid pooling, attention, two-way neck, decoupled head."""
    graph = Graph("silu", np.random.default_rng(seed))
    x = conv(graph, Map(INPUT_NAME, 3), 16, 3, stride=2)
    x = conv(graph, x, 32, 3, stride=2)
    x = split_stage(graph, x, 64, hidden=16, deep=False)
    x = conv(graph, x, 64, 3, stride=2)
    fine = split_stage(graph, x, 128, hidden=32, deep=False)
    middle = split_stage(graph, conv(graph, fine, 128, 3, stride=2), 128, hidden=64, deep=True)
    coarse = split_stage(graph, conv(graph, middle, 256, 3, stride=2), 256, hidden=128, deep=True)
    coarse = attention_stage(graph, pyramid_pool(graph, coarse), (size_px // 32) ** 2)
    down = split_stage(graph, concat(graph, (upsample(graph, coarse), middle)), 128, hidden=64, deep=False)
    small = split_stage(graph, concat(graph, (upsample(graph, down), fine)), 64, hidden=32, deep=False)
    joined = concat(graph, (conv(graph, small, 64, 3, stride=2), down))
    medium = split_stage(graph, joined, 128, hidden=64, deep=False)
    joined = concat(graph, (conv(graph, medium, 128, 3, stride=2), coarse))
    large = split_stage(graph, joined, 256, hidden=128, deep=True)
    outputs = []
    for scale in (small, medium, large):
        box = conv(graph, conv(graph, scale, 64, 3), 64, 3)
        kind = scale
        for _ in range(2):
            kind = conv(graph, conv(graph, kind, kind.channels, 3, depthwise=True), classes, 1)
        sides, scores = (conv(graph, part, part.channels, 1, activation="none") for part in (box, kind))
        outputs.append(concat(graph, (sides, scores)))
    write_network(graph, outputs, size_px, path)
