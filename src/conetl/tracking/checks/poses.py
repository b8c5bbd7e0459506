"""Whether the poses of a drive agree with what its images show: health checks of trajectory and calibration."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from conetl.geometry.motion.pose_graph import LoggedPoses, MeasuredMotions, motion_residuals
from conetl.geometry.motion.stereo_motion import RelativeMotion
from conetl.geometry.small_arrays import cross_matrix
from conetl.model.arrays import Bools, Floats, Ints
from conetl.model.drive import MIN_DETAIL, FramePair
from conetl.model.health import CALIBRATION, HealthCheck, Verdict, hold, hold_if
from conetl.model.params import TrajectoryParams
from conetl.model.rig import Rig
from conetl.tracking.checks.jumps import JUMPS, check_jumps, check_slow_jumps, check_turn_jumps
from conetl.tracking.checks.mount import check_mount
from conetl.tracking.clock import LEAST_S, MAX_SIGMA_S, ClockOffset
from conetl.tracking.drive_refinement import scale_is_doubtful
from conetl.tracking.self_calibration import SelfCalibration, SelfCalibrationOutcome
from conetl.tracking.trajectory import (
    RefinedTrajectory,
    RefinementOutcome,
    is_interpolated,
    measured_motions,
    plausible_motions,
    read_log,
)

ALIGNMENT, DISTANCES = "alignment of cameras and GNSS/INS", "distances by images and by GNSS/INS"
#: Checks that no offset of the clocks explains.
_NOT_OF_CLOCKS = (JUMPS, DISTANCES)
#: A drive of fewer intervals has too little evidence, except for jumps.
_LEAST_INTERVALS = 8
_MAX_REJECTED_SHARE, _LEAST_MEASURED_SHARE = 0.1, 0.5
#: The scale of the motions may be off by this many of its prior sigmas, and of its own.
_MAX_SCALE_SIGMAS = 3.2
#: Cameras look aside by more than this much (rad), and by this many of its sigmas: sample drives and KITTI by up to 0.27 degrees.
_ASIDE_RAD, _ASIDE_SIGMAS = np.radians(0.25), 4.5
#: Of all intervals at most this many in a row cannot be measured, as behind a lorry.
_LOST_SHARE = 0.35
#: Of normally distributed values, from the median of their absolute deviations and the square root of their number.
_SIGMA_OF_MEDIAN = 1.4826 * np.sqrt(np.pi / 2)
#: A drift is at least this many metres, and this many sigmas of the change of the log's errors.
_DRIFT_M, _DRIFT_SIGMAS = 0.1, 6.0
#: A vehicle that drives backwards for more intervals than this reverses; in each it moves this many metres, and this many of the
#: sigmas of the log's change.
_MAX_REVERSED, _REVERSED_M, _REVERSED_SIGMAS = 10, 0.05, 3.0
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

_LONGER = (
    "the calibration's baseline, focal length or lens is wrong (raw or rectified images?), or GNSS/INS drifts. Calibrate the rig "
    "(conetl calibrate) or reprocess the GNSS/INS log."
)


def check_trajectory(
    frame_pairs: Sequence[FramePair],
    rig: Rig,
    motions: Sequence[RelativeMotion],
    trajectory: RefinedTrajectory,
    params: TrajectoryParams,
) -> list[HealthCheck]:
    """Checks of the poses against visual odometry, of a short drive for jumps only. frame_pairs: `trajectory.logged`, with
    `detail`."""
    if not params.refine or len(frame_pairs) < 2:
        return []
    log = read_log(frame_pairs, rig, params, trajectory.errors)
    measured = measured_motions(frame_pairs, motions, params)
    none = np.zeros(0, dtype=bool)
    good = plausible_motions(log, measured, params.scale_sigma) if len(measured.start) else none
    if len(frame_pairs) <= _LEAST_INTERVALS:
        return [check_jumps(frame_pairs, rig, measured, good)]
    residual = motion_residuals(log, log.rotations, log.positions, measured, 0.0)[0]
    against = trajectory.outcome is RefinementOutcome.AGAINST_STATED_SIGMAS
    within = f"no pose was moved by more than {params.max_shift_chi2**0.5:.2g} of its stated sigmas"
    stated = trajectory.detail if against else within
    checks = [
        _measured(frame_pairs, rig, measured.start),
        _agreement(frame_pairs, rig, measured, good, residual),
        *([_not_adjusted(measured, residual)] if trajectory.outcome is RefinementOutcome.NOT_CONVERGED else []),
        check_jumps(frame_pairs, rig, measured, good),
        check_turn_jumps(frame_pairs, rig, measured, good),
        check_slow_jumps(frame_pairs, log, measured, good, residual),
        _clock(trajectory.clock, params),
        *([] if trajectory.scale is None else [_scale(*trajectory.scale, params.scale_sigma)]),
        *([_drift(log, trajectory)] if trajectory.outcome is RefinementOutcome.REFINED else []),
        _alignment(log, measured, residual),
        *([] if is_interpolated(frame_pairs) else check_mount(log, measured, good, residual)),
        *_directions(frame_pairs, log, measured, residual),
        hold_if(against, "stated sigmas of the poses", f"{stated[0].upper()}{stated[1:]}.", value=None),
    ]
    return [_with_likely_cause(check, trajectory.clock, params) for check in checks]


def _with_likely_cause(check: HealthCheck, clock: ClockOffset | None, params: TrajectoryParams) -> HealthCheck:
    """A hold whose likeliest cause is a start of the images that was only estimated: the message begins with that.

    Poses that are interpolated to other instants than those of their records fit the images less, also once the clock is
    corrected; the advice of each check is about recordings whose clocks are known.
    """
    if check.verdict is not Verdict.HOLD or params.clock_sigma_s <= LEAST_S or check.name in _NOT_OF_CLOCKS:
        return check
    off = ""
    if clock is not None and clock.is_applied(params.clock_sigma_s):
        off = f", and the poses show that it is off by {1e3 * clock.offset_s:+z.0f} +- {1e3 * clock.sigma_s:.0f} ms"
    detail = (
        f"The beginning of the images is only known to {1e3 * params.clock_sigma_s:.0f} ms{off}: state it in drive.yaml "
        f"(images.start, or clock.offset_s) before you look for other causes. {check.detail}"
    )
    return check.model_copy(update={"detail": detail})


def check_calibration(calibration: SelfCalibration) -> list[HealthCheck]:
    """Whether the images contradict the calibration by more than it can be corrected."""
    verdict = {
        SelfCalibrationOutcome.IMPLAUSIBLE: Verdict.HOLD,
        SelfCalibrationOutcome.APPLIED: Verdict.CORRECTED,
    }.get(calibration.outcome, Verdict.PASS)
    detail = f"{calibration.detail[0].upper()}{calibration.detail[1:]}."
    if verdict is Verdict.HOLD:
        detail += " Recalibrate the rig (conetl calibrate), or check whether the images were cropped or shifted."
    return [HealthCheck(name=CALIBRATION, verdict=verdict, value=None, detail=detail)]


def _directions(
    frame_pairs: Sequence[FramePair], log: LoggedPoses, measured: MeasuredMotions, residual: Floats
) -> list[HealthCheck]:
    """Whether images and course of sparse positions show the same direction; none for a log with more records.

    A course that is taken for the heading of a vehicle that reverses is opposite to what its cameras show.
    """
    if not is_interpolated(frame_pairs) or not len(measured.start):
        return []
    observed, logged = _shifts_m(measured, residual)
    k = measured.start
    noise = log.noise[k] ** 2 + log.noise[k + 1] ** 2 + 2 * log.drift[k] ** 2 * (1 - log.correlation[k])
    least_m = np.maximum(_REVERSED_M, _REVERSED_SIGMAS * np.sqrt(noise[:, :2].max(axis=1)))
    long = np.minimum(np.linalg.norm(observed, axis=1), np.linalg.norm(logged, axis=1)) > least_m
    back = long & ((observed * logged).sum(axis=1) < 0)
    count = int(back.sum())
    detail = "The vehicle drives in the direction of its cameras."
    if count > _MAX_REVERSED:
        first = frame_pairs[int(measured.start[np.argmax(back)])].frame_index
        detail = (
            f"In {count} intervals, from frame pair {first} on, the images show the vehicle driving backwards. Without "
            "attitudes, conetl computes the heading of a vehicle that drives forwards. Cut out the part that reverses, or "
            "record attitudes."
        )
    held, limit = count > _MAX_REVERSED, float(_MAX_REVERSED)
    return [hold_if(held, "driving direction", detail, value=float(count), limit=limit)]


def _shifts_m(measured: MeasuredMotions, residual: Floats) -> Floats:
    """(2, M, 3) motions in the left camera's frame: in the images, and by the log, from which they differ by (M, 6)."""
    observed = measured.next_SE3_first[:, :3, 3]
    return np.stack([observed, observed - residual[:, 3:]])


