"""An object that the network found in one image only is located by what both images show."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from conetl.geometry.pose import to_matrix4
from conetl.model.drive import Detection, StereoMatch
from conetl.model.params import MatchParams
from conetl.model.rig import Rig
from conetl.tracking.matching.matches import match_pair, with_measured_spread
from tests import records
from tests.cases import cases
from tests.synthetic.cone_images import BASE_M, ConePair, cone_pair

UP, PARAMS = np.array([0.0, -1.0, 0.0]), MatchParams()
RANGES_M = (6.5, 8.0, 10.0, 13.0, 16.0)


def rig_of(pair: ConePair) -> Rig:
    at_right = np.eye(4)
    at_right[0, 3] = BASE_M
    return Rig(
        rig_id="one", left=pair.camera, right=pair.camera, body_SE3_left=to_matrix4(np.eye(4)),
        body_SE3_right=to_matrix4(at_right),
    )  # fmt: skip


def in_right(pair: ConePair) -> Detection:
    """The left box, as if the network had found it in the right image."""
    box, off_px = pair.detection, pair.disparity_px
    assert box.foot_px is not None and box.tip_px is not None
    moved = {name: (point[0] - off_px, point[1]) for name, point in (("foot_px", box.foot_px), ("tip_px", box.tip_px))}
    return box.model_copy(update={"side": "right", "x_px": box.x_px - off_px, **moved})


def matched(
    pair: ConePair, side: str, right: NDArray[np.uint8] | None = None, params: MatchParams = PARAMS
) -> list[StereoMatch]:
    images = pair.left, pair.right if right is None else right
    boxes = ([pair.detection], []) if side == "left" else ([], [in_right(pair)])
    return match_pair(*boxes, rig_of(pair), params, up_left=UP, images=images)[0]


@pytest.mark.parametrize("side", cases("right", release=["left"]))
def test_one_box_gives_the_disparity_with_its_sigma(side: str) -> None:
    ratios = []
    for seed in range(20):
        pair = cone_pair(RANGES_M[seed % len(RANGES_M)], seed)
        for match in matched(pair, side):
            assert (match.left is None, match.right is None) == (side == "right", side == "left")
            found_px = match.foot_left_uv_px[0] - match.foot_right_uv_px[0]
            ratios.append((found_px - pair.disparity_px) / (2**0.5 * match.sigma_u_px))
    assert len(ratios) >= 18
    assert np.abs(ratios).max() < 3.0
    assert np.sqrt(np.mean(np.square(ratios))) > 0.3, "sigmas that are far too large"


@pytest.mark.parametrize("side", ["left", "right"])
def test_one_box_counts_as_one(side: str) -> None:
    """The rows and the bearing of a second box, with its own errors, would make them better by the square root of 2."""
    pair = cone_pair(9.0, 5)
    (alone,) = matched(pair, side)
    (both,), _ = match_pair(
        [pair.detection], [in_right(pair)], rig_of(pair), PARAMS, up_left=UP, images=(pair.left, pair.right)
    )
    assert alone.sigma_v_px == pytest.approx(2**0.5 * both.sigma_v_px)
    assert alone.sigma_pointing_px == pytest.approx(2**0.5 * both.sigma_pointing_px)
    assert with_measured_spread([alone] * 9) == [alone] * 9, "its rows are the same in both images, and show no scatter"


def test_what_the_other_image_does_not_show_clearly_is_not_located() -> None:
    pair = cone_pair(9.0, 6)
    noise = np.random.default_rng(0).integers(0, 255, pair.right.shape).astype(np.uint8)
    twice, width_px = pair.right.copy(), round(pair.detection.w_px)
    first = round(in_right(pair).x_px)
    twice[:, first - width_px - 2 : first - 2] = pair.right[:, first : first + width_px]
    assert [matched(pair, "left", right) for right in (noise, twice)] == [[], []]
    assert matched(cone_pair(10.0, 2, post=True), "left") == []


def test_boxes_in_both_images_that_contradict_each_other_are_not_matched_one_by_one() -> None:
    pair = cone_pair(9.0, 5)
    for changes in ({"category": "traffic_sign"}, {"y_px": in_right(pair).y_px + 12.0}):
        boxes = [pair.detection], [in_right(pair).model_copy(update=changes)]
        assert match_pair(*boxes, rig_of(pair), PARAMS, up_left=UP, images=(pair.left, pair.right))[0] == []


def test_a_weak_box_is_not_looked_for() -> None:
    pair = cone_pair(9.0, 7)
    assert matched(pair, "left")
    assert not matched(pair, "left", params=MatchParams(one_sided_min_score=0.95))
    assert not matched(pair, "left", params=MatchParams(refine=False))


def test_a_match_without_any_box_is_invalid() -> None:
    with pytest.raises(ValueError, match="at least one image"):
        StereoMatch.model_validate(records.matches(1)[0].model_dump() | {"left": None, "right": None})
