"""Chromium and the accessibility checker axe-core, for tests of the window page."""

import shutil
from contextlib import contextmanager
from pathlib import Path

import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
ARGUMENTS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
)  # fmt: skip
AXE = Path(__file__).parents[2] / "build/axe/node_modules/axe-core/axe.min.js"
"""Script of axe-core, installed by `.ci/run`."""


@contextmanager
def chromium():
    """Yield a Chromium browser; skip the test if Chromium or Playwright is missing."""
    playwright = pytest.importorskip("playwright.sync_api")
    if CHROMIUM is None:
        pytest.skip("Chromium is not installed: apt install chromium")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=list(ARGUMENTS))
        try:
            yield browser
        finally:
            browser.close()


@contextmanager
def opened(browser, address, width=1440, height=900, **options):
    """Yield an open page; afterwards fail if a script of the page or a request failed."""
    wrong = []
    page = browser.new_page(viewport={"width": width, "height": height}, **options)
    page.on("pageerror", lambda error: wrong.append(str(error)))

    def failed(request):
        # The page also stops the run by its socket. So the server can end before answering /stop.
        if not request.url.endswith("/stop"):
            wrong.append(request.url)

    page.on("requestfailed", failed)
    try:
        page.goto(address)
        yield page
        assert wrong == []
    finally:
        page.close()
