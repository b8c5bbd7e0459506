"""The shipped int8 network as one that can be trained on.

Weights are the 8-bit ones, as floats. The shipped network has its batch norms folded into its convolutions; here each of them
is given the mean and variance that its convolution has on some images, and the gain and offset that undo them, so that the
restored network answers as the shipped one does, also while it is trained.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import onnx
import torch
from numpy.typing import NDArray
from onnx import numpy_helper
from torch import Tensor, nn

from conetl.learning.network import BINS, ConeNet, has_batch_norm
from conetl.model.errors import InputError, ModelFileError

Constants = dict[str, NDArray[Any]]


def weight_of(constants: Constants, name: str) -> NDArray[np.float32]:
    """An 8-bit weight, quantised per output channel, as floats."""
    whole = constants[f"{name}.weight_quantized"].astype(np.float32)
    if constants[f"{name}.weight_zero_point"].any():
        raise ModelFileError(f"{name}: expected weights quantised around 0")
    scale = constants[f"{name}.weight_scale"].astype(np.float32)
    return whole * scale.reshape((-1,) + (1,) * (whole.ndim - 1))


def bias_of(constants: Constants, name: str) -> NDArray[np.float32]:
    """A bias, which is 32-bit integers or floats."""
    if f"{name}.bias" in constants:
        return constants[f"{name}.bias"].astype(np.float32)
    return (constants[f"{name}.bias_quantized"] * constants[f"{name}.bias_quantized_scale"]).astype(np.float32)


def unpacked_stem(
    packed: NDArray[np.float32], bias: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """The first convolution as `ConeNet` has it: the reverse of `onnx_export.PackedStem`, of its first output column."""
    channels = len(packed) // 2
    columns = packed.reshape(2, channels, 4, 3, 3, 2)[0]  # channel; pixel, colour; row, column
    taps = [columns[:, (tap - 1) % 4, :, :, (4 + tap - 1) // 4] for tap in range(3)]
    return np.stack(taps, -1)[:, ::-1] * np.float32(255), bias[:channels]


def blocks_of(network: ConeNet) -> dict[str, nn.Sequential]:
    """Every convolution with its batch norm, by its name."""
    return {name: block for name, block in network.named_modules() if has_batch_norm(block)}


@torch.no_grad()
def take_shipped_weights(network: ConeNet, constants: Constants) -> None:
    """Weights of the shipped network; batch norms that do nothing but add its biases."""
    for name, (convolution, norm, _) in blocks_of(network).items():
        if name == "stem":
            stem = weight_of(constants, "network.stem.conv"), bias_of(constants, "network.stem.conv")
            weight, bias = unpacked_stem(*stem)
        else:
            weight, bias = weight_of(constants, f"network.{name}.0"), bias_of(constants, f"network.{name}.0")
        convolution.weight.copy_(torch.from_numpy(np.ascontiguousarray(weight)))
        norm.running_mean.zero_()
        norm.running_var.fill_(1.0 - norm.eps)
        norm.bias.copy_(torch.from_numpy(np.ascontiguousarray(bias)))
    for k, layers in enumerate(zip(network.sides, network.ends, network.score, strict=True)):
        weight, bias = constants[f"outputs.{k}.weight"].T, constants[f"outputs.{k}.bias"]
        edges = (0, 4 * BINS, 4 * BINS + 4, len(weight))  # the last ones of an earlier network may be fewer classes
        for layer, first, last in zip(layers, edges, edges[1:], strict=False):
            layer.weight[: last - first].copy_(torch.from_numpy(weight[first:last, :, None, None].copy()))
            layer.bias[: last - first].copy_(torch.from_numpy(bias[first:last].copy()))


@torch.no_grad()
def give_norms_their_statistics(network: ConeNet, pictures: list[Tensor]) -> None:
    """Mean and variance of every convolution on these images (1, 3, H, W), and the gain and offset that undo them."""
    sums: dict[str, list[Tensor]] = {name: [] for name in blocks_of(network)}
    hooks = []
    for name, (convolution, *_) in blocks_of(network).items():

        def note(_module: nn.Module, _given: object, answer: Tensor, name: str = name) -> None:
            sums[name].append(torch.stack((answer.mean((0, 2, 3)), answer.square().mean((0, 2, 3)))))

        hooks.append(convolution.register_forward_hook(note))
    network.eval()
    for picture in pictures:
        network(picture)
    for hook in hooks:
        hook.remove()
    for name, (_, norm, _) in blocks_of(network).items():
        mean, square = torch.stack(sums[name]).mean(0)
        variance = (square - mean.square()).clamp(min=1e-6)
        gain = norm.weight / (norm.running_var + norm.eps).sqrt()
        norm.bias.add_(gain * (mean - norm.running_mean))
        norm.weight.copy_(gain * (variance + norm.eps).sqrt())
        norm.running_mean.copy_(mean)
        norm.running_var.copy_(variance)


def restored_network(model: Path, images: Sequence[NDArray[np.uint8]]) -> ConeNet:
    """The network of a model file of this project, to train on. images: (H, W, 3) BGR, like those that it is to learn from.

    Raises ModelFileError for other networks.
    """
    constants = {each.name: numpy_helper.to_array(each) for each in onnx.load(model).graph.initializer}
    network = ConeNet()
    try:
        take_shipped_weights(network, constants)
    except (KeyError, ValueError, RuntimeError) as error:
        raise ModelFileError(
            f"{model}: only the networks that come with conetl, and those trained from them, can be trained on ({error})"
        ) from error
    tensors = [
        torch.from_numpy(cv2.resize(image, (640, 384), interpolation=cv2.INTER_AREA)[..., ::-1].copy())
        .permute(2, 0, 1)[None]
        .float()
        .div(255)
        for image in images
    ]
    before = network.eval()(tensors[0])
    give_norms_their_statistics(network, tensors)
    worst = max(float((a - b).detach().abs().max()) for a, b in zip(before, network(tensors[0]), strict=True))
    if worst > 1e-2:
        raise InputError(
            f"the images have too little in them to train on: batch norms changed the answers by {worst:.2g}"
        )
    return network
