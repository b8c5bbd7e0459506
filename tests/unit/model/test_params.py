from __future__ import annotations

from conetl.model.params import DetectionParams


def test_more_of_the_images_is_searched_for_signs() -> None:
    cones, signs = (DetectionParams(categories=names) for names in (("traffic_cone", "drum"), ("drum", "traffic_sign")))
    assert cones.searched_margin_rad == cones.horizon_margin_rad < signs.searched_margin_rad
    assert DetectionParams(categories=("traffic_sign",), horizon_margin_rad=0.5).searched_margin_rad == 0.5
