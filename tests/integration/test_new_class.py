"""A class that conetl does not know is a row in the table of classes and a network that finds it: no code changes."""

from __future__ import annotations

import hashlib
import json
from contextlib import closing
from pathlib import Path

import cv2
import numpy as np
import onnx.parser
import pytest
from pydantic import SecretStr

from conetl.db.connection import connect
from conetl.db.map.map_store import read_current_features
from conetl.geometry.rig import map_SE3_camera, map_SE3_left
from conetl.model.feature_classes import FEATURE_CLASSES, FeatureClass
from conetl.model.map_records import DeltaKind
from conetl.model.params import DetectionParams, IngestParams, TrajectoryParams
from conetl.pipeline.ingest import ingest
from conetl.pipeline.settings import Settings
from conetl.readers.drives import read_drive
from tests.integration.small_drives import SAMPLES, cut_drive

FRAMES = range(10, 22)
#: Bounds of all magenta pixels as the one box of a YOLOv8 export of two classes.
NETWORK = """
<ir_version: 8, opset_import: ["": 17]>
magenta (uint8[1, h, w, 3] images) => (float[1, 6, 1] output0)
<float zero = {0}, float half = {0.5}, float one = {1}, float far = {1000000}, float least = {90},
 int64 blue = {0}, int64 green = {1}, int64 red = {2}, int64[1] along = {1}, int64[3] shape = {1, 1, 1}>
{
    numbers = Cast <to = 1> (images)
    b = Gather <axis = 3> (numbers, blue)
    g = Gather <axis = 3> (numbers, green)
    r = Gather <axis = 3> (numbers, red)
    bright = Min (b, r)
    excess = Sub (bright, g)
    is_magenta = Greater (excess, least)
    mask = Cast <to = 1> (is_magenta)
    columns = ReduceMax <axes = [1], keepdims = 0> (mask)
    rows = ReduceMax <axes = [2], keepdims = 0> (mask)
    column_zeros = Mul (columns, zero)
    row_zeros = Mul (rows, zero)
    column_ones = Add (column_zeros, one)
    row_ones = Add (row_zeros, one)
    column_ends = CumSum (column_ones, along)
    row_ends = CumSum (row_ones, along)
    not_columns = Sub (column_ones, columns)
    not_rows = Sub (row_ones, rows)
    columns_beyond = Mul (not_columns, far)
    rows_beyond = Mul (not_rows, far)
    x_starts = Add (column_ends, columns_beyond)
    y_starts = Add (row_ends, rows_beyond)
    x_first = ReduceMin <keepdims = 0> (x_starts)
    y_first = ReduceMin <keepdims = 0> (y_starts)
    x0 = Sub (x_first, one)
    y0 = Sub (y_first, one)
    x_ends = Mul (column_ends, columns)
    y_ends = Mul (row_ends, rows)
    x1 = ReduceMax <keepdims = 0> (x_ends)
    y1 = ReduceMax <keepdims = 0> (y_ends)
    width = Sub (x1, x0)
    height = Sub (y1, y0)
    x_sum = Add (x0, x1)
    y_sum = Add (y0, y1)
    x = Mul (x_sum, half)
    y = Mul (y_sum, half)
    found = ReduceMax <keepdims = 0> (mask)
    none = Mul (found, zero)
    v1 = Reshape (x, shape)
    v2 = Reshape (y, shape)
    v3 = Reshape (width, shape)
    v4 = Reshape (height, shape)
    v5 = Reshape (none, shape)
    v6 = Reshape (found, shape)
    output0 = Concat <axis = 1> (v1, v2, v3, v4, v5, v6)
}
"""


def write_network(path: Path) -> Path:
    content = onnx.parser.parse_model(NETWORK).SerializeToString()
    path.write_bytes(content)
    card = {
        "name": "magenta", "version": "1", "sha256": hashlib.sha256(content).hexdigest(), "input_layout": "BGR uint8 NHWC 0..255",
        "head": {"kind": "yolov8", "class_count": 2}, "pad_multiple_px": 32, "class_names": ["car", "bollard"],
        "score_scale": "0 or 1", "licence": "none",
    }  # fmt: skip
    path.with_name(path.name + ".json").write_text(json.dumps(card))
    return path


def drive_past_a_bollard(folder: Path) -> np.ndarray:
    """Some pairs of a sample drive with a bollard, 0.2 m wide and 0.9 m tall, drawn 9 m ahead of the last; its foot (3,)."""
    for photo in cut_drive(SAMPLES[0], folder, frames=FRAMES).glob("image_0?/data/*.jpg"):
        image = cv2.imread(str(photo))
        assert image is not None
        cv2.imwrite(str(photo.with_suffix(".png")), image)
        photo.unlink()
    drive, _ = read_drive(folder, headers_only=True)
    rig = drive.rig
    map_SE3_last = map_SE3_left(drive.frame_pairs[-1].pose, rig)
    foot_m = map_SE3_last[:3, :3] @ [0.8, 1.65, 9.0] + map_SE3_last[:3, 3]
    for pair in drive.frame_pairs:
        for path, pose, camera in (
            (pair.left_path, map_SE3_left(pair.pose, rig), rig.left),
            (pair.right_path, map_SE3_camera(pair.pose, rig, "right"), rig.right),
        ):
            x, y, z = pose[:3, :3].T @ (foot_m - pose[:3, 3])
            u, v = camera.fx_px * x / z + camera.cx_px, camera.fy_px * y / z + camera.cy_px
            half_px, tall_px = 0.1 * camera.fx_px / z, 0.9 * camera.fy_px / z
            image = cv2.imread(path)
            assert image is not None
            corners = np.array([(u - half_px, v - tall_px), (u + half_px, v)])
            low, high = (corners * 16).round().astype(int).tolist()
            cv2.rectangle(image, low, high, (255, 0, 255), -1, shift=4)
            cv2.imwrite(path, image)
    return np.asarray(foot_m)


def test_a_row_and_a_network_bring_a_new_class_onto_the_map(
    monkeypatch: pytest.MonkeyPatch, database_url: str, tmp_path: Path
) -> None:
    row = FeatureClass((0.5, 1.3), (0.3, 2.0), 0.22, round_body=False, on_road=True, in_rows=False, letter="L")
    monkeypatch.setitem(FEATURE_CLASSES, "bollard", row)
    settings = Settings(
        home=tmp_path / "home",
        database_url=SecretStr(database_url),
        model_path=write_network(tmp_path / "magenta.onnx"),
    )
    params = IngestParams(
        detection=DetectionParams(categories=("bollard",)),
        trajectory=TrajectoryParams(refine=False, self_calibrate=False),
    )
    foot_m = drive_past_a_bollard(tmp_path / "drive")
    report = ingest(tmp_path / "drive", params, settings)
    assert report.counts[DeltaKind.ADDED] == 1
    with closing(connect(database_url)) as conn:
        (feature,) = read_current_features(conn)
    assert feature.category == "bollard"
    off_m = np.array(feature.xyz_m) - foot_m
    assert np.linalg.norm(off_m) < 0.1 and (np.abs(off_m) < 4 * np.sqrt(np.array(feature.cov_m2)[[0, 3, 5]])).all()
    assert abs(feature.object_height_m - 0.9) < 0.05
