"""Forward intersection of two views (the paper's Equation 1) with covariance, beside OpenCV.

    python benchmarks/bench_intersection.py [--points 1000000] [--rounds 7] [--json FILE]

All methods run on one thread, in turn; the figure is the processor time of the best round. `cv2.triangulatePoints` solves the
linear equations by SVD, without iteration, image weights, covariance and status.
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


def main() -> None:
    parser = arguments_of(__doc__)
    parser.add_argument("--points", type=int, default=1_000_000)
    parser.add_argument("--rounds", type=int, default=7)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    uv, truth = observed(options.points)
    rivals: dict[str, Callable[[Array], Array]] = {
        "conetl": by_conetl,
        "conetl, poses per point": posed(options.points, truth),
        "cv2.triangulatePoints": by_opencv,
    }
    best: dict[str, float] = {}
    errors: dict[str, float] = {}
    for number in range(options.rounds + 1):  # the first round warms up and compiles
        for name, run in rivals.items():
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
    write_json(options.json, rows)


if __name__ == "__main__":
    main()
