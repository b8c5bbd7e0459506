"""The searched part of the right image contains all possible matches, and no camera is trusted alone."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conetl.model.drive import Detection
from conetl.model.params import DetectionParams, IngestParams, ReconcileParams
from conetl.model.rig import Rig, Side
from conetl.tracking.matching.epipolar_search import blocks_of, has_right_only_cone, is_within, right_region
from conetl.tracking.matching.matches import match_pair
from tests import records
from tests.synthetic.world import Cone, detect, make_path, make_rig

UP = np.array([0.0, -1.0, 0.0])
PARAMS = IngestParams()
EVERYWHERE = PARAMS.model_copy(update={"detection": DetectionParams(search_right="everywhere")})
RIG = make_rig()


def box(side: Side, x: float, y: float, w: float, h: float) -> Detection:
    return records.box(x, y, w, h, side=side)


@st.composite
def rigs(draw: st.DrawFn) -> Rig:
    """Rigs with other baselines and principal points, the right camera slightly turned."""
    turned = np.array(RIG.body_SE3_right)
    angle, down = draw(st.floats(-0.003, 0.003)), draw(st.floats(-0.004, 0.004))
    yaw = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    pitch = np.array([[1, 0, 0], [0, np.cos(down), -np.sin(down)], [0, np.sin(down), np.cos(down)]])
    turned[:3, :3] = turned[:3, :3] @ yaw @ pitch
    turned[:3, 3] = np.array(RIG.body_SE3_left)[:3, 3] + draw(st.floats(0.2, 3.0)) * (
        turned[:3, 3] - np.array(RIG.body_SE3_left)[:3, 3]
    )
    right = RIG.right.model_copy(update={"cx_px": RIG.right.cx_px + draw(st.floats(-30, 30))})
    return RIG.model_copy(update={"body_SE3_right": tuple(map(tuple, turned.tolist())), "right": right})


sizes = st.floats(8.0, 120.0)


@given(
    rigs(), st.floats(20, 1100), st.floats(20, 250), sizes, sizes,
    st.floats(-20, 400), st.floats(-25, 25), st.floats(0.55, 1.8), st.floats(0.4, 2.5),
)  # fmt: skip
def test_all_matches_are_in_the_region(
    rig: Rig, x: float, y: float, w: float, h: float, shift: float, down: float, taller: float, wider: float
) -> None:
    left = box("left", x, y, w, h)
    right = box("right", x - shift, y + down, w * wider, h * taller)
    matches, _ = match_pair([left], [right], rig, PARAMS.match, up_left=UP)
    if matches:
        region = right_region([left], rig, PARAMS)
        assert is_within(right.x_px + right.w_px / 2, right.y_px + right.h_px / 2, region)
        assert region is not None and region.reach_px >= max(right.w_px, right.h_px) / 2


def test_matches_occur_and_regions_are_small() -> None:
    """The property above is not vacuous."""
    (pair,) = make_path(1)
    found = detect([Cone((12.0, 1.0, 0.0))], [pair], RIG)
    matches, _ = match_pair(found[0, "left"], found[0, "right"], RIG, PARAMS.match, up_left=UP)
    region = right_region(found[0, "left"], RIG, PARAMS)
    assert len(matches) == 1 and region is not None
    share = (region.x1 - region.x0) * (region.y1 - region.y0) / (RIG.right.width_px * RIG.right.height_px)
    assert share < 0.05


def test_without_left_boxes_or_visible_partners_nothing_is_searched() -> None:
    right = [box("right", 300, 150, 20, 40)]
    assert right_region(right, RIG, PARAMS) is None
    assert right_region([], RIG, PARAMS) is None
    assert right_region([box("left", 0.0, 150, 10, 40)], RIG, PARAMS) is None, "its partner is left of the image"
    whole = right_region(right, RIG, EVERYWHERE)
    assert whole is not None
    assert whole[:4] == (0, 0, RIG.right.width_px, RIG.right.height_px)


@given(st.integers(1, 60), st.integers(1, 9))
def test_blocks_contain_every_pair_once_and_search_often_enough(count: int, least: int) -> None:
    params = PARAMS.model_copy(update={"reconcile": ReconcileParams(removal_min_frames=least)})
    blocks = blocks_of(count, params)
    assert [k for _, block in blocks for k in block] == list(range(count))
    assert all(middle in block for middle, block in blocks)
    middles = [middle for middle, _ in blocks]
    for first in range(count - least + 1):
        assert any(first <= middle < first + least for middle in middles)
    # A cone that only the right camera shows in successive pairs, enough to remove it, is found in at least half of them.
    for first in range(count - least + 1):
        for last in range(first + least, count + 1):
            shown = range(first, last)
            found = {k for middle, block in blocks if middle in shown for k in block}
            assert 2 * len(found.intersection(shown)) >= len(shown)


@pytest.mark.parametrize(
    ("boxes", "right_only"),
    [
        ([], False),
        ([box("right", 300, 150, 20, 40)], True),
        ([box("right", 300, 150, 8, 15)], False),  # too small to count
        ([box("right", 1200, 150, 20, 40)], False),  # outside the left image
        ([box("left", 330, 150, 20, 40), box("right", 300, 150, 20, 40)], False),
        ([box("left", 330, 150, 20, 40), box("right", 700, 150, 20, 40)], True),
        ([box("left", 330, 150, 20, 40)], False),
        # between both partners
        ([box("left", 230, 150, 20, 40), box("left", 930, 150, 20, 40), box("right", 600, 150, 20, 40)], True),
    ],
)
def test_cones_that_only_the_right_image_shows(boxes: list[Detection], right_only: bool) -> None:
    assert has_right_only_cone(boxes, RIG, PARAMS) is right_only
    assert has_right_only_cone(boxes, RIG, EVERYWHERE) is False, "all was searched"
