"""Where and when drives looked: passes of drives at points of the map, whatever they found there, and those at a work zone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any
from uuid import UUID

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from conetl.model.arrays import Bools, Floats, Ints
from conetl.model.base import utc_from_ns
from conetl.model.planned_zones import Sight
from conetl.model.rig import Side
from conetl.model.work_zone_params import PlanParams

_STEP_M = 2.0
_LATEST_NS = np.iinfo(np.int64).max
#: So many of a zone's devices must have been passed to say that it was not there yet.
_MOST = 0.5
Nanoseconds = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class DriveFrames:
    """Frame pairs of one drive that show absence, in the order of time."""

    drive_id: str
    frames: Ints
    """(N,)"""
    at_ns: Nanoseconds
    """(N,)"""
    xy_m: Floats
    """(N, 2) in the map's CRS."""
    drive_uuid: UUID | None = None
    """Several drives may have one drive_id."""


@dataclass(frozen=True, eq=False)
class ZonePhase:
    """The devices of a zone from an instant on."""

    from_ns: int
    last_seen_ns: int
    """When one of them was last seen, before the next phase."""
    xy_m: Floats
    """(N, 2) in the map's CRS."""


@dataclass(frozen=True, eq=False)
class FoundZone:
    """A work zone of the map over time."""

    zone_id: UUID
    phases: tuple[ZonePhase, ...]
    """By time, at least one."""
    first_seen_ns: int
    last_seen_ns: int
    gone_ns: int | None
    """When a drive observed that its last device was gone."""
    sigma_m: float
    """Horizontal, of its least certain device."""
    existence: float
    """Probability that enough of its devices exist to be a work zone."""
    closed_side: Side | None = None
    closed_lane_count: int | None = None
    merged_into: UUID | None = None
    """The zone that has had its devices since."""


@dataclass(frozen=True, eq=False)
class SeenZone:
    """A zone and the passes at it."""

    zone: FoundZone
    sightings: tuple[tuple[int, Floats], ...]
    """Instants (ns), and the devices (N, 2) that stood then."""
    absent_ns: int | None
    absent: Sight | None
    first: Sight
    last: Sight
    gone: Sight | None

    @property
    def xy_m(self) -> Floats:
        return np.concatenate([phase.xy_m for phase in self.zone.phases])


@dataclass(frozen=True, eq=False)
class Look:
    """One pass of a drive at some of M points."""

    drive: DriveFrames
    frame_index: int
    """Of a frame pair just before their middle."""
    from_ns: int
    until_ns: int
    seen: Bools
    """(M,)"""

    @property
    def sight(self) -> Sight:
        names = {"drive_id": self.drive.drive_id, "drive_uuid": self.drive.drive_uuid, "frame_index": self.frame_index}
        return Sight(at=utc_from_ns(self.from_ns), **names)


