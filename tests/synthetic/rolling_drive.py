"""Drives of cameras with a rolling shutter, without images: every row sees the scene from where the camera then was."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from conetl.geometry import pose as se3
from conetl.geometry.motion.rolling_shutter import with_shutters
from conetl.geometry.motion.stereo_tracks import StereoTracks, motions_of
from conetl.geometry.packing import cov_matrix
from conetl.model.drive import StereoMatch, Track
from conetl.model.params import IngestParams
from conetl.model.rig import Camera, Rig, Shutter
from conetl.pipeline.odometry import params_of_drive
from conetl.tracking.drive_refinement import refine_with_cones
from conetl.tracking.error_propagation import motion_error
from conetl.tracking.positions import locate_positions
from conetl.tracking.rolling_shutter import matches_at_stamp
from conetl.tracking.self_calibration import SelfCalibration, Span, choose_spans, self_calibrate, self_calibrated_rig
from tests import records
from tests.synthetic.odometry import log_of
from tests.synthetic.world import ORIGIN_M, drive_of, fuse_logged, make_rig

Floats = NDArray[np.float64]
PARAMS = IngestParams()
STEP_S, PAIRS = 0.1, 40
POINT_SIGMA_PX, POINTS = 0.2, 220
SIGMA_U_PX, SIGMA_V_PX, SIGMA_POINTING_PX = 0.3, 0.8, 0.3
CONE_HEIGHT_M, FARTHEST_M = 0.7, 20.0


@dataclass(frozen=True)
class Readout:
    """True shutters, in seconds: readout of both cameras, and the share of it that has passed at the stamp."""

    left_s: float
    right_s: float
    stamp_share: float = 0.0


class Street:
    """A vehicle that sways along a street with points on the ground, on facades and on trees, and with cones."""

    def __init__(self, rng: np.random.Generator, speed_m_s: float, turn_rad_s: float = 0.15) -> None:
        self._fine_s = np.arange(-0.5, PAIRS * STEP_S + 0.5, 0.001)
        t = self._fine_s
        start = rng.uniform(0, 6, 3)
        yaw = turn_rad_s / 0.6 * np.sin(0.6 * t + start[0])
        speed = speed_m_s * (1 + 0.08 * np.sin(0.9 * t + start[1]))
        forward = np.cumsum(np.stack([np.cos(yaw), np.sin(yaw), np.zeros(len(t))]) * speed * 0.001, axis=1)
        pitch, roll = 0.003 * np.sin(5.0 * t + start[2]), 0.004 * np.sin(3.1 * t)
        self._columns = (*forward, roll, pitch, yaw)
        x, y = (self.poses_at(np.arange(PAIRS) * STEP_S)[:, :2, 3] - ORIGIN_M[:2]).T
        along = rng.uniform(0, 1, 9000)
        ahead = np.interp(along, [0, 1], [x[0], x[-1] + 45.0])
        middle = np.interp(ahead, x, y)
        kind = rng.uniform(size=len(along))
        aside = np.where(
            kind < 0.45,
            rng.uniform(-7, 7, len(along)),
            rng.choice([-9.0, 9.0], len(along)) + rng.normal(0, 1, len(along)),
        )
        up = np.where(kind < 0.45, 0.0, rng.uniform(0.0, 6.0, len(along)))
        self.points_m = np.stack([ahead, middle + aside, up], axis=1) + ORIGIN_M
        at = np.linspace(x[6], x[-1] + 5.0, 9)
        side = np.where(np.arange(9) % 3 == 2, 3.0, -2.6)
        self.feet_m = np.stack([at, np.interp(at, x, y) + side, np.zeros(9)], axis=1) + ORIGIN_M

    def poses_at(self, times_s: Floats) -> Floats:
        """(N, 4, 4) body -> map."""
        x, y, z, roll, pitch, yaw = (np.interp(times_s, self._fine_s, column) for column in self._columns)
        return se3.se3(se3.rotation_from_rpy(roll, pitch, yaw), np.stack([x, y, z], axis=1) + ORIGIN_M)

    def exposed(self, points_m: Floats, stamp_s: float, rig: Rig, shutter: Readout) -> tuple[Floats, Floats]:
        """(N, 4) image points in the frame pair of a stamp, and (N,) depths; NaN where a point is not in view."""
        found, depth = [], np.zeros(len(points_m))
        for camera, body_SE3_camera, readout_s in (
            (rig.left, np.array(rig.body_SE3_left), shutter.left_s), (rig.right, np.array(rig.body_SE3_right), shutter.right_s)
        ):  # fmt: skip
            late_s = np.zeros(len(points_m))
            for _ in range(4 if readout_s else 1):
                poses = se3.compose(self.poses_at(stamp_s + late_s), body_SE3_camera)
                own = np.einsum("nji,nj->ni", poses[:, :3, :3], points_m - poses[:, :3, 3])
                uv = _seen(own, camera)
                rows = np.nan_to_num(uv[:, 1], nan=0.0)
                late_s = readout_s * (np.clip(rows / (camera.height_px - 1), -0.5, 1.5) - shutter.stamp_share)
            found.append(uv)
            depth = own[:, 2] if camera is rig.left and not depth.any() else depth
        seen = np.hstack(found)
        inside = (seen > 1).all(axis=1) & (seen < np.tile([rig.left.width_px - 2, rig.left.height_px - 2], 2)).all(
            axis=1
        )
        return np.where(inside[:, None], seen, np.nan), depth


def _seen(points_m: Floats, camera: Camera) -> Floats:
    z = np.where(points_m[:, 2:] > 1.5, points_m[:, 2:], np.nan)
    return np.asarray(points_m[:, :2] / z * [camera.fx_px, camera.fy_px] + [camera.cx_px, camera.cy_px])


def followed(
    rng: np.random.Generator, street: Street, rig: Rig, shutter: Readout, first: int, last: int, noise: float
) -> StereoTracks:  # fmt: skip
    """Points of the street in two frame pairs, with noise."""
    pose = street.poses_at(np.array([first * STEP_S]))[0]
    ahead_m = (street.points_m - pose[:3, 3]) @ pose[:3, 0]
    some = rng.permutation(np.flatnonzero((ahead_m > 3) & (ahead_m < 50)))[: 4 * POINTS]
    one, depth = street.exposed(street.points_m[some], first * STEP_S, rig, shutter)
    other, _ = street.exposed(street.points_m[some], last * STEP_S, rig, shutter)
    kept = np.flatnonzero(np.isfinite(one).all(axis=1) & np.isfinite(other).all(axis=1) & (depth < 50))[:POINTS]
    noisy = [px[kept] + rng.normal(0, noise * POINT_SIGMA_PX, (len(kept), 4)) for px in (one, other)]
    return StereoTracks(
        first_frame_index=first, second_frame_index=last, first_px=noisy[0], second_px=noisy[1], sigma_px=0.3, missing=None
    )  # fmt: skip


def matches_of(rng: np.random.Generator, street: Street, rig: Rig, shutter: Readout, noise: float) -> list[StereoMatch]:
    """Of all cones in all frame pairs; match_index is the number of the cone."""
    found = []
    heights = np.outer([0.0, 0.5, 1.0], [0.0, 0.0, CONE_HEIGHT_M])
    for pair in range(PAIRS):
        seen = [street.exposed(street.feet_m + height, pair * STEP_S, rig, shutter) for height in heights]
        whole = np.all([np.isfinite(uv).all(axis=1) for uv, _ in seen], axis=0) & (seen[0][1] < FARTHEST_M)
        for cone in np.flatnonzero(whole).tolist():
            own, pointing = rng.normal(0, noise * SIGMA_U_PX, 2), rng.normal(0, noise * SIGMA_POINTING_PX)
            uv = {}
            for name, (points, _) in zip(("foot", "centre", "tip"), seen, strict=True):
                for side, first in (("left", 0), ("right", 2)):
                    u, v = points[cone, first : first + 2]
                    uv[f"{name}_{side}_uv_px"] = (
                        float(u + own[first // 2] + pointing),
                        float(v + rng.normal(0, noise * SIGMA_V_PX)),
                    )
            box = {
                side: records.box(
                    uv[f"tip_{side}_uv_px"][0] - 10, uv[f"tip_{side}_uv_px"][1], 20.0,
                    max(uv[f"foot_{side}_uv_px"][1] - uv[f"tip_{side}_uv_px"][1], 5.0), frame=pair, side=side, index=cone,
                )
                for side in ("left", "right")
            }  # fmt: skip
            found.append(
                StereoMatch(
                    frame_index=pair, match_index=cone, left=box["left"], right=box["right"], sigma_u_px=SIGMA_U_PX,
                    sigma_v_px=SIGMA_V_PX, sigma_pointing_px=SIGMA_POINTING_PX, refined=True, cost=0.1, **uv,
                )
            )  # fmt: skip
    return found


@dataclass(frozen=True)
class Analysed:
    """A drive that went through calibration, odometry, refinement and positions."""

    tracks: list[Track]
    error_m: Floats
    """(N, 3) of tracks."""
    chi2: Floats
    """(N,) of these by their covariances; 3 degrees of freedom."""
    calibration: SelfCalibration
    rig: Rig
    along_m: float
    """By how much the measured motions are longer than the true ones, over the drive."""


def analysed(
    seed: int,
    shutter: Readout,
    stated: Shutter | None,
    *,
    speed_m_s: float = 15.0,
    turn_rad_s: float = 0.15,
    sigma_m: float = 0.02,
    right: Shutter | None = None,
    noise: float = 1.0,
    params: IngestParams = PARAMS,
) -> Analysed:
    """One drive of `shutter` whose rig states `stated` (and `right`, where the right camera's differs).

    noise: of image points, as a share of the stated one.
    """
    rng = np.random.default_rng(seed)
    rig = make_rig()
    street = Street(rng, speed_m_s, turn_rad_s)
    truth = street.poses_at(np.arange(PAIRS) * STEP_S)
    logged = log_of(truth, rng, sigma_m, 0.0005, params.trajectory)
    rig_stated = with_shutters(rig, stated, right or stated)
    left = se3.compose(truth, np.array(rig.body_SE3_left))
    steps = [se3.compose(se3.invert(b), a) for a, b in pairwise(left)]
    spans = list(choose_spans(steps, params.trajectory.self_calibration_span_m, [STEP_S] * len(steps)))
    noisy = [Span(s.first, s.last, _guess(rng, s.last_SE3_first), s.lasts_s) for s in spans]
    tracks = [followed(rng, street, rig, shutter, s.first, s.last, noise) for s in spans]
    calibration = self_calibrate(rig_stated, noisy, tracks, params.trajectory)
    own = self_calibrated_rig(rig_stated, calibration, params.trajectory)
    pairs = [followed(rng, street, rig, shutter, k, k + 1, noise) for k in range(PAIRS - 1)]
    motions = list(motions_of(pairs, logged, own, params.trajectory))
    found = matches_of(rng, street, rig, shutter, noise)
    drive = drive_of(logged, own)
    used = params.model_copy(update={"trajectory": params_of_drive(drive, params.trajectory)})
    refined = refine_with_cones(logged, own, motions, matches_at_stamp(found, logged, own), used)
    final = matches_at_stamp(found, refined.frame_pairs, own)
    positions, _ = locate_positions(final, refined.frame_pairs, own, params.position)
    boxes = [box for match in found for box in (match.left, match.right)]
    fused, _ = fuse_logged(refined.frame_pairs, own, boxes, final, positions, motion=motion_error(refined))
    errors, chi2 = [], []
    for track in fused:
        off = np.array(track.xyz_m) - street.feet_m
        nearest = off[np.linalg.norm(off, axis=1).argmin()]
        errors.append(nearest)
        chi2.append(nearest @ np.linalg.solve(cov_matrix(track.cov_m2), nearest))
    measured = [m for m in motions if m.second_SE3_first is not None]
    driven = sum(np.linalg.norm(m.shift_m()) for m in measured)
    true = sum(np.linalg.norm(steps[m.first_frame_index][:3, 3]) for m in measured)
    return Analysed(fused, np.array(errors).reshape(-1, 3), np.array(chi2), calibration, own, float(driven / true - 1))


def _guess(rng: np.random.Generator, motion: Floats) -> Floats:
    guess = motion.copy()
    guess[:3, 3] += rng.normal(0, 0.01, 3)
    return guess
