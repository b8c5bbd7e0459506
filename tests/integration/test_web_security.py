"""`conetl view` under attack: fuzzed by its own API definitions, overloaded, and called by other web pages."""

from __future__ import annotations

import asyncio
import http.client
import json
import os
import resource
from contextlib import closing
from urllib.parse import quote

import pytest
import schemathesis
from hypothesis import HealthCheck, given, settings
from pydantic import SecretStr
from schemathesis import GenerationMode
from schemathesis.checks import CHECKS

from conetl.db.connection import execute
from conetl.web.decisions import Writer
from conetl.web.live import MAX_STREAMS
from conetl.web.security import MAX_URL_BYTES
from tests.view_map import serving, two_drives

MAP = "/api/maps/default"
ITEMS = "/ogc/collections/default.features/items"
KNOWN = {"map_name": "default", "collectionId": "default.features", "tileMatrixSetId": "WebMercatorQuad"}
TOKEN = SecretStr("a token of this test, long enough")
LOGIN = {"Authorization": f"Bearer {TOKEN.get_secret_value()}"}
POLICY = "default-src 'none'"


@pytest.fixture(scope="module")
def server(module_conn, module_database_url, samples, tmp_path_factory):
    """Port of a server over a small map; the tests leave the map as it was."""
    two_drives(module_conn, samples, tmp_path_factory.mktemp("images"))
    count = "select (select count(*) from conetl.delta) + (select count(*) from conetl.feature_version) as rows"
    before = execute(module_conn, count)
    module_conn.commit()
    with serving(module_database_url, "default") as port:
        yield port
    assert execute(module_conn, count) == before


def ask(port, target, method="GET", **headers):
    """One unmodified request; status, headers in lower case, body."""
    with closing(http.client.HTTPConnection("127.0.0.1", port, timeout=60)) as conn:
        conn.putrequest(method, target, skip_host="Host" in headers)
        for name, value in headers.items():
            conn.putheader(name.replace("_", "-"), value)
        conn.endheaders()
        answer = conn.getresponse()
        return answer.status, {name.lower(): value for name, value in answer.getheaders()}, answer.read()


@pytest.fixture(scope="module")
def closed_server(server, module_database_url):
    """Port of a server that requires a login, for reading and for decisions."""
    writer = Writer(TOKEN, module_database_url)
    with serving(module_database_url, "default", writer=writer, reader_token=TOKEN) as port:
        yield port


@pytest.mark.parametrize(("definition", "base"), [("/api/openapi.json", ""), ("/ogc/api", "/ogc")])
def test_no_request_of_the_api_definition_breaks_the_server(server, closed_server, definition, base):
    status, _, body = ask(server, definition)
    assert status == 200
    document = json.loads(body)
    document.pop("servers", None)
    schema = schemathesis.openapi.from_dict(document)
    checks = [
        CHECKS.get_one(name)
        for name in ("not_a_server_error", "status_code_conformance", "response_schema_conformance")
    ]
    fuzzed = 0
    for found in schema.exclude(path_regex="/events$").get_all_operations():
        operation = found.ok()
        known = {p.name: KNOWN[p.name] for p in operation.path_parameters if p.name in KNOWN}

        @settings(
            max_examples=1, derandomize=True, database=None, deadline=None, suppress_health_check=list(HealthCheck)
        )
        @given(
            case=operation.as_strategy()
            | operation.as_strategy(path_parameters=known or None)
            | operation.as_strategy(generation_mode=GenerationMode.NEGATIVE)
        )
        def fuzz(case):
            answer = case.call(base_url=f"http://127.0.0.1:{server}{base}", timeout=60)
            case.validate_response(answer, checks=checks)
            assert POLICY in answer.headers["content-security-policy"][0]
            answer = case.call(base_url=f"http://127.0.0.1:{closed_server}{base}", headers=LOGIN, timeout=60)
            case.validate_response(answer, checks=checks)
            stranger = case.call(base_url=f"http://127.0.0.1:{closed_server}{base}", timeout=60)
            assert 400 <= stranger.status_code < 500

        fuzz()
        fuzzed += 1
    assert fuzzed > 8


