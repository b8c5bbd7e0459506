"""NMEA 0183 logs: GGA (position), RMC or ZDA (date), GST (sigmas), HDT, THS or PASHR (attitude), joined by their time of day.

Read without pynmeagps: see docs/explanation/decisions.md.
Height = altitude above the sea + geoid separation, both of GGA. Sentences without a valid checksum are not used.
"""

from __future__ import annotations

import re
from array import array
from collections.abc import Iterator
from datetime import date
from functools import reduce
from operator import xor
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from conetl.model.arrays import Floats
from conetl.model.errors import InputError
from conetl.readers.trajectories.recorded import Reading, Records, attitude
from conetl.readers.trajectories.settings import TrajectoryFile
from conetl.readers.trajectories.tables import LEVEL_SIGMA_RAD
from conetl.readers.trajectories.text import line_blocks
from conetl.readers.trajectories.times import DAY_NS, SECOND_NS, Times, decimal_ns

MAX_BYTES = 1 << 30
"""About six million epochs of GGA, RMC and GST."""
SIGMAS_OF_QUALITY_M = {1: (5.0, 10.0), 2: (2.0, 4.0), 3: (5.0, 10.0), 4: (0.05, 0.1), 5: (0.5, 1.0), 9: (2.0, 4.0)}
"""Sigmas (horizontal, up) without GST by the quality of GGA: autonomous, differential, PPS, RTK fixed, RTK float, SBAS (NovAtel).
They are multiplied by HDOP where it is above 1."""
HEADING_SIGMA_DEG = 1.0
"""Sigma of HDT and THS, which state none: two antennas half a metre apart."""
LATE_NS = 60 * SECOND_NS
"""Sentences of one day come no later among those of the next; a later time of day after a gap is of the same day."""
_NO_FIX = {
    0: "there was no fix",
    6: "an estimate without satellites, and no GST states its accuracy",
    7: "manual input",
    8: "a simulation",
}
_SENTENCE = re.compile(r"\$((?:[A-Z]{2}(GGA|RMC|ZDA|GST|HDT|THS)|P(ASHR)),[^*$]{0,120})\*([0-9A-Fa-f]{2})")
_ANY = re.compile(r"\$[A-Z]{2}(GGA|RMC|GST|ZDA|GSA|GSV|VTG|GLL|HDT),[^*]*\*[0-9A-Fa-f]{2}")


def looks_like(lines: list[str]) -> bool:
    """Whether most of the first lines are sentences."""
    filled = [line for line in lines[:60] if line.strip()]
    return sum(_ANY.search(line) is not None for line in filled) > len(filled) / 3


def read(path: Path, settings: TrajectoryFile) -> Reading:
    """The epochs of a log. Raises InputError where there is no date."""
    if path.stat().st_size > MAX_BYTES:
        raise InputError(f"{path}: expected at most {MAX_BYTES:,} bytes; cut the log to the time of the drive")
    log = _Log()
    for first, lines in line_blocks(path):
        for number, line in enumerate(lines, first):
            log.add(line, number)
    return Reading(_records(log, settings, path))


class _Log:
    """Sentences as numbers: times in ns since 1970, or since the first day until the date is known."""

    def __init__(self) -> None:
        self.gga_ns, self.gga = array("q"), array("d")  # lat, lon, altitude, separation, quality, HDOP, line
        self.gst_ns, self.gst = array("q"), array("d")  # sigmas of east, north, up
        # heading, roll, pitch, sigmas of roll, pitch, heading; degrees
        self.turn_ns, self.turn = array("q"), array("d")
        self.day, self.dated, self.last_ns = 0, False, -1
        self.damaged = 0

    def add(self, line: str, number: int) -> None:
        match = _SENTENCE.search(line)
        if match is None:
            return
        body = match[1]
        if not body.isascii() or reduce(xor, body.encode()) != int(match[4], 16):
            self.damaged += 1
            return
        words = body.split(",")
        try:
            self._add(match[2] or match[3], words, number)
        except (ValueError, IndexError, OverflowError):
            self.damaged += 1

    def _add(self, kind: str, words: list[str], number: int) -> None:
        if kind == "GGA" and words[1]:
            time_ns = self._at(_time_of_day(words[1]))
            quality = int(words[6] or 0)
            lat, lon = (_degrees(words[2], words[3]), _degrees(words[4], words[5])) if quality else (np.nan, np.nan)
            values = [lat, lon, _number(words[9]), _number(words[11]), quality, _number(words[8]), number]
            self.gga_ns.append(time_ns)
            self.gga.extend(values)
        elif kind == "RMC" and words[1] and words[2] == "A" and len(words[9]) == 6:
            year = int(words[9][4:])
            self._date(date(year + (1900 if year >= 80 else 2000), int(words[9][2:4]), int(words[9][:2])), words[1])
        elif kind == "ZDA" and words[1] and words[4]:
            self._date(date(int(words[4]), int(words[3]), int(words[2])), words[1])
        elif kind == "GST" and words[1]:
            sigmas = [_number(words[k]) for k in (7, 6, 8)]
            self.gst_ns.append(self._at(_time_of_day(words[1])))
            self.gst.extend(sigmas)
        elif kind in {"HDT", "THS"} and words[1] and words[2] in {"T", "A"} and self.last_ns >= 0:
            level = float(np.degrees(LEVEL_SIGMA_RAD))
            values = [_number(words[1]), 0.0, 0.0, level, level, HEADING_SIGMA_DEG]
            self.turn_ns.append(self.day * DAY_NS + self.last_ns)
            self.turn.extend(values)
        elif kind == "ASHR" and len(words) >= 10 and words[1] and words[3] == "T":
            values = [_number(words[k]) for k in (2, 4, 5, 7, 8, 9)]
            self.turn_ns.append(self._at(_time_of_day(words[1])))
            self.turn.extend(values)

    def _at(self, time_of_day_ns: int) -> int:
        """Time of a sentence; a time of day that starts over is on the next day, late sentences are on the day before."""
        step = time_of_day_ns - self.last_ns if self.last_ns >= 0 else 0
        if step > DAY_NS - LATE_NS:
            return (self.day - 1) * DAY_NS + time_of_day_ns
        if step < -DAY_NS // 2:
            self.day += 1
        self.last_ns = time_of_day_ns
        return self.day * DAY_NS + time_of_day_ns

    def _date(self, day: date, time_of_day: str) -> None:
        """The date of a sentence holds for those that follow, the first one also for those before it."""
        time_ns, days = _time_of_day(time_of_day), (day - date(1970, 1, 1)).days
        self._at(time_ns)
        if not self.dated:
            self.move(days - self.day)
            self.dated = True
        self.day, self.last_ns = days, time_ns

    def move(self, days: int) -> None:
        """Move all times so far."""
        for times in (self.gga_ns, self.gst_ns, self.turn_ns):
            for i in range(len(times)):
                times[i] += days * DAY_NS


