"""Label the work-zone clips by eye: key boxes of objects, the frames between them filled in, images to look at it all.

    python -m training.label_clips look KEYS/columbus.csv --clips DIR --frame 67 [--within 360 200 560 310] --out look.png
    python -m training.label_clips sheet KEYS/columbus.csv --clips DIR --out SHEETS
    python -m training.label_clips write KEYS/*.csv --clips DIR --out training/labels

A file of keys has a line `object,class,frame,x0,y0,x1,y1` a box, in pixels; what follows a # is a remark. One object has one
number in its clip. Between two of its keys every labelled frame gets a box: a standing thing is approached at constant speed,
then it is registered on the image. `look` shows a frame, or a part of it enlarged, with ticks in pixels; `sheet` shows every
box enlarged, filled ones with a ~; `write` writes what `dataset.py` reads.
"""

from __future__ import annotations

import argparse
import csv
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from conetl.learning.classes import CLASSES
from training.dataset import IGNORED, NOTHING

Floats = NDArray[np.float64]
EVERY, FIRST = 15, 7  # labelled frames: half a second apart, as the cones of `roadwork_clips_us`
MIN_CORRELATION = 0.55
COLOURS = {
    name: tuple(int(v) for v in cv2.cvtColor(np.array([[[22 * k, 255, 255]]], np.uint8), cv2.COLOR_HSV2BGR)[0, 0])
    for k, name in enumerate(CLASSES)
} | {IGNORED: (160, 160, 160)}
PER_ROW, ROWS, CELL_PX = 12, 8, 110


@dataclass(frozen=True)
class Labelled:
    """A box (4,) [x0, y0, x1, y1] px of an object in a frame; filled: not a person's."""

    frame: int
    number: int
    category: str
    box: np.ndarray
    filled: bool = False


def read_frames(clip: Path) -> dict[int, np.ndarray]:
    """The labelled frames of a clip."""
    video, frames = cv2.VideoCapture(str(clip)), {}
    for index in range(int(video.get(cv2.CAP_PROP_FRAME_COUNT))):
        ok, image = video.read()
        if ok and index % EVERY == FIRST:
            frames[index] = image
    if not frames:
        raise SystemExit(f"{clip}: no frame can be read")
    return frames


def read_keys(path: Path) -> list[Labelled]:
    """The lines of a file of keys. Ends the program at the first line that is not one."""
    keys = []
    for number, line in enumerate(path.read_text().splitlines(), 1):
        cells = line.split("#")[0].strip().split(",")
        if cells == [""]:
            continue
        try:
            thing, category, frame, *sides = cells
            key = Labelled(int(frame), int(thing), category.strip(), np.array(sides, float))
        except ValueError as error:
            raise SystemExit(f"{path}, line {number}: expected object,class,frame,x0,y0,x1,y1 ({error})") from error
        x0, y0, x1, y1 = key.box if len(key.box) == 4 else (0, 0, 0, 0)
        if not (x0 < x1 and y0 < y1 and key.category in COLOURS and key.frame % EVERY == FIRST):
            raise SystemExit(
                f"{path}, line {number}: expected a class of {', '.join(COLOURS)}, a frame of {FIRST}, {FIRST + EVERY}, ... "
                "and x0 < x1, y0 < y1"
            )
        keys.append(key)
    return keys


def fill(keys: list[Labelled], frames: dict[int, np.ndarray]) -> list[Labelled]:
    """Keys and the boxes between them, by frame."""
    objects: dict[tuple[int, str], dict[int, np.ndarray]] = defaultdict(dict)
    for key in keys:
        objects[key.number, key.category][key.frame] = key.box
    labels = list(keys)
    for (number, category), boxes in objects.items():
        for before, after in zip(sorted(boxes), sorted(boxes)[1:], strict=False):
            for frame in range(before + EVERY, after, EVERY):
                share = (frame - before) / (after - before)
                nearer = before if share < 0.5 else after
                guess = between(boxes[before], boxes[after], share)
                box = registered(frames[nearer], boxes[nearer], frames[frame], guess)
                labels.append(Labelled(frame, number, category, box, filled=True))
    return sorted(labels, key=lambda label: (label.frame, label.number))