SQL = [
    "'", "' or 1=1 --", "'; drop table conetl.map; --", '"', "$1", "\\", "1; select pg_sleep(9)", "%", "{}", "ä", "0x00",
    "null", "NaN",
]  # fmt: skip
PARAMETERS = {
    ITEMS: [
        "at", "known_at", "from", "to", "bbox", "datetime", "ids", "properties", "sortby", "category", "version", "easting_m",
        "valid_from", "feature_id", "limit", "offset", "f", "filter",
    ],
    "/ogc/collections": ["bbox", "datetime", "limit", "offset"],
    "/ogc/collections/default.features/tiles/WebMercatorQuad/0/0/0": ["ids", "sortby", "properties", "category", "limit"],
    f"{MAP}/tiles/0/0/5": ["valid_at", "known_at"],
    f"{MAP}/summary": ["valid_at", "known_at"],
    f"{MAP}/changes": ["from_valid_at", "to_known_at", "changeset_no", "sort", "after", "offset", "limit", "kinds", "area"],
    f"{MAP}/features": ["valid_at", "sort", "after", "hidden_classes", "least_existence", "seen_before", "of_changeset", "area"],
    f"{MAP}/features/count": ["feature", "sort"],
    f"{MAP}/changes/view": ["cell_zoom", "area"],
    f"{MAP}/search": ["text"],
    f"{MAP}/downloads/csv": ["valid_at", "box"],
}  # fmt: skip


@pytest.mark.parametrize("path", PARAMETERS)
def test_sql_in_every_parameter_is_a_value_or_refused(server, path):
    for name in PARAMETERS[path]:
        for text in SQL:
            status, _, body = ask(server, f"{path}?{name}={quote(text)}")
            assert status in (200, 400, 404, 422), (name, text, body)
            if path == ITEMS and status == 200 and name in ("category", "ids"):
                assert json.loads(body)["numberMatched"] == 0, (name, text)
            assert b"syntax error" not in body


@pytest.mark.parametrize(
    "path",
    [
        "/../../etc/passwd", "/%2e%2e/%2e%2e/etc/passwd", "/assets/..%2f..%2f..%2fapp.py", "/assets/..%5c..%5capp.py",
        "//etc/passwd",
        "/ogc/../../etc/passwd", "/ogc/..%2f..%2fetc%2fpasswd", "/ogc/collections/..%2f..%2f..%2fetc%2fpasswd", "/%00",
        f"{MAP}/drives/..%2f..%2fetc/trajectory",
        "/ogc/tileMatrixSets/..%2f..%2fetc%2fpasswd", "/file:///etc/passwd",
    ],
)  # fmt: skip
def test_no_path_leads_out(server, path):
    status, headers, body = ask(server, path)
    assert status in (400, 404, 422), (status, body[:200])
    assert b"root:" not in body
    assert POLICY in headers["content-security-policy"]


def test_requests_of_other_web_pages_are_refused(server):
    own = f"127.0.0.1:{server}"
    for path in (f"{MAP}/features", f"{MAP}/events", ITEMS, "/ogc/", "/"):
        for headers in (
            {"Origin": "https://evil.example"}, {"Origin": "null"}, {"Origin": "http://127.0.0.1:1"},
            {"Origin": f"http://{own}.evil.example"},
            {"Sec_Fetch_Site": "cross-site", "Sec_Fetch_Mode": "cors"},
            {"Sec_Fetch_Site": "cross-site", "Sec_Fetch_Mode": "no-cors"},
            {"Sec_Fetch_Site": "same-site", "Sec_Fetch_Mode": "cors"},
            {"Sec_Fetch_Site": "cross-site", "Sec_Fetch_Mode": "navigate", "Sec_Fetch_Dest": "iframe"},
        ):  # fmt: skip
            status, answer, _ = ask(server, path, **headers)
            assert status == 403, (path, headers)
            assert "access-control-allow-origin" not in answer
        assert ask(server, path, Host="evil.example")[0] == 400  # a name that was rebound to this machine
    assert ask(server, "/api/maps", Origin=f"http://{own}", Sec_Fetch_Site="same-origin")[0] == 200
    link = {"Sec_Fetch_Site": "cross-site", "Sec_Fetch_Mode": "navigate", "Sec_Fetch_Dest": "document"}
    assert ask(server, "/", **link)[0] == 200


@pytest.mark.parametrize("target", ["/", f"/?token={TOKEN.get_secret_value().replace(' ', '%20')}", f"{MAP}/features"])
def test_another_host_name_is_refused_before_the_login(closed_server, target):
    status, headers, _ = ask(closed_server, target, Host="evil.example", **LOGIN)
    assert status == 400 and "location" not in headers and "set-cookie" not in headers
    assert POLICY in headers["content-security-policy"]


