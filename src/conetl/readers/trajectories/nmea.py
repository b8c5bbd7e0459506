"""NMEA 0183 logs: GGA or GNS (position), RMC or ZDA (date), GST (sigmas), HDT, THS or PASHR (attitude), also between other bytes.

Sentences with the same time of day are one epoch, whatever their order and talkers. HDT and THS have no time: each belongs to the
epoch before or after it, which `_placed` finds for the whole log. Height = altitude above the sea + geoid separation.
Sentences without a valid checksum are not used, unless the log has none. (Without pynmeagps: docs/dev/decisions.md.)
"""

from __future__ import annotations

import re
from array import array
from collections.abc import Iterator, Sequence
from datetime import date
from functools import reduce
from itertools import groupby
from operator import xor
from pathlib import Path

import numpy as np

from conetl.model.arrays import Floats
from conetl.model.errors import InputError
from conetl.readers.trajectories.recorded import Reading, Records, attitude
from conetl.readers.trajectories.settings import TrajectoryFile
from conetl.readers.trajectories.tables import LEVEL_SIGMA_RAD
from conetl.readers.trajectories.text import Progress, head_bytes, line_blocks
from conetl.readers.trajectories.times import DAY_NS, SECOND_NS, Times, decimal_ns

SIGMAS_OF_QUALITY_M = {1: (5.0, 10.0), 2: (2.0, 4.0), 3: (5.0, 10.0), 4: (0.05, 0.1), 5: (0.5, 1.0), 9: (2.0, 4.0)}
"""Sigmas (horizontal, up) without GST by the quality of GGA: autonomous, differential, PPS, RTK fixed, RTK float, SBAS (NovAtel).
They are multiplied by HDOP where it is above 1."""
HEADING_SIGMA_DEG = 1.0
"""Sigma of HDT and THS, which state none: two antennas half a metre apart."""
LATE_NS = 5 * SECOND_NS
"""Sentences come no later than this after those of later epochs; an earlier time of day is of another day, or after a gap."""
SLOW_S = 0.4
"""Epochs this far apart show in turns whether a heading is of the epoch before or after it: the lever arm of the antenna matters
less than a step of the heading."""
LEAST_TURN_RAD = float(np.radians(1.0))
"""Root mean square of the turns per epoch that show it."""
_NO_FIX = {
    0: "there was no fix",
    6: "an estimate without satellites, and no GST states its accuracy",
    7: "manual input",
    8: "a simulation",
}
#: Best mode of a satellite system in GNS -> quality of GGA.
_GNS_MODES = {"R": 4, "F": 5, "D": 2, "P": 1, "A": 1, "E": 6, "M": 7, "S": 8}
_SENTENCE = re.compile(
    r"\$((?:([A-Z]{2})(GGA|GNS|RMC|ZDA|GST|HDT|THS)|P(ASHR)),[^*$\r\n]{0,120})(?:\*([0-9A-Fa-f]{2}))?"
)
_LEVEL_DEG = float(np.degrees(LEVEL_SIGMA_RAD))
_UNDATED = -1


def looks_like(lines: list[str], is_binary: bool) -> bool:
    """Whether the first lines have sentences in a third of them, or between the messages of another protocol."""
    found = sum(len(_SENTENCE.findall(line)) for line in lines)
    return found > 1 and (is_binary or 3 * found > sum(bool(line.strip()) for line in lines))


def unchecked_note(path: Path) -> str | None:
    """What to say of a log whose sentences have no checksums."""
    found = [match[-1] for match in _SENTENCE.findall(head_bytes(path).decode("latin-1"))]
    if not found or 2 * sum(map(bool, found)) >= len(found):
        return None
    return f"{path}: its NMEA sentences have no checksums: damaged values are not noticed"


def read(path: Path, settings: TrajectoryFile) -> Reading:
    """The epochs of a log. Raises InputError where there is no date."""
    note = unchecked_note(path)
    log, progress = _Log(unchecked=note is not None), Progress(path)
    for first, lines in line_blocks(path, progress):
        block, number, at, count = "\n".join(lines), first, 0, 0
        for match in _SENTENCE.finditer(block):
            count += 1
            number, at = number + block.count("\n", at, match.start()), match.start()
            log.add(match, number)
        progress.records = len(log.times)
        progress.add(f"line {first}", count, 0)
    return Reading(_records(log, settings, path), notes=[note] if note else [])


