"""Calibration files: the right rig from good ones, one helpful sentence from bad ones."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from conetl.geometry import pose as se3
from conetl.geometry import rig as rigs
from conetl.model.errors import InputError
from conetl.readers.rigs import read_kitti_rig, read_rig, write_rig_yaml

#: Numbers of the size of KITTI's own: camera 2 sits 6 cm left of camera 0, camera 3 47 cm right of it.
P2 = "7.2e+02 0 6.1e+02 4.5e+01 0 7.2e+02 1.7e+02 2.0e-01 0 0 1 2.7e-03"
P3 = "7.2e+02 0 6.1e+02 -3.4e+02 0 7.2e+02 1.7e+02 2.2e+00 0 0 1 2.7e-03"
CAM_TO_CAM = f"""calib_time: 09-Jan-2012 13:57:47
corner_dist: 9.950000e-02
S_rect_02: 1.242000e+03 3.750000e+02
R_rect_00: 1 0 0 0 1 0 0 0 1
P_rect_02: {P2}
S_rect_03: 1.242000e+03 3.750000e+02
P_rect_03: {P3}
"""
VELO_TO_CAM = "calib_time: x\nR: 0 -1 0 0 0 -1 1 0 0\nT: 0.0 -0.08 -0.27\n"
IMU_TO_VELO = "calib_time: x\nR: 1 0 0 0 1 0 0 0 1\nT: -0.81 0.32 -0.80\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "calib_cam_to_cam.txt").write_text(CAM_TO_CAM)
    (tmp_path / "calib_velo_to_cam.txt").write_text(VELO_TO_CAM)
    (tmp_path / "calib_imu_to_velo.txt").write_text(IMU_TO_VELO)
    return tmp_path


def test_kitti_rig_has_its_cameras_where_the_files_say(folder: Path) -> None:
    rig = read_rig(folder)
    assert (rig.left.width_px, rig.left.height_px) == (1242, 375)
    t2 = np.linalg.solve([[720, 0, 610], [0, 720, 170], [0, 0, 1]], [45, 0.2, 0.0027])
    t3 = np.linalg.solve([[720, 0, 610], [0, 720, 170], [0, 0, 1]], [-340, 2.2, 0.0027])
    relative = rigs.left_SE3_right(rig)
    np.testing.assert_allclose(relative[:3, 3], t2 - t3, atol=1e-12)
    assert abs(relative[1, 3]) > 1e-3, "ty is not zero and must not be dropped"
    assert rig.baseline_m == pytest.approx(np.linalg.norm(t2 - t3))
    # The chain by hand: imu -> velo adds T, velo -> cam swaps axes, cam0 -> rect is the identity here.
    imu_point = np.array([10.0, 1.0, -0.5])
    x, y, z = imu_point + np.array([-0.81, 0.32, -0.80])
    cam0 = np.array([-y, -z, x]) + np.array([0.0, -0.08, -0.27])
    np.testing.assert_allclose(
        se3.apply(se3.invert(rigs.body_SE3_camera(rig, "left")), imu_point), cam0 + t2, atol=1e-12
    )


def test_without_the_imu_the_body_is_the_left_camera(folder: Path) -> None:
    (folder / "calib_velo_to_cam.txt").unlink()
    (folder / "calib_imu_to_velo.txt").unlink()
    rig = read_rig(folder / "calib_cam_to_cam.txt")
    assert rigs.body_is_left_camera(rig)
    with pytest.raises(InputError, match=r"calib_velo_to_cam\.txt and calib_imu_to_velo\.txt missing"):
        read_kitti_rig(folder / "calib_cam_to_cam.txt", body_required=True)


def test_half_a_chain_is_refused(folder: Path) -> None:
    (folder / "calib_imu_to_velo.txt").unlink()
    with pytest.raises(InputError, match=r"calib_imu_to_velo\.txt missing"):
        read_rig(folder)


def test_the_rig_id_follows_the_numbers(folder: Path) -> None:
    first = read_rig(folder)
    assert read_rig(folder) == first
    path = folder / "calib_imu_to_velo.txt"
    path.write_text(IMU_TO_VELO.replace("-0.81", "-0.82"))
    assert read_rig(folder).rig_id != first.rig_id


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("P_rect_03:", "P_rekt_03:", r"calib_cam_to_cam.txt: 'P_rect_03' is missing; found"),
        ("S_rect_02: 1.242000e+03", "S_rect_02: wide", "'S_rect_02' must be numbers, found"),
        (P3, P3.replace("-3.4e+02", "-1.08e+12"), r"the baseline is 1.5e\+09 m, expected 0.01 to 10 m"),
        ("T: -0.81", "T: -81", "the lever arm of body_SE3_left is"),
        ("T: -0.81", "T: -810", "the lever arm of body_SE3_left is"),
        ("S_rect_02: 1.242000e+03", "S_rect_02: 4e+05", "pixels are more than"),
        (P2, P2.replace("1.7e+02", "1.7e+20"), r"the principal point \(610, 1.7e\+20\) is far outside of the image"),
        (P2, P2.rsplit(" ", 1)[0], "'P_rect_02' must be 12 numbers, found 11"),
        (P3, P3.replace("-3.4e+02", "nan"), "'P_rect_03' must be finite numbers"),
        (P3, P3.replace("-3.4e+02", "3.4e+02"), "left and right swapped"),
        (P3, P2, "left and right swapped"),
        (P2, P2.replace("7.2e+02 0", "-7.2e+02 0", 1), "'P_rect_02' must have positive focal lengths"),
        ("R_rect_00: 1 0", "R_rect_00: 2 0", "'R_rect_00' is not a rotation"),
        ("S_rect_02: 1.242000e+03", "S_rect_02: 1242.5", "whole numbers of pixels"),
        ("R: 0 -1", "R: 0 1", "calib_velo_to_cam.txt: 'R' is not a rotation"),
        ("T: -0.81", "T:", "calib_imu_to_velo.txt: 'T' must be 3 numbers, found 2"),
    ],
)
def test_a_broken_kitti_file_raises_one_message(folder: Path, old: str, new: str, message: str) -> None:
    (path,) = (path for path in folder.iterdir() if old in path.read_text())
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(InputError, match=message) as raised:
        read_rig(folder)
    assert str(folder) in str(raised.value)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda p: p / "nowhere.yaml", "no such file"),
        (lambda p: p, "expected one calibration in the folder, found none"),
        (lambda p: p / "rig.json", "not a calibration that conetl knows"),
        (lambda p: p / "rig.toml", "not a calibration that conetl knows"),
        (lambda p: p / "binary.txt", "not a text file"),
    ],
)
def test_files_that_are_not_calibrations(tmp_path: Path, make, message: str) -> None:  # type: ignore[no-untyped-def]
    (tmp_path / "rig.json").write_text("{}")
    (tmp_path / "rig.toml").write_text("a = 1")
    (tmp_path / "binary.txt").write_bytes(b"\x89HDF\x00\x81")
    with pytest.raises(InputError, match=message):
        read_rig(make(tmp_path))


PIXELS = "{width_px: 1242, height_px: 375, fx_px: 721.5, fy_px: 720.0, cx_px: 609.6, cy_px: 172.9}"
BOTH = f"left: {PIXELS}\nright: {PIXELS}\n"
HEAD = f"{BOTH}baseline_m: 0.27\n"
PAPER = (
    "{width_px: 6000, height_px: 4000, fx_mm: 15.9004, fy_mm: 15.8703, sensor_width_mm: 23.5, sensor_height_mm: 15.6"
)


def yaml_rig(folder: Path, text: str) -> Path:
    path = folder / "rig.yaml"
    path.write_text(text)
    return path


def test_rig_yaml_in_pixels(tmp_path: Path) -> None:
    rig = read_rig(
        yaml_rig(tmp_path, f"rig_id: mine\nleft: {PIXELS}\nright: {PIXELS}\nbaseline_m: 0.27\nsigma_px: 0.3\n")
    )
    assert (rig.rig_id, rig.left.fy_px, rig.sigma_px) == ("mine", 720.0, 0.3)
    assert rig.baseline_m == pytest.approx(0.27)
    assert rigs.body_is_left_camera(rig)
    assert read_rig(tmp_path) == rig, "the folder will do"


def test_rig_yaml_in_the_papers_millimetres(tmp_path: Path) -> None:
    rig = read_rig(
        yaml_rig(tmp_path, f"left: {PAPER}, x0_mm: 0.1, y0_mm: 0.05}}\nright: {PAPER}}}\nbaseline_m: 0.2745\n")
    )
    assert rig.left.fx_px == pytest.approx(15.9004 / 23.5 * 6000)
    assert rig.left.fy_px == pytest.approx(15.8703 / 15.6 * 4000)
    assert rig.right.cx_px == pytest.approx(2999.5)
    assert rig.left.cx_px == pytest.approx(2999.5 + 0.1 / 23.5 * 6000)
    assert rig.left.cy_px == pytest.approx(1999.5 - 0.05 / 15.6 * 4000), "y0 counts upwards, rows downwards"


def test_rig_yaml_with_relative_and_body_pose(tmp_path: Path) -> None:
    turn = se3.rotation_from_rpy(0.0, 0.01, 0.0).tolist()
    text = f"""
