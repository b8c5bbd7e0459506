"""What every reader of a trajectory file gives."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


class RecordedTrajectory(NamedTuple):
    """The valid records of one file in the order of their time, and what is wrong with the others."""

    name: str
    """Of the file, for messages."""
    times_ns: NDArray[np.int64]
    """(N,) UTC nanoseconds since 1970, strictly rising."""
    positions: Floats
    """(N, 3): latitude, longitude (degrees, WGS 84) and height above its ellipsoid (m); of a local file x, y, z (m)."""
    is_local: bool
    """Whether the positions are those of a level frame whose location `georeference` of drive.yaml states."""
    rotations: Floats | None
    """(N, 3, 3): from the body (forward, left, up) to east, north, up, of a local file to its frame; None where it has none."""
    sigma: Floats
    """(N, 6): east, north, up (m), roll, pitch, yaw (rad); NaN where the file states none."""
    bad: dict[int, str]
    """What is wrong with other records, by their time (UTC ns)."""
