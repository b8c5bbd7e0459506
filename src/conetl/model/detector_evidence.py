"""What a box, or a missing box, says about a cone: figures of one detector, measured on labelled images.

`training/calibrate_scores.py` writes them into the model's sidecar (`perception/model_card.py`); a model without them gets
`UNMEASURED`. The alternative to a cone is a *lookalike*: an object that is not a cone but was detected as one and will be again
(a tail lamp, a bollard). Scores are those of the network (`Detection.score`); P(cone | box) is a `calibrated_probability`.
"""

from __future__ import annotations

import hashlib
from bisect import bisect_right
from itertools import pairwise
from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, model_validator

from conetl.model.arrays import Bools, Floats
from conetl.model.base import Positive, Record
from conetl.model.drive import UnclearSquares
from conetl.model.feature_classes import CONE

Share = Annotated[float, Field(gt=0, lt=1)]
Count = Annotated[int, Field(ge=0)]
#: Scores and probabilities are clipped this far from 0 and 1 before taking logarithms.
_EDGE = 1e-4


class ScoreCalibration(Record):
    """Monotone map from a score to P(cone | box): piecewise linear in the log-odds of both, constant beyond the knots."""

    method: Literal["platt", "beta", "isotonic"]
    """Platt (1999): a straight line, two knots; beta (Kull et al. 2017); isotonic regression (Zadrozny & Elkan 2002)."""
    scores: tuple[Share, ...] = Field(min_length=2)
    probabilities: tuple[Share, ...] = Field(min_length=2)

    @model_validator(mode="after")
    def _monotone(self) -> Self:
        if len(self.scores) != len(self.probabilities):
            raise ValueError(f"{len(self.scores)} scores, but {len(self.probabilities)} probabilities")
        if any(b <= a for a, b in pairwise(self.scores)) or any(b < a for a, b in pairwise(self.probabilities)):
            raise ValueError("scores must increase, and probabilities must not decrease")
        return self


class ImageCorrelation(Record):
    """Correlation between two images of one object over the ratio of its apparent heights.

    far + (near - far) exp(-|octaves| / decay_octaves).
    """

    near: Share
    """At equal apparent heights."""
    far: Annotated[float, Field(ge=0, lt=1)]
    """At very different distances."""
    decay_octaves: Positive

    @model_validator(mode="after")
    def _falls(self) -> Self:
        if self.far > self.near:
            raise ValueError(f"far ({self.far}) is above near ({self.near})")
        return self


class DetectorEvidence(Record):
    """Response of a detector to cones, to lookalikes and to cone-free images.

    Axes of the tables: thresholds, heights and hidden shares. A height or hidden share belongs to the band that begins at or
    below it; between thresholds the figures are interpolated.
    """

    model_sha256: str = Field(pattern="^[0-9a-f]{64}$")
    match_iou: Share
    """Least overlap (IoU) of a box with a cone's box to count as its detection."""
    calibration: ScoreCalibration
    reference_score: Share
    """One of `score_thresholds`, above which the boxes of the next two fields were counted."""
    true_boxes: int = Field(ge=1)
    false_boxes: int = Field(ge=1)
    """Boxes on cones and beside them, in the images of the calibration: its prior odds."""
    score_thresholds: tuple[Share, ...] = Field(min_length=1)
    height_bands_px: tuple[Positive, ...] = Field(min_length=1)
    """Apparent height of the whole cone at which each band begins; the last is open."""
    hidden_bands: tuple[Annotated[float, Field(ge=0, lt=1)], ...] = Field(min_length=1)
    """Share of the cone's box behind nearer objects at which each band begins; the first is 0."""
    hidden_most: Share
    """Largest measured hidden share; beyond it an image is not evidence."""
    looks: tuple[tuple[Count, ...], ...]
    """Number of cones, by height and hidden band."""
    detected: tuple[tuple[tuple[Share, ...], ...], ...]
    lookalikes: Count
    found_again: tuple[Share, ...]
    """P(box at or above the threshold | lookalike with boxes in at least two other images), by threshold."""
    false_box_pictures: tuple[Count, ...]
    """Number of images on which false boxes were counted, by height band."""
    false_boxes_per_picture: tuple[tuple[Positive, ...], ...]
    """Boxes on no cone at or above the threshold, by threshold and height band."""
    false_boxes_by_class: dict[str, Positive] | None = None
    """Of classes other than cones: boxes on no object of the class at or above `reference_score`, per image; the upper 95 % bound
    where few were counted. None, or a class that is not in it: not counted."""
    look_correlation: ImageCorrelation
    """Of the log-likelihood ratios, cone against lookalike, of two images of one object."""
    miss_correlation: ImageCorrelation | None = None
    """Of the misses in two images of one fully visible cone. None in older figures: `look_correlation` and `joint_scale`
    apply."""
    joint_scale: Positive
    """Factor on the joint log-likelihood ratio that gives true odds; fitted on objects with several images."""

    @model_validator(mode="after")
    def _tables_fit_their_axes(self) -> Self:
        for name in ("score_thresholds", "height_bands_px", "hidden_bands"):
            if any(b <= a for a, b in pairwise(getattr(self, name))):
                raise ValueError(f"{name} must rise")
        scores, heights, hidden = len(self.score_thresholds), len(self.height_bands_px), len(self.hidden_bands)
        if self.hidden_bands[0] != 0 or self.reference_score not in self.score_thresholds:
            raise ValueError("hidden_bands must begin at 0, and reference_score be one of score_thresholds")
        for name, shape in (
            ("looks", (heights, hidden)),
            ("detected", (scores, heights, hidden)),
            ("found_again", (scores,)),
            ("false_box_pictures", (heights,)),
            ("false_boxes_per_picture", (scores, heights)),
        ):
            found = np.array(getattr(self, name), dtype=object).shape  # of rows that differ in length, their number
            if found != shape:
                raise ValueError(f"{name} has the shape {found}, its axes require {shape}")
        return self


