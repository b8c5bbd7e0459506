"""The clock of images against that of a trajectory file: as drive.yaml states it, or found from the images."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from conetl.model.errors import DriveFolderError
from conetl.model.records import Rig, Side
from conetl.perception.unguided_odometry import measure_motions
from conetl.readers.drives.drive_yaml import Clock
from conetl.readers.drives.poses import Samples
from conetl.tracking.clock_search import ImageClock, find_clock_offset, rates_of

#: So many parts of 2.5 minutes of a drive are tried.
_MOST_PARTS = 4
#: Of an offset that is stated without one (s), as from a flash of light. The poses tell what is left of it.
_STATED_SIGMA_S = 0.01


def image_clock(
    settings: Clock | None,
    track: Samples,
    times_ns: Sequence[int],
    rig: Rig,
    read: Callable[[int, Side], NDArray[np.uint8]],
    *,
    from_course: bool,
) -> ImageClock:
    """What to add to the times of the images to have those of the trajectory, and its sigma (s).

    times_ns: of the frame pairs, rising; rig: rectified; read: the rectified image of a frame pair, by its number in `times_ns`.
    Only an offset that is to be estimated reads images: 2.5 minutes of them, the following where those show nothing, 10 minutes
    at most. from_course: the trajectory has no attitudes of its own. Raises DriveFolderError where the offset cannot be
    determined.
    """
    if settings is None:
        return ImageClock(0.0, 0.0)  # the parameters' `clock_sigma_s` covers it
    if settings.offset_s != "estimate":
        return ImageClock(settings.offset_s, settings.sigma_s or _STATED_SIGMA_S)
    poses, first = track.map_SE3_body, 0
    for _ in range(_MOST_PARTS):
        motions = measure_motions(times_ns, rig, read, first)
        if not motions:
            break
        rates = rates_of(motions, dict(enumerate(times_ns)), rig)
        found = find_clock_offset(
            rates, times_ns[0], track.times_ns, poses[:, :3, 3], None if from_course else poses[:, :3, :3],
            track.sigma[:, :3], settings.search_s,
        )  # fmt: skip
        if found is not None:
            return found
        first = motions[-1].second_frame_index
    raise DriveFolderError(
        f"{track.name}: the offset between the clocks of images and trajectory cannot be determined within "
        f"+-{settings.search_s:g} s: the drive shows too few turns and changes of speed, or images and trajectory are not of the "
        "same time. State it in drive.yaml: 'clock: {offset_s: ..., sigma_s: ...}', the seconds to add to the times of the images"
    )
