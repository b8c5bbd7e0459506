"""Watch a drive while it is recorded: frame pairs, in the order of recording, become provisional features as they arrive.

The images of the next pair are searched while the cones of this one are matched, located and committed. An incomplete pair delays
those behind it for `PATIENCE_S` and is then left to the ingest, which processes the whole drive anyway; so are pairs for which
the machine is too slow.
"""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from queue import Empty, SimpleQueue

import numpy as np
from watchfiles import watch as watch_files

from conetl.db.connection import Connection
from conetl.db.live_store import clear_watches, end_watch, watch_lock
from conetl.db.map.map_store import find_map
from conetl.db.receipt_store import try_lock
from conetl.model.drive import MAX_SPEED_M_S, FramePair, Track
from conetl.model.errors import InputError
from conetl.model.params import IngestParams
from conetl.model.rejections import RejectionReason
from conetl.perception.images import ImageFileError
from conetl.pipeline import live_pair as live
from conetl.pipeline.database import open_maps
from conetl.pipeline.entries import MARKER
from conetl.pipeline.settings import Settings
from conetl.readers.drives.pairs import PairError
from conetl.readers.recording import BEHIND, ArrivingDrive, ArrivingPair, open_arriving

#: How long an incomplete pair holds up those behind it.
PATIENCE_S = 2.0
#: Interval for listing all folders again, in case the system missed a file; listing takes at most this share of the time.
_LIST_EVERY_S, _LIST_SHARE = 1.0, 0.02
_WAIT_S, _GATHER_MS = 0.1, 4
#: Older pairs are skipped while newer ones wait: the ingest processes them.
MAX_BEHIND_S = 0.5


@dataclass(frozen=True)
class PairTime:
    """Processing time of one frame pair, seconds."""

    frame_index: int
    total_s: float
    """From the last change of the later image to the commit."""
    waited_s: float
    """Of it, without work on this pair: notice of the file, a late pose, the pairs before it."""
    work: live.StepTimes
    backlog: bool
    """Its images were there before the watch was ready: its total means nothing."""


@dataclass
class WatchReport:
    """Progress of a watch."""

    drive_id: str = ""
    map_name: str = ""
    pairs: list[PairTime] = field(default_factory=list)
    refused: Counter[str] = field(default_factory=Counter)
    """Frame pairs that cannot be used, by reason."""
    left_out: int = 0
    """Frame pairs that were incomplete, or too old, when their turn came."""
    standing: Mapping[int, Track] = field(default_factory=dict)
    """Provisional features by number."""
    cleared: int = 0
    """Watches before this one whose provisional features were removed."""
    processor_s: float = 0.0
    """Of all threads of this process, since the watch was ready."""
    ended_by: str = ""


@dataclass(frozen=True)
class _Begun:
    """A pair whose images are being searched."""

    arriving: ArrivingPair
    since_s: float
    """When it was noticed (monotonic s)."""
    search: live.PairSearch


@dataclass
class _Watch:
    """The state of a watch."""

    conn: Connection
    detectors: live.Detectors
    folder: Path
    settings: Settings
    report: WatchReport
    progress: Callable[[WatchReport], None]
    max_behind_s: float
    patience_s: float
    ready_ns: int
    changes: SimpleQueue[Path]
    """Files that changed, as the system reports them."""
    source: ArrivingDrive | None = None
    drive: live.LiveDrive | None = None
    last: FramePair | None = None
    """The pair that the next one's position and time are compared with ..."""
    jumped: FramePair | None = None
    """... or the one that was rejected since for its position: two that agree are accepted."""
    taken_index: int = -1
    waiting: dict[str, tuple[ArrivingPair, float]] = field(default_factory=dict)
    """Pairs that are not done, with the time when they were noticed (monotonic s)."""
    turn: list[tuple[int, str]] = field(default_factory=list)
    """The order of those whose number in the recording is known, rising; of some that are done, too."""
    unplaced: list[ArrivingPair] = field(default_factory=list)
    """The others, in any order."""
    begun: _Begun | None = None
    """The one of them whose images are searched already."""