def _measured(frame_pairs: Sequence[FramePair], rig: Rig, starts: Ints) -> HealthCheck:
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
    in_part = end - first > _LOST_SHARE * intervals
    lost = np.median(details) >= MIN_DETAIL and share < _LEAST_MEASURED_SHARE
    detail = f"Visual odometry measured {measured} of {intervals} intervals between frame pairs."
    if lost or in_part:
        where = f"only {measured} of {intervals} intervals"
        if not lost:
            where = f"none of the {end - first} intervals from frame pair {frame_pairs[first].frame_index} on"
        detail = (
            f"Visual odometry could measure {where}, although the images show enough: the poses do not "
            "belong to these images, or left and right images do not belong together. Check numbers, order and time "
            f"stamps of images and poses.{_against_itself(frame_pairs, rig)}"
        )
    name = "intervals measured by visual odometry"
    return hold_if(lost or in_part, name, detail, value=share, limit=_LEAST_MEASURED_SHARE)


def _against_itself(frame_pairs: Sequence[FramePair], rig: Rig) -> str:
    """What is wrong with the log alone, as a sentence after others; empty if nothing is."""
    positions_m = np.array([pair.pose.map_t_body_m for pair in frame_pairs])
    looks = np.array([pair.pose.map_R_body for pair in frame_pairs]) @ np.array(rig.body_SE3_left)[:3, 2]
    steps_m, ahead = np.diff(positions_m[:, :2], axis=0), (looks[1:, :2] + looks[:-1, :2]) / 2
    every = np.diff(np.flatnonzero(steps_m.any(axis=1)))
    if len(every) and np.median(every) > 1:
        return (
            f" In the log, positions change only every {np.median(every):.0f} frame pairs: it has fewer records than there are "
            "images, and each was repeated. Deliver the original log; conetl interpolates."
        )
    step_s = float(np.median(np.diff([pair.captured_at_ns for pair in frame_pairs]))) * 1e-9
    bend_m = float(np.median(np.linalg.norm(np.diff(steps_m, axis=0), axis=1)))
    scatter_m = bend_m / _BEND_SIGMAS
    stated_m = float(np.median([max(pair.pose.sigma_enu_m[:2]) for pair in frame_pairs]))
    if bend_m > _BENDS_M_S2 * step_s**2 and scatter_m > _SCATTER_SHARE * stated_m:
        return (
            f" In the log, positions scatter by {scatter_m:.2f} m from one record to the next, with stated sigmas of "
            f"{stated_m:.2f} m: reprocess the log, or state its true sigmas (sigmas in drive.yaml)."
        )
    path_m = float(np.linalg.norm(steps_m, axis=1).sum())
    duration_s = (frame_pairs[-1].captured_at_ns - frame_pairs[0].captured_at_ns) * 1e-9
    if path_m < _STANDING_M_S * duration_s:
        return f" In the log, the vehicle moved {path_m:.1f} m in {duration_s:.0f} s: is it frozen, or in radians?"
    along, across = (ahead * steps_m).sum(axis=1), ahead[:, 0] * steps_m[:, 1] - ahead[:, 1] * steps_m[:, 0]
    aside_deg = float(np.degrees(np.median(np.abs(np.arctan2(across, along)))))
    if aside_deg > _ASIDE_DEG:
        return (
            f" In the log, the vehicle moved at {aside_deg:.0f} degrees to the direction of its cameras: are latitude and "
            "longitude swapped, or the records in reverse order?"
        )
    return ""


