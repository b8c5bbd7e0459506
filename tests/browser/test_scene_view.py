"""The tools around the scene in a real Chromium: plan, coordinates, measuring, layers, base map, dark page, swipe, timeline."""

from __future__ import annotations

import json
import re
import threading
from contextlib import closing
from datetime import UTC, datetime, timedelta
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from pyproj import Transformer

from conetl.db.connection import connect
from conetl.web.basemap import base_map
from tests.browser.conftest import page_without_problems
from tests.browser.test_view import ADDED, MOVED, click_cone, open_view, pixels_of, screenshot, settle
from tests.cases import cases
from tests.pmtiles_file import write_pmtiles
from tests.view_map import serving

#: As in web/src/theme.ts.
DARK_BACKGROUND = (0x12, 0x18, 0x1F)
TILE_COLOURS = ((200, 120, 40), (40, 120, 200))


def tile_png(colour: tuple[int, int, int]) -> bytes:
    return cv2.imencode(".png", np.full((256, 256, 3), colour[::-1], np.uint8))[1].tobytes()


def at_cone(page: Any, feature_id: str) -> tuple[float, float]:
    x, y = page.evaluate("id => window.conetlProject(id)", feature_id)
    return float(x), float(y)


def under_cursor(page: Any, x: float, y: float) -> np.ndarray:
    """Easting, northing, longitude, latitude that the page shows for a pixel of the canvas."""
    box = page.locator("main.view").bounding_box()
    page.mouse.move(box["x"] + x, box["y"] + y)
    page.wait_for_function("() => / E .* N.*, /.test(document.querySelector('.cursor').textContent)")
    page.wait_for_timeout(120)
    return np.array(re.findall(r"-?\d+\.\d+", page.locator(".cursor").inner_text()), float)


def test_the_plan_is_orthographic_and_coordinates_are_those_of_pyproj(page, address, features):
    open_view(page, address)
    page.keyboard.press("t")
    page.wait_for_function("() => location.hash.includes('view=plan')")
    settle(page)
    stays, comes = at_cone(page, features["stays"]), at_cone(page, features["comes"])
    assert abs(stays[1] - comes[1]) < 0.1 < comes[0] - stays[0]  # 8 m due east, north is up
    east, north, lon, lat = under_cursor(page, *stays)
    per_m = (comes[0] - stays[0]) / 8
    assert np.hypot(east - 458_001, north - 5_428_010) < 1.5 / per_m + 0.01
    expected = Transformer.from_crs(32632, 4326, always_xy=True).transform(east, north)
    assert np.abs(np.subtract(expected, (lon, lat))).max() < 1.5e-7  # a centimetre, and the last digit
    page.click("canvas", position={"x": stays[0], "y": stays[1] + 60})  # it stays, to be copied and sent
    shown = page.locator(".cursor").inner_text()
    page.wait_for_url("**at=**")
    page.mouse.move(5, 5)
    assert page.locator(".cursor").inner_text() == shown
    page.evaluate("navigator.clipboard.writeText = (text) => { window.copied = text; return Promise.resolve(); }")
    page.click(".cursor")
    assert page.evaluate("window.copied").split()[:2] == ["EPSG:32632", shown.split()[0]]
    page.keyboard.press("Escape")
    page.wait_for_selector(".cursor", state="hidden")
    under_cursor(page, *stays)
    line_px = page.locator(".scalebar i").bounding_box()["width"]
    metres = float(page.locator(".scalebar span").inner_text().split()[0])
    assert line_px / metres == pytest.approx(per_m, rel=0.02)
    page.mouse.wheel(0, -400)  # zooms at the cursor: the place under it stays
    settle(page)
    zoomed = at_cone(page, features["stays"])
    assert np.hypot(*np.subtract(zoomed, stays)) < 1.5
    assert at_cone(page, features["comes"])[0] - zoomed[0] > 1.3 * (comes[0] - stays[0])
    middle = page.locator("main.view").bounding_box()
    _, _, *centre = under_cursor(page, middle["width"] / 2, middle["height"] / 2)
    town, said = page.locator(".where").inner_text().split("\n")
    assert town == "Karlsruhe, Germany"
    said = [float(number) for number in said.split(", ")]
    assert np.abs(np.subtract(said, centre[::-1])).max() < 3e-5  # latitude, longitude of the middle
    page.evaluate("document.querySelector('#grid').value = 'labels'")
    page.evaluate("document.querySelector('#grid').dispatchEvent(new Event('change'))")
    page.wait_for_selector(".grid-labels .east-label")
    assert all(re.fullmatch(r"\d{6}(\.\d)? E", text) for text in page.locator(".east-label").all_inner_texts())
    page.wait_for_url("**grid=labels**")
    page.keyboard.press("t")
    page.wait_for_function("() => !location.hash.includes('view=plan')")


