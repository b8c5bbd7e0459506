"""Road objects other than cones drawn by formula: striped boards, drums, markers, signs and arrow boards, with exact boxes."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from conetl.learning.drawing.cut_outs import CutOut

Colour = tuple[float, ...]
#: Longer side of a drawing in pixels.
SIZE_PX = 240
BLACK: Colour = (22, 22, 24)
POST_SHADES = ((150, 150, 150), (95, 98, 100), (60, 62, 66), (190, 195, 198), (60, 85, 120))
WORDS = (
    "ROAD", "WORK", "AHEAD", "LANE", "CLOSED", "DETOUR", "ONE", "WAY", "SPEED", "LIMIT", "NO", "PARKING", "KEEP", "RIGHT", "END",
    "EXIT", "SLOW", "25", "35", "45", "50", "STOP",
)  # fmt: skip


def draw_object(rng: np.random.Generator, category: str) -> CutOut:
    """One random object of a class other than the cone."""
    return DRAW[category](rng)


def _orange(rng: np.random.Generator, or_red: bool = True) -> Colour:
    colour = np.array((25, 95, 240)) * rng.uniform(0.65, 1.05) + rng.normal(0, 14, 3)
    if or_red and rng.random() < 0.15:
        colour = np.array((40, 40, 205)) * rng.uniform(0.7, 1.1)
    return tuple(np.clip(colour, 0, 255).tolist())


def _white(rng: np.random.Generator) -> Colour:
    return tuple((rng.uniform(165, 250) * np.array((rng.uniform(0.9, 1.0), 0.98, 1.0))).tolist())


def _stripes(width: int, height: int, first: Colour, second: Colour, rng: np.random.Generator) -> np.ndarray:
    """A board (h, w, 3) with stripes at 45 degrees, or now and then upright ones."""
    v, u = np.mgrid[0:height, 0:width].astype(np.float32)
    slope = rng.choice((-1.0, 1.0)) * rng.uniform(0.8, 1.2) if rng.random() < 0.92 else 0.0
    period = max(min(width, height) * rng.uniform(0.9, 1.9), 6.0)
    share = ((u + slope * v) / period + rng.uniform()) % 1.0
    return np.where(
        (share < rng.uniform(0.42, 0.58))[..., None], np.array(first, np.float32), np.array(second, np.float32)
    )


def _shaded(canvas: NDArray[np.float32], rng: np.random.Generator) -> NDArray[np.uint8]:
    """Dirt and uneven light over what is drawn."""
    rows, columns = canvas.shape[:2]
    light = rng.uniform(0.55, 1.15) + rng.uniform(-0.2, 0.2) * np.linspace(-1, 1, columns)[None, :]
    dirt = cv2.resize(rng.normal(1, rng.uniform(0, 0.12), (12, 12)).astype(np.float32), (columns, rows))
    canvas[..., :3] *= (light * dirt)[..., None]
    return np.clip(canvas, 0, 255).astype(np.uint8)


def _turned(canvas: np.ndarray, box: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Seen from the side: narrower, its horizontals inclined, slightly rolled; trimmed. box: corners (N, 2) of the labelled."""
    rows, columns = canvas.shape[:2]
    squeeze, shear, roll = rng.uniform(0.55, 1.0), rng.normal(0, 0.05), rng.normal(0, 0.03)
    linear = np.array([[squeeze, -roll], [shear * squeeze + roll, 1.0]])
    corners = np.array([(0, 0), (columns, 0), (0, rows), (columns, rows)]) @ linear.T
    low = corners.min(0)
    size = np.ceil(corners.max(0) - low).astype(int)
    moved = cv2.warpAffine(canvas, np.column_stack((linear, -low)), size.tolist(), flags=cv2.INTER_LINEAR)
    box = box @ linear.T - low
    ys, xs = np.nonzero(moved[..., 3] > 40)
    x0, y0 = xs.min(), ys.min()
    moved = moved[y0 : ys.max() + 1, x0 : xs.max() + 1]
    hull = np.concatenate((box.min(0), box.max(0))) - np.tile((x0, y0), 2)
    limits = np.tile(moved.shape[1::-1], 2)
    return moved, np.clip(hull, 0, limits)


def _standing(canvas: np.ndarray, category: str, rng: np.random.Generator) -> CutOut:
    """A thing that stands on the road and is labelled whole; its foot and tip are the middles of its lower and upper side."""
    rows, columns = canvas.shape[:2]
    whole = np.array([(0, 0), (columns, 0), (0, rows), (columns, rows)], float)
    image, _ = _turned(_shaded(canvas, rng), whole, rng)
    height, width = image.shape[:2]
    return CutOut(image, category, np.array([width / 2, height, width / 2, 0.0]))


