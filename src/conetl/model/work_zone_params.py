"""Parameters of work zones, and of the check of their layout: how cones of a map are read, not part of a drive's key."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from conetl.model.base import Params, Positive
from conetl.model.base import Probability as Fraction


class WorkZoneParams(Params):
    """How cones become work zones."""

    min_cones: int = Field(default=3, ge=2)
    """Fewer cones near each other are not a work zone; an existing zone continues until its last cone is gone."""
    min_link_m: Positive = 15.0
    """Neighbours along the road closer than this always belong together."""
    link_factor: Positive = 3.2
    """Otherwise up to this many times the spacing beside the gap: two successive missing cones do not split a zone."""
    max_link_m: Positive = 80.0
    """Never more than this. MUTCD allows 130 ft (40 m) in a tangent at 65 mph (2023, 6K.01): one missing cone is bridged."""
    max_path_offset_m: Positive = 12.0
    """Cones farther from a drive's path do not stand on the road that it followed."""
    max_beyond_path_m: Positive = 40.0
    """Cones may stand this far before or behind a path: a camera sees ahead of the end of the drive."""
    axis_smoothing_m: Positive = 5.0
    path_axis_sigma_m: Positive = 0.5
    """Lateral sigma of a driven path as a road axis ..."""
    lane_axis_sigma_m: Positive = 0.1
    """... and a lane boundary."""
    kerb_side: Literal["right", "left"] = "right"
    """Traffic keeps to this side of the road."""
    row_tolerance_m: Positive = 0.3
    """Distance of a cone of a row from the line of its neighbours ..."""
    row_skip_cost: Positive = 7.0
    """... and the square of the number of tolerances beyond which a cone is not in the row."""
    min_row_cones: int = Field(default=4, ge=3)
    """Minimum number of cones of a second row; fewer are strays."""
    placement_sigma_m: Positive = 0.15
    """Precision of setting cones across the road."""
    segment_penalty: Positive = 14.0
    """Chi-square that an additional bend in a row must explain."""
    min_taper_slope: Positive = 0.01
    """Gentler slopes are not tapers: at 75 mph MUTCD requires 1:75."""
    min_taper_shift_m: Positive = 0.75
    lane_width_m: tuple[Positive, Positive] = (2.3, 5.0)
    """Minimum and maximum distance between two lane lines of a lane."""
    min_open_lane_m: Positive = 2.5
    """A lane with less remaining width is closed: lorries are up to 2.55 m wide (directive 96/53/EC)."""
    full_lane_shift_m: Positive = 2.8
    """Without lane lines: a taper this wide closes a lane (11 and 12 ft lanes are 3.35 and 3.66 m)."""
    verified_sigma_m: Positive = 0.5
    """A position counts as verified (WZDx) up to this horizontal sigma ..."""
    verified_existence: Fraction = 0.9
    """... and from this existence probability on."""
    assumed_duration_h: Positive = 24.0
    """WZDx requires an end date of active zones, too: this long after the feed, marked as not verified."""
    max_age_days: Positive = 7.0
    """A survey is evidence for this long. A zone not surveyed since then has an end in the past and unknown impact: whether it
    still stands is unknown."""
    keep_ended_days: Positive = 14.0
    """How long an ended work zone stays in the feed, as completed."""
    most_at_merge: int = Field(default=500, ge=0)
    """The versions of zones are stored after each merge if the map has at most so many features: half a second (2 cores)."""
    most_in_rounds: int = Field(default=20_000, ge=0)
    """In the rounds of schedules and in the nightly publication, up to so many: 20 s; beyond, only for receivers of notices."""


class LayoutParams(Params):
    """Rules of the layout check. The numbers of standards, and their sources, are in `workzones/rules`; None: no such rule."""

    taper_spacing_ft_per_mph: Positive | None = None
    """Maximum spacing of devices in a taper in feet per mph of the speed limit ..."""
    tangent_spacing_ft_per_mph: Positive | None = None
    """... and in a tangent."""
    low_speed_max_mph: Positive = 45.0
    """L = W S^2 / divisor below this speed, L = W S from it on."""
    low_speed_divisor: Positive = 60.0
    merging_taper_share: Positive | None = None
    """Minimum length of a merging taper as a share of L ..."""
    shoulder_taper_share: Positive | None = None
    """... and of a shoulder taper."""
    missing_cone_ratio: Positive = 1.6
    """No standard: a gap of more than this many times the row's own spacing lacks a cone."""
    in_lane_tolerance_m: Positive = 0.6
    """No standard: a cone farther than this from its row, towards traffic, is in the lane."""
    sigmas: Positive = 3.0
    """A limit counts as exceeded if it is exceeded by this many sigmas."""
    sources: dict[str, str] = Field(default_factory=dict)
    """By the names above: standard with section or table. Only rules with a source can be violated."""


class PlanParams(Params):
    """How zones that were found are compared with plans (`workzones/plan_comparison.py`)."""

    tolerance_m: Positive = 15.0
    """A device this far from the line or area of a plan still stands in its place: plans are drawn along the middle of a road,
    and tapers begin before them; zones shifted by 30 m must be found.
    `make bench-plans ARGS='--tolerance-m 10'` shows the effect."""
    approximate_m: Positive = 200.0
    """The same of a plan whose source gives points of a reference only."""
    near_m: Positive = 60.0
    """A zone this near to a plan that no zone meets is that plan's, elsewhere; farther away it has no permit."""
    same_lines_m: Positive = 1.0
    """A device belongs to the nearest plan, and to those that are farther by no more than this: records of one permit."""
    tolerance_min: Positive = 30.0
    """A zone seen less than this before the start or after the end is in time."""
    same_works_days: Positive = 14.0
    """A zone seen further than this from the time of a plan is not of that plan."""
    pass_s: Positive = 60.0
    """Frame pairs at one place within this time are one pass."""
    look_aside_m: Positive = 12.0
    """A drive looks at what is this near to its path: farther devices do not stand on the road that it followed
    (`max_path_offset_m`)."""
    look_gap_m: Positive = 25.0
    """Between frame pairs that are farther apart, as where images are missing, nothing was looked at."""
    least_coverage: Fraction = 0.9
    """Share of a plan that must have been passed in its time to say that nothing is there: a zone may stand on the rest."""
    sigmas: Positive = 2.0
    """Positions of devices are taken to be this many sigmas nearer to the plan."""