class AbsenceFigures(Record):
    """What is needed to rate the evidence of a visible location without a box; stored with each drive."""

    evidence: DetectorEvidence
    score_threshold: Share
    categories: tuple[str, ...] = (CONE,)
    """The classes that were searched for; of other objects the drive says nothing."""
    unclear: UnclearSquares | None = None
    """Where its images say nothing."""


def class_evidence(evidence: DetectorEvidence, category: str) -> DetectorEvidence:
    """The evidence for boxes of one class. For classes other than cones, only an upper limit of the false boxes was measured."""
    if category == CONE:
        return evidence
    false_boxes = (evidence.false_boxes_by_class or {}).get(category)
    if false_boxes is None:
        return UNMEASURED_CLASS
    return UNMEASURED_CLASS.model_copy(update={"false_boxes_per_picture": ((false_boxes,),)})


def absence_log_ratio(
    evidence: DetectorEvidence,
    score_threshold: float,
    heights_px: Floats,
    hidden: Floats,
    found: Bools,
    *,
    stray_probability: float,
    unseen_occluder_probability: float,
) -> float:
    """ln P(observations at a location | a cone stands there) / P(the same | none does); never positive.

    heights_px, hidden (N, 2): apparent height of the cone and its share behind nearer detections, in the left and right image;
    found (N,): whether something was found there. A frame pair misses a cone unless both images show it; an empty location has
    a box with `stray_probability`. Misses of several pairs are correlated (`miss_correlation`), and with
    `unseen_occluder_probability` all have one cause, an undetected object in front.
    """
    if len(heights_px) == 0:
        return 0.0
    seen = [
        detect_probability(evidence, h, s, score_threshold)
        for h, s in zip(heights_px.ravel(), hidden.ravel(), strict=True)
    ]
    shown = np.reshape(seen, (-1, 2)).prod(axis=1)
    ratios = np.where(found, np.log(shown / stray_probability), np.log((1 - shown) / (1 - stray_probability)))
    misses, least_px = evidence.miss_correlation, heights_px.min(axis=1)
    joint = joint_log_ratio(evidence, ratios, least_px) if misses is None else _correlated_sum(misses, ratios, least_px)
    blind = unseen_occluder_probability
    return min(float(np.logaddexp(np.log(blind), np.log1p(-blind) + joint)), 0.0)


def calibrated_probability(calibration: ScoreCalibration, score: float) -> float:
    """P(cone | a box of this score) in images like those that the calibration was fitted on."""
    return 1 / (1 + float(np.exp(-_log_odds(calibration, score))))


def detect_probability(evidence: DetectorEvidence, height_px: float, hidden: float, threshold: float) -> float:
    """P(a box at or above the threshold | a cone of this apparent height and hidden share)."""
    i, j = _band(evidence.height_bands_px, height_px), _band(evidence.hidden_bands, hidden)
    return _at_threshold(evidence, threshold, [table[i][j] for table in evidence.detected])


def lookalike_box_probability(evidence: DetectorEvidence, threshold: float) -> float:
    """P(a box at or above the threshold | a lookalike with boxes in at least two other images)."""
    return _at_threshold(evidence, threshold, evidence.found_again)


def false_boxes_per_image(evidence: DetectorEvidence, least_height_px: float, threshold: float) -> float:
    """Expected boxes at or above the threshold in an image without cones, of the bands from `least_height_px` on."""
    first = _band(evidence.height_bands_px, least_height_px)
    return _at_threshold(evidence, threshold, [sum(row[first:]) for row in evidence.false_boxes_per_picture])


