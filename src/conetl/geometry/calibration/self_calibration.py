"""Deviation of the right camera of a rig from its calibration, from static points that the rig passes.

A small bundle adjustment with additional parameters (e.g. Luhmann et al. 2013, "Close-range photogrammetry", ch. 4.4): over spans
of a few metres, points seen by both cameras at both ends must fit one rigid motion. Unknown are the points, one motion per span
and, common to the drive, one rotation of the right camera, one bend of its columns and one skew of its rows. A turn to the side
(ry) shifts all disparities, which points at many depths show once the rig has moved; turns up (rx) and about the axis (rz) shift
and tilt rows. The bend shifts columns as x squared: the effect of a wrong principal point or of decentring that a
calibration has modelled as a turn. Rows would determine ry more sharply by their shift in the corners (as x y), but only without
other row errors: the skew absorbs that part. `model_gap` is the change of the result if disparities may also follow the next even
Legendre polynomial, the fourth. Points and motions are eliminated (Schur complement); the covariance is taken from the scatter
between spans (M-estimates with clusters: Huber 1981, ch. 6; Liang & Zeger 1986; neighbours: Newey & West 1987).

Of cameras with a rolling shutter whose readout is uncertain, a change of the readout of both, with its prior, is one more shared
unknown: a point that has moved by some rows between the two ends was seen after another time than the rig's, so that near and far
points, and those above and below the horizon, show different motions (`geometry/motion/rolling_shutter.py`).

The rotation r = (rx, ry, rz) in radians perturbs left_SE3_right = (R, t) as (R exp([r]x), t), as in `CalibrationCovariance`. The
bend b adds b x^2 to the column, in units of the focal length. A turn moves columns by -ry (1 + x^2), so turn and bend together
are a camera turned by (rx, ry - b, rz) whose principal point is b focal lengths further to the left (`corrected`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from conetl.geometry.motion.rolling_shutter import at_stamp, rate_of
from conetl.geometry.motion.stereo_motion import MotionStatus, StereoCameras, estimate_motion, triangulate
from conetl.geometry.small_arrays import apply_steps, cross_matrix, inverse_of_symmetric, upper_median
from conetl.model.arrays import Floats
from conetl.model.params import TrajectoryParams

#: Choices of the points; one more where these are moved to the time stamp by the motions found with the choice before.
_OUTER, _OUTER_OF_ROLLING, _INNER = 2, 3, 10
#: rx, ry, rz, the bend of columns and the skew of rows; and, tried only, the fourth Legendre polynomial of the column. The
#: readout, where it is unknown, stands between them.
_SHARED, _TRIED = 5, 6
_SKEW, _BEND, _READOUT = 4, 3, 5
_CAUCHY_SIGMAS = 2.385  # 95 % efficiency on normal errors (Rey 1983)
_HUBER_SIGMAS = 2.0
#: Each point has 8 image coordinates and 3 unknowns of its own, a span's score the shared unknowns; median of chi-square(n) / n.
_FREEDOM, _MEDIAN_CHI2 = 5, {5: 0.8703, 6: 0.8914}
_NEAREST_M = 0.3
#: The last step, squared and in sigmas, must be smaller than this.
_CONVERGED = 0.01
#: Neighbouring spans see the same scenery: their errors are correlated over this many spans (Newey & West 1987).
_LAGS = 3


@dataclass(frozen=True)
class SpanPoints:
    """Points seen in all four images at the two ends of a span, in pixels of the rectified images."""

    first_px: Floats
    """(N, 4): u_left, v_left, u_right, v_right at the beginning."""
    last_px: Floats
    """(N, 4): likewise at the end."""
    sigma_px: Floats
    """(N,) of each coordinate."""
    last_SE3_first: Floats
    """(4, 4) approximate motion of the left camera, as in `estimate_motion`."""
    lasts_s: float = 0.0
    """Time between both ends, for a rolling shutter."""
    shares: Floats | None = None
    """(N, 4) `row_shares` of the points: left and right at the beginning, left and right at the end; None: global shutter."""


class Readouts(NamedTuple):
    """Of cameras with a rolling shutter."""

    stated_s: Floats
    """(2,) of the left and the right camera."""
    sigma_s: float
    """Prior sigma of a change of both; 0: none is made, only estimated."""


class RightCameraError(NamedTuple):
    """Estimate from the spans, without any prior."""

    turn_and_bend: Floats
    """(4,) rx, ry, rz in radians and the bend in focal lengths."""
    cov: Floats
    """(4, 4), from the scatter between spans."""
    model_gap: Floats
    """(4,): change of the estimate if disparities may also follow a fourth-order field."""
    readout_s: tuple[float, float] | None = None
    """Change of both readouts and its sigma, prior included if there is one; None of a global shutter, or if not determined."""


def corrected(cameras: StereoCameras, turn_and_bend: Floats) -> StereoCameras:
    """The rig whose right camera is turned and bent by (4,) rx, ry, rz and bend."""
    rotation_rad, shift_px = equivalent_camera(turn_and_bend, float(cameras.right_px[0]))
    back = np.eye(4)
    back[:3, :3] = Rotation.from_rotvec(-rotation_rad).as_matrix()
    moved = cameras.right_px + np.array([0.0, 0.0, shift_px, 0.0])
    return replace(cameras, right_px=moved, right_SE3_left=back @ cameras.right_SE3_left)


def equivalent_camera(turn_and_bend: Floats, focal_px: float) -> tuple[Floats, float]:
    """Rotation vector (3,) and shift of the principal point in columns (px) that are equivalent to (4,) turn and bend."""
    rx, ry, rz, bend = turn_and_bend
    return np.array([rx, ry - bend, rz]), float(-focal_px * bend)


def estimate_right_camera(
    cameras: StereoCameras, spans: Sequence[SpanPoints], params: TrajectoryParams, readouts: Readouts | None = None
) -> RightCameraError | None:
    """Turn and bend of the right camera under which the points of all spans are static; None where they are not determined.

    Fewer usable spans than `self_calibration_min_spans` give no scatter. Points on moving objects are outvoted within each span.
    readouts: of a rolling shutter, with spans that have shares of rows.
    """
    sigma_s = 0.0 if readouts is None else readouts.sigma_s
    prior = np.zeros(_SHARED + (sigma_s > 0))
    prior[_READOUT:] = sigma_s**-2 if sigma_s > 0 else 0.0
    state = np.zeros(len(prior))
    starts: list[Floats | None] = [None] * len(spans)
    for _ in range(_OUTER if readouts is None else _OUTER_OF_ROLLING):
        own, applied = corrected(cameras, state[:_SKEW]), state.copy()
        if readouts is not None:
            moved = [
                _at_stamp(own, *both, readouts.stated_s + state[_READOUT:].sum())
                for both in zip(spans, starts, strict=True)
            ]
        chosen = [
            _static_points(own, span, params, seed, starts[seed])
            for seed, span in enumerate(spans if readouts is None else moved)
        ]
        starts = [None if c is None else c.last_SE3_first for c in chosen]
        used = [c for c in chosen if c is not None]
        if len(used) < params.self_calibration_min_spans:
            return None
        joint = _joined(own, used)
        for _ in range(_INNER):
            since = (state - applied)[_READOUT:] if sigma_s > 0 else None
            normals, scores, joint = _step_spans(corrected(cameras, state[:_SKEW]), state[_SKEW], joint, since)
            solved = _combine(normals, scores, prior, state)
            if solved is None:
                return None
            step, cov, gap = solved
            state = state + step
            if step @ np.linalg.solve(cov, step) < _CONVERGED:
                break
        else:
            return None
    readout_s = (float(state[_READOUT]), float(cov[_READOUT, _READOUT] ** 0.5)) if sigma_s > 0 else None
    if readouts is not None and sigma_s == 0:  # one step shows which change would fit better
        normals, scores, _ = _step_spans(corrected(cameras, state[:_SKEW]), state[_SKEW], joint, np.zeros(1))
        further = _combine(normals, scores, np.zeros(_SHARED + 1), np.append(state, 0.0))
        readout_s = (
            None if further is None else (float(further[0][_READOUT]), float(further[1][_READOUT, _READOUT] ** 0.5))
        )
    return RightCameraError(state[:_SKEW], cov[:_SKEW, :_SKEW], gap[:_SKEW], readout_s)


def readout_by_images(
    spans: Sequence[SpanPoints], estimate: RightCameraError, prior_s: float, params: TrajectoryParams
) -> tuple[float, float] | None:
    """By how much the readout is longer, and its sigma (s): without the prior, with the error that all spans have in common."""
    if estimate.readout_s is None:
        return None
    longer_s, own_s = estimate.readout_s
    information = max(own_s**-2 - (prior_s**-2 if prior_s else 0.0), 1e-9)
    driven_m = sum(float(np.linalg.norm(span.last_SE3_first[:3, 3])) for span in spans)
    speed_m_s = driven_m / max(sum(span.lasts_s for span in spans), 1e-9)
    sigma_s = float(np.hypot(information**-0.5, params.self_calibration_readout_floor_m / max(speed_m_s, 1e-3)))
    return longer_s * own_s**-2 / information, sigma_s


def _at_stamp(cameras: StereoCameras, span: SpanPoints, start: Floats | None, readouts_s: Floats) -> SpanPoints:
    """The span with points as of a global shutter, by its motion. start: the motion, if known better; readouts_s (2,)."""
    if span.shares is None or not readouts_s.any():
        return span
    rate = rate_of(span.last_SE3_first if start is None else start, span.lasts_s)
    first, last = (
        at_stamp(cameras, px, shares * readouts_s, rate)
        for px, shares in ((span.first_px, span.shares[:, :2]), (span.last_px, span.shares[:, 2:]))
    )
    return replace(span, first_px=first, last_px=last)


@dataclass(frozen=True)
class _JointSpans:
    """S spans with N points in all, those of one span after those of the other."""

    seen_px: Floats
    """(N, 8): u_left, v_left, u_right, v_right at the beginning of a span, then at its end."""
    sigma_px: Floats
    """(N,)"""
    parts: tuple[slice, ...]
    """(S,): the points of each span."""
    poses: Floats
    """(S, 4, 4): last_SE3_first."""
    points: Floats
    """(N, 3) m in the left camera's frame at the beginning of the span."""
    lasts_s: tuple[float, ...]
    """(S,)"""
    shares: Floats | None
    """(N, 4), as those of spans."""


