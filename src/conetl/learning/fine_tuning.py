"""Teach a trained network an operator's own images without forgetting what it knows.

Samples are made of the own images, with drawn cones and other objects pasted on them (the replay set). Labels decide on their
objects, and where the network as it was sees something that is not there. Everywhere else, and on drawn objects, that network
decides (learning without forgetting, Li & Hoiem 2016), so that its scores stay what they were. Batch norms keep their statistics
and the shallow layers their weights, since a few streets are not all streets; that also saves half of the time.
"""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Callable, Iterator, Sequence

import cv2
import numpy as np
import torch
from torch import Tensor
from torch.nn import functional
from torch.utils.data import DataLoader, IterableDataset, get_worker_info

from conetl.learning.augment import Layered, make_sample, pyramid
from conetl.learning.images import LabelledImage
from conetl.learning.learner import Learner, collate
from conetl.learning.loss import detection_loss, distillation_loss, flatten_maps, taught_weights
from conetl.learning.network import ConeNet
from conetl.learning.replay import draw_more, drawn_cut_outs

SIZE_PX = 288
BATCH = 8
RATE = 5e-4
#: Weight of what the network knew, and the score from which it is wrong where nothing is.
MEMORY, FALSE_SCORE = 6.0, 0.25
#: Share of the weights as they were in the mean that is returned (WiSE-FT, Wortsman et al. 2022): less is forgotten.
KEPT = 0.3
#: Boxes of lower scores may change their shapes.
SEEN_SCORE = 0.1
WARM_STEPS = 50
#: Drawn things, half of them cones, at the beginning and at most; one takes 0.1 s. Those for measuring have another seed.
FIRST_DRAWN, MOST_DRAWN = 56, 1200
#: One batch in six holds half as many samples of this times the side, in which large objects are whole.
LARGE = 1.45


class SampleBatches(IterableDataset):
    """An endless stream of batches out of the own images with drawn things on them."""

    def __init__(self, images: Sequence[LabelledImage], seed: int) -> None:
        self.layered: list[Layered] = [(image, pyramid(image.image)) for image in images]
        self.with_objects = [pair for pair in self.layered if len(pair[0].boxes) or len(pair[0].false)] or self.layered
        self.seed = seed

    def __iter__(self) -> Iterator[tuple[Tensor, ...]]:
        cv2.setNumThreads(0)
        info = get_worker_info()
        number = info.id if info else 0
        rng, cut_outs = np.random.default_rng((self.seed, number)), drawn_cut_outs(self.seed + number, FIRST_DRAWN)

        def pick(rng: np.random.Generator) -> Layered:
            return self.with_objects[int(rng.integers(len(self.with_objects)))]

        count = 0
        while True:
            large = count % 6 == 5
            batch, size = (BATCH // 2, round(LARGE * SIZE_PX / 32) * 32) if large else (BATCH, SIZE_PX)
            samples = [make_sample(pick, self.layered, cut_outs, size, rng, large) for _ in range(batch)]
            yield collate(samples)
            count += 1
            if FIRST_DRAWN + 2 * count <= MOST_DRAWN:
                draw_more(cut_outs, rng)


def fine_tune(
    network: ConeNet,
    images: Sequence[LabelledImage],
    *,
    minutes: float,
    threads: int,
    seed: int = 1,
    progress: Callable[[float, str], None] = lambda share, losses: None,
) -> ConeNet:
    """The network after so many minutes of training, as a mean with what it was; on a GPU where PyTorch finds one.

    progress: is given the share of the time that is over, and the mean losses of the last steps.
    """
    torch.manual_seed(seed)
    torch.set_num_threads(threads)
    device = "cuda" if torch.cuda.is_available() else "cpu"
    before: ConeNet = copy.deepcopy(network).to(device, memory_format=torch.channels_last).eval()
    learner = Learner(network.to(device, memory_format=torch.channels_last), RATE)
    learner.network.eval()
    for part in (network.stem, network.stage4, network.stage8):
        part.requires_grad_(False)
    workers = 1 if device == "cpu" else 8
    batches = DataLoader(SampleBatches(images, seed), batch_size=None, num_workers=workers, prefetch_factor=6)
    loader, started, step, sums = iter(batches), time.monotonic(), 0, dict[str, float]()
    while (share := (time.monotonic() - started) / (60 * minutes)) < 1:
        rate = RATE * min(1.0, (step + 1) / WARM_STEPS) * (0.02 + 0.98 * 0.5 * (1 + math.cos(math.pi * share)))
        pictures, objects, trusts, fades = (part.to(device) for part in next(loader))
        pictures = pictures.permute(0, 3, 1, 2).flip(1).float() / 255  # RGB, channels last in memory
        with torch.no_grad():
            shallow = network.shallow_features(pictures)
            knew = before.outputs(before.deep_features(*shallow))
            taught, remembered = who_decides(knew, objects, trusts, fades)
        maps = network.outputs(network.deep_features(*shallow))
        loss, losses = detection_loss(maps, objects, trusts, fades, taught)
        losses["memory"] = MEMORY * distillation_loss(maps, knew, remembered)
        losses["shapes"] = shape_memory(maps, knew, remembered)
        learner.learn(loss + losses["memory"] + losses["shapes"], rate, step)
        step += 1
        for name, value in losses.items():
            sums[name] = sums.get(name, 0.0) + float(value.detach())
        if step % 20 == 0:
            progress(share, f"step {step}: " + ", ".join(f"{name} {value / 20:.3f}" for name, value in sums.items()))
            sums = {}
    old, new = before.cpu().state_dict(), learner.average.cpu().state_dict()
    before.load_state_dict(
        {name: torch.lerp(new[name], old[name], KEPT) if old[name].is_floating_point() else old[name] for name in old}
    )
    return before


def who_decides(knew: list[Tensor], truths: Tensor, trusts: Tensor, fades: Tensor) -> tuple[Tensor, Tensor]:
    """Weights (B, A, classes) of the scores: where labels decide, and where the network as it was does.

    knew: its maps. truths, trusts, fades: as in `detection_loss`; drawn objects alone are trusted wholly.
    """
    _, _, scores, points, strides = flatten_maps(knew)

    def within(boxes: Tensor, wanted: Tensor) -> Tensor:
        """(B, A, 1) whether a cell's centre lies in one of the wanted (B, G) boxes (B, G, 4)."""
        corners = torch.where(wanted[..., None], boxes, -1.0)[:, :, None]
        return ((points >= corners[..., :2]) & (points <= corners[..., 2:])).all(-1).any(1)[..., None]

    there, boxes = truths[..., 8] >= 0, truths[..., :4]
    on_own, on_drawn = within(boxes, there & (trusts < 1)), within(boxes, there & (trusts >= 1))
    is_false = scores.sigmoid() > FALSE_SCORE
    labels = (taught_weights(fades, points, strides) > 0) & (on_own | on_drawn | is_false)
    return labels.float(), ((~labels | on_drawn) & ~on_own).float()


def shape_memory(maps: list[Tensor], knew: list[Tensor], remembered: Tensor) -> Tensor:
    """How far the sides of boxes are from those that the network gave before, where it decides and saw something."""
    sides, known = flatten_maps(maps)[0], flatten_maps(knew)
    seen = (known[2].sigmoid() * remembered).amax(-1) > SEEN_SCORE
    old, new = (functional.log_softmax(each[seen], -1) for each in (known[0], sides))
    return (old.exp() * (old - new)).sum(-1).sum() / (4 * seen.sum().clamp(min=4))
