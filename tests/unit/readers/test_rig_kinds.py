"""Calibrations of data sets, SLAM programs and ROS: recognised by their keys whatever the file is called."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import pytest
import yaml

from conetl.geometry import camera as cam
from conetl.geometry import pose as se3
from conetl.geometry import rig as rigs
from conetl.model.errors import InputError
from conetl.model.rig import Rig
from conetl.readers.rigs import FORMAT_NAMES, find_rigs, read_rig, read_rig_and_format, read_rig_for_images
from tests.unit.readers.test_device_rigs import zed_text
from tests.unit.readers.test_rig_formats import (
    D1,
    D2,
    FISHEYE,
    K1,
    K2,
    SIZE,
    R,
    T,
    agrees_with_opencv,
    agrees_with_opencvs_fisheye,
    kalibr_content,
    ros_content,
)

BODY = se3.se3(np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]), [1.1, 0.3, 0.4])  # imu_SE3_left
PARALLEL = np.array([-0.35, 0.0, 0.0])


def rows(values: Any, form: str = ".12g") -> str:
    return " ".join(format(float(value), form) for value in np.ravel(values))


def projection(t: np.ndarray, k: np.ndarray = K1) -> np.ndarray:
    return np.column_stack([k, k @ t])


def opencv_matrix(value: Any, shape: tuple[int, int], space: str = " ") -> str:
    data = ", ".join(repr(float(number)) for number in np.ravel(value))
    return f"!!opencv-matrix\n   rows: {shape[0]}\n   cols: {shape[1]}\n   dt: d\n   data:{space}[{data}]\n"


# --------------------------------------------------------------------------- one sample of every kind


def odometry(left: str = "P2", right: str = "P3", first: str = "") -> str:
    """Cameras 2 and 3, each 5 cm to the left of where a pair around camera 0 would have them."""
    shift = np.array([0.05, 0.0, 0.0])
    return f"{first}{left}: {rows(projection(shift), '.12e')}\n{right}: {rows(projection(PARALLEL + shift), '.12e')}\n"


GREY = f"P0: {rows(projection(np.zeros(3)))}\nP1: {rows(projection(PARALLEL * 2))}\n"
OBJECT = odometry(first=GREY) + "R0_rect: 1 0 0 0 1 0 0 0 1\nTr_velo_to_cam: 0 -1 0 0 0 0 -1 0 1 0 0 -0.3\n\n"
KITTI_360 = (
    "calib_time: 30-Jun-2019 10:00:00\nR_rect_00: 1 0 0 0 1 0 0 0 1\n"
    + "".join(f"S_rect_0{n}: 1280 720\nP_rect_0{n}: {rows(projection(t))}\n" for n, t in ((0, np.zeros(3)), (1, PARALLEL)))
)  # fmt: skip


def middlebury(offset_px: float = 0.0, size: str = "width=1280\nheight=720\n", baseline: float = 350.0) -> str:
    def camera(cx: float) -> str:
        return f"[{K1[0, 0]} 0 {cx}; 0 {K1[1, 1]} {K1[1, 2]}; 0 0 1]"

    cameras = f"cam0={camera(K1[0, 2])}\ncam1={camera(K1[0, 2] + offset_px)}\n"
    return f"{cameras}doffs={offset_px}\nbaseline={baseline}\n{size}ndisp=280\nisint=0\nvmin=31\nvmax=257\n"


def ost(side: str, size: bool = True) -> str:
    content = ros_content(side)
    part = [f"[narrow_stereo/{side}]"]
    for name, key, width in (("camera matrix", "camera_matrix", 3), ("distortion", "distortion_coefficients", 5),
                             ("rectification", "rectification_matrix", 3), ("projection", "projection_matrix", 4)):  # fmt: skip
        data = np.reshape(content[key]["data"], (-1, width))
        part += ["", name, *(" ".join(f"{value:.15f}" for value in row) for row in data)]
    head = "# oST version 5.0 parameters\n\n\n[image]\n\nwidth\n1280\n\nheight\n720\n\n" if size else ""
    return head + "\n".join(part) + "\n\n"


def orbslam_pair(space: str = " ") -> str:
    """Settings of ORB-SLAM2 for raw images, by cv2.stereoRectify."""
    text = "%YAML:1.0\n\n#---\nCamera.fx: 900.5\nCamera.bf: 250.1\nCamera.width: 1280\nCamera.height: 720\nThDepth: 35.0 # 35\n"
    for side in ("left", "right"):
        content, name = ros_content(side), side.upper()
        text += f"{name}.height: 720\n{name}.width: 1280\n"
        for key, part, shape in (("D", "distortion_coefficients", (1, 5)), ("K", "camera_matrix", (3, 3)),
                                 ("R", "rectification_matrix", (3, 3)), ("P", "projection_matrix", (3, 4))):  # fmt: skip
            text += f"{name}.{key}: {opencv_matrix(content[part]['data'], shape, space)}"
    return text


def orbslam_camera(name: str, k: np.ndarray, coefficients: dict[str, float]) -> str:
    values = {"fx": k[0, 0], "fy": k[1, 1], "cx": k[0, 2], "cy": k[1, 2], **coefficients}
    return "".join(f"{name}.{key}: {float(value)!r}\n" for key, value in values.items())


def brown(d: np.ndarray) -> dict[str, float]:
    return dict(zip(("k1", "k2", "p1", "p2", "k3"), d, strict=True))


ORB_SIZE = "Camera.width: 1280\nCamera.height: 720\nCamera.fps: 20\n"
ORB_KITTI = f"%YAML:1.0\n{orbslam_camera('Camera', K1, dict.fromkeys(('k1', 'k2', 'p1', 'p2'), 0.0))}{ORB_SIZE}"
ORB_KITTI += f"Camera.bf: {0.35 * float(K1[0, 0])!r}\nCamera.RGB: 1\n"
LEFT_SE3_RIGHT = se3.invert(se3.se3(R, T))
ORB3 = (
    f'%YAML:1.0\n\nFile.version: "1.0"\nCamera.type: "PinHole"\n{orbslam_camera("Camera1", K1, brown(D1))}'
    f"{orbslam_camera('Camera2', K2, brown(D2))}{ORB_SIZE}Stereo.ThDepth: 60.0\n"
    f"Stereo.T_c1_c2: {opencv_matrix(LEFT_SE3_RIGHT, (4, 4))}"
)
ORB3_RECTIFIED = f'%YAML:1.0\nCamera.type: "Rectified"\n{orbslam_camera("Camera1", K1, {})}{ORB_SIZE}Stereo.b: 0.35\n'
_KB = dict(zip(("k1", "k2", "k3", "k4"), FISHEYE, strict=True))
ORB_FISHEYE = (
    f'%YAML:1.0\nCamera.type: "KannalaBrandt8"\n{orbslam_camera("Camera", K1, _KB)}{orbslam_camera("Camera2", K2, _KB)}'
    f"{ORB_SIZE}Camera.bf: 19.3\nTlr: {opencv_matrix(LEFT_SE3_RIGHT[:3], (3, 4))}"
)


def chain(way: str, header: str = "") -> str:
    content = kalibr_content()
    del content["cam1"]["T_cn_cnm1"]
    for camera, lens in (("cam0", D1), ("cam1", D2)):
        content[camera]["distortion_coeffs"] = lens[:4].tolist()
    for camera, cam_SE3_imu in (("cam0", se3.invert(BODY)), ("cam1", se3.compose(se3.se3(R, T), se3.invert(BODY)))):
        pose = cam_SE3_imu if way == "T_cam_imu" else se3.invert(cam_SE3_imu)
        content[camera][way] = pose.tolist()
        content[camera]["timeshift_cam_imu"] = 0.002
    return header + yaml.safe_dump(content)


def opencv_list(size: list[int]) -> str:
    text = "%YAML:1.0\n---\n" + f"image_size: {size}\n"
    for name, value, shape in (("M1", K1, (3, 3)), ("D1", D1, (1, 5)), ("M2", K2, (3, 3)), ("D2", D2, (1, 5)), ("R", R, (3, 3)),
                               ("T", T, (3, 1))):  # fmt: skip
        text += f"{name}: {opencv_matrix(value, shape)}"
    return text


def zed_named(name: str) -> str:
    return zed_text(resolutions=("HD",)).replace("_HD", f"_{name}")


def parallel(rig: Rig) -> None:
    """Two cameras K1, 0.35 m apart."""
    for camera in (rig.left, rig.right):
        assert (camera.width_px, camera.height_px, camera.lens.model) == (*SIZE, "none")
        np.testing.assert_allclose(cam.matrix_k(camera), K1, rtol=1e-9)
    np.testing.assert_allclose(rigs.left_SE3_right(rig), se3.se3(np.eye(3), -PARALLEL), atol=1e-9)


def without_k3(rig: Rig) -> None:
    """Kalibr has no k3."""
    np.testing.assert_allclose(rig.left.lens.coefficients, [*D1[:4], 0.0])
    np.testing.assert_allclose(rigs.left_SE3_right(rig), LEFT_SE3_RIGHT, atol=1e-9)


class Sample(NamedTuple):
    """A file, the options that it needs, and what its rig must be."""

    kind: str
    text: str
    check: Callable[[Rig], None]
    options: Mapping[str, Any] = MappingProxyType({})


SIZED = {"image_size": SIZE}
SAMPLES: dict[str, Sample] = {
    "KITTI odometry": Sample("kitti_rectified", odometry(first=GREY) + "Tr: 1 0 0 0 0 1 0 0 0 0 1 0\n", parallel, SIZED),
    "KITTI object": Sample("kitti_rectified", OBJECT, parallel, SIZED),
    "KITTI grey only": Sample("kitti_rectified", odometry("P0", "P1"), parallel, SIZED),
    "KITTI grey of four": Sample("kitti_rectified", odometry("P0", "P1") + GREY.replace("P0", "P2").replace("P1", "P3"), parallel,
                                 {**SIZED, "pair": ("image_0", "image_1")}),
    "KITTI 360": Sample("kitti", KITTI_360, parallel),
    "Middlebury": Sample("middlebury", middlebury(), parallel),
    "Middlebury without a size": Sample("middlebury", middlebury(size=""), parallel, SIZED),
    "Middlebury in metres": Sample("middlebury", middlebury(baseline=0.35), parallel, {"length_unit": "m"}),
    "oST": Sample("ros", ost("left") + ost("right", size=False), agrees_with_opencv),
    "oST named by themselves": Sample("ros", (ost("left") + ost("right", size=False)).replace("narrow_stereo/", ""),
                                      agrees_with_opencv),
    "ORB-SLAM2 raw": Sample("orbslam", orbslam_pair(), agrees_with_opencv),
    "ORB-SLAM2 raw without spaces": Sample("orbslam", orbslam_pair(""), agrees_with_opencv),
    "ORB-SLAM2 rectified": Sample("orbslam", ORB_KITTI, parallel),
    "ORB-SLAM3": Sample("orbslam", ORB3, agrees_with_opencv),
    "ORB-SLAM3 rectified": Sample("orbslam", ORB3_RECTIFIED, parallel),
    "ORB-SLAM3 fisheye": Sample("orbslam", ORB_FISHEYE, agrees_with_opencvs_fisheye),
    "Kalibr by the IMU": Sample("kalibr", chain("T_cam_imu"), without_k3),
    "OpenVINS": Sample("kalibr", chain("T_imu_cam", "%YAML:1.0\n\n"), without_k3),
    "OpenVINS with a document": Sample("kalibr", chain("T_imu_cam", "%YAML:1.0 # OpenCV\n---\n"), without_k3),
    "OpenCV width, height": Sample("opencv", opencv_list([1280, 720]), agrees_with_opencv),
    "OpenCV height, width": Sample("opencv", opencv_list([720, 1280]), agrees_with_opencv),
    "ZED of another section": Sample("zed", zed_named("RESOLUTION_HD"), agrees_with_opencv, SIZED),
    "ZED of a new resolution": Sample("zed", zed_named("HDPLUS").replace("[", " [ "), agrees_with_opencv, SIZED),
}  # fmt: skip


@pytest.mark.parametrize("name", SAMPLES)
def test_a_calibration_is_recognised_by_its_keys(tmp_path: Path, name: str) -> None:
    sample = SAMPLES[name]
    for file_name in ("calib.txt", "settings.yaml", "camera.conf", "stereo", "rig.JSON"):
        path = tmp_path / file_name
        path.write_text(f"\ufeff{sample.text}" if file_name == "stereo" else sample.text.replace("\n", "\r\n"))
        rig, found = read_rig_and_format(path, **sample.options)
        assert found == sample.kind
        sample.check(rig)
    found_in = find_rigs([tmp_path / "calib.txt"], SIZE)
    if "pair" not in sample.options:
        assert [kind for _, _, kind in found_in.fitting] == [
            FORMAT_NAMES[sample.kind]  # type: ignore[index]
        ] or "in metres" in name
        read_rig_for_images(tmp_path / "calib.txt", SIZE) if "in metres" not in name else None


DAMAGE = re.compile(r"damaged|restore|corrupt|truncated|cut off|broken", re.IGNORECASE)


@pytest.mark.parametrize("name", SAMPLES)
def test_a_missing_key_is_named_with_the_format(tmp_path: Path, name: str) -> None:
    """Without any one of its keys a file is read, or refused with the format's name; no message calls the file damaged."""
    sample, refused = SAMPLES[name], 0
    keys = dict.fromkeys(re.findall(r"^\s*(?:-\s*)?([A-Za-z][\w.]*(?: matrix)?)(?=[:=]|$)", sample.text, re.MULTILINE))
    for key in keys:
        path = tmp_path / "calib.txt"
        path.write_text(re.sub(rf"^(\s*){re.escape(key)}(?=\s*[:=]|$)", r"\1another", sample.text, flags=re.MULTILINE))
        try:
            read_rig(path, **sample.options)
        except InputError as error:
            refused += 1
            assert not DAMAGE.search(str(error)), error
            assert f"(read as {FORMAT_NAMES[sample.kind]})" in str(error) or "that conetl knows: found" in str(error)  # type: ignore[index]
    assert refused >= 2