def box_log_ratio(evidence: DetectorEvidence, score: float, height_px: float, hidden: float, doubt: float) -> float:
    """ln p(box with this score | cone) / p(box with this score | lookalike).

    The ratio of the probabilities of any box at or above the reference score, times that of the score distributions: the
    calibrated odds over the odds in the images of the calibration (Bayes). The latter is limited to doubt / (1 - doubt) and its
    inverse, because no set of images holds every object on roads.
    """
    t = evidence.reference_score
    presence = np.log(detect_probability(evidence, height_px, hidden, t) / lookalike_box_probability(evidence, t))
    spread = _log_odds(evidence.calibration, score) - np.log(evidence.true_boxes / evidence.false_boxes)
    bound = np.log((1 - doubt) / doubt)
    return float(presence + np.clip(spread, -bound, bound))


def miss_log_ratio(evidence: DetectorEvidence, height_px: float, hidden: float, threshold: float) -> float:
    """ln P(no box at or above the threshold | cone) / P(no such box | lookalike)."""
    missed = 1 - detect_probability(evidence, height_px, hidden, threshold)
    return float(np.log(missed / (1 - lookalike_box_probability(evidence, threshold))))


def joint_log_ratio(evidence: DetectorEvidence, ratios: Floats, heights_px: Floats) -> float:
    """Joint log-likelihood ratio of N images, from their own ratios (N,) and the object's apparent heights (N,)."""
    return evidence.joint_scale * _correlated_sum(evidence.look_correlation, ratios, heights_px)


def _correlated_sum(correlation: ImageCorrelation, ratios: Floats, heights_px: Floats) -> float:
    """Sum of log-likelihood ratios (N,) over the design effect of their correlation at apparent heights (N,).

    Design effect (Kish 1965, Survey Sampling, section 5.4): 1 + (N - 1) r with one correlation r, here the mean row sum of the
    correlations. All images have equal weights: the inverse of the correlations would favour the first and the last.
    """
    if len(ratios) == 0:
        return 0.0
    octaves = np.abs(np.subtract.outer(np.log2(heights_px), np.log2(heights_px)))
    matrix = correlation.far + (correlation.near - correlation.far) * np.exp(-octaves / correlation.decay_octaves)
    np.fill_diagonal(matrix, 1.0)
    return float(ratios.sum() * len(ratios) / matrix.sum())


def evidence_sha256(evidence: DetectorEvidence | None) -> str:
    """Hash of the figures (of an empty string without any), part of the identity of an ingest."""
    return hashlib.sha256(b"" if evidence is None else evidence.model_dump_json(exclude_none=True).encode()).hexdigest()


def _log_odds(calibration: ScoreCalibration, score: float) -> float:
    return float(np.interp(_logit(score), _logit(calibration.scores), _logit(calibration.probabilities)))


def _band(begins: tuple[float, ...], value: float) -> int:
    return max(bisect_right(begins, value) - 1, 0)


def _at_threshold(evidence: DetectorEvidence, threshold: float, values: tuple[float, ...] | list[float]) -> float:
    return float(np.interp(threshold, evidence.score_thresholds, values))


def _logit(probabilities: ArrayLike) -> Floats:
    p = np.clip(probabilities, _EDGE, 1 - _EDGE)
    return np.asarray(np.log(p / (1 - p)))


#: For a detector of which nothing was measured; no statement about any network. Scores are read as they were for the first
#: detector of this project: 0.42 is neither for nor against, a miss is ln(0.1 / 0.2) whatever the height, six looks count as one.
UNMEASURED = DetectorEvidence(
    model_sha256="0" * 64,
    match_iou=0.3,
    calibration=ScoreCalibration(method="platt", scores=(0.02, 0.98), probabilities=(0.02, 0.98)),
    reference_score=0.3,
    true_boxes=45,
    false_boxes=55,
    score_thresholds=(0.3,),
    height_bands_px=(8.0,),
    hidden_bands=(0.0,),
    hidden_most=0.25,
    looks=((0,),),
    detected=(((0.9,),),),
    lookalikes=0,
    found_again=(0.8,),
    false_box_pictures=(0,),
    false_boxes_per_picture=((0.3,),),
    look_correlation=ImageCorrelation(near=1 / 6, far=1 / 6, decay_octaves=1.0),
    joint_scale=1.0,
)
#: For the boxes of other classes than cones: one box in two images, so that several drives must miss an object before it is gone.
UNMEASURED_CLASS = UNMEASURED.model_copy(update={"detected": (((0.5,),),), "found_again": (0.5,)})

#: `UNMEASURED` with the default threshold of `DetectionParams`.
UNMEASURED_ABSENCE = AbsenceFigures(evidence=UNMEASURED, score_threshold=0.3)
