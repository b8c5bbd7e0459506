"""One frame pair of a drive that is being recorded, from its images to the database, by the functions of the batch.

Differences from the analysis of a whole drive: poses are the logged ones, the rig is not self-calibrated, sigmas are those of
single pairs, and tracks are fused from the last frame pairs only. The later ingest replaces all results.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from uuid import uuid4

import numpy as np

from conetl.db.connection import Connection
from conetl.db.live_store import WatchedDrive, write_live
from conetl.model.arrays import Image
from conetl.model.detector_evidence import UNMEASURED, DetectorEvidence
from conetl.model.drive import FramePair
from conetl.model.errors import StorageError
from conetl.model.feature_classes import CONE
from conetl.model.params import IngestParams
from conetl.model.rejections import RejectionReason
from conetl.model.rig import SIDES, Rig, Side
from conetl.perception.detector import Detector, detect_image, load_detector
from conetl.perception.images import ImageFileError
from conetl.perception.model_card import read_model_card
from conetl.perception.rectified_image import read_pair_image
from conetl.pipeline.one_pair import (
    SearchedPair,
    first_road_rows,
    images_of,
    map_up_in_left,
    match_searched,
    search_pair,
)
from conetl.pipeline.settings import Settings
from conetl.tracking.positions import locate_positions
from conetl.tracking.rolling_shutter import matches_at_stamp
from conetl.tracking.self_calibration import with_assumed_errors
from conetl.tracking.window_tracks import ObservedPair, WindowTracks, add_pair

#: An image of this size is searched before the first pair: the first run of a network takes several times as long.
_WARM_UP_SHAPE = (320, 1242, 3)


@dataclass(frozen=True)
class Detectors:
    """Two threads, a detector for each side, and the evidence of the model."""

    pool: ThreadPoolExecutor
    by_side: Mapping[Side, Detector]
    evidence: DetectorEvidence
    params: IngestParams


@dataclass(frozen=True)
class LiveDrive:
    """State of a drive so far; every pair makes a new one."""

    watch: WatchedDrive
    rig: Rig
    captured_ns: tuple[int, int] = (0, 0)
    """Of the first and the last pair taken."""
    frame_pair_count: int = 0
    tracks: WindowTracks = field(default_factory=WindowTracks)
    last_pair: FramePair | None = None


@dataclass(frozen=True)
class PairSearch:
    """A pair while its images are being searched for cones."""

    pair: FramePair
    began_s: float
    result: Future[tuple[SearchedPair, float]]
    """With the time of its end (monotonic s)."""

    def searched(self) -> tuple[SearchedPair, float]:
        """The result, once it is there. Raises ImageFileError if an image is incomplete."""
        searched, ended_s = self.result.result()
        images_of(searched)
        return searched, ended_s


@dataclass(frozen=True)
class StepTimes:
    """Seconds of work on one pair."""

    detect_s: float
    track_s: float
    """Match, locate, tracks."""
    commit_s: float
    processor_s: float
    """Of the side that took longer, and of all after it: the time that an idle machine would need, without the database."""


@contextmanager
def open_detectors(settings: Settings, params: IngestParams) -> Iterator[Detectors]:
    """Load the detector once for each side and run it once. Raises ModelFileError.

    Both images of a pair are searched in full, at the same time: the right one does not wait for the left one. They are searched
    for cones only: provisional features have no class.
    """
    cones_everywhere: dict[str, object] = {"search_right": "everywhere", "categories": (CONE,)}
    params = params.model_copy(update={"detection": params.detection.model_copy(update=cones_everywhere)})
    card = read_model_card(settings.model_path)
    by_side = {side: load_detector(settings.model_path, providers=settings.onnx_providers) for side in SIDES}
    grey = np.full(_WARM_UP_SHAPE, 127, np.uint8)
    with ThreadPoolExecutor(len(SIDES)) as pool:
        for detector in by_side.values():
            detect_image(detector, grey, score_threshold=params.detection.score_threshold)
        yield Detectors(pool, by_side, card.evidence or UNMEASURED, params)


def new_drive(drive_id: str, folder: Path, rig: Rig, srid: int, map_name: str) -> LiveDrive:
    """A drive of which no pair was processed yet. rig: of which the errors are assumed if it states none."""
    watched = WatchedDrive(uuid4(), map_name, srid, drive_id, str(folder.resolve()))
    return LiveDrive(watched, with_assumed_errors(rig, IngestParams().trajectory))


def begin_search(detectors: Detectors, rig: Rig, pair: FramePair) -> PairSearch:
    """Start to search both images of a pair. One pair at a time: it takes both threads."""
    return PairSearch(pair, time.monotonic(), detectors.pool.submit(_search, detectors, rig, pair))


def process_pair(
    conn: Connection, detectors: Detectors, drive: LiveDrive, search: PairSearch
) -> tuple[LiveDrive, StepTimes]:
    """Detections -> match -> locate -> tracks -> commit. Raises ImageFileError (an image is incomplete), DatabaseError."""
    pair, params = search.pair, detectors.params
    searched, ended_s = search.searched()
    started, processor_s = time.monotonic(), time.thread_time()
    matches, _ = match_searched(searched, drive.rig, params.match, map_up_in_left(pair, drive.rig))
    if drive.last_pair is not None:
        matches = matches_at_stamp(matches, [drive.last_pair, pair], drive.rig)
    positions, _ = locate_positions(matches, [pair], drive.rig, params.position)
    detections = [box for side in SIDES for box in searched[side].detections]
    observed = ObservedPair(pair, detections, matches, positions)
    tracks, changed = add_pair(drive.tracks, observed, drive.rig, params, detectors.evidence)
    count, now_ns = drive.frame_pair_count, pair.captured_at_ns
    captured_ns = (drive.captured_ns[0] if count else now_ns, now_ns)
    after = replace(drive, captured_ns=captured_ns, frame_pair_count=count + 1, tracks=tracks, last_pair=pair)
    tracked = time.monotonic()
    write_live(
        conn, after.watch, captured_ns=captured_ns, frame_pair_count=count + 1,
        tracks={number: tracks.standing[number] for number in changed if number in tracks.standing},
        taken_back=[number for number in changed if number not in tracks.standing],
        least_reach_m=params.reconcile.min_gate_m,
    )  # fmt: skip
    processor_s = max(one.processor_s for one in searched.values()) + time.thread_time() - processor_s
    times = StepTimes(ended_s - search.began_s, tracked - started, time.monotonic() - tracked, processor_s)
    return after, times


def _search(detectors: Detectors, rig: Rig, pair: FramePair) -> tuple[SearchedPair, float]:
    def read(side: Side) -> Image:
        try:
            return read_pair_image(pair, side, rig)
        except StorageError as error:  # the watch tries again, and skips the pair after a while
            raise ImageFileError(RejectionReason.IMAGE_UNREADABLE, str(error)) from error

    params, detector = detectors.params, detectors.by_side.__getitem__
    rows = first_road_rows([pair], rig, params.detection)
    searched = search_pair(pair.frame_index, read, detector, rig, params, rows, pool=detectors.pool)
    return searched, time.monotonic()
