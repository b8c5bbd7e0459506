"""Which cell answers for which object (task-aligned assignment, Feng et al. 2021) and the three losses.

Boxes are [x0, y0, x1, y1] in pixels. `points` (A, 2) are the cells' centres in pixels, `strides` (A,).
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from conetl.learning.classes import ALL_CLASSES, CLASSES
from conetl.learning.network import BINS, STRIDES

CANDIDATES = 9


def flatten_maps(maps: list[Tensor]) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Raw maps -> side logits (B, A, 4, BINS), ends (B, A, 4), score logits (B, A, classes), points (A, 2) px, strides (A,)."""
    sides, ends, scores, points, strides = [], [], [], [], []
    for stride, raw in zip(STRIDES, maps, strict=True):
        batch, _, height, width = raw.shape
        flat = raw.float().permute(0, 2, 3, 1).reshape(batch, height * width, -1)
        sides.append(flat[..., : 4 * BINS].reshape(batch, -1, 4, BINS))
        ends.append(flat[..., 4 * BINS : 4 * BINS + 4])
        scores.append(flat[..., 4 * BINS + 4 :])
        y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
        points.append(torch.stack((x.reshape(-1), y.reshape(-1)), 1).to(raw.device).float().add(0.5).mul(stride))
        strides.append(torch.full((height * width,), float(stride), device=raw.device))
    return torch.cat(sides, 1), torch.cat(ends, 1), torch.cat(scores, 1), torch.cat(points), torch.cat(strides)


def offsets_of(ends: Tensor, boxes: Tensor) -> Tensor:
    """Foot and tip (..., 4) [foot x, foot y, tip x, tip y] px in boxes (..., 4) -> offsets (..., 4) in shares of the box.

    The foot counts from the middle of the lower side upwards, the tip from the middle of the upper side downwards.
    """
    width, height = (boxes[..., 2] - boxes[..., 0]).clamp(min=1.0), (boxes[..., 3] - boxes[..., 1]).clamp(min=1.0)
    middle = (boxes[..., 0] + boxes[..., 2]) / 2
    return torch.stack(
        (
            (ends[..., 0] - middle) / width,
            (boxes[..., 3] - ends[..., 1]) / height,
            (ends[..., 2] - middle) / width,
            (ends[..., 3] - boxes[..., 1]) / height,
        ),
        -1,
    )


def boxes_from_sides(side_logits: Tensor, points: Tensor, strides: Tensor) -> Tensor:
    """Expected distance of each side -> boxes (..., 4) px."""
    bins = torch.arange(BINS, device=side_logits.device, dtype=side_logits.dtype)
    distance = side_logits.softmax(-1) @ bins * strides[:, None]
    return torch.cat((points - distance[..., :2], points + distance[..., 2:]), -1)


def overlap(a: Tensor, b: Tensor, complete: bool = False) -> Tensor:
    """IoU, or CIoU (Zheng et al. 2020), of boxes that broadcast."""
    low, high = torch.maximum(a[..., :2], b[..., :2]), torch.minimum(a[..., 2:], b[..., 2:])
    inner = (high - low).clamp(min=0).prod(-1)
    size_a, size_b = a[..., 2:] - a[..., :2], b[..., 2:] - b[..., :2]
    iou = inner / (size_a.clamp(min=0).prod(-1) + size_b.clamp(min=0).prod(-1) - inner + 1e-7)
    if not complete:
        return iou
    hull = torch.maximum(a[..., 2:], b[..., 2:]) - torch.minimum(a[..., :2], b[..., :2])
    gap = (a[..., :2] + a[..., 2:] - b[..., :2] - b[..., 2:]).square().sum(-1) / 4
    aspect = (
        4
        / torch.pi**2
        * (
            torch.atan(size_b[..., 0] / (size_b[..., 1] + 1e-7)) - torch.atan(size_a[..., 0] / (size_a[..., 1] + 1e-7))
        ).square()
    )
    with torch.no_grad():
        weight = aspect / (1 - iou + aspect + 1e-7)
    return iou - gap / (hull.square().sum(-1) + 1e-7) - weight * aspect