def _joined(cameras: StereoCameras, spans: Sequence[SpanPoints]) -> _JointSpans:
    ends = np.cumsum([0, *(len(span.first_px) for span in spans)])
    return _JointSpans(
        np.concatenate([np.hstack([span.first_px, span.last_px]) for span in spans]),
        np.concatenate([span.sigma_px for span in spans]),
        tuple(slice(start, end) for start, end in pairwise(ends.tolist())),
        np.array([span.last_SE3_first for span in spans]),
        triangulate(cameras, np.concatenate([span.first_px[:, :3] for span in spans]))[0],
        tuple(span.lasts_s for span in spans),
        None if spans[0].shares is None else np.concatenate([span.shares for span in spans if span.shares is not None]),
    )


def _static_points(
    cameras: StereoCameras, span: SpanPoints, params: TrajectoryParams, seed: int, start: Floats | None
) -> SpanPoints | None:
    """The points of a span that fit one rigid motion, and that motion; None if they are too few."""
    motion = estimate_motion(
        cameras, span.first_px[:, :3], span.last_px[:, :3], span.sigma_px, span.last_SE3_first, params, seed, start
    )
    if motion.status is not MotionStatus.OK:
        return None
    keep = motion.inliers
    shares = None if span.shares is None else span.shares[keep]
    return SpanPoints(
        span.first_px[keep], span.last_px[keep], span.sigma_px[keep], motion.next_SE3_first, span.lasts_s, shares
    )