def test_distance_width_and_area_have_the_sigma_of_the_cones(page, address, features):
    open_view(page, f"{address}#map=default&view=plan")
    page.keyboard.press("m")
    for name in ("stays", "comes"):
        click_cone(page, features[name])
    page.wait_for_selector(".measure .total >> text=±")
    cov = np.array(
        page.evaluate("id => fetch(`./api/maps/default/features/${id}`).then((r) => r.json())", features["stays"])[
            "history"
        ][-1]["cov_m2"]
    )
    value, sigma = map(float, re.findall(r"\d+\.\d+", page.locator(".measure .total").inner_text()))
    assert (value, sigma) == (pytest.approx(8.0, abs=0.005), pytest.approx(np.sqrt(2 * cov[0]), abs=0.006))
    click_cone(page, features["wanders"])  # on the line through both
    page.wait_for_selector("text=Last point to line 1–2")
    width = page.locator(".measure .row >> text=Last point to line 1–2").locator("xpath=..").inner_text()
    assert "0.00" in width
    page.keyboard.press("Backspace")
    x, y = at_cone(page, features["stays"])
    page.click("canvas", position={"x": x, "y": y + 120})
    page.wait_for_selector("text=Points on the ground have no sigma")
    page.click(".measure >> text=Area")
    _, north, _, _ = under_cursor(page, x, y + 120)
    area = float(re.findall(r"\d+\.\d+", page.locator(".measure .total").inner_text())[0])
    assert area == pytest.approx(8.0 * (5_428_010 - north) / 2, abs=0.4)
    page.wait_for_url("**measure=area:**")
    link = page.url
    page.keyboard.press("Escape")
    page.wait_for_selector(".measure", state="hidden")
    page.wait_for_url(lambda url: "measure" not in url)
    assert page.locator(".panel").is_hidden()
    page.goto("about:blank")
    page.goto(link)
    page.wait_for_selector(".measure .total")
    assert float(re.findall(r"\d+\.\d+", page.locator(".measure .total").inner_text())[0]) == pytest.approx(
        area, abs=0.01
    )


@pytest.mark.release
def test_the_page_is_dark_if_the_system_is_and_by_a_switch(browser, address):
    tab = browser.new_page(viewport={"width": 1280, "height": 800}, color_scheme="dark")
    open_view(tab, address)
    image = screenshot(tab)
    assert pixels_of(image, DARK_BACKGROUND) > 0.3 * image.shape[0] * image.shape[1]
    contrasts = tab.evaluate(
        """() => {
          const light = (css) => css.match(/[\\d.]+/g).slice(0, 3).map((v) => v / 255)
            .map((v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4))
            .reduce((sum, v, i) => sum + v * [0.2126, 0.7152, 0.0722][i], 0);
          const ground = (node) => { const css = getComputedStyle(node).backgroundColor;
            return /, 0\\)$/.test(css) && node.parentElement ? ground(node.parentElement) : css; };
          return [...document.querySelectorAll("label, button, h2, span, b, p, option, select")]
            .filter((n) => n.offsetParent && n.innerText.trim() && !n.disabled && !n.closest(":disabled, .view"))
            .map((n) => { const [a, b] = [light(getComputedStyle(n).color), light(ground(n))].sort((p, q) => q - p);
              return [(a + 0.05) / (b + 0.05), n.innerText.slice(0, 30)]; });
        }"""
    )
    assert len(contrasts) > 20 and min(contrasts)[0] >= 4.5, sorted(contrasts)[:5]
    tab.click("#theme")
    settle(tab)
    assert pixels_of(screenshot(tab), DARK_BACKGROUND) < 1000
    tab.reload()
    tab.wait_for_selector("html[data-theme=light]", state="attached")
    tab.close()


def test_two_states_are_compared_by_a_divider(page, address, features):
    open_view(page, f"{address}#map=default&mode=compare&from=1&view=plan", cones=4)
    page.check("#swipe")
    page.wait_for_selector("canvas[data-swipe='0.5']")
    page.focus(".swipe")
    page.keyboard.press("Home")  # all of it is the second state
    page.wait_for_selector("canvas[data-swipe='0']")
    settle(page)
    second = screenshot(page)
    assert pixels_of(second, ADDED) > 40 and pixels_of(second, MOVED) > 40
    page.keyboard.press("End")
    page.wait_for_selector("canvas[data-swipe='1']")
    settle(page)
    first = screenshot(page)
    assert pixels_of(first, ADDED) < 10 and pixels_of(first, MOVED) > 40
    page.wait_for_url("**swipe=1**")
    click_cone(page, features["goes"])  # which stands in the first state
    page.wait_for_selector(f"h2:text-is('{features['goes'][:8]}')")
    page.keyboard.press("Escape")
    box = page.locator(".swipe").bounding_box()
    page.mouse.move(box["x"] + 11, 300)
    page.mouse.down()
    page.mouse.move(700, 300)
    page.mouse.up()
    assert 0.3 < float(page.get_attribute("canvas", "data-swipe")) < 0.6
    assert page.locator(".swipe .left").inner_text().startswith("after 20")
    page.click("text=Drive by drive")
    page.wait_for_selector(".swipe", state="hidden")


