"""The cone detector: decode and suppression by their laws, model files that must be refused, and real images."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import onnx
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conetl.model.errors import InputError, ModelFileError
from conetl.perception import decoding
from conetl.perception.detector import (
    Detector,
    detect_image,
    load_detector,
    network_input,
    run_network,
    shipped_model_path,
)
from tests.folders import KITTI, SHARED, needs_kitti
from tests.unit.perception.networks import constant_network

KITTI_LEFT = KITTI / "image_02" / "data"


@pytest.fixture(scope="module")
def detector() -> Detector:
    return load_detector()


def test_onnxruntime_sends_no_telemetry(tmp_path: Path) -> None:
    """Official builds from 1.29 on do; they prepare that with an identifier of the machine and a cache in the home folder."""
    given = {name: value for name, value in os.environ.items() if name not in ("CI", "ORT_DISABLE_TELEMETRY")}
    command = "from conetl import load_detector; load_detector()"
    subprocess.run(
        [sys.executable, "-c", command],
        check=True,
        env=given | dict.fromkeys(("HOME", "XDG_CACHE_HOME"), str(tmp_path)),
    )
    assert list(tmp_path.rglob("*")) == []


@pytest.mark.parametrize("foot_and_tip", [False, True])
@given(st.integers(0, 2**32 - 1), st.floats(0.1, 0.9))
def test_decoding_undoes_the_encoding_of_any_cells(foot_and_tip: bool, seed: int, threshold: float) -> None:
    """Of three images of 24 x 40 px, at two strides: sides between two bins, feet and tips, and the best of three classes."""
    rng, bins, count = np.random.default_rng(seed), 5, 4
    outputs: list[np.ndarray] = []
    expected, images, scores = [], [], []
    for stride in (4, 8):
        rows, columns = 24 // stride, 40 // stride
        at = rng.choice(3 * rows * columns, count, replace=False)
        sides, shares = rng.uniform(0, bins - 1, (count, 4)), rng.uniform(-0.5, 0.5, (count, 4))
        logits = rng.permuted(np.linspace(-3, 3, 3 * count)).reshape(count, 3)
        share = np.maximum(1 - np.abs(sides[:, :, None] - np.arange(bins)), 1e-30)  # of each bin in the expectation
        ends = [shares] if foot_and_tip else []
        outputs += [np.hstack([np.log(share).reshape(count, -1), *ends, logits]), at]
        image, cell = np.divmod(at, rows * columns)
        x, y = (cell % columns + 0.5) * stride, (cell // columns + 0.5) * stride
        x0, y0, x1, y1 = (
            x - stride * sides[:, 0],
            y - stride * sides[:, 1],
            x + stride * sides[:, 2],
            y + stride * sides[:, 3],
        )
        width, height, middle = x1 - x0, y1 - y0, (x0 + x1) / 2
        foot = middle + shares[:, 0] * width, y1 - shares[:, 1] * height
        tip = middle + shares[:, 2] * width, y0 + shares[:, 3] * height
        score = 1 / (1 + np.exp(-logits.max(axis=1)))
        both = (*foot, *tip) if foot_and_tip else [np.full(count, np.nan)] * 4
        expected.append(np.column_stack([x0, y0, x1, y1, score, *both, logits.argmax(axis=1)]))
        images.append(image)
        scores.append(score)
    found, of_image, omitted = decoding.decode_cells(
        outputs, (3, 24, 40), (4, 8), bins, threshold, foot_and_tip=foot_and_tip, class_count=3
    )
    kept = np.concatenate(scores) >= threshold
    np.testing.assert_allclose(found, np.concatenate(expected)[kept], atol=1e-9)
    np.testing.assert_array_equal(of_image, np.concatenate(images)[kept])
    assert omitted == pytest.approx(max(some.min() for some in scores)), "cells that the network left out had no more"


@pytest.mark.parametrize(("values", "cells"), [((6, 2), 6), ((3, 17), 2)])
def test_decode_refuses_cells_of_another_head(values: tuple[int, int], cells: int) -> None:
    with pytest.raises(ValueError, match="expected"):
        decoding.decode_cells([np.zeros(values, np.float32), np.zeros(cells, np.int64)], (1, 32, 32), (8,), 4, 0.5)


def draw_cone(image: np.ndarray, x: float, foot: float, height: float) -> None:
    """An orange cone with two white bands, anti-aliased by drawing four times larger."""
    big = cv2.resize(image, None, fx=4, fy=4, interpolation=cv2.INTER_NEAREST)
    half = 0.26 * height

    def slab(low: float, high: float, colour: tuple[int, int, int]) -> None:
        corners = [
            (x + side * half * (1 - 0.85 * share), foot - share * height)
            for side, share in ((-1, low), (1, low), (1, high), (-1, high))
        ]
        cv2.fillPoly(big, [np.round(np.array(corners) * 4).astype(np.int32)], colour)

    slab(0.06, 1.0, (30, 85, 235))
    slab(0.35, 0.52, (235, 235, 235))
    slab(0.65, 0.80, (235, 235, 235))
    base = [(x - 1.35 * half, foot - 0.06 * height), (x + 1.35 * half, foot)]
    (x0, y0), (x1, y1) = np.round(np.array(base) * 4).astype(int)
    cv2.rectangle(big, (int(x0), int(y0)), (int(x1), int(y1)), (25, 70, 200), -1)
    image[:] = cv2.resize(big, (image.shape[1], image.shape[0]), interpolation=cv2.INTER_AREA)


def street(height: int, width: int, sky: int, *cones: tuple[float, float, float]) -> np.ndarray:
    """A grey road under a sky of some rows, with cones: x and y of the foot, and height."""
    image = np.full((height, width, 3), (110, 115, 118), np.uint8)
    image[:sky] = (200, 180, 160)
    for cone in cones:
        draw_cone(image, *cone)
    return image


def test_rows_above_the_road_can_be_left_out(detector: Detector) -> None:
    image = street(376, 400, 200, (150.0, 310.0, 60.0))
    whole = detect_image(detector, image, score_threshold=0.3)
    cropped = detect_image(detector, image, score_threshold=0.3, first_row=96)
    assert len(whole) == len(cropped) == 1
    np.testing.assert_allclose(cropped[0, :4], whole[0, :4], atol=2.5)  # 4 % of its height: it is no photograph


def test_a_part_of_the_image_shows_what_the_whole_does_there(detector: Detector) -> None:
    image = street(376, 1200, 200, *((x, 330.0, 70.0) for x in (150.0, 640.0, 1050.0)))
    whole = detect_image(detector, image, score_threshold=0.3, first_row=40)
    part = detect_image(
        detector, image, score_threshold=0.3, first_row=40, within=(600.0, 280.0, 680.0, 310.0), reach_px=50.0
    )
    assert len(whole) == 3 and len(part) == 1, "of three cones the one in the middle"
    (same,) = whole[np.abs(whole[:, 0] + whole[:, 2] / 2 - 640.0) < 40.0]
    np.testing.assert_allclose(part[0, :4], same[:4], atol=1.0)
    everywhere = detect_image(
        detector, image, score_threshold=0.3, first_row=40, within=(0.0, 0.0, 1200.0, 376.0), reach_px=376.0
    )
    np.testing.assert_array_equal(everywhere, whole)
    assert len(detect_image(detector, image, score_threshold=0.3, within=(300.0, 280.0, 400.0, 310.0))) == 0


def test_a_part_of_a_large_image_is_scaled_as_the_whole(detector: Detector) -> None:
    image = street(900, 3840, 300, (2112.0, 810.0, 216.0))
    (whole,) = detect_image(detector, image, score_threshold=0.3)
    (part,) = detect_image(detector, image, score_threshold=0.3, within=(2050.0, 680.0, 2170.0, 720.0), reach_px=144.0)
    np.testing.assert_allclose(part[:4], whole[:4], atol=2.5)  # 1 px of the network's


def test_a_part_of_a_tall_image_still_shows_what_fills_it(detector: Detector) -> None:
    image = street(900, 1600, 300, (700.0, 850.0, 360.0))
    found = detect_image(detector, image, score_threshold=0.4, within=(600.0, 600.0, 800.0, 740.0), reach_px=300.0)
    assert len(found) == 1
    assert found[0, 3] == pytest.approx(360.0, rel=0.15)


def test_a_part_of_a_better_and_larger_box_is_dropped() -> None:
    large = np.array([[0.0, 0.0, 100.0, 200.0, 0.8]])
    inside, beside = [10.0, 50.0, 90.0, 110.0, 0.5], [90.0, 50.0, 170.0, 110.0, 0.5]
    better = [*inside[:4], 0.9]
    np.testing.assert_array_equal(decoding.suppress_parts(np.array([inside, better, beside]), large), [better, beside])
    assert len(decoding.suppress_parts(np.zeros((0, 5)), large)) == 0


#: Of the overlaps that suppression computes.
SINGLE_PRECISION = 1e-6
coordinate = st.floats(0.0, 200.0, allow_nan=False)
candidate = st.tuples(coordinate, coordinate, st.floats(0.5, 90.0), st.floats(0.5, 90.0), st.floats(0.0, 1.0))


@given(st.lists(candidate, max_size=25), st.floats(0.1, 0.9))
def test_suppression_laws(rows: list[tuple[float, ...]], nms_iou: float) -> None:
    values = np.array(rows, float).reshape(-1, 5)
    candidates = np.column_stack((values[:, :2], values[:, :2] + values[:, 2:4], values[:, 4]))
    kept = decoding.suppress_overlaps(candidates, nms_iou)
    assert {tuple(row) for row in kept} <= {tuple(row) for row in candidates}
    assert np.all(np.diff(kept[:, 4]) <= 0)
    for index, box in enumerate(kept):  # survivors do not overlap
        assert np.all(decoding.intersection_over_union(box[:4], kept[index + 1 :, :4]) <= nms_iou + SINGLE_PRECISION)
    for box in candidates:  # whatever went, went for a survivor at least as good
        rivals = kept[kept[:, 4] >= box[4]]
        same = (kept == box).all(axis=1).any()
        assert same or np.any(decoding.intersection_over_union(box[:4], rivals[:, :4]) > nms_iou - SINGLE_PRECISION)
    np.testing.assert_array_equal(decoding.suppress_overlaps(kept, nms_iou), kept)


@given(st.integers(8, 300), st.integers(8, 300), st.integers(40, 200))
def test_boxes_map_back_through_padding_and_scaling(width: int, height: int, max_side: int) -> None:
    image = np.zeros((height, width, 3), np.uint8)
    blob, scale_x, scale_y = network_input(image, 32, max_side)
    assert blob.shape[2] % 32 == 0 and blob.shape[3] % 32 == 0
    assert max(blob.shape[2] - 31, blob.shape[3] - 31) <= max_side
    if max(width, height) <= max_side:
        assert scale_x == scale_y == 1.0
    # A vertical edge at the middle of the image lies at its scaled place in the network's input.
    image[:, : width // 2] = 255
    blob, scale_x, scale_y = network_input(image, 32, max_side)
    bright = float(blob[0, 0, 0, : round(width * scale_x)].sum())
    assert bright / scale_x == pytest.approx(width // 2, abs=1e-3 + (0.0 if scale_x == 1.0 else 1.0 / scale_x))


def test_boxes_in_the_padding_are_dropped_and_others_are_cut() -> None:
    boxes = np.array([[90.0, 10.0, 130.0, 40.0, 0.9], [105.0, 10.0, 120.0, 40.0, 0.8]])
    np.testing.assert_allclose(decoding.boxes_in_image(boxes, 100, 50), [[90.0, 10.0, 10.0, 30.0, 0.9]])


def copy_model(folder: Path) -> Path:
    source = shipped_model_path()
    shutil.copy(source.with_name(source.name + ".json"), folder)
    return Path(shutil.copy(source, folder))


def rewrite_card(model: Path, **changes: object) -> None:
    """Other values in a model's sidecar; None takes one out."""
    sidecar = model.with_name(model.name + ".json")
    card = json.loads(sidecar.read_text()) | changes
    sidecar.write_text(json.dumps({key: value for key, value in card.items() if value is not None}))


