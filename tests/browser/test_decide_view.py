"""Decisions from the panel and news without a reload, in a real Chromium."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pydantic import SecretStr
from pyproj import Transformer
from typer.testing import CliRunner

from conetl.cli.app import app as command_line
from conetl.db.connection import execute
from conetl.db.map.decision_store import list_decisions
from conetl.db.map.map_store import list_changesets, read_current_features
from conetl.pipeline.maps.decisions import PIN, decide_location, revert
from conetl.web.decisions import Writer
from tests.browser.test_view import click_cone, legend_becomes, settle
from tests.chromium import HTML, HTML_NAME, nothing_of_html_happens
from tests.integration.drives_of_days import merge, survey
from tests.unit.readers.test_base_layers import geojson, line
from tests.view_map import serving

TOKEN = "a-token-that-nobody-guesses"


@pytest.fixture(scope="module")
def address(module_database_url: str, conn: Any) -> Iterator[str]:
    merge(conn, survey(0))
    writer = Writer(SecretStr(TOKEN), module_database_url)
    with serving(module_database_url, "default", writer=writer) as port:
        yield f"http://127.0.0.1:{port}/"


@pytest.fixture
def page(browser: Any, address: str) -> Iterator[Any]:
    """Refused requests are logged by the browser itself: only errors of the page's own script fail here."""
    tab = browser.new_page(viewport={"width": 1280, "height": 800})
    problems: list[str] = []
    tab.on("pageerror", lambda e: problems.append(str(e)))
    tab.on("request", lambda r: problems.append(r.url) if TOKEN in r.url else None)
    tab.goto(f"{address}#mode=drive")
    tab.wait_for_selector(".status[data-status=live]")
    tab.wait_for_selector("canvas[data-frames]")
    settle(tab)
    yield tab
    tab.close()
    assert problems == []


def the_one(conn: Any, number: int) -> str:
    conn.rollback()
    return str(sorted(read_current_features(conn), key=lambda f: f.xyz_m)[number].feature_id)


def fill_form(
    page: Any, button: str, reason: str, *, token: str | None = None, within: str = ".decide-section"
) -> None:
    """By keyboard alone, from the button on."""
    page.focus(f"{within} button:text('{button}')")
    page.keyboard.press("Enter")
    page.wait_for_selector("form.decide")
    name = page.locator("form.decide [name=name]")
    if not name.input_value():
        page.keyboard.type("Ada Müller")
        page.keyboard.press("Tab")
    page.keyboard.type(reason)
    if token is not None:
        page.fill("form.decide [name=token]", token)
    page.focus("form.decide button[type=submit]")
    page.keyboard.press("Enter")


def test_a_cone_is_suppressed_and_comes_back(page, conn):
    one = the_one(conn, 2)
    click_cone(page, one)
    page.wait_for_selector(f"h2:text-is('{one[:8]}')")
    fill_form(page, "Suppress", "a bollard", token="not-the-writers-token")
    page.wait_for_selector(".decide-status.bad >> text=Nothing was written. The writer token is missing")
    assert page.evaluate("sessionStorage.length") == 0
    assert list_decisions(conn) == []
    page.fill("form.decide [name=token]", TOKEN)
    page.keyboard.press("Enter")
    page.wait_for_selector(".decide-status.good >> text=Suppressed. 1 feature version written")
    page.wait_for_selector(".legend label[data-kind=suppressed]")
    assert page.locator(".decide-section .decision").inner_text().startswith("Suppressed by Ada Müller: a bollard")
    assert page.locator(".decisions .decision-row").count() == 1
    conn.rollback()
    [decision] = list_decisions(conn)
    assert (decision.kind, decision.decided_by, decision.note) == ("suppress", "Ada Müller", "a bollard")
    count = len(read_current_features(conn))
    page.click("text=The road")
    page.wait_for_selector(f'html[data-cones="{count}"]', state="attached")
    page.click("text=Drive by drive")
    page.wait_for_selector(".legend label[data-kind=suppressed]")
    assert TOKEN not in page.url + page.content()
    fill_form(page, "Withdraw", "it is a cone")  # name and token are known by now
    page.wait_for_selector(".decide-status.good >> text=Withdrawn.")
    page.wait_for_selector(".legend label[data-kind=suppressed]", state="detached")
    conn.rollback()
    assert list_decisions(conn) == [] and one in {str(f.feature_id) for f in read_current_features(conn)}


def test_a_refusal_leaves_the_buttons_of_the_drive_form_free_and_goes_with_it(page):
    fill_form(page, "Revert drive", "wrong calibration", token="not-the-writers-token", within=".drive-decide")
    status = page.locator(".drive-decide .decide-status.bad")
    status.wait_for()
    submit, said = page.locator("form.decide [type=submit]").bounding_box(), status.bounding_box()
    assert submit["y"] + submit["height"] <= said["y"]
    page.keyboard.press("Escape")
    page.wait_for_selector("form.decide", state="detached")
    assert status.is_hidden()


