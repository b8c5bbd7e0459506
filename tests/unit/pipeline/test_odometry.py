"""Self-calibration of a drive in chunks."""

from __future__ import annotations

from pathlib import Path

import pytest

from conetl.model.params import IngestParams
from conetl.pipeline.chunks import Chunk
from conetl.pipeline.odometry import self_calibrate
from tests.synthetic.world import make_path, make_rig


@pytest.mark.parametrize(("chunk_pairs", "hinted"), [(4, True), (256, False)])
def test_chunks_shorter_than_a_span_are_named_as_the_cause(tmp_path: Path, chunk_pairs: int, hinted: bool) -> None:
    chunk = Chunk(
        rig=make_rig(), frame_pairs=tuple(make_path(4)), results_folder=tmp_path, model_path=None, detections_sha256="ab",
        params=IngestParams(chunk_pairs=chunk_pairs),
    )  # fmt: skip
    found = self_calibrate(chunk, [])
    assert found.detail.startswith("left as given: 0 spans")
    assert ("chunk_pairs is 4" in found.detail) is hinted
