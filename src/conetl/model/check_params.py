"""Limits of the health checks, in groups: part of the parameters of an ingest, and of its hash (`params.py`)."""

from __future__ import annotations

from pydantic import Field

from conetl.model.base import Params, Positive
from conetl.model.base import Probability as Fraction


class ImageCheckParams(Params):
    """Limits of the checks of single images, as shares of 1."""

    max_blank_share: Fraction = 0.1
    """Squares of the lower half without detail: a covered lens. No part of a road is without; sample drives have none."""
    max_blurred_share: Fraction = 0.1
    """Squares of the lower half with too little fine detail: a smeared lens."""
    max_torn_share: Fraction = 0.1
    """Torn frame pairs: with more, others are probably torn, too, and were not detected."""
    max_seam: Positive = 2.0
    """Step of brightness at one row relative to those of the rows around it, in the mean of 25 images; intact drives: 1.16."""


class StereoCheckParams(Params):
    """Limits of the checks of left against right images."""

    max_swapped_share: Fraction = 0.7
    """Features farther right in the right image, of all. In good drives up to 0.27, in swapped or mirrored images 0.85 to 1."""
    fits_better: Positive = 1.3
    """Right images of another frame must fit this many times as many features as their own; all fit while the vehicle stands."""
    least_rows_px: Positive = 0.7
    """Row offset of the right images from which on they are corrected; smaller ones are left to the self-calibration."""
    most_rows_px: Positive = 4.0
    """Largest offset that is corrected, as a turn of the camera. At 12 px the columns in the corners are 2 px off."""
    max_beyond_share: Fraction = 0.02
    """Features beyond infinity. In good drives at most 0.003; shifted by 6 columns 0.05 to 0.10."""
    max_k1: Positive = 0.02
    """Distortion (k1 of Brown's model) of one lens against the other; 0.02 are 4 px of disparity in a corner. Good: 0.004."""
    k1_sigmas: Positive = 6.0
    """... and as many of its sigmas."""


class ExposureCheckParams(Params):
    """Limits of the checks whether both cameras expose at one instant, and each frame once."""

    max_ahead_share: Positive = 0.02
    """Offset of the right camera along the path as a share of the baseline. Sample drives and KITTI: 0.001 to 0.006."""
    ahead_sigmas: Positive = 4.5
    """... and as many of its sigmas."""
    least_doubled_pairs: int = Field(default=4, ge=1)
    """Pairs of objects that are one interval's travel apart ..."""
    max_doubled_share: Fraction = 0.6
    """... and their share of all objects: each image shows two instants."""
    uneven_share: Fraction = 0.2
    """Lengths of intervals that differ by less are equal: twice or half as long is one lost or repeated frame."""
    elsewhere_m: Positive = 0.2
    """Images of another recording differ from a uniform log by this much."""


class OdometryCheckParams(Params):
    """Limits of the checks of visual odometry against the log."""

    least_measured_share: Fraction = 0.5
    """Intervals that can be measured, where the images show enough."""
    max_lost_share: Fraction = 0.35
    """Longest run of intervals that cannot be measured, as behind a lorry."""
    max_contradicting_share: Fraction = 0.1
    """Measured motions that contradict the log."""
    max_reversed: int = Field(default=10, ge=1)
    """Intervals in which a vehicle without attitudes drives backwards."""


class JumpCheckParams(Params):
    """Limits of jumps of the log against the images, and of one drive against the next."""

    least_m: Positive = 0.1
    """Least jump of a position ..."""
    sigmas: Positive = 6.0
    """... and least number of sigmas that the log states for its change; of attitudes, too."""
    turn_deg: Positive = 0.3
    """Least jump of an attitude."""
    adjoining_m: Positive = 0.3
    """Least jump between a drive and the next of the same rig, beyond what a vehicle can do."""


