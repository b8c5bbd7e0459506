from __future__ import annotations

import numpy as np
import pytest

from conetl.geometry.pose import to_matrix4
from conetl.model.drive import Detection, StereoMatch
from conetl.model.params import MatchParams
from conetl.model.rejections import RejectionReason
from conetl.model.rig import Camera, Rig
from conetl.tracking.matching.matches import foot_image_point, match_pair, with_measured_spread
from tests import records
from tests.synthetic.cone_images import BASE_M, F_PX, SIZE, cone_pair
from tests.synthetic.world import Cone, camera_pose, detect, make_path, make_rig

UP = np.array([0.0, -1.0, 0.0])


def one_cone() -> tuple[Rig, Detection, Detection]:
    """A rig and the boxes of one cone 10 m ahead."""
    rig, (pair,) = make_rig(), make_path(1)
    found = detect([Cone((10.0, 0.0, 0.0))], [pair], rig)
    return rig, found[0, "left"][0], found[0, "right"][0]


@pytest.mark.parametrize("step", [1, -1])
def test_every_cone_of_a_dense_row_is_matched_with_itself_in_any_order(step: int) -> None:
    rig, (pair,) = make_rig(), make_path(1)
    found = detect([Cone((9.0 + 1.5 * k, -3.0 + 0.4 * k, 0.0)) for k in range(10)], [pair], rig, noise_px=0.5)
    left, right = found[0, "left"], found[0, "right"][::step]
    assert len(left) == len(right) == 10
    matches, rejections = match_pair(left, right, rig, MatchParams(), up_left=UP)
    assert not rejections
    assert {(m.left.detection_index, m.right.detection_index) for m in matches} == {(k, k) for k in range(10)}


def test_different_rows_and_objects_behind_infinity_are_never_matched() -> None:
    rig, left, right = one_cone()
    for update in ({"y_px": right.y_px + 25}, {"x_px": left.x_px + 10}):
        assert match_pair([left], [right.model_copy(update=update)], rig, MatchParams(), up_left=UP)[0] == []


def test_a_box_cut_by_the_border_is_rejected_with_the_reason() -> None:
    rig, left, right = one_cone()
    cut = left.model_copy(update={"x_px": 0.5})
    matches, (rejection,) = match_pair([cut], [right], rig, MatchParams(), up_left=UP)
    assert matches == []
    assert rejection.reason == RejectionReason.BOX_CUT_BY_BORDER
    assert rejection.payload["frame_index"] == 0


@pytest.mark.parametrize("range_m", [6.5, 9.0, 15.0])
@pytest.mark.parametrize("aside_m", [-3.0, 0.0, 1.5])
def test_the_foot_is_the_centre_of_the_base_not_its_near_rim(range_m: float, aside_m: float) -> None:
    rig, (pair,) = make_rig(), make_path(1)
    cone = Cone((0.8 + range_m, aside_m, 0.0))
    (box,) = detect([cone], [pair], rig)[0, "left"]
    pose = camera_pose(pair, rig, "left")
    local = pose[:3, :3].T @ (np.array(cone.foot_m) + np.array([456_000.0, 5_428_000.0, 115.0]) - pose[:3, 3])
    true = [
        rig.left.cx_px + rig.left.fx_px * local[0] / local[2],
        rig.left.cy_px + rig.left.fy_px * local[1] / local[2],
    ]
    assert foot_image_point(box, rig.left, UP) == pytest.approx(true, abs=0.01)
    assert box.y_px + box.h_px - 0.5 - true[1] > 0.5, "without the correction the foot would be too near"


def test_foot_and_tip_of_the_network_are_used() -> None:
    rig, left, right = one_cone()
    (plain,), _ = match_pair([left], [right], rig, MatchParams(), up_left=UP)
    u, v = plain.foot_left_uv_px
    with_feet = [
        box.model_copy(update={"foot_px": (x + 0.5, y + 0.5 - 2.0), "tip_px": (x + 0.5, box.y_px + 1.0)})
        for box, (x, y) in ((left, plain.foot_left_uv_px), (right, plain.foot_right_uv_px))
    ]
    (match,), _ = match_pair([with_feet[0]], [with_feet[1]], rig, MatchParams(), up_left=UP)
    assert match.foot_left_uv_px == pytest.approx((u, v - 1.0)), "the mean of box and network"
    assert match.tip_left_uv_px[1] == pytest.approx(left.y_px + 0.5)
    assert match.centre_left_uv_px[1] == pytest.approx(left.y_px + left.h_px / 2 - 0.5), "of the box, as in the paper"