class Looks:
    """Passes of all drives, to be asked for any points."""

    def __init__(self, drives: Sequence[DriveFrames], params: PlanParams) -> None:
        ordered = sorted((one for one in drives if len(one.frames)), key=_order)
        dense = [_dense(one, params.look_gap_m) for one in ordered]
        self._params = params
        self._drives = ordered
        self._drive = np.repeat(np.arange(len(dense)), [len(at_ns) for _, at_ns, _ in dense])
        frames, at_ns, xy_m = ([part[k] for part in dense] for k in range(3))
        self._frames = np.concatenate([np.empty(0, np.intp), *frames])
        self._at_ns = np.concatenate([np.empty(0, np.int64), *at_ns])
        self._tree = KDTree(np.concatenate([np.empty((0, 2)), *xy_m]))

    def at(self, points_m: Floats) -> list[Look]:
        """The passes at points (M, 2), by time."""
        hits: Any = self._tree.query_ball_point(points_m, self._params.look_aside_m)
        point = np.repeat(np.arange(len(points_m)), [len(some) for some in hits])
        row = np.concatenate([np.empty(0, np.intp), *(np.array(some, np.intp) for some in hits)])
        order = np.lexsort((row, self._at_ns[row], self._drive[row]))
        point, row = point[order], row[order]
        drive, at_ns = self._drive[row], self._at_ns[row]
        cuts = np.flatnonzero((np.diff(drive) != 0) | (np.diff(at_ns) > self._params.pass_s * 1e9)) + 1
        looks = []
        for group in np.split(np.arange(len(row)), cuts) if len(row) else []:
            seen = np.zeros(len(points_m), bool)
            seen[point[group]] = True
            middle = np.flatnonzero(seen)[seen.sum() // 2]
            first = row[group[point[group] == middle][0]]
            by, from_ns, until_ns = self._drives[drive[group[0]]], int(at_ns[group[0]]), int(at_ns[group[-1]])
            looks.append(Look(by, int(self._frames[first]), from_ns, until_ns, seen))
        return sorted(looks, key=lambda look: (look.from_ns, _order(look.drive)))


def _order(drive: DriveFrames) -> tuple[int, str, str]:
    return int(drive.at_ns[0]), drive.drive_id, str(drive.drive_uuid)


def _dense(one: DriveFrames, gap_m: float) -> tuple[Ints, Nanoseconds, Floats]:
    """Frame numbers, instants and positions of a drive, with positions between frame pairs less than gap_m apart."""
    steps_m = np.hypot(*np.diff(one.xy_m, axis=0).T)
    counts = np.where(steps_m <= gap_m, np.maximum(np.ceil(steps_m / _STEP_M), 1), 1).astype(np.intp)
    starts = np.repeat(np.arange(len(steps_m)), counts)
    within = np.arange(len(starts)) - np.repeat(np.cumsum(counts) - counts, counts)
    at = np.append(starts + within / np.repeat(counts, counts), len(one.xy_m) - 1)
    every = np.arange(len(one.xy_m))
    since_ns = np.interp(at, every, (one.at_ns - one.at_ns[0]).astype(np.float64)).astype(np.int64)
    xy_m = np.stack([np.interp(at, every, column) for column in one.xy_m.T], axis=1)
    return one.frames[at.astype(np.intp)], one.at_ns[0] + since_ns, xy_m


def sightings_of(zone: FoundZone, looks: Looks, params: PlanParams) -> SeenZone:
    """Passes at a zone: those before it, at most of its first devices, and those while it stood, as devices were seen later."""
    slack_ns = round(params.pass_s * 1e9)
    every = looks.at(np.concatenate([phase.xy_m for phase in zone.phases]))
    first = len(zone.phases[0].xy_m)
    before = [one for one in every if one.until_ns < zone.first_seen_ns - slack_ns and one.seen[:first].mean() >= _MOST]
    sightings = []
    for phase, next_ns in zip(zone.phases, [*(one.from_ns for one in zone.phases[1:]), _LATEST_NS], strict=True):
        until_ns = min(next_ns - slack_ns, phase.last_seen_ns)
        later = {phase.last_seen_ns, *(one.from_ns for one in every)}
        if phase.last_seen_ns >= phase.from_ns - slack_ns:
            instants = [phase.from_ns, *sorted(ns for ns in later if phase.from_ns + slack_ns < ns <= until_ns)]
            sightings += [(ns, phase.xy_m) for ns in instants]

    def sight(ns: int) -> Sight:
        by = next(
            (one.sight for one in every if one.from_ns - slack_ns <= ns <= one.until_ns + slack_ns),
            Sight(at=utc_from_ns(ns)),
        )
        return by.model_copy(update={"at": utc_from_ns(ns)})

    absent_ns = before[-1].from_ns if before else None
    ends = (None if ns is None else sight(ns) for ns in (absent_ns, zone.gone_ns))
    return SeenZone(
        zone, tuple(sightings), absent_ns, next(ends), sight(zone.first_seen_ns), sight(zone.last_seen_ns), next(ends)
    )
