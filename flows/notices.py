"""Notices of work zones and of differences from plans: to webhooks, and as events of Prefect."""

import logging

import httpx
from prefect import get_client
from prefect.events import Event

from conetl.db.map.map_store import find_map
from conetl.db.map.results import MapInfo
from conetl.model.errors import ConetlError
from conetl.model.notices import Notice
from conetl.pipeline.database import MapDatabase
from conetl.pipeline.maps.notices import Round, message_of, notify_receivers, receivers_of
from conetl.pipeline.settings import Settings

_log = logging.getLogger(__name__)


def notify_map_receivers(settings: Settings, database: MapDatabase) -> Round | None:
    """Store the versions of work zones, and notify the receivers of CONETL_WEBHOOKS of them; None without a map.

    A failure is logged and left to the next run.
    """
    try:
        receivers = receivers_of(settings, send_event)
        with database.connection() as conn:
            if find_map(conn, settings.map_name) is not None:
                return notify_receivers(conn, receivers, map_name=settings.map_name)
    except ConetlError as error:
        _log.warning("Receivers of notices were not notified: %s", error)
    return None


def send_event(info: MapInfo, notice: Notice) -> str | None:
    """An event such as `conetl.work_zone.began`; one that is sent twice is stored once. Returns why Prefect does not have it."""
    map_resource = f"conetl.map.{info.map_name}"
    event = Event(
        event=f"conetl.{notice.kind}",
        resource={
            "prefect.resource.id": f"{map_resource}.{notice.subject.topic}.{notice.subject.subject_id}",
            "conetl.map": info.map_name,
        },
        related=[{"prefect.resource.id": map_resource, "prefect.resource.role": "map"}],
        payload=message_of(info, notice),
        id=notice.message_id(info.id_name),
    )
    try:  # not by `emit_event`, whose thread says nothing of what it could not send
        with get_client(sync_client=True) as client:
            client.request("POST", "/events", json=[event.model_dump(mode="json")]).raise_for_status()
    except (httpx.HTTPError, RuntimeError) as error:
        return f"{type(error).__name__}: {error}"[:200]
    return None
