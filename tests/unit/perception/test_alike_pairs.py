"""Which frame pairs are left out because they show what others show."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conetl.model.arrays import Image
from conetl.model.drive import FramePair, Pose
from conetl.model.params import SelectionParams
from conetl.model.rejections import RejectionReason
from conetl.model.rig import Side
from conetl.perception.alike_pairs import without_alike
from conetl.perception.images import ImageFileError

PARAMS = SelectionParams(fewest_pairs=1)
RNG = np.random.default_rng(5)
STREET = RNG.integers(0, 256, (128, 800), dtype=np.uint8)


def pairs(times_s: Sequence[float], along_m: Sequence[float]) -> list[FramePair]:
    """Frame pairs of a vehicle that drives east."""
    return [
        FramePair(
            frame_index=k, left_path=f"{k}", right_path=f"{k}", captured_at_ns=round(1e9 * t),
            pose=Pose(
                map_R_body=((1, 0, 0), (0, 1, 0), (0, 0, 1)), map_t_body_m=(x, 0, 0),
                sigma_enu_m=(0.02,) * 3, sigma_rpy_rad=(0.001,) * 3,
            ),
        )
        for k, (t, x) in enumerate(zip(times_s, along_m, strict=True))
    ]  # fmt: skip


def kept(
    frame_pairs: Sequence[FramePair], shown: Sequence[int] | None = None, params: SelectionParams = PARAMS
) -> list[int]:
    """Indices that are kept. shown: column of the street that each image begins at; default: no image may be read."""

    def read(pair: FramePair, side: Side) -> Image:
        if shown is None:
            raise AssertionError("no image is needed")
        assert side == "left"
        start = shown[pair.frame_index]
        noise = np.random.default_rng(pair.frame_index).normal(0, 4, (128, 320))
        return np.clip(STREET[:, start : start + 320] + noise, 0, 255).astype(np.uint8)

    return [pair.frame_index for pair in without_alike(frame_pairs, read, params)]


@pytest.mark.parametrize(
    ("rate_hz", "every"), [(5, 1), (10, 1), (12, 1), (15, 1), (18, 1), (20, 2), (25, 2), (30, 3), (60, 6)]
)
def test_fast_cameras_are_used_at_ten_to_eighteen_pairs_per_second(rate_hz: int, every: int) -> None:
    frames = pairs([k / rate_hz for k in range(61)], [8 * k / rate_hz for k in range(61)])
    assert kept(frames) == list(range(0, 61, every))


def test_at_high_speed_all_pairs_count() -> None:
    frames = pairs([k / 30 for k in range(31)], [60 * k / 30 for k in range(31)])
    assert kept(frames) == list(range(31))


def test_a_stop_counts_at_its_beginning_and_its_end() -> None:
    along_m = [0.0, 1.0, *[2.0] * 600, 3.0, 4.0]
    frames = pairs([k / 10 for k in range(len(along_m))], along_m)
    assert kept(frames, [50 * round(x) for x in along_m]) == [0, 1, 2, 601, 602, 603]


def test_all_pairs_of_a_vehicle_that_only_stands_are_searched() -> None:
    frames = pairs([k / 10 for k in range(39)], [0.0] * 39)
    assert kept(frames, [0] * 39) == [0]
    assert kept(frames, [0] * 39, SelectionParams()) == list(range(39))


def test_a_log_that_stands_while_the_images_move_is_not_believed() -> None:
    frames = pairs([k / 10 for k in range(9)], [0.0] * 9)
    assert kept(frames, [40 * k for k in range(9)]) == list(range(9))


def test_a_log_that_repeats_each_pose_is_not_believed() -> None:
    """At 0.1 m between images, which agree by more than those of 0.3 m."""
    frames = pairs([k / 10 for k in range(9)], [2.0 * (k // 2) for k in range(9)])
    assert kept(frames, [2 * k for k in range(9)]) == list(range(9))


def test_a_jam_counts_every_0_3_m_at_least() -> None:
    frames = pairs([k / 10 for k in range(13)], [0.11 * k for k in range(13)])
    assert kept(frames, [0] * 13) == [0, 2, 4, 6, 8, 10, 12]


def test_an_image_that_cannot_be_read_is_left_to_the_search() -> None:
    def read(pair: FramePair, _side: Side) -> Image:
        if pair.frame_index == 1:
            raise ImageFileError(RejectionReason.IMAGE_UNREADABLE, "damaged")
        return STREET[:, :320]

    found = without_alike(pairs([0, 0.2, 0.4, 0.6], [0, 0, 0, 0]), read, PARAMS)
    assert [pair.frame_index for pair in found] == [0, 1, 2]


def test_nothing_is_left_out_on_request() -> None:
    frames = pairs([k / 30 for k in range(9)], [0.0] * 9)
    everything = SelectionParams(dense_s=0, standing_rad=0, standing_m=0, fewest_pairs=1)
    assert kept(frames, params=everything) == list(range(9))


@given(
    steps=st.lists(st.tuples(st.floats(0.005, 0.3), st.floats(0, 2)), min_size=1, max_size=60),
)
def test_gaps_of_fast_cameras_are_bounded(steps: list[tuple[float, float]]) -> None:
    """Between two kept pairs there is no more time and distance than what counts as near, or one step of the recording."""
    times_s, along_m = np.cumsum([(0.0, 0.0), *steps], axis=0).T
    frames = pairs(times_s, along_m)
    chosen = kept(frames, params=PARAMS.model_copy(update={"standing_m": 0.0}))
    for first, last in pairwise(chosen):
        near = (
            times_s[last] - times_s[first] <= PARAMS.dense_s + 1e-6
            and along_m[last] - along_m[first] <= PARAMS.dense_m + 1e-6
        )
        assert near or last == first + 1
