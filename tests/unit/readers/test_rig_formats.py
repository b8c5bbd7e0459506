"""Calibrations of other tools: each format by its own formula, round trips, one sentence for bad files."""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import scipy.io
import yaml
from scipy.spatial.transform import Rotation

from conetl.files.documents import MAX_JSON_BYTES
from conetl.geometry import camera as cam
from conetl.geometry import pose as se3
from conetl.geometry import rig as rigs
from conetl.model.errors import InputError
from conetl.model.rig import Camera, Lens, Rig
from conetl.readers.rigs import WRITERS, read_rig, read_rig_and_format
from conetl.readers.rigs.common import rig_of
from tests.prepared import prepared

SIZE = (1280, 720)
K1 = np.array([[902.5, 0, 641.3], [0, 898.1, 355.2], [0, 0, 1.0]])
K2 = np.array([[911.0, 0, 633.8], [0, 907.7, 362.9], [0, 0, 1.0]])
D1 = np.array([-0.31, 0.12, 1.1e-3, -7e-4, -0.02])
D2 = np.array([-0.29, 0.10, -4e-4, 9e-4, -0.01])
FISHEYE = np.array([0.02, -0.01, 0.004, -0.0008])
R = Rotation.from_rotvec([0.01, -0.02, 0.005]).as_matrix()
T = np.array([-0.274, 0.003, 0.004])
POINTS = np.array([[0.4, 0.3, 5.0], [-1.2, 0.5, 6.0], [1.9, -0.8, 9.0], [0.0, 0.9, 3.0]])
LENSES = {
    "none": Lens(),
    "radial": Lens(model="radial", coefficients=(-0.2, 0.05)),
    "brown": Lens(model="brown", coefficients=tuple(D1)),
    "no k3": Lens(model="brown", coefficients=(-0.2, 0.05, 1e-3, -2e-3, 0.0)),
    "rational": Lens(model="rational", coefficients=(1.5, 0.4, 4e-4, -3e-4, 0.02, 1.9, 0.8, 0.1)),
    "fisheye": Lens(model="fisheye", coefficients=tuple(FISHEYE)),
}


def make_rig(
    lens: Lens, turn: tuple[float, ...] = (0.01, -0.02, 0.005), t: tuple[float, ...] = (0.27, 0.004, -0.003)
) -> Rig:
    left = Camera(width_px=1280, height_px=720, fx_px=902.5, fy_px=898.1, cx_px=641.3, cy_px=355.2, lens=lens)
    right = left.model_copy(update={"fx_px": 911.0, "fy_px": 907.7, "cx_px": 633.8, "cy_px": 362.9})
    return rig_of("made", left, right, se3.se3(Rotation.from_rotvec(turn).as_matrix(), t), rig_id="made")


def same_geometry(a: Rig, b: Rig) -> None:
    for side in ("left", "right"):
        one, two = rigs.camera_of(a, side), rigs.camera_of(b, side)
        assert (one.width_px, one.height_px, one.lens.model) == (two.width_px, two.height_px, two.lens.model)
        np.testing.assert_allclose(cam.intrinsics(one), cam.intrinsics(two), rtol=1e-12)
        np.testing.assert_allclose(one.lens.coefficients, two.lens.coefficients, rtol=1e-12)
    np.testing.assert_allclose(rigs.left_SE3_right(a), rigs.left_SE3_right(b), atol=1e-12)


def images_of(rig: Rig) -> tuple[np.ndarray, np.ndarray]:
    """Image points of POINTS (in the left camera) by conetl."""
    in_right = se3.apply(se3.invert(rigs.left_SE3_right(rig)), POINTS)
    return cam.project(rig.left, POINTS), cam.project(rig.right, in_right)


def images_by_opencv() -> tuple[np.ndarray, np.ndarray]:
    """The same by OpenCV's own formula from K1, D1, K2, D2, R, T."""
    left = cv2.projectPoints(POINTS, np.zeros(3), np.zeros(3), K1, D1)[0].reshape(-1, 2)
    return left, cv2.projectPoints(POINTS, cv2.Rodrigues(R)[0], T, K2, D2)[0].reshape(-1, 2)


