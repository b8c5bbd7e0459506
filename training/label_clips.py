"""Label the work-zone clips by the detector itself, with consistency over time and a person's last word.

    python training/label_clips.py MODEL.onnx --clips DIR --out LABELS.json [--sheet SHEET.png]

One picture alone says little about a weak box; a cone is there in many pictures and moves smoothly through them. Every second
frame is looked at as it is, mirrored and enlarged; boxes of one place are averaged; chains of such places over time that
last, score well and move smoothly are cones (`boxes`), also in the frames between where they were missed. What else got a box
is neither taught nor forbidden (`fades`), except where a person looked at the sheet of chains and saw a thing that is no cone
(`NO_CONES`): that is taught as background.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from scipy.signal import savgol_filter

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "src"))

from conetl.perception.decoding import intersection_over_union
from conetl.perception.detector import Detector, detect_image, load_detector

CLIPS = ("boston", "charlotte")  # the others show no cone: drums and panels (see CLIP_NEGATIVES in dataset.py)
EVERY = 2  # frames; the clips have 30 a second
MAX_GAP = 5  # looks without a box inside a chain
MIN_LOOKS, MIN_MEAN_SCORE, MIN_BEST_SCORE = 8, 0.2, 0.35
WEAK_SCORE = 0.08

#: (clip, frame, x, y): a point inside the box of a chain that a person looked at and that is no cone.
NO_CONES: tuple[tuple[str, int, float, float], ...] = (
    ("boston", 164, 251, 286),  # yellow hydrants and posts
    ("boston", 178, 53, 322),
    ("boston", 186, 87, 331),
    ("charlotte", 182, 148, 240),  # a red hydrant
    ("charlotte", 228, 541, 256),  # writing on a van
    ("charlotte", 172, 36, 199),
    ("charlotte", 470, 45, 326),  # a cone in a mirror
)


@dataclass
class Chain:
    """One thing over time: frame numbers, boxes (N, 4) [x0, y0, x1, y1] px, scores."""

    frames: list[int] = field(default_factory=list)
    boxes: list[np.ndarray] = field(default_factory=list)
    scores: list[float] = field(default_factory=list)

    def expected(self, frame: int) -> np.ndarray:
        """Box at a later frame by constant velocity of the last few looks."""
        if len(self.frames) < 3:
            return self.boxes[-1]
        past = min(len(self.frames), 4)
        step = (self.boxes[-1] - self.boxes[-past]) / (self.frames[-1] - self.frames[-past])
        return self.boxes[-1] + step * (frame - self.frames[-1])

    def is_cone(self) -> bool:
        return (
            len(self.frames) >= MIN_LOOKS
            and float(np.mean(self.scores)) >= MIN_MEAN_SCORE
            and max(self.scores) >= MIN_BEST_SCORE
        )

    def smooth(self) -> tuple[np.ndarray, np.ndarray]:
        """Frames of every look from first to last, and the boxes there: gaps filled, edges smoothed over seven looks."""
        every = np.arange(self.frames[0], self.frames[-1] + 1, EVERY)
        boxes = np.stack([np.interp(every, self.frames, side) for side in np.array(self.boxes).T], 1)
        return every, savgol_filter(boxes, min(7, len(every) - (len(every) + 1) % 2), 2, axis=0)


def look_three_ways(detector: Detector, image: np.ndarray) -> np.ndarray:
    """Boxes of one frame (N, 5) [x0, y0, x1, y1, score]: plain, mirrored, enlarged; those of one place averaged by score."""
    width = image.shape[1]
    larger = cv2.resize(image, None, fx=1.6, fy=1.6, interpolation=cv2.INTER_CUBIC)
    looks = [(image, 1.0, False), (np.ascontiguousarray(image[:, ::-1]), 1.0, True), (larger, 1.6, False)]
    found = []
    for seen, scale, mirrored in looks:
        boxes = detect_image(detector, seen, score_threshold=WEAK_SCORE)[:, :5].copy()
        boxes[:, :4] /= scale
        if mirrored:
            boxes[:, 0] = width - boxes[:, 0] - boxes[:, 2]
        boxes[:, 2:4] += boxes[:, :2]
        found.append(boxes)
    rest = np.concatenate(found)
    rest = rest[np.argsort(-rest[:, 4])]
    fused = []
    while len(rest):
        same = intersection_over_union(rest[0, :4], rest[:, :4]) > 0.5
        group = rest[same]
        box = np.average(group[:, :4], axis=0, weights=group[:, 4])
        fused.append((*box, group[:, 4].sum() / len(looks)))  # a box in one look of three counts a third
        rest = rest[~same]
    return np.array(fused).reshape(-1, 5)


def follow(looks: dict[int, np.ndarray]) -> list[Chain]:
    """Chains of boxes over time: nearest expected box of like height, best pairs first."""
    alive: list[Chain] = []
    ended: list[Chain] = []
    for frame, boxes in looks.items():
        ended += [c for c in alive if frame - c.frames[-1] > MAX_GAP * EVERY]
        alive = [c for c in alive if frame - c.frames[-1] <= MAX_GAP * EVERY]
        pairs = []
        for k, chain in enumerate(alive):
            expected = chain.expected(frame)
            height = max(expected[3] - expected[1], 4.0)
            for j, box in enumerate(boxes):
                apart = np.abs(box[:2] + box[2:4] - expected[:2] - expected[2:]).max() / 2
                ratio = (box[3] - box[1]) / height
                if apart < 0.35 * height + 3 and 0.7 < ratio < 1.45:
                    pairs.append((apart / height, k, j))
        taken_chains, taken_boxes = set(), set()
        for _, k, j in sorted(pairs):
            if k in taken_chains or j in taken_boxes:
                continue
            taken_chains.add(k)
            taken_boxes.add(j)
            alive[k].frames.append(frame)
            alive[k].boxes.append(boxes[j, :4])
            alive[k].scores.append(float(boxes[j, 4]))
        alive += [Chain([frame], [b[:4]], [float(b[4])]) for j, b in enumerate(boxes) if j not in taken_boxes]
    return ended + alive


def refused(name: str, chain: Chain) -> bool:
    """Whether a person said of this chain that it is no cone."""
    frames, boxes = np.array(chain.frames), np.array(chain.boxes)
    for clip, frame, x, y in NO_CONES:
        if clip != name or not frames[0] <= frame <= frames[-1]:
            continue
        x0, y0, x1, y1 = boxes[np.abs(frames - frame).argmin()]
        if x0 - 2 <= x <= x1 + 2 and y0 - 2 <= y <= y1 + 2:
            return True
    return False


def read_frames(path: Path) -> dict[int, np.ndarray]:
    clip = cv2.VideoCapture(str(path))
    frames = {}
    for index in range(int(clip.get(cv2.CAP_PROP_FRAME_COUNT))):
        ok, image = clip.read()
        if not ok:
            break
        if index % EVERY == 0:
            frames[index] = image
    return frames


def contact_sheet(chains: list[tuple[str, Chain, np.ndarray]]) -> np.ndarray:
    """The best look of every chain: clip, frame, centre, looks, mean score; a person names those that are no cones."""
    tiles = []
    for name, chain, image in chains:
        best = int(np.argmax([(b[3] - b[1]) * s for b, s in zip(chain.boxes, chain.scores, strict=True)]))
        x0, y0, x1, y1 = chain.boxes[best]
        half = max(x1 - x0, y1 - y0)
        window = [int(v) for v in (max((x0 + x1) / 2 - half, 0), max((y0 + y1) / 2 - half, 0))]
        cut = image[window[1] : int((y0 + y1) / 2 + half), window[0] : int((x0 + x1) / 2 + half)]
        tile = cv2.copyMakeBorder(cv2.resize(cut, (118, 118)), 28, 0, 1, 1, cv2.BORDER_CONSTANT)
        where = f"{name[:4]} {chain.frames[best]} {(x0 + x1) / 2:.0f},{(y0 + y1) / 2:.0f}"
        for row, text in enumerate((where, f"n{len(chain.frames)} {np.mean(chain.scores):.2f}")):
            cv2.putText(tile, text, (2, 11 + 13 * row), 0, 0.36, (255, 255, 255), 1, cv2.LINE_AA)
        tiles.append(tile)
    blank = np.zeros((146, 120, 3), np.uint8)
    tiles += [blank] * (-len(tiles) % 12)
    return np.vstack([np.hstack(tiles[row : row + 12]) for row in range(0, len(tiles), 12)])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("model", type=Path)
    parser.add_argument("--clips", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--sheet", type=Path, default=None)
    args = parser.parse_args()
    detector = load_detector(args.model)
    labels: dict[str, dict[str, dict[str, list[list[float]]]]] = {}
    for_sheet = []
    for name in CLIPS:
        frames = read_frames(args.clips / f"{name}.mp4")
        chains = follow({index: look_three_ways(detector, image) for index, image in frames.items()})
        kept = labels[name] = {str(index): {"boxes": [], "fades": []} for index in frames}
        for chain in chains:
            if refused(name, chain):
                continue
            if not chain.is_cone():
                for frame, box in zip(chain.frames, chain.boxes, strict=True):
                    grown = box + np.array((-2, -2, 2, 2))
                    kept[str(frame)]["fades"].append([round(float(v), 1) for v in grown])
                continue
            for frame, box in zip(*chain.smooth(), strict=True):
                kept[str(frame)]["boxes"].append([round(float(v), 1) for v in box])
        for_sheet += [
            (
                name,
                c,
                frames[c.frames[int(np.argmax([(b[3] - b[1]) * s for b, s in zip(c.boxes, c.scores, strict=True)]))]],
            )
            for c in chains
            if len(c.frames) >= MIN_LOOKS and not refused(name, c)
        ]
        print(f"{name}: {len(frames)} frames, {sum(c.is_cone() for c in chains)} cones", flush=True)
    args.out.write_text(json.dumps({"model": detector.card.name, "sha256": detector.card.sha256, "clips": labels}))
    if args.sheet:
        cv2.imwrite(str(args.sheet), contact_sheet(for_sheet))


if __name__ == "__main__":
    main()
