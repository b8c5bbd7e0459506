"""The Chromium of this machine. Tests that need one are skipped without."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
#: Only the map's own canvas needs the slow software GPU; the rest of a page is drawn without it in a fifth less processor time.
FLAGS = [
    "--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update",
    "--disable-sync", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--disable-gpu-compositing",
    # The pages behind the address bar, which no test sees, take a second of processor time for each new window.
    "--disable-features=WebUIOmniboxPopup,WebUIOmniboxAimPopup,HttpsUpgrades,PaintHolding",
]  # fmt: skip
#: Runs where a page takes it for HTML, and requests `x` even where the page removes what would run. Names of files hold no slash,
#: so the second one is for other texts.
HTML_NAME = "<img src=x onerror=alert(1)>"
HTML = f"{HTML_NAME}<script>alert(2)</script>"


@contextmanager
def chromium() -> Iterator[Any]:
    """A browser of Playwright's; skips the test where there is none."""
    playwright_api = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed (extra `dev`)")
    if CHROMIUM is None:
        pytest.skip("no Chromium on this machine (Debian: apt install chromium)")
    with playwright_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield browser
        browser.close()


@contextmanager
def nothing_of_html_happens(tab: Any) -> Iterator[None]:
    """No page that a tab shows within takes `HTML` for HTML."""
    seen: list[str] = []

    def dismiss(dialog: Any) -> None:
        seen.append(f"a dialog: {dialog.message}")
        dialog.dismiss()

    tab.on("dialog", dismiss)
    tab.on("request", lambda r: seen.append(r.url) if r.url.rpartition("/")[2] in ("x", "elsewhere") else None)
    yield
    tab.wait_for_timeout(300)
    assert seen == []
    assert tab.locator("img[src=x]").count() == 0
