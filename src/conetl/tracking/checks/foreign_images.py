"""A health check for images of another recording among those of a drive."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from conetl.geometry.linear_reference import evenly_spaced
from conetl.geometry.motion.stereo_motion import RelativeMotion
from conetl.geometry.motion.stereo_tracks import expected_motions, motions_of, shifts_between
from conetl.model.arrays import Floats
from conetl.model.drive import FramePair
from conetl.model.health import HealthCheck, hold_if
from conetl.model.params import TrajectoryParams
from conetl.model.rig import Rig, Side
from conetl.perception.visual_odometry import follow_drive
from conetl.perception.working_size import ImageReader

#: Images of another path contradict the log by this much (m), and by this many times the change of an even log; it turns
#: by no more than this much (rad) beyond the mean of the intervals before and after.
_ELSEWHERE_M, _EVEN_TIMES = 0.2, 2.0
_EVEN_RAD = np.radians(0.3)
#: Intervals, by their first and second pair counted from the one before, that cross it; and those beside it of equal lengths.
_ACROSS, _BESIDE = ((0, 1), (-1, 1), (0, 2), (-1, 2)), ((-1, 0), (1, 2), (-2, 0), (1, 3))
#: At most this many intervals are tried.
_MOST_TRIED = 40


def check_recording(
    pairs: Sequence[FramePair],
    rig: Rig,
    motions: Sequence[RelativeMotion],
    read: ImageReader,
    params: TrajectoryParams,
) -> HealthCheck:
    """Whether images of another recording begin somewhere: there the images depart from the log, although the log is smooth.

    The motions before and after agree with the log. The one between them contradicts it, and so do all motions across it; or none
    of these can be measured, although those beside it can. read: grey images of a frame pair.
    """
    expected = np.array(expected_motions(pairs, rig))
    off_m = shifts_between(pairs, motions) - expected[:, :3, 3]
    sizes_m = np.linalg.norm(off_m, axis=1)
    seconds = np.diff([pair.captured_at_ns for pair in pairs]) * 1e-9
    turns = Rotation.from_matrix(expected[:, :3, :3]).as_rotvec()
    uneven_m, uneven_rad, uneven_s = (
        np.linalg.norm(x[1:-1] - (x[:-2] + x[2:]) / 2, axis=1) for x in (expected[:, :3, 3], turns, seconds[:, None])
    )
    even = (uneven_m < _ELSEWHERE_M / _EVEN_TIMES) & (uneven_rad < _EVEN_RAD) & (uneven_s < seconds[1:-1] / 2)
    usual = sizes_m < _ELSEWHERE_M / _EVEN_TIMES
    suspected = np.flatnonzero(even & usual[:-2] & ~(sizes_m[1:-1] < _ELSEWHERE_M) & usual[2:]) + 1
    found = [
        pairs[k].frame_index
        for k in evenly_spaced(suspected.tolist(), _MOST_TRIED)
        if _goes_elsewhere(k, off_m[k], pairs, rig, read, params)
    ]
    detail = "Images and GNSS/INS show the same path."
    if found:
        detail = (
            f"After frame pair {' and '.join(map(str, found))} the images jump and GNSS/INS does not, while both agree before "
            "and after: images of another recording are mixed with these, or frames were lost. Check the names and numbers of "
            "the images."
        )
    return hold_if(found, "images of one recording", detail, value=float(len(found)), limit=0.0)


def _goes_elsewhere(
    k: int, off_m: Floats, pairs: Sequence[FramePair], rig: Rig, read: ImageReader, params: TrajectoryParams
) -> bool:
    """Whether all motions across the interval after pair k agree with it. off_m (3,): NaN where it was not measured."""

    def evened(pair: FramePair, side: Side) -> NDArray[np.uint8]:
        return np.asarray(cv2.equalizeHist(read(pair, side)))  # the exposure may change from one image to the next

    def off_of(first: int, second: int) -> Floats:
        both = pairs[k + first], pairs[k + second]
        [motion] = motions_of(follow_drive(both, rig, evened, params), both, rig, params)
        return np.asarray(motion.shift_m() - expected_motions(both, rig)[0][:3, 3])

    across = np.array([off_of(*ends) for ends in _ACROSS])
    if np.isnan(off_m).any():
        beside = np.array([off_of(*ends) for ends in _BESIDE if k + ends[0] >= 0 and k + ends[1] < len(pairs)])
        return bool(np.isnan(across).all() and (np.linalg.norm(beside, axis=1) < _ELSEWHERE_M).all())
    known = across[~np.isnan(across[:, 0])]
    return len(known) > 1 and bool((np.linalg.norm(known - off_m, axis=1) < np.linalg.norm(off_m) / 2).all())