def between(before: Floats, after: Floats, share: float) -> Floats:
    """The box of a standing thing approached at constant speed: 1/height is linear in time, places are linear in height."""
    low, high = before[3] - before[1], after[3] - after[1]
    height = 1 / ((1 - share) / low + share / high)
    if abs(high - low) > 0.03 * max(low, high):
        share = (height - low) / (high - low)
    return before + (after - before) * share


def registered(key: np.ndarray, box: np.ndarray, image: np.ndarray, guess: np.ndarray) -> np.ndarray:
    """The guess moved and scaled to where the patch of the key's box fits best; unchanged where it fits nowhere."""
    limits = np.tile(image.shape[1::-1], 2) - 1
    if min(*box, *guess) < 1 or (np.maximum(box, guess) > limits).any():
        return guess
    grey, patch_of = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), cv2.cvtColor(key, cv2.COLOR_BGR2GRAY)
    best, found = MIN_CORRELATION, guess
    centre, size = (guess[:2] + guess[2:]) / 2, guess[2:] - guess[:2]
    margin = 0.1 * (box[2:] - box[:2])
    (x0, y0), (x1, y1) = box[:2] - margin, box[2:] + margin
    reach = max(8.0, 0.5 * size[1])
    for scale in (0.88, 0.94, 1.0, 1.06, 1.12):
        width, height = np.maximum(np.round(size * scale * 1.2), 5).astype(int).tolist()
        to = np.array([(0, 0), (width, 0), (0, height)], np.float32)
        matrix = cv2.getAffineTransform(np.array([(x0, y0), (x1, y0), (x0, y1)], np.float32), to)
        patch = cv2.warpAffine(patch_of, matrix, (width, height), flags=cv2.INTER_AREA)
        low = np.maximum(np.floor(centre - reach - np.array((width, height)) / 2), 0).astype(int)
        high = np.ceil(centre + reach + np.array((width, height)) / 2).astype(int)
        window = grey[low[1] : high[1], low[0] : high[0]]
        if window.shape[0] < height or window.shape[1] < width:
            continue
        _, value, _, place = cv2.minMaxLoc(cv2.matchTemplate(window, patch, cv2.TM_CCOEFF_NORMED))
        if value > best:
            middle = low + place + np.array((width, height)) / 2
            best, found = value, np.concatenate((middle - size * scale / 2, middle + size * scale / 2))
    return found


def look(image: np.ndarray, labels: list[Labelled], within: tuple[float, ...]) -> np.ndarray:
    """A part of a frame, enlarged to about 1440 x 820, with labels and ticks in pixels of the frame."""
    x0, y0, x1, y1 = within
    scale = min(1440 / (x1 - x0), 820 / (y1 - y0))
    matrix = np.array([[scale, 0, -scale * x0], [0, scale, -scale * y0]])
    size = round(scale * (x1 - x0)), round(scale * (y1 - y0))
    shown = cv2.warpAffine(image, matrix, size, flags=cv2.INTER_CUBIC)
    for label in labels:
        low, high = np.round((label.box.reshape(2, 2) - (x0, y0)) * scale).astype(int).tolist()
        cv2.rectangle(shown, low, high, COLOURS[label.category], 1)
        text = f"{label.number}{'~' if label.filled else ''} {label.category[:2]}"
        cv2.putText(shown, text, (low[0], low[1] - 2), 0, 0.4, COLOURS[label.category], 1)
    shown = cv2.copyMakeBorder(shown, 16, 0, 34, 0, cv2.BORDER_CONSTANT)
    step = next(step for step, least in ((50, 0), (20, 3), (10, 6), (5, 12))[::-1] if scale >= least)
    for value in np.arange(np.ceil(x0 / step) * step, x1, step):
        at = int(34 + scale * (value - x0))
        shown[16::6, at] = 255
        cv2.putText(shown, str(int(value)), (at - 10, 11), 0, 0.38, (255, 255, 255), 1)
    for value in np.arange(np.ceil(y0 / step) * step, y1, step):
        at = int(16 + scale * (value - y0))
        shown[at, 34::6] = 255
        cv2.putText(shown, str(int(value)), (1, at + 4), 0, 0.38, (255, 255, 255), 1)
    return shown


