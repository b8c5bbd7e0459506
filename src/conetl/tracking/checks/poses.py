"""Whether the poses of a drive agree with what its images show: health checks of trajectory and calibration."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from conetl.geometry.linear_reference import evenly_spaced
from conetl.geometry.motion.pose_graph import LoggedPoses, MeasuredMotions, motion_residuals
from conetl.geometry.motion.rolling_shutter import readouts_s
from conetl.geometry.motion.stereo_motion import RelativeMotion
from conetl.geometry.motion.stereo_tracks import expected_motions
from conetl.model.arrays import Bools, Floats, Ints
from conetl.model.check_params import CheckParams
from conetl.model.drive import MIN_DETAIL, FramePair
from conetl.model.health import CALIBRATION, Finding
from conetl.model.params import TrajectoryParams
from conetl.model.rig import Rig
from conetl.tracking.checks.jumps import JUMPS, check_jumps, check_turn_jumps
from conetl.tracking.checks.mount import STRETCH, check_mount
from conetl.tracking.checks.path import DISTANCES, check_path, sentence
from conetl.tracking.clock import LEAST_S, MAX_SIGMA_S, ClockOffset
from conetl.tracking.log.plausible_motions import plausible_motions
from conetl.tracking.self_calibration import SelfCalibration, SelfCalibrationOutcome
from conetl.tracking.trajectory import (
    RefinedTrajectory,
    RefinementOutcome,
    is_interpolated,
    measured_motions,
    read_log,
    rough_log,
)

CLOCK = "clock of GNSS/INS against the cameras"
#: Checks that no offset of the clocks explains.
_NOT_OF_CLOCKS = (JUMPS, DISTANCES, STRETCH)
#: Times up to this many intervals away are tried, with this many motions. One fits if others fit worse by this factor; an angle
#: counts as what it moves at this distance.
_MOST_LAG, _MOST_MOTIONS, _LAG_FITS, _TURNED_M = 30, 400, 3.0, 8.0
#: A drive of fewer intervals has too little evidence, except for jumps.
_LEAST_INTERVALS = 8
#: A vehicle reverses in intervals in which it moves this many metres, and this many of the sigmas of the log's change.
_REVERSED_M, _REVERSED_SIGMAS = 0.05, 3.0
#: Motions are compared where they are longer, and have something in common from this share of their lengths on.
_DRIVEN_M, _COMMON_SHARE = 0.1, 0.008
#: Images are of another time than the log where most motions turn otherwise (degrees in an interval) and are of other lengths, or
#: of lengths that no calibration explains.
_OTHER_SHARE, _OTHER_DEG, _OTHER_LENGTHS, _OTHER_SCALE = 0.5, 0.15, 0.05, 0.2
#: Below this speed a vehicle stands still, and a log this far away from the direction in which the cameras look has other axes.
_STANDING_M_S, _ASIDE_DEG = 0.5, 20.0
#: Positions scatter where half of them bend the path by more than a vehicle can (m/s^2), and by this much of their stated sigmas.
#: The median of the bends is this many sigmas of one coordinate.
_BENDS_M_S2, _SCATTER_SHARE, _BEND_SIGMAS = 8.0, 0.5, np.sqrt(6 * np.log(4))

_DEFAULT = CheckParams()


def check_trajectory(
    frame_pairs: Sequence[FramePair],
    rig: Rig,
    motions: Sequence[RelativeMotion],
    trajectory: RefinedTrajectory,
    params: TrajectoryParams,
    limits: CheckParams = _DEFAULT,
) -> list[Finding]:
    """The poses against visual odometry, of a short drive for jumps only. frame_pairs: `trajectory.logged`, with `detail`."""
    if not params.refine or len(frame_pairs) < 2:
        return []
    measured = measured_motions(frame_pairs, motions, params)
    rough = rough_log(frame_pairs, rig, measured, params)
    log = read_log(frame_pairs, rig, params, trajectory.errors, rough.renewed)
    none = np.zeros(0, dtype=bool)
    good = plausible_motions(log, measured, params.scale_sigma, rough) if len(measured.start) else none
    if len(frame_pairs) <= _LEAST_INTERVALS:
        return [check_jumps(frame_pairs, rig, measured, good, limits.jumps, params.clock_sigma_s)]
    if lag_s := _lag_s(frame_pairs, rig, measured):
        # Poses of another time show nothing else.
        facts: dict[str, float | str] = {"lag_s": abs(lag_s), "order": "later" if lag_s > 0 else "earlier"}
        late = Finding(check=CLOCK, value=-1e3 * lag_s, found=True, says=("late",), facts=facts)
        return [_measured(frame_pairs, rig, measured.start, limits), late]
    residual = motion_residuals(log, log.rotations, log.positions, measured, 0.0)[0]
    findings = [
        _measured(frame_pairs, rig, measured.start, limits),
        _agreement(frame_pairs, rig, measured, good, residual),
        *([_not_adjusted(measured, residual)] if trajectory.outcome is RefinementOutcome.NOT_CONVERGED else []),
        _with_fault_of_log(
            check_jumps(frame_pairs, rig, measured, good, limits.jumps, params.clock_sigma_s), frame_pairs, rig
        ),
        check_turn_jumps(frame_pairs, rig, measured, good, limits.jumps),
        _clock(trajectory.clock, params),
        *check_path(trajectory, params, limits.path),
        *([] if is_interpolated(frame_pairs) else check_mount(log, measured, good, residual, limits.mount)),
        *_directions(frame_pairs, log, measured, residual),
    ]
    return [_with_likely_cause(finding, trajectory.clock, params) for finding in findings]


def _lag_s(frame_pairs: Sequence[FramePair], rig: Rig, measured: MeasuredMotions) -> float:
    """By how much later the log shows the motions in the images, to one interval; 0 unless they fit another time, and only one.

    Larger offsets than `estimate_clock` tries: of images and poses that were numbered differently, or of a recorder that was
    started later.
    """
    some = evenly_spaced(range(len(measured.start)), _MOST_MOTIONS)
    start, seen = measured.start[some], measured.next_SE3_first[some]
    logged, misfits = np.array(expected_motions(frame_pairs, rig)), dict[int, float]()
    for lag in range(-_MOST_LAG, _MOST_LAG + 1):
        there = start + lag
        both = (there >= 0) & (there < len(logged))
        if both.sum() < _LEAST_INTERVALS:
            continue
        turned = Rotation.from_matrix(seen[both, :3, :3] @ np.swapaxes(logged[there[both], :3, :3], 1, 2)).magnitude()
        shifted_m = np.linalg.norm(seen[both, :3, 3] - logged[there[both], :3, 3], axis=1)
        misfits[lag] = float(np.median(np.hypot(shifted_m, _TURNED_M * turned)))
    best = min(misfits, key=lambda lag: misfits[lag], default=0)
    others = [misfit for lag, misfit in misfits.items() if abs(lag - best) > 1]
    if best == 0 or _LAG_FITS * misfits[best] > min([misfits.get(0, 0.0), *others]):
        return 0.0
    return best * float(np.median(np.diff([pair.captured_at_ns for pair in frame_pairs]))) * 1e-9


def _with_likely_cause(finding: Finding, clock: ClockOffset | None, params: TrajectoryParams) -> Finding:
    """A finding whose likeliest cause is a start of the images that was only estimated: its message begins with that.

    Poses that are interpolated to other instants than those of their records fit the images less, also once the clock is
    corrected; the advice of each check is about recordings whose clocks are known.
    """
    if finding.treated or params.clock_sigma_s <= LEAST_S or finding.check in _NOT_OF_CLOCKS:
        return finding
    clock_ms = 1e3 * params.clock_sigma_s
    if clock is None or not clock.is_applied(params.clock_sigma_s):
        return finding.saying("start", *finding.says, clock_ms=clock_ms)
    off = {"off_ms": 1e3 * clock.offset_s, "off_sigma_ms": 1e3 * clock.sigma_s}
    return finding.saying("start is off", *finding.says, clock_ms=clock_ms, **off)


def check_calibration(calibration: SelfCalibration) -> Finding:
    """Whether the images contradict the calibration, and by more than it can be corrected."""
    outcome, found = calibration.outcome, calibration.outcome is SelfCalibrationOutcome.IMPLAUSIBLE
    return Finding(
        check=CALIBRATION, found=found, says=("implausible" if found else "",),
        treated="corrected" if outcome is SelfCalibrationOutcome.APPLIED else "", facts={"outcome": sentence(calibration.detail)},
    )  # fmt: skip


def check_readout(calibration: SelfCalibration, rig: Rig, params: TrajectoryParams) -> list[Finding]:
    """Whether the images contradict the stated readout of the cameras; none where none is stated. rig: as it was read."""
    if calibration.readout_off_ms is None:
        return []
    off_ms, sigma_ms = calibration.readout_off_ms
    is_off, stated_ms = abs(off_ms) > params.self_calibration_readout_sigmas * sigma_ms, 1e3 * float(readouts_s(rig)[0])
    finding = Finding(
        check="readout of the images", value=off_ms, sigma=sigma_ms, found=False, treated="corrected" if is_off else "",
        facts={"stated_ms": stated_ms, "found_ms": stated_ms + off_ms},
    )  # fmt: skip
    return [finding]


def _directions(
    frame_pairs: Sequence[FramePair], log: LoggedPoses, measured: MeasuredMotions, residual: Floats
) -> list[Finding]:
    """Whether images and course of sparse positions show the same direction; none for a log with more records.

    A course that is taken for the heading of a vehicle that reverses is opposite to what its cameras show.
    """
    if not is_interpolated(frame_pairs) or not len(measured.start):
        return []
    observed, logged = _shifts_m(measured, residual)
    k = measured.start
    noise = log.noise[k] ** 2 + log.noise[k + 1] ** 2 + 2 * log.drift[k] ** 2 * (1 - log.correlation[k]) + log.change[k]
    least_m = np.maximum(_REVERSED_M, _REVERSED_SIGMAS * np.sqrt(noise[:, :2].max(axis=1)))
    long = np.minimum(np.linalg.norm(observed, axis=1), np.linalg.norm(logged, axis=1)) > least_m
    back = long & ((observed * logged).sum(axis=1) < 0)
    first = frame_pairs[int(measured.start[np.argmax(back)])].frame_index
    return [Finding(check="driving direction", value=float(back.sum()), facts={"first": first})]


def _shifts_m(measured: MeasuredMotions, residual: Floats) -> Floats:
    """(2, M, 3) motions in the left camera's frame: in the images, and by the log, from which they differ by (M, 6)."""
    observed = measured.next_SE3_first[:, :3, 3]
    return np.stack([observed, observed - residual[:, 3:]])


