"""Forward intersection of two views (the paper's Equation 1) with covariance, beside OpenCV and, where it is installed, numba.

    python benchmarks/bench_intersection.py [--points 1000000] [--rounds 7] [--json FILE]

All methods run on one thread, in turn; the figure is the processor time of the best round. `cv2.triangulatePoints` solves the
linear equations by SVD, without iteration, image weights, covariance and status. The numba rival runs the same iterations as
conetl in compiled code, point by point.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.harness import arguments_of, print_rows, write_json
from conetl.geometry.intersection import intersect
from conetl.geometry.pose import rotation_from_rpy

Array = NDArray[np.float64]
FOCAL_PX, CX_PX, CY_PX, BASELINE_M, SIGMA_PX = 721.5, 609.6, 172.9, 0.54, 0.3


def observed(points: int) -> tuple[Array, Array]:
    """Noisy image points (P, 2, 2) of cones 3 to 35 m in front of a rectified pair, and the truth (P, 3)."""
    rng = np.random.default_rng(1)
    z = rng.uniform(3.0, 35.0, points)
    xyz = np.stack([rng.uniform(-0.6, 0.6, points) * z, rng.uniform(1.0, 1.7, points), z], axis=1)
    columns = (xyz[:, :1] - [0.0, BASELINE_M]) / z[:, None]
    uv = FOCAL_PX * np.stack([columns, np.broadcast_to(xyz[:, 1:2] / z[:, None], columns.shape)], axis=2) + (
        CX_PX,
        CY_PX,
    )
    return uv + rng.normal(0, SIGMA_PX, uv.shape), xyz


def by_conetl(uv: Array) -> Array:
    result = intersect(
        uv, np.tile([FOCAL_PX, FOCAL_PX, CX_PX, CY_PX], (2, 1)), np.tile(np.eye(3), (2, 1, 1)),
        np.array([[0.0, 0.0, 0.0], [BASELINE_M, 0.0, 0.0]]), SIGMA_PX,
    )  # fmt: skip
    return result.xyz_m


def posed(points: int, truth: Array) -> Callable[[Array], Array]:
    """conetl with rotated cameras and a pose per point, for image points of its own."""
    rng = np.random.default_rng(2)
    rotation = np.broadcast_to(rotation_from_rpy(*rng.uniform(-0.03, 0.03, (3, 2))), (points, 2, 3, 3)).copy()
    centre = np.broadcast_to([[0.0, 0.0, 0.0], [BASELINE_M, 0.0, 0.0]], (points, 2, 3)).copy()
    local = np.einsum("pvij,pvi->pvj", rotation, truth[:, None] - centre)
    uv = FOCAL_PX * local[..., :2] / local[..., 2:] + (CX_PX, CY_PX) + rng.normal(0, SIGMA_PX, (points, 2, 2))
    k = np.tile([FOCAL_PX, FOCAL_PX, CX_PX, CY_PX], (2, 1))
    return lambda _: intersect(uv, k, rotation, centre, SIGMA_PX).xyz_m


def by_opencv(uv: Array) -> Array:
    k = np.array([[FOCAL_PX, 0.0, CX_PX], [0.0, FOCAL_PX, CY_PX], [0.0, 0.0, 1.0]])
    left = k @ np.eye(3, 4)
    right = k @ np.column_stack([np.eye(3), [-BASELINE_M, 0.0, 0.0]])
    found = cv2.triangulatePoints(left, right, np.ascontiguousarray(uv[:, 0].T), np.ascontiguousarray(uv[:, 1].T))
    return np.asarray((found[:3] / found[3]).T)


def numba_rival() -> Callable[[Array], Array] | None:
    """The same Gauss-Newton iterations with covariance, compiled; None without numba."""
    try:
        import numba
    except ImportError:
        return None

    @numba.njit(fastmath=False)
    def solve(uv: Array, xyz: Array, cov: Array) -> None:
        weight = 1.0 / SIGMA_PX**2
        for p in range(uv.shape[0]):
            z = FOCAL_PX * BASELINE_M / (uv[p, 0, 0] - uv[p, 1, 0])
            x, y = (uv[p, 0, 0] - CX_PX) * z / FOCAL_PX, (uv[p, 0, 1] - CY_PX) * z / FOCAL_PX
            for _ in range(20):
                n00 = n02 = n11 = n12 = n22 = g0 = g1 = g2 = 0.0
                for view in range(2):
                    xc = x - view * BASELINE_M
                    f = FOCAL_PX / z
                    au, cu, cv = f, -f * xc / z, -f * y / z
                    ru, rv = uv[p, view, 0] - CX_PX - f * xc, uv[p, view, 1] - CY_PX - f * y
                    n00 += au * au
                    n02 += au * cu
                    n11 += au * au
                    n12 += au * cv
                    n22 += cu * cu + cv * cv
                    g0 += au * ru
                    g1 += au * rv
                    g2 += cu * ru + cv * rv
                c00, c01, c02 = n11 * n22 - n12 * n12, n02 * n12, -n11 * n02
                scale = 1.0 / (n00 * c00 + n02 * c02)
                c11, c12, c22 = n00 * n22 - n02 * n02, -n00 * n12, n00 * n11
                dx = (c00 * g0 + c01 * g1 + c02 * g2) * scale
                dy = (c01 * g0 + c11 * g1 + c12 * g2) * scale
                dz = (c02 * g0 + c12 * g1 + c22 * g2) * scale
                x, y, z = x + dx, y + dy, z + dz
                if dx * dx + dy * dy + dz * dz < 1e-10:
                    break
            xyz[p, 0], xyz[p, 1], xyz[p, 2] = x, y, z
            scale /= weight
            cov[p, 0], cov[p, 1], cov[p, 2] = c00 * scale, c01 * scale, c02 * scale
            cov[p, 3], cov[p, 4], cov[p, 5] = c11 * scale, c12 * scale, c22 * scale

    def run(uv: Array) -> Array:
        xyz, cov = np.empty((len(uv), 3)), np.empty((len(uv), 6))
        solve(uv, xyz, cov)
        return xyz

    return run


def main() -> None:
    parser = arguments_of(__doc__)
    parser.add_argument("--points", type=int, default=1_000_000)
    parser.add_argument("--rounds", type=int, default=7)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    uv, truth = observed(options.points)
    rivals: dict[str, Callable[[Array], Array] | None] = {
        "conetl": by_conetl,
        "conetl, poses per point": posed(options.points, truth),
        "cv2.triangulatePoints": by_opencv,
        "numba, same steps": numba_rival(),
    }
    best: dict[str, float] = {}
    errors: dict[str, float] = {}
    for number in range(options.rounds + 1):  # the first round warms up and compiles
        for name, run in rivals.items():
            if run is None:
                continue
            started = time.process_time()
            found = run(uv)
            seconds = time.process_time() - started
            if number:
                best[name] = min(best.get(name, seconds), seconds)
            errors[name] = float(np.nanmedian(np.linalg.norm(found - truth, axis=1)))
    rows: list[dict[str, object]] = [
        {
            "method": name,
            "M points/s": options.points / seconds / 1e6,
            "ratio to conetl": best["conetl"] / seconds,
            "covariance": "no" if name == "cv2.triangulatePoints" else "yes",
            "median error m": errors[name],
        }
        for name, seconds in best.items()
    ]
    print_rows(f"{options.points:,} points", rows)
    if rivals["numba, same steps"] is None:
        print("numba is not installed: its row is missing")
    write_json(options.json, rows)


if __name__ == "__main__":
    main()
