"""Several drives evaluated together: one row each and one for all, marks, and pooled statistics."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np

from conetl.evaluation.accuracy import PointErrors, position_errors
from conetl.evaluation.drive_evaluation import DriveEvaluation, figures_of, pooled_tables
from conetl.evaluation.truth import TruthLine
from conetl.model.feature_classes import CONE
from tests import records
from tests.synthetic.noisy_drive import draw_positions
from tests.synthetic.world import Cone, make_rig

CONES = [Cone((14.0 + 4.0 * k, 3.6 - 0.5 * k, 0.0)) for k in range(4)]


def drawn(seed: int) -> PointErrors:
    drive = draw_positions(np.random.default_rng(seed), make_rig(), CONES, frames=8)
    cone_of = {(p.frame_index, p.match_index): drive.truth[p.match_index] for p in drive.positions}
    return position_errors(cone_of, drive.positions, drive.drive)


def evaluation(name: str, errors: PointErrors, missed: int = 0) -> DriveEvaluation:
    """Two cones and two drums, each found 1 cm too far east, a false drum, and missed cones."""
    lines = []
    for k, cone_id in enumerate(sorted(set(errors.cone_ids))):
        truth = records.truth_cone(cone_id, (0.0, 0.0, 0.0), 0.5, "drum" if k > 1 else CONE)
        lines.append(TruthLine(truth, SimpleNamespace(xyz_m=(0.01, 0.0, 0.0)), 1.0, 1.0))  # type: ignore[type-var]
    cone = records.truth_cone("missed", (9.0, 0.0, 0.0), 0.5)
    lines += [TruthLine(cone, None, 1.0, None)] * missed
    false = [SimpleNamespace(category="drum")]
    return DriveEvaluation(name, lines, false, [], np.empty((0, 3)), errors, errors)  # type: ignore[arg-type]


def test_one_row_per_drive_and_one_for_all() -> None:
    good, other = drawn(1), drawn(2)
    wrong = dataclasses.replace(other, own_cov_m2=other.own_cov_m2 / 9, common_cov=other.common_cov / 9)
    pooled = [evaluation("good", good), evaluation("wrong", wrong, missed=1)]
    assert figures_of(pooled)["tracks"].count == len(good.difference_m) + len(other.difference_m)
    drives, nees, by_class = pooled_tables(pooled)
    of_good, of_wrong, of_all = ([str(value) for value in row] for row in drives.rows)
    assert of_good[:2] == ["good", "4 of 4"] and not any("*" in value for value in of_good)
    assert of_wrong[:2] == ["wrong", "4 of 5"] and any("*" in value for value in of_wrong)
    assert of_all[:2] == ["all drives", "8 of 9"]
    assert any(row[0] == "single positions, relative" and row[-1] == "too small" for row in nees.rows)
    cones, drums = by_class.rows
    assert cones[:4] == ("cone", "4 of 5", 0, "0.010") and drums[:4] == ("drum", "4 of 4", 2, "0.010")
