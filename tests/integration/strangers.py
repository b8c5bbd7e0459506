"""What strangers try on the services of `conetl up`: other users, other origins, forged hosts, callers of Prefect's API."""

from __future__ import annotations

import os
import re
import socket
import subprocess
import threading
from contextlib import suppress
from pathlib import Path

import httpx

from tests.chromium import chromium

OPEN = ("services.json", "services.lock", "start.lock", "postgres.location")
WORD = "s3cr3t-of-the-desk"
AUTH = f"desk:{WORD}"


def prefect_refuses_strangers(api: str) -> None:
    """Without login, from another origin, by another name; and what a caller with the login may not choose."""
    with httpx.Client(base_url=api, trust_env=False, timeout=60) as client:
        paths = client.get(f"{api.removesuffix('/api')}/openapi.json", auth=tuple(AUTH.split(":"))).json()["paths"]
        found = {path for path, methods in paths.items() for method in methods if answers(client, method, path)}
        assert len(paths) > 100
        assert found <= {"/health", "/ready"}
        preflight = {"Origin": "https://elsewhere.example", "Access-Control-Request-Method": "POST"}
        answer = client.options("/deployments/filter", headers=preflight)
        assert answer.status_code == 400
        assert "access-control-allow-origin" not in answer.headers
        forged = client.get("/health", headers={"Host": "elsewhere.example"})
        assert (forged.status_code, forged.text) == (400, "Invalid host header")

        client.auth = httpx.BasicAuth(*AUTH.split(":"))
        deployment = client.get("/deployments/name/audit/audit").json()["id"]
        for variables in ({"command": "id"}, {"env": {"PATH": "."}}, {"working_dir": "/tmp"}):
            body = {"job_variables": variables}
            assert client.post(f"/deployments/{deployment}/create_flow_run", json=body).status_code == 422
        drive = client.get("/deployments/name/ingest-drive/ingest-drive").json()
        assert drive["enforce_parameter_schema"] and "params" in drive["parameter_openapi_schema"]["properties"]
        for parameters in (
            {"drive": 3}, {"map_name": "a"}, {"drive": "/", "map_name": "../x"}, {"drive": "/", "map_srid": -1},
            {"drive": "/", "params": {"model": "x"}},
        ):  # fmt: skip
            body = {"parameters": parameters}
            assert client.post(f"/deployments/{drive['id']}/create_flow_run", json=body).status_code in (409, 422)


def answers(client: httpx.Client, method: str, path: str) -> bool:
    """Whether a route gives anything to a caller without login."""
    filled = re.sub(r"\{[^}]*\}", "00000000-0000-0000-0000-000000000000", path)
    return client.request(method, filled, json={}).status_code != httpx.codes.UNAUTHORIZED


def view_refuses_strangers(view: str, token: str) -> None:
    with httpx.Client(base_url=view, trust_env=False, timeout=60) as client:
        paths = client.get("/api/openapi.json", auth=("anybody", token)).json()["paths"]
        for path in ("/", "/assets/index.js", "/ogc/", "/ogc/collections", *paths):
            refused = client.get(path, headers={"Authorization": "Bearer guessed"})
            assert refused.status_code == 401, path
            assert "Log in" in refused.json()["detail"]
        assert client.get("/?token=guessed").status_code == 401
        assert client.get("/api/maps", headers={"Host": "elsewhere.example"}, auth=("", token)).status_code == 400
        assert client.get("/api/maps", headers={"Authorization": f"Bearer {token}"}).status_code == 200
        login = client.get("/", params={"token": token, "x": "1"})
        assert (login.status_code, login.headers["location"]) == (303, f"{view}/?x=1")
        cookie = login.headers["set-cookie"].lower()
        assert "httponly" in cookie and "samesite=lax" in cookie
        assert client.get("/api/maps").status_code == 200  # by the cookie
        assert client.get("/", params={"token": token}).headers["location"] == f"{view}/"  # no link contains the token


def nobody_reads(home: Path) -> None:
    """Another user of the machine lists and opens nothing below the home folder, and connects to no database."""
    if os.geteuid() != 0:
        return
    # Names and process ids of services are no secret: everybody lists processes.
    files = [
        path for path in home.rglob("*") if path.is_file() and path.name not in OPEN and path.parent != home / "tmp"
    ]
    sockets = [path for path in home.rglob(".s.PGSQL.*") if path.is_socket()]
    assert files and sockets
    script = 'for f; do if [ -r "$f" ] || [ -w "$f" ]; then echo "$f"; fi; done'
    done = subprocess.run(
        ["sh", "-c", script, "sh", *map(str, (*files, *sockets))], user="nobody", group="nogroup", extra_groups=[],
        capture_output=True, text=True, check=False, cwd="/",
    )  # fmt: skip
    assert (done.returncode, done.stdout) == (0, ""), done.stderr[-2000:]


def pages_of_other_origins_learn_nothing(*urls: str) -> None:
    """A page of another origin in Chromium: no answer can be read, with or without CORS."""
    fetch = """async ([url, mode]) => {
        try { const r = await fetch(url, {mode, credentials: 'include'}); return r.type + (await r.text()) }
        catch (error) { return 'refused' }
    }"""
    with socket.create_server(("127.0.0.1", 0)) as other, chromium() as browser:
        page_of(other)
        page = browser.new_page()
        page.goto(f"http://localhost:{other.getsockname()[1]}/")
        for url in urls:
            assert page.evaluate(fetch, [url, "cors"]) == "refused"
            assert page.evaluate(fetch, [url, "no-cors"]) in ("refused", "opaque")


def page_of(listener: socket.socket) -> None:
    """Serve an empty page to whoever connects, until the socket is closed."""

    def serve() -> None:
        with suppress(OSError):
            while True:
                caller, _ = listener.accept()
                with caller:
                    caller.recv(65536)
                    caller.sendall(b"HTTP/1.1 200 OK\r\nContent-Type: text/html\r\nContent-Length: 0\r\n\r\n")

    threading.Thread(target=serve, daemon=True).start()


def files_with(folder: Path, word: str) -> list[Path]:
    """Files that hold a word; what vanishes in between does not count."""
    found = []
    for path in folder.rglob("*"):
        try:
            if path.is_file() and word.encode() in path.read_bytes():
                found.append(path)
        except FileNotFoundError:
            continue
    return found


def arguments_with(word: str) -> list[int]:
    """Living processes that show a word to whoever lists them."""
    found = []
    for entry in Path("/proc").iterdir():
        try:
            if entry.name.isdigit() and word.encode() in (entry / "cmdline").read_bytes():
                found.append(int(entry.name))
        except OSError:
            continue
    return found
