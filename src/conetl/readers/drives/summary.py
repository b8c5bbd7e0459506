"""Summary of a drive before anything is computed from it: counts, rates, gaps, quality of the poses, extent."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from datetime import datetime

import numpy as np

from conetl.geometry import geodesy
from conetl.geometry.motion.steps import unexplained_step_m
from conetl.geometry.rectification import stored_camera
from conetl.model.arrays import Bools, Floats
from conetl.model.base import Record
from conetl.model.drive import Drive, FramePair
from conetl.model.rejections import Rejection

GAP_FACTOR = 2.5
"""A step longer than this many times the drive's median is a gap."""
LEAST_GAP_M = 3.0
JUMP_M = 0.5
JUMP_SIGMAS = 5.0
JUMP_WITHIN_S = 0.35
"""Jumps need neighbours that are near in time: a car that brakes or turns leaves the straight line, too."""


class Gap(Record):
    """A step between two usable pairs that is too long in time, in space, or both."""

    after_frame: int
    before_frame: int
    seconds: float
    metres: float
    """Level distance."""
    in_time: bool
    in_space: bool


class Jump(Record):
    """A position farther from where its neighbours, or the speeds before and after a gap, have it than its sigma explains."""

    frame: int
    """The position; of a jump across a gap the first one after it."""
    off_m: float


class RigSummary(Record):
    """The rig as later steps see it (rectified) and the images as they are stored."""

    rig_id: str
    baseline_m: float
    focal_px: float
    width_px: int
    height_px: int
    stored_width_px: int
    stored_height_px: int
    lens: str
    """Lens of the left camera as it took the images; "none" for rectified ones."""
    rectified_on_reading: bool
    calibration_covariance_known: bool


class PoseSummary(Record):
    """Recorded quality of the trajectory."""

    horizontal_sigma_median_m: float
    horizontal_sigma_max_m: float
    vertical_sigma_median_m: float
    yaw_sigma_median_deg: float
    jumps: tuple[Jump, ...]


class Extent(Record):
    """Bounding box of the body's positions."""

    east_m: tuple[float, float]
    north_m: tuple[float, float]
    height_m: tuple[float, float]
    lon_deg: tuple[float, float]
    lat_deg: tuple[float, float]


class DriveSummary(Record):
    """All of it; `conetl inspect --json` prints it."""

    drive_id: str
    source_path: str
    map_srid: int
    rig: RigSummary
    expected_pairs: int
    usable_pairs: int
    lost_by_reason: dict[str, int]
    lost: tuple[dict[str, str], ...]
    """record, reason and detail of each rejection."""
    captured_from: datetime
    captured_to: datetime
    duration_s: float
    rate_hz: float | None
    """From the median step; None for a single pair."""
    length_m: float
    """Level length of the drive path, straight between usable pairs."""
    gaps: tuple[Gap, ...]
    poses: PoseSummary
    extent: Extent


def summarise(drive: Drive, rejections: Sequence[Rejection]) -> DriveSummary:
    """The summary of a drive and its rejections. No image is opened."""
    pairs = drive.frame_pairs
    positions = np.array([pair.pose.map_t_body_m for pair in pairs])
    sigmas = np.array([pair.pose.sigma_enu_m for pair in pairs])
    times_s = np.array([(pair.captured_at_ns - pairs[0].captured_at_ns) * 1e-9 for pair in pairs])
    seconds, metres = np.diff(times_s), np.hypot(*np.diff(positions[:, :2], axis=0).T)
    horizontal = np.maximum(sigmas[:, 0], sigmas[:, 1])
    in_time = seconds > GAP_FACTOR * float(np.median(seconds)) if len(seconds) else np.zeros(0, bool)
    single = _jumps(pairs, times_s, positions, horizontal)
    across = _jumps_across_gaps(pairs, times_s, positions, sigmas, in_time)
    jumps = tuple(sorted({jump.frame: jump for jump in (*single, *across)}.values(), key=lambda jump: jump.frame))
    geodetic = geodesy.to_geodetic(drive.map_srid, positions)
    return DriveSummary(
        drive_id=drive.drive_id, source_path=drive.source_path, map_srid=drive.map_srid, rig=_rig(drive),
        expected_pairs=drive.expected_frame_count, usable_pairs=len(pairs),
        lost_by_reason=dict(sorted(Counter(r.reason.value for r in rejections).items())),
        lost=tuple(r.model_dump(mode="json", include={"record", "reason", "detail"}) for r in rejections),
        captured_from=drive.captured_from, captured_to=drive.captured_to, duration_s=float(times_s[-1] - times_s[0]),
        rate_hz=float(1.0 / np.median(seconds)) if len(seconds) else None, length_m=float(metres.sum()),
        gaps=_gaps(pairs, seconds, metres, in_time, {jump.frame for jump in single}),
        poses=PoseSummary(
            horizontal_sigma_median_m=float(np.median(horizontal)), horizontal_sigma_max_m=float(horizontal.max()),
            vertical_sigma_median_m=float(np.median(sigmas[:, 2])),
            yaw_sigma_median_deg=float(np.degrees(np.median([pair.pose.sigma_rpy_rad[2] for pair in pairs]))),
            jumps=jumps,
        ),
        extent=Extent(
            east_m=_span(positions[:, 0]), north_m=_span(positions[:, 1]), height_m=_span(positions[:, 2]),
            lon_deg=_span(geodetic[:, 1]), lat_deg=_span(geodetic[:, 0]),
        ),
    )  # fmt: skip


