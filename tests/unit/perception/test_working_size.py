"""Images of two sizes brought to one, and image points that keep their place through it."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from conetl.geometry.motion.stereo_tracks import NoMeasurement
from conetl.geometry.rig import infinity_shift_px
from conetl.model.rig import Camera, Rig, Side
from conetl.perception.working_size import WorkingImages, read_working_images, working_size
from tests.synthetic.world import make_path, make_rig

PAIR = make_path(1)[0]


def rig_of(left: tuple[int, int], right: tuple[int, int]) -> Rig:
    """The synthetic rig with images of other sizes (width, height)."""
    rig = make_rig()

    def camera(own: Camera, size: tuple[int, int]) -> Camera:
        return own.model_copy(update={"width_px": size[0], "height_px": size[1]})

    return rig.model_copy(update={"left": camera(rig.left, left), "right": camera(rig.right, right)})


def noise(width: int, height: int) -> NDArray[np.uint8]:
    return np.random.default_rng(5).integers(0, 255, (height, width)).astype(np.uint8)


def images_of(rig: Rig, max_width_px: int) -> WorkingImages:
    def read(_: object, side: Side) -> NDArray[np.uint8]:
        camera = rig.left if side == "left" else rig.right
        return noise(camera.width_px, camera.height_px)

    found = read_working_images(PAIR, read, working_size(rig, max_width_px))
    assert isinstance(found, WorkingImages)
    return found


@pytest.mark.parametrize("max_width_px", [1000, 320, 101])
def test_both_sides_become_one_size_with_one_scale(max_width_px: int) -> None:
    rig = rig_of((353, 105), (392, 107))
    working, images = working_size(rig, max_width_px), images_of(rig, max_width_px)
    assert images.left.shape == images.right.shape == working.size_px[::-1]
    assert working.size_px[0] == min(max_width_px, 392)
    assert images.quarter_left.shape == images.quarter_right.shape
    assert working.seen_px("left") == pytest.approx([353, 105] * working.scale)
    assert (working.seen_px("right") == np.inf).all(), "the larger side has no padding"
    assert images.half_left.shape == tuple((working.seen_px("left") / 2).astype(int)[::-1])


def test_equal_images_that_are_not_too_wide_stay_as_they_are() -> None:
    rig = rig_of((352, 104), (352, 104))
    working, images = working_size(rig, 352), images_of(rig, 352)
    assert np.array_equal(images.left, noise(352, 104))
    points = np.random.default_rng(0).uniform(0, 352, (50, 2))
    assert np.array_equal(working.to_working(points), points)
    assert np.array_equal(working.to_stored(points), points)


@pytest.mark.parametrize("max_width_px", [1000, 100, 77])
def test_a_point_of_the_reduced_image_is_where_the_stored_one_has_it(max_width_px: int) -> None:
    """Blobs at known places: their centroids in the reduced image, taken back, are where they were drawn."""
    rig = rig_of((400, 203), (380, 203))
    v, u = np.mgrid[:203, :400]
    for place in ((100.0, 70.0), (251.5, 133.25)):
        blob = (250 * np.exp(-((u - place[0]) ** 2 + (v - place[1]) ** 2) / 2 / 15**2)).astype(np.uint8)
        working = working_size(rig, max_width_px)
        found = read_working_images(PAIR, lambda _, side: blob[:, : 400 if side == "left" else 380], working)  # noqa: B023
        assert isinstance(found, WorkingImages)
        moments = cv2.moments(found.left.astype(np.float32))
        centroid = np.array([moments["m10"], moments["m01"]]) / moments["m00"]
        assert working.to_stored(centroid) == pytest.approx(place, abs=0.02)
        assert working.to_working(working.to_stored(centroid)) == pytest.approx(centroid, abs=1e-9)


def test_the_shift_at_infinity_is_that_of_the_rig_in_working_pixels() -> None:
    rig = rig_of((392, 105), (353, 105))
    right = rig.right.model_copy(update={"cx_px": rig.left.cx_px + 52.5, "cy_px": rig.left.cy_px - 3.0})
    rig = rig.model_copy(update={"right": right})
    assert working_size(rig, 1280).infinity_shift([100.0, 50.0]) == pytest.approx([-52.5, 3.0])
    assert working_size(rig, 196).infinity_shift([50.0, 25.0]) == pytest.approx([-26.25, 1.5], rel=0.01)
    assert infinity_shift_px(rig, np.array([100.0, 50.0])) == pytest.approx([-52.5, 3.0])


def test_a_shift_that_is_only_rounding_is_none() -> None:
    """Else it decided about disparities of block matching that equal the least one."""
    rig = make_rig()
    assert (working_size(rig, 1280).infinity_shift(np.random.default_rng(0).uniform(0, 300, (90, 2))) == 0.0).all()


@pytest.mark.parametrize(
    ("image", "reason"),
    [
        (noise(350, 104), NoMeasurement.IMAGE_UNREADABLE),  # of another size than the rig's
        (np.zeros((104, 352, 2), np.uint8), NoMeasurement.IMAGE_UNFIT),  # neither grey nor a colour
    ],
)
def test_images_that_cannot_be_used_say_so(image: NDArray[np.uint8], reason: NoMeasurement) -> None:
    assert read_working_images(PAIR, lambda *_: image, working_size(rig_of((352, 104), (352, 104)), 1280)) is reason
