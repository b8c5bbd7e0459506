"""Cones of a drive as landmarks of its trajectory.

Visual odometry follows points that change from frame to frame, and a calibration error scales all its distances; a cone is one
fixed point in many frames. The poses are those of the adjustment with cones, their covariance that of the adjustment without:
the same observations make the tracks afterwards and must count only once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from conetl.geometry.motion.stereo_motion import RelativeMotion
from conetl.geometry.packing import cov3, cov_matrix
from conetl.geometry.rig import map_SE3_left
from conetl.model.params import IngestParams
from conetl.model.records import FramePair, Pose, Position, Rig, StereoMatch
from conetl.tracking.association import chain_positions
from conetl.tracking.positions import locate_positions
from conetl.tracking.trajectory import RefinedTrajectory, RefinementOutcome, motion_error, refine_trajectory

#: Neighbouring observations of a cone are correlated (background, sun, calibration): so many count as one.
_CORRELATED = 4.0


def refine_with_cones(
    frame_pairs: Sequence[FramePair],
    rig: Rig,
    motions: Sequence[RelativeMotion],
    matches: Sequence[StereoMatch],
    params: IngestParams,
) -> RefinedTrajectory:
    """Refined poses by visual odometry and by cones observed often enough to be tracks.

    frame_pairs: as logged. motions: as for `refine_trajectory`. The result is that of visual odometry alone without
    `trajectory.cone_landmarks`, beside good GNSS/INS, without such cones, and if the adjustment with cones fails.
    """
    alone = refine_trajectory(frame_pairs, rig, motions, params.trajectory)
    if not params.trajectory.cone_landmarks or alone.outcome is not RefinementOutcome.REFINED:
        return alone
    if np.median([max(pair.pose.sigma_enu_m[:2]) for pair in frame_pairs]) < params.trajectory.cone_landmarks_from_m:
        return alone
    pairs = {pair.frame_index: pair for pair in alone.frame_pairs}
    positions, _ = locate_positions([m for m in matches if m.refined], pairs, rig, params.position)
    left = {index: map_SE3_left(pair.pose, rig) for index, pair in pairs.items()}
    groups = chain_positions(positions, left, params.track, motion_error(alone))
    cones = [[_down_weighted(p) for p in group] for group in groups if len(group) >= params.track.min_observations]
    if not cones:
        return alone
    together = refine_trajectory(frame_pairs, rig, motions, params.trajectory, cones)
    if together.outcome is not RefinementOutcome.REFINED:
        return alone
    pairs_of = zip(together.frame_pairs, alone.frame_pairs, strict=True)
    return replace(
        together,
        frame_pairs=tuple(_with_sigmas_of(pair, stated.pose) for pair, stated in pairs_of),
        covariance=alone.covariance,
        detail=f"{together.detail}; {len(cones)} cones as landmarks",
    )


def _with_sigmas_of(pair: FramePair, pose: Pose) -> FramePair:
    sigmas = {"sigma_enu_m": pose.sigma_enu_m, "sigma_rpy_rad": pose.sigma_rpy_rad}
    return pair.model_copy(update={"pose": pair.pose.model_copy(update=sigmas)})


def _down_weighted(position: Position) -> Position:
    return position.model_copy(update={"camera_cov_m2": cov3(_CORRELATED * cov_matrix(position.camera_cov_m2))})
