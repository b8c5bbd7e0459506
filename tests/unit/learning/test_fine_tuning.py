"""The training step: skipped where PyTorch is not installed (extra `train`)."""

from __future__ import annotations

import csv
import dataclasses

import cv2
import numpy as np
import pytest

from conetl.learning.labels.folder import BoxRow, ImageRow, write_label_files
from conetl.learning.new_model import train_model
from conetl.learning.replay import drawn_scenes
from conetl.model.errors import InputError
from conetl.perception.decoding import intersection_over_union
from conetl.perception.detector import detect_image, load_detector
from conetl.perception.model_card import shipped_model_path
from tests.unit.learning.test_measuring import image


def label_folder(folder, count):
    """Drawn scenes as an operator's labels, of two recordings."""
    scenes = drawn_scenes([image(str(k), "x", 0, seed=k) for k in range(3)], count, 7)
    (folder / "images").mkdir(parents=True)
    images, boxes = [], []
    for number, one in enumerate(scenes):
        name = f"{number:02d}.png"
        cv2.imwrite(str(folder / "images" / name), cv2.resize(one.image, None, fx=2, fy=2))
        images.append(ImageRow(name, f"drive_{number % 3}", "traffic_cone", 320, 240))
        cones = one.boxes[one.boxes[:, 8] == 0, :4] * 2
        boxes += [BoxRow(name, "traffic_cone", x, y, u - x, v - y, "drawn") for x, y, u, v in cones.tolist()]
    write_label_files(folder, images, boxes, [], "yolo")
    return folder


def test_too_few_labels_or_another_name_are_refused(tmp_path):
    pytest.importorskip("torch", reason="PyTorch is not installed: pip install 'conetl[train]'")
    with pytest.raises(InputError, match="at least 8 images"):
        train_model(label_folder(tmp_path / "labels", 4), tmp_path / "new.onnx")
    with pytest.raises(InputError, match=r"ends with \.onnx"):
        train_model(tmp_path / "labels", tmp_path / "new.pt")
    assert not list(tmp_path.glob("new*"))


def test_without_pytorch_the_remedy_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "torch", None)
    for name in ("fine_tuning", "learner", "loss", "network", "onnx_export", "restore"):
        monkeypatch.delitem(__import__("sys").modules, f"conetl.learning.{name}", raising=False)
    with pytest.raises(InputError, match=r"pip install 'conetl\[train\]'"):
        train_model(tmp_path, tmp_path / "new.onnx")


def test_the_restored_network_answers_as_the_shipped_one(tmp_path):
    pytest.importorskip("torch", reason="PyTorch is not installed: pip install 'conetl[train]'")
    from conetl.learning.onnx_export import export_network
    from conetl.learning.restore import restored_network

    scenes = drawn_scenes([image(str(k), "x", 0, seed=k) for k in range(3)], 6, 3)
    export_network(restored_network(shipped_model_path(), [one.image for one in scenes]), tmp_path / "again.onnx")
    card = load_detector().card.model_dump(mode="json")
    assert card["head"]["side_bins"] == 16
    shipped = load_detector()
    import hashlib
    import json

    card |= {
        "sha256": hashlib.sha256((tmp_path / "again.onnx").read_bytes()).hexdigest(), "evidence": None,
        "input_layout": "BGR float32 NHWC 0..255",
    }  # fmt: skip
    (tmp_path / "again.onnx.json").write_text(json.dumps(card))
    again = load_detector(tmp_path / "again.onnx")
    seen = 0
    for one in scenes:
        old, new = (detect_image(d, one.image, score_threshold=0.3, categories=None) for d in (shipped, again))
        corners = np.concatenate((new[:, :2], new[:, :2] + new[:, 2:4]), axis=1)
        for box in old[old[:, 4] >= 0.5]:
            overlaps = intersection_over_union(np.concatenate((box[:2], box[:2] + box[2:4])), corners)
            assert overlaps.max(initial=0.0) > 0.75 and abs(new[overlaps.argmax(), 4] - box[4]) < 0.15
            seen += 1
    assert seen > 5


def test_a_model_is_taught_and_written_with_card_and_page(tmp_path):
    pytest.importorskip("torch", reason="PyTorch is not installed: pip install 'conetl[train]'")
    steps = []
    made = train_model(
        label_folder(tmp_path / "labels", 12), tmp_path / "new.onnx", minutes=0.5, threads=1,
        progress=lambda share, text: steps.append(share),
    )  # fmt: skip
    detector = load_detector(made.model)
    assert detector.card.name == "new" and detector.card.version.endswith(f"+{made.trained_on}")
    assert detector.card.detections_sha256 != load_detector().card.detections_sha256
    assert (detector.card.evidence is not None) == made.is_measured
    assert len(made.kept_out) == 1 and made.page.read_text().startswith("<!doctype html>")
    with (tmp_path / "labels/images.csv").open() as file:
        kept = [row["image"] for row in csv.DictReader(file) if row["recording"] in made.kept_out]
    assert made.trained_on == 12 - len(kept)
    assert steps == sorted(steps) and dataclasses.is_dataclass(detector)