def watch_drive(
    folder: Path,
    settings: Settings,
    params: IngestParams,
    *,
    stop: threading.Event,
    idle_s: float | None = None,
    max_behind_s: float = MAX_BEHIND_S,
    patience_s: float = PATIENCE_S,
    poll: bool = False,
    progress: Callable[[WatchReport], None] = lambda _: None,
) -> WatchReport:
    """Watch a drive folder until it holds `COMPLETE`, `stop` is set, or nothing came for `idle_s`.

    max_behind_s: pairs older than this are left out while newer ones wait. patience_s: how long an incomplete pair is waited for.
    poll: list the files again and again instead of waiting for notices (network file systems). progress: called when the watch is
    ready, and after every pair. Raises InputError where the folder is missing, cannot be a drive, or is being watched already;
    DatabaseError.
    """
    if not folder.is_dir():
        what = "this is a file, not a drive folder" if folder.exists() else "there is no such folder"
        raise InputError(f"{folder}: {what}; create the folder before the recording begins")
    report = WatchReport(map_name=settings.map_name)
    with ExitStack() as stack:
        conn = stack.enter_context(open_maps(settings))
        detectors = stack.enter_context(live.open_detectors(settings, params))
        changes = stack.enter_context(_watch_folder(folder.resolve(), poll=poll))
        watch = _Watch(
            conn, detectors, folder, settings, report, progress, max_behind_s, patience_s, time.time_ns(), changes
        )
        processor_s, heard_s, list_s, took = time.process_time(), time.monotonic(), -np.inf, False
        progress(report)
        while not stop.is_set():
            paths = _wait_for_changes(changes, 0.0 if took else _WAIT_S)
            complete = (folder / MARKER).exists()  # before the listing, which then finds everything
            if watch.source is None and (source := open_arriving(folder)) is not None:
                _begin(watch, source, stack)
            if watch.source is not None:
                begun_s = time.monotonic()
                everything = (complete and not took) or begun_s >= list_s
                _register_pairs(watch, watch.source, None if everything else paths)
                list_s = time.monotonic() + pause_s(time.monotonic() - begun_s) if everything else list_s
            took = _take_next(watch)
            heard_s = time.monotonic() if paths or took else heard_s
            report.processor_s = time.process_time() - processor_s
            if complete and not took and all(_is_overdue(watch, since) for _, since in watch.waiting.values()):
                report.ended_by = MARKER
                break
            if idle_s is not None and time.monotonic() - heard_s >= idle_s:
                report.ended_by = f"nothing came for {idle_s:g} s"
                break
        report.ended_by = report.ended_by or "interrupted"
        report.left_out += len(watch.waiting)
        if watch.drive is not None:
            end_watch(conn, watch.drive.watch)
    return report


def pause_s(listing_s: float) -> float:
    """Pause before all folders are listed again, longer if listing them is slow."""
    return max(_LIST_EVERY_S, listing_s / _LIST_SHARE)


@contextmanager
def _watch_folder(folder: Path, *, poll: bool) -> Iterator[SimpleQueue[Path]]:
    """Files below a folder that changed, as a thread receives them from the system."""
    queue: SimpleQueue[Path] = SimpleQueue()
    stop = threading.Event()

    def listen() -> None:
        for changes in watch_files(
            folder, watch_filter=None, step=_GATHER_MS, debounce=4 * _GATHER_MS, rust_timeout=200, yield_on_timeout=False,
            stop_event=stop, force_polling=poll or None, poll_delay_ms=25, raise_interrupt=False,
        ):  # fmt: skip
            for _, path in changes:
                queue.put(Path(path))

    thread = threading.Thread(target=listen, name="changes", daemon=True)
    thread.start()
    try:
        yield queue
    finally:
        stop.set()
        thread.join()


def _wait_for_changes(changes: SimpleQueue[Path], wait_s: float) -> list[Path]:
    """What changed since the last call; waits for the first change."""
    paths: list[Path] = []
    with suppress(Empty):
        paths.append(changes.get(timeout=wait_s))
        while True:
            paths.append(changes.get_nowait())
    return paths


def _begin(watch: _Watch, source: ArrivingDrive, stack: ExitStack) -> None:
    """Start once the drive is known: lock it against other watches, and remove the results of earlier ones."""
    name = watch_lock(watch.settings.map_name, source.drive_id)
    if not stack.enter_context(try_lock(watch.conn, name)):
        raise InputError(f"{watch.folder}: the drive {source.drive_id} is being watched already")
    watch.source, watch.report.drive_id = source, source.drive_id
    watch.report.cleared = clear_watches(watch.conn, map_name=watch.settings.map_name, drive_id=source.drive_id)


def _register_pairs(watch: _Watch, source: ArrivingDrive, paths: list[Path] | None) -> None:
    """Add the pairs that arrived, and number those whose number in the recording is known by now: finding it takes time."""
    new = source.new_pairs(paths)
    watch.waiting |= {pair.key: (pair, time.monotonic()) for pair in new}
    orders = [(source.order(pair), pair) for pair in (*watch.unplaced, *new) if pair.key in watch.waiting]
    watch.unplaced = [pair for order, pair in orders if order[0] == BEHIND]
    placed = [order for order, _ in orders if order[0] != BEHIND]
    if placed:
        watch.turn = sorted([*watch.turn, *placed])


