"""Forty states of the page on three screens, light and dark: nothing overflows, no error, no finding of axe.

Each state is opened on one screen, another one for each; with CONETL_SCREENSHOTS=FOLDER on all six, whose images are written
there, with a contact sheet of each screen, to be looked at.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import laspy
import numpy as np
import pytest
from pydantic import SecretStr
from pyproj import CRS, Transformer
from typer.testing import CliRunner

from conetl.cli.app import app
from conetl.pipeline.settings import Settings
from conetl.web.decisions import Writer
from tests.browser.conftest import page_without_problems
from tests.browser.test_judge_view import AXE, TOKEN, merge_days
from tests.cases import cases
from tests.integration.drives_of_days import survey
from tests.unit.readers.test_base_layers import geojson, line
from tests.view_map import serving

FOLDER = os.environ.get("CONETL_SCREENSHOTS")
#: The last one is the first one at 200 %.
SIZES = {"desk": (1280, 800), "phone": (390, 844), "zoomed": (640, 400)}
SCREENS = [(size, theme) for size in SIZES for theme in ("light", "dark")]
Act = Callable[[Any], None]


def click(selector: str, then: str | None = None) -> Act:
    def act(page: Any) -> None:
        if not page.locator(selector).first.is_visible() and page.locator("button.menu").is_visible():
            page.click("button.menu")
        page.click(selector)
        if then:
            page.wait_for_selector(then)

    return act


def press(*keys: str, then: str | None = None) -> Act:
    def act(page: Any) -> None:
        for key in keys:
            page.keyboard.press(key)
        if then:
            page.wait_for_selector(then)

    return act


def search(text: str, then: str) -> Act:
    def act(page: Any) -> None:
        page.fill("#search", text)
        page.wait_for_selector(then)

    return act


IMAGE = ".panel-images .pane img"
FULL, FOUR = ".viewer:modal .pane img", ".viewer:modal .pane >> nth=3"
#: Name -> address, where {kind} is the id of the cone of which drive 2 says so, and what a person does then.
STATES: dict[str, tuple[str, list[Act]]] = {
    "road now": ("map=default", []),
    "plan": ("map=default&view=plan", []),
    "grid with coordinates": ("map=default&view=plan&grid=labels", []),
    "layers": ("map=default", [click(".map-tools button:text-is('Layers')")]),
    "points by height": ("map=default&colour=height&size=2&shading=1", []),
    "no base layers": ("map=default&points=0&lines=0", []),
    "measure": ("map=default&view=plan", [press("m")]),
    "coordinates": ("map=default&view=plan&at=12,3", []),
    "shortcuts": ("map=default", [press("?", then="dialog.help:modal")]),
    "download": ("map=default", [click("button:text-is('Download')", then="#downloads")]),
    "search": ("map=default", [search("day_", ".search-option")]),
    "share": ("map=default", [click("#share", then=".toast")]),
    "standing cone": ("map=default&feature={confirmed}", []),
    "decide": ("map=default&feature={confirmed}", [click(".decide-section button >> nth=0", then=".decide")]),
    "camera follows": ("map=default&changeset=2&feature={moved}&follow=1", []),
    "cones": ("map=default&list=cones", []),
    "changes": ("map=default&changeset=2&list=changes", []),
    "changes, filter": ("map=default&changeset=2&list=changes", [click("button.filter-more")]),
    "list and cone": ("map=default&changeset=2&list=changes&feature={moved}", []),
    "road then": ("map=default&valid=2026-03-02T12:00:00Z", []),
    "known then": ("map=default&known=1", []),
    "last drive": ("map=default&mode=drive", []),
    "first drive": ("map=default&changeset=1", []),
    "before": ("map=default&changeset=2&side=before", []),
    "after": ("map=default&changeset=2&side=after", []),
    "revert": ("map=default&changeset=2", [click(".drive-decide button >> nth=0", then=".drive-decide .decide")]),
    "removed cone": ("map=default&changeset=2&feature={removed}", []),
    "moved cone": ("map=default&changeset=2&feature={moved}", []),
    "photographs, swipe": ("map=default&changeset=2&feature={moved}", [click(".wipe-on", then=".pair")]),
    "full images": ("map=default&changeset=2&feature={moved}", [press("i", then=FULL)]),
    "full images, compared": ("map=default&changeset=2&feature={moved}", [press("i", then=FULL), press("c", then=FOUR)]),
    "compare": ("map=default&mode=compare&from=1", []),
    "compare, swipe": ("map=default&mode=compare&from=1&to=2&swipe=0.4", []),
    "compare, side by side": ("map=default&mode=compare&from=1&to=2&swipe=split", []),
    "paper": ("map=default&mode=compare&from=1&to=2&swipe=split&look=paper", []),
    "review": ("map=default&list=review", []),
    "review, next": ("map=default&list=review", [press("s")]),
    "kinds hidden": ("map=default&changeset=2&hide=confirmed,moved", []),
    "no such map": ("map=elsewhere", []),
    "no such drive": ("map=default&changeset=77", []),
    "misspelt link": ("map=default&colour=pink&nonsense=1", []),
}  # fmt: skip

#: In every run of the tests; the others show parts of these.
OFTEN = (
    "decide", "camera follows", "full images, compared", "compare, side by side", "misspelt link",
)  # fmt: skip


@pytest.fixture(scope="module")
def address(
    module_database_url: str, conn: Any, images: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[str]:
    """Three days of a road between walls of LiDAR points, with lane boundaries; decisions are accepted."""
    folder = tmp_path_factory.mktemp("base")
    merge_days(conn, images)
    environment = {"CONETL_DATABASE_URL": module_database_url, "CONETL_HOME": str(folder / "home")}
    result = CliRunner().invoke(app, ["base", "import", *map(str, street(folder))], env=environment)
    assert result.exit_code == 0, result.output
    writer = Writer(SecretStr(TOKEN), module_database_url, Settings(home=folder))
    with serving(module_database_url, "default", writer=writer) as port:
        yield f"http://127.0.0.1:{port}/"


def street(folder: Path) -> tuple[Path, Path]:
    """Points and lane boundaries around the surveyed cones."""
    cones_m = np.array([p.xyz_m for p in survey(0).positions])
    (west, south, ground), (east, north, _) = cones_m.min(0), cones_m.max(0)
    rng = np.random.default_rng(1)
    count = 100_000
    points_m = np.column_stack([
        rng.uniform(west - 40, east + 40, count), rng.uniform(south - 20, north + 20, count), ground + rng.normal(0, 0.01, count)
    ])  # fmt: skip
    walls = np.arange(count) % 3 == 0
    points_m[walls, 1] = np.where(rng.random(walls.sum()) < 0.5, north + 12, south - 12)
    points_m[walls, 2] = ground + rng.uniform(0, 6, walls.sum())
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = [0.001] * 3, [round(west), round(south), 100.0]
    header.add_crs(CRS.from_epsg(32632))
    las = laspy.LasData(header)
    las.x, las.y, las.z = points_m.T
    las.intensity = rng.integers(0, 255, count)
    las.write(folder / "street.laz")
    to_wgs84 = Transformer.from_crs(32632, 4326, always_xy=True)
    kinds = {south - 5: "line_thin", south - 1.5: "line_dashed", north + 2: "line_thin", north + 5: "curb"}
    lines = [
        line(*([*to_wgs84.transform(x, y), float(ground)] for x in (west - 30, east + 30)), kind=kind)
        for y, kind in kinds.items()
    ]
    return folder / "street.laz", geojson(folder / "lanes.geojson", *lines)


@pytest.fixture(scope="module")
def ids(browser: Any, address: str) -> dict[str, str]:
    tab = browser.new_page()
    tab.goto(f"{address}api/maps/default/changes/view?changeset_no=2")
    found = tab.evaluate("() => JSON.parse(document.body.innerText).changes.map(c => [c.kind, c.feature_id])")
    tab.close()
    return dict(found)


@pytest.fixture(scope="module")
def sheets() -> Iterator[dict[str, list[np.ndarray]]]:
    """Small images of each screen, which are written side by side."""
    made: dict[str, list[np.ndarray]] = {}
    yield made
    for screen, images in made.items():
        rows = [images[k : k + 7] for k in range(0, len(images), 7)]
        rows[-1] += [np.zeros_like(images[0])] * (7 - len(rows[-1]))
        assert cv2.imwrite(
            str(Path(FOLDER or ".") / f"sheet_{screen}.png"), np.vstack([np.hstack(row) for row in rows])
        )


def loaded(page: Any) -> None:
    page.wait_for_selector("canvas[data-frames], .card:not(.busy)", state="attached")
    page.wait_for_function(
        "() => document.querySelector('.progress').hidden && !document.querySelector('.viewer.busy')"
    )
    page.wait_for_timeout(400)


@pytest.mark.parametrize("name", cases(*OFTEN, release=[name for name in STATES if name not in OFTEN]))
def test_a_state_of_the_page_on_every_screen(browser, address, ids, sheets, name):
    fragment, acts = STATES[name]
    at = list(STATES).index(name)
    first, *others = SCREENS if FOLDER else [SCREENS[at % len(SCREENS)]]
    with page_without_problems(browser, address) as page:
        show_on(page, first)
        page.goto(f"{address}#{fragment.format(**ids)}")
        loaded(page)
        if "feature=" in fragment:
            page.wait_for_selector(IMAGE)
        if "list=review" in fragment:
            page.wait_for_selector(".review-items [aria-current=true]")
        for act in acts:
            act(page)
        look(page, sheets, f"{at:02d} {name}", first)
        for screen in others:  # the window is resized, and the system's theme changes
            show_on(page, screen)
            look(page, sheets, f"{at:02d} {name}", screen)


def show_on(page: Any, screen: tuple[str, str]) -> None:
    width, height = SIZES[screen[0]]
    page.set_viewport_size({"width": width, "height": height})
    page.emulate_media(color_scheme=screen[1])


def look(page: Any, sheets: dict[str, list[np.ndarray]], name: str, screen: tuple[str, str]) -> None:
    loaded(page)
    width, height = SIZES[screen[0]]
    assert not page.evaluate("() => document.documentElement.scrollWidth > innerWidth"), (name, screen)
    if name[3:] in ("road now", "last drive", "compare"):
        box = page.locator("main.view").bounding_box()
        assert box["width"] * box["height"] > 0.35 * width * height, (name, screen)
    if FOLDER:
        path = Path(FOLDER) / f"{name}_{'_'.join(screen)}.png".replace(", ", "_").replace(" ", "_")
        image = cv2.imdecode(np.frombuffer(page.screenshot(path=str(path)), np.uint8), cv2.IMREAD_COLOR)
        small = cv2.resize(image, (420, round(420 * height / width)), interpolation=cv2.INTER_AREA)
        sheets.setdefault("_".join(screen), []).append(small)
    if AXE.is_file():
        page.evaluate(AXE.read_text())  # by the debugger: the page's policy admits no other script
        found = page.evaluate("() => axe.run().then(r => r.violations.map(v => [v.id, v.nodes[0].html.slice(0, 200)]))")
        assert found == [], (name, screen)
