"""The page never freezes, and never shows what it does not know: empty maps, waiting, stopped servers, expired logins."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import ExitStack, closing
from typing import Any

import pytest
from pydantic import SecretStr

from conetl.db.connection import connect
from tests.browser.test_view import click_cone, legend_becomes, open_view, settle
from tests.cases import cases
from tests.view_map import commit, cone, serving

TOKEN = "reader-of-the-tests"
MODES = ("instant", "drive", "compare")


@pytest.fixture
def tab(browser: Any) -> Iterator[Any]:
    """A page whose own script must not fail; refused requests are logged by the browser itself."""
    page = browser.new_page(viewport={"width": 1280, "height": 800})
    problems: list[str] = []
    page.on("pageerror", lambda e: problems.append(str(e)))
    yield page
    page.close()
    assert problems == []


@pytest.mark.release
@pytest.mark.parametrize("state", ["empty", "misspelt", "one drive"])
def test_a_drive_arrives_on_every_page(browser, database_url, samples, tmp_path, state):
    """The axis of time had no bounds without a drive, and its labels no end."""
    conn = connect(database_url)
    if state != "empty":
        commit(conn, samples, tmp_path, "1", 0, samples.added(cone(samples, "first", 0.0)))
    name = "defualt" if state == "misspelt" else "default"
    with closing(conn), serving(database_url, "default") as port, ExitStack() as tabs:
        pages = []
        for mode in MODES:
            page = browser.new_page(viewport={"width": 1280, "height": 800})
            tabs.callback(page.close)
            page.goto(f"http://127.0.0.1:{port}/#map={name}&mode={mode}")
            page.wait_for_selector(
                {"empty": ".card >> text=is empty", "misspelt": ".card >> text=There is no map “defualt”"}.get(
                    state, 'html[data-cones="1"]'
                ),
                state="attached",
            )
            pages.append(page)
        second = cone(samples, "second", 3.0, day=1)
        commit(conn, samples, tmp_path, "2", 1, samples.added(second), map_name=name)
        for page in pages:
            page.wait_for_selector(f'html[data-cones="{2 if state == "one drive" else 1}"]', state="attached")
            assert page.locator(".card-host").is_hidden()
            assert page.locator(".axis-scale span:visible, .form-line select:visible").count() > 0
            for press in ("Drive by drive", "Compare two", "The road"):
                page.click(f"text={press}", timeout=5_000)
            settle(page)


def test_the_road_now_comes_first_and_the_changes_of_a_drive_are_one_click(tab, address, features):
    tab.goto(address)
    tab.wait_for_selector('html[data-cones="3"]', state="attached")
    legend_becomes(tab, ["standing 3"])
    assert "mode=" not in tab.url
    tab.click(".instant-view button:text-is('drive_2')")
    tab.wait_for_selector('html[data-cones="4"]', state="attached")
    legend_becomes(tab, ["added 1", "moved 1", "removed 1", "confirmed 1"])
    tab.click("text=The road")
    tab.wait_for_selector('html[data-cones="3"]', state="attached")
    tab.click(".instant-view .chip[data-kind=moved]")
    tab.wait_for_selector("#list-changes .table[aria-rowcount='2']")


def test_what_is_not_counted_yet_is_unknown(tab, address):
    held: list[Any] = []
    tab.route("**/review?**", lambda route: held.append(route))  # noqa: PLW0108 -- Playwright marks the handler
    tab.goto(address)
    tab.wait_for_selector('html[data-cones="3"]', state="attached")
    assert tab.inner_text(".review-button .badge") == "…"
    assert "unknown" in tab.get_attribute(".review-button", "aria-label")
    tab.click(".review-button")
    assert tab.inner_text(".review-head h2").startswith("Loading")
    for route in held:
        route.continue_()
    tab.keyboard.press("Escape")
    tab.wait_for_selector(".review-button .badge[data-count]:not([data-count=''])")
    assert tab.inner_text(".review-button .badge").isdigit()


def test_a_tooltip_stays_at_its_cone_and_goes_with_it(tab, address, features):
    open_view(tab, address)
    x, y = tab.evaluate("id => window.conetlProject(id)", features["wanders"])
    tab.hover("canvas[data-engine]", position={"x": x, "y": y})
    tip = tab.locator(".tip")
    tip.wait_for()
    place = """id => {
      const [x, y] = window.conetlProject(id), view = document.querySelector('.view').getBoundingClientRect();
      const box = document.querySelector('.tip').getBoundingClientRect();
      return [box.left - view.left - x, box.top + box.height / 2 - view.top - y];
    }"""
    before = tab.evaluate(place, features["wanders"])
    for _ in range(3):
        tab.keyboard.press("ArrowUp")
    settle(tab)
    moved = tab.evaluate("id => window.conetlProject(id)", features["wanders"])
    assert abs(moved[1] - y) > 20
    assert tab.evaluate(place, features["wanders"]) == pytest.approx(before, abs=12)
    tab.uncheck("#kind-moved")
    tip.wait_for(state="hidden")


@pytest.mark.parametrize("size", cases(((390, 844),), release=[((1280, 800),), ((640, 400),)]))
def test_the_buttons_of_a_panel_are_on_the_screen(tab, address, features, size):
    """640 x 400 is the screen of 1280 x 800 at 200 %."""
    tab.set_viewport_size({"width": size[0], "height": size[1]})
    tab.goto(f"{address}#mode=drive&feature={features['wanders']}&list=changes")
    tab.wait_for_selector(".panel-images .pane img >> nth=0", state="attached")
    tab.evaluate(  # a pinned cone of a long kind
        "() => document.querySelector('.panel-title').append(...['pinned', 'height changed'].map((text) => {"
        "  const chip = document.createElement('span'); chip.className = 'chip'; chip.textContent = text; return chip; }))"
    )
    for button in (".panel > header > .close", ".list-head .close"):
        box, host = tab.locator(button).bounding_box(), tab.locator(button.split()[0]).bounding_box()
        assert host["x"] <= box["x"] and box["x"] + box["width"] <= min(host["x"] + host["width"], size[0]) + 1, button
        assert box["y"] >= 0 and box["y"] + box["height"] <= size[1], button
        tab.click(button, trial=True, timeout=2_000)


def test_a_stopped_server_keeps_the_picture_and_says_since_when(tab, module_database_url, features):
    with serving(module_database_url, "default") as port:
        open_view(tab, f"http://127.0.0.1:{port}/")
        tab.wait_for_selector(".status[data-status=live]")
    tab.wait_for_selector(".scene-notice >> text=/since .*\\d+:\\d\\d:\\d\\d.* as it was then/")
    tab.click("button:text-is('Before')")
    tab.wait_for_selector(".toast >> text=The map still shows what it showed before.")
    assert tab.locator(".card-host").is_hidden()
    assert tab.get_attribute("html", "data-cones") == "4"
    assert tab.get_attribute("button[data-value=changes]", "aria-pressed") == "true"
    assert "side=" not in tab.url
    with serving(module_database_url, "default", port=port):
        tab.wait_for_selector(".status[data-status=live]", timeout=20_000)
        tab.wait_for_selector(".scene-notice", state="hidden")


def test_an_expired_login_asks_again(tab, module_database_url, features):
    with serving(module_database_url, "default", reader_token=SecretStr(TOKEN)) as port:
        tab.goto(f"http://127.0.0.1:{port}/?token={TOKEN}#mode=drive")
        tab.wait_for_selector('html[data-cones="4"]', state="attached")
        tab.context.clear_cookies()
        click_cone(tab, features["wanders"])
        tab.fill(".login input[name=token]", "wrong")
        tab.keyboard.press("Enter")
        tab.wait_for_selector(".login >> text=This token is wrong.")
        tab.fill(".login input[name=token]", TOKEN)
        tab.keyboard.press("Enter")
        tab.wait_for_selector(".panel h2 >> text=" + features["wanders"][:8])
        tab.wait_for_selector(".login", state="hidden")
        assert not re.search(TOKEN, tab.url)