class _Tiles(BaseHTTPRequestHandler):
    """Tiles like a chess board; other pages may read them."""

    def do_GET(self) -> None:
        _, x, y = map(int, self.path.strip("/").split("/"))
        data = tile_png(TILE_COLOURS[(x + y) % 2])
        self.send_response(200)
        self.send_header("Content-Type", "image/png")
        self.send_header("Content-Length", str(len(data)))
        self.send_header("Access-Control-Allow-Origin", "*")
        self.end_headers()
        self.wfile.write(data)

    def log_message(self, *_: object) -> None:
        pass


@pytest.mark.parametrize("source", cases("file", release=["server"]))
def test_a_base_map_lies_where_it_belongs(browser, module_database_url, features, tmp_path: Path, source):
    tiles = ThreadingHTTPServer(("127.0.0.1", 0), _Tiles)
    threading.Thread(target=tiles.serve_forever, daemon=True).start()
    host = f"http://127.0.0.1:{tiles.server_port}"
    lon0, lat0 = Transformer.from_crs(32632, 4326, always_xy=True).transform(458_001, 5_428_010)
    column, row = (np.floor(tile_of(lon0, lat0, 19)).astype(int)).tolist()
    around = {
        (19, column + i, row + j): tile_png(TILE_COLOURS[(column + i + row + j) % 2])
        for i in range(-3, 4)
        for j in range(-3, 4)
    }
    chosen = (
        base_map(f"{host}/{{z}}/{{x}}/{{y}}", "(c) chess")
        if source == "server"
        else base_map(str(write_pmtiles(tmp_path / "a.pmtiles", around)), "(c) chess")
    )
    asked: list[str] = []
    try:
        with serving(module_database_url, "default", basemap=chosen) as port:
            own = f"http://127.0.0.1:{port}"
            tab = browser.new_page(viewport={"width": 1280, "height": 800})
            tab.on("request", lambda r: asked.append(r.url))
            answer = tab.goto(f"{own}/#map=default&view=plan&grid=none&way=0&cam=3,12,14,0.4,0.001,60")
            images = re.search(r"img-src ([^;]*);", answer.headers["content-security-policy"])
            assert images and images[1] == "'self' data: blob:" + (f" {host}" if source == "server" else "")
            tab.wait_for_selector("canvas[data-tiles]:not([data-tiles='0'])")
            tab.wait_for_timeout(700)
            settle(tab)
            image = screenshot(tab)
            checked = 0
            for x, y in [(x, y) for x in range(60, 900, 160) for y in range(120, 560, 110)]:
                _, _, lon, lat = under_cursor(tab, x, y)
                fraction = tile_of(lon, lat, 19)
                if np.abs(fraction - np.round(fraction)).min() < 0.02:  # at a tile's edge
                    continue
                wanted = TILE_COLOURS[int(np.floor(fraction).sum()) % 2]
                near = np.abs(image[y, x] - wanted).max()
                checked += near <= 6
                assert near <= 6 or pixels_of(image[y - 12 : y + 13, x - 12 : x + 13], wanted) > 100, (
                    x,
                    y,
                )  # a cone is there
            assert checked > 14
            assert tab.locator(".attribution").inner_text() == "(c) chess"
            assert {url.split("/")[2] for url in asked if not url.startswith(("blob:", "data:"))} <= {own[7:], host[7:]}
            assert any(url.startswith(host) for url in asked) == (source == "server")
            tab.close()
    finally:
        tiles.shutdown()
        tiles.server_close()


def tile_of(lon_deg: float, lat_deg: float, z: int) -> np.ndarray:
    """Column and row, with fractions, of the Web Mercator scheme."""
    sin = np.sin(np.radians(lat_deg))
    return 2**z * np.array([(lon_deg + 180) / 360, 0.5 - np.log((1 + sin) / (1 - sin)) / (4 * np.pi)])


