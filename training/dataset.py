"""The training images of the shipped network: where they come from and how their labels are cleaned."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from conetl.learning.classes import CLASSES
from conetl.learning.drawing.cut_outs import CutOut
from conetl.learning.images import LabelledImage, objects_from

#: What labels/CLIP.csv holds besides classes: regions of objects that cannot be separated, and frames without anything.
IGNORED, NOTHING = "ignore", "nothing"
#: Places of the validation images that hold a cone, or may, without a label; found by a person among the boxes of
#: conetl-cone-2 from 18 px and score 0.15 on. Boxes there count neither way.
UNLABELLED = Path(__file__).with_name("val_unlabelled.csv")
CONES_ONLY = frozenset({"traffic_cone"})
NO_SIGNS = frozenset(CLASSES) - {"traffic_sign", "work_zone_sign"}
#: What differs from a `LabelledImage` of an operator, by source: of classes that are not labelled in it nothing is taught.
TRAITS: dict[str, dict[str, Any]] = {
    "renders": {"trust": 1.0, "stretch": (1.0, 1.0), "sizes": "rendered"},
    "rf_traffic_cones": {"trust": 0.8, "stretch": (0.55, 1.3), "sizes": "any", "taught": CONES_ONLY},
    "fs_onboard": {"trust": 0.9},
    "css_safety_cone": {"trust": 0.5, "sizes": "any", "taught": CONES_ONLY},
    "css_rest": {"trust": 0.4, "sizes": "any", "taught": CONES_ONLY},
    "labelled_clips": {},
    "frc_conesandcubes": {"trust": 0.9, "sizes": "any"},
    "robomagellan_conefinder": {"trust": 0.9, "sizes": "any", "taught": NO_SIGNS},
    "highway_tidar_negatives": {"sizes": "any", "taught": NO_SIGNS},
    "otonom_sign_negatives": {"sizes": "any", "taught": NO_SIGNS},
}


def image_of(
    name: str, source: str, image: np.ndarray, boxes: np.ndarray, fade: np.ndarray | None = None
) -> LabelledImage:
    """An image of one of these sources."""
    regions = np.zeros((0, 4)) if fade is None else fade
    return LabelledImage(name, source, image, boxes, regions, **TRAITS.get(source, {}))


def black_corner_angle(image: np.ndarray) -> float:
    """Angle in degrees by which a square image was turned about its centre, read from its black corners; 0 if none.

    Tries angles from -16 to 16 degrees and keeps the one whose predicted black corners agree best (intersection over
    union) with the black pixels that are there.
    """
    small = cv2.resize(image, (160, 160), interpolation=cv2.INTER_AREA).max(2)
    seed = np.zeros((162, 162), np.uint8)
    flags = 4 | cv2.FLOODFILL_MASK_ONLY | cv2.FLOODFILL_FIXED_RANGE | (1 << 8)
    for x, y in ((1, 1), (158, 1), (1, 158), (158, 158)):
        if small[y, x] < 70:  # brightened copies have dark grey corners
            cv2.floodFill(small, seed, (x, y), 1, 12, 12, flags=flags)
    found = seed[1:-1, 1:-1] > 0
    if found.sum() < 60:
        return 0.0
    y, x = np.mgrid[0:160, 0:160] - 79.5
    best, best_angle = 0.0, 0.0
    for angle in np.arange(-16.0, 16.01, 0.25):
        c, s = np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))
        predicted = (np.abs(c * x + s * y) > 80) | (np.abs(-s * x + c * y) > 80)
        overlap = (predicted & found).sum() / max((predicted | found).sum(), 1)
        if overlap > best:
            best, best_angle = float(overlap), float(angle)
    return best_angle if best > 0.6 else 0.0


def turn_upright(picture: LabelledImage) -> LabelledImage:
    """Undo the turn of a turned training copy and shrink its boxes to what they were before the turn.

    A box of w x h turned by t has the upright hull W = w cos t + h sin t, H = w sin t + h cos t; solved for w and h.
    Boxes cut by the image's edge lost that information: they keep the turned hull and the image is marked loose there.
    """
    height, width = picture.image.shape[:2]
    angle = black_corner_angle(picture.image) if width == height else 0.0
    if angle == 0.0:
        corners = picture.image[[2, 2, -3, -3], [2, -3, 2, -3]].max(1)
        picture.tight = not bool((corners < 70).all())  # turned, but by how much was not found
        return picture
    c, s = np.cos(np.deg2rad(abs(angle))), np.sin(np.deg2rad(abs(angle)))
    matrix = cv2.getRotationMatrix2D(((width - 1) / 2, (height - 1) / 2), angle, 1.0)
    image = cv2.warpAffine(picture.image, matrix, (width, height), flags=cv2.INTER_CUBIC)
    boxes, fade = [], []
    for x0, y0, x1, y1 in picture.boxes[:, :4]:
        hull_w, hull_h = x1 - x0, y1 - y0
        w, h = (hull_w * c - hull_h * s) / (c * c - s * s), (hull_h * c - hull_w * s) / (c * c - s * s)
        cx, cy = matrix @ ((x0 + x1) / 2, (y0 + y1) / 2, 1.0)
        cut = x0 < 3 or y0 < 3 or x1 > width - 3 or y1 > height - 3
        if cut or w < 0.2 * hull_w or h < 0.4 * hull_h:
            fade.append((cx - hull_w / 2, cy - hull_h / 2, cx + hull_w / 2, cy + hull_h / 2))
        else:
            boxes.append((cx - w / 2, cy - h / 2, cx + w / 2, cy + h / 2))
    cones = objects_from(boxes, [0] * len(boxes))
    return replace(picture, image=image, boxes=cones, fade=np.array(fade).reshape(-1, 4))


def far_band(boxes: np.ndarray, width: int, height: int) -> np.ndarray:
    """The band of the road where far cones of an onboard image stand, labelled or not, as one fade region."""
    if len(boxes) == 0:
        return np.array([[0.0, 0.3 * height, width, 0.55 * height]])
    top = boxes[:, 1].min() - 0.02 * height
    bottom = np.percentile(boxes[:, 3], 30) + 0.01 * height
    return np.array([[0.0, top, width, max(bottom, top + 0.06 * height)]])


def unlabelled_places() -> dict[str, np.ndarray]:
    """UNLABELLED by image: (N, 4) x0, y0, x1, y1."""
    places: dict[str, list[list[float]]] = {}
    with UNLABELLED.open() as lines:
        for row in csv.DictReader(lines):
            places.setdefault(row["file"], []).append([float(row[key]) for key in ("x0", "y0", "x1", "y1")])
    return {name: np.array(boxes) for name, boxes in places.items()}


def read_cones(root: Path, split: str) -> list[LabelledImage]:
    """All images of one split of the labelled cone data, labels cleaned for training, untouched for validation."""
    pictures, places = [], unlabelled_places()
    with (root / "manifest.csv").open() as lines:
        rows = [row for row in csv.DictReader(lines) if row["split"] == split]
    for row in rows:
        image = cv2.imread(str(root / split / "images" / row["file"]))
        if image is None:
            raise SystemExit(f"unreadable training image {row['file']}")
        height, width = image.shape[:2]
        boxes = read_labels((root / split / "labels" / row["file"]).with_suffix(".txt"), width, height)
        picture = image_of(row["file"], row["source"], image, boxes)
        if split == "train" and row["source"] == "rf_traffic_cones":
            picture = turn_upright(picture)
        if split == "train" and row["source"] == "fs_onboard":
            picture.fade = far_band(boxes, width, height)
        if split == "val":
            picture.fade = places.get(row["file"], picture.fade)
        pictures.append(picture)
    return pictures


def read_more_cones(root: Path, left_out: frozenset[str] = frozenset()) -> list[LabelledImage]:
    """The images of the further sources, but for those sources and clips that are left out to judge by."""
    pictures = []
    with (root / "manifest.csv").open() as lines:
        rows = list(csv.DictReader(lines))
    for row in rows:
        source, name = row["set"], row["file"]
        if source in left_out or name.rsplit("_", 1)[0] in left_out:
            continue
        image = cv2.imread(str(root / source / "images" / name))
        if image is None:
            raise SystemExit(f"unreadable training image {name}")
        height, width = image.shape[:2]
        labels = (root / source / "labels" / name).with_suffix(".txt")
        if source == "frc_conesandcubes":
            image = redder(image)
        pictures.append(image_of(name, source, image, read_labels(labels, width, height)))
    return pictures


def read_left_out(root: Path, left_out: str) -> list[LabelledImage]:
    """The images of those sources and clips, separated by commas."""
    names = set(left_out.split(","))
    return [p for p in read_more_cones(root) if names & {p.source, p.name.rsplit("_", 1)[0]}]


def redder(image: np.ndarray) -> np.ndarray:
    """Yellow plastic (hue 16 to 34 of OpenCV's 180) as the orange of road cones (2 to 14)."""
    hsv = cv2.cvtColor(image, cv2.COLOR_BGR2HSV)
    hue = np.arange(256)
    table = np.where((hue >= 16) & (hue <= 34), 2 + (hue - 16) * 12 / 18, hue).astype(np.uint8)
    hsv[..., 0] = cv2.LUT(hsv[..., 0], table)
    return cv2.cvtColor(hsv, cv2.COLOR_HSV2BGR)


def read_labelled_clips(clips: Path, labels: Path, left_out: frozenset[str] = frozenset()) -> list[LabelledImage]:
    """The labelled frames of the work-zone clips, all classes (labels/README.md).

    The frames of the clips themselves: in their copies in `roadwork_clips_us` crowds of far cones, which are labelled here, are
    painted over.
    """
    pictures = []
    for path in sorted(labels.glob("*.csv")):
        if path.stem in left_out:
            continue
        with path.open() as lines:
            rows = list(csv.DictReader(lines))
        clip = cv2.VideoCapture(str(clips / f"{path.stem}.mp4"))
        for index in range(int(clip.get(cv2.CAP_PROP_FRAME_COUNT))):
            ok, image = clip.read()
            if not ok:
                break
            here = [row for row in rows if int(row["frame"]) == index]
            if not here:
                continue
            boxes = {
                id(row): [float(row[side]) for side in ("x0", "y0", "x1", "y1")]
                for row in here
                if row["class"] != NOTHING
            }
            things = [row for row in here if row["class"] in CLASSES]
            objects = objects_from([boxes[id(row)] for row in things], [CLASSES.index(row["class"]) for row in things])
            fades = np.array([boxes[id(row)] for row in here if row["class"] == IGNORED]).reshape(-1, 4)
            pictures.append(image_of(f"{path.stem}_{index:04d}", "labelled_clips", image, objects, fades))
    return pictures


def read_renders(root: Path, known: set[str], limit: int = 4000) -> list[LabelledImage]:
    """Rendered images that are not in `known` yet: images/*.{jpg,png} with labels/*.txt beside them."""
    pictures: list[LabelledImage] = []
    for path in sorted((root / "images").glob("*")):
        label = root / "labels" / f"{path.stem}.txt"
        if path.stem in known or not label.exists() or path.suffix not in (".jpg", ".png"):
            continue
        image = cv2.imread(str(path))
        if image is None:
            continue  # still being written; the next look will find it
        pictures.append(image_of(path.stem, "renders", image, read_labels(label, image.shape[1], image.shape[0])))
        if len(pictures) >= limit:
            break
    return pictures


def read_labels(path: Path, width: int, height: int) -> np.ndarray:
    """YOLO text file, with foot and tip behind the box or without -> objects (N, 9). An absent file means none."""
    if not path.exists() or not path.read_text().strip():
        return np.zeros((0, 9))
    classes, rows = np.split(np.loadtxt(path, ndmin=2), [1], axis=1)
    ends = rows[:, 4:8] if rows.shape[1] >= 8 else np.full((len(rows), 4), np.nan)
    rows = np.concatenate((rows[:, :2] - rows[:, 2:4] / 2, rows[:, :2] + rows[:, 2:4] / 2, ends), 1)
    return np.column_stack((rows * np.tile((width, height), 4), classes))


def cut_out_cones(pictures: list[LabelledImage]) -> list[CutOut]:
    """GrabCut cut-outs of whole upright cones, trimmed to the cone's own outline: exact boxes for pasting."""
    cutouts = []
    for picture in pictures:
        height, width = picture.image.shape[:2]
        for x0, y0, x1, y1 in picture.boxes[:, :4]:
            w, h = x1 - x0, y1 - y0
            if h < 70 or h < 0.9 * w or x0 < 4 or y0 < 4 or x1 > width - 4 or y1 > height - 4:
                continue
            left, top = int(max(x0 - 0.15 * w, 0)), int(max(y0 - 0.15 * h, 0))
            right, bottom = int(min(x1 + 0.15 * w, width)), int(min(y1 + 0.15 * h, height))
            patch = picture.image[top:bottom, left:right]
            scale = min(1.0, 200 / patch.shape[0])
            patch = cv2.resize(patch, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
            frame = [round(v * scale) for v in (x0 - left, y0 - top, w, h)]
            mask = np.zeros(patch.shape[:2], np.uint8)
            cv2.grabCut(patch, mask, frame, np.zeros((1, 65)), np.zeros((1, 65)), 3, cv2.GC_INIT_WITH_RECT)
            solid = ((mask == cv2.GC_FGD) | (mask == cv2.GC_PR_FGD)).astype(np.uint8)
            solid = cv2.morphologyEx(solid, cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8))
            count, labels, stats, _ = cv2.connectedComponentsWithStats(solid)
            if count < 2:
                continue
            largest = 1 + int(stats[1:, cv2.CC_STAT_AREA].argmax())
            bx, by, bw, bh, area = stats[largest]
            # A good outline fills its box like a cone does and covers most of the label.
            if not (0.28 < area / (bw * bh) < 0.72 and bh > 0.8 * frame[3] and 1.1 < bh / bw < 3.5):
                continue
            alpha = cv2.GaussianBlur((labels == largest).astype(np.uint8) * 255, (3, 3), 0)
            cutouts.append(CutOut(np.dstack((patch, alpha))[by : by + bh, bx : bx + bw]))
    return cutouts
