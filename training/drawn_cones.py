"""Cones drawn by formula: a shaded body of revolution with bands on a plate, seen from slightly above, with exact outline."""

from __future__ import annotations

import cv2
import numpy as np

BODY_COLOURS = ((20, 80, 235), (25, 60, 220), (40, 45, 200), (30, 100, 245), (35, 35, 160), (60, 90, 215))
TALL_PX = 240


def draw_cone(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """One random traffic cone as a trimmed cut-out (h, w, 4) BGRA uint8, about TALL_PX high, and its foot and tip (4,) px."""
    foot_radius = rng.uniform(0.16, 0.30)  # all lengths in cone heights
    tip_radius = rng.uniform(0.025, 0.06)
    look_down = rng.uniform(0.0, 0.32)  # sine of the camera's elevation over the cone
    plate = foot_radius * rng.uniform(1.15, 1.5)
    thick = rng.uniform(0.02, 0.07)
    rows, columns = int(TALL_PX * 1.5), int(TALL_PX * 1.2)
    v, u = np.mgrid[0:rows, 0:columns].astype(np.float32)
    x = (u - columns / 2) / TALL_PX
    y = (rows * 0.8 - v) / TALL_PX  # up, 0 at the centre of the plate's top
    lean = rng.normal(0, 0.03)
    x = x - lean * y
    radius = np.clip(foot_radius + (tip_radius - foot_radius) * y, tip_radius, None)
    up = y + look_down * np.sqrt(np.clip(radius**2 - x**2, 0, None))
    radius = foot_radius + (tip_radius - foot_radius) * np.clip(up, 0, 1)
    body = (np.abs(x) < radius) & (up > 0) & (up < 1)

    base = np.array(BODY_COLOURS[int(rng.integers(len(BODY_COLOURS)))], np.float32) * rng.uniform(0.8, 1.15)
    white = np.float32(rng.uniform(170, 255)) * np.array([rng.uniform(0.92, 1.0), 0.98, 1.0], np.float32)
    colour = np.broadcast_to(base, (rows, columns, 3)).copy()
    kind = int(rng.choice(4, p=(0.1, 0.25, 0.45, 0.2)))  # number of white bands
    edges = np.linspace(rng.uniform(0.12, 0.35), rng.uniform(0.75, 0.97), 2 * kind + 1) if kind else np.zeros(0)
    edges = edges + rng.normal(0, 0.015, len(edges))
    for band in range(kind):
        inside = (up > edges[2 * band]) & (up < edges[2 * band + 1])
        colour[inside] = white
    turn = np.clip(x / np.maximum(radius, 1e-3), -1, 1)
    light = rng.uniform(-1, 1)
    facing = np.clip(light * turn + np.sqrt(1 - light**2) * np.sqrt(1 - turn**2), 0, None)
    ambient = rng.uniform(0.25, 0.8)
    shade = ambient + (1.15 - ambient) * facing
    dirt = cv2.resize(rng.normal(1, rng.uniform(0, 0.16), (14, 10)).astype(np.float32), (columns, rows))
    colour = colour * (shade * dirt)[..., None]

    picture = np.zeros((rows, columns, 4), np.float32)
    angle = rng.uniform(0, np.pi / 2) + np.arange(4) * np.pi / 2
    corners = np.stack((np.cos(angle) * plate * 1.25, np.sin(angle) * plate * 1.25 * look_down), 1)
    plate_colour = base * rng.uniform(0.6, 1.0) if rng.random() < 0.5 else np.full(3, rng.uniform(15, 60), np.float32)
    for drop, darkness in ((thick, 0.6), (0.0, 1.0)):
        points = np.stack((corners[:, 0] * TALL_PX + columns / 2, rows * 0.8 + (corners[:, 1] + drop) * TALL_PX), 1)
        hull = points if drop == 0 else np.concatenate((points, points - (0, thick * TALL_PX)))
        fill = (*(plate_colour * darkness * (ambient + 0.3)).tolist(), 255.0)
        cv2.fillConvexPoly(picture, cv2.convexHull(np.round(hull).astype(np.int32)), fill)
    picture[body, :3] = colour[body]
    picture[body, 3] = 255
    solid = np.clip(picture, 0, 255).astype(np.uint8)
    ys, xs = np.nonzero(solid[..., 3])
    middle, ground = columns / 2, rows * 0.8
    ends = np.array([middle, ground + thick * TALL_PX, middle + lean * TALL_PX, ground - TALL_PX])
    return solid[ys.min() : ys.max() + 1, xs.min() : xs.max() + 1], ends - np.tile((xs.min(), ys.min()), 2)