def test_a_match_has_one_category_whose_height_and_foot_count() -> None:
    rig, *boxes = one_cone()
    named = {name: [box.model_copy(update={"category": name}) for box in boxes] for name in ("traffic_sign", "plane")}
    assert match_pair([boxes[0]], named["traffic_sign"][1:], rig, MatchParams(), up_left=UP)[0] == []
    assert match_pair(*([box] for box in named["plane"]), rig, MatchParams(), up_left=UP)[0] == []
    (sign,), _ = match_pair(*([box] for box in named["traffic_sign"]), rig, MatchParams(), up_left=UP)
    assert sign.foot_left_uv_px[1] == pytest.approx(boxes[0].y_px + boxes[0].h_px - 0.5), "a plate has no base"
    tall = [box.model_copy(update={"y_px": box.y_px - 2 * box.h_px, "h_px": 3 * box.h_px}) for box in boxes]
    assert match_pair(*([box] for box in tall), rig, MatchParams(), up_left=UP)[0] == []
    as_board = [box.model_copy(update={"category": "arrow_board"}) for box in tall]
    assert len(match_pair(*([box] for box in as_board), rig, MatchParams(), up_left=UP)[0]) == 1


def test_images_determine_the_disparity_and_its_sigma() -> None:
    pair = cone_pair(9.0, 2)
    camera = Camera(width_px=SIZE[1], height_px=SIZE[0], fx_px=F_PX, fy_px=F_PX, cx_px=90.0, cy_px=30.0)
    right_pose = [[1.0, 0.0, 0.0, BASE_M], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
    rig = make_rig().model_copy(
        update={
            "left": camera, "right": camera,
            "body_SE3_left": to_matrix4(np.eye(4)), "body_SE3_right": to_matrix4(np.array(right_pose)),
        }
    )  # fmt: skip
    left = pair.detection
    off = pair.disparity_px - 1.3  # the boxes disagree by 1.3 px
    right = left.model_copy(update={"side": "right", "x_px": left.x_px - off, "foot_px": None})
    (match,), _ = match_pair([left], [right], rig, MatchParams(), up_left=UP, images=(pair.left, pair.right))
    assert match.refined
    disparity = match.foot_left_uv_px[0] - match.foot_right_uv_px[0]
    assert disparity == pytest.approx(pair.disparity_px, abs=0.1)
    assert match.sigma_u_px < 0.1
    (rough,), _ = match_pair(
        [left], [right], rig, MatchParams(refine=False), up_left=UP, images=(pair.left, pair.right)
    )
    assert not rough.refined
    assert rough.sigma_u_px > 0.5


def test_a_foot_behind_a_nearer_object_is_uncertain_along_the_rows() -> None:
    """By a share of the box's width, the more of its lower half is hidden; what stands behind hides nothing."""
    rig, left, right = one_cone()

    def matched(*others: Detection) -> StereoMatch:
        matches, _ = match_pair([left, *others], [right], rig, MatchParams(), up_left=UP)
        return next(m for m in matches if m.left == left)

    def beside(share: float, down_px: float) -> Detection:
        """A box over the right part of the cone's, its foot that much lower."""
        x_px = left.x_px + (1 - share) * left.w_px
        return left.model_copy(update={"x_px": x_px, "y_px": left.y_px + down_px, "detection_index": 7})

    alone = matched()
    assert matched(beside(0.5, -5.0)) == alone
    half, most = matched(beside(0.5, 5.0)), matched(beside(0.9, 5.0))
    # One of both images shows the other object, which hides half of the lower half there.
    expected = np.hypot(alone.sigma_pointing_px, 0.3 * 0.25 * (left.w_px + right.w_px) / 2)
    assert half.sigma_pointing_px == pytest.approx(expected, rel=0.05)
    assert most.sigma_pointing_px > half.sigma_pointing_px > alone.sigma_pointing_px
    assert half.sigma_v_px == alone.sigma_v_px and half.foot_left_uv_px == alone.foot_left_uv_px


def test_classes_have_their_own_foot() -> None:
    """A panel's box shows the near rim of its base plate, a barricade's its foot; of drums and panels the network's foot does not
    count."""
    rig, *boxes = one_cone()
    axis, bottom = boxes[0].x_px + boxes[0].w_px / 2 - 0.5, boxes[0].y_px + boxes[0].h_px - 0.5

    def foot(category: str, above_px: float | None = None) -> tuple[float, float]:
        tall = {"category": category, "y_px": boxes[0].y_px - 0.4 * boxes[0].h_px, "h_px": 1.4 * boxes[0].h_px}
        network = {"foot_px": None if above_px is None else (axis + 0.5, bottom + 0.5 - above_px)}
        pair = [box.model_copy(update=tall | network) for box in boxes]
        (match,), _ = match_pair(pair[:1], pair[1:], rig, MatchParams(), up_left=UP)
        return match.foot_left_uv_px

    rim = foot_image_point(boxes[0], rig.left, UP)
    assert rim[1] < bottom - 0.5
    assert foot("vertical_panel") == foot("vertical_panel", above_px=2.0) == pytest.approx(rim)
    assert foot("barricade") == pytest.approx((axis, bottom))
    assert foot("barricade", above_px=2.0) == pytest.approx((axis, bottom - 1.0))
    assert foot("drum", above_px=8.0) == pytest.approx(rim)


def test_the_edges_of_a_drum_give_its_axis_and_the_face_of_a_panel_its_own() -> None:
    """The box is 4 px too wide on one side, in both images; a panel's axis is half its board's thickness behind its face."""
    rng = np.random.default_rng(3)
    camera = Camera(width_px=400, height_px=200, fx_px=640.0, fy_px=640.0, cx_px=200.0, cy_px=50.0)
    right_pose = [[1.0, 0.0, 0.0, 0.54], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
    rig = make_rig().model_copy(
        update={
            "left": camera, "right": camera,
            "body_SE3_left": to_matrix4(np.eye(4)), "body_SE3_right": to_matrix4(np.array(right_pose)),
        }
    )  # fmt: skip
    images, boxes = [], []
    bands = rng.uniform(120, 250, 60).repeat(40).reshape(60, 40) + rng.normal(0, 12, (60, 40))
    for side, middle in (("left", 240), ("right", 200)):
        image = rng.normal(60, 2, (200, 400))
        image[100:160, middle - 20 : middle + 20] = bands
        images.append(np.repeat(np.clip(image, 0, 255).astype(np.uint8)[:, :, None], 3, axis=2))
        boxes.append(records.box(middle - 26, 99, 56, 62, side=side, category="drum"))
    match, _ = match_pair(boxes[:1], boxes[1:], rig, MatchParams(), up_left=UP, images=(images[0], images[1]))
    assert match[0].refined
    assert match[0].foot_left_uv_px[0] == pytest.approx(239.5, abs=0.3), "the box's middle is 241.5"
    panel = [box.model_copy(update={"category": "vertical_panel"}) for box in boxes]
    match, _ = match_pair(panel[:1], panel[1:], rig, MatchParams(), up_left=UP, images=(images[0], images[1]))
    depth_m = 640.0 * 0.54 / (match[0].foot_left_uv_px[0] - match[0].foot_right_uv_px[0])
    assert depth_m - 640.0 * 0.54 / 40.0 == pytest.approx(0.015, abs=0.005)


@pytest.mark.parametrize(("spread", "low", "high"), [(0.5, 0.55, 0.95), (1.0, 1.0, 1.6), (3.0, 2.0, 2.0)])
def test_the_scatter_of_feet_is_that_between_the_images(spread: float, low: float, high: float) -> None:
    """Without the constant of the calibration between the rows; few matches and boxes without feet change nothing."""
    rig, left, right = one_cone()
    (plain,), _ = match_pair([left], [right], rig, MatchParams(), up_left=UP)
    with_feet = [
        box.model_copy(update={"foot_px": (box.x_px + box.w_px / 2, box.y_px + box.h_px)})
        for box in (plain.left, plain.right)
    ]
    (match,), _ = match_pair([with_feet[0]], [with_feet[1]], rig, MatchParams(), up_left=UP)
    assert match.sigma_outline_px > 0 == plain.sigma_outline_px
    rng = np.random.default_rng(3)
    u, v = match.foot_right_uv_px
    noisy = [
        match.model_copy(update={"foot_right_uv_px": (u, v + 5.0 + spread * match.sigma_v_px * 2**0.5 * rng.normal())})
        for _ in range(300)
    ]
    changed = with_measured_spread([*noisy, plain])
    factor = changed[0].sigma_pointing_px / match.sigma_pointing_px
    assert low <= factor <= high
    assert np.median([m.sigma_v_px for m in changed[:-1]]) == pytest.approx(factor * match.sigma_v_px)
    assert changed[0].sigma_u_px == match.sigma_u_px
    assert changed[-1] == plain
    assert with_measured_spread([match]) == [match]
    # One box that ends 12 px lower in one image is not known better than that.
    lower = match.model_copy(update={"foot_right_uv_px": (u, v + 17.0)})
    *others, last = with_measured_spread([*noisy[:30], lower])
    assert last.sigma_v_px > 10 / 2**0.5 > np.median([m.sigma_v_px for m in others])
