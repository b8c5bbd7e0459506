from __future__ import annotations

import hashlib
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from conetl.model.detector_evidence import (
    UNMEASURED,
    DetectorEvidence,
    ImageCorrelation,
    ScoreCalibration,
    absence_log_ratio,
    box_log_ratio,
    calibrated_probability,
    class_evidence,
    detect_probability,
    evidence_sha256,
    false_boxes_per_image,
    joint_log_ratio,
    lookalike_box_probability,
    miss_log_ratio,
)

VALUES: dict[str, Any] = {
    "model_sha256": "0" * 64,
    "match_iou": 0.3,
    "calibration": {"method": "platt", "scores": [0.1, 0.9], "probabilities": [0.2, 0.99]},
    "reference_score": 0.3,
    "true_boxes": 300,
    "false_boxes": 100,
    "score_thresholds": [0.3, 0.5],
    "height_bands_px": [8.0, 20.0],
    "hidden_bands": [0.0, 0.25],
    "hidden_most": 0.6,
    "looks": [[10, 10], [10, 10]],
    "detected": [[[0.6, 0.3], [0.9, 0.7]], [[0.4, 0.1], [0.8, 0.5]]],
    "lookalikes": 20,
    "found_again": [0.4, 0.2],
    "false_box_pictures": [50, 100],
    "false_boxes_per_picture": [[0.2, 0.1], [0.1, 0.04]],
    "look_correlation": {"near": 0.8, "far": 0.4, "decay_octaves": 0.5},
    "joint_scale": 1.0,
}
EVIDENCE = DetectorEvidence.model_validate(VALUES)


def test_bands_begin_at_their_limits_and_thresholds_are_interpolated() -> None:
    assert detect_probability(EVIDENCE, 19.9, 0.0, 0.3) == pytest.approx(0.6)
    assert detect_probability(EVIDENCE, 20.0, 0.0, 0.3) == pytest.approx(0.9)
    assert detect_probability(EVIDENCE, 500.0, 0.3, 0.3) == pytest.approx(0.7)
    assert detect_probability(EVIDENCE, 20.0, 0.0, 0.4) == pytest.approx(0.85)
    assert detect_probability(EVIDENCE, 3.0, 0.0, 0.3) == pytest.approx(0.6), "the first band applies below its limit"
    assert lookalike_box_probability(EVIDENCE, 0.4) == pytest.approx(0.3)
    assert false_boxes_per_image(EVIDENCE, 8.0, 0.3) == pytest.approx(0.3)
    assert false_boxes_per_image(EVIDENCE, 22.0, 0.5) == pytest.approx(0.04)


@given(st.floats(0, 1), st.floats(0, 1))
def test_calibration_keeps_the_order_of_scores(a: float, b: float) -> None:
    low, high = sorted((a, b))
    calibration = EVIDENCE.calibration
    assert calibrated_probability(calibration, low) <= calibrated_probability(calibration, high)
    assert 0.2 - 1e-9 <= calibrated_probability(calibration, low) <= 0.99 + 1e-9


def test_calibration_interpolates_log_odds_and_may_have_steps() -> None:
    calibration = EVIDENCE.calibration
    assert calibrated_probability(calibration, 0.9) == pytest.approx(0.99)
    middle = (np.log(0.2 / 0.8) + np.log(99.0)) / 2
    assert calibrated_probability(calibration, 0.5) == pytest.approx(1 / (1 + np.exp(-middle)))
    flat = ScoreCalibration(method="isotonic", scores=(0.1, 0.2, 0.3), probabilities=(0.2, 0.2, 0.5))
    assert calibrated_probability(flat, 0.15) == pytest.approx(0.2)


def test_the_ratio_of_a_box_is_bayes_rule() -> None:
    """Odds in images like those of the calibration = ratio of the score times true over false boxes there."""
    ratio = box_log_ratio(EVIDENCE, 0.5, 30.0, 0.0, 1e-6)
    p = calibrated_probability(EVIDENCE.calibration, 0.5)
    assert ratio == pytest.approx(np.log(0.9 / 0.4) + np.log(p / (1 - p)) - np.log(300 / 100))
    for score, limit in ((0.999, np.log(4)), (0.001, -np.log(4))):  # at most the odds of `doubt`
        assert box_log_ratio(EVIDENCE, score, 30.0, 0.0, 0.2) == pytest.approx(np.log(0.9 / 0.4) + limit)


def test_joint_ratio_has_the_design_effect_of_kish() -> None:
    one_for_all = ImageCorrelation(near=0.5, far=0.5, decay_octaves=1.0)
    even = EVIDENCE.model_copy(update={"look_correlation": one_for_all, "joint_scale": 1.5})
    ratios, heights = np.array([1.0, 2.0, 3.0]), np.array([20.0, 40.0, 80.0])
    assert joint_log_ratio(even, ratios, heights) == pytest.approx(1.5 * 6.0 / (1 + 2 * 0.5))
    assert joint_log_ratio(EVIDENCE, ratios, np.full(3, 40.0)) < joint_log_ratio(EVIDENCE, ratios, heights)
    assert joint_log_ratio(EVIDENCE, ratios[:1], heights[:1]) == pytest.approx(1.0)
    assert joint_log_ratio(EVIDENCE, np.zeros(0), np.zeros(0)) == 0.0


