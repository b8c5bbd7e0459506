"""What images for people show of a street."""

from __future__ import annotations

import numpy as np

from conetl.reports.camera_images import SURROUNDINGS, pixelated
from conetl.reports.drive_passes import expected_box
from tests.synthetic.world import ORIGIN_M, Cone, apparent_box, make_path, make_rig


def test_only_objects_and_their_surroundings_can_be_recognised() -> None:
    image = np.random.default_rng(7).integers(0, 256, (375, 1242, 3), np.uint8)
    before = image.copy()
    box = (600.0, 200.0, 30.0, 40.0)
    shown = pixelated(image, [box])
    assert np.array_equal(image, before)
    reach = int(40 * SURROUNDINGS / 2)
    near = (slice(220 - reach, 220 + reach), slice(615 - reach, 615 + reach))
    assert np.array_equal(shown[near], image[near])
    far = np.ones(image.shape[:2], bool)
    far[near] = False
    assert len(np.unique(shown[far].reshape(-1, 3), axis=0)) < 1400  # colours of squares, not of pixels
    assert shown[far].std() < 0.2 * image[far].std()  # noise is averaged away
    assert len(np.unique(pixelated(image, []).reshape(-1, 3), axis=0)) < 1400


def test_the_box_of_a_position_is_where_the_cone_appears() -> None:
    cone, rig = Cone((14.0, 3.6, 0.0), height_m=0.7), make_rig()
    foot_m = tuple((np.array(cone.foot_m) + ORIGIN_M).tolist())
    for pair in make_path(2):
        for side in ("left", "right"):
            x, y, w, _ = expected_box(foot_m, cone.height_m, pair.pose, rig, side)
            true_x, true_y, true_w, _ = apparent_box(cone, pair, rig, side)
            assert abs(y - true_y) < 1e-6
            assert abs(x + w / 2 - true_x - true_w / 2) < 0.1
