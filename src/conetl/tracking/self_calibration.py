"""Whether a drive contradicts the calibration of its rig, and the corrected rig.

`geometry/calibration/self_calibration.py` has the estimate. Here: the spans of the drive that are used, significance and
plausibility of the estimate, and the rig with its right camera corrected. A turn changes `body_SE3_right`; intersection,
odometry and tracks use the full orientation. A bend at the sides of the image changes turn and principal point together. Images
are not resampled: of a rig with `rectified_from` the camera that took them is turned by the same angle; a bend would change the
images, so that such rigs are only turned.

Also the errors that are assumed of a calibration that states none (`with_assumed_errors`): the prior of the estimate, and, where
nothing is estimated, part of the sigmas of all positions. The readout of a rolling shutter that is not known is estimated along
with turn and bend, and replaces its prior whatever it is.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from enum import StrEnum
from itertools import repeat
from typing import NamedTuple

import numpy as np
from pydantic import Field
from scipy.linalg import block_diag

from conetl.geometry import pose as se3
from conetl.geometry.calibration.covariance import (
    calibration_id,
    known_covariance,
    shared_errors,
    square_root,
    with_covariance,
)
from conetl.geometry.calibration.self_calibration import (
    Readouts,
    RightCameraError,
    SpanPoints,
    equivalent_camera,
    estimate_right_camera,
    readout_by_images,
)
from conetl.geometry.motion.rolling_shutter import pair_shares, readout_sigma_s, readouts_s, shutter_of, with_shutters
from conetl.geometry.motion.stereo_tracks import StereoTracks, cameras_of
from conetl.geometry.packing import as_rows, vec3
from conetl.geometry.rig import body_SE3_camera, left_SE3_right, right_camera_turned
from conetl.model.arrays import Floats
from conetl.model.base import Record, Vec3
from conetl.model.params import TrajectoryParams
from conetl.model.rig import MAX_READOUT_MS, CalibrationCovariance, Rig, SharedErrors, Shutter, Side

_TURN_NAMES = ("relative.rx_rad", "relative.ry_rad", "relative.rz_rad")
_BASELINE_NAMES = ("relative.tx_m", "relative.ty_m", "relative.tz_m")
#: The tangential coefficient of brown and rational lenses that moves columns by (3 x^2 + y^2) of it.
_DECENTRING = "lens.3"


#: Offsets of the right camera beyond this many of their sigmas are in the sigmas of positions.
DOUBTFUL_SIGMAS = 3.0
_FORWARD = "relative.tz_m"


class Span(NamedTuple):
    """Part of a drive over which points are compared; first and last are positions in its frame pairs, not frame indices."""

    first: int
    last: int
    last_SE3_first: Floats
    """(4, 4) motion of the left camera by the logged poses."""
    lasts_s: float = 0.0


class SelfCalibrationOutcome(StrEnum):
    """Outcome of the self-calibration."""

    APPLIED = "applied"
    INSIGNIFICANT = "insignificant"
    IMPLAUSIBLE = "implausible"
    NO_ESTIMATE = "no_estimate"
    SWITCHED_OFF = "switched_off"


class SelfCalibration(Record):
    """Estimated turn and bend of the right camera, with their covariance."""

    outcome: SelfCalibrationOutcome
    detail: str
    """One sentence for a person."""
    rotation_rad: Vec3 | None = None
    """rx, ry, rz of a camera that is only turned; signs as in `geometry/calibration/self_calibration.py`."""
    bend: float = 0.0
    """Shift of the right image's columns at x = 1, in focal lengths; it grows as x squared."""
    cov: tuple[float, ...] = ()
    """Upper triangle, row by row, of the (4, 4) covariance of (rx, ry, rz, bend), prior included; empty without an estimate."""
    model_gap: tuple[float, ...] = ()
    """(rx, ry, rz, bend): their change if disparities may also follow another field; empty without an estimate."""
    right_ahead: tuple[float, ...] = ()
    """Offset of the right camera forward of its calibrated position, and its sigma (`right_camera_ahead`); empty if unknown."""
    span_count: int = Field(default=0, ge=0)
    readout_ms: tuple[float, float] | None = None
    """By how much the readout of both cameras is longer than assumed, and the sigma of the result; None: kept as stated."""
    readout_off_ms: tuple[float, float] | None = None
    """By how much that of the images alone is longer than a stated one, and the sigma of the difference; None: not determined."""