def _step_spans(
    cameras: StereoCameras, skew: float, spans: _JointSpans, readout_s: Floats | None = None
) -> tuple[Floats, Floats, _JointSpans]:
    """One Gauss-Newton step of each span, shared unknowns held: reduced normals (S, n, n), scores (S, n), the spans after it.

    readout_s (1,): change of the readout since the points were moved to the time stamp; None where it is no unknown.
    """
    points, parts, sigma_px = spans.points, spans.parts, spans.sigma_px[:, None]
    rotations = [pose[:3, :3] for pose in spans.poses]
    first, d_first, r_first = _image(cameras, skew, points)
    moved = np.concatenate([points[part] @ turn.T for part, turn in zip(parts, rotations, strict=True)])
    shift = np.repeat(spans.poses[:, :3, 3], [part.stop - part.start for part in parts], axis=0)
    last, d_last, r_last = _image(cameras, skew, moved + shift)
    if readout_s is not None and spans.shares is not None:
        rates = np.array([rate_of(pose, lasts) for pose, lasts in zip(spans.poses, spans.lasts_s, strict=True)])
        rates = np.repeat(rates, [part.stop - part.start for part in parts], axis=0)
        by_first = _by_readout(d_first, points, rates, spans.shares[:, :2])
        by_last = _by_readout(d_last, moved + shift, rates, spans.shares[:, 2:])
        first, last = first + readout_s * by_first, last + readout_s * by_last
        r_first, r_last = (np.insert(r, _READOUT, by, axis=2) for r, by in ((r_first, by_first), (r_last, by_last)))
    tried = r_first.shape[2]
    residual = (spans.seen_px - np.hstack([first, last])) / sigma_px
    turned = np.concatenate([d_last[part] @ turn for part, turn in zip(parts, rotations, strict=True)])
    by_point = np.concatenate([d_first, turned], axis=1) / sigma_px[:, :, None]
    shared = np.zeros((len(points), 8, 6 + tried))
    shared[:, 4:, :3] = -(d_last @ cross_matrix(moved))
    shared[:, 4:, 3:6] = d_last
    shared[:, :4, 6:], shared[:, 4:, 6:] = r_first, r_last
    shared /= sigma_px[:, :, None]
    normals = np.swapaxes(by_point, 1, 2) @ by_point
    inverses = inverse_of_symmetric(np.ascontiguousarray(normals.transpose(1, 2, 0))).transpose(2, 0, 1)
    own = inverses @ np.swapaxes(by_point, 1, 2)  # (N, 3, 8)
    # Residuals and shared derivatives, less the part that each point absorbs.
    free = np.concatenate([shared, residual[:, :, None]], axis=2)
    free -= by_point @ (own @ free)
    rest = free[:, :, -1]
    misfit = np.einsum("ni,ni->n", rest, rest) / _FREEDOM
    products = np.empty((len(parts), 6 + tried, 7 + tried))
    for k, part in enumerate(parts):
        factor = max(upper_median(misfit[part]) / _MEDIAN_CHI2[_FREEDOM], 1e-6)
        weight = 1 / (1 + misfit[part] / factor / _CAUCHY_SIGMAS**2) / factor
        columns = free[part].reshape(-1, free.shape[2])
        products[k] = columns[:, :-1].T @ (columns * np.repeat(weight, free.shape[1])[:, None])
    normal, score = products[:, :, :-1], products[:, :, -1:]
    inverse = np.linalg.pinv(normal[:, :6, :6], hermitian=True)
    gain = normal[:, 6:, :6] @ inverse
    steps = (inverse @ score[:, :6])[:, :, 0]
    by_motion = [shared[part, :, :6] @ step for part, step in zip(parts, steps, strict=True)]
    new_points = points + np.einsum("nij,nj->ni", own, residual - np.concatenate(by_motion))
    new_points[:, 2] = np.maximum(new_points[:, 2], 2 * _NEAREST_M)  # a point may not pass through the camera
    reduced, left = normal[:, 6:, 6:] - gain @ normal[:, :6, 6:], score[:, 6:] - gain @ score[:, :6]
    return reduced, left[:, :, 0], replace(spans, poses=apply_steps(spans.poses, steps), points=new_points)


