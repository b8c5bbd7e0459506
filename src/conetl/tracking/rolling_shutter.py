"""Rolling shutter of a whole drive: stereo matches as of a global shutter, and what an unknown readout means for positions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from conetl.geometry.motion.rolling_shutter import (
    camera_rates,
    is_rolling,
    points_at_stamp,
    readout_sigma_s,
    readouts_s,
    row_shares,
    shutter_of,
    with_shutters,
)
from conetl.geometry.motion.stereo_tracks import cameras_of
from conetl.model.drive import Drive, FramePair, StereoMatch
from conetl.model.params import TrajectoryParams
from conetl.model.rig import Rig, Shutter

_POINTS = ("foot", "centre", "tip")


def with_video_prior(drive: Drive, params: TrajectoryParams, *, is_video: bool) -> Drive:
    """The drive with the prior of a rolling shutter for cameras of videos whose shutter is not stated."""
    if not (is_video and params.video_readout_sigma_ms):
        return drive
    prior = Shutter(readout_ms=0.0, readout_sigma_ms=params.video_readout_sigma_ms)
    left, right = (shutter_of(drive.rig, side) or prior for side in ("left", "right"))
    return drive.model_copy(update={"rig": with_shutters(drive.rig, left, right)})


def matches_at_stamp(matches: Sequence[StereoMatch], frame_pairs: Sequence[FramePair], rig: Rig) -> list[StereoMatch]:
    """The matches with image points as a global shutter would have seen them at the time stamp of their frame pair.

    frame_pairs: with poses, also of pairs without matches. Not to be applied twice.
    """
    if not readouts_s(rig).any() or len(frame_pairs) < 2:
        return list(matches)
    rank = {pair.frame_index: k for k, pair in enumerate(frame_pairs)}
    own = [k for k, match in enumerate(matches) if match.frame_index in rank]
    if not own:
        return list(matches)
    rates = camera_rates(frame_pairs, rig)[[rank[matches[k].frame_index] for k in own]]
    cameras, moved = cameras_of(rig), list(matches)
    seen = np.array([[_pixels(matches[k], point) for k in own] for point in _POINTS])
    found = [points_at_stamp(rig, cameras, px, rates) for px in seen]
    for row, k in enumerate(own):
        values: dict[str, tuple[float, float]] = {}
        for point, px in zip(_POINTS, found, strict=True):
            u_left, v_left, u_right, v_right = px[row].tolist()
            values |= {f"{point}_left_uv_px": (u_left, v_left), f"{point}_right_uv_px": (u_right, v_right)}
        moved[k] = matches[k].model_copy(update=values)
    return moved


def _pixels(match: StereoMatch, point: str) -> tuple[float, ...]:
    return (*getattr(match, f"{point}_left_uv_px"), *getattr(match, f"{point}_right_uv_px"))


def row_time_sigma_s(matches: Sequence[StereoMatch], rig: Rig) -> float:
    """Sigma of the instants at which the feet of cones were exposed, of an unknown readout: common to the drive.

    Each row has its own share of the readout. Positions along the ray have variances by the fourth power of the depth, so that
    near observations, at low rows, make the position.
    """
    if not (is_rolling(rig) and matches):
        return 0.0
    feet = np.array([_pixels(match, "foot") for match in matches])
    shares = row_shares(rig, "left", feet[:, :2])
    weight = np.maximum(feet[:, 0] - feet[:, 2], 1e-3) ** 4
    return float(np.sqrt(np.average(shares**2, weights=weight))) * readout_sigma_s(rig)