def _fill(canvas: np.ndarray, x0: float, y0: float, x1: float, y1: float, colour: Colour) -> None:
    cv2.rectangle(canvas, (round(x0), round(y0)), (round(x1) - 1, round(y1) - 1), (*colour, 255.0), -1)


def _canvas(rows: float, columns: float) -> np.ndarray:
    return np.zeros((round(rows), round(columns), 4), np.float32)


def _draw_over(canvas: np.ndarray, drawn: np.ndarray) -> None:
    """Draw one image (h, w, 4) over another, at its upper edge and in its middle."""
    rows, columns = drawn.shape[:2]
    left = (canvas.shape[1] - columns) // 2
    np.copyto(canvas[:rows, left : left + columns], drawn, where=drawn[..., 3:] > 0)


def _round_body(
    height: int,
    low: float,
    top: float,
    bands: list[tuple[float, float, Colour]],
    base: Colour,
    rng: np.random.Generator,
) -> np.ndarray:
    """A body of revolution (h, w, 4): half widths at foot and top in px, bands as (from, to) shares of the height and colour."""
    columns = int(2 * max(low, top)) + 2
    look_down = rng.uniform(0.0, 0.3)
    v, u = np.mgrid[0:height, 0:columns].astype(np.float32)
    x = u + 0.5 - columns / 2
    share = 1 - (v + 0.5) / height
    half = low + (top - low) * share
    turn = np.clip(x / half, -1, 1)
    edge = look_down * half / height * np.sqrt(1 - turn**2)
    up = share + edge  # rings are ellipses
    canvas = _canvas(height, columns)
    canvas[..., :3] = base
    for start, end, colour in bands:
        canvas[(up >= start) & (up < end), :3] = colour
    light = rng.uniform(-0.8, 0.8)
    ambient = rng.uniform(0.45, 0.85)
    shade = ambient + (1.1 - ambient) * np.clip(light * turn + np.sqrt(1 - light**2) * np.sqrt(1 - turn**2), 0, 1)
    canvas[..., :3] *= shade[..., None]
    rim = look_down * half / height
    inside = (np.abs(x) <= half) & (share > -edge + rim) & (share < 1 - rim + edge)
    canvas[..., 3] = np.where(inside, 255.0, 0.0)
    canvas[(up > 1 - rim) & inside, :3] = np.array(base) * rng.uniform(0.8, 1.15)  # its lid
    return canvas


def _drum(rng: np.random.Generator) -> CutOut:
    height = SIZE_PX
    low = height * rng.uniform(0.24, 0.34)
    orange, white = _orange(rng), _white(rng)
    count = int(rng.choice((2, 2, 3, 4)))
    edges = np.linspace(rng.uniform(0.15, 0.3), rng.uniform(0.82, 0.95), 2 * count) + rng.normal(0, 0.01, 2 * count)
    bands = [(edges[2 * k], edges[2 * k + 1], white) for k in range(count)]
    body = _round_body(height, low, low * rng.uniform(0.72, 0.95), bands, orange, rng)
    base = round(height * rng.uniform(0.03, 0.08))
    wide = low * rng.uniform(1.05, 1.45)
    canvas = _canvas(height + base, 2 * wide + 4)
    dark = tuple(np.full(3, rng.uniform(18, 60)).tolist()) if rng.random() < 0.8 else orange
    _fill(canvas, canvas.shape[1] / 2 - wide, height - base / 2, canvas.shape[1] / 2 + wide, height + base, dark)
    _draw_over(canvas, body)
    return _standing(canvas, "drum", rng)


def _tubular_marker(rng: np.random.Generator) -> CutOut:
    height = SIZE_PX
    half = height * rng.uniform(0.03, 0.07)
    base = (  # red and white ones are bollards
        _orange(rng, or_red=False)
        if rng.random() < 0.6
        else ((30, 190, 235), (225, 225, 225), (40, 170, 90))[int(rng.integers(3))]
    )
    band = _white(rng) if rng.random() < 0.85 else (30, 200, 240)
    count = int(rng.integers(1, 4))
    start, bands = rng.uniform(0.5, 0.8), []
    for k in range(count):
        bands.append((start + 0.12 * k, start + 0.12 * k + rng.uniform(0.05, 0.1), band))
    body = _round_body(height, half, half * rng.uniform(0.85, 1.0), bands, base, rng)
    foot = half * rng.uniform(1.6, 3.2)
    thick = height * rng.uniform(0.02, 0.06)
    canvas = _canvas(height + thick, 2 * foot + 4)
    centre = (round(canvas.shape[1] / 2), round(height))
    cv2.ellipse(canvas, centre, (round(foot), round(thick)), 0, 0, 360, (*BLACK, 255.0), -1)
    _draw_over(canvas, body)
    return _standing(canvas, "tubular_marker", rng)


