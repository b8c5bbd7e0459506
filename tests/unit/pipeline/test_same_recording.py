"""Which drives are one recording, whatever they are called."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from conetl.model.drive import FramePair
from conetl.model.rig import Rig
from conetl.pipeline.compared.same_recording import has_same_log, is_redated, is_same_camera
from tests.synthetic.world import drive_of, make_path, make_rig, shifted

RIG = make_rig()
PAIRS = tuple(make_path(20))
DRIVE = drive_of(PAIRS, RIG)


def later(pair: FramePair, seconds: float) -> FramePair:
    return pair.model_copy(update={"captured_at_ns": pair.captured_at_ns + round(seconds * 1e9)})


def turned(rig: Rig, degrees: float) -> Rig:
    """The rig, looking elsewhere from the same vehicle."""
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_euler("z", degrees, degrees=True).as_matrix()
    poses = {
        name: tuple(map(tuple, turn @ np.array(getattr(rig, name)))) for name in ("body_SE3_left", "body_SE3_right")
    }
    return rig.model_copy(update=poses)


@pytest.mark.parametrize(
    ("pairs", "rig", "same"),
    [
        (PAIRS, RIG, True),
        ([shifted(pair, (0.6, -0.5, 0.0)) for pair in PAIRS], RIG, True),  # another GNSS solution
        ([later(pair, 0.02) for pair in PAIRS[:12]], RIG, True),  # a part of it, with another start of the clock
        ([shifted(pair, (0.0, 3.5, 0.0)) for pair in PAIRS], RIG, False),  # a vehicle beside it
        ([later(pair, 3600.0) for pair in PAIRS], RIG, False),
        (PAIRS[:1], RIG, False),
        (PAIRS, turned(RIG, 90.0), False),
    ],
)
def test_the_same_camera(pairs: list[FramePair], rig: Rig, same: bool) -> None:
    assert is_same_camera(DRIVE, rig, pairs) is same


def numbered(pairs: Sequence[FramePair], first: int) -> list[FramePair]:
    return [pair.model_copy(update={"frame_index": first + k}) for k, pair in enumerate(pairs)]


@pytest.mark.parametrize(
    ("pairs", "same"),
    [
        (
            [shifted(later(pair, 7200.0), (0.5, 0.0, 0.0)) for pair in PAIRS[3:]],
            True,
        ),  # of another zone, another solution
        ([later(pair, 7200.0 + 0.003 * (k % 6 == 0)) for k, pair in enumerate(PAIRS)], False),
        # Two frames in common: where this drive ended another one begins.
        (
            [
                later(p, 7200.0)
                for p in [
                    *PAIRS[18:],
                    *numbered(make_path(20, start_m=20.0, first_ns=PAIRS[-1].captured_at_ns + 100_000_000), 20),
                ]
            ],
            False,
        ),
    ],
)
def test_time_stamps_of_another_zone_are_those_of_the_same_recording(pairs: list[FramePair], same: bool) -> None:
    assert is_redated(DRIVE, RIG, pairs, within_m=2.0, within_rad=0.5) is same


@pytest.mark.parametrize(
    ("pairs", "same"),
    [
        (PAIRS, True),
        (PAIRS[4:], True),  # the first ones are lost
        (numbered(PAIRS[6:14], 0), True),  # 40 % of the frames, numbered anew
        ([*numbered(PAIRS[4:12], 0), *numbered([shifted(p, (0.0, 9.0, 0.0)) for p in PAIRS], 8)], False),
        (
            [shifted(pair, (0.02 * (-1) ** k, 0.01, 0.0)) for k, pair in enumerate(PAIRS)],
            True,
        ),  # adjusted to the images
        ([shifted(pair, (0.4, 0.0, 0.0)) for pair in PAIRS], False),  # another drive in the same lane
        ([shifted(pair, (0.0, 0.05 * k, 0.0)) for k, pair in enumerate(PAIRS)], False),
        (PAIRS[:7], False),
        ([pair.model_copy(update={"pose": PAIRS[0].pose}) for pair in PAIRS], False),  # a vehicle that waits
    ],
)
def test_the_log_of_a_recording_is_known_whatever_its_clock(pairs: list[FramePair], same: bool) -> None:
    drive = DRIVE if len({pair.pose for pair in pairs}) > 1 else DRIVE.model_copy(update={"frame_pairs": tuple(pairs)})
    assert has_same_log(drive, RIG, [later(pair, 3600.0) for pair in pairs]) is same


@pytest.mark.parametrize(("frames", "step_m", "same"), [(20, 1.0, False), (40, 1.02, False), (40, 1.0, True)])
def test_two_drives_in_one_lane_at_about_one_speed_are_not_one(frames: int, step_m: float, same: bool) -> None:
    """Of a GNSS without a fix (0.3 m), whose cameras have a regular trigger; the last is a recording itself."""
    drive = DRIVE.model_copy(update={"frame_pairs": tuple(make_path(frames, sigma_m=0.3))})
    other = [shifted(pair, (-0.4, 0.2, 0.0)) for pair in make_path(frames, step_m, sigma_m=0.3)]
    assert has_same_log(drive, RIG, [later(pair, 3600.0) for pair in other]) is same


def test_a_few_frames_are_not_known_by_their_log() -> None:
    few = DRIVE.model_copy(update={"frame_pairs": PAIRS[:5]})
    assert not has_same_log(few, RIG, [later(pair, 3600.0) for pair in PAIRS])