def agrees_with_opencv(rig: Rig) -> None:
    for ours, theirs in zip(images_of(rig), images_by_opencv(), strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-6)


def agrees_with_opencvs_fisheye(rig: Rig) -> None:
    theirs, _ = cv2.fisheye.projectPoints(POINTS[:, None], cv2.Rodrigues(R)[0], T, K2, FISHEYE)
    np.testing.assert_allclose(images_of(rig)[1], theirs.reshape(-1, 2), atol=1e-6)


# --------------------------------------------------------------------------- each format by its own formula


def opencv_text(path: Path, values: dict[str, Any]) -> Path:
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for key, value in values.items():
        storage.write(key, value)
    storage.release()
    return path


@pytest.mark.parametrize("suffix", [".yml", ".xml", ".json"])
def test_opencv_stereo_file(tmp_path: Path, suffix: str) -> None:
    values = {"M1": K1, "D1": D1, "M2": K2, "D2": D2, "R": R, "T": T[:, None], "image_width": 1280, "image_height": 720}
    rig, found = read_rig_and_format(opencv_text(tmp_path / f"stereo{suffix}", values))
    assert found == "opencv"
    agrees_with_opencv(rig)


def test_opencv_sample_with_two_files_without_size_in_millimetres(tmp_path: Path) -> None:
    opencv_text(tmp_path / "intrinsics.yml", {"M1": K1, "D1": D1, "M2": K2, "D2": D2})
    opencv_text(tmp_path / "extrinsics.yml", {"R": R, "T": 1000 * T[:, None], "Q": np.eye(4)})
    with pytest.raises(InputError, match=r"image_width, image_height.*--image-size"):
        read_rig(tmp_path)
    with pytest.raises(InputError, match=r"baseline is 274 m.*--unit mm"):
        read_rig(tmp_path, image_size=SIZE)
    for path in (tmp_path, tmp_path / "intrinsics.yml", tmp_path / "extrinsics.yml"):
        agrees_with_opencv(read_rig(path, image_size=SIZE, length_unit="mm"))


def test_opencv_single_camera_files(tmp_path: Path) -> None:
    for name, k, d in (("left", K1, D1), ("right", K2, D2)):
        opencv_text(tmp_path / f"{name}.yml", {
            "image_width": 1280, "image_height": 720, "camera_matrix": k, "distortion_coefficients": d[:, None],
        })  # fmt: skip
    with pytest.raises(InputError, match=r"'R' \(R\) is missing"):
        read_rig(tmp_path)
    opencv_text(tmp_path / "extrinsics.yml", {"R": cv2.Rodrigues(R)[0], "T": T})
    agrees_with_opencv(read_rig(tmp_path))


def test_plain_yaml_with_opencvs_names(tmp_path: Path) -> None:
    path = tmp_path / "stereo.yaml"
    values = {name: value.tolist() for name, value in {"K1": K1, "D1": D1, "K2": K2, "D2": D2, "R": R, "T": T}.items()}
    path.write_text(yaml.safe_dump({**values, "image_size": list(SIZE)}))
    agrees_with_opencv(read_rig(path))


def test_opencv_fisheye(tmp_path: Path) -> None:
    values = {"M1": K1, "D1": FISHEYE, "M2": K2, "D2": FISHEYE, "R": R, "T": T, "image_size": np.array(SIZE)}
    agrees_with_opencvs_fisheye(read_rig(opencv_text(tmp_path / "stereo.yml", values | {"fisheye_model": 1})))


def kalibr_content() -> dict[str, Any]:
    both = {"camera_model": "pinhole", "distortion_model": "radtan", "resolution": list(SIZE), "rostopic": "/cam"}
    return {
        "cam0": {**both, "intrinsics": [902.5, 898.1, 641.3, 355.2], "distortion_coeffs": D1[:4].tolist()},
        "cam1": {**both, "intrinsics": [911.0, 907.7, 633.8, 362.9], "distortion_coeffs": D2[:4].tolist(),
                 "T_cn_cnm1": se3.se3(R, T).tolist()},
    }  # fmt: skip


