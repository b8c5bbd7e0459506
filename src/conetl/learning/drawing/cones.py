"""Cones drawn by formula: a shaded body of revolution with bands on a plate, seen from slightly above, with exact outline."""

from __future__ import annotations

import cv2
import numpy as np

from conetl.learning.drawing.cut_outs import CutOut

#: BGR. Oranges and reds, then lime, yellow and blue.
BODY_COLOURS = (
    (20, 80, 235), (25, 60, 220), (40, 45, 200), (30, 100, 245), (35, 35, 160), (60, 90, 215), (40, 120, 255),
    (30, 235, 205), (25, 200, 240), (170, 80, 30),
)  # fmt: skip
COLOUR_SHARES = (0.12, 0.12, 0.12, 0.12, 0.12, 0.12, 0.12, 0.08, 0.05, 0.03)
TALL_PX = 240


def draw_cone(rng: np.random.Generator) -> CutOut:
    """One random traffic cone as a trimmed cut-out about TALL_PX high.

    Of lying and stacked cones, foot and tip are NaN.
    """
    slim = rng.random() < 0.3  # a channelizer: hardly narrower at its top, with a handle, on a rubber plate
    slotted = not slim and rng.random() < 0.1  # a low sports cone of one colour with openings, on a thin ring
    foot_radius = rng.uniform(0.07, 0.13) if slim else rng.uniform(0.14, 0.30)  # all lengths in cone heights
    tip_radius = rng.uniform(0.03, 0.06) if slim else rng.uniform(0.025, 0.06)
    if slotted:
        foot_radius, tip_radius = rng.uniform(0.2, 0.45), rng.uniform(0.04, 0.14)
    look_down = rng.uniform(0.0, 0.32)  # sine of the camera's elevation over the cone
    plate = foot_radius * (rng.uniform(1.4, 2.4) if slim else rng.uniform(1.15, 1.5))
    thick = rng.uniform(0.005, 0.03) if slotted else rng.uniform(0.02, 0.07)
    rows, columns = int(TALL_PX * 1.6), int(TALL_PX * 1.2)
    v, u = np.mgrid[0:rows, 0:columns].astype(np.float32)
    x = (u - columns / 2) / TALL_PX
    y = (rows * 0.8 - v) / TALL_PX  # up, 0 at the centre of the plate's top
    lean = rng.normal(0, 0.03)
    x = x - lean * y
    radius = np.clip(foot_radius + (tip_radius - foot_radius) * y, tip_radius, None)
    up = y + look_down * np.sqrt(np.clip(radius**2 - x**2, 0, None))
    radius = foot_radius + (tip_radius - foot_radius) * np.clip(up, 0, 1)
    body = (np.abs(x) < radius) & (up > 0) & (up < 1)

    base, colour = banded(up, rng, None if not slotted else 0)
    turn = np.clip(x / np.maximum(radius, 1e-3), -1, 1)
    if slotted:
        body &= ~openings(up, turn, rng)
    light = rng.uniform(-1, 1)
    facing = np.clip(light * turn + np.sqrt(1 - light**2) * np.sqrt(1 - turn**2), 0, None)
    ambient = rng.uniform(0.25, 0.8)
    shade = ambient + (1.15 - ambient) * facing
    dirt = cv2.resize(rng.normal(1, rng.uniform(0, 0.16), (14, 10)).astype(np.float32), (columns, rows))
    colour = colour * (shade * dirt)[..., None]

    picture = np.zeros((rows, columns, 4), np.float32)
    black = rng.random() < (0.85 if slim else 0.5)
    plate_colour = np.full(3, rng.uniform(15, 60), np.float32) if black else base * rng.uniform(0.6, 1.0)
    middle, ground = columns / 2, rows * 0.8
    add_plate(picture, (middle, ground), (plate, look_down, thick), plate_colour * (ambient + 0.3), rng)
    picture[body, :3] = colour[body]
    picture[body, 3] = 255
    tip = np.array([middle + lean * TALL_PX, ground - TALL_PX])
    add_top(picture, tip, base * (ambient + 0.3), slim, rng)
    solid = np.clip(picture, 0, 255).astype(np.uint8)
    ends = np.array([middle, ground + thick * TALL_PX, *tip])
    other = rng.random()
    if other < 0.1:
        solid, ends = lying(solid, rng), np.full(4, np.nan)
    elif other < 0.15:
        solid, ends = stacked(solid, int(rng.integers(2, 5))), np.full(4, np.nan)
    ys, xs = np.nonzero(solid[..., 3])
    trimmed = solid[ys.min() : ys.max() + 1, xs.min() : xs.max() + 1]
    return CutOut(trimmed, ends=ends - np.tile((xs.min(), ys.min()), 2))


