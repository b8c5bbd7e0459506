"""Parameters of every step: frozen, units in the names; their hash becomes part of the changeset.

Nothing here is read from the environment (see `pipeline/settings.py`). The defaults were chosen on the sample drives and one
real street (benchmarks/RESULTS.md).
"""

from __future__ import annotations

import hashlib
import json
from typing import Annotated, Literal

from pydantic import Field, field_validator

from conetl.model.base import NonNegative, Params, Positive, Record
from conetl.model.base import Probability as Fraction
from conetl.model.check_params import CheckParams
from conetl.model.feature_classes import CONE, FEATURE_CLASSES, known_classes

_SIGN_MARGIN_RAD = 0.3


class DetectionParams(Params):
    categories: tuple[str, ...] = (CONE,)
    """Classes of objects that are searched for. A drive is not evidence that an object of another class is gone."""
    score_threshold: Fraction = 0.3
    """Low, because a track needs several boxes that agree in space."""
    nms_iou: Fraction = 0.5
    """Of two boxes of a class that overlap by more (intersection over union), only the one with the higher score is kept."""
    min_height_px: Positive = 8.0
    """Minimum height of a box."""
    horizon_margin_rad: Annotated[float, Field(ge=0, lt=1.57)] = 0.1
    """Rows farther than this above the horizon are not searched: cones stand on the road. 0.1 rad is a slope of 10 %."""
    search_right: Literal["along_epipolar_lines", "everywhere"] = "along_epipolar_lines"
    """Search the right images along the epipolar lines of the left boxes only (`tracking/matching/epipolar_search.py`), or
    everywhere, which takes up to 50 % longer for the same positions."""

    @property
    def searched_margin_rad(self) -> float:
        """`horizon_margin_rad`, and more where signs or boards are searched for: one that ends 3 m above the road is below 0.3
        rad from 5 m on. What is searched for must be searched for wherever it counts as visible."""
        above_road = any(not FEATURE_CLASSES[category].on_road for category in self.categories)
        return max(self.horizon_margin_rad, _SIGN_MARGIN_RAD) if above_road else self.horizon_margin_rad

    @field_validator("categories")
    @classmethod
    def _known(cls, categories: tuple[str, ...]) -> tuple[str, ...]:
        if unknown := set(categories) - set(FEATURE_CLASSES):
            raise ValueError(f"{', '.join(sorted(unknown))}: expected some of {', '.join(FEATURE_CLASSES)}")
        return known_classes(categories)  # in one order: they are part of a hash


class MatchParams(Params):
    epipolar_tolerance_px: Positive = 3.0
    """Allowed row difference of a stereo match, added to `epipolar_tolerance_relative` times the box height."""
    epipolar_tolerance_relative: Positive = 0.12
    """See `epipolar_tolerance_px`."""
    min_range_m: Positive = 1.5
    """Nearest object of the disparity search."""
    max_range_m: Positive = 40.0
    """Farthest object of the disparity search."""
    max_size_ratio: Positive = 1.6
    """Larger over smaller box height (and width, squared tolerance) of a match."""
    max_score_difference: Positive = 0.7
    """Largest difference between the scores of the two boxes."""
    refine: bool = True
    """Refine the left-right correspondence by area-based matching where the images allow it."""
    one_sided_min_score: Fraction = 0.3
    """Least score of a detection without a partner that is looked for in the other image."""


class PositionParams(Params):
    convergence_m2: Positive = 1e-10
    """Stop when the sum of squares of the correction is below this (the paper's criterion)."""
    max_iterations: int = Field(default=20, ge=1)
    """Most iterations for one position."""
    min_ray_angle_rad: Positive = 0.008
    """Matches with a smaller angle between the rays are rejected: 0.008 rad is 67 m at a baseline of 0.54 m."""
    max_range_m: Positive = 35.0
    """Maximum distance of a position from the camera."""
    max_residual_px: Positive = 6.0
    """Matches with a larger residual are rejected."""


