"""Labelled images of a make of road object that no training image shows, to try `conetl train` as an operator would.

    python -m training.other_make OUT --backgrounds DIR [DIR ...] --count 60 --seed 1

writes a YOLO folder (images/, labels/, data.yaml) for `conetl labels import`. The make is an inflated dome: teal with
upright white stripes, a black foot, a short handle; its class is `traffic_cone`. It is drawn and lit by this file
alone, onto images without cones, and every folder of backgrounds becomes two recordings.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np

from conetl.learning.classes import CLASSES
from conetl.perception.images import read_image

TALL_PX = 220
TEAL, WHITE, BLACK = (125, 140, 15), (235, 238, 240), (24, 22, 22)


def draw_dome(rng: np.random.Generator) -> np.ndarray:
    """One dome (h, w, 4) BGRA, trimmed."""
    wide = TALL_PX * rng.uniform(0.7, 0.85)
    rows, columns = TALL_PX + 40, round(wide) + 40
    v, u = np.mgrid[0:rows, 0:columns].astype(np.float32)
    up, across = 1 - (v - 20) / TALL_PX, (u + 0.5 - columns / 2) / (wide / 2)
    half = np.where(up < 0.5, 0.82 + 0.36 * up, np.sqrt(np.clip(1 - ((up - 0.5) / 0.5) ** 2, 0, 1)))
    inside = (np.abs(across) <= half) & (up > -0.02 * (1 - across**2)) & (up < 1)
    turn = np.arcsin(np.clip(across / np.maximum(half, 1e-3), -1, 1))
    stripes = ((turn + rng.uniform(0, 1)) / 0.5 % 1.0) < 0.45
    base = np.clip(np.array(TEAL) * rng.uniform(0.75, 1.2) + rng.normal(0, 10, 3), 0, 255)
    canvas = np.zeros((rows, columns, 4), np.float32)
    canvas[..., :3] = np.where(stripes[..., None], np.array(WHITE), base)
    canvas[(up < 0.09), :3] = BLACK
    light = rng.uniform(-0.7, 0.7)
    canvas[..., :3] *= (0.6 + 0.45 * np.clip(np.cos(turn - light), 0, None))[..., None]
    canvas[..., 3] = 255.0 * inside
    cv2.rectangle(canvas, (columns // 2 - 12, 8), (columns // 2 + 12, 24), (*BLACK, 255.0), 5)  # handle
    canvas[..., :3] *= cv2.resize(rng.normal(1, 0.06, (9, 9)).astype(np.float32), (columns, rows))[..., None]
    solid = np.nonzero(canvas[..., 3])
    trimmed = canvas[solid[0].min() : solid[0].max() + 1, solid[1].min() : solid[1].max() + 1]
    return np.clip(trimmed, 0, 255).astype(np.uint8)


def place(scene: np.ndarray, rng: np.random.Generator, taken: list[np.ndarray]) -> np.ndarray | None:
    """Draw one onto an image; its box [x0, y0, x1, y1], or None where another stands."""
    rows, columns = scene.shape[:2]
    height = float(np.exp(rng.uniform(np.log(0.035), np.log(0.24)))) * rows
    drawn = draw_dome(rng)
    scale = height / len(drawn)
    drawn = cv2.resize(drawn, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    high, wide = drawn.shape[:2]
    foot = rows * (0.5 + 1.5 * height / rows * rng.uniform(0.7, 1.3))  # the nearer, the lower
    x, y = int(rng.uniform(0, columns - wide)), int(min(foot, rows) - high)
    box = np.array((x, y, x + wide, y + high), float)
    if any((np.minimum(box[2:], other[2:]) > np.maximum(box[:2], other[:2])).all() for other in taken):
        return None
    around = scene[y : y + high, x : x + wide].astype(np.float32)
    day = np.clip(around.mean() / 110, 0.45, 1.15) * rng.uniform(0.85, 1.15)
    alpha = cv2.GaussianBlur(drawn[..., 3:].astype(np.float32) / 255, (0, 0), 0.6)[..., None]
    shadow = scene[y + high - max(high // 10, 1) : y + high + max(high // 14, 1), x : x + round(1.3 * wide)]
    shadow[:] = (shadow * rng.uniform(0.55, 0.85)).astype(np.uint8)
    around = scene[y : y + high, x : x + wide].astype(np.float32)
    mixed = alpha * drawn[..., :3] * day + (1 - alpha) * around
    noise = rng.normal(0, 2.5, mixed.shape)
    scene[y : y + high, x : x + wide] = np.clip(cv2.GaussianBlur(mixed, (0, 0), 0.5) + noise, 0, 255).astype(np.uint8)
    return box


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--backgrounds", type=Path, nargs="+", required=True, help="folders of images without cones")
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    rng = np.random.default_rng(args.seed)
    for name in ("images", "labels"):
        (args.out / name).mkdir(parents=True, exist_ok=True)
    folders = [sorted(p for p in folder.iterdir() if p.suffix in (".jpg", ".png")) for folder in args.backgrounds]
    halves = [part for paths in folders for part in (paths[: len(paths) // 2], paths[len(paths) // 2 :])]
    for number in range(args.count):
        drive, nth = number % len(halves), number // len(halves)
        scene = read_image(halves[drive][nth * len(halves[drive]) * len(halves) // args.count])
        boxes: list[np.ndarray] = []
        for _ in range(int(rng.integers(2, 6))):
            box = place(scene, rng, boxes)
            boxes += [] if box is None else [box]
        name = f"drive{drive + 1}_{nth:04d}"
        cv2.imwrite(str(args.out / "images" / f"{name}.jpg"), scene, [cv2.IMWRITE_JPEG_QUALITY, 92])
        size = np.tile(scene.shape[1::-1], 2)
        rows = [np.concatenate(((box[:2] + box[2:]) / 2, box[2:] - box[:2])) / size for box in boxes]
        lines = [f"0 {' '.join(f'{value:.6f}' for value in row)}\n" for row in rows]
        (args.out / "labels" / f"{name}.txt").write_text("".join(lines))
    (args.out / "data.yaml").write_text(f"train: images\nval: images\nnames:\n  0: {CLASSES[0]}\n")
    print(f"{args.out}: {args.count} images of {len(halves)} recordings")


if __name__ == "__main__":
    main()
