"""The map as an independent reading of the tables: states, changes and evidence, computed from deltas in Python.

It uses neither the views and functions of sql/functions/ nor the evidence that is stored in the versions.
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from math import hypot
from typing import Any, NamedTuple

import numpy as np

from conetl.db.connection import Connection, execute
from conetl.model.params import ReconcileParams

TICK = timedelta(microseconds=1)
PARAMS = ReconcileParams()
_VERSIONS = """
select v.feature_id::text as id, v.version, v.category, v.present, v.changeset_id::text as changeset,
    ST_X(v.geom) as x, ST_Y(v.geom) as y, ST_Z(v.geom) as z, ST_AsGeoJSON(v.line, 17) as line, v.object_height_m as height,
    array[v.cov_xx, v.cov_xy, v.cov_xz, v.cov_yy, v.cov_yz, v.cov_zz] as cov, v.observation_count as observations,
    v.first_seen_ns, v.last_seen_ns, lower(v.valid_period) as valid_from, upper(v.valid_period) as valid_to,
    lower(v.system_period) as system_from, upper(v.system_period) as system_to
from conetl.feature_version v join conetl.map m using (map_id) where m.map_name = %(map)s
"""
_DELTAS = """
select x.feature_id::text as id, x.kind, x.old_version, x.new_version, x.changed_at, x.existence_after, d.kind as source,
    d.captured_from_ns, d.content_sha256, c.idempotency_key, c.changeset_id::text as changeset,
    lower(x.system_period) as system_from, upper(x.system_period) as system_to
