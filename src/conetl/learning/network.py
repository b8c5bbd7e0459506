"""The detector's network: a small anchor-free YOLO with outputs at strides 4, 8, 16 and 32.

Backbone of C2f blocks (split, bottlenecks, concatenate), a top-down feature pyramid, one decoupled pair of 1x1
output layer per level after a depthwise 3x3. Each side of a box is a distribution over 16 bins (distribution focal loss,
Li et al. 2020), which gives tighter sides than one number; the cone's foot and tip are offsets within that box.
Channels are multiples of 16 for the runtime's kernels.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeGuard

import torch
from torch import Tensor, nn
from torch.nn import functional

from conetl.learning.classes import CLASSES

STRIDES = (4, 8, 16, 32)
BINS = 16


def conv(channels_in: int, channels_out: int, size: int = 3, stride: int = 1) -> nn.Sequential:
    """Convolution, batch norm, ReLU (it costs nothing on a CPU)."""
    return nn.Sequential(
        nn.Conv2d(channels_in, channels_out, size, stride, size // 2, bias=False),
        nn.BatchNorm2d(channels_out, eps=1e-3, momentum=0.03),
        nn.ReLU(inplace=True),
    )


def depthwise(channels: int) -> nn.Sequential:
    """3x3 per channel, then 1x1 (MobileNet): a tenth of a full 3x3, which the fine levels cannot afford."""
    return nn.Sequential(
        nn.Sequential(
            nn.Conv2d(channels, channels, 3, 1, 1, groups=channels, bias=False),
            nn.BatchNorm2d(channels, eps=1e-3, momentum=0.03),
            nn.Identity(),
        ),
        conv(channels, channels, 1),
    )


class Bottleneck(nn.Module):
    """Two 3x3 convolutions with a shortcut."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.first = conv(channels, channels)
        self.second = conv(channels, channels)

    def forward(self, features: Tensor) -> Tensor:
        return features + self.second(self.first(features))


class SplitBlock(nn.Module):
    """C2f: half of the channels pass by, the other half goes through `depth` bottlenecks, all are joined."""

    def __init__(self, channels: int, depth: int) -> None:
        super().__init__()
        self.half = half = channels // 2
        self.enter = conv(channels, channels, 1)
        self.steps = nn.ModuleList(Bottleneck(half) for _ in range(depth))
        self.leave = conv(channels + depth * half, channels, 1)

    def forward(self, features: Tensor) -> Tensor:
        entered = self.enter(features)
        parts = [entered[:, : self.half], entered[:, self.half :]]  # as constants: chunk would be computed at run time
        for step in self.steps:
            parts.append(step(parts[-1]))
        return self.leave(torch.cat(parts, 1))


class PoolPyramid(nn.Module):
    """SPPF: three chained 5x5 max pools, for context beyond the receptive field."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.enter = conv(channels, channels // 2, 1)
        self.leave = conv(channels * 2, channels, 1)

    def forward(self, features: Tensor) -> Tensor:
        parts = [self.enter(features)]
        for _ in range(3):
            parts.append(functional.max_pool2d(parts[-1], 5, 1, 2))
        return self.leave(torch.cat(parts, 1))


def doubled(features: Tensor) -> Tensor:
    """Every cell (B, C, h, w) as two by two (B, C, 2h, 2w), by joining: the runtime's resizing takes several times as long."""
    rows = features.permute(0, 2, 3, 1).unsqueeze(2).unsqueeze(4)
    rows = torch.cat((rows, rows), 4)
    rows = torch.cat((rows, rows), 2)
    return rows.flatten(3, 4).flatten(1, 2).permute(0, 3, 1, 2)