def test_what_is_missing_is_named(tmp_path: Path) -> None:
    path = tmp_path / "calib.txt"

    def refused(text: str, message: str, **options: Any) -> None:
        path.write_text(text)
        with pytest.raises(InputError, match=message):
            read_rig(path, **options)

    refused(odometry(), r"'image size' is not in this file.*--image-size.*KITTI odometry or object", pair=None)
    refused("P2: 1 2\n", r"'P2' must be 3 x 4 numbers, found 2", image_size=SIZE)
    refused(odometry().replace("P3", "Q3"), "'P3' is missing; found .*KITTI odometry", image_size=SIZE)
    refused(ost("left"), "one camera of two; name the files left.yaml")
    refused(ost("left").replace("rectification", "turn") + ost("right", size=False), "left.rectification' is missing")
    refused(ORB_KITTI.replace("Camera.bf", "Camera.b"), "'Camera.bf' is missing; found .*ORB-SLAM settings")
    refused(ORB_KITTI.replace("Camera.k1: 0.0", "Camera.k1: -0.3"), r"'Camera.k1' .* must be 0 .*LEFT.K.*are missing")
    refused(ORB3.replace("Stereo.T_c1_c2", "T_c1_c2"), "'Stereo.T_c1_c2' is missing")
    refused(chain("T_imu_cam").replace("T_imu_cam", "T_BS"), "'cam1.T_cn_cnm1' is missing; found .*Kalibr")
    refused(zed_named("RESOLUTION_HD"), r"unknown size \(RESOLUTION_HD\).*--image-size.*ZED")
    refused("1 2 3\n4 5 6\n", "not a calibration that conetl knows: expected keys and values")
    refused("$GPGGA,1: 2: 3\n$GPRMC: @\n", "not a calibration that conetl knows, found neither")
    refused("B: 1\nC: 2\n", r"not a calibration that conetl knows: found \['B', 'C'\]. Known: .*ORB-SLAM")
    four = ost("left").replace(f"{D1[4]:.15f}\n", "\n") + ost("right", size=False).replace(f"{D2[4]:.15f}\n", "\n")
    refused(four, "distortion' are 4 numbers, of plumb_bob or of equidistant.*ROS camera_info pair")


