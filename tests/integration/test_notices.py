"""Notices of work zones to real servers: signed, in order, none lost, whatever the receiver does."""

from __future__ import annotations

import base64
import hashlib
import hmac
import json
import logging
import time
from collections import defaultdict
from contextlib import contextmanager
from datetime import UTC, datetime
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Thread
from uuid import UUID

import httpx
import pytest
from pydantic import SecretStr

from conetl.db.connection import execute
from conetl.db.map import notice_store as store
from conetl.db.map.map_store import map_transaction, require_map
from conetl.model.errors import InputError
from conetl.model.notices import Subject
from conetl.pipeline.maps import notices
from conetl.pipeline.maps.notices import Receiver, deliver, notify_receivers, receivers_of, record_notices
from conetl.pipeline.settings import Settings
from conetl.services import webhooks
from tests import command
from tests.integration.drives_of_days import merge, survey

SECRET = "shared with the receiver"


class Inbox(ThreadingHTTPServer):
    """A receiver: `answers` are status codes, `hang` or `drop`, one after the other; then 200."""

    daemon_threads = True

    def __init__(self, answers=(), port=0):
        self.answers, self.taken, self.seen = list(answers), [], []
        super().__init__(("127.0.0.1", port), _Handler)

    @property
    def url(self):
        return f"http://127.0.0.1:{self.server_port}/conetl?token=hidden"


class _Handler(BaseHTTPRequestHandler):
    def do_POST(self):
        body = self.rfile.read(int(self.headers["content-length"]))
        signed = f"{self.headers['webhook-id']}.{self.headers['webhook-timestamp']}.".encode() + body
        own = "v1," + base64.b64encode(hmac.new(SECRET.encode(), signed, hashlib.sha256).digest()).decode()
        assert self.headers["webhook-signature"] == own
        assert abs(int(self.headers["webhook-timestamp"]) - time.time()) < 60
        answer = self.server.answers.pop(0) if self.server.answers else 200
        message = json.loads(body) | {"id": self.headers["webhook-id"]}
        self.server.seen.append(message)
        if answer == "hang":
            time.sleep(3.0)
            return
        if answer == "drop":
            self.connection.close()
            return
        if answer == 200:
            self.server.taken.append(message)
        self.send_response(answer)
        if answer == 302:
            self.send_header("location", self.server.url)
        self.end_headers()

    def log_message(self, *_):
        pass


@contextmanager
def inbox(*answers, port=0):
    with Inbox(answers, port) as server:
        Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True).start()
        yield server
        server.shutdown()


def settings_for(*urls):
    return Settings(webhooks=",".join(urls), webhook_secret=SECRET)


def receivers_at(*urls):
    return receivers_of(settings_for(*urls), lambda *_: None)


@pytest.fixture(autouse=True)
def no_waiting(monkeypatch):
    monkeypatch.setattr(notices, "_FIRST_WAIT_S", 0.0)
    monkeypatch.setattr(webhooks, "_TIMEOUT_S", 0.5)


def write(conn, *events):
    """Notices of subjects by number: (1, "began"), ..."""
    with map_transaction(conn):
        info = require_map(conn, "default")
        made = [(Subject("work_zone", UUID(int=n)), event, {"end": None, "of": n}) for n, event in events]
        store.write_notices(conn, info.map_id, made, datetime.now(UTC))
    return info


@pytest.fixture
def info(conn):
    merge(conn, survey(0))
    conn.commit()
    return require_map(conn, "default")


def test_a_zone_that_begins_changes_and_is_reverted_is_told_once_each(conn, conetl, monkeypatch):
    merge(conn, survey(0))
    conn.commit()
    with inbox() as server:
        receivers = receivers_at(server.url)
        assert notify_receivers(conn, receivers, map_name="default") == (1, 1, 0)
        assert notify_receivers(conn, receivers, map_name="default") == (0, 0, 0)
        merge(conn, survey(1))
        conn.commit()
        monkeypatch.setenv("CONETL_WEBHOOKS", server.url)
        assert "CONETL_WEBHOOK_SECRET is not set" in conetl("zones", "notify", code=2)
        monkeypatch.setenv("CONETL_WEBHOOK_SECRET", SECRET)
        assert "1 new notice of map default; 1 delivered, 0 failed" in conetl("zones", "notify")
        first, second = server.taken
        assert (first["type"], second["type"]) == ("work_zone.began", "work_zone.changed")
        assert first["data"]["work_zone_id"] == second["data"]["work_zone_id"]
        assert len(first["data"]["devices"]) == 7
        assert first["map"] == "default"
        assert first["sequence"] < second["sequence"]
        lon, lat = first["data"]["line"]["coordinates"][0]
        assert (round(lon), round(lat)) != (0, 0)
        conetl("map", "revert", "2", "--note", "wrong road")
        conetl("zones", "notify")
        assert server.taken[-1]["type"] == "work_zone.changed"
        assert len(server.taken[-1]["data"]["devices"]) == 7
        conetl("map", "revert", "1", "--note", "wrong road")
        conetl("zones", "notify")
        assert server.taken[-1]["type"] == "work_zone.withdrawn"
        assert "0 undelivered notices" in conetl("zones", "undelivered")
        assert execute(conn, "select receiver from conetl.notice_receiver")[0]["receiver"].startswith("127.0.0.1 ")
    conn.rollback()


