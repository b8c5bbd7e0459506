"""A drive's own cones as landmarks of its trajectory: they stand still, so the path must bend until they do.

Visual odometry follows points that change from frame to frame, and what its calibration leaves over makes all its ways too
long or too short alike. A cone is one point over many frames. The poses are those of the adjustment with cones; their covariance
stays that of the adjustment without: the same sightings make the tracks afterwards, and what one says must count only once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from conetl.geometry.motion.stereo_motion import RelativeMotion
from conetl.geometry.packing import cov3, cov_matrix
from conetl.geometry.rig import map_SE3_left
from conetl.model.params import IngestParams
from conetl.model.records import FramePair, Position, Rig, StereoMatch
from conetl.tracking.association import chain_positions
from conetl.tracking.positions import locate_positions
from conetl.tracking.trajectory import RefinedTrajectory, RefinementOutcome, motion_error, refine_trajectory

#: Neighbouring sightings of a cone err alike (background, sun, calibration at its place in the image): so many count as one.
_ALIKE = 4.0


def refine_with_cones(
    frame_pairs: Sequence[FramePair],
    rig: Rig,
    motions: Sequence[RelativeMotion],
    matches: Sequence[StereoMatch],
    params: IngestParams,
) -> RefinedTrajectory:
    """Refined poses by visual odometry and by the cones that were seen often enough to be tracks.

    frame_pairs: as logged. motions: as `refine_trajectory` takes them. Without `trajectory.cone_landmarks`, beside good
    GNSS/INS, without such cones and where the adjustment with cones is not believed the result is that of visual odometry.
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
    cones = [[_counted(p) for p in group] for group in groups if len(group) >= params.track.min_observations]
    if not cones:
        return alone
    together = refine_trajectory(frame_pairs, rig, motions, params.trajectory, cones)
    if together.outcome is not RefinementOutcome.REFINED:
        return alone
    return replace(
        together,
        frame_pairs=tuple(
            bent.model_copy(
                update={
                    "pose": bent.pose.model_copy(
                        update={"sigma_enu_m": stated.pose.sigma_enu_m, "sigma_rpy_rad": stated.pose.sigma_rpy_rad}
                    )
                }
            )
            for bent, stated in zip(together.frame_pairs, alone.frame_pairs, strict=True)
        ),
        covariance=alone.covariance,
        detail=f"{together.detail}; {len(cones)} cones as landmarks",
    )


def _counted(position: Position) -> Position:
    return position.model_copy(update={"camera_cov_m2": cov3(_ALIKE * cov_matrix(position.camera_cov_m2))})
