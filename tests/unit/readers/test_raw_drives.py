"""Drive folders with raw images: which rig a reader takes."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from conetl.geometry import camera as cam
from conetl.geometry import pose as se3
from conetl.geometry import rig as rigs
from conetl.geometry.rectification import is_rectified, rectified_from_raw, rectify
from conetl.model.errors import DriveFolderError, InputError
from conetl.readers.drives import read_drive
from conetl.readers.rigs import read_kitti_rig, read_rig_for_images
from tests.folders import SAMPLE
from tests.unit.readers.test_plain_drive import HEADER

#: The numbers of KITTI's cameras 02 and 03, with few digits.
CAM_TO_CAM = """S_02: 1392 512
K_02: 959.791 0 696.0217 0 956.9251 224.1806 0 0 1
D_02: -0.3691481 0.1968681 1.353473e-03 5.677587e-04 -0.06770705
R_02: 9.999758e-01 -5.267463e-03 -4.552439e-03 5.251945e-03 9.999804e-01 -3.413835e-03 4.570332e-03 3.389843e-03 9.999838e-01
T_02: 5.956621e-02 2.900141e-04 2.577209e-03
S_rect_02: 1242 375
R_rect_00: 9.999239e-01 9.837760e-03 -7.445048e-03 -9.869795e-03 9.999421e-01 -4.278459e-03 7.402527e-03 4.351614e-03 9.999631e-01
P_rect_02: 721.5377 0 609.5593 44.85728 0 721.5377 172.854 0.2163791 0 0 1 0.002745884
S_03: 1392 512
K_03: 903.7596 0 695.7519 0 901.9653 224.2509 0 0 1
D_03: -0.3639558 0.1788651 6.029694e-04 -3.922424e-04 -0.05382460
R_03: 9.995599e-01 1.699522e-02 -2.431313e-02 -1.704422e-02 9.998531e-01 -1.809756e-03 2.427880e-02 2.223358e-03 9.997028e-01
T_03: -4.731050e-01 5.551470e-03 -5.250882e-03
S_rect_03: 1242 375
P_rect_03: 721.5377 0 609.5593 -339.5242 0 721.5377 172.854 2.199936 0 0 1 0.002729905
"""
R_RECT_02 = (9.998817e-01, 1.511453e-02, -2.841595e-03, -1.511724e-02, 9.998853e-01, -9.338510e-04, 2.827154e-03, 9.766976e-04,
             9.999955e-01)  # fmt: skip
R_RECT_03 = (9.998321e-01, -7.193136e-03, 1.685599e-02, 7.232804e-03, 9.999712e-01, -2.293585e-03, -1.683901e-02, 2.415116e-03,
             9.998553e-01)  # fmt: skip
PIXELS = "width_px: 96, height_px: 32, fx_px: 70, fy_px: 70, cx_px: 47.5, cy_px: 15.5"
BODY = "body_SE3_left: {R: [[0, 0, 1], [-1, 0, 0], [0, -1, 0]], t_m: [1.0, 0.2, 0.7]}"
BOTH = f"left: {{{PIXELS}}}\nright: {{{PIXELS}}}\n"


@pytest.fixture
def kitti(tmp_path: Path) -> Path:
    """Calibration of a KITTI day, with a drive of three frames without images in it."""
    root = tmp_path / "drive"
    (root / "oxts" / "data").mkdir(parents=True)
    for frame in range(3):
        shutil.copy(SAMPLE / "oxts" / "data" / f"{frame:010d}.txt", root / "oxts" / "data")
    shutil.copy(SAMPLE / "oxts" / "timestamps.txt", root / "oxts")
    for name in ("calib_velo_to_cam.txt", "calib_imu_to_velo.txt"):
        shutil.copy(SAMPLE / name, root)
    (root / "calib_cam_to_cam.txt").write_text(CAM_TO_CAM)
    return root


def put_images(root: Path, width: int, height: int) -> None:
    for camera in ("image_02", "image_03"):
        (root / camera / "data").mkdir(parents=True)
        shutil.copy(SAMPLE / camera / "timestamps.txt", root / camera)
        for frame in range(3):
            image = np.full((height, width, 3), 90 + frame, np.uint8)
            cv2.imwrite(str(root / camera / "data" / f"{frame:010d}.jpg"), image)


def test_kittis_raw_cameras_see_what_its_rectified_ones_see(kitti: Path) -> None:
    """The two halves of KITTI's file agree: a body point through K, D, R, T and through P_rect lies in one direction."""
    path = kitti / "calib_cam_to_cam.txt"
    raw = read_kitti_rig(path, body_required=True, images="raw")
    own = read_kitti_rig(path, body_required=True)
    assert raw.left.lens.model == "brown" and raw.baseline_m == pytest.approx(own.baseline_m, abs=1e-4)
    point = np.array([9.0, 1.0, -0.8])
    for side, r_rect in (("left", R_RECT_02), ("right", R_RECT_03)):
        centre = [rigs.body_SE3_camera(r, side)[:3, 3] for r in (raw, own)]  # type: ignore[arg-type]
        np.testing.assert_allclose(centre[0], centre[1], atol=2e-3)
        in_raw = se3.apply(se3.invert(rigs.body_SE3_camera(raw, side)), point)  # type: ignore[arg-type]
        uv = cam.project(rigs.camera_of(raw, side), in_raw)  # type: ignore[arg-type]
        # The other way round: through KITTI's rectified camera, back by its R_rect_0i into the raw one.
        in_own = se3.apply(se3.invert(rigs.body_SE3_camera(own, side)), point)  # type: ignore[arg-type]
        back = np.reshape(r_rect, (3, 3)).T @ in_own
        np.testing.assert_allclose(cam.project(rigs.camera_of(raw, side), back), uv, atol=0.25)  # type: ignore[arg-type]
    flat = rectify(raw)
    assert is_rectified(flat) and flat.left.fx_px == pytest.approx(959.791)
    assert flat.left.width_px >= 1392, "straightening a barrel at full resolution widens the image"
    assert np.isfinite(rectified_from_raw(flat, "left", [696.0, 256.0])).all()


