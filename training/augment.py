"""Training samples: scale, stretch, paste, hide, blur and relight images; boxes always follow the geometry.

Objects are (N, 9) as in `dataset.py`, fades (M, 5) [x0, y0, x1, y1, sum of 2**class] as in `loss.py`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import cv2
import numpy as np

from training.classes import ALL_CLASSES, CLASSES
from training.dataset import Image
from training.drawn_objects import CutOut

MIN_CONE_PX = 7.0  # below this a labelled cone is neither taught nor forbidden
# How far the sides of a source's boxes are believed; renders and cut-outs are exact, hand-drawn boxes leave a margin.
SIDE_TRUST = {
    "renders": 1.0,
    "rf_traffic_cones": 0.8,
    "fs_onboard": 0.9,
    "css_safety_cone": 0.5,
    "css_rest": 0.4,
    "labelled_clips": 0.6,
    "frc_conesandcubes": 0.9,
    "robomagellan_conefinder": 0.9,
}
PAD_PX = 32
#: Heights of the largest object in samples for large ones.
LARGE_PX = (180.0, 480.0)
#: Things that stand on the road, in rows.
STANDING = ("traffic_cone", "tubular_marker", "drum", "vertical_panel", "barricade")
Sample = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
#: An image and its `pyramid`.
Layered = tuple[Image, list[np.ndarray]]


def pyramid(image: np.ndarray) -> list[np.ndarray]:
    """Full, half and quarter size, so that shrinking by a warp does not alias."""
    half = cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    return [image, half, cv2.resize(half, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)]


def choose_scale(picture: Image, rng: np.random.Generator, large: bool) -> tuple[float, np.ndarray | None]:
    """Scale that brings one randomly chosen box to a height drawn log-uniformly, most of them small; and that box (4,)."""
    if large and len(picture.boxes):
        box = picture.boxes[int(np.argmax(picture.boxes[:, 3] - picture.boxes[:, 1])), :4]
        return float(np.clip(np.exp(rng.uniform(*np.log(LARGE_PX))) / (box[3] - box[1]), 0.05, 3.0)), box
    if len(picture.false):
        box, as_seen = picture.false[int(rng.integers(len(picture.false)))], rng.random() < 0.5
    elif len(picture.boxes) == 0:
        return float(np.exp(rng.uniform(np.log(0.35), np.log(1.3)))), None
    elif picture.source == "renders":
        box = picture.boxes[int(rng.integers(len(picture.boxes))), :4]
        return float(rng.choice((1.0, rng.uniform(0.7, 1.4)))), box
    else:
        classes = picture.boxes[:, 8]
        # no class is drowned by the others
        one = 0 if 0 in classes and rng.random() < 0.5 else rng.choice(np.unique(classes))
        box = picture.boxes[int(rng.choice(np.flatnonzero(classes == one))), :4]
        # as a camera saw them: most far cones are small already
        as_seen = picture.source in ("fs_onboard", "labelled_clips") and rng.random() < 0.5
    if as_seen:
        return float(rng.uniform(0.85, 1.25)), box
    low, high = (11.0, 64.0) if rng.random() < 0.62 else (50.0, 330.0)
    target = float(np.exp(rng.uniform(np.log(low), np.log(high))))
    return float(np.clip(target / (box[3] - box[1]), 0.05, 2.2)), box


def warp_into(
    canvas: np.ndarray,
    picture: Image,
    levels: list[np.ndarray],
    area: tuple[int, int, int, int],
    rng: np.random.Generator,
    large: bool = False,
) -> tuple[np.ndarray, np.ndarray]:
    """Draw an image, scaled, stretched, mirrored, slightly turned, into `area` of the canvas; boxes and fades there."""
    left, top, right, bottom = area
    stretch = 1.0
    if picture.source == "rf_traffic_cones":
        stretch = float(rng.uniform(0.55, 1.3))
    elif picture.source != "renders":
        stretch = float(rng.uniform(0.85, 1.15))
    scale, box = choose_scale(picture, rng, large)
    turn = np.deg2rad(rng.normal(0.0, 1.5)) if rng.random() < 0.5 else 0.0
    mirror = -1.0 if rng.random() < 0.5 else 1.0
    height, width = levels[0].shape[:2]
    if box is not None:
        cx, cy = (box[0] + box[2]) / 2, (box[1] + box[3]) / 2
    else:
        cx, cy = rng.uniform(0.2, 0.8) * width, rng.uniform(0.3, 0.8) * height
    # Where the chosen point lands: anywhere in the area, but rather fill the area with the image than with nothing.
    margin = 0.3 if large else 0.0
    to_x, to_y = (
        left + rng.uniform(margin, 1 - margin) * (right - left),
        top + rng.uniform(margin, 1 - margin) * (bottom - top),
    )
    half_w, half_h = scale * stretch * width / 2, scale * height / 2
    mid_x = to_x + mirror * scale * stretch * (width / 2 - cx)
    mid_y = to_y + scale * (height / 2 - cy)
    mid_x = np.clip(mid_x, *sorted((right - half_w, left + half_w)))
    mid_y = np.clip(mid_y, *sorted((bottom - half_h, top + half_h)))
    c, s = np.cos(turn), np.sin(turn)
    linear = np.array([[c, -s], [s, c]]) @ np.diag([mirror * scale * stretch, scale])
    offset = np.array([mid_x, mid_y]) - linear @ (width / 2, height / 2)
    level = 0 if scale > 0.7 else (1 if scale > 0.35 else 2)
    shrink = 2**level
    # Boxes live on pixel edges, warpAffine on pixel centres: pixel u of a level has its centre at (u + 0.5) * shrink.
    local = np.column_stack((linear * shrink, offset + linear @ np.full(2, 0.5 * shrink) - 0.5 - (left, top)))
    size = (right - left, bottom - top)
    transparent = cv2.BORDER_TRANSPARENT  # what the image does not reach stays
    cv2.warpAffine(levels[level], local, size, canvas[top:bottom, left:right], cv2.INTER_LINEAR, transparent)

    def follow(boxes: np.ndarray, cones: np.ndarray) -> np.ndarray:
        x0, y0, x1, y1 = boxes[:, :4].T
        inset = 0.38 * (x1 - x0) * cones  # a cone fills its box at the foot only, not at the top corners
        points = np.stack(
            [
                np.stack((x0, y1), 1),
                np.stack((x1, y1), 1),
                np.stack((x0 + inset, y0), 1),
                np.stack((x1 - inset, y0), 1),
            ],
            1,
        )
        moved = points @ linear.T + offset
        known = boxes.shape[1] // 8 * 2  # points: none of fades
        ends = boxes[:, 4:8].reshape(len(boxes), known, 2) @ linear.T + offset
        return np.concatenate((moved.min(1), moved.max(1), ends.reshape(len(boxes), 2 * known), boxes[:, 8:]), 1)

    fades = follow(picture.fade, np.zeros(len(picture.fade)))
    return follow(picture.boxes, picture.boxes[:, 8] == 0), fade_rows(fades)


def fade_rows(boxes: np.ndarray, classes: int = ALL_CLASSES) -> np.ndarray:
    """Boxes (M, 4) as fades (M, 5) of these classes."""
    return np.column_stack((boxes, np.full(len(boxes), float(classes))))


def untaught(picture: Image, area: tuple[int, int, int, int]) -> np.ndarray:
    """The classes that are not labelled in an image, as a fade of the whole area (0 or 1, 5)."""
    classes = sum(2**k for k, name in enumerate(CLASSES) if name not in picture.taught)
    return fade_rows(np.array([area] if classes else []).reshape(-1, 4), classes)


def clip_boxes(boxes: np.ndarray, area: tuple[int, int, int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Objects (N, 4 or more) cut at the area's edge; the second has the boxes of those of which too little is left (to fade).

    A cone that the lower edge cuts is narrower than its base: its visible width grows with the visible share of its height by
    0.18 + 0.6 share (in the middle of 155 cut-outs and 182 drawn cones).
    """
    if len(boxes) == 0:
        return boxes, np.zeros((0, 4))
    left, top, right, bottom = area
    cut = boxes.copy()
    if boxes.shape[1] > 8:
        share = (bottom - boxes[:, 1]) / np.maximum(boxes[:, 3] - boxes[:, 1], 1.0)
        narrow = (boxes[:, 8] == 0) & (share > 0) & (share < 0.88)
        loss = np.where(narrow, 0.41 - 0.3 * share, 0.0) * (boxes[:, 2] - boxes[:, 0])
        cut[:, 0] += loss
        cut[:, 2] -= loss
    cut[:, :4] = np.clip(cut[:, :4], (left, top, left, top), (right, bottom, right, bottom))
    size, full = cut[:, 2:4] - cut[:, :2], boxes[:, 2:4] - boxes[:, :2]
    inside = (size > 1).all(1)
    share = size.prod(1) / full.prod(1)
    keep = inside & (share > 0.3) & (size[:, 1] >= MIN_CONE_PX) & (size[:, 0] >= 2.5)
    return cut[keep], cut[inside & ~keep, :4]