def _vertical_panel(rng: np.random.Generator) -> CutOut:
    height = SIZE_PX
    width = height * rng.uniform(0.22, 0.42)
    canvas = _canvas(height, width * 1.9)
    middle, gap = canvas.shape[1] / 2, height * rng.uniform(0.02, 0.18)
    _fill(
        canvas,
        middle - width * rng.uniform(0.5, 0.9),
        height * 0.95,
        middle + width * rng.uniform(0.5, 0.9),
        height,
        BLACK,
    )
    _fill(canvas, middle - width * 0.12, height * 0.5, middle + width * 0.12, height * 0.97, (70, 72, 75))
    left, top, bottom = round(middle - width / 2), 0, round(height * 0.95 - gap)
    board = _stripes(round(width), bottom - top, _orange(rng), _white(rng), rng)
    canvas[top:bottom, left : left + board.shape[1], :3] = board
    canvas[top:bottom, left : left + board.shape[1], 3] = 255
    return _standing(canvas, "vertical_panel", rng)


def _barricade(rng: np.random.Generator) -> CutOut:
    boards = int(rng.choice((1, 2, 3), p=(0.3, 0.25, 0.45)))
    width = SIZE_PX * rng.uniform(0.8, 1.3)
    height = width * rng.uniform(0.5, 1.1) / (1.0 if boards > 1 else 1.3)
    canvas = _canvas(height, width)
    leg = _white(rng) if rng.random() < 0.6 else (_orange(rng) if rng.random() < 0.4 else (90, 92, 96))
    thick = width * rng.uniform(0.025, 0.06)
    inset = width * rng.uniform(0.04, 0.2)
    for x in (inset, width - inset):
        spread = width * rng.uniform(0.0, 0.12)  # A-frames
        for end in (x - spread, x + spread):
            cv2.line(canvas, (round(x), 0), (round(end), round(height)), (*leg, 255.0), max(round(thick), 2))
    first, second = _orange(rng), _white(rng)
    broad = height * rng.uniform(0.13, 0.24) if boards > 1 else height * rng.uniform(0.25, 0.4)
    tops = np.linspace(0, height * rng.uniform(0.5, 0.75), boards) if boards > 1 else [0.0]
    for top in tops:
        board = _stripes(round(width), round(broad), first, second, rng)
        y = round(top)
        canvas[y : y + len(board), :, :3] = board[: canvas.shape[0] - y, : canvas.shape[1]]
        canvas[y : y + len(board), :, 3] = 255
    return _standing(canvas, "barricade", rng)


def _symbol(plate: np.ndarray, colour: Colour, rng: np.random.Generator) -> None:
    """Words, an arrow or a few strokes in the middle of a plate (h, w, 4)."""
    rows, columns = plate.shape[:2]
    drawn, kind = np.zeros((rows, columns), np.uint8), rng.random()
    if kind < 0.5:
        lines = int(rng.integers(1, 4))
        for k in range(lines):
            word = str(rng.choice(WORDS))
            size = min(columns * 0.6 / (18 * len(word)), rows * 0.55 / (28 * lines))
            (wide, _), _ = cv2.getTextSize(word, 0, size, 1)
            at = round((columns - wide) / 2), round(rows * (0.5 + (k - (lines - 1) / 2) * 0.6 / lines) + 10 * size)
            cv2.putText(drawn, word, at, 0, size, 255, max(round(size * 4), 1), cv2.LINE_AA)
    elif kind < 0.8:
        angle = rng.choice((0, np.pi / 2, -np.pi / 2, np.pi, 0.7, -0.7))
        way = 0.3 * min(rows, columns) * np.array((np.sin(angle), -np.cos(angle)))
        start, end = (np.round((columns / 2, rows / 2) + sign * way).astype(int).tolist() for sign in (-1, 1))
        thick = max(round(min(rows, columns) * rng.uniform(0.05, 0.12)), 2)
        cv2.arrowedLine(drawn, start, end, 255, thick, cv2.LINE_AA, tipLength=0.45)
    else:
        points = rng.normal(0.5, 0.13, (int(rng.integers(3, 7)), 1, 2)) * (columns, rows)
        cv2.polylines(drawn, [points.astype(np.int32)], False, 255, max(round(rows * 0.06), 2), cv2.LINE_AA)
    share = drawn[..., None] / np.float32(255)
    plate[..., :3] = share * np.array(colour, np.float32) + (1 - share) * plate[..., :3]


