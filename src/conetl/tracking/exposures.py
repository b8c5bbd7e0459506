"""Whether the right camera stands where its calibration has it along the viewing direction, while the vehicle drives.

A right camera that exposes 5 ms late at 14 m/s stands 7 cm farther forward than calibrated, and cones 4 m beside the path are
0.3 m off. Odometry and log hardly show it, but the rows of the right image do: points move away from the middle row in proportion
to row and disparity, y d per baseline. A turn of the camera moves rows by 1 + y^2, x y and x, and another focal length by y, at
all distances: all five are estimated together, and sigmas are those of the scatter between the spans (jackknife).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from conetl.geometry.motion.stereo_motion import StereoCameras, triangulate
from conetl.geometry.rig import left_SE3_right
from conetl.geometry.small_arrays import median
from conetl.model.arrays import Floats
from conetl.model.drive import FramePair
from conetl.model.health import HealthCheck, hold_if
from conetl.model.rig import Rig

EXPOSURES = "exposures of both cameras"
#: Of the baseline: the right camera may stand so much before or behind its place, and that far it is known at best. Cones 4 m
#: aside are off by 0.08 m then. Sample drives 0 to 0.9 %.
_MAX_AHEAD, _FLOOR, _SIGMAS = 0.02, 0.002, 6.0
#: Points are outliers beyond so many sigmas of the median deviation.
_OUTLIER_SIGMAS, _ROUNDS = 3.0, 6
_LEAST_SPANS = 8


def right_camera_ahead(cameras: StereoCameras, spans: Sequence[Floats]) -> tuple[float, ...]:
    """How far the right camera stands before its place by the calibration, and the sigma of that, as shares of the baseline.

    spans: points (N, 4) u_left, v_left, u_right, v_right (px). Empty where they do not determine it.
    """
    if len(spans) < _LEAST_SPANS:
        return ()
    seen = np.concatenate(spans)
    span = np.repeat(np.arange(len(spans)), [len(each) for each in spans])
    points, _, usable = triangulate(cameras, seen[:, :3])
    seen, span, points = seen[usable], span[usable], points[usable]
    right = points @ cameras.right_SE3_left[:3, :3].T + cameras.right_SE3_left[:3, 3]
    x, y = (right[:, :2] / right[:, 2:]).T
    disparity = np.linalg.norm(cameras.right_SE3_left[:3, 3]) / right[:, 2]
    rows = (seen[:, 3] - cameras.right_px[3]) / cameras.right_px[1] - y
    effects = np.column_stack([y * disparity, y, x, x * y, 1 + y * y])
    kept, estimate = np.full(len(rows), True), np.zeros(5)
    for _ in range(_ROUNDS):
        estimate = np.linalg.lstsq(effects[kept], rows[kept], rcond=None)[0]
        rest = np.abs(rows - effects @ estimate)
        kept = rest <= _OUTLIER_SIGMAS * 1.4826 * median(rest[kept])
    parts = [(effects[kept & (span == k)], rows[kept & (span == k)]) for k in range(len(spans))]
    normals, sides = np.array([a.T @ a for a, _ in parts]), np.array([a.T @ r for a, r in parts])
    without = normals.sum(axis=0) - normals
    if np.linalg.matrix_rank(without).min() < len(estimate):
        return ()
    others = np.linalg.solve(without, (sides.sum(axis=0) - sides)[:, :, None])[:, 0, 0]
    sigma = np.sqrt((len(spans) - 1) * others.var())
    return float(estimate[0]), float(np.hypot(sigma, _FLOOR))


def check_exposures(ahead: tuple[float, ...], rig: Rig, frame_pairs: Sequence[FramePair]) -> list[HealthCheck]:
    """Whether both cameras expose at the same instant; where not, by how many milliseconds at the speed of the drive."""
    if not ahead:
        return []
    baseline_m = float(np.linalg.norm(left_SE3_right(rig)[:3, 3]))
    off_m, sigma_m, limit_m = baseline_m * np.array([*ahead, _MAX_AHEAD])
    wrong = abs(off_m) > max(limit_m, _SIGMAS * sigma_m)
    detail = "The right camera stands where the calibration has it."
    if wrong:
        path = np.array([pair.pose.map_t_body_m for pair in frame_pairs])
        seconds = np.diff([pair.captured_at_ns for pair in frame_pairs]) / 1e9
        speed_m_s = max(median(np.linalg.norm(np.diff(path, axis=0), axis=1) / seconds), 1e-3)
        detail = (
            f"The right camera stands {abs(off_m):.3f} +- {sigma_m:.3f} m {'before' if off_m > 0 else 'behind'} its place by the "
            f"calibration: at {speed_m_s:.1f} m/s it exposes {abs(off_m) / speed_m_s * 1e3:.1f} ms too "
            f"{'late' if off_m > 0 else 'early'}. Trigger both cameras together; if they are, calibrate the rig (conetl "
            "calibrate)."
        )
    return [hold_if(wrong, EXPOSURES, detail, value=off_m, sigma=sigma_m, limit=limit_m, unit="m")]