@pytest.mark.parametrize("colours", ["RGB", "BGR"])
@pytest.mark.parametrize("axes", ["NCHW", "NHWC"])
@pytest.mark.parametrize("numbers", ["float32 {} 0..1", "float32 {} 0..255", "uint8 {} 0..255"])
def test_every_layout_shows_the_same_image(colours: str, axes: str, numbers: str) -> None:
    image = np.random.default_rng(4).integers(0, 256, (32, 64, 3), dtype=np.uint8)
    blob, _, _ = network_input(image, 32, 1600, layout=f"{colours} {numbers.format(axes)}")
    assert blob.dtype == (np.uint8 if "uint8" in numbers else np.float32)
    shown = blob[0] if axes == "NHWC" else blob[0].transpose(1, 2, 0)
    expected = image[..., ::-1] if colours == "RGB" else image
    np.testing.assert_allclose(shown * (255.0 if "0..1" in numbers.split() else 1.0), expected, atol=1e-4)


def without_card(model: Path) -> None:
    model.with_name(model.name + ".json").unlink()


def change_one_byte(model: Path) -> None:
    content = bytearray(model.read_bytes())
    content[len(content) // 2] ^= 1
    model.write_bytes(content)


def make_no_network(model: Path) -> None:
    """With a matching hash, and without the evidence, which is of the file that was there."""
    model.write_bytes(b"not a network")
    rewrite_card(model, sha256=hashlib.sha256(b"not a network").hexdigest(), evidence=None)


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (Path.unlink, r"conetl-.*\.onnx"), (without_card, "sidecar"), (change_one_byte, "SHA-256"),
        (make_no_network, "cannot load"),
    ],
)  # fmt: skip
def test_a_model_that_is_incomplete_or_changed_is_refused(
    tmp_path: Path, damage: Callable[[Path], None], words: str
) -> None:
    model = copy_model(tmp_path)
    damage(model)
    with pytest.raises(ModelFileError, match=words):
        load_detector(model)