def test_one_page_may_be_framed_by_the_host_that_the_operator_names(module_database_url, server):
    frame = {"Sec_Fetch_Site": "cross-site", "Sec_Fetch_Mode": "navigate", "Sec_Fetch_Dest": "iframe"}
    host = "https://intranet.example"
    with serving(module_database_url, "default", embed_host=host) as port:
        status, headers, _ = ask(port, "/embed.html", **frame)
        assert status == 200 and "x-frame-options" not in headers
        assert f"frame-ancestors {host}" in headers["content-security-policy"]
        assert ask(port, "/embed.html", Sec_Fetch_Site="cross-site", Sec_Fetch_Mode="cors")[0] == 403
        for path in ("/", "/index.html", "/api/maps", ITEMS, "/embed.html/"):
            status, headers, _ = ask(port, path, **frame)
            assert status == 403 and headers["x-frame-options"] == "DENY", path
            assert "frame-ancestors 'none'" in ask(port, path)[1]["content-security-policy"]
    with serving(module_database_url, "default", embed_host=host, reader_token=TOKEN) as port:
        assert ask(port, "/embed.html", **frame)[0] == 401
    assert ask(server, "/embed.html", **frame)[0] == 403 and ask(server, "/embed.html")[0] == 404


def test_nothing_can_be_written(server):
    for method in ("POST", "PUT", "PATCH", "DELETE", "OPTIONS", "TRACE", "CONNECT", "PROPFIND"):
        for path in (f"{MAP}/features", "/api/maps", ITEMS, "/ogc/collections/default.features", "/ogc/", "/"):
            status, headers, _ = ask(server, path, method)
            assert status in (400, 405), (method, path)
            assert "access-control-allow-methods" not in headers


def test_head_answers_as_get_without_a_body(server):
    for path, wanted in ((ITEMS, 200), (f"{ITEMS}?nope=1", 400)):
        status, headers, body = ask(server, path, "HEAD")
        assert (status, body) == (wanted, ask(server, path)[2][:0])
        assert headers["content-type"] == ask(server, path)[1]["content-type"]


def test_extreme_requests(server):
    for path in (f"{MAP}/summary?valid_at=", f"{ITEMS}?ids=", f"{ITEMS}?bbox="):
        assert ask(server, path + "1," * MAX_URL_BYTES)[0] in (400, 414)
    assert ask(server, f"{ITEMS}?" + "&".join(["at=2026-03-01"] * 500))[0] == 400
    assert ask(server, f"{ITEMS}?ids=" + ",".join(["00000000-0000-4000-8000-000000000000"] * 150))[0] == 200
    assert ask(server, f"{ITEMS}?sortby=" + ",".join(["version"] * 900))[0] == 200
    for box in ("-180,-90,180,90", "-1e308,-1e308,1e308,1e308", "-180,-90,-180,-90", "180,-90,-180,90", "8,49,8,49"):
        status, _, body = ask(server, f"{ITEMS}?bbox={box}&limit=10000")
        assert status in (200, 400), body
    assert ask(server, f"{ITEMS}?offset=2147483647")[0] == 200
    assert ask(server, "/api/maps")[0] == 200


def test_headers_of_every_answer(server):
    for path in (
        "/", "/api/maps", "/api/no-such", "/ogc", "/ogc/", ITEMS, f"{ITEMS}?limit=0", "/ogc/no-such",
        f"{MAP}/search?text=x", "/x" * 5000,
    ):  # fmt: skip
        _, headers, _ = ask(server, path)
        policy = headers["content-security-policy"]
        assert POLICY in policy and "unsafe" not in policy, path
        assert (headers["x-content-type-options"], headers["x-frame-options"]) == ("nosniff", "DENY"), path
        assert headers["cross-origin-resource-policy"] == "same-origin"


def test_thousands_of_streams_are_refused_and_the_server_keeps_running(server):
    """CONETL_STREAMS=10000 opens that many."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    count = int(os.environ.get("CONETL_STREAMS", "1000"))

    async def crowd():
        said = {}
        held = []
        answered = []

        async def one():
            reader, writer = await asyncio.open_connection("127.0.0.1", server)
            writer.write(f"GET {MAP}/events HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".encode())
            status = (await asyncio.wait_for(reader.readline(), 120)).split()[1].decode()
            if status == "200":  # opened at the same moment: the surplus ones get an event and end
                await asyncio.wait_for(reader.readuntil(b"event: "), 120)
                status = (await reader.readline()).decode().strip()
            said[status] = said.get(status, 0) + 1
            held.append(writer)

        await asyncio.gather(*(one() for _ in range(100)))
        answered.append((await asyncio.to_thread(ask, server, f"{MAP}/summary"))[0])  # with all streams taken
        for start in range(100, count, 500):
            await asyncio.gather(*(one() for _ in range(min(500, count - start))))
        answered.append((await asyncio.to_thread(ask, server, f"{MAP}/summary"))[0])
        for writer in held:
            writer.close()
        return said, answered

    try:
        said, answered = asyncio.run(crowd())
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    print(f"{count} streams: {said}")
    assert sum(said.values()) == count
    assert said["changeset"] == MAX_STREAMS
    assert set(said) <= {"changeset", "trouble", "503"}
    assert answered == [200, 200]
