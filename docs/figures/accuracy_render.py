"""The rendered cone of the accuracy study: real detector, matching and intersection on images with drawn camera noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

from conetl.geometry.rig import up_in_left_camera
from conetl.model.params import IngestParams
from conetl.model.rig import Side
from conetl.perception.detections import to_detections
from conetl.perception.detector import Detector, detect_image, load_detector
from conetl.simulation.scene import develop, exposure_gain
from conetl.tracking.matching.matches import match_pair
from conetl.tracking.positions import CameraPosition, locate_in_camera
from docs.figures.paper_rig import RenderedPair, render_pair

Array = NDArray[np.float64]
DRAWS = 100
SAMPLES = 16
SHOWN_CM = 5.0
#: Cone heading and sun, degrees: the cone from eight sides.
SIDES = tuple((heading, sun) for sun in (118.0, -60.0) for heading in (0.0, 17.0, 45.0, 70.0))


@dataclass(frozen=True)
class RenderedErrors:
    """Errors of N draws; draws without a position are counted, not left out of sight."""

    errors_m: Array
    """(N, 3) left camera frame"""
    draws: int


def locate_draws(pair: RenderedPair, detector: Detector, seeds: Sequence[int]) -> RenderedErrors:
    """The pipeline's position of the cone in each draw of the camera noise."""
    gain = exposure_gain(pair.left)
    found = [one for seed in seeds if (one := _locate(pair, gain, detector, np.random.default_rng(seed))) is not None]
    return RenderedErrors(
        np.array([np.subtract(one.xyz_m, pair.foot_m) for one in found]).reshape(-1, 3),
        len(seeds),
    )


def _locate(pair: RenderedPair, gain: float, detector: Detector, rng: np.random.Generator) -> CameraPosition | None:
    params = IngestParams()
    images = (develop(pair.left, gain, rng), develop(pair.right, gain, rng))
    sides: tuple[Side, Side] = ("left", "right")
    boxes = [detect_image(detector, image, score_threshold=params.detection.score_threshold) for image in images]
    left, right = (
        to_detections(box, frame_index=0, side=side, params=params.detection)[0]
        for box, side in zip(boxes, sides, strict=True)
    )
    up = up_in_left_camera(pair.rig)
    matches, _ = match_pair(left, right, pair.rig, params.match, up_left=up, images=images)
    positions, _ = locate_in_camera(matches, pair.rig, params.position)
    near = [p for p in positions if np.linalg.norm(np.subtract(p.xyz_m, pair.foot_m)) < 1.0]
    return max(near, key=lambda p: p.score) if near else None


def study(figure_path: Path) -> str:
    """100 noise draws of the paper's case, and the cone from eight sides; the table, and the figure as a file."""
    detector = load_detector()
    paper = render_pair(samples_per_pixel=SAMPLES)
    errors = locate_draws(paper, detector, range(DRAWS))
    rows = [_row("paper's case, 100 draws", errors)]
    by_side = []
    for number, (heading, sun) in enumerate(SIDES):
        pair = render_pair(
            cone_yaw_rad=float(np.radians(heading)),
            sun_azimuth_deg=sun,
            samples_per_pixel=SAMPLES // 2,
            seed=number + 1,
        )
        by_side.append(locate_draws(pair, detector, range(10)))
        rows.append(_row(f"plate turned by {heading:.0f}°, sun at {sun:.0f}°, 10 draws", by_side[-1]))
    figure, (image, scatter) = plt.subplots(1, 2, figsize=(8.4, 3.6), width_ratios=(0.6, 1), layout="constrained")
    image.imshow(develop(paper.left, exposure_gain(paper.left), np.random.default_rng(0))[::2, ::2, ::-1])
    image.set_title("the cone at 8.53 m,\ncut from 6000 x 4000 pixels", fontsize=9)
    image.axis("off")
    for number, side in enumerate(by_side):
        scatter.plot(
            *(100 * side.errors_m[:, [0, 2]]).T,
            ".",
            color="#56b4e9",
            ms=5,
            label=None if number else "other sides and suns",
        )
    scatter.plot(*(100 * errors.errors_m[:, [0, 2]]).T, ".", color="#d55e00", ms=4, label="100 noise draws")
    scatter.plot(0, 0, "+", color="black", ms=12, label="truth")
    turn = np.linspace(0, 2 * np.pi, 100)
    scatter.plot(np.cos(turn), np.sin(turn), color="black", lw=0.8, label="1 cm")
    scatter.set(xlabel="error to the right (cm)", ylabel="error in depth (cm)")
    scatter.set(xlim=(-SHOWN_CM, SHOWN_CM), ylim=(-SHOWN_CM, SHOWN_CM), aspect="equal")
    everything = np.vstack([errors.errors_m, *(side.errors_m for side in by_side)])
    beyond = int(np.sum(np.abs(100 * everything[:, [0, 2]]).max(axis=1) > SHOWN_CM))
    if beyond:
        scatter.set_title(f"{beyond} of {len(everything)} draws lie beyond the image", fontsize=9)
    scatter.grid(color="#eeeeee")
    scatter.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)
    figure.savefig(figure_path, dpi=80)
    plt.close(figure)
    head = ["", "found", "median 3D, cm", "mean right", "down", "depth"]
    lines = [head, ["---"] + ["---:"] * (len(head) - 1), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def _row(name: str, e: RenderedErrors) -> list[str]:
    if not len(e.errors_m):
        return [name, f"0 of {e.draws}", *["-"] * 4]
    values = (float(np.median(np.linalg.norm(e.errors_m, axis=1))), *e.errors_m.mean(axis=0))
    return [name, f"{len(e.errors_m)} of {e.draws}", *(f"{100 * value:.2f}" for value in values)]