def _plate(
    outline: np.ndarray, size: tuple[float, float], face: Colour, rim: Colour | None, rng: np.random.Generator
) -> np.ndarray:
    """A plate (h, w, 4) of an outline (N, 2) in shares of its size (w, h), its rim in another colour."""
    plate = _canvas(size[1], size[0])
    points = np.round(outline * (plate.shape[1] - 1, plate.shape[0] - 1)).astype(np.int32)
    cv2.fillPoly(plate, [points], (*(rim or face), 255.0))
    if rim is not None:
        middle = outline.mean(0)
        inner = (outline - middle) * (
            rng.uniform(0.58, 0.84) if len(outline) == 3 else rng.uniform(0.82, 0.94)
        ) + middle
        points = np.round(inner * (plate.shape[1] - 1, plate.shape[0] - 1)).astype(np.int32)
        cv2.fillPoly(plate, [points], (*face, 255.0))
    return plate


def _on_post(plate: np.ndarray, category: str, rng: np.random.Generator) -> CutOut:
    """A plate on a post or a stand, of which the plate alone is labelled."""
    rows, columns = plate.shape[:2]
    below = rows * rng.uniform(0.0, 1.6)
    canvas = _canvas(rows + below, columns)
    if rng.random() < 0.85:
        half = columns * rng.uniform(0.02, 0.05)
        _fill(
            canvas, columns / 2 - half, rows * 0.8, columns / 2 + half, rows + below, POST_SHADES[int(rng.integers(5))]
        )
    _draw_over(canvas, plate)
    solid = plate[..., 3] > 0
    ys, xs = np.nonzero(solid)
    edge = cv2.convexHull(np.column_stack((xs, ys)).astype(np.int32))[:, 0].astype(float)
    edge = np.concatenate((edge, edge + 1))
    image, box = _turned(_shaded(canvas, rng), edge, rng)
    return CutOut(image, category, box=box)


SQUARE = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], float)
DIAMOND = np.array([(0.5, 0), (1, 0.5), (0.5, 1), (0, 0.5)])
TRIANGLE = np.array([(0.5, 0), (1, 1), (0, 1)])


def _polygon(corners: int) -> NDArray[np.float64]:
    angle = (np.arange(corners) + 0.5) * 2 * np.pi / corners
    points = np.column_stack((np.sin(angle), np.cos(angle)))
    return np.asarray((points - points.min(0)) / (points.max(0) - points.min(0)))


def _man_at_work(plate: np.ndarray, rng: np.random.Generator) -> None:
    """The figure of sign A, 15 of the Vienna Convention in the lower middle of a triangle (h, w, 4): a man with a shovel."""
    rows, columns = plate.shape[:2]
    drawn = np.zeros((rows, columns), np.uint8)
    wide = 0.22 * columns * rng.uniform(0.8, 1.1)
    thick = max(round(wide * rng.uniform(0.18, 0.3)), 1)

    def at(x: float, y: float) -> tuple[int, int]:
        """From the figure's middle, to the right and down, in shares of half its width."""
        return round(columns / 2 + way * x * wide), round(rows * 0.68 + y * wide)

    way = rng.choice((-1, 1))
    head, hip, hand = (-0.25, -1.0), (-0.55 + rng.normal(0, 0.05), -0.1), (0.3, -0.15 + rng.normal(0, 0.08))
    cv2.circle(drawn, at(*head), max(round(0.2 * wide), 1), 255, -1, cv2.LINE_AA)
    for one, other, width in (
        ((-0.35, -0.7), hip, 1.5), ((-0.35, -0.65), hand, 0.9), (hip, (-0.9, 0.75), 1.1), (hip, (-0.25, 0.75), 1.1),
        ((-0.1, -0.45), (0.75, 0.45), 0.5),
    ):  # fmt: skip
        cv2.line(drawn, at(*one), at(*other), 255, max(round(width * thick), 1), cv2.LINE_AA)
    cv2.ellipse(drawn, at(0.75, 0.8), (round(0.45 * wide), round(0.45 * wide)), 0, 180, 360, 255, -1, cv2.LINE_AA)
    share = drawn[..., None] / np.float32(255)
    plate[..., :3] = share * np.array(BLACK, np.float32) + (1 - share) * plate[..., :3]


