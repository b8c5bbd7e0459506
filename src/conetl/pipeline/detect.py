"""Steps that search images for objects: detections of parts of a chunk, and other results from the same images."""

from __future__ import annotations

import socket
import threading
from collections import defaultdict, deque
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache, partial
from itertools import chain, islice, zip_longest
from pathlib import Path
from typing import NamedTuple

from conetl.files.parquet_store import has_result, load_result, load_results, result_key, result_path, save_result
from conetl.model.drive import Detection, FramePair, ImageDetail, StereoMatch
from conetl.model.errors import ModelFileError
from conetl.model.params import params_sha256
from conetl.model.rejections import INPUT_REASONS, Rejection
from conetl.model.rig import SIDES, Rig, Side
from conetl.perception.detector import Detector, load_detector
from conetl.perception.image_detail import fine_detail
from conetl.perception.images import ImageFileError
from conetl.perception.rectified_image import fetch_pairs, read_pair_image
from conetl.perception.worker_setup import set_up_worker
from conetl.perception.working_size import ImageReader
from conetl.pipeline.chunks import ANALYSIS_VERSION, Chunk, images_key, parts_of
from conetl.pipeline.executor import Tick, no_tick, step
from conetl.pipeline.markings import find_marking_points, points_path
from conetl.pipeline.odometry import motions_path, track_motions
from conetl.pipeline.one_pair import first_road_rows, map_up_in_left, match_searched, search_pair
from conetl.pipeline.settings import read_settings
from conetl.tracking.matching.epipolar_search import blocks_of, has_right_only_cone
from conetl.tracking.matching.matches import match_pair, with_measured_spread

#: Decoded images that stay in memory for the extra steps.
_KEPT_BYTES = 128 * 2**20
_per_thread = threading.local()


class Detected(NamedTuple):
    """Parquet files of one part of a chunk."""

    detections: Path
    motions: Path | None = None
    marking_points: Path | None = None


class ExtraSteps(NamedTuple):
    """What else to compute from the images of a part while they are in memory."""

    odometry: bool = False
    markings: bool = False


NO_EXTRAS = ExtraSteps()


@step("detect", "detect {chunk.frames}, part {part}")
def detect(chunk: Chunk, part: int, rig: Rig, extras: ExtraSteps = NO_EXTRAS, tick: Tick = no_tick) -> Detected:
    """Detections in both images of one part of a chunk, and its matches, stored for `match`.

    The right image is searched along epipolar lines, and everywhere in some pairs of every block (`epipolar_search.py`). rig: of
    the drive after its self-calibration, for the matches and the extra steps, which run while the images are in memory. tick:
    called for every image and every motion.
    """
    read = _reader(chunk)
    steps: list[Iterator[None]] = []
    if extras.odometry:
        steps.append(track_motions(chunk, part, rig, read, tick))
    if extras.markings:
        steps.append(find_marking_points(chunk, part, rig, read))
    together = zip_longest(*steps)
    detections = _detections(chunk, part, rig, read, together, tick)
    deque(together, maxlen=0)
    return Detected(
        detections,
        motions_path(chunk, part, rig) if extras.odometry else None,
        points_path(chunk, part, rig) if extras.markings else None,
    )