def _measured(frame_pairs: Sequence[FramePair], rig: Rig, starts: Ints, limits: CheckParams) -> Finding:
    """Whether images with enough structure can be followed from frame to frame, without a long part where none can.

    starts (K,): numbers of the first frame pairs of the intervals that visual odometry measured.
    """
    intervals, measured = len(frame_pairs) - 1, len(starts)
    share = measured / intervals
    details = np.array([pair.detail if pair.detail is not None else 0.0 for pair in frame_pairs])
    unmeasured = np.minimum(details[:-1], details[1:]) >= MIN_DETAIL
    unmeasured[starts] = False
    steps = np.flatnonzero(np.diff(unmeasured, prepend=False, append=False)).reshape(-1, 2)
    first, end = max(steps.tolist(), key=lambda ends: ends[1] - ends[0], default=(0, 0))
    in_part = end - first > limits.odometry.max_lost_share * intervals
    lost = bool(np.median(details) >= MIN_DETAIL and share < limits.odometry.least_measured_share)
    says, facts = _against_itself(frame_pairs, rig) if lost or in_part else ((), {})
    facts |= {
        "measured": measured,
        "intervals": intervals,
        "lost": end - first,
        "first": frame_pairs[first].frame_index,
    }
    return Finding(
        check="intervals measured by visual odometry", value=share, found=lost or in_part, says=("" if lost else "part", *says),
        facts=facts,
    )  # fmt: skip


