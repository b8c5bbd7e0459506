"""Showing a view to others in a real Chromium: the link, and the frame in a page of a host that the operator allows."""

from __future__ import annotations

import html
import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import pytest
from pydantic import SecretStr

from conetl.pipeline.settings import Settings
from conetl.web.decisions import Writer
from tests.browser.test_view import click_cone, open_view, settle
from tests.cases import cases
from tests.view_map import serving


@contextmanager
def pages_of_others() -> Iterator[tuple[str, dict[str, str]]]:
    """Another server; yields its origin, and what it answers by path."""
    pages: dict[str, str] = {}

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            found = pages.get(self.path)
            self.send_response(404 if found is None else 200)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.end_headers()
            self.wfile.write((found or "").encode())

        def log_message(self, *_: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}", pages
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


@pytest.fixture(scope="module")
def intranet() -> Iterator[tuple[str, dict[str, str]]]:
    with pages_of_others() as found:
        yield found


@pytest.fixture(scope="module")
def address(
    module_database_url: str, features: dict[str, str], intranet: tuple[str, dict[str, str]], tmp_path_factory: Any
) -> Iterator[str]:
    writer = Writer(
        SecretStr("a-token-that-nobody-guesses"), module_database_url, Settings(home=tmp_path_factory.mktemp("home"))
    )
    with serving(module_database_url, "default", writer=writer, embed_host=intranet[0]) as port:
        yield f"http://127.0.0.1:{port}/"


def framed(tab: Any, pages: dict[str, str], origin: str, code: str) -> Any:
    """The frame of this code in a page of the other server."""
    pages["/"] = f"<!doctype html><title>Roads</title><h1>Our roads</h1>{code}"
    tab.goto(f"{origin}/")
    return tab.frame_locator("iframe")


def test_a_link_is_copied_that_opens_the_same_view_and_the_code_of_a_frame(browser, address, features, intranet):
    origin, pages = intranet
    tab = browser.new_page(viewport={"width": 1280, "height": 800})
    open_view(tab, f"{address}#map=default&changeset=2")
    tab.evaluate("navigator.clipboard.writeText = (text) => { window.copied = text; return Promise.resolve(); }")
    tab.keyboard.press("+")
    click_cone(tab, features["comes"])
    tab.wait_for_selector(".panel h2")
    tab.click("#share")
    tab.wait_for_selector(".toast >> text=The link is copied")
    link = tab.evaluate("window.copied")
    assert f"feature={features['comes']}" in link and "cam=" in link and link == tab.url
    tab.click(".toast >> text=Copy code of a frame")
    tab.wait_for_selector(".toast >> text=The code of a frame is copied")
    code = tab.evaluate("window.copied")
    assert html.unescape(re.findall('src="([^"]+)"', code)[0]) == link.replace("#", "embed.html#")
    frame = framed(tab, pages, origin, code)
    frame.locator(f".panel h2:text-is('{features['comes'][:8]}')").wait_for()
    frame.locator("html[data-cones='4']").wait_for(state="attached")
    assert not frame.locator(".top").is_visible() and not frame.locator(".timeline").is_visible()
    assert not frame.locator(".decide-section").is_visible()  # though this server accepts decisions
    frame.locator("canvas[data-frames]").press("r")
    tab.wait_for_timeout(300)
    assert not frame.locator(".review-head").is_visible()
    assert frame.locator(".whole-link").is_visible()
    tab.close()


def test_no_other_host_and_no_other_page_is_framed(browser, address, intranet):
    tab = browser.new_page()
    allowed, pages = intranet
    with pages_of_others() as (other, theirs):
        for origin, answers, path in ((other, theirs, "embed.html"), (allowed, pages, "")):
            said: list[str] = []
            tab.on("console", lambda m, said=said: said.append(m.text))
            answers["/"] = f'<iframe src="{address}{path}#map=default"></iframe>'
            tab.goto(f"{origin}/")
            tab.wait_for_timeout(1_000)
            assert tab.frame_locator("iframe").locator("canvas").count() == 0, origin
            assert any("frame-ancestors" in text or "403" in text or "X-Frame-Options" in text for text in said), said
    tab.close()


@pytest.mark.parametrize("size", cases(((390, 844),), release=[((1280, 800),)]))
def test_sharing_help_and_theme_are_at_hand_on_every_screen(browser, address, size):
    tab = browser.new_page(viewport={"width": size[0], "height": size[1]})
    open_view(tab, address)
    for name in ("#share", "#theme", ".help-button"):
        if size[0] < 760 and not tab.locator(name).is_visible():
            tab.click("button.menu")
        box = tab.locator(name).bounding_box()
        assert box["x"] >= 0 and box["x"] + box["width"] <= size[0], name
    tab.click(".help-button")
    tab.wait_for_selector("dialog.help:modal >> text=Shortcuts")
    settle(tab)
    tab.close()