@pytest.mark.parametrize("trouble", [500, 404, 302, "hang", "drop"])
def test_nothing_is_lost_or_out_of_order_while_a_receiver_is_in_trouble(conn, info, trouble):
    """One zone fails, others arrive meanwhile; its later notices wait for it."""
    with inbox(200, trouble, trouble) as server:
        [receiver] = receivers_at(server.url)
        store.add_receiver(conn, info.map_id, receiver.name)
        write(conn, (1, "began"), (2, "began"), (1, "changed"), (3, "began"), (2, "ended"), (1, "ended"))
        for _ in range(10):
            deliver(conn, info, receiver)
        told = defaultdict(list)
        for message in server.taken:
            told[message["data"]["of"]].append(message["type"].split(".")[1])
        assert told == {1: ["began", "changed", "ended"], 2: ["began", "ended"], 3: ["began"]}
        assert len({message["id"] for message in server.taken}) == len(server.taken)
        assert len(server.seen) == len(server.taken) + 2
        assert not store.undelivered(conn)


def test_one_failure_among_several_receivers_needs_attention(conn, info, conetl, monkeypatch):
    monkeypatch.setattr(notices, "_FIRST_WAIT_S", 3600.0)
    with inbox() as whole, inbox(500) as broken:
        monkeypatch.setenv("CONETL_WEBHOOKS", f"{whole.url},{broken.url}")
        monkeypatch.setenv("CONETL_WEBHOOK_SECRET", SECRET)
        assert "1 new notice of map default; 1 delivered, 1 failed" in conetl("zones", "notify", code=1)


def test_a_receiver_that_restarts_gets_what_it_missed(conn, info):
    with inbox() as server:
        [receiver], port = receivers_at(server.url), server.server_port
        store.add_receiver(conn, info.map_id, receiver.name)
        write(conn, (1, "began"))
        assert deliver(conn, info, receiver) == (1, 0)
    write(conn, (1, "changed"), (2, "began"), *((n, "began") for n in range(3, 12)))
    assert deliver(conn, info, receiver) == (0, 3), "it is left alone after three failures"
    assert {row["attempts"] for row in store.undelivered(conn)} == {1}
    with inbox(port=port) as server:
        for _ in range(3):
            deliver(conn, info, receiver)
        assert [message["data"]["of"] for message in sorted(server.taken, key=lambda one: one["sequence"])] == [
            1,
            *range(2, 12),
        ]


def test_an_answer_that_is_not_recorded_is_told_again_with_the_same_id(conn, info, monkeypatch):
    """At least once: the process dies between the answer and its record."""
    with inbox() as server:
        [receiver] = receivers_at(server.url)
        store.add_receiver(conn, info.map_id, receiver.name)
        write(conn, (1, "began"))

        def die(*_, **__):
            raise KeyboardInterrupt

        with monkeypatch.context() as patch:
            patch.setattr(store, "write_delivery", die)
            with pytest.raises(KeyboardInterrupt):
                deliver(conn, info, receiver)
        assert deliver(conn, info, receiver) == (1, 0)
        assert len(server.taken) == 2
        assert server.taken[0]["id"] == server.taken[1]["id"]


def test_what_fails_for_days_is_given_up_listed_and_told_on_request(conn, info, conetl, monkeypatch):
    with inbox(*[500] * 5) as server:
        [receiver] = receivers_at(server.url)
        store.add_receiver(conn, info.map_id, receiver.name)
        write(conn, (1, "began"), (1, "ended"))
        deliver(conn, info, receiver)
        execute(conn, "update conetl.notice_delivery set first_at = first_at - interval '4 days'")
        conn.commit()
        monkeypatch.setattr(notices, "_FIRST_WAIT_S", 3600.0)
        deliver(conn, info, receiver)  # given up: the next one of the zone is sent, and fails
        rows = store.undelivered(conn)
        assert [(row["event"], row["given_up_at"] is not None) for row in rows] == [("began", True), ("ended", False)]
        listed = conetl("zones", "undelivered")
        assert "given up" in listed
        assert "500" in listed
        assert "hidden" not in listed
        assert "2 undelivered notices, 1 given up" in conetl("status", code=3)
        server.answers.clear()
        monkeypatch.setenv("CONETL_WEBHOOKS", server.url)
        monkeypatch.setenv("CONETL_WEBHOOK_SECRET", SECRET)
        conetl("zones", "notify", "--again")
        assert server.taken[0]["type"] == "work_zone.began"
        conn.rollback()
        waited = execute(conn, "select max(now() - first_at) < interval '1 day' as anew from conetl.notice_delivery")
        assert waited == [{"anew": True}], "the days of patience begin again"