class _Values:
    """Numbers of the sentences of one kind, each with its epoch and the rank of its talker."""

    def __init__(self, width: int) -> None:
        self.width, self.epochs, self.values = width, array("q"), array("d")

    def add(self, epoch: int, talker: str, values: Sequence[float]) -> None:
        self.epochs.append(epoch)
        self.values.extend((int.from_bytes(talker.encode()) if talker != "GN" else 0, *values))

    def rows(self) -> tuple[Times, Floats]:
        """Epochs (N,) and values (N, width), of an epoch those of GN first and else by talker."""
        epochs = np.frombuffer(self.epochs, np.int64)
        values = np.frombuffer(self.values).reshape(-1, self.width + 1)
        order = np.lexsort((values[:, 0], epochs))
        return epochs[order], values[order, 1:]

    def of_epochs(self, count: int) -> Floats:
        """(count, width): of each epoch the first row; NaN without one."""
        found = np.full((count, self.width), np.nan)
        epochs, rows = self.rows()
        found[epochs[::-1]] = rows[::-1]
        return found


class _Log:
    """Sentences as numbers, by epoch."""

    def __init__(self, *, unchecked: bool) -> None:
        self.unchecked = unchecked
        #: Of each epoch: time of day (ns), date (days since 1970), number of its sentences with a time.
        self.times, self.days, self.counts = array("q"), array("q"), array("q")
        self.epoch_at: dict[int, int] = {}
        self.last = -1
        self.fixes = _Values(7)  # lat, lon, altitude, separation, quality, HDOP, line
        self.gst = _Values(3)  # sigmas of east, north, up
        self.pashr = _Values(6)  # heading, roll, pitch, sigmas of roll, pitch, heading; degrees
        #: HDT and THS by talker: epochs before and after each, degrees.
        self.headings: dict[str, tuple[array[int], array[int], array[float]]] = {}
        self.damaged = 0

    def add(self, match: re.Match[str], number: int) -> None:
        body, talker, kind, pashr, checksum = match.groups(default="")
        if not body.isascii() or (int(checksum, 16) != reduce(xor, body.encode()) if checksum else not self.unchecked):
            self.damaged += 1
            return
        try:
            self._add(kind or pashr, talker, body.split(","), number)
        except (ValueError, IndexError, OverflowError):
            self.damaged += 1

    def _add(self, kind: str, talker: str, words: list[str], number: int) -> None:
        if kind in {"HDT", "THS"}:
            if words[1] and words[2].strip() in {"T", "A"}:
                before, after, degrees = self.headings.setdefault(talker + kind, (array("q"), array("q"), array("d")))
                degrees.append(float(words[1]))
                before.append(self.last)
                after.append(-1)
        elif not words[1]:
            return
        elif kind == "GGA":
            self._add_fix(words, int(words[6] or 0), 9, 11, talker, number)
        elif kind == "GNS":
            quality = next((code for mode, code in _GNS_MODES.items() if mode in words[6]), 0)
            self._add_fix(words, quality, 9, 10, f"Z{talker}", number)  # GGA is better known
        elif kind == "RMC" and words[2] == "A" and len(words[9]) == 6:
            year = int(words[9][4:])
            day = date(year + (1900 if year >= 80 else 2000), int(words[9][2:4]), int(words[9][:2]))
            self.days[self._epoch(words[1])] = (day - date(1970, 1, 1)).days
        elif kind == "ZDA" and words[4]:
            day = date(int(words[4]), int(words[3]), int(words[2]))
            self.days[self._epoch(words[1])] = (day - date(1970, 1, 1)).days
        elif kind == "GST":
            sigmas = [_number(words[k]) for k in (7, 6, 8)]
            self.gst.add(self._epoch(words[1]), talker, sigmas)
        elif kind == "ASHR" and len(words) >= 10 and words[3] == "T":
            values = [_number(words[k]) for k in (2, 4, 5, 7, 8, 9)]
            self.pashr.add(self._epoch(words[1]), "", values)

    def _add_fix(self, words: list[str], quality: int, up: int, over: int, talker: str, number: int) -> None:
        lat, lon = (_degrees(words[2], words[3]), _degrees(words[4], words[5])) if quality else (np.nan, np.nan)
        values = [lat, lon, _number(words[up]), _number(words[over]), quality, _number(words[8]), number]
        self.fixes.add(self._epoch(words[1]), talker, values)

    def _epoch(self, text: str) -> int:
        """Number of the epoch of a time of day, hhmmss.ss. Raises ValueError."""
        hours, minutes, seconds_ns = int(text[:2]), int(text[2:4]), decimal_ns(text[4:])
        if not (0 <= hours < 24 and 0 <= minutes < 60 and seconds_ns <= 60 * SECOND_NS):
            raise ValueError
        time_ns = (hours * 3600 + minutes * 60) * SECOND_NS + seconds_ns
        found = self.epoch_at.get(time_ns, -1)
        if found < 0 or (self.times[self.last] - time_ns) % DAY_NS > LATE_NS:
            found = self.epoch_at[time_ns] = len(self.times)
            self.times.append(time_ns)
            self.days.append(_UNDATED)
            self.counts.append(0)
        self.counts[found] += 1
        for before, after, _ in self.headings.values():
            for k in range(len(after) - 1, -1, -1):  # those since the last sentence with a time
                if after[k] != -1 or before[k] != self.last:
                    break
                after[k] = found
        self.last = found
        return found


