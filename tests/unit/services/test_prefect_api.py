"""Access to a protected Prefect server, checked before it is used."""

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
    """Like Prefect's server with PREFECT_SERVER_API_AUTH_STRING: all but /health requires the password."""

    def do_GET(self) -> None:
        wanted = f"Basic {base64.b64encode(SECRET.encode()).decode()}"
        self.send_response(200 if self.path == "/api/health" or self.headers["Authorization"] == wanted else 401)
        self.end_headers()

    def log_message(self, *_: object) -> None: ...


@pytest.fixture
def api() -> Iterator[str]:
    with HTTPServer(("127.0.0.1", 0), _Protected) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}/api"
        server.shutdown()
        thread.join()


@pytest.mark.parametrize("auth", [None, "desk:guessed"])
def test_without_the_password_the_error_names_the_variable(api: str, auth: str | None) -> None:
    require_access(api, SECRET, VARIABLE)
    with pytest.raises(ServiceError, match=f"set {VARIABLE}") as refusal:
        require_access(api, auth, VARIABLE)
    assert api in str(refusal.value)
    assert "guessed" not in str(refusal.value)


def test_clients_use_the_password_of_the_own_server(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("PREFECT_API_AUTH_STRING", raising=False)
    monkeypatch.delenv("PREFECT_SERVER_API_AUTH_STRING", raising=False)
    assert prefect_auth_string() is None
    monkeypatch.setenv("PREFECT_API_AUTH_STRING", "desk:of-a-client")
    assert prefect_auth_string() == "desk:of-a-client"
    monkeypatch.setenv("PREFECT_SERVER_API_AUTH_STRING", SECRET)
    assert prefect_auth_string() == SECRET