def _against_itself(frame_pairs: Sequence[FramePair], rig: Rig) -> tuple[tuple[str, ...], dict[str, float]]:
    """What is wrong with the log alone: name of the message and its facts; nothing if nothing is."""
    positions_m = np.array([pair.pose.map_t_body_m for pair in frame_pairs])
    looks = np.array([pair.pose.map_R_body for pair in frame_pairs]) @ np.array(rig.body_SE3_left)[:3, 2]
    steps_m, ahead = np.diff(positions_m[:, :2], axis=0), (looks[1:, :2] + looks[:-1, :2]) / 2
    every = np.diff(np.flatnonzero(steps_m.any(axis=1)))
    if len(every) and np.median(every) > 1:
        return ("repeated",), {"every": float(np.median(every))}
    step_s = float(np.median(np.diff([pair.captured_at_ns for pair in frame_pairs]))) * 1e-9
    bend_m = float(np.median(np.linalg.norm(np.diff(steps_m, axis=0), axis=1)))
    scatter_m = bend_m / _BEND_SIGMAS
    stated_m = float(np.median([max(pair.pose.sigma_enu_m[:2]) for pair in frame_pairs]))
    if bend_m > _BENDS_M_S2 * step_s**2 and scatter_m > _SCATTER_SHARE * stated_m:
        return ("scatter",), {"scatter_m": scatter_m, "stated_m": stated_m}
    path_m = float(np.linalg.norm(steps_m, axis=1).sum())
    duration_s = (frame_pairs[-1].captured_at_ns - frame_pairs[0].captured_at_ns) * 1e-9
    if path_m < _STANDING_M_S * duration_s:
        return ("standing",), {"path_m": path_m, "duration_s": duration_s}
    along, across = (ahead * steps_m).sum(axis=1), ahead[:, 0] * steps_m[:, 1] - ahead[:, 1] * steps_m[:, 0]
    aside_deg = float(np.degrees(np.median(np.abs(np.arctan2(across, along)))))
    return (("aside",), {"aside_deg": aside_deg}) if aside_deg > _ASIDE_DEG else ((), {})


