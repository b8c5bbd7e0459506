"""`conetl view` in a real Chromium: what a person sees and does. Skipped without a browser."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from conetl.db.map.map_store import read_current_features
from conetl.model.base import utc_from_ns
from tests.command import free_port, until
from tests.view_map import commit, cone, missed

ROOT = Path(__file__).resolve().parents[2]
#: As in web/src/kinds.ts; red, green, blue.
ADDED, MOVED, MISSED = (0x00, 0x2E, 0x9A), (0x82, 0x17, 0x73), (0x8A, 0x54, 0xE4)


def _is_up(url: str, server: subprocess.Popen[bytes]) -> bool:
    assert server.poll() is None, "conetl view stopped"
    with suppress(OSError):
        urllib.request.urlopen(url, timeout=1).close()
        return True
    return False


@pytest.fixture(scope="module")
def address(module_database_url: str, features: dict[str, str]) -> Iterator[str]:
    port = free_port()
    command = [sys.executable, "-m", "conetl", "view", "--port", str(port), "--no-login"]
    environment = {**os.environ, "CONETL_DATABASE_URL": module_database_url, "PYTHONPATH": f"{ROOT / 'src'}:{ROOT}"}
    with subprocess.Popen(command, env=environment, cwd=ROOT, stdout=subprocess.DEVNULL) as server:
        try:
            url = f"http://127.0.0.1:{port}/"
            until(lambda: _is_up(url, server), "conetl view", 180, 0.2)  # a busy machine imports slowly
            yield url
        finally:
            server.send_signal(signal.SIGINT)
            assert server.wait(15) == 0


def open_view(page: Any, address: str, hash_: str = "", cones: int = 4) -> None:
    """The changes of the latest drive, unless the address says otherwise."""
    url = address + hash_
    if "mode=" not in url and "changeset=" not in url:
        url += "&mode=drive" if "#" in url else "#mode=drive"
    page.goto(url)
    page.wait_for_selector(f'html[data-cones="{cones}"]', state="attached")
    page.wait_for_selector("canvas[data-frames]")
    settle(page)


def settle(page: Any) -> None:
    """Wait until nothing is drawn any more."""
    before = None
    while before != (now := page.get_attribute("canvas", "data-frames")):
        before = now
        page.wait_for_timeout(250)
        # A requested frame waits for the one that is still being drawn.
        page.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")


def screenshot(page: Any) -> np.ndarray:
    """(H, W, 3) red, green, blue of the scene alone, without labels."""
    page.wait_for_timeout(100)
    data = page.locator("main.view").screenshot()
    return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)[:, :, ::-1].astype(int)


def pixels_of(image: np.ndarray, colour: tuple[int, int, int]) -> int:
    return int((np.abs(image - colour).max(axis=2) <= 6).sum())


def legend_becomes(page: Any, entries: list[str]) -> None:
    """Wait for the legend's entries: a picture at rest may still wait for the server's answer."""
    from playwright.sync_api import expect

    expect(page.locator(".legend label")).to_have_text(entries, use_inner_text=True, timeout=30_000)


def click_cone(page: Any, feature_id: str) -> None:
    x, y = page.evaluate("id => window.conetlProject(id)", feature_id)
    page.click("canvas", position={"x": float(x), "y": float(y)})


def test_the_first_view_shows_each_kind(page, address):
    started = time.monotonic()
    page.goto(f"{address}#mode=drive")
    page.wait_for_selector('html[data-cones="4"]', state="attached")
    page.wait_for_selector("canvas[data-frames]")
    print(f"first view: {time.monotonic() - started:.1f} s (software GL)")
    settle(page)
    image = screenshot(page)
    assert pixels_of(image, ADDED) > 40
    assert pixels_of(image, MOVED) > 40
    legend_becomes(page, ["added 1", "moved 1", "removed 1", "confirmed 1"])
    assert page.locator(".label").inner_text() == "1.50 m"


@pytest.mark.release
def test_the_slider_changes_the_drive(page, address):
    open_view(page, address)
    second = screenshot(page)
    page.locator(".changeset-slider").press("ArrowLeft")
    page.wait_for_selector('html[data-cones="3"]', state="attached")
    settle(page)
    first = screenshot(page)
    said = page.locator(".drive-text").inner_text()
    assert "drive_1" in said and "UTC, as known then" in said
    assert pixels_of(first, MOVED) == 0 < pixels_of(second, MOVED)
    assert pixels_of(first, ADDED) > 2 * pixels_of(second, ADDED)  # all three are new in the first drive


def test_before_changes_after(page, address):
    open_view(page, address)
    page.click("text=Before")
    page.wait_for_selector("text=standing")
    settle(page)
    assert (pixels_of(screenshot(page), ADDED), pixels_of(screenshot(page), MOVED)) == (0, 0)
    page.click("button:text-is('After')")
    page.wait_for_selector(".legend >> text=added")
    settle(page)
    legend_becomes(page, ["added 1", "moved 1", "confirmed 1"])
    assert pixels_of(screenshot(page), ADDED) > 40


@pytest.mark.release
def test_compare_and_any_time(page, address, samples):
    open_view(page, address)
    page.click("text=Compare two")
    page.wait_for_selector(".form-line select")
    settle(page)
    page.wait_for_url("**from=1**")  # since the day before the last one
    settle(page)
    legend_becomes(page, ["added 1", "moved 1", "removed 1", "confirmed 1"])
    page.select_option(".form-line select >> nth=0", "0")
    page.wait_for_url("**from=0**")
    settle(page)
    legend_becomes(page, ["added 3"])  # against the empty map: what stands now
    page.select_option(".form-line select >> nth=0", "latest")
    page.wait_for_url("**from=2**")
    settle(page)
    legend_becomes(page, ["unchanged 3"])
    page.click("text=The road")
    page.wait_for_selector(".legend >> text=standing")
    known = page.locator(".instant-view label:has-text('As known') select")
    committed = f"{utc_from_ns(samples.START_NS):%Y-%m-%d} 12:00:00 UTC"
    assert known.locator("option").all_inner_texts()[:2] == ["now", f"at {committed} · after drive_1"]
    assert known.input_value() == "now"
    time_input = page.locator(".instant-view input[type=text]")
    time_input.fill(f"{utc_from_ns(samples.START_NS):%Y-%m-%d} 07:00:00")
    time_input.press("Enter")
    page.wait_for_selector('html[data-cones="0"]', state="attached")
    assert "No cones on the map at this time" in page.locator(".legend").inner_text()


def test_a_click_shows_history_and_images(page, address, features):
    open_view(page, address)
    click_cone(page, features["wanders"])
    page.wait_for_selector(".panel-images .pane img >> nth=1")
    panel = page.locator(".panel").inner_text()
    assert features["wanders"][:8] in panel
    assert "moved by 1.500 m" in panel and "HISTORY, AS KNOWN NOW" in panel.upper()
    assert "458006.500 E" in panel
    captions = page.locator(".panel-images figcaption").all_inner_texts()
    assert [text.split(" · ")[0] for text in captions] == ["before", "this drive"]
    sizes = page.eval_on_selector_all(".panel-images img", "all => all.map(i => [i.naturalWidth, i.naturalHeight])")
    assert len(sizes) == 2 and all(min(size) >= 300 for size in sizes)
    frame = int(page.get_attribute(".viewer", "data-frame").split()[-1])
    page.keyboard.press("n")
    page.wait_for_selector(f".viewer[data-frame$=' {frame + 1}']")
    page.keyboard.press("Escape")
    page.wait_for_selector(".panel", state="hidden")


def test_a_link_restores_the_view(page, address, features, browser):
    open_view(page, address)
    page.click("canvas", position={"x": 20, "y": 20})
    for key in ("-", "-", "+", "Shift+ArrowLeft", "ArrowRight"):
        page.keyboard.press(key)
    settle(page)
    click_cone(page, features["comes"])
    page.wait_for_selector(".panel-images .pane img")
    settle(page)
    page.mouse.move(5, 5)  # no tooltip, no focus ring
    page.evaluate("document.activeElement.blur()")
    page.wait_for_timeout(300)
    link = page.url
    assert re.search(r"feature=[0-9a-f-]{36}.*cam=", link)
    wanted = screenshot(page)
    again = browser.new_page(viewport={"width": 1280, "height": 800})
    again.goto(link)
    again.wait_for_selector(".panel-images .pane img")
    settle(again)
    assert (np.abs(screenshot(again) - wanted).max(axis=2) > 40).mean() < 0.002
    assert features["comes"][:8] in again.locator(".panel h2").inner_text()
    again.close()


@pytest.mark.release
def test_a_choice_is_in_the_address_before_the_next_thing_happens(page, address, features):
    """In the same turn of the page's own loop, whatever moved just before; what keeps moving is written when it rests."""
    open_view(page, address)
    click_cone(page, features["wanders"])
    assert f"feature={features['wanders']}" in page.evaluate("() => location.hash")
    page.wait_for_selector(".viewer[data-frame]")
    frame = int(page.get_attribute(".viewer", "data-frame").split()[-1])
    settle(page)
    press = "key => (window.dispatchEvent(new KeyboardEvent('keydown', { key })), location.hash)"
    assert "image=" not in page.evaluate("() => location.hash")
    page.keyboard.press("ArrowRight")  # moves the camera
    image = re.search(r"image=([0-9a-f-]{36})\.(\d+)", page.evaluate(press, "n"))
    assert image and int(image[2]) == frame + 1
    assert "feature=" not in page.evaluate(press, "Escape")
    page.wait_for_timeout(300)
    held = """() => {
      const written = new Set();
      for (let i = 0; i < 100; i++) {
        window.dispatchEvent(new KeyboardEvent("keydown", { key: "b", repeat: i > 0 }));
        written.add(location.hash);
      }
      return written.size;
    }"""
    # A busy machine may rest between two of them.
    assert page.evaluate(held) < 10, "browsers refuse an address that changes all the time"
    page.goto("about:blank")
    page.goto(f"{address}#map=default&side=before&feature={features['wanders']}&image={image[1]}.{frame + 1}")
    page.wait_for_selector(f".viewer[data-frame$=' {frame + 1}']")
    page.wait_for_selector(".legend >> text=standing")


