"""Train the detector for a given number of minutes, whatever the machine.

    python -m training.train --cones DIR --clips DIR --renders DIR --minutes 75 --out RUN

Writes RUN/last.pt every two minutes (weights, their moving average, optimiser, step) and RUN/log.txt. `--resume RUN/last.pt`
goes on from there. Renders that appear in DIR while it trains are taken in as they come.

Two processes of one thread each get more done than one of two:
`torchrun --nproc-per-node 2 -m training.train --threads 1 ...`; each then has batches of its own.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import os
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import torch
import torch.distributed as dist
from torch import Tensor
from torch.utils.data import DataLoader, IterableDataset

from conetl.learning.augment import Layered, make_sample, pyramid
from conetl.learning.drawing.cones import draw_cone
from conetl.learning.drawing.objects import DRAW, draw_object
from conetl.learning.learner import Learner, collate
from conetl.learning.loss import detection_loss, distillation_loss
from conetl.learning.network import ConeNet, DetectionNetwork
from training.dataset import cut_out_cones, read_cones, read_labelled_clips, read_more_cones, read_renders
from training.teacher import Teacher, trained_teacher

SHARES = {
    "rf_traffic_cones": 0.17,
    "fs_onboard": 0.23,
    "css_safety_cone": 0.05,
    "css_rest": 0.06,
    "labelled_clips": 0.30,
    "frc_conesandcubes": 0.07,
    "robomagellan_conefinder": 0.02,
    "renders": 0.22,
    "false_boxes": 0.15,
}
LARGE = 1.45
#: Names of the networks in logs and checkpoints.
SHIPPED, TEACHER = "small", "teacher"
LABELS = Path(__file__).parent / "labels"
#: Sources of images without cones that others are drawn on.
BACKGROUNDS = ("css_safety_cone", "highway_tidar_negatives", "otonom_sign_negatives", "labelled_clips")


class Batches(IterableDataset):
    """An endless stream of batches of augmented samples; each loader process has its own random numbers.

    One in six holds half as many samples of LARGE times the side, in which large objects are whole.
    """

    def __init__(self, args: argparse.Namespace) -> None:
        self.args = args
        left_out = frozenset(args.leave_out.split(","))
        pictures = [p for p in read_cones(Path(args.cones), "train") if p.source not in left_out]
        false = {}
        if args.unlabelled:
            found = json.loads(Path(args.unlabelled).read_text())
            false = found["false"]
            for picture in pictures:
                fade = np.array(found["unlabelled"][picture.name]).reshape(-1, 4)
                picture.fade = fade if picture.source == "fs_onboard" else np.concatenate((picture.fade, fade))
        if args.more_cones:
            pictures += [p for p in read_more_cones(Path(args.more_cones), left_out) if p.source != "roadwork_clips_us"]
        if args.clips:
            pictures += read_labelled_clips(Path(args.clips), LABELS, left_out)
        cones = cut_out_cones([p for p in pictures if p.source in ("rf_traffic_cones", "frc_conesandcubes")])
        drawn = np.random.default_rng(args.seed)
        self.cutouts = {"traffic_cone": cones + [draw_cone(drawn) for _ in range(1500)]}
        self.cutouts |= {name: [draw_object(drawn, name) for _ in range(300)] for name in DRAW}
        backgrounds = [p for p in pictures if 0 not in p.boxes[:, 8] and p.source in BACKGROUNDS]
        self.backgrounds = [(p, pyramid(p.image)) for p in backgrounds]
        self.by_source = {name: [(p, pyramid(p.image)) for p in pictures if p.source == name] for name in SHARES}
        self.by_source["false_boxes"] = [
            (dataclasses.replace(p, false=np.array(false[p.name])), pyramid(p.image))
            for p in pictures
            if false.get(p.name)
        ]
        print(
            f"{len(pictures)} pictures, {sum(map(len, self.cutouts.values()))} cut-outs, {len(self.backgrounds)} backgrounds",
            flush=True,
        )
        self.look_for_renders()

    def look_for_renders(self) -> None:
        if self.args.renders:
            known = {p.name for p, _ in self.by_source["renders"]}
            new = read_renders(Path(self.args.renders), known)
            self.by_source["renders"] += [(p, pyramid(p.image)) for p in new]

    def __iter__(self) -> Iterator[tuple[Tensor, ...]]:
        cv2.setNumThreads(0)
        info = torch.utils.data.get_worker_info()
        rng = np.random.default_rng((self.args.seed, info.id if info else 0, self.args.start_step, self.args.rank))

        def pick(rng: np.random.Generator) -> Layered:
            names = [name for name in SHARES if self.by_source[name]]
            shares = np.array([SHARES[name] for name in names])
            if "renders" in names:  # a handful of renders is not repeated as often as a thousand
                shares[names.index("renders")] *= min(1.0, len(self.by_source["renders"]) / 120)
            name = names[int(rng.choice(len(names), p=shares / shares.sum()))]
            return self.by_source[name][int(rng.integers(len(self.by_source[name])))]

        for count in range(10**9):
            if count % 25 == 0:
                self.look_for_renders()
            large = count % 6 == 5
            number = self.args.batch // 2 if large else self.args.batch
            size = round(LARGE * self.args.size / 32) * 32 if large else self.args.size
            samples = [make_sample(pick, self.backgrounds, self.cutouts, size, rng, large) for _ in range(number)]
            yield collate(samples)


def maps_of(network: DetectionNetwork, images: Tensor, bf16: bool) -> list[Tensor]:
    """The network's maps; features in 16 bits where asked for, outputs never: sides of boxes need all their bits."""
    with torch.autocast(images.device.type, torch.bfloat16, enabled=bf16):
        features = network.features(images)
    return network.outputs([level.float() for level in features])