def test_kalibr_camchain(tmp_path: Path) -> None:
    path = tmp_path / "front-camchain.yaml"
    path.write_text(yaml.safe_dump(kalibr_content()))
    rig, found = read_rig_and_format(tmp_path)
    assert found == "kalibr"
    theirs = cv2.projectPoints(POINTS, cv2.Rodrigues(R)[0], T, K2, D2[:4])[0].reshape(-1, 2)
    np.testing.assert_allclose(images_of(rig)[1], theirs, atol=1e-6)


def ros_content(side: str) -> dict[str, Any]:
    """What ROS's calibrator writes: its rectification comes from cv2.stereoRectify."""
    r1, r2, p1, p2 = cv2.stereoRectify(K1, D1, K2, D2, SIZE, R, T[:, None], alpha=0)[:4]
    k, d, r, p = (K1, D1, r1, p1) if side == "left" else (K2, D2, r2, p2)

    def matrix(a: np.ndarray) -> dict[str, Any]:
        return {"rows": a.shape[0], "cols": a.shape[1], "data": a.reshape(-1).tolist()}

    return {
        "image_width": 1280, "image_height": 720, "camera_name": f"narrow/{side}", "camera_matrix": matrix(k),
        "distortion_model": "plumb_bob", "distortion_coefficients": matrix(d[None]), "rectification_matrix": matrix(r),
        "projection_matrix": matrix(p),
    }  # fmt: skip


def ros_pair(folder: Path) -> Path:
    for side in ("left", "right"):
        (folder / f"{side}.yaml").write_text(yaml.safe_dump(ros_content(side)))
    return folder


def test_ros_pair_gives_the_raw_rig_that_it_was_made_from(tmp_path: Path) -> None:
    ros_pair(tmp_path)
    for path in (tmp_path, tmp_path / "left.yaml", tmp_path / "right.yaml"):
        rig, found = read_rig_and_format(path)
        assert found == "ros"
        agrees_with_opencv(rig)


def test_ros_cameras_calibrated_one_by_one_need_extrinsics(tmp_path: Path) -> None:
    for side in ("left", "right"):
        content = ros_content(side)
        content["rectification_matrix"]["data"] = np.eye(3).reshape(-1).tolist()
        content["projection_matrix"]["data"][3] = 0.0
        (tmp_path / f"{side}.yaml").write_text(yaml.safe_dump(content))
    with pytest.raises(InputError, match="calibrated separately"):
        read_rig(tmp_path)
    relative = {"R": R.T.tolist(), "t_m": (-R.T @ T).tolist()}
    (tmp_path / "extrinsics.yaml").write_text(yaml.safe_dump({"left_SE3_right": relative}))
    agrees_with_opencv(read_rig(tmp_path))


def matlab_content(*, new: bool) -> dict[str, Any]:
    """stereoParameters by MATLAB's rules: pixels from one, transposed matrices, millimetres, [rows columns]."""
    content: dict[str, Any] = {"WorldUnits": "millimeters", "NumPatterns": 12}
    for number, k, d in ((1, K1, D1), (2, K2, D2)):
        ones = k + np.array([[0, 0, 1], [0, 0, 1], [0, 0, 0]])
        content[f"CameraParameters{number}"] = {
            "RadialDistortion": [d[0], d[1], d[4]], "TangentialDistortion": [d[2], d[3]], "ImageSize": [720, 1280],
            **({"K": ones.tolist()} if new else {"IntrinsicMatrix": ones.T.tolist()}),
        }  # fmt: skip
    if new:
        content["PoseCamera2"] = {"Dimensionality": 3, "R": R.tolist(), "Translation": (1000 * T).tolist()}
    else:
        content |= {"RotationOfCamera2": R.T.tolist(), "TranslationOfCamera2": (1000 * T).tolist()}
    return content


@pytest.mark.parametrize("new", [False, True])
@pytest.mark.parametrize("wrapped", [False, True])
def test_matlab_structure_as_json_and_mat(tmp_path: Path, new: bool, wrapped: bool) -> None:
    content = matlab_content(new=new)
    if wrapped:
        content = {"stereoParams": content}
    (tmp_path / "stereo.json").write_text(json.dumps(content))
    scipy.io.savemat(tmp_path / "stereo.mat", {"s": content} if not wrapped else content)
    for name in ("stereo.json", "stereo.mat"):
        rig, found = read_rig_and_format(tmp_path / name)
        assert found == "matlab"
        agrees_with_opencv(rig)
        assert rig.left.cx_px == pytest.approx(641.3), "MATLAB counts pixels from one"


