"""What people come to the page for: ten tasks, each in at most four interactions, on a desk's screen, a wide one and a phone.

A click, a choice in a list, a text that is typed with its Enter, and a look with the pointer count as one each.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from pydantic import SecretStr

from conetl.db.map.map_store import list_changesets
from conetl.pipeline.settings import Settings
from conetl.web.decisions import Writer
from tests.browser.conftest import page_without_problems
from tests.browser.test_judge_view import TOKEN, merge_days
from tests.cases import cases
from tests.view_map import serving

MOST = 4
SIZES = {"desk": (1280, 800), "wide": (1720, 900), "phone": (390, 844)}


@pytest.fixture(scope="module", params=cases("desk", release=["wide", "phone"]))
def size(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="module")
def address(module_database_url: str, conn: Any, images: Path, tmp_path_factory: Any, size: str) -> Iterator[str]:
    """A map of its own for each size."""
    merge_days(conn, images, size)
    writer = Writer(SecretStr(TOKEN), module_database_url, Settings(home=tmp_path_factory.mktemp("home")))
    with serving(module_database_url, size, writer=writer) as port:
        yield f"http://127.0.0.1:{port}/"


@pytest.fixture(scope="module")
def page(browser: Any, address: str) -> Iterator[Any]:
    """One tab for all tasks; each loads the page."""
    with page_without_problems(browser, address) as tab:
        yield tab


class Hand:
    """A person at the page, whose interactions are counted."""

    def __init__(self, page: Any) -> None:
        self.page, self.count = page, 0

    def click(self, selector: str) -> None:
        self.count += 1
        self.page.click(selector)

    def click_cone(self, feature_id: str) -> None:
        self.count += 1
        x, y = self.page.evaluate("id => window.conetlProject(id)", feature_id)
        self.page.click("canvas[data-engine]", position={"x": x, "y": y})

    def write(self, selector: str, text: str) -> None:
        self.count += 1
        self.page.fill(selector, text)
        self.page.press(selector, "Enter")

    def choose(self, selector: str, value: str) -> None:
        self.count += 1
        self.page.select_option(selector, value)

    def find(self, feature_id: str) -> None:
        self.click("#search")
        self.write("#search", feature_id[:8])
        self.page.wait_for_selector(f".panel h2:text-is('{feature_id[:8]}')")


@pytest.fixture(scope="module")
def changed(address: str, browser: Any, size: str) -> dict[str, list[str]]:
    """Ids of features by what the second drive did to them."""
    tab = browser.new_page()
    tab.goto(f"{address}api/maps/{size}/changes/view?changeset_no=2")
    found: dict[str, list[str]] = {}
    for kind, feature_id in tab.evaluate(
        "() => JSON.parse(document.body.innerText).changes.map(c => [c.kind, c.feature_id])"
    ):
        found.setdefault(kind, []).append(feature_id)
    tab.close()
    return found


@pytest.fixture
def task(page: Any, address: str, size: str) -> Callable[..., Any]:
    """Open the page, hand it over, and count."""
    width, height = SIZES[size]
    page.set_viewport_size({"width": width, "height": height})

    @contextmanager
    def begin(state: str = "") -> Iterator[Hand]:
        page.goto("about:blank")
        page.goto(f"{address}#map={size}{state}")
        page.wait_for_selector("html[data-cones]", state="attached")
        page.wait_for_function("() => document.querySelector('canvas[data-engine]').dataset.loading === '0'")
        hand = Hand(page)
        yield hand
        assert hand.count <= MOST
        assert page.evaluate("document.scrollingElement.scrollWidth") <= width

    return begin


def test_1_the_cone_that_moved_most(task, changed, size):
    with task() as hand:
        hand.click("text=Drive by drive")
        if size != "phone":  # where the page opens with the newest drive, which is on hold
            hand.click(".column[data-changeset='2']")
        else:
            hand.click(".timeline button.step:not([disabled]) >> nth=0")
        hand.click(".drive-text .chip[data-kind=moved]")
        hand.click("#list-changes .row[data-index='0']")
        hand.page.wait_for_selector(f".panel h2:text-is('{changed['moved'][0][:8]}')")
        assert hand.page.locator(".panel .why").inner_text().startswith("Moved: ")


def test_2_why_a_cone_went(task, changed):
    with task("&changeset=2") as hand:
        hand.find(changed["removed"][0])
        hand.page.wait_for_selector(".panel .why:has-text('Removed: drive')")
        assert re.search(r"visible in \d+ frame pairs, none showed a cone", hand.page.inner_text(".panel .why"))


def test_3_the_width_between_cones(task, changed):
    with task("&changeset=2&view=plan") as hand:
        stays = changed["confirmed"]
        hand.click("button:text-is('Measure')")
        for feature_id in (stays[0], stays[1], stays[-1]):
            hand.click_cone(feature_id)
        row = hand.page.locator(".measure .row:has-text('Last point to line 1–2')")
        row.locator("text=±").wait_for()


def test_4_two_days_compared(task):
    with task("&changeset=2") as hand:
        hand.click("text=Compare two")
        hand.choose(".form-line select >> nth=0", "1")
        hand.choose(".form-line select >> nth=1", "2")
        hand.click("#swipe")
        hand.page.wait_for_selector("canvas[data-swipe='0.5']")


def test_5_a_street_is_exported(task):
    with task("&changeset=2") as hand:
        hand.click("button:text-is('Download')")
        with hand.page.expect_download() as found:
            hand.click(".download-link:has-text('GeoPackage') >> nth=0")
        assert Path(found.value.path()).read_bytes().startswith(b"SQLite format 3")


def test_6_cones_below_a_probability(task):
    with task("&changeset=2") as hand:
        hand.click("button:has-text('List') >> nth=0")
        hand.click("button.filter-more")
        hand.write("[aria-label='Maximum existence probability']", "0.8")
        hand.page.wait_for_selector(".filter-summary:has-text('hidden by filters')")


def test_7_the_empty_position_of_a_removed_cone(task, changed):
    with task("&changeset=2") as hand:
        hand.find(changed["removed"][0])
        hand.page.wait_for_selector(".panel-images .viewer[data-frame] path.cone.dashed", state="attached")


def test_8_a_held_drive_is_accepted(task, conn, size):
    """By somebody whose name and token the tab knows."""
    with task() as hand:
        hand.page.evaluate(
            "([t, n]) => { sessionStorage.setItem('conetl writer token', t); sessionStorage.setItem('conetl name', n); }",
            [TOKEN, "Ada"],
        )
        hand.click(".review-button")
        hand.click(".review-buttons button >> nth=0")
        hand.page.wait_for_selector(".review-items .saved")
    conn.rollback()
    assert [c.hold for c in list_changesets(conn, map_name=size)] == [None] * 3


def test_9_a_coordinate_is_read(task, size):
    with task("&changeset=2&view=plan") as hand:
        box = hand.page.locator("canvas[data-engine]").bounding_box()
        hand.count += 1
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] * 0.8
        (hand.page.mouse.click if size == "phone" else hand.page.mouse.move)(x, y)
        hand.page.wait_for_selector(".cursor", state="visible")
        assert re.search(r"\d{6}\.\d+ E +\d{7}\.\d+ N", hand.page.inner_text(".cursor"))


def test_10_a_link_opens_what_is_seen(task, changed, browser, size):
    with task("&changeset=2") as hand:
        hand.find(changed["moved"][0])
        hand.count += 1  # copies the address
        hand.page.wait_for_url("**feature=**")
        other = browser.new_page(viewport=dict(zip(("width", "height"), SIZES[size], strict=True)))
        other.goto(hand.page.url)
        other.wait_for_selector(f".panel h2:text-is('{changed['moved'][0][:8]}')")
        other.close()
