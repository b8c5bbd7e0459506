"""Whether a Prefect server lets this process in: said before anything is asked of it."""

from __future__ import annotations

import base64
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer

import pytest

from conetl.model.errors import ServiceError
from conetl.pipeline.settings import prefect_auth_string
from conetl.services.prefect_api import require_access

SECRET = "desk:wide-open"
VARIABLE = "PREFECT_SERVER_API_AUTH_STRING"


class _Protected(BaseHTTPRequestHandler):
    """As Prefect's own server with PREFECT_SERVER_API_AUTH_STRING: all but /health wants the password."""

    def do_GET(self) -> None:
        wanted = f"Basic {base64.b64encode(SECRET.encode()).decode()}"
        self.send_response(200 if self.path == "/api/health" or self.headers["Authorization"] == wanted else 401)
        self.end_headers()

    def log_message(self, *_: object) -> None:
        """Tests say enough."""


@pytest.fixture
def api() -> Iterator[str]:
    with HTTPServer(("127.0.0.1", 0), _Protected) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}/api"
        server.shutdown()
        thread.join()


def test_the_right_password_is_let_in(api: str) -> None:
    require_access(api, SECRET, VARIABLE)


@pytest.mark.parametrize("auth", [None, "desk:guessed"])
def test_without_the_password_it_is_said_what_to_set(api: str, auth: str | None) -> None:
    with pytest.raises(ServiceError, match=f"set {VARIABLE}") as refusal:
        require_access(api, auth, VARIABLE)
    assert api in str(refusal.value)
    assert "guessed" not in str(refusal.value)


def test_the_password_of_the_own_server_serves_its_clients(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("PREFECT_API_AUTH_STRING", raising=False)
    monkeypatch.delenv("PREFECT_SERVER_API_AUTH_STRING", raising=False)
    assert prefect_auth_string() is None
    monkeypatch.setenv("PREFECT_API_AUTH_STRING", "desk:of-a-client")
    assert prefect_auth_string() == "desk:of-a-client"
    monkeypatch.setenv("PREFECT_SERVER_API_AUTH_STRING", SECRET)
    assert prefect_auth_string() == SECRET