# --------------------------------------------------------------------------- round trips


def target(folder: Path, kind: str) -> Path:
    return {"rig": folder / "rig.yaml", "opencv": folder / "stereo.yml", "kalibr": folder / "camchain.yaml", "ros": folder,
            "matlab": folder / "stereo.json"}[kind]  # fmt: skip


def rig_with(lens: str) -> Rig:
    return make_rig(Lens(), (0.0, 0.0, 0.0), (0.5, 0.0, 0.0)) if lens == "parallel" else make_rig(LENSES[lens])


@pytest.mark.parametrize("kind", WRITERS)
@pytest.mark.parametrize("lens", [*LENSES, "parallel"])
def test_round_trips(tmp_path: Path, kind: str, lens: str) -> None:
    rig, path = rig_with(lens), target(tmp_path, kind)
    WRITERS[kind](rig, path)
    again, found = read_rig_and_format(path)
    assert found == kind
    same_geometry(rig, again)


def coefficients(camera: Camera) -> list[float]:
    """As OpenCV orders them; zero where the lens has none."""
    return [*camera.lens.coefficients, *[0.0] * 5][:5]


def kalibr_of(rig: Rig) -> dict[str, Any]:
    """A camchain by Kalibr's rules."""
    cameras = [
        {
            "camera_model": "pinhole", "intrinsics": cam.intrinsics(camera).tolist(),
            "distortion_model": "equidistant" if camera.lens.model == "fisheye" else "radtan",
            "distortion_coeffs": coefficients(camera)[:4], "resolution": [camera.width_px, camera.height_px],
        }
        for camera in (rig.left, rig.right)
    ]  # fmt: skip
    return {"cam0": cameras[0], "cam1": {**cameras[1], "T_cn_cnm1": se3.invert(rigs.left_SE3_right(rig)).tolist()}}


def matlab_of(rig: Rig) -> dict[str, Any]:
    """stereoParameters by the rules of `matlab_content`."""
    right_SE3_left = se3.invert(rigs.left_SE3_right(rig))
    content: dict[str, Any] = {
        "RotationOfCamera2": right_SE3_left[:3, :3].T.tolist(),
        "TranslationOfCamera2": (1000 * right_SE3_left[:3, 3]).tolist(),
        "WorldUnits": "millimeters",
    }
    for number, camera in ((1, rig.left), (2, rig.right)):
        k1, k2, p1, p2, k3 = coefficients(camera)
        ones = cam.matrix_k(camera) + np.array([[0, 0, 1], [0, 0, 1], [0, 0, 0]])
        content[f"CameraParameters{number}"] = {
            "RadialDistortion": [k1, k2, k3], "TangentialDistortion": [p1, p2],
            "ImageSize": [camera.height_px, camera.width_px], "IntrinsicMatrix": ones.T.tolist(),
        }  # fmt: skip
    return content


@pytest.mark.parametrize("lens", ["none", "radial", "no k3", "fisheye", "parallel"])
def test_kalibr_with_any_lens(tmp_path: Path, lens: str) -> None:
    rig, path = rig_with(lens), target(tmp_path, "kalibr")
    path.write_text(yaml.safe_dump(kalibr_of(rig)))
    same_geometry(rig, read_rig(path))


@pytest.mark.parametrize("lens", ["none", "radial", "brown", "no k3", "parallel"])
def test_matlab_with_any_lens(tmp_path: Path, lens: str) -> None:
    rig, path = rig_with(lens), target(tmp_path, "matlab")
    path.write_text(json.dumps(matlab_of(rig)))
    same_geometry(rig, read_rig(path))


# --------------------------------------------------------------------------- bad files


@prepared
def change(content: dict[str, Any], keys: str, value: Any) -> None:
    """An edit of nested content; value None removes the key."""
    *way, last = keys.split("/")
    for key in way:
        content = content[key]
    if value is None:
        del content[last]
    else:
        content[last] = value