def test_two_ost_files_and_their_folder(tmp_path: Path) -> None:
    for side in ("left", "right"):
        (tmp_path / f"{side}.ini").write_text(ost(side))
    (tmp_path / "times.txt").write_text("0.0\n0.1\n")
    for path in (tmp_path, tmp_path / "left.ini", tmp_path / "right.ini"):
        agrees_with_opencv(read_rig(path))


def test_one_calibration_in_several_files_is_one(tmp_path: Path) -> None:
    """What ROS's calibrator packs together, beside a log."""
    for side in ("left", "right"):
        (tmp_path / f"{side}.yaml").write_text(yaml.safe_dump(ros_content(side)))
    (tmp_path / "log.txt").write_text("$GPGGA,094105.75,4900.1,N\n")
    found = find_rigs(sorted(tmp_path.iterdir()), SIZE)
    assert [path.name for path, _, _ in found.fitting] == ["left.yaml"] and not found.unread
    agrees_with_opencv(read_rig(tmp_path))


UNITS_M = {
    "mm": 0.001,
    "Millimetres": 0.001,
    "cm": 0.01,
    "inches": 0.0254,
    "ft": 0.3048,
    "foot": 0.3048,
    "µm": 1e-6,
    "dm": 0.1,
}


@pytest.mark.parametrize("unit", UNITS_M)
@pytest.mark.parametrize("kind", ["kalibr", "ros", "opencv", "orbslam", "kitti", "kitti_rectified", "rig"])
def test_lengths_in_any_unit(tmp_path: Path, kind: str, unit: str) -> None:
    baseline = 0.35 / UNITS_M[unit]
    t = [-baseline, 0.0, 0.0]
    camera = "{width_px: 1280, height_px: 720, fx_px: 902.5, fy_px: 898.1, cx_px: 641.3, cy_px: 355.2}"
    content, p = kalibr_content(), ros_content("right")["projection_matrix"]["data"][3]
    content["cam1"]["T_cn_cnm1"] = se3.se3(np.eye(3), t).tolist()
    wide = {"K1": K1, "K2": K1, "R": np.eye(3), "D1": np.zeros(4), "D2": np.zeros(4), "T": t, "image_size": SIZE}
    text = {
        "kalibr": yaml.safe_dump(content), "orbslam": ORB3_RECTIFIED.replace("0.35", repr(baseline)),
        "opencv": yaml.safe_dump({name: np.asarray(value).tolist() for name, value in wide.items()}),
        "kitti_rectified": f"P2: {rows(projection(np.zeros(3)))}\nP3: {rows(projection(np.array(t)), '.17g')}\n",
        "kitti": KITTI_360.replace(rows(projection(PARALLEL)), rows(projection(np.array(t)), ".17g")),
        "rig": f"left: {camera}\nright: {camera}\nbaseline_m: {baseline!r}\n",
        "ros": ost("left") + ost("right", size=False).replace(f"{p:.15f}", f"{p / UNITS_M[unit]:.15f}"),
    }[kind]  # fmt: skip
    path = tmp_path / "calib.yaml"
    path.write_text(text)
    options = {"image_size": SIZE} if kind == "kitti_rectified" else {}
    wanted = float(np.linalg.norm(T)) if kind == "ros" else 0.35
    assert read_rig(path, length_unit=unit, **options).baseline_m == pytest.approx(wanted, rel=1e-6)
    if unit in ("mm", "cm", "µm"):
        with pytest.raises(InputError, match="another unit"):
            read_rig(path, **options)


