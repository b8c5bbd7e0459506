"""Visual odometry without poses, on a sample drive; and what reads it for the offset of the clocks."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from conetl.geometry import pose as se3
from conetl.model.drive import Drive
from conetl.model.errors import InputError
from conetl.model.rig import Side
from conetl.perception.rectified_image import read_pair_image
from conetl.perception.unguided_odometry import measure_motions
from conetl.readers.drives import read_drive
from conetl.readers.drives.drive_yaml import Clock
from conetl.readers.drives.poses import Samples
from conetl.readers.drives.video_timing import image_clock
from conetl.tracking.clock_search import ImageClock, rates_of
from tests.folders import SAMPLE

IMAGES = 8


@pytest.fixture(scope="module")
def drive() -> Drive:
    return read_drive(SAMPLE)[0]


def test_speed_and_turn_rate_without_a_guess(drive: Drive) -> None:
    """At 13 m/s near points move by a fifth of the image between two images."""
    pairs = drive.frame_pairs[:IMAGES]
    times_ns = [pair.captured_at_ns for pair in pairs]
    motions = measure_motions(
        times_ns, drive.rig, lambda n, side: read_pair_image(pairs[n], side, drive.rig, grey=True)
    )
    assert [motion.reason for motion in motions] == ["ok"] * (IMAGES - 1)
    rates = rates_of(motions, dict(enumerate(times_ns)), drive.rig)
    poses = np.stack([se3.map_SE3_body(pair.pose) for pair in pairs])
    speed = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1) / np.diff(times_ns) * 1e9
    yaw = np.unwrap(np.arctan2(poses[:, 1, 0], poses[:, 0, 0]))
    assert np.abs(rates.speed_m_s - speed).max() < 0.05 * speed.max()
    assert np.abs(rates.turn_rad_s - np.diff(yaw) / np.diff(times_ns) * 1e9).max() < 0.02


def test_images_that_show_nothing_give_no_motions_and_no_offset(drive: Drive) -> None:
    reads = []

    def dark(number: int, side: Side) -> NDArray[np.uint8]:
        reads.append(number)
        return np.zeros((drive.rig.left.height_px, drive.rig.left.width_px), np.uint8)

    times_ns = [pair.captured_at_ns for pair in drive.frame_pairs[:20]]
    motions = measure_motions(times_ns, drive.rig, dark)
    assert [motion.second_SE3_first for motion in motions] == [None] * 19
    assert len(reads) < 4 * 20
    poses = np.stack([se3.map_SE3_body(pair.pose) for pair in drive.frame_pairs])
    stamps = [pair.captured_at_ns for pair in drive.frame_pairs]
    track = Samples("gnss.csv", stamps, poses, np.full((len(stamps), 6), 0.1), {})
    with pytest.raises(InputError, match=r"gnss\.csv: .* cannot be determined .* drive\.yaml: 'clock: \{offset_s"):
        image_clock(Clock(), track, times_ns, drive.rig, dark, from_course=False)
    reads.clear()
    assert image_clock(None, track, times_ns, drive.rig, dark, from_course=False) == ImageClock(0.0, 0.0)
    stated = Clock(offset_s=-7.5, sigma_s=0.02)
    assert image_clock(stated, track, times_ns, drive.rig, dark, from_course=False) == ImageClock(-7.5, 0.02)
    assert not reads
