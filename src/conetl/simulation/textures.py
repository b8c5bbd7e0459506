"""Procedural colour textures as uint8 sRGB arrays (H, W, 3), varied by a seed: surfaces with enough texture for stereo matching,
and faces of signs, arrow boards and striped boards."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from conetl.model.arrays import Floats, Image
from conetl.model.markings import MarkingColour
from conetl.simulation.scenario import Colour, Cone, RoadMarking

Bytes = tuple[int, int, int]
_SIZE_PX = 256
WHITE = (235, 235, 230)
BLACK = (13, 13, 13)
RED = (199, 18, 20)
ORANGE = (245, 107, 15)
AMBER = (255, 199, 64)
YELLOW = (242, 194, 20)
BLUE = (20, 71, 158)
#: (y, z) of the corners of plates in shares of their size, from the middle of the lower edge.
DISC = np.column_stack([0.5 * np.cos(np.arange(36) * np.pi / 18), 0.5 + 0.5 * np.sin(np.arange(36) * np.pi / 18)])
TRIANGLE = np.array([(0.5, 0.0), (0.0, 1.0), (-0.5, 0.0)])
DIAMOND = np.array([(0.5, 0.5), (0.0, 1.0), (-0.5, 0.5), (0.0, 0.0)])
SQUARE = np.array([(0.5, 0.0), (0.5, 1.0), (-0.5, 1.0), (-0.5, 0.0)])


def _noise(rng: np.random.Generator, shape: tuple[int, int], sigma_px: float) -> Floats:
    """Smooth noise of mean 0 and standard deviation 1; tileable up to the resampling of coarse noise."""
    coarser = 1 << max(0, int(np.log2(max(sigma_px, 1.0) / 2.0)))
    small = max(shape[0] // coarser, 4), max(shape[1] // coarser, 4)
    field: NDArray[Any] = rng.standard_normal(small, dtype=np.float32)
    field = gaussian_filter(field, sigma_px / coarser, mode="wrap")
    if coarser > 1:
        field = np.asarray(cv2.resize(field, shape[::-1], interpolation=cv2.INTER_LINEAR))
    return np.asarray((field - field.mean()) / field.std())


def _to_bytes(srgb: Floats) -> Image:
    return np.asarray(np.clip(srgb, 0.0, 1.0) * 255.0 + 0.5).astype(np.uint8)


def asphalt(seed: int, mean: float) -> Image:
    """Grains, stains, patches and crack-like streaks; one tile covers about 12 m."""
    rng, shape = np.random.default_rng([seed, 1]), (1536, 1536)
    grey = mean + 0.055 * _noise(rng, shape, 0.7) + 0.035 * _noise(rng, shape, 4.0)
    grey += 0.022 * _noise(rng, shape, 30.0) + 0.012 * _noise(rng, shape, 120.0)
    spots = _noise(rng, shape, 2.5) > 3.0
    grey[spots] -= 0.12
    tint = np.array([1.0, 0.99, 0.96])
    return _to_bytes(grey[..., None] * tint)


def mottled(seed: int, colour: Colour, contrast: float, size: int = 768, grain_px: float = 1.5) -> Image:
    """A colour with fine and coarse mottling: grass, hedge, gravel, concrete."""
    rng = np.random.default_rng([seed, 2])
    fine, coarse = _noise(rng, (size, size), grain_px), _noise(rng, (size, size), 14 * grain_px)
    hue = _noise(rng, (size, size), 6 * grain_px)
    light = 1.0 + contrast * (0.7 * fine + 0.35 * coarse)
    shift = 1.0 + 0.12 * contrast * hue[..., None] * np.array([1.0, 0.2, -0.6])
    return _to_bytes(np.array(colour) * light[..., None] * shift)


PAINTS: dict[MarkingColour, Colour] = {
    "white": (0.84, 0.84, 0.81), "yellow": (0.86, 0.64, 0.12), "other": (0.20, 0.34, 0.72)
}  # fmt: skip


def paint(seed: int, marking: RoadMarking, asphalt_grey: float) -> Image:
    """Paint of a road marking, with the asphalt below it where it is worn."""
    image = mottled(seed, PAINTS[marking.colour], 0.10, size=256)
    if marking.worn:
        rng = np.random.default_rng([seed, 10])
        wear = _noise(rng, image.shape[:2], 1.2) + 0.8 * _noise(rng, image.shape[:2], 6.0)
        gone = wear > np.quantile(wear, 1.0 - marking.worn)
        image[gone] = mottled(seed + 1, (asphalt_grey, asphalt_grey, 0.97 * asphalt_grey), 0.14, size=256)[gone]
    return image


def slabs(seed: int) -> Image:
    """Paving slabs with joints."""
    size, count = 512, 6
    image = mottled(seed, (0.60, 0.59, 0.56), 0.10, size=size).astype(np.float64) / 255.0
    step = size // count
    rng = np.random.default_rng([seed, 3])
    for row in range(count):
        for column in range(count):
            image[row * step : (row + 1) * step, column * step : (column + 1) * step] *= rng.uniform(0.88, 1.08)
    for k in range(count):
        image[k * step : k * step + 3] *= 0.6
        image[:, k * step : k * step + 3] *= 0.6
    return _to_bytes(image)


def facade(seed: int, wall: Colour, columns: int) -> Image:
    """A house front with windows; image rows run from the roof down."""
    rng = np.random.default_rng([seed, 4])
    rows, cell = 2, 96
    image = mottled(seed, wall, 0.07, size=1024)[: rows * cell, :].astype(np.float64) / 255.0
    repeats = -(-columns * cell // image.shape[1])
    image = np.tile(image, (1, repeats, 1))[:, : columns * cell].copy()
    frame, glass = np.array([0.85, 0.84, 0.8]), np.array([0.16, 0.19, 0.23])
    for row in range(rows):
        for column in range(columns):
            top, left = row * cell + 22, column * cell + 26 + int(rng.integers(-3, 4))
            image[top : top + 52, left : left + 42] = frame
            image[top + 4 : top + 48, left + 4 : left + 19] = glass * rng.uniform(0.6, 1.8)
            image[top + 4 : top + 48, left + 23 : left + 38] = glass * rng.uniform(0.6, 1.8)
            if rng.random() < 0.4:
                image[top + 4 : top + 24, left + 4 : left + 38] = np.array([0.7, 0.68, 0.62])
    return _to_bytes(image)


def cone_skin(cone: Cone, seed: int) -> Image:
    """Colour of a cone's body: rows from the tip (first) to the plate (last), columns around it."""
    rng = np.random.default_rng([seed, 5])
    rows, columns = 192, 96
    skin = np.broadcast_to(np.array(cone.colour), (rows, columns, 3)).copy()
    bands = {0: (), 1: ((0.30, 0.52),), 2: ((0.16, 0.34), (0.50, 0.66))}[cone.band_count]
    for top, bottom in bands:
        skin[int(top * rows) : int(bottom * rows)] = (0.90, 0.90, 0.88)
    rough = 1.0 + 0.05 * _noise(rng, (rows, columns), 1.0) + 0.05 * _noise(rng, (rows, columns), 8.0)
    skin *= rough[..., None]
    height = np.linspace(0.0, 1.0, rows)[:, None]
    blotches = _noise(rng, (rows, columns), 5.0) + 0.6 * _noise(rng, (rows, columns), 1.5) + 1.2 * height - 0.6
    cover = np.clip(cone.dirt * (0.45 + 0.5 * blotches), 0.0, 0.9)[..., None]
    return _to_bytes(skin * (1.0 - cover) + np.array([0.20, 0.17, 0.13]) * cover)


