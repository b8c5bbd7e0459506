"""Judging a change in a real Chromium: its images, why it happened, the state of the chosen time, and the review queue."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import numpy as np
import pytest
from pydantic import SecretStr

from conetl.db.map.decision_store import list_decisions
from conetl.pipeline.settings import Settings
from conetl.web.decisions import Writer
from tests.integration.drives_of_days import merge, survey
from tests.view_map import serving, with_images

AXE = Path(__file__).resolve().parents[2] / "web/node_modules/axe-core/axe.min.js"
TOKEN = "a-token-that-nobody-guesses"
HOLD = "GNSS/INS jumps by 5.0 m."


def merge_days(conn: Any, images: Path, map_name: str = "default") -> None:
    """Two days of a road with images on disk, and a drive on hold without."""
    for day in (0, 1):
        found = survey(day)
        drive = with_images(found.drive, found.detections, images / f"day_{day}")
        merge(conn, found._replace(drive=drive), map_name=map_name)
    merge(conn, survey(2), map_name=map_name, hold=HOLD)
    conn.commit()


@pytest.fixture(scope="module")
def settings(tmp_path_factory: pytest.TempPathFactory) -> Settings:
    return Settings(home=tmp_path_factory.mktemp("home"))


@pytest.fixture(scope="module")
def address(module_database_url: str, conn: Any, images: Path, settings: Settings) -> Iterator[str]:
    merge_days(conn, images)
    writer = Writer(SecretStr(TOKEN), module_database_url, settings)
    with serving(module_database_url, "default", writer=writer) as port:
        yield f"http://127.0.0.1:{port}/"


@pytest.fixture(scope="module")
def changed(address: str, browser: Any) -> dict[str, str]:
    """Ids of features by what the second drive did to them."""
    tab = browser.new_page()
    tab.goto(f"{address}api/maps/default/changes/view?changeset_no=2")
    found = tab.evaluate("() => JSON.parse(document.body.innerText).changes.map(c => [c.kind, c.feature_id])")
    tab.close()
    return dict(found)


def open_cone(page: Any, address: str, feature_id: str, state: str = "changeset=2") -> None:
    page.goto("about:blank")  # else the address changes without a load
    page.goto(f"{address}#map=default&{state}&feature={feature_id}")
    page.wait_for_selector(f".panel h2:text-is('{feature_id[:8]}')")


def frame_of(page: Any) -> int:
    return int(page.get_attribute(".viewer", "data-frame").split()[-1])


def test_a_removed_cone_shows_its_empty_position_and_why(page, address, changed):
    open_cone(page, address, changed["removed"])
    page.wait_for_selector(".panel-images .pane >> nth=1 >> path.cone.dashed")
    why = page.locator(".panel .why").inner_text()
    assert why.startswith(f"Removed: drive {survey(1).drive.drive_id} passed at ") and "none showed a cone" in why
    frames = page.locator(".viewer-ticks .empty").count()
    assert (
        f"visible in {frames} frame pair" in why
        or f"visible in {frames + 1} " in why
        or f"visible in {frames - 1} " in why
    )
    captions = page.locator(".panel-images figcaption").all_inner_texts()
    assert [text.split(" · ")[0] for text in captions] == ["before", "this drive"]
    nearest = frame_of(page)
    page.keyboard.press("i")
    page.wait_for_selector(".viewer:modal figcaption:text-is('right')")
    assert frame_of(page) == nearest and page.locator(".viewer path.cone.dashed").count() == 2
    assert page.locator(".viewer .pane img").evaluate_all(
        "all => all.every(i => i.naturalWidth === i.width && i.width > 300)"
    )
    assert "no cone observed" in page.locator(".viewer-text").inner_text()
    page.keyboard.press("c")  # beside the drive before, which observed it
    page.wait_for_selector(".viewer .pane >> nth=3")
    assert "before: " in page.locator(".viewer figcaption >> nth=0").inner_text()
    page.wait_for_selector(".viewer .pane >> nth=0 >> path.box.chosen")
    page.keyboard.press("Escape")
    page.wait_for_selector(".viewer:modal", state="detached")
    assert page.locator(".panel h2").is_visible(), "Escape closes the images only"


@pytest.mark.release
def test_before_and_after_are_a_swipe_that_keys_move(page, address, changed):
    open_cone(page, address, changed["removed"])
    page.wait_for_selector(".panel-images .pane >> nth=1 >> path.cone.dashed")
    page.check(".wipe-on")
    page.wait_for_selector(".pair")

    def visible_before() -> float:
        """Right edge of the image before, as a share of the image."""
        box, clip = page.locator(".pair > :first-child").first.evaluate(
            "n => [n.clientWidth, getComputedStyle(n).clipPath]"
        )
        cut = re.fullmatch(r"inset\(0px (\d+)%? 0px 0px\)", clip)
        assert box > 300 and cut, clip
        return 1 - float(cut[1]) / 100

    assert visible_before() == 0.5
    before, now = (page.locator(f".pair > .pane:nth-child({i})") for i in (1, 2))
    assert before.bounding_box() == now.bounding_box()  # one over the other
    assert (
        "before" in before.locator("figcaption").inner_text() and "this drive" in now.locator("figcaption").inner_text()
    )
    frame = frame_of(page)
    page.focus(".wipe")
    page.keyboard.press("End")
    assert visible_before() == 1.0
    page.keyboard.press("Home")
    page.keyboard.press("ArrowRight")
    assert visible_before() == pytest.approx(0.01) and frame_of(page) == frame
    page.keyboard.press("i")
    page.wait_for_selector(".viewer:modal")
    page.keyboard.press("c")
    page.wait_for_selector(".viewer:modal .pair >> nth=1")
    page.focus(".wipe")
    page.keyboard.press("ArrowRight")
    assert visible_before() == pytest.approx(0.02) and frame_of(page) == frame
    if AXE.is_file():
        page.evaluate(AXE.read_text())
        assert page.evaluate("() => axe.run().then((r) => r.violations.map((v) => [v.id, v.nodes[0].html]))") == []
    page.keyboard.press("v")
    page.wait_for_selector(".pair", state="detached")
    assert page.locator(".viewer .pane").count() == 4
    page.keyboard.press("Escape")


def camera_of(page: Any) -> tuple[np.ndarray, np.ndarray]:
    """Position and direction of the map's camera, of the address."""
    x, y, z, theta, phi, radius = map(float, parse_qs(urlsplit(page.url).fragment)["cam"][0].split(","))
    back = np.array([np.sin(phi) * np.sin(theta), -np.sin(phi) * np.cos(theta), np.cos(phi)])
    return np.array([x, y, z]) + radius * back, -back


