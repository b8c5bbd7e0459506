"""Base layers in a real Chromium: muted points and lines under the cones, switched on and off, never more than the budget."""

from __future__ import annotations

import time
from typing import Any

import laspy
import numpy as np
import pytest
from pyproj import CRS, Transformer
from typer.testing import CliRunner

from conetl.cli.app import app
from tests.browser.test_view import ADDED, click_cone, open_view, pixels_of, screenshot, settle
from tests.unit.readers.test_base_layers import geojson, line

#: The darkest points and the painted lines, as in web/src/base.ts.
LINE = (0x8A, 0x74, 0x43)
#: Lane boundaries and new cones in the colours of the paper's Figure 6, as in web/src/theme.ts.
PAPER_LINE, PAPER_NEW = (0x12, 0x83, 0x3A), (0x0A, 0x45, 0xD6)
POINT_COUNT, LINE_COUNT = 100_000, 200


def sandy(image: np.ndarray) -> int:
    """Pixels of points, and of a few smooth edges of lines: grey with a little yellow, whatever their intensity."""
    red, green, blue = np.moveaxis(image, 2, 0)
    return int(((red > 160) & (red - green < 12) & (red - blue > 11) & (red - blue < 30)).sum())


@pytest.fixture(scope="module", autouse=True)
def base_layers(module_database_url: str, features: dict[str, str], tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.mktemp("base")
    rng = np.random.default_rng(1)
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = [0.001] * 3, [458_000.0, 5_428_000.0, 100.0]
    header.add_crs(CRS.from_epsg(32632))
    las = laspy.LasData(header)
    las.x, las.y = rng.uniform(457_960, 458_060, POINT_COUNT), rng.uniform(5_427_980, 5_428_060, POINT_COUNT)
    las.z = 114.48 + rng.normal(0, 0.01, POINT_COUNT)
    las.y[::5], las.z[::5] = 5_428_030.0, rng.uniform(114.5, 118.0, POINT_COUNT // 5)  # a wall
    las.intensity = rng.integers(0, 255, POINT_COUNT)
    las.write(folder / "street.laz")
    to_wgs84 = Transformer.from_crs(32632, 4326, always_xy=True)

    def place(east_m: float, north_m: float) -> list[float]:
        return [*to_wgs84.transform(458_000 + east_m, 5_428_000 + north_m), 114.5]

    lanes = geojson(
        folder / "lanes.geojson", *(line(place(-20, 2 * i), place(40, 2 * i), kind="line_thin") for i in range(LINE_COUNT))
    )  # fmt: skip
    environment = {"CONETL_DATABASE_URL": module_database_url, "CONETL_HOME": str(folder / "home")}
    result = CliRunner().invoke(app, ["base", "import", str(folder / "street.laz"), str(lanes)], env=environment)
    assert result.exit_code == 0, result.output


def all_drawn(tab: Any) -> None:
    """Wait until every tile that the camera asks for is there and drawn."""
    tab.wait_for_selector("canvas[data-loading='0']")
    tab.wait_for_timeout(400)
    settle(tab)


def test_points_and_lines_are_drawn_switched_off_and_coloured(page, address):
    started = time.monotonic()
    open_view(page, address)
    page.wait_for_selector(f'html[data-lines="{LINE_COUNT}"]', state="attached")
    page.wait_for_selector("canvas[data-points]:not([data-points='0'])")
    took = time.monotonic() - started
    print(f"first view with {POINT_COUNT} points, {LINE_COUNT} lines: {took:.1f} s (software GL, settled)")
    all_drawn(page)
    on = screenshot(page)
    assert sandy(on) > 3_000
    assert pixels_of(on, LINE) > 300
    page.click("label:has(#points)")
    settle(page)
    without = screenshot(page)
    assert sandy(without) < sandy(on) / 5 and pixels_of(without, LINE) > 300
    assert page.get_attribute("canvas", "data-points") == "0"
    page.keyboard.press("2")
    settle(page)
    assert pixels_of(screenshot(page), LINE) == 0
    page.wait_for_url("**points=0&lines=0**")  # of two choices in one go the second is written when they rest
    page.keyboard.press("1")
    page.keyboard.press("2")
    settle(page)
    again = screenshot(page)
    assert sandy(again) > 3_000 and pixels_of(again, LINE) > 300
    page.evaluate("location.hash += '&colours=safe'")  # of older links: there are no others any more
    page.keyboard.press("2")
    page.wait_for_url(lambda url: "lines=0" in url and "colours" not in url)


#: Pans to and fro, a step per frame: the numbers of points that were drawn.
PAN = """async () => {
  const canvas = document.querySelector('canvas'), points = [];
  for (let i = 0; i < 24; i++) {
    canvas.dispatchEvent(new KeyboardEvent('keydown', { key: i % 2 ? 'ArrowRight' : 'ArrowLeft', bubbles: true }));
    await new Promise((done) => requestAnimationFrame(done));
    points.push(Number(canvas.dataset.points));
  }
  return points;
}"""


@pytest.mark.release
def test_a_moving_picture_is_light_and_at_rest_it_is_whole_again(page, address):
    open_view(page, address)
    page.wait_for_selector("canvas[data-points]:not([data-points='0'])")
    all_drawn(page)
    before, count = screenshot(page), int(page.get_attribute("canvas", "data-points"))
    moving = page.evaluate(PAN)
    assert min(moving) < count  # without a graphics card, all points would take too long
    page.wait_for_timeout(400)
    all_drawn(page)
    assert int(page.get_attribute("canvas", "data-points")) == count
    assert (np.abs(screenshot(page) - before).max(axis=2) > 8).mean() < 0.001


def test_the_preset_of_the_paper_is_one_click_and_a_link(page, address, features):
    """Figure 6 of Lagahit & Tseng: LiDAR red, lane boundaries green, the new cone blue, before beside after."""
    open_view(page, address)
    page.click(".map-tools button:text-is('Layers')")
    page.click("#paper")
    page.wait_for_selector("canvas[data-swipe='split']")
    page.click(".map-tools button:text-is('Layers')")
    all_drawn(page)
    shown = screenshot(page)
    before, after = np.split(shown[:, : shown.shape[1] // 2 * 2], 2, axis=1)
    for half in (before, after):
        red, green, blue = np.moveaxis(half, 2, 0)
        assert ((red - green > 50) & (red - blue > 50)).sum() > 1_000
        assert pixels_of(half, PAPER_LINE) > 100 > sandy(half) and pixels_of(half, LINE) == 0
    assert pixels_of(before, PAPER_NEW) == 0 and pixels_of(after, PAPER_NEW) > 40
    click_cone(page, features["comes"])  # it stands in the right half
    page.wait_for_selector(f".panel h2:text-is('{features['comes'][:8]}')")
    page.keyboard.press("Escape")
    link = page.url
    assert "mode=compare" in link and "swipe=split" in link and "look=paper" in link
    page.goto("about:blank")
    page.goto(link)
    page.wait_for_selector("canvas[data-swipe='split']")
    all_drawn(page)
    again = screenshot(page)
    assert pixels_of(again[:, again.shape[1] // 2 :], PAPER_NEW) > 40
    x, y = page.evaluate("id => window.conetlProject(id)", features["goes"])
    page.click("canvas", position={"x": x - again.shape[1] / 2, "y": y})  # where it stood before
    page.wait_for_selector(f".panel h2:text-is('{features['goes'][:8]}')")
    page.keyboard.press("Escape")
    page.click(".map-tools button:text-is('Layers')")
    page.click("#paper")
    page.wait_for_function("() => !/paper|swipe|mode/.test(location.hash)")
    all_drawn(page)
    assert sandy(screenshot(page)) > 1_000


@pytest.mark.release
def test_points_are_lit_by_depth_and_cones_stay_before_them(page, address, features):
    open_view(page, f"{address}#map=default&mode=drive&size=2")
    all_drawn(page)
    flat = screenshot(page)
    page.click(".map-tools button:text-is('Layers')")
    page.check("#shading")
    page.wait_for_url("**shading=1**")
    page.click(".map-tools button:text-is('Layers')")
    all_drawn(page)
    lit = screenshot(page)
    assert ((flat - lit).min(axis=2) > 40).sum() > 200  # points behind nearer ones are darker
    assert pixels_of(lit, ADDED) == pytest.approx(pixels_of(flat, ADDED), rel=0.2) and pixels_of(lit, LINE) > 200
    click_cone(page, features["comes"])
    page.wait_for_selector(f".panel h2:text-is('{features['comes'][:8]}')")


def test_cones_are_found_among_points_and_each_tile_comes_once(page, address, features):
    asked: list[str] = []
    page.on("request", lambda r: asked.append(r.url) if "/base/tiles/" in r.url else None)
    open_view(page, address)
    all_drawn(page)
    frames = page.get_attribute("canvas", "data-frames")
    page.wait_for_timeout(1_000)
    assert page.get_attribute("canvas", "data-frames") == frames  # nothing is drawn at rest
    click_cone(page, features["comes"])
    page.wait_for_selector(f"h2:text-is('{features['comes'][:8]}')")
    x, y = page.evaluate("id => window.conetlProject(id)", features["stays"])
    print(f"finding the cone under a click: {page.evaluate('([x, y]) => window.conetlPickTime(x, y)', [x, y]):.2f} ms")
    assert int(page.get_attribute("canvas", "data-points")) <= 1_000_000
    before = len(asked)
    for _ in range(6):
        page.keyboard.press("-")
    all_drawn(page)
    assert before <= len(asked) <= before + 40  # tiles of the surroundings
    assert len(set(asked)) == len(asked) > 0