@pytest.mark.release
def test_a_stated_class_shows_on_drives_that_were_committed_before(page, conn):
    assert page.locator(".classes").is_hidden()  # cones alone
    decided = decide_location(conn, "classify", the_one(conn, 4), map_name="default", category="drum")
    page.wait_for_selector(".classes label >> text=Drum")
    page.click("text=The road")
    page.wait_for_selector(".classes label >> text=Drum")
    revert(conn, str(decided.decision_id), map_name="default")
    page.wait_for_selector(".classes", state="hidden")


@pytest.mark.release
def test_a_concurrent_decision_appears_and_is_a_conflict(page, conn):
    one = the_one(conn, 3)
    click_cone(page, one)
    page.wait_for_selector(".decide-section button:text('Pin')")
    page.route("**/events", lambda route: route.abort())
    page.reload()  # this page hears of nothing
    page.wait_for_selector(".decide-section button:text('Pin')")
    conn.rollback()
    decide_location(conn, PIN, one, map_name="default", note="of old", decided_by="Grace")
    fill_form(page, "Pin", "on the kerb", token=TOKEN)
    page.wait_for_selector(".decide-status.bad >> text=There is already a decision to pin this position")
    assert "It is now version 1, added by" in page.locator(".panel .decide-status").inner_text()
    page.wait_for_selector(".decide-section .decision >> text=Pinned by Grace: of old")
    fill_form(page, "Unpin", "done", token=None)
    page.wait_for_selector(".decide-status.good")
    assert page.locator("form.decide").count() == 0
    page.keyboard.press("Escape")
    page.wait_for_selector(".panel", state="hidden")


def test_stored_html_is_text(browser, address, conn, module_database_url, tmp_path: Path):
    """What strangers name and write: drives, files, refused records, decisions, the licence."""
    environment = {
        "CONETL_DATABASE_URL": module_database_url, "CONETL_HOME": str(tmp_path / "home"), "CONETL_MAP_NAME": "hostile",
    }  # fmt: skip

    def conetl(*arguments: object) -> str:
        done = CliRunner().invoke(command_line, list(map(str, arguments)), env=environment)
        assert done.exit_code == 0, done.output
        return done.stdout

    conn.rollback()
    merge(conn, survey(0, name=HTML), map_name="hostile")
    refused = (
        "insert into conetl.quarantine (changeset_id, step, reason, record, detail, payload) "
        "select changeset_id, 'tracks', 'never_near', %(html)s, %(html)s, '{}' from conetl.changeset join conetl.drive using "
        "(drive_uuid) where drive_id = %(html)s"
    )
    execute(conn, refused, {"html": HTML})
    conn.commit()
    one, other = sorted(str(f.feature_id) for f in read_current_features(conn, map_name="hostile"))[:2]
    conn.rollback()
    copied, project, layer = tmp_path / f"{HTML_NAME}.geojson", tmp_path / "map.qgs", tmp_path / "map.geojson"
    conetl("map", "licence", HTML)
    conetl("map", "export", "--out", copied)
    conetl("map", "import", copied)
    conetl("map", "pin", one, "--note", HTML, "--by", HTML)
    conetl("map", "suppress", other, "--note", HTML, "--by", HTML)
    conetl("map", "export", "--out", layer)
    conetl("map", "qgis", "--out", project)
    for path in (layer, project):  # labels and map tips of QGIS may be HTML; in GeoJSON the drive is a value of its own
        rest = path.read_text().replace(f'"drive_id": {json.dumps(HTML)}', "")
        assert "<img" not in rest and "<script" not in rest, path
    night = tmp_path / "night.html"
    conetl("report", "night", "--since", "2000-01-01", "--until", "2100-01-01", "--out", night)

    tab = browser.new_page(viewport={"width": 1280, "height": 800})
    with nothing_of_html_happens(tab):
        tab.goto(f"{address}#map=hostile&mode=drive")
        tab.wait_for_selector("canvas[data-frames]")
        tab.get_by_text(HTML_NAME).first.wait_for()
        for decided in (one, other):
            tab.fill("#search", decided)
            tab.press("#search", "Enter")
            tab.wait_for_selector(f"h2:text-is('{decided[:8]}')")
            tab.locator(".panel").get_by_text(f"by {HTML}: {HTML}").first.wait_for()
        for mode in ("Compare two", "The road", "Drive by drive"):
            tab.click(f"text={mode}")
            settle(tab)
        tab.locator(".changeset-slider").press("ArrowLeft")
        tab.locator(".drive-text strong").get_by_text(HTML_NAME).wait_for()
    of_drive = min(changeset.changeset_no for changeset in list_changesets(conn, map_name="hostile"))
    conn.rollback()
    for page in (f"{address}api/maps/hostile/changesets/{of_drive}/report", night.as_uri()):
        with nothing_of_html_happens(tab):
            tab.goto(page)
            assert HTML_NAME in tab.text_content("body")
    tab.close()