SWITCHED_OFF = SelfCalibration(outcome=SelfCalibrationOutcome.SWITCHED_OFF, detail="self-calibration is switched off")


def span_params(params: TrajectoryParams) -> TrajectoryParams:
    """The parameters for tracking points over spans."""
    return params.model_copy(
        update={
            "epipolar_tolerance_px": params.self_calibration_row_tolerance_px,
            "corners_per_cell": params.self_calibration_corners_per_cell,
        }
    )


def choose_spans(motions: Iterable[Floats], span_m: float, steps_s: Iterable[float] = repeat(0.0)) -> Iterator[Span]:
    """Consecutive parts of a drive of about `span_m` each; motions (4, 4): of the left camera, one per interval, in order.

    Parts in which the car does not move far enough give no span. steps_s: how long each interval is, for rolling shutters.
    """
    start, pose, lasts_s = 0, np.eye(4), 0.0
    for k, (motion, step_s) in enumerate(zip(motions, steps_s, strict=False)):
        pose, lasts_s = se3.compose(motion, pose), lasts_s + step_s
        if float(np.linalg.norm(pose[:3, 3])) >= span_m:
            yield Span(start, k + 1, pose, lasts_s)
            start, pose, lasts_s = k + 1, np.eye(4), 0.0


def self_calibrate(
    rig: Rig, spans: Sequence[Span], tracks: Sequence[StereoTracks], params: TrajectoryParams
) -> SelfCalibration:
    """Estimate turn and bend of the right camera from the points of each span, and decide whether to apply them.

    tracks: of each span. Of the logged poses only the start of each span's motion is used.
    """
    is_stated = any(shutter_of(rig, side) is not None for side in ("left", "right"))
    readouts = Readouts(readouts_s(rig), readout_sigma_s(rig)) if is_stated else None
    points = [
        _span_points(rig, span, found, rolling=readouts is not None)
        for span, found in zip(spans, tracks, strict=True)
        if found.missing is None
    ]
    if len(points) < params.self_calibration_min_spans:
        needed = params.self_calibration_min_spans
        return _without_estimate(f"{len(points)} spans of the drive could be compared, at least {needed} are needed")
    estimate = estimate_right_camera(cameras_of(rig), points, params, readouts)
    off_s = None
    prior_s = params.video_readout_sigma_ms * 1e-3
    if readouts is not None and estimate is not None and readouts.sigma_s < prior_s:
        off_s = readout_by_images(points, estimate, readouts.sigma_s, params)
        if off_s is not None:
            off_s = off_s[0], float(np.hypot(off_s[1], readouts.sigma_s))
            if abs(off_s[0]) > params.self_calibration_readout_sigmas * off_s[1]:
                readouts = readouts._replace(sigma_s=prior_s)
                estimate = estimate_right_camera(cameras_of(rig), points, params, readouts)
    if estimate is None:
        return _without_estimate("too few points are stationary, or all of them are far away")
    unit_px = pixels_per_unit(rig)
    cov = estimate.cov + np.diag(_floor(rig, params) ** 2)
    _, prior, by_parameter = _prior(rig, params)
    before = by_parameter @ prior @ by_parameter.T
    # The scatter decides on significance; the model gap adds to the covariance of the turn.
    spread = before + cov + np.outer(estimate.model_gap, estimate.model_gap)
    prior_chi2 = float(estimate.turn_and_bend @ np.linalg.solve(spread, estimate.turn_and_bend))
    gain = before @ np.linalg.inv(spread)
    found, posterior = gain @ estimate.turn_and_bend, _symmetric(before - gain @ before)
    shift_px, sigma_px = estimate.turn_and_bend * unit_px, np.sqrt(np.diag(cov)) * unit_px
    worth = (np.abs(shift_px) > params.self_calibration_significance * sigma_px) & (
        np.abs(found * unit_px) > params.self_calibration_least_px
    )
    off = f"off by {-shift_px[1]:+.2f} +- {sigma_px[1]:.2f} px"
    sides = f", at the sides by {-shift_px[3]:+.2f} +- {sigma_px[3]:.2f} px more" if found[3] else ""
    figures = f"disparities {off}{sides}, rows by {shift_px[0]:+.2f} +- {sigma_px[0]:.2f} px"
    readout_ms, readout_text = _readout_of(points, estimate, readouts, params)
    outcome = SelfCalibrationOutcome.APPLIED
    rotation, _ = equivalent_camera(found, rig.right.fx_px)
    bend_text = f", its columns are bent by {found[3] * unit_px[3]:+.2f} px at the sides" if found[3] else ""
    left_px = float(np.sqrt(posterior[1, 1]) * unit_px[1])
    detail = (
        f"the right camera has rotated by {abs(rotation[1]) * 1e3:.2f} mrad sideways and {abs(rotation[0]) * 1e3:.2f} mrad up or "
        f"down{bend_text}: disparities were {off}, and are now accurate to {left_px:.2f} px"
    )
    if not worth.any():
        outcome = SelfCalibrationOutcome.INSIGNIFICANT
        detail = f"kept as given; the drive agrees with it ({figures})"
    elif prior_chi2 > params.self_calibration_max_chi2:
        outcome = SelfCalibrationOutcome.IMPLAUSIBLE
        detail = f"kept as given; it would have to be wrong by {prior_chi2**0.5:.1f} of its sigmas ({figures})"
    return SelfCalibration(
        outcome=outcome, detail=detail + readout_text, rotation_rad=vec3(found[:3]), bend=float(found[3]),
        cov=tuple(posterior[np.triu_indices(4)].tolist()), model_gap=tuple(estimate.model_gap.tolist()), span_count=len(points),
        readout_ms=readout_ms, readout_off_ms=None if off_s is None else (1e3 * off_s[0], 1e3 * off_s[1]),
    )  # fmt: skip