@pytest.mark.parametrize("kind", ["opencv", "kalibr"])
@pytest.mark.parametrize(("size", "centre", "wanted"), [
    ([720, 1280], (640, 360), (1280, 720)), ([1280, 720], (640, 360), (1280, 720)), ([480, 640], (325, 236), (640, 480)),
    ([1024, 1280], (630, 520), (1280, 1024)), ([1280, 1280], (600, 700), (1280, 1280)), ([1000, 1024], (512, 500), (1000, 1024)),
    ([1242, 375], (450, 250), (1242, 375)), ([375, 1242], (450, 250), (1242, 375)),
])  # fmt: skip
def test_the_order_of_a_size_shows_in_the_principal_point(
    tmp_path: Path, kind: str, size: list[int], centre: tuple[int, int], wanted: tuple[int, int]
) -> None:
    """An almost square size is not turned."""
    k = [[900.0, 0, centre[0]], [0, 900.0, centre[1]], [0, 0, 1]]
    opencv = {
        "K1": k,
        "D1": [0.0] * 4,
        "K2": k,
        "D2": [0.0] * 4,
        "R": np.eye(3).tolist(),
        "T": [-0.3, 0, 0],
        "imageSize": size,
    }
    content = kalibr_content()
    for camera in content.values():
        camera |= {"intrinsics": [900.0, 900.0, *centre], "resolution": size}
    path = tmp_path / "stereo.yaml"
    path.write_text(yaml.safe_dump(opencv if kind == "opencv" else content))
    left = read_rig(path).left
    assert (left.width_px, left.height_px) == wanted


