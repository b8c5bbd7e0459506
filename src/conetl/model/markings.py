"""Records of lane markings: one marking in one drive, and the shape that a stretch of it has on the map.

Units and frames as in `base.py`.
"""

from __future__ import annotations

from math import exp, isqrt
from typing import Literal

import numpy as np
from pydantic import Field, model_validator

from conetl.model.arrays import Floats
from conetl.model.base import Cov3, NonNegative, Positive, Probability, Record, SharedErrorJacobian, Vec3

MarkingColour = Literal["white", "yellow", "other"]
MarkingPattern = Literal["solid", "dashed"]
#: Existence: prior probability of what was found, grey levels at which a frame pair's evidence is half of the most, and that
#: evidence (logarithm of odds).
_PRIOR, _HALF_CONTRAST, _EVIDENCE = 0.2, 20.0, 0.6


def marking_existence(frames: int, contrast: float, hit_share: float = 1.0) -> float:
    """Prior odds times a factor per frame pair that grows with contrast (grey levels) and the share of painted length that was
    hit."""
    gain = _EVIDENCE * frames * hit_share * contrast / (contrast + _HALF_CONTRAST)
    return 1 / (1 + (1 - _PRIOR) / _PRIOR * exp(-gain))


class Marking(Record):
    """Shape of a lane marking: the centre line of the paint, on the road surface. A dashed line runs through its gaps."""

    vertices_m: tuple[Vec3, ...] = Field(min_length=2)
    """Easting, northing, ellipsoidal height, in the direction of travel of the drive that first observed it."""
    cov_m2: tuple[Cov3, ...] = Field(min_length=2)
    """Absolute, one per vertex. Along the line a vertex is where it was put, without error: the part along the line is that of
    the drive's pose only."""
    width_m: Positive
    width_sigma_m: Positive
    colour: MarkingColour
    pattern: MarkingPattern
    dash_m: Positive | None = None
    """Length of a dash; None of solid lines."""
    gap_m: Positive | None = None

    @model_validator(mode="after")
    def _consistent(self) -> Marking:
        if len(self.cov_m2) != len(self.vertices_m):
            raise ValueError(f"{len(self.vertices_m)} vertices have {len(self.cov_m2)} covariances")
        dashed = self.pattern == "dashed"
        if (self.dash_m is not None, self.gap_m is not None) != (dashed, dashed):
            raise ValueError("dash_m and gap_m: expected of dashed markings, and of them only")
        return self


class MarkingTrack(Record):
    """One lane marking in one drive, adjusted from all its observations; as long as the drive shows it without a break."""

    marking_index: int = Field(ge=0)
    category: str
    marking: Marking
    relative_cov_m2: tuple[Cov3, ...] = Field(min_length=2)
    """Of the vertices, without the errors of pose and calibration that all of them share."""
    existence_probability: Probability
    observation_count: int = Field(ge=1)
    """Frame pairs in which it was observed."""
    first_seen_ns: int
    last_seen_ns: int
    contrast: NonNegative
    """Median grey levels between paint and road."""
    blur_px: NonNegative
    """Sigma of the Gaussian that blurs its edges in the images, median."""
    shared_jacobian: SharedErrorJacobian | None = Field(default=None, exclude=True, repr=False)
    """Of the calibration's part in the covariances, at the middle vertex; None where unknown."""
    image_cov_m2: tuple[bytes, ...] = Field(default=(), exclude=True, repr=False)
    """Of the vertices, without any error of pose and calibration, for evaluations; not in the database. Joint covariances of
    stretches, one after the other: the bytes of (3k, 3k) doubles for k vertices."""

    def image_covs(self) -> list[Floats]:
        """The stretches of `image_cov_m2` as arrays (3k, 3k)."""
        return [np.frombuffer(data).reshape(2 * (isqrt(len(data) // 8),)) for data in self.image_cov_m2]