class TrackParams(Params):
    gate_chi2: Positive = 16.0
    """Gate on the squared Mahalanobis distance of (u, v, disparity) against the prediction."""
    max_gap_frames: int = Field(default=12, ge=1)
    """A track not observed for longer is closed; `join_gate_m` may still join it."""
    max_innovation_m: Positive = 2.0
    """Maximum distance to the prediction: distant boxes are uncertain along the line of sight and may be of another cone."""
    motion_sigma_relative: Positive = 0.12
    """Error of the relative motion along the path, as a share of it: GNSS without a fix drifts by 10 %."""
    motion_sigma_aside: Positive = 0.04
    """The same across the path (sideways and up), where the INS is accurate."""
    motion_sigma_m: Positive = 0.05
    """The part of both that does not depend on the distance."""
    join_gate_m: Positive = 0.6
    """Two tracks never observed in one image and nearer than this (plus drift) are one cone."""
    min_observations: int = Field(default=3, ge=1)
    """Minimum number of positions of a track."""
    min_existence_probability: Fraction = 0.5
    """Minimum existence probability of a track that confirms a feature; see `founding_existence_probability` for new ones."""
    expected_cones_per_picture: Positive = 0.05
    """Prior: its ratio to the detector's false boxes per image is the odds that a group of boxes is a cone. One in twenty images
    is typical of an ordinary street; work zones have more."""
    score_doubt: Annotated[float, Field(gt=0, lt=0.5)] = 0.02
    """Limit of the evidence of one score for or against a cone: no set of images holds every object on roads."""
    hidden_run_probability: Annotated[float, Field(gt=0, lt=1)] = 0.1
    """Probability that successive misses have one cause, an undetected object in front (a parked van)."""
    min_cone_height_m: Positive = FEATURE_CLASSES[CONE].heights_m[0]
    """Minimum height of a cone."""
    max_cone_height_m: Positive = FEATURE_CLASSES[CONE].heights_m[1]
    """Maximum height of a cone."""
    max_ground_distance_m: Positive = 0.45
    """Maximum distance of the foot from the road surface given by the drive's other tracks."""
    max_range_m: Positive = 20.0
    """A cone must have been observed nearer than this at least once to become a feature."""

    def heights_m(self, category: str) -> tuple[float, float]:
        """Minimum and maximum height of an object: of cones these parameters, of other classes `FEATURE_CLASSES`."""
        if category == CONE:
            return self.min_cone_height_m, self.max_cone_height_m
        return FEATURE_CLASSES[category].heights_m


class AgreementParams(Params):
    """Limits of the comparison of a whole drive with the map, and of an imported map with it."""

    least_offset_m: Positive = 0.1
    """Smaller displacements and height differences are left to the fusion ..."""
    sigmas: Positive = 5.0
    """... and those below this many stated sigmas."""
    least_pairs: int = Field(default=3, ge=1)
    """Cones, or stretches of lane markings, that must agree on a displacement, a class or an absence ..."""
    gross_rise_m: Positive = 1.5
    """... but on a height difference beyond this, larger than any error of measurement, one does."""
    widened_max_m: Positive = 1.0
    """A drive displaced by at most this, beyond its stated sigmas, is fused with the map, and the sigmas of both are enlarged;
    one that is farther aside is held. Lever arms are wrong by less, base stations and datums often by more."""
    widened_least_m: Positive = 0.04
    """Smaller displacements do not enlarge them: networks and rectification move all cones of a drive by up to 2 cm."""
    widened_spacing: Positive = 3.0
    """Cones must stand this many displacements apart, so that each is nearest to its own position on the map."""
    max_displacement_m: Positive = 60.0
    """Displacements of a whole drive that are tried ..."""
    max_turn_deg: Positive = 10.0
    """... with rotations up to this, and ..."""
    part_turn_deg: Positive = 0.5
    """... of a part of it up to this, which errors of two cones can show."""
    lever_m: Positive = 4.0
    """Displacements of a drive with few cones: of the lever arm of another vehicle."""
    elsewhere_m: Positive = 300.0
    """Displacements of a drive or an imported map in another datum: ED50 is 80 m east and 200 m north of ETRS89."""
    least_agreeing: int = Field(default=4, ge=2)
    """Cones that must fit after a displacement ..."""
    least_share: Fraction = 0.6
    """... and their share."""
    least_same: int = Field(default=5, ge=2)
    """The same where a displacement is searched far away, where two rows fit by chance; of an imported map ..."""
    least_same_of_drive: int = Field(default=7, ge=2)
    """... and of a drive, in which some cones may be new."""
    same_zone_m: Positive = 0.05
    """People do not set up two zones that match to this RMS distance of their cones."""
    beside_m: Positive = 30.0
    """No road connects two cones this near in plan ..."""
    cliff_m: Positive = 20.0
    """... with such a height difference; bridges are lower."""
    again_s: Positive = 5.0
    """A cone that a drive did not observe for longer than this may be passed again ..."""
    again_m: Positive = 4.0
    """... displaced by at most this distance; ..."""
    again_gate_m: Positive = 1.5
    """... cones nearer to each other are compared even if their displacements differ, as by a drift."""
    blind_probability: Annotated[float, Field(gt=0, lt=1)] = 0.01
    """Prior probability that a drive does not detect what its model card promises ..."""
    max_blind: Annotated[float, Field(gt=0, lt=1)] = 0.05
    """... and the posterior from which on a person must decide whether its cones are gone."""