@pytest.mark.parametrize(("size", "raw"), [((1242, 375), False), ((1392, 512), True)])
def test_the_size_of_kitti_images_decides_whether_they_are_raw(kitti: Path, size: tuple[int, int], raw: bool) -> None:
    put_images(kitti, *size)
    drive, rejections = read_drive(kitti)
    assert rejections == [] and len(drive.frame_pairs) == 3
    assert (drive.rig.rectified_from is not None) == raw
    assert (read_rig_for_images(kitti, size).rectified_from is not None) == raw


def test_kitti_images_of_a_third_size_are_rejected(kitti: Path) -> None:
    put_images(kitti, 640, 200)
    with pytest.raises(Exception, match=r"640 x 200 pixels, but the calibration is for 1242 x 375"):
        read_drive(kitti)


def test_a_swapped_raw_pair_is_rejected(kitti: Path) -> None:
    with pytest.raises(InputError, match=r"T_03, T_02: .*swapped"):
        read_kitti_rig(kitti / "calib_cam_to_cam.txt", left=3, right=2, body_required=True, images="raw")


def plain(root: Path, rig: str) -> Path:
    for side in ("left", "right"):
        (root / side).mkdir(parents=True)
        cv2.imwrite(str(root / side / "a.png"), np.full((32, 96, 3), 100, np.uint8))
    (root / "rig.yaml").write_text(rig)
    row = "a,2026-03-02 09:41:07,8.43,49.0,116,0,0,32,0.015,0.015,0.02,0.05,0.05,0.15"
    (root / "trajectory.csv").write_text(f"{HEADER}\n{row}\n")
    return root


def test_a_plain_drive_with_lenses_is_rectified(tmp_path: Path) -> None:
    lens = "lens: {model: brown, coefficients: [-0.3, 0.1, 0.001, 0, 0]}"
    text = f"left: {{{PIXELS}, {lens}}}\nright: {{{PIXELS}}}\nbaseline_m: 0.3\n{BODY}\nsigmas: {{left.fx_px: 1.0}}\n"
    rig = read_drive(plain(tmp_path / "d", text))[0].rig
    assert rig.rectified_from is not None and rig.rectified_from.left.lens.model == "brown"
    assert rig.calibration_covariance is None and rig.rectified_from.calibration_covariance is not None
    assert is_rectified(rig)


def test_a_plain_drive_with_a_turned_camera_is_rectified(tmp_path: Path) -> None:
    turn = se3.rotation_from_rpy(0.0, 0.02, 0.0).tolist()
    text = f"{BOTH}left_SE3_right: {{R: {turn}, t_m: [0.3, 0, 0]}}\n{BODY}\n"
    assert read_drive(plain(tmp_path / "d", text))[0].rig.rectified_from is not None
    text = f"{BOTH}baseline_m: 0.3\n{BODY}\n"
    assert read_drive(plain(tmp_path / "e", text))[0].rig.rectified_from is None


def test_a_plain_drive_whose_cameras_share_no_image_is_refused(tmp_path: Path) -> None:
    turn = se3.rotation_from_rpy(0.0, 2.6, 0.0).tolist()
    text = f"{BOTH}left_SE3_right: {{R: {turn}, t_m: [0.3, 0, 0]}}\n{BODY}\n"
    with pytest.raises(DriveFolderError, match=r"rig\.yaml: the cameras look"):
        read_drive(plain(tmp_path / "d", text))
