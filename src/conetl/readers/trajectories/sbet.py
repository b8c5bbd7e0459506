"""Applanix SBET files: 17 little-endian doubles per record, and the sigmas of smrmsg files beside them, 10 doubles per record.

SBET: time (s of the GPS week, or of the day), latitude, longitude (rad), ellipsoidal height (m), 3 velocities, roll, pitch,
platform heading, wander angle (rad), 3 accelerations, 3 angular rates. True heading = platform heading - wander angle.
smrmsg: time, sigmas of north, east, down (m), of 3 velocities (m/s), of roll, pitch, heading (minutes of arc).
(Applanix, POSPac MMS user guide, SBET and SMRMSG formats.)
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from conetl.files.documents import input_errors
from conetl.model.arrays import Floats
from conetl.model.errors import InputError
from conetl.readers.trajectories.clocks import TimeFormat, common_clock
from conetl.readers.trajectories.recorded import Reading, Records, attitude
from conetl.readers.trajectories.settings import TrajectoryFile
from conetl.readers.trajectories.times import SECOND_NS, Times, gps_to_utc

WIDTH, SIGMA_WIDTH = 17, 10
RECORD_BYTES, SIGMA_BYTES = 8 * WIDTH, 8 * SIGMA_WIDTH
MAX_BYTES = 16 << 30
MAX_SIGMA_GAP_S = 10.0
"""Sigmas farther away than this from a record are unknown."""
_PIECE = 500_000
_LEAST_RECORDS = 2


def looks_like(size: int, head: bytes) -> bool:
    """Whether the first records of a file can be those of a vehicle."""
    if size % RECORD_BYTES or size < _LEAST_RECORDS * RECORD_BYTES:
        return False
    rows = np.frombuffer(head[: len(head) // RECORD_BYTES * RECORD_BYTES], "<f8").reshape(-1, WIDTH)
    with np.errstate(invalid="ignore"):
        plausible = (
            (rows[:, 0] >= 0) & (rows[:, 0] < 2 * 604_800) & (np.abs(rows[:, 1]) <= np.pi / 2) & (np.abs(rows[:, 2]) <= np.pi)
            & (np.abs(rows[:, 3]) < 1e4) & (np.abs(rows[:, 4:11]) < 1e3).all(axis=1)
        )  # fmt: skip
    return bool(np.mean(plausible) > 0.9 and np.mean(np.abs(rows[:, 1]) > 1e-6) > 0.5)


def read(path: Path, settings: TrajectoryFile) -> Reading:
    """The records of an SBET file, with sigmas where there is a smrmsg file. Raises InputError."""
    rows = _mapped(path, WIDTH)
    if not len(rows):
        raise InputError(f"{path}: the file is empty; expected records of {RECORD_BYTES} bytes")
    start = rows[:100, 0]
    first = [repr(float(value)) for value in start[np.isfinite(start)]]
    clock = common_clock(first, "time", path, settings, scale="gps", unit="s")
    if clock.kind not in {"week", "day"} or clock.scale not in {"gps", "UTC"}:
        raise InputError(
            f"{path}: its times are seconds of a GPS week or of a day, of GPS time or UTC; found {first[:1]}"
        )
    sigma_path = sigma_file(path)
    sigmas = None if sigma_path is None else _mapped(sigma_path, SIGMA_WIDTH)
    return Reading(_records(rows, sigmas, clock))


def _mapped(path: Path, width: int) -> Floats:
    """(N, width) of a file, read as it is used. Raises InputError."""
    with input_errors(path):
        size = path.stat().st_size
        if size % (8 * width) or size > MAX_BYTES:
            raise InputError(
                f"{path}: has {size:,} bytes; expected records of {8 * width} bytes each, "
                f"and at most {MAX_BYTES:,} bytes. Was it copied completely?"
            )
        return np.memmap(path, "<f8", "r", shape=(size // (8 * width), width)) if size else np.zeros((0, width))


def sigma_file(path: Path) -> Path | None:
    """The smrmsg file of an SBET file: smrmsg_X.out beside sbet_X.out, or the only one beside it. Raises InputError."""
    found = sorted(p for p in path.parent.glob("[sS][mM][rR][mM][sS][gG]*") if p.is_file())
    own = [p for p in found if p.stem.lower().removeprefix("smrmsg") == path.stem.lower().removeprefix("sbet")]
    if len(own or found) > 1:
        wanted = f"smrmsg{path.stem.lower().removeprefix('sbet')}.out"
        raise InputError(f"{path}: {', '.join(p.name for p in found[:5])} are beside it; name one of them {wanted}")
    return next(iter(own or found), None)


def _records(rows: Floats, sigmas: Floats | None, clock: TimeFormat) -> Iterator[Records]:
    """Pieces of the file; only one is in memory."""
    sigma_times = None if sigmas is None else _unwrapped_s(np.array(sigmas[:, 0]), clock.period_ns)
    # The whole column, 58 MB for ten hours at 200 Hz: a week may end anywhere in it.
    stated = np.array(rows[:, 0])
    usable = (stated >= 0) & (stated <= 2 * 604_800)  # NaN fails too
    unwrapped = _unwrapped_s(np.where(usable, stated, 0.0), clock.period_ns)
    for first in range(0, len(rows), _PIECE):
        piece = np.array(rows[first : first + _PIECE])
        seconds, finite = unwrapped[first : first + _PIECE], usable[first : first + _PIECE]
        # Seconds and their fractions apart: a double of ns since 1970 has steps of 256 ns.
        whole = np.floor(seconds)
        times: Times = whole.astype(np.int64) * SECOND_NS + np.rint((seconds - whole) * 1e9).astype(np.int64)
        times += clock.start_ns
        times = np.where(finite, gps_to_utc(times) if clock.scale == "gps" else times, 0)
        degrees = np.degrees(piece[:, [1, 2, 7, 8, 9, 10]])
        bounded = (np.abs(degrees[:, 2:]) <= 1080.0).all(axis=1)
        heading = np.where(bounded, degrees[:, 4] - degrees[:, 5], np.nan)
        rotations = attitude(np.where(bounded, degrees[:, 2], 0.0), np.where(bounded, degrees[:, 3], 0.0), heading)
        positions = np.column_stack([degrees[:, :2], piece[:, 3]])
        sigma = np.full((len(piece), 6), np.nan)
        if sigmas is not None and sigma_times is not None and len(sigma_times):
            sigma = _sigmas_at(seconds, sigma_times, sigmas)
        wrong = dict.fromkeys(np.flatnonzero(~finite).tolist(), "the time is not a number of seconds")
        yield Records(times, positions, rotations, sigma, wrong, (f"record {first + i}" for i in range(len(piece))))


def _unwrapped_s(seconds: Floats, period_ns: int) -> Floats:
    """Times (N,) of a week or day, those after its end above the period: from its last 14th to the first."""
    period = period_ns * 1e-9
    with np.errstate(invalid="ignore"):
        late = seconds[:-1] > period * 13 / 14
        # Two late times, so that one wild time does not move all that follow.
        turned = late & np.concatenate([[True], late[:-1]])[: len(late)] & (seconds[1:] < period / 14)
    return np.asarray(seconds + period * np.concatenate([[0], np.cumsum(turned)]))


def _sigmas_at(seconds: Floats, times: Floats, rows: Floats) -> Floats:
    """(N, 6) east, north, up (m), roll, pitch, yaw (rad) at times (N,): the larger of the neighbours (M,)."""
    after = np.searchsorted(times, seconds).clip(0, len(times) - 1)
    before = (after - (times[after] > seconds)).clip(0)
    near = np.minimum(np.abs(times[after] - seconds), np.abs(times[before] - seconds)) <= MAX_SIGMA_GAP_S
    used = np.maximum(rows[before], rows[after])[:, [2, 1, 3, 7, 8, 9]]
    used[:, 3:] = np.radians(used[:, 3:] / 60.0)
    return np.where(near[:, None], used, np.nan)