@pytest.mark.release
def test_two_thousand_drives_of_years_are_clusters_that_open(page, address):
    """The timeline of the server, with its first drive a thousandfold over six years."""
    count = 2_000

    def many(route: Any) -> None:
        answer = route.fetch()
        timeline = json.loads(answer.text())
        first, last = timeline["changesets"]
        began = datetime(2020, 3, 1, 8, tzinfo=UTC)
        items = []
        for i in range(count - 1):
            at = (began + timedelta(days=i * 1.1)).isoformat()
            times = {"captured_from": at, "captured_to": at, "valid_at": at}
            items.append(first | times | {"changeset_no": i + 1, "drive_id": f"drive_{i:04}"})
        timeline["changesets"] = [*items, last | {"changeset_no": count}]
        route.fulfill(response=answer, body=json.dumps(timeline))

    page.route("**/timeline", many)
    page.route(
        re.compile("changeset_no="),
        lambda route: route.continue_(url=re.sub(r"changeset_no=\d+", "changeset_no=2", route.request.url)),
    )
    page.goto(f"{address}#mode=drive")
    page.wait_for_selector(".axis .cluster")
    page.wait_for_selector("canvas[data-frames]")
    years = [text for text in page.locator(".axis-scale span").all_inner_texts() if text in map(str, range(2020, 2027))]
    assert len(years) >= 4 and 10 < page.locator(".axis .column").count() < 120
    total = sum(int(text or 1) for text in page.locator(".axis .column").all_inner_texts())
    assert total == count
    spent = page.evaluate(
        """() => { const before = performance.now();
          for (let i = 0; i < 10; i++) window.dispatchEvent(new KeyboardEvent("keydown", { key: i % 2 ? "." : "," }));
          return (performance.now() - before) / 10; }"""
    )
    print(f"choosing a drive among {count}: {spent:.1f} ms")
    for _ in range(6):  # a cluster opens until its drives are apart
        clusters = page.locator(".axis .cluster")
        if not clusters.count():
            break
        clusters.nth(clusters.count() // 2).click()
    single = page.locator(".axis .column:not(.cluster)").first
    number = int(single.get_attribute("data-changeset"))
    single.click()
    page.wait_for_selector(f".drive-text strong:text-is('drive_{number - 1:04}')")
    page.click("[aria-label='Show the whole timeline']")
    page.mouse.move(640, 760)
    page.mouse.wheel(0, -500)
    page.wait_for_timeout(100)
    assert sum(int(text or 1) for text in page.locator(".axis .column").all_inner_texts()) < count


@pytest.mark.release
def test_a_mini_map_shows_where_the_view_is(page, address, features):
    open_view(page, f"{address}#map=default&view=plan")
    assert page.locator(".minimap").is_hidden()
    click_cone(page, features["stays"])
    page.keyboard.press("Escape")
    for _ in range(12):
        page.keyboard.press("+")
    page.wait_for_selector(".minimap:visible")
    settle(page)
    before = at_cone(page, features["comes"])
    page.click(".minimap", position={"x": 158, "y": 58})  # its eastern end, where that cone is
    settle(page)
    x, y = at_cone(page, features["comes"])
    box = page.locator("main.view").bounding_box()
    assert (
        abs(x - box["width"] / 2) < abs(before[0] - box["width"] / 2) / 4 and abs(y - box["height"] / 2) < box["height"]
    )


def test_layers_are_styled_and_the_address_says_so(page, address):
    open_view(page, address)
    page.click(".map-tools >> text=Layers")
    page.keyboard.press("Escape")
    assert page.locator(".layers-panel").is_hidden()
    page.click(".map-tools >> text=Layers")
    page.select_option("#grid", "none")
    page.wait_for_function("() => location.hash.includes('grid=none')")
    settle(page)
    assert "grid" not in page.locator(".scalebar span").inner_text()
    page.click(".layers-panel >> text=Reset")
    page.wait_for_function("() => !location.hash.includes('grid=')")
    page.keyboard.press("Escape")


def test_a_work_zone_is_an_area_with_what_is_closed_on_the_road_now(browser, database_url, samples):
    """Of the road now; a drive's changes are shown without."""
    cones = [samples.feature(f"z{k}", xyz_m=(458_000.0 + 6.0 * k, 5_428_010.0, 114.5)) for k in range(6)]
    with closing(connect(database_url)) as conn:
        samples.commit(conn, *[samples.added(cone) for cone in cones], key="1")
    with serving(database_url, "default") as port, page_without_problems(browser, f"http://127.0.0.1:{port}/") as page:
        page.goto(f"http://127.0.0.1:{port}/")
        page.wait_for_selector('html[data-zones="1"]', state="attached")
        page.wait_for_selector(".zone >> text=Work zone", state="visible")
        page.click("text=Drive by drive")
        page.wait_for_selector('html[data-zones="0"]', state="attached")
