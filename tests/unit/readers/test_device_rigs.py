"""Calibrations that cameras and Metashape bring along, and rigs of more than two cameras: each by its own formula."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from conetl.geometry import camera as cam
from conetl.geometry import pose as se3
from conetl.geometry import rig as rigs
from conetl.model.errors import InputError
from conetl.model.rig import Rig
from conetl.readers.rigs import read_rig, read_rig_and_format, read_rig_for_images
from tests.unit.readers.test_rig_formats import (
    D1,
    D2,
    FISHEYE,
    K1,
    K2,
    LENSES,
    SIZE,
    R,
    T,
    agrees_with_opencv,
    agrees_with_opencvs_fisheye,
    change,
    complaint,
    kalibr_content,
    make_rig,
    ros_content,
)

# --------------------------------------------------------------------------- ZED


def zed_text(
    *, shared_lens: bool = False, resolutions: tuple[str, ...] = ("2K", "HD"), stereo: dict[str, str] | None = None
) -> str:
    """What Stereolabs' calibration tool writes of OpenCV's K1, D1, K2, D2, R, T; other resolutions have other numbers."""
    lines = []
    for side, k, d in (("LEFT", K1, D1), ("RIGHT", K2, D2)):
        lens = dict(zip(("k1", "k2", "p1", "p2", "k3"), d, strict=True))
        for name in resolutions:
            factor = 1.0 if name == "HD" else 1.5
            values = {"fx": k[0, 0], "fy": k[1, 1], "cx": k[0, 2], "cy": k[1, 2]}
            values = {key: factor * value for key, value in values.items()} | ({} if shared_lens else lens)
            lines += [f"[{side}_CAM_{name}]", *(f"{key}={float(value)!r}" for key, value in values.items()), ""]
        if shared_lens:
            more = dict.fromkeys(("k4", "k5", "k6"), 0)
            lines += [f"[{side}_DISTO]", *(f"{key} = {float(value)!r}" for key, value in (lens | more).items()), ""]
    x, y, z = cv2.Rodrigues(R)[0].ravel()
    found = {"Baseline": -1000 * T[0], "TY": 1000 * T[1], "TZ": 1000 * T[2]}
    for name in resolutions:
        found |= {f"CV_{name}": y, f"RX_{name}": x, f"RZ_{name}": z}
    return "\n".join(
        [*lines, "[STEREO]", *(f"{key}={float(value)!r}" for key, value in (found | (stereo or {})).items()), ""]
    )


@pytest.mark.parametrize("shared_lens", [False, True])
def test_zed_factory_file(tmp_path: Path, shared_lens: bool) -> None:
    path = tmp_path / "SN1010.conf"
    path.write_text(zed_text(shared_lens=shared_lens))
    rig, found = read_rig_and_format(path, image_size=SIZE)
    assert found == "zed"
    agrees_with_opencv(rig)
    assert read_rig_for_images(path, SIZE).rectified_from == rig
    assert read_rig(path, image_size=(2208, 1242)).left.fx_px == pytest.approx(1.5 * K1[0, 0])


def test_a_zed_file_with_one_resolution_needs_no_size(tmp_path: Path) -> None:
    path = tmp_path / "SN1010.conf"
    path.write_text(zed_text(resolutions=("HD",)))
    agrees_with_opencv(read_rig(path))


ZED = zed_text()
BAD_ZED = {
    "no size": (ZED, r"images of 2208x1242 \(2K\), 1280x720 \(HD\); name that.*--image-size"),
    "other size": (ZED, "none is 640x480", (640, 480)),
    "negative": (ZED.replace("=274", "=-274"), "'STEREO.baseline'.* found -0.2740 m .*swapped", SIZE),
    "metres": (
        ZED.replace("Baseline=274", "Baseline=0.274 #"),
        "'STEREO.baseline'.* found 0.0002 m .*another unit",
        SIZE,
    ),
    "degrees": (ZED.replace("RX_HD=0", "RX_HD=9"), "RX_HD.*small angles in radians", SIZE),
    "no angle": (ZED.replace("CV_HD", "CV_QHD"), "'STEREO.cv_hd' is missing", SIZE),
    "no camera": (ZED.replace("RIGHT_CAM", "RIGHT"), "must have the sections LEFT_CAM_HD", SIZE),
    "no lens": (ZED.replace("k1", "q1"), "'LEFT_CAM_HD.k1' must be in one of", SIZE),
    "twice": (ZED.replace("[STEREO]", "[STEREO]\nTY=1"), "'STEREO.TY' is in the file twice", SIZE),
    "no sections": ("fx=1\n", "not a calibration that conetl knows: found \\['fx'\\]", SIZE),
    "words": (ZED.replace("cx=", "cx=about "), "'LEFT_CAM_HD.cx' must be numbers", SIZE),
}


# --------------------------------------------------------------------------- OAK


def oak_content(*, rectified: bool = True) -> dict[str, Any]:
    """An EEPROM whose cameras B (left) and C (right) have OpenCV's R and T, and A in the middle, at the end of the chain."""

    def camera(k: np.ndarray, d: np.ndarray, to: int, r: np.ndarray, t: np.ndarray) -> dict[str, Any]:
        return {
            "cameraType": 0, "width": 1280, "height": 720, "intrinsicMatrix": k.tolist(),
            "distortionCoeff": [*d, *[0.0] * 9], "specHfovDeg": 71.0,
            "extrinsics": {"rotationMatrix": r.tolist(), "toCameraSocket": to,
                           "translation": dict(zip("xyz", (100 * t).tolist(), strict=True))},
        }  # fmt: skip

    content: dict[str, Any] = {"version": 7, "cameraData": [
        [0, camera(K1, D1, -1, np.eye(3), np.zeros(3))],
        [1, camera(K1, D1, 2, R, T)],
        [2, camera(K2, D2, 0, np.eye(3), np.array([0.1, 0.0, 0.0]))],
    ]}  # fmt: skip
    if rectified:
        r1, r2 = cv2.stereoRectify(K1, D1, K2, D2, SIZE, R, T[:, None])[:2]
        content["stereoRectificationData"] = {
            "leftCameraSocket": 1, "rightCameraSocket": 2, "rectifiedRotationLeft": r1.tolist(),
            "rectifiedRotationRight": r2.tolist(),
        }  # fmt: skip
    return content


