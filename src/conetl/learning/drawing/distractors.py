"""Things drawn into training samples that are of no class, or stand before an object: posts, lamps, cars, panels, rails."""

from __future__ import annotations

import cv2
import numpy as np


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
