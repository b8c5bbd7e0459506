"""Self-calibration of a drive in chunks, and frames that both cameras lose."""

from __future__ import annotations

from pathlib import Path

import pytest

from conetl.geometry.motion.stereo_tracks import motions_of
from conetl.model.health import Verdict
from conetl.model.params import IngestParams, TrajectoryParams
from conetl.perception.visual_odometry import follow_drive
from conetl.pipeline.chunks import Chunk
from conetl.pipeline.odometry import grey_reader, self_calibrate
from conetl.readers.drives import read_drive
from conetl.tracking.exposures import check_lost_frames
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