def read_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cones", required=True)
    parser.add_argument("--more-cones", default="", help="further labelled sources")
    parser.add_argument("--leave-out", default="", help="sources and clips not to train on, separated by commas")
    parser.add_argument("--clips", default="", help="the work-zone clips, whose labels lie in labels/")
    parser.add_argument("--renders", default="")
    parser.add_argument("--unlabelled", default="", help="what find_unlabelled.py wrote")
    parser.add_argument("--start", default="", help="checkpoint whose weights are taken where their shapes agree")
    parser.add_argument("--out", required=True)
    parser.add_argument("--minutes", type=float, default=75)
    parser.add_argument("--size", type=int, default=352)
    parser.add_argument("--batch", type=int, default=8)
    parser.add_argument("--rate", type=float, default=2e-3)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--workers", type=int, default=1, help="processes that make samples")
    parser.add_argument(
        "--teacher", default="", help="ImageNet weights of the backbone of a larger network to learn from"
    )
    parser.add_argument(
        "--taught-by", default="", help="checkpoint of a run with a teacher, which now teaches and learns no more"
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--bf16", action="store_true", help="16-bit features: faster on processors with AMX and on GPUs"
    )
    parser.add_argument("--resume", default="")
    return parser.parse_args()


def take_weights(network: ConeNet, checkpoint: Path) -> None:
    """Start from an earlier network: every weight of the same name and shape is taken, the others keep their random start."""
    own, earlier = network.state_dict(), torch.load(checkpoint, map_location="cpu", weights_only=True)["average"]
    for name in [name for name in earlier if name in own and earlier[name].ndim == own[name].ndim > 1]:
        missing = torch.zeros_like(own[name][:, earlier[name].shape[1] :])
        # Of a layer that joins more channels now, the new ones count nothing at first.
        if missing.numel() and len(missing) == len(earlier[name]):
            earlier[name] = torch.cat((earlier[name], missing), 1)
    taken = {name: value for name, value in earlier.items() if name in own and own[name].shape == value.shape}
    network.load_state_dict(own | taken)
    print(f"{len(taken)} of {len(own)} tensors taken from {checkpoint.name}", flush=True)


def make_learners(args: argparse.Namespace, device: str) -> dict[str, Learner]:
    """The networks to train, in the order in which each learns from a batch: the teacher, where there is one, goes first."""
    network = ConeNet()
    if args.start:
        take_weights(network, Path(args.start))
    networks: dict[str, DetectionNetwork] = {TEACHER: Teacher(Path(args.teacher))} if args.teacher else {}
    networks[SHIPPED] = network
    return {
        name: Learner(network.to(device, memory_format=torch.channels_last), args.rate)
        for name, network in networks.items()
    }