def test_providers_are_those_of_the_installed_onnxruntime() -> None:
    assert load_detector(providers="cpu").session.get_providers() == ["CPUExecutionProvider"]
    assert load_detector(providers="CPUExecutionProvider").session.get_providers() == ["CPUExecutionProvider"]
    for names, missing in (("Abacus,CPU", "no Abacus, it has .*CPU"), ("", "no provider without a name")):
        with pytest.raises(InputError, match=f"CONETL_ONNX_PROVIDERS: the installed onnxruntime has {missing}"):
            load_detector(providers=names)


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("head", {"side_bins": 8, "strides_px": [4, 8, 16, 32]}, "expects"),
        ("head", {"side_bins": 16, "strides_px": [8, 16], "foot_and_tip": True}, "outputs"),
        ("head", {"kind": "yolov8"}, "yolov8"),
        ("head", {"kind": "yolov99"}, "head"),
        ("input_layout", "RGB float32 NCHW 0..1", "takes a tensor"),
        ("input_layout", "BGR uint8 NHWC 0..1", "input_layout"),
        ("extra", 1, "extra"),
        ("evidence", {"model_sha256": "0" * 64}, "calibrate_scores"),
    ],
)
def test_a_sidecar_that_does_not_fit_is_refused(tmp_path: Path, key: str, value: object, words: str) -> None:
    model = copy_model(tmp_path)
    shipped = json.loads(model.with_name(model.name + ".json").read_text())
    before = {"head": {"kind": "side-distributions", "class_count": 8}, "evidence": shipped["evidence"]}.get(key, {})
    rewrite_card(model, **{key: before | value if isinstance(value, dict) else value})
    with pytest.raises(ModelFileError, match=words):
        load_detector(model)


