"""Whether the object of a track was stationary while it was observed: a cone that rolls or is carried past is not mapped.

The observations of a track are adjusted again with a constant velocity as an additional unknown, beside the position, the errors
that they share, and those of the poses with their joint covariance (`variance_components`). The squared velocity over its
covariance is the likelihood ratio of motion against rest: chi-square with two degrees of freedom for a stationary object. A
velocity that all tracks of a drive share, for example because of a wrong baseline, is the vehicle's.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from conetl.model.arrays import Floats, Ints
from conetl.model.drive import Drive, StereoMatch, Track
from conetl.model.rejections import Rejection, RejectionReason
from conetl.tracking.error_propagation import PoseCov
from conetl.tracking.tracks import rejected_track
from conetl.tracking.variance_components import ObservedCone, adjusted, observed_cones

#: Stationary objects in four rendered worlds and on a real street have chi-squares of up to 15 (146 tracks); observations
#: moved by 0.3 m/s exceed 25 in nine of ten of these tracks. Slower motion (m/s) only blurs the position.
_LEAST_CHI2, _LEAST_MS = 25.0, 0.15
#: Prior of the velocity (one sigma), and how many tracks are needed to know their common velocity.
_PRIOR_MS, _LEAST_TRACKS = 5.0, 5
_LEAST_PAIRS = 3


def without_moving(
    drive: Drive, matches: Sequence[StereoMatch], tracks: Sequence[Track], pose_cov: PoseCov
) -> tuple[list[Track], list[Rejection]]:
    """The tracks of stationary objects, renumbered, and rejections of the others.

    drive: with refined poses; pose_cov: of these poses. matches: with their final sigmas.
    """
    at_ns = {pair.frame_index: pair.captured_at_ns for pair in drive.frame_pairs}
    found = {
        track.track_index: _velocity(cone, np.array([at_ns[m.frame_index] for m in pairs], dtype=np.int64))
        for track, pairs, cone in observed_cones(drive, matches, tracks, pose_cov, _LEAST_PAIRS)
    }
    common = np.zeros(2)
    if len(found) >= _LEAST_TRACKS:
        common = np.median([velocity for velocity, _ in found.values()], axis=0)
    kept: list[Track] = []
    rejections: list[Rejection] = []
    for track in tracks:
        velocity, cov = found.get(track.track_index, (common, np.eye(2)))
        # Either the whole velocity or its difference from the common one may be the vehicle's error: the smaller counts.
        off = min(velocity, velocity - common, key=np.linalg.norm)
        chi2, speed_ms = float(off @ np.linalg.solve(cov, off)), float(np.linalg.norm(off))
        if chi2 <= _LEAST_CHI2 or speed_ms <= _LEAST_MS:
            kept.append(track.model_copy(update={"track_index": len(kept)}))
        else:
            found_chi2 = f"chi-square {chi2:.0f}, limit {_LEAST_CHI2:g}"
            detail = f"moves at {speed_ms:.1f} m/s ({found_chi2}); only objects at rest are mapped"
            rejections.append(rejected_track(RejectionReason.MOVING, track, detail))
    return kept, rejections


def _velocity(cone: ObservedCone, at_ns: Ints) -> tuple[Floats, Floats]:
    """(2,) m/s east and north of an object observed at times (F,), and (2, 2) its covariance."""
    seconds = (at_ns - at_ns[0]) * 1e-9
    by_velocity = cone.design[:, :, :3] * (_PRIOR_MS * (seconds - seconds.mean()))[:, None, None]
    cone = cone._replace(design=np.concatenate([cone.design, by_velocity], axis=2))
    unknown, cov, _, _ = adjusted(cone, cone.stated_px2 + cone.fixed_px2)
    return _PRIOR_MS * unknown[-3:-1], _PRIOR_MS**2 * cov[-3:-1, -3:-1]