def sheets(labels: list[Labelled], frames: dict[int, np.ndarray]) -> list[np.ndarray]:
    """Every box enlarged, with its frame and number."""
    cells = []
    for label in labels:
        half = float((label.box[2:] - label.box[:2]).max()) / 2 + 6
        scale, middle = CELL_PX / 2 / half, (label.box[:2] + label.box[2:]) / 2
        matrix = np.column_stack((np.eye(2) * scale, CELL_PX / 2 - scale * middle))
        method = cv2.INTER_CUBIC if scale > 1 else cv2.INTER_AREA
        cell = cv2.warpAffine(frames[label.frame], matrix, (CELL_PX, CELL_PX), flags=method)
        low, high = np.round((label.box.reshape(2, 2) - middle) * scale + CELL_PX / 2).astype(int).tolist()
        cv2.rectangle(cell, low, high, COLOURS[label.category], 1)
        cell = cv2.copyMakeBorder(cell, 14, 2, 2, 2, cv2.BORDER_CONSTANT)
        text = f"{label.frame}:{label.number}{'~' if label.filled else ''} {label.category[:5]}"
        cv2.putText(cell, text, (1, 11), 0, 0.38, COLOURS[label.category], 1)
        cells.append(cell)
    pages = []
    for first in range(0, len(cells), PER_ROW * ROWS):
        part = cells[first : first + PER_ROW * ROWS]
        part += [np.zeros_like(cells[0])] * (-len(part) % PER_ROW)
        pages.append(np.vstack([np.hstack(part[k : k + PER_ROW]) for k in range(0, len(part), PER_ROW)]))
    return pages


def write(path: Path, labels: list[Labelled], frames: dict[int, np.ndarray]) -> None:
    """The labels of a clip as CSV, boxes cut at the frame's edge; a frame without anything has a line that says so."""
    with path.open("w", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(("frame", "class", "x0", "y0", "x1", "y1"))
        for frame, image in sorted(frames.items()):
            here = [label for label in labels if label.frame == frame]
            for label in sorted(here, key=lambda label: (label.category, label.box.tolist())):
                box = np.clip(label.box, 0, np.tile(image.shape[1::-1], 2))
                rows.writerow((frame, label.category, *(f"{side:.1f}" for side in box)))
            if not here:
                rows.writerow((frame, NOTHING, "", "", "", ""))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("task", choices=("look", "sheet", "write"))
    parser.add_argument("keys", type=Path, nargs="+")
    parser.add_argument("--clips", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--frame", type=int, default=FIRST)
    parser.add_argument("--within", type=float, nargs=4)
    args = parser.parse_args()
    for path in args.keys:
        frames = read_frames(args.clips / f"{path.stem}.mp4")
        labels = fill(read_keys(path), frames)
        if args.task == "look":
            image = frames[args.frame]
            here = [label for label in labels if label.frame == args.frame]
            cv2.imwrite(str(args.out), look(image, here, args.within or (0, 0, *image.shape[1::-1])))
        elif args.task == "sheet":
            args.out.mkdir(parents=True, exist_ok=True)
            for number, page in enumerate(sheets(labels, frames)):
                cv2.imwrite(str(args.out / f"{path.stem}_{number}.png"), page)
        else:
            args.out.mkdir(parents=True, exist_ok=True)
            write(args.out / path.name, labels, frames)


if __name__ == "__main__":
    main()