def test_texts_of_other_programs(tmp_path: Path) -> None:
    """Latin-1 in a comment, and UTF-16 as Windows writes it."""
    path = tmp_path / "stereo.yml"
    text = opencv_list([1280, 720]).replace("---\n", "---\n# Prüfstand, geöffnet\n")
    for encoding in ("utf-8", "cp1252", "utf-16"):
        path.write_bytes(text.encode(encoding))
        agrees_with_opencv(read_rig(path))


@pytest.mark.parametrize("text", ['{"a":' * 900 + "1" + "}" * 900, "<a>" * 900 + "</a>" * 900, "a: " + "[" * 900])
def test_a_file_that_is_nested_deeply_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "calib.txt"
    for more in ("", "<opencv_storage>"):
        path.write_text(f"{more}{text}{more.replace('<', '</')}")
        with pytest.raises(
            InputError, match=r"nested too deeply|exceeds|not a calibration|not YAML|not XML|keys and values"
        ):
            read_rig(path)


@pytest.mark.parametrize(
    "text",
    ["\n" * 400_000, " " * 400_000, "a" * 400_000, f"P2: {'1' * 400_000}x", "1 " * 200_000, "[a" * 100_000],
)
def test_long_texts_take_no_time(tmp_path: Path, text: str) -> None:
    """Expressions that go back over a text would take minutes."""
    path = tmp_path / "calib.txt"
    path.write_text(text)
    with pytest.raises(InputError):
        read_rig(path)