def striped(colours: tuple[Colour, ...], seed: int) -> Image:
    """Rings of colour from top to bottom, for bollards and barriers."""
    rng, rows = np.random.default_rng([seed, 6]), 120
    image = np.zeros((rows, 32, 3))
    edges = np.linspace(0, rows, len(colours) + 1).astype(int)
    for colour, top, bottom in zip(colours, edges, edges[1:], strict=False):
        image[top:bottom] = colour
    return _to_bytes(image * (1.0 + 0.05 * _noise(rng, (rows, 32), 1.5))[..., None])


def round_sign(seed: int) -> Image:
    """A red ring on white with two dark bars that resemble digits."""
    rng = np.random.default_rng([seed, 7])
    axis = np.linspace(-1.0, 1.0, 128)
    xx, yy = np.meshgrid(axis, axis)
    radius = np.hypot(xx, yy)
    image = np.full((128, 128, 3), 0.92)
    image[radius > 0.72] = (0.80, 0.06, 0.08)
    for centre in (-0.25, 0.25):
        bar = (np.abs(xx - centre) < 0.14) & (np.abs(yy) < 0.36)
        hole = (np.abs(xx - centre) < 0.05) & (np.abs(yy) < rng.uniform(0.1, 0.26))
        image[bar & ~hole] = 0.05
    return _to_bytes(image)


