"""Find things in the web view: lists, filters, search, sites, downloads; wrong addresses, phones, accessibility."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.browser.test_view import ADDED, MOVED, click_cone, open_view, pixels_of, screenshot, settle
from tests.command import until
from tests.view_map import commit, cone, serving

ROOT = Path(__file__).resolve().parents[2]
AXE = ROOT / "web/node_modules/axe-core/axe.min.js"
#: Controls that reach beyond a phone's screen, except for what scrolls in itself.
OUTSIDE = """() => [...document.querySelectorAll('button, input, select, a')]
  .filter((node) => node.checkVisibility() && !node.closest('.table, .sidebar, .track-scroll'))
  .map((node) => [node.outerHTML.slice(0, 80), node.getBoundingClientRect()])
  .filter(([, box]) => box.width && (box.left < -1 || box.right > 391))
  .map(([html]) => html)"""
NOBODY = "00000000-0000-4000-8000-00000000dead"


@pytest.fixture(scope="module")
def address(module_database_url: str, features: dict[str, str]) -> Iterator[str]:
    with serving(module_database_url, "default") as port:
        yield f"http://127.0.0.1:{port}/"


def rows(page: Any, tab: str = "cones", column: int = 0) -> list[str]:
    """One column of the rows that are drawn, in their order."""
    cells = page.eval_on_selector_all(
        f"#list-{tab} .table-space .row",
        "(all, column) => all.map((r) => [Number(r.dataset.index), r.children[column].textContent])",
        column,
    )
    return [text for _, text in sorted(cells)]


def see(page: Any, wanted: list[str], tab: str = "cones", column: int = 0) -> None:
    """Wait until a column has these texts: rows come from the server."""
    until(lambda: rows(page, tab, column) == wanted, f"the rows {wanted}", 15, 0.1)


def wait_for_rows(page: Any, count: int, tab: str = "cones") -> None:
    page.wait_for_selector(f"#list-{tab} .table[aria-rowcount='{count + 1}']")


def ids(features: dict[str, str], *names: str) -> list[str]:
    return [features[name][:8] for name in names]


def test_the_list_of_changes_has_the_largest_move_first_and_selects_with_the_map(page, address, features):
    open_view(page, address)
    page.keyboard.press("l")
    page.click("#list-tab-changes")
    wait_for_rows(page, 4, "changes")
    see(page, ids(features, "wanders", "comes", "goes", "stays"), "changes")
    assert rows(page, "changes", 5) == ["1.500", "", "", "0.000"]
    page.click("#list-changes .row[data-index='0']")
    page.wait_for_selector(".panel >> text=moved by 1.500 m")
    settle(page)
    x, y = page.evaluate("id => window.conetlProject(id)", features["wanders"])
    box = page.locator(".view canvas").first.bounding_box()
    assert abs(x - box["width"] / 2) < 20 and abs(y - box["height"] / 2) < 60  # it flew there
    for key, name in (("]", "comes"), ("j", "goes"), ("[", "comes"), ("k", "wanders")):
        page.keyboard.press(key)
        page.wait_for_selector(f".panel h2:text-is('{features[name][:8]}')")
    page.wait_for_selector(".panel >> text=moved by 1.500 m")  # it flew there again
    page.evaluate("document.activeElement.blur()")
    page.keyboard.press("Home")
    settle(page)
    click_cone(page, features["stays"])
    page.wait_for_selector("#list-changes .row[data-index='3'][aria-selected=true]")
    page.wait_for_url("**list=changes**")
    page.reload()
    page.wait_for_selector("#list-changes .row[data-index='3'][aria-selected=true]")
    page.keyboard.press("l")
    page.wait_for_selector(".list", state="hidden")


def test_columns_sort_and_keys_move_through_the_rows(page, address, features):
    open_view(page, address, "#list=cones")
    wait_for_rows(page, 3)  # what stands; the one that is gone is a change
    heads = page.locator("#list-cones [role=columnheader]")
    see(page, ids(features, "comes", "wanders", "stays"))  # the least probable one first
    heads.filter(has_text="East m").locator("button").click()
    see(page, ids(features, "stays", "wanders", "comes"))
    assert [text[:7] for text in rows(page, column=7)] == ["458001.", "458006.", "458009."]
    heads.filter(has_text="East m").locator("button").click()
    see(page, ids(features, "comes", "wanders", "stays"))
    page.wait_for_url("**sort=east-**")
    assert page.locator("#list-cones [aria-sort=descending]").inner_text() == "East m"
    page.focus("#list-cones .table")
    for key in ("ArrowDown", "ArrowDown", "End", "ArrowUp"):
        page.keyboard.press(key)
    page.wait_for_selector(f".panel h2:text-is('{features['wanders'][:8]}')")


def test_filters_hold_for_map_and_list_and_are_in_the_address(page, address, features):
    open_view(page, address, "#list=changes")
    wait_for_rows(page, 4, "changes")
    page.click(".kind-chips .chip[data-kind=moved]")
    wait_for_rows(page, 3, "changes")
    page.wait_for_selector('html[data-cones="3"]', state="attached")
    assert page.locator(".legend label[data-kind=moved] input").is_checked() is False
    settle(page)
    assert pixels_of(screenshot(page), MOVED) == 0
    page.fill("#probability", "0.8")
    wait_for_rows(page, 1, "changes")
    page.fill("#probability", "0")
    page.click("button.filter-more")
    page.fill("[aria-label='Maximum existence probability']", "0.8")
    wait_for_rows(page, 2, "changes")
    see(page, ids(features, "comes", "goes"), "changes")
    page.fill("[aria-label='Maximum existence probability']", "")
    page.select_option(".filter-field select", "1")
    wait_for_rows(page, 0, "changes")  # the second drive changed or confirmed all of them
    assert "4 cones hidden by filters" in page.locator(".filter-summary").inner_text()
    page.wait_for_url("**drive=1**")
    page.reload()
    wait_for_rows(page, 0, "changes")
    page.click(".filter-summary >> text=clear")
    wait_for_rows(page, 4, "changes")
    page.wait_for_url(lambda url: "hide" not in url and "drive=" not in url)
    page.click("button.filter-more")
    for label, value in (
        ("Maximum horizontal sigma in metres", "0.001"), ("Maximum object height in metres", "0.1"),
        ("Last seen from", "2030-01-01"),
    ):  # fmt: skip
        page.fill(f"[aria-label='{label}']", value)
        wait_for_rows(page, 0, "changes")
        page.fill(f"[aria-label='{label}']", "")
        wait_for_rows(page, 4, "changes")
    page.click(".kind-chips .chip[data-kind=removed]", click_count=2)
    wait_for_rows(page, 1, "changes")
    page.wait_for_url("**show=removed**")


@pytest.mark.release
def test_classes_have_a_legend_a_filter_and_words(page, address, conn, features):
    def set_category(category: str) -> None:
        with conn, conn.cursor() as cursor:
            update = "update conetl.feature_version set category = %s where feature_id = %s"
            cursor.execute(update, (category, features["comes"]))

    open_view(page, address, "#list=changes")
    wait_for_rows(page, 4, "changes")
    assert page.locator("#list-changes [role=columnheader]").all_inner_texts()[:2] == ["Id", "Kind"]
    assert page.locator(".classes").is_hidden() and page.locator("#list-tab-cones").inner_text() == "Cones3"
    set_category("work_zone_sign")
    try:
        page.reload()
        wait_for_rows(page, 4, "changes")
        assert page.locator(".classes label").all_inner_texts() == ["Traffic cone\n3", "Work-zone sign\n1"]
        assert page.locator("#list-tab-cones").inner_text() == "Objects3"
        assert sorted(rows(page, "changes", 1)) == ["Traffic cone"] * 3 + ["Work-zone sign"]
        page.uncheck("#class-traffic_cone")
        page.wait_for_selector('html[data-cones="1"]', state="attached")
        page.wait_for_url("**hideclass=traffic_cone**")
        page.reload()
        wait_for_rows(page, 1, "changes")
        assert "3 objects hidden by filters" in page.locator(".filter-summary").inner_text()
        page.click("#list-changes .row[data-index='0']")
        page.wait_for_selector(".panel dd:text-is('Work-zone sign')")
        page.click(".filter-summary >> text=clear")
        wait_for_rows(page, 4, "changes")
    finally:
        set_category("traffic_cone")


@pytest.mark.release
def test_only_in_view_follows_the_camera(page, address, features):
    open_view(page, address, f"#list=changes&feature={features['stays']}")
    page.wait_for_selector(".panel >> text=Evidence")
    page.click(".panel button:text-is('Centre')")
    for _ in range(14):
        page.keyboard.press("+")
    page.check("#in-view")
    wait_for_rows(page, 1, "changes")
    see(page, ids(features, "stays"), "changes")
    page.evaluate("document.activeElement.blur()")
    page.keyboard.press("Home")
    wait_for_rows(page, 4, "changes")


@pytest.mark.release
def test_a_list_whose_request_failed_is_asked_for_again(browser, address):
    tab = browser.new_page(viewport={"width": 1280, "height": 800})
    tab.route("**/changes?**", lambda route: route.abort())
    with tab.expect_event("requestfailed"):
        open_view(tab, address, "#list=changes")
    tab.unroute("**/changes?**")
    wait_for_rows(tab, 4, "changes")
    tab.close()


def test_counts_of_a_drive_open_the_list_of_its_changes(page, address, features):
    open_view(page, address)
    page.click(".drive-text .chip[data-kind=moved]")
    wait_for_rows(page, 1, "changes")
    assert rows(page, "changes") == ids(features, "wanders")
    page.click(".drive-text .chip[data-kind=moved]")
    wait_for_rows(page, 4, "changes")


def test_the_search_finds_cones_drives_days_towns_and_coordinates(page, address, features):
    open_view(page, address)

    def search(text: str) -> list[str]:
        page.keyboard.press("/")
        page.fill("#search", text)
        page.wait_for_selector(".search-popup")
        page.wait_for_timeout(600)
        return page.locator(".search-group, .search-option > span").all_inner_texts()

    assert search("drive_") == ["Drives", "drive_2", "drive_1"]
    page.keyboard.press("ArrowDown")
    page.keyboard.press("Enter")
    page.wait_for_selector(".drive-text >> text=drive_1")
    assert search("458004 5428010")[0] == "Coordinates"
    page.keyboard.press("Enter")
    page.wait_for_selector(".found-pin")
    page.wait_for_url("**mark=4.00,10.00**")
    assert search("Karlsru") == ["Towns", "Karlsruhe, Germany"]
    assert search("torf,") == [] and "Nothing found for “torf,”" in page.locator(".search-status").inner_text()
    page.reload()
    page.wait_for_selector(".found-pin")
    page.click(".found-pin")
    page.wait_for_selector(".found-pin", state="hidden")
    assert search(features["wanders"][:10]) == ["Cones", features["wanders"][:8]]
    page.keyboard.press("Enter")
    page.wait_for_selector(f".panel h2:text-is('{features['wanders'][:8]}')")


def test_downloads_are_what_is_shown(page, address, features):
    open_view(page, address, "#changeset=1", cones=3)  # three cones, all added

    def download(text: str) -> tuple[str, bytes]:
        if page.locator(".menu-popup").is_hidden():
            page.click("button:text-is('Download')")
        with page.expect_download() as found:
            page.click(f".menu-popup >> text={text}")
        return found.value.suggested_filename, Path(found.value.path()).read_bytes()

    name, text = download("GeoJSON")
    assert name.startswith("default_2026-03-") and name.endswith("Z.geojson")
    shown = {f["properties"]["feature_id"] for f in json.loads(text)["features"]}
    assert shown == {features[n] for n in ("stays", "goes", "wanders")}
    assert len(list(csv.DictReader(io.StringIO(download("CSV")[1].decode())))) == 3
    name, data = download("Image of the view")
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert name.endswith(".png") and image.shape[1] > 900 and image[: image.shape[0] // 2].std() > 3
    page.click("text=Work zones")
    page.fill("[placeholder=Publisher]", "City")
    page.fill("[placeholder='Road name']", "L 605")
    name, text = download("Download WZDx")
    assert name.startswith("default_2026-03-") and json.loads(text)["feed_info"]["publisher"] == "City"
    assert page.get_attribute(".menu-popup a[target=_blank]", "href") == "./api/maps/default/changesets/1/report"


@pytest.mark.release
def test_an_address_that_is_wrong_is_said_so(browser, address):
    tab = browser.new_page(viewport={"width": 1280, "height": 800})
    for hash_, *said in (
        ("changeset=99", "The map “default” has no changeset 99"),
        ("mode=compare&from=1&to=77", "has no changeset 77"),
        ("mode=instant&known=55", "has no changeset 55"),
        ("map=elsewhere", "There is no map “elsewhere”"),
        (f"feature={NOBODY}", f"has no feature {NOBODY}"),
        ("mode=instnt", "mode=instnt is not one of instant"),
        (
            "mode=instant&valid=yesterday&feature=12&crs=EPSG:4326&p=2&sigma=2&smax=x",
            "valid=yesterday is not a time", "feature=12 is not the id of a cone", "crs is unknown", "sigma is unknown",
            "p=2 is not a probability; smax=x is not a number",
        ),
    ):  # fmt: skip
        tab.goto("about:blank")
        tab.goto(f"{address}#{hash_}")
        for text in said:
            tab.get_by_text(text).first.wait_for()
        if "99" in hash_:
            assert tab.locator(".drive-text").inner_text() == "No changeset 99"
            tab.click("text=Show the latest")
            tab.wait_for_selector('html[data-cones="4"]', state="attached")
        if "elsewhere" in hash_:
            tab.get_by_text("Select one of the maps of this database: “default”").first.wait_for()
    tab.close()


@pytest.fixture
def long_name(conn: Any) -> Iterator[str]:
    """The second drive has a long name meanwhile."""
    names = ("2026-03-03_ring_northbound_lane_2_survey_vehicle_07_run_004", "drive_2")
    for new, old in (names, names[::-1]):
        with conn, conn.cursor() as cursor:
            cursor.execute("update conetl.drive set drive_id = %s where drive_id = %s", (new, old))
        if new != "drive_2":
            yield new


@pytest.mark.release
def test_a_phone_needs_no_sideways_scrolling(browser, address, features, long_name):
    tab = browser.new_page(viewport={"width": 390, "height": 844}, has_touch=True, is_mobile=True)
    for hash_ in (
        "",
        f"feature={features['wanders']}",
        "mode=drive&list=changes",
        "mode=compare&list=cones",
        "mode=drive",
    ):
        tab.goto("about:blank")
        tab.goto(f"{address}#{hash_}")
        tab.wait_for_selector("canvas[data-frames]")
        tab.wait_for_timeout(300)
        assert tab.evaluate("document.scrollingElement.scrollWidth") <= 390, hash_
        outside = tab.evaluate(OUTSIDE)
        assert outside == [], hash_
        if "list" in hash_:  # both ends: drives of one vehicle differ at that of their names
            assert (
                tab.locator(f".table:visible [title='{long_name}']").first.inner_text() == "2026-03-03…cle_07_run_004"
            )
    tab.click("button.menu")
    tab.click(".sidebar input >> nth=0")
    assert tab.locator(".sidebar").is_visible()
    tab.click("text=List")
    assert tab.locator(".sidebar").is_hidden(), "the legend does not cover the list"
    tab.click("button.menu")
    tab.keyboard.press("Escape")
    assert tab.locator(".sidebar").is_hidden() and tab.get_attribute("button.menu", "aria-expanded") == "false"
    tab.close()


@pytest.mark.release
@pytest.mark.skipif(not AXE.is_file(), reason="axe-core is not installed (npm ci in web/)")
def test_axe_has_no_serious_finding(browser, address, features):
    tab = browser.new_page(viewport={"width": 1280, "height": 800}, bypass_csp=True)
    tab.goto(f"{address}#mode=drive&list=changes&feature={features['wanders']}")
    tab.wait_for_selector(".panel-images .pane img")
    tab.add_script_tag(path=AXE)

    def findings() -> list[str]:
        found = tab.evaluate("() => axe.run().then((r) => r.violations)")
        return [
            f"{v['id']}: {v['help']}: {n['html'][:160]}"
            for v in found
            for n in v["nodes"]
            if v["impact"] in ("serious", "critical")
        ]

    assert findings() == []
    tab.click("button.filter-more")
    tab.click("button:text-is('Download')")
    assert findings() == []
    tab.keyboard.press("Escape")
    tab.fill("#search", "drive_")
    tab.wait_for_selector(".search-option")
    assert findings() == []
    tab.close()


def test_far_sites_are_listed(page, address, conn, samples, images):
    """Last in this file: it changes the map."""
    far = cone(samples, "far", 900.0, day=2)
    beside = cone(samples, "beside", 905.0, day=2)
    open_view(page, address)
    assert page.locator(".sites-section").is_hidden()
    commit(conn, samples, images, "3", 2, samples.added(far), samples.added(beside))
    page.wait_for_selector(".sites-section")
    sites = page.locator(".sites button")
    assert sites.all_inner_texts() == ["Site 1, the largest\n3 cones", "Site 2, 900 m east\n2 cones"]
    sites.nth(1).click()
    settle(page)
    x, _ = page.evaluate("id => window.conetlProject(id)", str(far.feature_id))
    assert 0 < x < page.locator(".view canvas").first.bounding_box()["width"]


def test_a_lane_marking_is_a_line_that_can_be_clicked_and_hidden(page, address, conn, samples, images):
    """After the sites: it changes the map, too."""
    vertices_m = np.linspace((458_000.0, 5_428_006.0, 114.5), (458_010.0, 5_428_007.0, 114.5), 5)
    shape = samples.marking(vertices_m, pattern="dashed", dash_m=3.0, gap_m=1.0, colour="yellow", width_m=0.2)
    line = samples.line_feature(shape, seen_ns=samples.START_NS + 3 * samples.DAY_NS + 7)
    commit(conn, samples, images, "4", 3, samples.added(line, track_index=None))
    open_view(page, address, "#view=plan&cam=5,7,15,0,0.01,20", cones=6)
    assert page.locator(".classes label").all_inner_texts() == ["Traffic cone\n5", "Lane marking\n1"]
    assert page.locator(".drive-text .chip").all_inner_texts() == ["1 stretch of lane markings added"]
    shown = pixels_of(screenshot(page), ADDED)
    click_cone(page, str(line.feature_id))
    page.wait_for_selector(".panel dd span:text-is('yellow, dashed, 3.0 m with gaps of 1.0 m')")
    assert "0.200 ± 0.010 m" in page.locator(".panel").inner_text()
    assert "foot centre" not in page.locator(".panel").inner_text()
    page.keyboard.press("Escape")
    page.uncheck("#class-lane_marking")
    page.wait_for_selector('html[data-cones="5"]', state="attached")
    settle(page)
    assert pixels_of(screenshot(page), ADDED) < shown - 500