def image_pose(page: Any, changeset: int) -> tuple[np.ndarray, np.ndarray]:
    """Position and axis of the left image of the frame pair that is shown."""
    frame = page.evaluate(
        """async ([no, index]) => {
          const read = (path) => fetch(`./api/maps/default/${path}`).then((r) => r.json());
          const { drive_uuid } = (await read('timeline')).changesets.find((t) => t.changeset_no === no);
          return (await read(`drives/${drive_uuid}/frames/${index}`)).left;
        }""",
        [changeset, frame_of(page)],
    )
    return np.array(frame["xyz_m"]), np.array(frame["map_R_camera"])[:, 2]


@pytest.mark.release
def test_the_maps_camera_follows_the_image_along_the_drive(page, address, changed):
    open_cone(page, address, changed["moved"])
    page.wait_for_selector(".panel-images .pane img")
    page.wait_for_url("**cam=**")
    before, _ = camera_of(page)
    page.check("#follow")
    page.wait_for_url("**follow=1**")
    for key in ("n", "n", "p"):
        xyz_m, axis = image_pose(page, 2)
        page.wait_for_timeout(300)  # the address follows the camera
        at, direction = camera_of(page)
        assert np.linalg.norm(at - xyz_m) < 0.02 < np.linalg.norm(at - before)
        assert direction @ axis > np.cos(np.radians(1.0))
        frame = frame_of(page)
        page.keyboard.press(key)
        page.wait_for_function("f => !document.querySelector('.viewer').dataset.frame.endsWith(` ${f}`)", arg=frame)
    link = page.url
    page.goto("about:blank")
    page.goto(link)
    page.wait_for_selector("#follow:checked")
    page.click("canvas", position={"x": 300, "y": 60})  # a key of the map
    page.keyboard.press("f")
    page.wait_for_url(lambda url: "follow" not in url)