def go_on(checkpoint: Path, learners: dict[str, Learner], device: str) -> int:
    """Take all of a checkpoint; its step."""
    kept = torch.load(checkpoint, map_location=device, weights_only=True)
    for name, learner in learners.items():
        learner.take(kept if name == SHIPPED else kept[name])
    return int(kept["step"])


def elapsed_share(started: float, minutes: float) -> float:
    """How much of the time to train is over, by the first process's clock where there are several: all stop at the same step."""
    share = torch.tensor((time.monotonic() - started) / (60 * minutes))
    if dist.is_initialized():
        dist.broadcast(share, 0)
    return float(share)


def main() -> None:
    args = read_arguments()
    out = Path(args.out)
    out.mkdir(parents=True, exist_ok=True)
    torch.manual_seed(args.seed)
    torch.set_num_threads(args.threads)
    if dist.is_torchelastic_launched():
        dist.init_process_group("gloo")
        if torch.cuda.is_available():
            torch.cuda.set_device(int(os.environ["LOCAL_RANK"]) % torch.cuda.device_count())
    args.rank = dist.get_rank() if dist.is_initialized() else 0
    device = "cuda" if torch.cuda.is_available() else "cpu"
    learners = make_learners(args, device)
    args.start_step = go_on(Path(args.resume), learners, device) if args.resume else 0
    teacher: DetectionNetwork | None = learners[TEACHER].average if TEACHER in learners else None
    if args.taught_by:
        teacher = trained_teacher(Path(args.taught_by)).to(device, memory_format=torch.channels_last)
    batches = DataLoader(
        Batches(args), batch_size=None, num_workers=args.workers, prefetch_factor=6, pin_memory=device == "cuda"
    )
    loader = iter(batches)

    started = saved = time.monotonic()
    step, sums = args.start_step, dict[str, Tensor]()
    while (share := elapsed_share(started, args.minutes)) < 1:
        warm = min(1.0, (step - args.start_step + 1) / (50 if args.resume else 300))
        rate = args.rate * warm * (0.02 + 0.98 * 0.5 * (1 + math.cos(math.pi * share)))
        images, *truth = (part.to(device, non_blocking=True) for part in next(loader))
        images = images.permute(0, 3, 1, 2).flip(1).float() / 255  # RGB, channels last in memory
        losses: dict[str, Tensor] = {}
        for name, learner in learners.items():
            learner.network.train()
            maps = maps_of(learner.network, images, args.bf16)
            loss, parts = detection_loss(maps, *truth)
            if name == SHIPPED and teacher is not None:
                with torch.no_grad():
                    teaching = maps_of(teacher, images, args.bf16)
                parts["distillation"] = distillation_loss(maps, teaching)
                loss = loss + min(1.0, 4 * share) * parts["distillation"]
            learner.learn(loss, rate, step)
            losses |= {f"{name} {part}": value.detach() for part, value in parts.items()}
        step += 1
        sums = {name: sums.get(name, 0) + value for name, value in losses.items()}
        if step % 100 == 0 and args.rank == 0:
            means = " ".join(f"{name} {float(value) / 100:.3f}" for name, value in sums.items())
            note(out, f"{step} {(time.monotonic() - started) / 60:.1f} min {means}")
            sums = {}
        if time.monotonic() - saved > 120 and args.rank == 0:
            saved = time.monotonic()
            save(out, learners, step)
    if args.rank == 0:
        save(out, learners, step)
    if dist.is_initialized():
        dist.destroy_process_group()


def note(out: Path, line: str) -> None:
    print(line, flush=True)
    with (out / "log.txt").open("a") as log:
        log.write(line + "\n")


def save(out: Path, learners: dict[str, Learner], step: int) -> None:
    part = out / "last.pt.part"
    others = {name: learner.state() for name, learner in learners.items() if name != SHIPPED}
    torch.save(learners[SHIPPED].state() | {"step": step} | others, part)
    part.rename(out / "last.pt")


if __name__ == "__main__":
    main()