def _take_next(watch: _Watch) -> bool:
    """Process the next due pair, and begin with the one after it; False if none is due."""
    if watch.source is None:
        return False
    ahead = watch.begun is not None
    begun, watch.begun = watch.begun or _begin_next(watch, watch.source), None
    if begun is None or watch.drive is None:
        return False
    try:
        begun.search.searched()
    except ImageFileError as error:
        done = _is_overdue(watch, begun.since_s)
        if done:
            watch.report.refused[error.reason.value] += 1
            del watch.waiting[begun.arriving.key]
        return done or ahead  # begun ahead: it may be complete by now
    del watch.waiting[begun.arriving.key]
    pair = begun.search.pair
    watch.last, watch.jumped, watch.taken_index = pair, None, pair.frame_index
    _register_pairs(watch, watch.source, _wait_for_changes(watch.changes, 0.0))
    watch.begun = _begin_next(watch, watch.source)
    _take(watch, watch.drive, begun)
    return True


def _begin_next(watch: _Watch, source: ArrivingDrive) -> _Begun | None:
    """Begin with the next due pair, if any. An incomplete one delays the others for a while."""
    watch.turn = [order for order in watch.turn if order[1] in watch.waiting]
    turn = [*watch.turn, *sorted((BEHIND, pair.key) for pair in watch.unplaced if pair.key in watch.waiting)]
    newest_ns = max((_written_ns(watch.waiting[key][0]) for _, key in turn[-2:]), default=0)
    for _, key in turn:
        pair, since = watch.waiting[key]
        if _is_late(watch, pair, newest_ns):
            watch.report.left_out += 1
            del watch.waiting[pair.key]
            continue
        try:
            posed, rig = source.frame_pair(pair, _srid(watch)), source.rig()
            if posed is not None and rig is not None:
                if posed[0].frame_index <= watch.taken_index:  # those behind it did not wait any longer
                    watch.report.left_out += 1
                    del watch.waiting[pair.key]
                    continue
                _check_motion(watch, posed[0])
                watch.drive = watch.drive or live.new_drive(
                    source.drive_id, watch.folder, rig, posed[1], watch.settings.map_name
                )
                return _Begun(pair, since, live.begin_search(watch.detectors, rig, posed[0]))
        except PairError as error:
            watch.report.refused[error.reason.value] += 1
            del watch.waiting[pair.key]
            continue
        if not _is_overdue(watch, since):
            return None
    return None


def _is_overdue(watch: _Watch, since_s: float) -> bool:
    return time.monotonic() - since_s > watch.patience_s


def _is_late(watch: _Watch, pair: ArrivingPair, newest_ns: int) -> bool:
    """Whether a pair is too old to process while newer pairs wait."""
    written_ns = _written_ns(pair)
    behind_s = (time.time_ns() - written_ns) * 1e-9
    return behind_s > watch.max_behind_s and newest_ns > max(written_ns, watch.ready_ns)


def _written_ns(pair: ArrivingPair) -> int:
    """Time of the last change of the later image of a pair (inode time, which a rename sets too); 0 if one has vanished."""
    try:
        return max(path.stat().st_ctime_ns for path in (pair.left_path, pair.right_path))
    except OSError:
        return 0


def _take(watch: _Watch, drive: live.LiveDrive, begun: _Begun) -> None:
    """Process a pair whose images are complete."""
    pair, written_ns = begun.search.pair, _written_ns(begun.arriving)
    watch.drive, times = live.process_pair(watch.conn, watch.detectors, drive, begun.search)
    watch.report.standing = watch.drive.tracks.standing
    total_s = (time.time_ns() - written_ns) * 1e-9
    worked_s = times.detect_s + times.track_s + times.commit_s
    watch.report.pairs.append(
        PairTime(pair.frame_index, total_s, total_s - worked_s, times, backlog=written_ns < watch.ready_ns)
    )
    watch.progress(watch.report)


def _srid(watch: _Watch) -> int | None:
    """CRS of the drive once it is known, else of the map, if there is one."""
    if watch.drive is not None:
        return watch.drive.watch.srid
    info = find_map(watch.conn, watch.settings.map_name)
    watch.conn.rollback()
    return info.srid if info else None


def _check_motion(watch: _Watch, pair: FramePair) -> None:
    """Raise PairError unless time rises and the speed from the last pair, also a rejected one, is below 100 m/s."""
    if watch.last is not None and pair.captured_at_ns <= watch.last.captured_at_ns:
        raise PairError(RejectionReason.TIMESTAMP_INVALID, f"frame pair {pair.frame_index}: the time does not rise")
    known = [other for other in (watch.last, watch.jumped) if other is not None]
    speeds = [_speed_m_s(other, pair) for other in known]
    if speeds and min(speeds) > MAX_SPEED_M_S:
        watch.jumped = pair
        raise PairError(RejectionReason.POSE_INVALID, f"frame pair {pair.frame_index}: reached at {speeds[0]:.0f} m/s")


def _speed_m_s(before: FramePair, pair: FramePair) -> float:
    metres = float(np.linalg.norm(np.subtract(pair.pose.map_t_body_m, before.pose.map_t_body_m)))
    return metres / max((pair.captured_at_ns - before.captured_at_ns) * 1e-9, 1e-3)