def absent(evidence: DetectorEvidence, frames: int) -> float:
    return absence_log_ratio(
        evidence, 0.3, np.full((frames, 2), 40.0), np.zeros((frames, 2)), np.zeros(frames, bool),
        stray_probability=0.02, unseen_occluder_probability=1e-60,
    )  # fmt: skip


@given(st.integers(1, 40), st.floats(0.05, 0.8))
def test_empty_frames_have_the_correlation_of_misses_if_known(n: int, r: float) -> None:
    alike = ImageCorrelation(near=r, far=r, decay_octaves=1.0)
    separate = EVIDENCE.model_copy(update={"miss_correlation": alike, "joint_scale": 7.0})
    one = np.log((1 - 0.9 * 0.9) / (1 - 0.02))
    assert absent(separate, n) == pytest.approx(n * one / (1 + (n - 1) * r), rel=1e-4)
    older = EVIDENCE.model_copy(update={"look_correlation": alike, "joint_scale": 0.5})
    assert absent(older, n) == pytest.approx(0.5 * absent(separate, n), rel=1e-4)


@given(st.floats(8, 300), st.floats(0, 0.6), st.floats(0.3, 0.5))
def test_a_miss_is_evidence_against_cones_that_are_found_more_often(height: float, hidden: float, t: float) -> None:
    found, again = detect_probability(EVIDENCE, height, hidden, t), lookalike_box_probability(EVIDENCE, t)
    assert (miss_log_ratio(EVIDENCE, height, hidden, t) < 0) == (found > again)
    assert miss_log_ratio(EVIDENCE, 30.0, 0.0, 0.3) < miss_log_ratio(EVIDENCE, 30.0, 0.4, 0.3) < 0


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("found_again", [0.4], "found_again has the shape"),
        ("detected", [[[0.6, 0.3], [0.9]], [[0.4, 0.1], [0.8, 0.5]]], "detected has the shape"),
        ("false_boxes_per_picture", [[0.2, 0.1]], "false_boxes_per_picture has the shape"),
        ("score_thresholds", [0.5, 0.3], "score_thresholds must rise"),
        ("hidden_bands", [0.1, 0.25], "begin at 0"),
        ("reference_score", 0.35, "reference_score"),
        ("look_correlation", {"near": 0.4, "far": 0.5, "decay_octaves": 0.5}, "is above near"),
        ("calibration", {"method": "platt", "scores": [0.1, 0.9], "probabilities": [0.5, 0.4]}, "must not decrease"),
        ("calibration", {"method": "platt", "scores": [0.1, 0.9], "probabilities": [0.2, 0.5, 0.7]}, "2 scores, but 3"),
    ],
)
def test_inconsistent_tables_are_refused(key: str, value: object, words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        DetectorEvidence.model_validate(VALUES | {key: value})


def test_an_unmeasured_detector_has_default_figures() -> None:
    assert box_log_ratio(UNMEASURED, 0.9, 30.0, 0.0, 0.02) > 2
    assert box_log_ratio(UNMEASURED, 0.42, 30.0, 0.0, 0.02) == pytest.approx(0, abs=0.05)
    assert miss_log_ratio(UNMEASURED, 30.0, 0.0, 0.3) == pytest.approx(np.log(0.5))


def test_the_hash_depends_on_all_figures_and_is_that_of_older_files() -> None:
    other = EVIDENCE.model_copy(update={"true_boxes": 301})
    later = EVIDENCE.model_copy(update={"miss_correlation": EVIDENCE.look_correlation})
    assert len({evidence_sha256(e) for e in (None, EVIDENCE, other, later)}) == 4
    text = EVIDENCE.model_dump_json(exclude={"miss_correlation", "false_boxes_by_class"})
    assert evidence_sha256(DetectorEvidence.model_validate_json(text)) == hashlib.sha256(text.encode()).hexdigest()


def test_counted_false_boxes_of_a_class_change_its_prior_odds_alone() -> None:
    counted = UNMEASURED.model_copy(update={"false_boxes_by_class": {"drum": 0.03}})
    assert class_evidence(counted, "traffic_cone") is counted
    drum, sign = class_evidence(counted, "drum"), class_evidence(counted, "traffic_sign")
    assert false_boxes_per_image(drum, 22.0, 0.3) == pytest.approx(0.03)
    assert sign == class_evidence(UNMEASURED, "drum") and false_boxes_per_image(sign, 22.0, 0.3) == pytest.approx(0.3)
    assert box_log_ratio(drum, 0.7, 30.0, 0.0, 0.02) == box_log_ratio(sign, 0.7, 30.0, 0.0, 0.02)