def _agreement(
    frame_pairs: Sequence[FramePair], rig: Rig, measured: MeasuredMotions, good: Bools, residual: Floats
) -> HealthCheck:
    """Whether the motions agree with the log within the errors of both."""
    rejected = int((~good).sum())
    share = rejected / max(len(good), 1)
    held = rejected > 1 and share > _MAX_REJECTED_SHARE
    detail = f"{len(good) - rejected} of {len(good)} measured motions agree with GNSS/INS."
    if held:
        metres, degrees = (
            np.median(np.linalg.norm(part[~good], axis=1)) for part in (residual[:, 3:], np.degrees(residual[:, :3]))
        )
        detail = (
            f"{rejected} of {len(good)} measured motions contradict GNSS/INS, by {metres:.2f} m and {degrees:.2f} degrees in the "
            f"median.{_against_itself(frame_pairs, rig) or _in_common(_shifts_m(measured, residual), degrees, share)}"
        )
    return hold_if(held, "visual odometry against GNSS/INS", detail, value=share, limit=_MAX_REJECTED_SHARE)


def _not_adjusted(measured: MeasuredMotions, residual: Floats) -> HealthCheck:
    """Of poses that no adjustment fits to the images: each motion may agree with an inaccurate log that all contradict."""
    images_m, log_m = np.linalg.norm(_shifts_m(measured, residual), axis=2).sum(axis=1).tolist()
    detail = (
        f"No poses fit both images and GNSS/INS: the path is {images_m:.0f} m long in the images and {log_m:.0f} m in GNSS/INS. "
        "Check the time stamps of the images (beginning and frame rate; a video can state a wrong rate), the log and the "
        "calibration."
    )
    return hold("adjustment of the poses", detail, value=None)


