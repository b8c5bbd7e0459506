"""Depth of the visible surface of a standing cone, from its outline in one image, up to scale.

A plane through each edge of the outline and the projection centre touches the cone. The plane midway between both contains the
axis, upright through the foot's row. The circular cone about that axis that touches both planes is unique up to its size, the
unknown of the matching; so the depth of the axis at the foot is 1. Each pixel's ray meets that cone in a quadratic equation;
nothing is linearised.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from conetl.model.records import Camera
from conetl.tracking.matching.cone_outline import Outline

Floats = NDArray[np.float64]


class Surface(NamedTuple):
    """Depths of n pixels, in units of the axis's depth at the foot."""

    depth: Floats
    """(n,) of the first intersection of the ray with the surface; of the limb outside the outline"""
    limb: Floats
    """(n,) of the point of the ray nearest to the axis, where it touches the cone at the limb"""
    height: Floats
    """(n,) of that point above the foot, along the axis"""


def cone_surface(outline: Outline, camera: Camera, up: Floats, rows: Floats, columns: Floats) -> Surface | None:
    """The surface at image points (n,) rows and columns; None if the edges are not those of an upright body.

    up: unit vector (3,) in the camera's frame (x right, y down, z forward).
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
    return Surface(depth, limb, limb * rise - start)


def _plane(camera: Camera, top: tuple[float, float], foot: tuple[float, float], outwards: float) -> Floats:
    """(3,) unit normal of the plane through the projection centre and a line of the image, its x of the sign `outwards`."""
    (x0, y0), (x1, y1) = (
        ((u - camera.cx_px) / camera.fx_px, (v - camera.cy_px) / camera.fy_px) for u, v in (top, foot)
    )
    normal = np.array([y0 - y1, x1 - x0, x0 * y1 - y0 * x1])  # the cross product of the rays (x, y, 1) through both
    return np.asarray(normal / np.linalg.norm(normal) * np.sign(normal[0]) * outwards)