BAD_KALIBR = {
    "no cam1": (change("cam1", None), "cam0.*cam1"),
    "no intrinsics": (change("cam0/intrinsics", None), "'cam0.intrinsics' is missing"),
    "NaN": (change("cam1/intrinsics", [float("nan"), 1, 2, 3]), "'cam1.intrinsics' must be finite"),
    "three numbers": (change("cam0/intrinsics", [1, 2, 3]), "'cam0.intrinsics' must be 4 numbers, found 3"),
    "omni": (change("cam0/camera_model", "omni"), "'cam0.camera_model' 'omni' is not supported"),
    "fov": (change("cam1/distortion_model", "fov"), "'cam1.distortion_model' 'fov' is not supported"),
    "list": (change("cam1/distortion_model", ["radtan"]), r"'cam1.distortion_model' \['radtan'\] is not supported"),
    "no pose": (change("cam1/T_cn_cnm1", None), "'cam1.T_cn_cnm1' is missing"),
    "3x4": (change("cam1/T_cn_cnm1", np.eye(4)[:3].tolist()), "'cam1.T_cn_cnm1' must be 4 x 4 numbers, found 3 x 4"),
    "swapped": (change("cam1/T_cn_cnm1", (np.eye(4) + 0.3 * np.eye(4, k=3)).tolist()), "T_cn_cnm1.*swapped"),
    "no rotation": (change("cam1/T_cn_cnm1", np.diag([1, 2, 1, 1]).tolist()), "T_cn_cnm1.*not a rigid motion"),
    "words": (change("cam0/resolution", "big"), "'cam0.resolution' must be numbers"),
    "half pixels": (change("cam0/resolution", [640.5, 480]), "'cam0.resolution' must be whole numbers"),
    "another image": (change("cam0/resolution", [160, 120]), "'cam0.intrinsics' cannot be used: the principal point"),
    "far": (change("cam1/T_cn_cnm1", (np.eye(4) - 1.5e9 * np.eye(4, k=3)).tolist()), r"T_cn_cnm1.*baseline is 1.5e\+09 m"),
    "negative f": (change("cam0/intrinsics", [-900, 900, 640, 360]), "'cam0.intrinsics' must have positive focal"),
}  # fmt: skip
BAD_MATLAB = {
    "no camera": (change("CameraParameters2", None), "'CameraParameters2' is missing"),
    "no matrix": (change("CameraParameters1/IntrinsicMatrix", None), "'CameraParameters1.IntrinsicMatrix' is missing"),
    "not transposed": (change("CameraParameters1/IntrinsicMatrix", K1.tolist()), "CameraParameters1.IntrinsicMatrix"),
    "skew": (change("CameraParameters1/IntrinsicMatrix", [[900, 0, 0], [3, 900, 0], [640, 360, 1]]), "a skew of 3"),
    "four radial": (change("CameraParameters2/RadialDistortion", [1, 2, 3, 4]), "must be 2 or 3 numbers, found 4"),
    "no size": (change("CameraParameters1/ImageSize", []), "'CameraParameters1.ImageSize'.*--image-size"),
    "NaN": (change("TranslationOfCamera2", [float("nan"), 0, 0]), "'TranslationOfCamera2' must be finite"),
    "swapped": (change("TranslationOfCamera2", [274.0, 0, 0]), "TranslationOfCamera2.*swapped"),
    "no pose": (change("RotationOfCamera2", None), "'PoseCamera2' is missing"),
    "far": (change("TranslationOfCamera2", [-1.5e12, 0, 0]), r"baseline is 1.5e\+09 m"),
    "unit": (change("WorldUnits", "squares"), "'length unit' 'squares' is not a known unit"),
}  # fmt: skip
BAD_ROS = {
    "no projection": (change("projection_matrix", None), "'projection_matrix' is missing"),
    "rows": (change("camera_matrix/rows", 4), "'camera_matrix' has 4 rows and 3 columns, but 9 numbers"),
    "true rows": (change("camera_matrix/rows", True), "'camera_matrix' has True rows and 3 columns, but 9 numbers"),
    "negative rows": (change("camera_matrix", {"rows": -3, "cols": -3, "data": [1.0] * 9}), "'camera_matrix' has -3 rows"),
    "long rows": (change("camera_matrix/rows", "3" * 5000), r"'camera_matrix' has '3{9,99}\.\.\.3+' rows"),
    "model": (change("distortion_model", "double_sphere"), "'distortion_model' 'double_sphere' is not supported"),
    "count": (change("distortion_coefficients/data", [1.0, 2.0, 3.0]), "'distortion_coefficients' has"),
    "rotation": (change("rectification_matrix/data", [1.0] * 9), "'rectification_matrix' is not a rotation"),
    "far": (change("projection_matrix/data", [900, 0, 640, -9e12, 0, 900, 360, 0, 0, 0, 1, 0]), r"baseline is 1e\+10 m"),
    "baseline": (change("projection_matrix/data", [900, 0, 640, 250, 0, 900, 360, 0, 0, 0, 1, 0]), "projection_matrix.*swapped"),
}  # fmt: skip
BAD_OPENCV = {
    "no D2": (change("D2", None), r"'M?D?.*' \(right distortion\) is missing"),
    "no T": (change("T", None), r"'T' \(T\) is missing"),
    "2x2": (change("M1", np.eye(2)), "'M1' must be 3 x 3 numbers, found 2 x 2"),
    "NaN": (change("M2", np.full((3, 3), np.nan)), "'M2' must be finite"),
    "six": (change("D1", np.ones(6)), "'D1' must be 0, 4, 5, 8, 12 or 14 coefficients.*found 6"),
    "prism": (change("D1", np.ones(12)), "'D1' holds thin-prism"),
    "swapped": (change("T", -T), "'R, T'.*swapped"),
    "far": (change("T", np.array([-270.0, 0, 0])), "'R, T' cannot be used: the baseline is 270 m, expected 0.01 to 10 m"),
    "depth": (change("T", np.array([-0.2, 0, 0.5])), "'R, T'.*does not follow the image rows"),
    "lens": (change("distortion_model", "ftheta"), "'distortion_model' 'ftheta' is not a known lens model"),
}  # fmt: skip


