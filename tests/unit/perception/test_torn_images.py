from __future__ import annotations

from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from conetl.checks.verdict import judge
from conetl.geometry.motion.stereo_motion import RelativeMotion
from conetl.model.drive import FramePair
from conetl.model.health import HealthCheck, Verdict
from conetl.model.rejections import RejectionReason
from conetl.model.rig import SIDES, Side
from conetl.perception.checks.torn_images import TornImage, check_seams, check_torn, find_torn, row_changes, thinned
from conetl.perception.rectified_image import read_pair_image
from conetl.readers.drives import read_drive
from tests.folders import SAMPLES

Image = NDArray[np.uint8]
DRIVE = read_drive(SAMPLES[0])[0]
PAIRS = DRIVE.frame_pairs
#: Sensors add other noise to every image, of a standing scene too.
NOISE = np.random.default_rng(0).normal(0.0, 2.0, (320, 960))


@cache
def intact(number: int, side: Side) -> Image:
    return read_pair_image(PAIRS[number], side, DRIVE.rig, grey=True)


class Recording:
    """Images of the sample drive, some of which can be replaced."""

    def __init__(self) -> None:
        self.images = {(k, side): intact(k, side) for k in range(len(PAIRS)) for side in SIDES}

    def tear(self, row: int, *numbers: int, sides: tuple[Side, ...] = SIDES) -> Recording:
        for k in numbers:
            for side in sides:
                torn = intact(k, side).copy()
                torn[row:] = intact(k - 1, side)[row:]
                self.images[k, side] = torn
        return self

    def read(self, pair: FramePair, side: Side) -> Image:
        return self.images[PAIRS.index(pair), side]

    def torn(self) -> list[TornImage]:
        return find_torn(DRIVE, [self._motion(k) for k in range(len(PAIRS) - 1)], self.read)

    def _motion(self, k: int) -> RelativeMotion:
        changes = [row_changes(self.images[k, side], self.images[k + 1, side]) for side in SIDES]
        first, second = (pair.frame_index for pair in PAIRS[k : k + 2])
        return RelativeMotion(
            first_frame_index=first, second_frame_index=second, second_SE3_first=None, cov=(), inlier_count=0, point_count=0,
            reason="too_few_points", row_changes=tuple(np.concatenate(changes).tolist()),
        )  # fmt: skip

    def seams(self) -> HealthCheck:
        chosen = np.linspace(0, len(PAIRS) - 1, 5).astype(int).tolist()
        finding = check_seams(
            {side: [thinned(self.images[k, side]) for k in chosen] for side in SIDES},
            lambda side: [thinned(self.images[k, side]) for k in range(1, len(PAIRS), 2) if k not in chosen],
        )
        return judge(finding)


def frames(torn: list[TornImage]) -> set[int]:
    return {PAIRS.index(one.pair) for one in torn}


def test_intact_images_are_not_torn() -> None:
    recording = Recording()
    assert recording.torn() == [] and recording.seams().verdict is Verdict.PASS
    check, rejections = check_torn([], DRIVE)
    assert judge(check).verdict is Verdict.PASS and check.value == 0.0 and rejections == []


@pytest.mark.parametrize("row", [96, 150, 200, 256])
def test_single_torn_images_are_found_with_side_and_row(row: int) -> None:
    torn = Recording().tear(row, 10, 25, sides=("right",)).torn()
    assert frames(torn) == {10, 25} and {one.side for one in torn} == {"right"}
    assert all(abs(one.row_px - row) <= 10 for one in torn)


def test_images_after_it_that_are_torn_at_the_same_row_are_found() -> None:
    assert frames(Recording().tear(200, 10, 11, 12).torn()) == {10, 11, 12}


def test_a_pair_with_two_torn_images_is_rejected_once_and_many_hold_the_drive() -> None:
    few = Recording().tear(200, 10).torn()
    check, [rejection] = check_torn(few, DRIVE)
    passed = judge(check)
    assert len(few) == 2 and passed.verdict is Verdict.PASS and "1 of 39 frame pairs were torn" in passed.detail
    assert rejection.reason is RejectionReason.IMAGE_TORN and rejection.payload["frame_index"] == PAIRS[10].frame_index
    assert f"{Path(PAIRS[10].left_path).name}: from about row" in rejection.detail
    many = Recording().tear(200, *range(4, 39, 3)).torn()
    check, rejections = check_torn(many, DRIVE)
    held = judge(check)
    assert held.verdict is Verdict.HOLD and len(rejections) == 12 and "12 of 39 frame pairs are torn" in held.detail


@pytest.mark.parametrize("row", [130, 192, 256])
@pytest.mark.parametrize("sides", [SIDES, ("left",)])
def test_a_drive_whose_images_are_all_torn_at_one_row_is_held(row: int, sides: tuple[Side, ...]) -> None:
    check = Recording().tear(row, *range(1, len(PAIRS)), sides=sides).seams()
    assert check.verdict is Verdict.HOLD and f"row {row} of the left images" in check.detail
    assert ("right images" in check.detail) == ("right" in sides)


def test_the_hood_of_the_vehicle_a_caption_and_a_covered_lens_are_no_seams() -> None:
    columns = np.linspace(-1.0, 1.0, 960)
    hood = np.arange(320)[:, None] > 270 + 30 * columns**2
    flat = np.arange(320)[:, None] > np.full(960, 280)
    for part, grey in ((hood, 120), (flat, 30), (flat, 160), (np.arange(320)[:, None] >= np.full(960, 160), 0)):
        recording = Recording()
        for number, (key, image) in enumerate(recording.images.items()):
            own = np.clip(grey + np.roll(NOISE, 7 * number, axis=1), 0, 255).astype(np.uint8)
            recording.images[key] = np.where(part, own, image)
        assert recording.torn() == [] and recording.seams().verdict is Verdict.PASS


def test_a_seam_above_a_bar_is_found() -> None:
    recording = Recording().tear(192, *range(1, len(PAIRS)))
    bar = np.full((40, 960), 70, np.uint8)
    recording.images = {key: np.vstack([image[:280], bar]) for key, image in recording.images.items()}
    assert "torn at row 192 of the left images and row 192 of the right images" in recording.seams().detail


def test_a_standing_vehicle_is_not_torn() -> None:
    """Images of a scene that stands, with someone walking in the upper part, with the noise of a sensor and without."""
    for noise in (NOISE, 0 * NOISE):
        recording = Recording()
        for k in range(12, 25):
            for side in SIDES:
                scene = intact(12, side).astype(np.float64) + np.roll(noise, 7 * k, axis=1)
                cv2.circle(scene, (100 + 20 * k, 100), 25, (60.0,), -1)
                recording.images[k, side] = np.clip(scene, 0, 255).astype(np.uint8)
        assert recording.torn() == []


def test_too_few_images_are_not_judged() -> None:
    assert check_seams({side: [] for side in SIDES}, lambda _: []).value is None
    assert find_torn(DRIVE.model_copy(update={"frame_pairs": PAIRS[:1]}), [], Recording().read) == []
