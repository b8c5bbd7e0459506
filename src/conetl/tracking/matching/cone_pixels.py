"""Pixels of the left image used to match a cone: its body, its edges, and the background beside them, with their depths.

Depth is that of the visible surface of a standing cone, from its outline, up to scale. A plane through each edge of the outline
and the projection centre touches the cone. The plane midway between both contains the axis, upright through the foot's row. The
circular cone about that axis that touches both planes is unique up to its size, the unknown of the matching; so the depth of the
axis at the foot is 1. Each pixel's ray meets that cone in a quadratic equation; nothing is linearised.

`SplinePatch` is a part of an image, blurred and interpolated by cubic B-splines (Unser 1999). The grey values themselves are the
coefficients: that blurs by 0.58 px (sigma) at every sub-pixel position alike. An interpolating spline passes all noise at whole
pixels and half of it between them, which biases matching towards half pixels.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from conetl.model.arrays import Bools, Floats, Image, Ints
from conetl.model.rig import Camera
from conetl.tracking.matching.cone_outline import Outline

_MIN_PIXELS = 24
_MAX_PIXELS = 1200
#: Used rows of the body, as shares from tip to foot; the base plate is not at the axis.
_ROWS = (0.02, 0.90)
#: Width of the edge inside the outline, and of the margin outside: shares of the radius at the foot, limited in pixels. A far
#: cone would otherwise be all edge, half of it background.
_EDGE_SHARE, _OUT_SHARE = 0.1, 0.075
_EDGE_PX, _OUT_PX = (1.0, 2.0), (1.0, 1.5)
#: Blur (sigma) of an edge by lens, sensor and the smoothing here, and distances at which only background is visible.
_BLUR_PX = 0.85
_BEYOND_PX = np.array([2.0, 3.0])


class BodyPixels(NamedTuple):
    """The used pixels of the left image; n of them. Of flat objects (`plate_pixels.py`) without edges and background."""

    rows: Ints
    """(n,) rows in the image"""
    columns: Ints
    values: Floats
    """(n, channels) grey values"""
    slopes: Floats
    """(2, n, channels) of the grey values along columns and rows"""
    depth: Floats
    """(n,) of the visible surface, in units of the depth of the axis at the foot"""
    nearer: Floats
    """(n,) depth of the limb less that of the surface, in the same units; 0 at the edges"""
    height: Floats
    """(n,) above the foot, in the same units"""
    at_edge: Floats
    """(n, 2) 1 for pixels of the left, of the right edge"""
    edge: Ints
    """(n,) number of the edge next to a pixel: one row, left or right of the axis"""
    cover: Floats
    """(n,) share of the background in the grey value"""
    beyond: Beyond


class Beyond(NamedTuple):
    """Background just beyond the blur of the edges: e edges, two points each."""

    rows: Ints
    """(2e,)"""
    columns: Floats
    depth: Floats
    """(2e,) of the edge: the right image is sampled beside the same edge"""
    values: Floats
    """(e, 2, channels) grey values in the left image"""


def cone_pixels(left: Image, outline: Outline, camera: Camera, up: Floats) -> BodyPixels | None:
    """The pixels inside the outline, with the disparity surface over them; None if there are too few pixels."""
    height = outline.foot_row - outline.tip_row
    first = max(int(np.ceil(outline.tip_row + _ROWS[0] * height)), 0)
    last = min(int(np.floor(outline.tip_row + _ROWS[1] * height)), left.shape[0] - 1)
    if last - first < 4:
        return None
    v = np.arange(first, last + 1)
    axis, radius = outline.axis(v.astype(np.float64)), outline.radius(v.astype(np.float64))
    widest = float(outline.radius(np.array([outline.foot_row]))[0])
    edge_px, out_px = float(np.clip(_EDGE_SHARE * widest, *_EDGE_PX)), float(np.clip(_OUT_SHARE * widest, *_OUT_PX))
    low = max(int(np.floor((axis - radius).min() - out_px)), 0)
    high = min(int(np.ceil((axis + radius).max() + out_px)), left.shape[1] - 1)
    u = np.arange(low, high + 1)
    aside = u[None, :] - axis[:, None]
    inside = np.abs(aside) <= radius[:, None] + out_px
    chosen = some_rows(inside)
    if chosen is None:
        return None
    i, j = chosen
    surface = _cone_surface(outline, camera, up, v[i].astype(np.float64), u[j].astype(np.float64))
    if surface is None:
        return None
    depth, limb, above_foot = surface
    # At the edge the blurred outline is visible, not the surface.
    inner = radius[i] - np.abs(aside[i, j]) > edge_px
    nearer = (limb - depth) * inner
    values, *slopes = (part[i, j] for part in smooth(left, v, u))
    right_half = aside[i, j] > 0
    cover = ndtr((np.abs(aside[i, j]) - radius[i]) / _BLUR_PX)
    beyond = _beyond(left, outline, camera, up, v)
    if beyond is None:
        return None
    at_edge = ~inner[:, None] & (right_half[:, None] == np.array([False, True]))
    return BodyPixels(
        v[i], u[j], values, np.stack(slopes), limb - nearer, nearer, above_foot, at_edge.astype(np.float64),
        2 * i + right_half, cover, beyond,
    )  # fmt: skip


def some_rows(inside: Bools) -> tuple[Ints, Ints] | None:
    """Rows and columns of the pixels in a mask, of a large one in every so many rows alone; None if there are too few."""
    every = max(int(np.ceil(inside.sum() / _MAX_PIXELS)), 1)
    inside[np.arange(len(inside)) % every != 0] = False  # neighbouring rows of a near object are redundant
    rows, columns = np.nonzero(inside)
    return None if len(rows) < _MIN_PIXELS else (rows, columns)


def _beyond(left: Image, outline: Outline, camera: Camera, up: Floats, rows: Ints) -> Beyond | None:
    """Background beside both edges of every row; None if it is outside the image."""
    y = rows.astype(np.float64)
    axis, radius = outline.axis(y), outline.radius(y)
    columns = axis[:, None, None] + np.array([-1.0, 1.0])[None, :, None] * (radius[:, None, None] + _BEYOND_PX)
    columns, y = columns.ravel(), np.repeat(y, 2 * len(_BEYOND_PX))
    surface = _cone_surface(outline, camera, up, y, columns)
    patch = SplinePatch.of(left, rows[0], rows[-1], columns.min(), columns.max())
    if surface is None or patch is None:
        return None
    v = np.repeat(rows, 2 * len(_BEYOND_PX))
    values = patch.at(v, columns, 0.0)[0]
    return Beyond(v, columns, surface[1], values.reshape(-1, len(_BEYOND_PX), values.shape[1]))


def smooth(image: Image, rows: Ints, columns: Ints) -> tuple[Floats, Floats, Floats]:
    """Grey values (rows, columns, channels) blurred like `SplinePatch` at whole pixels, and their slopes along columns and
    rows."""
    top = np.clip(np.arange(rows[0] - 1, rows[-1] + 2), 0, image.shape[0] - 1)
    aside = np.clip(np.arange(columns[0] - 1, columns[-1] + 2), 0, image.shape[1] - 1)
    part = image[top[:, None], aside].astype(np.float64)
    blurred, down = (part[:-2] + 4 * part[1:-1] + part[2:]) / 6, (part[2:] - part[:-2]) / 2
    return (
        np.asarray((blurred[:, :-2] + 4 * blurred[:, 1:-1] + blurred[:, 2:]) / 6),
        np.asarray((blurred[:, 2:] - blurred[:, :-2]) / 2),
        np.asarray((down[:, :-2] + 4 * down[:, 1:-1] + down[:, 2:]) / 6),
    )


def _cone_surface(
    outline: Outline, camera: Camera, up: Floats, rows: Floats, columns: Floats
) -> tuple[Floats, Floats, Floats] | None:
    """The surface at image points (n,) rows and columns; None if the edges are not those of an upright body.

    up: unit vector (3,) in the camera's frame (x right, y down, z forward). Returns (n,) each, in units of the axis's depth at
    the foot: depth of the first intersection of the ray with the surface (outside of the outline that of the limb); depth of the
    limb, where the ray is nearest to the axis and touches the cone; its height above the foot, along the axis.
    """
    left = _plane(camera, (outline.left_top, outline.tip_row), (outline.left_foot, outline.foot_row), -1.0)
    right = _plane(camera, (outline.right_top, outline.tip_row), (outline.right_foot, outline.foot_row), 1.0)
    middle = right - left  # both point outwards, so that the midway plane is equally far inside of both
    middle /= np.linalg.norm(middle)
    y = (outline.foot_row - camera.cy_px) / camera.fy_px
    foot = np.array([-(middle[1] * y + middle[2]) / middle[0], y, 1.0])
    axis = up - (up @ middle) * middle
    axis /= np.linalg.norm(axis)
    # A plane touches a cone of radius r0 + r1 h if its distance from the axis is (r0 + r1 h) cos(half angle) at all h.
    sine = float(right @ axis)
    cosine = np.sqrt(1.0 - sine**2)
    r0, r1 = -float(right @ foot) / cosine, -sine / cosine
    if r0 <= 0:
        return None
    rays = np.ones((3, len(rows)))
    rays[0], rays[1] = (columns - camera.cx_px) / camera.fx_px, (rows - camera.cy_px) / camera.fy_px
    # | depth * ray - foot |^2 - h^2 = (r0 + r1 h)^2 with h = (depth * ray - foot) . axis
    rise, start = axis @ rays, float(foot @ axis)
    base = r0 - r1 * start
    a = (rays**2).sum(axis=0) - (1 + r1**2) * rise**2
    b = -foot @ rays + (1 + r1**2) * rise * start - r1 * rise * r0
    c = float(foot @ foot) - start**2 - base**2
    if (a <= 0).any():
        return None
    limb = -b / a
    depth = limb - np.sqrt(np.maximum(b**2 - a * c, 0.0)) / a
    if (depth <= 0.5).any():
        return None
    return depth, limb, limb * rise - start


def _plane(camera: Camera, top: tuple[float, float], foot: tuple[float, float], outwards: float) -> Floats:
    """(3,) unit normal of the plane through the projection centre and a line of the image, its x of the sign `outwards`."""
    (x0, y0), (x1, y1) = (
        ((u - camera.cx_px) / camera.fx_px, (v - camera.cy_px) / camera.fy_px) for u, v in (top, foot)
    )
    normal = np.array([y0 - y1, x1 - x0, x0 * y1 - y0 * x1])  # the cross product of the rays (x, y, 1) through both
    return np.asarray(normal / np.linalg.norm(normal) * np.sign(normal[0]) * outwards)


class SplinePatch(NamedTuple):
    """Cubic B-spline coefficients of a part of an image."""

    rows_of_four: Floats
    """(4, channels * rows * columns): in [k] the coefficients from row k on, colour by colour, so that interpolation across the
    rows is one product with (4,) weights."""
    shape: tuple[int, int, int]
    """channels, rows (three fewer than were cut out), columns"""
    row0: int
    column0: int

    @staticmethod
    def of(image: Image, row0: float, row1: float, column0: float, column1: float) -> SplinePatch | None:
        """The part with rows and columns between two limits; None if it would leave the image at the sides."""
        first, last = int(np.floor(column0)) - 2, int(np.floor(column1)) + 4
        if first < 0 or last > image.shape[1]:
            return None
        top = int(np.floor(row0)) - 2
        rows = np.arange(top, int(np.floor(row1)) + 4)
        if top < 0 or rows[-1] >= image.shape[0]:
            rows = np.clip(rows, 0, image.shape[0] - 1)
        by_colour = image[rows, first:last].transpose(2, 0, 1).astype(np.float64)
        channels, count = by_colour.shape[0], len(rows) - 3
        rows_of_four = np.stack([by_colour[:, k : k + count].ravel() for k in range(4)])
        return SplinePatch(rows_of_four, (channels, count, last - first), top, first)

    def at(self, rows: Ints, columns: Floats, down_px: float) -> tuple[Floats, Floats, Floats]:
        """Grey values and their slopes along columns and rows, each (n, channels), at rows + down_px and columns.

        In memory they are ordered colour by colour, as least squares reads them.
        """
        channels, height, width = self.shape
        whole = int(np.floor(down_px))
        # All pixels have the same fraction of a row: interpolate whole rows first, then four columns per pixel.
        down = np.stack(_weights(np.array(down_px - whole)))
        blend = (down @ self.rows_of_four).reshape(2 * channels, height * width)
        base = np.floor(columns)
        value_u, slope_u = _weights(columns - base)
        top = np.minimum(np.maximum(rows + (whole - 1 - self.row0), 0), height - 1)
        first = np.minimum(np.maximum(base.astype(np.intp) - (1 + self.column0), 0), width - 4)
        first += top * width
        picked = blend.take(first + np.arange(4)[:, None], axis=1)  # (2 * channels, 4, n): values, then slopes down
        along = (picked[:channels] * slope_u).sum(axis=1)
        both = (picked * value_u).sum(axis=1)
        return both[:channels].T, along.T, both[channels:].T


def _weights(part: Floats) -> tuple[Floats, Floats]:
    """Cubic B-spline weights (4, ...) of the four neighbours of a point, and their derivatives; part: 0..1 after the second."""
    t, rest = part, 1 - part
    t2, rest2 = t * t, rest * rest
    value, slope = np.empty((4, *part.shape)), np.empty((4, *part.shape))
    value[0], value[3] = rest2 * rest / 6, t2 * t / 6
    value[1] = 2 / 3 - t2 + t2 * t / 2
    value[2] = 1 - value[0] - value[1] - value[3]
    slope[0], slope[3] = -rest2 / 2, t2 / 2
    slope[1] = 1.5 * t2 - 2 * t
    slope[2] = -slope[0] - slope[1] - slope[3]
    return value, slope