def complaint(path: Path, message: str, named: Path | None = None, **options: Any) -> None:
    with pytest.raises(InputError, match=message) as raised:
        read_rig(path, **options)
    assert str(raised.value).startswith(str(named or path)), "the file is not named"
    assert len(str(raised.value)) < 900


def broken(folder: Path, tool: str, break_it: Callable[[dict[str, Any]], None]) -> tuple[Path, Path]:
    """A calibration with one fault: what is read, and the file with the fault."""
    path = target(folder, tool)
    content = {
        "kalibr": kalibr_content(), "matlab": matlab_content(new=False), "ros": ros_content("right"),
        "opencv": {"M1": K1, "D1": D1, "M2": K2, "D2": D2, "R": R, "T": T, "image_size": np.array(SIZE)},
    }[tool]  # fmt: skip
    break_it(content)
    if tool == "opencv":
        return path, opencv_text(path, content)
    file = ros_pair(path) / "right.yaml" if tool == "ros" else path
    file.write_text(json.dumps(content) if tool == "matlab" else yaml.safe_dump(content))
    return path, file


BAD = {"kalibr": BAD_KALIBR, "matlab": BAD_MATLAB, "ros": BAD_ROS, "opencv": BAD_OPENCV}


@pytest.mark.parametrize(("tool", "name"), [(tool, name) for tool, faults in BAD.items() for name in faults])
def test_a_broken_file(tmp_path: Path, tool: str, name: str) -> None:
    break_it, message = BAD[tool][name]
    path, file = broken(tmp_path, tool, break_it)
    complaint(path, message, file)


