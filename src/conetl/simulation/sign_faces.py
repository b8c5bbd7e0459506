"""Faces of signs, arrow boards and striped boards as uint8 sRGB arrays (H, W, 3), varied by a seed."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from conetl.simulation.scenario import Colour
from conetl.simulation.textures import Image, mottled

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


FACES: dict[str, tuple[NDArray[np.float64], Callable[[int], Image]]] = {
    "diamond": (DIAMOND, diamond), "work_triangle": (TRIANGLE, work_triangle), "warning_triangle": (TRIANGLE, warning_triangle),
    "speed_disc": (DISC, speed_disc), "mandatory_disc": (DISC, mandatory_disc), "rectangle": (SQUARE, rectangle),
    "arrow_board": (SQUARE, arrow_board),
}  # fmt: skip
"""Outline and face by kind of plate."""


def _filled(outline: NDArray[np.float64], rim: Bytes, face: Bytes, share: float, middle: float = 0.5) -> Image:
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


def _weathered(seed: int, canvas: Image | NDArray[np.float64]) -> Image:
    """Dirt and an uneven coat."""
    rows, columns = canvas.shape[:2]
    coat = mottled(seed, (0.5, 0.5, 0.5), 0.08, size=_SIZE_PX)[:rows, :columns] / 128.0
    dull = np.random.default_rng([seed, 13]).uniform(0.82, 1.0)
    return np.asarray(np.clip(canvas * coat * dull + 0.5, 0.0, 255.0)).astype(np.uint8)
