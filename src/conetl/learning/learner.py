"""A network that learns: batches, its optimiser, and the moving average of its weights."""

from __future__ import annotations

import copy
import math
from typing import Any

import numpy as np
import torch
import torch.distributed as dist
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from conetl.learning.augment import Sample
from conetl.learning.network import DetectionNetwork


def collate(batch: list[Sample]) -> tuple[Tensor, ...]:
    """Images (B, size, size, 3) uint8 BGR, objects (B, G, 9), trusts (B, G), fades (B, M, 5), padded (`loss.detection_loss`)."""
    images = np.stack([sample[0] for sample in batch])
    objects, trusts, fades = ([torch.from_numpy(sample[k]).float() for sample in batch] for k in (1, 2, 3))
    return (
        torch.from_numpy(images),
        pad_sequence(objects, batch_first=True, padding_value=-1.0),
        pad_sequence(trusts, batch_first=True),
        pad_sequence(fades, batch_first=True),
    )


class Learner:
    """A network with its optimiser, and the moving average of its weights, which is what is exported."""

    def __init__(self, network: DetectionNetwork, rate: float) -> None:
        self.network, self.average = network, copy.deepcopy(network).eval()
        groups: dict[tuple[float, float], list[torch.nn.Parameter]] = {}
        for name, weights in network.named_parameters():
            decay = 0.02 if weights.ndim > 1 else 0.0  # biases and norms are not decayed
            share = 0.25 if name.startswith("backbone.") else 1.0  # what has seen ImageNet is to keep what it knows
            groups.setdefault((decay, share), []).append(weights)
        settings = [{"params": each, "weight_decay": decay, "share": share} for (decay, share), each in groups.items()]
        self.optimiser = torch.optim.AdamW(settings, lr=rate, betas=(0.9, 0.99))

    def learn(self, loss: Tensor, rate: float, step: int) -> None:
        """One step down the gradient of `loss`."""
        for group in self.optimiser.param_groups:
            group["lr"] = rate * group["share"]
        self.optimiser.zero_grad()
        loss.backward()
        share_gradients(self.network)
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), 10.0)
        self.optimiser.step()
        decay = 0.9988 * (1 - math.exp(-(step + 1) / 500))
        states = zip(self.average.state_dict().values(), self.network.state_dict().values(), strict=True)
        pairs = [(kept, value) for kept, value in states if kept.dtype.is_floating_point]
        with torch.no_grad():
            torch._foreach_lerp_([kept for kept, _ in pairs], [value for _, value in pairs], 1 - decay)

    def state(self) -> dict[str, dict[str, Any]]:
        return {
            "network": self.network.state_dict(),
            "average": self.average.state_dict(),
            "optimiser": self.optimiser.state_dict(),
        }

    def take(self, kept: dict[str, Any]) -> None:
        """Take all of a `state`."""
        self.network.load_state_dict(kept["network"])
        self.average.load_state_dict(kept["average"])
        self.optimiser.load_state_dict(kept["optimiser"])


def share_gradients(network: DetectionNetwork) -> None:
    """The mean of the gradients of all processes, in place, where there are several."""
    if not dist.is_initialized():
        return
    gradients = [weight.grad for weight in network.parameters() if weight.grad is not None]
    together = torch.cat([gradient.flatten() for gradient in gradients])
    dist.all_reduce(together)
    together /= dist.get_world_size()
    parts = together.split([gradient.numel() for gradient in gradients])
    for gradient, part in zip(gradients, parts, strict=True):
        gradient.copy_(part.view_as(gradient))