def _in_common(shifts_m: Floats, degrees: float, share: float) -> str:
    """What all motions have in common, and what to check. shifts_m: as of `_shifts_m`; degrees: by how much those turn otherwise
    that contradict the log, a share of all."""
    lengths_m = np.linalg.norm(shifts_m, axis=2)
    far = lengths_m.min(axis=0) > _DRIVEN_M
    if far.sum() >= _LEAST_INTERVALS:
        ratio = lengths_m[0, far] / lengths_m[1, far] - 1
        scale = float(np.median(ratio))
        turned = share > _OTHER_SHARE and degrees > _OTHER_DEG and np.median(np.abs(ratio)) > _OTHER_LENGTHS
        if turned or abs(scale) > _OTHER_SCALE:
            return (
                " The images show a different path than GNSS/INS: check first when they were taken (images.start in drive.yaml, "
                "its time zone, time stamps, clocks), then the alignment, the stated sigmas and the calibration."
            )
        if abs(scale) > _COMMON_SHARE and np.median(np.abs(ratio - scale)) < abs(scale) / 4:
            return f" Distances in the images differ by {100 * scale:+.1f} % from GNSS/INS throughout: {_LONGER}"
    return " Check the alignment and clocks of cameras and GNSS/INS, their stated sigmas, and the calibration."


def _clock(clock: ClockOffset | None, params: TrajectoryParams) -> HealthCheck:
    """The offset between the clocks of cameras and GNSS/INS."""
    name = "clock of GNSS/INS against the cameras"
    if clock is None or clock.sigma_s > MAX_SIGMA_S:
        detail = f"This drive does not show the offset of the clocks; a sigma of {1e3 * params.clock_sigma_s:g} ms is assumed."
        return HealthCheck(name=name, verdict=Verdict.PASS, value=None, detail=detail)
    text = f"{1e3 * clock.offset_s:+.0f} +- {1e3 * clock.sigma_s:.0f} ms"
    detail = f"The clocks agree ({text})."
    applied = clock.is_applied(params.clock_sigma_s)
    if applied:
        # An offset within the stated error of the clocks, as for videos whose start was searched, is not the recorder's fault.
        advice = "Correct the synchronisation of the recorder."
        if abs(clock.offset_s) <= 3 * params.clock_sigma_s:
            advice = f"The clocks were only known to {1e3 * params.clock_sigma_s:.0f} ms."
        detail = f"The time stamps of GNSS/INS lagged by {text}; this was corrected. {advice}"
    return HealthCheck(
        name=name, verdict=Verdict.CORRECTED if applied else Verdict.PASS, value=1e3 * clock.offset_s,
        sigma=1e3 * clock.sigma_s, limit=1e3 * LEAST_S, unit="ms", detail=detail,
    )  # fmt: skip


def _scale(scale: float, sigma: float, prior: float) -> HealthCheck:
    """Whether images and GNSS/INS show the same distances."""
    limit = _MAX_SCALE_SIGMAS * prior
    held, doubtful = abs(scale) > max(limit, _MAX_SCALE_SIGMAS * sigma), scale_is_doubtful(scale, sigma, prior)
    detail = "Images and GNSS/INS show the same distances."
    if held or doubtful:
        detail = f"Distances in the images differ by {100 * scale:+.1f} +- {100 * sigma:.1f} % from GNSS/INS: {_LONGER}"
        detail += "" if held else " The sigmas of all positions include such a drift."
    return HealthCheck(
        name=DISTANCES,
        verdict=Verdict.HOLD if held else Verdict.CORRECTED if doubtful else Verdict.PASS, value=100 * scale,
        sigma=100 * sigma, limit=100 * limit, unit="%", detail=detail,
    )  # fmt: skip


