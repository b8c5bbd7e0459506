"""Storage that fails for a moment: nothing of it stays in results that are kept by content."""

from __future__ import annotations

import errno
from collections.abc import Callable
from pathlib import Path

import pytest

from conetl.files.parquet_store import load_result
from conetl.model.errors import StorageError
from conetl.model.params import IngestParams
from conetl.model.records import Detection
from conetl.perception import images
from conetl.perception.model_card import read_model_card
from conetl.pipeline import chunks
from conetl.pipeline.chunks import Chunk
from conetl.readers.drives import read_drive
from flows import detection, refinement
from tests.integration.small_drives import SAMPLES, cut_drive

Failure = Callable[[Path], bytes]


@pytest.fixture
def chunk(tmp_path: Path) -> Chunk:
    drive, _ = read_drive(cut_drive(SAMPLES[0], tmp_path / "drive", "2026-04-01"))
    return Chunk(
        drive_id=drive.drive_id, rig=drive.rig, frame_pairs=drive.frame_pairs[:2],
        results_folder=tmp_path / "results", model_path=None,
        detections_sha256=read_model_card(None).detections_sha256, params=IngestParams(),
    )  # fmt: skip


def stale(path: Path) -> bytes:
    raise OSError(errno.ESTALE, "Stale file handle", str(path))


def gone(path: Path) -> bytes:
    raise FileNotFoundError(errno.ENOENT, "No such file or directory", str(path))


def half(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(path.stat().st_size // 2)


FAILURES = pytest.mark.parametrize("failure", [stale, gone, half])


@FAILURES
def test_detections_are_not_kept_of_images_that_were_not_read(
    chunk: Chunk, monkeypatch: pytest.MonkeyPatch, failure: Failure
) -> None:
    """The hashes are those of the good images; only their second reading fails."""
    with monkeypatch.context() as failing:
        failing.setattr(Path, "read_bytes", failure)
        with pytest.raises(StorageError, match=r"\.jpg"):
            detection.detect_task.fn(chunk, 0, None)
    assert not chunk.results_folder.exists()
    found, rejections = load_result(detection.detect_task.fn(chunk, 0, None), Detection)
    assert found
    assert not rejections


@FAILURES
def test_points_are_not_kept_of_images_that_were_not_read(
    chunk: Chunk, monkeypatch: pytest.MonkeyPatch, failure: Failure
) -> None:
    with monkeypatch.context() as failing:
        failing.setattr(Path, "read_bytes", failure)
        with pytest.raises(StorageError, match=r"\.jpg"):
            refinement.odometry_task.fn(chunk)
    assert not chunk.results_folder.exists()
    found, _ = load_result(refinement.odometry_task.fn(chunk).tracks, refinement.StereoTracks)
    assert found[0].missing is None


def test_a_image_that_comes_back_after_its_hash_is_not_kept_under_no_image(
    chunk: Chunk, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as failing:
        failing.setattr(chunks, "file_sha256", lambda _: images.NO_FILE_SHA256)
        with pytest.raises(StorageError, match="changed"):
            detection.detect_task.fn(chunk, 0, None)
    assert not chunk.results_folder.exists()


def test_a_image_that_is_gone_is_a_rejection_that_is_kept(chunk: Chunk) -> None:
    Path(chunk.frame_pairs[0].left_path).unlink()
    _, rejections = load_result(detection.detect_task.fn(chunk, 0, None), Detection)
    assert [rejection.reason for rejection in rejections] == ["image_missing"]
    found, _ = load_result(refinement.odometry_task.fn(chunk).tracks, refinement.StereoTracks)
    assert found[0].missing == "image_unreadable"


def test_a_image_that_is_bad_for_good_is_a_rejection_that_is_kept(chunk: Chunk) -> None:
    image = Path(chunk.frame_pairs[0].left_path)
    image.write_bytes(half(image))
    _, rejections = load_result(detection.detect_task.fn(chunk, 0, None), Detection)
    assert [rejection.reason for rejection in rejections] == ["image_truncated"]


def test_matches_and_calibration_are_not_worked_out_without_images_that_were_there(
    chunk: Chunk, monkeypatch: pytest.MonkeyPatch
) -> None:
    detected = detection.detect_task.fn(chunk, 0, None)
    kept = set(chunk.results_folder.iterdir())
    read = refinement.reader_again(chunk.rig)
    with monkeypatch.context() as failing:
        failing.setattr(Path, "read_bytes", gone)
        with pytest.raises(StorageError, match="was read before"):
            detection.match_task.fn(chunk, chunk.rig, detected)
        with pytest.raises(StorageError, match="was read before"):
            read(chunk.frame_pairs[0], "left")
    assert set(chunk.results_folder.iterdir()) == kept