left: {PIXELS}
right: {PIXELS}
left_SE3_right: {{R: {turn}, t_m: [0.3, 0.001, -0.002]}}
body_SE3_left: {{R: [[0, 0, 1], [-1, 0, 0], [0, -1, 0]], t_m: [1.0, 0.2, 0.7]}}
"""
    rig = read_rig(yaml_rig(tmp_path, text))
    np.testing.assert_allclose(rigs.left_SE3_right(rig)[:3, :3], turn, atol=1e-12)
    np.testing.assert_allclose(rigs.left_SE3_right(rig)[:3, 3], [0.3, 0.001, -0.002], atol=1e-12)
    np.testing.assert_allclose(rigs.up_in_left_camera(rig), [0, -1, 0], atol=1e-12)


def test_rig_yaml_in_millimetres_from_the_corner(tmp_path: Path) -> None:
    millimetres = PAPER.replace("fx_mm: 15.9004, fy_mm: 15.8703", "focal_mm: [15.9004, 15.8703]")
    text = f"left: {millimetres}, principal_mm: [11.75, 7.8]}}\nright: {millimetres}}}\nbaseline_m: 0.2745\n"
    rig = read_rig(yaml_rig(tmp_path, text))
    assert rig.left.cx_px == pytest.approx(2999.5) and rig.left.cy_px == pytest.approx(1999.5)
    assert rig.left.fx_px == rig.right.fx_px == pytest.approx(15.9004 / 23.5 * 6000)


def test_covariance_survives_the_file(tmp_path: Path) -> None:
    text = covariance("left.fx_px, relative.ry_rad", "[4.0, 1.0e-4], [1.0e-4, 1.0e-6]")
    rig = read_rig(yaml_rig(tmp_path, f"rig_id: a\n{text}\nsigma_px: 0.3\n"))
    assert rig.calibration_covariance is not None and rig.calibration_covariance.matrix[0] == (4.0, 1e-4)
    write_rig_yaml(rig, tmp_path / "again.yaml")
    assert read_rig(tmp_path / "again.yaml") == rig


def test_a_rolling_shutter_is_written_as_it_was_read(tmp_path: Path) -> None:
    text = HEAD.replace("cy_px: 172.9}", "cy_px: 172.9, shutter: {readout_ms: 10, stamp_row: first}}", 1)
    rig = read_rig(yaml_rig(tmp_path, f"rig_id: a\n{text}"))
    assert rig.left.shutter is not None and rig.left.shutter.readout_ms == 10.0
    write_rig_yaml(rig, tmp_path / "again.yaml")
    assert read_rig(tmp_path / "again.yaml") == rig


def covariance(names: str, rows: str) -> str:
    return f"{HEAD}calibration_covariance: {{names: [{names}], matrix: [{rows}]}}"


def with_lens(lens: str) -> str:
    return HEAD.replace("cy_px: 172.9}", f"cy_px: 172.9, lens: {lens}}}", 1)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("- a list", "expected a YAML mapping"),
        ("left: [", "this is not YAML"),
        (HEAD.replace("cy_px: 172.9}", "cy_px: 172.9, shutter: {readout_ms: 400}}", 1), "left.shutter.readout_ms: "),
        (f"left: {PIXELS}\nbaseline_m: 0.3", "right: is missing"),
        (BOTH, "either baseline_m"),
        (f"{BOTH}baseline_m: -0.3", "baseline_m: "),
        (f"{BOTH}baseline_m: .nan", "baseline_m: "),
        (f"{BOTH}baseline_m: 0.3\nbase: 1", "base: "),
        (f"left: {PIXELS}\nright: {{width_px: 9, height_px: 5, fx_px: 7}}\nbaseline_m: 0.3", "right: .*either fx_px"),
        (f"left: {PIXELS}\nright: {PAPER}, fx_px: 3000}}\nbaseline_m: 0.3", "right: .*give either fx_px"),
        (f"{BOTH}left_SE3_right: {{t_m: [-0.3, 0, 0]}}", "left and right swapped"),
        (f"{BOTH}left_SE3_right: {{t_m: [0.3, 0, 0.2]}}", "does not follow the image rows"),
        (
            BOTH + "left_SE3_right: {R: [[1, 0, 0], [0, 1, 0], [0, 0, 2]], t_m: [0.3, 0, 0]}",
            "SE3_right.R: .* not a rotation",
        ),
        (
            f"{BOTH}baseline_m: 0.3\ncalibration_covariance: {{names: [left.fx_px], matrix: [[1.0]], "
            "shared: {calibration: 00000000-0000-0000-0000-000000000001, matrix: [[1.0]]}}",
            "what drives share of it is computed",
        ),
        (f"{HEAD}sigmas: {{left.f_px: 1}}", "'left.f_px' in the calibration's covariance is not a parameter"),
        (f"{HEAD}sigmas: {{left.lens.0: 1}}", "'left.lens.0' in the calibration's covariance is not a parameter"),
        (f"{HEAD}sigmas: {{left.fx_px: -1}}", "sigmas.left.fx_px: "),
        (f"{HEAD}sigmas: {{left.fx_px: .nan}}", "sigmas.left.fx_px: "),
        (f"{HEAD}sigmas: {{left.fx_mm: 0.1}}", "millimetres need a camera given in millimetres"),
        (f"{HEAD}sigmas: {{relative.rx_rad: 0.1, relative.rx_deg: 1}}", "relative.rx_rad is given twice"),
        (covariance("left.fx_px", "[1.0]") + "\nsigmas: {left.fx_px: 1}", "either sigmas or"),
        (covariance("left.fx_px", "[1.0, 0.0]"), "calibration_covariance.*1 x 1"),
        (covariance("left.fx_px, left.fy_px", "[1, 2], [2, 1]"), "negative eigenvalue"),
        (f"{HEAD}lens: {{}}", "lens: "),
        (with_lens("{model: brown, coefficients: [1, 2]}"), "left.lens: .*has 5 coefficients, found 2"),
        (with_lens("{model: mei, coefficients: [1, 2]}"), "left.lens.model: "),
        (with_lens("{model: radial, coefficients: [.nan, 0]}"), "left.lens.coefficients.0: "),
    ],
)
def test_a_broken_rig_yaml_raises_one_message(tmp_path: Path, text: str, message: str) -> None:
    path = yaml_rig(tmp_path, text)
    with pytest.raises(InputError, match=message) as raised:
        read_rig(path)
    assert re.match(re.escape(str(path)), str(raised.value))