@torch.no_grad()
def assign(
    scores: Tensor, boxes: Tensor, points: Tensor, strides: Tensor, truth: Tensor, classes: Tensor, there: Tensor
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """The cells that answer for an object: image (P,), cell (P,), truth index (P,) and target score (P,).

    Scores (B, A, classes), boxes (B, A, 4), truth (B, G, 4) of classes (B, G), of which `there` (B, G) are no padding.
    """
    iou = overlap(truth[:, :, None], boxes[:, None])
    # A small object may hold no cell centre: let it grow to two strides for the question "inside?".
    centre, half = (truth[..., :2] + truth[..., 2:]) / 2, (truth[..., 2:] - truth[..., :2]) / 2
    half = torch.maximum(half[:, :, None], strides[:, None] * 0.75)
    inside = ((points - centre[:, :, None]).abs() < half).all(-1)
    reachable = (truth[..., 2:] - truth[..., :2]).amax(-1, keepdim=True) < strides * (BINS - 1) * 1.3
    allowed = inside & reachable & there[..., None]
    of_class = scores.sigmoid().sqrt().transpose(1, 2).gather(1, classes[..., None].expand(-1, -1, len(points)))
    align = of_class * iou.clamp(min=0) ** 6 * allowed
    # Ties of nothing (early in training all IoUs are near 0): prefer cells near the centre.
    align = align + 1e-9 / (1 + (points - centre[:, :, None]).norm(dim=-1) / strides) * allowed
    top = align.topk(min(CANDIDATES, align.shape[2]), 2)
    chosen = torch.zeros_like(align).scatter_(2, top.indices, (top.values > 0).float())
    owner_align = align * chosen
    best, owners = owner_align.max(1)
    image, cell = torch.nonzero(best > 0, as_tuple=True)
    owner = owners[image, cell]
    peak_align, peak_iou = owner_align.amax(2), (iou * chosen).amax(2)
    target = align[image, owner, cell] / (peak_align[image, owner] + 1e-12) * peak_iou[image, owner]
    return image, cell, owner, target


def taught_weights(fades: Tensor, points: Tensor, strides: Tensor) -> Tensor:
    """Weights (B, A, classes) of the score's loss: 0 where a class is neither taught nor forbidden, else 1."""
    corners = fades[:, :, None, :4]
    inside = ((points >= corners[..., :2]) & (points <= corners[..., 2:])).all(-1)
    # Of places where something may stand only fine cells fade: far things are small, large boxes stay forbidden.
    inside &= (strides <= 16) | (fades[..., 4:] != ALL_CLASSES)
    faded = (fades[..., 4:].long() >> torch.arange(len(CLASSES), device=fades.device)) & 1  # (B, M, classes)
    return (inside.float().transpose(1, 2) @ faded.float() == 0).float()


def detection_loss(
    maps: list[Tensor], truths: Tensor, trusts: Tensor, fades: Tensor, taught: Tensor | None = None
) -> tuple[Tensor, dict[str, Tensor]]:
    """Sum of score (BCE against IoU-scaled targets), box (CIoU), side (DFL) and end (smooth L1) losses for a batch.

    truths: (B, G, 9) box, foot and tip (NaN where not known) and class; class -1 pads. trusts: (B, G). fades: (B, M, 5) box and
    the sum of 2**class of those classes that are neither taught nor forbidden in it; 0 pads. taught: weights (B, A, classes) of
    what is taught instead of all that no fade covers.
    """
    side_logits, end_offsets, score_logits, points, strides = flatten_maps(maps)
    with torch.no_grad():  # only the assigned cells' boxes are differentiated, below
        boxes = boxes_from_sides(side_logits, points, strides)
        there, classes = truths[..., 8] >= 0, truths[..., 8].clamp(min=0).long()
        weights = taught_weights(fades, points, strides) if taught is None else taught.clone()
    image, cell, owner, target = assign(score_logits.detach(), boxes, points, strides, truths[..., :4], classes, there)
    targets = torch.zeros_like(score_logits)
    targets[image, cell, classes[image, owner]] = target
    weights[image, cell] = 1.0
    truth, ends, amount = truths[image, owner, :4], truths[image, owner, 4:8], target * trusts[image, owner]
    logits, at, stride = side_logits[image, cell], points[cell], strides[cell]
    box_loss = ((1 - overlap(boxes_from_sides(logits, at, stride), truth, complete=True)) * amount).sum()
    wanted = torch.cat((at - truth[:, :2], truth[:, 2:] - at), 1) / stride[:, None]
    wanted = wanted.clamp(0, BINS - 1.01)
    lower = wanted.long()
    share = wanted - lower
    log = functional.log_softmax(logits, -1)
    cost = -(
        log.gather(-1, lower[..., None]).squeeze(-1) * (1 - share)
        + log.gather(-1, (lower + 1)[..., None]).squeeze(-1) * share
    )
    side_loss = (cost.mean(1) * amount).sum()
    offsets = offsets_of(ends, truth)
    known = torch.isfinite(offsets).all(1)
    # a cone cut by the image's edge has its ends far outside its box
    offsets = torch.where(known[:, None], offsets, 0.0).clamp(-0.6, 0.9)
    apart = functional.smooth_l1_loss(end_offsets[image, cell], offsets, reduction="none", beta=0.03)
    end_loss = (apart.mean(1) * target * known).sum()
    total = targets.sum().clamp(min=4.0)
    raw = functional.binary_cross_entropy_with_logits(score_logits, targets, reduction="none")
    score_loss = (raw * weights).sum() / total
    box_loss, side_loss, end_loss = box_loss / total, side_loss / total, end_loss / total
    losses = {"score": score_loss, "box": box_loss, "side": side_loss, "end": end_loss}
    total_loss = 0.7 * score_loss + 7.5 * box_loss + 1.5 * side_loss + 6.0 * end_loss
    return total_loss, {name: loss.detach() for name, loss in losses.items()}


def distillation_loss(taught: list[Tensor], teaching: list[Tensor], weights: Tensor | None = None) -> Tensor:
    """How far the scores of one network are from those of another, which gets no gradient.

    Binary cross entropy of all cells and classes, less its least value, over the amount that the other network sees. weights: of
    cells and classes (B, A, classes); None: all alike.
    """
    scores = flatten_maps(taught)[2]
    with torch.no_grad():
        wanted = flatten_maps(teaching)[2].sigmoid()
        amount = wanted.amax(-1)
        total = (amount * (amount > 0.1)).sum().clamp(min=4.0)
        least = functional.binary_cross_entropy(wanted, wanted, weights, reduction="sum")
    return 0.7 * (functional.binary_cross_entropy_with_logits(scores, wanted, weights, reduction="sum") - least) / total