@pytest.mark.release
def test_the_images_are_zoomed_panned_and_played(page, address, changed):
    open_cone(page, address, changed["moved"])
    page.wait_for_selector(".panel-images .pane img")
    page.click(".panel-images .enlarge")
    page.wait_for_selector(".viewer:modal figcaption:text-is('right')")
    first = frame_of(page)
    assert page.locator(".viewer path.box.chosen").count() == 2
    assert page.locator(".viewer path.cone.old").count() > 0, "the position before the move is outlined"
    image = page.locator(".viewer .pane img >> nth=0")
    before = image.evaluate("i => i.style.transform")
    page.mouse.move(400, 250)
    page.mouse.wheel(0, -2000)
    page.wait_for_function("() => Number(document.querySelector('.viewer').dataset.scale) > 3")
    assert image.evaluate("i => getComputedStyle(i).imageRendering") == "pixelated"
    zoomed = image.evaluate("i => i.style.transform")
    page.mouse.down()
    page.mouse.move(460, 290)
    page.mouse.up()
    assert len({before, zoomed, image.evaluate("i => i.style.transform")}) == 3
    page.keyboard.press("0")
    assert page.get_attribute(".viewer", "data-scale") == "fit"
    page.mouse.click(400, 250)  # selects a point: its line is in the other image
    line = page.locator(".viewer .pane >> nth=1 >> path.epipolar")
    rows = {float(part.split()[1]) for part in line.get_attribute("d").replace("M", "L").split("L")[1:]}
    assert max(rows) - min(rows) < 1, "rows of a rectified pair are equal"
    page.keyboard.press("ArrowRight")
    page.wait_for_function(
        "f => Number(document.querySelector('.viewer').dataset.frame.split(' ').at(-1)) === f", arg=first + 1
    )
    page.keyboard.press(" ")
    page.wait_for_function(
        "f => Number(document.querySelector('.viewer').dataset.frame.split(' ').at(-1)) > f + 2", arg=first
    )
    page.keyboard.press("1")
    page.wait_for_function("() => document.querySelectorAll('.viewer .pane').length === 1")


def test_a_missing_image_is_named(page, address, changed, images):
    hidden = (images / "day_1").rename(images / "away")
    try:
        open_cone(page, address, changed["confirmed"])
        page.wait_for_selector(".viewer .pane-problem:visible")
        page.keyboard.press("i")
        page.wait_for_selector(".viewer .pane-problem:visible >> nth=1")
        assert "is missing: restore the drive to" in page.locator(".viewer .pane-problem >> nth=0").inner_text()
        assert page.locator(".viewer path.box").count() > 0, "boxes and outlines are drawn all the same"
    finally:
        hidden.rename(images / "day_1")


def test_the_state_of_the_chosen_time_is_everywhere(page, address, changed):
    first, second = (survey(day).drive.captured_from for day in (0, 1))
    east = "() => document.querySelector('.panel dd .mono').textContent"
    open_cone(page, address, changed["moved"])
    page.wait_for_selector(".panel .chip.kind:text('moved')")
    after = page.evaluate(east)
    between = f"mode=instant&valid={second:%Y-%m-%dT00:00:00Z}"
    for state, chip in (
        (between, "standing"),
        ("mode=compare&from=0&to=1", "added"),
        ("changeset=2&side=before", "standing"),
    ):
        open_cone(page, address, changed["moved"], state)
        page.wait_for_selector(f".panel .chip.kind:text('{chip}')")
        assert page.evaluate(east) != after and page.locator(".panel .why").inner_text().startswith("Added: "), state
        page.wait_for_selector(f".viewer-text:has-text('{survey(0).drive.drive_id}')")
    open_cone(page, address, changed["moved"], f"mode=instant&valid={first:%Y-%m-%dT00:00:00Z}")
    page.wait_for_selector(".panel .chip.kind:text('not on the map yet')")
    assert "added it." in page.locator(".panel .notice").inner_text()
    open_cone(page, address, changed["removed"], "mode=instant")
    page.wait_for_selector(".panel .chip.kind:text('removed')")
    open_cone(page, address, changed["moved"], "changeset=99")
    page.wait_for_selector(".card:has-text('has no changeset 99')")


def fill_form(page: Any, reason: str) -> None:
    page.wait_for_selector("form.decide")
    page.fill("form.decide [name=name]", "Ada")
    page.fill("form.decide [name=reason]", reason)
    page.fill("form.decide [name=token]", TOKEN)
    page.keyboard.press("Enter")


@pytest.mark.release
def test_a_decision_keeps_the_panel_its_images_and_renews_the_chip(page, address, changed, conn):
    open_cone(page, address, changed["confirmed"])
    page.wait_for_selector(".panel-images .pane img")
    page.evaluate("() => { window.held = document.querySelector('.panel-images .pane img'); }")
    page.click(".decide-section button:text('Pin')")
    fill_form(page, "on the kerb")
    page.wait_for_selector(".panel .chip.pinned")
    page.wait_for_timeout(300)
    assert page.evaluate("() => window.held.isConnected && window.held.getBoundingClientRect().width > 50")
    page.keyboard.press("Escape")
    conn.rollback()
    assert [d.kind for d in list_decisions(conn) if d.kind != "hold"] == ["pin"]