def test_oak_eeprom(tmp_path: Path) -> None:
    path = tmp_path / "calib.json"
    path.write_text(json.dumps(oak_content()))
    rig, found = read_rig_and_format(path)
    assert found == "oak"
    agrees_with_opencv(rig)
    for pair in (("1", "2"), ("CAM_B", "CAM_C"), ("b", "c")):
        agrees_with_opencv(read_rig(path, pair=pair))
    # From B over C to A, which lies 10 cm to the left of C.
    wide = rigs.left_SE3_right(read_rig(path, pair=("B", "A")))
    np.testing.assert_allclose(wide[:3, 3], -R.T @ (T + np.array([0.1, 0.0, 0.0])), atol=1e-12)


def test_an_oak_without_a_stereo_pair_is_not_guessed_at(tmp_path: Path) -> None:
    path = tmp_path / "calib.json"
    path.write_text(json.dumps(oak_content(rectified=False)))
    complaint(path, r"has 3 cameras, \['CAM_A', 'CAM_B', 'CAM_C'\]; choose the stereo pair.*--pair LEFT,RIGHT")
    agrees_with_opencv(read_rig(path, pair=("B", "C")))
    with pytest.raises(InputError, match="right camera must sit to the right"):
        read_rig(path, pair=("C", "B"))
    with pytest.raises(InputError, match="no camera 'CAM_D'"):
        read_rig(path, pair=("B", "D"))


