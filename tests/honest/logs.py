"""Logs of known poses with errors of many shapes, whose root mean square over all draws is the sigma that the log states.

Sigmas are the total of an error: of its constant part, of what changes slowly and of what is new in every record. Beside the
shape itself, the clock and the lever arm err by their priors where the shape is not about them.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from functools import cache

import numpy as np
from numpy.typing import NDArray
from pyproj import Transformer
from scipy.spatial.transform import Rotation

from conetl.geometry import pose as se3
from conetl.model.drive import FramePair
from conetl.model.params import TrajectoryParams
from conetl.readers.drives.poses import Samples
from conetl.readers.drives.sparse_poses import pose_reader
from conetl.readers.trajectories.tables import LEVEL_SIGMA_RAD
from tests.folders import SHARED

Floats = NDArray[np.float64]
#: Times (K,) in seconds -> true poses (K, 4, 4) body -> map; also some seconds before and after the images.
TruePoses = Callable[[Floats], Floats]
RECEIVER = SHARED / "comma2k19_segment"
PARAMS = TrajectoryParams()
#: Heights err by this much more than eastings and northings, headings than roll and pitch.
_UP, _HEADING = 1.5, 3.0
#: Sigmas of roll and pitch in degrees that a log states: of an INS with RTK, and of two cheaper ones.
_ATTITUDES_DEG = (0.02, 0.05, 0.17)
_M_PER_DEG = 111_320.0
#: Of eastings and northings of a fix.
_FIXED_M = 0.02
#: Velocities are differences over twice this time.
_STEP_S = 0.05
#: A trajectory of 1 Hz begins and ends so long before and after the images.
_AROUND_S = 12.0


@dataclass(frozen=True)
class LogErrors:
    """What a log adds to the poses of K records, and what it states about that."""

    position_m: Floats
    """(K, 3) east, north, up."""
    sigma_m: Floats
    """(K, 3)"""
    turn_rad: Floats
    """(K, 3) about the axes of the body: roll, pitch, yaw."""
    sigma_rad: Floats
    """(K, 3)"""
    late_s: Floats
    """(K,) each record is of an instant so much later than its stamp."""
    step_m: Floats = field(default_factory=lambda: np.zeros(3))
    """(3,) positions are rounded to multiples of it; zero: they are not."""
    step_rad: Floats = field(default_factory=lambda: np.zeros(3))
    """(3,) of roll, pitch and yaw."""
    has_level: bool = True
    """Whether roll and pitch are recorded; otherwise they are zero, with the sigma that a reader assumes."""
    clock_sigma_s: float | None = None
    """Stated; None: the prior."""


@dataclass(frozen=True)
class Times:
    """Of K records."""

    seconds: Floats
    """(K,) from the first image."""
    velocity_m_s: Floats
    """(K, 3) true ones."""

    @property
    def count(self) -> int:
        return len(self.seconds)


Draw = Callable[[np.random.Generator, Times, float], LogErrors]


@dataclass(frozen=True)
class LogShape:
    """One kind of error."""

    name: str
    draw: Draw
    """The last argument is the total sigma (m) of eastings and northings."""
    strengths_m: tuple[float, ...] = (0.02, 0.05, 0.3, 1.0)
    rate_hz: float | None = None
    """Of the records, where they are fewer than the images; then the log has positions only."""


# ------------------------------------------------------------------ processes of unit variance, (K, 3)


def constant(rng: np.random.Generator, times: Times) -> Floats:
    return np.tile(rng.normal(0, 1, 3), (times.count, 1))


def white(rng: np.random.Generator, times: Times) -> Floats:
    return rng.normal(0, 1, (times.count, 3))


def slow(rng: np.random.Generator, times: Times, lasts_s: float) -> Floats:
    """First-order Gauss-Markov process."""
    kept = np.exp(-np.diff(times.seconds) / lasts_s)
    found = white(rng, times)
    for k, keep in enumerate(kept, 1):
        found[k] = keep * found[k - 1] + np.sqrt(1 - keep**2) * found[k]
    return found


def slow_by_chance(rng: np.random.Generator, times: Times) -> Floats:
    """Of a correlation time between 5 and 100 s."""
    return slow(rng, times, float(np.exp(rng.uniform(np.log(5), np.log(100)))))


def mixed(rng: np.random.Generator, times: Times) -> Floats:
    """Constant, slow and white, each with a share of the variance that is drawn for each axis."""
    shares = np.sqrt(rng.dirichlet(np.ones(3), 3)).T
    parts = constant(rng, times), slow_by_chance(rng, times), white(rng, times)
    return np.asarray(sum(share * part for share, part in zip(shares, parts, strict=True)))


def saw_tooth(rng: np.random.Generator, times: Times) -> Floats:
    """Grows at a constant rate and is set back to zero once a second, as an INS that a receiver of 1 Hz corrects."""
    since = np.mod(times.seconds + rng.uniform(), 1.0)
    return np.sqrt(3) * since[:, None] * rng.normal(0, 1, 3)


def wave(rng: np.random.Generator, times: Times) -> Floats:
    """An oscillation of 1 to 20 s, as of a filter that is badly damped."""
    return _oscillation(rng, times, np.exp(rng.uniform(0, np.log(20), 3)))


def long_wave(rng: np.random.Generator, times: Times) -> Floats:
    """An oscillation of 1.5 to 4 times the length of the drive, within which it is nearly a steady drift."""
    return _oscillation(rng, times, rng.uniform(1.5, 4.0, 3) * times.seconds[-1])


def _oscillation(rng: np.random.Generator, times: Times, period_s: Floats) -> Floats:
    """Of the same variance at all times."""
    angle = 2 * np.pi * times.seconds[:, None] / period_s
    return np.asarray(np.cos(angle) * rng.normal(0, 1, 3) + np.sin(angle) * rng.normal(0, 1, 3))


def steps(rng: np.random.Generator, times: Times) -> Floats:
    """Another constant after every 4 s in the mean, as where satellites come and go."""
    step_s = np.diff(times.seconds, prepend=times.seconds[0])
    number = np.cumsum(rng.uniform(size=times.count) > np.exp(-step_s / 4.0))
    return rng.normal(0, 1, (int(number[-1]) + 1, 3))[number]


def receiver(rng: np.random.Generator, times: Times) -> Floats:
    """A piece of the errors of a real receiver, turned about the vertical by chance."""
    recorded_s, errors = receiver_errors()
    lasts_s = recorded_s[-1]
    at_s = rng.uniform(0, 2 * lasts_s) + times.seconds
    at_s = lasts_s - np.abs(np.mod(at_s, 2 * lasts_s) - lasts_s)  # there and back, without a jump
    piece = np.column_stack([np.interp(at_s, recorded_s, column) for column in errors.T])
    turn = Rotation.from_euler("z", rng.uniform(0, 2 * np.pi)).as_matrix()
    return np.asarray(piece @ turn.T * (1, 1, rng.choice([-1, 1])))


@cache
def receiver_errors() -> tuple[Floats, Floats]:
    """Seconds (N,) and errors (N, 3) of a u-blox at 10 Hz against poses from all sensors, without their mean and its delay, in
    units of their root mean square: of both horizontal axes together, and of heights."""
    with (RECEIVER / "frame_pose_ecef.csv").open() as file:
        poses = list(csv.DictReader(file))
    with (RECEIVER / "live_gnss_ublox.csv").open() as file:
        fixes = list(csv.DictReader(file))
    ecef = np.array([[float(row[f"{axis}_m"]) for axis in "xyz"] for row in poses])
    true_m = np.column_stack(Transformer.from_crs(4978, 32610, always_xy=True).transform(*ecef.T)[:2])
    heights = Transformer.from_crs(4978, 4979, always_xy=True).transform(*ecef.T)[2]
    true_m = np.column_stack([true_m, heights])
    start = datetime(1980, 1, 6, tzinfo=UTC)
    true_s = np.array([604_800 * int(row["gps_week"]) + float(row["gps_tow"]) - 18.0 for row in poses])
    stamps = (datetime.fromisoformat(row["utc_iso"].replace("Z", "+00:00")) for row in fixes)
    fixed_s = np.array([(stamp - start) / timedelta(seconds=1) for stamp in stamps])
    lat_lon = [[float(row[name]) for row in fixes] for name in ("lon_deg", "lat_deg")]
    fixed_m = np.column_stack(
        [
            *Transformer.from_crs(4326, 32610, always_xy=True).transform(*lat_lon),
            [float(row["altitude_m"]) for row in fixes],
        ]
    )

    def errors(delay_s: float) -> tuple[Floats, Floats]:
        inside = (fixed_s + delay_s > true_s[0]) & (fixed_s + delay_s < true_s[-1])
        at_s = fixed_s[inside] + delay_s
        off = fixed_m[inside] - np.column_stack([np.interp(at_s, true_s, column) for column in true_m.T])
        return at_s - at_s[0], off - off.mean(axis=0)

    seconds, off = min(
        (errors(delay) for delay in np.arange(-0.3, 0.3, 0.01)), key=lambda found: float(found[1][:, :2].std())
    )
    rms = np.sqrt([np.mean(off[:, :2] ** 2)] * 2 + [np.mean(off[:, 2] ** 2)])
    return seconds, off / rms


# ------------------------------------------------------------------ logs


Process = Callable[[np.random.Generator, Times], Floats]


def _usual_positions(rng: np.random.Generator, times: Times) -> Floats:
    share = PARAMS.gnss_white_share
    return np.sqrt(1 - share**2) * slow(rng, times, PARAMS.gnss_correlation_s) + share * white(rng, times)


def _usual_attitudes(rng: np.random.Generator, times: Times) -> Floats:
    share = PARAMS.attitude_white_share
    return np.sqrt(1 - share**2) * slow(rng, times, PARAMS.attitude_correlation_s) + share * white(rng, times)


def errors_of(
    rng: np.random.Generator,
    times: Times,
    sigma_m: float,
    *,
    positions: Process = _usual_positions,
    attitudes: Process = _usual_attitudes,
    attitude_deg: float | None = None,
) -> LogErrors:
    """Errors of stated sigmas that stay the same over the drive. attitude_deg: of roll and pitch; drawn without it."""
    sigma_rad = np.radians(attitude_deg or float(rng.choice(_ATTITUDES_DEG))) * np.array([1, 1, _HEADING])
    sigma = sigma_m * np.array([1, 1, _UP])
    both = np.tile(sigma, (times.count, 1)), np.tile(sigma_rad, (times.count, 1))
    found = LogErrors(
        positions(rng, times) * sigma, both[0], attitudes(rng, times) * sigma_rad, both[1], np.zeros(times.count)
    )
    return replace(found, late_s=np.full(times.count, rng.normal(0, PARAMS.clock_sigma_s)))


def of_positions(process: Process) -> Draw:
    return lambda rng, times, sigma_m: errors_of(rng, times, sigma_m, positions=process)


def of_attitudes(process: Process, attitude_deg: float) -> Draw:
    return lambda rng, times, sigma_m: errors_of(rng, times, sigma_m, attitudes=process, attitude_deg=attitude_deg)


def other_axes(rng: np.random.Generator, times: Times, sigma_m: float) -> LogErrors:
    """Each axis has a process of its own."""
    order = rng.permutation(3)
    processes = (constant, slow_by_chance, white)

    def positions(rng: np.random.Generator, times: Times) -> Floats:
        return np.column_stack([processes[k](rng, times)[:, 0] for k in order])

    return errors_of(rng, times, sigma_m, positions=positions, attitudes=positions)


def rounded(degrees: float, height_m: float, angle_deg: float) -> Draw:
    """Written with so many decimals; the rest of the stated variance is slow. A step must be small enough for the sigma."""
    step_m = np.array([0.65 * degrees * _M_PER_DEG, degrees * _M_PER_DEG, height_m])
    step_rad = np.radians(np.full(3, angle_deg))

    def draw(rng: np.random.Generator, times: Times, sigma_m: float) -> LogErrors:
        found = errors_of(rng, times, sigma_m, attitude_deg=max(0.05, 0.5 * angle_deg))
        own = np.sqrt(1 - step_m**2 / (12 * found.sigma_m[0] ** 2))
        turned = np.sqrt(1 - step_rad**2 / (12 * found.sigma_rad[0] ** 2))
        return replace(
            found, position_m=found.position_m * own, turn_rad=found.turn_rad * turned, step_m=step_m, step_rad=step_rad
        )

    return draw


def jittered(jitter_s: float, *, as_clock: bool = False) -> Draw:
    """Each stamp is wrong by itself. as_clock: that is stated as the sigma of the clock, not in those of the positions."""

    def draw(rng: np.random.Generator, times: Times, sigma_m: float) -> LogErrors:
        found = errors_of(rng, times, sigma_m, attitude_deg=0.05)
        late_s = rng.normal(0, jitter_s, times.count)
        if as_clock:
            return replace(found, late_s=late_s, clock_sigma_s=jitter_s)
        moved_m = np.abs(times.velocity_m_s) * jitter_s
        return replace(found, late_s=found.late_s + late_s, sigma_m=np.hypot(found.sigma_m, moved_m))

    return draw


def fix_and_float(rng: np.random.Generator, times: Times, sigma_m: float) -> LogErrors:
    """A receiver loses its fix every few seconds; each float solution errs by another constant, and slowly."""
    fixed, other = (errors_of(rng, times, sigma) for sigma in (_FIXED_M, sigma_m))
    change = rng.uniform(size=times.count) > np.exp(-np.diff(times.seconds, prepend=times.seconds[0]) / 3.0)
    episode = np.cumsum(change)
    each = rng.normal(0, 1, (int(episode[-1]) + 1, 3))[episode] * other.sigma_m
    is_float = ((episode + rng.integers(2)) % 2 == 1)[:, None]
    floated = np.sqrt(0.5) * (other.position_m + each)
    return replace(
        fixed,
        position_m=np.where(is_float, floated, fixed.position_m),
        sigma_m=np.where(is_float, other.sigma_m, fixed.sigma_m),
    )


def gap(rng: np.random.Generator, times: Times, sigma_m: float) -> LogErrors:
    """No GNSS for a third to a half of the drive, at most 10 s: the INS drifts until it returns, to sigma_m, as it states."""
    found, lasts_s = errors_of(rng, times, _FIXED_M), float(times.seconds[-1])
    first_s, gap_s = rng.uniform(0.1, 0.4) * lasts_s, min(rng.uniform(0.35, 0.5) * lasts_s, 10.0)
    share = (times.seconds - first_s) / gap_s
    drift_m = np.where((share > 0) & (share < 1), np.abs(share) ** 1.5, 0.0)[:, None] * sigma_m * np.array([1, 1, _UP])
    return replace(
        found, position_m=found.position_m + drift_m * rng.normal(0, 1, 3), sigma_m=np.hypot(found.sigma_m, drift_m)
    )


def heading_only(rng: np.random.Generator, times: Times, sigma_m: float) -> LogErrors:
    found = errors_of(rng, times, sigma_m)
    sigma = np.column_stack([np.full((times.count, 2), LEVEL_SIGMA_RAD), found.sigma_rad[:, 2]])
    return replace(found, sigma_rad=sigma, has_level=False)


SHAPES = (
    LogShape("constant", of_positions(constant)),
    LogShape("wave longer than the drive", of_positions(long_wave)),
    LogShape("slow, 5 to 100 s", of_positions(slow_by_chance)),
    LogShape("white", of_positions(white)),
    LogShape("constant, slow and white", of_positions(mixed)),
    LogShape("each axis another", other_axes),
    LogShape("saw-tooth of 1 s", of_positions(saw_tooth)),
    LogShape("wave of 1 to 20 s", of_positions(wave)),
    LogShape("steps", of_positions(steps)),
    LogShape("rounded to 1e-7 degrees", rounded(1e-7, 0.01, 0.01), (0.02, 0.05)),
    LogShape("rounded to 1e-6 degrees", rounded(1e-6, 0.1, 0.1), (0.05, 0.3)),
    LogShape("stamps +-2 ms", jittered(0.002), (0.02, 0.05)),
    LogShape("stamps +-4 ms", jittered(0.004), (0.02, 0.05)),
    LogShape("stamps +-4 ms, as clock", jittered(0.004, as_clock=True), (0.02, 0.05)),
    LogShape("fix and float", fix_and_float, (0.3, 1.0)),
    LogShape("gap of GNSS", gap, (0.3, 1.0)),
    LogShape("attitudes constant", of_attitudes(constant, 0.1), (0.02, 0.3)),
    LogShape("attitudes slow, 5 s", of_attitudes(lambda rng, times: slow(rng, times, 5.0), 0.1), (0.02, 0.3)),
    LogShape("attitudes white", of_attitudes(white, 0.04), (0.02, 0.3)),
    LogShape("heading only", heading_only),
    LogShape("positions at 1 Hz, slow", of_positions(slow_by_chance), (0.02, 0.3, 1.0), rate_hz=1.0),
    LogShape("positions at 1 Hz, white", of_positions(white), (0.02, 0.3, 1.0), rate_hz=1.0),
    *([LogShape("real receiver", of_positions(receiver), (0.3, 1.0))] if RECEIVER.is_dir() else []),
)


@dataclass(frozen=True)
class Log:
    """Frame pairs with the poses of a log."""

    frame_pairs: tuple[FramePair, ...]
    clock_sigma_s: float | None
    """Stated; None: the prior."""


def logged(
    pairs: Sequence[FramePair], poses_at: TruePoses, rng: np.random.Generator, shape: LogShape, sigma_m: float
) -> Log:
    """The same frame pairs with the poses of a log of this shape. poses_at: seconds from the first image."""
    images_s = np.array([pair.captured_at_ns - pairs[0].captured_at_ns for pair in pairs]) * 1e-9
    records_s = images_s
    if shape.rate_hz:
        records_s = np.arange(-_AROUND_S + rng.uniform(), images_s[-1] + _AROUND_S, 1 / shape.rate_hz)
    before, after = (poses_at(records_s + step)[:, :3, 3] for step in (-_STEP_S, _STEP_S))
    errors = shape.draw(rng, Times(records_s, (after - before) / (2 * _STEP_S)), sigma_m)
    poses = recorded_poses(poses_at(records_s + errors.late_s), rng, errors)
    sigma = np.hstack([errors.sigma_m, errors.sigma_rad])
    if not shape.rate_hz:
        changed = (
            pair.model_copy(update={"pose": se3.to_pose(*pose)})
            for pair, pose in zip(pairs, zip(poses, sigma, strict=True), strict=True)
        )
        return Log(tuple(changed), errors.clock_sigma_s)
    stamps_ns = pairs[0].captured_at_ns + np.round(records_s * 1e9).astype(np.int64)
    poses[:, :3, :3] = np.eye(3)
    exposures = [pair.captured_at_ns for pair in pairs]
    pose_at = pose_reader(Samples("gnss.csv", stamps_ns.tolist(), poses, sigma, {}), exposures, from_course=True)
    return Log(
        tuple(pair.model_copy(update={"pose": pose_at(pair.captured_at_ns)}) for pair in pairs), errors.clock_sigma_s
    )


def recorded_poses(true: Floats, rng: np.random.Generator, errors: LogErrors) -> Floats:
    """(K, 4, 4) poses with these errors, and with a lever arm that errs by its prior."""
    poses = true.copy()
    poses[:, :3, 3] += true[:, :3, :3] @ rng.normal(0, PARAMS.lever_arm_sigma_m, 3) + errors.position_m
    poses[:, :3, :3] = true[:, :3, :3] @ Rotation.from_rotvec(errors.turn_rad).as_matrix()
    places = np.where(
        errors.step_m > 0, np.round(poses[:, :3, 3] / np.maximum(errors.step_m, 1e-12)) * errors.step_m, poses[:, :3, 3]
    )
    angles = Rotation.from_matrix(poses[:, :3, :3]).as_euler("ZYX")[:, ::-1]
    angles = np.where(
        errors.step_rad > 0, np.round(angles / np.maximum(errors.step_rad, 1e-12)) * errors.step_rad, angles
    )
    return se3.se3(se3.rotation_from_rpy(*(angles * (errors.has_level, errors.has_level, True)).T), places)