def stripes(seed: int, colour: Colour, width_over_height: float, to_left: bool) -> Image:
    """A board with white stripes at 45 degrees, four to eight of each colour along its longer side."""
    rows = _SIZE_PX if width_over_height < 1 else round(_SIZE_PX / width_over_height)
    columns = min(round(rows * width_over_height), _SIZE_PX)
    v, u = np.mgrid[0:rows, 0:columns]
    period = max(rows, columns) / np.random.default_rng([seed, 11]).uniform(4.0, 6.0)
    first = ((u + (v if to_left else -v)) / period) % 1.0 < 0.5
    return _weathered(seed, np.where(first[..., None], 255.0 * np.array(colour), WHITE))


def diamond(seed: int) -> Image:
    """Orange with a black border and a symbol or words: a warning sign of road works in the US."""
    canvas = _filled(DIAMOND, BLACK, ORANGE, 0.90)
    rng = np.random.default_rng([seed, 12])
    if rng.random() < 0.5:
        _words(canvas, rng.choice([["ROAD", "WORK", "AHEAD"], ["RIGHT", "LANE", "CLOSED"]]).tolist(), BLACK, 0.55)
    else:
        _arrow(canvas, float(rng.uniform(0.0, 0.8)), BLACK)
    return _weathered(seed, canvas)


def work_triangle(seed: int) -> Image:
    """A white or yellow triangle with a red rim and a black figure: road works in Europe."""
    face = WHITE if seed % 2 else YELLOW
    canvas = _filled(TRIANGLE, RED, face, 0.68, middle=0.36)
    for (x, y), radius in (((0.42, 0.52), 0.05), ((0.44, 0.68), 0.08), ((0.62, 0.78), 0.09)):
        cv2.circle(canvas, _at(canvas, x, y), round(radius * len(canvas)), BLACK, -1, cv2.LINE_AA)
    cv2.line(canvas, _at(canvas, 0.44, 0.56), _at(canvas, 0.62, 0.78), BLACK, 9, cv2.LINE_AA)
    return _weathered(seed, canvas)


def warning_triangle(seed: int) -> Image:
    canvas = _filled(TRIANGLE, RED, WHITE, 0.68, middle=0.36)
    cv2.line(canvas, _at(canvas, 0.5, 0.42), _at(canvas, 0.5, 0.72), BLACK, 20, cv2.LINE_AA)
    cv2.circle(canvas, _at(canvas, 0.5, 0.82), 11, BLACK, -1, cv2.LINE_AA)
    return _weathered(seed, canvas)


def speed_disc(seed: int) -> Image:
    """A speed limit of Europe: black figures on white in a red ring."""
    canvas = _filled(DISC, RED, WHITE, 0.76)
    _words(canvas, [("30", "50", "60", "80")[seed % 4]], BLACK, 0.56)
    return _weathered(seed, canvas)


def mandatory_disc(seed: int) -> Image:
    canvas = _filled(DISC, WHITE, BLUE, 0.93)
    _arrow(canvas, 2.3 if seed % 2 else 0.0, WHITE)
    return _weathered(seed, canvas)


