"""Parts of the images that are blurred, of drives whose lenses are smeared; and a camera that loses a frame."""

from __future__ import annotations

from pathlib import Path

import pytest

from conetl.checks.verdict import judge_all
from conetl.model.drive import Drive
from conetl.model.health import Verdict
from conetl.model.rig import Lens
from conetl.perception.checks.stereo_check import check_stereo
from conetl.readers.drives import read_drive
from tests.integration.small_drives import SAMPLES, spoil_huffman_table
from tests.mutants.images import PairMutant, both, changed, copy_drive, only_right, smeared
from tests.mutants.recordings import right_late
from tests.unit.readers.drive_formats import sample_frames, sample_rig, write_plain


def wrong(change: PairMutant, folder: Path) -> Drive:
    copy = copy_drive(SAMPLES[0], folder / "drive")
    changed(change)(copy)
    return check_stereo(read_drive(copy)[0])[0]


def test_a_part_of_one_lens_that_is_smeared_is_found(tmp_path: Path) -> None:
    unclear = wrong(only_right(smeared(5.0, top=0.4, left=0.5)), tmp_path).unclear
    assert unclear is not None and unclear.side_px == 64 and not unclear.left
    camera = read_drive(SAMPLES[0])[0].rig.right
    rows, columns = camera.height_px // 64, camera.width_px // 64
    truth = {
        (row, column)
        for row in range(rows)
        for column in range(columns)
        if 64 * row > 0.4 * 64 * rows and column > columns / 2
    }
    found = set(unclear.right)
    assert len(truth & found) >= 0.9 * len(truth)
    assert all(row >= 0.4 * rows - 1.5 and column >= columns / 2 - 1.5 for row, column in found)


def test_the_lower_part_of_both_lenses_that_is_smeared_is_found(tmp_path: Path) -> None:
    unclear = wrong(both(smeared(5.0)), tmp_path).unclear
    assert unclear is not None and unclear.left and unclear.right
    assert all(row >= 2 for row, _ in (*unclear.left, *unclear.right))


def test_rectified_images_of_different_lenses_may_differ_in_width(tmp_path: Path) -> None:
    """Each keeps what its camera sees."""
    rig = sample_rig()
    lenses = {side: Lens(model="radial", coefficients=(k1, 0.0)) for side, k1 in (("left", -0.06), ("right", 0.06))}
    raw = rig.model_copy(
        update={side: getattr(rig, side).model_copy(update={"lens": lens}) for side, lens in lenses.items()}
    )
    drive, _ = read_drive(write_plain(tmp_path / "drive", sample_frames(), raw))
    widths = [camera.width_px // 64 for camera in (drive.rig.left, drive.rig.right)]
    assert widths[0] != widths[1]
    checks = {check.name: check for check in judge_all(check_stereo(drive)[1])}
    assert "blurred parts of the lenses" in checks and "distortion of the lenses" in checks


@pytest.mark.parametrize("first", [9, 20, 28, 35])
def test_a_camera_that_loses_a_frame_is_found_from_where_it_does(first: int) -> None:
    checks = judge_all(check_stereo(right_late(1, first)(read_drive(SAMPLES[0])[0]))[1])
    trigger = next(check for check in checks if check.name == "trigger of both cameras")
    assert (trigger.verdict, trigger.value) == (Verdict.HOLD, 1.0)
    assert "1 frames earlier" in trigger.detail and "in frame pairs" in trigger.detail


@pytest.mark.parametrize("lost", [(19, 28), (0, 9, 19, 28, 38)])
def test_images_that_cannot_be_decoded_are_not_those_of_another_frame(lost: tuple[int, ...], tmp_path: Path) -> None:
    """The right images beside them fit better than they do."""
    copy = copy_drive(SAMPLES[0], tmp_path / "drive")
    for frame in lost:
        spoil_huffman_table(copy / "image_03" / "data" / f"{frame:010}.jpg")
    checks = {check.name: check for check in judge_all(check_stereo(read_drive(copy)[0])[1])}
    assert checks["trigger of both cameras"].verdict is Verdict.PASS
    found = checks["images that can be decoded"]
    assert (found.verdict, found.value, found.unit) == (Verdict.NOTE, 20 * len(lost), "%")
    assert f"frame pairs {', '.join(map(str, lost))}. Such" in found.detail