def test_a_message_has_no_control_characters(tmp_path: Path) -> None:
    for text in (
        "P2\x1b[31m: 1 2 3\n",
        "cam0:\n  \x07intrinsics: 1\ncam1: {a: 1}\n",
        "[LEFT_CAM_\x1b[2J]\nfx=1\n",
        '{"a\\u001b[1m": 1}',
    ):
        path = tmp_path / "calib.txt"
        path.write_text(text)
        with pytest.raises(InputError) as raised:
            read_rig(path)
        assert str(raised.value).isprintable()


@pytest.mark.parametrize("letters", ["KDRP", "kdrp"])
@pytest.mark.parametrize("end", ["", "---\n", "---\nheader: {}\n---\n"])
def test_messages_of_ros_as_text(letters: str, end: str, tmp_path: Path) -> None:
    """`rostopic echo /left/camera_info > left.yaml`."""
    k, d, r, p = letters
    for side, shift in (("left", 0.0), ("right", -640.0 * 0.5374)):
        (tmp_path / f"{side}.yaml").write_text(
            f"# of a camera\nheader:\n  frame_id: {side}\nheight: 320\nwidth: 960\ndistortion_model: plumb_bob\n"
            f"{d}: [0, 0, 0, 0, 0]\n{k}: [640, 0, 478.35, 0, 640, 146.2, 0, 0, 1]\n{r}: [1, 0, 0, 0, 1, 0, 0, 0, 1]\n"
            f"{p}: [640, 0, 478.35, {shift}, 0, 640, 146.2, 0, 0, 0, 1, 0]\nbinning_x: 0\nbinning_y: 0\n"
            f"roi:\n  x_offset: 0\n  width: 0\n  do_rectify: false\n{end}"
        )
    rig, kind = read_rig_and_format(tmp_path / "left.yaml")
    assert kind == "ros" and rig.baseline_m == pytest.approx(0.5374) and rig.left.cx_px == 478.35
    text = (tmp_path / "right.yaml").read_text()
    for old, new in (("binning_x: 0", "binning_x: 2"), ("width: 0", "width: 800")):
        (tmp_path / "right.yaml").write_text(text.replace(old, new))
        with pytest.raises(InputError, match="cropped or binned"):
            read_rig_and_format(tmp_path / "left.yaml")


def test_what_is_not_a_stereo_calibration_is_not_called_one(tmp_path: Path) -> None:
    path = tmp_path / "camera.xml"
    path.write_text("<calibration><projection>frame</projection><width>960</width><f>640</f></calibration>")
    with pytest.raises(InputError, match="not a calibration that conetl knows"):
        read_rig_and_format(path)
    path = tmp_path / "stereo.npz"
    np.savez(path, K1=np.eye(3))
    with pytest.raises(InputError, match=r"NumPy and pickle are not read: write .* as JSON or YAML"):
        read_rig_and_format(path)