def network_of_two_classes(folder: Path, metadata: dict[str, str], layout: str, *names: str) -> Path:
    """A YOLOv8 export with what its exporter wrote into it, beside a sidecar with these names."""
    shape: list[int | str] = [1, "h", "w", 3] if "NHWC" in layout else [1, 3, "h", "w"]
    model = onnx.load_from_string(constant_network([np.ones((1, 4 + len(names), 1), np.float32)], shape))
    onnx.helper.set_model_props(model, metadata)
    content = model.SerializeToString()
    (folder / "two.onnx").write_bytes(content)
    card = {
        "name": "two", "version": "1", "sha256": hashlib.sha256(content).hexdigest(), "input_layout": layout,
        "head": {"kind": "yolov8", "class_count": len(names)}, "pad_multiple_px": 32, "class_names": names,
        "score_scale": "probability", "licence": "none",
    }  # fmt: skip
    (folder / "two.onnx.json").write_text(json.dumps(card))
    return folder / "two.onnx"


@pytest.mark.parametrize(
    ("names", "in_sidecar", "words"),
    [
        ("{0: 'traffic_cone', 1: 'drum'}", ("drum", "traffic_cone"), "class 0 is 'traffic_cone' .* and 'drum' by class_names"),
        ("{0: 'Traffic-Cone', 1: 'barrel'}", ("drum", "traffic_cone"), "class 0 is 'traffic_cone'"),
        ("['car', 'road', 'cone']", ("cone", "car", "road"), "in another order.*The file has car, road, cone"),
        ("{0: 'cone', 1: 'car', 2: 'bus'}", ("traffic_cone", "car"), "names 3 classes .cone, car, bus., .* sidecar 2"),
    ],
)  # fmt: skip
def test_classes_in_another_order_than_in_the_file_are_refused(
    tmp_path: Path, names: str, in_sidecar: tuple[str, ...], words: str
) -> None:
    model = network_of_two_classes(tmp_path, {"names": names}, "BGR float32 NHWC 0..255", *in_sidecar)
    with pytest.raises(ModelFileError, match=words):
        load_detector(model)