def test_a_new_receiver_is_told_what_still_holds(conn, info):
    write(conn, (1, "began"), (2, "began"), (2, "changed"), (1, "ended"), (3, "began"), (3, "withdrawn"))
    told = []
    receiver = Receiver("new", lambda _, notice: told.append((notice.subject.subject_id.int, notice.event)))
    store.add_receiver(conn, info.map_id, receiver.name)
    write(conn, (2, "ended"))
    assert deliver(conn, info, receiver) == (1, 0)
    assert told == [(2, "ended")], "what changed since replaces it"
    other = Receiver("newer", receiver.send)
    write(conn, (4, "began"))
    store.add_receiver(conn, info.map_id, other.name)
    deliver(conn, info, other)
    assert told[1:] == [(4, "began")]


def test_only_one_process_tells_a_receiver(conn, info, database_url):
    from conetl.db.connection import connect

    write(conn, (1, "began"))
    calls = []

    def slow(_, notice):
        with connect(database_url) as other:
            calls.append(deliver(other, info, Receiver("one", lambda *_: calls.append("twice"))))

    store.add_receiver(conn, info.map_id, "one")
    write(conn, (2, "began"))
    deliver(conn, info, Receiver("one", slow))
    assert set(calls) == {(0, 0)}


def test_a_difference_from_a_plan_begins_and_ends(conn, conetl, tmp_path):
    merge(conn, survey(0))
    merge(conn, survey(1))
    conn.commit()
    far = {"type": "Feature", "geometry": {"type": "Point", "coordinates": [8.4, 49.0]}, "properties": {
        "id": "A", "start": "2020-01-01T00:00:00Z", "end": "2020-01-02T00:00:00Z"}}  # fmt: skip
    file = tmp_path / "permits.geojson"
    file.write_text(json.dumps({"type": "FeatureCollection", "features": [far]}))
    conetl("zones", "plan", "import", file)
    assert record_notices(conn, map_name="default") == 2
    rows = execute(conn, "select topic, event, state from conetl.notice order by topic")
    conn.rollback()
    assert [(row["topic"], row["event"]) for row in rows] == [("plan_difference", "began"), ("work_zone", "began")]
    assert rows[0]["state"]["kind"] == "found without permit"
    assert record_notices(conn, map_name="default") == 0
    row = rows[0]["state"]
    conetl("zones", "judge", row["difference_id"], "accepted", "--by", "Ann")
    assert record_notices(conn, map_name="default") == 1
    assert execute(conn, "select event from conetl.notice order by notice_no desc")[0]["event"] == "changed"
    conn.rollback()


@pytest.mark.parametrize("url", ["example.org/x", "ftp://example.org", "file:///etc/passwd", "http://"])
def test_an_address_that_is_none_is_refused(url):
    with pytest.raises(InputError, match="expected an address like https://example"):
        receivers_at(url)


def test_prefect_gets_an_event_once_and_a_failure_stops_no_flow(conn, database_url, prefect_here, prefect, caplog):
    from conetl.pipeline.database import MapDatabase
    from flows.notices import notify_map_receivers

    merge(conn, survey(0))
    conn.commit()
    logging.getLogger("flows.notices").addHandler(caplog.handler)  # Prefect keeps its messages from the root
    settings = Settings(home=prefect_here, database_url=database_url, webhooks="prefect")
    with MapDatabase(settings) as database:
        assert notify_map_receivers(settings, database) == (1, 1, 0)
        assert notify_map_receivers(settings, database) == (0, 0, 0)
        wrong = settings.model_copy(update={"webhooks": SecretStr("https://example.org")})
        assert notify_map_receivers(wrong, database) is None
        assert "CONETL_WEBHOOK_SECRET is not set" in caplog.text
    user, _, password = prefect["PREFECT_API_AUTH_STRING"].partition(":")

    def events():  # the server stores them a moment later
        return httpx.post(
            f"{prefect['PREFECT_API_URL']}/events/filter", json={"filter": {"event": {"prefix": ["conetl.work_zone"]}}},
            auth=(user, password), timeout=30, trust_env=False,
        ).json()["events"]  # fmt: skip

    command.until(events, "the event", 60, 0.5)
    [event] = events()
    assert event["event"] == "conetl.work_zone.began"
    assert event["payload"]["data"]["work_zone_id"] in event["resource"]["prefect.resource.id"]
