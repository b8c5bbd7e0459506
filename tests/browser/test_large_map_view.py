"""A map that is too large to be drawn cone by cone: clusters with their numbers, all cones where the view is near, and a list."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from benchmarks.made_up_maps import make_closures
from tests.browser.conftest import page_without_problems
from tests.browser.test_view import legend_becomes, settle
from tests.view_map import serving

COUNT = 30_000
#: The cluster nearest to the middle of the view.
NEAREST = """() => {
  const middleOf = (node) => {
    const box = node.getBoundingClientRect();
    return [box.left + box.width / 2, box.top + box.height / 2];
  };
  const [x, y] = middleOf(document.querySelector('main.view'));
  const spots = [...document.querySelectorAll('.cluster:not([hidden])')].map(middleOf);
  return spots.sort((a, b) => Math.hypot(a[0] - x, a[1] - y) - Math.hypot(b[0] - x, b[1] - y))[0];
}"""
NUMBERS = "() => [document.documentElement.dataset.cones, document.documentElement.dataset.clustered]"


@pytest.fixture(scope="module")
def address(module_database_url: str, conn: Any) -> Iterator[str]:
    make_closures(conn, "default", features=COUNT)
    with serving(module_database_url, "default") as port:
        yield f"http://127.0.0.1:{port}/"


def drawn(page: Any) -> tuple[int, int]:
    """Number of cones that are drawn one by one, and in clusters."""
    cones, clustered = page.evaluate(NUMBERS)
    return int(cones), int(clustered)


def test_numbers_of_clusters_and_cones_are_those_of_the_map(browser, address):
    with page_without_problems(browser, address) as page:
        answers: list[int] = []
        page.on("response", lambda r: answers.append(int(r.headers.get("content-length", 0))))
        page.goto(f"{address}#view=plan")
        page.wait_for_function("() => Number(document.documentElement.dataset.clustered) > 0")
        settle(page)
        assert sum(drawn(page)) == COUNT
        texts = page.eval_on_selector_all(".cluster:not([hidden])", "all => all.map((n) => n.textContent)")
        assert 3 < len(texts) < 400
        legend_becomes(page, [f"standing {COUNT:,}"])
        page.click("button:has-text('List') >> nth=0")
        assert page.inner_text("#list-tab-cones") == f"Cones{COUNT:,}"
        page.keyboard.press("l")
        for _ in range(8):
            if drawn(page)[0]:
                break
            spot = page.evaluate(NEAREST)
            page.mouse.click(*spot)
            page.wait_for_timeout(300)
            settle(page)
        cones, clustered = drawn(page)
        assert 0 < cones <= COUNT and cones + clustered < COUNT
        page.keyboard.press("Home")
        page.wait_for_timeout(300)
        settle(page)
        assert sum(drawn(page)) == COUNT
        assert max(answers) < 1_000_000
        page.keyboard.press("l")
        page.wait_for_selector(f"#list-cones .table[aria-rowcount='{COUNT + 1}'] .row[data-index='0']:not(:empty)")
        page.focus("#list-cones .table")
        page.keyboard.press("End")  # the last of 30,000 rows
        page.wait_for_selector(f"#list-cones .row[data-index='{COUNT - 1}'][aria-selected=true]")
        page.wait_for_selector(".panel h2")