class DetectionNetwork(nn.Module):
    """Image (B, 3, H, W) float in 0..1, RGB, H and W multiples of 32 -> one raw map (B, 4*BINS + 4 + classes, H/s, W/s) a
    stride.

    Channels: BINS logits for each of left, top, right, bottom distance in strides from the cell's centre; the offsets of
    foot x, foot y, tip x, tip y in shares of the box's size from the middle of its lower and upper side (`loss.offsets_of`);
    the logits of CLASSES. `widths`: channels of the features of each stride, which a subclass computes.
    """

    def __init__(self, widths: Sequence[int]) -> None:
        super().__init__()
        self.sides = nn.ModuleList(nn.Conv2d(width, 4 * BINS, 1) for width in widths)
        self.ends = nn.ModuleList(nn.Conv2d(width, 4, 1) for width in widths)
        self.score = nn.ModuleList(nn.Conv2d(width, len(CLASSES), 1) for width in widths)
        for stride, score, side in zip(STRIDES, self.score, self.sides, strict=True):
            assert score.bias is not None and side.bias is not None
            nn.init.constant_(score.bias, math.log(5 / (640 / stride) ** 2))
            nn.init.constant_(side.bias, 1.0)
        for ends in self.ends:
            nn.init.zeros_(ends.weight)

    def features(self, picture: Tensor) -> list[Tensor]:
        """Input of the output layers: (B, C, H/s, W/s) a stride."""
        raise NotImplementedError

    def forward(self, picture: Tensor) -> list[Tensor]:
        return self.outputs(self.features(picture))

    def outputs(self, features: list[Tensor]) -> list[Tensor]:
        """What the output layers say of `features`, a raw map a stride."""
        layers = zip(features, self.sides, self.ends, self.score, strict=True)
        return [torch.cat((sides(shared), ends(shared), score(shared)), 1) for shared, sides, ends, score in layers]


class ConeNet(DetectionNetwork):
    """The network that is shipped: 1.41 million parameters."""

    def __init__(self) -> None:
        widths = (32, 64, 64, 96)
        super().__init__(widths)
        self.stem = conv(3, 16, 3, 2)
        self.stage4 = conv(16, 32, 3, 2)
        self.stage8 = nn.Sequential(conv(32, 64, 3, 2), SplitBlock(64, 2))
        self.stage16 = nn.Sequential(conv(64, 128, 3, 2), SplitBlock(128, 2))
        self.stage32 = nn.Sequential(conv(128, 256, 3, 2), SplitBlock(256, 1), PoolPyramid(256))
        self.down32 = conv(256, 96, 1)
        self.side16, self.top16 = conv(128, 64, 1), conv(96, 64, 1)
        self.side8, self.mix8 = conv(64, 64, 1), SplitBlock(64, 1)
        self.side4, self.top4 = conv(32, 32, 1), conv(64, 32, 1)
        self.mix16 = SplitBlock(64, 1)
        self.heads = nn.ModuleList(depthwise(width) for width in widths)

    def features(self, picture: Tensor) -> list[Tensor]:
        return self.deep_features(*self.shallow_features(picture))

    def shallow_features(self, picture: Tensor) -> tuple[Tensor, Tensor]:
        """Of strides 4 and 8: edges and textures, which are those of all objects."""
        c4 = self.stage4(self.stem(picture))
        return c4, self.stage8(c4)

    def deep_features(self, c4: Tensor, c8: Tensor) -> list[Tensor]:
        """`features` out of the shallow ones."""
        c16 = self.stage16(c8)
        p32 = self.down32(self.stage32(c16))
        p16 = self.mix16(self.side16(c16) + doubled(self.top16(p32)))
        p8 = self.mix8(self.side8(c8) + doubled(p16))
        p4 = self.side4(c4) + doubled(self.top4(p8))
        return [head(features) for head, features in zip(self.heads, (p4, p8, p16, p32), strict=True)]


def has_batch_norm(block: nn.Module) -> TypeGuard[nn.Sequential]:
    """Whether it is a convolution with its batch norm, as `conv` and `depthwise` make them."""
    return isinstance(block, nn.Sequential) and len(block) == 3 and isinstance(block[1], nn.BatchNorm2d)


def fuse_batch_norms(network: nn.Module) -> None:
    """Fold every batch norm into the convolution before it, in place (for export)."""
    for child in network.children():
        if has_batch_norm(child):
            child[0] = torch.nn.utils.fuse_conv_bn_eval(child[0], child[1])
            child[1] = nn.Identity()
        fuse_batch_norms(child)
