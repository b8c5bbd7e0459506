"""The evidence model on looks made by hand, with the shipped detector's own figures, and on a road of the synthetic world."""

from __future__ import annotations

from collections import defaultdict

import pytest
from hypothesis import given
from hypothesis import strategies as st

from conetl.detector_evidence import UNMEASURED, DetectorEvidence
from conetl.io.detector import shipped_model_path
from conetl.io.model_card import read_model_card
from conetl.params import IngestParams
from conetl.records import Detection, Position
from conetl.steps.existence import Look, existence_probability, probability_from_looks
from tests.synthetic.world import Cone, camera_poses, detect, locate, make_path, make_rig

PARAMS = IngestParams()
RIG = make_rig()


def shipped() -> DetectorEvidence:
    evidence = read_model_card(shipped_model_path()).evidence
    assert evidence is not None, "the shipped model's sidecar holds its evidence"
    return evidence


def looks(*scores: float | None, height_px: float = 40.0, hidden: float = 0.0) -> list[Look]:
    return [Look(height_px=height_px, hidden=hidden, score=score) for score in scores]


def belief(left: list[Look], right: list[Look] | None = None, evidence: DetectorEvidence | None = None) -> float:
    return probability_from_looks([left, right or []], PARAMS, evidence or shipped())


def test_good_boxes_make_a_cone_and_weak_ones_with_misses_make_none() -> None:
    assert belief(looks(*[0.75] * 20), looks(*[0.75] * 20)) > 0.97
    assert belief(looks(*[0.34, None] * 10), looks(*[None, 0.32] * 10)) < 0.1


def test_without_any_look_the_odds_are_cones_to_false_boxes() -> None:
    evidence = shipped()
    rates = evidence.false_boxes_per_picture[evidence.score_thresholds.index(0.3)]
    expected = PARAMS.track.expected_cones_per_picture
    assert belief([]) == pytest.approx(expected / (expected + sum(rates[3:])), rel=1e-6), "22 px lie in the fourth band"


def test_looks_at_one_thing_fail_together() -> None:
    """More of the same looks move the belief less and less: the whole stays below 1 / correlation looks."""
    few, many, more = (belief(looks(*[0.5] * n)) for n in (2, 20, 200))
    assert few < many < more
    assert more - many < 0.2 * (many - few)


def test_a_long_run_of_misses_counts_only_so_far() -> None:
    """A parked van hides the cone for a long while; seen before and after it stays a cone."""
    seen = [0.8] * 8
    assert belief(looks(*seen, *[None] * 30, *seen)) > 0.8
    assert belief(looks(*seen, *[None] * 30, *seen)) == pytest.approx(
        belief(looks(*seen, *[None] * 60, *seen)), abs=0.02
    )


def test_misses_between_boxes_count_more_than_one_run_of_them() -> None:
    assert belief(looks(*[0.6, None] * 8)) < belief(looks(*[0.6] * 8, *[None] * 8))


def test_a_look_that_could_not_show_the_cone_says_nothing() -> None:
    seen = looks(*[0.6] * 5)
    behind = looks(*[None] * 5, hidden=0.9)
    assert belief([*seen, *behind]) == belief(seen)


def test_a_miss_of_a_half_hidden_cone_is_forgiven() -> None:
    seen = looks(*[0.6] * 4)
    assert belief([*seen, *looks(None, None, hidden=0.5)]) > belief([*seen, *looks(None, None)])


@given(
    st.lists(st.one_of(st.none(), st.floats(0.3, 0.95)), min_size=1, max_size=12),
    st.integers(0, 11),
    st.floats(0.3, 0.95),
)
def test_a_better_score_never_lowers_the_belief(scores: list[float | None], place: int, score: float) -> None:
    place %= len(scores)
    old = scores[place]
    if old is None or old >= score:
        return
    better = [*scores[:place], score, *scores[place + 1 :]]
    assert belief(looks(*better)) >= belief(looks(*scores)) - 1e-12


def test_an_unmeasured_detector_gives_beliefs_too() -> None:
    assert belief(looks(*[0.9] * 20), evidence=UNMEASURED) > 0.9
    assert belief(looks(*[0.32] * 20), evidence=UNMEASURED) < 0.3


def on_a_road(score: float, kept_every: int) -> float:
    """Belief in a cone at the roadside that gets a box of `score` in every `kept_every`-th frame pair."""
    pairs = make_path(40)
    found = detect([Cone((30.0, 2.5, 0.0))], pairs, RIG, score=score)
    thinned = {key: boxes if key[0] % kept_every == 0 else [] for key, boxes in found.items()}
    detections, _, positions = locate(thinned, pairs, RIG)
    by_frame: dict[int, list[Detection]] = defaultdict(list)
    for detection in detections:
        by_frame[detection.frame_index].append(detection)
    group: list[Position] = positions
    return existence_probability(group, 0.7, RIG, camera_poses(pairs, RIG, "left"), by_frame, PARAMS, shipped())


def test_on_a_road_boxes_are_found_where_the_cone_should_be() -> None:
    assert on_a_road(0.7, 1) > 0.95
    assert on_a_road(0.35, 3) < 0.1
