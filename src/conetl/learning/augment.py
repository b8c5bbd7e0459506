"""Training samples: scale, stretch, paste, hide, blur and relight images; boxes always follow the geometry.

Objects are (N, 9) as in `images.py`, fades (M, 5) [x0, y0, x1, y1, sum of 2**class] as in `loss.py`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import cv2
import numpy as np

from conetl.learning.classes import ALL_CLASSES, CLASSES, EVERY_SIZE
from conetl.learning.drawing.cut_outs import CutOut
from conetl.learning.drawing.distractors import draw_furniture, hide_cones
from conetl.learning.images import LabelledImage

MIN_CONE_PX = 7.0  # below this a labelled cone is neither taught nor forbidden
PAD_PX = 32
#: Heights of the largest object in samples for large ones.
LARGE_PX = (180.0, 480.0)
#: Things that stand on the road, in rows.
STANDING = ("traffic_cone", "tubular_marker", "drum", "vertical_panel", "barricade")
Sample = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
#: An image and its `pyramid`.
Layered = tuple[LabelledImage, list[np.ndarray]]


def pyramid(image: np.ndarray) -> list[np.ndarray]:
    """Full, half and quarter size, so that shrinking by a warp does not alias."""
    half = cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    return [image, half, cv2.resize(half, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)]


def choose_scale(picture: LabelledImage, rng: np.random.Generator, large: bool) -> tuple[float, np.ndarray | None]:
    """Scale that brings one randomly chosen box to a height drawn log-uniformly, most of them small; and that box (4,)."""
    if large and len(picture.boxes):
        box = picture.boxes[int(np.argmax(picture.boxes[:, 3] - picture.boxes[:, 1])), :4]
        return float(np.clip(np.exp(rng.uniform(*np.log(LARGE_PX))) / (box[3] - box[1]), 0.05, 3.0)), box
    if len(picture.false) and not (picture.judged_only and len(picture.boxes) and rng.random() < 0.5):
        box, as_seen = picture.false[int(rng.integers(len(picture.false)))], rng.random() < 0.5
    elif len(picture.boxes) == 0:
        return float(np.exp(rng.uniform(np.log(0.35), np.log(1.3)))), None
    elif picture.sizes == "rendered":
        box = picture.boxes[int(rng.integers(len(picture.boxes))), :4]
        return float(rng.choice((1.0, rng.uniform(0.7, 1.4)))), box
    else:
        classes = picture.boxes[:, 8]
        # no class is drowned by the others
        one = 0 if 0 in classes and rng.random() < 0.5 else rng.choice(np.unique(classes))
        box = picture.boxes[int(rng.choice(np.flatnonzero(classes == one))), :4]
        as_seen = picture.sizes == "as seen" and rng.random() < 0.5
    if as_seen:
        return float(rng.uniform(0.85, 1.25)), box
    low, high = (11.0, 64.0) if rng.random() < 0.62 else (50.0, 330.0)
    target = float(np.exp(rng.uniform(np.log(low), np.log(high))))
    return float(np.clip(target / (box[3] - box[1]), 0.05, 2.2)), box


def warp_into(
    canvas: np.ndarray,
    picture: LabelledImage,
    levels: list[np.ndarray],
    area: tuple[int, int, int, int],
    rng: np.random.Generator,
    large: bool = False,
) -> tuple[np.ndarray, np.ndarray]:
    """Draw an image, scaled, stretched, mirrored, slightly turned, into `area` of the canvas; boxes and fades there."""
    left, top, right, bottom = area
    stretch = float(rng.uniform(*picture.stretch))
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

    fades = fade_rows(
        follow(picture.fade, np.zeros(len(picture.fade))), EVERY_SIZE if picture.judged_only else ALL_CLASSES
    )
    return follow(picture.boxes, picture.boxes[:, 8] == 0), clip_regions(fades, area)


def fade_rows(boxes: np.ndarray, classes: int = ALL_CLASSES) -> np.ndarray:
    """Boxes (M, 4) as fades (M, 5) of these classes."""
    return np.column_stack((boxes, np.full(len(boxes), float(classes))))


def untaught(picture: LabelledImage, area: tuple[int, int, int, int]) -> np.ndarray:
    """The classes that are not labelled in an image, as a fade of the whole area (0 or 1, 5)."""
    classes = sum(2**k for k, name in enumerate(CLASSES) if name not in picture.taught)
    return fade_rows(np.array([area] if classes else []).reshape(-1, 4), classes)


def clip_regions(regions: np.ndarray, area: tuple[int, int, int, int]) -> np.ndarray:
    """Regions (M, 4 or more) as far as they lie in an area, without those that do not."""
    left, top, right, bottom = area
    cut = regions.copy()
    cut[:, :4] = np.clip(cut[:, :4], (left, top, left, top), (right, bottom, right, bottom))
    return np.asarray(cut[(cut[:, 2:4] > cut[:, :2]).all(1)])


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
    all_boxes, all_trust = [objects], [np.full(len(objects), background.trust)]
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
        all_trust.append(np.full(len(kept), picture.trust if picture.tight else 0.15))
        all_fades += [fade_rows(faded), fades, untaught(picture, area)]
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
        boxes, trust, fades = kept[:, :9], kept[:, 9], np.concatenate((clip_regions(fades, area), fade_rows(cut)))
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
