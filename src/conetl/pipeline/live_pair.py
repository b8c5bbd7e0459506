"""One frame pair of a drive that is being recorded, from its images to the database."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple
from uuid import uuid4

import numpy as np

from conetl.db.connection import Connection
from conetl.db.live_store import WatchedDrive, write_live
from conetl.model.arrays import Image
from conetl.model.detector_evidence import UNMEASURED, DetectorEvidence
from conetl.model.drive import Detection, FramePair, Track
from conetl.model.errors import StorageError
from conetl.model.feature_classes import CONE
from conetl.model.params import IngestParams
from conetl.model.rejections import RejectionReason
from conetl.model.rig import SIDES, Rig, Side
from conetl.perception.detector import Detector, detect_image, load_detector
from conetl.perception.images import ImageFileError
from conetl.perception.model_card import read_model_card
from conetl.pipeline.one_pair import match_searched, search_image
from conetl.pipeline.settings import Settings
from conetl.tracking.live_tracks import LiveFrame, LiveTracks, add_frame
from conetl.tracking.positions import locate_positions

#: An image of this size is searched before the first pair: the first run of a network takes several times as long.
_WARM_UP_SHAPE = (320, 1242, 3)


@dataclass(frozen=True)
class Detectors:
    """Two threads with a detector for each side, and the evidence of the model."""

    pool: ThreadPoolExecutor
    by_side: Mapping[Side, Detector]
    evidence: DetectorEvidence
    params: IngestParams


@dataclass(frozen=True)
class LiveDrive:
    """State of a drive so far; every pair makes a new one."""

    watch: WatchedDrive
    rig: Rig
    captured_ns: tuple[int, int]
    """Of the first and the last pair taken."""
    frame_pair_count: int = 0
    tracks: LiveTracks = field(default_factory=LiveTracks)
    standing: dict[int, Track] = field(default_factory=dict)
    """Provisional features by number."""


class SearchedImage(NamedTuple):
    """The detections in one image of a pair."""

    found: tuple[Image, list[Detection]]
    """The image, and its cones."""
    ended_s: float
    """Monotonic s."""
    processor_s: float


@dataclass(frozen=True)
class PairSearch:
    """Both images of a pair while they are being searched for cones."""

    pair: FramePair
    began_s: float
    sides: tuple[Future[SearchedImage], Future[SearchedImage]]

    def images(self) -> tuple[SearchedImage, SearchedImage]:
        """Results for both images, once they have been searched. Raises ImageFileError if one is incomplete."""
        return self.sides[0].result(), self.sides[1].result()


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


def new_drive(drive_id: str, folder: Path, rig: Rig, srid: int, map_name: str, first: FramePair) -> LiveDrive:
    """A drive of which no pair was processed yet."""
    watch = WatchedDrive(uuid4(), map_name, srid, drive_id, str(folder.resolve()))
    return LiveDrive(watch, rig, (first.captured_at_ns, first.captured_at_ns))


def search_pair(detectors: Detectors, rig: Rig, pair: FramePair) -> PairSearch:
    """Start to search both images of a pair."""
    left, right = (detectors.pool.submit(_search, detectors, rig, pair, side) for side in SIDES)
    return PairSearch(pair, time.monotonic(), (left, right))


def process_pair(
    conn: Connection, detectors: Detectors, drive: LiveDrive, search: PairSearch
) -> tuple[LiveDrive, StepTimes]:
    """Detections -> match -> locate -> tracks -> commit. Raises ImageFileError (an image is incomplete), DatabaseError."""
    pair, sides = search.pair, search.images()
    started, processor_s = time.monotonic(), time.thread_time()
    params = detectors.params
    matches, _ = match_searched([side.found for side in sides], drive.rig, params, pair)
    positions, _ = locate_positions(matches, [pair], drive.rig, params.position)
    detections = [box for side in sides for box in side.found[1]]
    frame = LiveFrame(pair, tuple(detections), tuple(matches), tuple(positions))
    tracks, changed = add_frame(drive.tracks, frame, drive.rig, params, detectors.evidence)
    cones = {number: found for number, found in changed.items() if isinstance(found, Track)}
    taken_back = [number for number in changed if number not in cones and number in drive.standing]
    standing = {n: t for n, t in (drive.standing | cones).items() if n not in taken_back}
    after = replace(
        drive, captured_ns=(drive.captured_ns[0], pair.captured_at_ns), frame_pair_count=drive.frame_pair_count + 1,
        tracks=tracks, standing=standing,
    )  # fmt: skip
    tracked = time.monotonic()
    write_live(
        conn, after.watch, captured_ns=after.captured_ns, frame_pair_count=after.frame_pair_count, tracks=cones,
        taken_back=taken_back, least_reach_m=params.reconcile.min_gate_m,
    )  # fmt: skip
    processor_s_all = max(side.processor_s for side in sides) + time.thread_time() - processor_s
    detect_s = max(side.ended_s for side in sides) - search.began_s
    return after, StepTimes(detect_s, tracked - started, time.monotonic() - tracked, processor_s_all)


def _search(detectors: Detectors, rig: Rig, pair: FramePair, side: Side) -> SearchedImage:
    started_s = time.thread_time()
    path = Path(pair.left_path if side == "left" else pair.right_path)
    try:
        found = search_image(path, rig, side, detectors.by_side[side], detectors.params.detection, pair)
    except StorageError as error:  # the watch tries again, and skips the pair after a while
        raise ImageFileError(RejectionReason.IMAGE_UNREADABLE, str(error)) from error
    return SearchedImage(found, time.monotonic(), time.thread_time() - started_s)