class PathCheckParams(Params):
    """Limits of differences between the path in the images and in the log."""

    sigma_factor: Positive = 3.0
    """Up to this factor, stated sigmas that are too small are enlarged; beyond it the log is not what it states."""
    worth_saying: Positive = 1.25
    """From this factor on, enlarged sigmas are reported."""
    aside_deg: Positive = 0.25
    """Least angle between the directions of motion. Sample drives and KITTI: up to 0.27 degrees."""
    scale_percent: Positive = 1.0
    """Least difference of distances: three sigmas of a good calibration (`scale_sigma`)."""
    sigmas: Positive = 4.5
    """Least number of sigmas of each: p = 1e-4 for a dozen checks together."""


class MountCheckParams(Params):
    """Limits of the mount of the cameras by turns and slopes; 120 simulated good drives have up to 3.8 sigmas."""

    roll_deg: Positive = 1.0
    """Least roll of the cameras ..."""
    lever_arm_m: Positive = 0.3
    """... least error of their lever arm ..."""
    sigmas: Positive = 5.5
    """... and least number of sigmas of both."""
    stretch_percent: Positive = 5.0
    """Pitch in the images beyond that of the log ..."""
    stretch_sigmas: Positive = 5.0
    """... and least number of its sigmas."""
    climb: Positive = 0.3
    """Factor by which the log climbs more than the images, minus 1."""


class ControlCheckParams(Params):
    """Limits of control points against each other and the log."""

    gate_chi2: Positive = 16.3
    """A point beyond contradicts the others: chi-square of 3 degrees of freedom at 0.001."""
    ambiguous_chi2: Positive = 9.0
    """Another assignment of points to cones that fits worse by less may be the right one."""
    near_m: Positive = 2.0
    """The cone of a point is at most this far away, beside three sigmas of the log."""
    least_agreeing: int = Field(default=3, ge=2)
    """Points that must agree where the log contradicts them ..."""
    free_m: Positive = 1.0
    """... and may be wrong by this much more than it states (1 sigma)."""
    same_plan_m: Positive = 0.1
    """Points that differ from the log in height, but in plan by less than this, may be wrong themselves."""
    drift_sigmas: Positive = 10.0
    """Points may as well be wrong as a log that drifts against the images by fewer sigmas of both."""


class RegionCheckParams(Params):
    """Limits of the checks of a drive against the extent and the other drives of the map."""

    unusual_km: Positive = 50.0
    """A drive farther from everything on the map is noted."""
    least_on_roads: Fraction = 0.9
    """Share of the path that would be on roads of the map one UTM zone farther; of random roads 0.0002 would be."""
    most_m_s: Positive = 70.0
    """A vehicle is not faster (250 km/h)."""
    apart_m: Positive = 100.0
    """One rig is not in two places farther apart than this at once; areas of drives are 50 m wide."""


class CheckParams(Params):
    """Limits of the health checks, in the units in which they are printed; `checks/table.py` states which check has which."""

    images: ImageCheckParams = ImageCheckParams()
    """Single images: lenses, torn images."""
    stereo: StereoCheckParams = StereoCheckParams()
    """Left against right images."""
    exposures: ExposureCheckParams = ExposureCheckParams()
    """Instants of exposure."""
    odometry: OdometryCheckParams = OdometryCheckParams()
    """Visual odometry against the log."""
    jumps: JumpCheckParams = JumpCheckParams()
    """Jumps of the log."""
    path: PathCheckParams = PathCheckParams()
    """Drift, direction and distances."""
    mount: MountCheckParams = MountCheckParams()
    """Mount of the cameras."""
    control: ControlCheckParams = ControlCheckParams()
    """Control points."""
    region: RegionCheckParams = RegionCheckParams()
    """Extent of the map."""

    covered_m: Positive = 0.3
    """Largest error of positions that larger sigmas cover without a hold; beyond it, neighbouring cones (1 m) are taken for each
    other. Wrong recordings of the tests that must be held have 0.5 m and more."""

    def value(self, name: str) -> float:
        """The limit of a name such as "jumps.least_m"."""
        group, field = name.split(".")
        return float(getattr(getattr(self, group), field))
