"""Notices of a map: what changed of its work zones and of their differences from plans is recorded, then sent to receivers.

Both are rounds that may be repeated at any time: recording compares the map with the last notices; each receiver gets the
notices of one subject in their order, at least once. A process that dies between an answer and its record sends it again.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple
from uuid import UUID

from conetl.db.connection import Connection
from conetl.db.map import notice_store as store
from conetl.db.map.map_store import map_transaction, require_map
from conetl.db.map.results import MapInfo
from conetl.db.receipt_store import try_lock
from conetl.geometry.geodesy import to_geodetic
from conetl.model.base import ns_from_utc, utc_from_ns
from conetl.model.errors import InputError
from conetl.model.notices import Notice, Subject
from conetl.model.work_zone_params import WorkZoneParams
from conetl.model.work_zone_records import WorkZone
from conetl.pipeline.maps.planned_zones import compare_with_plans
from conetl.pipeline.maps.work_zones import read_zones, zone_as_dict
from conetl.pipeline.settings import Settings
from conetl.services import webhooks
from conetl.workzones.work_zones import Stood, same_zones

_log = logging.getLogger(__name__)
_PREFECT = "prefect"
#: A cone that is found so much farther away has been moved; less is accuracy.
_MOVED_M = 0.5
#: A device of a zone whose id became another one is known again by its place; feature ids may be others, too.
_SAME_PLACE_M = 1.0
#: Of a zone, what makes another notice; of a difference likewise.
_ZONE_KEYS = ("start", "end", "merged_into", "closed_side", "closed_lane_count", "vehicle_impact", "direction_known")
_DIFFERENCE_KEYS = ("kind", "zone_id", "planned_from", "planned_until", "verdict")
#: Plans become due as time passes: they are compared so often if nothing changes.
_PLANS_AGAIN_S = 3600.0
#: A failed notice is tried again after this time, then twice as long ..., until it is given up.
_FIRST_WAIT_S, _MOST_WAIT_S, _PATIENCE_S = 30.0, 6 * 3600.0, 3 * 86400.0
#: A round for one receiver ends after so many notices, this time, or so many failures one after the other.
_MOST_NOTICES, _MOST_ROUND_S, _MOST_FAILURES = 500, 60.0, 3

#: Tells a receiver; returns why it does not have the notice, else None.
Send = Callable[[MapInfo, Notice], str | None]


class Receiver(NamedTuple):
    """Who is notified."""

    name: str
    send: Send


class Round(NamedTuple):
    """What a round did."""

    recorded: int
    delivered: int
    failed: int


def receivers_of(settings: Settings, prefect: Send) -> list[Receiver]:
    """Those of CONETL_WEBHOOKS: addresses, and `prefect` for events of Prefect, which that function sends.

    Raises InputError for what is no address, or without CONETL_WEBHOOK_SECRET.
    """
    given = settings.webhooks.get_secret_value() if settings.webhooks else ""
    names = dict.fromkeys(name for one in given.split(",") if (name := one.strip()))
    secret = settings.webhook_secret.get_secret_value() if settings.webhook_secret else ""
    if names.keys() - {_PREFECT} and not secret:
        raise InputError("CONETL_WEBHOOK_SECRET is not set: receivers check with it that messages are conetl's")

    def send(url: str, info: MapInfo, notice: Notice) -> str | None:
        return webhooks.post(url, secret, str(notice.message_id(info.id_name)), message_of(info, notice))

    return [
        Receiver(_PREFECT, prefect) if name == _PREFECT else Receiver(webhooks.receiver_name(name), partial(send, name))
        for name in names
    ]


def message_of(info: MapInfo, notice: Notice) -> dict[str, Any]:
    """The content of a message; `sequence` rises with the notices of a map."""
    return {
        "type": notice.kind, "timestamp": notice.recorded_at.isoformat(), "map": info.map_name, "sequence": notice.notice_no,
        "data": dict(notice.state),
    }  # fmt: skip


def notify_receivers(conn: Connection, receivers: Sequence[Receiver], *, map_name: str) -> Round:
    """Record what changed on a map, of a large one only for receivers, and notify them. Raises InputError if there is no map."""
    info = require_map(conn, map_name)
    for receiver in receivers:
        store.add_receiver(conn, info.map_id, receiver.name)
    most = None if receivers else WorkZoneParams().most_in_rounds
    recorded = record_notices(conn, map_name=map_name, most_features=most)
    counts = [deliver(conn, info, receiver) for receiver in receivers]
    return Round(recorded, sum(done for done, _ in counts), sum(failed for _, failed in counts))


def record_notices(conn: Connection, *, map_name: str, most_features: int | None = None) -> int:
    """Compare work zones, and their differences from plans, with their last versions; returns the number of new ones.

    most_features: nothing is done on a larger map, where this takes about a second per 1,000 features.
    """
    info = require_map(conn, map_name)
    due = store.round_due(conn, info.map_id, most_s=_PLANS_AGAIN_S)
    if not due["is_due"] or (most_features is not None and due["feature_count"] > most_features):
        return 0
    params = WorkZoneParams()
    zones = _read_states(conn, info, params)
    if _keep_ids(conn, info, zones):
        zones = _read_states(conn, info, params)
    now = {Subject("work_zone", zone_id): state for zone_id, state in zones.items()}
    rows = compare_with_plans(conn, map_name=map_name).rows if due["has_plans"] else []
    for row in rows:
        if row.rank is not None:
            now[Subject("plan_difference", row.difference.difference_id)] = _as_json(row.flat() | {"end": None})
    oldest = utc_from_ns(ns_from_utc(due["newest"]) - int(params.keep_ended_days * 86400e9)).isoformat()
    with map_transaction(conn, map_name):  # two that record at the same time see each other's notices
        before = store.last_states(conn, info.map_id)
        new = [(one, event, {**state, **_origin(one, before, state)}) if event == "began" else (one, event, state)
               for one, event, state in _changes(before, now, oldest)]  # fmt: skip
        store.write_notices(conn, info.map_id, new, due["newest"])
    return len(new)


def _read_states(conn: Connection, info: MapInfo, params: WorkZoneParams) -> dict[UUID, dict[str, Any]]:
    found = read_zones(conn, map_name=info.map_name, as_of=None, lanes=None, params=params)
    return {zone.history.zone_id: _zone_state(zone, info.srid) for zone in found.zones}


def _keep_ids(conn: Connection, info: MapInfo, zones: Mapping[UUID, Mapping[str, Any]]) -> bool:
    """Store under which ids zones were known whose ids are others now; whether there are any."""
    with map_transaction(conn, info.map_name):
        known = {one.subject_id: state for one, (event, state) in store.last_states(conn, info.map_id).items()
                 if one.topic == "work_zone" and event != "withdrawn"}  # fmt: skip
        lost, new = (
            {zone_id: Stood(one["start"], one["end"], [device["xyz_m"] for device in one["devices"]])
             for zone_id, one in some.items() if zone_id not in others}
            for some, others in ((known, zones), (zones, known))
        )  # fmt: skip
        aliases = same_zones(lost, new, _SAME_PLACE_M)
        stored = store.read_zone_aliases(conn, map_name=info.map_name)
        aliases = {computed_id: zone_id for computed_id, zone_id in aliases.items() if computed_id not in stored}
        store.write_zone_aliases(conn, info.map_id, aliases)
    return bool(aliases)


def _origin(
    one: Subject, before: Mapping[Subject, tuple[str, Mapping[str, Any]]], state: Mapping[str, Any]
) -> dict[str, Any]:
    """The zone of which a new one is a part that was split off: it had most of its devices."""
    if one.topic != "work_zone":
        return {}
    own = {device["feature_id"] for device in state["devices"]}
    shared = {other.subject_id: len(own & {device["feature_id"] for device in known["devices"]})
              for other, (event, known) in before.items()
              if other.topic == one.topic and other != one and event in ("began", "changed")}  # fmt: skip
    most = max(shared, key=lambda zone_id: (shared[zone_id], str(zone_id)), default=None)
    return {"split_from": str(most)} if most is not None and shared[most] else {}


def deliver(conn: Connection, info: MapInfo, receiver: Receiver) -> tuple[int, int]:
    """Send a receiver what is due; the number of notices it has now and of failures. One process at a time does that."""
    done = failed = in_a_row = 0
    until = time.monotonic() + _MOST_ROUND_S
    with try_lock(conn, f"conetl.notices/{receiver.name}/{info.map_id}") as free:
        due = store.due_notices(conn, info.map_id, receiver.name, most=_MOST_NOTICES) if free else []
        while due:
            for notice in due:
                problem = receiver.send(info, notice)
                wait_s = min(_FIRST_WAIT_S * 2.0 ** min(notice.attempts, 20), _MOST_WAIT_S)
                store.write_delivery(conn, receiver.name, notice, problem, wait_s=wait_s, patience_s=_PATIENCE_S)
                if problem is None:
                    done, in_a_row = done + 1, 0
                else:
                    failed, in_a_row = failed + 1, in_a_row + 1
                    _log.warning(
                        "%s was not notified of %s %s: %s",
                        receiver.name,
                        notice.kind,
                        notice.subject.subject_id,
                        problem,
                    )
                if in_a_row == _MOST_FAILURES or done >= _MOST_NOTICES or time.monotonic() > until:
                    return done, failed
            due = store.due_notices(conn, info.map_id, receiver.name, most=_MOST_NOTICES)
    return done, failed


def _changes(
    before: Mapping[Subject, tuple[str, Mapping[str, Any]]], now: Mapping[Subject, dict[str, Any]], oldest: str
) -> Iterator[tuple[Subject, str, Mapping[str, Any]]]:
    """New notices; what is not known and ended before `oldest` is old news."""
    for subject, state in now.items():
        event, last = before.get(subject, ("", {}))
        ended = state["end"] is not None
        if event == "" and not (ended and state["end"] < oldest):
            yield subject, "ended" if ended else "began", state
        elif event in ("ended", "withdrawn") and not ended:
            yield subject, "began", state
        elif event and _differs(subject, last, state):
            yield subject, "ended" if ended else "changed", state
    for subject, (event, last) in before.items():
        if subject not in now and event in ("began", "changed"):
            yield subject, "withdrawn" if subject.topic == "work_zone" else "ended", last


def _differs(subject: Subject, before: Mapping[str, Any], now: Mapping[str, Any]) -> bool:
    if subject.topic != "work_zone":
        return any(before.get(key) != now[key] for key in _DIFFERENCE_KEYS)
    places = [{cone["feature_id"]: cone["xyz_m"] for cone in state["devices"]} for state in (before, now)]
    return (
        any(before.get(key) != now[key] for key in _ZONE_KEYS)
        or places[0].keys() != places[1].keys()
        or any(math.dist(places[0][key][:2], places[1][key][:2]) > _MOVED_M for key in places[0])
    )


def _zone_state(zone: WorkZone, srid: int) -> dict[str, Any]:
    """A work zone as JSON values, with its devices in the map's CRS and its line in WGS 84."""
    history = zone.history
    end_ns, merged = history.end_ns, history.merged_into
    geodetic = to_geodetic(srid, zone.line_m)
    return {
        **{key: value for key, value in zone_as_dict(zone).items() if key != "cones"},
        "start": utc_from_ns(history.start_ns).isoformat(),
        "end": None if end_ns is None else utc_from_ns(end_ns).isoformat(),
        "merged_into": None if merged is None else str(merged),
        "srid": srid,
        "devices": [
            {"feature_id": str(cone.feature_id), "xyz_m": [round(value, 3) for value in cone.xyz_m]}
            for cone in zone.layout.cones
        ],
        "line": {"type": "LineString", "coordinates": geodetic[:, [1, 0]].round(8).tolist()},
    }


def _as_json(values: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value.isoformat() if hasattr(value, "isoformat") else
            value if isinstance(value, (str, int, float, bool, list, type(None))) else str(value)
            for key, value in values.items()}  # fmt: skip
