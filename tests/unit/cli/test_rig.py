"""`conetl rig`: tables for people, JSON for programs, files for other tools."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

from conetl.cli.app import app
from conetl.model.errors import InputError
from conetl.readers.rigs import read_rig

RIG = """
rig_id: a6000-pair
left: {width_px: 6000, height_px: 4000, focal_mm: [15.9004, 15.8703], sensor_width_mm: 23.5, sensor_height_mm: 15.6}
right: {width_px: 6000, height_px: 4000, focal_mm: 15.9,
        principal_mm: [11.75, 7.8], sensor_width_mm: 23.5, sensor_height_mm: 15.6,
        lens: {model: radial, coefficients: [-0.05, 0.01]}}
left_SE3_right: {t_m: [0.2745, 0, 0]}
body_SE3_left: {R: [[0, 0, 1], [-1, 0, 0], [0, -1, 0]], t_m: [1.0, 0.2, 0.7]}
sigmas: {left.fx_mm: 0.01, relative.ry_deg: 0.084, relative.tx_mm: 0.3, right.lens.1: 0.002}
"""


@pytest.fixture
def rig_yaml(tmp_path: Path) -> Path:
    path = tmp_path / "rig.yaml"
    path.write_text(RIG)
    return path


def run(*words: object) -> str:
    result = CliRunner().invoke(app, ["rig", *map(str, words)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert result.exit_code == 0, result.output
    return result.output


def test_show_prints_interior_and_exterior_with_sigmas(rig_yaml: Path) -> None:
    text = run("show", rig_yaml)
    # The second is fx and its sigma of 0.01 mm, in pixels.
    for part in ("conetl rig.yaml, rig a6000-pair", "4059.677 ± 2.553", "0.27450 ± 0.00030 m", "± 0.0840 deg"):
        assert part in text
    assert "0.010000 ± 0.002000" in text and "raw; they are rectified when read" in text
    shown = json.loads(run("show", rig_yaml, "--json"))
    assert (shown["format"], shown["rectified"], shown["baseline_m"]) == ("rig", False, 0.2745)
    assert shown["rig"]["right"]["lens"]["model"] == "radial"


def test_convert_to_opencv_names_what_is_lost(rig_yaml: Path, tmp_path: Path) -> None:
    text = run("convert", rig_yaml, tmp_path / "stereo.xml", "--to", "opencv")
    assert "cannot store" in text and "body_SE3_left" in text and "covariance" in text
    storage = cv2.FileStorage(str(tmp_path / "stereo.xml"), cv2.FILE_STORAGE_READ)
    assert storage.getNode("M1").mat()[0, 0] == pytest.approx(15.9004 / 23.5 * 6000)
    np.testing.assert_allclose(storage.getNode("T").mat().ravel(), [-0.2745, 0, 0])
    assert "cannot store" not in run("convert", rig_yaml, tmp_path / "again.yaml", "--to", "rig")
    assert read_rig(tmp_path / "again.yaml") == read_rig(rig_yaml)


def test_size_and_unit_of_a_file_that_has_none(tmp_path: Path) -> None:
    k = [[900.0, 0, 640], [0, 900, 360], [0, 0, 1]]
    values = {"K1": k, "D1": [0.0] * 5, "K2": k, "D2": [0.0] * 5, "R": np.eye(3).tolist(), "T": [-270.0, 0, 0]}
    (tmp_path / "stereo.yaml").write_text(yaml.safe_dump(values))
    words = ("convert", tmp_path / "stereo.yaml", tmp_path / "rig.yaml", "--to", "rig", "--image-size", "1280x720")
    with pytest.raises(InputError, match="another unit"):
        run(*words)
    assert json.loads(run(*words, "--unit", "mm", "--json"))["read_as"] == "opencv"
    assert read_rig(tmp_path / "rig.yaml").baseline_m == pytest.approx(0.27)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--to", "colmap"), "--to colmap: known formats"),
        (("--to", "rig", "--image-size", "big"), "--image-size big"),
        (("--to", "rig", "--scale-to", "0x0"), "--scale-to 0x0: expected width x height"),
        (("--to", "rig", "--scale-to", "1920x1080"), "--scale-to 1920x1080: .*another aspect ratio"),
        (("--to", "rig", "--pair", "cam0"), "--pair cam0: expected the names"),
    ],
)
def test_bad_options_are_rejected(rig_yaml: Path, tmp_path: Path, words: tuple[str, ...], message: str) -> None:
    with pytest.raises(InputError, match=message):
        run("convert", rig_yaml, tmp_path / "x.yaml", *words)
    assert not (tmp_path / "x.yaml").exists()


def test_a_rig_yaml_needs_no_format_and_others_do(rig_yaml: Path, tmp_path: Path) -> None:
    opencv, back = tmp_path / "stereo.yml", tmp_path / "back" / "rig.yaml"
    back.parent.mkdir()
    run("convert", rig_yaml, opencv, "--to", "opencv")
    run("convert", opencv, back)
    assert read_rig(back).baseline_m == pytest.approx(0.2745)
    with pytest.raises(InputError, match=r"choose the format with --to: rig, opencv, ros$"):
        run("convert", rig_yaml, tmp_path / "other.yaml")


def test_a_pair_of_a_scaled_chain(tmp_path: Path) -> None:
    pose = np.eye(4)
    pose[0, 3] = -0.2
    camera = {
        "camera_model": "pinhole", "intrinsics": [900.0, 900.0, 639.5, 359.5], "resolution": [1280, 720],
        "distortion_model": "radtan", "distortion_coeffs": [0.0] * 4,
    }  # fmt: skip
    chain = {f"cam{n}": camera | ({"T_cn_cnm1": pose.tolist()} if n else {}) for n in range(3)}
    (tmp_path / "camchain.yaml").write_text(yaml.safe_dump(chain))
    with pytest.raises(InputError, match="choose the stereo pair: conetl rig convert with --pair LEFT,RIGHT"):
        run("show", tmp_path / "camchain.yaml")
    words = ("--pair", "cam0,cam2", "--scale-to", "640x360")
    run("convert", tmp_path / "camchain.yaml", tmp_path / "rig.yaml", *words)
    rig = read_rig(tmp_path / "rig.yaml")
    assert (rig.baseline_m, rig.left.fx_px) == pytest.approx((0.4, 450.0))
    assert (rig.left.cx_px, rig.left.width_px) == pytest.approx((319.5, 640))