def _span_points(rig: Rig, span: Span, tracks: StereoTracks, *, rolling: bool) -> SpanPoints:
    first_px, last_px, sigma_px = tracks.points()
    shares = np.hstack([pair_shares(rig, first_px), pair_shares(rig, last_px)]) if rolling else None
    return SpanPoints(first_px, last_px, sigma_px, span.last_SE3_first, span.lasts_s, shares)


def _readout_of(
    spans: Sequence[SpanPoints], estimate: RightCameraError, readouts: Readouts | None, params: TrajectoryParams
) -> tuple[tuple[float, float] | None, str]:
    """As `SelfCalibration.readout_ms`, and a part of a sentence about it."""
    if readouts is None or not readouts.sigma_s:
        return None, ""
    found = readout_by_images(spans, estimate, readouts.sigma_s, params)
    if found is None:
        return None, ""
    gain = readouts.sigma_s**2 / (readouts.sigma_s**2 + found[1] ** 2)
    longer_ms, sigma_ms = 1e3 * gain * found[0], 1e3 * gain**0.5 * found[1]
    found_ms = float(readouts.stated_s[0]) * 1e3 + longer_ms
    text = f"; by the images, the rows of an image are exposed within {found_ms:.0f} +- {sigma_ms:.0f} ms (rolling shutter)"
    return (longer_ms, sigma_ms), text


def with_assumed_errors(rig: Rig, params: TrajectoryParams) -> Rig:
    """The rig; if its calibration states no errors, with those that published calibrations have.

    They are a turn and a bend of the right camera (`self_calibration_prior_px`) and the length of the baseline, which stands for
    the scale of both (`scale_sigma`).
    """
    if known_covariance(rig) is not None:
        return rig
    names = (*_TURN_NAMES, "right.cx_px") if rig.rectified_from is None else _TURN_NAMES
    sigma = params.self_calibration_prior_px / pixels_per_unit(rig)
    baseline_m = left_SE3_right(rig.rectified_from or rig)[:3, 3]
    root = block_diag(np.linalg.pinv(_by_parameter(names, rig)) * sigma, params.scale_sigma * baseline_m[:, None])
    matrix = as_rows(_symmetric(root @ root.T))
    return with_covariance(rig, CalibrationCovariance(names=(*names, *_BASELINE_NAMES), matrix=matrix))


