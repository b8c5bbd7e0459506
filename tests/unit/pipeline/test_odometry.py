"""Self-calibration of a drive in chunks, and frames that both cameras lose."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from conetl.files.parquet_store import load_result, save_result
from conetl.geometry.motion.stereo_tracks import StereoTracks, motions_of
from conetl.model.health import Verdict
from conetl.model.params import IngestParams, TrajectoryParams
from conetl.perception.visual_odometry import follow_drive
from conetl.pipeline import odometry as steps
from conetl.pipeline.chunks import Chunk, chunks_of
from conetl.pipeline.odometry import grey_reader, self_calibrate
from conetl.pipeline.settings import Settings
from conetl.readers.drives import read_drive
from conetl.tracking.checks.exposures import check_lost_frames
from tests.integration.small_drives import SAMPLES
from tests.mutants.recordings import images_shifted
from tests.synthetic.world import make_path, make_rig


@pytest.mark.parametrize(("chunk_pairs", "hinted"), [(4, True), (256, False)])
def test_chunks_shorter_than_a_span_are_named_as_the_cause(tmp_path: Path, chunk_pairs: int, hinted: bool) -> None:
    chunk = Chunk(
        rig=make_rig(), frame_pairs=tuple(make_path(4)), results_folder=tmp_path, model_path=None, detections_sha256="ab",
        params=IngestParams(chunk_pairs=chunk_pairs),
    )  # fmt: skip
    found = self_calibrate(chunk, [])
    assert found.detail.startswith("kept as given: 0 spans")
    assert ("chunk_pairs is 4" in found.detail) is hinted


@pytest.mark.parametrize(
    ("frames", "named"), [(1, "before frame pair 8:"), (-1, "before frame pair 8:"), (0, "No frame")]
)
def test_a_frame_that_both_cameras_lose_or_repeat_is_found(frames: int, named: str) -> None:
    drive = images_shifted(frames, 8)(read_drive(SAMPLES[0])[0])
    pairs, rig, params = drive.frame_pairs[:13], drive.rig, TrajectoryParams()
    motions = motions_of(follow_drive(pairs, rig, grey_reader(rig), params), pairs, rig, params)
    check = check_lost_frames(pairs, rig, list(motions), grey_reader(rig), params)
    assert named in check.detail and check.verdict is (Verdict.HOLD if frames else Verdict.PASS)


def test_a_drive_of_which_one_pair_is_left_is_checked(tmp_path: Path) -> None:
    drive = read_drive(SAMPLES[0])[0]
    pairs, rig, params = drive.frame_pairs[:3], drive.rig, IngestParams()
    followed = follow_drive(pairs, rig, grey_reader(rig), params.trajectory)
    motions = save_result(tmp_path, "motions", list(motions_of(followed, pairs, rig, params.trajectory)), [])
    drive = drive.model_copy(update={"frame_pairs": pairs[:1]})
    checks = steps.check_poses(drive, [motions], steps.refine(drive, [motions], [], params), params.trajectory)
    assert {check.verdict for check in checks} <= {Verdict.PASS}


def test_images_at_the_ends_of_spans_are_decoded_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """But for those of the first span: what it begins with is read again, which drops the images of its end."""
    (chunk,) = chunks_of(read_drive(SAMPLES[0])[0], Settings(home=tmp_path), IngestParams())
    decoded: Counter[tuple[int, str]] = Counter()
    decode = steps.read_pair_image

    def counted(pair: Any, side: Any, *arguments: Any, **options: Any) -> Any:
        decoded[pair.frame_index, side] += 1
        return decode(pair, side, *arguments, **options)

    monkeypatch.setattr(steps, "read_pair_image", counted)
    found = steps.odometry(chunk, 0)
    assert len(load_result(found.tracks, StereoTracks)[0]) == 20
    assert {index for (index, _), count in decoded.items() if count > 1} == {0, 2}