def _by_readout(by_point: Floats, points: Floats, rates: Floats, shares: Floats) -> Floats:
    """(N, 4) px/s: derivative of image points by the readout. by_point (N, 4, 3); rates (N, 6); shares (N, 2), left and right."""
    moving = np.cross(rates[:, :3], points) + rates[:, 3:]
    return np.asarray(np.einsum("nij,nj->ni", by_point, moving) * np.repeat(shares, 2, axis=1))


def _image(cameras: StereoCameras, skew: float, points: Floats) -> tuple[Floats, Floats, Floats]:
    """Image points (N, 4) of points (N, 3), derivatives (N, 4, 3) by the point, (N, 4, 6) by the shared unknowns."""
    turn = cameras.right_SE3_left[:3, :3]
    right = points @ turn.T + cameras.right_SE3_left[:3, 3]
    left_uv, left_d = _pinhole(cameras.left_px, points)
    right_uv, right_d = _pinhole(cameras.right_px, right)
    by_shared = np.zeros((len(points), 4, _TRIED))
    by_shared[:, 2:, :3] = right_d @ cross_matrix(right)  # exp(-[r]x) q = q + q x r
    by_shared[:, 2:, _BEND] = -by_shared[:, 2:, 1]
    by_shared[:, 2, _BEND] -= cameras.right_px[0]
    corner = (right_uv - cameras.right_px[2:]) / cameras.right_px[:2]
    by_shared[:, 3, _SKEW] = cameras.right_px[1] * corner[:, 0] * corner[:, 1]
    side2 = (right_uv[:, 0] / cameras.right_px[2] - 1) ** 2  # about 1 at both sides of the image
    by_shared[:, 2, _SHARED] = cameras.right_px[0] * (35 * side2**2 - 30 * side2 + 3) / 8
    right_uv[:, 1] += skew * by_shared[:, 3, _SKEW]
    return np.hstack([left_uv, right_uv]), np.concatenate([left_d, right_d @ turn], axis=1), by_shared


