"""Whether the object of a track stood while it was observed: a cone that rolls or is carried past stands nowhere.

The observations of a track are adjusted once more with a constant velocity as a further unknown, beside the position, the errors
that they share, and those of the poses with their joint covariance (`variance_components`). The squared velocity over its
covariance is the likelihood ratio of motion against rest: chi-square of two degrees of freedom for an object that stands. What
the tracks of a drive have in common, as where a baseline is wrong, is the vehicle's.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from conetl.model.arrays import Floats
from conetl.model.drive import FramePair, StereoMatch, Track
from conetl.model.rejections import Rejection, RejectionReason
from conetl.model.rig import Rig
from conetl.tracking.error_propagation import PoseCov
from conetl.tracking.variance_components import adjusted, observed_cone, usable_pairs

#: Objects that stand in four rendered worlds and on a real street have chi-squares of up to 15 (146 tracks); observations
#: moved by 0.3 m/s exceed 25 in nine of ten of these tracks. Slower than this (m/s) it blurs its position and no more.
_LEAST_CHI2, _LEAST_MS = 25.0, 0.15
#: Prior of the velocity (one sigma), and with how many tracks what they have in common is known.
_PRIOR_MS, _LEAST_TRACKS = 5.0, 5
_LEAST_PAIRS = 3


def without_moving(
    tracks: Sequence[Track],
    matches: Sequence[StereoMatch],
    frame_pairs: Sequence[FramePair],
    rig: Rig,
    pose_cov: PoseCov,
) -> tuple[list[Track], list[Rejection]]:
    """The tracks, numbered anew, of objects that stood, and rejections of the others.

    frame_pairs: with refined poses; pose_cov: of these. matches: with their last sigmas.
    """
    match_of = {(m.frame_index, m.match_index): m for m in matches}
    pair_of = {pair.frame_index: pair for pair in frame_pairs}
    found = {}
    for track in tracks:
        pairs = usable_pairs(track, match_of)
        if len(pairs) >= _LEAST_PAIRS:
            found[track.track_index] = _velocity(np.array(track.xyz_m), pairs, rig, pair_of, pose_cov)
    common = np.zeros(2)
    if len(found) >= _LEAST_TRACKS:
        common = np.median([velocity for velocity, _ in found.values()], axis=0)
    kept: list[Track] = []
    rejections: list[Rejection] = []
    for track in tracks:
        velocity, cov = found.get(track.track_index, (common, np.eye(2)))
        # A velocity that all tracks share, or that this one has beside it, may be the vehicle's.
        off = min(velocity, velocity - common, key=np.linalg.norm)
        chi2, speed_ms = float(off @ np.linalg.solve(cov, off)), float(np.linalg.norm(off))
        if chi2 <= _LEAST_CHI2 or speed_ms <= _LEAST_MS:
            kept.append(track.model_copy(update={"track_index": len(kept)}))
        else:
            rejections.append(_moving(track, speed_ms, chi2))
    return kept, rejections


def _velocity(
    xyz_m: Floats, pairs: Sequence[StereoMatch], rig: Rig, pair_of: Mapping[int, FramePair], pose_cov: PoseCov
) -> tuple[Floats, Floats]:
    """(2,) m/s east and north of an object, and (2, 2) its covariance."""
    poses = {index: pair.pose for index, pair in pair_of.items()}
    cone = observed_cone(xyz_m, pairs, rig, poses, pose_cov)
    at_ns = np.array([pair_of[m.frame_index].captured_at_ns for m in pairs], dtype=np.int64)
    seconds = (at_ns - at_ns[0]) * 1e-9
    by_velocity = cone.design[:, :, :3] * (_PRIOR_MS * (seconds - seconds.mean()))[:, None, None]
    cone = cone._replace(design=np.concatenate([cone.design, by_velocity], axis=2))
    unknown, cov, _, _ = adjusted(cone, cone.stated_px2 + cone.fixed_px2)
    return _PRIOR_MS * unknown[-3:-1], _PRIOR_MS**2 * cov[-3:-1, -3:-1]


def _moving(track: Track, speed_ms: float, chi2: float) -> Rejection:
    return Rejection(
        step="tracks",
        reason=RejectionReason.MOVING,
        record=f"track first seen in frame pair {track.members[0][0]}",
        detail=f"moves by {speed_ms:.1f} m/s (chi-square {chi2:.0f}, expected at most {_LEAST_CHI2:g}); objects of a map stand",
        payload=track.model_dump(mode="json"),
    )
