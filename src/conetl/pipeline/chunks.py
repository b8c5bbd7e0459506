"""A drive is analysed in chunks of frame pairs: the input of the steps, the keys of their results and of the changeset."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from conetl.files.parquet_store import load_results, result_key
from conetl.model.base import Record
from conetl.model.detector_evidence import evidence_sha256
from conetl.model.drive import Drive, FramePair, StereoMatch
from conetl.model.feature_classes import LINE_CLASSES
from conetl.model.params import IngestParams, params_sha256
from conetl.model.rejections import Rejection
from conetl.model.rig import Rig
from conetl.perception.model_card import read_model_card
from conetl.pipeline.settings import Settings

#: Part of every key: increment it when a step computes something else from the same inputs, so that drives can be analysed again.
#: `tests/integration/test_reanalysis.py` fails then, and prints the new records of a sample drive.
ANALYSIS_VERSION = "38"
#: Never changes: keys of analyses and changesets of this version, which are in databases, do not contain it.
_FIRST_VERSION = "33"


@dataclass(frozen=True)
class Analysis:
    """What an analysis depends on besides the drive: hashes of parameters and model, and `ANALYSIS_VERSION`."""

    params_sha256: str
    model_sha256: str
    detections_sha256: str
    evidence_sha256: str

    @property
    def sha256(self) -> str:
        return result_key("analysis", self.params_sha256, self.detections_sha256, self.evidence_sha256, *_version())

    def changeset_key(self, content_sha256: str, map_srid: int) -> str:
        """Idempotency key of the changeset of a drive."""
        own = (self.params_sha256, self.detections_sha256, self.evidence_sha256)
        return result_key("changeset", content_sha256, *own, str(map_srid), *_version())


def analysis_of(params: IngestParams, settings: Settings) -> Analysis:
    """What an analysis with these parameters depends on. Raises ModelFileError."""
    card = read_model_card(settings.model_path)
    return Analysis(params_sha256(params), card.sha256, card.detections_sha256, evidence_sha256(card.evidence))


def _version() -> tuple[str, ...]:
    return () if ANALYSIS_VERSION == _FIRST_VERSION else (f"analysis {ANALYSIS_VERSION}",)


class Chunk(Record):
    """Consecutive frame pairs of a drive, with the folder for their results."""

    drive_id: str
    rig: Rig
    frame_pairs: tuple[FramePair, ...]
    results_folder: Path
    model_path: Path | None
    detections_sha256: str
    """Of the model's sidecar: what model, and how it is used."""
    params: IngestParams
    next_pair: FramePair | None = None
    """The first one of the next chunk: the motion to it is this chunk's."""

    @property
    def frames(self) -> str:
        """Drive and frame indices, in words."""
        return f"{self.drive_id} {self.frame_pairs[0].frame_index} to {self.frame_pairs[-1].frame_index}"


def chunks_of(drive: Drive, settings: Settings, params: IngestParams) -> list[Chunk]:
    """A drive cut into chunks of `params.chunk_pairs` frame pairs; the last may be shorter. Raises ModelFileError.

    Line classes are removed from the classes to search for: the result of the detector does not depend on them. Raises ValueError
    if only the headers of the drive's images were read: their hashes are part of every key.
    """
    if not all(pair.left_sha256 and pair.right_sha256 for pair in drive.frame_pairs):
        raise ValueError(f"drive {drive.drive_id} was read with headers_only: its images have no hashes")
    card = read_model_card(settings.model_path)
    point_classes = tuple(name for name in params.detection.categories if name not in LINE_CLASSES)
    detection = params.detection.model_copy(update={"categories": point_classes})
    params = params.model_copy(update={"detection": detection})
    return [
        Chunk(
            drive_id=drive.drive_id,
            rig=drive.rig,
            frame_pairs=drive.frame_pairs[first : first + params.chunk_pairs],
            next_pair=next(iter(drive.frame_pairs[first + params.chunk_pairs :]), None),
            results_folder=settings.results_folder.resolve(),
            model_path=settings.model_path and settings.model_path.resolve(),
            detections_sha256=card.detections_sha256,
            params=params,
        )
        for first in range(0, len(drive.frame_pairs), params.chunk_pairs)
    ]


def parts_of(chunk: Chunk) -> list[slice]:
    """The frame pairs of a chunk for each detection step: halves, so that the last ones keep all cores busy."""
    count = len(chunk.frame_pairs)
    half = (count + 1) // 2
    return [slice(first, min(first + half, count)) for first in range(0, count, half)]


def images_key(chunk: Chunk, rig: Rig | None = None) -> str:
    """Hash of images and rig (the chunk's own or another one) without the poses: refined poses change no image."""
    shown = {"frame_index", "left_path", "right_path", "left_sha256", "right_sha256"}
    pairs = (pair.model_dump_json(include=shown) for pair in chunk.frame_pairs)
    return result_key((rig or chunk.rig).model_dump_json(), *pairs)


def geometry_key(chunk: Chunk, rig: Rig | None = None) -> str:
    """Hash of the images, poses and rig (the chunk's own or another one) that results of a chunk depend on."""
    return result_key((rig or chunk.rig).model_dump_json(), *(pair.model_dump_json() for pair in chunk.frame_pairs))


def load_matches(paths: Iterable[Path], frame_pairs: Sequence[FramePair]) -> tuple[list[StereoMatch], list[Rejection]]:
    """Stereo matches of these frame pairs (torn ones may be missing), and all rejections."""
    indices = {pair.frame_index for pair in frame_pairs}
    matches, rejections = load_results(paths, StereoMatch)
    return [match for match in matches if match.frame_index in indices], rejections