class ReconcileParams(Params):
    gate_chi2: Positive = 16.0
    """Gate on the squared Mahalanobis distance between track and feature, after the drive's common offset."""
    min_gate_m: Positive = 0.5
    """Objects closer than this are at the same position: crews do not set cones closer together."""
    max_rise_m: Positive = 1.5
    """Cones at one position with a larger height difference, beyond their sigmas, are on two levels (a bridge and a road)."""
    max_offset_m: Positive = 2.0
    """Maximum common offset of a drive from the map that is estimated and removed (GNSS without a fix)."""
    moved_max_m: Positive = 3.0
    """A vanished feature and a new track of similar height, at most this far apart, are one moved cone."""
    moved_height_tolerance_m: Positive = 0.15
    """Cones whose heights differ by more are of different sizes, which are at least 0.2 m apart."""
    moved_existence_probability: Annotated[float, Field(gt=0, lt=1)] = 0.7
    """Below this a feature counts as vanished if a new cone of similar height is near it."""
    founding_existence_probability: Fraction = 0.6
    """A less certain track confirms a feature but does not add one: two drives rarely err at the same location."""
    vanished_probability: Annotated[float, Field(gt=0, lt=1)] = 0.1
    """Probability that a cone is removed between two drives: the prior of a drive that misses it."""
    stray_probability: Annotated[float, Field(gt=0, lt=1)] = 0.1
    """Probability that a frame pair has a detection at an empty location: a stray box, or a neighbour's."""
    unseen_occluder_probability: Annotated[float, Field(gt=0, lt=1)] = 0.02
    """Probability that an undetected object (a parked van) hid a location during the whole drive; limits evidence of absence."""
    removal_existence_probability: Annotated[float, Field(gt=0, lt=1)] = 0.5
    """A feature is removed by the drive that lowers its existence probability below this."""
    removal_min_frames: int = Field(default=5, ge=1)
    """A feature is removed only if its location is visible and empty in at least this many frame pairs."""
    visible_min_height_px: Positive = 22.0
    """A cone counts as visible if it would appear at least this tall."""
    visible_border_px: Positive = 12.0
    """A cone counts as visible if it would appear at least this far inside both images."""
    marking_gate_m: Positive = 0.25
    """Lane markings nearer than this across their direction, after the drive's common offset, are the same one."""
    marking_moved_max_m: Positive = 1.0
    """A lane marking that is missed and a new one at most this far beside it are one marking that was repainted."""
    marking_least_m: Positive = 2.5
    """Shorter parts of a drive's lane marking are not added: the ends of markings are only accurate to the distance of their
    vertices."""
    marking_missed_probability: Annotated[float, Field(gt=0, lt=1)] = 0.05
    """Probability that a drive does not observe a lane marking in view (dirt, shadow, a lorry beside it): once for all frame
    pairs, which are not independent."""
    marking_blind_probability: Annotated[float, Field(gt=0, lt=1)] = 0.5
    """The same for a drive that shows less than half as much of lane markings as it does not observe (a wet road at night)."""
    marking_min_frames: int = Field(default=3, ge=1)
    """A vertex of a lane marking is missed if it was in view of this many frame pairs and the drive did not observe it."""
    marking_view_from_m: Positive = 4.0
    """Lane markings are in view from this distance in front of the camera on."""
    marking_view_to_m: Positive = 12.0
    """Lane markings are in view up to this distance, within the area that is searched for them (`MarkingParams`)."""
    marking_view_aside_m: Positive = 7.0
    """Lane markings are in view this far to the left and to the right."""
    marking_max_blur_m: Positive = 0.025
    """Nothing is in view beyond the depth at which images blur edges on the road by this sigma, a fifth of the paint width."""
    agreement: AgreementParams = AgreementParams()
    """Comparison of the drive as a whole."""


