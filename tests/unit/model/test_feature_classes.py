"""Heights that standards and makers give the classes of objects are plausible, with what a measurement adds."""

from __future__ import annotations

import pytest

from conetl.model.feature_classes import FEATURE_CLASSES

MEASURED_M = 0.05
BUILT_M = {
    "traffic_cone": (0.30, 1.07),
    "tubular_marker": (0.45, 1.22),
    "drum": (0.91, 1.42),
    "vertical_panel": (0.65, 1.75),
    "barricade": (0.91, 1.90),
    "work_zone_sign": (0.30, 1.72),
    "arrow_board": (0.61, 3.60),
    "traffic_sign": (0.30, 1.72),
}


@pytest.mark.parametrize(("category", "built_m"), BUILT_M.items())
def test_what_is_built_is_plausible(category: str, built_m: tuple[float, float]) -> None:
    lowest_m, highest_m = FEATURE_CLASSES[category].heights_m
    assert lowest_m <= built_m[0] - MEASURED_M + 1e-9 and built_m[1] + MEASURED_M <= highest_m + 1e-9
    least_m, most_m = FEATURE_CLASSES[category].match_heights_m
    assert least_m < lowest_m and highest_m < most_m, "boxes are looser than what they hold"
