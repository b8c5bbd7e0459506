"""Parameters of every step: frozen, closed, units in the names; their hash goes into the changeset.

Data, function and parameters are three separate things: a step is `step(records, params)`. Nothing here is read from the
environment (see `settings.py`); the defaults were chosen on the sample drives and on one real street (docs/explanation).
"""

from __future__ import annotations

import hashlib
import json
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

Positive = Annotated[float, Field(gt=0)]
Fraction = Annotated[float, Field(ge=0, le=1)]


class Params(BaseModel):
    """Base of all parameter groups."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class DetectionParams(Params):
    score_threshold: Fraction = 0.3
    """Low on purpose: one weak box costs little, because a track needs several that agree in space."""
    nms_iou: Fraction = 0.5
    min_height_px: Positive = 8.0
    horizon_margin_rad: Annotated[float, Field(ge=0, lt=1.57)] = 0.1
    """Rows farther than this above the horizon are not looked at: cones stand on the road. 0.1 rad is a slope of 10 %."""
    search_right: Literal["along_epipolar_lines", "everywhere"] = "along_epipolar_lines"
    """Where the right camera's images are searched: only where the partner of a box of the left one can be
    (`tracking/matching/epipolar_search.py`), or everywhere, which takes up to half as long again for the same positions."""


class MatchParams(Params):
    epipolar_tolerance_px: Positive = 3.0
    """Allowed row difference of a stereo match, added to `epipolar_tolerance_relative` times the box height."""
    epipolar_tolerance_relative: Positive = 0.12
    min_range_m: Positive = 1.5
    max_range_m: Positive = 40.0
    """Bounds of the disparity search."""
    max_size_ratio: Positive = 1.6
    """Larger over smaller box height (and width, squared tolerance) of a match."""
    max_score_difference: Positive = 0.7
    refine: bool = True
    """Refine the left-right correspondence by area-based matching where the images allow it."""


class PositionParams(Params):
    convergence_m2: Positive = 1e-10
    """Stop when the sum of squares of the correction falls below this (the paper's criterion)."""
    max_iterations: int = Field(default=20, ge=1)
    min_ray_angle_rad: Positive = 0.008
    """Smaller angles between the two rays are refused: 0.008 rad is 67 m at a baseline of 0.54 m."""
    max_range_m: Positive = 35.0
    max_residual_px: Positive = 6.0


class TrackParams(Params):
    gate_chi2: Positive = 16.0
    """Gate on the squared Mahalanobis distance of (u, v, disparity) against the prediction."""
    max_gap_frames: int = Field(default=12, ge=1)
    """A track not seen for longer is closed; it may still be joined by `join_gate_m`."""
    max_innovation_m: Positive = 2.0
    """Cap on the distance to the prediction: far boxes are vague along the line of sight, where another cone may stand."""
    motion_sigma_relative: Positive = 0.12
    """Error of the relative motion along the way, as a share of it: GNSS without a fix slides by 10 %."""
    motion_sigma_aside: Positive = 0.04
    """The same across the way (sideways and up), where the INS alone is good."""
    motion_sigma_m: Positive = 0.05
    join_gate_m: Positive = 0.6
    """Two tracks never seen in one image and nearer than this (plus drift) are one cone."""
    min_observations: int = Field(default=3, ge=1)
    min_existence_probability: Fraction = 0.5
    """Rather a cone than not: such a track confirms a feature. It takes more to found one, see `reconcile`."""
    expected_cones_per_picture: Positive = 0.05
    """Before anything was seen: against the detector's false boxes per image it gives the odds that a group of boxes is a cone.
    One image in twenty suits an ordinary street; a road with works holds more."""
    score_doubt: Annotated[float, Field(gt=0, lt=0.5)] = 0.02
    """No score is surer than this in favour of a cone or against it: no set of images holds all that stands on roads."""
    hidden_run_probability: Annotated[float, Field(gt=0, lt=1)] = 0.1
    """That a cone is missed several times running because of something in front that is no detection (a parked van)."""
    min_cone_height_m: Positive = 0.25
    max_cone_height_m: Positive = 1.15
    max_ground_distance_m: Positive = 0.45
    """Of the foot from the road surface under the rig, at `ground_reference_range_m`; grows with range."""
    max_range_m: Positive = 20.0
    """A cone must have been seen nearer than this at least once to become a feature."""


class ReconcileParams(Params):
    gate_chi2: Positive = 16.0
    """Gate on the squared Mahalanobis distance between track and feature, after the drive's common offset."""
    min_gate_m: Positive = 0.5
    """Nearer than this is always the same place: road crews do not set cones closer than that."""
    max_offset_m: Positive = 2.0
    """Largest common offset of a drive against the map that is estimated and taken out (GNSS without a fix)."""
    moved_max_m: Positive = 3.0
    """A vanished feature and a new track of like height, at most this far apart, are one cone that was moved."""
    moved_height_tolerance_m: Positive = 0.15
    """Heights that differ by more are of different classes of cones, which lie 0.2 m apart and more."""
    moved_existence_probability: Annotated[float, Field(gt=0, lt=1)] = 0.7
    """Below this belief a feature counts as vanished where a new cone of like height near it tells where it went."""
    founding_existence_probability: Fraction = 0.6
    """A track less sure than this confirms a feature that stands there already, but makes no new one: two drives rarely err at
    the same place."""
    vanished_probability: Annotated[float, Field(gt=0, lt=1)] = 0.1
    """That a cone is taken away between one drive and the next: however often it was seen, a drive that misses it starts from
    this doubt."""
    stray_probability: Annotated[float, Field(gt=0, lt=1)] = 0.1
    """That a frame pair shows something at an empty spot: a stray box, or a neighbour's."""
    unseen_occluder_probability: Annotated[float, Field(gt=0, lt=1)] = 0.02
    """That something which is no detection (a parked van) hid a spot all the time: no look without a box is surer than this."""
    removal_existence_probability: Annotated[float, Field(gt=0, lt=1)] = 0.5
    """A feature is removed by the drive that brings the belief in it below this ..."""
    removal_min_frames: int = Field(default=5, ge=1)
    """... and that looked at its spot in at least so many frame pairs without finding a cone there."""
    visible_min_height_px: Positive = 22.0
    """A cone counts as visible when it would appear at least this tall ..."""
    visible_border_px: Positive = 12.0
    """... and at least this far inside both images."""


class TrajectoryParams(Params):
    refine: bool = True
    """Refine the logged poses by visual odometry; False takes them as they are."""
    self_calibrate: bool = True
    """Turn the right camera where the drive's own images contradict the calibration; needs `refine`."""
    self_calibration_span_m: Positive = 2.0
    """Points are compared over this way: longer ones tell depth better, but fewer points survive."""
    self_calibration_min_spans: int = Field(default=8, ge=4)
    self_calibration_max_spans: int = Field(default=120, ge=4)
    """More parts than these, evenly spread over the drive, only cost time: what they agree on is then far below the floor."""
    self_calibration_row_tolerance_px: Positive = 2.5
    """As `epipolar_tolerance_px`, for these points: rows may be off by what is to be found."""
    self_calibration_corners_per_cell: int = Field(default=3, ge=1)
    """As `corners_per_cell`, for these points: there are few spans."""
    self_calibration_prior_px: Positive = 1.0
    """How far a calibration of unknown covariance may be off: sigma of a shift of disparities and of rows, and, at the image's
    side, of rows by a tilt and of disparities by a bend."""
    self_calibration_sigma_floor_px: Positive = 0.05
    """Of each of these, added to what the spans say: lenses and focal lengths are not turns of a camera."""
    self_calibration_least_px: Positive = 0.1
    """A correction smaller than this, in each of the four, is not applied ..."""
    self_calibration_significance: Positive = 3.0
    """... nor one of fewer than so many of its own sigmas ..."""
    self_calibration_max_chi2: Positive = 18.5
    """... nor one farther from the prior: chi-square of 4 degrees of freedom at 0.001."""
    max_width_px: int = Field(default=1280, ge=64)
    """Wider images are reduced for following points."""
    cell_px: int = Field(default=40, ge=8)
    corners_per_cell: int = Field(default=2, ge=1)
    """More of them sharpen a motion below the floors that follow, and cost time in proportion."""
    min_disparity_px: Positive = 2.0
    """Points with less are too far to tell how far the car drove; sky has none."""
    min_points: int = Field(default=30, ge=6)
    sigma_px: Positive = 0.3
    """Of a followed point; only relative weights and thresholds depend on it, the covariance comes from the residuals."""
    circle_tolerance_px: Positive = 0.7
    epipolar_tolerance_px: Positive = 1.0
    inlier_px: Positive = 1.5
    min_inlier_share: Fraction = 0.2
    gate_m: Positive = 0.5
    """Motions farther than this from the logged one, frame pair to frame pair, are those of a lorry, not of the car."""
    gate_rad: Positive = 0.02
    floor_relative: Positive = 0.003
    """Error of visual odometry that its residuals do not show, as a share of the way between two frame pairs ..."""
    floor_m: Positive = 0.002
    floor_rad: Positive = 0.0001
    scale_sigma: Positive = 0.003
    """... and in common to the whole drive: an error of the baseline or the focal length makes all ways too long alike."""
    robust_sigmas: Positive = 3.0
    """Huber's bound for an interval in the adjustment of the trajectory."""
    gnss_correlation_s: Positive = 20.0
    """Over this time the error of GNSS/INS changes (first-order Gauss-Markov process) ..."""
    gnss_white_share: Fraction = 0.1
    """... except this share of its sigma, which is new in every record."""
    attitude_correlation_s: Positive = 60.0
    attitude_white_share: Fraction = 0.3
    cone_landmarks: bool = True
    """Let the drive's own cones, which stand still, take part in the adjustment ..."""
    cone_landmarks_from_m: Positive = 0.1
    """... where GNSS/INS states at least this (median horizontal sigma). Beside an RTK fix cones only harm."""
    max_shift_chi2: Positive = 36.0
    """Squared shift of a pose in its stated sigmas above which the refinement is not believed: 3 sigma of a GNSS/INS that
    states half its sigmas."""


class IngestParams(Params):
    """All parameters of one ingest."""

    detection: DetectionParams = DetectionParams()
    match: MatchParams = MatchParams()
    position: PositionParams = PositionParams()
    track: TrackParams = TrackParams()
    reconcile: ReconcileParams = ReconcileParams()
    trajectory: TrajectoryParams = TrajectoryParams()
    chunk_pairs: int = Field(default=256, ge=1)
    """Frame pairs of a chunk, half of which are one detection task: a task costs Prefect some 10 ms."""
    max_rejected_fraction: Fraction = 0.10
    """More frame pairs refused than this, and the command ends with exit code 1."""


class ImportParams(Params):
    """What is taken for true of an imported map where its file does not say it, and how it is compared with the map."""

    sigma_m: Positive = 0.5
    """Standard deviation of each coordinate."""
    cone_height_m: Positive = 0.5
    cone_height_sigma_m: Positive = 0.2
    existence_probability: Fraction = 0.9
    """Somebody wrote it down; people err, and cones are taken away."""
    ground_height_m: float | None = None
    """Ellipsoidal height of all cones of a file without heights; None: such a file is refused."""
    new_ids: bool = False
    """Found ids of its own for every feature, instead of those of the file."""
    reconcile: ReconcileParams = ReconcileParams()


class WorkZoneParams(Params):
    """How cones become work zones."""

    min_cones: int = Field(default=3, ge=2)
    """Fewer cones near each other found no work zone (one that has shrunk goes on until its last cone is gone)."""
    min_link_m: Positive = 15.0
    """Neighbours along the road that are nearer than this always belong together."""
    link_factor: Positive = 3.2
    """Otherwise up to this many times the spacing beside the gap: two cones missing in succession do not split a zone."""
    max_link_m: Positive = 80.0
    """Never more than this. MUTCD 2009 6F.63 allows 130 ft (40 m) in a tangent at 65 mph: one missing cone is bridged."""
    max_path_offset_m: Positive = 12.0
    """Cones farther from a drive's path do not stand on the road that it followed."""
    max_beyond_path_m: Positive = 40.0
    """Cones may stand so far before or behind a path: what a camera sees ahead of where the drive ended."""
    axis_smoothing_m: Positive = 5.0
    path_axis_sigma_m: Positive = 0.5
    """How far a car wanders across its lane beside cones: what a driven path is worth as an axis ..."""
    lane_axis_sigma_m: Positive = 0.1
    """... and a lane boundary."""
    kerb_side: Literal["right", "left"] = "right"
    """Traffic keeps to this side of the road."""
    row_tolerance_m: Positive = 0.3
    """How far a cone of a row stands from the line of its neighbours ..."""
    row_skip_cost: Positive = 7.0
    """... and the square of how many such tolerances one accepts rather than leave it out of the row."""
    min_row_cones: int = Field(default=4, ge=3)
    """A second row beside the first needs as many; fewer are strays."""
    placement_sigma_m: Positive = 0.15
    """How exactly crews set cones across the road."""
    segment_penalty: Positive = 14.0
    """Chi-square that one more bend in a row must explain."""
    min_taper_slope: Positive = 0.01
    """Gentler than this is no taper: at 75 mph MUTCD asks for 1:75."""
    min_taper_shift_m: Positive = 0.75
    lane_width_m: tuple[Positive, Positive] = (2.3, 5.0)
    """Two lane lines so far apart, least and most, have a lane between them."""
    min_open_lane_m: Positive = 2.5
    """A lane of which less is left is closed: lorries are up to 2.55 m wide (directive 96/53/EC)."""
    full_lane_shift_m: Positive = 2.8
    """Without lane lines: a taper that wide closes a lane (11 and 12 ft lanes are 3.35 and 3.66 m)."""
    verified_sigma_m: Positive = 0.5
    """A position counts as verified (WZDx) up to this horizontal sigma ..."""
    verified_existence: Fraction = 0.9
    """... and from this existence probability on."""
    assumed_duration_h: Positive = 24.0
    """WZDx wants an end date also of what stands: so long after the feed was made, marked as not verified."""
    keep_ended_days: Positive = 14.0
    """So long a work zone that is gone stays in the feed, as completed."""


class LayoutParams(Params):
    """Rules of the layout check, each with its source; MUTCD: Manual on Uniform Traffic Control Devices (FHWA), edition 2009."""

    taper_spacing_ft_per_mph: Positive = 1.0
    """MUTCD 2009, 6F.63: spacing of devices in a taper at most 1.0 times the speed limit in mph, in feet ..."""
    tangent_spacing_ft_per_mph: Positive = 2.0
    """... and in a tangent at most 2.0 times."""
    low_speed_max_mph: Positive = 45.0
    """MUTCD 2009, Table 6C-4: L = W S^2 / 60 for 40 mph or less, L = W S for 45 mph or more; between them the milder one."""
    low_speed_divisor: Positive = 60.0
    merging_taper_share: Positive = 1.0
    """MUTCD 2009, Table 6C-3: a merging taper is at least L long ..."""
    shoulder_taper_share: Positive = 1.0 / 3.0
    """... and a shoulder taper at least L / 3."""
    missing_cone_ratio: Positive = 1.6
    """No norm: a gap of more than so many times the row's own spacing lacks a cone."""
    in_lane_tolerance_m: Positive = 0.6
    """No norm: a cone farther than this from its row, towards traffic, stands in the way."""
    sigmas: Positive = 3.0
    """A rule must be exceeded by so many sigmas to be called violated."""


def params_sha256(params: Params) -> str:
    """Hash of a parameter group: equal values give equal hashes, whatever the order they were written in."""
    text = json.dumps(params.model_dump(mode="json"), sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()