def _reader(chunk: Chunk) -> ImageReader:
    """Reads the images of a chunk in colour, and caches those of the current block: extra steps need no second decoding."""
    image_bytes = max(3 * camera.width_px * camera.height_px for camera in (chunk.rig.left, chunk.rig.right))
    most = len(SIDES) * chunk.params.reconcile.removal_min_frames
    return lru_cache(max(min(most, _KEPT_BYTES // image_bytes), 1))(
        lambda pair, side: read_pair_image(pair, side, chunk.rig)
    )


def _detections(chunk: Chunk, part: int, rig: Rig, read: ImageReader, extras: Iterator[object], tick: Tick) -> Path:
    """Detections of a part; extras: advances by one step for every frame pair, after its block was searched."""
    pairs = chunk.frame_pairs[parts_of(chunk)[part]]
    params, reconcile = chunk.params.detection, chunk.params.reconcile
    first_rows = first_road_rows(chunk.frame_pairs, chunk.rig, params)
    key = result_key(
        ANALYSIS_VERSION,
        "detect",
        chunk.detections_sha256,
        params_sha256(params),
        params_sha256(chunk.params.match),
        f"{reconcile.removal_min_frames} pairs, {reconcile.visible_min_height_px} px, {reconcile.visible_border_px} px, "
        f"{chunk.params.track.max_cone_height_m} m",
        images_key(chunk),
        f"rows {first_rows}, part {part}",
    )
    if has_result(chunk.results_folder, key) and has_result(chunk.results_folder, _detail_key(key)):
        detected = result_path(chunk.results_folder, key)
        tick(2 * len(pairs))
        _match_part(chunk, part, detected, rig)
        return detected
    set_up_worker()
    found: list[_PairFound] = []
    for middle, block in blocks_of(len(pairs), chunk.params):
        fetch_pairs([pairs[k] for k in block])
        seen = {middle: _search(chunk, pairs[middle], first_rows, rig, read, tick, everywhere=True)}
        # A pair with a broken image shows nothing about the others.
        is_broken = any(rejection.reason in INPUT_REASONS for rejection in seen[middle].rejections)
        everywhere = is_broken or has_right_only_cone(seen[middle].detections, chunk.rig, chunk.params)
        for k in block:
            if k != middle:
                seen[k] = _search(chunk, pairs[k], first_rows, rig, read, tick, everywhere=everywhere)
        found += [seen[k] for k in block]
        deque(islice(extras, len(block)), maxlen=0)
    together = _PairFound(*(list(chain.from_iterable(parts)) for parts in zip(*found, strict=True)))
    save_result(chunk.results_folder, _detail_key(key), together.details, [])
    detected = save_result(chunk.results_folder, key, together.detections, together.rejections)
    save_result(chunk.results_folder, _match_key(chunk, detected, rig), together.matches, together.rejected_matches)
    return detected


def detail_path(detected: Path) -> Path:
    """The Parquet file of the `ImageDetail`s that were measured along with detections."""
    return result_path(detected.parent, _detail_key(detected.stem))


def _detail_key(detections_key: str) -> str:
    return result_key("detail", detections_key)


class _PairFound(NamedTuple):
    """What one frame pair shows, or several."""

    detections: list[Detection]
    details: list[ImageDetail]
    rejections: list[Rejection]
    matches: list[StereoMatch]
    rejected_matches: list[Rejection]


def _search(
    chunk: Chunk,
    pair: FramePair,
    first_rows: Mapping[Side, int],
    rig: Rig,
    read: ImageReader,
    tick: Tick,
    *,
    everywhere: bool,
) -> _PairFound:
    """Detections and matches of one frame pair; the right image is searched around possible partners, or everywhere."""
    searched = search_pair(
        pair.frame_index, partial(read, pair), lambda _: _detector(chunk), chunk.rig, chunk.params, first_rows,
        everywhere=everywhere,
    )  # fmt: skip
    tick(len(SIDES))
    found = _PairFound([], [], [], *match_searched(searched, rig, chunk.params.match, map_up_in_left(pair, rig)))
    for side, one in searched.items():
        found.detections.extend(one.detections)
        found.rejections.extend(one.rejections if one.problem is None else [_unread(pair, side, one.problem)])
        if one.image is not None:
            detail = fine_detail(one.image)
            found.details.append(ImageDetail(frame_index=pair.frame_index, side=side, detail=detail))
    return found


def _unread(pair: FramePair, side: Side, error: ImageFileError) -> Rejection:
    return Rejection(
        step="detections", reason=error.reason, record=f"frame pair {pair.frame_index}", detail=f"{side} image {error}",
        payload={"frame_index": pair.frame_index, "side": side, "path": pair.image(side)[0]},
    )  # fmt: skip


@step("match", "match {chunk.frames}")
def match(chunk: Chunk, rig: Rig, *detected: Detected) -> Path:
    """Stereo matches of a chunk: those that `detect` found with its parts, joined; returns the Parquet file.

    chunk: with the rig that was used to read its images; rig: the same after self-calibration.
    """
    files = [part.detections for part in detected]
    keys = [_match_key(chunk, path, rig) for path in files]
    key = result_key(ANALYSIS_VERSION, "matches", *keys)
    if has_result(chunk.results_folder, key):
        return result_path(chunk.results_folder, key)
    paths = [_match_part(chunk, part, path, rig) for part, path in enumerate(files)]
    matches, rejections = load_results(paths, StereoMatch)
    return save_result(chunk.results_folder, key, with_measured_spread(matches), rejections)


def _match_part(chunk: Chunk, part: int, detected: Path, rig: Rig) -> Path:
    """The matches of one part, computed if they are missing; returns the Parquet file."""
    key = _match_key(chunk, detected, rig)
    if has_result(chunk.results_folder, key):
        return result_path(chunk.results_folder, key)
    by_frame: dict[int, dict[Side, list[Detection]]] = defaultdict(lambda: {"left": [], "right": []})
    for detection in load_result(detected, Detection)[0]:
        by_frame[detection.frame_index][detection.side].append(detection)
    matches: list[StereoMatch] = []
    rejections: list[Rejection] = []
    for pair in chunk.frame_pairs[parts_of(chunk)[part]]:
        found, rejected = _match_again(chunk, pair, by_frame[pair.frame_index], rig)
        matches += found
        rejections += rejected
    return save_result(chunk.results_folder, key, matches, rejections)


def _match_again(
    chunk: Chunk, pair: FramePair, by_side: Mapping[Side, Sequence[Detection]], rig: Rig
) -> tuple[list[StereoMatch], list[Rejection]]:
    """Stereo matches of a frame pair that was searched before: its images are read again where the boxes alone match."""
    match_boxes = partial(
        match_pair, by_side["left"], by_side["right"], rig, chunk.params.match, up_left=map_up_in_left(pair, rig)
    )
    found = match_boxes()
    if not (chunk.params.match.refine and found[0]):
        return found
    left, right = (read_pair_image(pair, side, chunk.rig) for side in SIDES)
    return match_boxes(images=(left, right))


def _match_key(chunk: Chunk, detected: Path, rig: Rig) -> str:
    """Key of the matches of one part."""
    ups = b"".join(map_up_in_left(pair, rig).tobytes() for pair in chunk.frame_pairs).hex()
    return result_key(
        ANALYSIS_VERSION, "match", detected.stem, params_sha256(chunk.params.match), images_key(chunk, rig), ups
    )


def _detector(chunk: Chunk) -> Detector:
    """One single-threaded session per thread: two of them beat one session with two threads."""
    loaded: tuple[str, Detector] | None = getattr(_per_thread, "detector", None)
    if loaded is None or loaded[0] != chunk.detections_sha256:
        detector = load_detector(chunk.model_path, providers=read_settings().onnx_providers)
        if detector.card.detections_sha256 != chunk.detections_sha256:  # on another machine, perhaps
            raise ModelFileError(
                f"{detector.path} on {socket.gethostname()} is another model, or its sidecar another, than that of this run "
                f"(SHA-256 {detector.card.sha256}); all machines need the same version of conetl and the same CONETL_MODEL_PATH"
            )
        loaded = (chunk.detections_sha256, detector)
        _per_thread.detector = loaded
    return loaded[1]