def _with_fault_of_log(finding: Finding, frame_pairs: Sequence[FramePair], rig: Rig) -> Finding:
    """A finding of jumps, which begins with what is wrong with the log alone."""
    says, facts = _against_itself(frame_pairs, rig)
    return finding.saying(*says, *finding.says, **facts) if says in (("repeated",), ("scatter",)) else finding


def _agreement(
    frame_pairs: Sequence[FramePair], rig: Rig, measured: MeasuredMotions, good: Bools, residual: Floats
) -> Finding:
    """How many motions contradict the log beyond the errors of both."""
    rejected = int((~good).sum())
    share = rejected / max(len(good), 1)
    facts: dict[str, float] = {"rejected": rejected, "motions": len(good), "agreeing": len(good) - rejected}
    says: tuple[str, ...] = ()
    if rejected:
        parts = residual[~good, 3:], np.degrees(residual[~good, :3])
        metres, degrees = (float(np.median(np.linalg.norm(part, axis=1))) for part in parts)
        says, more = _against_itself(frame_pairs, rig)
        if not says:
            says, more = _in_common(_shifts_m(measured, residual), degrees, share)
        facts |= {"metres": metres, "degrees": degrees, **more}
    found = None if rejected > 1 else False
    return Finding(check="visual odometry against GNSS/INS", value=share, found=found, says=("", *says), facts=facts)


def _not_adjusted(measured: MeasuredMotions, residual: Floats) -> Finding:
    """Of poses that no adjustment fits to the images: each motion may agree with an inaccurate log that all contradict."""
    images_m, log_m = np.linalg.norm(_shifts_m(measured, residual), axis=2).sum(axis=1).tolist()
    return Finding(check="adjustment of the poses", found=True, facts={"images_m": images_m, "log_m": log_m})


def _in_common(shifts_m: Floats, degrees: float, share: float) -> tuple[tuple[str, ...], dict[str, float]]:
    """What all motions have in common: name of the message and its facts. shifts_m: as of `_shifts_m`; degrees: by how much those
    turn otherwise that contradict the log, a share of all."""
    lengths_m = np.linalg.norm(shifts_m, axis=2)
    far = lengths_m.min(axis=0) > _DRIVEN_M
    if far.sum() >= _LEAST_INTERVALS:
        ratio = lengths_m[0, far] / lengths_m[1, far] - 1
        scale = float(np.median(ratio))
        turned = share > _OTHER_SHARE and degrees > _OTHER_DEG and np.median(np.abs(ratio)) > _OTHER_LENGTHS
        if turned or abs(scale) > _OTHER_SCALE:
            return ("other path",), {}
        if abs(scale) > _COMMON_SHARE and np.median(np.abs(ratio - scale)) < abs(scale) / 4:
            return ("scale",), {"scale_percent": 100 * scale}
    return ("unknown",), {}


def _clock(clock: ClockOffset | None, params: TrajectoryParams) -> Finding:
    """The offset between the clocks of cameras and GNSS/INS."""
    clock_ms = 1e3 * params.clock_sigma_s
    if clock is None or clock.sigma_s > MAX_SIGMA_S:
        return Finding(check=CLOCK, facts={"clock_ms": clock_ms}, limit=1e3 * LEAST_S)
    # An offset within the stated error of the clocks, as for videos whose start was searched, is not the recorder's fault.
    cause = "assumed" if abs(clock.offset_s) <= 3 * params.clock_sigma_s else "recorder"
    return Finding(  # an offset that is not corrected is within the sigmas
        check=CLOCK, value=1e3 * clock.offset_s, sigma=1e3 * clock.sigma_s, found=False, limit=1e3 * LEAST_S,
        treated="corrected" if clock.is_applied(params.clock_sigma_s) else "", says=("", cause),
        facts={"clock_ms": clock_ms, "order": "behind" if clock.offset_s > 0 else "ahead of"},
    )  # fmt: skip
