"""A right camera before or behind its place, from the rows of points at the spans of a drive."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from conetl.checks.verdict import judge
from conetl.geometry.motion.stereo_motion import StereoCameras
from conetl.model.drive import FramePair, Track
from conetl.model.health import Verdict
from conetl.tracking.checks.exposures import check_doubled, check_exposures, right_camera_ahead
from tests import records
from tests.synthetic.world import make_path, make_rig

BASELINE_M, SPANS, POINTS = 0.4, 20, 150
INTRINSICS = np.array([700.0, 700.0, 480.0, 200.0])
EVEN = [13.0] * SPANS


def cameras() -> StereoCameras:
    right_SE3_left = np.eye(4)
    right_SE3_left[0, 3] = -BASELINE_M
    return StereoCameras(INTRINSICS, INTRINSICS, right_SE3_left)


def seen_spans(
    ahead_m: float, seed: int, *, turn_rad: float = 0.0, zoom: float = 1.0, rows_px: float = 0.0
) -> list[NDArray[np.float64]]:
    """Road and roadside, seen with 0.2 px noise; a twentieth of the points has wrong rows."""
    random = np.random.default_rng(seed)
    spans = []
    for _ in range(SPANS):
        depth = random.uniform(4.0, 40.0, POINTS)
        points = np.column_stack([random.uniform(-0.6, 0.6, POINTS) * depth, random.uniform(-3.0, 1.6, POINTS), depth])
        turn = Rotation.from_rotvec(turn_rad * np.array([1.0, -1.0, 2.0])).as_matrix()
        right = (points - (BASELINE_M, 0.0, ahead_m)) @ turn.T
        left_px = INTRINSICS[2:] + INTRINSICS[:2] * points[:, :2] / points[:, 2:]
        right_px = INTRINSICS[2:] + zoom * INTRINSICS[:2] * right[:, :2] / right[:, 2:]
        px = np.hstack([left_px, right_px]) + random.normal(0.0, 0.2, (POINTS, 4))
        px[:, 3] += rows_px
        px[::20, 3] += random.normal(0.0, 3.0, len(px[::20]))
        spans.append(px)
    return spans


@pytest.mark.parametrize("ahead_m", [-0.05, 0.0, 0.01, 0.05])
def test_the_right_camera_is_found_before_its_place(ahead_m: float) -> None:
    found = np.array([right_camera_ahead(cameras(), seen_spans(ahead_m, seed), EVEN) for seed in range(20)])
    assert np.abs(found[:, 0] * BASELINE_M - ahead_m).max() < 0.004
    assert found[:, 1].max() < 0.01


def test_the_sigma_holds_for_the_scatter_of_drives() -> None:
    found = np.array([right_camera_ahead(cameras(), seen_spans(0.0, seed), EVEN) for seed in range(400)])
    alone = np.sqrt(found[:, 1] ** 2 - 0.002**2)  # without what no number of points improves
    # Parts of the image scatter by noise alone here, so that their scatter counts twice.
    assert 0.4 < np.mean((found[:, 0] / alone) ** 2) < 1.0


@pytest.mark.parametrize(
    ("turn_rad", "zoom", "rows_px"),
    [(0.001, 1.0, 0.0), (-0.001, 1.0, 0.0), (0.0, 1.005, 0.0), (0.0, 0.995, 0.0), (0.0, 1.0, 5.0), (0.0, 1.0, -5.0)],
)
def test_other_errors_of_the_right_camera_are_told_from_it(turn_rad: float, zoom: float, rows_px: float) -> None:
    spans = seen_spans(0.0, 3, turn_rad=turn_rad, zoom=zoom, rows_px=rows_px)
    share, sigma = right_camera_ahead(cameras(), spans, EVEN)
    assert abs(share) < 4 * sigma and abs(share) < 0.02


@pytest.mark.parametrize(("per_m_s", "fixed_m", "grows"), [(0.004, 0.0, True), (0.0, 0.05, False)])
def test_a_late_trigger_differs_from_a_moved_camera_where_the_speed_changes(
    per_m_s: float, fixed_m: float, grows: bool
) -> None:
    speeds = np.linspace(5.0, 20.0, SPANS)
    spans = [seen_spans(fixed_m + per_m_s * speed, seed)[0] for seed, speed in enumerate(speeds.tolist())]
    share, _, growing, sigma = right_camera_ahead(cameras(), spans, speeds.tolist())
    assert share * BASELINE_M == pytest.approx(0.05, abs=0.005)
    assert abs(growing - (share if grows else 0.0)) < 3 * sigma < abs(share)


@pytest.mark.parametrize(("share", "verdict"), [(0.015, "widened"), (0.025, "widened"), (0.2, "hold")])
def test_an_offset_is_held_if_it_moves_cones_by_more_than_sigmas_cover(share: float, verdict: str) -> None:
    """Of a baseline of 0.4 m, cones 4 m beside the path are off by nine times the offset."""
    rig, pairs = make_rig(), make_path(20)
    [finding] = check_exposures((share, 0.002, 0.0, 0.5), rig, pairs)
    assert check_exposures((share, 0.002, 0.0, 0.5), rig, pairs[:1]) == [], "a speed takes two frame pairs"
    assert finding.effect_m == pytest.approx(share * (4.0 - rig.baseline_m))
    found = judge(finding)
    assert found.verdict == verdict and ("sigmas of all positions include" in found.detail) == (verdict == "widened")


def test_few_spans_say_nothing() -> None:
    assert right_camera_ahead(cameras(), seen_spans(0.05, 1)[:7], EVEN[:7]) == ()


def survey(columns_m: Sequence[float], *, doubled: bool = False) -> tuple[list[Track], Sequence[FramePair]]:
    """A drive of 1.2 m per interval past objects at these metres along the path; doubled: each once more, 1.2 m farther."""
    pairs = [
        pair.model_copy(update={"pose": pair.pose.model_copy(update={"map_t_body_m": (1.2 * k, 0.0, 0.0)})})
        for k, pair in enumerate(records.drive(frames=60).frame_pairs)
    ]
    along = [x + shift for x in columns_m for shift in ((0.0, 1.2) if doubled else (0.0,))]
    return [records.track(k, 10, xyz_m=(x, 3.0, 0.0)) for k, x in enumerate(along)], pairs


@pytest.mark.parametrize("spacing_m", [0.9, 1.2, 2.4, 5.0])
def test_rows_of_objects_pass(spacing_m: float) -> None:
    assert judge(check_doubled(*survey([30.0 + spacing_m * k for k in range(9)]))).verdict is Verdict.PASS


def test_doubled_objects_are_held() -> None:
    row = [30.0 + 5.0 * k for k in range(9)]
    assert judge(check_doubled(*survey(row, doubled=True))).verdict is Verdict.HOLD
    assert judge(check_doubled(*survey(row[:3], doubled=True))).verdict is Verdict.PASS  # two rows of three may be real
    assert judge(check_doubled([], [])).verdict is Verdict.PASS