def test_files_that_are_cut_off_or_of_another_kind(tmp_path: Path) -> None:
    whole = opencv_text(tmp_path / "stereo.yml", {"M1": K1}).read_text()
    (tmp_path / "cut.yml").write_text(whole[: len(whole) // 2])
    complaint(tmp_path / "cut.yml", "this is not YAML")
    (tmp_path / "cut.json").write_text('{"CameraParameters1": {')
    complaint(tmp_path / "cut.json", "not JSON")
    (tmp_path / "cut.mat").write_bytes(b"MATLAB 5.0 MAT-file" + b"\0" * 200)
    complaint(tmp_path / "cut.mat", "not a .mat file|no structure")
    scipy.io.savemat(tmp_path / "other.mat", {"a": 1})
    complaint(tmp_path / "other.mat", "not a calibration that conetl knows: found")
    (tmp_path / "left_cam.yaml").write_text(yaml.safe_dump(ros_content("left")))
    complaint(tmp_path / "left_cam.yaml", "right_cam.yaml is missing")
    (tmp_path / "cam.yaml").write_text(yaml.safe_dump(ros_content("left")))
    complaint(tmp_path / "cam.yaml", "name the files left.yaml and right.yaml")


def test_world_units_that_are_numbers_are_millimetres(tmp_path: Path) -> None:
    path = tmp_path / "stereo.mat"
    scipy.io.savemat(path, {"s": matlab_content(new=False) | {"WorldUnits": np.ones(3)}})
    assert read_rig(path).baseline_m == pytest.approx(float(np.linalg.norm(T)))


def mat_element(kind: int, content: bytes) -> bytes:
    return struct.pack("<II", kind, len(content)) + content


def test_a_mat_file_beyond_the_limits_is_refused(tmp_path: Path) -> None:
    """Too many bytes, few that become many, and structures in structures."""
    path = tmp_path / "stereo.mat"
    scipy.io.savemat(path, {"a": np.zeros(MAX_JSON_BYTES // 8)})
    complaint(path, "at most 5,000,000 bytes")
    scipy.io.savemat(path, {"a": np.zeros(MAX_JSON_BYTES // 8)}, do_compression=True)
    assert path.stat().st_size < 10_000
    complaint(path, "at most 5,000,000 bytes uncompressed")
    scipy.io.savemat(path, {"a": 1.0})
    header = path.read_bytes()[:128]
    start = (
        mat_element(6, bytes([2, 0, 0, 0, 0, 0, 0, 0])) + mat_element(5, struct.pack("<ii", 1, 1)) + mat_element(1, b"")
    )
    start += struct.pack("<HHi", 5, 4, 8) + mat_element(1, b"inner\0\0\0")
    structure = b""
    for _ in range(500):
        structure = mat_element(14, start + structure)
    for content in (structure, mat_element(15, zlib.compress(structure))):
        path.write_bytes(header + content)
        complaint(path, "nested too deeply")


def test_a_folder_with_two_calibrations_is_not_guessed_at(tmp_path: Path) -> None:
    ros_pair(tmp_path)
    (tmp_path / "camchain.yaml").write_text(yaml.safe_dump(kalibr_content()))
    complaint(tmp_path, "found camchain.yaml and left.yaml")


def test_a_size_is_only_for_files_without_it(tmp_path: Path) -> None:
    path = tmp_path / "camchain.yaml"
    path.write_text(yaml.safe_dump(kalibr_content()))
    with pytest.raises(InputError, match="leave them out"):
        read_rig(path, image_size=SIZE)


def test_opencv_writes_no_rig_that_it_cannot_hold(tmp_path: Path) -> None:
    rig = make_rig(Lens())
    small = rig.model_copy(update={"right": rig.right.model_copy(update={"width_px": 640})})
    with pytest.raises(InputError, match="one image size"):
        WRITERS["opencv"](small, tmp_path / "a.yml")
    mixed = rig.model_copy(update={"right": rig.right.model_copy(update={"lens": LENSES["fisheye"]})})
    with pytest.raises(InputError, match="two fisheye lenses or none"):
        WRITERS["opencv"](mixed, tmp_path / "a.yml")
    with pytest.raises(InputError, match=r"end in \.yml"):
        WRITERS["opencv"](rig, tmp_path / "a.txt")


def test_a_key_that_is_a_section_too_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "calib.txt"
    path.write_text("a: 1 2\n[a]\nb=1\n")
    with pytest.raises(InputError, match="'a' is in the file twice, as a key and as a section"):
        read_rig(path)
