"""The review in images in a real Chromium: items by keys, what the server keeps, small screens, accessibility."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import SecretStr

from conetl.db.map.decision_store import list_decisions
from conetl.db.map.map_store import list_changesets
from conetl.files.people import add_person, people_of
from conetl.pipeline.settings import Settings
from conetl.reports.drive_page import write_drive_page
from conetl.web.decisions import Writer
from tests.browser.test_list_view import AXE
from tests.integration.drives_of_days import DAY_NS, merge, survey_of
from tests.synthetic.world import START_NS, Cone
from tests.view_map import serving, with_images

TOKEN = "a-token-that-nobody-guesses"
HOLD = "GNSS/INS jumps by 5.0 m."
SIZES = [(1280, 800), (390, 844), (640, 400)]  # the last is the first at 200 % zoom
#: Both sides of the road; the next day eight of them are gone, and three stand elsewhere.
GONE = 8
BEFORE = [Cone((13.0 + 2.4 * k, side, 0.0), height_m=0.7) for k in range(7) for side in (3.6, -3.9)]
AFTER = [Cone((x + 1.2, y * 1.2, z), height_m=0.7) for x, y, z in (c.foot_m for c in BEFORE[:3])] + BEFORE[3 + GONE :]


@pytest.fixture(scope="module")
def settings(tmp_path_factory: pytest.TempPathFactory) -> Settings:
    return Settings(home=tmp_path_factory.mktemp("home"))


@pytest.fixture(scope="module")
def address(module_database_url: str, conn: Any, images: Path, settings: Settings) -> Iterator[str]:
    for day, cones in enumerate((BEFORE, AFTER, AFTER)):
        first_ns = START_NS + day * DAY_NS
        found = survey_of(cones, np.random.default_rng(day), f"day_{day}", frames=20, start_m=0.0, first_ns=first_ns)
        found = found._replace(drive=with_images(found.drive, found.detections, images / f"day_{day}"))
        merge(conn, found, hold=HOLD if day == 2 else None)
    conn.commit()
    writer = Writer(SecretStr(TOKEN), module_database_url, settings)
    with serving(module_database_url, "default", writer=writer) as port:
        yield f"http://127.0.0.1:{port}/"


def open_review(page: Any, address: str, *, known: bool = True) -> int:
    """By a key; returns the number of items that wait."""
    page.goto(address)
    page.wait_for_selector(".review-button .badge[data-count]:not([data-count=''])", state="attached")
    page.wait_for_selector("canvas[data-frames]")
    if known:
        page.evaluate(
            "t => { sessionStorage['conetl writer token'] = t; sessionStorage['conetl name'] = 'Ada'; }", TOKEN
        )
    page.keyboard.press("r")
    wait_for_images(page)
    return int(page.get_attribute(".review-button .badge", "data-count"))


def wait_for_images(page: Any, other_than: str | None = None) -> str:
    """Until the images of another item are there; returns its key, the text of its row."""
    page.wait_for_function(
        """before => {
          const row = document.querySelector('.review-items [aria-current=true]');
          const images = [...document.querySelectorAll('.review-images .pane:not([hidden]) img')];
          const problems = document.querySelectorAll('.review-images .pane-problem:not([hidden])').length;
          return row && row.innerText.split('\\n')[0] !== before && (problems || images.length)
            && images.every((i) => i.complete) && !document.querySelector('.viewer.busy')
            && document.querySelector('.viewer').dataset.item === row.dataset.item;
        }""",
        arg=other_than,
    )
    return str(page.locator(".review-items [aria-current=true]").inner_text().split("\n")[0])


@pytest.mark.release
def test_it_opens_on_small_screens_and_without_axe_findings(browser, address):
    for width, height in SIZES:
        page = browser.new_page(viewport={"width": width, "height": height})
        open_review(page, address)
        for box in page.locator(".review-buttons button, .review-head button").evaluate_all(
            "all => all.map(b => b.getBoundingClientRect()).map(b => [b.left, b.top, b.right, b.bottom])"
        ):
            assert box[0] >= 0 and box[1] >= 0 and box[2] <= width and box[3] <= height, (width, box)
        images = page.locator(".review-images .panes").bounding_box()
        assert images["width"] * images["height"] > 0.25 * width * height, (width, images)
        assert page.locator(".view canvas[data-engine]").bounding_box()["width"] > 100, "the map is the inset"
        assert not page.evaluate("() => document.documentElement.scrollWidth > innerWidth")
        if AXE.exists():
            page.evaluate(AXE.read_text())  # by the debugger: the page's policy admits no other script
            found = page.evaluate("() => axe.run(document).then(r => r.violations.map(v => [v.id, v.nodes[0].html]))")
            assert found == [], width
        page.keyboard.press("Escape")
        page.wait_for_selector(".review-head", state="hidden")
        assert page.locator(".timeline").is_visible()
        page.close()


@pytest.mark.release
def test_what_is_skipped_stays_away_and_nothing_is_written_without_a_name(browser, address, conn):
    page = browser.new_page()  # it logs the refusal
    count = open_review(page, address, known=False)
    first = wait_for_images(page)
    page.keyboard.press("s")
    second = wait_for_images(page, first)
    page.reload()
    page.wait_for_selector(f".badge[data-count='{count - 1}']", state="attached")
    assert wait_for_images(page) == second, "the address keeps the review open"
    page.keyboard.press("a")
    page.wait_for_selector(".review-writer")
    page.keyboard.type("Ada")
    page.keyboard.press("Tab")
    page.keyboard.type("not-the-writers-token")
    page.keyboard.press("Enter")
    page.wait_for_selector(".review-writer .bad >> text=The writer token is missing or wrong")
    conn.rollback()
    assert [d for d in list_decisions(conn) if d.kind != "hold"] == []
    page.close()


@pytest.mark.release
def test_a_class_is_corrected_and_withdrawn_by_keys(page, address, conn):
    open_review(page, address)
    page.click(".review-items li:last-child button")  # moved
    wait_for_images(page)
    page.keyboard.press("c")
    page.keyboard.press(page.inner_text(".review-buttons button:has-text('Drum') kbd"))
    page.wait_for_selector(".review-items .saved:has-text('drum ✓')")
    conn.rollback()
    [made] = [d for d in list_decisions(conn) if d.kind != "hold"]
    assert (made.kind, made.category, made.decided_by) == ("classify", "drum", "Ada")
    page.click(".review-items .saved button")
    page.wait_for_selector(".review-buttons button:has-text('Withdraw')")
    page.keyboard.press("w")
    page.wait_for_selector(".review-items :is(.saved, .withdrawing)", state="detached")
    conn.rollback()
    assert [d.kind for d in list_decisions(conn)] == ["hold"]


def test_items_are_judged_by_at_most_three_keys_each(page, address, conn, settings):
    """It decides."""
    held = next(c for c in list_changesets(conn) if c.hold)
    report = settings.drive_report_path(held.drive_id, held.changeset_no)
    write_drive_page(conn, held, report, map_name="default")
    conn.rollback()
    keys = 1  # the one that opens it

    def press(key: str) -> None:
        nonlocal keys
        keys += 1
        page.keyboard.press(key)

    assert open_review(page, address) > GONE
    row = wait_for_images(page)
    assert HOLD in page.inner_text(".review-head .why")
    for number in range(GONE):
        if number == 5:  # twice by mistake: back, and taken back
            press("r")
            wait_for_images(page, row)
            press("b")
            page.wait_for_selector(".review-buttons button:has-text('Withdraw')")
            press("w")
            page.wait_for_selector(".review-buttons button:has-text('Accept')")
        press("r" if number == 7 else "a")
        row = wait_for_images(page, row)
        if number == 0:  # the accepted drive confirms what moved
            page.wait_for_selector(".review-items:not(:has-text('Moved by'))")
    page.wait_for_function("n => document.querySelectorAll('.review-items .saved').length === n", arg=GONE)
    assert keys <= 3 * GONE

    conn.rollback()
    made = [d for d in list_decisions(conn) if d.kind != "hold"]
    kinds = sorted(d.kind for d in made)
    assert kinds == ["accept", *["approve"] * (GONE - 2), "pin"]
    assert {(d.decided_by, d.note) for d in made} == {("Ada", "judged in the images")}
    assert [c.counts for c in list_changesets(conn) if c.drive_id == held.drive_id] == [True]
    assert "accepted by Ada" in report.read_text()
    page.keyboard.press("Escape")
    page.wait_for_selector(f".decisions .decision-row >> nth={GONE - 1}")
    page.reload()
    page.wait_for_selector(".badge[data-count='1']")


def test_a_person_who_is_logged_in_needs_no_token_and_sees_whole_images(
    browser, module_database_url, address, tmp_path
):
    token = add_person(tmp_path, "Ada Mayer", "review").get_secret_value()
    shared = SecretStr("the-token-of-the-view-itself")
    writer = Writer(SecretStr(TOKEN), module_database_url, Settings(home=tmp_path))
    with serving(
        module_database_url, "default", writer=writer, reader_token=shared, find_person=people_of(tmp_path)
    ) as port:
        # By the dialog of the browser, which sends the token as a password, as those who open the address without one.
        page = browser.new_page(
            viewport={"width": 1280, "height": 800}, http_credentials={"username": "ada", "password": token}
        )
        other = browser.new_page()
        other.goto(f"http://127.0.0.1:{port}/?token={shared.get_secret_value()}")
        other.wait_for_selector(".status[data-status=live]")
        page.goto(f"http://127.0.0.1:{port}/#list=review")
        wait_for_images(page)
        assert page.inner_text(".review-progress") and token not in page.url
        page.click(".review-items button:has(.mono) >> nth=0")
        wait_for_images(page)
        page.keyboard.press("i")
        page.wait_for_selector(".viewer:modal figcaption:text-is('right')")
        assert "pixelated" not in page.inner_text(".viewer-text")
        page.keyboard.press("Escape")
        page.keyboard.press("n")
        page.keyboard.type("a shadow")
        page.keyboard.press("Enter")
        page.keyboard.press("a")
        page.wait_for_selector(".review-items .saved")
        page.keyboard.press("Escape")
        assert page.inner_text(".who") == "Ada Mayer"
        for tab in (page, other):
            tab.wait_for_selector(".decisions .decision >> text=by Ada Mayer: a shadow", timeout=10_000)
            tab.close()