def openings(up: np.ndarray, turn: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Where a slotted cone lets its background through: rows of upright slots or round holes, even round its body."""
    around = np.arcsin(turn) / np.pi * rng.choice((4, 5, 6, 8)) + rng.uniform()
    rows = int(rng.integers(1, 4))
    level = (up - rng.uniform(0.1, 0.25)) / (0.6 / rows)
    wide, tall = rng.uniform(0.15, 0.32), rng.uniform(0.25, 0.42)
    inside = (((around % 1.0 - 0.5) / wide) ** 2 + ((level % 1.0 - 0.5) / tall) ** 2 < 1) & (level > 0) & (level < rows)
    return np.asarray(inside)


def banded(up: np.ndarray, rng: np.random.Generator, bands: int | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Colour of the body, BGR (3,), and of each pixel (h, w, 3), at the share `up` of the height.

    bands: number of white ones, None: up to three.
    """
    base = np.array(BODY_COLOURS[int(rng.choice(len(BODY_COLOURS), p=COLOUR_SHARES))], np.float32)
    base = base * rng.uniform(0.8, 1.15)
    white = np.float32(rng.uniform(150, 255)) * np.array([rng.uniform(0.92, 1.0), 0.98, 1.0], np.float32)
    colour = np.broadcast_to(base, (*up.shape, 3)).copy()
    kind = int(rng.choice(4, p=(0.2, 0.25, 0.4, 0.15))) if bands is None else bands
    edges = np.linspace(rng.uniform(0.12, 0.45), rng.uniform(0.7, 0.97), 2 * kind + 1) if kind else np.zeros(0)
    edges = edges + rng.normal(0, 0.015, len(edges))
    for band in range(kind):
        inside = (up > edges[2 * band]) & (up < edges[2 * band + 1])
        colour[inside] = white
    return base, colour


def add_plate(
    picture: np.ndarray,
    centre: tuple[float, float],
    shape: tuple[float, float, float],
    colour: np.ndarray,
    rng: np.random.Generator,
) -> None:
    """The square plate that a cone stands on. shape: half its side and its thickness in cone heights, the sine of the camera's
    elevation between them.
    """
    plate, look_down, thick = shape
    angle = rng.uniform(0, np.pi / 2) + np.arange(4) * np.pi / 2
    corners = np.stack((np.cos(angle), np.sin(angle) * look_down), 1) * plate * 1.25
    for drop, darkness in ((thick, 0.6), (0.0, 1.0)):
        points = (corners + np.array((0.0, drop))) * TALL_PX + centre
        hull = points if drop == 0 else np.concatenate((points, points - (0, thick * TALL_PX)))
        fill = (*(colour * darkness).tolist(), 255.0)
        cv2.fillConvexPoly(picture, cv2.convexHull(np.round(hull).astype(np.int32)), fill)


def add_top(picture: np.ndarray, tip: np.ndarray, colour: np.ndarray, slim: bool, rng: np.random.Generator) -> None:
    """A handle on channelizers, a lamp on some of the others."""
    at = (int(tip[0]), int(tip[1]))
    if slim and rng.random() < 0.8:
        size = (int(TALL_PX * rng.uniform(0.03, 0.06)), int(TALL_PX * rng.uniform(0.04, 0.08)))
        cv2.ellipse(picture, at, size, 0, 0, 360, (*colour.tolist(), 255.0), int(rng.integers(5, 11)))
    elif rng.random() < 0.06:
        radius = int(TALL_PX * rng.uniform(0.05, 0.1))
        cv2.circle(picture, (at[0], at[1] - radius // 2), radius, (30.0, rng.uniform(120, 200), 240.0, 255.0), -1)


def lying(solid: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """On its side: a cut-out turned by a quarter, more or less, within a square."""
    side = round(1.2 * max(solid.shape[:2]))
    angle = float(rng.choice((-1, 1)) * rng.normal(97, 8))
    matrix = cv2.getRotationMatrix2D((solid.shape[1] / 2, solid.shape[0] / 2), angle, 1.0)
    matrix[:, 2] += (side / 2 - solid.shape[1] / 2, side / 2 - solid.shape[0] / 2)
    return cv2.warpAffine(solid, matrix, (side, side))


def stacked(solid: np.ndarray, count: int) -> np.ndarray:
    """Cones put over each other: each a tenth of a height above the one below, and before it."""
    step = TALL_PX // 10
    pile = np.zeros((solid.shape[0] + step * (count - 1), *solid.shape[1:]), np.uint8)
    for number in range(count):
        above = step * (count - 1 - number)
        part = pile[above : above + len(solid)]
        np.copyto(part, solid, where=solid[..., 3:] > 0)
    return pile