@pytest.mark.release
def test_news_come_without_a_reload(page, conn, module_database_url, tmp_path: Path):
    """Last in this file: a drive, a base layer that comes and goes, a decision made elsewhere. Prints how long each took."""
    page.evaluate("""() => {
        window.notReloaded = true;
        window.seen = {};
        const watch = () => {
            const drive = document.querySelector('.drive-text strong')?.textContent, root = document.documentElement.dataset;
            const frames = document.querySelector('canvas').dataset.frames;
            const gone = document.querySelectorAll('[data-kind=suppressed]').length;
            for (const name of [`drive ${drive}`, `lines ${root.lines}`, `suppressed ${gone}`])
                if (!window.seen[name]) window.seen[name] = { frames };
            for (const seen of Object.values(window.seen)) if (seen.frames !== frames) seen.at ??= Date.now();
        };
        new MutationObserver(watch).observe(document, { subtree: true, attributes: true, childList: true });
    }""")

    def came(name: str, committed: float) -> None:
        at = page.wait_for_function("(name) => window.seen[name]?.at", arg=name, timeout=60_000).json_value()
        print(f"from commit to view, {name}: {at / 1000 - committed:.2f} s")

    second = survey(1)
    conn.rollback()
    merge(conn, second)
    came(f"drive {second.drive.drive_id}", time.time())
    one = the_one(conn, 1)
    conn.rollback()
    decide_location(conn, "suppress", one, map_name="default", note="a bin", decided_by="Grace")
    came("suppressed 1", time.time())
    features = read_current_features(conn)
    east, north = features[0].xyz_m[:2]
    to_wgs84 = Transformer.from_crs(second.drive.map_srid, 4326, always_xy=True)
    points = [[*to_wgs84.transform(east + d, north), features[0].xyz_m[2]] for d in (0, 5)]
    lanes = geojson(tmp_path / "lanes.geojson", line(*points, kind="line_thin"))
    environment = {"CONETL_DATABASE_URL": module_database_url, "CONETL_HOME": str(tmp_path / "home")}
    for command, name in ((["import", str(lanes)], "lines 1"), (["drop", "lanes"], "lines 0")):
        page.evaluate("(name) => { delete window.seen[name]; }", name)
        done = CliRunner().invoke(command_line, ["base", *command], env=environment)
        assert done.exit_code == 0, done.output
        came(name, time.time())
    assert page.evaluate("window.notReloaded") is True


@pytest.mark.release
def test_a_drive_on_hold_is_accepted_and_the_acceptance_withdrawn(page, conn):
    held = survey(2)
    conn.rollback()
    merge(conn, held, hold="GNSS/INS jumps by 5.0 m.")
    conn.commit()
    page.wait_for_selector(".decision-row:has-text('On hold'):has-text('jumps by 5.0 m')")
    page.click(".decision-row:has-text('On hold')")
    page.wait_for_selector(f".drive-text:has-text('{held.drive.drive_id}')")
    assert page.locator(".drive-decide button").all_text_contents() == ["Accept …", "Revert drive …"]
    assert page.locator(".drive-text .hold-reason").inner_text() == "GNSS/INS jumps by 5.0 m."
    assert "jumps by 5.0 m" in (page.locator(".column:has(.held)").get_attribute("title") or "")
    fill_form(page, "Accept", "seen in the images", token=TOKEN, within=".drive-decide")
    page.wait_for_selector(".decision-row:has-text('Accepted')")
    page.wait_for_selector(f".decide-status:has-text('Released: drive {held.drive.drive_id}')")
    page.wait_for_selector(".column .held", state="detached")
    conn.rollback()
    assert [known.counts for known in list_changesets(conn) if known.drive_id == held.drive.drive_id] == [True]
    page.wait_for_selector(".drive-decide button:text('Withdraw')")
    fill_form(page, "Withdraw", "a slip", within=".drive-decide")
    page.wait_for_selector(".decision-row:has-text('On hold')")
    conn.rollback()
    assert [bool(known.hold) for known in list_changesets(conn) if known.drive_id == held.drive.drive_id] == [True]
    if folder := os.environ.get("CONETL_SCREENSHOTS"):
        page.screenshot(path=f"{folder}/hold.png")


def test_a_decision_shows_at_once_in_selector_image_and_lists(page, conn):
    """Of somebody else, while the page shows the road as it opens. Last in this file: the decision stays."""
    count = len(read_current_features(conn))
    page.goto(f"{page.url.partition('#')[0]}#map=default&list=cones")
    page.wait_for_selector(f'html[data-cones="{count}"]', state="attached")
    page.wait_for_selector(f"#map option:text-is('default ({count} features)')", state="attached")
    decide_location(conn, "suppress", the_one(conn, 1), map_name="default", note="a bollard", decided_by="Bo")
    page.wait_for_selector(f'html[data-cones="{count - 1}"]', state="attached")
    page.wait_for_selector(f"#map option:text-is('default ({count - 1} features)')", state="attached")
    page.wait_for_selector(f"#list-cones .table[aria-rowcount='{count}']")
    legend_becomes(page, [f"standing {count - 1}"])
