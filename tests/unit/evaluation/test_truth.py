from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from conetl.evaluation.truth import TruthCone, compare_with_truth, read_truth_cones, split_by_extent
from conetl.model.errors import InputError
from conetl.model.map_records import MapFeature
from tests import records

PATH = np.array([[0.0, 0.0, 1.6], [10.0, 0.0, 1.6], [20.0, 0.0, 1.6]])


def cone(name: str, x: float, y: float) -> TruthCone:
    return records.truth_cone(name, (x, y, 0.0))


def feature(number: int, x: float, y: float) -> MapFeature:
    return records.feature(number, **records.standing_at((x, y, 0.02)))


def test_pairs_misses_and_false_features_are_told_apart() -> None:
    truth = [cone("a", 5.0, 3.0), cone("b", 15.0, 3.0)]
    lines, false = compare_with_truth(truth, [feature(1, 5.03, 3.04), feature(2, 8.0, -4.0)], PATH)
    assert [(line.truth.cone_id, line.feature is not None) for line in lines] == [("a", True), ("b", False)]
    assert lines[0].error_3d_m == pytest.approx(np.sqrt(0.03**2 + 0.04**2 + 0.02**2))
    assert lines[0].truth_range_m == pytest.approx(np.hypot(5.0, 3.0))
    assert [f.feature_id.int for f in false] == [2]


def test_a_survey_needs_no_more_than_places_and_heights(tmp_path: Path) -> None:
    path = tmp_path / "truth.csv"
    header = "cone_id,easting_m,northing_m,height_ellipsoidal_m,cone_height_m,map_srid"
    path.write_text(f"{header}\na,458318.6,5427845.4,115.3,0.7,25832\n")
    cones, srid = read_truth_cones(path)
    assert (cones[0].cone_id, cones[0].xyz_m, srid) == ("a", (458318.6, 5427845.4, 115.3), 25832)
    path.write_text("Punkt;Rechts;Hoch\n1;2;3\n")
    with pytest.raises(
        InputError, match=f"expected the columns {header.replace(',', ', ')}, .*found Punkt;Rechts;Hoch"
    ):
        read_truth_cones(path)


def test_one_feature_stands_for_one_cone_only() -> None:
    truth = [cone("a", 5.0, 3.0), cone("b", 5.6, 3.0)]
    lines, false = compare_with_truth(truth, [feature(1, 5.25, 3.0)], PATH)
    assert sum(line.feature is not None for line in lines) == 1
    assert not false


def test_far_cones_are_not_asked_for_but_their_features_are_not_false() -> None:
    lines, false = compare_with_truth([cone("far", 5.0, 30.0)], [feature(1, 5.0, 30.0)], PATH)
    assert lines == []
    assert false == []


def test_objects_are_compared_with_the_truth_of_their_class() -> None:
    drum = cone("drum", 5.0, 3.0).model_copy(update={"category": "drum"})
    found = [feature(1, 5.0, 3.0), feature(2, 15.0, 3.0), feature(3, 12.0, 3.0)]
    sign = found[2].model_copy(update={"category": "traffic_sign"})
    lines, false = compare_with_truth([drum, cone("cone", 15.0, 3.0)], [*found[:2], sign], PATH)
    assert [(line.truth.cone_id, line.feature is not None) for line in lines] == [("cone", True), ("drum", False)]
    assert [f.feature_id.int for f in false] == [1], "a cone where a drum stands is false, a sign is not judged"


def test_what_stands_outside_of_a_partial_survey_is_not_judged() -> None:
    truth = [cone("a", 5.0, 3.0), cone("b", 15.0, 3.0)]
    beside, beyond = feature(1, 10.0, 1.5), feature(2, 25.0, 3.0)
    assert split_by_extent(truth, [beside, beyond]) == ([beside], [beyond])
    assert split_by_extent(truth[:1], [beside, beyond]) == ([], [beside, beyond])
    assert split_by_extent(truth, []) == ([], [])
