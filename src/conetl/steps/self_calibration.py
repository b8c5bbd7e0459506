"""Does a drive contradict the calibration of its rig, and which rig agrees with it?

The estimate itself is `geometry/self_calibration.py`. Here: which spans of the drive take part, whether what they say is
significant and plausible, and the rig with its right camera turned. The turn goes into `body_SE3_right`, not into the principal
point: a turned camera shifts the sides of its picture more than the middle, and intersection, odometry and tracks take the full
orientation anyway (matching asks `geometry/rig.py` where infinity lies). Pictures are not resampled: of a rig with
`rectified_from` the camera that took them is turned by the same angle, so that pictures stay as they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.spatial.transform import Rotation

from conetl.geometry import pose as se3
from conetl.geometry.calibration_covariance import known_covariance
from conetl.geometry.packing import cov3, cov_matrix, vec3
from conetl.geometry.rig import body_SE3_camera
from conetl.geometry.self_calibration import SpanPoints, estimate_turn
from conetl.geometry.stereo_motion import RelativeMotion
from conetl.geometry.stereo_tracks import StereoTracks, cameras_of, motion_limits
from conetl.params import TrajectoryParams
from conetl.records import CalibrationCovariance, Cov3, Record, Rig, Vec3

Floats = NDArray[np.float64]
_TURN_NAMES = ("relative.rx_rad", "relative.ry_rad", "relative.rz_rad")


class Span(NamedTuple):
    """Part of a drive over which points are compared."""

    first: int
    """Place in the drive's frame pairs, not frame index."""
    last: int
    last_SE3_first: Floats
    """(4, 4) motion of the left camera by visual odometry."""


class SelfCalibrationOutcome(StrEnum):
    """What became of the rig's calibration."""

    APPLIED = "applied"
    INSIGNIFICANT = "insignificant"
    IMPLAUSIBLE = "implausible"
    NO_ESTIMATE = "no_estimate"
    SWITCHED_OFF = "switched_off"


class SelfCalibration(Record):
    """What a drive says of its rig: the turn of the right camera with what is then known of it."""

    outcome: SelfCalibrationOutcome
    detail: str
    """One sentence for a person."""
    rotation_rad: Vec3 | None
    """rx, ry, rz; left_SE3_right = (R, t) becomes (R exp([r]x), t). None without an estimate."""
    rotation_cov: Cov3 | None
    """Of the turn, the prior included, rad^2."""
    span_count: int = Field(ge=0)
    point_count: int = Field(ge=0)
    prior_chi2: float = Field(ge=0)
    """Squared distance of what the spans say from the calibration as it was, 3 degrees of freedom."""


#: Where the parameters do not ask for it.
SWITCHED_OFF = SelfCalibration(
    outcome=SelfCalibrationOutcome.SWITCHED_OFF, detail="self-calibration is switched off", rotation_rad=None,
    rotation_cov=None, span_count=0, point_count=0, prior_chi2=0.0,
)  # fmt: skip


def choose_spans(motions: Sequence[RelativeMotion], span_m: float) -> list[Span]:
    """Consecutive parts of a drive of about `span_m` each; motions: one an interval, in order, none left out.

    A car that stands or turns on the spot never gets far enough: such parts give no span, nor do intervals without a measurement.
    """
    spans, start, pose = [], 0, np.eye(4)
    for k, motion in enumerate(motions):
        if motion.second_SE3_first is None:
            start, pose = k + 1, np.eye(4)
            continue
        pose = se3.compose(np.array(motion.second_SE3_first), pose)
        if float(np.linalg.norm(pose[:3, 3])) >= span_m:
            spans.append(Span(start, k + 1, pose))
            start, pose = k + 1, np.eye(4)
    return spans


def self_calibrate(
    rig: Rig, spans: Sequence[Span], tracks: Sequence[StereoTracks], params: TrajectoryParams
) -> SelfCalibration:
    """Estimate the turn of the right camera from the points of each span, and decide whether it is to be applied.

    tracks: of each span. Nothing in it depends on where the poses say that the car was.
    """
    points = [
        SpanPoints(*found.points(), span.last_SE3_first)
        for span, found in zip(spans, tracks, strict=True)
        if found.missing is None
    ]
    if len(points) < params.self_calibration_min_spans:
        return _without_estimate(f"{len(points)} spans of the drive could be compared, needed are "
                                 f"{params.self_calibration_min_spans}")  # fmt: skip
    said = estimate_turn(cameras_of(rig), points, motion_limits(params), params.self_calibration_min_spans)
    if said is None:
        return _without_estimate("too few points stand still, or they are all far away")
    unit_px = _pixels_a_radian(rig)
    cov = said.cov + np.diag((params.self_calibration_sigma_floor_px / unit_px) ** 2)
    _, prior, by_parameter = _prior(rig, params)
    turn_prior = by_parameter @ prior @ by_parameter.T
    # Whether the calibration is contradicted, the scatter decides; how well the turn then describes it, the model's gap too.
    spread = turn_prior + cov + np.outer(said.model_gap_rad, said.model_gap_rad)
    prior_chi2 = float(said.rotation_rad @ np.linalg.solve(spread, said.rotation_rad))
    gain = turn_prior @ np.linalg.inv(spread)
    rotation, posterior = gain @ said.rotation_rad, _symmetric(turn_prior - gain @ turn_prior)
    shift_px, sigma_px = said.rotation_rad * unit_px, np.sqrt(np.diag(cov)) * unit_px
    worth = (np.abs(shift_px) > params.self_calibration_significance * sigma_px) & (
        np.abs(rotation * unit_px) > params.self_calibration_least_px
    )
    figures = (
        f"disparities {-shift_px[1]:+.2f} +- {sigma_px[1]:.2f} px, rows {shift_px[0]:+.2f} +- {sigma_px[0]:.2f} px in the "
        f"middle, {shift_px[2]:+.2f} +- {sigma_px[2]:.2f} px more at the side; {len(points)} spans"
    )
    outcome = SelfCalibrationOutcome.APPLIED
    turn_text = f"{rotation[1] * 1e3:+.2f} mrad to the side and {rotation[0] * 1e3:+.2f} mrad up or down"
    left_px = float(np.sqrt(posterior[1, 1]) * unit_px[1])
    detail = f"right camera turned by {turn_text}, disparities are good to {left_px:.2f} px after it ({figures})"
    if not worth.any():
        outcome = SelfCalibrationOutcome.INSIGNIFICANT
        detail = f"calibration left as it is, the drive does not contradict it ({figures})"
    elif prior_chi2 > params.self_calibration_max_chi2:
        outcome = SelfCalibrationOutcome.IMPLAUSIBLE
        detail = (
            f"calibration left as it is: it would have to be off by {prior_chi2**0.5:.1f} of its sigmas ({figures})"
        )
    return SelfCalibration(
        outcome=outcome, detail=detail, rotation_rad=vec3(rotation), rotation_cov=cov3(posterior), span_count=len(points),
        point_count=said.point_count, prior_chi2=prior_chi2,
    )  # fmt: skip