def _work_zone_sign(rng: np.random.Generator) -> CutOut:
    orange = _orange(rng) if rng.random() < 0.93 else (170.0, 90.0, 235.0)
    side = SIZE_PX * 0.8
    if rng.random() < 0.35:
        face = (20.0, 195.0, 245.0) if rng.random() < 0.35 else _white(rng)
        plate = _plate(TRIANGLE, (side, side * rng.uniform(0.85, 1.0)), face, (35, 30, 190), rng)
        _man_at_work(plate, rng)
        return _on_post(plate, "work_zone_sign", rng)
    if rng.random() < 0.6:
        plate = _plate(DIAMOND, (side, side), orange, BLACK if rng.random() < 0.5 else None, rng)
    else:
        tall = side * rng.uniform(0.35, 1.3)
        face = orange if rng.random() < 0.75 else _white(rng)
        plate = _plate(SQUARE, (side, tall), face, BLACK if rng.random() < 0.6 else None, rng)
        if face != orange:  # a white one on an orange stand
            _symbol(plate, BLACK, rng)
            stand = _canvas(plate.shape[0] * 1.5, plate.shape[1])
            _fill(stand, 0, plate.shape[0], plate.shape[1], stand.shape[0], orange)
            stand[: plate.shape[0]] = plate
            box = np.array([(0, 0), (plate.shape[1], 0), (0, plate.shape[0]), plate.shape[1::-1]], float)
            image, box = _turned(_shaded(stand, rng), box, rng)
            return CutOut(image, "work_zone_sign", box=box)
    _symbol(plate, BLACK, rng)
    return _on_post(plate, "work_zone_sign", rng)


def _arrow_board(rng: np.random.Generator) -> CutOut:
    width, height = SIZE_PX, SIZE_PX * rng.uniform(0.45, 0.65)
    dark = tuple(np.full(3, rng.uniform(15, 60)).tolist())
    plate = _plate(SQUARE, (width, height), dark, _orange(rng) if rng.random() < 0.5 else dark, rng)
    lit = (rng.uniform(60, 160), rng.uniform(190, 235), 255.0) if rng.random() < 0.7 else (90.0, 100.0, 105.0)
    if rng.random() < 0.75:
        radius = height * rng.uniform(0.035, 0.06)
        head = rng.choice((-1, 1, 0))
        for x in np.linspace(0.1, 0.9, 7):
            cv2.circle(plate, (round(x * width), round(height / 2)), round(radius), (*lit, 255.0), -1)
        for way in (-1, 1):
            for k in range(1, 4):
                if head in (0, way):
                    x = 0.5 + way * (0.4 - 0.1 * k)
                    for side in (-1, 1):
                        at = (round(x * width), round(height * (0.5 + side * 0.12 * k)))
                        cv2.circle(plate, at, round(radius), (*lit, 255.0), -1)
    else:
        _symbol(plate, lit, rng)
    return _on_post(plate, "arrow_board", rng)


def _traffic_sign(rng: np.random.Generator) -> CutOut:
    red, yellow, blue, green = (35, 30, 190), (20, 195, 245), (150, 80, 20), (70, 110, 0)
    white, side = _white(rng), SIZE_PX * 0.8
    kind = int(rng.choice(8, p=(0.16, 0.12, 0.1, 0.16, 0.24, 0.08, 0.06, 0.08)))
    disc = _polygon(32)
    faces: tuple[tuple[np.ndarray, float, Colour, Colour | None, Colour], ...] = (
        (_polygon(8), 1.0, red, white, white),  # stop
        (disc, 1.0, white, red, BLACK),  # speed limit, prohibition
        (
            TRIANGLE if rng.random() < 0.7 else 1 - TRIANGLE,
            rng.uniform(0.85, 1.0),
            white,
            red,
            BLACK,
        ),  # warning, give way
        (DIAMOND, 1.0, yellow if rng.random() < 0.7 else (20, 240, 190), BLACK, BLACK),
        (SQUARE, rng.uniform(0.8, 1.7), white, BLACK if rng.random() < 0.7 else red, BLACK),
        (disc if rng.random() < 0.5 else SQUARE, rng.uniform(0.9, 1.3), blue, white, white),
        (SQUARE, rng.uniform(0.3, 0.8), green, white, white),
        (SQUARE, rng.uniform(0.3, 0.5), BLACK, white, white),  # one way
    )
    outline, tall, face, rim, ink = faces[kind]
    plate = _plate(outline, (side, side * tall), face, rim, rng)
    _symbol(plate, ink, rng)
    return _on_post(plate, "traffic_sign", rng)


DRAW: dict[str, Callable[[np.random.Generator], CutOut]] = {
    "tubular_marker": _tubular_marker,
    "drum": _drum,
    "vertical_panel": _vertical_panel,
    "barricade": _barricade,
    "work_zone_sign": _work_zone_sign,
    "arrow_board": _arrow_board,
    "traffic_sign": _traffic_sign,
}
