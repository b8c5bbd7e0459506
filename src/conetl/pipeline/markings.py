"""Steps that find lane markings: points in frame pairs, chunk by chunk, and the markings of a whole drive."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np

from conetl.files.parquet_store import has_result, load_results, result_key, result_path, save_result
from conetl.geometry.linear_reference import spaced
from conetl.model.drive import Drive
from conetl.model.markings import MarkingTrack
from conetl.model.params import MarkingParams, params_sha256
from conetl.model.rig import Rig
from conetl.perception.images import ImageFileError
from conetl.perception.markings.crossings import find_points
from conetl.perception.markings.points import MarkingPoints
from conetl.perception.rectified_image import fetch_pairs
from conetl.perception.worker_setup import set_up_worker
from conetl.perception.working_size import ImageReader
from conetl.pipeline.chunks import ANALYSIS_VERSION, Chunk, geometry_key, parts_of
from conetl.pipeline.executor import step
from conetl.tracking.error_propagation import PoseCov
from conetl.tracking.markings.tracks import fuse_markings

_log = logging.getLogger(__name__)
_PAIRS_AT_ONCE = 8


def find_marking_points(chunk: Chunk, part: int, rig: Rig, read: ImageReader) -> Iterator[None]:
    """Search one frame pair of a part of a chunk at each step, in the images of `read`; the last step stores the points.

    rig: the chunk's after self-calibration. One pair is searched for every `pair_spacing_m` of the path. A pair that cannot be
    decoded has no points; the detection reports it.
    """
    key = _points_key(chunk, part, rig)
    if has_result(chunk.results_folder, key):
        return
    set_up_worker()
    params, pairs = chunk.params.marking, chunk.frame_pairs[parts_of(chunk)[part]]
    chosen = set(spaced(np.array([pair.pose.map_t_body_m for pair in pairs]), params.pair_spacing_m))
    found = []
    for k, pair in enumerate(pairs):
        if k % _PAIRS_AT_ONCE == 0:
            fetch_pairs([pairs[n] for n in range(k, min(k + _PAIRS_AT_ONCE, len(pairs))) if n in chosen])
        if k in chosen:
            with suppress(ImageFileError):
                found.append(find_points(pair.frame_index, read(pair, "left"), read(pair, "right"), rig, params))
        yield
    save_result(chunk.results_folder, key, found, [])


def points_path(chunk: Chunk, part: int, rig: Rig) -> Path:
    """The Parquet file of the points that `find_marking_points` stores."""
    return result_path(chunk.results_folder, _points_key(chunk, part, rig))


def _points_key(chunk: Chunk, part: int, rig: Rig) -> str:
    params = params_sha256(chunk.params.marking)
    return result_key(ANALYSIS_VERSION, "marking-points", params, geometry_key(chunk, rig), str(part))


@step("mark", "mark {drive.drive_id}")
def mark(drive: Drive, paths: Sequence[Path], params: MarkingParams, errors: PoseCov) -> list[MarkingTrack]:
    """Lane markings of the whole drive, by its final poses and rig. paths: of all `points_path`."""
    points, _ = load_results(paths, MarkingPoints)
    tracks = fuse_markings(points, drive, params, errors)
    _log.info("Lane markings: %d, from points in %d frame pairs", len(tracks), len(points))
    return tracks
