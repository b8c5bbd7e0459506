"""Steps that find lane markings: points in frame pairs, chunk by chunk, and the markings of a whole drive."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from conetl.files.parquet_store import has_result, load_results, result_key, result_path, save_result
from conetl.geometry.linear_reference import spaced
from conetl.model.markings import MarkingTrack
from conetl.model.params import IngestParams, params_sha256
from conetl.model.records import Drive
from conetl.perception.images import ImageFileError
from conetl.perception.markings.crossings import find_points
from conetl.perception.markings.points import MarkingPoints
from conetl.perception.rectified_image import fetch_pairs, read_pair_image
from conetl.perception.worker_setup import set_up_worker
from conetl.pipeline.chunks import RESULTS_VERSION, Chunk, geometry_key, parts_of
from conetl.tracking.error_propagation import pose_cov
from conetl.tracking.markings.tracks import fuse_markings
from conetl.tracking.trajectory import RefinedTrajectory

_log = logging.getLogger(__name__)
_PAIRS_AT_ONCE = 8


def marking_points(chunk: Chunk, part: int) -> Path:
    """Points of lane markings in one of the parts of a chunk; returns the Parquet file.

    chunk: with the rig after self-calibration. A pair is searched for every `pair_spacing_m` of the path; one that cannot be
    decoded shows nothing, the detection reports it.
    """
    params = chunk.params.marking
    key = result_key(RESULTS_VERSION, "marking-points", params_sha256(params), geometry_key(chunk), str(part))
    if has_result(chunk.results_folder, key):
        return result_path(chunk.results_folder, key)
    set_up_worker()
    whole = chunk.frame_pairs[parts_of(chunk)[part]]
    pairs = [whole[k] for k in spaced(np.array([pair.pose.map_t_body_m for pair in whole]), params.pair_spacing_m)]
    found = []
    for number, pair in enumerate(pairs):
        if number % _PAIRS_AT_ONCE == 0:
            fetch_pairs(pairs[number : number + _PAIRS_AT_ONCE])
        try:
            left, right = (read_pair_image(pair, side, chunk.rig) for side in ("left", "right"))
        except ImageFileError:
            continue
        found.append(find_points(pair.frame_index, left, right, chunk.rig, params))
    return save_result(chunk.results_folder, key, found, [])


def mark(
    drive: Drive, paths: Sequence[Path], params: IngestParams, trajectory: RefinedTrajectory
) -> list[MarkingTrack]:
    """Lane markings of the whole drive, by its final poses and rig. paths: of all `marking_points`."""
    points, _ = load_results(paths, MarkingPoints)
    tracks = fuse_markings(points, drive, params.marking, pose_cov(trajectory, params.trajectory))
    _log.info("Lane markings: %d, from points in %d frame pairs", len(tracks), len(points))
    return tracks
