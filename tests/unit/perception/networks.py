"""A network for tests: it reads an image and always gives the same."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper


def constant_network(outputs: Sequence[np.ndarray], image_shape: Sequence[int | str]) -> bytes:
    """An ONNX file that gives the outputs plus 0 times the image's mean."""
    nodes = [
        helper.make_node("ReduceMean", ["images"], ["mean"], keepdims=0),
        helper.make_node("Mul", ["mean", "zero"], ["nothing"]),
    ]
    constants = [numpy_helper.from_array(np.zeros((), np.float32), "zero")]
    given_outputs = []
    for index, output in enumerate(outputs):
        constants.append(numpy_helper.from_array(np.asarray(output, np.float32), f"raw{index}"))
        nodes.append(helper.make_node("Add", [f"raw{index}", "nothing"], [f"output{index}"]))
        given_outputs.append(helper.make_tensor_value_info(f"output{index}", TensorProto.FLOAT, output.shape))
    images = helper.make_tensor_value_info("images", TensorProto.FLOAT, image_shape)
    graph = helper.make_graph(nodes, "constant", [images], given_outputs, constants)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    onnx.checker.check_model(model)
    return bytes(model.SerializeToString())