def _pinhole(intrinsics: Floats, points: Floats) -> tuple[Floats, Floats]:
    fx, fy, cx, cy = intrinsics
    z = np.maximum(points[:, 2], _NEAREST_M)
    x, y = points[:, 0] / z, points[:, 1] / z
    d = np.zeros((len(points), 2, 3))
    d[:, 0, 0], d[:, 0, 2], d[:, 1, 1], d[:, 1, 2] = fx / z, -fx * x / z, fy / z, -fy * y / z
    return np.stack([fx * x + cx, fy * y + cy], axis=1), d


def _combine(
    all_normals: Floats, all_scores: Floats, prior: Floats, state: Floats
) -> tuple[Floats, Floats, Floats] | None:
    """Robust step (n,), its covariance (n, n) and the model's gap (n,). prior (n,): inverse variances of zero; state (n,)."""
    shared = len(prior)
    normals, scores = all_normals[:, :shared, :shared], all_scores[:, :shared]
    weight, inverses = np.ones(len(normals)), np.linalg.pinv(normals, hermitian=True)
    for _ in range(10):
        normal = np.einsum("s,sij->ij", weight, normals) + np.diag(prior)
        if np.linalg.cond(normal / np.sqrt(np.outer(np.diag(normal), np.diag(normal)) + 1e-300)) > 1e8:
            return None
        inverse = np.linalg.inv(normal)
        step = inverse @ (np.einsum("s,si->i", weight, scores) - prior * state)
        rest = scores - normals @ step
        # Covariance of a span's score: its information times the excess scatter between spans.
        score2 = np.einsum("si,sij,sj->s", rest, inverses, rest) / shared
        spread = max(float(np.median(score2)) / _MEDIAN_CHI2[shared], 1e-12)
        weight = np.minimum(1.0, _HUBER_SIGMAS / np.sqrt(score2 / spread + 1e-300))
    weighted = weight[:, None] * rest
    count = len(normals)
    middle = weighted.T @ weighted
    for lag in range(1, min(_LAGS, count - 1) + 1):
        along = weighted[lag:].T @ weighted[:-lag]
        middle += (1 - lag / (_LAGS + 1)) * (along + along.T)
    # With few spans this is uncertain: take at least the covariance of independent spans.
    values, vectors = np.linalg.eigh(inverse @ middle @ inverse * count / max(count - shared, 1))
    alone = inverse @ (weighted.T @ weighted) @ inverse * count / max(count - shared, 1)
    least = np.einsum("ij,ik,kj->j", vectors, alone, vectors)
    cov = (vectors * np.maximum(values, least)) @ vectors.T + inverse @ np.diag(prior) @ inverse
    tried = np.einsum("s,sij->ij", weight, all_normals)
    tried[:shared, :shared] += np.diag(prior)
    score = np.einsum("s,si->i", weight, all_scores)
    score[:shared] -= prior * state
    gap = np.linalg.pinv(tried, hermitian=True) @ score
    return step, (cov + cov.T) / 2, gap[:shared] - step