@pytest.mark.parametrize(
    "names",
    [
        "{0: 'Drum', 1: 'cone'}", "['barrel', 'orange cone']", "{0: 'traffic light', 1: 'hydrant'}", "{0: 'a', 1: 'b'}", "cones",
        "{1: 'traffic_cone', 2: 'drum'}", "{0: 7, 1: 8}", "'ab'", "7", "[" * 10_000, "",
    ],
)  # fmt: skip
def test_other_names_of_the_same_classes_are_accepted(tmp_path: Path, names: str) -> None:
    """And what is no list of names is ignored, as other exporters may use the key."""
    load_detector(network_of_two_classes(tmp_path, {"names": names}, "BGR float32 NHWC 0..255", "drum", "traffic_cone"))


@pytest.mark.parametrize("layout", ["BGR float32 NCHW 0..1", "RGB float32 NCHW 0..255"])
def test_the_input_of_an_export_of_ultralytics_is_known(tmp_path: Path, layout: str) -> None:
    author = {"author": "Ultralytics"}
    with pytest.raises(ModelFileError, match=r"an export of Ultralytics, whose input is 'RGB float32 NCHW 0\.\.1'"):
        load_detector(network_of_two_classes(tmp_path, author, layout, "drum", "traffic_cone"))
    load_detector(network_of_two_classes(tmp_path, {}, layout, "drum", "traffic_cone"))
    load_detector(network_of_two_classes(tmp_path, author, "RGB float32 NCHW 0..1", "drum", "traffic_cone"))


