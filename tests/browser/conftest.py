"""Fixtures of the tests in a real Chromium, which are skipped without one."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.chromium import chromium
from tests.view_map import serving, two_drives


@pytest.fixture(scope="module")
def conn(module_conn: Any) -> Any:
    return module_conn


@pytest.fixture(scope="module")
def images(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("images")


@pytest.fixture(scope="module")
def features(conn: Any, samples: Any, images: Path) -> dict[str, str]:
    return {name: str(f.feature_id) for name, f in two_drives(conn, samples, images).items()}


@pytest.fixture(scope="module")
def address(module_database_url: str, features: dict[str, str]) -> Iterator[str]:
    """The application in this process; `test_view.py` starts the command itself."""
    with serving(module_database_url, "default") as port:
        yield f"http://127.0.0.1:{port}/"


@pytest.fixture(scope="package")
def browser() -> Iterator[Any]:
    with chromium() as found:
        yield found


@contextmanager
def page_without_problems(browser: Any, address: str) -> Iterator[Any]:
    """A page that must log no error and contact no other server."""
    tab = browser.new_page(viewport={"width": 1280, "height": 800})
    problems: list[str] = []
    own = (address, f"blob:{address}", "data:")
    tab.on("console", lambda m: problems.append(m.text) if m.type == "error" else None)
    tab.on("pageerror", lambda e: problems.append(str(e)))
    tab.on("request", lambda r: None if r.url.startswith(own) else problems.append(f"requested {r.url}"))
    yield tab
    tab.close()
    assert problems == []


@pytest.fixture
def page(browser: Any, address: str) -> Iterator[Any]:
    with page_without_problems(browser, address) as tab:
        yield tab