def _rig(drive: Drive) -> RigSummary:
    rig = drive.rig
    raw = rig.rectified_from or rig
    stored = stored_camera(rig, "left")
    return RigSummary(
        rig_id=rig.rig_id, baseline_m=rig.baseline_m, focal_px=rig.left.fx_px, width_px=rig.left.width_px,
        height_px=rig.left.height_px, stored_width_px=stored.width_px, stored_height_px=stored.height_px,
        lens=raw.left.lens.model, rectified_on_reading=rig.rectified_from is not None,
        calibration_covariance_known=raw.calibration_covariance is not None,
    )  # fmt: skip


def _span(values: Floats) -> tuple[float, float]:
    return float(values.min()), float(values.max())


def _gaps(
    pairs: Sequence[FramePair], seconds: Floats, metres: Floats, in_time: Bools, jumped: set[int]
) -> tuple[Gap, ...]:
    """Steps that are too long; those to and from a jump are not gaps in space."""
    moving = metres[metres > 0.05]
    wrong = np.array([pair.frame_index in jumped for pair in pairs])
    long_m = max(LEAST_GAP_M, GAP_FACTOR * float(np.median(moving)) if len(moving) else 0.0)
    in_space = (metres > long_m) & ~(wrong[:-1] | wrong[1:])
    return tuple(
        Gap(
            after_frame=pairs[i].frame_index, before_frame=pairs[i + 1].frame_index, seconds=float(seconds[i]),
            metres=float(metres[i]), in_time=bool(in_time[i]), in_space=bool(in_space[i]),
        )
        for i in np.flatnonzero(in_time | in_space).tolist()
    )  # fmt: skip


def _jumps(pairs: Sequence[FramePair], times_s: Floats, positions: Floats, horizontal_m: Floats) -> tuple[Jump, ...]:
    """Positions off the line between their neighbours, the worst of each run: a jump affects its neighbours, too."""
    before, here, after = slice(None, -2), slice(1, -1), slice(2, None)
    weight = ((times_s[here] - times_s[before]) / (times_s[after] - times_s[before]))[:, None]
    expected = (1.0 - weight) * positions[before, :2] + weight * positions[after, :2]
    off = np.hypot(*(positions[here, :2] - expected).T)
    wild = (off > np.maximum(JUMP_M, JUMP_SIGMAS * horizontal_m[here])) & (
        times_s[after] - times_s[before] <= JUMP_WITHIN_S
    )
    padded = np.concatenate([[0.0], np.where(wild, off, 0.0), [0.0]])
    worst = wild & (padded[1:-1] >= padded[:-2]) & (padded[1:-1] > padded[2:])
    return tuple(Jump(frame=pairs[i + 1].frame_index, off_m=float(off[i])) for i in np.flatnonzero(worst).tolist())


def _jumps_across_gaps(
    pairs: Sequence[FramePair], times_s: Floats, positions: Floats, sigmas: Floats, in_time: Bools
) -> list[Jump]:
    """Gaps in time over which the positions move otherwise than the speeds before and after them allow."""
    steps_m = np.diff(positions, axis=0)
    speeds = steps_m / np.maximum(np.diff(times_s), 1e-3)[:, None]
    speeds[in_time] = np.nan
    found = []
    for k in np.flatnonzero(in_time).tolist():
        near = sigmas[k : k + 2]
        errors_m = np.maximum(JUMP_M, JUMP_SIGMAS * np.array([near[:, :2].max(), near[:, 2].max()]))
        if off_m := unexplained_step_m(steps_m, speeds, times_s, k, errors_m):
            found.append(Jump(frame=pairs[k + 1].frame_index, off_m=off_m))
    return found
