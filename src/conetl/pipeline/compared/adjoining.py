"""Drives that one vehicle recorded one after the other must fit together.

If a recording is cut where GNSS jumps, each of its drives agrees with itself, but one lies in the wrong place. Which one is
unknown, unless the map from other drives agrees with one of them, or a person accepted one: the others go on hold, and so do the
drives that continue them; drives that continue a trusted one count. The result depends only on the drives of the map and on which
of them are trusted, not on the order of ingestion, and holds end when nothing contradicts the drives any more.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple
from uuid import UUID

import numpy as np

from conetl.db.connection import Connection
from conetl.db.map.drive_store import AdjoiningDrive, adjoining_drives, read_ends
from conetl.geometry.motion.steps import max_deviation_m
from conetl.geometry.rig import map_SE3_left
from conetl.mapping.history import Doubt
from conetl.model.arrays import Floats
from conetl.model.check_params import JumpCheckParams
from conetl.model.drive import Drive, FramePair
from conetl.model.health import ADJOINING, Finding
from conetl.model.rig import Rig

#: Drives that begin at most this long after another ended may be parts of one recording; longer gaps cannot be bridged.
WITHIN_NS = 5_000_000_000
#: The vehicle's speed comes from the frame pairs of half a second, between two and `_PAIRS` of them. It keeps its direction:
#: `_LEAST_COSINE` is the minimum cosine of the angle between both.
_PAIRS, _NEAR_NS, _LEAST_COSINE = 10, 500_000_000, 0.8
#: Of all drives of a map, whatever the parameters of the newest one.
_LIMITS = JumpCheckParams()


class Adjoining(NamedTuple):
    """What is known of a drive from those before and after it."""

    doubt: Doubt | None
    """None if nothing contradicts it or what it continues, or if a person accepted one of these."""
    on_hold: bool
    """Whether it is on hold for this already."""


class NewDrive(NamedTuple):
    """A drive that was added to the map (`add_drive`) and has no changeset yet."""

    drive_uuid: UUID
    drive: Drive
    replaces: frozenset[UUID]
    """Earlier analyses and deliveries of the recording."""


class _Part(NamedTuple):
    rig: Rig
    pairs: Sequence[FramePair]
    """Of both ends at least, in the order of their time."""


def find_doubts(
    conn: Connection, drive_uuids: Collection[UUID], new_drive: NewDrive | None = None
) -> dict[UUID, Adjoining]:
    """Which of some drives, and of those that they contradict or continue, may lie in the wrong place.

    drive_uuids: of one map. Those that no longer count are not in the result, but the drives that they held are. The drives that
    an old one continues are compared even if nothing contradicts it: it may have been what the map confirmed of them. Raises
    DatabaseError from the surrounding transaction.
    """
    drives: dict[UUID, AdjoiningDrive] = {}
    parts: dict[UUID, _Part] = {}
    links: dict[UUID, dict[UUID, float]] = {}
    gone, new = frozenset[UUID](), set[UUID]()
    if new_drive is not None:
        gone, new, drive = new_drive.replaces, {new_drive.drive_uuid}, new_drive.drive
        pairs = sorted(drive.frame_pairs, key=lambda pair: pair.captured_at_ns)
        drives[new_drive.drive_uuid] = AdjoiningDrive(
            new_drive.drive_uuid, drive.drive_id, drive.rig, pairs[0].captured_at_ns, on_hold=False, accepted=False
        )
        parts[new_drive.drive_uuid] = _Part(drive.rig, pairs)
    todo, explored = set(drive_uuids), set[UUID]()
    doubted = todo - new
    while todo:
        found = [(of, other) for of, other in adjoining_drives(conn, todo, WITHIN_NS) if other.drive_uuid not in gone]
        drives |= {other.drive_uuid: other for _, other in found}
        near = [
            (of, other.drive_uuid)
            for of, other in found
            if of != other.drive_uuid
            and of in drives
            and (drives[of].rig.rig_id, drives[of].rig.left) == (other.rig.rig_id, other.rig.left)
        ]
        ends = read_ends(conn, {drive_uuid for pair in near for drive_uuid in pair} - parts.keys(), _PAIRS)
        parts |= {drive_uuid: _Part(drives[drive_uuid].rig, pairs) for drive_uuid, pairs in ends.items()}
        for one, other in near:
            off_m = _misfit_m(parts[one], parts[other])
            if off_m is not None:
                links.setdefault(one, {})[other] = links.setdefault(other, {})[one] = off_m
        explored |= todo
        doubted |= {other.drive_uuid for _, other in found if other.on_hold}
        doubted |= {of for of in explored & links.keys() if any(links[of].values())}
        doubted |= {other for of in doubted & links.keys() for other in links[of]}
        todo = doubted - explored
    spread = _propagate(drives, links)
    return {of: spread[of] for of in explored & spread.keys()}


def _propagate(
    drives: Mapping[UUID, AdjoiningDrive], links: Mapping[UUID, Mapping[UUID, float]]
) -> dict[UUID, Adjoining]:
    """The doubts about drives that contradict each other, and about all that continue them."""
    in_order = sorted(drives, key=lambda one: (drives[one].captured_from_ns, drives[one].drive_id))
    doubts: dict[UUID, Adjoining] = {}
    for first in in_order:
        if first in doubts:
            continue
        chain = [first]  # of drives of which each continues another one
        for one in chain:
            chain += [other for other in in_order if links.get(one, {}).get(other) == 0 and other not in chain]
        contradicted = {
            one: _contradiction(drives[other].drive_id, links[one][other])
            for one in sorted(chain, key=in_order.index)
            if (other := next((other for other in in_order if links.get(one, {}).get(other)), None)) is not None
        }
        is_known = not contradicted or any(drives[one].accepted for one in chain)
        for one in chain:
            doubt = None
            if not is_known:
                finding = contradicted.get(one) or _continuation(drives[next(iter(contradicted))].drive_id)
                doubt = Doubt(finding, frozenset(chain) - {one})
            doubts[one] = Adjoining(doubt, drives[one].on_hold)
    return doubts


def _misfit_m(one: _Part, other: _Part) -> float | None:
    """Distance between where the later part begins and where the earlier one leads; None if another vehicle recorded it."""
    is_first = one.pairs[-1].captured_at_ns <= other.pairs[0].captured_at_ns
    earlier, later = (one, other) if is_first else (other, one)
    end, begin = _motion(earlier.rig, earlier.pairs[: -_PAIRS - 1 : -1]), _motion(later.rig, later.pairs[:_PAIRS])
    if end is None or begin is None or end.forward @ begin.forward < _LEAST_COSINE:
        return None
    apart_s = (begin.at_ns - end.at_ns) * 1e-9
    off = begin.xyz_m - end.xyz_m - (begin.velocity + end.velocity) / 2 * apart_s
    off_m = np.array([np.hypot(off[0], off[1]), abs(off[2])])
    sigma_m = np.hypot(np.hypot(end.sigma_m, begin.sigma_m), np.hypot(end.sigma_speed, begin.sigma_speed) * apart_s / 2)
    limit_m = np.maximum(_LIMITS.adjoining_m, _LIMITS.sigmas * sigma_m) + max_deviation_m(apart_s)
    return float(np.hypot(*off_m)) if (off_m > limit_m).any() else 0.0


class _Motion(NamedTuple):
    """Motion of the left camera in the middle of a few frame pairs; sigmas horizontal and vertical."""

    at_ns: float
    xyz_m: Floats
    velocity: Floats
    forward: Floats
    """Its direction in the nearest frame pair."""
    sigma_m: Floats
    sigma_speed: Floats


def _motion(rig: Rig, pairs: Sequence[FramePair]) -> _Motion | None:
    """Fit a line to the positions over time. pairs: the nearest one first; None for fewer than two instants."""
    near_ns = [abs(pair.captured_at_ns - pairs[0].captured_at_ns) for pair in pairs]
    pairs = [pair for k, (pair, off_ns) in enumerate(zip(pairs, near_ns, strict=True)) if k < 2 or off_ns <= _NEAR_NS]
    at_ns = np.array([pair.captured_at_ns for pair in pairs], np.int64)
    if at_ns.min() == at_ns.max():
        return None
    left = np.array([map_SE3_left(pair.pose, rig) for pair in pairs])
    off_s = (at_ns - at_ns[0]) * 1e-9
    middle_s, off_s = off_s.mean(), off_s - off_s.mean()
    xyz_m, spread_s = left[:, :3, 3], float(np.sqrt(off_s @ off_s))
    sigma_m = np.max([pair.pose.sigma_enu_m for pair in pairs], axis=0)
    sigma_m = np.array([sigma_m[:2].max(), sigma_m[2]])
    return _Motion(
        float(at_ns[0]) + middle_s * 1e9,
        xyz_m.mean(0),
        off_s @ xyz_m / spread_s**2,
        left[0, :3, 2],
        sigma_m,
        sigma_m / spread_s,
    )


def _contradiction(other_id: str, off_m: float) -> Finding:
    return Finding(check=ADJOINING, value=off_m, limit=_LIMITS.adjoining_m, facts={"drive_id": other_id})


def _continuation(other_id: str) -> Finding:
    return Finding(check=ADJOINING, found=True, says=("continues",), facts={"drive_id": other_id})