class TrajectoryParams(Params):
    refine: bool = True
    """Refine the logged poses by visual odometry."""
    self_calibrate: bool = True
    """Correct the right camera where the drive's own images contradict the calibration; requires `refine`."""
    self_calibration_span_m: Positive = 2.0
    """Points are compared over this distance: longer spans determine depth better, but fewer points survive."""
    self_calibration_min_spans: int = Field(default=8, ge=8)
    """Minimum number of spans."""
    self_calibration_max_spans: int = Field(default=120, ge=8)
    """At most this many spans, evenly spread over the drive: more cost time without lowering the error floor."""
    self_calibration_row_tolerance_px: Positive = 2.5
    """Like `epipolar_tolerance_px`, for these points, whose row error is to be estimated."""
    self_calibration_corners_per_cell: int = Field(default=3, ge=1)
    """Like `corners_per_cell`, for these points, because spans are few."""
    self_calibration_prior_px: Positive = 0.7
    """Sigma of a calibration that states none: of a shift of disparities and of rows, and, at the image's side, of rows by a tilt
    and of disparities by a bend. Root mean square of what KITTI's two calibrations are off (benchmarks/RESULTS.md)."""
    self_calibration_sigma_floor_px: Positive = 0.05
    """Added to the sigma of each of these from the spans: errors of lenses and focal lengths are not turns of a camera."""
    self_calibration_least_px: Positive = 0.1
    """A correction that is smaller in all four is not applied."""
    self_calibration_significance: Positive = 3.0
    """A correction below this many of its own sigmas is not applied."""
    self_calibration_max_chi2: Positive = 37.8
    """A correction farther from the prior is not applied. 6 sigmas, 4.3 px of an assumed one: cameras are also knocked."""
    self_calibration_readout_floor_m: Positive = 0.05
    """Sigma of a readout from the images beyond their scatter, as the distance driven in that time: points that come near are
    followed a little too far, as with a longer readout. By 0.03 m on the mean of five rendered drives, at most 0.065 m."""
    self_calibration_readout_sigmas: Positive = 2.0
    """A stated readout that differs from that of the images by more sigmas is estimated as if it were not stated."""
    video_readout_sigma_ms: NonNegative = 10.0
    """Prior sigma of the readout of cameras with a rolling shutter, around 0, for video whose `readout_ms` is not stated: video
    cameras and phones take 5 to 30 ms. 0: their shutters count as global, as those of images in folders and bags."""
    readout_scale_per_s: NonNegative = 0.4
    """By what share of the distance an error of the readout of 1 s scales measured motions, at most: 0.37 on a rendered drive at
    15 m/s, less at lower speeds. With the sigma of the readout it adds to `scale_sigma`."""
    max_width_px: int = Field(default=1280, ge=64)
    """Wider images are reduced for tracking points."""
    cell_px: int = Field(default=40, ge=8)
    """Points are chosen in cells of this side."""
    corners_per_cell: int = Field(default=2, ge=1)
    """Points in each cell: more make motions more precise than `floor_relative`, at proportional cost."""
    min_disparity_px: Positive = 2.0
    """Points with less are too far away to measure the distance driven."""
    min_points: int = Field(default=30, ge=6)
    """Minimum number of points of a motion."""
    sigma_px: Positive = 0.3
    """Of a tracked point; only relative weights and thresholds depend on it, the covariance comes from the residuals."""
    circle_tolerance_px: Positive = 0.7
    """Maximum distance from its start at which a point ends that is followed through both images of two pairs and back."""
    epipolar_tolerance_px: Positive = 1.0
    """Maximum row difference of a point in the left and the right image."""
    inlier_px: Positive = 1.5
    """Maximum residual of a point that agrees with a motion."""
    min_inlier_share: Fraction = 0.2
    """Minimum share of points that agree with it."""
    gate_m: Positive = 0.5
    """Motions that differ by more from the logged one, per frame pair, are those of a moving lorry in the image."""
    gate_rad: Positive = 0.02
    """Like `gate_m`, for rotations."""
    floor_relative: Positive = 0.003
    """Error of visual odometry beyond its residuals, as a share of the distance between two frame pairs."""
    floor_m: Positive = 0.002
    """Error of visual odometry beyond its residuals, as a distance."""
    floor_rad: Positive = 0.0001
    """Error of visual odometry beyond its residuals, as an angle."""
    scale_sigma: Positive = 0.003
    """Error of all distances of a drive, common to them: that of the baseline and the focal length."""
    robust_sigmas: Positive = 3.0
    """Huber's bound for an interval in the adjustment of the trajectory."""
    clock_sigma_s: Positive = 0.001
    """Sigma of the offset between the clocks of cameras and GNSS/INS, unless the drive shows a larger one and it is corrected."""
    lever_arm_sigma_m: Positive = 0.01
    """Sigma of each coordinate of the lever arm between GNSS/INS and cameras."""
    gnss_correlation_s: Positive = 20.0
    """Correlation time of the error of GNSS/INS (first-order Gauss-Markov process)."""
    gnss_white_share: Fraction = 0.1
    """Share of the sigma of GNSS/INS that is independent in every record."""
    attitude_correlation_s: Positive = 60.0
    """Correlation time of the error of the attitude."""
    attitude_white_share: Fraction = 0.3
    """Share of the sigma of the attitude that is independent in every record."""
    cone_landmarks: bool = True
    """Use the drive's own cones as landmarks in the adjustment."""
    cone_landmarks_from_m: Positive = 0.1
    """Cones are landmarks if GNSS/INS states at least this median horizontal sigma; with an RTK fix they do harm."""
    max_shift_chi2: Positive = 64.0
    """Largest squared shift of a pose in its sigmas, which may have grown: beyond it no spectrum of errors describes the log."""