from conetl.delta x join conetl.changeset c using (changeset_id) join conetl.drive d using (drive_uuid)
join conetl.map m on m.map_id = c.map_id where m.map_name = %(map)s
"""


class Instant(NamedTuple):
    """On the road, and in the database; None: latest."""

    valid: datetime | None = None
    known: datetime | None = None


@dataclass(frozen=True)
class Told:
    """One feature as it stood."""

    version: int
    category: str
    xyz_m: tuple[float, float, float]
    line_m: tuple[tuple[float, ...], ...] | None
    height_m: float | None
    """Of the object; None of a line."""
    cov_m2: tuple[float, ...]
    observations: int
    first_seen_ns: int
    last_seen_ns: int
    seen: int
    missed: int
    existence: float
    changeset: str
    valid_from: datetime
    valid_to: datetime | None


class MapByTables:
    """All rows of one map, read once."""

    def __init__(self, conn: Connection, map_name: str) -> None:
        self.versions: dict[str, list[Any]] = defaultdict(list)
        self.deltas: dict[str, list[Any]] = defaultdict(list)
        for row in execute(conn, _VERSIONS, {"map": map_name}):
            self.versions[row["id"]].append(row)
        for row in execute(conn, _DELTAS, {"map": map_name}):
            self.deltas[row["id"]].append(row)
        conn.rollback()

    def standing(self, at: Instant) -> dict[str, Told]:
        """What stood there."""
        return {key: one for key in self.versions if (one := self._state(key, at)) is not None}

    def changes(self, begin: Instant, end: Instant) -> dict[str, tuple[str, float | None, Told | None, Told | None]]:
        """What differs: kind, horizontal shift, earlier and later state."""
        before, after = self.standing(begin), self.standing(end)
        found = {}
        for key in before.keys() | after.keys():
            old, new = before.get(key), after.get(key)
            if old is not None and new is not None and _content(old) == _content(new):
                continue
            found[key] = (*_kind(old, new), old, new)
        return found

    def gone(self, key: str, at: Instant) -> Told | None:
        """The last state of a feature that does not stand there, with the evidence after it; None: nothing is known of it."""
        return self._state(key, at, present=False)

    def _state(self, key: str, at: Instant, *, present: bool = True) -> Told | None:
        rows = [row for row in self.versions[key] if _holds(row, at.known) and row["present"] is present]
        known = sorted(
            (delta for delta in self.deltas[key] if _holds(delta, at.known)),
            key=lambda d: (d["captured_from_ns"], d["content_sha256"], d["idempotency_key"]),
        )
        judged = [one for one in _rows_of(known) if at.valid is None or one["from"] <= at.valid]
        if not judged or (present and judged[-1]["gone"]):
            return None
        last = judged[-1]
        mine = [row for row in rows if row["version"] == last["version"]]
        if not mine:  # a person suppressed it
            return None
        row = mine[0]
        line = None if row["line"] is None else tuple(map(tuple, json.loads(row["line"])["coordinates"]))
        later = [one["from"] for one in _rows_of(known) if one["from"] > last["from"]]
        return Told(
            row["version"], row["category"], (row["x"], row["y"], row["z"]), line, None if line else row["height"],
            tuple(row["cov"]), row["observations"], row["first_seen_ns"], row["last_seen_ns"], last["seen"], last["missed"],
            last["existence"], last["changeset"], last["from"], min(later, default=None),
        )  # fmt: skip


def _rows_of(deltas: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """What deltas in the order of drives say, each from when on; a later drive wins from where it begins."""
    rows: list[dict[str, Any]] = []
    seen = missed = 0
    version_from, existence = None, 0.0
    for delta in deltas:
        seen += delta["source"] == "drive" and delta["kind"] not in ("missed", "removed", "merged")
        missed += delta["kind"] in ("missed", "removed")
        existence = existence if delta["existence_after"] is None else delta["existence_after"]
        begins = delta["changed_at"] if version_from is None else max(delta["changed_at"], version_from + TICK)
        rows = [row for row in rows if not row["is_miss"] or row["from"] < begins]
        if delta["kind"] != "missed":
            version_from = begins
        rows.append({
            "from": begins, "version": delta["new_version"], "seen": seen, "missed": missed, "existence": existence,
            "changeset": delta["changeset"], "is_miss": delta["kind"] == "missed", "gone": delta["kind"] in ("removed", "merged"),
        })  # fmt: skip
    return rows


def _holds(row: Mapping[str, Any], known: datetime | None) -> bool:
    if known is None:
        return row["system_to"] is None
    return row["system_from"] <= known and (row["system_to"] is None or known < row["system_to"])


def _content(one: Told) -> tuple[Any, ...]:
    return (
        one.version, one.category, one.xyz_m, one.line_m, one.height_m, one.cov_m2, one.observations, one.seen, one.missed,
        one.existence, one.last_seen_ns,
    )  # fmt: skip


def _kind(old: Told | None, new: Told | None) -> tuple[str, float | None]:
    if old is None:
        return "added", None
    if new is None:
        return "removed", None
    shift_m, limit_m = hypot(new.xyz_m[0] - old.xyz_m[0], new.xyz_m[1] - old.xyz_m[1]), PARAMS.min_gate_m
    if old.line_m is not None:
        shift_m, limit_m = _distance_m(np.array(old.line_m)[:, :2], np.array(new.xyz_m[:2])), PARAMS.marking_gate_m
    if shift_m > limit_m:
        return "moved", shift_m
    if old.height_m and new.height_m and abs(new.height_m - old.height_m) > PARAMS.moved_height_tolerance_m:
        return "height_changed", shift_m
    only_missed = (
        old.version == new.version and old.seen == new.seen and new.missed > old.missed and old.xyz_m == new.xyz_m
    )
    return ("missed" if only_missed else "confirmed"), shift_m


def _distance_m(line: np.ndarray[Any, Any], point: np.ndarray[Any, Any]) -> float:
    """Of a point from a line of several vertices."""
    a, along = line[:-1], np.diff(line, axis=0)
    share = np.clip(((point - a) * along).sum(axis=1) / (along**2).sum(axis=1), 0, 1)
    return float(np.linalg.norm(a + share[:, None] * along - point, axis=1).min())
