"""Differences from plans in a real Chromium: the three worst of last night with reasons and images, verdicts, small screens."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import SecretStr

from conetl.pipeline.maps.planned_zones import compare_with_plans, import_plans
from conetl.pipeline.settings import Settings
from conetl.readers.plans import read_plans
from conetl.web.decisions import Writer
from tests.browser.test_list_view import AXE
from tests.browser.test_review_view import SIZES, TOKEN
from tests.integration.drives_of_days import DAY_NS, merge, survey_of
from tests.integration.test_planned_zones import line, permit
from tests.synthetic.world import START_NS, Cone
from tests.view_map import serving, with_images

#: Along the road: one stands in its place, one 30 m from its plan, one longer than permitted, one without a permit.
ZONES = {"in place": (14.0, 6), "elsewhere": (52.0, 6), "longer": (92.0, 9), "none": (182.0, 6)}


@pytest.fixture(scope="module")
def address(
    module_database_url: str, conn: Any, images: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[str]:
    cones = [Cone((start + 3.0 * k, 3.6, 0.0), height_m=0.7) for start, count in ZONES.values() for k in range(count)]
    for day in range(2):
        first_ns = START_NS + day * DAY_NS
        rng = np.random.default_rng(day)
        found = survey_of(cones, rng, f"night_{day}", frames=255, start_m=-50.0, first_ns=first_ns)
        found = found._replace(drive=with_images(found.drive, found.detections, images / f"night_{day}"))
        merge(conn, found)
    conn.commit()
    features = [
        permit("in place", line((10.0, 34.0), y_m=4.0)), permit("elsewhere", line((52.0, 68.0), y_m=30.0)),
        permit("longer", line((92.0, 96.0), y_m=4.0)), permit("empty", line((-45.0, -32.0), y_m=-4.0)),
        permit("aside", line((20.0, 40.0), y_m=400.0)),
    ]  # fmt: skip
    folder = tmp_path_factory.mktemp("plans")
    file = folder / "permits.geojson"
    file.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    import_plans(conn, file, read_plans(file), map_name="default", list_name="permits")
    conn.commit()
    writer = Writer(SecretStr(TOKEN), module_database_url, Settings(home=folder))
    with serving(module_database_url, "default", writer=writer) as port:
        yield f"http://127.0.0.1:{port}/"


def rows(conn: Any) -> list[Any]:
    conn.rollback()
    found = compare_with_plans(conn, map_name="default").worst_first
    conn.rollback()
    return found


def opened(page: Any, address: str) -> None:
    page.goto(address)
    page.wait_for_selector("canvas[data-frames]")
    page.wait_for_selector("[data-queue=differences]:visible")
    page.evaluate("t => { sessionStorage['conetl writer token'] = t; sessionStorage['conetl name'] = 'Ada'; }", TOKEN)


def shown(page: Any) -> tuple[str, str, int]:
    """Question, reason and number of images of the item that is shown, once its images are there."""
    page.wait_for_function(
        "() => document.querySelector('.review-images img')?.complete && !document.querySelector('.viewer.busy')"
    )
    count = page.locator(".review-images .pane:not([hidden]) img").count()
    return page.inner_text(".review-head h2"), page.inner_text(".review-head .why"), count


def test_the_three_worst_of_last_night_why_and_their_images_in_three_interactions(page, address, conn):
    expected = rows(conn)
    assert [str(row.difference.kind) for row in expected] == [
        "found without permit", "elsewhere", "longer", "permitted but not found",
    ]  # fmt: skip
    opened(page, address)
    page.click("[data-queue=differences]")  # 1
    found = [shown(page)]
    for _ in range(2):
        page.keyboard.press("ArrowDown")  # 2, 3
        page.wait_for_function("q => document.querySelector('.review-head h2').textContent !== q", arg=found[-1][0])
        found.append(shown(page))
    for (question, why, images), row in zip(found, expected, strict=False):
        assert question.lower() == row.difference.kind and row.difference.text in why and images >= 1
        assert "Sure that it differs: >99 %" in why and "Seen from 2026-03-0" in why
    assert "26 m from the permitted place" in found[1][1] and "plan elsewhere" in found[1][1].lower()
    assert page.inner_text(".review-items h3 >> nth=0") == "Last night"
    assert page.locator(".viewer-text").inner_text().startswith("night_1"), "the last drive that found it"
    assert page.evaluate("document.documentElement.dataset.differences") >= "3"


def test_a_person_judges_and_opens_again(page, address, conn, tmp_path):
    opened(page, address)
    page.keyboard.press("d")
    first = rows(conn)[0].difference.difference_id
    shown(page)
    page.keyboard.press("n")
    page.keyboard.type("emergency works")
    page.keyboard.press("Enter")
    page.keyboard.press("a")
    page.wait_for_selector(".review-items li:has-text('accepted ✓')")
    [judged] = [row for row in rows(conn) if row.difference.difference_id == first]
    assert (judged.verdict, judged.note, judged.decided_by, judged.rank) == ("accepted", "emergency works", "Ada", 4)
    page.reload()
    page.wait_for_selector(".review-items h3:has-text('Judged')")
    page.click(".review-items li:has-text('accepted ✓') button")
    page.wait_for_selector(".review-head .why:has-text('Accepted by Ada: emergency works')")
    page.keyboard.press("o")
    page.wait_for_selector(".review-items h3:has-text('Judged')", state="detached")
    assert {row.verdict for row in rows(conn)} == {"open"}
    page.keyboard.press("Escape")
    page.wait_for_selector(".review-head", state="hidden")
    page.keyboard.press("Home")
    page.wait_for_timeout(500)
    page.screenshot(path=str(tmp_path / "map.png"))
    assert page.get_attribute("[data-queue=differences] .badge", "data-count") == "4"


@pytest.mark.release
def test_it_fits_small_screens_without_axe_findings_in_light_and_dark(browser, address, tmp_path):
    for theme in ("light", "dark"):
        for width, height in SIZES:
            page = browser.new_page(viewport={"width": width, "height": height}, color_scheme=theme)
            opened(page, address)
            page.keyboard.press("d")
            shown(page)
            for box in page.locator(".review-buttons button, .review-head button").evaluate_all(
                "all => all.map(b => b.getBoundingClientRect()).map(b => [b.left, b.top, b.right, b.bottom])"
            ):
                assert box[0] >= 0 and box[1] >= 0 and box[2] <= width and box[3] <= height, (width, box)
            assert not page.evaluate("() => document.documentElement.scrollWidth > innerWidth")
            if AXE.exists():
                page.evaluate(AXE.read_text())
                problems = page.evaluate(
                    "() => axe.run(document).then(r => r.violations.map(v => [v.id, v.nodes[0].html]))"
                )
                assert problems == [], (theme, width)
            page.screenshot(path=str(tmp_path / f"{theme}_{width}.png"))
            page.close()
