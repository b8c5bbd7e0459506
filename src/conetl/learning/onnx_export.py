"""A network as ONNX, checked: the runtime gives what PyTorch gave.

The exported network takes images of one size as they lie in memory, (P, H, W, 3) BGR 0 to 255: what would have to be done to
them before is folded into the first convolution.
"""

from __future__ import annotations

import copy
import warnings
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import torch
from torch import Tensor, nn
from torch.nn import functional

from conetl.learning.classes import CLASSES
from conetl.learning.network import STRIDES, ConeNet, fuse_batch_norms
from conetl.model.errors import ModelFileError

#: Cells a stride whose boxes are computed: more than the cones of any image cover.
BEST_CELLS = (512, 256, 128, 64)


class PackedStem(nn.Module):
    """The network's first convolution for images as they lie in memory: (P, H, W, 3) BGR 0 to 255 -> what `ConeNet.stem` gives.

    Four pixels side by side are taken as one of 12 channels, and two output columns as one of twice the channels: the numbers
    stay where they are, and an 8-bit convolution is kept busy, which it is not by three channels. Of the columns 4j - 1 to 4j + 3
    that the outputs 2j and 2j + 1 see, the first is the last quarter of column j - 1, the others are column j.
    """

    def __init__(self, stem: nn.Sequential) -> None:
        super().__init__()
        first = stem[0]
        assert isinstance(first, nn.Conv2d) and first.bias is not None
        self.channels = first.out_channels
        weight = first.weight.detach().flip(1) / 255.0  # RGB 0..1 -> BGR 0..255
        packed = torch.zeros(2, self.channels, 4, 3, 3, 2)  # output column, its channel; pixel, its colour; row, column
        for output in range(2):
            for tap in range(3):
                column, pixel = divmod(4 + 2 * output + tap - 1, 4)
                packed[output, :, pixel, :, :, column] = weight[..., tap]
        self.conv = nn.Conv2d(12, 2 * self.channels, (3, 2), (2, 1))
        self.conv.weight = nn.Parameter(packed.reshape(2 * self.channels, 12, 3, 2))
        self.conv.bias = nn.Parameter(first.bias.detach().repeat(2))
        self.relu = nn.ReLU()

    def forward(self, picture: Tensor) -> Tensor:
        packed = picture.reshape(*picture.shape[:2], -1, 12).permute(0, 3, 1, 2)
        pairs = self.relu(self.conv(functional.pad(packed, (1, 0, 1, 0)))).permute(0, 2, 3, 1)
        return pairs.reshape(*pairs.shape[:2], -1, self.channels).permute(0, 3, 1, 2)


class CellOutputs(nn.Module):
    """The output layers of one stride, for the cells of the highest scores only: all of them would cost an eighth of the whole.

    Features (P, C, h, w) -> the cells' values (K, 4*BINS + 4 + classes) as in `ConeNet`, and their places (K,) in the row-major
    maps of the images, one after the other: the cells are the best of all images together. They are chosen by a score that
    may be rounded to 8 bits; the scores given are not.
    """

    def __init__(self, sides: nn.Module, ends: nn.Module, score: nn.Module, count: int) -> None:
        super().__init__()
        self.score, self.count = score, count
        self.register_buffer(
            "weight", torch.cat((sides.weight, ends.weight, score.weight)).detach().flatten(1).T.contiguous()
        )
        self.register_buffer("bias", torch.cat((sides.bias, ends.bias, score.bias)).detach())

    def forward(self, features: Tensor) -> tuple[Tensor, Tensor]:
        logits = self.score(features).amax(1).reshape(1, -1)
        # A number of cells that depends on the image's size has to be a tensor, or tracing would freeze it.
        available = torch._shape_as_tensor(logits)[1]
        _, cells = logits.topk(torch.minimum(torch.tensor(self.count), available), 1)
        chosen = features.permute(0, 2, 3, 1).reshape(-1, len(self.weight)).index_select(0, cells[0])
        return chosen @ self.weight + self.bias, cells[0]


class BestCells(nn.Module):
    """The network as conetl runs it: images (P, H, W, 3) -> values and places of `CellOutputs`, stride by stride."""

    def __init__(self, network: ConeNet) -> None:
        super().__init__()
        self.network = copy.deepcopy(network)
        self.network.stem = PackedStem(network.stem)
        layers = zip(network.sides, network.ends, network.score, BEST_CELLS, strict=True)
        self.outputs = nn.ModuleList(CellOutputs(*layer) for layer in layers)

    def forward(self, picture: Tensor) -> tuple[Tensor, ...]:
        features = self.network.features(picture)
        pairs = [output(shared) for output, shared in zip(self.outputs, features, strict=True)]
        return tuple(tensor for pair in pairs for tensor in pair)


def export_network(network: ConeNet, path: Path) -> float:
    """Write a network as float32 ONNX. Returns the largest difference of its answers. Raises ModelFileError."""
    network = copy.deepcopy(network).cpu().eval()
    fuse_batch_norms(network)
    names = [name for stride in STRIDES for name in (f"stride{stride}", f"stride{stride}_cells")]
    axes = {"picture": {0: "pictures", 1: "height", 2: "width"}} | {name: {0: f"{name}_count"} for name in names}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of tracing, and of the older exporter, which this network needs
        torch.onnx.export(
            BestCells(network), (torch.rand(1, 96, 160, 3),), str(path), input_names=["picture"], output_names=names,
            dynamic_axes=axes, opset_version=17, dynamo=False,
        )  # fmt: skip
    model = onnx.load(path)
    onnx.helper.set_model_props(model, {"names": str(dict(enumerate(CLASSES)))})  # as Ultralytics writes them
    onnx.save(model, path)
    picture = 255 * torch.rand(2, 288, 416, 3)  # more images than the one that was traced, and of another size
    with torch.no_grad():
        maps = network(picture.flip(3).permute(0, 3, 1, 2) / 255.0)
    given = onnxruntime.InferenceSession(str(path)).run(None, {"picture": picture.numpy()})
    worst = 0.0
    for values, cells, expected in zip(given[::2], given[1::2], maps, strict=True):
        in_order = expected.permute(0, 2, 3, 1).reshape(-1, expected.shape[1])
        worst = max(worst, float(np.abs(values - in_order[torch.from_numpy(cells)].numpy()).max()))
    if worst > 1e-2:
        raise ModelFileError(f"{path}: the exported network differs from the trained one by {worst}")
    return worst
