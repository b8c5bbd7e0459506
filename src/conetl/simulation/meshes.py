"""Triangle meshes as numpy arrays, and their PLY files. Lengths in metres."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from conetl.model.arrays import Floats


class Mesh(NamedTuple):
    """vertices (N, 3), normals (N, 3), uv (N, 2), triangles (M, 3)."""

    vertices: Floats
    normals: Floats
    uv: Floats
    triangles: NDArray[np.int32]


def lathe(radii_m: ArrayLike, heights_m: ArrayLike, sides: int = 40) -> Mesh:
    """A profile rotated about z; u runs around, v from 0 at the last ring to 1 at the first (image rows, top first)."""
    radius, height = np.asarray(radii_m, dtype=float), np.asarray(heights_m, dtype=float)
    turn = np.linspace(0.0, 2.0 * np.pi, sides + 1)
    slope = np.stack([np.gradient(height), -np.gradient(radius)], axis=1)
    slope *= np.sign(height[-1] - height[0]) or 1.0
    slope /= np.linalg.norm(slope, axis=1, keepdims=True) + 1e-12
    cos, sin = np.cos(turn), np.sin(turn)
    vertices = np.stack(np.broadcast_arrays(radius[:, None] * cos, radius[:, None] * sin, height[:, None]), axis=-1)
    normals = np.stack(np.broadcast_arrays(slope[:, :1] * cos, slope[:, :1] * sin, slope[:, 1:]), axis=-1)
    v = (height - height.min()) / (np.ptp(height) or 1.0)
    uv = np.stack(np.broadcast_arrays(turn / (2 * np.pi), v[:, None]), axis=-1)
    index = np.arange(len(radius) * (sides + 1)).reshape(len(radius), sides + 1)
    a, b, c, d = index[:-1, :-1].ravel(), index[:-1, 1:].ravel(), index[1:, 1:].ravel(), index[1:, :-1].ravel()
    triangles = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return Mesh(vertices.reshape(-1, 3), normals.reshape(-1, 3), uv.reshape(-1, 2), triangles.astype(np.int32))


def box(size_m: ArrayLike, base_m: float = 0.0) -> Mesh:
    """A box on z = base_m, centred on the z axis; each face has the whole texture."""
    sx, sy, sz = np.asarray(size_m, dtype=float)
    vertices, normals, uv, triangles = [], [], [], []
    for number in range(6):
        axis, sign = number // 2, (-1.0, 1.0)[number % 2]
        normal = np.zeros(3)
        normal[axis] = sign
        up = np.array([0.0, 0.0, 1.0]) if axis != 2 else np.array([0.0, 1.0, 0.0])
        across = np.cross(up, normal)
        for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1)):
            unit = normal + a * across + b * up
            vertices.append(unit * [sx / 2, sy / 2, sz / 2] + [0.0, 0.0, base_m + sz / 2])
            normals.append(normal)
            uv.append([(a + 1) / 2, (b + 1) / 2])
        k = 4 * number
        triangles += [[k, k + 1, k + 2], [k, k + 2, k + 3]]
    return Mesh(np.array(vertices), np.array(normals), np.array(uv), np.array(triangles, dtype=np.int32))


def prism(outline_m: ArrayLike, thickness_m: float) -> Mesh:
    """A convex outline (K, 2) in the y-z plane, extruded along x; its faces have the texture over the bounding box."""
    outline = np.asarray(outline_m, dtype=float)
    count = len(outline)
    uv = (outline - outline.min(axis=0)) / np.ptp(outline, axis=0)
    fan = np.array([[0, k, k + 1] for k in range(1, count - 1)])
    return Mesh(
        np.concatenate([np.column_stack([np.full(count, x), outline]) for x in (-thickness_m / 2, thickness_m / 2)]),
        np.repeat([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]], count, axis=0),
        np.concatenate([uv * [-1.0, 1.0] + [1.0, 0.0], uv]),
        np.concatenate([fan, fan + count]).astype(np.int32),
    )


def ribbon(points_m: ArrayLike, width_m: float, height_m: float, tile_m: float) -> Mesh:
    """A level band along the centre line points_m (K, 2), with a texture that repeats every tile_m."""
    points = np.asarray(points_m, dtype=float)
    steps = np.diff(points, axis=0)
    normals = np.stack([-steps[:, 1], steps[:, 0]], axis=1) / np.linalg.norm(steps, axis=1)[:, None]
    both = normals[np.r_[0, np.arange(len(normals))]] + normals[np.r_[np.arange(len(normals)), -1]]
    aside = both * (width_m / np.sum(both**2, axis=1))[:, None]  # mitred where the line bends
    outline = np.concatenate([points - aside, (points + aside)[::-1]])
    count = len(outline)
    first = np.arange(len(steps))
    triangles = np.concatenate(
        [
            np.stack([first, first + 1, count - 2 - first], axis=1),
            np.stack([first, count - 2 - first, count - 1 - first], axis=1),
        ]
    )
    return Mesh(
        np.column_stack([outline, np.full(count, height_m)]),
        np.tile([0.0, 0.0, 1.0], (count, 1)),
        outline / tile_m,
        triangles.astype(np.int32),
    )


def transformed(mesh: Mesh, matrix: Floats) -> Mesh:
    """The mesh after a rigid (4, 4) motion."""
    return mesh._replace(
        vertices=mesh.vertices @ matrix[:3, :3].T + matrix[:3, 3], normals=mesh.normals @ matrix[:3, :3].T
    )


def write_ply(mesh: Mesh, path: Path) -> None:
    """Binary little-endian PLY with normals and texture coordinates."""
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(mesh.vertices)}\n"
        + "".join(f"property float {name}\n" for name in ("x", "y", "z", "nx", "ny", "nz", "u", "v"))
        + f"element face {len(mesh.triangles)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    vertices = np.hstack([mesh.vertices, mesh.normals, mesh.uv]).astype("<f4")
    faces = np.zeros(len(mesh.triangles), dtype=[("n", "u1"), ("v", "<i4", 3)])
    faces["n"], faces["v"] = 3, mesh.triangles
    path.write_bytes(header.encode() + vertices.tobytes() + faces.tobytes())
