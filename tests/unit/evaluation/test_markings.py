"""Lane markings against truth: constructed lines with known errors, simulated noise, and the truth files of sample drives."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from conetl.evaluation.marking_evaluation import evaluate_markings, pooled_markings
from conetl.evaluation.markings import (
    TRUTH_FILE,
    TruthMarking,
    compare_markings,
    marking_consistency,
    marking_figures,
    read_truth_markings,
    visible_to,
)
from conetl.geometry.packing import cov3, vec3
from conetl.model.errors import InputError
from conetl.model.feature_classes import LANE_MARKING
from conetl.model.markings import Marking, MarkingTrack
from conetl.readers.drives import read_drive
from tests.folders import SAMPLE
from tests.synthetic.world import calibrated


def line(y_m: float, start_m: float = 0.0, end_m: float = 40.0, step_m: float = 2.5) -> np.ndarray:
    x = np.linspace(start_m, end_m, round((end_m - start_m) / step_m) + 1)
    return np.column_stack([x, np.full(len(x), y_m), 0.01 * x])


def truth(name: str, vertices: np.ndarray, **values: object) -> TruthMarking:
    known = {"pattern": "solid", "colour": "white", "width_m": 0.12} | values
    return TruthMarking.model_validate({"marking_id": name, "vertices_m": vertices.tolist(), **known})


def found(vertices: np.ndarray, cov: np.ndarray | None = None, **values: object) -> Marking:
    one = cov3(np.diag([0.03, 0.03, 0.02]) ** 2 if cov is None else cov)
    known = {"pattern": "solid", "colour": "white", "width_m": 0.12, "width_sigma_m": 0.01} | values
    return Marking.model_validate({"vertices_m": [vec3(v) for v in vertices], "cov_m2": [one] * len(vertices), **known})


def everywhere(points_m: np.ndarray) -> np.ndarray:
    return np.ones(len(points_m), dtype=bool)


def test_known_errors_of_a_shifted_line() -> None:
    """3 cm to the left, 2 cm too high, too wide, and only on the last three quarters."""
    dashes = {"pattern": "dashed", "dash_m": 3.0, "gap_m": 9.0}
    known = truth("a", line(0.0), **dashes)
    shifted = line(0.03, 10.0) + np.array([0.0, 0.0, 0.02])
    seen = found(shifted, width_m=0.15, colour="yellow", pattern="dashed", dash_m=3.2, gap_m=8.9)
    figures = marking_figures([compare_markings([known], [seen], everywhere)])
    assert figures.truth_m == pytest.approx(40.0, abs=0.11) and figures.found_m == pytest.approx(30.0, abs=0.11)
    assert figures.completeness == pytest.approx(0.75, abs=0.005)
    assert (figures.correctness, figures.redundancy) == (1.0, pytest.approx(0.0, abs=0.01))
    assert (figures.lateral_median_m, figures.height_median_m) == (pytest.approx(0.03), pytest.approx(0.02))
    assert figures.width_median_m == pytest.approx(0.03)
    assert (figures.dash_median_m, figures.gap_median_m) == (pytest.approx(0.2), pytest.approx(0.1))
    assert (figures.pattern_share, figures.colour_share) == (1.0, 0.0)
    wrong = seen.model_copy(update={"dash_m": 4.0})
    assert marking_figures([compare_markings([known], [wrong], everywhere)]).pattern_share == 0.0


def test_gaps_beyond_the_last_visible_dash_are_not_demanded() -> None:
    """Dashes of 3 m from 4, 16, 28 m, seen up to 30 m: what counts is from 4 m, without the gap before, to 30 m."""
    known = truth("a", line(0.0), pattern="dashed", dash_m=3.0, gap_m=9.0, dash_start_m=4.0)
    seen = found(line(0.0, 4.0, 19.0), pattern="dashed", dash_m=3.0, gap_m=9.0)
    figures = marking_figures([compare_markings([known], [seen], lambda p: p[:, 0] <= 30.0)])
    assert figures.truth_m == pytest.approx(26.0, abs=0.11)
    assert figures.completeness == pytest.approx(15 / 26, abs=0.01)
    nothing = compare_markings([known], [seen], lambda p: (p[:, 0] > 8.0) & (p[:, 0] < 15.0))
    assert marking_figures([nothing]).truth_m == 0.0, "between dashes there is nothing to see"


def test_what_is_false_double_or_not_visible() -> None:
    known = [truth("a", line(0.0)), truth("b", line(-3.5))]
    seen = [found(line(0.02)), found(line(-0.02, 0.0, 20.0)), found(line(2.0, 0.0, 20.0))]
    figures = marking_figures([compare_markings(known, seen, lambda p: p[:, 1] > -1.0)])
    assert figures.completeness == 1.0, "the other marking was not visible"
    assert figures.correctness == pytest.approx(0.75, abs=0.005)
    assert figures.redundancy == pytest.approx(1 / 3, abs=0.005)
    nothing = marking_figures([compare_markings(known, [], everywhere)])
    assert (nothing.completeness, nothing.correctness, nothing.lateral_median_m) == (0.0, None, None)


def test_one_line_is_not_both_lines_of_a_double_marking() -> None:
    known = [truth("solid", line(0.0)), truth("beside it", line(0.14))]
    errors = compare_markings(known, [found(line(0.02))], everywhere)
    assert [marking_figures([errors.of_truth(k)]).completeness for k in (0, 1)] == [1.0, 0.0]


def test_stretches_of_a_curve_are_compared_where_they_are() -> None:
    turn = np.linspace(0.0, 1.2, 60)
    arc = np.column_stack([30 * np.sin(turn), 30 * (1 - np.cos(turn)), np.zeros(60)])
    inner = np.column_stack([29.95 * np.sin(turn), 30 - 29.95 * np.cos(turn), np.zeros(60)])
    stretches = [found(inner[k : k + 11]) for k in range(0, 55, 10)]
    figures = marking_figures([compare_markings([truth("arc", arc)], stretches, everywhere)])
    assert figures.completeness is not None and figures.completeness > 0.98 and figures.correctness == 1.0
    assert figures.lateral_median_m == pytest.approx(0.05, abs=0.002)


def test_nees_of_drawn_noise_is_in_its_band_and_that_of_too_small_sigmas_is_not() -> None:
    """Own noise of each vertex and one shift of the whole drive."""
    rng = np.random.default_rng(3)
    own, shared = np.diag([0.0004, 0.02, 0.01]) ** 2, np.diag([0.02, 0.02, 0.03]) ** 2
    known = [truth(str(k), line(3.5 * k, 0.0, 200.0)) for k in range(4)]
    shift = rng.multivariate_normal(np.zeros(3), shared)
    seen, count = [], 0
    for k in range(4):
        vertices = line(3.5 * k, 0.0, 200.0)
        noise = rng.multivariate_normal(np.zeros(3), own, len(vertices))
        seen.append(found(vertices + noise + shift, own + shared))
        count += len(vertices)
    every, common = np.kron(np.eye(count), own), (np.tile(np.eye(3), (count, 1, 1)), shared)
    results = marking_consistency(compare_markings(known, seen, everywhere), every, *common)
    for name, dof in (("lateral", count), ("height", count), ("together", 2 * count)):
        one = results[name]
        assert one is not None and one.absolute.dof == dof and one.relative.holds(0.999) and one.common.holds(0.999)
    small = marking_consistency(compare_markings(known, seen, everywhere), every / 4, *common)["together"]
    assert small is not None and small.relative.per_dof == pytest.approx(4.0, rel=0.2)
    assert marking_consistency(compare_markings(known, [], everywhere), every[:0, :0], *common)["lateral"] is None


def test_pose_errors_that_drift_along_a_drive_are_in_the_band_as_correlated_errors_alone() -> None:
    rng = np.random.default_rng(4)
    own, known = np.diag([0.004, 0.004, 0.004]) ** 2, [truth("a", line(0.0, 0.0, 200.0))]
    vertices = line(0.0, 0.0, 200.0)
    apart_m = np.linalg.norm(vertices[:, None] - vertices, axis=2)
    change = np.kron(0.01**2 * np.exp(-apart_m / 30.0), np.eye(3))
    drift, noise = (rng.multivariate_normal(np.zeros(change.shape[0]), change).reshape(-1, 3),
                    rng.multivariate_normal(np.zeros(3), own, len(vertices)))  # fmt: skip
    seen, none = [found(vertices + noise + drift, own)], (np.zeros((len(vertices), 3, 0)), np.zeros((0, 0)))
    for added, holds in ((change, True), (0.0, False)):
        every = np.kron(np.eye(len(vertices)), own) + added
        results = marking_consistency(compare_markings(known, seen, everywhere), every, *none)
        assert [one is not None and one.absolute.holds(0.999) for one in results.values()] == [holds] * 3


@pytest.mark.parametrize("sigmas", [{}, {"relative.ry_rad": 1e-4, "right.cx_px": 0.5}])
def test_a_drive_that_found_the_truth_is_complete_and_correct(sigmas: dict[str, float]) -> None:
    """The sample drive sees three markings, also with a rig after self-calibration; tracks made of the truth have no errors."""
    drive, _ = read_drive(SAMPLE)
    drive = drive.model_copy(update={"rig": calibrated(drive.rig, sigmas)}) if sigmas else drive
    known = read_truth_markings(SAMPLE / TRUTH_FILE, drive.map_srid)
    assert [(one.marking_id, one.pattern) for one in known] == [("E1", "solid"), ("E2", "solid"), ("C1", "dashed")]
    cov = cov3(np.eye(3) * 1e-4)
    tracks = [
        MarkingTrack(
            marking_index=k, category=LANE_MARKING, existence_probability=0.99, observation_count=9, first_seen_ns=1,
            last_seen_ns=2, contrast=60.0, blur_px=0.9, relative_cov_m2=(cov,) * len(one.vertices_m),
            image_cov_m2=tuple((np.eye(3 * n) * 1e-4).tobytes() for n in (1, len(one.vertices_m) - 1)),
            marking=found(np.array(one.vertices_m), pattern=one.pattern, dash_m=one.dash_m, gap_m=one.gap_m),
        )
        for k, one in enumerate(known)
    ]  # fmt: skip
    evaluation = evaluate_markings(known, tracks, drive, lambda frames: 1e-4 * np.eye(6 * len(frames)))
    figures = evaluation.figures
    assert (figures.completeness, figures.correctness, figures.pattern_share) == (1.0, 1.0, 1.0)
    assert 150.0 < figures.truth_m < 200.0, "three lines along 51 m and up to 15 m ahead"
    assert figures.lateral_median_m == pytest.approx(0.0, abs=1e-6)
    assert all(one is not None and np.isfinite(one.absolute.per_dof) for one in evaluation.nees.values())
    each = evaluation.tables()[1].rows
    assert [row[0] for row in each] == ["E1", "E2", "C1"]
    assert pooled_markings({"a": evaluation, "b": evaluation})[0].rows[-1][0] == "all drives"
    assert pooled_markings({}) == []


def test_visible_is_what_is_near_ahead_and_in_both_images() -> None:
    drive, _ = read_drive(SAMPLE)
    alone = drive.model_copy(update={"frame_pairs": drive.frame_pairs[:1]})
    left = np.array(drive.rig.body_SE3_left)
    body = np.array(drive.frame_pairs[0].pose.map_R_body), np.array(drive.frame_pairs[0].pose.map_t_body_m)
    camera = np.array(
        [[0.0, 1.6, 8.0], [0.0, 1.6, 3.0], [0.0, 1.6, 16.0], [0.0, 1.6, -8.0], [5.9, 1.6, 8.0], [0.0, 1.6, 5.0]]
    )
    points = (camera @ left[:3, :3].T + left[:3, 3]) @ body[0].T + body[1]
    # Of the last two one is in the left image only, one is below both.
    assert visible_to(alone)(points).tolist() == [True, False, False, False, True, False]
    assert visible_to(alone)(points[4:5] + 0.2 * (points[4] - points[0])).tolist() == [False]


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("{", "FeatureCollection"),
        ('{"features": [{"properties": {}, "geometry": {"coordinates": [[8, 49, 1]]}}]}', "feature 1"),
        ('{"features": [{"properties": {"pattern": "dotted"}, "geometry": {"coordinates": [[8, 49, 1], [8, 50, 1]]}}]}', "1"),
    ],
)  # fmt: skip
def test_a_broken_truth_file_is_named(tmp_path: Path, text: str, named: str) -> None:
    path = tmp_path / TRUTH_FILE
    path.write_text(text)
    with pytest.raises(InputError, match=named):
        read_truth_markings(path, 32632)