def self_calibrated_rig(rig: Rig, found: SelfCalibration, params: TrajectoryParams) -> Rig:
    """The rig with its right camera corrected and the remaining `calibration_covariance`; stated and not applied: unchanged.

    A calibration that states no errors has the assumed ones, or, where the drive agrees with it, what these leave. A readout that
    was estimated is applied in any case.
    """
    rig = _with_readout(rig, found)
    agrees = found.outcome is SelfCalibrationOutcome.INSIGNIFICANT and known_covariance(rig) is None
    applied = found.outcome is SelfCalibrationOutcome.APPLIED
    if not (applied or agrees):
        return with_assumed_errors(rig, params)
    assert found.rotation_rad is not None  # it was estimated
    names, prior, by_parameter = _prior(rig, params)
    # The estimate is a measurement of turn and bend, and so of all correlated parameters.
    before, after = by_parameter @ prior @ by_parameter.T, np.zeros((4, 4))
    after[np.triu_indices(4)] = found.cov
    after += np.triu(after, 1).T
    back = np.linalg.pinv(before, rcond=1e-9, hermitian=True)
    lift = prior @ by_parameter.T @ back
    left_over = _symmetric(prior - lift @ (before - after) @ lift.T)
    turn_and_bend = np.array([*found.rotation_rad, found.bend])
    shared = SharedErrors(
        calibration=calibration_id(with_assumed_errors(rig, params)),
        matrix=as_rows(_shared_after(prior, by_parameter, lift @ (before - after) @ back, found, _floor(rig, params))),
    )
    if not applied:  # what was found is an error that remains
        remains = lift @ turn_and_bend
        kept = CalibrationCovariance(names=names, matrix=as_rows(left_over + np.outer(remains, remains)), shared=shared)
        return with_covariance(rig, kept)
    covariance = CalibrationCovariance(names=names, matrix=as_rows(left_over), shared=shared)
    rotation, shift_px = equivalent_camera(turn_and_bend, rig.right.fx_px)
    rig = right_camera_turned(rig, rotation)
    if rig.rectified_from is None:
        rig = rig.model_copy(update={"right": rig.right.model_copy(update={"cx_px": rig.right.cx_px + shift_px})})
    return with_covariance(rig, covariance)


def _with_readout(rig: Rig, found: SelfCalibration) -> Rig:
    if found.readout_ms is None:
        return rig
    longer_ms, sigma_ms = found.readout_ms

    def of(side: Side) -> Shutter:
        known = shutter_of(rig, side) or Shutter(readout_ms=0.0)
        readout_ms = float(np.clip(known.readout_ms + longer_ms, -MAX_READOUT_MS, MAX_READOUT_MS))
        return known.model_copy(update={"readout_ms": readout_ms, "readout_sigma_ms": sigma_ms})

    return with_shutters(rig, of("left"), of("right"))


def is_ahead(ahead: Sequence[float]) -> bool:
    """Whether an offset of the right camera (`SelfCalibration.right_ahead`) is more than noise."""
    return bool(ahead) and abs(ahead[0]) > DOUBTFUL_SIGMAS * ahead[1]


def widened_by_offset(rig: Rig, found: SelfCalibration) -> Rig:
    """The rig whose `calibration_covariance` contains the offset of its right camera, if there is one.

    It is not corrected: other brightness curves of the two cameras look the same, and move nothing.
    """
    if not is_ahead(found.right_ahead):
        return rig
    known = known_covariance(rig)
    given = () if known is None else known.names
    names = given if _FORWARD in given else (*given, _FORWARD)
    matrix = np.zeros((len(names), len(names)))
    if known is not None:
        matrix[: len(given), : len(given)] = known.matrix
    at = names.index(_FORWARD)
    matrix[at, at] += (found.right_ahead[0] * rig.baseline_m) ** 2
    shared = None if known is None else known.shared
    if shared is not None and len(names) > len(given):
        shared = shared.model_copy(update={"matrix": (*shared.matrix, (0.0,) * len(shared.matrix[0]))})
    return with_covariance(rig, CalibrationCovariance(names=names, matrix=as_rows(matrix), shared=shared))


