"""The existence probability of made-up images, with the shipped detector's own figures, and on a road of the synthetic world."""

from __future__ import annotations

from collections import defaultdict

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conetl.model.detector_evidence import UNMEASURED, DetectorEvidence
from conetl.model.drive import Detection, FramePair, Position
from conetl.model.params import DetectionParams, IngestParams
from conetl.model.rig import Side
from conetl.perception.model_card import read_model_card
from conetl.tracking.existence import ImageEvidence, existence_from_images, existence_probability
from tests.synthetic.world import Cone, camera_poses, detect, locate, make_path, make_rig

PARAMS = IngestParams()
RIG = make_rig()


def shipped() -> DetectorEvidence:
    evidence = read_model_card(None).evidence
    assert evidence is not None, "the shipped model's sidecar holds its evidence"
    return evidence


def images(*scores: float | None, height_px: float = 40.0, hidden: float = 0.0) -> list[ImageEvidence]:
    return [ImageEvidence(height_px=height_px, hidden=hidden, score=score) for score in scores]


def approach(*scores: float | None) -> list[ImageEvidence]:
    """Apparent heights from 22 to 80 px, as from an approaching car."""
    heights = np.geomspace(22.0, 80.0, len(scores)).tolist()
    return [
        ImageEvidence(height_px=height, hidden=0.0, score=score) for height, score in zip(heights, scores, strict=True)
    ]


def existence(
    left: list[ImageEvidence], right: list[ImageEvidence] | None = None, evidence: DetectorEvidence | None = None
) -> float:
    return existence_from_images([left, right or []], PARAMS, evidence or shipped())


def test_good_boxes_are_a_cone_and_weak_ones_with_misses_are_not() -> None:
    assert existence(approach(*[0.75] * 20), approach(*[0.75] * 20)) > 0.95
    assert existence(approach(*[0.34, None] * 10), approach(*[None, 0.32] * 10)) < 0.2
    assert existence(images(*[0.9] * 20), evidence=UNMEASURED) > 0.9
    assert existence(images(*[0.32] * 20), evidence=UNMEASURED) < 0.3


def test_without_images_the_odds_are_cones_to_false_boxes() -> None:
    evidence = shipped()
    rates = evidence.false_boxes_per_picture[evidence.score_thresholds.index(0.3)]
    expected = PARAMS.track.expected_cones_per_picture
    assert existence([]) == pytest.approx(expected / (expected + sum(rates[3:])), rel=1e-6), (
        "22 px are in the fourth band"
    )


def test_images_of_one_object_are_correlated() -> None:
    """Many images from one distance add little to the first; from several distances they add more."""
    prior, one, many = existence([]), existence(images(0.7)), existence(images(*[0.7] * 50))
    assert 0 < many - one < 0.5 * (one - prior)
    assert existence(approach(*[0.7] * 50)) > many + 0.005


def test_a_long_run_of_misses_counts_only_so_far() -> None:
    """A parked van hides the cone; observed behind it, it is a cone, however long it was hidden."""
    seen = approach(*[0.8] * 12)
    hidden = [images(*[None] * n, height_px=22.0) for n in (30, 60)]
    assert existence([*hidden[0], *seen]) > 0.8
    assert existence([*hidden[0], *seen]) == pytest.approx(existence([*hidden[1], *seen]), abs=0.01)


def test_misses_count_by_their_runs_and_by_what_hides_the_cone() -> None:
    assert existence(approach(*[0.6, None] * 8)) < existence(approach(*[None] * 8, *[0.6] * 8)), "one run or several"
    observed = images(*[0.6] * 4)
    assert existence([*observed, *images(*[None] * 5, hidden=0.9)]) == existence(observed), "hidden"
    assert existence([*observed, *images(None, None, hidden=0.5)]) > existence([*observed, *images(None, None)])


@given(
    st.lists(st.one_of(st.none(), st.floats(0.3, 0.95)), min_size=1, max_size=12),
    st.integers(0, 11),
    st.floats(0.3, 0.95),
)
def test_a_better_score_never_lowers_the_probability(scores: list[float | None], place: int, score: float) -> None:
    place %= len(scores)
    old = scores[place]
    if old is None or old >= score:
        return
    better = [*scores[:place], score, *scores[place + 1 :]]
    assert existence(images(*better)) >= existence(images(*scores)) - 1e-12


def located(
    found: dict[tuple[int, Side], list[Detection]], pairs: list[FramePair]
) -> tuple[dict[int, list[Detection]], list[Position]]:
    """Detections by frame, and positions."""
    detections, _, positions = locate(found, pairs, RIG)
    by_frame: dict[int, list[Detection]] = defaultdict(list)
    for detection in detections:
        by_frame[detection.frame_index].append(detection)
    return by_frame, positions


def on_a_road(score: float, kept_every: int, members: int | None = None) -> float:
    """Existence probability of a cone at the roadside with a box of `score` in every `kept_every`-th frame pair.

    members: number of its positions; the other boxes belong to another object.
    """
    pairs = make_path(40)
    found = detect([Cone((30.0, 2.5, 0.0))], pairs, RIG, score=score)
    thinned = {key: boxes if key[0] % kept_every == 0 else [] for key, boxes in found.items()}
    by_frame, positions = located(thinned, pairs)
    group: list[Position] = positions[-members:] if members else positions
    own = {position.frame_index for position in group}

    def is_of_other(box: Detection) -> bool:
        return box.frame_index not in own

    poses = camera_poses(pairs, RIG, "left")
    return existence_probability(group, 0.7, RIG, poses, by_frame, PARAMS, shipped(), is_of_other)


def test_on_a_road_boxes_are_found_where_the_cone_should_be() -> None:
    assert on_a_road(0.8, 1) > 0.95
    assert on_a_road(0.35, 3) < 0.2


def test_boxes_of_another_object_are_no_evidence() -> None:
    alone, in_all = on_a_road(0.7, 1, members=3), on_a_road(0.7, 1)
    assert alone < in_all - 0.005, "three pairs of boxes are less evidence than all"
    pairs = 3 * [ImageEvidence(height_px=60.0, hidden=0.0, score=0.7)]
    assert alone == pytest.approx(existence(pairs, pairs), abs=0.02), "as without the images of the other boxes"


def test_a_right_image_that_was_not_searched_is_no_evidence() -> None:
    """If the left image has no box, the right one is neither a miss nor a box, even if searched."""
    pairs = make_path(40)
    found = detect([Cone((30.0, 2.5, 0.0))], pairs, RIG, score=0.6)
    blind = {index for index, _ in found if index % 3}
    poses, values = camera_poses(pairs, RIG, "left"), []
    for shown in ("both", "left"):
        kept = {
            (index, side): boxes if index not in blind or (side == "right" and shown == "both") else []
            for (index, side), boxes in found.items()
        }
        by_frame, positions = located(kept, pairs)
        for search in ("along_epipolar_lines", "everywhere"):
            params = PARAMS.model_copy(update={"detection": DetectionParams(search_right=search)})
            values.append(
                existence_probability(positions, 0.7, RIG, poses, by_frame, params, shipped(), lambda _: False)
            )
    searched_in_part, all_searched, searched_in_part_missing, all_missing = values
    assert searched_in_part == searched_in_part_missing
    assert all_searched > all_missing
