"""Drives that one vehicle recorded one after the other must fit together.

A recording that was cut where GNSS jumps gives drives of which each agrees with itself, and one lies in the wrong place. Which
one is not known, unless the map as other drives left it agrees with one of them, or a person accepted it: the others go on hold,
and so do the drives that continue them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple
from uuid import UUID

import numpy as np

from conetl.db.connection import Connection
from conetl.db.map.drive_store import AdjoiningDrive, adjoining_drives, read_frame_pairs
from conetl.geometry.motion.steps import step_misfit
from conetl.geometry.rig import map_SE3_left
from conetl.model.health import ADJOINING, HealthCheck, Verdict
from conetl.model.map_records import Delta, DeltaKind
from conetl.model.records import Drive, FramePair, Rig

#: Drives that begin so many seconds after another ended may be parts of one recording; of longer ones nothing can be said.
_WITHIN_S = 5.0
#: So many frame pairs of each say how fast the vehicle was; it drives on in about the same direction.
_PAIRS, _LEAST_COSINE = 5, 0.8
#: Jumps are at least so many metres and sigmas.
_JUMP_M, _JUMP_SIGMAS = 0.3, 6.0
#: A drive that confirms so many objects which were on the map an hour before is where the map has it.
_LEAST_CONFIRMED, _BEFORE_NS = 3, 3_600_000_000_000


class Doubt(NamedTuple):
    """Which drives may lie in the wrong place."""

    own: HealthCheck | None
    """Why the drive itself goes on hold; None where it counts."""
    others: tuple[tuple[UUID, UUID, HealthCheck], ...]
    """Drives on the map that go on hold: drive_uuid, changeset and why."""


class _Part(NamedTuple):
    drive_id: str
    content_sha256: str
    rig: Rig
    pairs: Sequence[FramePair]
    """In the order of their time."""


def find_doubt(conn: Connection, drive: Drive, deltas: Sequence[Delta], *, map_name: str) -> Doubt:
    """Compare a drive with those of the same rig that were recorded right before and after it.

    deltas: what the comparison with the map made of it. Raises DatabaseError from the surrounding transaction.
    """
    part = _Part(drive.drive_id, drive.content_sha256, drive.rig, _in_time(drive.frame_pairs))
    trusted = is_confirmed(deltas, part.pairs[0].captured_at_ns)
    own: HealthCheck | None = None
    doubted: dict[UUID, tuple[AdjoiningDrive, HealthCheck]] = {}
    reached: list[_Part] = []
    for other, its_part, off_m in _neighbours(conn, part, map_name):
        if off_m:
            if not trusted:
                own = own or _contradiction(other.drive_id, off_m)
            if not other.is_trusted(_LEAST_CONFIRMED) and not other.on_hold:
                doubted[other.drive_uuid] = other, _contradiction(drive.drive_id, off_m)
                reached.append(its_part)
        elif other.on_hold and not trusted:
            own = own or _continuation(other.drive_id)
    if own is not None:
        reached.append(part)
    while reached:
        start = reached.pop()
        for other, its_part, off_m in _neighbours(conn, start, map_name):
            known = other.drive_uuid in doubted or other.on_hold or other.is_trusted(_LEAST_CONFIRMED)
            if not off_m and not known and other.drive_id != drive.drive_id:
                doubted[other.drive_uuid] = other, _continuation(start.drive_id)
                reached.append(its_part)
    return Doubt(own, tuple((other.drive_uuid, other.changeset_id, check) for other, check in doubted.values()))


def is_confirmed(deltas: Sequence[Delta], captured_from_ns: int) -> bool:
    """Whether a drive agrees with what was on the map an hour before it began."""
    kinds = DeltaKind.CONFIRMED, DeltaKind.HEIGHT_CHANGED
    known = [d for d in deltas if d.kind in kinds and d.old and d.old.first_seen_ns < captured_from_ns - _BEFORE_NS]
    return len(known) >= _LEAST_CONFIRMED


def _neighbours(conn: Connection, part: _Part, map_name: str) -> list[tuple[AdjoiningDrive, _Part, float]]:
    """Drives of the same vehicle right before and after a part, and by how many metres they do not fit; 0 where they do."""
    first_ns, last_ns = part.pairs[0].captured_at_ns, part.pairs[-1].captured_at_ns
    found = []
    for other in adjoining_drives(
        conn,
        part.drive_id,
        part.content_sha256,
        (first_ns, last_ns),
        round(_WITHIN_S * 1e9),
        _BEFORE_NS,
        map_name=map_name,
    ):
        if (other.rig.rig_id, other.rig.left) != (part.rig.rig_id, part.rig.left):
            continue
        theirs = _Part(
            other.drive_id, other.content_sha256, other.rig, _in_time(read_frame_pairs(conn, other.drive_uuid))
        )
        earlier, later = (part, theirs) if other.captured_from_ns >= last_ns else (theirs, part)
        off_m = _misfit_m(earlier, later)
        if off_m is not None:
            found.append((other, theirs, off_m))
    return found


def _misfit_m(earlier: _Part, later: _Part) -> float | None:
    """By how much the later part begins elsewhere than where the earlier one led; None where another vehicle made it."""
    pairs = [*earlier.pairs[-_PAIRS:], *later.pairs[:_PAIRS]]
    rigs = [*[earlier.rig] * len(earlier.pairs[-_PAIRS:]), *[later.rig] * len(later.pairs[:_PAIRS])]
    last = len(earlier.pairs[-_PAIRS:]) - 1
    left = np.array([map_SE3_left(pair.pose, rig) for pair, rig in zip(pairs, rigs, strict=True)])
    if left[last, :3, 2] @ left[last + 1, :3, 2] < _LEAST_COSINE:
        return None
    times_s = np.array([pair.captured_at_ns - pairs[0].captured_at_ns for pair in pairs]) * 1e-9
    times_s = np.maximum.accumulate(times_s + 1e-6 * np.arange(len(pairs)))
    steps_m = np.diff(left[:, :3, 3], axis=0)
    speeds = steps_m / np.diff(times_s)[:, None]
    speeds[last] = np.nan
    misfit = step_misfit(steps_m, speeds, times_s, last)
    if misfit is None:
        return None
    sigma_m = np.array([pairs[k].pose.sigma_enu_m for k in (last, last + 1)])
    horizontal_m, vertical_m = np.maximum(_JUMP_M, _JUMP_SIGMAS * np.hypot(*sigma_m))[1:]
    return misfit.unexplained_m((float(horizontal_m), float(vertical_m)))


def _in_time(pairs: Sequence[FramePair]) -> list[FramePair]:
    return sorted(pairs, key=lambda pair: pair.captured_at_ns)


def _contradiction(other_id: str, off_m: float) -> HealthCheck:
    detail = (
        f"It and drive {other_id}, recorded right before or after it by the same cameras, lie {off_m:.1f} m apart where one "
        "continues the other: GNSS/INS jumps there, and which of them is right is unknown. Process the GNSS/INS log anew, or "
        "accept the one that is right."
    )
    return HealthCheck(
        name=ADJOINING, verdict=Verdict.HOLD, value=round(off_m, 3), limit=_JUMP_M, unit="m", detail=detail
    )


def _continuation(other_id: str) -> HealthCheck:
    detail = (
        f"It continues drive {other_id}, which is on hold because GNSS/INS jumps between it and another drive: it has the same "
        "position error, if there is one. Process the GNSS/INS log anew, or accept it if that drive is right."
    )
    return HealthCheck(name=ADJOINING, verdict=Verdict.HOLD, value=None, detail=detail)