@pytest.mark.parametrize("size", [(160, 320), ("h", "w"), ("h", 640)])
def test_a_network_of_another_family_runs_by_its_sidecar_alone(
    tmp_path: Path, size: tuple[int | str, int | str]
) -> None:
    """A YOLOv8 export of two classes that always gives one box, centred at (100, 60), 20 x 40, in its own input."""
    fixed = size == (160, 320)
    boxes = np.array([[[100], [60], [20], [40], [0.1], [0.9]]], np.float32)
    content = constant_network([boxes], [1, *size, 3])
    (tmp_path / "tiny.onnx").write_bytes(content)
    card = {
        "name": "tiny", "version": "1", "sha256": hashlib.sha256(content).hexdigest(), "input_layout": "BGR float32 NHWC 0..255",
        "head": {"kind": "yolov8", "class_count": 2}, "pad_multiple_px": 32, "class_names": ["car", "traffic_cone"],
        "score_scale": "probability", "licence": "none",
    }  # fmt: skip
    (tmp_path / "tiny.onnx.json").write_text(json.dumps(card))
    detector = load_detector(tmp_path / "tiny.onnx")
    found = detect_image(detector, np.zeros((320, 640, 3), np.uint8), score_threshold=0.5)
    scale = 2.0 if fixed else 1.0  # the fixed network sees the image at half its size
    np.testing.assert_allclose(found[:, :5], [[90 * scale, 40 * scale, 20 * scale, 40 * scale, 0.9]], rtol=1e-6)
    assert np.isnan(found[:, 5:9]).all() and (found[:, 9] == 1).all()
    if size != ("h", "w"):  # a part of the image would come to it larger than the whole, or not fit
        x, y = 100 * scale, 60 * scale
        seen = detect_image(
            detector, np.zeros((320, 640, 3), np.uint8), score_threshold=0.5, within=(x - 10, y - 10, x + 10, y + 10)
        )
        np.testing.assert_array_equal(seen, found)
    if fixed:
        window = {"cone_px": 48, "window_px": 96, "scores": [0.2, 0.8], "share": 0.4}
        (tmp_path / "tiny.onnx.json").write_text(json.dumps(card | {"closer_look": window}))
        with pytest.raises(ModelFileError, match=r"takes images of 320x160 only.*closer_look"):
            load_detector(tmp_path / "tiny.onnx")
    (tmp_path / "tiny.onnx.json").write_text(json.dumps(card | {"input_layout": "BGR float32 NCHW 0..255"}))
    shape = " x ".join(map(str, (1, *size, 3)))
    words = f"the network's input is {shape}, the sidecar's input_layout 'BGR float32 NCHW 0..255': the input is NHWC"
    with pytest.raises(ModelFileError, match=words):
        load_detector(tmp_path / "tiny.onnx")


def test_images_of_another_kind_are_refused(detector: Detector) -> None:
    with pytest.raises(ValueError, match="BGR"):
        detect_image(detector, np.zeros((64, 64), np.uint8), score_threshold=0.5)


def test_windows_looked_at_together_are_seen_as_each_alone(detector: Detector) -> None:
    assert detector.several
    rng = np.random.default_rng(4)
    windows = [np.asarray(rng.integers(90, 120, (96, 96, 3)), np.uint8) for _ in range(5)]
    for index, window in enumerate(windows[1:], 1):
        draw_cone(window, 20.0 + 12.0 * index, 80.0, 20.0 + 8.0 * index)
    together = [seen for seen, _ in run_network(detector, windows, 96, 0.02, 0.5)]
    assert sum(len(seen) for seen in together) >= 4
    for window, seen in zip(windows, together, strict=True):
        np.testing.assert_array_equal(seen, run_network(detector, [window], 96, 0.02, 0.5)[0][0])
    one_by_one = run_network(dataclasses.replace(detector, several=False), windows, 96, 0.02, 0.5)
    for seen, (alone, _) in zip(together, one_by_one, strict=True):
        np.testing.assert_array_equal(seen, alone)