def _time_of_day(text: str) -> int:
    """Nanoseconds of hhmmss.ss. Raises ValueError."""
    hours, minutes, seconds_ns = int(text[:2]), int(text[2:4]), decimal_ns(text[4:])
    if not (0 <= hours < 24 and 0 <= minutes < 60 and seconds_ns <= 60 * 10**9):
        raise ValueError
    return (hours * 3600 + minutes * 60) * 10**9 + seconds_ns


def _degrees(text: str, side: str) -> float:
    """Degrees of dddmm.mmmm and N, S, E or W. Raises ValueError."""
    point = text.find(".") if "." in text else len(text)
    degrees, minutes = int(text[: point - 2]), float(text[point - 2 :])
    if side not in {"N", "S", "E", "W"} or not 0 <= minutes < 60 or degrees < 0:
        raise ValueError
    return (degrees + minutes / 60.0) * (-1 if side in {"S", "W"} else 1)


def _number(text: str) -> float:
    return float(text) if text else np.nan


def _records(log: _Log, settings: TrajectoryFile, path: Path) -> Iterator[Records]:
    """All epochs. Raises InputError without a date."""
    if not log.gga_ns:
        why = f"; {log.damaged:,} sentences have a wrong checksum or content" if log.damaged else ""
        raise InputError(f"{path}: there is no GGA sentence with a time{why}")
    if not log.dated:
        if settings.date is None:
            raise InputError(
                f"{path}: no valid RMC or ZDA sentence gives the date: put trajectory: {{date: 2024-02-07}} (UTC) into drive.yaml"
            )
        log.move((settings.date - date(1970, 1, 1)).days - int(log.gga_ns[0] // DAY_NS))
    times = np.frombuffer(log.gga_ns, np.int64).copy()
    lat, lon, altitude, separation, quality, hdop, line = np.frombuffer(log.gga).reshape(-1, 7).T
    geoid = settings.heights not in {None, "ellipsoidal"}
    height = altitude if geoid or settings.heights == "ellipsoidal" else altitude + separation
    sigma = np.full((len(times), 6), np.nan)
    sigma[:, :3] = _joined(times, log.gst_ns, np.frombuffer(log.gst).reshape(-1, 3))
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
    turns = _joined(times, log.turn_ns, np.frombuffer(log.turn).reshape(-1, 6))
    rotations = None
    # An attitude that most epochs lack costs those that lack it; then the course over ground is better.
    if np.isfinite(turns[:, 0]).mean() > 0.5:
        rotations = attitude(turns[:, 1], turns[:, 2], turns[:, 0])
        sigma[:, 3:] = np.radians(turns[:, 3:])
    names = (f"line {int(number)}" for number in line)
    yield Records(times, np.column_stack([lat, lon, height]), rotations, sigma, wrong, names)


def _joined(times: Times, keys: array[int], values: Floats) -> Floats:
    """(N, K) values of sentences with the same times (N,); NaN without one."""
    found = np.full((len(times), values.shape[1]), np.nan)
    if len(keys):
        stamps: NDArray[np.int64] = np.frombuffer(keys, np.int64)
        order = np.argsort(stamps, kind="stable")
        at = order[np.searchsorted(stamps[order], times).clip(0, len(order) - 1)]
        same = stamps[at] == times
        found[same] = values[at[same]]
    return found
