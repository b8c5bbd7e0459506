"""What is kept out, and what two detectors are compared by; samples of judged images."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from conetl.learning.augment import clip_regions, make_sample, pyramid
from conetl.learning.classes import CLASSES, EVERY_SIZE
from conetl.learning.comparison import compare, require_same_classes, write_comparison_page
from conetl.learning.evidence.again import measure_again
from conetl.learning.held_out import SHARE, hold_out
from conetl.learning.images import LabelledImage, objects_from
from conetl.learning.labels.folder import NOTHING, BoxRow, labelled_image
from conetl.learning.replay import DRAWN, drawn_cut_outs, drawn_scenes
from conetl.model.errors import InputError
from conetl.perception.detector import load_detector


def image(name, recording, objects=2, seed=0):
    pixels = np.random.default_rng(seed).integers(60, 190, (120, 160, 3)).astype(np.uint8)
    boxes = objects_from([(20 + 40 * k, 40, 40 + 40 * k, 80) for k in range(objects)], [0] * objects)
    return LabelledImage(name, recording, pixels, boxes)


@pytest.mark.parametrize("sizes", [(10, 10, 10, 10), (30, 5, 5), (5, 5), (1, 9, 2, 8, 20)])
def test_whole_recordings_are_kept_out(sizes):
    images = [image(f"{k}_{i}", f"drive_{k}") for k, size in enumerate(sizes) for i in range(size)]
    own, kept = hold_out(images)
    assert len(own) + len(kept) == len(images) and kept
    if len(sizes) > 2:
        assert not {one.source for one in own} & {one.source for one in kept}
        assert SHARE * len(images) <= len(kept) + max(sizes) and len(kept) < len(images) / 2


def test_of_one_recording_the_last_images_are_kept_out():
    images = [image(f"{i:02d}", "drive") for i in range(20)]
    own, kept = hold_out(images[::-1])
    assert sorted(one.name for one in kept) == [f"{i:02d}" for i in range(15, 20)] and len(own) == 15


def test_samples_of_judged_images_teach_nothing_outside_of_their_boxes():
    boxes = [BoxRow("a", "traffic_cone", 60, 40, 20, 40, "pin"), BoxRow("a", NOTHING, 110, 40, 20, 40, "suppress")]
    judged = labelled_image("a", "drive", [], image("a", "drive").image, boxes)
    pair = (judged, pyramid(judged.image))
    cut_outs = drawn_cut_outs(3, 28)
    rng = np.random.default_rng(5)
    for _ in range(20):
        pixels, objects, trusts, fades = make_sample(lambda _: pair, [pair], cut_outs, 128, rng)
        assert pixels.shape == (128, 128, 3) and len(objects) == len(trusts)
        assert (fades[:, 4] == EVERY_SIZE).any() and np.isfinite(objects[:, :4]).all()


def test_regions_are_cut_at_the_edge_however_little_is_left():
    regions = np.array([[-100.0, -100, 4, 4, 7], [50, 50, 60, 60, 7], [200, 0, 300, 10, 7]])
    assert clip_regions(regions, (0, 0, 100, 100)).tolist() == [[0, 0, 4, 4, 7], [50, 50, 60, 60, 7]]


@pytest.fixture(scope="module")
def detector():
    return load_detector()


@pytest.fixture(scope="module")
def scenes():
    return drawn_scenes([image("a", "drive", 0), image("b", "drive", 0, seed=1)], 6, 11)


def test_drawn_scenes_hold_what_was_drawn(scenes):
    assert len(scenes) == 6 and sum(len(one.boxes) for one in scenes) > 10
    for one in scenes:
        height, width = one.image.shape[:2]
        assert one.source == DRAWN and (one.boxes[:, 2] <= width).all() and (one.boxes[:, 3] <= height).all()


def test_a_detector_is_compared_with_itself_and_with_one_that_finds_nothing(detector, scenes, tmp_path, monkeypatch):
    own = [dataclasses.replace(one, source="drive", judged_only=False, fade=np.zeros((0, 4))) for one in scenes[:2]]
    own[0].false = np.array([[0.0, 0.0, 8.0, 8.0]])
    same = compare(detector, detector, [*own, *scenes[2:]])
    assert same.changed == [] and same.refused == (1, 0, 0)
    assert all(row.recall[0] == row.recall[1] for row in same.figures if row.objects)
    assert {row.images for row in same.figures} == {"own", DRAWN}
    blind = dataclasses.replace(detector, card=detector.card.model_copy(update={"sha256": "0" * 64}))
    from conetl.learning import comparison

    real = comparison.detect_image
    monkeypatch.setattr(comparison, "detect_image", lambda d, *a, **k: real(d, *a, **k)[: 0 if d is blind else None])
    found = compare(detector, blind, own)
    seen = {row.category: row for row in found.figures if row.score == 0.3}
    assert len(found.changed) > 0 and all(row.recall[1] == 0 for row in seen.values() if row.objects)
    page = write_comparison_page(
        tmp_path / "page.html", "old and new", ["a line"], found, "Kept out: drive."
    ).read_text()
    assert "Images that changed" in page and "data:image/jpeg;base64," in page and "traffic cone" in page


def test_networks_of_other_classes_cannot_be_taught(detector):
    require_same_classes(detector)
    other = dataclasses.replace(detector, card=detector.card.model_copy(update={"class_names": CLASSES[::-1]}))
    with pytest.raises(InputError, match="can be taught"):
        require_same_classes(other)


def test_evidence_of_few_images_is_refused_with_the_counts(detector, scenes):
    evidence, why = measure_again(detector, detector.card.evidence, scenes[:1])
    assert evidence is None and "at least" in why
    assert measure_again(detector, None, scenes) == (None, "the network that it was made from has no evidence")