def test_oak_fisheyes(tmp_path: Path) -> None:
    content = oak_content(rectified=False)
    for _, camera in content["cameraData"]:
        camera |= {"cameraType": 1, "distortionCoeff": [*FISHEYE, *[0.0] * 10]}
    path = tmp_path / "calib.json"
    path.write_text(json.dumps(content))
    agrees_with_opencvs_fisheye(read_rig(path, pair=("B", "C")))


def edited(edit: Callable[[dict[str, Any]], None]) -> str:
    content = oak_content()
    edit(content)
    return json.dumps(content)


def oak_camera(socket: int, edit: Callable[[dict[str, Any]], None]) -> str:
    return edited(lambda content: edit(content["cameraData"][socket][1]))


BAD_OAK = {
    "inverse": (oak_camera(1, change("extrinsics/rotationMatrix", R.T.tolist())), "stereoRectificationData.*contradicts"),
    "prism": (oak_camera(1, change("distortionCoeff", [0.1] * 14)), "cameraData.CAM_B.distortionCoeff' holds thin-prism"),
    "metres": (oak_camera(1, change("extrinsics/lengthUnit", 0)), "CAM_B.extrinsics.*baseline is 27.4 m"),
    "no chain": (oak_camera(1, change("extrinsics/toCameraSocket", -1)), "CAM_B.extrinsics' does not lead to CAM_C"),
    "panorama": (oak_camera(2, change("cameraType", 2)), "CAM_C.cameraType' 2 is not supported"),
    "no rotation": (oak_camera(1, change("extrinsics/rotationMatrix", np.ones((3, 3)).tolist())), "is not a rotation"),
    "not calibrated": (edited(lambda content: content.update(cameraData=[])), "has 0 calibrated cameras"),
    "no size": (oak_camera(1, change("width", None)), "cameraData.CAM_B.width' is missing"),
}  # fmt: skip


# --------------------------------------------------------------------------- Metashape


def metashape_text(*, extra: str = "", kind: str = "frame", scale: str = "", slave: str = "") -> str:
    """A chunk with the master (left) and a slave whose pose in the master is the inverse of OpenCV's R and T."""
    sensors = ""
    pose = f"<rotation>{' '.join(map(repr, R.T.ravel().tolist()))}</rotation>"
    pose += f"<location>{' '.join(map(repr, (-R.T @ T).tolist()))}</location>"
    for number, k, lens in ((0, K1, D1), (1, K2, D2)):
        names = ("k1", "k2", "p2", "p1", "k3") if kind == "frame" else ("k1", "k2", "k3", "k4")
        values = {"f": k[1, 1], "cx": k[0, 2] + 0.5 - 640, "cy": k[1, 2] + 0.5 - 360, "b1": k[0, 0] - k[1, 1]}
        values |= dict(zip(names, lens if kind == "frame" else FISHEYE, strict=True))
        numbers = "".join(f"<{key}>{float(value)!r}</{key}>" for key, value in values.items())
        master = ' master_id="0"' if number else ""
        sensors += (
            f'<sensor id="{number}" label="Camera {number}" type="{kind}"{master}>'
            f'<resolution width="1280" height="720"/><calibration type="{kind}" class="initial"><f>1</f></calibration>'
            f'<calibration type="{kind}" class="adjusted"><resolution width="1280" height="720"/>{numbers}{extra}</calibration>'
            f"{(slave or pose) if number else ''}</sensor>"
        )
    chunk = f'<chunk><sensors next_id="2">{sensors}</sensors>{scale}</chunk>'
    return f'<?xml version="1.0"?><document version="2.0.0">{chunk}</document>'


def test_metashape_multi_camera_system(tmp_path: Path) -> None:
    path = tmp_path / "cameras.xml"
    path.write_text(metashape_text())
    rig, found = read_rig_and_format(path)
    assert found == "metashape"
    agrees_with_opencv(rig)
    for pair in (("0", "1"), ("Camera 0", "Camera 1")):
        agrees_with_opencv(read_rig(path, pair=pair))
    with pytest.raises(InputError, match="right camera must sit to the right"):
        read_rig(path, pair=("1", "0"))