class PairParams(Params):
    """What one pair shows of its calibration (`conetl locate`)."""

    min_points: int = Field(default=50, ge=10)
    """Fewer points in both images show nothing."""
    least_scatter_px: Positive = 0.1
    """Least scatter of the rows of a point. KITTI and the sample drives: 0.09 to 0.25."""
    beyond_share: Annotated[float, Field(gt=0, lt=0.5)] = 0.02
    """Share of points that may be beyond infinity by wrong matches: at most 0.01 in KITTI and the sample drives."""
    farthest_sigma_px: Positive = 0.2
    """Sigma of the disparity that all but this share exceed."""


class SelectionParams(Params):
    """Frame pairs that are left out because they show what their neighbours show: if the next one is still near the last one that
    is kept."""

    dense_s: NonNegative = 0.11
    """Near in time, together with `dense_m`: of cameras faster than 10 Hz about ten pairs per second are used. 0: all."""
    dense_m: NonNegative = 1.5
    """By the log."""
    standing_m: NonNegative = 0.3
    """Near by the log where left images agree, too: of a vehicle that stands or crawls. 0: all pairs of it are used."""
    standing_rad: NonNegative = 0.01
    """Like `standing_m`, for rotations."""
    standing_correlation: Fraction = 0.5
    """Least correlation of small left images at `standing_m`, in the median of their blocks: 0.6 on KITTI. It must be higher at
    less distance."""
    fewest_pairs: int = Field(default=10, ge=1)
    """All pairs are searched where fewer would be left, as of a vehicle that stands all the time."""


