"""The summary of drives with known gaps and jumps, and images judged by their ends."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from conetl.model.drive import Drive, FramePair
from conetl.model.rejections import RejectionReason
from conetl.perception.images import ImageFileError, check_image_ends
from conetl.readers.drives import read_drive
from conetl.readers.drives.summary import summarise
from tests.unit.readers.drive_formats import SAMPLE


@pytest.fixture(scope="module")
def sample() -> Drive:
    return read_drive(SAMPLE, headers_only=True)[0]


def moved(drive: Drive, frame: int, by_m: float) -> Drive:
    def shift(pair: FramePair) -> FramePair:
        x, y, z = pair.pose.map_t_body_m
        pose = pair.pose.model_copy(update={"map_t_body_m": (x + by_m, y, z)})
        return pair.model_copy(update={"pose": pose}) if pair.frame_index == frame else pair

    return drive.model_copy(update={"frame_pairs": tuple(map(shift, drive.frame_pairs))})


def test_a_clean_drive(sample: Drive) -> None:
    summary = summarise(sample, [])
    assert summary.rate_hz == pytest.approx(10.0)
    assert (summary.usable_pairs, summary.expected_pairs, summary.gaps, summary.poses.jumps) == (39, 39, (), ())
    positions = np.array([p.pose.map_t_body_m for p in sample.frame_pairs])
    assert summary.length_m == pytest.approx(np.linalg.norm(np.diff(positions[:, :2], axis=0), axis=1).sum())
    assert summary.extent.east_m == (positions[:, 0].min(), positions[:, 0].max())
    assert (summary.poses.horizontal_sigma_median_m, summary.poses.vertical_sigma_median_m) == (0.02, 0.03)
    assert not summary.rig.calibration_covariance_known


def test_gaps_in_time_and_space(sample: Drive) -> None:
    kept = tuple(p for p in sample.frame_pairs if not 10 <= p.frame_index < 14)
    gap, *others = summarise(sample.model_copy(update={"frame_pairs": kept}), []).gaps
    assert others == []
    assert (gap.after_frame, gap.before_frame, gap.in_time, gap.in_space) == (9, 14, True, True)
    assert gap.seconds == pytest.approx(0.5)
    assert 6.0 < gap.metres < 7.5


@pytest.mark.parametrize(("by_m", "reported"), [(0.3, []), (1.5, [20]), (6.0, [20])])
def test_a_jump_is_reported_once(sample: Drive, by_m: float, reported: list[int]) -> None:
    summary = summarise(moved(sample, 20, by_m), [])
    assert summary.gaps == ()  # the same error is not a gap as well
    jumps = summary.poses.jumps
    assert [jump.frame for jump in jumps] == reported
    assert all(jump.off_m == pytest.approx(by_m, abs=0.05) for jump in jumps)


@pytest.mark.parametrize("lost", [2, 5, 10, 15])
@pytest.mark.parametrize("up", [False, True])
def test_a_jump_across_a_gap_is_reported(sample: Drive, lost: int, up: bool) -> None:
    """The speeds before and after the gap do not allow it; a gap alone is no jump."""

    def shifted(metres: float) -> Drive:
        def shift(pair: FramePair) -> FramePair:
            x, y, z = pair.pose.map_t_body_m
            place = (x, y, z + metres) if up else (x, y + metres, z)
            return pair.model_copy(update={"pose": pair.pose.model_copy(update={"map_t_body_m": place})})

        pairs = [p if p.frame_index < 15 else shift(p) for p in sample.frame_pairs]
        kept = tuple(p for p in pairs if not 15 <= p.frame_index < 15 + lost)
        return sample.model_copy(update={"frame_pairs": kept})

    assert summarise(shifted(0.0), []).poses.jumps == ()
    [jump] = summarise(shifted(50.0), []).poses.jumps
    assert jump.frame == 15 + lost and jump.off_m == pytest.approx(50.0, abs=1.5)


def test_the_ends_of_an_image_suffice_for_its_checks(tmp_path: Path) -> None:
    noise = np.random.default_rng(1).integers(0, 255, (300, 400, 3), np.uint8)  # larger than what is read of it
    for suffix in (".png", ".jpg"):
        data = bytes(cv2.imencode(suffix, noise, [cv2.IMWRITE_JPEG_QUALITY, 100])[1].tobytes())
        path = tmp_path / f"image{suffix}"
        path.write_bytes(data)
        assert len(data) > 100_000
        header = check_image_ends(path, path.name, (400, 300))
        assert (header.width_px, header.height_px) == (400, 300)
        with pytest.raises(ImageFileError) as wrong:
            check_image_ends(path, path.name, (401, 300))
        assert wrong.value.reason is RejectionReason.IMAGE_WRONG_SIZE
        path.write_bytes(data[:-50])
        with pytest.raises(ImageFileError) as cut:
            check_image_ends(path, path.name, (400, 300))
        assert cut.value.reason is RejectionReason.IMAGE_TRUNCATED