def test_metashape_equidistant_fisheye(tmp_path: Path) -> None:
    path = tmp_path / "cameras.xml"
    path.write_text(metashape_text(kind="equidistant_fisheye"))
    agrees_with_opencvs_fisheye(read_rig(path))


def test_metashape_lengths_in_another_unit_have_to_be_confirmed(tmp_path: Path) -> None:
    path = tmp_path / "cameras.xml"
    scale = "<components><component><transform><scale>2.5</scale></transform></component></components>"
    path.write_text(metashape_text(scale=scale))
    complaint(path, "'location' may be in the chunk's own unit, which is 2.5 m.*--unit m")
    agrees_with_opencv(read_rig(path, length_unit="m"))
    path.write_text(metashape_text(scale=scale.replace("2.5", "1")))
    agrees_with_opencv(read_rig(path))


BAD_METASHAPE = {
    "skew": (metashape_text(extra="<b2>2</b2>"), "a skew of 2"),
    "long label": (
        metashape_text(extra="<b2>2</b2>").replace("Camera 0", "Cam" * 4000),
        r"'Cam.{,200}\.\.\..{,200}a skew of 2",
    ),
    "k4": (metashape_text(extra="<k4>0.1</k4>"), "'Camera 0.calibration.k4' is 0.1, which conetl's lenses do not have"),
    "p3": (metashape_text(extra="<p3>1e-3</p3>"), "calibration.p3' is 0.001"),
    "unknown": (metashape_text(extra="<q7>1</q7>"), r"has \['q7'\], which conetl does not know"),
    "spherical": (metashape_text().replace('"frame" class="adj', '"spherical" class="adj'), "spherical"),
    "no pose": (metashape_text(slave=" "), "'Camera 1.rotation' is missing"),
    "short": (metashape_text(slave="<rotation>1 0 0</rotation>"), "Camera 1.rotation' must be 9 numbers, found 3"),
    "no master": (metashape_text().replace(' master_id="0"', ""), "are not in one multi-camera system"),
    "no calibration": (metashape_text().replace("calibration", "guess"), "'Camera 0.calibration' is missing"),
    "two chunks": (metashape_text().replace("</document>", "<chunk/></document>"), "one chunk, found 2"),
    "one camera": (metashape_text().replace('<sensor id="1"', '<sensor id="0"'), "has 1 cameras"),
}


BAD = {"SN1.conf": BAD_ZED, "calib.json": BAD_OAK, "cameras.xml": BAD_METASHAPE}


@pytest.mark.parametrize(("name", "fault"), [(name, fault) for name, faults in BAD.items() for fault in faults])
def test_a_bad_file_of_a_device(tmp_path: Path, name: str, fault: str) -> None:
    text, message, *image_size = BAD[name][fault]
    (tmp_path / name).write_text(text)
    complaint(tmp_path / name, message, image_size=image_size[0] if image_size else None)


# --------------------------------------------------------------------------- more than two cameras


def test_kalibr_chain_of_three(tmp_path: Path) -> None:
    content = kalibr_content()
    pose = se3.se3(Rotation.from_rotvec([0.0, 0.03, 0.0]).as_matrix(), [-0.2, 0.0, 0.01])
    content["cam2"] = {**content["cam1"], "T_cn_cnm1": pose.tolist()}
    path = tmp_path / "camchain.yaml"
    path.write_text(yaml.safe_dump(content))
    complaint(path, r"has 3 cameras, \['cam0', 'cam1', 'cam2'\]; choose the stereo pair")
    first = se3.se3(R, T)
    for pair, wanted in ((("cam0", "cam1"), first), (("cam1", "cam2"), pose), (("cam0", "cam2"), pose @ first)):
        found = rigs.left_SE3_right(read_rig(path, pair=pair))
        np.testing.assert_allclose(found, np.linalg.inv(wanted), atol=1e-9)
    with pytest.raises(InputError, match="right camera must sit to the right"):
        read_rig(path, pair=("cam2", "cam0"))


