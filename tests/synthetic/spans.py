"""Simulated points of a drive as they are followed over spans: truth for the tests of self-calibration."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from conetl.geometry.calibration.self_calibration import SpanPoints
from conetl.geometry.motion.stereo_tracks import StereoTracks

Floats = NDArray[np.float64]
WIDTH_PX, HEIGHT_PX, FOCAL_PX, CX_PX, CY_PX, BASELINE_M = 1242, 375, 721.5, 609.6, 172.9, 0.54
SIGMA_PX, NEAREST_M = 0.2, 6.0


def see(points: Floats, turn_rad: Floats) -> Floats:
    """(N, 4) u, v left and u, v right of points (N, 3) by a rig whose right camera is turned."""
    right = (points - [BASELINE_M, 0, 0]) @ Rotation.from_rotvec(turn_rad).as_matrix()
    return np.column_stack(
        [FOCAL_PX * q[:, i] / q[:, 2] + c for q in (points, right) for i, c in ((0, CX_PX), (1, CY_PX))]
    )


def motion(way_m: float, turn_rad: float) -> Floats:
    """(4, 4) last_SE3_first of a camera that drove ahead by way_m and turned to the side."""
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec([0.002, turn_rad, -0.001]).as_matrix()
    pose[:3, 3] = [-0.02, 0.005, -way_m]
    return pose


def make_span(
    rng: np.random.Generator,
    turn_rad: Floats,
    *,
    points: int = 90,
    way_m: float = 2.0,
    lorry: int = 0,
) -> SpanPoints:
    """One span of a street: points at many depths, seen inside all four images; the first `lorry` drive ahead with the car."""
    pose = motion(way_m, rng.normal(0, 0.02))
    kept: list[Floats] = []
    while sum(map(len, kept)) < points:
        z = NEAREST_M / rng.uniform(0.12, 1.0, 4 * points)
        p = np.stack([rng.uniform(-0.8, 0.8, len(z)) * z, rng.uniform(-0.2, 0.22, len(z)) * z, z], axis=1)
        inside = np.ones(len(p), dtype=bool)
        for seen in (see(p, turn_rad), see(p @ pose[:3, :3].T + pose[:3, 3], turn_rad)):
            inside &= (seen[:, ::2] > 0).all(axis=1) & (seen[:, ::2] < WIDTH_PX).all(axis=1)
            inside &= (seen[:, 1::2] > 0).all(axis=1) & (seen[:, 1::2] < HEIGHT_PX).all(axis=1)
        kept.append(p[inside])
    first = np.concatenate(kept)[:points]
    last = first @ pose[:3, :3].T + pose[:3, 3]
    last[:lorry] = first[:lorry] + np.array([0.0, 0.0, 0.3])
    noisy = [see(p, turn_rad) + rng.normal(0, SIGMA_PX, (points, 4)) for p in (first, last)]
    guess = pose.copy()
    guess[:3, 3] += rng.normal(0, 0.01, 3)
    return SpanPoints(noisy[0], noisy[1], np.full(points, 0.3), guess)


def followed(made: SpanPoints, number: int) -> StereoTracks:
    """The points of a span, between frames `number` and the next one, as they are stored."""
    return StereoTracks(
        first_frame_index=number, second_frame_index=number + 1, first_px=tuple(made.first_px.ravel().tolist()),
        second_px=tuple(made.last_px.ravel().tolist()), sigma_px=0.3, missing=None,
    )  # fmt: skip
