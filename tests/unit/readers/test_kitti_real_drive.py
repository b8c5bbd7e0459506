"""The real KITTI drive, where it is at hand (`../shared/data`, or `$CONETL_SHARED_DATA`)."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from conetl.geometry import rig as rigs
from conetl.model.drive import Drive
from conetl.model.rejections import Rejection
from conetl.readers.drives import read_drive
from tests.folders import KITTI, needs_kitti

pytestmark = needs_kitti


@pytest.fixture(scope="module")
def kitti() -> tuple[Drive, list[Rejection]]:
    return read_drive(KITTI)


@pytest.fixture(scope="module")
def map_SE3_left(kitti: tuple[Drive, list[Rejection]]) -> NDArray[np.float64]:
    drive, _ = kitti
    return np.stack([rigs.map_SE3_left(pair.pose, drive.rig) for pair in drive.frame_pairs])


def test_all_pairs_are_there(kitti: tuple[Drive, list[Rejection]]) -> None:
    drive, rejections = kitti
    assert rejections == []
    assert len(drive.frame_pairs) == drive.expected_frame_count == 154
    assert drive.map_srid == 32632
    assert (drive.rig.left.width_px, drive.rig.left.height_px) == (1242, 375)
    assert drive.rig.baseline_m == pytest.approx(0.5327, abs=2e-4)
    assert 15.0 < (drive.captured_to - drive.captured_from).total_seconds() < 16.5
    assert all(0.3 <= pair.pose.sigma_enu_m[0] <= 0.55 for pair in drive.frame_pairs)


def test_cameras_sit_on_the_car_as_kitti_describes(kitti: tuple[Drive, list[Rejection]]) -> None:
    rig = kitti[0].rig
    left, right = rigs.body_SE3_camera(rig, "left"), rigs.body_SE3_camera(rig, "right")
    # KITTI's sketch: IMU 0.93 m and cameras 1.65 m above the road, cameras 1.08 m before the IMU and left of it 0.32 m.
    assert left[2, 3] == pytest.approx(1.65 - 0.93, abs=0.03)
    assert left[0, 3] == pytest.approx(0.81 + 0.27, abs=0.03)
    assert left[1, 3] - right[1, 3] == pytest.approx(0.533, abs=2e-3)
    np.testing.assert_allclose(left[:3, 2], [1, 0, 0], atol=0.02)
    np.testing.assert_allclose(left[:3, 0], [0, -1, 0], atol=0.02)


def test_the_camera_drives_where_it_looks(map_SE3_left: NDArray[np.float64]) -> None:
    steps = np.diff(map_SE3_left[:, :3, 3], axis=0)
    length = np.linalg.norm(steps, axis=1)
    moving = length > 0.2
    assert moving.sum() > 100
    along = np.einsum("pi,pi->p", steps[moving], map_SE3_left[:-1, :3, 2][moving]) / length[moving]
    assert (along > 0.98).all(), "each step leads forward along the optical axis"
    # In a straight stretch the heading of the way and the optical axis agree on average to within half a degree.
    side = np.einsum("pi,pi->p", steps[moving], map_SE3_left[:-1, :3, 0][moving]) / length[moving]
    assert abs(np.median(side)) < 0.03
