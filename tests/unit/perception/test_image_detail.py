"""Fine structure of images."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from conetl.model.drive import MIN_DETAIL
from conetl.perception.image_detail import fine_detail, local_detail
from tests.integration.small_drives import SAMPLES
from tests.mutants.images import Image, compressed, covered


@pytest.fixture(scope="module")
def image() -> Image:
    return np.asarray(cv2.imread(str(SAMPLES[0] / "image_02" / "data" / "0000000010.jpg")), np.uint8)


@pytest.mark.parametrize(("quality", "shows"), [(95, True), (10, True), (2, False)])
def test_blocks_of_strong_compression_are_no_detail(image: Image, quality: int, shows: bool) -> None:
    assert (fine_detail(compressed(quality)(image)) >= MIN_DETAIL) is shows


def test_the_detail_of_squares_shows_what_is_covered(image: Image) -> None:
    detail = local_detail(np.ascontiguousarray(covered(right=0.5)(image)[..., 1]))
    assert detail.shape == (image.shape[0] // 32, image.shape[1] // 32)
    assert detail[:, :14].max() == 0 and np.median(detail[:, 16:]) > MIN_DETAIL
    assert fine_detail(np.zeros((20, 20, 3), np.uint8)) == 0 and not local_detail(np.zeros((20, 20), np.uint8)).size