def rectangle(seed: int) -> Image:
    """A regulatory sign of the US: black words on white with a black border."""
    canvas = _filled(SQUARE, BLACK, WHITE, 0.92)
    texts = (["SPEED", "LIMIT", "45"], ["NO", "PARKING"], ["KEEP", "RIGHT"], ["SPEED", "LIMIT", "25"])
    _words(canvas, texts[seed % 4], BLACK, 0.8)
    return _weathered(seed, canvas)


def arrow_board(seed: int) -> Image:
    """Amber lamps that form an arrow on a dark board."""
    canvas = _filled(SQUARE, BLACK, (26, 26, 28), 0.95)
    way = -1 if seed % 2 else 1
    lamps = [(x, 0.5) for x in np.linspace(0.12, 0.88, 9)]
    lamps += [(0.5 + way * (0.38 - 0.09 * k), 0.5 + side * 0.14 * k) for k in (1, 2) for side in (-1, 1)]
    for x, y in lamps:
        # The board is twice as wide as it is high.
        cv2.ellipse(canvas, _at(canvas, x, y), (6, 12), 0, 0, 360, AMBER, -1, cv2.LINE_AA)
    return _weathered(seed, canvas)


FACES: dict[str, tuple[Floats, Callable[[int], Image]]] = {
    "diamond": (DIAMOND, diamond), "work_triangle": (TRIANGLE, work_triangle), "warning_triangle": (TRIANGLE, warning_triangle),
    "speed_disc": (DISC, speed_disc), "mandatory_disc": (DISC, mandatory_disc), "rectangle": (SQUARE, rectangle),
    "arrow_board": (SQUARE, arrow_board),
}  # fmt: skip
"""Outline and face by kind of plate."""


def _filled(outline: Floats, rim: Bytes, face: Bytes, share: float, middle: float = 0.5) -> Image:
    """The outline over the whole image in the rim's colour, and scaled about its middle in that of the face."""
    canvas = np.zeros((_SIZE_PX, _SIZE_PX, 3), np.uint8)
    canvas[:] = rim
    inner = (outline - [0.0, middle]) * share + [0.0, middle]
    corners = np.column_stack([0.5 - inner[:, 0], 1.0 - inner[:, 1]]) * (_SIZE_PX - 1)
    cv2.fillPoly(canvas, [np.rint(corners).astype(np.int32)], face, cv2.LINE_AA)
    return canvas


def _words(canvas: Image, words: list[str], colour: Bytes, share: float) -> None:
    """Centred lines of text within a share of the image's sides."""
    step = share * _SIZE_PX / len(words)
    for k, word in enumerate(words):
        (wide, high), _ = cv2.getTextSize(word, cv2.FONT_HERSHEY_SIMPLEX, 1.0, 2)
        size = min(share * _SIZE_PX / wide, 0.72 * step / high)
        y = _SIZE_PX / 2 + (k - (len(words) - 1) / 2) * step + size * high / 2
        at = round((_SIZE_PX - size * wide) / 2), round(y)
        thick = max(round(4 * size), 3)
        cv2.putText(canvas, word, at, cv2.FONT_HERSHEY_SIMPLEX, size, colour, thick, cv2.LINE_AA)


def _arrow(canvas: Image, turn_rad: float, colour: Bytes) -> None:
    way = 0.28 * np.array([np.sin(turn_rad), -np.cos(turn_rad)])
    cv2.arrowedLine(
        canvas, _at(canvas, *(0.5 - way)), _at(canvas, *(0.5 + way)), colour, 20, cv2.LINE_AA, tipLength=0.45
    )


def _at(canvas: Image, x: float, y: float) -> tuple[int, int]:
    return round(x * canvas.shape[1]), round(y * canvas.shape[0])


def _weathered(seed: int, canvas: Image | Floats) -> Image:
    """Dirt and an uneven coat."""
    rows, columns = canvas.shape[:2]
    coat = mottled(seed, (0.5, 0.5, 0.5), 0.08, size=_SIZE_PX)[:rows, :columns] / 128.0
    dull = np.random.default_rng([seed, 13]).uniform(0.82, 1.0)
    return np.asarray(np.clip(canvas * coat * dull + 0.5, 0.0, 255.0)).astype(np.uint8)
