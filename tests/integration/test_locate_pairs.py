"""Distances from single pairs of real recordings, whose calibration states no errors, against measured ones."""

from __future__ import annotations

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from conetl.cli.app import app
from conetl.evaluation.lidar_drive import lidar_residuals
from tests.folders import KITTI, SHARED, needs_kitti

GUIDEPOSTS = SHARED / "kitti_raw_guideposts"
needs_guideposts = pytest.mark.skipif(
    not GUIDEPOSTS.is_dir(),
    reason=f"no guide posts at {GUIDEPOSTS}; set CONETL_SHARED_DATA to the folder that holds them",
)


def located(frame: int) -> dict[str, list[dict[str, float]]]:
    pair = [str(GUIDEPOSTS / side / "data" / f"{frame:010d}.jpg") for side in ("image_02", "image_03")]
    result = CliRunner().invoke(app, ["locate", *pair, "--calibration", str(GUIDEPOSTS), "--json"])
    assert result.exit_code == 0, result.output
    return dict(json.loads(result.stdout))


@needs_guideposts
def test_measured_distances_are_within_two_stated_sigmas() -> None:
    """Frame 10 has the disparities of KITTI Stereo 2015: a panel at 18.26 m, a sign at 21.5 m (../shared/data)."""
    objects = {one["category"]: one for one in located(10)["objects"]}
    for category, truth_m in {"vertical_panel": 18.26, "traffic_sign": 21.5}.items():
        one = objects[category]
        for measured_m in (one["ground_distance_m"], one["xyz_m"][2]):  # type: ignore[index]
            assert abs(measured_m - truth_m) < 2 * one["ground_distance_sigma_m"]


@needs_guideposts
def test_sigmas_are_at_most_six_percent_of_the_distance() -> None:
    found = [one for frame in range(0, 21, 2) for one in located(frame)["objects"]]
    shares = [
        one["ground_distance_sigma_m"] / one["ground_distance_m"]
        for one in found
        if 8 <= one["ground_distance_m"] <= 25
    ]
    assert len(shares) > 10
    assert max(shares) < 0.06


@pytest.mark.release
@needs_kitti
def test_ranges_of_a_calibration_without_sigmas_hold_against_lidar() -> None:
    """Every other frame; the prior was chosen on the others, among other recordings."""
    check = lidar_residuals(KITTI, model_path=None, self_calibrate=False, progress=lambda done, total: None)
    odd = [r for r in check.residuals if r.frame_index % 2]
    ratios = np.array([r.residual_m / np.hypot(r.stereo_sigma_m, r.lidar_sigma_m) for r in odd])
    assert len(ratios) > 20
    assert np.mean(np.abs(ratios) < 2) >= 0.85
    assert 0.2 < np.mean(ratios**2) < 2.0, "one calibration has one error: not a sample of many"