def test_ros_folder_of_more_cameras(tmp_path: Path) -> None:
    for name, side in (("front_left", "left"), ("front_right", "right"), ("rear", "left")):
        (tmp_path / f"{name}.yaml").write_text(yaml.safe_dump(ros_content(side)))
    agrees_with_opencv(read_rig(tmp_path, pair=("front_left", "front_right")))
    with pytest.raises(InputError, match=r"no camera 'side'; found \['front_left', 'front_right', 'rear'\]"):
        read_rig(tmp_path, pair=("front_left", "side"))


def rig_of_many() -> tuple[dict[str, Any], Rig, np.ndarray]:
    """A rig.yaml with three cameras, the rig of its first two, and the pose of the left one on the body."""
    rig = make_rig(LENSES["brown"])
    body = se3.se3(Rotation.from_rotvec([0.1, 0.2, 0.3]).as_matrix(), [1.0, 0.2, 0.7])
    cameras = {}
    for name, side in (("l", "left"), ("r", "right"), ("rear", "left")):
        camera = rigs.camera_of(rig, side)  # type: ignore[arg-type]
        pose = se3.compose(body, rigs.body_SE3_camera(rig, side))  # type: ignore[arg-type]
        content = camera.model_dump() | {"lens": {"model": "brown", "coefficients": [*camera.lens.coefficients]}}
        cameras[name] = content | {"body_SE3_camera": {"R": pose[:3, :3].tolist(), "t_m": pose[:3, 3].tolist()}}
    return {"rig_id": "van", "cameras": cameras}, rig, body


def test_rig_yaml_with_cameras_by_name(tmp_path: Path) -> None:
    content, rig, body = rig_of_many()
    path = tmp_path / "rig.yaml"
    path.write_text(yaml.safe_dump(content))
    complaint(path, r"has 3 cameras, \['l', 'r', 'rear'\]; choose the stereo pair")
    found = read_rig(path, pair=("l", "r"))
    assert found.rig_id == "van-l-r"
    np.testing.assert_allclose(rigs.left_SE3_right(found), rigs.left_SE3_right(rig), atol=1e-12)
    np.testing.assert_allclose(rigs.body_SE3_camera(found, "left"), body, atol=1e-12)
    path.write_text(yaml.safe_dump({"cameras": {"l": content["cameras"]["l"]}}))
    complaint(path, "cameras: ")


# --------------------------------------------------------------------------- other image sizes


@settings(max_examples=30, deadline=None)
@given(factor=st.sampled_from([0.25, 0.5, 2.0, 3.0]), x=st.floats(-2, 2), y=st.floats(-1, 1), z=st.floats(3, 20))
def test_points_of_scaled_images_are_scaled_points(factor: float, x: float, y: float, z: float) -> None:
    rig = make_rig(LENSES["brown"])
    small = rigs.resized(rig, round(factor * 1280), round(factor * 720))
    edge = cam.project(rig.left, [x, y, z]) + 0.5  # counted from the edge of the image
    np.testing.assert_allclose(cam.project(small.left, [x, y, z]) + 0.5, factor * edge, atol=1e-9)


def test_sigmas_are_scaled_with_the_image(tmp_path: Path) -> None:
    path = tmp_path / "rig.yaml"
    camera = "{width_px: 1280, height_px: 720, fx_px: 900, fy_px: 900, cx_px: 640, cy_px: 360}"
    sigmas = "sigmas: {left.fx_px: 2, right.cy_px: 4, relative.tx_m: 0.001}"
    path.write_text(f"left: {camera}\nright: {camera}\nbaseline_m: 0.3\n{sigmas}\n")
    covariance = rigs.resized(read_rig(path), 640, 360).calibration_covariance
    assert covariance is not None
    np.testing.assert_allclose(np.sqrt(np.diag(covariance.matrix)), [1, 2, 0.001])
    with pytest.raises(ValueError, match="another aspect ratio"):
        rigs.resized(read_rig(path), 640, 400)