def _drift(log: LoggedPoses, trajectory: RefinedTrajectory) -> HealthCheck:
    """Whether the adjustment moves one part of the drive against another by more than the log's errors change in that time.

    Of a consistent log the difference of adjusted and logged positions varies less than the errors of the log.
    """
    pairs = trajectory.frame_pairs
    places = np.array([pair.pose.map_t_body_m for pair in pairs])
    times_s = np.array([pair.captured_at_ns for pair in pairs], dtype=np.int64) * 1e-9
    moved, last = places - log.positions, len(places) - 1
    worst = HealthCheck(
        name="drift of the poses", verdict=Verdict.PASS, value=0.0, limit=_DRIFT_M, unit="m",
        detail="The poses do not drift relative to the images.",
    )  # fmt: skip
    for i, j in ((0, last // 2), (last // 2, last), (0, last)):
        drift_m, sigma_m = moved[j] - moved[i], np.sqrt(_change_variance(log, i, j))
        axis = int(np.argmax(np.abs(drift_m) / sigma_m))
        off_m, limit_m = float(abs(drift_m[axis])), max(_DRIFT_M, _DRIFT_SIGMAS * float(sigma_m[axis]))
        if off_m > max(limit_m, worst.value or 0.0):
            detail = (
                f"GNSS/INS drifts by {off_m:.1f} m relative to the images within {times_s[j] - times_s[i]:.0f} s, but states a "
                f"sigma of {float(sigma_m[axis]):.2f} m for this change: reprocess its log, or state its true sigmas."
            )
            worst = worst.model_copy(
                update={"verdict": Verdict.HOLD, "value": off_m, "limit": limit_m, "detail": detail}
            )
    return worst


def _change_variance(log: LoggedPoses, i: int, j: int) -> Floats:
    """(3,) m^2, of the change of the log's position errors from frame i to frame j."""
    slow, white = log.drift[:, :3], log.own[:, :3]
    kept = np.prod(log.correlation[i:j, 0])
    return np.asarray(white[i] ** 2 + white[j] ** 2 + slow[i] ** 2 + slow[j] ** 2 - 2 * slow[i] * slow[j] * kept)


def _alignment(log: LoggedPoses, measured: MeasuredMotions, residual: Floats) -> HealthCheck:
    """Whether images and log show the same direction of motion, in the median of the drive.

    Cameras that look aside and positions that drift at a constant rate are the same to them. The adjustment turns the poses, and
    leaves the drift in the positions.
    """
    both = _shifts_m(measured, residual)
    both = both[:, (np.linalg.norm(both, axis=2) > _DRIVEN_M).all(axis=0)]
    count, lengths_m = both.shape[1], np.linalg.norm(both, axis=2, keepdims=True)
    if count < _LEAST_INTERVALS:
        return hold_if(False, ALIGNMENT, "The vehicle does not drive far enough for this check.", value=None)
    shown, logged = both / lengths_m * np.sign(both[1, :, 2:])  # also of a vehicle that reverses
    turns = shown - logged
    aside, ahead = np.median(turns, axis=0), np.median(logged, axis=0)
    noise = _SIGMA_OF_MEDIAN * np.median(np.abs(turns - aside), axis=0) / np.sqrt(count)
    middle, body_R_left = len(log.positions) // 2, log.body_SE3_left[:3, :3]
    map_R_left = log.rotations[middle] @ body_R_left
    turned = cross_matrix(ahead) @ body_R_left.T
    cov = turned @ np.diag(log.drift[middle, 3:] ** 2) @ turned.T
    change = np.diag(_change_variance(log, 0, len(log.positions) - 1))
    cov += map_R_left.T @ change @ map_R_left / lengths_m[1].sum() ** 2
    sigmas = np.sqrt(np.diag(cov)[:2] + noise[:2] ** 2)
    axis = int(np.argmax(np.abs(aside[:2]) / sigmas))
    off_deg = np.degrees(abs(aside[axis]))
    limit_deg = np.degrees(max(_ASIDE_RAD, _ASIDE_SIGMAS * sigmas[axis]))
    held = bool(off_deg > limit_deg)
    detail = "The direction of the cameras agrees with their alignment with GNSS/INS."
    if held:
        detail = (
            f"The directions of motion in the images and in GNSS/INS differ by {off_deg:.1f} degrees "
            f"{('sideways', 'up or down')[axis]}, with a stated sigma of {np.degrees(sigmas[axis]):.2f}: GNSS/INS drifts by "
            f"{100 * abs(aside[axis]):.1f} cm per metre driven, or the alignment of cameras and GNSS/INS is wrong. Reprocess its "
            "log, recalibrate the alignment, or state its sigmas (sigmas in drive.yaml)."
        )
    off_deg, limit_deg = np.round([off_deg, limit_deg], 3).tolist()
    return hold_if(held, ALIGNMENT, detail, value=off_deg, limit=limit_deg, unit="degrees")
