"""Storage that fails for a moment: nothing of it stays in results that are kept by content."""

from __future__ import annotations

import errno
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from conetl.files.parquet_store import load_result
from conetl.files.storage import forget_all
from conetl.geometry.motion.stereo_tracks import StereoTracks
from conetl.geometry.rig import right_camera_turned
from conetl.model.drive import Detection, StereoMatch
from conetl.model.errors import StorageError
from conetl.model.params import IngestParams, TrajectoryParams
from conetl.pipeline.chunks import Chunk, chunks_of
from conetl.pipeline.detect import detect, match
from conetl.pipeline.odometry import follow_spans, grey_reader
from conetl.pipeline.settings import Settings
from conetl.readers.drives import read_drive
from tests.integration.small_drives import SAMPLES, cut_drive, spoil_huffman_table

Failure = Callable[[Path], bytes]


def chunk_of(drive: Path, results: Path) -> Chunk:
    """The first two pairs of a drive, of whose images nothing is in memory."""
    read, _ = read_drive(drive)
    forget_all()
    chunk = chunks_of(
        read, Settings(), IngestParams(chunk_pairs=2, trajectory=TrajectoryParams(self_calibration_span_m=1.0))
    )[0]
    return chunk.model_copy(update={"results_folder": results})


@pytest.fixture
def chunk(tmp_path: Path) -> Chunk:
    return chunk_of(cut_drive(SAMPLES[0], tmp_path / "drive", "2026-04-01"), tmp_path / "results")


def stale(path: Path) -> bytes:
    raise OSError(errno.ESTALE, "Stale file handle", str(path))


def gone(path: Path) -> bytes:
    raise FileNotFoundError(errno.ENOENT, "No such file or directory", str(path))


def half(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(path.stat().st_size // 2)


def detected(chunk: Chunk) -> bool:
    found, rejections = load_result(detect(chunk, 0, chunk.rig).detections, Detection)
    return bool(found) and not rejections


def followed(chunk: Chunk) -> bool:
    found, _ = load_result(follow_spans(chunk), StereoTracks)
    return found[0].missing is None


@pytest.mark.parametrize("failure", [stale, gone, half])
@pytest.mark.parametrize("work", [detected, followed])
def test_nothing_is_kept_of_images_that_were_not_read(
    chunk: Chunk, monkeypatch: pytest.MonkeyPatch, work: Callable[[Chunk], bool], failure: Failure
) -> None:
    """The hashes are those of the good images; only their second reading fails."""
    with monkeypatch.context() as failing:
        failing.setattr(Path, "read_bytes", failure)
        with pytest.raises(StorageError, match=r"\.jpg"):
            work(chunk)
    assert not chunk.results_folder.exists()
    assert work(chunk)


def test_an_image_that_changed_since_it_was_hashed_is_not_used(chunk: Chunk) -> None:
    image = Path(chunk.frame_pairs[0].left_path)
    image.write_bytes(half(image))
    for work in (lambda: detect(chunk, 0, chunk.rig), lambda: follow_spans(chunk)):
        with pytest.raises(StorageError, match="changed"):
            work()
    image.unlink()
    with pytest.raises(StorageError, match="there is no such file"):
        detect(chunk, 0, chunk.rig)
    assert not chunk.results_folder.exists()


def test_an_image_that_no_decoder_accepts_is_a_rejection_that_is_kept(tmp_path: Path) -> None:
    drive = cut_drive(SAMPLES[0], tmp_path / "drive", "2026-04-01")
    spoil_huffman_table(sorted((drive / "image_02" / "data").iterdir())[0])
    chunk = chunk_of(drive, tmp_path / "results")
    _, rejections = load_result(detect(chunk, 0, chunk.rig).detections, Detection)
    assert [rejection.reason for rejection in rejections] == ["image_unreadable"]
    found, _ = load_result(follow_spans(chunk), StereoTracks)
    assert found[0].missing == "image_unreadable"


def test_matches_and_calibration_are_not_worked_out_without_images_that_were_there(
    chunk: Chunk, monkeypatch: pytest.MonkeyPatch
) -> None:
    detected, rig = detect(chunk, 0, chunk.rig), right_camera_turned(chunk.rig, np.array([0.0, 1e-4, 0.0]))
    kept = set(chunk.results_folder.iterdir())
    forget_all()
    with monkeypatch.context() as failing:
        failing.setattr(Path, "read_bytes", gone)
        with pytest.raises(StorageError, match="changed"):
            match(chunk, rig, detected)
        with pytest.raises(StorageError, match="changed"):
            grey_reader(chunk.rig)(chunk.frame_pairs[0], "left")
    assert set(chunk.results_folder.iterdir()) == kept
    assert load_result(match(chunk, rig, detected, detect(chunk, 1, chunk.rig)), StereoMatch)[0]
