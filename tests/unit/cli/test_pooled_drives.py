"""Several drives on one table: what it counts, what it marks, and what it says of them together."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from conetl.cli.tools.pooled_drives import DriveErrors, as_dict, pool, print_pooled
from conetl.evaluation.accuracy import PointErrors, position_errors
from tests.synthetic.noisy_drive import PoseErrors, draw_positions
from tests.synthetic.world import Cone, make_rig

CONES = [Cone((14.0 + 4.0 * k, 3.6 - 0.5 * k, 0.0)) for k in range(4)]


def drawn(seed: int) -> PointErrors:
    drive = draw_positions(np.random.default_rng(seed), make_rig(), CONES, PoseErrors(), frames=8)
    cone_of = {(p.frame_index, p.match_index): drive.truth[p.match_index] for p in drive.positions}
    return position_errors(cone_of, drive.positions, drive.drive)


def test_one_line_a_drive_and_one_for_all(capsys: pytest.CaptureFixture[str]) -> None:
    good, other = drawn(1), drawn(2)
    wrong = dataclasses.replace(other, own_cov_m2=other.own_cov_m2 / 9, common_cov=other.common_cov / 9)
    pooled = pool({"good": DriveErrors(4, 4, 0, good, good), "wrong": DriveErrors(5, 4, 1, wrong, wrong)})
    assert pooled.figures["tracks"].count == len(good.difference_m) + len(other.difference_m)
    print_pooled(pooled)
    lines = capsys.readouterr().out.splitlines()
    (of_good,), (of_wrong,), (of_all,) = (
        [line for line in lines if line.startswith(name)] for name in ("good", "wrong", "all together")
    )
    assert "4 of 4" in of_good
    assert "*" not in of_good
    assert "*" in of_wrong
    assert "8 of 9" in of_all
    assert any("single positions, relative" in line and "too small" in line for line in lines)


def test_figures_of_two_drives_are_those_of_all_their_errors() -> None:
    some = [drawn(seed) for seed in (3, 4)]
    pooled = pool({str(k): DriveErrors(4, 4, 0, errors, errors) for k, errors in enumerate(some)})
    everything = np.concatenate([errors.difference_m for errors in some])
    figures = pooled.figures["single positions"]
    assert figures.rmse_3d_m == pytest.approx(float(np.sqrt((everything**2).sum(axis=1).mean())))
    assert figures.bias_enu_m == pytest.approx(tuple(everything.mean(axis=0)))
    assert set(as_dict(pooled)) == {"pooled"}
