"""The simulated GNSS/INS against pyproj and against conetl's own reader of OXTS records."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from pyproj import Geod, Transformer
from scipy.spatial.transform import Rotation

from conetl.geometry.rig import body_SE3_camera
from conetl.readers.drives import kitti
from conetl.readers.drives.drive_yaml import Sigmas
from conetl.readers.rigs import read_rig
from conetl.readers.trajectories.oxts import parse_oxts
from conetl.readers.trajectories.times import parse_timestamp
from conetl.simulation import simulate, trajectory
from conetl.simulation.scenario import scenario_pass
from conetl.simulation.simulate import simulated_camera


def _drive(pass_number: int) -> tuple[np.ndarray, np.ndarray]:
    scenario = scenario_pass(pass_number)
    times = np.arange(scenario.frame_count) * trajectory.FRAME_PERIOD_S
    return times, trajectory.true_poses(scenario, times)


def _exact(poses: np.ndarray, times: np.ndarray) -> list[list[float]]:
    return trajectory.oxts_records(
        poses[:, :3, 3], Rotation.from_matrix(poses[:, :3, :3]).as_euler("ZYX")[:, ::-1], times
    )


@pytest.mark.parametrize("pass_number", [1, 2, 3])
def test_reader_gets_the_true_poses_back_from_noiseless_records(pass_number: int, tmp_path: Path) -> None:
    times, poses = _drive(pass_number)
    simulate.write_oxts(tmp_path, _exact(poses, times), ["stamp"] * len(times))
    files = sorted((tmp_path / "oxts" / "data").glob("*.txt"))
    records = {int(path.stem): parse_oxts(path.read_text()) for path in files}
    read = kitti.oxts_trajectory(records, {}, trajectory.MAP_SRID, Sigmas())
    np.testing.assert_allclose(read.map_SE3_body[:, :3, 3], poses[:, :3, 3], atol=1e-5)
    np.testing.assert_allclose(read.map_SE3_body[:, :3, :3], poses[:, :3, :3], atol=1e-8)


def test_velocities_belong_to_the_path() -> None:
    times, poses = _drive(1)
    record = _exact(poses, times)[20]
    lon_lat = Transformer.from_crs(trajectory.MAP_SRID, 4326, always_xy=True)
    before, after = (lon_lat.transform(*poses[n, :2, 3]) for n in (19, 21))
    azimuth, _, metres = Geod(ellps="WGS84").inv(*before, *after)
    speed = metres / 0.2
    assert record[6] == pytest.approx(speed * math.cos(math.radians(azimuth)), abs=0.05)  # north
    assert record[7] == pytest.approx(speed * math.sin(math.radians(azimuth)), abs=0.05)  # east
    assert record[8] == pytest.approx(speed, abs=0.05)  # forward


def test_measured_poses_differ_as_the_noise_model_says() -> None:
    times, poses = _drive(1)
    errors = []
    for seed in range(200):
        places, _ = trajectory.measured_poses(poses, times, np.random.default_rng(seed))
        errors.append(places - poses[:, :3, 3])
    sigma = np.std(errors, axis=(0, 1))
    expected = [math.hypot(m.drift, m.white) for m in (trajectory.HORIZONTAL_M,) * 2 + (trajectory.VERTICAL_M,)]
    np.testing.assert_allclose(sigma, expected, rtol=0.25)
    steps = np.std(np.diff(errors, axis=1))
    assert steps < 0.4 * sigma.mean()  # slow drift, not white noise


def test_written_calibration_is_the_chain_of_the_renderer(tmp_path: Path) -> None:
    camera = simulated_camera()
    simulate.write_calibration(tmp_path, camera, datetime(2026, 3, 2, tzinfo=UTC))
    read = read_rig(tmp_path)
    np.testing.assert_allclose(body_SE3_camera(read, "left"), trajectory.body_SE3_camera(2), atol=1e-9)
    np.testing.assert_allclose(body_SE3_camera(read, "right"), trajectory.body_SE3_camera(3), atol=1e-9)
    assert (read.left.fx_px, read.left.cx_px, read.left.cy_px) == pytest.approx(
        (camera.fx_px, camera.cx_px, camera.cy_px)
    )
    left = trajectory.body_SE3_camera(2)
    cameras = np.linalg.inv(trajectory.map_SE3_road()) @ _drive(1)[1] @ left
    assert cameras[:, 2, 3] == pytest.approx(trajectory.CAMERA_HEIGHT_M, abs=0.05)
    assert np.linalg.norm(trajectory.body_SE3_camera(3)[:3, 3] - left[:3, 3]) == pytest.approx(0.54, abs=0.01)


def test_timestamps_are_read_back() -> None:
    start = datetime(2026, 3, 2, 9, 59, 59, 950_000, UTC)
    written = simulate.timestamp(start, 0.1)
    assert written == "2026-03-02 10:00:00.050000000"
    ten = int(datetime(2026, 3, 2, 10, tzinfo=UTC).timestamp())
    assert parse_timestamp(written) == ten * 10**9 + 50_000_000