def _degrees(text: str, side: str) -> float:
    """Degrees of dddmm.mmmm and N, S, E or W. Raises ValueError."""
    point = text.find(".") if "." in text else len(text)
    degrees, minutes = int(text[: point - 2]), float(text[point - 2 :])
    if side not in {"N", "S", "E", "W"} or not 0 <= minutes < 60 or degrees < 0:
        raise ValueError
    return (degrees + minutes / 60.0) * (-1 if side in {"S", "W"} else 1)


def _number(text: str) -> float:
    return float(text) if text else np.nan


def _times_ns(log: _Log, settings: TrajectoryFile, path: Path) -> Times:
    """UTC ns of the epochs (N,). A date holds for its epoch and those that follow, the first one also for those before it."""
    times = np.frombuffer(log.times, np.int64)
    days, numbers = np.array(log.days), np.arange(len(times))
    steps = np.diff(times, prepend=times[:1])
    # The day of each epoch, counted from that of the first.
    turns = np.cumsum((steps < -DAY_NS // 2).astype(np.int64) - (steps > DAY_NS - LATE_NS))
    if not (days != _UNDATED).any():
        if settings.date is None:
            raise InputError(
                f"{path}: no valid RMC or ZDA sentence gives the date: put trajectory: {{date: 2024-02-07}} (UTC) into "
                "drive.yaml"
            )
        days[0] = (settings.date - date(1970, 1, 1)).days
    dated = np.maximum.accumulate(np.where(days != _UNDATED, numbers, -1))
    dated = np.where(dated >= 0, dated, np.argmax(days != _UNDATED))
    return np.asarray((days[dated] + turns - turns[dated]) * DAY_NS + times)


def _records(log: _Log, settings: TrajectoryFile, path: Path) -> Iterator[Records]:
    """All epochs. Raises InputError without a date."""
    epochs, fixes = log.fixes.rows()
    if not len(epochs):
        why = f"; {log.damaged:,} sentences have a wrong checksum or content" if log.damaged else ""
        raise InputError(
            f"{path}: there is no GGA or GNS sentence with a time, and others have no heights: log GGA as well{why}"
        )
    count = len(log.times)
    times = _times_ns(log, settings, path)
    lat, lon, altitude, separation, quality, hdop, line = fixes.T
    geoid = settings.heights not in {None, "ellipsoidal"}
    height = altitude if geoid or settings.heights == "ellipsoidal" else altitude + separation
    sigma = np.full((len(epochs), 6), np.nan)
    sigma[:, :3] = log.gst.of_epochs(count)[epochs]
    sigma[~(sigma > 0.0)] = np.nan
    has_gst = ~np.isnan(sigma[:, :3]).any(axis=1)
    for code, (horizontal, up) in SIGMAS_OF_QUALITY_M.items():
        where = (quality == code) & ~has_gst
        sigma[where, :3] = np.array([horizontal, horizontal, up]) * np.fmax(hdop[where], 1.0)[:, None]
    wrong: dict[int, str] = {}
    for code, text in _NO_FIX.items():
        where = (quality == code) & ~(has_gst & (code == 6))
        wrong |= dict.fromkeys(np.flatnonzero(where).tolist(), f"GGA quality {code}: {text}")
    if not geoid:
        lost = np.isnan(height) & np.isfinite(altitude)
        text = "GGA has no geoid separation; put the geoid into drive.yaml, trajectory: {heights: 'EPSG:5773'}"
        wrong = dict.fromkeys(np.flatnonzero(lost).tolist(), text) | wrong
    turns = _attitudes(log, _courses(times, epochs, lat, lon, count))[epochs]
    rotations = None
    # An attitude that most epochs lack costs those that lack it; then the course over ground is better.
    if np.isfinite(turns[:, 0]).mean() > 0.5:
        rotations = attitude(turns[:, 1], turns[:, 2], turns[:, 0])
        sigma[:, 3:] = np.radians(turns[:, 3:])
    names = (f"line {int(number)}" for number in line)
    yield Records(times[epochs], np.column_stack([lat, lon, height]), rotations, sigma, wrong, names)


# --------------------------------------------------------------------------- headings, which have no time


def _attitudes(log: _Log, courses: Floats) -> Floats:
    """(N, 6) heading, roll, pitch and sigmas of roll, pitch, heading (degrees) of the epochs: of PASHR, else of the headings of
    which most can be placed. courses: (N, 2) as of `_courses`."""
    found = log.pashr.of_epochs(len(log.times))
    placed = []
    usual = float(np.median(log.counts))
    cut = log.counts[0] < usual, log.counts[-1] < usual
    for name, (before, after, degrees) in sorted(log.headings.items()):
        epochs = _placed(
            before.tolist(), after.tolist(), _follows(before, after, degrees, courses), len(found) - 1, cut
        )
        placed.append((epochs, degrees, name))
    for epochs, degrees, _ in sorted(placed, key=lambda one: (-len(one[0]), one[2])):
        own = np.full(len(found), np.nan)
        own[list(epochs)] = np.frombuffer(degrees)[list(epochs.values())]
        empty = np.isnan(found[:, 0]) & np.isfinite(own)
        found[empty] = np.array([0.0, 0.0, 0.0, _LEVEL_DEG, _LEVEL_DEG, HEADING_SIGMA_DEG])
        found[empty, 0] = own[empty]
    return found


def _placed(
    before: list[int], after: list[int], follows: bool | None, end: int, cut: tuple[bool, bool]
) -> dict[int, int]:
    """Index of the sentence of each epoch that has one. before, after: epochs of the sentences with a time around each.

    One between two sentences of the same epoch belongs to it. Of several between two epochs the first belongs to the one before,
    the last to the one after. A single one belongs to either: in a row of them, an end whose epoch has one already decides
    about all, as does the whole first or last epoch (0, end) of the log without one; else what most others of the log show; else
    they are of the epoch before. cut: whether these two epochs lack other sentences. follows: whether all are of the epoch
    before, by the course; that counts more than the ends of the log.
    """
    found: dict[int, int] = {}
    ends: dict[int, int] = {}
    rows: list[list[tuple[int, int, int]]] = []
    for (b, a), items in groupby(range(len(before)), key=lambda k: (before[k], after[k])):
        first, *others = items
        if a == b:
            found.setdefault(b, first)
            follows = None  # their order in an epoch changes
        elif -1 in {a, b}:
            ends[max(a, b)] = [first, *others][-1 if b == -1 else 0]
        elif others:
            found[b], found[a] = first, others[-1]
        elif rows and rows[-1][-1][1] == b and b not in found:
            rows[-1].append((b, a, first))
        else:
            rows.append([(b, a, first)])
    taken = found.keys() | ends.keys()
    lacks = {epoch for epoch, is_cut in zip((0, end), cut, strict=True) if not is_cut} - taken
    known = [
        (row[0][0] in taken) - (row[0][0] in lacks) - (row[-1][1] in taken) + (row[-1][1] in lacks) for row in rows
    ]
    votes = sum(side * len(row) for side, row in zip(known, rows, strict=True))
    for side, row in zip(known, rows, strict=True):
        to_next = (side or votes) > 0 if follows is None else not follows
        for b, a, item in row:
            found.setdefault(a if to_next else b, item)
    return ends | found


def _courses(times: Times, epochs: Times, lat: Floats, lon: Floats, count: int) -> Floats:
    """(count, 2) course over ground (rad, clockwise from north) and its change per epoch; NaN where the vehicle rests."""
    found = np.full((count, 2), np.nan)
    at = np.radians(np.column_stack([lat, lon]))
    seconds = np.diff(times[epochs]) * 1e-9
    if len(epochs) < 5 or not SLOW_S < np.median(seconds) < 5.0:
        return found
    steps = np.diff(at, axis=0) * 6.371e6 * np.column_stack([np.ones(len(at) - 1), np.cos(at[1:, 0])])
    moving = (np.linalg.norm(steps, axis=1) > 2.0 * seconds) & (seconds > 0) & (seconds < 5.0)
    course = np.where(moving, np.arctan2(steps[:, 1], steps[:, 0]), np.nan)
    change = np.angle(np.exp(1j * np.diff(course)))
    found[epochs[1:-1]] = np.column_stack([course[:-1] + change / 2, change])
    return found


def _follows(before: array[int], after: array[int], degrees: array[float], courses: Floats) -> bool | None:
    """Whether headings are of the epoch before them: otherwise they turn one step too early against the courses (N, 2).

    None where the vehicle turns too little to show it.
    """
    b, a, heading = np.frombuffer(before, np.int64), np.frombuffer(after, np.int64), np.radians(np.frombuffer(degrees))
    between = (a != b) & (a >= 0) & (b >= 0)
    course, change = courses[np.where(between, b, 0)].T
    usable = between & np.isfinite(course) & np.isfinite(change)
    apart, change = np.angle(np.exp(1j * (heading - course)[usable])), change[usable]
    if not usable.any() or np.sqrt(np.mean(change**2)) < LEAST_TURN_RAD:
        return None
    steps_early = float((apart - np.median(apart)) @ change / (change @ change))
    return steps_early < 0.3 if not 0.3 < steps_early < 0.6 else None
