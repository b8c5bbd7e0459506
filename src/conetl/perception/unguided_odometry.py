"""Visual odometry without known poses, for finding the offset of the clocks.

Each interval starts from the motion of the interval before, the first from trial speeds. Images are reduced, so that points may
move far between two of them; the motions are accurate to a few millimetres, less than those of a drive with poses.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from conetl.geometry.motion.stereo_motion import MotionStatus, RelativeMotion, estimate_motion
from conetl.geometry.motion.stereo_tracks import cameras_of, relative_motion
from conetl.geometry.pose import to_matrix3
from conetl.model.arrays import Floats, Image
from conetl.model.drive import FramePair, Pose
from conetl.model.params import TrajectoryParams
from conetl.model.rig import Rig, Side
from conetl.perception.visual_odometry import follow_spans

#: Images are followed at this width (px), this many per second, and for this many intervals (2.5 minutes).
_WIDTH_PX, _RATE_HZ, _MOST_INTERVALS = 640, 10.0, 1500
#: Speeds that are tried where no motion is known (m/s).
_TRIED_M_S = (0.0, 5.0, 10.0, 18.0, 28.0)
#: After an interval that could not be measured, speeds are tried again only occasionally: a covered lens must not take long.
_TRY_EVERY = 10
#: A motion may differ by this much from the one before (m, rad).
_REACH_M, _REACH_RAD = 3.0, 0.15


def measure_motions(
    times_ns: Sequence[int], rig: Rig, read: Callable[[int, Side], Image], first: int = 0
) -> list[RelativeMotion]:
    """Motions of the left camera between images about 0.1 s apart, from the one numbered `first` on, for at most 2.5 minutes.

    times_ns: of the frame pairs, rising. rig: rectified. read: the rectified image of a frame pair (its number in `times_ns`),
    grey or colour; raises ImageFileError for a broken one. Frame indices of the result are these numbers. Images that show
    nothing give motions without a measurement.
    """
    params = TrajectoryParams(max_width_px=_WIDTH_PX, gate_m=_REACH_M, gate_rad=_REACH_RAD)
    step_s = float(np.median(np.diff(times_ns))) * 1e-9 if len(times_ns) > 1 else 1.0
    stride = max(round(1 / (_RATE_HZ * max(step_s, 1e-3))), 1)
    numbers = list(range(first, len(times_ns), stride))[: _MOST_INTERVALS + 1]
    unknown = Pose(
        map_R_body=to_matrix3(np.eye(3)), map_t_body_m=(0.0, 0.0, 0.0), sigma_enu_m=(0.0, 0.0, 0.0), sigma_rpy_rad=(0.0, 0.0, 0.0)
    )  # fmt: skip
    pairs = [
        FramePair(frame_index=n, left_path="", right_path="", captured_at_ns=times_ns[n], pose=unknown) for n in numbers
    ]
    cameras, asked = cameras_of(rig), [np.eye(4)]

    def spans() -> Iterator[tuple[int, int, Floats]]:
        """The interval that is requested next: the last one of `asked` may change between two."""
        while state[0] + 1 < len(pairs):
            yield state[0], state[0] + 1, asked[0]

    def image(pair: FramePair, side: Side) -> Image:
        return read(pair.frame_index, side)

    state, failures, tried, before = [0], 0, 0, None
    found: list[RelativeMotion] = []
    for tracks in follow_spans(spans(), pairs, rig, image, params):
        first_px, second_px, sigma_px = tracks.points()
        motion = None
        if tracks.missing is None:
            motion = estimate_motion(
                cameras, first_px[:, :3], second_px[:, :3], sigma_px, asked[0], params, seed=state[0], guess=before
            )
        tried += 1
        good = motion is not None and motion.status is MotionStatus.OK
        seconds = (pairs[state[0] + 1].captured_at_ns - pairs[state[0]].captured_at_ns) * 1e-9
        if not good and before is None and tried < len(_TRIED_M_S) and failures % _TRY_EVERY == 0:
            asked[0] = _forward(_TRIED_M_S[tried] * seconds)
            continue
        found.append(relative_motion(tracks, motion))
        failures = 0 if good else failures + 1
        before = motion.next_SE3_first if good and motion is not None else None
        asked[0], tried, state[0] = _forward(0.0) if before is None else before, 0, state[0] + 1
    return found


def _forward(distance_m: float) -> Floats:
    """(4, 4) next_SE3_first of a camera that moves straight on."""
    motion = np.eye(4)
    motion[2, 3] = -distance_m
    return motion