def self_calibrated_rig(rig: Rig, found: SelfCalibration, params: TrajectoryParams) -> Rig:
    """The rig with its right camera turned and what is left to know as `calibration_covariance`; as it is unless applied."""
    if found.outcome is not SelfCalibrationOutcome.APPLIED:
        return rig
    assert found.rotation_rad is not None and found.rotation_cov is not None  # it was applied
    names, prior, by_parameter = _prior(rig, params)
    # The estimate as a measurement of the parameters: what it says of the turn, it says of all that is correlated with it.
    turn_prior = by_parameter @ prior @ by_parameter.T
    lift = prior @ by_parameter.T @ np.linalg.pinv(turn_prior, hermitian=True)
    left_over = _symmetric(prior - lift @ (turn_prior - cov_matrix(found.rotation_cov)) @ lift.T)
    covariance = CalibrationCovariance(names=names, matrix=tuple(tuple(row) for row in left_over.tolist()))
    own = body_SE3_camera(rig, "right")
    in_body = own[:3, :3] @ Rotation.from_rotvec(found.rotation_rad).as_matrix() @ own[:3, :3].T

    def turn(one: Rig) -> Rig:
        pose = body_SE3_camera(one, "right")
        pose[:3, :3] = in_body @ pose[:3, :3]
        return one.model_copy(update={"body_SE3_right": se3.to_matrix4(pose)})

    if rig.rectified_from is None:
        return turn(rig).model_copy(update={"calibration_covariance": covariance})
    taken = turn(rig.rectified_from).model_copy(update={"calibration_covariance": covariance})
    return turn(rig).model_copy(update={"rectified_from": taken})


def _pixels_a_radian(rig: Rig) -> Floats:
    """(3,): rows for rx and disparity for ry in the middle of the picture, rows at its side for rz."""
    return np.array([rig.right.fy_px, rig.right.fx_px, rig.right.width_px / 2])


def _prior(rig: Rig, params: TrajectoryParams) -> tuple[tuple[str, ...], Floats, Floats]:
    """Names (K) and covariance (K, K) of the calibration before the drive, and (3, K) how its errors look like a turn.

    A principal point that is off looks like a turn in the middle of the picture; without it a calibration would seem to know
    the turn worse than it knows what the pictures show. Focal lengths, lens and baseline do nothing there.
    """
    taken = rig.rectified_from or rig
    own_R_taken = body_SE3_camera(rig, "right")[:3, :3].T @ body_SE3_camera(taken, "right")[:3, :3]
    known = known_covariance(rig)
    if known is None:
        sigma = params.self_calibration_prior_px / _pixels_a_radian(rig)
        return _TURN_NAMES, own_R_taken.T @ np.diag(sigma**2) @ own_R_taken, own_R_taken
    by_parameter = np.zeros((3, len(known.names)))
    for k, name in enumerate(known.names):
        side, _, field = name.partition(".")
        camera, sign = (taken.left, -1.0) if side == "left" else (taken.right, 1.0)
        if name in _TURN_NAMES:
            by_parameter[:, k] = own_R_taken[:, _TURN_NAMES.index(name)]
        elif field == "cx_px":
            by_parameter[1, k] = -sign / camera.fx_px
        elif field == "cy_px":
            by_parameter[0, k] = sign / camera.fy_px
    return known.names, np.array(known.matrix), by_parameter


def _symmetric(matrix: Floats) -> Floats:
    return np.asarray((matrix + matrix.T) / 2)


def _without_estimate(why: str) -> SelfCalibration:
    return SelfCalibration(
        outcome=SelfCalibrationOutcome.NO_ESTIMATE, detail=f"calibration left as it is: {why}", rotation_rad=None,
        rotation_cov=None, span_count=0, point_count=0, prior_chi2=0.0,
    )  # fmt: skip
