from __future__ import annotations

import cv2
import numpy as np
import pytest

from conetl.tracking.matching.plate_pixels import board_edges
from tests import records


def test_a_board_ends_at_its_edges_not_at_those_of_its_box() -> None:
    rng = np.random.default_rng(2)
    image = cv2.GaussianBlur(rng.uniform(90, 220, (220, 400, 3)), (0, 0), 2.0)
    image[60:110, 150:240] = rng.normal(20, 3, (50, 90, 3))
    image = cv2.GaussianBlur(image, (0, 0), 0.7).clip(0, 255).astype(np.uint8)
    box = records.box(153, 58, 90, 55, category="arrow_board")
    found = board_edges(image, box)
    ends = (found.x_px, found.x_px + found.w_px, found.y_px, found.y_px + found.h_px)
    assert ends == pytest.approx((150, 240, 60, 110), abs=0.3)
    even = np.full_like(image, 90)
    assert board_edges(even, box) == box, "without any change of colour the box remains"