def test_a_faint_cone_keeps_its_box_among_many_clear_ones(detector: Detector) -> None:
    """The network answers for its best cells only, of all images of a run together."""
    road = np.full((96, 96, 3), (110, 115, 118), np.uint8)
    clear = road.copy()
    draw_cone(clear, 48.0, 72.0, 48.0)
    faint = np.asarray(0.8 * road + 0.2 * clear, np.uint8)
    expected = run_network(detector, [faint], 96, 0.02, 0.5)[0][0]
    assert len(expected) == 1
    *_, (seen, _) = run_network(detector, [clear] * 63 + [faint], 96, 0.02, 0.5)
    np.testing.assert_array_equal(seen, expected)


@pytest.mark.parametrize("height_px", [60.0, 220.0, 300.0, 360.0])
def test_a_drawn_cone_is_found_once_where_it_stands(detector: Detector, height_px: float) -> None:
    image = street(640, 640, 200, (320.0, 600.0, height_px))
    found = detect_image(detector, image, score_threshold=0.4)
    assert len(found) == 1
    x, y, w, h = found[0, :4]
    assert x + w / 2 == pytest.approx(320.0, abs=0.05 * height_px)
    assert y + h == pytest.approx(600.0, abs=0.1 * height_px)
    assert h == pytest.approx(height_px, rel=0.15)


@pytest.mark.parametrize(("height_px", "contrast"), [(8.0, 0.13), (10.0, 0.13), (14.0, 0.08)])
def test_a_faint_distant_cone_is_enlarged_in_a_single_image(
    detector: Detector, height_px: float, contrast: float
) -> None:
    empty = street(640, 400, 150)
    image = cv2.addWeighted(street(640, 400, 150, (320.0, 220.0, height_px)), contrast, empty, 1 - contrast, 0)
    assert len(detect_image(detector, image, score_threshold=0.3)) == 0
    assert len(detect_image(detector, image, score_threshold=0.3, single_image=True)) == 1
    assert len(detect_image(detector, empty, score_threshold=0.05, single_image=True)) == 0


@needs_kitti
@pytest.mark.parametrize("frame", [75, 80, 85])
def test_real_cones_are_found(detector: Detector, frame: int) -> None:
    image = cv2.imread(str(KITTI_LEFT / f"{frame:010d}.jpg"))
    found = detect_image(detector, image, score_threshold=0.3)
    assert len(found) >= 2
    assert np.all(np.diff(found[:, 4]) <= 0)
    assert np.all(found[:, :2] >= 0) and np.all(found[:, 0] + found[:, 2] <= image.shape[1])


@needs_kitti
def test_cone_free_real_frames_are_nearly_empty(detector: Detector) -> None:
    frames = range(0, 40, 8)
    images = [cv2.imread(str(KITTI_LEFT / f"{frame:010d}.jpg")) for frame in frames]
    count = sum(len(detect_image(detector, image, score_threshold=0.5)) for image in images)
    assert count <= len(images)  # at most one false box an image


def test_drums_are_told_from_cones(detector: Detector) -> None:
    path = SHARED / "cones_more" / "roadwork_clips_us" / "images" / "houston_0187.jpg"
    image = cv2.imread(str(path)) if path.exists() else None
    if image is None:
        pytest.skip(f"{path} is not there")
    names = detector.card.class_names
    found = detect_image(detector, image, score_threshold=0.3, categories=None, single_image=True)
    drums = found[found[:, 9] == names.index("drum")]
    assert len(drums) == 3
    cones = detect_image(detector, image, score_threshold=0.3, single_image=True)
    assert (cones[:, 9] == names.index("traffic_cone")).all()
    corners_of_drums, corners_of_cones = (np.hstack((b[:, :2], b[:, :2] + b[:, 2:4])) for b in (drums, cones))
    for box in corners_of_drums:
        assert decoding.intersection_over_union(box, corners_of_cones).max(initial=0) < 0.3