class MarkingParams(Params):
    """Detection of lane markings; only used if they are searched for (`DetectionParams.categories`)."""

    pair_spacing_m: Positive = 1.0
    """A frame pair is searched for markings if the rig has moved this far since the last searched one."""
    min_range_m: Positive = 4.0
    """Depth in front of the camera from which on the road is searched."""
    max_range_m: Positive = 17.0
    """Depth in front of the camera up to which the road is searched."""
    max_offset_m: Positive = 8.0
    """How far to the left and to the right of the camera the road is searched."""
    min_width_m: Positive = 0.07
    """Minimum width of paint: 0.10 to 0.30 m by most standards, measured with noise."""
    max_width_m: Positive = 0.35
    """Maximum width of paint."""
    min_contrast: Positive = 8.0
    """Minimum difference of paint and road in grey levels."""
    max_above_road_m: Positive = 0.04
    """Maximum height of the paint above the road on either side: kerbs are at least 0.06 m high."""
    max_gap_m: Positive = 14.0
    """Longest gap between the dashes of one line: 9 m (Germany, other roads) to 12 m (motorways)."""
    min_length_m: Positive = 3.0
    """Minimum length of the paint of one marking."""
    min_frames: int = Field(default=3, ge=1)
    """Minimum number of frame pairs that show it."""
    vertex_spacing_m: Positive = 2.5
    """Distance between two vertices of a line."""


class IngestParams(Params):
    """All parameters of one ingest."""

    detection: DetectionParams = DetectionParams()
    """Search for objects in images."""
    match: MatchParams = MatchParams()
    """Stereo matches."""
    position: PositionParams = PositionParams()
    """Positions by forward intersection."""
    track: TrackParams = TrackParams()
    """Positions of one object, over all frame pairs."""
    reconcile: ReconcileParams = ReconcileParams()
    """Comparison with the map."""
    trajectory: TrajectoryParams = TrajectoryParams()
    """Poses and calibration."""
    pair: PairParams = PairParams()
    """Single pairs."""
    selection: SelectionParams = SelectionParams()
    """Frame pairs that are searched."""
    marking: MarkingParams = MarkingParams()
    """Lane markings."""
    check: CheckParams = CheckParams()
    """Health checks of the recording."""
    chunk_pairs: int = Field(default=256, ge=1)
    """Frame pairs per chunk, half of which are one detection task: a task costs Prefect about 10 ms. It changes results a little:
    the rows that are searched and the measured spread of disparities are those of a chunk."""
    max_rejected_fraction: Fraction = 0.10
    """With a larger share of rejected frame pairs the command ends with exit code 1."""


class ImportParams(Params):
    """Assumptions about an imported map where its file states nothing, and parameters of its comparison with the map."""

    sigma_m: Positive = 0.5
    """Standard deviation of each coordinate."""
    cone_height_m: Positive = 0.5
    cone_height_sigma_m: Positive = 0.2
    existence_probability: Fraction = 0.9
    """Below 1, because people make mistakes and cones are removed."""
    ground_height_m: float | None = None
    """Ellipsoidal height of all cones of a file without heights; None: such a file is refused."""
    new_ids: bool = False
    """Assign new ids to all features instead of those of the file."""
    reconcile: ReconcileParams = ReconcileParams()


def params_sha256(params: Record) -> str:
    """Hash of a parameter group: equal values give equal hashes in any order."""
    text = json.dumps(params.model_dump(mode="json"), sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()
