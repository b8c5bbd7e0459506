"""A drive is worked on in chunks of frame pairs: what a task is given, and what its results are known by."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from conetl.files.parquet_store import file_sha256, result_key
from conetl.files.storage import as_path, in_batches
from conetl.model.params import IngestParams
from conetl.model.records import Drive, FramePair, Record, Rig
from conetl.perception.model_card import read_model_card
from conetl.pipeline.settings import Settings

#: Part of every result key: raise it when a step computes something else from the same inputs.
RESULTS_VERSION = "11"


class Chunk(Record):
    """Some consecutive frame pairs of a drive, and where their results go."""

    drive_id: str
    rig: Rig
    frame_pairs: tuple[FramePair, ...]
    results_folder: Path
    model_path: Path | None
    detections_sha256: str
    """Of the model's sidecar: what model, and how it is used."""
    params: IngestParams


def chunks_of(drive: Drive, settings: Settings, params: IngestParams) -> list[Chunk]:
    """A drive cut into chunks of `params.chunk_pairs` frame pairs; the last may be shorter. Raises ModelFileError."""
    card = read_model_card(settings.model_path)
    return [
        Chunk(
            drive_id=drive.drive_id,
            rig=drive.rig,
            frame_pairs=drive.frame_pairs[first : first + params.chunk_pairs],
            results_folder=settings.results_folder.resolve(),
            model_path=settings.model_path and settings.model_path.resolve(),
            detections_sha256=card.detections_sha256,
            params=params,
        )
        for first in range(0, len(drive.frame_pairs), params.chunk_pairs)
    ]


def parts_of(chunk: Chunk) -> list[slice]:
    """The frame pairs of a chunk that one detection task takes: halves, so that the last ones keep all cores busy."""
    count = len(chunk.frame_pairs)
    half = (count + 1) // 2
    return [slice(first, min(first + half, count)) for first in range(0, count, half)]


def image_paths(pairs: Sequence[FramePair]) -> list[Path]:
    """Places of the images of frame pairs, left and right in turn."""
    return [as_path(path) for pair in pairs for path in (pair.left_path, pair.right_path)]


def image_hashes(paths: Sequence[Path]) -> dict[Path, str]:
    """SHA-256 of images as they are now, in order; of none where one is missing. Raises OSError where storage fails."""
    return {path: file_sha256(path) for path in in_batches(paths, fresh=True)}


def rig_and_poses(chunk: Chunk, rig: Rig | None = None) -> str:
    """Hash of all geometry that a chunk's matches and positions depend on, by the chunk's rig or another one."""
    return result_key((rig or chunk.rig).model_dump_json(), *(pair.model_dump_json() for pair in chunk.frame_pairs))