def paste_row(
    canvas: np.ndarray, cutout: CutOut, taken: list[np.ndarray], rng: np.random.Generator
) -> list[np.ndarray]:
    """Paste a row of like things that recedes from the camera, the farthest first; those (N, 9) that found a place."""
    rows, columns = canvas.shape[:2]
    horizon, aside = rng.uniform(0.1, 0.5) * rows, rng.uniform(0.0, 1.0) * columns
    near_px = float(np.exp(rng.uniform(np.log(25), np.log(220))))
    foot, x = horizon + near_px * rng.uniform(1.0, 3.0), rng.uniform(0.0, 1.0) * columns
    spacing = rng.uniform(0.3, 1.2)
    found: list[np.ndarray] = []
    for number in reversed(range(int(rng.integers(2, 7)))):
        share = 1 / (1 + spacing * number) * rng.uniform(0.96, 1.04)
        place = aside + (x - aside) * share, horizon + (foot - horizon) * share
        if near_px * share >= MIN_CONE_PX + 1:
            known = np.concatenate(taken + found or [np.zeros((0, 9))])
            found.append(paste_cutout(canvas, cutout, known, rng, near_px * share, place))
    return found


def paste_cutout(
    canvas: np.ndarray,
    cutout: CutOut,
    taken: np.ndarray,
    rng: np.random.Generator,
    height_px: float | None = None,
    foot: tuple[float, float] | None = None,
) -> np.ndarray:
    """Paste one cut-out where it hides little of the objects `taken` (N, 9), with a shadow at its foot if it stands.

    Height and foot [x, y] px are random where they are not given. Returns it as an object (1, 9) with an exact box, or (0, 9)
    when the place was taken or does not lie in the image.
    """
    picture, stands = cutout.image, cutout.category in STANDING
    if height_px is None:
        height_px = float(np.exp(rng.uniform(np.log(10), np.log(260))))
    scale = height_px / picture.shape[0]
    squeeze = rng.uniform(0.6, 1.15) if cutout.category == "traffic_cone" else rng.uniform(0.85, 1.1)
    width = max(round(picture.shape[1] * scale * squeeze), 4)
    height = max(round(height_px), 8)
    patch = cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR)
    shrink = np.tile((width / picture.shape[1], height / picture.shape[0]), 2)
    ends, box = cutout.ends * shrink, cutout.box_or_all * shrink
    if rng.random() < 0.5:
        patch = patch[:, ::-1]
        ends[[0, 2]], box[[0, 2]] = width - ends[[0, 2]], width - box[[2, 0]]
    colour = patch[..., :3].astype(np.float32) * rng.uniform(0.55, 1.25) * rng.uniform(0.9, 1.1, 3)
    rows, columns = canvas.shape[:2]
    x = int(rng.integers(0, max(columns - width, 1)))
    top = int((0.2 if stands else 0.0) * rows)
    y = int(rng.integers(top, max(rows - height, top + 1)))
    y = min(y, rows - height)
    if foot is not None:
        x, y = round(foot[0] - width / 2), round(foot[1] - height)
    elif rng.random() < 0.2:  # cut by the image's side, or by its lower edge
        if rng.random() < 0.3:
            y = rows - height // 2
        else:
            x = int(rng.choice((0, columns)) - rng.uniform(0.3, 0.7) * width)
    at = np.array((x, y, x, y))
    placed = np.array([[*(box + at), *(ends + at), CLASSES.index(cutout.category)]])
    seen, _ = clip_boxes(placed, (0, 0, columns, rows))
    if len(seen) == 0 or (foot is not None and (seen[0, :4] != placed[0, :4]).any()):
        return np.zeros((0, 9))
    low, high = np.maximum(taken[:, :2], (x, y)), np.minimum(taken[:, 2:4], (x + width, y + height))
    hidden = np.clip(high - low, 0, None).prod(1) / np.maximum((taken[:, 2:4] - taken[:, :2]).prod(1), 1.0)
    if (hidden > 0.5).any():
        return np.zeros((0, 9))
    if stands and rng.random() < 0.6:
        cast_shadow(canvas, x + width // 2, y + height - 1, width, rng)
    inside = slice(max(-y, 0), rows - y), slice(max(-x, 0), columns - x)
    alpha, colour = patch[..., 3:][inside].astype(np.float32) / 255, colour[inside]
    region = canvas[max(y, 0) : y + height, max(x, 0) : x + width]
    region[:] = np.clip(alpha * colour + (1 - alpha) * region, 0, 255).astype(np.uint8)
    if cutout.box is None and (seen[0, :4] != placed[0, :4]).any():  # exactly what is to be seen of it
        across, down = np.flatnonzero((alpha > 0.5).any((0, 2))), np.flatnonzero((alpha > 0.5).any((1, 2)))
        if len(across) == 0:
            return np.zeros((0, 9))
        seen[0, :4] = np.array((across[0], down[0], across[-1] + 1, down[-1] + 1)) + np.tile((max(x, 0), max(y, 0)), 2)
    return seen


def cast_shadow(canvas: np.ndarray, x: int, foot: int, width: int, rng: np.random.Generator) -> None:
    """Darken an ellipse of the ground at the foot of a thing `width` px wide."""
    axes = max(int(width * 0.7), 2), max(int(width * 0.16), 1)
    x += int(rng.normal(0, width / 3))
    left, top = max(x - axes[0] - 2, 0), max(foot - axes[1] - 2, 0)
    ground = canvas[top : max(foot + axes[1] + 3, 0), left : max(x + axes[0] + 3, 0)]
    if ground.size:
        shadow = ground.copy()
        cv2.ellipse(shadow, (x - left, foot - top), axes, 0, 0, 360, (25, 25, 28), -1)
        ground[:] = cv2.addWeighted(shadow, 0.5, ground, 0.5, 0)


def draw_post(canvas: np.ndarray, x: float, foot: float, height: float, rng: np.random.Generator) -> None:
    """A bollard or post with bands (red-white, black-yellow, plain), shaded like a cylinder."""
    width = max(height * rng.uniform(0.05, 0.22), 2.0)
    palettes = (
        ((40, 40, 190), (225, 225, 228)),
        ((30, 30, 150), (210, 212, 215)),
        ((30, 200, 235), (30, 30, 30)),
        ((90, 90, 95), (90, 90, 95)),
        ((35, 35, 165), (35, 35, 165)),
    )
    first, second = palettes[int(rng.choice(5, p=(0.42, 0.26, 0.1, 0.11, 0.11)))]
    bands = int(rng.integers(2, 9))
    light = rng.uniform(0.35, 1.1)
    over = np.zeros((max(round(height), 3), max(round(width), 2), 3), np.float32)
    for band in range(bands):
        over[band * over.shape[0] // bands : (band + 1) * over.shape[0] // bands] = first if band % 2 == 0 else second
    if rng.random() < 0.5:  # a dark or grey post that has its bands near the top only
        top = rng.uniform(0.0, 0.12) * height
        start, end = int(top), int(top + height * rng.uniform(0.12, 0.45))
        plain = np.full_like(over, rng.choice((25.0, 45.0, 90.0, 150.0)))
        plain[start:end] = cv2.resize(over, (over.shape[1], max(end - start, 1)))[: end - start]
        over = plain
    shade = 1 - rng.uniform(0.1, 0.6) * np.abs(np.linspace(-1, 1, over.shape[1]) + rng.uniform(-0.6, 0.6))
    over *= light * shade[None, :, None]
    y0, x0 = int(foot - over.shape[0]), int(x)
    y1, x1 = min(y0 + over.shape[0], canvas.shape[0]), min(x0 + over.shape[1], canvas.shape[1])
    cut_y, cut_x = max(y0, 0), max(x0, 0)
    if y1 > cut_y and x1 > cut_x:
        canvas[cut_y:y1, cut_x:x1] = np.clip(over[cut_y - y0 : y1 - y0, cut_x - x0 : x1 - x0], 0, 255)


def draw_tail_lamp(canvas: np.ndarray, x: float, foot: float, height: float, rng: np.random.Generator) -> None:
    """A car's rear lamp: a tall red lens with a white or amber part, on a dark or painted body.

    A lens that is narrower at its top has the body all around it: on the road it would be a cone.
    """
    wide, body = height * rng.uniform(0.3, 0.6), height * rng.uniform(0.6, 2.5)
    paint = rng.choice((12.0, 30.0, 60.0, 130.0, 190.0)) * rng.uniform(0.7, 1.2, 3)
    pointed = rng.random() < 0.5
    if pointed:
        body = max(body, 1.6 * wide)
        left, low_edge = x - body * rng.uniform(0.35, 0.65), foot + height * rng.uniform(0.5, 1.2)
    else:
        left, low_edge = x - body * rng.uniform(0.1, 0.9), foot + height * rng.uniform(0.1, 0.8)
    corners = (int(left), int(low_edge)), (int(left + body), int(foot - 1.3 * height))
    cv2.rectangle(canvas, *corners, paint.tolist(), -1)
    low = rng.uniform(0.3, 1.0)
    top, lean = low * (rng.uniform(0.1, 0.9) if pointed else rng.uniform(0.9, 1.8)), rng.normal(0.0, 0.25)
    outline = np.array([(-low, 0.0), (low, 0.0), (top + lean, -1.0), (-top + lean, -1.0)]) * (wide / 2, height) + (
        x,
        foot,
    )
    red = (int(rng.integers(10, 60)), int(rng.integers(10, 50)), int(rng.integers(90, 230)))
    cv2.fillPoly(canvas, [outline.astype(np.int32)], red, cv2.LINE_AA)
    share = np.sort(rng.uniform(0.1, 0.9, 2))  # the reversing lamp or indicator between two heights of the lens
    edge, other_edge = (
        outline[0] + (outline[3] - outline[0]) * share[:, None],
        outline[1] + (outline[2] - outline[1]) * share[:, None],
    )
    pale = (200, 205, 215) if rng.random() < 0.7 else (40, 130, 230)
    band = np.array([edge[0], other_edge[0], other_edge[1], edge[1]])
    cv2.fillPoly(canvas, [band.astype(np.int32)], (np.array(pale) * rng.uniform(0.5, 1.1)).tolist(), cv2.LINE_AA)


def draw_car_corner(canvas: np.ndarray, x: float, foot: float, height: float, rng: np.random.Generator) -> None:
    """The rear corner of a car with a drop-shaped lamp, broad and round below, curved to a point above: window, panel, bumper."""
    body = height * rng.uniform(1.5, 3.0)
    paint = rng.choice((10.0, 18.0, 30.0, 60.0, 130.0, 200.0)) * rng.uniform(0.7, 1.2, 3)
    left, low_edge = x - body * rng.uniform(0.3, 0.7), foot + height * rng.uniform(0.4, 1.4)
    middle = foot - height * rng.uniform(0.4, 0.9)
    parts = (
        (left, middle - height * rng.uniform(0.5, 1.2), left + body, middle, rng.uniform(20, 130, 3)),  # window
        (left, middle, left + body, low_edge, paint),
        (left, foot + height * rng.uniform(0.1, 0.4), left + body, low_edge, paint * rng.uniform(0.4, 1.1)),
    )
    for x0, y0, x1, y1, colour in parts:
        cv2.rectangle(canvas, (int(x0), int(y0)), (int(x1), int(y1)), np.clip(colour, 0, 255).tolist(), -1)
    up = np.linspace(0, 1, 14)
    wide, lean, bend = height * rng.uniform(0.18, 0.34), height * rng.normal(0, 0.35), rng.uniform(1.2, 2.5)
    half = (
        wide * (1 - up ** rng.uniform(0.8, 2.0)) * np.sqrt(np.clip(up / rng.uniform(0.08, 0.3), 0, 1)) + 0.02 * height
    )
    line = x + lean * up**bend
    sides = np.concatenate((np.column_stack((line - half, up)), np.column_stack((line + half, up))[::-1]))
    outline = np.column_stack((sides[:, 0], foot - height * sides[:, 1]))
    red = (int(rng.integers(10, 70)), int(rng.integers(10, 60)), int(rng.integers(70, 220)))
    cv2.fillPoly(canvas, [outline.astype(np.int32)], red, cv2.LINE_AA)
    for _ in range(int(rng.integers(0, 3))):  # clear or amber glasses in it
        k = int(rng.integers(2, 11))
        at = int(line[k]), int(foot - height * up[k])
        size = max(int(half[k] * rng.uniform(0.4, 0.9)), 1), max(int(height * rng.uniform(0.03, 0.12)), 1)
        pale = np.array((190, 195, 210) if rng.random() < 0.7 else (40, 120, 225)) * rng.uniform(0.5, 1.1)
        cv2.ellipse(canvas, at, size, 0, 0, 360, np.clip(pale, 0, 255).tolist(), -1, cv2.LINE_AA)


def draw_furniture(canvas: np.ndarray, rng: np.random.Generator) -> None:
    """Things of no class though red, orange or white: posts, lamps, vests, vans, triangles."""
    height, width = canvas.shape[:2]
    for _ in range(int(rng.integers(1, 5))):
        kind = int(rng.integers(9))
        x, foot = rng.uniform(0, width), rng.uniform(0.3, 1.0) * height
        size = float(np.exp(rng.uniform(np.log(8), np.log(110))))
        warm = (int(rng.integers(0, 70)), int(rng.integers(20, 140)), int(rng.integers(150, 256)))
        point = (int(x), int(foot))
        if kind in (0, 1):
            gap = size * rng.uniform(0.2, 0.8)
            for k in range(int(rng.integers(1, 5))):
                draw_post(canvas, x + k * gap, foot, size, rng)
        elif kind in (4, 6):
            draw_tail_lamp(canvas, x, foot, size, rng)
        elif kind in (7, 8):
            draw_car_corner(canvas, x, foot, size, rng)
        elif kind == 2:  # lamp or headlight
            shade = (255, 255, 255) if rng.random() < 0.6 else warm
            cv2.ellipse(canvas, point, (max(int(size * 0.2), 2), max(int(size * 0.25), 2)), 0, 0, 360, shade, -1)
        elif kind == 3:  # panel of one warm colour: van side, vest, sign board
            w, h = size * rng.uniform(0.3, 2.5), size * rng.uniform(0.4, 1.5)
            cv2.rectangle(canvas, point, (int(x + w), int(foot - h)), warm, -1)
            if rng.random() < 0.6:
                band = int(foot - h * rng.uniform(0.3, 0.8))
                cv2.rectangle(canvas, (int(x), band), (int(x + w), int(band - h * 0.15)), (220, 225, 225), -1)
        else:  # triangle on its tip or lying down: cones point upwards
            r = max(size * 0.4, 3)
            shape = [(-r / 2, -r), (r / 2, -r), (0, 0)] if rng.random() < 0.5 else [(-r, -r / 2), (-r, r / 2), (r, 0)]
            cv2.fillPoly(canvas, [(np.array(shape) + point).astype(int)], warm)


def hide_cones(canvas: np.ndarray, boxes: np.ndarray, rng: np.random.Generator) -> None:
    """Put a post, a block or rails in front of some cones, so that up to 60 % of each is hidden; boxes stay whole."""
    for x0, y0, x1, y1 in boxes[:, :4]:
        if rng.random() > 0.3 or y1 - y0 < 12:
            continue
        kind = rng.random()
        if kind < 0.35:
            draw_rails(canvas, (x0, y0, x1, y1), rng)
        elif kind < 0.8:
            draw_post(
                canvas,
                rng.uniform(x0 - 0.1 * (x1 - x0), x1 - 0.2 * (x1 - x0)),
                y1 + rng.uniform(0, 0.3) * (y1 - y0),
                (y1 - y0) * rng.uniform(1.0, 1.6),
                rng,
            )
        else:
            left = x0 + (x1 - x0) * rng.choice((-0.3, 0.6))
            grey = int(rng.integers(20, 200))
            cv2.rectangle(canvas, (int(left), int(y0)), (int(left + 0.7 * (x1 - x0)), int(y1)), (grey, grey, grey), -1)


def draw_rails(canvas: np.ndarray, box: tuple[float, float, float, float], rng: np.random.Generator) -> None:
    """One or two rails or striped boards across an object's box, as of a barricade or a fence in front of it."""
    x0, y0, x1, y1 = box
    reach = (x1 - x0) * rng.uniform(0.2, 4.0, 2)
    left, right = int(x0 - reach[0]), int(x1 + reach[1])
    thick = (y1 - y0) * rng.uniform(0.1, 0.3)
    tops = rng.uniform(y0, y1 - thick, int(rng.integers(1, 3)))
    slope = rng.normal(0.0, 0.06) * (right - left)
    colours = [(40, 90, 235), (225, 228, 230)] if rng.random() < 0.6 else [tuple(rng.integers(20, 220, 3).tolist())] * 2
    light, stripe, slant = rng.uniform(0.35, 1.1), thick * rng.uniform(0.6, 2.0), thick * rng.choice((-1.0, 0.0, 1.0))
    for top in tops:
        for number, at in enumerate(np.arange(left, right, stripe)):
            rise = slope * (at - left) / max(right - left, 1)
            corners = np.array([(at, 0), (at + stripe, 0), (at + stripe + slant, thick), (at + slant, thick)])
            corners[:, 1] += top + rise
            cv2.fillPoly(canvas, [corners.astype(np.int32)], (np.array(colours[number % 2]) * light).tolist())


def relight(image: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Exposure, gamma, white balance, saturation, haze, blur, noise, JPEG: what cameras and days do to an image."""
    if rng.random() < 0.8:
        gain = np.exp(rng.normal(-0.05, 0.2)) * np.exp(rng.normal(0, 0.05, 3))
        gamma = np.exp(rng.normal(0, 0.2))
        ramp = (np.arange(256)[:, None] / 255.0) ** gamma * gain
        if rng.random() < 0.3:  # hard sunlight: white road, black shadows
            middle = rng.uniform(0.3, 0.6)
            ramp = np.clip(ramp, 0, 1.3)
            ramp = (ramp - middle) * rng.uniform(1.1, 1.9) + middle
        elif rng.random() < 0.08:  # dusk and night
            ramp = ramp * rng.uniform(0.15, 0.5)
        elif rng.random() < 0.25:
            ramp = ramp * (1 - (veil := rng.uniform(0.05, 0.4))) + veil
        table = np.clip(ramp * 255, 0, 255).astype(np.uint8)
        image = cv2.LUT(image, table[None])
    if rng.random() < 0.4:
        grey = cv2.cvtColor(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)
        keep = rng.uniform(0.25, 1.4)
        image = cv2.addWeighted(image, keep, grey, 1 - keep, 0)
    if rng.random() < 0.25:
        image = cv2.GaussianBlur(image, (0, 0), rng.uniform(0.4, 1.3))
    elif rng.random() < 0.1:
        length = int(rng.integers(3, 8))
        image = cv2.blur(image, (length, 1))
    if rng.random() < 0.4:
        noise = rng.integers(0, 255, (image.shape[0] // 2, image.shape[1], 3), dtype=np.uint8)
        noise, amount = np.concatenate((noise, noise[::-1]))[: image.shape[0]], rng.uniform(0.01, 0.14)
        image = cv2.addWeighted(image[: len(noise)], 1.0, noise, amount, -127 * amount)
    if rng.random() < 0.4:
        quality = [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(35, 95))]
        image = np.asarray(cv2.imdecode(cv2.imencode(".jpg", image, quality)[1], cv2.IMREAD_COLOR))
    return image


def make_sample(
    pick: Callable[[np.random.Generator], Layered],
    backgrounds: list[Layered],
    cutouts: dict[str, list[CutOut]],
    size: int,
    rng: np.random.Generator,
    large: bool = False,
) -> Sample:
    """One training sample: image (size, size, 3) BGR uint8, objects (N, 9), trust (N,) of their sides, fades (M, 5).

    large: of one image alone, its largest object large and rather in the middle, or with pasted objects of up to its size.
    """
    background, levels = backgrounds[int(rng.integers(len(backgrounds)))]
    canvas = cv2.resize(levels[2], (size, size), interpolation=cv2.INTER_LINEAR)  # no black where the warp leaves a gap
    objects, fades = warp_into(canvas, background, levels, (0, 0, size, size), rng)
    objects, cut = clip_boxes(objects, (0, 0, size, size))
    all_boxes, all_trust = [objects], [np.full(len(objects), SIDE_TRUST.get(background.source, 0.5))]
    all_fades = [fade_rows(cut), fades, untaught(background, (0, 0, size, size))]
    draw = rng.random()
    if (large and draw < 0.68) or draw < 0.38:
        areas = [(0, 0, size, size)]
    elif draw < 0.68:
        x, y = (int(v) for v in rng.integers(int(0.3 * size), int(0.7 * size), 2))
        areas = [(0, 0, x, y), (x, 0, size, y), (0, y, x, size), (x, y, size, size)]
    else:
        areas = []  # background with cut-outs only
    for area in areas:
        picture, levels = pick(rng)
        all_boxes, all_trust = uncovered(all_boxes, all_trust, area)
        boxes, fades = warp_into(canvas, picture, levels, area, rng, large)
        kept, faded = clip_boxes(boxes, area)
        all_boxes.append(kept)
        all_trust.append(np.full(len(kept), SIDE_TRUST.get(picture.source, 0.5) if picture.tight else 0.15))
        all_fades += [fade_rows(faded), clip_boxes(fades, area)[0], untaught(picture, area)]
    if rng.random() < 0.5:
        draw_furniture(canvas, rng)
    if not areas or rng.random() < 0.35:
        if rng.random() < 0.5:
            row = paste_row(canvas, one_of(cutouts, rng, STANDING), all_boxes, rng)
            all_boxes += row
            all_trust += [np.ones(len(box)) for box in row]
        for _ in range(int(rng.integers(1, 6))):
            height_px = float(np.exp(rng.uniform(*np.log(LARGE_PX)))) if large and rng.random() < 0.5 else None
            box = paste_cutout(canvas, one_of(cutouts, rng, CLASSES), np.concatenate(all_boxes), rng, height_px)
            all_boxes.append(box)
            all_trust.append(np.ones(len(box)))
    boxes, trust, fades = np.concatenate(all_boxes), np.concatenate(all_trust), np.concatenate(all_fades)
    hide_cones(canvas, boxes, rng)
    canvas = relight(canvas, rng)
    if rng.random() < 0.3:  # the image ends before the network's input does, which repeats its last row and column
        right, bottom = (size - rng.integers(0, PAD_PX, 2)).tolist()
        canvas[:, right:], canvas[bottom:] = canvas[:, right - 1 : right], canvas[bottom - 1 : bottom]
        area = (0, 0, right, bottom)
        kept, cut = clip_boxes(np.column_stack((boxes, trust)), area)
        boxes, trust, fades = kept[:, :9], kept[:, 9], np.concatenate((clip_boxes(fades, area)[0], fade_rows(cut)))
    return canvas, boxes, trust, fades


def one_of(cutouts: dict[str, list[CutOut]], rng: np.random.Generator, classes: Sequence[str]) -> CutOut:
    """A cone in half of the cases, else a thing of any of the other classes."""
    name = "traffic_cone" if rng.random() < 0.5 else str(rng.choice([name for name in classes if name in cutouts]))
    return cutouts[name][int(rng.integers(len(cutouts[name])))]


def uncovered(
    boxes: list[np.ndarray], trust: list[np.ndarray], area: tuple[int, int, int, int]
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Objects, and the trust of their sides, of which an image drawn into this area hides nothing or little."""
    every, trusts = np.concatenate(boxes), np.concatenate(trust)
    low, high = np.maximum(every[:, :2], area[:2]), np.minimum(every[:, 2:4], area[2:])
    hidden = np.clip(high - low, 0, None).prod(1) / np.maximum((every[:, 2:4] - every[:, :2]).prod(1), 1.0)
    return [every[hidden < 0.3]], [trusts[hidden < 0.3]]