def with_measured_scale(rig: Rig, given: Rig, scale: tuple[float, float] | None, params: TrajectoryParams) -> Rig:
    """The rig of a drive with the error of its scale that distances in GNSS/INS leave open.

    given: as it was read; of stated errors none is changed. scale: distances in the images relative to those in GNSS/INS, less 1,
    and its sigma; the rig is not corrected by it. None: not measured.
    """
    covariance, shared = known_covariance(rig), shared_errors(rig)
    if known_covariance(given) is not None or scale is None or covariance is None or shared is None:
        return rig
    part = min(float(np.hypot(*scale)) / params.scale_sigma, 1.0)
    factor = np.array([part if name in _BASELINE_NAMES else 1.0 for name in covariance.names])
    common = shared.model_copy(update={"matrix": as_rows(np.array(shared.matrix) * factor[:, None])})
    matrix = as_rows(np.array(covariance.matrix) * np.outer(factor, factor))
    return with_covariance(rig, CalibrationCovariance(names=covariance.names, matrix=matrix, shared=common))


def _shared_after(prior: Floats, by_parameter: Floats, gain: Floats, found: SelfCalibration, floor: Floats) -> Floats:
    """(K, M): change of the corrected parameters by one sigma of errors shared by drives with the same calibration.

    The correction is gain (H x + e), x being the error of the given calibration, H `by_parameter`, e that of the estimate: (I -
    gain H) x - gain e remains. x is common to all drives. Of e, the scatter of spans is of this drive alone; floor and model
    gap are errors beyond a turn and bend of the rig, the same in every drive.
    """
    given = square_root(prior)
    return np.column_stack([given - gain @ by_parameter @ given, gain * floor, gain @ np.array(found.model_gap)])


def _floor(rig: Rig, params: TrajectoryParams) -> Floats:
    """(4,): least sigma of the estimate."""
    return np.asarray(params.self_calibration_sigma_floor_px / pixels_per_unit(rig))


def pixels_per_unit(rig: Rig) -> Floats:
    """(4,): rows for rx and disparity for ry in the middle of the image, rows for rz and columns for the bend at its side."""
    side = rig.right.width_px / 2 / rig.right.fx_px
    return np.array([rig.right.fy_px, rig.right.fx_px, rig.right.width_px / 2, rig.right.fx_px * side**2])


def turn_and_bend_cov(rig: Rig, params: TrajectoryParams) -> Floats:
    """(4, 4): covariance of turn and bend by the errors of the given calibration, stated or assumed."""
    _, prior, by_parameter = _prior(rig, params)
    return np.asarray(by_parameter @ prior @ by_parameter.T)


def _prior(rig: Rig, params: TrajectoryParams) -> tuple[tuple[str, ...], Floats, Floats]:
    """Names (K) and covariance (K, K) of the given calibration, stated or assumed, and (4, K) turn and bend by its errors."""
    covariance = known_covariance(with_assumed_errors(rig, params))
    assert covariance is not None
    return covariance.names, np.array(covariance.matrix), _by_parameter(covariance.names, rig)


def _by_parameter(names: Sequence[str], rig: Rig) -> Floats:
    """(4, K): turn and bend of the rectified right camera by an error of each named parameter.

    An error of the principal point acts like a turn and a bend that cancel at the sides of the image, decentring of a lens like
    a bend. Other parameters have no effect here.
    """
    camera_rig = rig.rectified_from or rig
    own_R_camera_rig = body_SE3_camera(rig, "right")[:3, :3].T @ body_SE3_camera(camera_rig, "right")[:3, :3]
    result = np.zeros((4, len(names)))
    for k, name in enumerate(names):
        side, _, field = name.partition(".")
        camera, sign = (camera_rig.left, -1.0) if side == "left" else (camera_rig.right, 1.0)
        if name in _TURN_NAMES:
            result[:3, k] = own_R_camera_rig[:, _TURN_NAMES.index(name)]
        elif field == "cx_px":
            result[1, k] = result[3, k] = -sign / camera.fx_px
        elif field == "cy_px":
            result[0, k] = sign / camera.fy_px
        elif field == _DECENTRING and camera.lens.model in ("brown", "rational"):
            result[3, k] = 3 * sign
    result[3] *= rig.rectified_from is None
    return result


def _symmetric(matrix: Floats) -> Floats:
    return np.asarray((matrix + matrix.T) / 2)


def _without_estimate(why: str) -> SelfCalibration:
    detail = f"kept as given: {why}"
    return SelfCalibration(outcome=SelfCalibrationOutcome.NO_ESTIMATE, detail=detail)