def test_a_server_error_is_shown_and_can_be_retried(browser, address):
    tab = browser.new_page(viewport={"width": 1280, "height": 800})
    tab.route("**/events", lambda route: route.abort())  # else an event loads the map before the click
    tab.route("**/timeline", lambda route: route.fulfill(status=503, json={"detail": "The database is busy."}))
    tab.goto(f"{address}#mode=drive")
    tab.wait_for_selector(".card >> text=The database is busy.")
    tab.unroute("**/timeline")
    tab.click("text=Try again")
    tab.wait_for_selector('html[data-cones="4"]', state="attached")
    assert tab.locator(".card-host").is_hidden()
    tab.close()


def test_a_new_changeset_appears_without_a_reload(page, address, conn, samples, images, features):
    """Last in this file: it changes the map."""
    open_view(page, address)
    page.wait_for_selector(".status[data-status=live]")
    page.evaluate("window.notReloaded = true")
    at_ns = samples.START_NS + 2 * samples.DAY_NS + 7
    [stays] = [f for f in read_current_features(conn) if str(f.feature_id) == features["stays"]]
    late = cone(samples, "late", 12.0, day=2)
    commit(conn, samples, images, "3", 2, samples.added(late), missed(stays, at_ns, 0.8))
    committed = time.monotonic()
    page.wait_for_selector("text=drive_3 was saved: 1 added")
    page.wait_for_selector(".drive-text >> text=drive_3")
    print(f"from commit to view: {time.monotonic() - committed:.1f} s")
    assert page.evaluate("window.notReloaded") is True
    page.wait_for_selector(".legend label >> text=not observed")  # the changes come a request after the drive
    legend_becomes(page, ["added 1", "not observed 1", "not evaluated 2"])
    settle(page)
    assert pixels_of(screenshot(page), MISSED) > 40
    click_cone(page, features["stays"])
    page.wait_for_selector(".panel >> text=observed by 2 drives, not observed by 1 drive")
    said = page.locator(".history button").all_inner_texts()  # without line ends where the panel is being drawn
    begins = ["added · version 1", "confirmed · version 2", "not observed in 5 frame pairs"]
    assert [text[: len(begin)] for text, begin in zip(said, begins, strict=True)] == begins
    passed = "drive drive_3 passed, the position was visible in 5 frame pairs, none showed a cone"
    why = f"Not observed: {passed}; sure it stands: 80 %"
    assert page.locator(".panel .why").inner_text().startswith(why)


@pytest.mark.release
def test_high_contrast_shows_what_is_pressed_and_the_bars(page, address):
    """The system's high contrast gives all elements of a kind one background, unless a style says otherwise."""
    page.emulate_media(forced_colors="active")
    open_view(page, address)
    backgrounds = "(elements) => elements.map((e) => getComputedStyle(e).backgroundColor)"
    buttons = page.locator(".drive-line .segmented button")
    pressed = buttons.evaluate_all("(buttons) => buttons.map((b) => b.getAttribute('aria-pressed'))")
    colours = buttons.evaluate_all(backgrounds)
    assert sorted(pressed) == ["false", "false", "true"]
    assert len(set(colours)) == 2 and colours.count(colours[pressed.index("true")]) == 1
    bars = page.locator(".column.chosen .bars > *").evaluate_all(backgrounds)
    assert len(bars) == len(set(bars)) > 1, "each kind of change has its colour"
